"""Whether the wavelengths of a spectrum are right: by absorptions of the atmosphere, what a compensation left of
them, or the red edge of plants."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.processing.intervals import Z95
from hyperval.processing.oxygen_residual import oxygen_residual
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

LEAST_DEPTH = 0.15  # of an absorption under the line between its shoulders
LEAST_BANDS = 3  # in a feature
MOST_GAP = 2.5  # widest step between bands of a feature, in their usual step: bands left out hide its centre
LEAST_PLANT = 3.0  # reflectance at 785 nm over that at 675 nm
_STEPS = 20
_SAMPLING = 0.08  # part of the band spacing by which a centre of few bands is uncertain


@dataclass(frozen=True)
class Feature:
    """An absorption: the centre of its area and how well that is known, and where it is looked for [nm]."""

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
    """How far a feature lies from its place: wavelengths as labelled less the true ones [nm]."""

    feature: str
    nm: float
    uncertainty_nm: float

    @property
    def certain(self) -> bool:
        """Whether the 95 % interval leaves 0 out."""
        return abs(self.nm) > Z95 * self.uncertainty_nm


def absorption_centre(
    wavelength_nm: npt.ArrayLike, radiance: npt.ArrayLike, feature: Feature
) -> tuple[float, float]:
    """Centre of the area of an absorption under the line between its shoulders, and its depth; NaN without one.

    The first moment of what is absorbed, sum d w dw / sum d dw with d = 1 - L / L_line: a symmetric band response
    widens the absorption and leaves the moment where it is.  The window follows the centre until both agree, so
    that a shift of its own width is found too.  Bands left out within it take part of the absorption away, so that
    there is no centre.

    Parameters
    ----------
    wavelength_nm, radiance : (B,) increasing, finite
    """
    w, y = np.asarray(wavelength_nm, dtype=float), np.asarray(radiance, dtype=float)
    wide = (w > feature.centre_nm - 2.0 * feature.half_nm) & (w < feature.centre_nm + 2.0 * feature.half_nm)
    at = np.flatnonzero(wide)
    if at.size < LEAST_BANDS + 2:
        return float("nan"), 0.0
    line = np.interp(w[at], w[at[[0, -1]]], y[at[[0, -1]]])
    centre, depth = float(w[at][np.argmin(y[at] / np.where(line > 0.0, line, np.inf))]), 0.0
    width = np.gradient(w)
    for _ in range(_STEPS):
        before, inside, after = _around(w, centre, feature)
        if not before.any() or not after.any() or inside.sum() < LEAST_BANDS:
            return float("nan"), 0.0
        steps = np.diff(w[before | inside | after])
        if steps.max() > MOST_GAP * np.median(steps):
            return float("nan"), 0.0
        d = 1.0 - y[inside] / _line(w, y, before, inside, after)
        area = float(np.sum(d * width[inside]))
        depth = float(d.max())
        if depth < LEAST_DEPTH or area <= 0.0:
            return float("nan"), depth
        moved = float(np.sum(d * w[inside] * width[inside])) / area
        if abs(moved - centre) < 1e-3:
            break
        # Half steps: bands enter and leave the window, which makes whole ones swing.
        centre = 0.5 * (centre + moved)
    return centre, depth


def centre_uncertainty(
    wavelength_nm: npt.ArrayLike,
    radiance: npt.ArrayLike,
    covariance: npt.ArrayLike,
    feature: Feature,
    centre_nm: float,
) -> float:
    """Standard uncertainty [nm] of an absorption's centre by the errors of its bands; NaN without a centre.

    First order, the line between the shoulders taken as known: a unit of radiance in a band inside moves
    the centre c by -(w - c) dw / (A L_line), A = sum d dw being the area of the absorption.

    Parameters
    ----------
    covariance : (B, B) of the radiance (B,)
    """
    w, y, cov = (np.asarray(x, dtype=float) for x in (wavelength_nm, radiance, covariance))
    if not np.isfinite(centre_nm):
        return float("nan")
    before, inside, after = _around(w, centre_nm, feature)
    line, width = _line(w, y, before, inside, after), np.gradient(w)[inside]
    area = float(np.sum((1.0 - y[inside] / line) * width))
    slope = (w[inside] - centre_nm) * width / (area * line)
    return float(np.sqrt(max(slope @ cov[np.ix_(inside, inside)] @ slope, 0.0)))


def _around(w: Array, centre: float, feature: Feature) -> tuple[Mask, Mask, Mask]:
    """Bands of the shoulder before, of the absorption and of the shoulder after."""
    low, high = centre - feature.half_nm, centre + feature.half_nm
    before = (w >= low - feature.shoulder_nm) & (w < low)
    after = (w > high) & (w <= high + feature.shoulder_nm)
    return before, (w >= low) & (w <= high), after


def _line(w: Array, y: Array, before: Mask, inside: Mask, after: Mask) -> Array:
    """Radiance of the line between the shoulders at the bands inside."""
    ends = [w[before].mean(), w[after].mean()], [y[before].mean(), y[after].mean()]
    return np.asarray(np.interp(w[inside], *ends))


def red_edge(wavelength_nm: npt.ArrayLike, reflectance: npt.ArrayLike) -> float:
    """Wavelength [nm] at half of the rise from the red to the infrared; NaN where nothing rises as plants do."""
    w, y = np.asarray(wavelength_nm, dtype=float), np.asarray(reflectance, dtype=float)
    red, infrared = (w >= 650.0) & (w <= 700.0), (w >= 770.0) & (w <= 800.0)
    if not red.any() or not infrared.any():
        return float("nan")
    low, high = float(y[red].min()), float(y[infrared].mean())
    rise = np.flatnonzero((w >= 670.0) & (w <= 780.0))
    half = 0.5 * (low + high)
    crossed = np.flatnonzero((y[rise][:-1] < half) & (y[rise][1:] >= half))
    if low <= 0.0 or high < LEAST_PLANT * low or crossed.size != 1:
        return float("nan")
    k = rise[crossed[0]]
    return float(w[k] + (half - y[k]) / (y[k + 1] - y[k]) * (w[k + 1] - w[k]))


def wavelength_shifts(spectrum: npt.ArrayLike, axis: SpectralAxis, *, reflectance: bool = False) -> Iterator[Shift]:
    """Shift of every feature that a spectrum (B,) shows.

    Radiance is looked at for absorptions of oxygen and water vapour, reflectance, from which they were taken out,
    for what was left of the oxygen band and for the red edge.  Bands that are bad or unknown are left out.
    """
    y = np.asarray(spectrum, dtype=float)
    order = np.argsort(axis.centre_nm, kind="stable")
    use = order[(axis.good & np.isfinite(y))[order]]
    if use.size < LEAST_BANDS + 2:
        return
    w, y = axis.centre_nm[use], y[use]
    if reflectance:
        left = oxygen_residual(w, y, axis.fwhm_nm[use])
        if left is not None:
            yield Shift(OXYGEN_RESIDUAL, left.shift_nm, left.uncertainty_nm)
        edge = red_edge(w, y)
        if np.isfinite(edge):
            yield _shift(RED_EDGE, edge, w)
        return
    for feature in FEATURES:
        near = np.abs(w - feature.centre_nm) <= feature.half_nm
        if near.sum() < LEAST_BANDS or np.max(axis.fwhm_nm[use][near]) > feature.half_nm:
            continue
        centre, _ = absorption_centre(w, y, feature)
        if np.isfinite(centre):
            yield _shift(feature, centre, w)


def _shift(feature: Feature, edge_nm: float, wavelength_nm: Array) -> Shift:
    at = int(np.argmin(np.abs(wavelength_nm - edge_nm)))
    spacing = float(np.gradient(wavelength_nm)[at])
    u = float(np.hypot(feature.uncertainty_nm, _SAMPLING * spacing))
    return Shift(feature.name, edge_nm - feature.centre_nm, u)
