"""A dry run: which files a campaign needs, which values are still to be given, what it would compare.

Every name that a campaign uses, looked up without a pixel's being computed: headers, regions, truth, spectra.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from hyperval.campaign.products import undecided_by
from hyperval.campaign.schema import Campaign, DayScenarios, Job, Reference, read_jobs, scenarios_of
from hyperval.compare.judge import Gate
from hyperval.compare.spectra import TOGETHER
from hyperval.config import Location, load_yaml, twice
from hyperval.datasets import SIMULATED, check_copy, how_to_get, owner_of, resolve
from hyperval.envi_header import header_beside
from hyperval.errors import HypervalError, InputError
from hyperval.imagery import needs_header
from hyperval.metrics import foreign
from hyperval.model import Sources
from hyperval.observe import IMAGE, SCENE, Place, check_line_for_detection, observe_radcalnet, open_place, target_groups
from hyperval.paths import Resolve, matching
from hyperval.products import SPECTRA
from hyperval.results import Outcome, Result, row_name
from hyperval.run import is_run, read_rows
from hyperval.scenario import Scenario, SpectrumSource, builtin_scenarios
from hyperval.sensor.specification import load_sensor
from hyperval.simulate import load_scene
from hyperval.spectra.axis import SpectralAxis
from hyperval.statistics_library import builtin_class

FILE, VALUE, COMPARISON, NAME = "file", "value", "comparison", "name"
PRESENT, MISSING, TO_FILL_IN, PLANNED, WRONG = "found", "missing", "to fill in", "planned", "wrong"
NEVER_MET, INCONCLUSIVE = "can never be met", "inconclusive"


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


def dry_run(paths: Sequence[Path], finished: Path | None = None) -> list[Item]:
    """List what every campaign names, every name that does not fit, and criteria that can never be met.

    Headers are opened, and no pixel is read; intervals are worked out where the collection is spectra, and no cube.

    Parameters
    ----------
    finished : folder of an earlier run, whose inconclusive criteria of campaigns with a cube are listed

    Raises
    ------
    InputError : no such campaign file.
    UsageError : mistakes in a campaign or scenario in which every value is filled in.
    """
    jobs = [job for path in paths for job in read_jobs(path)]
    items = [(job, item) for job in jobs for item in _items(job, finished)]
    return [replace(item, campaign=job.outline.name, words=job.words) for job, item in items]


def overview(items: Sequence[Item]) -> list[Item]:
    """The items on one screen: what several campaigns share once, files at hand and comparisons as their number.

    The words of a run stand in braces where an item is that of several campaigns.
    """
    groups: dict[tuple[str, str, str, str], list[Item]] = {}
    for item in items:
        shown = {PLANNED: (item.campaign, ""), PRESENT: ("", "")}.get(item.state, (item.what, item.detail))
        what, detail = map(item.general, shown)
        groups.setdefault((item.kind, item.state, what, detail), []).append(item)
    rows = []
    for (kind, state, what, detail), members in groups.items():
        names = list(dict.fromkeys(i.campaign for i in members))
        general = {i.general(i.campaign) for i in members}
        one_file = f", {general.pop()}" if len(general) == 1 else ""
        if state == PLANNED:
            count, deciding = (n // len(names) for n in (len(members), sum(i.decides for i in members)))
            what = f"{count} comparisons, {deciding} acceptance criteria"
            detail = ", ".join(dict.fromkeys(i.what.split()[0] for i in members))
        elif state == PRESENT:
            paths = {i.what for i in members}
            what = f"{len(paths)} files" if len(paths) > 1 else members[0].what
        elif len(names) == 1:
            what, detail = members[0].what, members[0].detail
        who = names[0] if len(names) == 1 else f"{len(names)} campaigns{one_file}"
        rows.append(Item(who, kind, state, what, detail))
    return rows


def summary(items: Sequence[Item]) -> list[str]:
    """One sentence for each campaign, or for several that lack the same; who holds what is missing."""
    states: dict[tuple[str, str], list[str]] = {}
    for name in dict.fromkeys(i.campaign for i in items):
        own = [i for i in items if i.campaign == name]
        files, values, wrong, never = (sum(i.state == s for i in own) for s in (MISSING, TO_FILL_IN, WRONG, NEVER_MET))
        words = [f"{files} files missing, {values} values to fill in"] * bool(files or values)
        words += [f"{wrong} unknown names"] * bool(wrong)
        ready = "ready" + f"; {never} acceptance criteria can never be met" * bool(never)
        states.setdefault((own[0].general(name), ", ".join(words) or ready), []).append(name)
    who = {key: names[0] if len(names) == 1 else f"{key[0]} ({len(names)} campaigns)" for key, names in states.items()}
    out = [f"{names}: {state}" for (_, state), names in who.items()]
    owners = {owner.name: owner for i in items if i.state == MISSING and (owner := owner_of(i.what)) is not None}
    out += [f"{o.name} is held by {o.holder}: {how_to_get(o)}" for o in owners.values() if not o.public]
    return out


def _items(job: Job, finished: Path | None) -> list[Item]:
    """Without the name and the words of the campaign."""
    items = [row for one in job.files for row in _file(one, job)]
    items += [Item("", VALUE, TO_FILL_IN, p.key, f"{p.what} ({p.where})") for p in job.to_fill_in]
    items += [_comparison(gate) for gate in job.outline.comparisons]
    scenarios = [] if job.to_fill_in else _scenarios(job)
    if not any(item.lacking for item in items):
        items += _mistakes(job, scenarios)
    return items if any(item.lacking for item in items) else [*items, *_undecided(job, finished)]


def _undecided(job: Job, finished: Path | None) -> Iterator[Item]:
    """Criteria that what is known beforehand, or of a cube what an earlier run found, does not decide."""
    campaign = job.campaign
    found: list[tuple[Result, str]] = []
    if campaign.collection.cube is not None and finished is not None and is_run(finished):
        rows = (row for row in read_rows(finished, every=False) if row.campaign == campaign.name and row.gates)
        found = [(row, f"in {finished}: {row.reason}") for row in rows if row.outcome is Outcome.UNDECIDED]
    elif campaign.collection.cube is None and campaign.scenarios and any(g.gate for g in campaign.comparisons):
        found = [(row, f"to decide it: {words}") for row, words in undecided_by(job)]
    for row, words in found:
        state = NEVER_MET if row.never_met else INCONCLUSIVE
        yield Item("", COMPARISON, state, f"{row.product} {row_name(row)}", words)


def _file(reference: Reference, job: Job) -> list[Item]:
    path = reference.path
    if path is None:
        held = owner_of(reference.text)
        place = f"expected below HYPERVAL_DATA (--data-dir); {held.name} is not public" if held and held.holder else ""
        return [Item("", FILE, MISSING, reference.text, place or reference.problem)]
    try:
        check_copy(reference.text, path)
    except InputError as error:
        return [Item("", FILE, MISSING, reference.text, f"{error.what}: {error.mend}")]
    matches = matching(path)
    size = f"{sum(p.stat().st_size for p in matches)} bytes"
    rows = [Item("", FILE, PRESENT, reference.text, size if len(matches) == 1 else f"{len(matches)} files, {size}")]
    is_image = reference.key == "collection.cube.path" and needs_header(path) and path.suffix.lower() != ".hdr"
    if is_image and job.content["collection"]["cube"].get("header") is None and header_beside(path) is None:
        rows.append(Item("", FILE, MISSING, f"{reference.text}.hdr", "the ENVI header beside the cube"))
    return rows


def _comparison(gate: Gate) -> Item:
    decides = "acceptance criterion" if gate.gate else "informational"
    pooled = f" for {gate.fraction_at_least:g} of them" if gate.fraction_at_least else ""
    what = f"{gate.product} {gate.metric} of {', '.join(gate.subjects)}"
    return Item("", COMPARISON, PLANNED, what, f"{gate.limit_text}{pooled}, {decides}", decides=gate.gate)


@dataclass
class Lookup:
    """Names of one file, with the lines of its entries, and those of them that do not fit."""

    file: Path
    lines: Mapping[Location, int]
    at: Location
    find: Resolve  # what its references lead to
    mistakes: list[Item] = field(default_factory=list)

    def add(self, location: Location, what: str) -> None:
        """A mistake at an entry; the line is that of the entry or of the nearest one that holds it."""
        whole = (*self.at, *location)
        line = next((self.lines[whole[:n]] for n in range(len(whole), -1, -1) if whole[:n] in self.lines), 1)
        key = ".".join(str(part) for part in whole)
        self.mistakes.append(Item("", NAME, WRONG, f"{self.file}:{line}: {key}", what))

    @contextmanager
    def within(self, *location: str | int) -> Iterator[None]:
        """Errors of what is done inside stand at an entry."""
        try:
            yield
        except HypervalError as error:
            expected = f"; expected: {error.expected}" if error.expected else ""
            self.add(location, ": ".join(filter(None, (error.where, error.what + expected))))

    def one(self, location: Location, name: str, known: Sequence[str], noun: str, whose: str = "") -> None:
        """A mistake where a name is none of ``known``."""
        if name not in known:
            expected = f"expected: one of {', '.join(known) or 'none'}"
            self.add(location, f"{whose or 'no'} {noun}{name!r}; {expected}")

    def named(self, content: Any, pattern: str, at: Location = ()) -> Iterator[tuple[Location, Any]]:
        """What a configuration holds at a pattern of its keys, and where; * is each entry of a list."""
        part, _, rest = pattern.partition(".")
        if not part and content is not None:
            yield at, content
        elif part == "*":
            for i, item in enumerate(content):
                yield from self.named(item, rest, (*at, i))
        elif content is not None:
            yield from self.named(getattr(content, part), rest, (*at, part))

    def measured(self, at: Location, region: str, regions: Sequence[str]) -> None:
        """A region that gives its statistics; without any, none does."""
        if regions:
            self.one(at, region, regions, "region ")
        else:
            self.add(at, "no reflectance is measured: a cube in radiance needs collection.empirical_line")

    def spectrum(
        self, at: Location, source: SpectrumSource, name: str, axis: SpectralAxis | None, regions: Sequence[str] = ()
    ) -> None:
        """Read a spectrum on the bands; one that a simulation writes, or a region gives, by its name alone."""
        if source.measured is not None:
            self.measured((*at, "measured"), source.measured, regions)
        elif axis is not None and not (source.file or "").startswith(SIMULATED):
            with self.within(*at):
                Sources(axis, {}, self.find).spectrum(source, name)


class CollectionNames(NamedTuple):
    """What a collection offers by name; ``axis`` None where no cube could be opened.

    ``subjects`` are the populations of targets; empty where a group names what only a simulation writes.
    """

    axis: SpectralAxis | None = None
    regions: tuple[str, ...] = ()
    subjects: tuple[str, ...] = ()
    pixel_size: bool = True


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


def _scenarios(job: Job) -> list[tuple[Scenario, Lookup]]:
    """The scenarios, whose files are at hand, each with the file it stands in, its lines, and where in it.

    Raises
    ------
    UsageError : mistakes in the campaign or in the scenario files.
    """
    out, find = [], partial(resolve, base=job.folder)
    for i, source in enumerate(job.campaign.scenarios):
        named = source.scenario if isinstance(source, DayScenarios) else source
        at: tuple[Path, Mapping[Location, int], Location] = job.path, job.lines, ("scenarios", i)
        if isinstance(named, str) and named not in builtin_scenarios():
            at = find(named), load_yaml(find(named))[1], ()
        for one in scenarios_of(source, find, job.folder, job.words):
            out.append((one, Lookup(*at, partial(resolve, base=one.folder or job.folder))))
    return out


def _mistakes(job: Job, scenarios: Sequence[tuple[Scenario, Lookup]]) -> list[Item]:
    """Every name of a campaign and its scenarios that does not fit."""
    campaign, own = job.campaign, Lookup(job.path, job.lines, (), partial(resolve, base=job.folder))
    offered, cube = _offered(campaign, own), campaign.collection.cube
    measured = cube is not None and (cube.quantity != "radiance" or campaign.collection.empirical_line is not None)
    regions = offered.regions if measured else ()  # that the collection gives statistics of
    predicted: list[str] = []  # the subjects of all scenarios
    for scenario, lookup in scenarios:
        scene, axis = scenario.scene, offered.axis
        if scenario.sensor is not None:
            with lookup.within("sensor"):
                name = scenario.sensor
                sensor = load_sensor(lookup.find(name) if name.endswith((".yaml", ".yml")) else name)
                axis = axis or sensor.axis
        for kind in ("classes", "panels", "sites", "targets"):
            for at, surface in lookup.named(scenario, f"scene.{kind}.*"):
                lookup.spectrum((*at, "spectrum"), surface.spectrum, surface.name, axis, regions)
                for place, region in lookup.named(surface, "covariance.measured", at):
                    lookup.measured(place, region, regions)
                for place, name in lookup.named(surface, "covariance.builtin", at):
                    if axis is not None:
                        with lookup.within(*place):
                            builtin_class(name, axis)
        for at, source in lookup.named(scenario, "scene.adjacency.spectrum"):
            lookup.spectrum(at, source, "surroundings", axis, regions)
        predicted += [s.name for s in (*scene.classes, *scene.panels, *scene.sites)]
        predicted += [p.name for t in scene.targets for p in t.populations]
    # Metrics that a product does not have, and subjects of spectra and curves that neither side has.
    pools = [pool.name for pool in campaign.detection.pools] if campaign.detection else []
    both = {**{name: [*offered.regions, *offered.subjects] for name in SPECTRA}, "roc": [*offered.subjects, *pools]}
    for i, gate in enumerate(campaign.comparisons):
        if wrong := foreign(gate.metric, gate.product):
            own.add(("comparisons", i, "metric"), wrong)
        known = both.get(gate.product, [])
        for k, pattern in enumerate(gate.subjects if known else ()):
            if not any(fnmatchcase(name, pattern) for name in (*known, *TOGETHER)):
                own.one(("comparisons", i, "subjects", k), pattern, known, "", "the collection has no")
            elif gate.product != "roc" and not any(fnmatchcase(name, pattern) for name in (*predicted, *TOGETHER)):
                own.one(("comparisons", i, "subjects", k), pattern, predicted, "subject ", "no scenario has a")
    return [item for lookup in (own, *(lookup for _, lookup in scenarios)) for item in lookup.mistakes]


def _offered(campaign: Campaign, lookup: Lookup) -> CollectionNames:
    """What the collection offers, once everything that the campaign names of it was looked up."""
    collection, detection, cube = campaign.collection, campaign.detection, campaign.collection.cube
    offered = CollectionNames(regions=tuple(s.subject for s in collection.spectra))
    if collection.radcalnet is not None:
        with lookup.within("collection", "radcalnet"):
            seen = observe_radcalnet(collection.radcalnet, lookup.find)
            return CollectionNames(seen.axis, tuple(seen.toa_reflectance))
    elif cube is not None:
        offered = (_simulated if collection.simulate else _opened)(campaign, lookup)
    if not collection.spectra and offered.axis is None:
        return offered
    known: dict[str, Sequence[str]] = {"region": offered.regions, "set of pixels": (SCENE, IMAGE, *offered.regions)}
    if detection is not None:
        known["detection target"] = [target.name for target in detection.targets]
        known["detector of this campaign"] = detection.detectors
        known |= {"subject": offered.subjects} if offered.subjects else {}
    for pattern, noun in NAMES:
        for at, name in lookup.named(campaign, pattern) if noun in known else ():
            lookup.one(at, str(name), known[noun], "region " if noun == "set of pixels" else f"{noun} ")
    if cube is None:
        return offered
    for at, panel in lookup.named(campaign, "collection.empirical_line.panels.*"):
        lookup.spectrum((*at, "spectrum"), panel.spectrum, panel.region, offered.axis)
    for at, target in lookup.named(campaign, "detection.targets.*") if not cube.by_number else ():  # read by bands
        lookup.spectrum((*at, "spectrum"), target.spectrum, target.name, offered.axis)
    if detection and (detection.areas or detection.unmixing) and not offered.pixel_size:
        lookup.add(
            ("detection", "areas" if detection.areas else "unmixing"),
            "areas need the ground area of a pixel, which neither the cube's map nor targets.pixel_size_m states",
        )
    return offered


def _opened(campaign: Campaign, lookup: Lookup) -> CollectionNames:
    """The collection as it lies on the disk; rules on spectra are not run."""
    collection, detection = campaign.collection, campaign.detection
    if collection.bands is not None:
        with lookup.within("collection", "bands"):
            lookup.find(collection.bands.path)
    plain = collection.model_copy(update={"regions": [], "targets": None, "leave_out": []})

    def opened(**parts: Any) -> Place | None:
        return open_place(plain.model_copy(update=parts), lookup.find)

    place: Place | None = None
    with lookup.within("collection", "cube"):
        place = opened()
    if place is None:
        return CollectionNames()
    rules = [str(r.name) for r in collection.regions if r.normalized_difference is not None]
    names: list[str] = []
    for i, source in enumerate(collection.regions):
        at = "collection", "regions", i
        if part := source.half or source.ring:
            lookup.one((*at, "half" if source.half else "ring", "of"), part.of, [*names, *rules], "region ")
            names.append(str(source.name))
        elif source.normalized_difference is None:
            with lookup.within(*at):
                names += getattr(opened(regions=[source]), "regions", ())
    for name in twice(names):
        lookup.add(("collection", "regions"), f"two regions are named {name!r}")
    if collection.targets is not None:
        with lookup.within("collection", "targets"):
            place = opened(targets=collection.targets) or place
    groups: dict[str, None] = {}
    if detection is not None and detection.targets:
        with lookup.within("detection"):
            check_line_for_detection(place, collection)
        for i, target in enumerate(detection.targets):
            with lookup.within("detection", "targets", i, "material"):
                groups |= dict.fromkeys(target_groups(place.targets, target, detection.group))
    return CollectionNames(place.cube.axis, (*names, *rules), tuple(groups), place.pixel_area_m2 is not None)


def _simulated(campaign: Campaign, lookup: Lookup) -> CollectionNames:
    """The collection as its scene file says that it will be."""
    collection, detection = campaign.collection, campaign.detection
    with lookup.within("collection", "simulate"):
        file = lookup.find(str(collection.simulate))
        scene = load_scene(file)
        own = file.parent / scene.sensor
        axis = load_sensor(str(own) if own.is_file() else scene.sensor).axis
        written = [p.name for p in scene.panels]
        regions = (*written, *(r.name for r in scene.regions), *(str(r.name) for r in collection.regions if not r.file))
        materials = list(dict.fromkeys(g.material for g in scene.targets))
        for at, material in lookup.named(campaign, "detection.targets.*.material"):
            lookup.one(at, material, materials, "target of material ", "the scene has no")
        for at, source in lookup.named(campaign, "collection.empirical_line.panels.*.spectrum"):
            if source.file == f"{SIMULATED}panel_spectra.csv":
                lookup.one(at, str(source.record), written, "spectrum ", "the simulation writes no")
        grouped = detection is not None and detection.group == "{group}"
        return CollectionNames(axis, regions, tuple(g.name for g in scene.targets) if grouped else ())
    return CollectionNames()
