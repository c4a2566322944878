"""Radiance and irradiance of ASD files: stored as such, or counts with the instrument's calibration behind them.

Versions 7 and 8 append, after the white reference, a block of classifier data, one of dependent variables and the
calibration: how many spectra, then for each its kind, name, integration time [ms] and gains of the two
short-wave detectors, then the spectra themselves.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError

Array = npt.NDArray[np.float64]

RADIANCE_UNIT, IRRADIANCE_UNIT = "W m-2 sr-1 nm-1", "W m-2 nm-1"
BASE, LAMP, RESPONSE = 1, 2, 3
GREATEST = 20.0  # [W m-2 sr-1 nm-1]; sunlit white reaches 0.7, raw counts go to 65535
MAX_STEP = 0.25  # at a join of two detectors; a drifting instrument steps by a tenth
_NO_ANGLE = 180  # fore optic of 180 degrees and more: a cosine receptor, which sees irradiance
_CLASSIFIER_TEXTS = 20
_ENTRY = struct.Struct("<b20sihh")
_MEND = "export the calibrated spectrum as text, with its unit in the title"


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
        raise InputError(
            f"the calibration in the file is not understood ({error})", where=where, mend=_MEND
        ) from None
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
    """The calibration spectra by kind; ValueError where the blocks before them are not empty ones."""
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
