"""A dry run: which files a campaign needs, which values are still to be given, what it would compare."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hyperval.campaign.draft import Text, read_texts
from hyperval.campaign.references import Reference
from hyperval.campaign.template import filled
from hyperval.compare.gates import Gate
from hyperval.config import load_yaml, validate
from hyperval.datasets import held_set, how_to_get
from hyperval.file_names import matching
from hyperval.imagery.envi_raster import header_beside
from hyperval.imagery.rasters import needs_header
from hyperval.scenario import Scenario, builtin_scenarios

FILE, VALUE, COMPARISON = "file", "value", "comparison"
FOUND, MISSING, TO_FILL_IN, PLANNED = "found", "missing", "to fill in", "planned"


@dataclass(frozen=True)
class Item:
    """One line of a dry run.

    Attributes
    ----------
    campaign : its name
    kind : "file", "value" or "comparison"
    state : "found", "missing", "to fill in" or "planned"
    what : the reference, the key, or product and subjects
    detail : size of a file, how to get it, what a value is, the limit of a comparison
    """

    campaign: str
    kind: str
    state: str
    what: str
    detail: str = ""

    @property
    def lacking(self) -> bool:
        """Whether the campaign cannot run for want of it."""
        return self.state in (MISSING, TO_FILL_IN)


def dry_run(paths: Sequence[Path]) -> list[Item]:
    """List what every campaign names; nothing is computed and no cube is opened.

    Raises
    ------
    InputError : no such campaign file.
    UsageError : mistakes in a campaign or scenario in which every value is filled in.
    """
    texts = [text for path in paths for text in read_texts(path)]
    return [item for text in texts for item in _items(text)]


def summary(items: Sequence[Item]) -> list[str]:
    """One sentence for each campaign."""
    out = []
    for name in dict.fromkeys(i.campaign for i in items):
        own = [i for i in items if i.campaign == name]
        files = sum(i.state == MISSING for i in own)
        values = sum(i.state == TO_FILL_IN for i in own)
        lacking = f"{files} files missing, {values} values to fill in"
        out.append(f"{name}: {lacking if files or values else 'ready'}")
    holders = {owner.name: owner for i in items if i.state == MISSING and (owner := held_set(i.what)) is not None}
    out += [f"{o.name} is held by {o.held_by}: {how_to_get(o)}" for o in holders.values()]
    return out


def _items(text: Text) -> list[Item]:
    outline = text.outline()
    name = outline.name
    items = [row for reference in text.named.files for row in _file(name, reference, text)]
    items += [Item(name, VALUE, TO_FILL_IN, p.key, f"{p.what} ({p.where})") for p in text.named.to_fill_in]
    items += [_comparison(name, gate) for gate in outline.comparisons]
    if not text.named.to_fill_in:
        _check(text)
    return items


def _file(name: str, reference: Reference, text: Text) -> list[Item]:
    path = reference.path
    if path is None:
        holder = held_set(reference.text)
        place = f"to stand below HYPERVAL_DATA (--data-dir); {holder.name} is not public" if holder else ""
        return [Item(name, FILE, MISSING, reference.text, place or reference.problem)]
    found = matching(path)
    size = sum(p.stat().st_size for p in found)
    detail = f"{size} bytes" if len(found) == 1 else f"{len(found)} files, {size} bytes"
    rows = [Item(name, FILE, FOUND, reference.text, detail)]
    if reference.key == "collection.cube.path" and needs_header(path):
        given = text.content["collection"]["cube"].get("header")
        if given is None and path.suffix.lower() != ".hdr" and header_beside(path) is None:
            rows.append(Item(name, FILE, MISSING, f"{reference.text}.hdr", "the ENVI header beside the cube"))
    return rows


def _comparison(name: str, gate: Gate) -> Item:
    decides = "decides" if gate.gate else "informs"
    pooled = f" for {gate.fraction_at_least:g} of them" if gate.fraction_at_least else ""
    what = f"{gate.product} {gate.metric} of {', '.join(gate.subjects)}"
    return Item(name, COMPARISON, PLANNED, what, f"{gate.limit_text}{pooled}, {decides}")


def _check(text: Text) -> None:
    """Raise UsageError for mistakes in the campaign or in the scenario files that are at hand."""
    for scenario in text.campaign().scenarios:
        if not isinstance(scenario, str) or scenario in builtin_scenarios():
            continue
        path = Reference("scenarios", scenario, text.path.resolve().parent).path
        if path is not None:
            scenario_of(path, text)


def scenario_of(path: Path, text: Text) -> Scenario:
    """A scenario file with the words of the run; UsageError for its mistakes."""
    data, lines = load_yaml(path)
    return validate(Scenario, filled(data, text.words), lines, str(path))
