"""Wavelength errors of a spectrum, by absorptions of the atmosphere, by the red edge of plants, or after compensation.

A reflectance shows it in the oxygen A band: a band labelled w that lies at w - s was divided by the transmittance at w,
not by its own:

    rho'(w) / rho(w) = (1 - W' k(w - s)) / (1 - W k(w))

with the absorption k of the oxygen seen through the band (of area 1) and its equivalent widths, W' in the light and
W in the compensation.  Too much or too little absorption taken out leaves a bump; a shift leaves a slope across it.
Labels that are changed afterwards move the bump itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy
from scipy import special

from hyperval.data import Array, Mask
from hyperval.model.intervals import Z95, student_factor
from hyperval.spectra.axis import SIGMA_PER_FWHM, SpectralAxis

# The two branches of the band: share, centre and spread [nm]. Fitted to MODTRAN 6 in channels of 5.7 nm, rms 0.003
# of up to 0.47 absorbed.
_BRANCHES = ((0.48, 761.24, 0.80), (0.52, 764.38, 2.57))
# Uncertainty by the shape of two branches [nm]: shifts of -5 to 5 nm simulated line by line are found within 1.2.
_SHAPE = 1.0
# Equivalent width [nm], sun to sensor: 4.0 by MODTRAN 6 from 2.3 km under a sun at 31 degrees; as the root of the
# path, 3.6 to 6 from other heights and suns.
_WIDTH, _WIDTH_SD = 4.5, 0.25
RANGE_NM = (742.0, 787.0)
_DEGREE = 3  # of the polynomial that the logarithm of the surface follows there
MIN_OXYGEN_BANDS = _DEGREE + 6  # three more than the fit has parameters
MAX_SHIFT = 10.0  # [nm]
_STEP = 1.0  # of the shifts that are tried first [nm]
_MIN_FIGURE = 1e-4  # relative: rounding of a reflectance to four digits
_ALPHA = 1e-4  # of one test; a few of the shifts tried are independent: 1e-3 in all


def oxygen_absorption(wavelength_nm: npt.ArrayLike, fwhm_nm: npt.ArrayLike) -> Array:
    """(B,) absorption of the oxygen A band through Gaussian bands, of area 1 over wavelength [nm-1]."""
    w, band = np.asarray(wavelength_nm, dtype=float), np.asarray(fwhm_nm, dtype=float) * SIGMA_PER_FWHM
    share, centre, sd = np.array(_BRANCHES).T[:, :, None]
    spread = np.hypot(sd, band)
    density = np.exp(-(((w - centre) / spread) ** 2) / 2.0) / (np.sqrt(2.0 * np.pi) * spread)
    return np.asarray((share * density).sum(axis=0))


def oxygen_residual(wavelength_nm: npt.ArrayLike, reflectance: npt.ArrayLike, fwhm_nm: npt.ArrayLike) -> Shift | None:
    """The shift that explains the residual of the oxygen A band; None where there is none beyond the scatter.

    Least squares in the logarithm over 742 to 787 nm: the surface as a cubic, both equivalent widths and the shift.
    Its uncertainty is that of scatter and shape; the path of the light is known to a quarter, and so is a shift.
    There is no residual, or it was interpolated over, where no shift improves on the cubic by more than chance (F
    test with two parameters).  Where no shift of the light does, the compensation is shifted along with it: labels
    that were changed afterwards.

    Parameters
    ----------
    wavelength_nm, reflectance, fwhm_nm : (B,) finite
    """
    w, y, fwhm = (np.asarray(x, dtype=float) for x in (wavelength_nm, reflectance, fwhm_nm))
    used = (w > RANGE_NM[0]) & (w < RANGE_NM[1]) & (y > 0.0)
    if used.sum() < MIN_OXYGEN_BANDS:
        return None
    w, z, fwhm = w[used], np.log(y[used]), fwhm[used]
    centre = 0.5 * (RANGE_NM[0] + RANGE_NM[1])
    powers = np.vander((w - centre) / (RANGE_NM[1] - centre), _DEGREE + 1)
    return next(filter(None, (_oxygen_fit(z, powers, w, fwhm, follows) for follows in (0.0, 1.0))), None)


def _oxygen_fit(z: Array, powers: Array, w: Array, fwhm: Array, follows: float) -> Shift | None:
    """The same of log reflectance (B,), with the compensation shifted by ``follows`` times the shift of the light."""

    def absorption(shift: float) -> Array:
        return oxygen_absorption(w - shift, fwhm)

    # The start: the usual width of the light, linear in the departure of the compensation's from it.
    def linear(shift: float) -> tuple[Array, Array]:
        k = absorption(follows * shift)
        log_t = _log_transmitted(_WIDTH * k)
        return np.column_stack([powers, k / np.exp(log_t)]), z - _log_transmitted(_WIDTH * absorption(shift)) + log_t

    start_shift = float(min(np.arange(-MAX_SHIFT, MAX_SHIFT + _STEP, _STEP), key=lambda s: _misfit(*linear(s))))
    dof = w.size - powers.shape[1] - 2  # the width of the light is held by its prior

    def residuals(p: Array) -> Array:
        removed = _log_transmitted(p[2] * absorption(follows * p[0]))
        return np.asarray(z - _log_transmitted(p[1] * absorption(p[0])) + removed - powers @ p[3:])

    def weighted(p: Array, scatter: float) -> Array:
        return np.append(residuals(p) / scatter, (p[1] / _WIDTH - 1.0) / _WIDTH_SD)

    *surface, extra_width = np.linalg.lstsq(*linear(start_shift))[0]
    p = np.array([start_shift, _WIDTH, _WIDTH + extra_width, *surface])
    for _ in range(2):
        scatter = max(float(np.sqrt(np.sum(residuals(p) ** 2) / dof)), _MIN_FIGURE)
        best = scipy.optimize.least_squares(weighted, p, method="lm", args=(scatter,))
        p = best.x
    squares = float(np.sum(residuals(p) ** 2))
    gain = 0.5 * max(_misfit(powers, z) - squares, 0.0) / max(squares / dof, _MIN_FIGURE**2)
    if special.fdtrc(2, dof, gain) > _ALPHA or abs(p[0]) > MAX_SHIFT:
        return None
    covariance = np.linalg.pinv(best.jac.T @ best.jac)
    by_scatter = student_factor(dof) * np.sqrt(covariance[0, 0])
    return Shift(OXYGEN_RESIDUAL, float(p[0]), float(np.hypot(_SHAPE, by_scatter)))


def oxygen_band_width(wavelength_nm: npt.ArrayLike, spectrum: npt.ArrayLike) -> float:
    """FWHM [nm], a whole number, of Gaussian bands that a spectrum (B,) shows the oxygen A band through; else NaN.

    Least squares over 740 to 790 nm: continuum as a parabola, depth and width of the absorption.

    Examples
    --------
    >>> w = np.arange(400.0, 1000.0, 10.0)
    >>> oxygen_band_width(w, 0.3 - oxygen_absorption(w, np.full(w.size, 12.0)))
    12.0
    """
    w, y = np.asarray(wavelength_nm, dtype=float), np.asarray(spectrum, dtype=float)
    used = (w >= 740.0) & (w <= 790.0) & np.isfinite(y)
    continuum = np.vander((w[used] - 765.0) / 25.0, 3)
    if used.sum() < continuum.shape[1] + MIN_BANDS:
        return float("nan")
    tried = np.arange(1.0, 41.0)
    squares = [_misfit(np.column_stack([continuum, oxygen_absorption(w[used], f)]), y[used]) for f in tried]
    return float(tried[np.argmin(squares)]) if min(squares) < 0.1 * _misfit(continuum, y[used]) else float("nan")


def _log_transmitted(absorbed: Array) -> Array:
    return np.asarray(np.log1p(-np.minimum(absorbed, 0.99)))


def _misfit(columns: Array, values: Array) -> float:
    """Residual sum of squares of values (n,) regressed on columns (n, p)."""
    return float(np.sum((values - columns @ np.linalg.lstsq(columns, values)[0]) ** 2))


MIN_DEPTH = 0.15  # of an absorption under the line between its shoulders
MIN_BANDS = 3  # in a feature
MAX_GAP = 2.5  # widest step between bands of a feature over their median one: missing bands hide its centre
MIN_LEVEL = 0.8  # of the infrared's, in the last band before 770 nm
MIN_PLANT = 3.0  # reflectance at 785 nm over that at 675 nm
_STEPS = 20
_SAMPLING = 0.08  # part of the band spacing by which a centre of few bands is uncertain


@dataclass(frozen=True)
class Feature:
    """An absorption: the centre of its area, its standard uncertainty, and the window searched [nm]."""

    key: str
    name: str
    centre_nm: float
    uncertainty_nm: float
    half_nm: float
    shoulder_nm: float


# Centres: MODTRAN 6 at 5 nm for a flat surface (763.1 +- 0.1, 941.3 +- 0.2, 1134.7 +- 0.2) beside 6S, whose lines
# are coarser (762.4, 941.4, 1137.1); liquid water in plants moves the two of vapour by 1 nm.
FEATURES = (
    Feature("oxygen-763", "oxygen A band", 762.9, 0.5, 12.0, 10.0),
    Feature("vapour-940", "water vapour at 940 nm", 941.4, 1.0, 60.0, 20.0),
    Feature("vapour-1135", "water vapour at 1135 nm", 1135.5, 1.3, 50.0, 20.0),
)
OXYGEN_RESIDUAL = f"rest of the {FEATURES[0].name}"
# Half of the rise from red to infrared: 710 to 724 nm for leaves, lawns and the built-in grass.
RED_EDGE = Feature("red-edge", "red edge of plants", 717.0, 5.0, 50.0, 20.0)


@dataclass(frozen=True)
class Shift:
    """Wavelength error at a feature: wavelengths as labelled less the true ones [nm]."""

    feature: str
    nm: float
    uncertainty_nm: float

    @property
    def is_significant(self) -> bool:
        """Whether the 95 % interval excludes 0."""
        return abs(self.nm) > Z95 * self.uncertainty_nm


def absorption_centre(wavelength_nm: npt.ArrayLike, radiance: npt.ArrayLike, feature: Feature) -> tuple[float, float]:
    """Centre of the area of an absorption under the line between its shoulders, and its depth; NaN without one.

    The first moment of the absorbed part, sum d w dw / sum d dw with d = 1 - L / L_line: a symmetric band response
    widens the absorption and does not move the moment.  The window follows the centre until both agree, so that a
    shift of its own width is found too.  Where bands are missing in it there is no centre.

    Parameters
    ----------
    wavelength_nm, radiance : (B,) increasing, finite
    """
    w, y = np.asarray(wavelength_nm, dtype=float), np.asarray(radiance, dtype=float)
    wide = (w > feature.centre_nm - 2.0 * feature.half_nm) & (w < feature.centre_nm + 2.0 * feature.half_nm)
    index = np.flatnonzero(wide)
    if index.size < MIN_BANDS + 2:
        return float("nan"), 0.0
    continuum = np.interp(w[index], w[index[[0, -1]]], y[index[[0, -1]]])
    centre, depth = float(w[index][np.argmin(y[index] / np.where(continuum > 0.0, continuum, np.inf))]), 0.0
    width = np.gradient(w)
    for _ in range(_STEPS):
        blue, core, red = _feature_bands(w, centre, feature)
        if not blue.any() or not red.any() or core.sum() < MIN_BANDS:
            return float("nan"), 0.0
        steps = np.diff(w[blue | core | red])
        if steps.max() > MAX_GAP * np.median(steps):
            return float("nan"), 0.0
        d = 1.0 - y[core] / _continuum(w, y, blue, core, red)
        area = float(np.sum(d * width[core]))
        depth = float(d.max())
        if depth < MIN_DEPTH or area <= 0.0:
            return float("nan"), depth
        moment = float(np.sum(d * w[core] * width[core])) / area
        if abs(moment - centre) < 1e-3:
            break
        # Half steps: bands enter and leave the window, which makes full ones oscillate.
        centre = 0.5 * (centre + moment)
    return centre, depth


def centre_uncertainty(
    wavelength_nm: npt.ArrayLike, radiance: npt.ArrayLike, covariance: npt.ArrayLike, feature: Feature, centre_nm: float
) -> float:
    """Standard uncertainty [nm] of an absorption's centre by the errors of its bands and shoulders; NaN without one.

    First order, with p = (w - c) dw / (A L_line) and the area A = sum d dw of the absorption: the centre c changes by
    -p for a unit of radiance in a band of the core, and by p L / L_line for one of the line.

    Parameters
    ----------
    covariance : (B, B) of the radiance (B,)
    """
    w, y, cov = (np.asarray(x, dtype=float) for x in (wavelength_nm, radiance, covariance))
    if not np.isfinite(centre_nm):
        return float("nan")
    blue, core, red = _feature_bands(w, centre_nm, feature)
    continuum, width = _continuum(w, y, blue, core, red), np.gradient(w)[core]
    area = float(np.sum((1.0 - y[core] / continuum) * width))
    part, slope = (w[core] - centre_nm) * width / (area * continuum), np.zeros(w.size)
    slope[core] = -part
    for shoulder, levels in ((blue, (1.0, 0.0)), (red, (0.0, 1.0))):
        interpolation = np.interp(w[core], [w[blue].mean(), w[red].mean()], levels)
        slope[shoulder] = (part * y[core] / continuum) @ interpolation / np.count_nonzero(shoulder)
    return float(np.sqrt(max(slope @ cov @ slope, 0.0)))


def _feature_bands(w: Array, centre: float, feature: Feature) -> tuple[Mask, Mask, Mask]:
    """Bands of the blue shoulder, of the absorption's core and of the red shoulder."""
    low, high = centre - feature.half_nm, centre + feature.half_nm
    blue = (w >= low - feature.shoulder_nm) & (w < low)
    red = (w > high) & (w <= high + feature.shoulder_nm)
    return blue, (w >= low) & (w <= high), red


def _continuum(w: Array, y: Array, blue: Mask, core: Mask, red: Mask) -> Array:
    """Radiance of the line between the shoulders in the bands of the core."""
    ends = [w[blue].mean(), w[red].mean()], [y[blue].mean(), y[red].mean()]
    return np.asarray(np.interp(w[core], *ends))


def red_edge(wavelength_nm: npt.ArrayLike, reflectance: npt.ArrayLike) -> float:
    """Wavelength [nm] at half of the rise from the red to the infrared; NaN where nothing rises as plants do.

    Dyed fabrics rise there too, but have not reached the infrared's level before 770 nm.
    """
    w, y = np.asarray(wavelength_nm, dtype=float), np.asarray(reflectance, dtype=float)
    red, infrared = (w >= 650.0) & (w <= 700.0), (w >= 770.0) & (w <= 800.0)
    if not red.any() or not infrared.any():
        return float("nan")
    low, high = float(y[red].min()), float(y[infrared].mean())
    rise = np.flatnonzero((w >= 670.0) & (w <= 780.0))
    half = 0.5 * (low + high)
    crossed = np.flatnonzero((y[rise][:-1] < half) & (y[rise][1:] >= half))
    still_rising = float(y[w < 770.0][-1]) < MIN_LEVEL * high
    if low <= 0.0 or high < MIN_PLANT * low or crossed.size != 1 or still_rising:
        return float("nan")
    k = rise[crossed[0]]
    return float(w[k] + (half - y[k]) / (y[k + 1] - y[k]) * (w[k + 1] - w[k]))


def wavelength_shifts(spectrum: npt.ArrayLike, axis: SpectralAxis, *, reflectance: bool = False) -> Iterator[Shift]:
    """Shift of every feature that a spectrum (B,) shows.

    Radiance shows absorptions of oxygen and water vapour; reflectance, which is compensated for them, the residual
    of the oxygen band and the red edge.  Bands that are bad or unknown are not used.
    """
    y = np.asarray(spectrum, dtype=float)
    order = np.argsort(axis.centre_nm, kind="stable")
    used = order[(axis.good & np.isfinite(y))[order]]
    if used.size < MIN_BANDS + 2:
        return
    w, y = axis.centre_nm[used], y[used]
    if reflectance:
        residual = oxygen_residual(w, y, axis.fwhm_nm[used])
        if residual is not None:
            yield residual
        edge = red_edge(w, y)
        if np.isfinite(edge):
            yield _feature_shift(RED_EDGE, edge, w)
        return
    for feature in FEATURES:
        in_feature = np.abs(w - feature.centre_nm) <= feature.half_nm
        if in_feature.sum() < MIN_BANDS or np.max(axis.fwhm_nm[used][in_feature]) > feature.half_nm:
            continue
        centre, _ = absorption_centre(w, y, feature)
        if np.isfinite(centre):
            yield _feature_shift(feature, centre, w)


def _feature_shift(feature: Feature, edge_nm: float, wavelength_nm: Array) -> Shift:
    k = int(np.argmin(np.abs(wavelength_nm - edge_nm)))
    spacing = float(np.gradient(wavelength_nm)[k])
    u = float(np.hypot(feature.uncertainty_nm, _SAMPLING * spacing))
    return Shift(feature.name, edge_nm - feature.centre_nm, u)


def common_shifts(spectra: Iterable[Array], axis: SpectralAxis, *, reflectance: bool) -> list[tuple[Shift, int]]:
    """Shift of every feature that some of the spectra (B,) show, and how many do.

    It is the median over these spectra, and so is its uncertainty: that of the feature's position, which the spectra
    share, is not divided by their number.
    """
    found: dict[str, list[Shift]] = {}
    for spectrum in spectra:
        for shift in wavelength_shifts(spectrum, axis, reflectance=reflectance):
            found.setdefault(shift.feature, []).append(shift)
    medians = {name: np.median([(s.nm, s.uncertainty_nm) for s in shifts], axis=0) for name, shifts in found.items()}
    return [(Shift(name, *map(float, medians[name])), len(shifts)) for name, shifts in found.items()]
