"""Binary files of spectra: ASD of field spectrometers, SPECPR of USGS.

ASD binary files: reflectance as the stored spectrum over the stored reference; radiance and irradiance.

Layout (little-endian): 484 bytes of header, with the data type at 186, first wavelength and step at
191 and 195, data format at 199, number of channels at 204; the spectrum; from version 2 on a
reference block of a flag, two times, a description with its length, and the reference spectrum.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError, refuse
from hyperval.spectra.record import Record

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
    wrong = raw[199] not in _FORMATS or not 2 <= channels <= MAX_CHANNELS or not (np.isfinite(first) and step > 0)
    refuse(wrong, "the ASD header is not valid", where)
    last, (least, most) = first + step * (channels - 1), RANGE_NM
    what = f"the ASD header is not valid: wavelengths from {first:g} to {last:g} nm"
    refuse(not least <= first < last <= most, what, where, f"{least:g} to {most:g} nm")
    expected = "reflectance, raw counts with their white reference, radiance or irradiance"
    export = "export the reflectance as text"
    refuse(kind not in (0, 1, 2, 4), f"the file holds {_TYPES.get(kind, 'unknown data')}", where, expected, export)
    dtype, alone = np.dtype(_FORMATS[raw[199]]), raw[:3] == b"ASD"  # version 1 stores the reflectance and no reference
    values = _array(raw, HEADER_BYTES, channels, dtype, where, ratio=alone)
    nm = first + step * np.arange(channels, dtype=float)
    record = Record(path.stem, nm, values, source=where, wavelength_unit="nm")
    flag, end = HEADER_BYTES + values.size * dtype.itemsize, len(raw)
    if not alone and len(raw) >= flag + 20:
        end = flag + 20 + int(struct.unpack_from("<H", raw, flag + 18)[0]) + channels * dtype.itemsize
    if kind in (2, 4):
        if quantity not in _UNITS:  # refused by what it holds, whether it can be calibrated or not
            return replace(record, quantity=_TYPES[kind])
        values, power, notes = calibrated(raw, end, values, nm, dtype, where)
        return replace(record, values=values, quantity=power, notes=notes, unit=_UNITS[power])
    refuse(alone and kind == 0, "raw counts without a white reference", where)
    notes = ()
    if not alone:
        refuse(len(raw) < flag + 20, "the ASD file is cut short", where)
        refuse(not struct.unpack_from("<H", raw, flag)[0], "the file holds no white reference", where, mend=export)
        reference = _array(raw, end - channels * dtype.itemsize, channels, dtype, where)
        with np.errstate(divide="ignore", invalid="ignore"):
            values = np.where(reference != 0, values / reference, np.nan)
        notes = ("reflectance is the stored spectrum over the stored white reference",)
    return replace(record, values=values, unit="fraction", quantity="reflectance", notes=notes)


def _array(raw: bytes, at: int, count: int, dtype: np.dtype, where: str, *, ratio: bool = False) -> Array:
    """Counts or radiances channel by channel; those that no instrument stores are refused.

    Such are values that are not finite, emptied, or one alone far from both channels beside it; a ``ratio``, a stored
    reflectance, may be anything where there was no light.
    """
    refuse(len(raw) < at + count * dtype.itemsize, "the ASD file is cut short", where)
    values = np.frombuffer(raw, dtype, count, at).astype(float)
    before, after = np.pad(values, 1, mode="reflect")[:-2], np.pad(values, 1, mode="reflect")[2:]
    with np.errstate(all="ignore"):
        beyond = np.maximum(values - np.maximum(before, after), np.minimum(before, after) - values)
        most = max(_SPIKE * np.abs(values).max(), _SPIKE_STEPS * float(np.median(np.abs(np.diff(values)))))
        bad = ~np.isfinite(values) | ((beyond > most) & (not ratio))
    empty = np.convolve(values == 0.0, np.ones(_EMPTY), "valid") == _EMPTY
    channel = int(np.argmax(bad)) if bad.any() else int(np.argmax(empty))
    what = f"channel {channel + 1} holds {values[channel]:g}"
    what += "" if bad.any() else f", as do the {_EMPTY - 1} after it"
    expected, mend = "values like those of the channels beside it", "copy the file again: it is damaged"
    refuse(bad.any() or empty.any(), what, where, expected, mend)
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
    kind = "irradiance" if raw[186] == 4 else "radiance"
    if float(np.nanmax(np.abs(stored))) <= GREATEST:
        return stored, kind, ()
    expected = f"at most {GREATEST:g} {_UNITS['radiance']}"
    what = f"a file of {kind} that holds counts up to {np.nanmax(stored):.0f}, and no calibration"
    refuse(raw[:3] not in (b"as7", b"as8"), what, where, expected, _MEND)
    try:
        powers = _calibrations(raw, end_of_reference, stored.size, dtype)
    except (struct.error, IndexError, ValueError) as error:
        raise InputError(f"the calibration in the file is not understood ({error})", where=where, mend=_MEND) from None
    (field_of_view,) = struct.unpack_from("<h", raw, 394)
    needed = (LAMP, RESPONSE) if field_of_view >= _NO_ANGLE else (BASE, LAMP, RESPONSE)
    what = f"a file of {kind} that holds counts, and no calibration"
    refuse(any(k not in powers for k in needed), what, where, mend=_MEND)
    (integration,) = struct.unpack_from("<L", raw, 390)
    gains, joins = struct.unpack_from("<2H", raw, 436), struct.unpack_from("<2f", raw, 444)
    response, integration_ms, own_gains = powers[RESPONSE]
    unset = not (integration and integration_ms > 0 and all(gains) and all(own_gains))
    refuse(unset, "settings of the calibration that are 0", where, mend=_MEND)
    ratios = [integration_ms / integration, gains[0] / own_gains[0], gains[1] / own_gains[1]]
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.select([wavelength_nm <= joins[0], wavelength_nm <= joins[1]], ratios[:2], ratios[2])
        values = np.where(response > 0, powers[LAMP][0] * stored / response * factor, np.nan)
    kind = "irradiance"
    if field_of_view < _NO_ANGLE:
        values, kind = values * powers[BASE][0] / np.pi, "radiance"
    for join in joins:
        after = int(np.searchsorted(wavelength_nm, join, side="right"))
        if 1 <= after < values.size:
            low, high = values[after - 1], values[after]
            part = abs(high / low - 1.0) if low else np.inf
            what = f"calibrated, the spectrum steps by {100 * part:.0f} % at {join:g} nm, where two detectors join: "
            what += "the calibration in the file does not fit its settings"
            refuse(not part <= MAX_STEP, what, where, f"at most {100 * MAX_STEP:.0f} %", _MEND)
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


MARK = b"SPECPR_MAGIC"
RECORD_BYTES = 1536
MAX_SPECPR_BYTES = 256 << 20
MOST_CHANNELS = 4852  # of the format
_CONTINUATION, _TEXT, _ERRORS = 1, 2, 8
_FIRST, _MORE = 256, 383


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
    expected, cut = f"records of {RECORD_BYTES} bytes, at most {MAX_SPECPR_BYTES}", size % RECORD_BYTES
    refuse(cut or not 0 < size <= MAX_SPECPR_BYTES, f"{size} bytes", where, expected, "copy the file again")
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
            at = f"record {spectrum.wavelength_record}, which holds none for {spectrum.channels} channels"
            raise InputError(f"record {spectrum.number} ({spectrum.title!r}) has its wavelengths in {at}", where=where)
        errors = _after(spectrum, spectra) if spectrum.errors_follow else None
        spread = None if errors is None else _values(raw, flags, errors, where)
        wavelength, values = (_values(raw, flags, s, where) for s in (grid, spectrum))
        record = Record(spectrum.title, wavelength, values, spread, source=where)
        out.append(replace(record, wavelength_unit="um", unit="fraction"))
    refuse(not out, "the file holds no spectrum with wavelengths", where)
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
    what = f"record {at} ({spectrum.title!r}): {n} channels, and {behind.size} records behind it"
    lacking = n > MOST_CHANNELS or behind.size != more or np.any((behind & (_CONTINUATION | _TEXT)) != _CONTINUATION)
    refuse(lacking, what, where, f"{more} continuations", "the file is damaged: copy it again")
    parts = [raw[at, 512:].tobytes(), *(raw[i, 4:].tobytes() for i in range(at + 1, at + 1 + more))]
    return np.frombuffer(b"".join(parts), ">f4")[:n].astype(float)
