"""Surface reflectance of HYPERNETS (L2A): a sequence of views, its errors by kind with their correlation.

The network's files are NetCDF-4 with the conventions of CoMet: relative uncertainties in percent, one random, one
systematic with a matrix of its correlation between wavelengths (in which a dimension stands twice).  The matrix is
stored to two decimals, and so has small negative eigenvalues; these are left out.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError, UsageError, reader
from hyperval.hdf5 import check_hdf5
from hyperval.paths import checked_file
from hyperval.spectra.readers_record import MAX_BYTES, Record, SpectrumErrors

Array = npt.NDArray[np.float64]

HDF5_MARK = b"\x89HDF\r\n\x1a\n"
MAX_WAVELENGTHS, MAX_SERIES = 5000, 2000
_NAMES = (
    "wavelength", "reflectance", "std_reflectance", "u_rel_random_reflectance", "u_rel_systematic_reflectance",
    "err_corr_systematic_reflectance", "viewing_zenith_angle", "viewing_azimuth_angle", "solar_zenith_angle",
    "solar_azimuth_angle", "acquisition_time", "quality_flag", "n_valid_scans",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class HypernetsSequence:
    """One sequence.

    Attributes
    ----------
    site, latitude_deg, longitude_deg : where
    wavelength_nm : (W,)
    reflectance : (S, W) hemispherical-conical, by series [1]
    scan_deviation : (S, W) standard deviation between the scans of a series [1]
    random, systematic : (S, W) standard uncertainties [1]
    stored_correlation : (W, W) of the systematic errors between wavelengths, as it stands in the file
    view_zenith_deg, view_azimuth_deg, solar_zenith_deg, solar_azimuth_deg : (S,) azimuths east of north
    times : (S,) UTC
    flags : (S,) quality flags, 0 where nothing is amiss
    scans : (S,) valid scans behind each
    """

    site: str
    latitude_deg: float
    longitude_deg: float
    wavelength_nm: Array
    reflectance: Array
    scan_deviation: Array
    random: Array
    systematic: Array
    stored_correlation: Array
    view_zenith_deg: Array
    view_azimuth_deg: Array
    solar_zenith_deg: Array
    solar_azimuth_deg: Array
    times: tuple[datetime, ...]
    flags: npt.NDArray[np.int64]
    scans: npt.NDArray[np.int64]
    source: str

    @property
    def names(self) -> tuple[str, ...]:
        """(S,) names of the series: number and direction of view."""
        pairs = zip(self.view_zenith_deg, self.view_azimuth_deg, strict=True)
        return tuple(f"series {i}: zenith {z:.0f} azimuth {a:.0f}" for i, (z, a) in enumerate(pairs, start=1))

    @cached_property
    def correlation(self) -> Array:
        """(W, W) the stored correlation without the negative eigenvalues of its rounding, the diagonal 1."""
        values, vectors = np.linalg.eigh(0.5 * (self.stored_correlation + self.stored_correlation.T))
        made = (vectors * np.clip(values, 0.0, None)) @ vectors.T
        scale = np.sqrt(np.diag(made))
        made /= np.outer(scale, scale)
        made.setflags(write=False)
        return np.asarray(made)

    def errors(self, series: int) -> SpectrumErrors:
        """Errors of one series by kind; ``series`` counts from 0."""
        return SpectrumErrors(self.random[series], self.systematic[series], self.correlation)


def is_hypernets(raw: bytes) -> bool:
    """Whether the content is of the network: HDF5 that names its processor."""
    return raw.startswith(HDF5_MARK) and b"hypernets_processor" in raw


def hypernets_records(path: Path) -> list[Record]:
    """The series as spectra, named by number and direction of view, with their errors; flagged ones say so."""
    sequence = read_hypernets(path)
    return [
        Record(
            name, sequence.wavelength_nm, sequence.reflectance[i], str(path), sequence.scan_deviation[i],
            int(sequence.scans[i]) or None, "nm", "fraction", None,
            (f"quality flags {sequence.flags[i]:#x}",) if sequence.flags[i] else (), errors=sequence.errors(i),
        )
        for i, name in enumerate(sequence.names)
    ]  # fmt: skip


@reader
def read_hypernets(path: Path | str) -> HypernetsSequence:
    """Read an L2A file.

    Raises
    ------
    InputError : missing, too large, not an L2A file of the network, or values that cannot be.
    """
    import xarray as xr

    path = checked_file(path, what="HYPERNETS file", most=MAX_BYTES)
    check_hdf5(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the dimension that stands twice
            with xr.open_dataset(path, engine="h5netcdf") as data:
                lacking = [name for name in _NAMES if name not in data.variables]
                if lacking:
                    raise InputError(
                        f"holds no {lacking[0]}", where=str(path), expected="a HYPERNETS file of level L2A"
                    )
                count = {name: data[name].size for name in ("wavelength", "acquisition_time")}
                if count["wavelength"] > MAX_WAVELENGTHS or count["acquisition_time"] > MAX_SERIES:
                    raise InputError("too many wavelengths or series", where=str(path), expected="one sequence")
                values = {name: np.asarray(data[name].values, dtype=float) for name in _NAMES}
                about = {k: data.attrs.get(k) for k in ("site_id", "site_latitude", "site_longitude")}
    except (InputError, UsageError):
        raise
    except Exception as error:  # whatever a damaged file makes of the libraries
        raise InputError(
            f"cannot be read: {error}", where=str(path), expected="a HYPERNETS file of level L2A"
        ) from error
    return _checked(values, about, str(path))


def _checked(values: dict[str, Array], about: dict[str, object], where: str) -> HypernetsSequence:
    nm, rho = values["wavelength"], values["reflectance"].T
    size = nm.size
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(_NAMES[1:5], (size, rho.shape[0]))
    shapes |= dict.fromkeys(_NAMES[6:], (rho.shape[0],)) | {"err_corr_systematic_reflectance": (size, size)}
    for name, shape in shapes.items():
        if values[name].shape != shape:
            raise InputError(f"{name} has shape {values[name].shape}", where=where, expected=str(shape))
    if size < 2 or np.any(np.diff(nm) <= 0) or not (nm[0] > 200.0 and nm[-1] < 3000.0):
        raise InputError("wavelengths do not increase within 200 to 3000 nm", where=where)
    matrix = values["err_corr_systematic_reflectance"]
    if not np.all(np.abs(matrix) <= 1.0 + 1e-6) or np.any(np.abs(np.diag(matrix) - 1.0) > 0.01):
        raise InputError("a correlation beyond -1 to 1, or other than 1 with itself", where=where)
    relative = {kind: 0.01 * values[f"u_rel_{kind}_reflectance"].T for kind in ("random", "systematic")}
    if any(np.any(u < 0.0) for u in relative.values()):
        raise InputError("uncertainties below 0", where=where)
    flags, scans = (np.nan_to_num(values[name]).astype(np.int64) for name in ("quality_flag", "n_valid_scans"))
    try:
        latitude, longitude = float(str(about["site_latitude"])), float(str(about["site_longitude"]))
        times = tuple(datetime.fromtimestamp(t, UTC) for t in values["acquisition_time"])
    except (ValueError, OverflowError, OSError) as error:
        raise InputError(f"place or time is missing: {error}", where=where, expected="a whole L2A file") from error
    random, systematic = (relative[kind] * np.abs(rho) for kind in ("random", "systematic"))
    return HypernetsSequence(
        str(about["site_id"]), latitude, longitude, nm, rho, values["std_reflectance"].T, random, systematic,
        matrix, values["viewing_zenith_angle"], values["viewing_azimuth_angle"], values["solar_zenith_angle"],
        values["solar_azimuth_angle"], times, flags, scans, where,
    )  # fmt: skip
