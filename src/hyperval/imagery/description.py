"""What the files of an image say of it, and what is taken from that: bands, unit and scale, no data.

Every reader hands on a :class:`Raster`: stored numbers with a :class:`Description`.  Here alone it is decided which
wavelengths, which unit and which scale an image has, and which stored number means no data.  Entries without a standard
(level of processing, shift of the wavelengths, time of the flight) change no number; they go into the notes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, time
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS
from rasterio.errors import CRSError

from hyperval.data import Array, Index, Mask
from hyperval.envi_header import EnviHeader
from hyperval.errors import filled_words, needed, reader, refusal, refuse
from hyperval.paths import checked_file, read_text
from hyperval.spectra.axis import SUNLIT_NM, SpectralAxis, fwhm_from_spacing, spacing_note, wavelengths_in_nm
from hyperval.spectra.record import reflectance_factor
from hyperval.spectra.text import number_table
from hyperval.storage import number_of
from hyperval.units import RADIANCE_UNIT, is_radiance, to_internal

Bands = SpectralAxis | Literal["numbers"] | None

_SEEN_LINES, _SEEN_SAMPLES = 16, 64
MAX_READ_BYTES = 16 << 20  # of single pixels' lines at once
MIN_FWHM_NM = 0.05  # the finest imaging spectrometers, for fluorescence, have 0.1 to 0.3
_UNIT = r"(nm|nanomet\w*|[uµμ]m|micromet\w*|microns?)"
_SPREAD = r"(?:(?:\+\s*/?\s*-|±)\s*[0-9.]+\s*)?"  # half a width, as ITRES writes it
# A number alone in parentheses is taken for a wavelength where it is as fine as ENVI writes it.
_NAMED = re.compile(
    rf"\(\s*([0-9]+\.[0-9]{{3,}})\s*\)|(?<![0-9.])([0-9]+(?:\.[0-9]+)?)\s*{_SPREAD}{_UNIT}(?![a-z])", re.IGNORECASE
)
_MAX_GAIN_BYTES = 1 << 20


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

    @property
    def changes(self) -> bool:
        """Whether a value is another number than the stored one."""
        return bool(np.any(np.asarray(self.gain) != 1.0) or np.any(self.offset))


UNSCALED = Scale()


@dataclass(frozen=True, eq=False)
class Description:
    """What a file, or the metadata beside it, says of an image; an ENVI header speaks before its data file.

    Attributes
    ----------
    product : in words, "" for a plain image
    bands : as listed, None where the file lists none
    scale : as stated
    quantity : "radiance", "reflectance" or "deviations" of either, None when the files do not say
    unit : of the scaled values, None when the files do not say
    ignore_value : stored value that means no data
    sensor : name of the instrument, "" when unknown
    sorts : bands may be sorted by wavelength without being told to, as the layout of the product is known
    entries : what else is said, by key, as the entries of a header
    notes : what was assumed
    sun_zenith_deg : zenith angle of the sun for the whole image, None when it is not stated
    packing : scale and offset of the file by which its reader has unpacked the values that count as stored here
    header : of ENVI; its lists and scale factors are read when asked for, as a campaign may state them itself
    gains : file of what whole numbers of radiance are divided by
    band_names : empty where the header does not have one for each
    ignored : number in the file that means no data, where its reader hands out NaN in its place
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
    header: EnviHeader | None = None
    gains: Path | None = None
    band_names: tuple[str, ...] = ()
    ignored: float | None = None

    def no_data(self) -> float | None:
        """Stored value that means no data: the ``data ignore value`` of a header, else that of the data file."""
        stated = self.header.number("data ignore value") if self.header is not None else None
        return self.ignore_value if stated is None else stated

    def unit_in_entries(self) -> tuple[str, str | None]:
        """The entry that states a unit of radiance, by which no number changes, and that unit; None without."""
        texts = {key: text.strip() for key, text in self.entries.items() if "unit" in key and "wavelength" not in key}
        return next(((key, text) for key, text in texts.items() if is_radiance(text)), ("", None))

    def listed(self) -> ListedBands | None:
        """The bands as the header lists them, else the data file; None where neither does."""
        header = self.header
        if header is None:
            return self.bands
        notes: tuple[str, ...] = ()
        values, unit, key = header.numbers("wavelength", header.bands), header.text("wavelength units"), "wavelength"
        if values is None:
            in_names = wavelengths_in_names(header.band_names)
            if in_names is None:
                return self.bands
            values, unit, key = in_names[0], in_names[1] or unit, "band names"
            notes = ("no wavelengths are listed: those in the names of the bands are taken",)
        flags = header.numbers("bbl", header.bands)
        refuse(flags is not None and not np.all(np.isin(flags, (0.0, 1.0))), "bands.flags", header.where("bbl"))
        where = {"wavelength": header.where(key), "wavelength units": header.where("wavelength units")}
        where |= {name: header.where(name) for name in ("fwhm", "bbl") if name in header.entries}
        good = None if flags is None else flags == 1.0
        return ListedBands(values, header.numbers("fwhm", header.bands), unit, good, where, notes)

    def scales(self, quantity: str) -> list[Scale]:
        """What the files state that values of a quantity are scaled by, where it changes them: one may at most.

        By a header reflectance is divided by ``reflectance scale factor`` (or multiplied by ``data reflectance gain
        values``), everything else takes ``data gain values`` and ``data offset values``; whole numbers of radiance
        are divided by the numbers of a ``.gain`` file.

        Raises
        ------
        InputError : a scale factor that is zero, or one of reflectance for a radiance.
        """
        stated = [*(_scales_of(self.header, quantity) if self.header is not None else ()), self.scale]
        if self.gains is not None and self.header is not None and quantity == "radiance":
            stated.append(_gain_file(self.gains, self.header.bands))
        return [scale for scale in stated if scale.changes]

    def band_table(
        self, given_unit: str | None, where: str, sort_bands: bool = False, stated: Bands = None, count: int = 0
    ) -> tuple[SpectralAxis, Index, tuple[str, ...]]:
        """The bands that have a wavelength, in nm and in order; which stored band each is; what was assumed.

        Parameters
        ----------
        given_unit : the unit where the file states none; must agree with the file otherwise
        sort_bands : sort bands whose wavelengths do not increase (two detectors that overlap)
        stated : the bands of a file of ``count``, or "numbers": those count from 1 in place of wavelengths

        >>> Description(bands=ListedBands(np.array([8.0, 8.1]), np.full(2, 0.1), "um")).band_table(None, "x")[2]
        ('warning: no band below 8000 nm: the model has reflected sunlight, no emission',)

        Raises
        ------
        InputError : no wavelengths, a wrong count, not finite, not increasing, two the same, widths not positive, or
            a bad-band list that does not fit.
        UsageError : a unit that contradicts the file or that nobody states, or wavelengths implausible in it; an axis
            of another number of bands.
        """
        if stated == "numbers":
            warning = "warning: bands are identified by number: values labelled nm are band numbers"
            return SpectralAxis(np.arange(1.0, count + 1.0), np.ones(count)), np.arange(count), (warning,)
        if stated is not None:
            refuse(len(stated) != count, "bands.given", where, given=len(stated), count=count)
            return stated, np.arange(count), ("wavelengths as given beside the cube",)
        bands = needed(self.listed(), "bands.none", where)
        has = np.flatnonzero(np.isfinite(bands.wavelength))
        refuse(not has.size, "bands.without", where)
        listed, notes = bands.wavelength[has], list(bands.notes)
        places = {key: bands.where.get(key, where) for key in ("wavelength", "wavelength units", "fwhm", "bbl")}
        centre, unit, note = wavelengths_in_nm(listed, bands.unit, given_unit, places["wavelength units"])
        to_nm = to_internal(unit, "wavelength")
        notes += note
        if has.size < bands.wavelength.size:
            notes.append(f"{bands.wavelength.size - has.size} stored bands without a wavelength are left out")
        good = np.ones(has.size, bool) if bands.good is None else bands.good[has]
        refuse(not good.any(), "bands.bad", places["bbl"])
        if bands.good is not None and ("bbl" in bands.where or not good.all()):
            notes.append(f"bad-band list: {int((~good).sum())} of {good.size} bands are bad")
        width = None if bands.fwhm is None else bands.fwhm[has] * to_nm
        if width is not None and not width.any():
            notes.append("every fwhm in the file is 0, which is none")
            width = None
        if width is not None:
            none, wide = np.flatnonzero(~(width > 0)), np.any(width >= centre) or np.median(width) < MIN_FWHM_NM
            refuse(none.size, "bands.width", places["fwhm"], band=none + 1, width=width[none] / to_nm)
            refuse(wide, "bands.widths", places["fwhm"], least=width.min(), most=width.max(), unit=unit)
        falls, same = np.flatnonzero(np.diff(centre) <= 0), np.unique(centre).size < centre.size
        pair = {"first": falls + 1, "second": falls + 2, "low": centre[falls], "high": centre[falls + 1]}
        unordered = falls.size and (same or not (sort_bands or self.sorts))
        refuse(unordered, "bands.same" if same else "bands.order", places["wavelength"], **pair)
        order = np.argsort(centre, kind="stable")
        if moved := int(np.sum(order != np.arange(order.size))):
            notes.append(f"{moved} bands were moved to sort the wavelengths")
        if centre.min() > SUNLIT_NM:
            notes.append(f"warning: no band below {centre.min():g} nm: the model has reflected sunlight, no emission")
        if width is None:
            refuse(centre.size < 2, "axis.single", places["wavelength"])
            width, beside_gap = _spacing_by_detector(centre)
            notes.append(spacing_note("the file lists no fwhm", np.sort(centre[beside_gap])))
        return SpectralAxis(centre[order], width[order], good[order]), has[order], tuple(notes)

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
            both = {"holds": self.quantity, "quantity": quantity}
            raise refusal("scale.deviations" if self.quantity == "deviations" else "scale.quantity", where, **both)
        if scale is not None:
            refuse(not np.isfinite(scale) or scale <= 0, "scale.number", scale=scale)
            # It multiplies the packed values, and gives a reflectance as a fraction.
            read = self.unit if quantity == "radiance" else None
            stated = Scale(scale / self.packing[0], -scale * self.packing[1] / self.packing[0])
            note = f"stored values x {scale:g} (stated)"
        else:
            active = self.scales(quantity)
            if len(active) > 1:
                raise refusal("scale.two", where, first=active[0].source, second=active[1].source)
            stated = active[0] if active else UNSCALED
            read, note = stated.unit or self.unit, stated.source
            if quantity == "radiance" and unit and read and to_internal(unit, quantity) != to_internal(read, quantity):
                raise refusal("scale.unit", where, own=read, by=f" ({note})" * bool(stated.unit), unit=unit)
        factor, name = _unit_factor(quantity, unit or read)
        if quantity == "reflectance" and factor != 1.0:
            note = f"{note}; ".removeprefix("; ") + f"x {factor:g} (unit {unit or read})"
        gain, offset = (np.broadcast_to(factor * np.asarray(v, float), bands).copy() for v in stated[:2])
        return Scale(gain, offset, note, name)


def _scales_of(header: EnviHeader, quantity: str) -> list[Scale]:
    """What an ENVI header states as a scale of a quantity."""
    of_reflectance = quantity == "reflectance" and "data reflectance gain values" in header.entries
    kind = "data reflectance" if of_reflectance else "data"
    gain, offset = (header.numbers(f"{kind} {term} values", header.bands, each=False) for term in ("gain", "offset"))
    factor = header.number(key := "reflectance scale factor")
    refuse(gain is not None and np.any(gain == 0), "scale.zero", header.where(f"{kind} gain values"))
    refuse(factor is not None and not 0.0 < factor < np.inf, "scale.factor", header.where(key), factor=factor)
    name = f"{kind} gain/offset values" if gain is not None or offset is not None else ""
    two, second = factor not in (None, 1.0) and (name or quantity == "radiance"), name or "a radiance"
    refuse(two, "scale.two", header.where(key), first=f"{key!r}", second=second)
    if factor is not None and quantity == "reflectance" and not name:
        return [Scale(1.0 / factor, 0.0, f"stored values / {factor:g} (reflectance scale factor)")]
    return [Scale(1.0 if gain is None else gain, 0.0 if offset is None else offset, name)]


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


def _spacing_by_detector(centre: Array) -> tuple[Array, Mask]:
    """Spacing (B,) of bands [nm] in the order of the file, and which stand beside gaps.

    A detector ends where the wavelength jumps back.  Once sorted, the bands of two overlapping detectors lie closer
    together than those of either.
    """
    detectors = np.split(centre, np.flatnonzero(np.diff(centre) <= 0) + 1)
    rank = np.arange(centre.size)
    if min(d.size for d in detectors) < 2:
        rank, detectors = np.argsort(np.argsort(centre, kind="stable")), [np.sort(centre)]
    width, beside_gap = (np.concatenate(each)[rank] for each in zip(*map(fwhm_from_spacing, detectors), strict=True))
    return width, beside_gap


def _unit_factor(quantity: str, unit: str | None) -> tuple[float, str]:
    """What one of the unit of a quantity is in the internal unit, and the name of that."""
    if quantity == "radiance":
        return to_internal(needed(unit, "scale.no_unit", internal=RADIANCE_UNIT), "radiance"), RADIANCE_UNIT
    if quantity == "reflectance":
        return reflectance_factor(unit or "fraction"), "1"
    if quantity in ("counts", "other"):
        return 1.0, unit or quantity.replace("other", "")
    raise refusal("scale.unknown_quantity", quantity=quantity)


@reader
def _gain_file(path: Path, bands: int) -> Scale:
    """The scale of a file of what the stored numbers of each band are divided by.

    Source: JPL, AVIRIS Distribution Document 030217: two columns, factor and channel; spectra divided by the
    factors are radiances in micro-watts/cm^2/nm/sr.
    """
    text = read_text(checked_file(path, what="gain file", most=_MAX_GAIN_BYTES))
    _, table, first = number_table(text, path)
    refuse(len(table) != bands, "gain.rows", path, what=f"{len(table)} rows for {bands} bands", bands=bands)
    divisor, channel = table[:, 0], table[:, 1] if table.shape[1] > 1 else np.arange(1.0, bands + 1.0)
    wrong = ~((divisor > 0) & np.isfinite(divisor) & (channel == np.arange(1, bands + 1)))
    row = int(np.argmax(wrong))
    refuse(wrong.any(), "gain.rows", f"{path}:{first + row}", what=f"{divisor[row]:g} {channel[row]:g}", bands=bands)
    return Scale(1.0 / divisor, 0.0, f"stored values / those of {path.name}", RADIANCE_UNIT)


@dataclass(frozen=True, eq=False)
class Raster:
    """Stored numbers of an image, by lines or by pixels, with what its files say of them; one class for each format.

    Attributes
    ----------
    path : the data file
    lines, samples, bands : size of the image
    dtype : of a stored number
    description : what the files say
    transform : from continuous (sample, line) to map coordinates, None without
    crs : coordinate reference system of these, None when unknown
    other_files : files beside it that were read
    """

    path: Path
    lines: int
    samples: int
    bands: int
    dtype: np.dtype
    description: Description = Description()
    transform: Affine | None = None
    crs: CRS | None = None
    other_files: tuple[Path, ...] = ()

    kind = "image"
    in_blocks = False  # whether reading line by line would unpack the same blocks again and again

    @property
    def size(self) -> tuple[int, int, int]:
        """(lines, samples, bands)."""
        return self.lines, self.samples, self.bands

    @property
    def source_files(self) -> tuple[Path, ...]:
        """The files that were read."""
        return (self.path, *self.other_files)

    def kept_open(self) -> AbstractContextManager[object]:
        """Inside, the file is opened once for all reads, where its reader can."""
        return nullcontext()

    def read_bands(self, first: int, count: int, buffer: npt.NDArray[Any] | None = None) -> npt.NDArray[Any]:
        """(bands, count, samples) stored numbers of consecutive lines: a view in the order of the file.

        ``buffer`` is a flat array of ``dtype`` with room for the lines, to read into where the reader can.
        """
        if first < 0 or count < 1 or first + count > self.lines:
            raise refusal("image.lines", first=first, last=first + count - 1, lines=self.lines)
        return self._read(first, count, buffer)

    def read_some_bands(self, first: int, count: int, bands: Sequence[int]) -> npt.NDArray[Any]:
        """(n, count, samples) stored numbers of consecutive lines in a few bands."""
        return self.read_bands(first, count)[list(bands)]

    def read_pixels(self, rows: Index, cols: Index) -> npt.NDArray[Any]:
        """(n, bands) stored numbers of single pixels; neighbouring ones are read at once."""
        out = np.empty((rows.size, self.bands), self.dtype)
        with self.kept_open():
            for cluster in self._together(rows, cols):
                top, first = int(rows[cluster].min()), int(cols[cluster].min())
                window = slice(top, int(rows[cluster].max()) + 1), slice(first, int(cols[cluster].max()) + 1)
                out[cluster] = self._box(slice(0, self.bands), *window)[:, rows[cluster] - top, cols[cluster] - first].T
        return out

    def some_pixels(self) -> npt.NDArray[Any]:
        """(n, bands) stored numbers of pixels that are spread evenly over the image."""
        lines, samples = some_lines(self.lines, _SEEN_LINES), some_lines(self.samples, _SEEN_SAMPLES)
        return self.read_pixels(np.repeat(lines, samples.size), np.tile(samples, lines.size))

    def _together(self, rows: Index, cols: Index) -> Sequence[Index]:
        """Which pixels are read together: those of lines that follow each other, as many as fit into memory."""
        order = np.argsort(rows, kind="stable")
        ordered, most = rows[order], max(1, MAX_READ_BYTES // (self.samples * self.bands * self.dtype.itemsize))
        edges = np.flatnonzero((np.diff(ordered) > 1) | (np.diff(ordered // most) > 0)) + 1
        return [part for part in np.split(order, edges) if part.size]

    def _read(self, first: int, count: int, buffer: npt.NDArray[Any] | None) -> npt.NDArray[Any]:
        return self._box(slice(0, self.bands), slice(first, first + count), slice(0, self.samples))

    def _box(self, bands: slice, lines: slice, samples: slice) -> npt.NDArray[Any]:
        """(bands, lines, samples) stored numbers of a part of the image."""
        raise NotImplementedError


def some_lines(lines: int, count: int) -> Index:
    """Numbers of at most so many lines, spread evenly over an image."""
    return np.unique(np.linspace(0, lines - 1, count).astype(int))


def crs_of_wkt(wkt: str | None) -> CRS | None:
    """The system of a WKT, ESRI's among them, or a code; None where there is none that is understood.

    >>> crs_of_wkt("EPSG:32616").to_epsg(), crs_of_wkt("WGS84")  # the name of a datum is no system
    (32616, None)
    """
    try:
        return CRS.from_user_input(wkt, morph_from_esri_dialect=True) if wkt and re.search(r"[\[:+]", wkt) else None
    except CRSError:
        return None


def gdal_transform(text: str | None) -> Affine | None:
    """The transform of six numbers in the order of GDAL's GeoTransform; None where a text has others."""
    numbers = re.findall(r"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?", text or "")
    return Affine.from_gdal(*(float(n) for n in numbers)) if len(numbers) == 6 else None


_MIN_FILLED = 8  # bands that hold one number by no chance
_MAX_FILLS = 3


def filled(stored: npt.NDArray[Any], ignore: float | None = None) -> Mask:
    """Which pixels (...) of stored numbers (B, ...) are fill: all bands hold one number.

    That is 0, and of eight bands or more a negative number; where no ignore value is stated also the largest of a whole
    type of two bytes or more, which a pixel that is saturated throughout holds too.

    >>> stored = np.full((8, 5), [0, -50, -50, 32767, 7], "i2")
    >>> stored[1, 2] = -49
    >>> [filled(stored).tolist(), filled(stored, -9999.0).tolist(), filled(stored[:7]).tolist()]
    [[True, True, False, True, False], [True, True, False, False, False], [True, False, False, False, False]]
    """
    last = stored[-1]
    fill = np.asarray(last == 0 if len(stored) < _MIN_FILLED else last <= 0)
    if len(stored) >= _MIN_FILLED and ignore is None and stored.dtype.kind in "iu" and stored.dtype.itemsize > 1:
        fill |= last == np.iinfo(stored.dtype).max
    fill &= (stored[0] == last) & (stored[len(stored) // 2] == last)  # as few pixels are; they are looked at in full
    fill[fill] = (stored[:, fill] == last[fill]).all(axis=0)
    return fill


def fill_notes(stored: npt.NDArray[Any], ignore: float | None) -> list[str]:
    """Notes on an unstated fill value among pixels (n, B): how many pixels hold which number.

    >>> fill_notes(np.full((4, 8), -50) * [[1], [1], [0], [1]], -9999.0)
    ['warning: 3 of 4 pixels seen hold -50 in every band: taken for no data, which nothing states']
    """
    found = stored[filled(stored.T, ignore), -1]
    found = found[~np.isin(found, (0, np.nan if ignore is None else ignore))]
    listed = [f"{value:g}" for value in np.unique(found)]
    which = " or ".join(listed[:_MAX_FILLS]) + ", ..." * (len(listed) > _MAX_FILLS)
    warning = f"warning: {found.size} of {len(stored)} pixels seen hold {which} in every band"
    return [f"{warning}: taken for no data, which nothing states"] * bool(listed)


_WORDS = "imagery/acquisition.yaml"
_CO2_NM = 2010.0  # the carbon dioxide bands that a shift is fitted to lie at about 2000-2070 nm
MINUTES_APART = 10.0  # the sun moves 2.5 degrees in ten minutes
_LEVELS = r"^(processing|product) ?level$|^level$|^data ?(units?|type name)$|^z plot titles$"
_SHIFTS = r"(co2|wavelength|spectral).*shift|shift.*(co2|wavelength|spectral)"
_SMOOTHED, _NONE = r"smooth(ing|ed)", re.compile(r"(0|no|none|off|false)(\s|$)", re.IGNORECASE)
_TIMES = r"gps.*(time|start|stop|end)|^(start|stop) time$|^acquisition (date|time)$"


def _said(name: str, text: str = "", /, **values: object) -> str:
    """A sentence, filled."""
    text = text if len(text) <= 80 else text[:77] + "..."
    return "warning: header: " + filled_words(_WORDS, name, text=text, **values)


def acquisition_notes(entries: Mapping[str, str], axis: SpectralAxis, quantity: str) -> tuple[str, ...]:
    """Warnings of a level or a unit that is that of another quantity, and of a shift of the wavelengths.

    Parameters
    ----------
    entries : header entries in lower case, braces taken off
    axis : the bands, for the size of a shift
    quantity : what the campaign takes the cube for

    >>> axis = SpectralAxis(np.array([500.0, 2010.0]), 10.0)
    >>> entries = {"spectir smoothing": "Savitsky-Golay", "calculated co2 shift": "3.65 Expected CO2 position=2036.94"}
    >>> [note[17:60] for note in acquisition_notes(entries, axis, "reflectance")]
    ["'spectir smoothing = Savitsky-Golay': where", "CO2 shift 3.65 nm found ('calculated co2 sh"]
    >>> [len(acquisition_notes({"spectir smoothing": of}, axis, "reflectance")) for of in ("none", "0", "0.5 nm")]
    [0, 0, 1]
    """
    notes, near = [], int(np.argmin(np.abs(axis.centre_nm - _CO2_NM)))
    for key, text in _matching(entries, _LEVELS) if quantity in ("radiance", "reflectance") else ():
        named = {q for q in ("radiance", "reflectance") if re.search(rf"(?<![a-z]){q}", text.lower())}
        if named and quantity not in named:
            notes.append(_said("level", text, key=key, named=" and ".join(sorted(named)), quantity=quantity))
    notes += [_said("smoothed", text, key=key) for key, text in _matching(entries, _SMOOTHED) if not _NONE.match(text)]
    for key, text in _matching(entries, _SHIFTS):
        value, size = number_of(text.partition(" ")[0].removesuffix("nm")), ""
        if abs(axis.centre_nm[near] - _CO2_NM) < 100.0:
            size = f", {abs(value) / axis.fwhm_nm[near]:.2f} of a band width at {axis.centre_nm[near]:.0f} nm"
        if value:
            sentence = "shift" if np.isfinite(value) else "no shift"
            notes.append(
                _said(sentence, text, key=key, kind="CO2" if "co2" in key else "wavelength", nm=value, size=size)
            )
    return tuple(notes)


def time_notes(entries: Mapping[str, str], overflight: datetime, name: str) -> tuple[str, ...]:
    """Warnings where a time of the header is not that of a scenario: another day, or more than ten minutes apart.

    Parameters
    ----------
    overflight : time of the scenario, with its offset from UTC
    name : of the scenario

    GPS time runs ahead of UTC by less than 20 s, which is ignored; a header in local time is found too.
    """
    utc, notes = overflight.astimezone(UTC), []
    for key, text in _matching(entries, _TIMES):
        # Days in the form 2012-09-20 or 2012/09/20: other orders are not clear.
        day = _first(date, r"(?<![0-9])([0-9]{4})[-/]([0-9]{1,2})[-/]([0-9]{1,2})(?![0-9])", text)
        clock = _first(time, r"(?<![0-9:])([0-9]{1,2}):([0-9]{2})(?::([0-9]{2}))?", text)
        common = {"key": key, "name": name, "utc": utc}
        if day is not None and day != utc.date():
            notes.append(_said("day", text, **common))
        elif clock is not None:
            delay = (datetime.combine(utc, clock, UTC) - utc).total_seconds() / 60.0
            delay = (delay + 720.0) % 1440.0 - 720.0
            if abs(delay) > MINUTES_APART:
                notes.append(_said("time", text, minutes=abs(delay), side="after" if delay > 0 else "before", **common))
    return tuple(notes)


def _first(kind: Callable[..., Any], pattern: str, text: str) -> Any:
    """What the first numbers of a form are, None without or where they are none."""
    match = re.search(pattern, text)
    try:
        return kind(*(int(group or 0) for group in match.groups())) if match is not None else None
    except ValueError:
        return None


def _matching(entries: Mapping[str, str], pattern: str) -> list[tuple[str, str]]:
    return [(key, " ".join(text.split())) for key, text in entries.items() if re.search(pattern, key)]
