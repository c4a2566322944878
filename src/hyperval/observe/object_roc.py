"""The curve of whole objects, with the background scored by the same footprint."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.alarm_blocks import AlarmBlocks, block_side
from hyperval.processing.objects import Placed, footprint, footprint_maxima, object_scores, placed_with_halo
from hyperval.processing.roc import empirical_roc, with_summary
from hyperval.products import RocCurve

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


def object_curve(
    scores: Array,
    objects: Mapping[str, Placed],
    alarms: Mask,
    blocks: AlarmBlocks,
    halo: int,
    pixel_area_m2: float | None,
    *,
    draws: int = 1000,
    seed: int = 0,
) -> RocCurve:
    """ROC of objects, each with the greatest score over its pixels and ``halo`` pixels around them.

    Without a halo a false alarm is a background pixel.  With one it is a placement of an object's footprint on
    the background, where noise has as many chances as it has on the object; objects of different shapes each
    bring their own placements, objects of one shape the same.

    Parameters
    ----------
    scores : (lines, samples), NaN where invalid
    objects : the pixels that are scored, each object in its window
    alarms : (lines, samples) True on the background
    blocks : the scores of its valid pixels with their places
    draws, seed : of the bootstrap over objects

    Raises
    ------
    UsageError : the footprint fits nowhere on the background.
    """
    best = np.array(list(object_scores(scores, objects, halo).values()))
    best = best[np.isfinite(best)]
    if halo == 0:
        looked_at = int(np.count_nonzero(alarms))
    else:
        blocks, looked_at = _placements(scores, objects, alarms, halo)
    area = None if pixel_area_m2 is None else looked_at * pixel_area_m2 / 1e6
    noise = blocks.scores
    curve = empirical_roc(best, noise, unit="object", background_area_km2=area, blocks=blocks)
    return with_summary(curve, best, noise, draws=draws, rng=np.random.default_rng(seed), blocks=blocks)


def alarms_by_pixel(
    scores: Array,
    objects: Mapping[str, Placed],
    alarms: Mask,
    halo: int,
    pixel_area_m2: float | None,
    *,
    draws: int = 1000,
    seed: int = 0,
) -> RocCurve:
    """ROC of objects by the greatest score in their halos, where every pixel outside the halos is a false alarm.

    This is how the MUUFL Gulfport collection is scored (Bullwinkle).  It favours detection: an object has as many
    chances as its halo has pixels, a false alarm one; :func:`object_curve` gives both the same.  Parameters as
    there.
    """
    best = np.array(list(object_scores(scores, objects, halo).values()))
    best = best[np.isfinite(best)]
    counted = alarms.copy()
    for placed in objects.values():
        (line, sample), grown = placed_with_halo(placed, halo, scores.shape)
        counted[line : line + grown.shape[0], sample : sample + grown.shape[1]] &= ~grown
    blocks = AlarmBlocks.of_map(scores, counted)
    area = None if pixel_area_m2 is None else int(np.count_nonzero(counted)) * pixel_area_m2 / 1e6
    curve = empirical_roc(best, blocks.scores, unit="object", background_area_km2=area, blocks=blocks)
    return with_summary(curve, best, blocks.scores, draws=draws, rng=np.random.default_rng(seed), blocks=blocks)


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
