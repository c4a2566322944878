"""Empirical line method on measured panels: radiance to reflectance with its uncertainty.

A straight line with errors in both coordinates, for many bands at once, with an offset or through the origin; the
darkest pixel as the dark panel.  A material of known spectrum that lies in the scene (a colour standard) is a panel
like any other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import numpy.typing as npt
from scipy import special

from hyperval.data import Array, Mask
from hyperval.errors import UsageError, refusal, refuse
from hyperval.model.inputs import covariance_directions
from hyperval.products import EstimatedPart

MINIMUM_CONTRAST = 0.1  # reflectance between the darkest and the brightest panel
MINIMUM_GAIN_SNR = 5.0  # gain over its standard uncertainty
PERCENT_LIMIT = 1.5  # no panel reflects more; above it the numbers are percent
_ITERATIONS = 100
_TOLERANCE = 1e-13
_STEP = 1e-4  # of the reflectance of a panel, and of its radiance


@dataclass(frozen=True)
class LineFit:
    """y = intercept + slope x for each of B problems of P points.

    ``slope``, ``intercept``, ``reduced_chi2`` are (B,), ``covariance`` of (slope, intercept) is (B, 2, 2).
    """

    slope: Array
    intercept: Array
    covariance: Array
    reduced_chi2: Array


def fit_line(x: Array, y: Array, x_variance: Array, y_variance: Array, *, intercept: bool = True) -> LineFit:
    """Best line through points whose x and y both carry independent errors.

    York's iteration in the form of York, Evensen, Lopez Martinez & De Basabe Delgado, Am. J. Phys. 72,
    367-375, 2004 (their section III, r_i = 0); first given by York, Earth Planet. Sci. Lett. 5, 320-324, 1968.
    Through the origin it is the same about 0 in place of the weighted means, and the zero of dS/dk for the least
    S = sum (y - k x)^2/(var y + k^2 var x).

    Parameters
    ----------
    x, y, x_variance, y_variance : (P, B); in a band either all points have an error or none has, and a band
        without errors is fitted with equal weights and a covariance of zero
    intercept : False: the line goes through the origin

    Raises
    ------
    UsageError : some points of a band have an error and others none.
    """
    exact = (x_variance == 0) & (y_variance == 0)
    error_free = exact.all(axis=0)
    refuse(np.any(exact.any(axis=0) & ~error_free), "line.errors")
    # Error-free bands: unit weights make the same iteration ordinary least squares.
    vx, vy = np.where(error_free, 0.0, x_variance), np.where(error_free, 1.0, y_variance)

    def mean(values: Array, weight: Array) -> Array:
        return np.sum(weight * values, axis=0) / np.sum(weight, axis=0) if intercept else np.zeros(x.shape[1])

    def weights_and_beta(slope: Array) -> tuple[Array, Array, Array, Array]:
        w = 1.0 / (vy + slope**2 * vx)  # York et al. 2004, weights W_i with r_i = 0
        dx, dy = x - mean(x, w), y - mean(y, w)
        return w, w * (dx * vy + slope * dy * vx), dx, dy  # beta_i

    dx, dy = x - mean(x, np.ones_like(x)), y - mean(y, np.ones_like(y))
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.sum(dx * dy, axis=0) / np.sum(dx * dx, axis=0)
        for _ in range(_ITERATIONS):
            previous = slope
            w, beta, dx, dy = weights_and_beta(slope)
            slope = np.sum(w * beta * dy, axis=0) / np.sum(w * beta * dx, axis=0)
            if not np.any(np.abs(slope - previous) > _TOLERANCE * np.abs(slope)):
                break
        w, beta, _, _ = weights_and_beta(slope)
        adjusted = mean(x, w) + beta
        centre = mean(adjusted, w)
        variance = 1.0 / np.sum(w * (adjusted - centre) ** 2, axis=0)
    covariance = np.zeros((x.shape[1], 2, 2))
    covariance[:, 0, 0] = variance
    covariance[:, 0, 1] = covariance[:, 1, 0] = -centre * variance
    covariance[:, 1, 1] = (1.0 / np.sum(w, axis=0) if intercept else 0.0) + centre**2 * variance
    covariance[error_free] = 0.0
    offset = mean(y, w) - slope * mean(x, w)
    dof = len(x) - 1 - intercept
    reduced = np.where(error_free | (dof == 0), np.nan, np.sum(w * (y - offset - slope * x) ** 2, axis=0) / max(dof, 1))
    return LineFit(slope, offset, covariance, reduced)


@dataclass(frozen=True, eq=False)
class MeasuredPanel:
    """A point of an empirical line: a panel, or a site, seen in the field and in the image.

    Attributes
    ----------
    name : of the panel
    reflectance : (B,) in the field [1]
    reflectance_error : (B, B) covariance of its error, or (B,) variances where bands err alone
    radiance : (B,) mean of its pixels [uW cm-2 sr-1 nm-1]
    radiance_error : of that mean, likewise
    n : pixels behind the mean
    sampled : ``radiance_error`` with its degrees of freedom, where it was estimated from the panel's pixels
    """

    name: str
    reflectance: Array
    reflectance_error: Array
    radiance: Array
    radiance_error: Array
    n: int = 1
    sampled: EstimatedPart | None = None


@dataclass(frozen=True, eq=False)
class EmpiricalLine:
    """The line L = offset + gain rho of each band, and the derivatives of its reflectance by the panels.

    Attributes
    ----------
    gain, offset : (B,) [uW cm-2 sr-1 nm-1]; NaN in bands that are not ``usable``
    covariance : (B, 2, 2) of (gain, offset) in that order
    reduced_chi2 : (B,) chi-square over P - 2 (P - 1 through the origin); NaN where any line fits
    usable : (B,) False where a panel has no reflectance, or they do not differ enough, or are too noisy, to fix a gain
    good : (B,) bands by which the line is judged
    panels : that it is fitted to
    intercept : False: the line goes through the origin
    least_contrast : of the panels, in a band that is usable
    """

    gain: Array
    offset: Array
    covariance: Array
    reduced_chi2: Array
    usable: Mask
    good: Mask
    panels: tuple[MeasuredPanel, ...]
    intercept: bool = True
    least_contrast: float = MINIMUM_CONTRAST

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the panels."""
        return tuple(p.name for p in self.panels)

    def reflectance(self, radiance: npt.ArrayLike) -> Array:
        """(..., B) reflectance (L - b)/k of a radiance (..., B)."""
        return (np.asarray(radiance, dtype=float) - self.offset) / self.gain

    def without_panel(self, name: str) -> EmpiricalLine | None:
        """The line through the other panels; None where they fix no line."""
        try:
            panels = [p for p in self.panels if p.name != name]
            return fit_elm(panels, self.good, intercept=self.intercept, minimum_contrast=self.least_contrast)
        except UsageError:
            return None

    @cached_property
    def leave_one_out_errors(self) -> Array:
        """(P, B) error of the reflectance of each panel by the line through the others; NaN where they fix none.

        An extrapolation for the darkest and the brightest.
        """
        error = np.full((len(self.panels), self.gain.size), np.nan)
        for row, panel in zip(error, self.panels, strict=True):
            if (line := self.without_panel(panel.name)) is not None:
                row[self.usable] = (line.reflectance(panel.radiance) - panel.reflectance)[self.usable]
        return error

    @cached_property
    def birge_factor(self) -> float:
        """Birge factor on the variances of the panels' errors: 1 where they lie on one line within stated errors.

        Else the reduced chi-square, median over good bands, over its expectation, where chance exceeds it in at most
        one line of a hundred.  Bands with error correlation rho count as B^2 / sum rho^2, as their chi-squares have
        rho^2.  Source: Birge, Phys. Rev. 40, 207-227, 1932; York et al., Am. J. Phys. 72, 367-375, 2004.

        Twenty bands with twice the stated error have 4 times the stated variance:

        >>> rng, rho = np.random.default_rng(1), np.array([0.05, 0.3, 0.6])
        >>> panels = [MeasuredPanel(str(r), r + 0.06 * r * rng.standard_normal(20), np.full(20, (0.03 * r) ** 2),
        ...     np.full(20, 10.0 * r), np.full(20, 1e-6)) for r in rho]
        >>> 3.5 < fit_elm(panels).birge_factor < 7.0
        True
        """
        valid, dof = np.isfinite(self.reduced_chi2) & self.good, len(self.panels) - 1 - self.intercept
        if not valid.any() or dof < 1:
            return 1.0
        squares, covariances = np.outer(self.gain, self.gain), np.zeros(2 * (self.gain.size,))
        for p in self.panels:
            x, y = (np.diag(e) if e.ndim == 1 else e for e in (p.reflectance_error, p.radiance_error))
            covariances += squares * x + y
        covariance = covariances[np.ix_(valid, valid)]
        sd = np.sqrt(np.diag(covariance))
        rank = (sd.size**2 / np.sum((covariance / np.outer(sd, sd)) ** 2) + 1.0) / 2.0
        chance = special.betaincinv(rank, rank, (np.arange(200) + 0.5) / 200)  # of the median of so many bands
        expected = 2.0 * special.gammaincinv(dof / 2.0, chance) / dof
        median = float(np.median(self.reduced_chi2[valid]))
        return median / float(expected.mean()) if median > np.quantile(expected, 0.99) else 1.0

    def error_covariance(self, radiance: npt.ArrayLike, own: str = "") -> Array:
        """(B, B) error covariance, by its panels, of the reflectance of a mean radiance (B,).

        sum over panels of D C_rho D + E C_L E with D, E = diag of the derivatives of the reflectance.  ``own``
        names the panel whose mean radiance it is: its pixels then are on both sides, and 1/gain is added to E, so that
        a line through two panels reproduces their reflectances whatever their radiances.  :attr:`birge_factor`
        widens the errors of panels that lie on no one line.
        """
        slopes = self._derivatives(radiance)
        slopes[1, [panel.name == own for panel in self.panels]] += 1.0 / self.gain
        return self._propagated_covariance(slopes)

    @cached_property
    def scale_errors(self) -> Array:
        """(K, B) relative errors of reflectance differences, those of the gain, along independent directions."""
        of_gain = self._derivatives(self.gain) - self._derivatives(0.0 * self.gain)
        return covariance_directions(np.nan_to_num(self._propagated_covariance(of_gain)))

    def _propagated_covariance(self, slopes: Array) -> Array:
        """(B, B) covariance of a quantity with these derivatives (2, P, B) by the panels' reflectance and radiance."""
        total = np.zeros((self.gain.size, self.gain.size))
        for panel, panel_slopes in zip(self.panels, slopes.swapaxes(0, 1), strict=True):
            for error, slope in zip((panel.reflectance_error, panel.radiance_error), panel_slopes, strict=True):
                total += np.diag(error * slope**2) if error.ndim == 1 else error * np.outer(slope, slope)
        return total * self.birge_factor

    def estimated_parts(self, radiance: npt.ArrayLike) -> tuple[EstimatedPart, ...]:
        """The parts of :meth:`error_covariance` that were estimated from the panels' pixels; others count as known."""
        widened = self.birge_factor
        return tuple(
            panel.sampled.of_each(partial(np.multiply, widened * np.outer(e, e)))
            for panel, e in zip(self.panels, self._derivatives(radiance)[1], strict=True)
            if panel.sampled is not None
        )

    def _derivatives(self, radiance: npt.ArrayLike) -> Array:
        """(2, P, B) derivatives of the reflectance of a radiance (B,) by the panels' reflectance and radiance."""
        gain, offset, step = self._perturbed_lines
        moved = (np.asarray(radiance, dtype=float) - offset) / gain
        return np.asarray((moved[:, :, 0] - moved[:, :, 1]) / (2.0 * step))

    @cached_property
    def _perturbed_lines(self) -> tuple[Array, Array, Array]:
        """(2, P, 2, B) gains and offsets with a panel's reflectance, or radiance, a step up and down; (2, P, B) steps.

        Central differences: the law of propagation (JCGM 100:2008, 5.2).
        """
        x, y, vx, vy = (values[:, self.usable] for values in _panel_points(self.panels))
        count, steps = len(x), _STEP * np.stack([np.maximum(x, 0.01), np.maximum(np.abs(y), 1e-12)])
        columns = []
        for kind, panel, sign in np.ndindex(2, count, 2):
            columns.append((x.copy(), y.copy()))
            columns[-1][kind][panel] += (1 - 2 * sign) * steps[kind, panel]
        moved = (np.concatenate(values, axis=1) for values in zip(*columns, strict=True))
        fit = fit_line(*moved, *(np.tile(v, len(columns)) for v in (vx, vy)), intercept=self.intercept)
        parts = (values.reshape(2, count, 2, -1) for values in (fit.slope, fit.intercept))
        gain, offset, steps = (_in_all_bands(values, self.usable) for values in (*parts, steps))
        return gain, offset, steps


def _in_all_bands(values: Array, usable: Mask) -> Array:
    """Values (..., U) of the usable bands among all (..., B), NaN in the others."""
    full = np.full((*values.shape[:-1], usable.size), np.nan)
    full[..., usable] = values
    return full


def _panel_points(panels: Sequence[MeasuredPanel]) -> Array:
    """(4, P, B) reflectance, radiance, and the variances of their errors: the diagonal of a covariance."""
    variances = [[np.diag(e) if e.ndim == 2 else e for e in (p.reflectance_error, p.radiance_error)] for p in panels]
    return np.stack([[p.reflectance, p.radiance, *v] for p, v in zip(panels, variances, strict=True)], axis=1)


def fit_elm(
    panels: Sequence[MeasuredPanel],
    good: Mask | None = None,
    *,
    intercept: bool = True,
    minimum_contrast: float = MINIMUM_CONTRAST,
) -> EmpiricalLine:
    """Line through all panels, band by band, with errors in reflectance and in radiance.

    Exact for two panels; more are weighted by York's method (:func:`fit_line`).  A band in which a panel has no
    reflectance (NaN), whose panels differ by less than ``minimum_contrast`` or whose gain is below five times its
    uncertainty gets NaN; where the latter two are more than half of the known good bands the panels are refused.

    Parameters
    ----------
    good : (B,) bands by which panels are accepted; others have a line where one can be fitted; None: all
    intercept : False: L = gain rho, for radiance whose path part is removed or small, for which one panel is enough.
        The offset and its covariances are 0, by assumption

    Raises
    ------
    UsageError : too few panels, reflectance in percent, equal panels (two bright ones fit
        anything), or panels too noisy or too dark to fix a line.

    Examples
    --------
    >>> error, one, two = np.zeros(4), np.ones(4), np.array([1.0, 2.0, 1.0, 1.0])  # bad bands hold the same
    >>> def line(reflectance, noise, good):
    ...     dark = MeasuredPanel("dark", 0.1 * one, error, one, noise)
    ...     return fit_elm([dark, MeasuredPanel("bright", reflectance, error, two, noise)], good).usable.tolist()
    >>> line(0.5 * one, 1e-6 * one, np.array([False, True, False, False]))  # too noisy
    [False, True, False, False]
    >>> line(np.array([0.1, 0.5, 0.1, 0.1]), 1e-6 * one, np.array([False, True, False, False]))  # of no contrast
    [False, True, False, False]
    """
    panels = tuple(panels)
    refuse(len(panels) < 1 + intercept, "line.few", count=len(panels), least=1 + intercept)
    good = np.ones(panels[0].radiance.size, bool) if good is None else good
    points = _panel_points(panels)
    for p, (rho, *measured) in zip(panels, points[:, :, good].swapaxes(0, 1), strict=True):
        covered = np.isfinite(rho)  # a field spectrum may not reach all bands
        refuse(not covered.any(), "panel.unknown", name=p.name)
        refuse(not np.isfinite(np.array(measured)[:, covered]).all(), "panel.finite", name=p.name)
        refuse((brightest := rho[covered].max()) > PERCENT_LIMIT, "panel.percent", name=p.name, rho=brightest)
        refuse((darkest := rho[covered].min()) < -0.05, "panel.negative", name=p.name, rho=darkest)
    valid = np.asarray(np.isfinite(points).all(axis=(0, 1)))
    exact = np.all(points[2:] == 0.0, axis=0)
    valid &= good | (exact.all(axis=0) == exact.any(axis=0))
    refuse(not valid[good].any(), "line.no_band")
    contrast = np.ptp(points[0], axis=0) if intercept else np.full(valid.size, np.inf)
    usable = valid & (contrast >= minimum_contrast)
    if np.mean(usable[valid & good]) < 0.5:
        names, median_contrast = ", ".join(p.name for p in panels), np.median(contrast[valid & good])
        raise refusal("line.contrast", names=names, differ=median_contrast, least=minimum_contrast)
    fit = fit_line(*(part[:, usable] for part in points), intercept=intercept)
    noisy = ~(fit.slope > MINIMUM_GAIN_SNR * np.sqrt(fit.covariance[:, 0, 0]))
    failed = noisy[good[usable]]
    refuse(np.mean(failed) > 0.5, "line.noisy", least=MINIMUM_GAIN_SNR, count=int(failed.sum()), bands=failed.size)
    usable[usable] = ~noisy
    parts = (fit.slope, fit.intercept, fit.covariance.T, fit.reduced_chi2)
    gain, offset, covariance, chi2 = (_in_all_bands(part[..., ~noisy], usable) for part in parts)
    return EmpiricalLine(gain, offset, covariance.T, chi2, usable, good, panels, intercept, minimum_contrast)


def darkest_pixel_panel(
    least: Array, noise: Array, good: Mask, reflectance: float, reflectance_sd: float
) -> MeasuredPanel:
    """The ``least`` radiance of the scene in each band (B,) as a panel of low, assumed reflectance.

    The least of many noisy pixels lies below the darkest surface by some standard deviations of the noise; the
    variance of the panel is therefore that of one pixel's noise, independent from band to band.  The reflectance of
    the darkest surface has one error common to all bands.  The darkest pixels of different bands may differ.

    Raises
    ------
    UsageError : a darkest radiance that, in a ``good`` band (B,), is not finite or negative beyond three standard
        deviations of noise.
    """
    invalid = good & (~(least >= -3.0 * np.sqrt(noise)) | ~np.isfinite(least))
    refuse(np.any(invalid), "line.darkest", count=int(np.sum(invalid)))
    ones = np.ones(least.size)
    return MeasuredPanel("darkest pixel", reflectance * ones, reflectance_sd**2 * np.outer(ones, ones), least, noise)
