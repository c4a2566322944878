"""Binary files of spectra: ASD of field spectrometers, SPECPR of USGS, ENVI libraries.

ASD (little-endian): 484 bytes of header, with the data type at 186, first wavelength and step at 191 and 195, data
format at 199, number of channels at 204; the spectrum; from version 2 on a reference block of a flag, two times, a
description with its length, and the reference spectrum.  Reflectance is the stored spectrum over the reference.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.data import Array, equals
from hyperval.envi_header import data_beside, header_beside, read_header
from hyperval.errors import needed, package_table, refusal, refuse
from hyperval.paths import checked_file
from hyperval.spectra.record import MAX_BYTES, FieldSpectrum, SpectraFile

_VERSIONS = (b"ASD", b"as2", b"as3", b"as4", b"as5", b"as6", b"as7", b"as8")
HEADER_BYTES = 484
_HEADER = np.dtype({
    "names": ("kind", "first", "step", "format", "channels", "integration", "optic", "gains", "joins"),
    "formats": ("u1", "<f4", "<f4", "u1", "<u2", "<u4", "<i2", ("<u2", 2), ("<f4", 2)),
    "offsets": (186, 191, 195, 199, 204, 390, 394, 436, 444), "itemsize": HEADER_BYTES,
})  # fmt: skip
_FORMATS = {0: "<f4", 1: "<i4", 2: "<f8"}
_TYPES: dict[int, str] = dict(enumerate(package_table("spectra/words.yaml")["asd_types"]))
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
_ENTRY = np.dtype([("kind", "i1"), ("name", "S20"), ("integration", "<i4"), ("gains", "<i2", 2)])


def is_asd(file: SpectraFile) -> bool:
    """True when the content is that of an ASD binary file."""
    raw = file.raw
    return raw[:3] in _VERSIONS and len(raw) > HEADER_BYTES and b"\0" in raw[3:HEADER_BYTES]


def asd_records(file: SpectraFile) -> list[FieldSpectrum]:
    """Reflectance (relative to the white reference), radiance or irradiance of an ASD file, as its type says.

    Raises
    ------
    InputError : cut short, another data type, no reference in it, or counts without a calibration that fits.
    """
    raw, where = file.raw, str(file.path)
    head = np.frombuffer(raw, _HEADER, 1)[0]
    kind, channels, first, step = int(head["kind"]), int(head["channels"]), float(head["first"]), float(head["step"])
    last, (least, most) = first + step * (channels - 1), RANGE_NM
    readable = head["format"] in _FORMATS and 2 <= channels <= MAX_CHANNELS and step > 0
    wrong = not (readable and least <= first < last <= most)
    refuse(wrong, "asd.header", where, first=first, last=last, least=least, most=most)
    refuse(kind not in (0, 1, 2, 4), "asd.kind", where, held=_TYPES.get(kind, "unknown data"))
    dtype, alone = np.dtype(_FORMATS[int(head["format"])]), raw[:3] == b"ASD"  # version 1: reflectance, no reference
    values = _array(raw, HEADER_BYTES, channels, dtype, where, ratio=alone)
    nm = first + step * np.arange(channels, dtype=float)
    record = FieldSpectrum(file.path.stem, nm, values, wavelength_unit="nm")
    flag, end = HEADER_BYTES + values.size * dtype.itemsize, len(raw)
    if not alone and len(raw) >= flag + 20:
        end = flag + 20 + int(struct.unpack_from("<H", raw, flag + 18)[0]) + channels * dtype.itemsize
    if kind in (2, 4):
        if file.quantity not in _UNITS:  # refused by what it holds, whether it can be calibrated or not
            return [replace(record, quantity=_TYPES[kind])]
        values, power, notes = calibrated(raw, end, values, nm, dtype, where)
        return [replace(record, values=values, quantity=power, notes=notes, unit=_UNITS[power])]
    refuse(alone and kind == 0, "asd.counts", where)
    notes = ()
    if not alone:
        refuse(len(raw) < flag + 20, "asd.short", where)
        refuse(not struct.unpack_from("<H", raw, flag)[0], "asd.reference", where)
        reference = _array(raw, end - channels * dtype.itemsize, channels, dtype, where)
        with np.errstate(divide="ignore", invalid="ignore"):
            values = np.where(reference != 0, values / reference, np.nan)
        notes = ("reflectance is the stored spectrum over the stored white reference",)
    return [replace(record, values=values, unit="fraction", quantity="reflectance", notes=notes)]


def _array(raw: bytes, start: int, count: int, dtype: np.dtype, where: str, *, ratio: bool = False) -> Array:
    """Counts or radiances channel by channel; those that no instrument stores are refused.

    Such are values that are not finite, emptied, or one alone far from both channels beside it; a ``ratio``, a stored
    reflectance, may be anything where there was no light.
    """
    refuse(len(raw) < start + count * dtype.itemsize, "asd.short", where)
    values = np.frombuffer(raw, dtype, count, start).astype(float)
    before, after = np.pad(values, 1, mode="reflect")[:-2], np.pad(values, 1, mode="reflect")[2:]
    with np.errstate(all="ignore"):
        excess = np.maximum(values - np.maximum(before, after), np.minimum(before, after) - values)
        most = max(_SPIKE * np.abs(values).max(), _SPIKE_STEPS * float(np.median(np.abs(np.diff(values)))))
        bad = ~np.isfinite(values) | ((excess > most) & (not ratio))
    empty = np.convolve(values == 0.0, np.ones(_EMPTY), "valid") == _EMPTY
    channel = int(np.argmax(bad)) if bad.any() else int(np.argmax(empty))
    others = "" if bad.any() else f", as do the {_EMPTY - 1} after it"
    wrong = bad.any() or empty.any()
    refuse(wrong, "asd.channel", where, channel=channel + 1, value=values[channel], others=others)
    return values


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
    head = np.frombuffer(raw, _HEADER, 1)[0]
    kind, receptor = "irradiance" if head["kind"] == 4 else "radiance", head["optic"] >= _NO_ANGLE
    if float(np.nanmax(np.abs(stored))) <= GREATEST:
        return stored, kind, ()
    uncalibrated = raw[:3] not in (b"as7", b"as8")
    refuse(
        uncalibrated, "asd.large", where, power=kind, value=np.nanmax(stored), most=GREATEST, unit=_UNITS["radiance"]
    )
    try:
        powers = _calibrations(raw, end_of_reference, stored.size, dtype)
    except (struct.error, IndexError, ValueError) as error:
        raise refusal("asd.calibration", where, why=error) from None
    parts = (LAMP, RESPONSE) if receptor else (BASE, LAMP, RESPONSE)
    refuse(any(k not in powers for k in parts), "asd.uncalibrated", where, power=kind)
    response, integration_ms, own_gains = powers[RESPONSE]
    gains, joins, integration = head["gains"].tolist(), head["joins"].tolist(), int(head["integration"])
    refuse(not (integration and integration_ms > 0 and all(gains) and all(own_gains)), "asd.settings", where)
    ratios = [integration_ms / integration, gains[0] / own_gains[0], gains[1] / own_gains[1]]
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.select([wavelength_nm <= joins[0], wavelength_nm <= joins[1]], ratios[:2], ratios[2])
        values = np.where(response > 0, powers[LAMP][0] * stored / response * factor, np.nan)
    kind = "irradiance" if receptor else "radiance"
    values = values if receptor else values * powers[BASE][0] / np.pi
    for join in joins:
        after = int(np.searchsorted(wavelength_nm, join, side="right"))
        if 1 <= after < values.size:
            low, high = values[after - 1], values[after]
            part = abs(high / low - 1.0) if low else np.inf
            refuse(not part <= MAX_STEP, "asd.join", where, percent=100 * part, join=join, most=100 * MAX_STEP)
    return values, kind, (f"{kind} from counts by the calibration in the file",)


def _calibrations(raw: bytes, start: int, channels: int, dtype: np.dtype) -> dict[int, tuple[Array, int, list[int]]]:
    """The calibration spectra by kind, each with integration time [ms] and gains.

    ValueError where the blocks before them are not empty ones.

    Versions 7 and 8 append, after the white reference, a block of classifier data, one of dependent variables and
    the calibration: how many spectra, then for each its kind, name, integration time [ms] and gains of the two
    short-wave detectors, then the spectra themselves.
    """
    start += 2
    for _ in range(_CLASSIFIER_TEXTS):
        (length,) = struct.unpack_from("<h", raw, start)
        if length < 0:
            raise ValueError("a text of negative length")
        start += 2 + length
    constituents, _, _, dependents = struct.unpack_from("<4h", raw, start)
    if constituents or dependents:
        raise ValueError("classifier data come first")
    entries = np.frombuffer(raw, _ENTRY, raw[start + 12], start + 13)
    start += 13 + entries.nbytes
    if start + entries.size * channels * dtype.itemsize > len(raw):
        raise ValueError("cut short")
    spectra = np.frombuffer(raw, dtype, entries.size * channels, start).astype(float).reshape(-1, channels)
    columns = (entries[name].tolist() for name in ("kind", "integration", "gains"))
    return {kind: (values, time, gains) for kind, time, gains, values in zip(*columns, spectra, strict=True)}


MARK = b"SPECPR_MAGIC"
MAX_SPECPR_BYTES = 256 << 20
SPECPR_CHANNELS = 4852  # of the format
_CONTINUATION, _TEXT, _ERRORS = 1, 2, 8
_FIRST, _MORE = 256, 383
_RECORD = np.dtype({
    "names": ("flags", "title", "channels", "grid", "widths", "first", "more"),
    "formats": (">u4", "S40", ">i4", ">i4", ">i4", (">f4", _FIRST), (">f4", _MORE)),
    "offsets": (0, 4, 80, 100, 104, 512, 4), "itemsize": 1536,
})  # fmt: skip


def specpr_records(file: SpectraFile) -> list[FieldSpectrum]:
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
    where, size = str(file.path), file.path.stat().st_size
    cut = size % _RECORD.itemsize or not 0 < size <= MAX_SPECPR_BYTES
    refuse(cut, "specpr.size", where, size=size, one=_RECORD.itemsize, most=MAX_SPECPR_BYTES)
    raw = np.fromfile(file.path, _RECORD)
    begins = (raw["flags"] & (_CONTINUATION | _TEXT) == 0) & (raw["channels"] > 0)
    starts = [int(i) for i in np.flatnonzero(begins) if i > 0]
    heads = set(starts)
    # The spectrum of as many channels that follows one with this flag holds its errors.
    errors = {
        one: after for one, after in pairwise(starts)
        if raw["flags"][one] & _ERRORS and raw["channels"][one] == raw["channels"][after]
    }  # fmt: skip
    auxiliary = {*raw["grid"][starts].tolist(), *raw["widths"][starts].tolist(), *errors.values()}
    out = []
    for i in (i for i in starts if i not in auxiliary and raw["grid"][i] > 0):
        grid, channels = int(raw["grid"][i]), int(raw["channels"][i])
        none = grid not in heads or raw["channels"][grid] != channels
        refuse(none, "specpr.grid", where, number=i, title=_title(raw[i]), grid=grid, channels=channels)
        wavelength, values = (_values(raw, k, where) for k in (grid, i))
        spread = _values(raw, errors[i], where) if i in errors else None
        out.append(FieldSpectrum(_title(raw[i]), wavelength, values, spread, wavelength_unit="um", unit="fraction"))
    refuse(not out, "specpr.none", where)
    return out


def _title(record: np.void) -> str:
    return bytes(record["title"]).split(b"\0")[0].decode("latin-1").strip()


def _values(raw: npt.NDArray[np.void], start: int, where: str) -> Array:
    """The channels (n,) of a spectrum from its first record and the continuations behind it."""
    n = int(raw["channels"][start])
    more = max(0, -(-(n - _FIRST) // _MORE))
    following = raw[start + 1 : start + 1 + more]
    broken = np.any((following["flags"] & (_CONTINUATION | _TEXT)) != _CONTINUATION)
    cut, title = n > SPECPR_CHANNELS or following.size != more or broken, _title(raw[start])
    refuse(cut, "specpr.continued", where, number=start, title=title, channels=n, count=following.size, more=more)
    return np.concatenate([raw["first"][start], following["more"].ravel()])[:n].astype(float)


HEADERS = (b"ENVI\r", b"ENVI\n", b"ENVI \r", b"ENVI \n")  # how a header begins, and no plot


def library_records(file: SpectraFile) -> list[FieldSpectrum]:
    """Every spectrum of a library of ENVI, by its header or its data file.

    Raises
    ------
    InputError : not a spectral library, a data file of the wrong size, or names or wavelengths that do not fit.
    """
    is_header = file.head.startswith(HEADERS)
    header = read_header(file.path if is_header else header_beside(file.path) or file.path)
    path = checked_file(data_beside(file.path), what="spectral library") if is_header else file.path
    lines, channels, size = header.lines, header.samples, path.stat().st_size
    other = header.file_type.lower() != "envi spectral library" or header.bands != 1
    refuse(other, "library.type", header.where("file type"), type=header.file_type, bands=header.bands)
    whole, most = header.expected_bytes, MAX_BYTES
    wrong = size != whole or size > most
    refuse(wrong, "library.size", path, size=size, lines=lines, channels=channels, whole=whole, most=most)
    wavelength = needed(header.numbers("wavelength", channels), "library.wavelengths", header.path, channels=channels)
    names = header.strings("spectra names") or tuple(f"spectrum {i + 1}" for i in range(lines))
    refuse(len(names) != lines, "library.names", header.where("spectra names"), count=len(names), lines=lines)
    values = np.fromfile(path, header.dtype, offset=header.header_offset).reshape(lines, channels)
    # An ignore value and a list of bad bands both say that channels hold no value.
    ignore, flags = header.number("data ignore value"), header.numbers("bbl", channels)
    empty = np.zeros(values.shape, bool) if ignore is None else equals(values, ignore)
    if flags is not None:
        empty |= flags == 0.0
    key, factor = "reflectance scale factor", header.number("reflectance scale factor")
    absurd = factor is not None and not (np.isfinite(factor) and factor > 0)
    refuse(absurd, "library.scale", header.where(key), key=key, factor=factor or 0.0)
    # A factor of 1 is what ENVI writes when nobody told it: it states nothing.
    scale = f"scaled:{factor!r}" if factor not in (None, 1.0) else None
    return on_one_grid(names, wavelength, np.where(empty, np.nan, values), path, header.text("wavelength units"), scale)


def on_one_grid(
    names: Iterable[Any], wavelength: Any, rows: Any, source: object, unit: str | None, scale: str | None = None
) -> list[FieldSpectrum]:
    """Spectra (spectrum, channel) on one set of wavelengths."""
    named, nm = zip(names, np.asarray(rows, float), strict=True), np.asarray(wavelength, float)
    origin = str(source)
    return [FieldSpectrum(str(name), nm, row, source=origin, wavelength_unit=unit, unit=scale) for name, row in named]
