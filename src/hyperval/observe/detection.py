"""Filters, scores and detection curves of one collection; anomalies where no target is looked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.collection import Detection, DetectionTarget
from hyperval.errors import InputError, UsageError
from hyperval.imagery.regions import objects
from hyperval.imagery.truth import TargetMasks, TargetObject
from hyperval.observe.filter_bank import FilterBank, filter_bank, map_name, spectrum_by_number
from hyperval.observe.objects import object_curve, scored_pixels, target_areas, target_groups
from hyperval.observe.place import IMAGE, SCENE, Place
from hyperval.prediction.inputs import Sources
from hyperval.processing.alarm_blocks import AlarmBlocks
from hyperval.processing.alarms import alarms_before_first
from hyperval.processing.elm import EmpiricalLine
from hyperval.processing.exceedance import (
    ANOMALY_LEVELS,
    FEWEST_FOR_A_CURVE,
    LEAST_EXPECTED_ALARMS,
    exceedance_curve,
)
from hyperval.processing.local_scores import LocalWindow, score_cube_locally
from hyperval.processing.objects import object_scores, values_on
from hyperval.processing.pixel_scores import PixelDetector, score_cube
from hyperval.processing.roc import PresetThresholds, empirical_roc, pooled_roc, preset_thresholds, with_summary
from hyperval.processing.sample import SampleStatistics
from hyperval.products import (
    ANOMALIES,
    Abundance,
    ExceedanceCurve,
    ObjectScores,
    RocCurve,
    ScoreDistribution,
    background_of,
)
from hyperval.progress import watch_lines

BY_PIXEL = "object-by-pixel"  # objects by their halos, alarms by pixel
_MOST_SCORES = 500  # that a product keeps of one population: the exact ends of a curve
Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
MOST_NAMED = 10


@dataclass(frozen=True, eq=False)
class Detected:
    """What the detectors found.

    Attributes
    ----------
    score_maps : "TARGET-DETECTOR" -> (lines, samples) score
    outlines : "TARGET-DETECTOR" -> mask of each object that was looked for
    scores, roc, abundance : products by their keys
    detectors : by the keys of ``score_maps``
    bands : (B,) the bands that the filters use
    nominal_area_m2 : area of the targets as the truth states it, by the keys of ``abundance``
    object_scores, exceedance : products by their keys
    shrinkage : of the background's covariance, 0 where there were pixels enough
    """

    score_maps: Mapping[str, Array]
    outlines: Mapping[str, Mapping[str, Mask]]
    scores: Mapping[tuple[str, str], ScoreDistribution]
    roc: Mapping[tuple[str, str, str], RocCurve]
    abundance: Mapping[tuple[str, str], Abundance]
    detectors: Mapping[str, PixelDetector]
    bands: Mask
    nominal_area_m2: Mapping[tuple[str, str], float]
    notes: tuple[str, ...] = field(default=())
    object_scores: Mapping[tuple[str, str], ObjectScores] = field(default_factory=dict)
    exceedance: Mapping[tuple[str, str], ExceedanceCurve] = field(default_factory=dict)
    shrinkage: float = 0.0


def detect(
    place: Place,
    detection: Detection,
    measured: Mapping[str, SampleStatistics],
    elm: EmpiricalLine | None,
    resolve: Callable[[str], Path],
    *,
    show_progress: bool | None = None,
) -> Detected:
    """Score the image with every detector and target, and count what is found.

    Parameters
    ----------
    measured : statistics of the regions and of the detectors' background in the cube's values

    Raises
    ------
    UsageError : names that do not fit, a singular background.
    InputError : target spectra or truth that are missing.
    """
    axis = place.cube.axis
    if place.by_number:
        spectra = {t.name: _by_number(t, len(axis), resolve) for t in detection.targets}
    else:
        sources = Sources(axis, {}, resolve)
        spectra = {t.name: sources.spectrum(t.spectrum, t.name).mean for t in detection.targets}
    bank = filter_bank(place, detection, measured, elm, spectra)
    maps, remarks = _score_maps(place, detection, bank, elm, show_progress)
    scored = _Curves(place, detection, maps)
    for target in detection.targets:
        groups = target_groups(place.targets, target, detection.group)
        for detector in detection.detectors:
            scored.add(target, detector, groups)
    if not detection.targets:
        for name, scores in maps.items():
            moments, curves = anomaly_products(name, scores, scored.alarms)
            scored.scores |= moments
            scored.exceedance |= curves
            remarks.append(anomaly_note(place, name, scores, scored.alarms))
    scored.add_pools()
    if detection.halo_pixels:
        remarks.append(
            f"curves '{BY_PIXEL}' count every pixel as a false alarm and give an object the best of its halo, as "
            "MUUFL's scoring does: they favour detection, those 'object' do not"
        )
    if detection.first_detection:
        remarks.append(
            "alarms_before_first counts false alarms up to the best pixel of any object, as RIT's self-test does: "
            "it favours targets of many pixels or pieces, of which the luckiest stands for all"
        )
    areas, nominal = target_areas(place, detection, maps)
    return Detected(
        maps,
        {key: TargetMasks(list(objects.values())) for key, objects in scored.outlined.items()},
        scored.scores,
        scored.roc,
        areas,
        bank.detectors,
        bank.bands,
        nominal,
        (*bank.notes, *remarks),
        scored.of_objects,
        scored.exceedance,
        bank.shrinkage,
    )


def _by_number(target: DetectionTarget, bands: int, resolve: Callable[[str], Path]) -> Array:
    """(B,) spectrum of a target where bands go by number."""
    if target.spectrum.file is None:
        raise UsageError(
            f"the spectrum of {target.name!r} goes by wavelength, the bands of the cube by number",
            expected="a text file with one row for each band",
        )
    return spectrum_by_number(resolve(target.spectrum.file), bands)


def _score_maps(
    place: Place, detection: Detection, bank: FilterBank, elm: EmpiricalLine | None, show: bool | None
) -> tuple[dict[str, Array], list[str]]:
    """Score (lines, samples) by the keys of the bank, and what is to be said of it."""
    cube, local = place.cube, detection.local_window
    watch = watch_lines("scores", cube.bytes_per_line, cube.lines, show=show)
    if local is None or bank.whitener is None:
        maps = score_cube(
            cube, bank.detectors, elm, bank.bands, whitener=bank.whitener, needed=cube.axis.good, watch=watch
        )
        return maps, []
    window = LocalWindow(local.outer_pixels, local.inner_pixels)
    surroundings = place.background([IMAGE] if IMAGE in detection.background else [SCENE])
    scored = score_cube_locally(
        cube, bank.forms, bank.whitener, window, surroundings, elm, bank.bands, needed=cube.axis.good, watch=watch
    )
    note = (
        f"background means from windows of {window.outer} less {window.inner} pixels; "
        f"{scored.without_surroundings} pixels without surroundings take the mean of the background. "
        "Predicted scores are against that mean throughout"
    )
    return scored.maps, [note]


class _Curves:
    """Products of the score maps, subject by subject."""

    def __init__(self, place: Place, detection: Detection, maps: Mapping[str, Array]):
        self.place, self.detection, self.maps = place, detection, maps
        self.alarms = place.background(detection.false_alarms)
        area = place.pixel_area_m2
        self.area_km2 = None if area is None else float(self.alarms.sum()) * area / 1e6
        self.scores: dict[tuple[str, str], ScoreDistribution] = {}
        self.roc: dict[tuple[str, str, str], RocCurve] = {}
        self.outlined: dict[str, dict[str, TargetObject]] = {}
        self.of_objects: dict[tuple[str, str], ObjectScores] = {}
        self.exceedance: dict[tuple[str, str], ExceedanceCurve] = {}

    def add(self, target: DetectionTarget, detector: str, groups: Mapping[str, list[TargetObject]]) -> None:
        """Scores and curves of every subject of a target by one detector."""
        key = map_name(target.name, detector)
        scores = self.maps[key]
        self.outlined.setdefault(key, {}).update({o.name: o for members in groups.values() for o in members})
        noise = AlarmBlocks.of_map(scores, self.alarms)
        if noise.scores.size >= FEWEST_FOR_A_CURVE:
            self.exceedance[target.name, detector] = exceedance_curve(noise)
        thresholds = preset_thresholds(noise.scores, blocks=noise)
        for subject, members in groups.items():
            if (subject, detector) in self.scores:
                raise UsageError(
                    f"two targets give the subject {subject!r}",
                    where="detection.group",
                    mend="let the group hold {target}, the name of the detection target",
                )
            self._subject(subject, detector, members, scores, noise, thresholds)

    def _subject(
        self,
        subject: str,
        detector: str,
        members: Sequence[TargetObject],
        scores: Array,
        noise: AlarmBlocks,
        thresholds: PresetThresholds,
    ) -> None:
        objects = {o.name: scored_pixels(o, self.place) for o in members}
        pixels = np.concatenate([values_on(scores, placed) for placed in objects.values()])
        pixels = pixels[np.isfinite(pixels)]
        if pixels.size == 0:
            raise InputError(f"no valid pixel on the targets of {subject!r}")
        self.scores[subject, detector] = _moments(pixels)
        self.scores[background_of(subject), detector] = _moments(noise.scores)
        by_pixel = empirical_roc(pixels, thresholds, unit="pixel", background_area_km2=self.area_km2)
        self.roc[subject, detector, "pixel"] = with_summary(by_pixel, pixels, noise.scores, blocks=noise)
        halo = self.detection.halo_pixels
        if not halo:  # the model does not know what a halo may catch
            best = object_scores(scores, objects)
            self.of_objects[subject, detector] = ObjectScores(np.array(list(best.values())), tuple(best))
        area, bootstrap = self.place.pixel_area_m2, self.detection.bootstrap
        shared = scores, objects, self.alarms, noise, thresholds, halo, area, bootstrap
        by_object = object_curve(*shared)
        if self.detection.first_detection:
            by_object = replace(by_object, alarms_before_first=alarms_before_first(pixels, noise.scores))
        self.roc[subject, detector, "object"] = by_object
        if halo:
            self.roc[subject, detector, BY_PIXEL] = object_curve(*shared, by_pixel=True)

    def add_pools(self) -> None:
        """Curves of several subjects counted together."""
        for pool in self.detection.pools:
            if any(pool.name == subject for subject, _, _ in self.roc):
                raise UsageError(f"the pool {pool.name!r} bears the name of a subject or of another pool")
            for detector in self.detection.detectors:
                for unit in ("pixel", "object"):
                    lacking = [s for s in pool.subjects if (s, detector, unit) not in self.roc]
                    if lacking:
                        raise UsageError(f"pool {pool.name!r}: no curve of {', '.join(lacking)}")
                    curves = [self.roc[s, detector, unit] for s in pool.subjects]
                    first = [c.alarms_before_first for c in curves if c.alarms_before_first is not None]
                    pooled = replace(pooled_roc(curves), alarms_before_first=min(first, default=None))
                    self.roc[pool.name, detector, unit] = pooled


def _moments(values: Array) -> ScoreDistribution:
    sd = float(np.std(values, ddof=1)) if values.size > 1 else float("nan")
    tail = (
        np.partition(values, values.size - _MOST_SCORES)[-_MOST_SCORES:] if values.size > _MOST_SCORES else values
    )
    return ScoreDistribution(float(np.mean(values)), sd, int(values.size), greatest=np.sort(tail)[::-1])


def anomaly_products(
    detector: str, scores: Array, background: Mask
) -> tuple[dict[tuple[str, str], ScoreDistribution], dict[tuple[str, str], ExceedanceCurve]]:
    """Moments of the background's score and how often it lies above a threshold, by their keys of the products.

    Parameters
    ----------
    scores : (lines, samples), NaN where invalid
    background : (lines, samples) True where pixels count for false alarms
    """
    noise = AlarmBlocks.of_map(scores, background)
    sd = float(np.std(noise.scores, ddof=1)) if noise.scores.size > 1 else float("nan")
    moments = ScoreDistribution(float(np.mean(noise.scores)), sd, int(noise.scores.size))
    curves = {}
    if noise.scores.size >= FEWEST_FOR_A_CURVE:
        curves[ANOMALIES, detector] = exceedance_curve(noise)
    return {(background_of(ANOMALIES), detector): moments}, curves


def anomaly_note(place: Place, detector: str, scores: Array, background: Mask) -> str:
    """The strongest groups of touching pixels above the threshold that the background passes at a low rate.

    The rate is the lowest of 1e-4, 1e-3 and 1e-2 at which the background leaves ten pixels or more: they fix the
    threshold, and belong to the groups themselves where the background is the whole scene.
    """
    noise = scores[background & np.isfinite(scores)]
    level = next((p for p in ANOMALY_LEVELS if p * noise.size >= LEAST_EXPECTED_ALARMS), None)
    if level is None:
        return f"{detector}: {noise.size} background pixels are too few for a threshold of anomalies"
    threshold = float(np.sort(noise)[noise.size - 1 - int(level * noise.size)])
    labels, count = objects(np.nan_to_num(scores, nan=-np.inf) > threshold)
    if not count:
        return f"{detector}: no pixel beyond {threshold:.4g}, which {level:g} of the background exceeds"
    inside = labels > 0
    best = np.full(count + 1, -np.inf)
    np.maximum.at(best, labels[inside], scores[inside])
    sizes = np.bincount(labels[inside], minlength=count + 1)
    strongest = np.argsort(-best[1:], kind="stable")[:MOST_NAMED] + 1
    words = [_in_words(place, scores, labels == number, int(sizes[number])) for number in strongest]
    more = f"; and {count - MOST_NAMED} weaker" if count > MOST_NAMED else ""
    return (
        f"{detector}: {count} anomalies, groups of touching pixels beyond {threshold:.4g}, which {level:g} of the "
        f"background exceeds: {'; '.join(words)}{more}"
    )


def _in_words(place: Place, scores: Array, group: Mask, size: int) -> str:
    line, sample = (int(i) for i in np.unravel_index(np.argmax(np.where(group, scores, -np.inf)), scores.shape))
    where = f"line {line}, sample {sample}"
    transform = place.cube.transform
    if transform is not None:
        x, y = transform @ (sample + 0.5, line + 0.5)
        where += f" ({x:.2f}, {y:.2f})"
    return f"{where}: {scores[line, sample]:.4g}, {size} pixel{'' if size == 1 else 's'}"
