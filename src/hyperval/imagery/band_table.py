"""The spectral axis of a cube from its header: checked, in nm; a unit is taken only where no other can be meant."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from hyperval.envi_header import EnviHeader
from hyperval.errors import InputError, UsageError
from hyperval.spectra.axis import SpectralAxis, fwhm_from_spacing
from hyperval.units import PLAUSIBLE_NM, only_wavelength_unit, wavelength_to_nm, wavelength_unit_note

Array = npt.NDArray[np.float64]
Bands = SpectralAxis | Literal["numbers"] | None

LEAST_FWHM_NM = 0.05  # the finest imaging spectrometers, for fluorescence, have 0.1 to 0.3
_UNIT = r"(nm|nanomet\w*|[uµμ]m|micromet\w*|microns?)"
_SPREAD = r"(?:(?:\+\s*/?\s*-|±)\s*[0-9.]+\s*)?"  # half a width, as ITRES writes it
# A number alone in parentheses is taken for a wavelength where it is as fine as ENVI writes it.
_NAMED = re.compile(
    rf"\(\s*([0-9]+\.[0-9]{{3,}})\s*\)|(?<![0-9.])([0-9]+(?:\.[0-9]+)?)\s*{_SPREAD}{_UNIT}(?![a-z])", re.IGNORECASE
)
_UNSTATED = ("", "unknown", "none")


@dataclass(frozen=True)
class BandTable:
    """Spectral axis of a cube, and which stored band each of its bands is.

    Attributes
    ----------
    axis : the bands in increasing wavelength
    stored_band : (B,) 0-based number of the stored band; 0, 1, 2, ... unless bands were sorted
    notes : what was assumed
    """

    axis: SpectralAxis
    stored_band: npt.NDArray[np.intp]
    notes: tuple[str, ...] = ()


def band_table(header: EnviHeader, *, wavelength_unit: str | None = None, sort_bands: bool = False) -> BandTable:
    """Band centres, widths and bad-band list of an ENVI header.

    Parameters
    ----------
    header : the parsed header
    wavelength_unit : the unit where the header states none; must agree with the header otherwise
    sort_bands : sort bands whose wavelengths do not increase (two detectors that overlap)

    Raises
    ------
    InputError : no wavelengths, a wrong count, not finite, not increasing, widths not positive, or
        a bad-band list that does not fit.
    UsageError : the unit is missing or contradicts the header, or the wavelengths are implausible in it.
    """
    values, key = header.numbers("wavelength", header.bands), "wavelength"
    in_names = _in_header_names(header) if values is None else None
    stated, remarks = header.text("wavelength units"), []
    if in_names is not None:
        values, key, stated = in_names[0], "band names", in_names[1] or stated
        remarks.append("the header lists no wavelengths: those in the names of its bands are taken")
    if values is None:
        raise InputError(
            "the header lists no wavelengths",
            where=str(header.path),
            expected=f"'wavelength = {{...}}' with {header.bands} values",
        )
    unit, note = stated_unit(stated, wavelength_unit, values, header.where("wavelength units"))
    centre = wavelengths_in_nm(values, unit, header.where(key))
    notes = [*remarks, *note]
    good = np.ones(header.bands, bool)
    flags = header.numbers("bbl", header.bands)
    if flags is not None:
        if not np.all(np.isin(flags, (0.0, 1.0))):
            raise InputError(
                "the bad-band list holds other values than 0 (bad) and 1 (good)", where=header.where("bbl")
            )
        good = flags == 1.0
        if not good.any():
            raise InputError("the bad-band list marks every band as bad", where=header.where("bbl"))
        notes.append(f"bad-band list: {int((~good).sum())} of {good.size} bands are bad")
    width = header.numbers("fwhm", header.bands)
    if width is not None and not width.any():
        notes.append("every fwhm in the header is 0, which is none")
        width = None
    if width is not None:
        if np.any(width <= 0):
            at = int(np.flatnonzero(width <= 0)[0])
            raise InputError(f"band {at + 1} has a width (fwhm) of {width[at]:g}", where=header.where("fwhm"))
        width = width * wavelength_to_nm(unit)
        _check_widths(width, centre, unit, header.where("fwhm"))
    return ordered_bands(
        centre, width, good, sort_bands=sort_bands, where=header.where("wavelength"), notes=tuple(notes)
    )


def lists_wavelengths(header: EnviHeader) -> bool:
    """Whether a header has wavelengths, as a list or in the names of its bands."""
    return header.text("wavelength") is not None or _in_header_names(header) is not None


def _in_header_names(header: EnviHeader) -> tuple[Array, str | None] | None:
    names = header.strings("band names") or ()
    return wavelengths_in_names(names) if len(names) == header.bands else None


def wavelengths_in_names(names: Sequence[str]) -> tuple[Array, str | None] | None:
    """The wavelength in the name of every band, and its unit where the names have one; None where not all have it.

    ENVI writes ``Band 7 (0.548000)``, others ``548.3 nm``: a number in parentheses or before a unit.
    """
    hits = [_NAMED.findall(name) for name in names]
    if not hits or any(len(hit) != 1 for hit in hits):
        return None
    numbers = np.array([float(h[0][0] or h[0][1]) for h in hits])
    units = {h[0][2] for h in hits}
    if len(units) != 1 or (units == {""} and not np.all(np.diff(numbers) > 0)):
        return None
    return numbers, units.pop() or None


def given_bands(axis: SpectralAxis | Literal["numbers"], count: int, where: str) -> BandTable:
    """Bands that are given beside a file of ``count``, or that go by their number from 1 in place of a wavelength.

    Raises
    ------
    UsageError : an axis of another number of bands.
    """
    if axis == "numbers":
        note = "warning: bands go by their number: where nm are written, it is the number of a band"
        return BandTable(SpectralAxis(np.arange(1.0, count + 1.0), np.ones(count)), np.arange(count), (note,))
    if len(axis) != count:
        raise UsageError(f"the given axis has {len(axis)} bands, the cube {count}", where=where)
    return BandTable(axis, np.arange(count), ("wavelengths as given beside the cube",))


def ordered_bands(
    centre_nm: Array,
    fwhm_nm: Array | None,
    good: npt.NDArray[np.bool_],
    *,
    sort_bands: bool,
    where: str,
    notes: tuple[str, ...] = (),
) -> BandTable:
    """The bands of a file in increasing wavelength; ``fwhm_nm`` None takes the spacing of each detector.

    Raises
    ------
    InputError : wavelengths that do not increase and are not to be sorted, or of which two are the same.
    """
    centre, order, remarks = centre_nm, np.arange(centre_nm.size), list(notes)
    steps = np.diff(centre)
    if np.any(steps <= 0):
        at = int(np.flatnonzero(steps <= 0)[0])
        if not sort_bands or np.unique(centre).size < centre.size:
            same = np.unique(centre).size < centre.size
            raise InputError(
                f"wavelengths do not increase: band {at + 2} ({centre[at + 1]:g} nm) follows band {at + 1} "
                f"({centre[at]:g} nm){' (two bands share a wavelength)' if same else ''}",
                where=where,
                mend="give the bands of one wavelength their own centres, in a header that collection.cube names"
                if same
                else "where detectors overlap or bands stand in falling order, state sort_bands: true "
                "under collection.cube",
            )
        order = np.argsort(centre, kind="stable")
        remarks.append(f"{int(np.sum(order != np.arange(order.size)))} bands were moved to sort the wavelengths")
    if fwhm_nm is None:
        fwhm_nm = _spacing_by_detector(centre)
        remarks.append("the file lists no fwhm: band widths are taken as the band spacing")
    return BandTable(SpectralAxis(centre[order], fwhm_nm[order], good[order]), order, tuple(remarks))


def _check_widths(fwhm: Array, centre: Array, unit: str, where: str) -> None:
    """Raise InputError for widths [nm] that are plainly not in the unit of the wavelengths."""
    if np.any(fwhm >= centre) or np.median(fwhm) < LEAST_FWHM_NM:
        raise InputError(
            f"band widths (fwhm) from {fwhm.min():g} to {fwhm.max():g} nm, read in {unit} as the wavelengths are",
            where=where,
            expected="widths in the unit of the wavelengths, smaller than these",
            mend="convert the widths in a copy of the header, or give a table of the bands (collection.bands)",
        )


def _spacing_by_detector(centre: Array) -> Array:
    """Spacing (B,) of bands [nm] in the order of the file: a detector ends where the wavelength jumps back.

    Once sorted, the bands of two detectors that overlap lie closer to each other than either's own.
    """
    if np.all(np.diff(centre) < 0):
        return fwhm_from_spacing(centre[::-1])[::-1]
    detectors = np.split(centre, np.flatnonzero(np.diff(centre) <= 0) + 1)
    if min(d.size for d in detectors) < 2:
        order = np.argsort(centre, kind="stable")
        out = np.empty_like(centre)
        out[order] = fwhm_from_spacing(centre[order])
        return out
    return np.concatenate([fwhm_from_spacing(d) for d in detectors])


def stated_unit(in_file: str | None, given: str | None, values: Array, where: str) -> tuple[str, tuple[str, ...]]:
    """The wavelength unit that the file or the caller states, else the only one that the values can be in, noted.

    Raises
    ------
    InputError : a unit that is no wavelength.
    UsageError : the caller contradicts the file, or nobody states the unit of values that fit two, or none.
    """
    text = (in_file or "").strip(" \t\"'")
    if text.lower() in _UNSTATED:
        if given is not None:
            return given, ()
        unit = only_wavelength_unit(values)
        if unit is None:
            raise UsageError(
                f"the file states no wavelength unit, and {values.min():g} to {values.max():g} do not tell it",
                where=where,
                expected="nm or um",
                mend="state wavelength_unit: nm (or um) in the campaign",
            )
        return unit, (wavelength_unit_note(values, unit),)
    try:
        factor = wavelength_to_nm(text)
    except UsageError:
        raise InputError(
            f"wavelengths in {text!r} cannot be used",
            where=where,
            expected="nm or um",
            mend="give a table of the bands (collection.bands)",
        ) from None
    if given is not None and wavelength_to_nm(given) != factor:
        raise UsageError(
            f"the file states wavelengths in {text}, the campaign in {given}",
            where=where,
            mend="take wavelength_unit out of the campaign, or correct the file",
        )
    return text, ()


def wavelengths_in_nm(values: Array, unit: str, where: str, *, width: bool = False) -> Array:
    """Wavelengths, or widths of bands, in nm; UsageError when wavelengths are implausible in ``unit``."""
    nm = values * wavelength_to_nm(unit)
    if width:
        return nm
    low, high = PLAUSIBLE_NM
    if nm.min() < low or nm.max() > high:
        raise UsageError(
            f"wavelengths from {values.min():g} to {values.max():g} cannot be in {unit}",
            where=where,
            expected=f"{low:g} to {high:g} nm",
            mend="0.4 to 2.5 is um, 400 to 2500 is nm: correct the wavelength unit",
        )
    return nm
