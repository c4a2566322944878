"""What a product or a header says of its image: bands, units, no-data, sensor; one gain and offset a band.

The spectral axis of a cube from its header: checked, in nm; a unit is taken only where no other can be meant.

Which pixels of a cube hold data, and whether their values can be what they are said to be.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from hyperval.envi_header import EnviHeader
from hyperval.errors import InputError, UsageError, reader
from hyperval.paths import checked_file
from hyperval.spectra.axis import SpectralAxis, fwhm_from_spacing
from hyperval.units import (
    PLAUSIBLE_NM,
    RADIANCE_UNIT,
    only_wavelength_unit,
    radiance_to_internal,
    wavelength_to_nm,
    wavelength_unit_note,
)

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
    return wavelengths_in_names(header.band_names)


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


_REFLECTANCE_UNITS = {"fraction": 1.0, "1": 1.0, "percent": 0.01, "%": 0.01}
_MAX_BYTES = 1 << 20


@dataclass(frozen=True, eq=False)
class Description:
    """What a file, or the metadata beside it, says of an image.

    Attributes
    ----------
    product : in words, for notes
    wavelength, fwhm : (B,) of the stored bands in ``wavelength_unit``; 0 where a band has none. Widths may lack
    wavelength_unit : as the file states it, None when it does not
    good : (B,) False for bands that the product marks as bad
    gain, offset : (B,) value = gain * stored + offset in ``unit``, or numbers for all bands
    quantity : "radiance" or "reflectance", None when the product does not say
    unit : of the scaled values, None when the product does not say
    ignore_value : stored value that means no data
    sensor : name of the instrument, "" when unknown
    sorts : bands may be sorted by wavelength without being told to, as the layout of the product is known
    entries : what else is said, by key, as the entries of a header
    notes : what was assumed
    rectified : False for an image in scanner geometry, whatever map position its file states
    sun_zenith_deg : zenith angle of the sun for the whole image, None when it is not stated
    packing : scale and offset of the file by which its reader has unpacked the values that count as stored here
    """

    product: str
    wavelength: Array
    fwhm: Array | None = None
    wavelength_unit: str | None = None
    good: npt.NDArray[np.bool_] | None = None
    gain: npt.ArrayLike = 1.0
    offset: npt.ArrayLike = 0.0
    quantity: str | None = None
    unit: str | None = None
    ignore_value: float | None = None
    sensor: str = ""
    sorts: bool = False
    entries: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    rectified: bool = True
    sun_zenith_deg: float | None = None
    packing: tuple[float, float] = (1.0, 0.0)

    @property
    def all_notes(self) -> tuple[str, ...]:
        """The product and its sensor, then the notes."""
        by = f" of {self.sensor}" if self.sensor and self.sensor.lower() not in self.product.lower() else ""
        return (f"read as {self.product}{by}", *self.notes)

    def band_table(self, given_unit: str | None, where: str, *, sort_bands: bool = False) -> BandTable:
        """The bands that have a wavelength, in nm and in order.

        Raises
        ------
        InputError : no band has a wavelength, or two share one.
        UsageError : a unit that contradicts the file, or that nobody states.
        """
        has = np.flatnonzero(np.isfinite(self.wavelength) & (self.wavelength > 0))
        if not has.size:
            raise InputError("no band has a wavelength", where=where)
        listed = self.wavelength[has]
        unit, note = stated_unit(self.wavelength_unit, given_unit, listed, where)
        centre = wavelengths_in_nm(listed, unit, where)
        width = None if self.fwhm is None else wavelengths_in_nm(self.fwhm[has], unit, where, width=True)
        if width is not None and not np.all(width > 0):
            raise InputError("band widths (fwhm) that are not positive", where=where)
        good = np.ones(has.size, bool) if self.good is None else self.good[has]
        if not good.any():
            raise InputError("the product marks every band as bad", where=where)
        notes = list(note)
        if has.size < self.wavelength.size:
            notes.append(f"{self.wavelength.size - has.size} stored bands without a wavelength are left out")
        if not good.all():
            notes.append(f"bad-band list: {int((~good).sum())} of {good.size} bands are bad")
        table = ordered_bands(centre, width, good, sort_bands=sort_bands or self.sorts, where=where, notes=tuple(notes))
        return BandTable(table.axis, has[table.stored_band], table.notes)

    def scaling(self, quantity: str, unit: str | None, scale: float | None, where: str) -> Scaling:
        """Gain and offset of every stored band; what the campaign states must be what the product says.

        Raises
        ------
        InputError : the product holds another quantity.
        UsageError : another unit than the product's, or one that nobody states.
        """
        if self.quantity is not None and quantity not in ("other", self.quantity):
            raise InputError(
                f"the product holds {self.quantity}, the campaign says {quantity}",
                where=where,
                mend=f"state quantity: {self.quantity}, or name the {quantity} product",
            )
        both = quantity == "radiance" and unit is not None and self.unit is not None and scale is None
        if both and radiance_to_internal(str(unit)) != radiance_to_internal(str(self.unit)):
            raise UsageError(
                f"the product states its radiance in {self.unit}, the campaign in {unit}",
                where=where,
                mend="leave unit out",
            )
        bands = self.wavelength.size
        gain, offset = (np.broadcast_to(np.asarray(v, float), bands).copy() for v in (self.gain, self.offset))
        note = f"scale of the {self.product}" if np.any(gain != 1.0) or np.any(offset != 0.0) else ""
        if scale is None:
            return scaled(gain, offset, note, quantity=quantity, unit=unit or self.unit, scale=None)
        # What the campaign states multiplies the packed values, and gives a reflectance as a fraction.
        own = self.unit if quantity == "radiance" else None
        whole = scaled(gain, offset, note, quantity=quantity, unit=unit or own, scale=scale)
        return replace(whole, gain=whole.gain / self.packing[0], offset=-whole.gain * self.packing[1] / self.packing[0])


@dataclass(frozen=True)
class Scaling:
    """value = gain * stored + offset, per stored band, in ``unit``.

    Attributes
    ----------
    gain, offset : (B,) in stored band order
    unit : unit of the values
    notes : where the numbers come from
    """

    gain: Array
    offset: Array
    unit: str
    notes: tuple[str, ...] = ()


def scaled(gain: Array, offset: Array, note: str, *, quantity: str, unit: str | None, scale: float | None) -> Scaling:
    """The gain and offset of a file in the internal unit; ``scale`` takes their place.

    Raises
    ------
    UsageError : an unknown unit or quantity, a radiance without unit, or a scale that is no number.
    """
    to_internal, name = _unit_factor(quantity, unit)
    if scale is not None:
        if not np.isfinite(scale) or scale <= 0:
            raise UsageError(f"scale is {scale:g}", expected="a positive number that multiplies the stored values")
        gain, offset = np.full(gain.size, float(scale)), np.zeros(gain.size)
        note = f"stored values x {scale:g} (stated)"
    return Scaling(gain * to_internal, offset * to_internal, name, (note,) if note else ())


def header_scaling(header: EnviHeader | None, bands: int, quantity: str) -> tuple[Array, Array, str]:
    """Gain and offset of every band by a header, and where it states them; 1 and 0 where it does not.

    Reflectance is divided by ``reflectance scale factor`` (or multiplied by ``data reflectance gain values``),
    everything else takes ``data gain values`` and ``data offset values``.

    Raises
    ------
    InputError : a scale factor that is zero, or two that exclude each other.
    """
    one, zero = np.ones(bands), np.zeros(bands)
    if header is None:
        return one, zero, ""
    own = quantity == "reflectance" and "data reflectance gain values" in header.entries
    kind = "data reflectance" if own else "data"
    gain = header.numbers(f"{kind} gain values", bands)
    offset = header.numbers(f"{kind} offset values", bands)
    factor = header.number("reflectance scale factor")
    if gain is not None and np.any(gain == 0):
        raise InputError("a gain of 0 makes every value the same", where=header.where(f"{kind} gain values"))
    if factor is not None and not (np.isfinite(factor) and factor > 0):
        raise InputError(
            f"'reflectance scale factor' is {factor:g}",
            where=header.where("reflectance scale factor"),
            expected="a positive number",
        )
    scaled = gain is not None or offset is not None
    if factor not in (None, 1.0) and (scaled or quantity == "radiance"):
        other = f"'{kind} gain values'" if scaled else "a radiance"
        raise InputError(
            f"'reflectance scale factor' and {other} exclude each other",
            where=header.where("reflectance scale factor"),
            mend="state scale: (what multiplies the stored values) in the campaign",
        )
    if scaled:
        return (one if gain is None else gain), (zero if offset is None else offset), f"{kind} gain/offset values"
    if factor is not None and quantity == "reflectance":
        return one / factor, zero, f"stored values / {factor:g} (reflectance scale factor)"
    return one, zero, ""


def _unit_factor(quantity: str, unit: str | None) -> tuple[float, str]:
    if quantity == "radiance":
        if unit is None:
            raise UsageError(
                "the unit of the radiance is not stated",
                expected=f"for example unit: {RADIANCE_UNIT}",
                mend="state unit: in the campaign",
            )
        return radiance_to_internal(unit), RADIANCE_UNIT
    if quantity == "reflectance":
        if unit is not None and unit not in _REFLECTANCE_UNITS:
            raise UsageError(f"unknown reflectance unit {unit!r}", expected="fraction or percent")
        return _REFLECTANCE_UNITS[unit or "fraction"], "1"
    if quantity == "other":
        return 1.0, unit or ""
    raise UsageError(f"unknown quantity {quantity!r}", expected="radiance, reflectance or other")


def gain_file_beside(image: Path) -> Path | None:
    """The ``.gain`` file that the image's name begins with, as f130612t01p00r10rdn_e.gain; None without one."""
    name = image.name.lower()
    fits = [p for p in sorted(image.parent.glob("*.[gG][aA][iI][nN]")) if name.startswith(p.stem.lower())]
    return max(fits, key=lambda p: len(p.stem), default=None)


def divided(
    path: Path | None, bands: int, quantity: str, unit: str | None, scale: float | None
) -> tuple[npt.NDArray[np.float64] | None, str | None]:
    """(B,) gains of a radiance and its unit, by a file of divisors; None and the stated unit where it has no say.

    Source: JPL, AVIRIS Distribution Document 030217: two columns, factor and channel; spectra divided by the
    factors are radiances in micro-watts/cm^2/nm/sr.

    Raises
    ------
    UsageError : a stated unit that is not the file's.
    """
    if path is None or quantity != "radiance" or scale is not None:
        return None, unit
    if unit is not None and radiance_to_internal(unit) != 1.0:
        raise UsageError(
            f"{path.name} beside the cube gives {RADIANCE_UNIT}, the campaign states {unit}",
            where=str(path),
            mend=f"state unit: {RADIANCE_UNIT}, or scale: and its unit",
        )
    return 1.0 / _divisors(path, bands), RADIANCE_UNIT


@reader
def _divisors(path: Path, bands: int) -> npt.NDArray[np.float64]:
    """(B,) what the stored numbers of each band are divided by.

    Raises
    ------
    InputError : not one positive number for each band, or channels that do not count from 1.
    """
    expected = f"{bands} rows of a factor and a channel that counts from 1"
    text = checked_file(path, what="gain file", most=_MAX_BYTES).read_text("latin-1")
    out = np.empty(bands)
    rows = [(n, r.split()) for n, r in enumerate(text.splitlines(), start=1) if r.strip()]
    if len(rows) != bands:
        raise InputError(f"{len(rows)} rows for {bands} bands", where=str(path), expected=expected)
    for band, (number, cells) in enumerate(rows):
        try:
            out[band], channel = float(cells[0]), int(cells[1]) if len(cells) > 1 else band + 1
        except ValueError:
            out[band], channel = np.nan, 0
        if not (np.isfinite(out[band]) and out[band] > 0 and channel == band + 1):
            raise InputError(f"{' '.join(cells)[:40]!r}", where=f"{path}:{number}", expected=expected)
    return out


Mask = npt.NDArray[np.bool_]


def equals(stored: npt.NDArray[Any], ignore: float) -> Mask:
    """Where the stored values are the ignore value, compared in the stored type."""
    kept = ignore_in_type(stored.dtype, ignore)
    if kept is None:
        return np.zeros(stored.shape, bool)
    return np.asarray(np.isnan(stored) if np.isnan(ignore) else stored == kept)


def ignore_in_type(dtype: np.dtype, ignore: float) -> Any | None:
    """The ignore value as a stored value, None where the type cannot hold it."""
    if dtype.kind == "f":
        beyond = np.isfinite(ignore) and abs(ignore) > 1.0000001 * float(np.finfo(dtype).max)
        return None if beyond else dtype.type(ignore)
    if not float(ignore).is_integer():
        return None
    limits = np.iinfo(dtype)
    if float(ignore) == float(limits.max):  # as a float, the largest 64-bit number is the next power of two
        return dtype.type(limits.max)
    if not limits.min <= int(ignore) <= limits.max:
        return None
    return dtype.type(int(ignore))


def usable_pixels(
    stored: npt.NDArray[Any], *, ignore: float | None, zero_is_fill: bool, needed: Mask | None = None
) -> Mask:
    """Pixels (lines, samples) of stored values (B, lines, samples) that can be used.

    A pixel is not usable where a needed band holds the ignore value or is not finite, or where every band is
    stored as 0 and ``zero_is_fill``.

    Parameters
    ----------
    needed : (B,) bands that must hold data; all by default
    """
    usable = np.ones(stored.shape[1:], bool)
    some = slice(None) if needed is None or needed.all() else needed
    if ignore is not None and ignore_in_type(stored.dtype, ignore) is not None:
        usable &= ~equals(stored[some], ignore).any(axis=0)
    if stored.dtype.kind == "f":
        usable &= np.isfinite(stored[some]).all(axis=0)
    if zero_is_fill:
        # Few pixels hold a 0 in each of three bands; only those are looked at in full.
        dark = stored[-1] == 0
        for band in (0, stored.shape[0] // 2):
            if not dark.any():
                return usable
            dark &= stored[band] == 0
        usable[dark] &= stored[:, dark].any(axis=0)
    return usable


# Above these the 95th percentile of a cube says that its scale was not stated.
CHECKED_SAMPLES = 64  # in each of 16 lines
PLAUSIBLE_REFLECTANCE = 1.5
PLAUSIBLE_RADIANCE = 200.0  # [uW cm-2 sr-1 nm-1]; a white surface under the zenith sun gives about 65


def _some_values(cube: Any, line: int) -> npt.NDArray[Any]:
    """(n,) values of valid pixels of a line, spread over its samples, in the good bands."""
    rows = np.full(min(cube.samples, CHECKED_SAMPLES), line)
    cols = np.linspace(0, cube.samples - 1, rows.size).astype(int)
    return np.asarray(cube.spectra((rows, cols))[:, cube.axis.good].ravel())


def check_values_of(cube: Any) -> None:
    """Raise InputError when the values are too large for the quantity: a scale that was not stated."""
    limit = {"reflectance": PLAUSIBLE_REFLECTANCE, "radiance": PLAUSIBLE_RADIANCE}.get(cube.quantity)
    if limit is None:
        return
    lines = np.unique(np.linspace(0, cube.lines - 1, 16).astype(int))
    sample = np.concatenate([_some_values(cube, int(line)) for line in lines])
    if sample.size == 0:
        return
    high = float(np.percentile(sample, 95))
    if high > limit:
        raise InputError(
            f"95 % of the {cube.quantity} values reach up to {high:.4g} {cube.unit}".removesuffix(" 1"),
            where=str(cube.raster.path),
            expected=f"at most {limit:g}",
            mend="state scale: (what multiplies the stored values) or unit:"
            if cube.quantity == "radiance"
            else "state scale: what multiplies the stored values (0.01 where they are percent, 0.0001 where they "
            "are reflectance times 10000)",
        )
