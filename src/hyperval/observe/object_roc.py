"""The curve of whole objects, with the background scored by the same footprint."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.objects import Placed, footprint, footprint_maxima, object_scores
from hyperval.processing.roc import empirical_roc, with_summary
from hyperval.products import RocCurve

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


def object_curve(
    scores: Array,
    objects: Mapping[str, Placed],
    alarms: Mask,
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
    draws, seed : of the bootstrap over objects

    Raises
    ------
    UsageError : the footprint fits nowhere on the background.
    """
    best = np.array(list(object_scores(scores, objects, halo).values()))
    best = best[np.isfinite(best)]
    if halo == 0:
        noise = scores[alarms]
        noise, looked_at = noise[np.isfinite(noise)], int(np.count_nonzero(alarms))
    else:
        parts, looked_at = [], 0
        shapes = [footprint(part, halo) for _, part in objects.values()]
        # The placements of one shape count once, however many objects have it: they are the same pixels.
        for shape in {(s.shape, s.tobytes()): s for s in shapes}.values():
            parts.append(footprint_maxima(scores, shape, ~alarms))
            looked_at += parts[-1].size * shape.size
        noise = np.concatenate(parts)
        if noise.size == 0:
            raise UsageError(
                f"with a halo of {halo} pixels no footprint of the targets fits on the background",
                where="detection.halo_pixels",
            )
    area = None if pixel_area_m2 is None else looked_at * pixel_area_m2 / 1e6
    curve = empirical_roc(best, noise, unit="object", background_area_km2=area)
    return with_summary(curve, best, noise, draws=draws, rng=np.random.default_rng(seed))
