"""The spectral axis: the bands that every product of one comparison shares, their responses, and atmospheric windows.

Limits of the windows are rounded positions of the well known gas absorptions of the solar-reflective range (Gao et al.,
Remote Sens. Environ. 113, 2009, S17-S24, discuss each); a comparison inside an absorption tests the gas amounts, not
the sensor, and is reported apart.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from hyperval.data import Array, Mask
from hyperval.errors import needed, package_table, refuse
from hyperval.units import PLAUSIBLE_NM, in_nm, only_wavelength_unit, plausible, to_internal, wavelength_unit_named

_UNSTATED = ("", "unknown", "none", "<unspecified>")  # of a unit
SUNLIT_NM = 3000.0  # up to which reflected sunlight is most; numbers beyond it that nobody calls nm may be wavenumbers

_WORDS = package_table("spectra/words.yaml")
# (from nm, to nm, gas), and names of parts of the range (from nm, to nm).
ABSORPTION_BANDS_NM: list[tuple[float, float, str]] = [(*ends, gas) for *ends, gas in _WORDS["absorption_bands_nm"]]
SPECTRAL_REGIONS_NM: dict[str, tuple[float, float]] = {
    name: (low, high) for name, (low, high) in _WORDS["regions_nm"].items()
}


def in_window(wavelength_nm: npt.ArrayLike) -> Mask:
    """True for wavelengths between 400 and 2500 nm that lie in no absorption band."""
    w = np.asarray(wavelength_nm, dtype=float)
    clear = (w >= 400.0) & (w <= 2500.0)
    for low, high, _ in ABSORPTION_BANDS_NM:
        clear &= ~((w >= low) & (w <= high))
    return clear


@dataclass(frozen=True)
class SpectralAxis:
    """Band centres and widths.

    Attributes
    ----------
    centre_nm : (B,) strictly increasing band centres [nm]
    fwhm_nm : (B,) full widths at half maximum [nm]; positive
    good : (B,) True where the band is usable (bad-band list applied)
    """

    centre_nm: Array
    fwhm_nm: Array
    good: Mask = field(default_factory=lambda: np.ones(0, bool))

    def __post_init__(self) -> None:
        centre = np.asarray(self.centre_nm, dtype=float)
        fwhm = np.broadcast_to(np.asarray(self.fwhm_nm, dtype=float), centre.shape).copy()
        good = np.asarray(self.good, dtype=bool)
        if good.size == 0:  # not given: every band is usable
            good = np.ones(centre.shape, bool)
        refuse(centre.ndim != 1 or centre.size == 0, "axis.empty")
        refuse(not np.all(np.isfinite(centre)) or not np.all(np.isfinite(fwhm)), "axis.infinite")
        falls = np.flatnonzero(np.diff(centre) <= 0)[:1]
        refuse(falls.size, "axis.order", first=falls + 1, second=falls + 2, low=centre[falls], high=centre[falls + 1])
        refuse(np.any(fwhm <= 0), "axis.width")
        refuse(good.shape != centre.shape, "axis.flags", count=good.size, bands=centre.size)
        for name, value in (("centre_nm", centre), ("fwhm_nm", fwhm), ("good", good)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return int(self.centre_nm.size)

    @property
    def numbered(self) -> bool:
        """True where numbers of bands stand in place of wavelengths, which are never below 100 nm."""
        return bool(self.centre_nm[0] < PLAUSIBLE_NM[0])

    @property
    def in_windows(self) -> Mask:
        """(B,) bands in the clear windows of the atmosphere; none where bands go by number.

        >>> SpectralAxis(np.arange(1.0, 481.0), 1.0).in_windows.any()
        np.False_
        """
        return in_window(self.centre_nm) & (not self.numbered)

    @property
    def clear(self) -> Mask:
        """(B,) good bands in these windows, by which a spectrum is summarised; all good ones where bands go by number.

        >>> SpectralAxis([500.0, 600.0, 940.0], 10.0, np.array([True, False, True])).clear
        array([ True, False, False])
        >>> SpectralAxis(np.arange(1.0, 4.0), 1.0, np.array([True, False, True])).clear
        array([ True, False,  True])
        """
        return self.good & (self.in_windows | self.numbered)

    @property
    def words(self) -> str:
        """How many bands, and from where to where.

        >>> SpectralAxis(np.array([500.0, 520.0]), 5.0).words, SpectralAxis(np.array([1.0, 2.0]), 1.0).words
        ('2 bands, 500-520 nm', '2 bands by number')
        """
        ends = " by number" if self.numbered else f", {self.centre_nm[0]:.0f}-{self.centre_nm[-1]:.0f} nm"
        return f"{len(self)} bands{ends}"

    def select(self, keep: npt.NDArray[Any]) -> SpectralAxis:
        """The axis of the bands that ``keep`` (mask or indices) names."""
        return SpectralAxis(self.centre_nm[keep], self.fwhm_nm[keep], self.good[keep])

    def nearest(self, wavelength_nm: float, widths: float = 1.0) -> int | None:
        """Number of the band nearest a wavelength; None where it is further off than so many of its widths.

        >>> axis = SpectralAxis(np.array([500.0, 520.0]), np.array([5.0, 10.0]))
        >>> axis.nearest(511.0), axis.nearest(509.0), axis.nearest(509.0, widths=2.0)
        (1, None, 0)
        """
        k = int(np.argmin(np.abs(self.centre_nm - wavelength_nm)))
        return k if abs(self.centre_nm[k] - wavelength_nm) <= widths * self.fwhm_nm[k] else None

    def matches(self, other: SpectralAxis, tolerance_nm: float = 0.05) -> bool:
        """True when both axes have the same band centres to ``tolerance_nm``."""
        return len(self) == len(other) and bool(np.all(np.abs(self.centre_nm - other.centre_nm) <= tolerance_nm))


def wavelengths_in_nm(
    values: Array, stated: str | None, by_user: str | None, where: str
) -> tuple[Array, str, tuple[str, ...]]:
    """Wavelengths [nm], their unit, and a note where nobody states it and only one is possible.

    Parameters
    ----------
    stated, given : by the file, and by its caller

    Raises
    ------
    InputError : a unit in which they cannot be used.
    UsageError : file and caller contradict each other, nobody states a unit, or they are implausible in it.
    """
    text = (stated or "").strip(" \t\"'")
    text = "" if text.lower() in _UNSTATED else text if in_nm(text) else wavelength_unit_named(text) or text
    refuse(text and in_nm(text) is None, "wavelengths.unit", where, unit=text)
    unlike = text and by_user is not None and to_internal(by_user, "wavelength") != in_nm(text)
    refuse(unlike, "wavelengths.units", where, stated=text, given=by_user)
    unit, ends = text or by_user or only_wavelength_unit(values), {"least": values.min(), "most": values.max()}
    unit = needed(unit, "wavelengths.unstated", where, **ends)
    refuse(not (text or by_user) and ends["most"] > SUNLIT_NM, "wavelengths.doubtful", where, **ends)
    nm, (low, high) = values * to_internal(unit, "wavelength"), PLAUSIBLE_NM
    refuse(not plausible(nm), "wavelengths.implausible", where, **ends, unit=unit, low=low, high=high)
    note = f"the file states no wavelength unit: {ends['least']:g} to {ends['most']:g} can only be {unit}"
    return nm, unit, () if text or by_user else (note,)


_GAP = 5.0  # times the median step between bands: what stands beside one does not touch the next


def fwhm_from_spacing(centre_nm: npt.ArrayLike) -> tuple[Array, Mask]:
    """Widths (B,) of bands without a stated one: their spacing [nm]; and (B,) which of them are beside a gap.

    Beside a gap a band is as wide as the step on its other side or, where it stands alone, as the median step.

    >>> widths, beside_gap = fwhm_from_spacing([400.0, 405.0, 411.0, 415.0, 940.0, 1040.0])
    >>> widths.tolist(), beside_gap.tolist()
    ([5.0, 5.5, 5.0, 4.0, 6.0, 6.0], [False, False, False, True, True, True])
    """
    centre = np.asarray(centre_nm, dtype=float)
    refuse(centre.size < 2, "axis.single")
    step, width = np.diff(centre), np.gradient(centre)
    sides, most = np.stack([step[[0, *range(step.size)]], step[[*range(step.size), -1]]]), _GAP * np.median(step)
    nearer, beside_gap = sides.min(axis=0), sides.max(axis=0) > most
    return np.where(beside_gap, np.where(nearer > most, most / _GAP, nearer), width), np.asarray(beside_gap)


def spacing_note(lacking: str, lone_nm: Array) -> str:
    """The note on :func:`fwhm_from_spacing`, by what is ``lacking``; ``lone_nm``: centres beside gaps [nm].

    >>> [spacing_note("none", np.array(nm)).partition(": ")[0] for nm in ([415.0], [])]
    ['warning', 'none']
    """
    note, first = f"{lacking}: band widths are taken as the band spacing", ", ".join(f"{nm:.4g}" for nm in lone_nm[:5])
    beside = f"{lone_nm.size} bands beside gaps (the first: {first} nm)"
    guess = f"warning: {note}; those of {beside} are guesses by nearer bands"
    mend = "list all in the header (fwhm) or in a table of the bands (collection.bands: fwhm_column)"
    return f"{guess}: {mend}" if lone_nm.size else note


# A Gaussian of FWHM w has sigma = w / (2 sqrt(2 ln 2)).
SIGMA_PER_FWHM = 1.0 / (2.0 * np.sqrt(2.0 * np.log(2.0)))
CUT_SIGMA = 3.0


def band_average(
    wavelength_nm: npt.ArrayLike, values: npt.ArrayLike, axis: SpectralAxis, *, outside: str = "raise"
) -> Array:
    """Average of a sampled spectrum over Gaussian band responses.

    The response of a band is exp(-(l - c)^2 / 2 sigma^2) cut at +-3 sigma and normalised to unit
    area; the spectrum between its samples is taken as linear, and the product of both is integrated
    exactly, so that neither narrow lines nor bands narrower than the sampling are missed.

    Parameters
    ----------
    wavelength_nm : (n,) increasing sample positions [nm]
    values : (..., n) spectrum or stack of spectra, any unit
    axis : the bands
    outside : "raise" (default) when a response reaches beyond the samples by more than half a
        FWHM, or "nan" to give NaN for those bands

    Returns
    -------
    (..., B) band averages in the unit of ``values``.

    Raises
    ------
    UsageError : the spectrum does not cover the bands.
    """
    grid = np.asarray(wavelength_nm, dtype=float)
    y = np.asarray(values, dtype=float)
    refuse(grid.ndim != 1 or y.shape[-1] != grid.size, "samples.count", values=y.shape[-1], wavelengths=grid.size)
    refuse(np.any(np.diff(grid) <= 0), "samples.order")
    matrix, short = band_weights(grid, axis)
    bad = axis.centre_nm[short]
    refuse(bad.size and outside == "raise", "samples.short", ends=grid[[0, -1]], count=bad.size, bands=bad)
    result = y @ matrix.T
    result[..., short] = np.nan
    return result


def band_weights(grid: Array, axis: SpectralAxis) -> tuple[Array, Mask]:
    """(B, n) weights of samples at ``grid`` (n,) [nm] in :func:`band_average`, and (B,) bands that reach beyond.

    In units of sigma from the centre, a step of the grid from x0 to x1 has of the response, where it is not cut,

        I0 = Phi(b) - Phi(a),  I1 = phi(a) - phi(b),  [a, b] = [x0, x1] within +-3

    of which the sample at x1 takes (I1 - x0 I0) / (x1 - x0), and that at x0 the rest of I0.
    """
    sigma = axis.fwhm_nm * SIGMA_PER_FWHM
    centre = axis.centre_nm
    short = (centre - 0.5 * axis.fwhm_nm < grid[0]) | (centre + 0.5 * axis.fwhm_nm > grid[-1])
    first = np.searchsorted(grid, centre - CUT_SIGMA * sigma, side="right") - 1
    last = np.searchsorted(grid, centre + CUT_SIGMA * sigma)
    steps = int(np.clip(np.max(last - first), 1, grid.size - 1))  # as many for all bands as the widest reaches over
    index = np.clip(first, 0, grid.size - 1 - steps)[:, None] + np.arange(steps + 1)
    x = (grid[index] - centre[:, None]) / sigma[:, None]
    cut = np.clip(x, -CUT_SIGMA, CUT_SIGMA)
    area = np.diff(ndtr(cut))
    upper = -(np.diff(np.exp(-0.5 * cut**2)) / np.sqrt(2.0 * np.pi) + x[:, :-1] * area) / np.diff(x)
    weights = np.zeros(x.shape)
    weights[:, 1:] = upper
    weights[:, :-1] += area - upper
    with np.errstate(invalid="ignore"):
        weights /= weights.sum(axis=1, keepdims=True)
    matrix = np.zeros((len(axis), grid.size))
    np.put_along_axis(matrix, index, weights, axis=1)
    return matrix, short
