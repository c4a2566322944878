"""ASD binary files: reflectance as the stored spectrum over the stored reference; radiance and irradiance.

Layout (little-endian): 484 bytes of header, with the data type at 186, first wavelength and step at
191 and 195, data format at 199, number of channels at 204; the spectrum; from version 2 on a
reference block of a flag, two times, a description with its length, and the reference spectrum.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError
from hyperval.spectra.readers_record import Record

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
RADIANCE_UNIT, IRRADIANCE_UNIT = "W m-2 sr-1 nm-1", "W m-2 nm-1"
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
    where = str(path)
    kind = raw[186]
    first, step = struct.unpack_from("<2f", raw, 191)
    channels = struct.unpack_from("<H", raw, 204)[0]
    if raw[199] not in _FORMATS or not 2 <= channels <= MAX_CHANNELS or not (np.isfinite(first) and step > 0):
        raise InputError("the ASD header is not valid", where=where)
    if not RANGE_NM[0] <= first < first + step * (channels - 1) <= RANGE_NM[1]:
        raise InputError(
            f"the ASD header is not valid: wavelengths from {first:g} to {first + step * (channels - 1):g} nm",
            where=where, expected=f"{RANGE_NM[0]:g} to {RANGE_NM[1]:g} nm",
        )  # fmt: skip
    if kind not in (0, 1, 2, 4):
        raise InputError(
            f"the file holds {_TYPES.get(kind, 'unknown data')}",
            where=where,
            expected="reflectance, raw counts with their white reference, radiance or irradiance",
            mend="export the reflectance as text",
        )
    dtype = np.dtype(_FORMATS[raw[199]])
    spectrum = _array(raw, HEADER_BYTES, channels, dtype, where, ratio=raw[:3] == b"ASD")
    wavelength = first + step * np.arange(channels, dtype=float)
    if kind in (2, 4):
        if quantity not in (
            "radiance",
            "irradiance",
        ):  # refused by what it holds, whether it can be calibrated or not
            return Record(path.stem, wavelength, spectrum, where, wavelength_unit="nm", quantity=_TYPES[kind])
        values, calibrations, notes = calibrated(
            raw, _end_of_reference(raw, channels, dtype), spectrum, wavelength, dtype, where
        )
        return Record(
            path.stem, wavelength, values, where,
            wavelength_unit="nm", quantity=calibrations, notes=notes,
            unit=RADIANCE_UNIT if calibrations == "radiance" else IRRADIANCE_UNIT,
        )  # fmt: skip
    note: tuple[str, ...] = ()
    if raw[:3] == b"ASD":  # version 1 stores the reflectance itself and no reference
        if kind == 0:
            raise InputError("raw counts without a white reference", where=where)
    else:
        end = _end_of_reference(raw, channels, dtype)
        flag = HEADER_BYTES + spectrum.size * dtype.itemsize
        if len(raw) < flag + 20:
            raise InputError("the ASD file is cut short", where=where)
        if not struct.unpack_from("<H", raw, flag)[0]:
            raise InputError("the file holds no white reference", where=where, mend="export the reflectance as text")
        reference = _array(raw, end - channels * dtype.itemsize, channels, dtype, where)
        with np.errstate(divide="ignore", invalid="ignore"):
            spectrum = np.where(reference != 0, spectrum / reference, np.nan)
        note = ("reflectance is the stored spectrum over the stored white reference",)
    return Record(
        name=path.stem,
        wavelength=wavelength,
        values=spectrum,
        where=where,
        wavelength_unit="nm",
        reflectance_unit="fraction",
        quantity="reflectance",
        notes=note,
    )


def _end_of_reference(raw: bytes, channels: int, dtype: np.dtype) -> int:
    """First byte behind the white reference; the end of a file that is too short to hold one."""
    at = HEADER_BYTES + channels * dtype.itemsize
    if raw[:3] == b"ASD" or len(raw) < at + 20:
        return len(raw)
    return at + 20 + int(struct.unpack_from("<H", raw, at + 18)[0]) + channels * dtype.itemsize


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


@dataclass(frozen=True, eq=False)
class Calibration:
    """A spectrum of an instrument's calibration with the settings under which it was taken."""

    values: Array
    integration_ms: int
    gains: tuple[int, int]


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
            where=where, expected=f"at most {GREATEST:g} {RADIANCE_UNIT}", mend=_MEND,
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
    response = powers[RESPONSE]
    if not (integration and response.integration_ms > 0 and all(gains) and all(response.gains)):
        raise InputError("settings of the calibration that are 0", where=where, mend=_MEND)
    factor = np.where(
        wavelength_nm <= joins[0],
        response.integration_ms / integration,
        np.where(wavelength_nm <= joins[1], gains[0] / response.gains[0], gains[1] / response.gains[1]),
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.where(response.values > 0, powers[LAMP].values * stored / response.values * factor, np.nan)
    if field_of_view < _NO_ANGLE:
        values = values * powers[BASE].values / np.pi
        kind = "radiance"
    else:
        kind = "irradiance"
    _check_joins(values, wavelength_nm, joins, where)
    return values, kind, (f"{kind} from counts by the calibration in the file",)


def _calibrations(raw: bytes, at: int, channels: int, dtype: np.dtype) -> dict[int, Calibration]:
    """The calibration spectra by kind; ValueError where the blocks before them are not empty ones.

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
        calibrations[kind] = Calibration(values, integration, (first, second))
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
