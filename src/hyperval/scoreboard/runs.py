"""The benchmark: all detectors on each campaign, and the folder with the results.

Detectors of the user's own: Python files that register them.  The page: detectors with ranks, campaign by campaign.
"""

from __future__ import annotations

import math
import runpy
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from hyperval.campaign import Campaign, Job, collected, jobs_of
from hyperval.campaign.provenance import command_without_output, record_of
from hyperval.datasets import InputLog
from hyperval.errors import HypervalError, InputError, MissingDataError, UsageError, internal_error
from hyperval.executors import in_order, worker_count, workers
from hyperval.figures.spec import Axis, ColourScale, Figure, Mark, Panels, Part, measured_mark, row_names
from hyperval.imagery.cube import raster_of_size
from hyperval.model import predict
from hyperval.observe import open_place
from hyperval.pixels import AddedDetectorError, PixelDetector, detect, detector_names, register_detector
from hyperval.progress import step, track
from hyperval.report.html import page
from hyperval.report.verdict import number_text
from hyperval.results import Cause, Outcome, Result, ResultTable, of_campaign
from hyperval.run import Run
from hyperval.scenario import Scenario
from hyperval.scoreboard.detectors import (
    EVERY_OBJECT,
    PRODUCT,
    Question,
    classes_with_regions,
    detector_rows,
    peer_rows,
    predicted_rows,
    with_every_detector,
)
from hyperval.scoreboard.ranks import MEASURES
from hyperval.storage import sha256_of, whole_folder

_LOADED: set[Path] = set()
_TITLES = {m.name: m.title for m in MEASURES.values()}


def load_extensions(paths: Iterable[Path]) -> None:
    """Run each file once in this process; what it registers has rows from then on.

    The files are programs: run only what you trust.

    Raises
    ------
    InputError : no such file.
    UsageError : a file that fails.
    """
    for path in paths:
        place = Path(path).resolve()
        if place in _LOADED:
            continue
        if not place.is_file():
            raise InputError("no such file", where=str(path), expected="a Python file that registers detectors")
        try:
            runpy.run_path(str(place))
        except HypervalError:
            raise
        except Exception as error:
            raise UsageError(
                f"the extension fails: {type(error).__name__}: {error}",
                where=str(path),
                expected="a Python file that calls register_detector",
            ) from error
        _LOADED.add(place)


INTERNAL_ERROR = 4


@dataclass(frozen=True)
class Entry:
    """One campaign to be run, as it is handed to a worker."""

    job: Job
    seed: int
    extensions: tuple[Path, ...] = ()
    scores: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Benchmarked:
    """What one campaign gives to the page.

    Attributes
    ----------
    exit_code : of the error that stopped it; None when nothing did
    here : subject, method and metric -> the row, where it has a value
    measures : metrics of all objects together
    groups : detectors that have the same value of each of these: they order the pixels alike
    """

    name: str
    title: str
    simulated: bool
    rows: list[Result]
    notes: list[str] = field(default_factory=list)
    provenance: dict[str, Any] = field(default_factory=dict)
    exit_code: int | None = None

    @cached_property
    def here(self) -> dict[tuple[str, str, str], Result]:  # noqa: D102 - above
        return {(r.subject, r.method, r.metric): r for r in self.rows if r.outcome is Outcome.NONE}

    @cached_property
    def measures(self) -> list[str]:  # noqa: D102 - above
        return [m for m in _TITLES if any((s, metric) == (EVERY_OBJECT, m) for s, _, metric in self.here)]

    @cached_property
    def groups(self) -> list[tuple[str, ...]]:  # noqa: D102 - above
        values: dict[str, dict[str, float]] = {}
        for (subject, method, metric), row in self.here.items():
            if subject == EVERY_OBJECT and metric in _TITLES:
                values.setdefault(method.removesuffix("/object"), {})[metric] = row.value
        each = list(values.values())
        return [tuple(n for n in values if values[n] == own) for i, own in enumerate(each) if own not in each[:i]]

    def standing(self, group: tuple[str, ...], metric: str, subject: str = EVERY_OBJECT) -> list[Result | None]:
        """Value, rank and share of first places of a group by a metric."""
        return [self.here.get((subject, f"{group[0]}/object", f"{part}{metric}")) for part in ("", "rank_", "first_")]


def benchmark_campaign(entry: Entry, *, show_progress: bool | None = False) -> Benchmarked:
    """Every row of one campaign; what stops it becomes its one row, SKIPPED or ERROR."""
    job = entry.job
    if job.waits is not None:
        return _stopped(entry, Outcome.SKIPPED, job.waits[0])
    try:
        load_extensions(entry.extensions)
        with _score_maps(entry):
            return _run(entry, job, show_progress)
    except MissingDataError as error:
        return _stopped(entry, Outcome.SKIPPED, str(error))
    except Exception as error:  # one broken campaign must not hide what the others say
        words = str(error) if isinstance(error, HypervalError) else internal_error(error)
        return _stopped(entry, Outcome.ERROR, words, getattr(error, "exit_code", INTERNAL_ERROR))


@contextmanager
def _score_maps(entry: Entry) -> Iterator[None]:
    """Score maps that were made elsewhere are detectors of this campaign."""

    def made(file: str, target: Any, mean: Any, covariance: Any, undesired: Any) -> PixelDetector:
        path = Path(file.replace("{campaign}", entry.job.campaign.name))

        def image(values: Any, scene: Any) -> Any:
            raster = raster_of_size(path, values.shape[:2])
            return raster.read_some_bands(0, raster.lines, [0])[0].astype(float)

        return PixelDetector(np.zeros((1, mean.size)), np.zeros(1), image=image)

    before = dict(detect.ADDED_DETECTORS)
    try:
        for name, file in entry.scores.items():
            register_detector(name, partial(made, file))
        yield
    finally:
        detect.ADDED_DETECTORS.clear()
        detect.ADDED_DETECTORS.update(before)


def _run(entry: Entry, job: Job, show_progress: bool | None) -> Benchmarked:
    """With every detector; one that this collection cannot take does not take the others with it."""
    own, refused = job.campaign.detection, dict[str, str]()
    while True:
        try:
            return _with(entry, job, refused, show_progress)
        except AddedDetectorError as error:
            refused[error.detector] = str(error)
        except UsageError as error:
            # A target among the undesired, a singular background: the campaign's own detectors are known to run.
            others = set(detector_names()) - set(own.detectors if own else ()) - {*refused}
            if own is None or isinstance(error, MissingDataError) or not others:
                raise
            refused |= dict.fromkeys(others, f"not run, as one of the detectors was refused: {error}")


def _with(entry: Entry, job: Job, refused: Mapping[str, str], show_progress: bool | None) -> Benchmarked:
    """The rows with every detector that was not ``refused``."""
    name, chosen = job.campaign.name, Question(job.campaign, {})

    def ask(scenarios: Sequence[Scenario], inputs: InputLog) -> Campaign:
        nonlocal chosen
        regions: list[str] = []
        if job.campaign.detection is not None and not job.campaign.detection.undesired:
            place = open_place(job.campaign.collection, inputs.resolve, show_progress=show_progress)
            regions = classes_with_regions(scenarios, place.regions)
        chosen = with_every_detector(job.campaign, regions, refused)
        return chosen.campaign

    with step(name, 1, 1, "benchmark"), collected(job, question=ask, show_progress=show_progress) as collection:
        rows = detector_rows(collection.observed, chosen, seed=entry.seed, show_progress=show_progress)
        rows += peer_rows(collection.observed, chosen.campaign.detection)
        if chosen.campaign.detection is not None:
            origins = ((scenario, collection.origins(scenario, show_progress)) for scenario in collection.scenarios)
            rows += predicted_rows(predict(*one) for one in origins)
        record = record_of(
            collection.inputs,
            collection.scenarios,
            collection.seed,
            {"campaign": chosen.campaign},
            [collection.observed.observation],
        )
        notes = list(dict.fromkeys([*chosen.notes, *_halo(chosen), *collection.observed.observation.notes]))
    return Benchmarked(name, job.campaign.title, bool(job.campaign.simulated), of_campaign(rows, name), notes, record)


def _halo(question: Question) -> list[str]:
    if question.campaign.detection is None or not question.campaign.detection.halo_pixels:
        return []
    return ["ranks count the pixels of an object alone; the values by subject count the campaign's halo too"]


def _stopped(entry: Entry, outcome: Outcome, reason: str, code: int | None = None) -> Benchmarked:
    campaign = entry.job.campaign
    log = InputLog.of_file(entry.job.path)
    cause = Cause.NO_DATA if outcome is Outcome.SKIPPED else Cause.BROKEN
    row = Result(campaign.name, PRODUCT, EVERY_OBJECT, "all", "benchmark", outcome=outcome, cause=cause, reason=reason)
    record = record_of(log, [], None, {"campaign": campaign}, [])
    return Benchmarked(campaign.name, campaign.title, bool(campaign.simulated), [row], [], record, code)


def benchmark(
    paths: Sequence[Path],
    output: Path,
    *,
    extensions: Sequence[Path] = (),
    scores: Mapping[str, str] = MappingProxyType({}),
    seed: int = 0,
    scheduler: str | None = None,
    show_progress: bool | None = None,
) -> int:
    """Run every campaign with all detectors, and write one table and its page.

    Parameters
    ----------
    extensions : Python files that register detectors
    scores : name of a detector -> file of its score map, made elsewhere; {campaign} in it is the campaign's name
    seed : of the resampling
    scheduler : address of what runs the campaigns; default: one process for each processor (HYPERVAL_WORKERS)

    Returns
    -------
    The exit code of the first campaign that ended in an error, else 0: a benchmark judges nothing.

    Raises
    ------
    UsageError, InputError : campaign files or extensions that are not right; nothing is written.
    """
    load_extensions(extensions)
    programs = tuple(Path(p).resolve() for p in extensions)
    entries = [Entry(job, seed, programs, dict(scores)) for job in jobs_of(*paths)]
    with whole_folder(output) as folder:
        done = _done(entries, scheduler, show_progress)
        _write(done, extensions, seed, folder)
    return next((d.exit_code for d in done if d.exit_code is not None), 0)


def _done(entries: Sequence[Entry], scheduler: str | None, show_progress: bool | None) -> list[Benchmarked]:
    count = worker_count(len(entries))
    if scheduler is None and count == 1:
        return [benchmark_campaign(entry, show_progress=show_progress) for entry in entries]
    with workers(count, scheduler) as where:
        results = in_order(where, partial(benchmark_campaign, show_progress=False), entries, ahead=len(entries))
        return list(track(results, "campaigns", len(entries), show=show_progress))


def _write(done: Sequence[Benchmarked], extensions: Sequence[Path], seed: int, folder: Path) -> None:
    from hyperval.figures.print import drawings_of

    record: dict[str, Any] = {
        "command": command_without_output(),
        "seed": seed,
        "extensions": {Path(p).name: sha256_of(Path(p)) for p in extensions},
        "campaigns": {d.name: d.provenance for d in done},
    }
    figures, simulated = benchmark_figures(done), {d.name for d in done if d.simulated}
    drawings = [one for figure in figures for one in drawings_of([figure], simulated=figure.section in simulated)]
    files = {one.file_name: one.content for one in drawings}
    Run(ResultTable(row for d in done for row in d.rows), record).write(folder, benchmark_page(done, figures), files)


_MOST_SUBJECTS = 30
_RANK_METRICS = ("log_auc@1e-3..1e-1", "auc")


def detector_figure(one: Benchmarked) -> Figure | None:
    """A view for each metric on all objects: value, interval, rank with its set."""
    detectors, captions = row_names([" = ".join(g) for g in one.groups]), []
    views = []
    for metric in one.measures:
        standings = [one.standing(g, metric) for g in one.groups]
        known = [(i, row, rank) for i, (row, rank, _) in enumerate(standings) if row is not None and rank is not None]
        # Densities of false alarms are drawn on a logarithmic axis, where none stands at its left end.
        far = metric.startswith("far")
        positive = [v for _, row, _ in known for v in (row.value, row.upper) if math.isfinite(v) and v > 0]
        floor = 0.5 * min(positive, default=1.0) if far else -math.inf
        marks, notes = [], [""] * len(one.groups)
        for first in (True, False):
            own = [(i, row, rank) for i, row, rank in known if (rank.lower <= 1) == first]
            values = np.array([(row.value, row.lower, row.upper, i) for i, row, _ in own], float).reshape(-1, 4).T
            columns = dict(zip(("x", "low", "high"), np.maximum(values[:3], floor), strict=True)) | {"y": values[3]}
            label = "may be first" if first else "is not first"
            marks.append(measured_mark("dots", columns, label, marker="circle", hollow=not first, along="x"))
            for i, row, rank in own:
                notes[i] = _rank_text(rank)
                captions.append(f"{'/'.join(one.groups[i])} {metric} {row.value:.3g}, rank {notes[i]}")
        none = " (none: at the left end)" if far and any(row.value == 0.0 for _, row, _ in known) else ""
        part = Part(replace(detectors, notes=tuple(notes)), tuple(marks))
        views.append(Panels(Axis("value", "log" if far else "linear"), (part,), _TITLES[metric] + none))
    if not views:
        return None
    title = f"{one.name}: detectors on all objects with 95 % intervals; rank [95 % set]"
    alt = f"Metrics of each detector on all objects of {one.name}. {'; '.join(captions)}."
    return Figure(f"{one.name}-detectors", one.name, title, alt, tuple(views))


def rank_figure(one: Benchmarked) -> Figure | None:
    """Ranks by subject, as a map: dark where the detector leads, with the set of ranks that are not refuted."""
    ranked = {metric for _, _, metric in one.here}
    metric = next((m for m in _RANK_METRICS if f"rank_{m}" in ranked), "")
    every = list(dict.fromkeys(subject for subject, _, name in one.here if name == f"rank_{metric}"))
    subjects = every[:_MOST_SUBJECTS]
    # Where all objects are one subject, the map would say it twice.
    if not metric or len({*subjects, EVERY_OBJECT}) < 3 or not one.groups:
        return None
    more = "" if len(subjects) == len(every) else f"; {len(subjects)} of {len(every)} subjects"
    title = f"{one.name}: rank [95 % set] by {_TITLES[metric]}, subjects of two objects and more{more}"
    ranks = {(s, g): one.standing(g, metric, s)[1] for s in subjects for g in one.groups}
    return _rank_map(f"{one.name}-ranks", one.name, title, subjects, one.groups, ranks)


def _rank_text(rank: Result) -> str:
    return f"{rank.value:.0f} [{rank.lower:.0f}-{rank.upper:.0f}]"


def _rank_map(
    name: str, section: str, title: str, rows: Sequence[str], groups: Sequence[tuple[str, ...]],
    ranks: Mapping[tuple[str, tuple[str, ...]], Result | None],
) -> Figure:  # fmt: skip
    """A cell for each row and group of detectors that order alike: dark where it leads."""
    cells, words, captions = [], [], []
    for i, subject in enumerate(rows):
        for j, names in enumerate(groups):
            if (row := ranks[subject, names]) is not None:
                cells.append((j - 0.5, j + 0.5, i - 0.5, i + 0.5, row.value))
                words.append(_rank_text(row))
                captions.append(f"{subject}, {'/'.join(names)}: {words[-1]}")
    columns = dict(zip(("left", "right", "bottom", "top", "value"), np.array(cells, float).T, strict=True))
    scale = ColourScale("falling", 1.0, max(float(columns["value"].max()), 2.0))
    mark = Mark("cells", columns, words=tuple(words), beside="centre", scale=scale)
    return Figure(
        name, section, title, f"{title}. {'; '.join(captions)}.",
        (Panels(row_names([" = ".join(g) for g in groups]), (Part(row_names(rows), (mark,)),)),),
        head=title.partition(",")[0], width_in=2.6 + 1.35 * len(groups),
    )  # fmt: skip


def overview_figure(done: Sequence[Benchmarked]) -> Figure | None:
    """Rank of every detector on all objects of every collection, as a map; one collection needs none."""
    metric = _RANK_METRICS[1]
    known = [one for one in done if metric in one.measures]
    every = dict.fromkeys(name for one in known for group in one.groups for name in group)
    names: list[tuple[str, ...]] = [(name,) for name in every]
    if len(known) < 2:
        return None
    title = f"Rank [95 % set] by {_TITLES[metric]} on all objects of each collection"
    ranks = {(one.name, own): one.standing(own, metric)[1] for one in known for own in names}
    return _rank_map("overview", "benchmark", title, [one.name for one in known], names, ranks)


def predicted_figure(one: Benchmarked) -> Figure | None:
    """Measured over predicted area and P_D, a point for each subject and detector, a view for each metric."""
    views, captions = [], []
    for metric, title in _TITLES.items():
        pairs = [(key, one.here[*key[:2], metric], row) for key, row in one.here.items()
                 if key[2] == f"predicted_{metric}" and (*key[:2], metric) in one.here]  # fmt: skip
        if not pairs or metric.startswith("far"):
            continue
        y, low, high, x = np.array([(m.value, m.lower, m.upper, p.value) for _, m, p in pairs], float).T
        said = tuple(
            f"{s}, {method}: measured {m.value:.2f}, predicted {p.value:.2f}" for (s, method, _), m, p in pairs
        )
        diagonal = Mark("line", {"x": np.array([0.0, 1.0]), "y": np.array([0.0, 1.0])}, "as predicted", dash="dotted")
        dots = measured_mark("dots", {"x": x, "y": y, "low": low, "high": high}, marker="circle", words=said)
        part = Part(Axis("measured", ends=(-0.02, 1.02)), (diagonal, dots))
        views.append(Panels(Axis("predicted", ends=(-0.02, 1.02)), (part,), title))
        captions.append(f"{title}: {'; '.join(said)}")
    if not views:
        return None
    title = f"{one.name}: measured against predicted, a point for each subject and detector, with 95 % intervals"
    return Figure(f"{one.name}-predicted", one.name, title, f"{title}. {' '.join(captions)}.", tuple(views))


def benchmark_figures(done: Sequence[Benchmarked]) -> list[Figure]:
    """The figures of the page."""
    made = [make(one) for one in done for make in (detector_figure, rank_figure, predicted_figure)]
    return [figure for figure in (*made, overview_figure(done)) if figure is not None]


def benchmark_page(done: Sequence[Benchmarked], figures: Sequence[Figure]) -> str:
    """The page."""
    skipped = [r for d in done for r in d.rows if r.outcome in (Outcome.SKIPPED, Outcome.ERROR)]
    entries = [
        {
            "words": one, "leads": leads(one), "measures": [_TITLES[m] for m in one.measures],
            "detectors": [{"name": " = ".join(g), "cells": [_cell(*one.standing(g, m)) for m in one.measures]}
                          for g in one.groups],
            "figures": [figure for figure in figures if figure.section == one.name],
        }
        for one in done if one.here  # the others are named under what was not run
    ]  # fmt: skip
    count = sum(len(d.rows) for d in done)
    over = [one for one in figures if one.section == "benchmark"]
    return page("benchmark.html.j2", figures, over=over, entries=entries, skipped=skipped, count=count, all=len(done))


def leads(one: Benchmarked) -> list[str]:
    """Who is first by each metric on all objects, and who cannot be told from the first."""
    out = []
    for metric, title in _TITLES.items():
        ranks = {" = ".join(g): rank for g in one.groups if (rank := one.standing(g, metric)[1]) is not None}
        first = [name for name, rank in ranks.items() if rank.value == 1]
        near = [name for name, rank in ranks.items() if rank.value > 1 and rank.lower <= 1]
        words = f"; not distinguished from it: {', '.join(near)}" if near else "; all others differ significantly"
        if ranks:
            out.append(f"{title}: {' and '.join(first)}{words if len(one.groups) > len(first) else ''}")
    return out


def _cell(value: Result | None, rank: Result | None, first: Result | None) -> dict[str, str]:
    """A metric of a detector on all objects, in words."""
    numbers = ["–", "", ""]
    if value is not None and math.isfinite(value.value):
        spread = (value.upper - value.lower) / 2  # two digits of it are all that value and ends are worth
        numbers = [number_text(number, spread) for number in (value.value, value.lower, value.upper)]
    return {
        "value": numbers[0], "interval": " to ".join(filter(None, numbers[1:])),
        "rank": _rank_text(rank) if rank else "–", "first": f"{100 * first.value:.0f} %" if first else "–",
    }  # fmt: skip
