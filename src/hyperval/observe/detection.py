"""Filters, scores and detection curves of one collection."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.collection import AreaCheck, Detection, DetectionTarget
from hyperval.errors import InputError, UsageError
from hyperval.imagery.truth import TargetMasks, TargetObject, all_pixels
from hyperval.observe.bands import usable_bands
from hyperval.observe.object_roc import object_curve
from hyperval.observe.place import IMAGE, SCENE, Place
from hyperval.prediction.inputs import Sources
from hyperval.processing.blas import single_blas_thread
from hyperval.processing.detectors import (
    ANOMALY_DETECTORS,
    WITHOUT_COVARIANCE,
    pixel_detector,
    whitener_of,
)
from hyperval.processing.elm import EmpiricalLine
from hyperval.processing.exceedance import FEWEST_FOR_A_CURVE, exceedance_curve
from hyperval.processing.filters import PositiveDefinite
from hyperval.processing.local_scores import LocalWindow, score_cube_locally
from hyperval.processing.objects import (
    Placed,
    footprint,
    footprint_sums,
    object_scores,
    placed_with_halo,
    values_on,
)
from hyperval.processing.pixel_scores import PixelDetector, score_cube
from hyperval.processing.roc import empirical_roc, pooled_roc, with_summary
from hyperval.processing.sample import SampleStatistics, statistics_of
from hyperval.products import Abundance, ExceedanceCurve, ObjectScores, RocCurve, ScoreDistribution, background_of
from hyperval.progress import watch_lines

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

BACKGROUND = "detector background"
# Below this many pixels for each band a sample covariance is shrunk (Ledoit & Wolf 2004).
FEW_PIXELS_PER_BAND = 3
# Names in braces are replaced as they stand: str.format would take widths that fill the memory.
_BRACES = re.compile(r"\{([^{}]*)\}")


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


def in_reflectance(statistics: SampleStatistics, elm: EmpiricalLine | None) -> tuple[Array, Array]:
    """Mean (B,) and covariance (B, B) after the empirical line; as they stand without one."""
    if elm is None:
        return statistics.mean, statistics.covariance
    return elm.reflectance(statistics.mean), statistics.covariance / np.outer(elm.gain, elm.gain)


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
    measured : statistics of the regions and of :data:`BACKGROUND` in the cube's values

    Raises
    ------
    UsageError : names that do not fit, a singular background.
    InputError : target spectra or truth that are missing.
    """
    axis = place.cube.axis
    sources = Sources(axis, {}, resolve)
    spectra = {t.name: sources.spectrum(t.spectrum, t.name).mean for t in detection.targets}
    background, shrinkage = measured[BACKGROUND], 0.0
    bands, left_out = usable_bands(detection, axis, list(spectra.values()), elm, background)
    notes = [f"detectors use {int(bands.sum())} of {len(axis)} bands", *left_out]
    if background.n < FEW_PIXELS_PER_BAND * int(bands.sum()):
        # Few, so they fit in memory; the pass has not summed the fourth moment.
        few = statistics_of(_complete(place.cube.pixels(place.background(detection.background))))
        background, shrinkage = replace(background, covariance=few.shrunk_covariance), few.shrinkage
        notes.append(f"{background.n} background pixels are few: covariance shrunk by {shrinkage:.3g}")
    mean, covariance = in_reflectance(background, elm)
    with single_blas_thread():  # small matrices: more threads only wait for each other
        inverted = None
        if not set(detection.detectors) <= set(WITHOUT_COVARIANCE):
            inverted = PositiveDefinite(covariance[np.ix_(bands, bands)])
            notes.append(f"condition number of the background matrix at unit diagonal: {inverted.condition:.3g}")
        for name in detection.undesired:
            place.region(name)  # refuses a name that no region has
        undesired = [in_reflectance(measured[name], elm)[0][bands] for name in detection.undesired]
        detectors: dict[str, PixelDetector] = {}
        looked_for: dict[str, tuple[str, Array | None]] = {}
        for target in detection.targets:
            for name in detection.detectors:
                key = name if name in ANOMALY_DETECTORS else f"{target.name}-{name}"
                if key not in detectors:
                    looked_for[key] = name, None if name in ANOMALY_DETECTORS else spectra[target.name][bands]
                    detectors[key] = pixel_detector(
                        name, spectra[target.name][bands], mean[bands], inverted, np.array(undesired)
                    )
        whitener = None
        local = detection.local_window
        if inverted is not None and (local or any(d.quadratic == "distance" for d in detectors.values())):
            whitener = whitener_of(mean[bands], inverted)
    watch = watch_lines("scores", place.cube.bytes_per_line, place.cube.lines, show=show_progress)
    if local is not None and whitener is not None:
        window = LocalWindow(local.outer_pixels, local.inner_pixels)
        surroundings = place.background([IMAGE] if IMAGE in detection.background else [SCENE])
        found_here = score_cube_locally(
            place.cube, looked_for, whitener, window, surroundings, elm, bands, needed=axis.good, watch=watch
        )
        maps = found_here.maps
        notes.append(
            f"background means from windows of {window.outer} less {window.inner} pixels; "
            f"{found_here.without_surroundings} pixels without surroundings take the mean of the background. "
            "Predicted scores are against that mean throughout"
        )
    else:
        maps = score_cube(place.cube, detectors, elm, bands, whitener=whitener, needed=axis.good, watch=watch)

    alarms = place.background(detection.false_alarms)
    area_km2 = None if place.pixel_area_m2 is None else float(alarms.sum()) * place.pixel_area_m2 / 1e6
    scores: dict[tuple[str, str], ScoreDistribution] = {}
    roc: dict[tuple[str, str, str], RocCurve] = {}
    outlined: dict[str, dict[str, TargetObject]] = {}
    of_objects: dict[tuple[str, str], ObjectScores] = {}
    exceedance: dict[tuple[str, str], ExceedanceCurve] = {}
    for target in detection.targets:
        groups = target_groups(place.targets, target, detection.group)
        for detector in detection.detectors:
            key = detector if detector in ANOMALY_DETECTORS else f"{target.name}-{detector}"
            found = maps[key]
            outlined.setdefault(key, {}).update({o.name: o for members in groups.values() for o in members})
            noise = found[alarms]
            noise = noise[np.isfinite(noise)]
            if noise.size >= FEWEST_FOR_A_CURVE:
                exceedance[target.name, detector] = exceedance_curve(found, alarms)
            for subject, members in groups.items():
                if (subject, detector) in scores:
                    raise UsageError(
                        f"two targets give the subject {subject!r}",
                        where="detection.group",
                        mend="let the group hold {target}, the name of the detection target",
                    )
                pixels = np.concatenate([values_on(found, scored_pixels(o, place)) for o in members])
                pixels = pixels[np.isfinite(pixels)]
                if pixels.size == 0:
                    raise InputError(f"no valid pixel on the targets of {subject!r}")
                scores[subject, detector] = _moments(pixels)
                scores[background_of(subject), detector] = _moments(noise)
                by_pixel = empirical_roc(pixels, noise, unit="pixel", background_area_km2=area_km2)
                roc[subject, detector, "pixel"] = with_summary(by_pixel, pixels, noise)
                if not detection.halo_pixels:  # the model does not know what a halo may catch
                    best = object_scores(found, {o.name: scored_pixels(o, place) for o in members})
                    of_objects[subject, detector] = ObjectScores(np.array(list(best.values())), tuple(best))
                roc[subject, detector, "object"] = object_curve(
                    found,
                    {o.name: scored_pixels(o, place) for o in members},
                    alarms,
                    detection.halo_pixels,
                    place.pixel_area_m2,
                    draws=detection.bootstrap.draws,
                    seed=detection.bootstrap.seed,
                )
    for pool in detection.pools:
        if any(pool.name == subject for subject, _, _ in roc):
            raise UsageError(f"the pool {pool.name!r} bears the name of a subject or of another pool")
        for detector in detection.detectors:
            for unit in ("pixel", "object"):
                curves = [roc[s, detector, unit] for s in pool.subjects if (s, detector, unit) in roc]
                if len(curves) < len(pool.subjects):
                    lacking = [s for s in pool.subjects if (s, detector, unit) not in roc]
                    raise UsageError(f"pool {pool.name!r}: no curve of {', '.join(lacking)}")
                roc[pool.name, detector, unit] = pooled_roc(curves)
    areas: dict[tuple[str, str], Abundance] = {}
    nominal: dict[tuple[str, str], float] = {}
    for check in detection.areas:
        found_areas, known = _areas(place, detection, check, maps)
        areas.update(found_areas)
        nominal.update(known)
    outlines = {key: TargetMasks(list(objects.values())) for key, objects in outlined.items()}
    return Detected(
        maps, outlines, scores, roc, areas, detectors, bands, nominal, tuple(notes), of_objects, exceedance,
        shrinkage,
    )  # fmt: skip


def scored_pixels(target: TargetObject, place: Place) -> Placed:
    """The pixels of an object that are scored, in their window."""
    if place.target_pixels == "touched" or target.centre_pixel is None:
        return target.placed
    return target.centre_pixel, np.ones((1, 1), bool)


def target_groups(
    objects: Sequence[TargetObject], target: DetectionTarget, form: str
) -> dict[str, list[TargetObject]]:
    """Objects of the target's material by subject name, in the order of the truth."""
    out: dict[str, list[TargetObject]] = {}
    for item in objects:
        if item.material != target.material:
            continue
        words = {"name": item.name, "material": item.material, **item.attributes, "target": target.name}
        subject = _subject(form, words)
        out.setdefault(subject, []).append(item)
    if not out:
        known = sorted({o.material for o in objects})
        raise UsageError(
            f"target {target.name!r}: the truth has no object of material {target.material!r}",
            expected="one of " + ", ".join(known) if known else "a truth with targets",
        )
    return out


def _subject(form: str, words: Mapping[str, str]) -> str:
    unknown = [word for word in _BRACES.findall(form) if word not in words]
    if unknown:
        raise UsageError(
            f"detection.group {form!r} does not fit the truth: no {unknown[0]!r}",
            expected="names in braces out of " + ", ".join(sorted(words)),
        )
    return _BRACES.sub(lambda found: words[found[1]], form)


def _window(image: npt.NDArray[Any], corner: tuple[int, int], like: Mask) -> npt.NDArray[Any]:
    """The part of an image under a window of the size of ``like``."""
    return image[corner[0] : corner[0] + like.shape[0], corner[1] : corner[1] + like.shape[1]]


def _complete(pixels: Array) -> Array:
    """The pixels (n, B) that are finite in every band, as the statistics of regions take them."""
    return pixels[np.isfinite(pixels).all(axis=1)]


def _moments(values: Array) -> ScoreDistribution:
    sd = float(np.std(values, ddof=1)) if values.size > 1 else float("nan")
    return ScoreDistribution(float(np.mean(values)), sd, int(values.size))


def _areas(
    place: Place, detection: Detection, check: AreaCheck, maps: Mapping[str, Array]
) -> tuple[dict[tuple[str, str], Abundance], dict[tuple[str, str], float]]:
    """Sum of scores over each object times the pixel area, and the area that the truth states.

    The uncertainty is the spread of the same sum over background that has the object's footprint.  Both are
    means over the objects of a subject.
    """
    if place.pixel_area_m2 is None:
        raise UsageError("areas need the ground area of a pixel; the cube is not georeferenced")
    target = next((t for t in detection.targets if t.name == check.target), None)
    if target is None or check.detector not in detection.detectors:
        raise UsageError(f"areas: no score map of target {check.target!r} with detector {check.detector!r}")
    scores = maps[f"{check.target}-{check.detector}"]
    everything = all_pixels(place.targets, place.cube.shape)
    out: dict[tuple[str, str], Abundance] = {}
    nominal: dict[tuple[str, str], float] = {}
    # A background of "image" holds the targets too; their sums say nothing of the error.
    counted = place.background(detection.background) & ~place.near_targets
    spread: dict[tuple[tuple[int, ...], bytes], float] = {}  # variance of the sum, by shape of the footprint
    for subject, members in target_groups(place.targets, target, detection.group).items():
        total = 0.0
        pixels = 0
        variance = 0.0
        for item in members:
            corner, grown = placed_with_halo(item.placed, check.margin_pixels, scores.shape)
            summed = grown & (~_window(everything, corner, grown) | _window(item.mask, corner, grown))
            total += float(np.nansum(_window(scores, corner, grown)[summed]))
            pixels += int(summed.sum())
            shape = footprint(summed)
            key = shape.shape, shape.tobytes()
            if key not in spread:
                elsewhere = footprint_sums(scores, shape, ~counted)
                spread[key] = float(np.var(elsewhere, ddof=1)) if elsewhere.size > 1 else float("nan")
            variance += spread[key]
        area = place.pixel_area_m2
        out[subject, check.detector] = Abundance(
            total / len(members) * area, float(np.sqrt(variance)) / len(members) * area, pixels
        )
        stated = float(np.mean([o.area_m2 for o in members]))
        if np.isfinite(stated):  # a truth may say where the objects are and not how large
            nominal[subject, check.detector] = stated
    return out, nominal
