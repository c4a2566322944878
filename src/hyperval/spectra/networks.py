"""Ground networks: the days of RadCalNet sites, and surface reflectance of HYPERNETS (L2A).

A RadCalNet file is tab-separated text: the site, one column a half hour, the state of the air, reflectance every 10 nm,
and after an empty line the standard uncertainties of all of it in the same columns.  ``.input`` holds what was measured
on the ground, ``.output`` what the network computed for the top of the atmosphere, seen from nadir; the text of the two
does not tell them apart, but that the latter may list the place of the sun.  9996 and above: no value.  In strong
absorption bands later versions add 9 to the uncertainty: the network does not vouch for it, nor is the value taken.

HYPERNETS files are NetCDF-4 with the conventions of CoMet: a sequence of views, relative uncertainties in percent, one
random, one systematic with a matrix of its correlation between wavelengths (in which a dimension stands twice).  The
matrix is stored to two decimals and so has small negative eigenvalues; these are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hyperval.data import Array
from hyperval.errors import package_table, reader, refusal, refuse
from hyperval.hdf5 import opened_netcdf
from hyperval.paths import checked_file, read_text
from hyperval.spectra.record import MAX_BYTES, FieldSpectrum, SpectraFile, SpectrumErrors
from hyperval.storage import number_of

_MOST = {"wavelength": 5000, "series": 2000}
_UNITS: dict[str, Any] = {"wavelength_unit": "nm", "unit": "fraction"}
_WORDS = package_table("spectra/words.yaml")
_AXES: dict[str, str] = _WORDS["hypernets_axes"]


def hypernets_records(file: SpectraFile) -> list[FieldSpectrum]:
    """The series of an L2A file as spectra, named by number and direction of view; flagged ones say so.

    Raises
    ------
    InputError : not an L2A file of the network, or values that cannot be.
    """
    path = file.path
    with opened_netcdf(path, "HYPERNETS file of level L2A", _AXES, _MOST) as data:
        values = {name: np.asarray(data[name].values, dtype=float) for name in _AXES}
    nm, rho, matrix = values["wavelength"], values["reflectance"].T, values["err_corr_systematic_reflectance"]
    disorder = nm.size < 2 or np.any(np.diff(nm) <= 0) or not (nm[0] > 200.0 and nm[-1] < 3000.0)
    refuse(disorder, "hypernets.wavelengths", path)
    implausible = not np.all(np.abs(matrix) <= 1.0 + 1e-6) or np.any(np.abs(np.diag(matrix) - 1.0) > 0.01)
    refuse(implausible, "hypernets.correlation", path)
    random, systematic = (0.01 * values[f"u_rel_{kind}_reflectance"].T for kind in ("random", "systematic"))
    refuse(np.any(random < 0.0) or np.any(systematic < 0.0), "network.negative", path)
    flags, scans = (np.nan_to_num(values[name]).astype(np.int64) for name in ("quality_flag", "n_valid_scans"))
    directions = zip(values["viewing_zenith_angle"], values["viewing_azimuth_angle"], strict=True)
    correlation, records = _without_rounding(matrix), []
    for i, (zenith, azimuth) in enumerate(directions):
        name = f"series {i + 1}: zenith {zenith:.0f} azimuth {azimuth:.0f}"
        size, spread = np.abs(rho[i]), values["std_reflectance"][:, i]
        notes = (f"quality flags {flags[i]:#x}",) if flags[i] else ()
        more = {"errors": SpectrumErrors(random[i] * size, systematic[i] * size, correlation), "notes": notes, **_UNITS}
        records.append(FieldSpectrum(name, nm, rho[i], spread, int(scans[i]) or None, **more))
    return records


def _without_rounding(stored: Array) -> Array:
    """A correlation (W, W) without the negative eigenvalues of its rounding, the diagonal 1."""
    values, vectors = np.linalg.eigh(0.5 * (stored + stored.T))
    made = (vectors * np.clip(values, 0.0, None)) @ vectors.T
    scale = np.sqrt(np.diag(made))
    made /= np.outer(scale, scale)
    made.setflags(write=False)
    return np.asarray(made)


NO_VALUE = 9996.0  # and above, up to 9999: night, bad weather, outside the instrument's range, other causes
MARKED = 9.0  # of an uncertainty: more than any is
STATE: dict[str, str] = _WORDS["radcalnet_state"]
SURFACE, TOP = "reflectance", "top-of-atmosphere reflectance"
_IN_FILE = {"O3": 1000.0}  # Dobson units in an atm cm
# First words of the lines that are read, but for those of the spectra.
_PLACE, _TIME = ("Lat", "Lon", "Alt"), ("Year", "DOY(U)", "UTC")


@dataclass(frozen=True, eq=False)
class RadCalNetDay:
    """One daily file; arrays are NaN where the file holds no value.

    Attributes
    ----------
    site, latitude_deg, longitude_deg, altitude_m : of the heading
    quantity : "reflectance" of the surface, or "top-of-atmosphere reflectance"
    times : (T,) UTC
    state : name of ``STATE`` -> (T,) pressure [hPa], temperature [K], water vapour [g cm-2], ozone [atm cm], aerosol
        optical depth at 550 nm, Angstrom exponent; names with ``u_`` before them: their standard uncertainties
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
        whole = np.isfinite([self.state[name] for name in STATE.values()]).all(axis=0)
        whole &= np.isfinite(self.values).sum(axis=1) >= 2
        return tuple(label for label, good in zip(self.labels, whole, strict=True) if good)

    def column(self, label: str) -> int:
        """Number of a half hour by its label; raises UsageError where it holds no value."""
        what = "holds no value" if label in self.labels else "is none of the file"
        unknown, labels = label not in self.valid, ", ".join(self.valid)
        refuse(unknown, "radcalnet.half_hour", self.source, label=label, told=what, known=labels)
        return self.labels.index(label)

    def at(self, label: str) -> dict[str, float]:
        """State of a half hour and its standard uncertainties, names with ``u_`` before them."""
        i = self.column(label)
        return {name: float(values[i]) for name, values in self.state.items()}


@reader
def read_radcalnet(path: Path | str) -> RadCalNetDay:
    """Read a daily file.

    Raises
    ------
    InputError : missing, too large, not of this form, or values that cannot be.
    UsageError : neither the name, by .input or .output, nor the content says what was measured.
    """
    path = checked_file(path, what="daily file of RadCalNet", most=MAX_BYTES)
    return day_of(read_text(path), path)


def radcalnet_records(file: SpectraFile) -> list[FieldSpectrum]:
    """The valid half hours of a file as spectra, named by their time; the spread is the standard uncertainty."""
    day = day_of(file.text, file.path)
    kind, records = "" if day.quantity == SURFACE else day.quantity, []
    for label in day.valid:
        values, uncertainty = day.values[i := day.column(label)], day.uncertainty[i]
        records.append(FieldSpectrum(label, day.wavelength_nm, values, uncertainty, quantity=kind, **_UNITS))
    return records


def day_of(text: str, path: Path) -> RadCalNetDay:
    """A daily file from its text; errors as for :func:`read_radcalnet`."""
    parts: list[dict[str, _Row]] = [{}]
    for number, line in enumerate(text.splitlines(), start=1):
        key, *words = (word.strip() for word in line.split("\t"))
        if key in parts[-1]:  # state and spectra once more: the uncertainties of all of it
            parts.append({})
        if key:
            parts[-1][key] = _Row(f"{path}:{number}", key, [word for word in words if word])
    quantity = SURFACE if path.suffix.lower() == ".input" else TOP
    is_known = quantity == SURFACE or path.suffix.lower() == ".output" or {"Zen:", "Azi:"} <= parts[0].keys()
    refuse(not is_known, "radcalnet.quantity", path)
    refuse(len(parts) != 2, "radcalnet.parts", path, count=len(parts))
    first, second = parts
    for part, keys in ((first, ("Site", *_PLACE, *_TIME, *STATE)), (second, STATE)):
        lacking = next((key for key in keys if f"{key}:" not in part), "")
        refuse(lacking, "radcalnet.lacking", path, key=lacking)
    year, days, clock = (first[f"{key}:"] for key in _TIME)
    count = len(year.words)
    latitude, longitude, altitude = (float(first[f"{key}:"].numbers(1)[0]) for key in _PLACE)
    times = tuple(map(clock.time, year.numbers(count), days.numbers(count), clock.cells(count)))
    refuse(any(b <= a for a, b in pairwise(times)), "radcalnet.disorder", clock.where)
    (nm, values), (u_nm, uncertainty) = (_spectra(part, count, str(path)) for part in parts)
    state, doubt = (
        {name: part[f"{key}:"].numbers(count) / _IN_FILE.get(key, 1.0) for key, name in STATE.items()} for part in parts
    )
    refuse(not np.array_equal(nm, u_nm), "radcalnet.unlike", path)
    values, uncertainty = (np.where(uncertainty >= MARKED, np.nan, x) for x in (values, uncertainty))
    refuse(any(np.nanmin(u, initial=0.0) < 0 for u in (uncertainty, *doubt.values())), "network.negative", path)
    wrong = np.isfinite(values) & ~((values > -0.1) & (values < 2.0))
    refuse(wrong.any(), "radcalnet.values", path, count=wrong.sum(), some=values[wrong][:1], least=NO_VALUE)
    (site,) = first["Site:"].cells(1)
    place = (site, latitude, longitude, altitude)
    state |= {f"u_{name}": u for name, u in doubt.items()}
    return RadCalNetDay(*place, quantity, times, state, nm, values, uncertainty, str(path))


class _Row(NamedTuple):
    """A line of a file: where it stands, its first word and the others."""

    where: str
    key: str
    words: list[str]

    def cells(self, count: int) -> list[str]:
        """The words behind the key, as many as there have to be."""
        found, wanted = len(self.words), count or 1
        refuse(found != wanted, "radcalnet.count", self.where, found=found, key=self.key, wanted=wanted)
        return self.words

    def numbers(self, count: int) -> Array:
        """The same as numbers, NaN where there is no value."""
        values = np.array([number_of(cell) for cell in self.cells(count)])
        refuse(not np.all(np.isfinite(values)), "radcalnet.numbers", self.where, least=NO_VALUE)
        return np.where(values >= NO_VALUE, np.nan, values)

    def time(self, year: float, day: float, clock: str) -> datetime:
        """Year, day of the year and time of the day as one."""
        try:
            return datetime.strptime(f"{int(year):04d} {int(day):03d} {clock}", "%Y %j %H:%M").replace(tzinfo=UTC)
        except ValueError as error:
            raise refusal("radcalnet.time", self.where, day=day, clock=clock) from error


def _spectra(part: Mapping[str, _Row], count: int, path: str) -> tuple[Array, Array]:
    """(W,) wavelengths and (count, W) values of the lines that begin with a number."""
    rows = [row for key, row in part.items() if not key.endswith(":")]
    values = np.array([row.numbers(count) for row in rows]).reshape(-1, count)
    nm = np.array([_Row(row.where, "", [row.key]).numbers(1)[0] for row in rows])
    disorder = nm.size < 2 or np.any(np.diff(nm) <= 0) or not (nm[0] > 300 and nm[-1] < 3000)
    refuse(disorder, "radcalnet.wavelengths", path)
    return nm, values.T
