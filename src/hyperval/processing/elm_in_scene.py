"""Compensation with less than two panels: a line through the origin, and the darkest pixel as the dark panel.

A material of known spectrum that lies in the scene (a colour standard) is a panel like any other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.elm import (
    MINIMUM_GAIN_SNR,
    EmpiricalLine,
    PanelMeasurement,
    refuse_bad_panels,
)

Array = npt.NDArray[np.float64]

_ITERATIONS = 100
_TOLERANCE = 1e-13


def fit_gain(
    panels: Sequence[PanelMeasurement],
    *,
    saturation: npt.ArrayLike | None = None,
    minimum_gain_snr: float = MINIMUM_GAIN_SNR,
) -> EmpiricalLine:
    """The line L = gain rho through the origin, for radiance whose path part is removed or small.

    Of all k it has the least S = sum w (L - k rho)^2 with w = 1/(var L + k^2 var rho); dS/dk = 0 gives
    k = sum w x L / sum w x rho with x = w (rho var L + k L var rho), iterated, and var k = 1/sum w x^2.  One panel
    is enough, and two or more are judged by the reduced chi-square of P - 1 degrees of freedom.  The offset and
    its covariances are 0: that it is none is the assumption.

    Raises
    ------
    UsageError : no panel, reflectance in percent, saturated or dark panels.
    """
    panels = tuple(panels)
    refuse_bad_panels(panels, saturation, least=1)
    rho, u_rho, radiance, variance = (
        np.stack([getattr(p, name) for p in panels])
        for name in ("reflectance", "reflectance_sd", "radiance", "radiance_variance")
    )
    v_rho = u_rho**2
    exact = (variance == 0) & (v_rho == 0)
    if np.any(exact.any(axis=0) & ~exact.all(axis=0)):
        raise UsageError("some panels have an error and others have none")
    none = exact.all(axis=0)
    vy, vx = np.where(none, 1.0, variance), np.where(none, 0.0, v_rho)
    k, var_k, w = _gain(rho, radiance, vx, vy)
    var_k = np.where(none, 0.0, var_k)
    usable = np.isfinite(k) & (k > minimum_gain_snr * np.sqrt(var_k))
    if np.mean(usable) < 0.5:
        raise UsageError(
            f"the gain is below {minimum_gain_snr:g} times its uncertainty in {int((~usable).sum())} of "
            f"{usable.size} bands",
            expected="panels that reflect",
        )
    bands, count = usable.size, len(panels)
    covariance = np.zeros((bands, 2, 2))
    covariance[:, 0, 0] = var_k
    covariance[~usable] = np.nan
    residuals = np.where(usable, radiance - k * rho, np.nan)
    reduced = np.full(bands, np.nan)
    if count > 1:
        reduced = np.where(usable & ~none, np.sum(w * residuals**2, axis=0) / (count - 1), np.nan)
    left = None
    if count > 1:
        left = np.full(rho.shape, np.nan)
        for i in range(count):
            rest = np.arange(count) != i
            part, var_part, _ = _gain(rho[rest], radiance[rest], vx[rest], vy[rest])
            # Without panel i the others may be too dark to fix a gain: that band then has no leave-one-out error.
            clear = usable & np.isfinite(part) & (part > minimum_gain_snr * np.sqrt(np.where(none, 0.0, var_part)))
            left[i, clear] = radiance[i, clear] / part[clear] - rho[i, clear]
    return EmpiricalLine(
        np.where(usable, k, np.nan), np.where(usable, 0.0, np.nan), covariance, residuals, reduced, left, usable,
        tuple(p.name for p in panels), 1,
    )  # fmt: skip


def _gain(rho: Array, radiance: Array, vx: Array, vy: Array) -> tuple[Array, Array, Array]:
    """(B,) gain of panels (P, B), its variance, and the weights (P, B) of :func:`fit_gain`."""
    with np.errstate(divide="ignore", invalid="ignore"):
        k = np.sum(rho * radiance, axis=0) / np.sum(rho**2, axis=0)
        for _ in range(_ITERATIONS):
            w = 1.0 / (vy + k**2 * vx)
            x = w * (rho * vy + k * radiance * vx)
            new = np.sum(w * x * radiance, axis=0) / np.sum(w * x * rho, axis=0)
            done = np.all(~(np.abs(new - k) > _TOLERANCE * np.abs(new)))
            k = new
            if done:
                break
        w = 1.0 / (vy + k**2 * vx)
        x = w * (rho * vy + k * radiance * vx)
        return k, 1.0 / np.sum(w * x**2, axis=0), w


def darkest_pixel_panel(
    darkest: npt.ArrayLike,
    noise_variance: npt.ArrayLike,
    reflectance: float = 0.0,
    reflectance_sd: float = 0.01,
) -> PanelMeasurement:
    """The darkest radiance of the scene in each band (B,) as a panel of low, assumed reflectance.

    The least of many noisy pixels lies below the darkest surface by some standard deviations of the noise; the
    variance of the panel is therefore that of one pixel's noise, and the assumed reflectance has its own
    uncertainty.  The darkest pixels of different bands may be different ones.

    Raises
    ------
    UsageError : a darkest radiance that is not finite or negative beyond three standard deviations of noise.
    """
    least, noise = np.asarray(darkest, dtype=float), np.asarray(noise_variance, dtype=float)
    below = least < -3.0 * np.sqrt(noise)
    if not np.all(np.isfinite(least)) or np.any(below):
        raise UsageError(
            "the darkest radiance of the scene is negative or unknown in "
            f"{int(np.sum(below | ~np.isfinite(least)))} bands",
            mend="state the ignore value of the cube, or leave those bands out",
        )
    each = np.ones_like(least)
    return PanelMeasurement("darkest pixel", reflectance * each, reflectance_sd * each, least, noise, 1)
