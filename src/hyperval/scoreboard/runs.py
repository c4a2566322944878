"""The benchmark: all detectors on each campaign, ranks with their sets, score maps, and the page.

All detectors see the same pixels, so blocks of the background and objects are resampled for all of them at once.
Peers are matched filter, ACE and RX of SPy on the same pixels, bands, spectra and background; a user's own detectors
come from Python files that register them.
"""

from __future__ import annotations

import math
import re
import runpy
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import compress, product
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
import spectral
from scipy import special, stats

from hyperval.campaign import Campaign, Job, command_without_output, load_jobs, observe_campaign, record_of
from hyperval.collection import Detection
from hyperval.compare import EVERY_OBJECT, named, product_rows, row, skip_rows
from hyperval.data import Array, Counts, Index
from hyperval.datasets import InputLog
from hyperval.errors import HypervalError, MissingDataError, UsageError, refusal, refuse, words_and_code
from hyperval.executors import in_order, worker_count, workers
from hyperval.figures import Axis, ColourScale, Figure, Mark, Panels, Part
from hyperval.figures.spec import compose, figure_of_views, measured_mark, single_panel, to_columns
from hyperval.imagery import ImageGrid, TargetObject, raster_of_size
from hyperval.model import AREAS, clopper_pearson, predict
from hyperval.observe import Observed, Place, map_name, open_place, scored_part, target_groups
from hyperval.pixels import LEAST_EXPECTED_ALARMS, AlarmBlocks, area_interval, detect, object_scores
from hyperval.products import Products
from hyperval.progress import step, track
from hyperval.report.html import page
from hyperval.report.verdict import number_text
from hyperval.results import Cause, Outcome, Result, ResultTable, of_campaign
from hyperval.run import Run
from hyperval.scenario import Scenario
from hyperval.settings import with_settings
from hyperval.storage import sha256_of, whole_folder


@dataclass(frozen=True)
class BlockCounts:
    """Background pixels above and level with each object's score, block by block.

    P looks (an object through the filter of one target spectrum), D detectors, K blocks.

    Attributes
    ----------
    detectors : names, in the order of the second dimension
    over, tie : (P, D, K) background pixels above the object's score, and equal to it
    pixels : (K,) background pixels of each block
    item : (P,) number of the object on the ground that is looked at
    group : name -> looks of a subject or of a pool
    density_km2 : background pixels on a square kilometre; NaN when the ground area is not known
    lost : of each detector that has no score for something that others have, what it is: in words
    """

    detectors: tuple[str, ...]
    over: Counts
    tie: Counts
    pixels: Counts
    item: Index
    group: Mapping[str, Sequence[int]]
    density_km2: float = float("nan")
    lost: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        """Background pixels."""
        return int(self.pixels.sum())

    @property
    def orders(self) -> list[int]:
        """(D,) number of the order in which each detector puts the pixels; those that order alike share it.

        Told by the counts of every look: two detectors that agree in all blocks about all objects.
        """
        number: dict[bytes, int] = {}
        columns = [self.over[:, d].tobytes() + self.tie[:, d].tobytes() for d in range(len(self.detectors))]
        return [number.setdefault(column, len(number)) for column in columns]

    def shares(self, weights: Array) -> tuple[Array, Array]:
        """Share of the background above each look's score and level with it, each (P, D, R).

        Parameters
        ----------
        weights : (K, R) how often each block is drawn
        """
        total = self.pixels @ weights
        return self.over @ weights / total, self.tie @ weights / total


def counts_by_block(scores: Array, background: AlarmBlocks) -> tuple[Counts, Counts]:
    """(P, K) background scores above, and equal to, each of the scores (P,), in each block."""
    falling, place = np.unique(-scores, return_inverse=True)
    above, reached = (background.counts_above(x) for x in (-falling, np.nextafter(-falling, -np.inf)))
    return above[place], (reached - above)[place]


LOG_AREA = "log_auc@1e-3..1e-1"
PD_OF_FAR = 0.5


@dataclass(frozen=True)
class BenchmarkMetric:
    """One metric.

    Attributes
    ----------
    name, title : in the table, and on the page
    of_look : the part each look has in the metric, from (over, tie); the metric is their mean.  None: the quantile
        of false alarms at P_D = 0.5, of which less is better
    least_pfa : P_FA at which the background must expect some alarms; infinity: any
    """

    name: str
    title: str
    of_look: Callable[[Array, Array], Array] | None
    least_pfa: float = math.inf


def is_detected(pfa: float) -> Callable[[Array, Array], Array]:
    """1 where the object lies above the threshold that lets at most ``pfa`` of the background through."""
    return lambda over, tie: np.asarray(over + tie <= pfa * (1.0 + 1e-9), dtype=float)


MEASURES: Mapping[str, BenchmarkMetric] = {
    m.name: m
    for m in (
        BenchmarkMetric("auc", "AUC", AREAS["auc"].averaged),
        BenchmarkMetric(LOG_AREA, "log-weighted AUC, P_FA 1e-3 to 1e-1", AREAS[LOG_AREA].averaged, 1e-3),
        BenchmarkMetric("pd@1e-2", "P_D at P_FA 1e-2", is_detected(1e-2), 1e-2),
        BenchmarkMetric("pd@1e-3", "P_D at P_FA 1e-3", is_detected(1e-3), 1e-3),
        BenchmarkMetric("far@pd0.5", "false alarms per km2 at P_D 0.5", None),
    )
}


def pfa_at_detection(over: Array, tie: Array, weight: Array) -> Array:
    """(D, R) P_FA at the highest threshold that finds half of the looks.

    Parameters
    ----------
    over, tie : (P, D, R) shares of the background
    weight : (P, R) how often each look is drawn

    Examples
    --------
    >>> over = np.array([[[0.1]], [[0.01]], [[0.2]]])  # share of the background above each of three objects
    >>> pfa_at_detection(over, np.zeros((3, 1, 1)), np.ones((3, 1))).item()
    0.1
    """
    s = over + tie
    order = np.argsort(s, axis=0, kind="stable")
    drawn = np.take_along_axis(np.broadcast_to(weight[:, None, :], s.shape), order, axis=0).cumsum(axis=0)
    reached = np.argmax(drawn >= PD_OF_FAR * drawn[-1] * (1.0 - 1e-9), axis=0)
    return np.asarray(np.take_along_axis(np.take_along_axis(s, order, axis=0), reached[None], axis=0)[0])


def draw_metric(measure: BenchmarkMetric, over: Array, tie: Array, weight: Array) -> Array:
    """(D, R) the metric in draws of looks and background; of false alarms the P_FA, not yet per km2."""
    if measure.of_look is None:
        return pfa_at_detection(over, tie, weight)
    return np.asarray(np.einsum("pdr,pr->dr", measure.of_look(over, tie), weight) / weight.sum(axis=0))


def goodness(measure: BenchmarkMetric, values: Array, n: int) -> Array:
    """The metric so that more is better; of P_FA minus its logarithm, no less than half a pixel of ``n``."""
    if measure.of_look is not None:
        return values
    return np.asarray(-np.log10(np.maximum(values, 0.5 / n)))


LEVEL = 0.95
_CHUNK_VALUES = 4_000_000  # of the largest array of a pass over draws


@dataclass(frozen=True)
class RankedDetectors:
    """Detectors on one group of objects by one metric; arrays are (D,).

    Attributes
    ----------
    value, lower, upper : the metric and its 95 % interval
    rank : 1 for the best; equals share the best of their ranks, detectors that order alike count as one
    rank_lower, rank_upper : 95 % confidence set of the rank
    first : share of draws in which the detector is the best, equals counted alike
    objects : objects on the ground
    distinct : detectors that do not order the pixels alike
    orders : whether so few objects can order detectors at all
    """

    value: Array
    lower: Array
    upper: Array
    rank: Counts
    rank_lower: Counts
    rank_upper: Counts
    first: Array
    objects: int
    distinct: int
    orders: bool


def fewest_objects(detectors: int) -> int:
    """Objects from which on two of so many detectors can be told apart at all.

    Where one finds every object better than another, the exact sign test of m objects has the p-value 2^(1 - m); it
    must reach 5 % divided by the number of rivals (Bonferroni).
    """
    return int(np.ceil(1.0 - np.log2((1.0 - LEVEL) / max(detectors - 1, 1))))


def rank_sets(values: Array, draws: Array, objects: int) -> tuple[Counts, Counts]:
    """Least and greatest rank (D,) of each detector that the draws do not refute, at 95 % for each.

    A detector has as many above it as are better than it by more than c standard deviations of the paired
    difference, and likewise below; c is the 95 % point of the greatest of these ratios over its rivals in the draws
    about their mean, widened as Student's t of ``objects`` - 1 is wider than the normal law.
    Source: Mogstad, Romano, Shaikh & Wilhelm, Rev. Econ. Stud. 91, 476-518, 2024 (marginal confidence sets).

    Parameters
    ----------
    values : (D,) goodness, more is better
    draws : (D, R) the same in paired resamples

    Examples
    --------
    >>> first, last = rank_sets(np.array([0.9, 0.5]), np.array([[0.9, 0.8, 0.95], [0.5, 0.4, 0.6]]), 20)
    >>> first, last
    (array([1, 2]), array([1, 2]))
    """
    count = values.size
    low, high = np.ones(count, np.int64), np.full(count, count, np.int64)
    if objects < 2:
        return low, high
    tail = 0.5 + LEVEL / 2.0
    wider = float(stats.t.ppf(tail, objects - 1) / special.ndtri(tail) * np.sqrt(objects / (objects - 1)))
    gap, drawn = values - values[:, None], draws - draws[:, None]  # of each rival (second) from each detector
    sd = drawn.std(axis=2, ddof=1)
    moving = sd > 1e-12
    ratio = np.abs(drawn - drawn.mean(axis=2, keepdims=True)) / np.where(moving, sd, np.inf)[..., None]
    c = np.quantile(ratio.max(axis=1), LEVEL, axis=1) * wider
    # Alike in all draws and yet apart: decided by the number of objects alone, which the caller has asked.
    limit = np.where(moving, c[:, None] * sd, 1e-9)
    return low + np.sum(gap > limit, axis=1), high - np.sum(-gap > limit, axis=1)


def rank_detectors(
    counts: BlockCounts, looks: list[int], measure: BenchmarkMetric, *, draws: int, rng: np.random.Generator
) -> RankedDetectors:
    """Detectors on the objects of some looks: objects and blocks of the background drawn anew, for all at once.

    Detectors that order all pixels alike count as one, and share rank and set.

    Examples
    --------
    >>> over = np.tile(np.array([[[0], [30]]]), (9, 1, 1))  # 9 objects, 2 detectors, 1 block of background
    >>> counts = BlockCounts(("a", "b"), over, 0 * over, np.array([100]), np.arange(9), {})
    >>> r = rank_detectors(counts, list(range(9)), MEASURES["auc"], draws=50, rng=np.random.default_rng(0))
    >>> r.rank, r.first
    (array([1, 2]), array([1., 0.]))
    """
    order = np.array(counts.orders)
    one_of = np.unique(order, return_index=True)[1]
    item = np.unique(counts.item[looks], return_inverse=True)[1]
    m, n = int(item.max()) + 1, counts.n
    cells, names = np.ix_(np.array(looks), one_of), tuple(counts.detectors[d] for d in one_of)
    part = replace(counts, detectors=names, over=counts.over[cells], tie=counts.tie[cells], item=item)
    shares = part.shares(np.ones((part.pixels.size, 1)))
    value = draw_metric(measure, *shares, np.ones((len(looks), 1)))[:, 0]
    both, exchanged = _resample(part, measure, m, draws, rng)
    best, drawn = goodness(measure, value, n), goodness(measure, both, n)
    enough = m >= fewest_objects(value.size)
    low, high = rank_sets(best, drawn, m) if enough else (np.ones(value.size, int), np.full(value.size, value.size))
    if measure.of_look is None:  # percentiles of the draws, and above no alarm at all the exact limit
        lower, upper = np.quantile(both, [0.025, 0.975], axis=1)
        upper = np.maximum(upper, clopper_pearson(0, n, 0.9)[1])
    else:
        lower, upper = _limits(item, measure.of_look(*shares)[:, :, 0], exchanged, n)
    rank = np.array([1 + np.sum(best > x + 1e-12) for x in best], dtype=np.int64)
    first = np.mean(drawn >= drawn.max(axis=0) - 1e-12, axis=1)
    return RankedDetectors(
        value[order], np.minimum(lower, value)[order], np.maximum(upper, value)[order], rank[order],
        np.minimum(low, rank)[order], np.maximum(high, rank)[order], first[order], m, value.size, enough,
    )  # fmt: skip


def _resample(part: BlockCounts, measure: BenchmarkMetric, objects: int, draws: int, rng: np.random.Generator) -> Array:
    """(2, D, R) the metric with objects and blocks drawn anew, and with blocks alone."""
    blocks, looks = part.pixels.size, part.item.size
    step = max(1, _CHUNK_VALUES // (looks * len(part.detectors)))
    drawn: list[tuple[Array, Array]] = []
    for first in range(0, draws, step):
        size = min(step, draws - first)
        weights = rng.multinomial(blocks, np.full(blocks, 1.0 / blocks), size=size).T.astype(float)
        taken = rng.multinomial(objects, np.full(objects, 1.0 / objects), size=size).T[part.item].astype(float)
        shares = part.shares(weights)
        drawn.append((draw_metric(measure, *shares, taken), draw_metric(measure, *shares, np.ones_like(taken))))
    return np.concatenate(drawn, axis=2)


def _limits(item: Index, parts: Array, still: Array, n: int) -> Array:
    """(2, D) 95 % interval of each detector's mean of parts (P, D) between 0 and 1, of objects ``item`` (P,).

    The logit interval with both variances, no narrower than what is known of a bounded mean.
    """
    limits = []
    for part, moved in zip(parts.T, still, strict=True):
        of_object = np.bincount(item, part) / np.bincount(item)
        spread = float(of_object.var(ddof=1)) / of_object.size if of_object.size > 1 else 0.25
        limits.append(area_interval(of_object, spread, float(moved.var(ddof=1)), n))
    return np.array(limits).T


PRODUCT = "benchmark"
DRAWS = 1000


def with_every_detector(
    campaign: Campaign, regions: Sequence[str], refused: Mapping[str, str]
) -> tuple[Campaign, Mapping[str, str], Sequence[str]]:
    """The campaign with all detectors that the code knows, and without what the benchmark does not look at.

    Parameters
    ----------
    regions : names that the collection has; those that are classes of a scenario are projected away by osp, where
        the campaign names none itself
    refused : detector -> why it cannot run, as was found out

    Returns
    -------
    The campaign; detector -> why it cannot run here; what was chosen for the campaign.
    """
    bare = campaign.model_copy(update={"classification": None, "attribution": None})
    detection = campaign.detection
    if detection is None:
        return bare, {}, ()
    undesired, left_out = list(detection.undesired or regions), dict[str, str]()
    if detection.local_window is not None:
        why = "the campaign takes background means from a local window, which this detector does not have"
        left_out = {name: why for name in detect.detector_names() if name not in detect.LOCAL_DETECTORS}
    if not undesired:
        left_out.setdefault("osp", "no region of the collection is a class of the scenario: nothing to project away")
    left_out |= refused
    run = [name for name in detect.detector_names() if name not in left_out]
    is_chosen = "osp" in run and not detection.undesired
    notes = (f"osp projects away the mean spectra of {', '.join(undesired)}",) if is_chosen else ()
    changes = {"detectors": run, "undesired": undesired if "osp" in run else [], "areas": [], "unmixing": None}
    return bare.model_copy(update={"detection": with_settings(detection, changes)}), left_out, notes


def _subjects(place: Place, detection: Detection) -> Iterator[tuple[str, dict[str, list[TargetObject]]]]:
    """Each target with the pixels of its objects that are scored: subject -> objects."""
    for target in detection.targets:
        groups = target_groups(place.targets, target, detection.group)
        yield target.name, {s: [scored_part(o, place) for o in objects] for s, objects in groups.items()}


def block_counts(place: Place, maps: Mapping[str, Array], detection: Detection) -> BlockCounts:
    """Background pixels above every object's greatest score, by detector and block of the image.

    A halo that the campaign gives its objects is left out: pixels of the object alone count, and of the background
    single pixels.

    Parameters
    ----------
    maps : score maps (lines, samples) by their names

    >>> from types import SimpleNamespace
    >>> at, red = np.arange(9).reshape(3, 3), {"name": "red", "material": "red", "spectrum": {"file": "red.csv"}}
    >>> corners, mask = {"a": (0, 0), "b": (2, 1)}, np.ones((1, 1), bool)
    >>> both = [TargetObject(n, "red", 1.0, 1.0, (3, 3), x, mask, None, {"name": n}) for n, x in corners.items()]
    >>> place = SimpleNamespace(targets=both, target_pixels="touched", pixel_area_m2=1.0, pixels_of=lambda *_: at > 0)
    >>> maps = {"red-cem": np.where(at < 5, 1.0, np.nan), "red-ace": np.where(at == 4, np.nan, 1.0)}
    >>> maps |= {name: np.where(at == 8, np.nan, scores) for name, scores in maps.items()}  # no data
    >>> for words in block_counts(place, maps, Detection(detectors=["cem", "ace"], targets=[red])).lost:
    ...     print(words.partition(" of the")[0])
    cem has no score for 1 objects and 3 pixels
    ace has no score for 0 objects and 1 pixels
    """
    names = tuple(detection.detectors)
    used = {t.name: [maps[map_name(t.name, detector)] for detector in names] for t in detection.targets}
    finite = np.array([[np.isfinite(one) for one in scores] for scores in used.values()])  # (targets, detectors, ...)
    pixels = place.pixels_of(*detection.false_alarms)
    counted = pixels & finite.all(axis=(0, 1))
    # What others have scores of, objects and pixels of the background: where none has the image holds no data.
    missing = np.zeros((2, len(names)), int)
    missing[1] = np.count_nonzero(pixels & finite.any(axis=(0, 1)) & ~finite.all(axis=0), axis=(1, 2))
    counts, item, number, group = list[Counts](), list[int](), dict[str, int](), dict[str, list[int]]()
    for target, subjects in _subjects(place, detection):
        objects = {o.name: o for members in subjects.values() for o in members}
        greatest = np.array([list(object_scores(one, objects.values()).values()) for one in used[target]])
        found = np.isfinite(greatest)
        valid = found.all(axis=0)
        missing[0] += (found.any(axis=0) & ~found).sum(axis=1)
        index = {name: len(item) + i for i, name in enumerate(compress(objects, valid))}
        blocks = [AlarmBlocks.from_map(one, counted) for one in used[target]]
        pairs = [counts_by_block(scores[valid], each) for scores, each in zip(greatest, blocks, strict=True)]
        counts.append(np.array(pairs).transpose(1, 2, 0, 3))
        item += [number.setdefault(name, len(number)) for name in index]
        group |= {subject: [index[o.name] for o in members if o.name in index] for subject, members in subjects.items()}
    group |= {pool.name: [i for s in pool.subjects for i in group.get(s, [])] for pool in detection.pools}
    group[EVERY_OBJECT] = list(range(len(item)))
    density = math.nan if place.pixel_area_m2 is None else 1e6 / place.pixel_area_m2
    over, tie = np.concatenate(counts, axis=1)
    lost = tuple(
        f"{name} has no score for {m} objects and {n} pixels of the background: no detector is ranked by them"
        for name, m, n in zip(names, *missing.tolist(), strict=True)
        if m or n
    )
    return BlockCounts(names, over, tie, blocks[0].block_sizes, np.array(item, dtype=np.intp), group, density, lost)


def detector_rows(
    observed: Observed, detection: Detection | None, left_out: Mapping[str, str], *, seed: int
) -> tuple[list[Result], tuple[str, ...]]:
    """Rows of every detector: metrics by subject, the same of all objects, ranks, and what could not run; and notes."""
    place = observed.place
    if detection is None or place is None or observed.detected is None:
        why = "the campaign looks for no targets"
        return list(named(skip_rows(Cause.NO_OBSERVATION, why, "rank"), PRODUCT, EVERY_OBJECT, "detectors")), ()
    maps = observed.detected.score_maps
    rows = list(side_rows(observed.observation, "measured"))
    counts = block_counts(place, maps, detection)
    for name, columns in track(counts.group.items(), "ranks", len(counts.group)):
        if len(set(counts.item[list(columns)])) < 2:
            continue  # no object orders detectors, and one by chance alone
        for measure in MEASURES.values():
            if counts.n * measure.least_pfa >= LEAST_EXPECTED_ALARMS:
                ranks = rank_detectors(counts, list(columns), measure, draws=DRAWS, rng=np.random.default_rng(seed))
                rows += rank_rows(name, counts, measure, ranks)
    for name, reason in left_out.items():
        rows += named(skip_rows(Cause.REFUSED, reason, "rank"), PRODUCT, EVERY_OBJECT, f"{name}/object")
    return rows, tuple(f"warning: {what}" for what in counts.lost)


def side_rows(side: Products, side_word: Literal["measured", "predicted"]) -> Iterator[Result]:
    """The metrics by subject, pool and detector as one side's own rows have them: ``METRIC``, ``predicted_METRIC``."""
    pixels = {(s, f"{d}/{u}"): c.n_background for (s, d, u), c in side.roc.items()}
    names = {re.sub("auc|far", rf"\g<0>_{side_word}", name): measure for name, measure in MEASURES.items()}
    for one in product_rows(side, "observed" if side_word == "measured" else side_word):
        measure = names.get(one.metric) if one.product == "roc" else None
        n = pixels.get((one.subject, one.method))
        if measure is not None and (n is None or n * measure.least_pfa >= LEAST_EXPECTED_ALARMS):
            metric = measure.name if side_word == "measured" else f"predicted_{measure.name}"
            yield replace(one, product=PRODUCT, metric=metric, evidence=None)


def rank_rows(group: str, counts: BlockCounts, measure: BenchmarkMetric, ranks: RankedDetectors) -> list[Result]:
    """``METRIC`` (of all objects together), ``rank_METRIC`` and ``first_METRIC`` of each detector on one group."""
    m, rows, name = ranks.objects, list[Result](), measure.name
    words = f"paired: {DRAWS} draws of {m} objects and of blocks of the background, the same for all detectors"
    words = "; ".join([words, *counts.lost])
    if not ranks.orders:
        words += f"; {m} objects cannot order {ranks.distinct} detectors, {fewest_objects(ranks.distinct)} could"
    first = "share of the draws in which it is the best, equals counted alike"
    why = "every target at the same P_FA through its own filter; objects and blocks of the background sampled"
    scale, unit = (counts.density_km2, "km-2") if measure.of_look is None else (1.0, "1")
    if group == EVERY_OBJECT and math.isnan(scale):
        unknown = skip_rows(Cause.NO_GROUND_AREA, "the ground area of the background is not known", name)
        rows += named(unknown, PRODUCT, group, "detectors")
    for d, detector in enumerate(counts.detectors):
        value, *ends = (float(each[d]) * scale for each in (ranks.value, ranks.lower, ranks.upper))
        lines = [row(name, value, ends, unit=unit, n=m, reason=why)] if group == EVERY_OBJECT and value == value else []
        rank = row(f"rank_{name}", ranks.rank[d], (ranks.rank_lower[d], ranks.rank_upper[d]), n=m, reason=words)
        lines += [rank, row(f"first_{name}", ranks.first[d], n=m, reason=first)]
        rows += named(lines, PRODUCT, group, f"{detector}/object")
    return rows


PEER = "spy"


# By the name of our own detector.
PEERS: dict[str, Callable[[Array, Array, Any], Any]] = {
    "matched-filter": spectral.matched_filter,
    "ace": spectral.ace,
    "rx": lambda image, _, background: spectral.rx(image, background=background),
}


def peer_rows(observed: Observed, detection: Detection | None) -> list[Result]:
    """Area under the ROC by pixel of each subject and peer (``auc``), and how SPy's scores follow ours.

    ``score_rank_correlation`` is Spearman's between its map and ours over all pixels that both score: 1 where
    both put them into the same order.  One SKIPPED row where the image is too large to be taken into memory.
    """
    place, detected = observed.place, observed.detected
    if detection is None or place is None or detected is None:
        return []
    cube, bands = place.cube, np.flatnonzero(detected.bank.bands)
    if cube.lines * cube.samples * bands.size > detect.MAX_VALUES:
        why = f"SPy holds the image in memory, and it has more than {detect.MAX_VALUES:.0e} values"
        return list(named(skip_rows(Cause.REFUSED, why, "auc"), PRODUCT, EVERY_OBJECT, PEER))
    image = np.concatenate([block.values[..., bands] for block in cube.blocks()])
    if place.line is not None:
        image = (image - place.line.offset[bands]) / place.line.gain[bands]
    valid = np.isfinite(image).all(axis=-1)
    background = spectral.calc_stats(image, mask=(place.pixels_of(*detection.background) & valid).astype(np.int8))
    image[~valid] = background.mean
    alarms = place.pixels_of(*detection.false_alarms) & valid
    spectra = {key.removesuffix(f"-{name}"): our for key, (name, our) in detected.bank.forms.items() if our is not None}
    rows: list[Result] = []
    version = f"a peer: SPy {spectral.__version__}, same bands, spectra and background"
    for (target, subjects), (name, peer) in product(_subjects(place, detection), PEERS.items()):
        with np.errstate(invalid="ignore"):  # 0/0 of what holds no data, which stands at the mean
            scores = np.asarray(peer(image, spectra[target], background), dtype=np.float64)
        scores[~valid] = np.nan
        noise = scores[alarms]
        for subject, objects in subjects.items():
            pixels = np.concatenate([scores[o.window][o.part] for o in objects])
            pixels = pixels[np.isfinite(pixels)]
            found = skip_rows(Cause.NO_OBSERVATION, "no valid pixel on the targets or in the background", "auc")
            if pixels.size and noise.size:
                share = stats.mannwhitneyu(pixels, noise).statistic / (pixels.size * noise.size)
                found = [row("auc", float(share), n=int(pixels.size), reason=version)]
            rows += named(found, PRODUCT, subject, f"{PEER}-{name}/pixel")
        our = detected.score_maps.get(map_name(target, name))
        if our is not None:
            both = np.isfinite(our) & np.isfinite(scores)
            value = float(stats.spearmanr(our[both], scores[both]).statistic)
            found = [row("score_rank_correlation", value, n=int(both.sum()), reason=version)]
            rows += named(found, PRODUCT, target, f"{PEER}-{name}/pixel")
    return rows


_LOADED: set[Path] = set()


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
        refuse(not place.is_file(), "benchmark.file", path)
        try:
            runpy.run_path(str(place))
        except HypervalError:
            raise
        except Exception as error:
            raise refusal("benchmark.fails", path, kind=type(error).__name__, why=error) from error
        _LOADED.add(place)


@dataclass(frozen=True)
class BenchmarkRun(Run):
    """The run of one campaign with all detectors.

    Attributes
    ----------
    exit_code : of the error that stopped it; None when nothing did
    values : subject, method and metric -> the row, where it has a value
    measures : metrics of all objects together
    groups : detectors that have the same value of each of these: they order the pixels alike
    """

    exit_code: int | None = None

    @cached_property
    def values(self) -> dict[tuple[str, str, str], Result]:  # noqa: D102 - above
        return {(r.subject, r.method, r.metric): r for r in self.table.where(outcome=Outcome.NONE)}

    @cached_property
    def measures(self) -> list[str]:  # noqa: D102 - above
        return [m for m in MEASURES if any((s, metric) == (EVERY_OBJECT, m) for s, _, metric in self.values)]

    @cached_property
    def groups(self) -> list[tuple[str, ...]]:  # noqa: D102 - above
        values: dict[str, dict[str, float]] = {}
        for (subject, method, metric), found in self.values.items():
            if subject == EVERY_OBJECT and metric in MEASURES:
                values.setdefault(method.removesuffix("/object"), {})[metric] = found.value
        each = list(values.values())
        return [tuple(n for n in values if values[n] == held) for i, held in enumerate(each) if held not in each[:i]]

    def group_rows(self, group: tuple[str, ...], metric: str, subject: str = EVERY_OBJECT) -> list[Result | None]:
        """Value, rank and share of first places of a group by a metric."""
        return [self.values.get((subject, f"{group[0]}/object", f"{part}{metric}")) for part in ("", "rank_", "first_")]

    def ranks(self, metric: str) -> list[tuple[str, Result]]:
        """The names of each group and its rank by a metric on all objects, of those that have one."""
        standings = ((" = ".join(group), self.group_rows(group, metric)[1]) for group in self.groups)
        return [(names, rank) for names, rank in standings if rank is not None]


def benchmark_campaign(job: Job, *, seed: int, extensions: Sequence[Path], scores: Mapping[str, str]) -> BenchmarkRun:
    """Every row of one campaign; what stops it becomes its one row, SKIPPED or ERROR."""
    if job.unavailable is not None:
        return _failed_benchmark(job, Outcome.SKIPPED, job.unavailable[0])
    detection, refused = job.campaign.detection, dict[str, str]()
    try:
        load_extensions(extensions)
        with _score_maps(job.campaign.name, scores):
            while True:  # a detector that this collection cannot take does not take the others with it
                try:
                    return _benchmark_run(job, seed, refused)
                except detect.AddedDetectorError as error:
                    refused[error.detector] = str(error)
                except UsageError as error:
                    # A target among the undesired, a singular background: its own detectors are known to run.
                    others = set(detect.detector_names()) - set(detection.detectors if detection else ()) - {*refused}
                    if detection is None or isinstance(error, MissingDataError) or not others:
                        raise
                    refused |= dict.fromkeys(others, f"not run, as one of the detectors was refused: {error}")
    except MissingDataError as error:
        return _failed_benchmark(job, Outcome.SKIPPED, str(error))
    except Exception as error:  # one broken campaign must not hide what the others say
        return _failed_benchmark(job, Outcome.ERROR, *words_and_code(error))


@contextmanager
def _score_maps(campaign: str, scores: Mapping[str, str]) -> Iterator[None]:
    """Score maps that were made elsewhere are detectors of this campaign."""

    def detector(file: str, target: Any, mean: Any, covariance: Any, undesired: Any) -> detect.PixelDetector:
        path = Path(file.replace("{campaign}", campaign))

        def image(values: Any, scene: Any) -> Any:
            raster = raster_of_size(path, ImageGrid(values.shape[:2]))
            return raster.read_some_bands(0, raster.lines, [0])[0].astype(float)

        return detect.PixelDetector(np.zeros((1, mean.size)), np.zeros(1), image=image)

    before = dict(detect.ADDED_DETECTORS)
    try:
        for name, file in scores.items():
            detect.register_detector(name, partial(detector, file))
        yield
    finally:
        detect.ADDED_DETECTORS.clear()
        detect.ADDED_DETECTORS.update(before)


def _benchmark_run(job: Job, seed: int, refused: Mapping[str, str]) -> BenchmarkRun:
    """The rows with every detector that was not ``refused``."""
    left_out, remarks = dict[str, str](), list[str]()

    def choose_campaign(scenarios: Sequence[Scenario], inputs: InputLog) -> Campaign:
        regions: list[str] = []
        if job.campaign.detection is not None and not job.campaign.detection.undesired:
            place = open_place(job.campaign.collection, inputs.resolve)
            # Those that are classes of the scenarios, or give them their statistics.
            named = [n for s in scenarios for c in s.scene.classes for n in (c.name, c.spectrum.measured)]
            regions = list(dict.fromkeys(n for n in named if n is not None and n in place.regions))
        asked, reasons, notes = with_every_detector(job.campaign, regions, refused)
        left_out.update(reasons)
        remarks.extend(notes)
        return asked

    with step(job.campaign.name, 1, 1, "benchmark"), observe_campaign(job, question=choose_campaign) as collection:
        observed, detection = collection.observed, collection.campaign.detection
        rows, lost = detector_rows(observed, detection, left_out, seed=seed)
        rows, notes = [*rows, *peer_rows(observed, detection)], [*remarks, *lost]
        for scenario in collection.scenarios if detection is not None else ():
            rows += side_rows(predict(scenario, collection.origins(scenario)), "predicted")
        about = {"campaign": collection.campaign}
        record = record_of(collection.inputs, collection.scenarios, collection.seed, about, [observed.observation])
        if detection is not None and detection.halo_pixels:
            notes += ["ranks count the pixels of an object alone; the values by subject count the campaign's halo too"]
        notes = list(dict.fromkeys([*notes, *observed.observation.notes]))
    return _build_benchmark(job.campaign, rows, record, notes=notes)


def _build_benchmark(campaign: Any, rows: Iterable[Result], record: Mapping[str, Any], **more: Any) -> BenchmarkRun:
    more |= {"campaign": campaign.name, "title": campaign.title, "simulated": bool(campaign.simulated)}
    return BenchmarkRun(ResultTable(of_campaign(rows, campaign.name)), record, **more)


def _failed_benchmark(job: Job, outcome: Outcome, reason: str, code: int | None = None) -> BenchmarkRun:
    cause = Cause.NO_DATA if outcome is Outcome.SKIPPED else Cause.BROKEN
    row = Result("", PRODUCT, EVERY_OBJECT, "all", "benchmark", outcome=outcome, cause=cause, reason=reason)
    record = record_of(InputLog.of_file(job.path), [], None, {"campaign": job.outline}, [])
    return _build_benchmark(job.outline, [row], record, exit_code=code)


def benchmark(
    paths: Sequence[Path],
    output: Path,
    *,
    extensions: Sequence[Path] = (),
    scores: Mapping[str, str] = MappingProxyType({}),
    seed: int = 0,
    scheduler: str | None = None,
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
    The exit code of the first campaign that ended in an error, else 5 where no detector was ranked, else 0.

    Raises
    ------
    UsageError, InputError : campaign files or extensions that are not right; nothing is written.
    """
    from hyperval.figures.print import drawings_of

    load_extensions(extensions)
    jobs, programs = load_jobs(*paths, compares=False), tuple(Path(p).resolve() for p in extensions)
    inputs = [*(one.path for job in jobs for one in job.files), *map(Path, scores.values())]
    with whole_folder(output, beside=inputs) as folder, workers(worker_count(len(jobs)), scheduler) as where:
        one_process = where.executor is None  # one after the other, each with its own bars
        run = partial(benchmark_campaign, seed=seed, extensions=programs, scores=dict(scores))
        results = in_order(where, run, jobs, ahead=max(1, len(jobs)))
        done = list(track(results, "campaigns", len(jobs), show=False if one_process else None))
        read, each = {Path(p).name: sha256_of(Path(p)) for p in extensions}, {d.campaign: d.provenance for d in done}
        record = {"command": command_without_output(), "seed": seed, "extensions": read, "campaigns": each}
        figures, simulated = benchmark_figures(done), {d.campaign for d in done if d.simulated}
        drawings = [one for figure in figures for one in drawings_of([figure], simulated=figure.section in simulated)]
        rows = ResultTable(row for d in done for row in d.table)
        Run(rows, record).write(folder, benchmark_page(done, figures), drawings)
    return next((d.exit_code for d in done if d.exit_code is not None), 0 if any(d.values for d in done) else 5)


_MAX_SUBJECTS = 30
_RANK_METRICS = ("log_auc@1e-3..1e-1", "auc")


def detector_figure(one: BenchmarkRun) -> Figure | None:
    """A view for each metric on all objects: value, interval, rank with its set."""
    detectors = Axis.named([" = ".join(g) for g in one.groups])

    def view(metric: str) -> Panels:
        standings = [one.group_rows(group, metric) for group in one.groups]
        ranked = {i: (row, rank) for i, (row, rank, _) in enumerate(standings) if row is not None and rank is not None}
        notes = {i: _rank_text(rank) for i, (_, rank) in ranked.items()}
        # Densities of false alarms are drawn on a logarithmic axis, where none stands at its left end.
        far = metric.startswith("far")
        positive = [v for row, _ in ranked.values() for v in (row.value, row.upper) if math.isfinite(v) and v > 0]
        floor = 0.5 * min(positive, default=1.0) if far else -math.inf
        rows = [(*np.maximum((row.value, row.lower, row.upper), floor), i) for i, (row, _) in ranked.items()]
        dots = measured_mark("dots", to_columns(rows, ("x", "low", "high", "y")), marker="circle", along="x")
        styles: dict[Any, Any] = {True: {"label": "may be first"}, False: {"label": "is not first", "hollow": True}}
        marks = dots.split([rank.lower <= 1 for _, rank in ranked.values()], styles)
        none = far and any(row.value == 0.0 for row, _ in ranked.values())
        name = MEASURES[metric].title + (" (none: at the left end)" if none else "")
        texts = [f"{'/'.join(one.groups[i])} {row.value:.3g}, rank {notes[i]}" for i, (row, _) in ranked.items()]
        part = Part(replace(detectors, notes=tuple(notes.get(i, "") for i in range(len(one.groups)))), tuple(marks))
        return Panels(Axis("value", "log" if far else "linear"), (part,), name, words="; ".join(texts))

    name = f"{one.campaign}-detectors"
    return figure_of_views("detectors", one.measures, view, name=name, campaign=one.campaign)


def rank_figure(one: BenchmarkRun) -> Figure | None:
    """Ranks by subject, as a map: dark where the detector leads, with the set of ranks that are not refuted."""
    metric = next((m for m in _RANK_METRICS if any(name == f"rank_{m}" for *_, name in one.values)), "")
    every = list(dict.fromkeys(subject for subject, _, name in one.values if name == f"rank_{metric}"))
    subjects = every[:_MAX_SUBJECTS]
    # Where all objects are one subject, the map would say it twice.
    if not metric or len({*subjects, EVERY_OBJECT}) < 3 or not one.groups:
        return None
    more = "" if len(subjects) == len(every) else f"; {len(subjects)} of {len(every)} subjects"
    rows = {subject: (one, subject) for subject in subjects}
    return _rank_map("ranks", rows, one.groups, metric, more, name=f"{one.campaign}-ranks", campaign=one.campaign)


def _rank_text(rank: Result) -> str:
    return f"{rank.value:.0f} [{rank.lower:.0f}-{rank.upper:.0f}]"


def _rank_map(
    kind: str, rows: Mapping[str, tuple[BenchmarkRun, str]], groups: Sequence[tuple[str, ...]], metric: str,
    more: str = "", **about: str,
) -> Figure:  # fmt: skip
    """A cell for each row, of a subject of a campaign, and group of detectors that order alike: dark where it leads."""
    cells, words, captions = [], [], []
    for (i, (label, (one, subject))), (j, group) in product(enumerate(rows.items()), enumerate(groups)):
        if (row := one.group_rows(group, metric, subject)[1]) is not None:
            cells.append((j - 0.5, j + 0.5, i - 0.5, i + 0.5, row.value))
            words.append(_rank_text(row))
            captions.append(f"{label}, {'/'.join(group)}: {words[-1]}")
    columns = to_columns(cells, ("left", "right", "bottom", "top", "value"))
    scale = ColourScale("falling", 1.0, max(float(columns["value"].max()), 2.0))
    mark = Mark("cells", columns, words=tuple(words), beside="centre", scale=scale)
    x, y = Axis.named([" = ".join(group) for group in groups]), Axis.named(list(rows))
    view = single_panel(x, y, [mark], words="; ".join(captions))
    title = MEASURES[metric].title
    figure = compose(kind, [view], more, metric=title, short=title.partition(",")[0], **about)
    return replace(figure, width_in=2.6 + 1.35 * len(groups))


def overview_figure(done: Sequence[BenchmarkRun]) -> Figure | None:
    """Rank of every detector on all objects of every collection, as a map; one collection needs none."""
    metric = _RANK_METRICS[1]
    shown = {one.campaign: (one, EVERY_OBJECT) for one in done if metric in one.measures}
    every = dict.fromkeys(name for one, _ in shown.values() for group in one.groups for name in group)
    if len(shown) < 2:
        return None
    return _rank_map("overview", shown, [(name,) for name in every], metric)


def predicted_figure(one: BenchmarkRun) -> Figure | None:
    """Measured over predicted area and P_D, a point for each subject and detector, a view for each metric."""
    names = [name for name in MEASURES if not name.startswith("far")]
    pairs = {name: [(key, one.values[*key[:2], name], row) for key, row in one.values.items()
                    if key[2] == f"predicted_{name}" and (*key[:2], name) in one.values] for name in names}  # fmt: skip

    def view(metric: str) -> Panels:
        numbers = [(p.value, m.value, m.lower, m.upper) for _, m, p in pairs[metric]]
        labels = tuple(
            f"{s}, {method}: measured {m.value:.2f}, predicted {p.value:.2f}" for (s, method, _), m, p in pairs[metric]
        )
        diagonal = Mark("line", {"x": np.array([0.0, 1.0]), "y": np.array([0.0, 1.0])}, "as predicted", dash="dotted")
        dots = measured_mark("dots", to_columns(numbers), marker="circle", words=labels)
        x, y = (Axis(side, ends=(-0.02, 1.02)) for side in ("predicted", "measured"))
        return single_panel(x, y, (diagonal, dots), MEASURES[metric].title)

    paired = [name for name in names if pairs[name]]
    return figure_of_views("predicted", paired, view, name=f"{one.campaign}-predicted", campaign=one.campaign)


def benchmark_figures(done: Sequence[BenchmarkRun]) -> list[Figure]:
    """The figures of the page."""
    made = [make(one) for one in done for make in (detector_figure, rank_figure, predicted_figure)]
    return [figure for figure in (*made, overview_figure(done)) if figure is not None]


def benchmark_page(done: Sequence[BenchmarkRun], figures: Sequence[Figure]) -> str:
    """The page."""
    return page(
        "benchmark.html.j2", figures, figures=figures, all=len(done), count=sum(len(d.table) for d in done),
        entries=[one for one in done if one.values],  # the others are named under what was not run
        skipped=[r for d in done for r in d.table if r.outcome in (Outcome.SKIPPED, Outcome.ERROR)],
        measures=MEASURES, rank_text=_rank_text, number=number_text, isfinite=math.isfinite,
    )  # fmt: skip
