"""What the files of an image say of it, and what is taken from that: bands, unit and scale, no data.

Every reader hands on a :class:`Raster`: stored numbers with a :class:`Description`.  Here alone it is decided which
wavelengths, which unit and which scale an image has, which of its pixels hold data, and whether its values can be
what they are said to be.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS
from rasterio.errors import CRSError

from hyperval.envi_header import EnviHeader
from hyperval.errors import HypervalError, InputError, UsageError, reader
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
Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]
Bands = SpectralAxis | Literal["numbers"] | None

MAX_READ_BYTES = 16 << 20  # of single pixels' lines at once
LEAST_FWHM_NM = 0.05  # the finest imaging spectrometers, for fluorescence, have 0.1 to 0.3
_UNIT = r"(nm|nanomet\w*|[uµμ]m|micromet\w*|microns?)"
_SPREAD = r"(?:(?:\+\s*/?\s*-|±)\s*[0-9.]+\s*)?"  # half a width, as ITRES writes it
# A number alone in parentheses is taken for a wavelength where it is as fine as ENVI writes it.
_NAMED = re.compile(
    rf"\(\s*([0-9]+\.[0-9]{{3,}})\s*\)|(?<![0-9.])([0-9]+(?:\.[0-9]+)?)\s*{_SPREAD}{_UNIT}(?![a-z])", re.IGNORECASE
)
_UNSTATED = ("", "unknown", "none")
_REFLECTANCE_UNITS = {"fraction": 1.0, "1": 1.0, "percent": 0.01, "%": 0.01}
_MAX_GAIN_BYTES = 1 << 20
# Above these the 95th percentile of a cube says that its scale was not stated.
CHECKED_SAMPLES = 64  # in each of 16 lines
PLAUSIBLE = {"reflectance": 1.5, "radiance": 200.0}  # a white surface under the zenith sun gives about 65


class ListedBands(NamedTuple):
    """The bands that a file lists, in its own unit and order.

    Attributes
    ----------
    wavelength, fwhm : (B,) of the stored bands, NaN where a band has none; widths may lack
    unit : of both, None where the file does not say
    good : (B,) False for bands that the file marks as bad
    where : place of an entry in its file, for messages
    notes : what was taken for what
    """

    wavelength: Array
    fwhm: Array | None = None
    unit: str | None = None
    good: Mask | None = None
    where: Mapping[str, str] = {}
    notes: tuple[str, ...] = ()


class Scale(NamedTuple):
    """value = gain * stored + offset in ``unit``, for all bands or (B,) for each, and what states it."""

    gain: npt.ArrayLike = 1.0
    offset: npt.ArrayLike = 0.0
    source: str = ""
    unit: str | None = None


UNSCALED = Scale()


@dataclass(frozen=True)
class BandTable:
    """Spectral axis of a cube, and which stored band each of its bands is.

    Attributes
    ----------
    axis : the bands in increasing wavelength
    stored_band : (B,) 0-based number of the stored band; 0, 1, 2, ... unless bands were sorted or left out
    notes : what was assumed
    """

    axis: SpectralAxis
    stored_band: Index
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Description:
    """What a file, or the metadata beside it, says of an image.

    Attributes
    ----------
    product : in words, "" for a plain image
    bands : as listed, None where the file lists none
    scale : as stated
    quantity : "radiance" or "reflectance", None when the files do not say
    unit : of the scaled values, None when the files do not say
    ignore_value : stored value that means no data
    sensor : name of the instrument, "" when unknown
    sorts : bands may be sorted by wavelength without being told to, as the layout of the product is known
    entries : what else is said, by key, as the entries of a header
    notes : what was assumed
    sun_zenith_deg : zenith angle of the sun for the whole image, None when it is not stated
    packing : scale and offset of the file by which its reader has unpacked the values that count as stored here
    """

    product: str = ""
    bands: ListedBands | None = None
    scale: Scale = UNSCALED
    quantity: str | None = None
    unit: str | None = None
    ignore_value: float | None = None
    sensor: str = ""
    sorts: bool = False
    entries: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    sun_zenith_deg: float | None = None
    packing: tuple[float, float] = (1.0, 0.0)

    @property
    def all_notes(self) -> tuple[str, ...]:
        """The product and its sensor, then the notes."""
        by = f" of {self.sensor}" if self.sensor and self.sensor.lower() not in self.product.lower() else ""
        return (f"read as {self.product}{by}", *self.notes) if self.product else self.notes

    @property
    def band_names(self) -> tuple[str, ...]:
        """The names of the bands, empty without any."""
        return ()

    def listed(self) -> ListedBands | None:
        """The bands as the file lists them, None where it lists none."""
        return self.bands

    def scales(self, quantity: str) -> list[Scale]:
        """What the files state that values of a quantity are scaled by: at most one of them may do something."""
        return [self.scale]

    def no_data(self) -> float | None:
        """Stored value that means no data."""
        return self.ignore_value

    def band_table(self, given_unit: str | None, where: str, *, sort_bands: bool = False) -> BandTable:
        """The bands that have a wavelength, in nm and in order.

        Parameters
        ----------
        given_unit : the unit where the file states none; must agree with the file otherwise
        sort_bands : sort bands whose wavelengths do not increase (two detectors that overlap)

        Raises
        ------
        InputError : no wavelengths, a wrong count, not finite, not increasing, two the same, widths not positive, or
            a bad-band list that does not fit.
        UsageError : a unit that contradicts the file or that nobody states, or wavelengths implausible in it.
        """
        bands = self.listed()
        if bands is None:
            raise InputError(
                "the file lists no wavelengths",
                where=where,
                expected="'wavelength = {...}' with a value for each band in an ENVI header",
                mend="give the header that lists them (cube.header), or a table of the bands (collection.bands)",
            )
        has = np.flatnonzero(np.isfinite(bands.wavelength))
        if not has.size:
            raise InputError("no band has a wavelength", where=where)
        listed, notes = bands.wavelength[has], list(bands.notes)
        unit, note = stated_unit(bands.unit, given_unit, listed, bands.where.get("wavelength units", where))
        centre = wavelengths_in_nm(listed, unit, bands.where.get("wavelength", where))
        notes += note
        if has.size < bands.wavelength.size:
            notes.append(f"{bands.wavelength.size - has.size} stored bands without a wavelength are left out")
        good = np.ones(has.size, bool) if bands.good is None else bands.good[has]
        if not good.any():
            raise InputError("the file marks every band as bad", where=bands.where.get("bbl", where))
        if bands.good is not None and ("bbl" in bands.where or not good.all()):
            notes.append(f"bad-band list: {int((~good).sum())} of {good.size} bands are bad")
        width = None if bands.fwhm is None else bands.fwhm[has] * wavelength_to_nm(unit)
        if width is not None and not width.any():
            notes.append("every fwhm in the file is 0, which is none")
            width = None
        if width is not None:
            _check_widths(width, centre, unit, bands.where.get("fwhm", where))
        table = _ordered(centre, width, good, sort_bands or self.sorts, bands.where.get("wavelength", where))
        return BandTable(table.axis, has[table.stored_band], (*notes, *table.notes))

    def scaling(self, quantity: str, unit: str | None, scale: float | None, bands: int, where: str) -> Scale:
        """Gain and offset (B,) of so many stored bands in the internal unit.

        What the campaign states must be what the files say; ``scale`` multiplies the stored values, and replaces
        whatever the files say of a scale.

        Raises
        ------
        InputError : the files hold another quantity, scale the values twice or by 0.
        UsageError : another unit than the file's, one that nobody states or that is unknown, a scale that is none.
        """
        if self.quantity is not None and quantity not in ("counts", "other", self.quantity):
            raise InputError(
                f"the product holds {self.quantity}, the campaign says {quantity}",
                where=where,
                mend=f"state quantity: {self.quantity}, or name the {quantity} product",
            )
        if scale is not None:
            if not np.isfinite(scale) or scale <= 0:
                raise UsageError(f"scale is {scale:g}", expected="a positive number that multiplies the stored values")
            # It multiplies the packed values, and gives a reflectance as a fraction.
            own = self.unit if quantity == "radiance" else None
            stated = Scale(scale / self.packing[0], -scale * self.packing[1] / self.packing[0])
            note = f"stored values x {scale:g} (stated)"
        else:
            active = [s for s in self.scales(quantity) if np.any(np.asarray(s.gain) != 1.0) or np.any(s.offset)]
            if len(active) > 1:
                raise InputError(
                    f"{active[0].source} and {active[1].source} exclude each other",
                    where=where,
                    mend="state scale: (what multiplies the stored values) in the campaign",
                )
            stated = active[0] if active else UNSCALED
            own, note = stated.unit or self.unit, stated.source
            if quantity == "radiance" and unit and own and radiance_to_internal(unit) != radiance_to_internal(own):
                raise UsageError(
                    f"the file states its radiance in {own}{f' ({note})' * bool(stated.unit)}, the campaign in {unit}",
                    where=where,
                    mend="leave unit out, or state scale: and its unit",
                )
        factor, name = _unit_factor(quantity, unit or own)
        gain, offset = (np.broadcast_to(factor * np.asarray(v, float), bands).copy() for v in stated[:2])
        return Scale(gain, offset, note, name)


@dataclass(frozen=True, eq=False)
class HeaderDescription(Description):
    """What an ENVI header says of an image, before what its data file says itself.

    Attributes
    ----------
    header : its lists and scale factors are read when they are asked for, as a campaign may state them itself
    inner : what the tags of a GeoTIFF say
    gains_path : file of what its whole numbers are divided by to give radiance, where one lies beside it
    """

    header: EnviHeader = field(kw_only=True)
    inner: Description | None = None
    gains_path: Path | None = None

    @property
    def band_names(self) -> tuple[str, ...]:
        """The names of the bands, empty where the header does not have one for each."""
        return self.header.band_names

    def no_data(self) -> float | None:
        """The ``data ignore value``, else that of the data file."""
        stated = self.header.number("data ignore value")
        return self.inner.no_data() if stated is None and self.inner is not None else stated

    def listed(self) -> ListedBands | None:
        """Band centres, widths and bad-band list of the header."""
        header = self.header
        notes: tuple[str, ...] = ()
        values, unit, key = header.numbers("wavelength", header.bands), header.text("wavelength units"), "wavelength"
        if values is None:
            in_names = wavelengths_in_names(header.band_names)
            if in_names is None:
                return self.inner.listed() if self.inner is not None else None
            values, unit, key = in_names[0], in_names[1] or unit, "band names"
            notes = ("the header lists no wavelengths: those in the names of its bands are taken",)
        flags = header.numbers("bbl", header.bands)
        if flags is not None and not np.all(np.isin(flags, (0.0, 1.0))):
            raise InputError(
                "the bad-band list holds other values than 0 (bad) and 1 (good)", where=header.where("bbl")
            )
        where = {"wavelength": header.where(key), "wavelength units": header.where("wavelength units")}
        where |= {name: header.where(name) for name in ("fwhm", "bbl") if name in header.entries}
        good = None if flags is None else flags == 1.0
        return ListedBands(values, header.numbers("fwhm", header.bands), unit, good, where, notes)

    def scales(self, quantity: str) -> list[Scale]:
        """What header, data file and a file of gains state.

        Reflectance is divided by ``reflectance scale factor`` (or multiplied by ``data reflectance gain values``),
        everything else takes ``data gain values`` and ``data offset values``; whole numbers of radiance are divided
        by the numbers of a ``.gain`` file.

        Raises
        ------
        InputError : a scale factor that is zero, or one of reflectance for a radiance.
        """
        header, out = self.header, []
        own = quantity == "reflectance" and "data reflectance gain values" in header.entries
        kind = "data reflectance" if own else "data"
        gain, offset = (header.numbers(f"{kind} {name} values", header.bands) for name in ("gain", "offset"))
        factor = header.number("reflectance scale factor")
        if gain is not None and np.any(gain == 0):
            raise InputError("a gain of 0 makes every value the same", where=header.where(f"{kind} gain values"))
        if factor is not None and not (np.isfinite(factor) and factor > 0):
            raise InputError(
                f"'reflectance scale factor' is {factor:g}",
                where=header.where("reflectance scale factor"),
                expected="a positive number",
            )
        if gain is not None or offset is not None:
            own_gain = np.ones(header.bands) if gain is None else gain
            out.append(Scale(own_gain, 0.0 if offset is None else offset, f"{kind} gain/offset values"))
        if factor not in (None, 1.0) and (out or quantity == "radiance"):
            raise InputError(
                f"'reflectance scale factor' and {out[0].source if out else 'a radiance'} exclude each other",
                where=header.where("reflectance scale factor"),
                mend="state scale: (what multiplies the stored values) in the campaign",
            )
        if factor is not None and quantity == "reflectance" and not out:
            out.append(Scale(1.0 / factor, 0.0, f"stored values / {factor:g} (reflectance scale factor)"))
        if self.gains_path is not None and quantity == "radiance":
            out.append(_gain_file(self.gains_path, header.bands))
        return out + (self.inner.scales(quantity) if self.inner is not None else [])


def header_description(
    header: EnviHeader, inner: Description | None = None, gains_path: Path | None = None
) -> HeaderDescription:
    """The description of an image with an ENVI header."""
    return HeaderDescription(
        entries=header.extras, notes=header.notes, header=header, inner=inner, gains_path=gains_path
    )


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


def _ordered(centre: Array, fwhm: Array | None, good: Mask, sort_bands: bool, where: str) -> BandTable:
    """The bands [nm] of a file in increasing wavelength; no widths take the spacing of each detector."""
    order, notes = np.arange(centre.size), []
    steps = np.diff(centre)
    if np.any(steps <= 0):
        at = int(np.flatnonzero(steps <= 0)[0])
        same = np.unique(centre).size < centre.size
        if not sort_bands or same:
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
        notes.append(f"{int(np.sum(order != np.arange(order.size)))} bands were moved to sort the wavelengths")
    if fwhm is None:
        fwhm = _spacing_by_detector(centre)
        notes.append("the file lists no fwhm: band widths are taken as the band spacing")
    return BandTable(SpectralAxis(centre[order], fwhm[order], good[order]), order, tuple(notes))


def _check_widths(fwhm: Array, centre: Array, unit: str, where: str) -> None:
    """Raise InputError for widths [nm] that are not positive, or plainly not in the unit of the wavelengths."""
    if not np.all(fwhm > 0):
        at = int(np.flatnonzero(~(fwhm > 0))[0])
        raise InputError(
            f"band {at + 1} has a width (fwhm) of {fwhm[at] / wavelength_to_nm(unit):g}, which is not positive",
            where=where,
        )
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
        unit = given or only_wavelength_unit(values)
        if unit is None:
            raise UsageError(
                f"the file states no wavelength unit, and {values.min():g} to {values.max():g} do not tell it",
                where=where,
                expected="nm or um",
                mend="state wavelength_unit: nm (or um) in the campaign",
            )
        return unit, () if given else (wavelength_unit_note(values, unit),)
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


def wavelengths_in_nm(values: Array, unit: str, where: str) -> Array:
    """Wavelengths in nm; UsageError when they are implausible in ``unit``."""
    nm = values * wavelength_to_nm(unit)
    low, high = PLAUSIBLE_NM
    if nm.min() < low or nm.max() > high:
        raise UsageError(
            f"wavelengths from {values.min():g} to {values.max():g} cannot be in {unit}",
            where=where,
            expected=f"{low:g} to {high:g} nm",
            mend="0.4 to 2.5 is um, 400 to 2500 is nm: correct the wavelength unit",
        )
    return nm


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
    if quantity in ("counts", "other"):
        return 1.0, unit or quantity.replace("other", "")
    raise UsageError(f"unknown quantity {quantity!r}", expected="radiance, reflectance, counts or other")


def gain_file_beside(image: Path) -> Path | None:
    """The ``.gain`` file that the image's name begins with, as f130612t01p00r10rdn_e.gain; None without one."""
    name = image.name.lower()
    fits = [p for p in sorted(image.parent.glob("*.[gG][aA][iI][nN]")) if name.startswith(p.stem.lower())]
    return max(fits, key=lambda p: len(p.stem), default=None)


@reader
def _gain_file(path: Path, bands: int) -> Scale:
    """The scale of a file of what the stored numbers of each band are divided by.

    Source: JPL, AVIRIS Distribution Document 030217: two columns, factor and channel; spectra divided by the
    factors are radiances in micro-watts/cm^2/nm/sr.

    Raises
    ------
    InputError : not one positive number for each band, or channels that do not count from 1.
    """
    expected = f"{bands} rows of a factor and a channel that counts from 1"
    text = checked_file(path, what="gain file", most=_MAX_GAIN_BYTES).read_text("latin-1")
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
    return Scale(1.0 / out, 0.0, f"stored values / those of {path.name}", RADIANCE_UNIT)


@dataclass(frozen=True, eq=False)
class Raster:
    """Stored numbers of an image, by lines or by pixels, with what its files say of them; one class for each format.

    Attributes
    ----------
    path : the data file
    size : (lines, samples, bands)
    dtype : of a stored number
    description : what the files say
    position : transform from continuous (sample, line) to map coordinates, and their system; None where unknown
    other_files : files beside it that were read
    """

    path: Path
    size: tuple[int, int, int]
    dtype: np.dtype
    description: Description = Description()
    position: tuple[Affine | None, CRS | None] = (None, None)
    other_files: tuple[Path, ...] = ()

    kind = "image"
    in_blocks = False  # whether reading line by line would unpack the same blocks again and again

    @property
    def lines(self) -> int:
        """Number of lines."""
        return self.size[0]

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.size[1]

    @property
    def bands(self) -> int:
        """Number of bands."""
        return self.size[2]

    @property
    def transform(self) -> Affine | None:
        """Affine transform from continuous (sample, line) to map coordinates, None without one."""
        return self.position[0]

    @property
    def crs(self) -> CRS | None:
        """Coordinate reference system, None when unknown."""
        return self.position[1]

    @property
    def source_files(self) -> tuple[Path, ...]:
        """The files that were read."""
        return (self.path, *self.other_files)

    def kept_open(self) -> AbstractContextManager[object]:
        """Inside, the file is opened once for all reads, where its reader can."""
        return nullcontext()

    def read_lines(self, first: int, count: int) -> npt.NDArray[Any]:
        """(count, samples, bands) stored numbers of consecutive lines."""
        return self.read_bands(first, count).transpose(1, 2, 0)

    def read_bands(self, first: int, count: int, buffer: npt.NDArray[Any] | None = None) -> npt.NDArray[Any]:
        """(bands, count, samples) stored numbers of consecutive lines: a view in the order of the file.

        ``buffer`` is a flat array of ``dtype`` with room for the lines, to read into where the reader can.
        """
        if first < 0 or count < 1 or first + count > self.lines:
            raise UsageError(f"lines {first}-{first + count - 1} of a cube of {self.lines} lines")
        return self._read(first, count, buffer)

    def read_some_bands(self, first: int, count: int, bands: Sequence[int]) -> npt.NDArray[Any]:
        """(n, count, samples) stored numbers of consecutive lines in a few bands."""
        return self.read_bands(first, count)[list(bands)]

    def read_pixels(self, rows: Index, cols: Index) -> npt.NDArray[Any]:
        """(n, bands) stored numbers of single pixels; those that lie close are read at once."""
        out = np.empty((rows.size, self.bands), self.dtype)
        with self.kept_open():
            for here in self._together(rows, cols):
                top, left = int(rows[here].min()), int(cols[here].min())
                window = slice(top, int(rows[here].max()) + 1), slice(left, int(cols[here].max()) + 1)
                for first, values in self._window(*window):
                    out[here, first : first + len(values)] = values[:, rows[here] - top, cols[here] - left].T
        return out

    def _together(self, rows: Index, cols: Index) -> Sequence[Index]:
        """Which pixels are read together: those of lines that follow each other."""
        order = np.argsort(rows, kind="stable")
        ordered = rows[order]
        run = np.cumsum(np.diff(ordered, prepend=ordered[:1]) > 1)
        most = max(1, MAX_READ_BYTES // (self.samples * self.bands * self.dtype.itemsize))
        part = (ordered - ordered[np.searchsorted(run, run)]) // most
        edges = np.flatnonzero((np.diff(run) != 0) | (np.diff(part) != 0)) + 1
        return [part for part in np.split(order, edges) if part.size]

    def _window(self, lines: slice, samples: slice) -> Iterator[tuple[int, npt.NDArray[Any]]]:
        """The number of a first band, and (n, lines, samples) of it and the next ones in a window."""
        raise NotImplementedError

    def _read(self, first: int, count: int, buffer: npt.NDArray[Any] | None) -> npt.NDArray[Any]:
        raise NotImplementedError


def crs_of_wkt(wkt: str | None) -> CRS | None:
    """The system of a WKT, ESRI's among them; None where there is none that is understood."""
    try:
        return CRS.from_wkt(wkt, morph_from_esri_dialect=True) if wkt else None
    except CRSError:
        return None


def gdal_transform(text: str | None) -> Affine | None:
    """The transform of six numbers in the order of GDAL's GeoTransform; None where a text has others."""
    numbers = re.findall(r"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?", text or "")
    return Affine.from_gdal(*(float(n) for n in numbers)) if len(numbers) == 6 else None


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
    return dtype.type(int(ignore)) if limits.min <= int(ignore) <= limits.max else None


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


def check_values_of(cube: Any) -> None:
    """Raise InputError when the values are too large for the quantity: a scale that was not stated."""
    limit = PLAUSIBLE.get(cube.quantity)
    if limit is None:
        return
    lines = np.unique(np.linspace(0, cube.lines - 1, 16).astype(int))
    cols = np.linspace(0, cube.samples - 1, min(cube.samples, CHECKED_SAMPLES)).astype(int)
    sample = np.concatenate(
        [cube.spectra((np.full(cols.size, line), cols))[:, cube.axis.good].ravel() for line in lines]
    )
    high = float(np.percentile(sample, 95)) if sample.size else 0.0
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


def record(raster: Raster) -> list[tuple[str, str, str]]:
    """What is known of an image: thing, value, and where the value comes from, or what would mend its lack.

    It is what the reader itself goes by: a file and line of a header, an entry of a product, a convention, a guess.
    """
    about, where, files = raster.description, str(raster.path), ", ".join(p.name for p in raster.other_files)
    header = about.header if isinstance(about, HeaderDescription) else None
    by = about.product or raster.kind

    def origin(key: str) -> str:
        return f"{header.where(key)} '{key}'" if header is not None and key in header.entries else by

    lines, samples, bands = raster.size
    rows = [
        ("is", about.product or raster.kind, "its first bytes" + (f", and {files} beside it" if files else "")),
        ("size", f"{lines} lines, {samples} samples, {bands} bands of {raster.dtype}", origin("samples")),
    ]
    notes = list(about.notes)
    try:
        table, listed = about.band_table(None, where, sort_bands=True), about.listed()
        assert listed is not None  # noqa: S101 - a table is made of them
        centre, width = table.axis.centre_nm, table.axis.fwhm_nm
        stated = listed.where.get("wavelength", by)
        rows.append(("wavelengths", f"{len(centre)}, {centre[0]:g} to {centre[-1]:g} nm", stated))
        silent = (listed.unit or "").strip(" \t\"'").lower() in _UNSTATED
        unit = str(only_wavelength_unit(listed.wavelength)) if silent else str(listed.unit)
        rows.append(("wavelength unit", unit, "guess: by the values" if silent else stated))
        no_width = "convention: the spacing of the bands"
        rows.append(
            ("widths", f"{width.min():g} to {width.max():g} nm", no_width if listed.fwhm is None else origin("fwhm"))
        )
        notes += table.notes
    except HypervalError as error:
        rows.append(("wavelengths", f"not known: {error.what}", error.mend or str(error.expected)))
    rows.append(
        ("quantity", about.quantity or "not known", by if about.quantity else "state quantity: (init: --quantity)")
    )
    if about.quantity != "reflectance":
        rows.append(("unit of radiance", about.unit or "not known", by if about.unit else "state unit: (init: --unit)"))
    for quantity in [about.quantity] if about.quantity else ["radiance", "reflectance"]:
        try:
            active = [s for s in about.scales(quantity) if np.any(np.asarray(s.gain) != 1.0) or np.any(s.offset)]
            gains = [
                f"x {np.min(s.gain):g} to {np.max(s.gain):g}, + {np.min(s.offset):g} to {np.max(s.offset):g}"
                for s in active
            ]
            sources = [s.source for s in active] or [
                "nothing states another; state scale: where the numbers are scaled"
            ]
            rows.append((f"scale of {quantity}", "; ".join(gains) or "x 1", "; ".join(sources)))
        except HypervalError as error:
            rows.append((f"scale of {quantity}", f"not known: {error.what}", error.mend or ""))
    ignore = about.no_data()
    none = "nothing states one"
    rows.append(("no data", *(("none", none) if ignore is None else (f"{ignore:g}", origin("data ignore value")))))
    a = raster.transform
    if a is None:
        rows.append(("position", "none", "targets.pixel_size_m states the size of a pixel; cube.glt places them"))
    else:
        rows.append(
            ("position", f"x = {a.c:.10g}, y = {a.f:.10g} at the corner; steps {a.a:g}, {a.e:g}", origin("map info"))
        )
        known = origin(
            "coordinate system string" if header and "coordinate system string" in header.entries else "map info"
        )
        rows.append(("coordinate system", str(raster.crs or "not known"), known))
    return rows + [("assumed", note, "reader") for note in notes]
