"""Empirical line method on measured panels: radiance to reflectance with its uncertainty.

A straight line with errors in both coordinates, for many bands at once.

Error of an empirical line with its correlation between bands.

Compensation with less than two panels: a line through the origin, and the darkest pixel as the dark panel.

A material of known spectrum that lies in the scene (a colour standard) is a panel like any other.

The empirical line method on statistics: two panels, without noise (processing step before 3.21).

The source gives no number to these formulas: k_i = (L_i(high) - L_i(low)) / (rho_high - rho_low),
b_i = L_i(low) - k_i rho_low, rho^ = (L - b) / k, Sigma^_ij = Sigma_L,ij / (k_i k_j), with panels of
reflectance 0.1 and 0.6.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy import special
from scipy.special import ndtr, ndtri

from hyperval.errors import UsageError
from hyperval.products import EstimatedPart

Array = npt.NDArray[np.float64]
_ITERATIONS = 100
_TOLERANCE = 1e-13


@dataclass(frozen=True)
class LineFit:
    """y = intercept + slope x for each of B problems of P points.

    ``slope``, ``intercept``, ``reduced_chi2`` are (B,), ``covariance`` of (slope, intercept) is (B, 2, 2),
    ``residuals`` y - intercept - slope x are (P, B).
    """

    slope: Array
    intercept: Array
    covariance: Array
    residuals: Array
    reduced_chi2: Array


def fit_line(x: Array, y: Array, x_variance: Array, y_variance: Array) -> LineFit:
    """Best line through points whose x and y both carry independent errors.

    York's iteration in the form of York, Evensen, Lopez Martinez & De Basabe Delgado, Am. J. Phys. 72,
    367-375, 2004 (their section III, r_i = 0); first given by York, Earth Planet. Sci. Lett. 5, 320-324, 1968.

    Parameters
    ----------
    x, y, x_variance, y_variance : (P, B); in a band either all points have an error or none has, and a band
        without errors is fitted with equal weights and a covariance of zero

    Raises
    ------
    UsageError : some points of a band have an error and others none.
    """
    points, bands = x.shape
    exact = (x_variance == 0) & (y_variance == 0)
    none = exact.all(axis=0)
    if np.any(exact.any(axis=0) & ~none):
        raise UsageError(
            "some panels have an error and others have none",
            mend="give every panel an uncertainty in reflectance or radiance, or none of them",
        )
    # Error-free bands: unit weights make the same iteration ordinary least squares.
    vx, vy = np.where(none, 0.0, x_variance), np.where(none, 1.0, y_variance)
    dx, dy = x - x.mean(axis=0), y - y.mean(axis=0)
    slope = np.sum(dx * dy, axis=0) / np.sum(dx * dx, axis=0)
    for _ in range(_ITERATIONS):
        w, x_bar, y_bar, beta = _york_step(x, y, vx, vy, slope)
        new = np.sum(w * beta * (y - y_bar), axis=0) / np.sum(w * beta * (x - x_bar), axis=0)
        done = np.all(np.abs(new - slope) <= _TOLERANCE * np.abs(new))
        slope = new
        if done:
            break
    w, x_bar, y_bar, beta = _york_step(x, y, vx, vy, slope)
    intercept = y_bar - slope * x_bar
    adjusted = x_bar + beta
    adjusted_bar = np.sum(w * adjusted, axis=0) / np.sum(w, axis=0)
    slope_var = 1.0 / np.sum(w * (adjusted - adjusted_bar) ** 2, axis=0)
    covariance = np.empty((bands, 2, 2))
    covariance[:, 0, 0] = slope_var
    covariance[:, 0, 1] = covariance[:, 1, 0] = -adjusted_bar * slope_var
    covariance[:, 1, 1] = 1.0 / np.sum(w, axis=0) + adjusted_bar**2 * slope_var
    covariance[none] = 0.0
    residuals = y - intercept - slope * x
    if points > 2:
        reduced = np.where(none, np.nan, np.sum(w * residuals**2, axis=0) / (points - 2))
    else:
        reduced = np.full(bands, np.nan)
    return LineFit(slope, intercept, covariance, residuals, reduced)


def _york_step(x: Array, y: Array, vx: Array, vy: Array, slope: Array) -> tuple[Array, Array, Array, Array]:
    w = 1.0 / (vy + slope**2 * vx)  # York et al. 2004, weights W_i with r_i = 0
    total = np.sum(w, axis=0)
    x_bar, y_bar = np.sum(w * x, axis=0) / total, np.sum(w * y, axis=0) / total
    beta = w * ((x - x_bar) * vy + slope * (y - y_bar) * vx)  # beta_i
    return w, x_bar, y_bar, beta


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

    Exact for two panels; more are weighted by York's method (:func:`hyperval.processing.elm.fit_line`).
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
            f"the gain is below {minimum_gain_snr:g} times its uncertainty in {int(noisy.sum())} of {noisy.size} bands",
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


def refuse_bad_panels(panels: tuple[PanelMeasurement, ...], saturation: npt.ArrayLike | None, least: int = 2) -> None:
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
                    f"panel {p.name!r} is saturated in {int(full.sum())} bands (first: band {int(full.argmax()) + 1})",
                    mend="leave the panel or those bands out",
                )


def _spread(values: Array, usable: npt.NDArray[np.bool_], shape: tuple[int, ...]) -> Array:
    full = np.full(shape, np.nan)
    full[usable] = values
    return full


Fit = Callable[[Sequence[PanelMeasurement]], EmpiricalLine]

_STEP = 1e-4  # of the reflectance of a panel, and of its radiance


@dataclass(frozen=True)
class PanelErrors:
    """Error covariances (B, B) of one panel: of its reflectance in the field and of its mean radiance.

    ``sampled``: that of the radiance with what it is known by, where it was estimated from the panel's pixels.
    """

    reflectance: Array
    radiance: Array
    sampled: EstimatedPart | None = None


@dataclass(frozen=True)
class LineError:
    """How the reflectance of a line depends on its panels, band by band, and how their errors hang together.

    Attributes
    ----------
    line : the line
    by_reflectance, by_radiance : for each panel, lines fitted with it a step up and a step down
    steps : (P, 2, B) those steps
    errors : of each panel
    fit, panels : how and through what the line was fitted
    """

    line: EmpiricalLine
    by_reflectance: tuple[tuple[EmpiricalLine, EmpiricalLine], ...]
    by_radiance: tuple[tuple[EmpiricalLine, EmpiricalLine], ...]
    steps: Array
    errors: tuple[PanelErrors, ...]
    fit: Fit
    panels: tuple[PanelMeasurement, ...]

    def without(self, name: str) -> LineError | None:
        """The line through the other panels; None where they fix no line."""
        rest = [i for i, panel in enumerate(self.panels) if panel.name != name]
        try:
            return line_error(self.fit, [self.panels[i] for i in rest], [self.errors[i] for i in rest])
        except UsageError:
            return None

    def covariance(self, radiance: npt.ArrayLike, own: str = "") -> Array:
        """(B, B) error covariance, by its panels, of the reflectance of a mean radiance (B,).

        sum over panels of D C_rho D + E C_L E with D, E = diag of the derivatives of the reflectance.  ``own``
        names the panel whose mean radiance it is: the same pixels then are on both sides, and 1/gain comes on top
        of E, so that a line through two panels gives their reflectances back whatever their radiances.  Panels
        that contradict each other have greater errors than is stated: :func:`contradiction` widens them.
        """
        level = np.asarray(radiance, dtype=float)
        total = np.zeros((level.size, level.size))
        for p, errors in enumerate(self.errors):
            d = self._slope(self.by_reflectance[p], self.steps[p, 0], level)
            e = self._slope(self.by_radiance[p], self.steps[p, 1], level)
            if own == self.line.panels[p]:
                e = e + 1.0 / self.line.gain
            total += errors.reflectance * np.outer(d, d) + errors.radiance * np.outer(e, e)
        return total * contradiction(self.line)

    def estimated(self, radiance: npt.ArrayLike) -> tuple[EstimatedPart, ...]:
        """The parts of :meth:`covariance` that were estimated from the panels' pixels; the rest counts as known."""
        level, widened = np.asarray(radiance, dtype=float), contradiction(self.line)
        parts = []
        for p, errors in enumerate(self.errors):
            if errors.sampled is not None:
                e = self._slope(self.by_radiance[p], self.steps[p, 1], level)
                parts.append(errors.sampled.of_each(partial(np.multiply, widened * np.outer(e, e))))
        return tuple(parts)

    def _slope(self, pair: tuple[EmpiricalLine, EmpiricalLine], step: Array, level: Array) -> Array:
        return (pair[0].reflectance(level) - pair[1].reflectance(level)) / (2.0 * step)


def contradiction(line: EmpiricalLine) -> float:
    """Factor by which the panels' errors are greater than stated: 1 where they lie on one line within these.

    Else the reduced chi-square, median over bands, where chance exceeds it in one line of a hundred.  Source:
    Birge, Phys. Rev. 40, 207-227, 1932; York et al., Am. J. Phys. 72, 367-375, 2004.
    """
    chi2 = line.reduced_chi2[np.isfinite(line.reduced_chi2)]
    freedom = len(line.panels) - line.parameters
    if not chi2.size or freedom < 1:
        return 1.0
    median = float(np.median(chi2))
    return median if median > 2.0 * special.gammaincinv(freedom / 2.0, 0.99) / freedom else 1.0


def line_error(
    fit: Fit, panels: Sequence[PanelMeasurement], errors: Sequence[PanelErrors], line: EmpiricalLine | None = None
) -> LineError:
    """Derivatives of a line by every panel, by central differences: the law of propagation (JCGM 100:2008, 5.2).

    Parameters
    ----------
    fit : the way from panels to the line
    panels, errors : in the same order
    """
    fit_line = line or fit(panels)
    by_reflectance, by_radiance, steps = [], [], []
    for i, p in enumerate(panels):
        h, g = _STEP * np.maximum(p.reflectance, 0.01), _STEP * np.maximum(np.abs(p.radiance), 1e-12)
        steps.append([h, g])
        by_reflectance.append(
            (
                fit(_with(panels, i, replace(p, reflectance=p.reflectance + h))),
                fit(_with(panels, i, replace(p, reflectance=p.reflectance - h))),
            )
        )
        by_radiance.append(
            (
                fit(_with(panels, i, replace(p, radiance=p.radiance + g))),
                fit(_with(panels, i, replace(p, radiance=p.radiance - g))),
            )
        )
    return LineError(
        fit_line, tuple(by_reflectance), tuple(by_radiance), np.array(steps), tuple(errors), fit, tuple(panels)
    )


def _with(panels: Sequence[PanelMeasurement], i: int, panel: PanelMeasurement) -> list[PanelMeasurement]:
    return [panel if j == i else p for j, p in enumerate(panels)]


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


@dataclass(frozen=True)
class TwoPanelLine:
    """L = offset + gain rho per band.

    Attributes
    ----------
    gain : (B,) k [uW cm-2 sr-1 nm-1 per unit reflectance]
    offset : (B,) b [uW cm-2 sr-1 nm-1]
    """

    gain: Array
    offset: Array


def two_panel_line(
    radiance_low: npt.ArrayLike,
    radiance_high: npt.ArrayLike,
    reflectance_low: npt.ArrayLike = 0.1,
    reflectance_high: npt.ArrayLike = 0.6,
) -> TwoPanelLine:
    """The line through two panels (before 3.21).

    Parameters
    ----------
    radiance_low, radiance_high : (B,) mean radiance of the panels
    reflectance_low, reflectance_high : scalar or (B,) their reflectances [1]

    Raises
    ------
    UsageError : the panels do not differ in reflectance, or the brighter one is not brighter.
    """
    low, high = np.asarray(radiance_low, dtype=float), np.asarray(radiance_high, dtype=float)
    r_low, r_high = np.asarray(reflectance_low, dtype=float), np.asarray(reflectance_high, dtype=float)
    step = r_high - r_low
    if np.any(step <= 0):
        raise UsageError("the high panel of the empirical line must be brighter than the low one in every band")
    gain = (high - low) / step
    dark = int(np.sum(~(gain > 0)))
    if dark:
        raise UsageError(
            f"the empirical line has no slope in {dark} of {gain.size} bands: no light reaches the sensor there",
            mend="drop those bands (processing: bands: windows_only: true, or ranges)",
        )
    return TwoPanelLine(gain, low - r_low * gain)


def retrieved_reflectance(line: TwoPanelLine, radiance: npt.ArrayLike) -> Array:
    """rho^ = (L - b) / k, (..., B) [1] (before 3.21)."""
    return np.asarray((np.asarray(radiance, dtype=float) - line.offset) / line.gain)


def retrieved_covariance(line: TwoPanelLine, covariance: npt.ArrayLike, out: Array | None = None) -> Array:
    """Sigma^_ij = Sigma_L,ij / (k_i k_j), (B, B) [1] (before 3.21); the offset does not enter.

    ``out`` : (B, B) memory for the result
    """
    slope = 1.0 / line.gain
    result: Array = np.multiply(np.asarray(covariance, dtype=float), slope[:, None], out=out)
    result *= slope
    return result


def darkest_level(fractions: npt.ArrayLike, means: npt.ArrayLike, sds: npt.ArrayLike, pixels: int) -> Array:
    """Radiance of the darkest of ``pixels`` pixels of the scene, band by band: its median (before 3.21).

    All of n independent pixels exceed x with probability (1 - F(x))^n, F = sum f_m Phi((x - L_m) / sigma_m); the
    median of their least is F(x) = 1 - 2^(-1/n).  Darkest-pixel compensation takes it for that of a
    dark surface.

    Parameters
    ----------
    fractions : (..., M) area fractions, sum 1
    means, sds : (..., M, B) of the classes' radiance

    Returns
    -------
    (..., B)

    Raises
    ------
    UsageError : no pixel.
    """
    f, mu, sd = (np.asarray(a, dtype=float) for a in (fractions, means, sds))
    if pixels < 1:
        raise UsageError(f"the darkest of {pixels} pixels", expected="at least one pixel")
    f, sd = f[..., None], np.maximum(sd, 1e-300)
    p = -np.expm1(-np.log(2.0) / pixels)
    alone = mu + sd * ndtri(p)
    high = np.where(f > 0, alone, -np.inf).max(axis=-2)  # there every class is below x with at least p
    low = np.where(f > 0, alone, np.inf).min(axis=-2)  # there none is with more
    for _ in range(60):
        middle = 0.5 * (low + high)
        below = (f * ndtr((middle[..., None, :] - mu) / sd)).sum(axis=-2) < p
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(0.5 * (low + high))
