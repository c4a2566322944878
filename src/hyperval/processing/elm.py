"""Empirical line method on measured panels: radiance to reflectance with its uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.line_fit import fit_line

Array = npt.NDArray[np.float64]

MINIMUM_CONTRAST = 0.1  # reflectance between the darkest and the brightest panel
MINIMUM_GAIN_SNR = 5.0  # gain over its standard uncertainty
PERCENT_LIMIT = 1.5  # no panel reflects more; above it the numbers are percent


@dataclass(frozen=True)
class PanelMeasurement:
    """One panel seen in the field and in the image.

    Attributes
    ----------
    name : panel name
    reflectance, reflectance_sd : (B,) field reflectance and its standard uncertainty [1]
    radiance, radiance_variance : (B,) mean radiance of the panel's pixels [uW cm-2 sr-1 nm-1] and the
        variance of the error of that mean
    n : pixels behind the mean
    """

    name: str
    reflectance: Array
    reflectance_sd: Array
    radiance: Array
    radiance_variance: Array
    n: int

    def __post_init__(self) -> None:
        fields = ("reflectance", "reflectance_sd", "radiance", "radiance_variance")
        bands = np.shape(self.reflectance)
        for name in fields:
            value = np.asarray(getattr(self, name), dtype=float)
            if value.ndim != 1 or value.shape != bands:
                raise UsageError(f"panel {self.name!r}: {name} has shape {value.shape}, reflectance {bands}")
            if not np.all(np.isfinite(value)):
                raise UsageError(f"panel {self.name!r}: {name} holds NaN or infinity", mend="leave those bands out")
            object.__setattr__(self, name, value)
        if np.any(self.reflectance_sd < 0) or np.any(self.radiance_variance < 0):
            raise UsageError(f"panel {self.name!r}: an uncertainty is negative")
        if self.n < 1:
            raise UsageError(f"panel {self.name!r} has no pixels")


@dataclass(frozen=True)
class EmpiricalLine:
    """The line L = offset + gain rho of each band.

    Attributes
    ----------
    gain, offset : (B,) [uW cm-2 sr-1 nm-1]; NaN in bands that are not ``usable``
    covariance : (B, 2, 2) of (gain, offset) in that order
    residuals : (P, B) collected less fitted radiance by panel
    reduced_chi2 : (B,) chi-square over P - 2; NaN for two panels, which any line fits
    leave_one_out : (P, B) reflectance error of each panel under the line of the others, an extrapolation for
        the darkest and the brightest; None below 3 panels
    usable : (B,) False where the panels do not differ enough, or are too noisy, to fix a gain
    panels : names, in the order of the residuals
    parameters : fitted in each band: 2, or 1 for a line through the origin
    """

    gain: Array
    offset: Array
    covariance: Array
    residuals: Array
    reduced_chi2: Array
    leave_one_out: Array | None
    usable: npt.NDArray[np.bool_]
    panels: tuple[str, ...]
    parameters: int = 2

    def reflectance(self, radiance: npt.ArrayLike) -> Array:
        """(..., B) reflectance (L - b)/k of a radiance (..., B)."""
        return (np.asarray(radiance, dtype=float) - self.offset) / self.gain

    def radiance(self, reflectance: npt.ArrayLike) -> Array:
        """(..., B) radiance b + k rho of a reflectance (..., B)."""
        return np.asarray(self.offset + self.gain * np.asarray(reflectance, dtype=float))


def fit_elm(
    panels: Sequence[PanelMeasurement],
    *,
    saturation: npt.ArrayLike | None = None,
    minimum_contrast: float = MINIMUM_CONTRAST,
    minimum_gain_snr: float = MINIMUM_GAIN_SNR,
) -> EmpiricalLine:
    """Line through all panels, band by band, with errors in reflectance and in radiance.

    Exact for two panels; more are weighted by York's method (:func:`hyperval.processing.line_fit.fit_line`).
    A band whose panels differ by less than ``minimum_contrast`` or whose gain is below
    ``minimum_gain_snr`` times its uncertainty gets NaN; where that is more than half of the bands the panels
    are refused.

    Parameters
    ----------
    saturation : scalar or (B,) radiance at which the detector is full; a panel that reaches it is refused

    Raises
    ------
    UsageError : one panel, reflectance in percent, saturated panels, equal panels (two bright ones fit
        anything), or panels too noisy to fix a line.
    """
    panels = tuple(panels)
    names = tuple(p.name for p in panels)
    refuse_bad_panels(panels, saturation)
    rho, u_rho, radiance, variance = (
        np.stack([getattr(p, name) for p in panels])
        for name in ("reflectance", "reflectance_sd", "radiance", "radiance_variance")
    )
    contrast = rho.max(axis=0) - rho.min(axis=0)
    flat = contrast < minimum_contrast
    if np.mean(flat) > 0.5:
        raise UsageError(
            f"the panels {', '.join(names)} differ by {np.median(contrast):.3g} in reflectance (median over bands)",
            expected=f"at least {minimum_contrast:g}",
            mend="add a darker or brighter panel",
        )
    fit = fit_line(rho[:, ~flat], radiance[:, ~flat], u_rho[:, ~flat] ** 2, variance[:, ~flat])
    noisy = fit.slope <= minimum_gain_snr * np.sqrt(fit.covariance[:, 0, 0])
    if np.mean(noisy) > 0.5:
        raise UsageError(
            f"the gain is below {minimum_gain_snr:g} times its uncertainty "
            f"in {int(noisy.sum())} of {noisy.size} bands",
            expected="panels whose radiances differ clearly, the brighter one being the more reflective",
            mend="use larger regions, check which panel is which, or give the panel errors as they are",
        )
    usable = ~flat
    usable[usable] = ~noisy
    bands = flat.size
    line = EmpiricalLine(
        gain=_spread(fit.slope[~noisy], usable, (bands,)),
        offset=_spread(fit.intercept[~noisy], usable, (bands,)),
        covariance=_spread(fit.covariance[~noisy], usable, (bands, 2, 2)),
        residuals=_spread(fit.residuals.T[~noisy], usable, (bands, len(panels))).T,
        reduced_chi2=_spread(fit.reduced_chi2[~noisy], usable, (bands,)),
        leave_one_out=None,
        usable=usable,
        panels=names,
    )
    if len(panels) < 3:
        return line
    errors = np.full(rho.shape, np.nan)
    for i in range(len(panels)):
        rest = np.arange(len(panels)) != i
        # Without panel i the others may no longer differ: that band then has no leave-one-out error.
        clear = usable & (rho[rest].max(axis=0) - rho[rest].min(axis=0) >= minimum_contrast)
        part = fit_line(
            rho[rest][:, clear], radiance[rest][:, clear], u_rho[rest][:, clear] ** 2, variance[rest][:, clear]
        )
        errors[i, clear] = (radiance[i, clear] - part.intercept) / part.slope - rho[i, clear]
    return EmpiricalLine(**{**line.__dict__, "leave_one_out": errors})


def refuse_bad_panels(
    panels: tuple[PanelMeasurement, ...], saturation: npt.ArrayLike | None, least: int = 2
) -> None:
    """Raise UsageError for fewer panels than ``least``, reflectances that are none, and saturated panels."""
    if len(panels) < least:
        raise UsageError(
            f"{len(panels)} panel for an empirical line", expected="two or more" if least == 2 else "one or more"
        )
    if len({p.reflectance.size for p in panels}) > 1:
        raise UsageError("the panels have different numbers of bands")
    for p in panels:
        if np.any(p.reflectance > PERCENT_LIMIT):
            raise UsageError(
                f"panel {p.name!r} has a reflectance of {p.reflectance.max():.4g}",
                expected="a fraction, 0 to 1",
                mend="divide percent by 100",
            )
        if np.any(p.reflectance < -0.05):
            raise UsageError(f"panel {p.name!r} has a reflectance of {p.reflectance.min():.3g}")
        if saturation is not None:
            full = p.radiance >= np.asarray(saturation, dtype=float)
            if np.any(full):
                raise UsageError(
                    f"panel {p.name!r} is saturated in {int(full.sum())} bands "
                    f"(first: band {int(full.argmax()) + 1})",
                    mend="leave the panel or those bands out",
                )


def _spread(values: Array, usable: npt.NDArray[np.bool_], shape: tuple[int, ...]) -> Array:
    full = np.full(shape, np.nan)
    full[usable] = values
    return full
