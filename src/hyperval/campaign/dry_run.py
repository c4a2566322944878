"""A dry run: which files a campaign needs, which values are still to be given, what it would compare."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from hyperval.campaign.day_scenarios import DayScenarios, scenarios_of
from hyperval.campaign.job import Text, read_texts
from hyperval.campaign.names import (
    Lookup,
    Mistake,
    campaign_mistakes,
    comparison_mistakes,
    scenario_mistakes,
)
from hyperval.campaign.references import Reference
from hyperval.compare.gates import Gate
from hyperval.config import Location, load_yaml
from hyperval.datasets import how_to_get, resolve, set_on_request
from hyperval.file_names import matching
from hyperval.imagery.envi_raster import header_beside
from hyperval.imagery.rasters import needs_header
from hyperval.scenario import Scenario, builtin_scenarios

FILE, VALUE, COMPARISON, NAME = "file", "value", "comparison", "name"
PRESENT, MISSING, TO_FILL_IN, PLANNED, WRONG = "found", "missing", "to fill in", "planned", "wrong"


@dataclass(frozen=True)
class Item:
    """One line of a dry run.

    Attributes
    ----------
    campaign : its name
    kind : "file", "value", "comparison" or "name"
    state : "found", "missing", "to fill in", "planned" or "wrong"
    what : the reference, the key, product and subjects, or file, line and key of a name that does not fit
    detail : size of a file, how to get it, what a value is, the limit of a comparison, what is wrong
    words : those of the campaign's run
    """

    campaign: str
    kind: str
    state: str
    what: str
    detail: str = ""
    words: Mapping[str, str] = field(default_factory=dict)

    def general(self, text: str) -> str:
        """A text with the words of the run as they stand in its file, such as {line}: the same in every run."""
        for word, own in sorted(self.words.items(), key=lambda item: -len(item[1])):
            text = text.replace(own, f"{{{word}}}") if own else text
        return text

    @property
    def lacking(self) -> bool:
        """Whether the campaign cannot run for want of it."""
        return self.state in (MISSING, TO_FILL_IN, WRONG)


def dry_run(paths: Sequence[Path]) -> list[Item]:
    """List what every campaign names, and every name that does not fit; headers are opened, nothing is computed.

    Raises
    ------
    InputError : no such campaign file.
    UsageError : mistakes in a campaign or scenario in which every value is filled in.
    """
    texts = [text for path in paths for text in read_texts(path)]
    return [replace(item, words=text.words) for text in texts for item in _items(text)]


def overview(items: Sequence[Item]) -> list[Item]:
    """The items on one screen: what several campaigns share once, files at hand and comparisons as their number.

    The words of a run stand in braces where an item is that of several campaigns.
    """
    groups: dict[tuple[str, str, str, str], list[Item]] = {}
    for item in items:
        what, detail = item.general(item.what), item.general(item.detail)
        if item.state == PLANNED:
            what, detail = item.general(item.campaign), ""
        elif item.state == PRESENT:
            what = detail = ""
        groups.setdefault((item.kind, item.state, what, detail), []).append(item)
    rows = []
    for (kind, state, what, detail), members in groups.items():
        names = list(dict.fromkeys(i.campaign for i in members))
        general = list(dict.fromkeys(i.general(i.campaign) for i in members))
        one_file = f", {general[0]}" if len(general) == 1 else ""
        who = names[0] if len(names) == 1 else f"{len(names)} campaigns{one_file}"
        if len(names) == 1 and state not in (PLANNED, PRESENT):
            what, detail = members[0].what, members[0].detail
        elif state == PLANNED:
            count = len(members) // len(names)
            deciding = sum(i.detail.endswith(", decides") for i in members) // len(names)
            products = dict.fromkeys(i.what.split()[0] for i in members)
            what, detail = f"{count} comparisons, {deciding} decide", ", ".join(products)
        elif state == PRESENT:
            paths = {i.what for i in members}
            what = f"{len(paths)} files" if len(paths) > 1 else members[0].what
        rows.append(Item(who, kind, state, what, detail))
    return rows


def summary(items: Sequence[Item]) -> list[str]:
    """One sentence for each campaign, or for several that lack the same; who holds what is missing."""
    states: dict[tuple[str, str], list[str]] = {}
    for name in dict.fromkeys(i.campaign for i in items):
        own = [i for i in items if i.campaign == name]
        files = sum(i.state == MISSING for i in own)
        values = sum(i.state == TO_FILL_IN for i in own)
        wrong = sum(i.state == WRONG for i in own)
        lacking = f"{files} files missing, {values} values to fill in" if files or values else ""
        lacking += f"{', ' if lacking else ''}{wrong} names that do not fit" if wrong else ""
        states.setdefault((own[0].general(name), lacking or "ready"), []).append(name)
    out = [
        f"{names[0] if len(names) == 1 else f'{general} ({len(names)} campaigns)'}: {state}"
        for (general, state), names in states.items()
    ]
    holders = {
        owner.name: owner for i in items if i.state == MISSING and (owner := set_on_request(i.what)) is not None
    }
    out += [f"{o.name} is held by {o.holder}: {how_to_get(o)}" for o in holders.values()]
    return out


def _items(text: Text) -> list[Item]:
    outline = text.outline()
    name = outline.name
    items = [row for reference in text.named.files for row in _file(name, reference, text)]
    items += [Item(name, VALUE, TO_FILL_IN, p.key, f"{p.what} ({p.where})") for p in text.named.to_fill_in]
    items += [_comparison(name, gate) for gate in outline.comparisons]
    if not text.named.to_fill_in:
        scenarios = _scenarios(text)
        if not any(item.state == MISSING for item in items):
            items += [Item(name, NAME, WRONG, m.where, m.what) for m in _mistakes(text, scenarios)]
    return items


def _file(name: str, reference: Reference, text: Text) -> list[Item]:
    path = reference.path
    if path is None:
        holder = set_on_request(reference.text)
        place = f"to stand below HYPERVAL_DATA (--data-dir); {holder.name} is not public" if holder else ""
        return [Item(name, FILE, MISSING, reference.text, place or reference.problem)]
    matches = matching(path)
    size = sum(p.stat().st_size for p in matches)
    detail = f"{size} bytes" if len(matches) == 1 else f"{len(matches)} files, {size} bytes"
    rows = [Item(name, FILE, PRESENT, reference.text, detail)]
    if reference.key == "collection.cube.path" and needs_header(path):
        given = text.content["collection"]["cube"].get("header")
        if given is None and path.suffix.lower() != ".hdr" and header_beside(path) is None:
            rows.append(Item(name, FILE, MISSING, f"{reference.text}.hdr", "the ENVI header beside the cube"))
    return rows


def _comparison(name: str, gate: Gate) -> Item:
    decides = "decides" if gate.gate else "does not decide"
    pooled = f" for {gate.fraction_at_least:g} of them" if gate.fraction_at_least else ""
    what = f"{gate.product} {gate.metric} of {', '.join(gate.subjects)}"
    return Item(name, COMPARISON, PLANNED, what, f"{gate.limit_text}{pooled}, {decides}")


def _scenarios(text: Text) -> list[tuple[Scenario, str, Mapping[Location, int], Location]]:
    """The scenarios, whose files are at hand, each with the file it stands in, its lines, and where in it.

    Raises
    ------
    UsageError : mistakes in the campaign or in the scenario files.
    """
    out: list[tuple[Scenario, str, Mapping[Location, int], Location]] = []
    base = text.path.resolve().parent
    find = partial(resolve, base=base)
    for i, source in enumerate(text.campaign().scenarios):
        named = source.scenario if isinstance(source, DayScenarios) else source
        at: Location = ("scenarios", i)
        file, lines = text.path, text.lines
        if isinstance(named, str) and named not in builtin_scenarios():
            file, at = find(named), ()
            lines = load_yaml(file)[1]
        out += [(scenario, str(file), lines, at) for scenario in scenarios_of(source, find, base, text.words)]
    return out


def _mistakes(
    text: Text, scenarios: Sequence[tuple[Scenario, str, Mapping[Location, int], Location]]
) -> list[Mistake]:
    campaign, base = text.campaign(), text.path.resolve().parent
    own = Lookup(str(text.path), text.lines)
    offered = campaign_mistakes(campaign, own, base)
    collection = campaign.collection
    reflects = collection.cube is not None and collection.cube.quantity == "reflectance"
    subjects: list[str] = []
    others: list[Mistake] = []
    for scenario, file, lines, at in scenarios:
        lookup = Lookup(file, lines)
        find = partial(resolve, base=scenario.folder or base)
        measured = reflects or (collection.cube is not None and collection.empirical_line is not None)
        subjects += scenario_mistakes(scenario, lookup, at, offered, measured, find)
        others += lookup.mistakes
    comparison_mistakes(campaign, own, offered, subjects)
    return [*own.mistakes, *others]
