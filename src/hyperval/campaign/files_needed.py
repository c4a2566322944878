"""The dry run: which files a campaign needs, which values are still to be filled in, what it would compare.

Names are looked up in headers, regions, truth and spectra without computing a pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hyperval.campaign.products import undecided_criteria_of
from hyperval.campaign.schema import Campaign, Job, Reference, load_scenarios, read_jobs
from hyperval.compare.judge import Gate
from hyperval.compare.spectra import TOGETHER
from hyperval.config import Location, texts_of, twice
from hyperval.datasets import SIMULATED, check_copy, how_to_get, owner_of, resolve
from hyperval.envi_header import header_beside
from hyperval.errors import HypervalError, InputError, T, package_table
from hyperval.imagery import needs_header
from hyperval.metrics import foreign, metric_of
from hyperval.model import Sources
from hyperval.model.stated import SurfaceStatistics, uncovered_bands
from hyperval.observe import Place, check_line_for_detection, observe, open_place, target_groups
from hyperval.paths import Resolve, is_pattern
from hyperval.products import SPECTRA
from hyperval.results import Outcome, Result, grouped, row_name
from hyperval.run import is_run, read_rows
from hyperval.scenario import Scenario
from hyperval.sensor.specification import load_sensor, sensor_named
from hyperval.simulate import load_scene
from hyperval.spectra.axis import SpectralAxis
from hyperval.statistics_library import ClassStatistics

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
    detail : how to get a file, what a value is, the limit of a comparison, what is wrong, what would
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

    def generalise(self, text: str) -> str:
        """A text with the words of the run as they stand in its file, such as {line}: the same in every run."""
        for word, value in sorted(self.words.items(), key=lambda item: -len(item[1])):
            text = text.replace(value, f"{{{word}}}") if value else text
        return text

    @property
    def is_blocking(self) -> bool:
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
    """The items on one screen: those of several campaigns once, files at hand and comparisons as their number.

    Words that differ between these campaigns stand as names in braces.
    """

    def key(item: Item) -> tuple[str, ...]:
        texts = {PLANNED: (item.campaign, ""), PRESENT: ("", "")}.get(item.state, (item.what, item.detail))
        return item.kind, item.state, *map(item.generalise, texts)

    rows = []
    for (kind, state, what, detail), members in grouped(items, key).items():
        names = list(dict.fromkeys(i.campaign for i in members))
        general = {i.generalise(i.campaign) for i in members}
        one_file = f", {general.pop()}" if len(general) == 1 else ""
        if state == PLANNED:
            count, deciding = (n // len(names) for n in (len(members), sum(i.decides for i in members)))
            what = f"comparisons: {count}, of which acceptance criteria: {deciding}"
            detail = ", ".join(dict.fromkeys(i.what.split()[0] for i in members))
        elif state == PRESENT and len(paths := {i.what for i in members}) > 1:
            what = f"{len(paths)} files"
        elif state == PRESENT or len(names) == 1:
            what, detail = members[0].what, members[0].detail
        campaigns = names[0] if len(names) == 1 else f"{len(names)} campaigns{one_file}"
        rows.append(Item(campaigns, kind, state, what, detail))
    return rows


def summary(items: Sequence[Item]) -> list[str]:
    """One sentence for each campaign, or for several that lack the same, and the holders of missing data."""
    states: dict[tuple[str, str], list[str]] = {}
    for name, rows in grouped(items, lambda item: item.campaign).items():
        files, values, wrong, never = (sum(i.state == s for i in rows) for s in (MISSING, TO_FILL_IN, WRONG, NEVER_MET))
        counts = (files, "file{} missing"), (values, "value{} to fill in"), (wrong, "unknown name{}")
        words = [f"{count} {what.format('s' * (count > 1))}" for count, what in counts if count]
        ready = "ready" + f"; {never} acceptance criteria can never be met" * bool(never)
        states.setdefault((rows[0].generalise(name), ", ".join(words) or ready), []).append(name)
    head = {key: names[0] if len(names) == 1 else f"{key[0]} ({len(names)} campaigns)" for key, names in states.items()}
    out = [f"{names}: {state}" for (_, state), names in head.items()]
    owners = {owner.name: owner for i in items if i.state == MISSING and (owner := owner_of(i.what)) is not None}
    out += [f"{o.name} is held by {o.holder}: {how_to_get(o)}" for o in owners.values() if not o.public]
    return out


def _items(job: Job, finished: Path | None) -> list[Item]:
    """Without the name and the words of the campaign."""
    items = [row for one in job.files for row in _file(one, job)]
    items += [Item("", VALUE, TO_FILL_IN, p.key, f"{p.what} ({p.where})") for p in job.to_fill_in]
    items += [item for gate in job.outline.comparisons for item in _comparisons(gate)]
    lookup = Lookup(job.path, job.lines, (), partial(resolve, base=job.folder))
    are_whole = not job.to_fill_in and all(one.path for one in job.files if one.key == "scenarios")
    scenarios = [*_scenarios(job, lookup)] if are_whole else []
    if not any(item.is_blocking for item in items):
        items += _mistakes(job.campaign, lookup, scenarios)
    if not any(item.is_blocking for item in items):
        items += [Item("", VALUE, TO_FILL_IN, key, "or observe alone: hyperval observe") for key in job.missing_keys]
    return items if any(item.is_blocking for item in items) else [*items, *_undecided_items(job, finished)]


def _undecided_items(job: Job, finished: Path | None) -> Iterator[Item]:
    """Criteria that what is known beforehand, or of a cube what an earlier run found, does not decide.

    >>> from types import SimpleNamespace as Of
    >>> names = "spectral_angle", "bias_ratio", "chi2_reduced_full", "chi2_*"
    >>> gates = [Of(metric=name, product="radiance", gate=True) for name in names]
    >>> job = Of(campaign=Of(comparisons=gates, collection=Of(cube="x.img")))
    >>> [item.what for item in _undecided_items(job, None)]
    ['radiance spectral_angle', 'radiance chi2_reduced_full']
    """
    campaign = job.campaign
    bare = [g for g in campaign.comparisons if g.gate and metric_of(g.metric).is_bare and not is_pattern(g.metric)]
    for gate in bare:
        yield Item("", COMPARISON, NEVER_MET, f"{gate.product} {gate.metric}", "its values have no interval")
    found: list[tuple[Result, str]] = []
    if campaign.collection.cube is not None and finished is not None and is_run(finished):
        rows = (row for row in read_rows(finished, every=False) if row.campaign == campaign.name and row.gates)
        found = [(row, f"in {finished}: {row.reason}") for row in rows if row.outcome is Outcome.UNDECIDED]
    elif campaign.collection.cube is None and campaign.scenarios and any(g.gate for g in campaign.comparisons):
        found = [(row, f"to decide it: {words}") for row, words in undecided_criteria_of(job)]
    for row, words in ((row, words) for row, words in found if not any(gate.matches(row) for gate in bare)):
        state = NEVER_MET if row.never_met else INCONCLUSIVE
        yield Item("", COMPARISON, state, f"{row.product} {row_name(row)}", words)


def _file(reference: Reference, job: Job) -> list[Item]:
    path, problem = reference.path_or_problem
    if path is None:
        held = owner_of(reference.text)
        place = f"expected below HYPERVAL_DATA (--data-dir); {held.name} is not public" if held and held.holder else ""
        return [Item("", FILE, MISSING, reference.text, place or problem)]
    try:
        check_copy(reference.text, path)
    except InputError as error:
        return [Item("", FILE, MISSING, reference.text, f"{error.what}: {error.mend}")]
    rows = [Item("", FILE, PRESENT, reference.text)]
    is_image = reference.key == "collection.cube.path" and needs_header(path) and path.suffix.lower() != ".hdr"
    if is_image and not {"header", "engine"} & {*job.content["collection"]["cube"]} and header_beside(path) is None:
        rows.append(Item("", FILE, MISSING, f"{reference.text}.hdr", "the ENVI header beside the cube"))
    return rows


def _comparisons(gate: Gate) -> Iterator[Item]:
    """One of each subject that an entry names, or of all of them together."""
    decides = "acceptance criterion" if gate.gate else "informational"
    pooled = f" for {gate.fraction_at_least:g} of them" if gate.fraction_at_least else ""
    for subject in [", ".join(gate.subjects)] if pooled else gate.subjects:
        what = f"{gate.product} {gate.metric} of {subject}"
        yield Item("", COMPARISON, PLANNED, what, f"{gate.limit_text}{pooled}, {decides}", decides=gate.gate)


# What a collection offers: its bands, None where they are not known, and its names by what they are of.
CollectionNames = tuple[SpectralAxis | None, dict[str, Sequence[str]]]


@dataclass
class Lookup:
    """Names of one file, with the lines of its entries, and those of all files that do not fit."""

    file: Path
    lines: Mapping[Location, int]
    entry: Location
    find: Resolve  # what its references lead to
    mistakes: list[Item] = field(default_factory=list)

    def add_mistake(self, location: Location, what: str) -> None:
        """A mistake at an entry; the line is that of the entry or of the nearest one that holds it."""
        whole = (*self.entry, *location)
        line = next((self.lines[whole[:n]] for n in range(len(whole), -1, -1) if whole[:n] in self.lines), 1)
        key = ".".join(str(part) for part in whole)
        self.mistakes.append(Item("", NAME, WRONG, f"{self.file}:{line}: {key}", what))

    def call(self, location: Location, read: Callable[..., T], *what: Any, **more: Any) -> T | None:
        """The result of a function of the run; None where it refuses, which is a mistake at an entry."""
        try:
            return read(*what, **more)
        except HypervalError as error:
            expected = f"; expected: {error.expected}" if error.expected else ""
            self.add_mistake(location, ": ".join(filter(None, (error.where, error.what + expected))))
            return None

    def require(self, location: Location, name: str, names: Sequence[str], lacks: str, fits: Any = str.__eq__) -> None:
        """Add a mistake where a name is none of ``names``, or fits none."""
        if not any(fits(one, name) for one in names):
            self.add_mistake(location, f"{lacks} {name!r}; expected: one of {', '.join(names) or 'none'}")

    def spectra(
        self, location: Location, entry: Any, name: str, axis: SpectralAxis | None, regions: Sequence[str] = ()
    ) -> SurfaceStatistics | None:
        """The spectrum of an entry, read with its covariance as the run does; of ``regions`` the names alone.

        What a simulation writes is not there yet; a spread that is stated stands in no file.
        """
        found = dict[str, SurfaceStatistics | None]()
        if axis is None:
            return None
        none = np.zeros(len(axis))
        sources = Sources(axis, dict.fromkeys(regions, ClassStatistics("", axis, none, np.diag(none))), self.find)
        for key in ("spectrum", "covariance"):
            source: Any = getattr(entry, key, None)
            stated = {} if source is None else source.model_dump(exclude_none=True)
            if stated and "relative_sd" not in stated and not str(stated.get("file")).startswith(SIMULATED):
                found[key] = self.call((*location, key), sources.spectrum, source, name)
        return found.get("spectrum")


def _scenarios(job: Job, lookup: Lookup) -> Iterator[tuple[Scenario, Lookup]]:
    """The scenarios, whose files are at hand, each with the file it stands in, its lines, and where in it.

    Raises
    ------
    UsageError : mistakes in the campaign or in the scenario files.
    """
    for i, source in enumerate(job.campaign.scenarios):
        for one, file, lines in load_scenarios(source, lookup.find, job.folder, job.words):
            origin = {"file": file, "lines": lines} if file else {"entry": ("scenarios", i)}
            yield one, replace(lookup, find=partial(resolve, base=one.folder or job.folder), **origin)


def _mistakes(campaign: Campaign, lookup: Lookup, scenarios: Sequence[tuple[Scenario, Lookup]]) -> list[Item]:
    """Every name of a campaign and its scenarios that does not fit."""
    (axis, by_noun), cube, detection = _collection_names(campaign, lookup), campaign.collection.cube, campaign.detection
    nouns = package_table("campaign/keys.yaml")["names"]
    for location, name in texts_of(campaign.model_dump(mode="json")):
        noun, *more = nouns.get(".".join(part for part in location if isinstance(part, str)), [""])
        if noun in by_noun:
            lookup.require(location, name, (*more, *by_noun[noun]), f"no {noun}")
    regions, subjects = by_noun.get("region", ()), by_noun.get("subject", ())
    offered = axis, regions if cube and (cube.quantity != "radiance" or campaign.collection.empirical_line) else ()
    predicted = [name for scenario, look in scenarios for name in _subjects(scenario, look, *offered)]
    # Metrics that a product does not have, and subjects of spectra and curves that neither side has.
    pools = [pool.name for pool in detection.pools] if detection else []
    both = {**{name: [*regions, *subjects] for name in SPECTRA}, "roc": [*subjects, *pools]}
    both[""] = [*regions, *both["roc"]]
    for i, gate in enumerate(campaign.comparisons):
        if wrong := foreign(gate.metric, gate.product):
            lookup.add_mistake(("comparisons", i, "metric"), wrong)
        names = both.get(gate.product, [])
        for k, pattern in enumerate(gate.subjects if names else ()):
            if not any(fnmatchcase(name, pattern) for name in (*names, *TOGETHER)):
                lookup.require(("comparisons", i, "subjects", k), pattern, names, "the collection has no")
            elif gate.product != "roc" and not any(fnmatchcase(name, pattern) for name in (*predicted, *TOGETHER)):
                lookup.require(("comparisons", i, "subjects", k), pattern, predicted, "no scenario has a subject")
    for i, pattern in enumerate(campaign.attribution.each if campaign.attribution and both[""] else ()):
        lookup.require(("attribution", "each", i), pattern, both[""], "the collection has no", fnmatchcase)
    return lookup.mistakes


def _subjects(scenario: Scenario, lookup: Lookup, axis: SpectralAxis | None, regions: Sequence[str]) -> list[str]:
    """The subjects of a scenario, once its sensor and its spectra were looked up."""
    scene, name = scenario.scene, scenario.sensor
    if name is not None:
        sensor = lookup.call(("sensor",), sensor_named, name, lookup.find)
        axis = sensor.axis if axis is None and sensor is not None else axis
    read = dict[str, Any]()
    for kind in ("classes", "panels", "sites", "targets"):
        for i, surface in enumerate(getattr(scene, kind)):
            read[surface.name] = lookup.spectra(("scene", kind, i), surface, surface.name, axis, regions)
    if axis is not None and None not in read.values():
        lookup.call(("scene",), list, uncovered_bands(scenario, read, axis))
    lookup.spectra(("scene", "adjacency"), scene.adjacency, "surroundings", axis, regions)
    populations = [p.name for target in scene.targets for p in target.populations]
    return [s.name for s in (*scene.classes, *scene.panels, *scene.sites)] + populations


def _collection_names(campaign: Campaign, lookup: Lookup) -> CollectionNames:
    """What the collection offers, once its files and the spectra that are looked for in it were looked up."""
    collection, detection, cube = campaign.collection, campaign.detection, campaign.collection.cube
    kind = next(key for key in ("simulate", "cube", "spectra", "radcalnet") if getattr(collection, key))
    read = {"simulate": _names_of_scene, "cube": _names_of_cube}.get(kind, _names_of_spectra)
    axis, names = lookup.call(("collection", kind), read, campaign, lookup) or (None, {})
    for i, panel in enumerate(collection.empirical_line.panels if collection.empirical_line else ()):
        lookup.spectra(("collection", "empirical_line", "panels", i), panel, panel.region, axis)
    if detection is not None and cube is not None:
        for i, target in enumerate(detection.targets if not cube.by_number else ()):  # which are read by bands
            lookup.spectra(("detection", "targets", i), target, target.name, axis)
    return axis, names


def _names_of_spectra(campaign: Campaign, lookup: Lookup) -> CollectionNames:
    """A collection without a cube, which takes no time to look at."""
    observation = observe(campaign.collection, None, lookup.find).observation
    return observation.axis, {"region": list(observation.toa_reflectance or observation.radiance)}


def _names_of_cube(campaign: Campaign, lookup: Lookup) -> CollectionNames:
    """The collection as it lies on the disk; rules on spectra are not run."""
    collection, detection = campaign.collection, campaign.detection
    plain = collection.model_copy(update={"regions": [], "targets": None, "leave_out": []})

    def reopen(**parts: Any) -> Place:
        return open_place(plain.model_copy(update=parts), lookup.find)

    place, names = reopen(), list[str]()
    for i, source in enumerate(collection.regions):
        location = "collection", "regions", i
        if part := source.half or source.ring:
            lookup.require((*location, "half" if source.half else "ring", "of"), part.of, names, "no region")
        if part or source.normalized_difference is not None:
            names.append(str(source.name))
        elif drawn := lookup.call(location, reopen, regions=[source]):
            names += drawn.regions
    for name in twice(names):
        lookup.add_mistake(("collection", "regions"), f"two regions are named {name!r}")
    offered: dict[str, Sequence[str]] = {"region": names}
    truth = lookup.call(("collection", "targets"), reopen, targets=collection.targets) if collection.targets else place
    if detection is not None and detection.targets and truth is not None:  # else one mistake would make others
        lookup.call(("detection",), check_line_for_detection, truth, collection)
        for i, target in enumerate(detection.targets):
            location = "detection", "targets", i
            groups = lookup.call((*location, "material"), target_groups, truth.targets, target, detection.group)
            offered["subject"] = [*offered.get("subject", ()), *(groups or ())]
    if detection and (detection.areas or detection.unmixing) and (truth or place).pixel_area_m2 is None:
        lacks = "areas need the ground area of a pixel, which neither the cube's map nor targets.pixel_size_m states"
        lookup.add_mistake(("detection", "areas" if detection.areas else "unmixing"), lacks)
    return place.cube.axis, offered


def _names_of_scene(campaign: Campaign, lookup: Lookup) -> CollectionNames:
    """The collection as its scene file says that it will be."""
    collection, detection = campaign.collection, campaign.detection
    file = lookup.find(str(collection.simulate))
    scene = load_scene(file)
    sensor_file = file.parent / scene.sensor
    written = [p.name for p in scene.panels]
    drawn = (*(r.name for r in scene.regions), *(str(r.name) for r in collection.regions if not r.file))
    for i, panel in enumerate(collection.empirical_line.panels if collection.empirical_line else ()):
        if panel.spectrum.file == f"{SIMULATED}panel_spectra.csv":
            location = "collection", "empirical_line", "panels", i, "spectrum"
            lookup.require(location, str(panel.spectrum.record), written, "the simulation writes no spectrum")
    offered: dict[str, Sequence[str]] = {"region": [*written, *drawn]}
    offered["target of material"] = list(dict.fromkeys(g.material for g in scene.targets))
    if detection is not None and detection.group == "{group}":  # else by columns of what is only to be written
        offered["subject"] = [g.name for g in scene.targets]
    return load_sensor(str(sensor_file) if sensor_file.is_file() else scene.sensor).axis, offered
