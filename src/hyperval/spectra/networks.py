"""A day of a RadCalNet site: surface and top-of-atmosphere reflectance every half hour, with the state of the air.

A file is tab-separated text: the site, one column a half hour, the state, reflectance every 10 nm, and after an
empty line the standard uncertainties of all of it in the same columns.  ``.input`` holds what was measured on the
ground, ``.output`` what the network computed for the top of the atmosphere, seen from nadir; the text of the two
does not tell them apart.  9996 and above: no value.

Surface reflectance of HYPERNETS (L2A): a sequence of views, its errors by kind with their correlation.

The network's files are NetCDF-4 with the conventions of CoMet: relative uncertainties in percent, one random, one
systematic with a matrix of its correlation between wavelengths (in which a dimension stands twice).  The matrix is
stored to two decimals, and so has small negative eigenvalues; these are left out.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperval.errors import HypervalError, InputError, UsageError, reader, refuse
from hyperval.hdf5 import check_hdf5
from hyperval.paths import checked_file
from hyperval.spectra.record import MAX_BYTES, Record, SpectrumErrors

Array = npt.NDArray[np.float64]

HDF5_MARK = b"\x89HDF\r\n\x1a\n"
MAX_WAVELENGTHS, MAX_SERIES = 5000, 2000
# Variables and their dimensions: wavelength and series.
_SHAPES = {
    "wavelength": "w", "reflectance": "ws", "std_reflectance": "ws", "u_rel_random_reflectance": "ws",
    "u_rel_systematic_reflectance": "ws", "err_corr_systematic_reflectance": "ww", "viewing_zenith_angle": "s",
    "viewing_azimuth_angle": "s", "quality_flag": "s", "n_valid_scans": "s",
}  # fmt: skip


def is_hypernets(raw: bytes) -> bool:
    """Whether the content is of the network: HDF5 that names its processor."""
    return raw.startswith(HDF5_MARK) and b"hypernets_processor" in raw


def hypernets_records(path: Path) -> list[Record]:
    """The series of an L2A file as spectra, named by number and direction of view; flagged ones say so.

    Raises
    ------
    InputError : not an L2A file of the network, or values that cannot be.
    """
    values = _variables(path)
    nm, rho, matrix = values["wavelength"], values["reflectance"].T, values["err_corr_systematic_reflectance"]
    disorder = nm.size < 2 or np.any(np.diff(nm) <= 0) or not (nm[0] > 200.0 and nm[-1] < 3000.0)
    refuse(disorder, "wavelengths do not increase within 200 to 3000 nm", path)
    beyond = not np.all(np.abs(matrix) <= 1.0 + 1e-6) or np.any(np.abs(np.diag(matrix) - 1.0) > 0.01)
    refuse(beyond, "a correlation beyond -1 to 1, or other than 1 with itself", path)
    random, systematic = (0.01 * values[f"u_rel_{kind}_reflectance"].T for kind in ("random", "systematic"))
    refuse(np.any(random < 0.0) or np.any(systematic < 0.0), "uncertainties below 0", path)
    flags, scans = (np.nan_to_num(values[name]).astype(np.int64) for name in ("quality_flag", "n_valid_scans"))
    views = zip(values["viewing_zenith_angle"], values["viewing_azimuth_angle"], strict=True)
    correlation, records = _without_rounding(matrix), []
    for i, (zenith, azimuth) in enumerate(views):
        name = f"series {i + 1}: zenith {zenith:.0f} azimuth {azimuth:.0f}"
        size, spread = np.abs(rho[i]), values["std_reflectance"][:, i]
        notes = (f"quality flags {flags[i]:#x}",) if flags[i] else ()
        record = Record(name, nm, rho[i], spread, int(scans[i]) or None, str(path), notes=notes)
        errors = SpectrumErrors(random[i] * size, systematic[i] * size, correlation)
        records.append(replace(record, errors=errors, wavelength_unit="nm", unit="fraction"))
    return records


def _variables(path: Path) -> dict[str, Array]:
    """The variables of a HYPERNETS file that spectra are made of, each of its size."""
    import xarray as xr

    check_hdf5(path)
    expected = "a HYPERNETS file of level L2A"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the dimension that stands twice
            with xr.open_dataset(path, engine="h5netcdf") as data:
                lacking = next((name for name in _SHAPES if name not in data.variables), "")
                refuse(lacking, f"holds no {lacking}", path, expected)
                sizes = {"w": data["wavelength"].size, "s": data["quality_flag"].size}
                many = sizes["w"] > MAX_WAVELENGTHS or sizes["s"] > MAX_SERIES
                refuse(many, "too many wavelengths or series", path, "one sequence")
                values = {name: np.asarray(data[name].values, dtype=float) for name in _SHAPES}
    except HypervalError:
        raise
    except Exception as error:  # whatever a damaged file makes of the libraries
        raise InputError(f"cannot be read: {error}", where=str(path), expected=expected) from error
    for name, axes in _SHAPES.items():
        shape = tuple(sizes[axis] for axis in axes)
        refuse(values[name].shape != shape, f"{name} has shape {values[name].shape}", path, str(shape))
    return values


def _without_rounding(stored: Array) -> Array:
    """A correlation (W, W) without the negative eigenvalues of its rounding, the diagonal 1."""
    values, vectors = np.linalg.eigh(0.5 * (stored + stored.T))
    made = (vectors * np.clip(values, 0.0, None)) @ vectors.T
    scale = np.sqrt(np.diag(made))
    made /= np.outer(scale, scale)
    made.setflags(write=False)
    return np.asarray(made)


NO_VALUE = 9996.0  # and above, up to 9999: night, bad weather, outside the instrument's range, other causes
STATE = {
    "P": "pressure_hpa", "T": "temperature_k", "WV": "water_vapour_g_cm2", "O3": "ozone_dobson",
    "AOD": "aot550", "Ang": "angstrom_exponent",
}  # fmt: skip
SURFACE, TOP = "reflectance", "top-of-atmosphere reflectance"
_KINDS = {".input": SURFACE, ".output": TOP}
_DOBSON_PER_ATM_CM = 1000.0
# First words of the lines, but for those of the spectra, behind the types and at the end.
_KEYS = ("Site", "Lat", "Lon", "Alt", "Year", "DOY(U)", "UTC", "DOY(L)", "Local", *STATE, "Type", *STATE)


@dataclass(frozen=True, eq=False)
class RadCalNetDay:
    """One daily file; arrays are NaN where the file holds no value.

    Attributes
    ----------
    site, latitude_deg, longitude_deg, altitude_m : of the heading
    quantity : "reflectance" of the surface, or "top-of-atmosphere reflectance"
    times : (T,) UTC
    state, state_uncertainty : name of ``STATE`` -> (T,) pressure [hPa], temperature [K], water vapour [g cm-2],
        ozone [Dobson], aerosol optical depth at 550 nm, Angstrom exponent, and their standard uncertainties
    wavelength_nm : (W,)
    values, uncertainty : (T, W) reflectance and its standard uncertainty [1]
    source : the file
    """

    site: str
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    quantity: str
    times: tuple[datetime, ...]
    state: Mapping[str, Array]
    state_uncertainty: Mapping[str, Array]
    wavelength_nm: Array
    values: Array
    uncertainty: Array
    source: str

    @property
    def labels(self) -> tuple[str, ...]:
        """(T,) the time of each column, such as 04:00."""
        return tuple(f"{t:%H:%M}" for t in self.times)

    @property
    def valid(self) -> tuple[str, ...]:
        """Labels of the half hours with a spectrum and the whole state."""
        whole = np.isfinite(np.stack(list(self.state.values()))).all(axis=0)
        whole &= np.isfinite(self.values).sum(axis=1) >= 2
        return tuple(label for label, good in zip(self.labels, whole, strict=True) if good)

    def column(self, label: str) -> int:
        """Number of a half hour by its label; raises UsageError where it holds no value."""
        what = f"the half hour {label} {'holds no value' if label in self.labels else 'is none of the file'}"
        refuse(label not in self.valid, what, self.source, ", ".join(self.valid), kind=UsageError)
        return self.labels.index(label)

    def at(self, label: str) -> dict[str, float]:
        """State of a half hour and its standard uncertainties, names with ``u_`` before them; ozone in atm cm."""
        i = self.column(label)
        numbers = {name: float(values[i]) for name, values in self.state.items()}
        numbers |= {f"u_{name}": float(values[i]) for name, values in self.state_uncertainty.items()}
        for name in ("ozone", "u_ozone"):
            numbers[f"{name}_atm_cm"] = numbers.pop(f"{name}_dobson") / _DOBSON_PER_ATM_CM
        return numbers


@reader
def read_radcalnet(path: Path | str) -> RadCalNetDay:
    """Read a daily file.

    Raises
    ------
    InputError : missing, too large, not of this form, or values that cannot be.
    UsageError : a name that ends in neither .input nor .output.
    """
    path = checked_file(path, what="daily file of RadCalNet", most=MAX_BYTES)
    return day_of(path.read_text("utf-8", errors="replace"), path)


def is_radcalnet(head: bytes) -> bool:
    """Whether a file begins as the network's do."""
    return head.startswith(b"Site:") and b"\nLat:" in head.replace(b"\r", b"")


def radcalnet_records(text: str, path: Path) -> list[Record]:
    """The valid half hours of a file as spectra, named by their time; the spread is the standard uncertainty."""
    day = day_of(text, path)
    kind, records = "" if day.quantity == SURFACE else day.quantity, []
    for label in day.valid:
        values, uncertainty = day.values[i := day.column(label)], day.uncertainty[i]
        record = Record(label, day.wavelength_nm, values, uncertainty, source=str(path), quantity=kind)
        records.append(replace(record, wavelength_unit="nm", unit="fraction"))
    return records


def day_of(text: str, path: Path) -> RadCalNetDay:
    """A daily file from its text; errors as for :func:`read_radcalnet`."""
    quantity = _KINDS.get(path.suffix.lower(), "")
    what = "the text of RadCalNet's files does not say whether the surface or the top of the atmosphere is meant"
    expected = "a name that ends in .input (surface) or .output (top of the atmosphere)"
    refuse(not quantity, what, path, expected, kind=UsageError)
    lines = [(f"{path}:{i}", line.split("\t")) for i, line in enumerate(text.splitlines(), start=1) if line.strip()]
    rows = [_Row(where, words[0].strip(), [w.strip() for w in words[1:] if w.strip()]) for where, words in lines]
    keyed = [row for row in rows if row.key.endswith(":")][: len(_KEYS)]
    end = _Row(rows[-1].where if rows else str(path), "the end of the file", [])
    for key, row in zip(_KEYS, [*keyed, *[end] * len(_KEYS)], strict=False):
        refuse(row.key != f"{key}:", f"{row.key[:40]!r} where {key!r} belongs", row.where, f"{key}: and values")
    site, *place, year, days, clock = keyed[:7]
    count = len(year.words)
    latitude, longitude, altitude = (float(row.numbers(1)[0]) for row in place)
    times = tuple(map(clock.time, year.numbers(count), days.numbers(count), clock.cells(count)))
    disorder = any(b <= a for a, b in pairwise(times))
    refuse(disorder, "the half hours do not follow each other", clock.where, "increasing UTC")
    # The state and the spectra, and after them the uncertainties of all of it.
    half = rows.index(keyed[-len(STATE)])
    (nm, values), (u_nm, uncertainty) = (_spectra(part, count, str(path)) for part in (rows[:half], rows[half:]))
    state, doubt = (
        {name: row.numbers(count) for name, row in zip(STATE.values(), keyed[at:], strict=False)}
        for at in (_KEYS.index("P"), -len(STATE))
    )
    refuse(not np.array_equal(nm, u_nm), "uncertainties at other wavelengths than the values", path)
    negative = any(np.nanmin(u, initial=0.0) < 0 for u in (uncertainty, *doubt.values()))
    refuse(negative, "uncertainties below 0", path)
    wrong = np.isfinite(values) & ~((values > -0.1) & (values < 2.0))
    what = f"{wrong.sum()} values such as {values[wrong][:1]} are neither a reflectance nor a mark"
    refuse(wrong.any(), what, path, f"a fraction, or {NO_VALUE:g} to 9999 where there is none")
    return RadCalNetDay(
        site.cells(1)[0], latitude, longitude, altitude, quantity, times, state, doubt, nm, values, uncertainty,
        str(path),
    )  # fmt: skip


class _Row(NamedTuple):
    """A line of a file: where it stands, its first word and the others."""

    where: str
    key: str
    words: list[str]

    def cells(self, count: int) -> list[str]:
        """The words behind the key, as many as there have to be."""
        what = f"{len(self.words)} values" + (f" of {self.key[:-1]}" if self.key.endswith(":") else "")
        refuse(len(self.words) != count or not count, what, self.where, f"{count or 1} values, one a half hour")
        return self.words

    def numbers(self, count: int) -> Array:
        """The same as numbers, NaN where there is no value."""
        try:
            values = np.array([float(w) for w in self.cells(count)])
        except ValueError as error:
            expected = "numbers separated by tabulators"
            raise InputError("not a row of numbers", where=self.where, expected=expected) from error
        expected = f"{NO_VALUE:g} to 9999 where there is none"
        refuse(not np.all(np.isfinite(values)), "a number is missing", self.where, expected)
        return np.where(values >= NO_VALUE, np.nan, values)

    def time(self, year: float, day: float, clock: str) -> datetime:
        """Year, day of the year and time of the day as one."""
        try:
            start = datetime.strptime(f"{int(year):04d} {clock}", "%Y %H:%M").replace(tzinfo=UTC)
        except ValueError as error:
            raise InputError(f"not a time: {clock!r}", where=self.where, expected="UTC as HH:MM") from error
        refuse(not 1 <= day <= 366, f"day {day:g} of the year", self.where, "1 to 366")
        return start + timedelta(days=int(day) - 1)


def _spectra(rows: list[_Row], count: int, path: str) -> tuple[Array, Array]:
    """(W,) wavelengths and (count, W) values of the lines that begin with a number."""
    numbers = [row for row in rows if not row.key.endswith(":")]
    values = np.array([row.numbers(count) for row in numbers]).reshape(-1, count)
    nm = np.array([_Row(row.where, "", [row.key]).numbers(1)[0] for row in numbers])
    disorder = nm.size < 2 or np.any(np.diff(nm) <= 0) or not (nm[0] > 300 and nm[-1] < 3000)
    refuse(disorder, "no increasing wavelengths in nm", path, "400 to 2500 nm")
    return nm, values.T
