"""All detectors on one collection: which of them can run, their score maps, and their rows with ranks.

Peers of the benchmark: matched filter, ACE and RX of SPy on the same pixels, bands, spectra and background.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy
import spectral
from scipy import stats

from hyperval.campaign import Campaign
from hyperval.collection import Detection
from hyperval.compare.products import product_rows
from hyperval.compare.rows import named, row, skipped
from hyperval.observe import Observed, map_name, scored_pixels, target_groups
from hyperval.pixels import ANOMALY_DETECTORS, LOCAL_DETECTORS, AlarmBlocks, detector_names, object_scores, values_on
from hyperval.products import PredictedProducts
from hyperval.progress import track
from hyperval.results import Cause, Result
from hyperval.scenario import Scenario
from hyperval.scoreboard.ranks import (
    MEASURES,
    BlockCounts,
    Measure,
    RankedDetectors,
    counts_by_block,
    fewest_objects,
    ranked,
)
from hyperval.settings import with_settings

Array = npt.NDArray[np.float64]

PRODUCT = "benchmark"
EVERY_OBJECT = "all objects"
DRAWS = 1000


@dataclass(frozen=True)
class Question:
    """A campaign that is asked for every detector it can take.

    Attributes
    ----------
    left_out : detector -> why it cannot run here
    notes : what was chosen for the campaign
    """

    campaign: Campaign
    left_out: Mapping[str, str]
    notes: tuple[str, ...] = ()


def with_every_detector(campaign: Campaign, regions: Sequence[str], refused: Mapping[str, str]) -> Question:
    """The campaign with all detectors that the code knows, and without what the benchmark does not look at.

    Parameters
    ----------
    regions : names that the collection has; those that are classes of a scenario are projected away by osp, where
        the campaign names none itself
    refused : detector -> why it cannot run, as was found out
    """
    bare = campaign.model_copy(update={"classification": None, "attribution": None})
    detection = campaign.detection
    if detection is None:
        return Question(bare, {})
    names, left_out, notes = detector_names(), dict[str, str](), tuple[str, ...]()
    if detection.local_window is not None:
        why = "the campaign takes background means from a local window, which this detector does not have"
        left_out = {name: why for name in names if name not in LOCAL_DETECTORS}
    undesired = list(detection.undesired or regions)
    if "osp" not in left_out and not undesired:
        left_out["osp"] = "no region of the collection is a class of the scenario: nothing to project away"
    elif "osp" not in left_out and not detection.undesired:
        notes = (f"osp projects away the mean spectra of {', '.join(undesired)}",)
    left_out |= refused
    run = [name for name in names if name not in left_out]
    changed: Detection = with_settings(
        detection,
        {"detectors": run, "undesired": undesired if "osp" in run else [], "areas": [], "unmixing": None},
    )
    return Question(bare.model_copy(update={"detection": changed}), left_out, notes)


def classes_with_regions(scenarios: Sequence[Scenario], regions: Iterable[str]) -> list[str]:
    """Regions of the collection that are classes of the scenarios, or give them their statistics."""
    there = set(regions)
    named = [n for s in scenarios for c in s.scene.classes for n in (c.name, c.spectrum.measured)]
    return list(dict.fromkeys(n for n in named if n is not None and n in there))


def block_counts(observed: Observed, detection: Detection) -> BlockCounts:
    """Background pixels above every object's greatest score, by detector and block of the image.

    A halo that the campaign gives its objects is left out: pixels of the object alone count, and of the background
    single pixels.
    """
    place, measured = observed.place, observed.detected
    assert place is not None  # noqa: S101 - detection has both
    assert measured is not None  # noqa: S101
    counted = place.background(detection.false_alarms)
    names = tuple(detection.detectors)
    keys = {(t.name, d): d if d in ANOMALY_DETECTORS else f"{t.name}-{d}" for t in detection.targets for d in names}
    for key in set(keys.values()):
        counted = counted & np.isfinite(measured.score_maps[key])
    over, tie = [], []
    item: list[int] = []
    group: dict[str, list[int]] = {}
    number: dict[str, int] = {}
    for target in detection.targets:
        groups = target_groups(place.targets, target, detection.group)
        objects = {o.name: scored_pixels(o, place) for members in groups.values() for o in members}
        maps = [measured.score_maps[keys[target.name, d]] for d in names]
        scores = np.array([list(object_scores(m, objects).values()) for m in maps])
        valid = np.isfinite(scores).all(axis=0)
        kept = [name for name, ok in zip(objects, valid, strict=True) if ok]
        at = {name: len(item) + i for i, name in enumerate(kept)}
        pairs = []
        for own, m in zip(scores, maps, strict=True):
            background = AlarmBlocks.of_map(m, counted)
            pairs.append(counts_by_block(own[valid], background))
        over.append(np.stack([p[0] for p in pairs], axis=1))
        tie.append(np.stack([p[1] for p in pairs], axis=1))
        item += [number.setdefault(name, len(number)) for name in kept]
        for subject, members in groups.items():
            group[subject] = [at[o.name] for o in members if o.name in at]
    for pool in detection.pools:
        group[pool.name] = [i for s in pool.subjects for i in group.get(s, [])]
    group[EVERY_OBJECT] = list(range(len(item)))
    density = math.nan if place.pixel_area_m2 is None else 1e6 / place.pixel_area_m2
    return BlockCounts(
        names, np.concatenate(over), np.concatenate(tie), background.pixels,
        np.array(item, dtype=np.intp), group, density,
    )  # fmt: skip


def detector_rows(
    observed: Observed, question: Question, *, seed: int, show_progress: bool | None = None
) -> list[Result]:
    """Rows of every detector: metrics by subject, the same of all objects, ranks, and what could not run."""
    detection = question.campaign.detection
    if detection is None or observed.detected is None:
        why = "the campaign looks for no targets"
        return list(named(skipped(Cause.NO_OBSERVATION, why, "rank"), PRODUCT, EVERY_OBJECT, "detectors"))
    rows = _measured_rows(observed) + threshold_rows(observed, detection)
    counts = block_counts(observed, detection)
    groups = {name: looks for name, looks in counts.group.items() if looks}
    for name, looks in track(groups.items(), "ranks", len(groups), show=show_progress):
        objects = len(set(counts.item[list(looks)]))
        if objects < 2:
            continue  # one object orders detectors by chance alone
        for measure in MEASURES.values():
            if measure.known_from(counts.n):
                ranks = ranked(counts, list(looks), measure, draws=DRAWS, rng=np.random.default_rng(seed))
                rows += rank_rows(name, counts, measure, ranks)
    for name, reason in question.left_out.items():
        rows += named(skipped(Cause.REFUSED, reason, "rank"), PRODUCT, EVERY_OBJECT, f"{name}/object")
    return rows


def predicted_rows(predictions: Iterable[PredictedProducts]) -> list[Result]:
    """What the model says of the measured rows: ``predicted_METRIC`` by subject and detector."""
    names = {m.observed.replace("measured", "predicted"): f"predicted_{m.name}" for m in MEASURES.values()}
    rows = [one for p in predictions for one in product_rows(p, "predicted") if one.product == "roc"]
    return [replace(r, product=PRODUCT, metric=names[r.metric], evidence=None) for r in rows if r.metric in names]


def threshold_rows(observed: Observed, detection: Detection) -> list[Result]:
    """Areas of the other two sides of the 3-D ROC by subject: P_D and P_FA over the threshold.

    Scores run from 0, the least of background and targets, to 1, the greatest; the area under an exceedance is then
    the mean.  Intervals are of the means of objects and of blocks of the image.
    Source: Chang, IEEE Trans. Geosci. Remote Sens. 59, 5131-5153, 2021.
    """
    place, measured = observed.place, observed.detected
    assert place is not None  # noqa: S101 - detection has both
    assert measured is not None  # noqa: S101
    counted, rows = place.background(detection.false_alarms), list[Result]()
    for target in detection.targets:
        groups = target_groups(place.targets, target, detection.group)
        for name in detection.detectors:
            scores = measured.score_maps[map_name(target.name, name)]
            own = {s: [values_on(scores, scored_pixels(o, place)) for o in members] for s, members in groups.items()}
            noise = AlarmBlocks.of_map(scores, counted)
            every = np.concatenate([noise.scores, *(values for each in own.values() for values in each)])
            low, high = np.nanmin(every), np.nanmax(every)
            sums, sizes = (np.bincount(noise.block, weights) for weights in (noise.scores - low, None))
            for subject, each in own.items():
                found = [np.array([part.sum(), part.size]) for v in each if (part := v[np.isfinite(v)] - low).size]
                for metric, parts in (("auc_d_tau", np.array(found).T), ("auc_f_tau", np.stack([sums, sizes]))):
                    if parts.size:
                        mean, ends = _mean_of_parts(parts[0] / max(float(high - low), 1e-300), parts[1])
                        made = [row(metric, mean, ends, n=parts.shape[1])]
                        rows += named(made, PRODUCT, subject, f"{name}/pixel")
    return rows


def _mean_of_parts(sums: Array, sizes: Array) -> tuple[float, tuple[float, float]]:
    """Mean over parts of different sizes, and its 95 % interval from their scatter, by Student's t."""
    mean, count = float(sums.sum() / sizes.sum()), sums.size
    spread = math.sqrt(float(np.sum((sums - mean * sizes) ** 2)) * count / max(count - 1, 1)) / float(sizes.sum())
    half = float(stats.t.ppf(0.975, count - 1)) * spread if count > 1 else math.nan
    return mean, (mean - half, mean + half)


def _measured_rows(observed: Observed) -> list[Result]:
    """The metrics of single subjects and pools, as the collection's own rows have them."""
    least = {(s, f"{d}/{u}"): c.n_background or 0 for (s, d, u), c in observed.observation.roc.items()}
    names = {m.observed: m for m in MEASURES.values()}
    rows = []
    for own in product_rows(observed.observation, "observed"):
        measure = names.get(own.metric)
        if own.product == "roc" and measure is not None and measure.known_from(least[own.subject, own.method]):
            rows.append(replace(own, product=PRODUCT, metric=measure.name, evidence=None))
    return rows


def rank_rows(group: str, counts: BlockCounts, measure: Measure, ranks: RankedDetectors) -> list[Result]:
    """``METRIC`` (of all objects together), ``rank_METRIC`` and ``first_METRIC`` of each detector on one group."""
    m, rows = ranks.objects, list[Result]()
    words = f"paired: {DRAWS} draws of {m} objects and of blocks of the background, the same for all detectors"
    if not ranks.orders:
        words += f"; {m} objects cannot order {ranks.distinct} detectors, {fewest_objects(ranks.distinct)} could"
    first = "share of the draws in which it is the best, equals counted alike"
    known = measure.of_look is not None or math.isfinite(counts.density_km2)
    if group == EVERY_OBJECT and not known:
        why = "the ground area of the background is not known"
        rows += named(skipped(Cause.NO_GROUND_AREA, why, measure.name), PRODUCT, group, "detectors")
    for d, detector in enumerate(counts.detectors):
        ends = float(ranks.rank_lower[d]), float(ranks.rank_upper[d])
        own = [
            *([_value_row(counts, measure, ranks, d)] if group == EVERY_OBJECT and known else []),
            row(f"rank_{measure.name}", float(ranks.rank[d]), ends, n=m, reason=words),
            row(f"first_{measure.name}", float(ranks.first[d]), n=m, reason=first),
        ]
        rows += named(own, PRODUCT, group, f"{detector}/object")
    return rows


def _value_row(counts: BlockCounts, measure: Measure, ranks: RankedDetectors, d: int) -> Result:
    per_area = measure.of_look is None
    scale = counts.density_km2 if per_area else 1.0
    ends = float(ranks.lower[d]) * scale, float(ranks.upper[d]) * scale
    why = "every target at the same P_FA through its own filter; objects and blocks of the background sampled"
    unit = "km-2" if per_area else "1"
    return row(measure.name, float(ranks.value[d]) * scale, ends, unit=unit, n=ranks.objects, reason=why)


MOST_VALUES = 50_000_000  # of the image in the bands of the filters: SPy works on all of it in memory
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
    if cube.lines * cube.samples * bands.size > MOST_VALUES:
        why = f"SPy holds the image in memory, and it has more than {MOST_VALUES:.0e} values"
        return list(named(skipped(Cause.REFUSED, why, "auc"), PRODUCT, EVERY_OBJECT, PEER))
    image = np.concatenate([block.values[..., bands] for block in cube.blocks()])
    if observed.elm is not None:
        image = (image - observed.elm.offset[bands]) / observed.elm.gain[bands]
    valid = np.isfinite(image).all(axis=-1)
    background = spectral.calc_stats(image, mask=(place.background(detection.background) & valid).astype(np.int8))
    image[~valid] = background.mean
    alarms = place.background(detection.false_alarms) & valid
    spectra = {key.removesuffix(f"-{name}"): own for key, (name, own) in detected.bank.forms.items() if own is not None}
    rows: list[Result] = []
    for target in detection.targets:
        spectrum = spectra[target.name]
        groups = target_groups(place.targets, target, detection.group)
        for name, peer in PEERS.items():
            scores = np.asarray(peer(image, spectrum, background), dtype=np.float64)
            scores[~valid] = np.nan
            for subject, members in groups.items():
                pixels = np.concatenate([values_on(scores, scored_pixels(o, place)) for o in members])
                own_rows = _subject_rows(pixels[np.isfinite(pixels)], scores[alarms])
                rows += named(own_rows, PRODUCT, subject, f"{PEER}-{name}/pixel")
            own = detected.score_maps.get(name if name == "rx" else f"{target.name}-{name}")
            if own is not None:
                both = np.isfinite(own) & np.isfinite(scores)
                value = float(scipy.stats.spearmanr(own[both], scores[both]).statistic)
                found = row("score_rank_correlation", value, n=int(both.sum()), reason=_version())
                rows += named([found], PRODUCT, target.name, f"{PEER}-{name}/pixel")
    return rows


def _subject_rows(pixels: Array, noise: Array) -> list[Result]:
    if not pixels.size or not noise.size:
        return skipped(Cause.NO_OBSERVATION, "no valid pixel on the targets or in the background", "auc")
    share = scipy.stats.mannwhitneyu(pixels, noise).statistic / (pixels.size * noise.size)
    return [row("auc", float(share), n=int(pixels.size), reason=_version())]


def _version() -> str:
    return f"a peer: SPy {spectral.__version__}, same bands, spectra and background"
