"""What a product or a header says of its image: bands, units, no-data, sensor; one gain and offset a band."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.envi_header import EnviHeader
from hyperval.errors import InputError, UsageError, reader
from hyperval.imagery.band_table import BandTable, ordered_bands, stated_unit, wavelengths_in_nm
from hyperval.paths import checked_file
from hyperval.units import RADIANCE_UNIT, radiance_to_internal

Array = npt.NDArray[np.float64]
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
        table = ordered_bands(
            centre, width, good, sort_bands=sort_bands or self.sorts, where=where, notes=tuple(notes)
        )
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
        return scaled(gain, offset, note, quantity=quantity, unit=unit or self.unit, scale=scale)


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


def scaled(
    gain: Array, offset: Array, note: str, *, quantity: str, unit: str | None, scale: float | None
) -> Scaling:
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
