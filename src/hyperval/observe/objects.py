"""The objects of the truth: which subject holds them, their curves, and their areas by the sum of their scores."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.collection import AreaCheck, Bootstrap, Detection, DetectionTarget
from hyperval.errors import UsageError
from hyperval.imagery.truth import TargetObject, all_pixels
from hyperval.observe.place import Place
from hyperval.processing.alarm_blocks import AlarmBlocks, block_side
from hyperval.processing.objects import (
    Placed,
    footprint,
    footprint_maxima,
    footprint_sums,
    object_scores,
    placed_with_halo,
)
from hyperval.processing.roc import PresetThresholds, empirical_roc, preset_thresholds, with_summary
from hyperval.products import Abundance, RocCurve

# Names in braces are replaced as they stand: str.format would take widths that fill the memory.
_BRACES = re.compile(r"\{([^{}]*)\}")
Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Areas = dict[tuple[str, str], Abundance]
Nominal = dict[tuple[str, str], float]


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
    return _BRACES.sub(lambda match: words[match[1]], form)


def object_curve(
    scores: Array,
    objects: Mapping[str, Placed],
    alarms: Mask,
    blocks: AlarmBlocks,
    thresholds: PresetThresholds,
    halo: int,
    pixel_area_m2: float | None,
    bootstrap: Bootstrap,
    *,
    by_pixel: bool = False,
) -> RocCurve:
    """ROC of objects, each with the greatest score over its pixels and ``halo`` pixels around them.

    Without a halo a false alarm is a background pixel.  With one it is a placement of an object's footprint on
    the background, where noise has as many chances as it has on the object; objects of different shapes each
    bring their own placements, objects of one shape the same.

    ``by_pixel``: a false alarm is every pixel outside the halos.  This is how the MUUFL Gulfport collection is
    scored (Bullwinkle).  It favours detection: an object has as many chances as its halo has pixels, a false
    alarm one.

    Parameters
    ----------
    scores : (lines, samples), NaN where invalid
    objects : the pixels that are scored, each object in its window
    alarms : (lines, samples) True on the background
    blocks, thresholds : the scores of its valid pixels with their places, and what they say of every curve
    bootstrap : over objects

    Raises
    ------
    UsageError : the footprint fits nowhere on the background.
    """
    best = np.array(list(object_scores(scores, objects, halo).values()))
    best = best[np.isfinite(best)]
    pixels = int(np.count_nonzero(alarms))
    if by_pixel:
        alarms = alarms.copy()
        for placed in objects.values():
            (line, sample), grown = placed_with_halo(placed, halo, scores.shape)
            alarms[line : line + grown.shape[0], sample : sample + grown.shape[1]] &= ~grown
        blocks, pixels = AlarmBlocks.of_map(scores, alarms), int(np.count_nonzero(alarms))
    elif halo:
        blocks, pixels = _placements(scores, objects, alarms, halo)
    if by_pixel or halo:
        thresholds = preset_thresholds(blocks.scores, blocks=blocks)
    area = None if pixel_area_m2 is None else pixels * pixel_area_m2 / 1e6
    curve = empirical_roc(best, thresholds, unit="object", background_area_km2=area)
    rng = np.random.default_rng(bootstrap.seed)
    return with_summary(curve, best, blocks.scores, draws=bootstrap.draws, rng=rng, blocks=blocks)


def _placements(scores: Array, objects: Mapping[str, Placed], alarms: Mask, halo: int) -> tuple[AlarmBlocks, int]:
    """Greatest score of every placement of the objects' footprints on the background, and the pixels looked at."""
    parts, looked_at = [], 0
    shapes = []
    for name, (_, part) in objects.items():
        shapes.append(footprint(part, halo))
        if any(np.greater(shapes[-1].shape, scores.shape)):
            raise UsageError(
                f"the object {name!r} with a halo of {halo} pixels is larger than the image, {scores.shape}",
                where="detection.halo_pixels",
                expected="a halo that leaves background around the object",
            )
    # The placements of one shape count once, however many objects have it: they are the same pixels.
    for shape in {(s.shape, s.tobytes()): s for s in shapes}.values():
        parts.append(footprint_maxima(scores, shape, ~alarms))
        looked_at += parts[-1][0].size * shape.size
    maxima, lines, samples = (np.concatenate(part) for part in zip(*parts, strict=True))
    if maxima.size == 0:
        names = ", ".join(objects)
        raise UsageError(
            f"with a halo of {halo} pixels no footprint of the targets fits on the background ({names})",
            where="detection.halo_pixels",
        )
    # Blocks as large on the ground as those of the pixels.
    return AlarmBlocks.of_places(maxima, lines, samples, block_side(int(np.count_nonzero(alarms)))), looked_at


def target_areas(place: Place, detection: Detection, maps: Mapping[str, Array]) -> tuple[Areas, Nominal]:
    """Areas of every check that is asked for, and those that the truth states [m2], by subject and detector."""
    areas: Areas = {}
    nominal: Nominal = {}
    for check in detection.areas:
        _add_areas(place, detection, check, maps, areas, nominal)
    return areas, nominal


def _add_areas(
    place: Place, detection: Detection, check: AreaCheck, maps: Mapping[str, Array], areas: Areas, nominal: Nominal
) -> None:
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
        areas[subject, check.detector] = Abundance(
            total / len(members) * area, float(np.sqrt(variance)) / len(members) * area, pixels
        )
        stated = float(np.mean([o.area_m2 for o in members]))
        if np.isfinite(stated):  # a truth may say where the objects are and not how large
            nominal[subject, check.detector] = stated


def _window(image: npt.NDArray[Any], corner: tuple[int, int], like: Mask) -> npt.NDArray[Any]:
    """The part of an image under a window of the size of ``like``."""
    return image[corner[0] : corner[0] + like.shape[0], corner[1] : corner[1] + like.shape[1]]
