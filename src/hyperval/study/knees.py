"""Where a curve bends most."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

Array = npt.NDArray[np.float64]
LEAST_POINTS = 5
_FINE = 2001
_FLAT = 1e-6  # of the output: below it nothing bends


@dataclass(frozen=True)
class KneePoint:
    """The knee of one curve: its place, the curve and its curvature there; NaN with a reason where none is."""

    x: float
    y: float
    curvature: float
    reason: str = ""


def knee(
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    *,
    logarithmic: bool = False,
    bend: Literal["any", "concave", "convex"] = "any",
) -> KneePoint:
    """The point of greatest curvature of y(x) once both axes run from 0 to 1.

    kappa = |v''| / (1 + v'^2)^(3/2) of v(u), u = (x - x_0)/(x_1 - x_0) (of log x where ``logarithmic``) and
    v = (y - y_min)/(y_max - y_min), along the cubic spline through the points.  That is the knee in the sense of
    Satopaa et al., "Finding a kneedle in a haystack", ICDCS Workshops 2011, section II: the curvature is made
    independent of the units by the normalisation, and so depends on the ends of the range, which are stated with
    it.

    Parameters
    ----------
    x, y : (n,), n of 5 or more, x rising
    bend : "concave" looks at v'' < 0 alone (a rising curve levels off), "convex" at v'' > 0

    Examples
    --------
    >>> x = np.linspace(0.1, 10.0, 50)
    >>> round(knee(x, 1.0 - np.exp(-x), bend="concave").x, 1)
    2.8
    """
    at, value = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    finite = np.isfinite(value)
    at, value = at[finite], value[finite]
    nothing = np.nan, np.nan, np.nan
    if at.size < LEAST_POINTS:
        return KneePoint(*nothing, f"{at.size} points; a knee needs {LEAST_POINTS}")
    span = float(np.ptp(value))
    if span <= _FLAT * max(1.0, float(np.abs(value).max())):
        return KneePoint(*nothing, "the curve is flat")
    scaled = np.log(at) if logarithmic else at
    u = (scaled - scaled[0]) / (scaled[-1] - scaled[0])
    spline = CubicSpline(u, (value - value.min()) / span)
    fine = np.linspace(0.0, 1.0, _FINE)
    sign = {"any": 0.0, "concave": -1.0, "convex": 1.0}[bend]
    second = spline(fine, 2)
    second = np.abs(second) if sign == 0.0 else np.maximum(sign * second, 0.0)
    curvature = second / (1.0 + spline(fine, 1) ** 2) ** 1.5
    if not curvature.any():
        return KneePoint(*nothing, f"no part of the curve is {bend}")
    # A parabola through the three values around the greatest: between the points of the fine grid.
    k = int(np.argmax(curvature))
    if k in (0, _FINE - 1):
        return KneePoint(*nothing, "the curve bends most at an end of the range")
    a, b, c = curvature[k - 1 : k + 2]
    shift = 0.5 * (a - c) / (a - 2.0 * b + c) if a - 2.0 * b + c < 0 else 0.0
    best = fine[k] + shift * (fine[1] - fine[0])
    where = scaled[0] + best * (scaled[-1] - scaled[0])
    return KneePoint(
        float(np.exp(where) if logarithmic else where), float(value.min() + span * spline(best)), float(b)
    )
