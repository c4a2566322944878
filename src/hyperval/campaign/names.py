"""A dry run: which files a campaign needs, which values are still to be given, what it would compare.

Every name that a campaign uses, looked up without a pixel's being computed: headers, regions, truth, spectra.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any

from hyperval.campaign.job import SIMULATED, Job, Reference, Text, read_texts
from hyperval.campaign.schema import Campaign, DayScenarios, scenarios_of
from hyperval.compare.judge import Gate
from hyperval.config import Location, load_yaml
from hyperval.datasets import check_copy, how_to_get, resolve, set_on_request
from hyperval.envi_header import header_beside
from hyperval.errors import HypervalError, InputError
from hyperval.imagery.rasters import needs_header
from hyperval.metrics import foreign
from hyperval.model import Sources
from hyperval.observe.detection import target_groups
from hyperval.observe.place import IMAGE, SCENE, Place, check_line_for_detection, open_place
from hyperval.observe.site_spectra import observe_radcalnet
from hyperval.paths import matching
from hyperval.scenario import Scenario, SpectrumSource, builtin_scenarios
from hyperval.sensor.specification import load_sensor
from hyperval.simulate import load_scene
from hyperval.spectra.axis import SpectralAxis
from hyperval.statistics_library import builtin_class


@dataclass(frozen=True)
class Mistake:
    """A name that does not fit: ``file:line`` with its key, and what is wrong."""

    where: str
    what: str


@dataclass
class Lookup:
    """Mistakes of one file, with the lines of its entries."""

    file: str
    lines: Mapping[Location, int]
    mistakes: list[Mistake] = field(default_factory=list)

    def add(self, at: Location, what: str) -> None:
        """A mistake at an entry; the line is that of the entry or of the nearest one that holds it."""
        line = next((self.lines[at[:n]] for n in range(len(at), -1, -1) if at[:n] in self.lines), 1)
        key = ".".join(str(part) for part in at)
        self.mistakes.append(Mistake(f"{self.file}:{line}: {key}", what))

    @contextmanager
    def at(self, *location: str | int) -> Any:
        """Errors of what is done inside stand at an entry."""
        try:
            yield
        except HypervalError as error:
            where = f"{error.where}: " if error.where else ""
            expected = f"; expected: {error.expected}" if error.expected else ""
            self.add(location, f"{where}{error.what}{expected}")

    def one(self, location: Location, name: str, known: Sequence[str], noun: str) -> bool:
        """Whether a name is one of ``known``; a mistake where it is none."""
        if name not in known:
            self.add(location, f"no {noun} {name!r}; expected: one of {', '.join(known) or 'none'}")
        return name in known


@dataclass(frozen=True)
class CollectionNames:
    """What a collection offers by name; ``axis`` None where no cube could be opened.

    ``subjects`` are the populations of targets; empty where a group names what only a simulation writes.
    """

    axis: SpectralAxis | None
    regions: tuple[str, ...]
    subjects: tuple[str, ...]
    pixel_size: bool


# Entries of a campaign that name something, and what they name; * stands for each entry of a list.
NAMES = (
    ("collection.leave_out.*", "region"),
    ("collection.snr_regions.*", "region"),
    ("collection.empirical_line.panels.*.region", "region"),
    ("classification.classes.*", "region"),
    ("detection.background.*", "set of pixels"),
    ("detection.false_alarms.*", "set of pixels"),
    ("detection.undesired.*", "region"),
    ("detection.pools.*.subjects.*", "subject"),
    ("detection.areas.*.target", "detection target"),
    ("detection.areas.*.detector", "detector of this campaign"),
    ("detection.unmixing.targets.*.target", "detection target"),
    ("detection.unmixing.background", "region"),
)


def _named(content: Any, pattern: Sequence[str], at: Location = ()) -> Iterator[tuple[Location, str]]:
    """Each text of a configuration at a pattern of its keys, and where it stands."""
    if not pattern:
        yield at, str(content)
    elif pattern[0] == "*":
        for i, item in enumerate(content):
            yield from _named(item, pattern[1:], (*at, i))
    elif content is not None:
        yield from _named(getattr(content, pattern[0]), pattern[1:], (*at, pattern[0]))


def _look_up(campaign: Campaign, lookup: Lookup, offered: CollectionNames) -> None:
    """A mistake for each name that the collection, or the campaign itself, does not have."""
    detection, regions = campaign.detection, offered.regions
    known: dict[str, Sequence[str]] = {"region": regions, "set of pixels": (SCENE, IMAGE, *regions)}
    if detection is not None:
        known["detection target"] = [target.name for target in detection.targets]
        known["detector of this campaign"] = detection.detectors
        known |= {"subject": offered.subjects} if offered.subjects else {}
    for pattern, noun in NAMES:
        for at, name in _named(campaign, pattern.split(".")) if noun in known else ():
            lookup.one(at, name, known[noun], "region" if noun == "set of pixels" else noun)


def campaign_mistakes(campaign: Campaign, lookup: Lookup, base: Path) -> CollectionNames:
    """Look up everything that a campaign names of its collection; mistakes go to ``lookup``.

    Parameters
    ----------
    base : folder of the campaign file
    """
    collection = campaign.collection

    def find(reference: str) -> Path:
        return resolve(reference, base)

    if collection.radcalnet is not None:
        with lookup.at("collection", "radcalnet"):
            seen = observe_radcalnet(collection.radcalnet, find)
            return CollectionNames(seen.axis, tuple(seen.toa_reflectance), (), True)
        return CollectionNames(None, (), (), True)
    if collection.spectra:
        sites = CollectionNames(None, tuple(s.subject for s in collection.spectra), (), True)
        _look_up(campaign, lookup, sites)
        return sites
    offered = _simulated(campaign, lookup, find) if collection.simulate else _opened(campaign, lookup, find)
    if offered is None:
        return CollectionNames(None, (), (), True)
    _look_up(campaign, lookup, offered)
    line = collection.empirical_line
    for i, panel in enumerate(line.panels if line else ()):
        at: Location = ("collection", "empirical_line", "panels", i, "spectrum")
        _spectrum(lookup, at, panel.spectrum, panel.region, offered.axis, find, ())
    detection, by_number = campaign.detection, collection.cube is not None and collection.cube.by_number
    for i, target in enumerate(detection.targets if detection and not by_number else ()):  # those are read by bands
        at = ("detection", "targets", i, "spectrum")
        _spectrum(lookup, at, target.spectrum, target.name, offered.axis, find, ())
    if detection and (detection.areas or detection.unmixing) and not offered.pixel_size:
        lookup.add(
            ("detection", "areas" if detection.areas else "unmixing"),
            "areas need the ground area of a pixel, which neither the cube's map nor targets.pixel_size_m states",
        )
    return offered


def scenario_mistakes(
    scenario: Scenario,
    lookup: Lookup,
    at: Location,
    offered: CollectionNames,
    measured: bool,
    find: Callable[[str], Path],
) -> tuple[str, ...]:
    """Look up everything that a scenario names; returns the names of its subjects.

    Parameters
    ----------
    at : where the scenario stands in its file
    measured : whether the collection gives statistics of its regions
    find : references of the scenario
    """
    axis = offered.axis
    if scenario.sensor is not None:
        with lookup.at(*at, "sensor"):
            name = scenario.sensor
            sensor = load_sensor(find(name) if name.endswith((".yaml", ".yml")) else name)
            axis = axis or sensor.axis
    scene = scenario.scene
    regions = offered.regions if measured else ()
    surfaces: list[tuple[Location, Any]] = []
    for kind in ("classes", "panels", "sites", "targets"):
        surfaces += [((*at, "scene", kind, i), s) for i, s in enumerate(getattr(scene, kind))]
    for location, surface in surfaces:
        _spectrum(lookup, (*location, "spectrum"), surface.spectrum, surface.name, axis, find, regions)
        spread = surface.covariance
        if spread is not None and spread.measured is not None and spread.measured not in regions:
            _unmeasured(lookup, (*location, "covariance", "measured"), spread.measured, regions, measured)
        if spread is not None and spread.builtin is not None and axis is not None:
            with lookup.at(*location, "covariance", "builtin"):
                builtin_class(spread.builtin, axis)
    if scene.adjacency.spectrum is not None:
        at_around = (*at, "scene", "adjacency", "spectrum")
        _spectrum(lookup, at_around, scene.adjacency.spectrum, "surroundings", axis, find, regions)
    names = [s.name for s in (*scene.classes, *scene.panels, *scene.sites)]
    return (*names, *(p.name for t in scene.targets for p in t.populations))


def comparison_mistakes(campaign: Campaign, lookup: Lookup, offered: CollectionNames, predicted: Sequence[str]) -> None:
    """Metrics that a product does not have, and subjects of spectra and curves that neither side has."""
    detection = campaign.detection
    pools = [pool.name for pool in detection.pools] if detection else []
    both = {
        **{key: [*offered.regions, *offered.subjects] for key in ("radiance", "reflectance", "snr", "toa_reflectance")},
        "roc": [*offered.subjects, *pools],
    }
    for i, gate in enumerate(campaign.comparisons):
        if wrong := foreign(gate.metric, gate.product):
            lookup.add(("comparisons", i, "metric"), wrong)
        collected = both.get(gate.product)
        if not collected:
            continue
        for k, pattern in enumerate(gate.subjects):
            at = ("comparisons", i, "subjects", k)
            if not any(fnmatchcase(name, pattern) for name in collected):
                lookup.add(at, f"the collection has no {pattern!r}; expected: one of {', '.join(collected)}")
            elif gate.product != "roc" and not any(fnmatchcase(name, pattern) for name in predicted):
                lookup.add(at, f"no scenario has a subject {pattern!r}; expected: one of {', '.join(predicted)}")


def _opened(campaign: Campaign, lookup: Lookup, find: Callable[[str], Path]) -> CollectionNames | None:
    """The collection as it lies on the disk; rules on spectra are not run."""
    collection = campaign.collection
    rules = [str(r.name) for r in collection.regions if r.normalized_difference is not None]
    if collection.bands is not None:
        with lookup.at("collection", "bands"):
            find(collection.bands.path)
    plain = collection.model_copy(update={"regions": [], "targets": None, "leave_out": []})
    place: Place | None = None
    with lookup.at("collection", "cube"):
        place = open_place(plain, find, show_progress=False)
    if place is None:
        return None
    names: list[str] = []
    for i, source in enumerate(collection.regions):
        if source.normalized_difference is not None:
            continue
        part = source.half or source.ring
        if part is not None:
            key = "half" if source.half else "ring"
            lookup.one(("collection", "regions", i, key, "of"), part.of, [*names, *rules], "region")
            names.append(str(source.name))
            continue
        with lookup.at("collection", "regions", i):
            names += open_place(plain.model_copy(update={"regions": [source]}), find, show_progress=False).regions
    for name in sorted({n for n in names if names.count(n) > 1}):
        lookup.add(("collection", "regions"), f"two regions are named {name!r}")
    if collection.targets is not None:
        with lookup.at("collection", "targets"):
            place = open_place(plain.model_copy(update={"targets": collection.targets}), find, show_progress=False)
    groups: dict[str, None] = {}
    detection = campaign.detection
    if detection is not None and detection.targets:
        with lookup.at("detection"):
            check_line_for_detection(place, collection)
    for i, target in enumerate(detection.targets if detection else ()):
        with lookup.at("detection", "targets", i, "material"):
            groups |= dict.fromkeys(target_groups(place.targets, target, detection.group if detection else ""))
    return CollectionNames(place.cube.axis, (*names, *rules), tuple(groups), place.pixel_area_m2 is not None)


def _simulated(campaign: Campaign, lookup: Lookup, find: Callable[[str], Path]) -> CollectionNames | None:
    """The collection as its scene file says that it will be."""
    with lookup.at("collection", "simulate"):
        scene = load_scene(find(str(campaign.collection.simulate)))
        axis = load_sensor(scene.sensor).axis
        regions = (*(p.name for p in scene.panels), *(r.name for r in scene.regions))
        more = tuple(str(r.name) for r in campaign.collection.regions if r.file is None)
        materials = tuple(dict.fromkeys(g.material for g in scene.targets))
        targets = campaign.detection.targets if campaign.detection else []
        for i, target in enumerate(targets):
            if target.material not in materials:
                lookup.add(
                    ("detection", "targets", i, "material"),
                    f"the scene has no target of material {target.material!r}; one of {', '.join(materials)}",
                )
        written = [p.name for p in scene.panels]
        line = campaign.collection.empirical_line
        for i, panel in enumerate(line.panels if line else ()):
            source = panel.spectrum
            if source.file == f"{SIMULATED}panel_spectra.csv" and source.record not in written:
                lookup.add(
                    ("collection", "empirical_line", "panels", i, "spectrum"),
                    f"the simulation writes no spectrum {source.record!r}; expected: one of {', '.join(written)}",
                )
        subjects: tuple[str, ...] = ()
        if campaign.detection is not None and campaign.detection.group == "{group}":
            subjects = tuple(g.name for g in scene.targets)
        return CollectionNames(axis, regions + more, subjects, True)
    return None


def _spectrum(
    lookup: Lookup,
    at: Location,
    source: SpectrumSource,
    name: str,
    axis: SpectralAxis | None,
    find: Callable[[str], Path],
    regions: Sequence[str],
) -> None:
    """Read a spectrum on the bands; one that a simulation writes, or a region gives, by its name alone."""
    if source.measured is not None:
        if source.measured not in regions:
            _unmeasured(lookup, (*at, "measured"), source.measured, regions, bool(regions))
        return
    if axis is None or (source.file or "").startswith(SIMULATED):
        return
    with lookup.at(*at):
        Sources(axis, {}, find).spectrum(source, name)


def _unmeasured(lookup: Lookup, at: Location, region: str, regions: Sequence[str], measured: bool) -> None:
    if measured:
        lookup.one(at, region, regions, "region")
    else:
        lookup.add(at, "nothing is measured in reflectance: a cube in radiance needs collection.empirical_line")


FILE, VALUE, COMPARISON, NAME = "file", "value", "comparison", "name"
PRESENT, MISSING, TO_FILL_IN, PLANNED, WRONG = "found", "missing", "to fill in", "planned", "wrong"
NEVER_MET = "can never be met"


@dataclass(frozen=True)
class Item:
    """One line of a dry run.

    Attributes
    ----------
    campaign : its name
    kind : "file", "value", "comparison" or "name"
    state : "found", "missing", "to fill in", "planned", "wrong" or "can never be met"
    what : the reference, the key, product and subjects, or file, line and key of a name that does not fit
    detail : size of a file, how to get it, what a value is, the limit of a comparison, what is wrong, what would
        have to be known better
    words : those of the campaign's run
    decides : whether a comparison is an acceptance criterion
    """

    campaign: str
    kind: str
    state: str
    what: str
    detail: str = ""
    words: Mapping[str, str] = field(default_factory=dict)
    decides: bool = False

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
    """List what every campaign names, every name that does not fit, and criteria that can never be met.

    Headers are opened, and no pixel is read; intervals are worked out where the collection is spectra, and no cube.

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
            deciding = sum(i.decides for i in members) // len(names)
            products = dict.fromkeys(i.what.split()[0] for i in members)
            what, detail = f"{count} comparisons, {deciding} acceptance criteria", ", ".join(products)
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
        never = sum(i.state == NEVER_MET for i in own)
        lacking += f"ready; {never} acceptance criteria can never be met" if never else ""
        states.setdefault((own[0].general(name), lacking or "ready"), []).append(name)
    out = [
        f"{names[0] if len(names) == 1 else f'{general} ({len(names)} campaigns)'}: {state}"
        for (general, state), names in states.items()
    ]
    holders = {owner.name: owner for i in items if i.state == MISSING and (owner := set_on_request(i.what)) is not None}
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
    return items if any(item.lacking for item in items) else [*items, *_never_met(name, text)]


def _never_met(name: str, text: Text) -> list[Item]:
    """Criteria whose intervals, as far as they are known beforehand, are wider than their ranges."""
    campaign = text.campaign()
    if campaign.collection.cube is not None or not campaign.scenarios or not any(g.gate for g in campaign.comparisons):
        return []
    from hyperval.campaign.one import never_met, outcomes
    from hyperval.campaign.sides import collected, predicted_side
    from hyperval.model import predict
    from hyperval.results import row_name

    with collected(Job(campaign, text.path, text.named.files), show_progress=False) as side:
        prediction = predicted_side(side, [predict(s, side.origins(s, False)) for s in side.scenarios])
        found = never_met(outcomes(side, prediction), prediction, side.observed.observation)
    return [Item(name, COMPARISON, NEVER_MET, f"{row.product} {row_name(row)}", f"it takes {x}") for row, x in found]


def _file(name: str, reference: Reference, text: Text) -> list[Item]:
    path = reference.path
    if path is None:
        holder = set_on_request(reference.text)
        place = f"to stand below HYPERVAL_DATA (--data-dir); {holder.name} is not public" if holder else ""
        return [Item(name, FILE, MISSING, reference.text, place or reference.problem)]
    matches = matching(path)
    size = sum(p.stat().st_size for p in matches)
    detail = f"{size} bytes" if len(matches) == 1 else f"{len(matches)} files, {size} bytes"
    try:
        check_copy(reference.text, path)
    except InputError as error:
        return [Item(name, FILE, MISSING, reference.text, f"{error.what}: {error.mend}")]
    rows = [Item(name, FILE, PRESENT, reference.text, detail)]
    if reference.key == "collection.cube.path" and needs_header(path):
        given = text.content["collection"]["cube"].get("header")
        if given is None and path.suffix.lower() != ".hdr" and header_beside(path) is None:
            rows.append(Item(name, FILE, MISSING, f"{reference.text}.hdr", "the ENVI header beside the cube"))
    return rows


def _comparison(name: str, gate: Gate) -> Item:
    decides = "acceptance criterion" if gate.gate else "informational"
    pooled = f" for {gate.fraction_at_least:g} of them" if gate.fraction_at_least else ""
    what = f"{gate.product} {gate.metric} of {', '.join(gate.subjects)}"
    return Item(name, COMPARISON, PLANNED, what, f"{gate.limit_text}{pooled}, {decides}", decides=gate.gate)


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


def _mistakes(text: Text, scenarios: Sequence[tuple[Scenario, str, Mapping[Location, int], Location]]) -> list[Mistake]:
    campaign, base = text.campaign(), text.path.resolve().parent
    own = Lookup(str(text.path), text.lines)
    offered = campaign_mistakes(campaign, own, base)
    collection = campaign.collection
    reflects = collection.cube is not None and collection.cube.quantity != "radiance"
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
