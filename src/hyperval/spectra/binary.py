"""Binary files of spectra: ASD, libraries of ENVI (.sli, .lib with .hdr), SPECPR; libraries of SPy and xarray at hand.

ASD binary files: reflectance as the stored spectrum over the stored reference; radiance and irradiance.

Layout (little-endian): 484 bytes of header, with the data type at 186, first wavelength and step at
191 and 195, data format at 199, number of channels at 204; the spectrum; from version 2 on a
reference block of a flag, two times, a description with its length, and the reference spectrum.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperval.envi_header import EnviHeader, read_header
from hyperval.errors import InputError, UsageError
from hyperval.paths import checked_file
from hyperval.spectra.readers_record import MAX_BYTES, FieldSpectrum, Record

if TYPE_CHECKING:
    import xarray as xr
    from spectral.io.envi import SpectralLibrary

Array = npt.NDArray[np.float64]

_VERSIONS = (b"ASD", b"as2", b"as3", b"as4", b"as5", b"as6", b"as7", b"as8")
_FORMATS = {0: "<f4", 1: "<i4", 2: "<f8"}
_TYPES = {
    0: "raw counts", 1: "reflectance", 2: "radiance", 3: "no units", 4: "irradiance", 5: "quality index",
    6: "transmittance", 7: "unknown", 8: "absolute reflectance",
}  # fmt: skip
HEADER_BYTES = 484
MAX_CHANNELS = 10_000
RANGE_NM = (200.0, 2600.0)  # of the instruments
# How far a single channel may stick out above or below both beside it: as a share of the greatest value, and in
# median steps between channels.  Good files reach 0.02 and 5 in their noise, at absorption edges and at joins of
# detectors, and 12 steps where they hold nothing but noise.  And how many channels in a row may be 0.
_SPIKE, _SPIKE_STEPS, _EMPTY = 0.25, 30.0, 8
_UNITS = {"radiance": "W m-2 sr-1 nm-1", "irradiance": "W m-2 nm-1"}
BASE, LAMP, RESPONSE = 1, 2, 3
GREATEST = 20.0  # [W m-2 sr-1 nm-1]; sunlit white reaches 0.7, raw counts go to 65535
MAX_STEP = 0.25  # at a join of two detectors; a drifting instrument steps by a tenth
_NO_ANGLE = 180  # fore optic of 180 degrees and more: a cosine receptor, which sees irradiance
_CLASSIFIER_TEXTS = 20
_ENTRY = struct.Struct("<b20sihh")
_MEND = "export the calibrated spectrum as text, with its unit in the title"


def is_asd(raw: bytes) -> bool:
    """True when the content is that of an ASD binary file."""
    return raw[:3] in _VERSIONS and len(raw) > HEADER_BYTES and b"\0" in raw[3:HEADER_BYTES]


def asd_record(raw: bytes, path: Path, quantity: str = "reflectance") -> Record:
    """Reflectance (relative to the white reference), radiance or irradiance of an ASD file, as its type says.

    Raises
    ------
    InputError : cut short, another data type, no reference in it, or counts without a calibration that fits.
    """
    where, kind = str(path), raw[186]
    first, step = struct.unpack_from("<2f", raw, 191)
    (channels,) = struct.unpack_from("<H", raw, 204)
    if raw[199] not in _FORMATS or not 2 <= channels <= MAX_CHANNELS or not (np.isfinite(first) and step > 0):
        raise InputError("the ASD header is not valid", where=where)
    last, (least, most) = first + step * (channels - 1), RANGE_NM
    if not least <= first < last <= most:
        what = f"the ASD header is not valid: wavelengths from {first:g} to {last:g} nm"
        raise InputError(what, where=where, expected=f"{least:g} to {most:g} nm")
    if kind not in (0, 1, 2, 4):
        raise InputError(
            f"the file holds {_TYPES.get(kind, 'unknown data')}",
            where=where,
            expected="reflectance, raw counts with their white reference, radiance or irradiance",
            mend="export the reflectance as text",
        )
    dtype, alone = np.dtype(_FORMATS[raw[199]]), raw[:3] == b"ASD"  # version 1 stores the reflectance and no reference
    stored = _array(raw, HEADER_BYTES, channels, dtype, where, ratio=alone)
    record = Record(path.stem, first + step * np.arange(channels, dtype=float), stored, where, wavelength_unit="nm")
    flag = HEADER_BYTES + stored.size * dtype.itemsize
    end = len(raw)
    if not alone and len(raw) >= flag + 20:
        end = flag + 20 + int(struct.unpack_from("<H", raw, flag + 18)[0]) + channels * dtype.itemsize
    if kind in (2, 4):
        if quantity not in _UNITS:  # refused by what it holds, whether it can be calibrated or not
            return replace(record, quantity=_TYPES[kind])
        values, power, notes = calibrated(raw, end, stored, record.wavelength, dtype, where)
        return replace(record, values=values, quantity=power, notes=notes, unit=_UNITS[power])
    notes = ()
    if alone and kind == 0:
        raise InputError("raw counts without a white reference", where=where)
    if not alone:
        if len(raw) < flag + 20:
            raise InputError("the ASD file is cut short", where=where)
        if not struct.unpack_from("<H", raw, flag)[0]:
            raise InputError("the file holds no white reference", where=where, mend="export the reflectance as text")
        reference = _array(raw, end - channels * dtype.itemsize, channels, dtype, where)
        with np.errstate(divide="ignore", invalid="ignore"):
            stored = np.where(reference != 0, stored / reference, np.nan)
        notes = ("reflectance is the stored spectrum over the stored white reference",)
    return replace(record, values=stored, reflectance_unit="fraction", quantity="reflectance", notes=notes)


def _array(raw: bytes, at: int, count: int, dtype: np.dtype, where: str, *, ratio: bool = False) -> Array:
    if len(raw) < at + count * dtype.itemsize:
        raise InputError("the ASD file is cut short", where=where)
    values = np.frombuffer(raw, dtype, count, at).astype(float)
    check_channels(values, where, ratio=ratio)
    return values


def check_channels(values: Array, where: str, *, ratio: bool = False) -> None:
    """Refuse values that no instrument stores: not finite, emptied, or one alone far from both channels beside it.

    Parameters
    ----------
    values : (n,) counts or radiances, channel by channel
    ratio : a stored reflectance, which may be anything where there was no light

    Raises
    ------
    InputError : with the first such channel.
    """
    before, after = np.pad(values, 1, mode="reflect")[:-2], np.pad(values, 1, mode="reflect")[2:]
    with np.errstate(all="ignore"):
        beyond = np.maximum(values - np.maximum(before, after), np.minimum(before, after) - values)
        most = max(_SPIKE * np.abs(values).max(), _SPIKE_STEPS * float(np.median(np.abs(np.diff(values)))))
        bad = ~np.isfinite(values) | ((beyond > most) & (not ratio))
    empty = np.convolve(values == 0.0, np.ones(_EMPTY), "valid") == _EMPTY
    if bad.any() or empty.any():
        at = int(np.argmax(bad)) if bad.any() else int(np.argmax(empty))
        raise InputError(
            f"channel {at + 1} holds {values[at]:g}" + ("" if bad.any() else f", as do the {_EMPTY - 1} after it"),
            where=where,
            expected="values like those of the channels beside it",
            mend="copy the file again: it is damaged",
        )


def calibrated(
    raw: bytes, end_of_reference: int, stored: Array, wavelength_nm: Array, dtype: np.dtype, where: str
) -> tuple[Array, str, tuple[str, ...]]:
    """Values of a radiance or irradiance file, their quantity and what was done.

    Values that can be radiances are taken as they stand [W m-2 sr-1 nm-1].  Counts need the calibration in the
    file: E = lamp x counts/response x (setting of the response/setting of the spectrum), where the setting is the
    integration time of the first detector (longer: more counts) and the gain number of the others (greater: fewer
    counts); L = E base/pi with the reflectance ``base`` of the panel under the lamp.

    Parameters
    ----------
    end_of_reference : where the calibration may begin, len(raw) for files without one
    stored : (n,) values of the file

    Raises
    ------
    InputError : counts without calibration, or a calibration under which the detectors do not join.
    """
    kind = "irradiance" if raw[186] == 4 else "radiance"
    if float(np.nanmax(np.abs(stored))) <= GREATEST:
        return stored, kind, ()
    if raw[:3] not in (b"as7", b"as8"):
        raise InputError(
            f"a file of {kind} that holds counts up to {np.nanmax(stored):.0f}, and no calibration",
            where=where, expected=f"at most {GREATEST:g} {_UNITS['radiance']}", mend=_MEND,
        )  # fmt: skip
    try:
        powers = _calibrations(raw, end_of_reference, stored.size, dtype)
    except (struct.error, IndexError, ValueError) as error:
        raise InputError(f"the calibration in the file is not understood ({error})", where=where, mend=_MEND) from None
    (field_of_view,) = struct.unpack_from("<h", raw, 394)
    needed = (LAMP, RESPONSE) if field_of_view >= _NO_ANGLE else (BASE, LAMP, RESPONSE)
    if any(k not in powers for k in needed):
        raise InputError(f"a file of {kind} that holds counts, and no calibration", where=where, mend=_MEND)
    (integration,) = struct.unpack_from("<L", raw, 390)
    gains = struct.unpack_from("<2H", raw, 436)
    joins = struct.unpack_from("<2f", raw, 444)
    response, integration_ms, own_gains = powers[RESPONSE]
    if not (integration and integration_ms > 0 and all(gains) and all(own_gains)):
        raise InputError("settings of the calibration that are 0", where=where, mend=_MEND)
    factor = np.where(
        wavelength_nm <= joins[0],
        integration_ms / integration,
        np.where(wavelength_nm <= joins[1], gains[0] / own_gains[0], gains[1] / own_gains[1]),
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.where(response > 0, powers[LAMP][0] * stored / response * factor, np.nan)
    if field_of_view < _NO_ANGLE:
        values = values * powers[BASE][0] / np.pi
        kind = "radiance"
    else:
        kind = "irradiance"
    _check_joins(values, wavelength_nm, joins, where)
    return values, kind, (f"{kind} from counts by the calibration in the file",)


def _calibrations(raw: bytes, at: int, channels: int, dtype: np.dtype) -> dict[int, tuple[Array, int, tuple[int, int]]]:
    """The calibration spectra by kind, each with integration time [ms] and gains.

    ValueError where the blocks before them are not empty ones.

    Versions 7 and 8 append, after the white reference, a block of classifier data, one of dependent variables and
    the calibration: how many spectra, then for each its kind, name, integration time [ms] and gains of the two
    short-wave detectors, then the spectra themselves.
    """
    at += 2
    for _ in range(_CLASSIFIER_TEXTS):
        (length,) = struct.unpack_from("<h", raw, at)
        if length < 0:
            raise ValueError("a text of negative length")
        at += 2 + length
    (constituents,) = struct.unpack_from("<h", raw, at)
    (dependents,) = struct.unpack_from("<h", raw, at + 6)
    if constituents or dependents:
        raise ValueError("classifier data come first")
    at += 12
    count = raw[at]
    at += 1
    entries = [_ENTRY.unpack_from(raw, at + i * _ENTRY.size) for i in range(count)]
    at += count * _ENTRY.size
    calibrations = {}
    for kind, _, integration, first, second in entries:
        if at + channels * dtype.itemsize > len(raw):
            raise ValueError("cut short")
        values = np.frombuffer(raw, dtype, channels, at).astype(float)
        calibrations[kind] = (values, integration, (first, second))
        at += channels * dtype.itemsize
    return calibrations


def _check_joins(values: Array, wavelength_nm: Array, joins: tuple[float, ...], where: str) -> None:
    for join in joins:
        after = int(np.searchsorted(wavelength_nm, join, side="right"))
        if not 1 <= after < values.size:
            continue
        low, high = values[after - 1], values[after]
        step = abs(high / low - 1.0) if low else np.inf
        if not step <= MAX_STEP:
            raise InputError(
                f"calibrated, the spectrum steps by {100 * step:.0f} % at {join:g} nm, where two detectors join: "
                "the calibration in the file does not fit its settings",
                where=where,
                expected=f"at most {100 * MAX_STEP:.0f} %",
                mend=_MEND,
            )


_SUFFIXES = (".sli", ".lib", ".img", "", ".SLI", ".LIB", ".IMG")
MARK = b"SPECPR_MAGIC"
RECORD_BYTES = 1536
MAX_SPECPR_BYTES = 256 << 20
MOST_CHANNELS = 4852  # of the format
_CONTINUATION, _TEXT, _ERRORS = 1, 2, 8
_FIRST, _MORE = 256, 383


def records_at_hand(library: Any) -> list[Record]:
    """The spectra of a library of SPy, or of an array of xarray (spectrum, wavelength).

    Raises
    ------
    UsageError : another kind of object, or one without wavelengths.
    """
    if hasattr(library, "spectra") and hasattr(library, "bands") and library.bands.centers is not None:
        wavelength, rows, names = library.bands.centers, library.spectra, library.names
        unit = library.bands.band_unit
    elif hasattr(library, "coords") and "wavelength" in library.coords and library.ndim == 2:
        ordered = library.transpose(..., "wavelength")
        wavelength, rows = ordered["wavelength"].values, ordered.values
        named = ordered.dims[0] in ordered.coords
        names = ordered[ordered.dims[0]].values if named else [f"spectrum {i + 1}" for i in range(len(rows))]
        unit = ordered["wavelength"].attrs.get("units")
    else:
        raise UsageError(
            f"an object of type {type(library).__name__} without wavelengths",
            expected="a path, a library of SPy (spectral), or an array of xarray (spectrum, wavelength)",
        )
    return _records(names, wavelength, rows, "library at hand", None if unit is None else str(unit))


def library_records(path: Path, header: EnviHeader | None, root: Path | None = None) -> list[Record]:
    """Every spectrum of a library; ``path`` is the header when ``header`` is None, else the data file.

    Raises
    ------
    InputError : not a spectral library, a data file of the wrong size, or names or wavelengths that do not fit.
    """
    if header is None:
        header = read_header(path)
        files = [path.with_suffix(end) for end in _SUFFIXES if path.with_suffix(end).is_file()]
        if len(files) != 1:
            raise InputError(f"{len(files)} data files beside the header", where=str(path))
        path = files[0]
    path = checked_file(path, root=root, what="spectral library")
    checked_file(header.path, root=root, what="ENVI header")
    lines, channels, size = header.lines, header.samples, path.stat().st_size
    if header.file_type.lower() != "envi spectral library" or header.bands != 1:
        what, expected = (
            f"file type {header.file_type!r} with {header.bands} bands",
            "ENVI Spectral Library with one band",
        )
        raise InputError(what, where=header.where("file type"), expected=expected)
    if size != header.expected_bytes or size > MAX_BYTES:
        expected = f"{header.expected_bytes} bytes ({lines} spectra of {channels} channels), at most {MAX_BYTES}"
        raise InputError(f"{size} bytes", where=str(path), expected=expected)
    wavelength = header.numbers("wavelength")
    if wavelength is None or wavelength.size != channels:
        what = f"{0 if wavelength is None else wavelength.size} wavelengths for {channels} channels"
        raise InputError(what, where=header.where("wavelength"))
    names = header.strings("spectra names") or tuple(f"spectrum {i + 1}" for i in range(lines))
    if len(names) != lines:
        raise InputError(f"{len(names)} names for {lines} spectra", where=header.where("spectra names"))
    stored = np.fromfile(path, header.dtype, offset=header.header_offset).reshape(lines, channels)
    # An ignore value and a list of bad bands both say that channels hold no value.
    ignore, flags = header.number("data ignore value"), header.numbers("bbl", channels)
    empty = np.zeros(stored.shape, bool) if ignore is None else stored == ignore
    if flags is not None:
        empty |= flags == 0.0
    factor = header.number("reflectance scale factor")
    if factor is not None and not (np.isfinite(factor) and factor > 0):
        raise InputError(f"'reflectance scale factor' is {factor:g}", where=header.where("reflectance scale factor"))
    # A factor of 1 is what ENVI writes when nobody told it: it states nothing.
    scale = f"scaled:{factor!r}" if factor not in (None, 1.0) else None
    values = np.where(empty, np.nan, stored.astype(float))
    return _records(names, wavelength, values, str(path), header.text("wavelength units"), scale)


def _records(
    names: Iterable[Any], wavelength: Any, rows: Any, where: str, unit: str | None, scale: str | None = None
) -> list[Record]:
    """Spectra (spectrum, channel) on one set of wavelengths, whose unit may be said to be unknown."""
    unit = None if unit is None or unit.lower() in ("", "unknown", "none", "<unspecified>") else unit
    axis = np.asarray(wavelength, float)
    return [
        Record(str(name), axis, np.asarray(row, float), where, wavelength_unit=unit, reflectance_unit=scale)
        for name, row in zip(names, rows, strict=True)
    ]


class _Spectrum(NamedTuple):
    number: int
    title: str
    channels: int
    wavelength_record: int
    width_record: int
    errors_follow: bool


def is_specpr(head: bytes) -> bool:
    """Whether the content is that of a SPECPR file."""
    return head.startswith(MARK)


def specpr_records(path: Path) -> list[Record]:
    """Every spectrum of a SPECPR file but wavelengths, band widths and errors; the errors go with their spectrum.

    Records have 1536 bytes, big-endian, and begin with 32 bits of flags: bit 0 continuation, bit 1 text, bit 3
    errors in the records that follow.  The first record of a spectrum holds its title at 4, the number of
    channels at 80, the record of its wavelengths at 100 and of its band widths at 104, and 256 values from 512
    on; continuations hold 383 values each from 4 on.  Record 0 begins with a mark.  Wavelengths are in
    micrometres, deleted channels hold -1.23e34.  Source: R. N. Clark, SPECPR format, USGS Open-File Report
    93-595.

    Raises
    ------
    InputError : cut short, too large, records that contradict each other, or no spectrum.
    """
    where = str(path)
    size = path.stat().st_size
    if size % RECORD_BYTES or not RECORD_BYTES <= size <= MAX_SPECPR_BYTES:
        expected = f"records of {RECORD_BYTES} bytes, at most {MAX_SPECPR_BYTES}"
        raise InputError(f"{size} bytes", where=where, expected=expected, mend="copy the file again")
    raw = np.fromfile(path, np.uint8).reshape(-1, RECORD_BYTES)
    flags = raw[:, :4].copy().view(">u4").ravel()
    heads = [_head(raw[i], i) for i in range(1, len(raw)) if not flags[i] & (_CONTINUATION | _TEXT)]
    spectra = [h for h in heads if h.channels > 0]
    by_number = {s.number: s for s in spectra}
    auxiliary = {n for s in spectra for n in (s.wavelength_record, s.width_record) if n > 0}
    auxiliary |= {after.number for s in spectra if s.errors_follow and (after := _after(s, spectra)) is not None}
    out = []
    for spectrum in spectra:
        if spectrum.number in auxiliary or spectrum.wavelength_record <= 0:
            continue
        grid = by_number.get(spectrum.wavelength_record)
        if grid is None or grid.channels != spectrum.channels:
            what = f"record {spectrum.number} ({spectrum.title!r}) has its wavelengths in record "
            what += f"{spectrum.wavelength_record}, which holds none for {spectrum.channels} channels"
            raise InputError(what, where=where)
        errors = _after(spectrum, spectra) if spectrum.errors_follow else None
        spread = None if errors is None else _values(raw, flags, errors, where)
        wavelength, values = (_values(raw, flags, s, where) for s in (grid, spectrum))
        out.append(Record(spectrum.title, wavelength, values, where, spread, None, "um", "fraction"))
    if not out:
        raise InputError("the file holds no spectrum with wavelengths", where=where)
    return out


def _head(record: npt.NDArray[np.uint8], number: int) -> _Spectrum:
    title = record[4:44].tobytes().split(b"\0")[0].decode("latin-1").strip()
    words = record[:512].copy().view(">i4")
    return _Spectrum(number, title, int(words[20]), int(words[25]), int(words[26]), bool(int(words[0]) & _ERRORS))


def _after(spectrum: _Spectrum, spectra: list[_Spectrum]) -> _Spectrum | None:
    """The spectrum of as many channels that follows, which holds the errors."""
    follows = next((s for s in spectra if s.number > spectrum.number), None)
    return follows if follows is not None and follows.channels == spectrum.channels else None


def _values(raw: npt.NDArray[np.uint8], flags: npt.NDArray[np.uint32], spectrum: _Spectrum, where: str) -> Array:
    """The channels (n,) of a spectrum from its first record and the continuations behind it."""
    n, at = spectrum.channels, spectrum.number
    more = max(0, -(-(n - _FIRST) // _MORE))
    behind = flags[at + 1 : at + 1 + more]
    if n > MOST_CHANNELS or behind.size != more or not np.all((behind & (_CONTINUATION | _TEXT)) == _CONTINUATION):
        raise InputError(
            f"record {at} ({spectrum.title!r}): {n} channels, and {behind.size} records behind it",
            where=where,
            expected=f"{more} continuations",
            mend="the file is damaged: copy it again",
        )
    parts = [raw[at, 512:].tobytes(), *(raw[i, 4:].tobytes() for i in range(at + 1, at + 1 + more))]
    return np.frombuffer(b"".join(parts), ">f4")[:n].astype(float)


def library_to_spy(spectra: Sequence[FieldSpectrum]) -> SpectralLibrary:
    """Spectra on one set of wavelengths as a library of SPy; :func:`read_records` takes it back.

    Raises
    ------
    UsageError : no spectrum, or different wavelengths.
    """
    from spectral.io.envi import SpectralLibrary  # with xarray 70 MB, which most runs need not

    _check(spectra)
    header = {
        "wavelength": spectra[0].wavelength_nm.tolist(),
        "wavelength units": "nm",
        "spectra names": [s.name for s in spectra],
    }
    return SpectralLibrary(np.stack([s.values for s in spectra]), header)


def library_to_xarray(spectra: Sequence[FieldSpectrum]) -> xr.DataArray:
    """Spectra on one set of wavelengths as an array (spectrum, wavelength); UsageError as for SPy."""
    import xarray as xr

    _check(spectra)
    return xr.DataArray(
        np.stack([s.values for s in spectra]),
        dims=("spectrum", "wavelength"),
        coords={
            "spectrum": [s.name for s in spectra],
            "wavelength": ("wavelength", spectra[0].wavelength_nm, {"units": "nm"}),
        },
        name=spectra[0].quantity,
    )


def _check(spectra: Sequence[FieldSpectrum]) -> None:
    if not spectra or any(not np.array_equal(s.wavelength_nm, spectra[0].wavelength_nm) for s in spectra):
        raise UsageError("a library needs spectra on one set of wavelengths", mend="resample them first")
