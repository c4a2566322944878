"""Area of target objects from the sum of their scores."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.collection import AreaCheck, Detection
from hyperval.errors import UsageError
from hyperval.imagery.truth import all_pixels
from hyperval.observe.place import Place
from hyperval.observe.subjects import target_groups
from hyperval.processing.objects import footprint, footprint_sums, placed_with_halo
from hyperval.products import Abundance

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Areas = dict[tuple[str, str], Abundance]
Nominal = dict[tuple[str, str], float]


def target_areas(place: Place, detection: Detection, maps: Mapping[str, Array]) -> tuple[Areas, Nominal]:
    """Areas of every check that is asked for, and those that the truth states [m2], by subject and detector."""
    areas: Areas = {}
    nominal: Nominal = {}
    for check in detection.areas:
        measured, stated = _areas(place, detection, check, maps)
        areas.update(measured)
        nominal.update(stated)
    return areas, nominal


def _areas(
    place: Place, detection: Detection, check: AreaCheck, maps: Mapping[str, Array]
) -> tuple[Areas, Nominal]:
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
    out: Areas = {}
    nominal: Nominal = {}
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


def _window(image: npt.NDArray[Any], corner: tuple[int, int], like: Mask) -> npt.NDArray[Any]:
    """The part of an image under a window of the size of ``like``."""
    return image[corner[0] : corner[0] + like.shape[0], corner[1] : corner[1] + like.shape[1]]
