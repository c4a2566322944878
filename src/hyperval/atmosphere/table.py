"""Terms from a table computed before: interpolated over the state, with an estimate of the error.

A table holds what does not depend on the strength of the sun, at the resolution of its engine; F = mu0 E0 / pi:

    path = L_a / F, direct = A / F, adjacency = B / F, S, ground = E_ground / (pi F), gas: two-way
    transmittance, and diffuse: the sky's part of E_ground, where the engine tells it

Interpolated are these products, before any band is averaged.  The rules (:mod:`hyperval.atmosphere.terms`):
aerosol by :mod:`hyperval.atmosphere.table` (a range as depth); altitudes by monotone cubic; angles by cubic
spline; water logarithms of the transmittances, linear in the square root of the column; ozone likewise, linear in
the column.

In files a table is NetCDF, or a folder of MODTRAN channel files named after their state; from the embedded engine it
is computed over a grid of states.

Terms of a table between two amounts of aerosol.

What the haze does goes along two optical depths: the sun comes through all of it, tau, the view passes what lies
below the sensor, d.  The rule of MODTRAN's profile (:mod:`hyperval.atmosphere.state`) ties d to tau, and not
as a straight line: under an aircraft d is nearly nothing up to tau = 0.05 and grows with tau above it.  So

    ground G             straight in ln G over tau        (Beer's law for the way of the sun)
    direct A             straight in ln(A/G) over d       (Beer's law for the view)
    both, A + B          straight in (A + B)/G over d     (scattering moves light from A to B, loses little)
    path                 straight over d                  (single scattering; its limit is the Rayleigh path)
    S, gas, diffuse      straight over tau

At a sensor above the atmosphere d is tau.  What was measured with the embedded engine:
validation/atmosphere/README.md.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import product
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import solar
from hyperval.atmosphere.cache import cache_folder
from hyperval.atmosphere.modtran import (
    read_channels,
    read_chn,
    read_modtran_json,
    stated_albedo,
    stated_fields,
    terms_from_runs,
)
from hyperval.atmosphere.sixs import sixs_terms
from hyperval.atmosphere.state import (
    OZONE_G_CM2_PER_ATM_CM,
    SPACE_KM,
    AtmosphericState,
    aot550_from_range,
    column_g_cm2,
    fraction_below,
    standard_profile,
)
from hyperval.atmosphere.terms import AS_THEY_ARE, AtmosphericTerms, Rule, along, inside
from hyperval.errors import InputError, UsageError, reader
from hyperval.hdf5 import check_hdf5
from hyperval.progress import track
from hyperval.storage import sha256_of, whole_file
from hyperval.units import PLAUSIBLE_NM

if TYPE_CHECKING:
    import xarray as xr

Array = npt.NDArray[np.float64]

_LEAST_TERM = 1e-12  # of a term of which a logarithm or a ratio is taken [1]
# rms error of the path [1] halfway between two nodes a factor of four apart; it grows with the logarithm of it.
PATH_ERROR, AT_RATIO = 0.02, 4.0


def depth_below(aot550: npt.ArrayLike, ground_km: float, sensor_km: float) -> Array:
    """Aerosol optical depth at 550 nm between ground and sensor, for depths of the whole atmosphere (k,)."""
    depths = np.asarray(aot550, dtype=float)
    shares = [fraction_below(float(t), ground_km, min(sensor_km, 100.0)) if t > 0 else 0.0 for t in depths.ravel()]
    return np.asarray(depths * np.reshape(shares, depths.shape))


def between_aerosols(
    nodes: Array, values: Mapping[str, Array], aot550: float, ground_km: float, sensor_km: float
) -> dict[str, Array]:
    """All quantities of a table (k, ...) at one aerosol depth between its nodes (k,), by the rules above.

    Where there is no light at the ground, direct and adjacency are straight over tau.
    """
    i = int(np.clip(np.searchsorted(nodes, aot550) - 1, 0, nodes.size - 2))
    tau = nodes[i : i + 2]
    below = depth_below([tau[0], aot550, tau[1]], ground_km, sensor_km)
    v = float((aot550 - tau[0]) / (tau[1] - tau[0]))
    w = float((below[1] - below[0]) / (below[2] - below[0])) if below[2] > below[0] else v
    low, high = ({name: array[i + k] for name, array in values.items()} for k in (0, 1))
    between = {name: _straight(low[name], high[name], v) for name in values}
    between["path"] = _straight(low["path"], high["path"], w)
    lit = (low["ground"] > _LEAST_TERM) & (high["ground"] > _LEAST_TERM)
    lit &= (low["direct"] > _LEAST_TERM) & (high["direct"] > _LEAST_TERM)
    g = [np.where(lit, part["ground"], 1.0) for part in (low, high)]
    a = [np.where(lit, part["direct"], 1.0) / x for part, x in zip((low, high), g, strict=True)]
    both = [(p["direct"] + p["adjacency"]) / x for p, x in zip((low, high), g, strict=True)]
    ground = np.exp(_straight(np.log(g[0]), np.log(g[1]), v))
    direct = ground * np.exp(_straight(np.log(a[0]), np.log(a[1]), w))
    adjacency = np.maximum(ground * _straight(both[0], both[1], w) - direct, 0.0)
    for name, value in (("ground", ground), ("direct", direct), ("adjacency", adjacency)):
        between[name] = np.where(lit, value, between[name])
    return between


def path_error(nodes: Array, aot550: float, ground_km: float, sensor_km: float) -> float:
    """Relative standard uncertainty of the path by this interpolation [1]; 0 at a node.

    2 sqrt(w (1 - w)) PATH_ERROR ln r / ln 4 with w the place between the nodes over d and r the ratio of their
    depths: shape and size were fitted to what the embedded engine shows between its nodes
    (validation/atmosphere/README.md).
    """
    i = int(np.clip(np.searchsorted(nodes, aot550) - 1, 0, nodes.size - 2))
    low, here, high = depth_below([nodes[i], aot550, nodes[i + 1]], ground_km, sensor_km)
    if not high > low:
        return 0.0
    w = float(np.clip((here - low) / (high - low), 0.0, 1.0))
    ratio = float(nodes[i + 1] / max(nodes[i], 0.01))  # less haze than 0.01 is none
    return float(2.0 * np.sqrt(w * (1.0 - w)) * PATH_ERROR * np.log(ratio) / np.log(AT_RATIO))


def _straight(a: Array, b: Array, w: float) -> Array:
    return np.asarray(a + w * (b - a))


QUANTITIES = ("path", "direct", "adjacency", "spherical_albedo", "ground", "gas")
OPTIONAL = ("diffuse",)
AEROSOL_RULE = None  # all quantities together
_MONOTONE, _CUBIC, _STRAIGHT = Rule("monotone"), Rule("cubic"), Rule("linear")
# Rule of each axis, and by how much a state may miss a value that the table holds only once.
AXES: dict[str, tuple[Rule | None, float]] = {
    "aot550": (AEROSOL_RULE, 1e-3),
    "water_vapour_g_cm2": (Rule("linear", np.sqrt, np.square, logarithm=True), 5e-3),
    "ozone_atm_cm": (Rule("linear", logarithm=True), 2e-3),
    "ground_altitude_km": (_MONOTONE, 0.02),
    "sensor_altitude_km": (_MONOTONE, 0.02),
    "solar_zenith_deg": (_CUBIC, 0.3),
    "view_zenith_deg": (_CUBIC, 0.5),
    "relative_azimuth_deg": (_CUBIC, 5.0),
}
# Values that a table can be computed for only as a whole.
NAMED = ("model", "aerosol")
_LEAST_WIDTH_NM = 1e-3
_SUN = (1e-9, 1e3)  # [uW cm-2 nm-1] at 1 au: its lines reach 250, and 1e-7 is left at 0.1 mm
_LEAST = 1e-30  # below it a logarithm says nothing
_RHO = 0.3  # ground over which the error is stated
_LEAST_GAS = 0.1  # and the two-way gas transmittance above which


@dataclass(frozen=True)
class AtmosphericTable:
    """Atmospheric terms over a grid of states.

    Attributes
    ----------
    wavelength_nm : (n,) [nm]
    axes : name -> nodes, increasing; their order is that of the leading dimensions
    fixed : fields of the state that all nodes share
    quantities : path, direct, adjacency, spherical_albedo, ground, gas and perhaps diffuse: (*nodes, n) each [1]
    solar_irradiance : (n,) at 1 au [uW cm-2 nm-1]; None: the state chooses the solar spectrum
    fwhm_nm : (n,) widths of the channels that the values are averages over; None: samples
    source : engine and version, files
    errors : axis -> worst and rms error of the total radiance when a node is left out [1]; None: not estimated yet
    """

    wavelength_nm: Array
    axes: dict[str, Array]
    fixed: dict[str, Any]
    quantities: dict[str, Array]
    solar_irradiance: Array | None = None
    fwhm_nm: Array | None = None
    source: dict[str, Any] = field(default_factory=dict)
    errors: dict[str, dict[str, float] | None] | None = None

    def __post_init__(self) -> None:
        _check_table(self)

    def terms(self, state: AtmosphericState) -> AtmosphericTerms:
        """The terms of a state inside the table.

        Raises
        ------
        UsageError : a value outside the axes, or other than the one the table was computed for.
        """
        at = coordinates(state)
        self._check_fixed(state, at)
        values = dict(self.quantities)
        left = list(self.axes)
        # Aerosol last: its rule needs the altitudes, which may be axes themselves.
        for name in sorted(self.axes, key=lambda axis: AXES[axis][0] is AEROSOL_RULE):
            x, number = float(inside(name, self.axes[name], at[name])), left.index(name)
            values = _along(self.axes[name], {q: np.moveaxis(v, number, 0) for q, v in values.items()}, x, name, at)
            left.remove(name)
        path_relative = 0.0
        if "aot550" in self.axes:
            places = at["ground_altitude_km"], at["sensor_altitude_km"]
            path_relative = path_error(self.axes["aot550"], at["aot550"], *places)
        irradiance = self.solar_irradiance
        if irradiance is None:
            irradiance = solar.extraterrestrial_irradiance(state.solar_spectrum, self.wavelength_nm, 1.0)
        unit = np.cos(np.deg2rad(state.sun[0])) * irradiance / state.distance_au**2 / np.pi
        lines = None
        if self.solar_irradiance is None and self.fwhm_nm is None:
            lines = solar.lines_between(state.solar_spectrum, self.wavelength_nm)
        return AtmosphericTerms(
            wavelength_nm=self.wavelength_nm.copy(),
            path_radiance=unit * values["path"],
            direct=unit * values["direct"],
            adjacency=unit * values["adjacency"],
            spherical_albedo=values["spherical_albedo"],
            ground_irradiance=np.where(values["ground"] > 0.0, np.pi * unit * values["ground"], np.nan),
            gas_transmittance=values["gas"],
            provenance={
                "engine": "table",
                "source": self.source,
                "solar_spectrum": "of the table" if self.solar_irradiance is not None else state.solar_spectrum,
                "axes": {name: [float(v) for v in nodes] for name, nodes in self.axes.items()},
                "interpolation_path_relative": path_relative,
                "leave_one_out_error": self.errors if self.errors is not None else leave_one_out(self),
                "state": state.model_dump(mode="json"),
            },
            fwhm_nm=self.fwhm_nm,
            diffuse_fraction=values.get("diffuse"),
            diffuser_radiance=unit,
            solar_lines=lines,
            path_uncertainty=path_relative * unit * values["path"],
        )

    def _check_fixed(self, state: AtmosphericState, at: Mapping[str, float]) -> None:
        clear = at["aot550"] == 0.0
        for name, value in self.fixed.items():
            if name in NAMED:
                given = state.model_dump(mode="json")[name]
                wrong = given != value and not (name == "aerosol" and clear)
            elif name in AXES:
                if name == "relative_azimuth_deg" and at["view_zenith_deg"] == 0.0:
                    continue  # every azimuth is the same at nadir
                given = at[name]
                wrong = abs(float(value) - at[name]) > AXES[name][1]
            else:
                continue
            if wrong:
                what, mend = f"{name} is {given!r}, and the table was computed for {value!r}", "compute a table for it"
                raise UsageError(what, expected=f"{name}: {value!r}", mend=f"change the state, or {mend}")


def coordinates(state: AtmosphericState) -> dict[str, float]:
    """Where a state lies on every axis that a table can have."""
    profile = standard_profile(state.model)
    water, ozone = state.water_vapour_g_cm2, state.ozone_atm_cm
    if water is None:
        water = column_g_cm2(profile, profile.water_g_m3, state.ground_altitude_km)
    if ozone is None:
        ozone = column_g_cm2(profile, profile.ozone_g_m3, state.ground_altitude_km) / OZONE_G_CM2_PER_ATM_CM
    zenith, azimuth = state.sun
    return {
        "aot550": state.aerosol_optical_depth,
        "water_vapour_g_cm2": water,
        "ozone_atm_cm": ozone,
        "ground_altitude_km": state.ground_altitude_km,
        "sensor_altitude_km": min(state.sensor_altitude_km, SPACE_KM),
        "solar_zenith_deg": zenith,
        "view_zenith_deg": state.view_zenith_deg,
        "relative_azimuth_deg": abs((azimuth - state.view_azimuth_deg + 180.0) % 360.0 - 180.0),
    }


def _along(nodes: Array, values: Mapping[str, Array], x: float, axis: str, at: Mapping[str, float]) -> dict[str, Array]:
    """All quantities (k, ...) at ``x`` along their first dimension."""
    rule = AXES[axis][0]
    if rule is AEROSOL_RULE:
        return between_aerosols(nodes, values, x, at["ground_altitude_km"], at["sensor_altitude_km"])
    return {q: along(nodes, v, x, _rule_for(q, rule)) for q, v in values.items()}


def _rule_for(quantity: str, rule: Rule) -> Rule:
    """The rule of an axis; what is no transmittance is straight where those are straight in their logarithm."""
    return _STRAIGHT if rule.logarithm and quantity in AS_THEY_ARE else rule


def leave_one_out(table: AtmosphericTable) -> dict[str, dict[str, float] | None]:
    """Relative error of the total radiance over ground of 0.3 at nodes predicted from the others, axis by axis.

    Where the two-way gas transmittance is above 0.1.  Without the node the step is twice as wide, so this is an
    upper estimate: the error inside the table is about a quarter of it for a linear rule, less for a cubic.
    None for an axis of two nodes.
    """
    misses: dict[str, dict[str, float] | None] = {}
    for name, nodes in table.axes.items():
        errors = []
        quantities, axes, at = dict(table.quantities), list(table.axes), {}
        for level in ("ground_altitude_km", "sensor_altitude_km") if AXES[name][0] is AEROSOL_RULE else ():
            at[level] = table.fixed.get(level, 0.0 if level.startswith("ground") else SPACE_KM)
            if level in table.axes:  # the haze below the sensor is asked for at the middle altitude
                middle = table.axes[level].size // 2
                at[level] = float(table.axes[level][middle])
                quantities = {q: np.take(v, middle, axis=axes.index(level)) for q, v in quantities.items()}
                axes.remove(level)
        moved = {q: np.moveaxis(v, axes.index(name), 0) for q, v in quantities.items()}
        for i in range(1, nodes.size - 1):
            keep = np.delete(np.arange(nodes.size), i)
            predicted = _along(nodes[keep], {q: v[keep] for q, v in moved.items()}, float(nodes[i]), name, at)
            exact = {q: v[i] for q, v in moved.items()}
            seen = exact["gas"] > _LEAST_GAS
            errors.append((_total(predicted)[seen] / np.maximum(_total(exact)[seen], _LEAST)) - 1.0)
        if errors:
            every = np.concatenate(errors)
            misses[name] = {
                "worst": round(float(np.max(np.abs(every), initial=0.0)), 6),
                "rms": round(float(np.sqrt(np.mean(every**2))) if every.size else 0.0, 6),
            }
        else:
            misses[name] = None
    return misses


def _total(values: Mapping[str, Array]) -> Array:
    """Radiance over uniform ground by 3.7, in units of F."""
    ground = values["direct"] + values["adjacency"]
    return np.asarray(values["path"] + ground * _RHO / (1.0 - values["spherical_albedo"] * _RHO))


def _check_table(table: AtmosphericTable) -> None:
    nm, shape = table.wavelength_nm, (*(nodes.size for nodes in table.axes.values()), table.wavelength_nm.size)
    for name, nodes in table.axes.items():
        if name not in AXES:
            raise UsageError(f"no axis {name!r}", expected="one of " + ", ".join(AXES))
        if nodes.ndim != 1 or nodes.size < 2 or not np.all(np.diff(nodes) > 0) or not np.all(np.isfinite(nodes)):
            raise UsageError(f"the nodes of {name} are {nodes.tolist()}", expected="two or more, increasing")
    if nm.size < 2 or np.any(np.diff(nm) <= 0):
        raise UsageError("the wavelengths do not increase", expected="increasing wavelengths [nm]")
    for name in (*QUANTITIES, *(n for n in OPTIONAL if n in table.quantities)):
        array = table.quantities.get(name)
        if array is None or array.shape != shape:
            got = "missing" if array is None else f"of shape {array.shape}"
            raise UsageError(f"{name} is {got}", expected=f"shape {shape}")
        if not np.all(np.isfinite(array)) or np.any(array < 0.0):
            raise UsageError(f"{name} has values that are negative or not finite", expected="finite values from 0")
    if np.any(table.quantities["spherical_albedo"] >= 1.0):
        raise UsageError("spherical_albedo reaches 1", expected="below 1")
    for name, values, least, most in (
        ("wavelength_nm", nm, *PLAUSIBLE_NM),
        ("fwhm_nm", table.fwhm_nm, _LEAST_WIDTH_NM, nm),
        ("solar_irradiance", table.solar_irradiance, *_SUN),
    ):
        if values is None:
            continue
        if values.shape != nm.shape:
            raise UsageError(f"{name} is of shape {values.shape}", expected=f"shape {nm.shape}")
        wrong, high = ~((values >= least) & (values <= most)), np.broadcast_to(most, nm.shape)
        if wrong.any():
            at = int(np.argmax(wrong))
            raise UsageError(f"{name} is {values[at]:g} at {nm[at]:g} nm", expected=f"{least:g} to {high[at]:g}")


_MAX_VALUES = 1 << 27  # 1 GiB of float64
_FORMAT = "hyperval atmospheric table 1"
_LONG_NAMES = {
    "path": "path radiance over black ground, L_a / F",
    "direct": "direct-view coefficient, A / F",
    "adjacency": "adjacency coefficient, B / F",
    "spherical_albedo": "spherical albedo of the atmosphere",
    "ground": "irradiance of black ground, E / (pi F)",
    "gas": "two-way gas transmittance",
    "diffuse": "sky's part of the irradiance of black ground",
}
# What MODTRAN users and their tools call the axes.
_FILE_NAMES = {
    "AOT550": "aot550", "H2OSTR": "water_vapour_g_cm2", "O3STR": "ozone_atm_cm", "GNDALT": "ground_altitude_km",
    "H1ALT": "sensor_altitude_km",
}  # fmt: skip
_PART = re.compile(r"([A-Za-z][A-Za-z0-9_]*?)-(\d+(?:\.\d+)?)(?=_|$)")


@reader
def read_table(path: Path, template: Path | None = None) -> AtmosphericTable:
    """A table from a NetCDF file, a folder of channel files, or the run template (.json) in such a folder.

    Tables are kept in memory for the life of the process, as long as their files do not change.

    Parameters
    ----------
    template : run template of a folder, where it stands elsewhere

    Raises
    ------
    InputError : missing, corrupt, too large, or an incomplete grid.
    """
    path = Path(path)
    if path.is_dir() or path.suffix == ".json":
        folder = path if path.is_dir() else path.parent
        files = _channel_files(folder)
        if template is None:
            template = _template_file(folder, files[0]) if path.is_dir() else path
        return _from_folder(tuple(_stamp(f) for f in files), str(folder), _stamp(template))
    return _from_netcdf(*_stamp(path))


def write_table(table: AtmosphericTable, path: Path) -> None:
    """Write a table as NetCDF, whole or not at all; the same table gives the same bytes."""
    dims = (*table.axes, "wavelength_nm")
    import xarray as xr  # 80 MB with pandas, which most runs do not need

    data = xr.Dataset(
        coords={
            "wavelength_nm": ("wavelength_nm", table.wavelength_nm, {"units": "nm"}),
            **{name: (name, nodes) for name, nodes in table.axes.items()},
        },
        attrs={
            "Conventions": "CF-1.11",
            "format": _FORMAT,
            "fixed": json.dumps(table.fixed, sort_keys=True),
            "source": json.dumps(table.source, sort_keys=True),
            "leave_one_out_error": json.dumps(table.errors or leave_one_out(table), sort_keys=True),
        },
    )
    present = [name for name in (*QUANTITIES, *OPTIONAL) if name in table.quantities]
    for name in present:
        data[name] = (dims, table.quantities[name], {"units": "1", "long_name": _LONG_NAMES[name]})
    if table.solar_irradiance is not None:
        data["solar_irradiance"] = ("wavelength_nm", table.solar_irradiance, {"units": "uW cm-2 nm-1"})
    if table.fwhm_nm is not None:
        data["fwhm_nm"] = ("wavelength_nm", table.fwhm_nm, {"units": "nm"})
    packed = {"zlib": True, "complevel": 4, "shuffle": True, "fletcher32": True}  # the last: HDF5's own checksum
    encoding = dict.fromkeys(map(str, data.variables), packed)
    with whole_file(Path(path)) as temporary:
        data.to_netcdf(temporary, mode="w", engine="h5netcdf", encoding=encoding)


_Stamp = tuple[str, int, int]


def _stamp(path: Path) -> _Stamp:
    """Name, time of change and size: what tells whether a file is still the one that was read."""
    try:
        status = path.stat()
    except OSError as error:
        raise InputError("no such file", where=str(path)) from error
    return str(path), status.st_mtime_ns, status.st_size


@lru_cache(maxsize=8)
def _from_netcdf(path: str, changed_ns: int, size: int) -> AtmosphericTable:
    import xarray as xr

    check_hdf5(path)
    try:
        with xr.open_dataset(path, engine="h5netcdf") as data:
            return _table_of(data, path)
    except (OSError, ValueError, KeyError, RuntimeError, TypeError) as error:
        raise InputError(
            f"not a table: {str(error).splitlines()[0][:200]}", where=path, expected=f"NetCDF, format {_FORMAT!r}"
        ) from error
    except UsageError as error:
        raise InputError(f"not a valid table: {error.what}", where=path, expected=error.args[0]) from error


def _table_of(data: xr.Dataset, path: str) -> AtmosphericTable:
    missing = [name for name in (*QUANTITIES, "wavelength_nm") if name not in data.variables]
    if data.attrs.get("format") != _FORMAT or missing:
        raise InputError(
            f"not a table: {'lacks ' + ', '.join(missing) if missing else 'another format'}",
            where=path,
            expected=f"NetCDF with the attribute format {_FORMAT!r} and the variables {', '.join(QUANTITIES)}",
        )
    present = [name for name in (*QUANTITIES, *OPTIONAL) if name in data.variables]
    total = sum(int(np.prod(data[name].shape, dtype=object)) for name in present)
    if total > _MAX_VALUES:
        raise InputError(f"{total} values", where=path, expected=f"at most {_MAX_VALUES}")
    dims = [str(d) for d in data["path"].dims]
    if dims[-1] != "wavelength_nm" or not set(dims[:-1]) <= set(AXES):
        raise InputError(
            f"dimensions {dims}", where=path, expected="some of " + ", ".join(AXES) + ", and wavelength_nm last"
        )
    return AtmosphericTable(
        wavelength_nm=_floats(data["wavelength_nm"]),
        axes={name: _floats(data[name]) for name in dims[:-1]},
        fixed=_record(data.attrs, "fixed"),
        quantities={name: _floats(data[name].transpose(*dims)) for name in present},
        solar_irradiance=_floats(data["solar_irradiance"]) if "solar_irradiance" in data else None,
        fwhm_nm=_floats(data["fwhm_nm"]) if "fwhm_nm" in data else None,
        source={**_record(data.attrs, "source"), "file": Path(path).name, "sha256": sha256_of(Path(path))},
        errors=_record(data.attrs, "leave_one_out_error"),
    )


def _floats(values: xr.DataArray | xr.Variable) -> Array:
    return np.ascontiguousarray(values.to_numpy(), dtype=float)


def _record(attributes: dict[Any, Any], name: str) -> dict[str, Any]:
    record = json.loads(str(attributes.get(name, "{}")))
    if not isinstance(record, dict):
        raise ValueError(f"the attribute {name} is no record")
    return record


def _channel_files(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise InputError("no such folder", where=str(folder))
    files = sorted(p for p in folder.iterdir() if p.name != _stem(p) and _PART.search(_stem(p)))
    if len(files) < 2:
        expected = "names such as AOT550-0.05_H2OSTR-0.75.chn"
        raise InputError(f"{len(files)} channel files", where=str(folder), expected=expected)
    return files


def _stem(path: Path) -> str:
    """The name of a channel file without its ending; that of any other file as it is."""
    plain = path.name.removesuffix(".gz")
    return plain.removesuffix(".chn") if plain.endswith(".chn") else path.name


def _values_in(path: Path) -> dict[str, float]:
    values = {_FILE_NAMES.get(name, name): float(value) for name, value in _PART.findall(_stem(path))}
    for axis in values:
        if axis not in AXES:
            raise InputError(
                f"{axis!r} is no axis", where=str(path), expected="among " + ", ".join([*_FILE_NAMES, *AXES])
            )
    return values


@lru_cache(maxsize=8)
def _from_folder(stamps: tuple[_Stamp, ...], folder: str, template: _Stamp) -> AtmosphericTable:
    files = [Path(name) for name, _, _ in stamps]
    values = [_values_in(f) for f in files]
    names = [name for name in AXES if any(name in v for v in values)]
    if any(set(v) != set(names) for v in values):
        raise InputError("the file names have different parts", where=folder, expected="_".join(names))
    nodes = {name: np.array(sorted({v[name] for v in values})) for name in names}
    at = {tuple(v[name] for name in names): file for v, file in zip(values, files, strict=True)}
    grid = list(product(*(n.tolist() for n in nodes.values())))
    absent = [c for c in grid if c not in at]
    if absent or len(at) != len(files):
        lacking = ", ".join(f"{n} {v:g}" for n, v in zip(names, absent[0], strict=True)) if absent else "a node twice"
        expected = f"one file for each of {len(grid)} states"
        raise InputError(f"the grid is not complete: {lacking}", where=folder, expected=expected)
    stated, albedos = _stated(Path(template[0]))
    slanted = stated.get("view_zenith_deg") != 0.0 or "view_zenith_deg" in names
    if slanted and not {"view_zenith_deg", "relative_azimuth_deg"} <= set(names):
        raise InputError(
            "a slanted line of sight", where=template[0],
            expected="OBSZEN: 180, or files that are named after the direction",
            mend="name them ..._view_zenith_deg-30_relative_azimuth_deg-120.chn: the sensor's zenith seen from the "
            "ground, and the angle between its azimuth and the sun's",
        )  # fmt: skip
    axes = {name: n for name, n in nodes.items() if n.size > 1}
    fixed = {k: v for k, v in stated.items() if k in (*AXES, *NAMED) and k not in axes}
    fixed |= {name: float(n[0]) for name, n in nodes.items() if n.size == 1}
    if "solar_zenith_deg" not in (*axes, *fixed) or "day_of_year" not in stated:
        expected = "a run template (.json) with IDAY and the sun's place"
        raise InputError("the sun is not stated", where=folder, expected=expected)
    rows = [_row(at[c], albedos) for c in grid]
    if any(not np.array_equal(r["wavelength_nm"], rows[0]["wavelength_nm"]) for r in rows):
        raise InputError("the files have different channels", where=folder)
    zeniths = [(fixed | dict(zip(names, c, strict=True)))["solar_zenith_deg"] for c in grid]
    irradiance = np.array([r["unit"] for r in rows]) * np.pi / np.cos(np.deg2rad(zeniths))[:, None]
    if np.any(np.ptp(irradiance, axis=0) > 1e-3 * irradiance.max(axis=0)):
        raise InputError("the runs have different suns", where=folder, expected="one solar spectrum, day and zenith")
    source = {
        "engine": "MODTRAN channel files",
        "files": {f.name: sha256_of(f) for f in (*files, Path(template[0]))},
        "terms": "from the runs" if rows[0]["solved"] else "from the printed coefficients",
    }
    sun = irradiance[0] * solar.distance_on_day(int(stated["day_of_year"])) ** 2
    return _assembled(axes, fixed, rows, source, sun)


def _assembled(
    axes: dict[str, Array], fixed: dict[str, Any], rows: list[dict[str, Any]], source: dict[str, Any],
    solar_irradiance: Array | None = None,
) -> AtmosphericTable:  # fmt: skip
    """The table of rows in the order of its grid, with its leave-one-node-out error."""
    nm, fwhm = rows[0]["wavelength_nm"], rows[0].get("fwhm_nm")
    shape = (*(n.size for n in axes.values()), nm.size)
    present = [name for name in (*QUANTITIES, *OPTIONAL) if all(r[name] is not None for r in rows)]
    quantities = {name: np.stack([r[name] for r in rows]).reshape(shape) for name in present}
    table = AtmosphericTable(nm, axes, fixed, quantities, solar_irradiance, fwhm, source)
    return replace(table, errors=leave_one_out(table))


def _template_file(folder: Path, first: Path) -> Path:
    beside = folder / f"LUT_{_stem(first)}.json"
    templates = [beside] if beside.is_file() else sorted(folder.glob("*template*.json"))
    if len(templates) != 1:
        expected = "one *template*.json, or LUT_NAME.json beside each file"
        raise InputError(f"{len(templates)} run templates", where=str(folder), expected=expected)
    return templates[0]


def _stated(template: Path) -> tuple[dict[str, Any], list[float] | None]:
    """What the run template states, and the ground reflectances of its runs."""
    cases = read_modtran_json(template)
    stated, *others = (stated_fields(case, str(template)) for case in cases)
    if any(other != stated for other in others):
        what, expected = "its cases differ in more than the ground", "one state over ground of several reflectances"
        raise InputError(what, where=str(template), expected=expected)
    if "meteorological_range_km" in stated:
        ground = stated.get("ground_altitude_km", 0.0)
        stated["aot550"] = aot550_from_range(stated["meteorological_range_km"], ground)
    if "solar_azimuth_deg" in stated and stated.get("view_zenith_deg") == 0.0:
        stated["relative_azimuth_deg"] = stated["solar_azimuth_deg"] % 180.0  # means nothing at nadir
    albedos = [stated_albedo(c) for c in cases]
    return stated, [a for a in albedos if a is not None] if None not in albedos and len(albedos) > 1 else None


def _row(path: Path, albedos: list[float] | None) -> dict[str, Any]:
    runs = read_channels(path)
    solved = len(runs) >= 3
    terms = terms_from_runs(runs, albedos) if solved else read_chn(path)
    unit = terms.diffuser_radiance
    if unit is None or np.any(unit <= 0.0) or np.any(np.diff(terms.wavelength_nm) <= 0):
        raise InputError("channels without sun, or channels that overlap", where=str(path))
    return {**_quantities(terms, unit), "fwhm_nm": terms.fwhm_nm, "unit": unit, "solved": solved}


def _quantities(terms: AtmosphericTerms, unit: Array) -> dict[str, Any]:
    """What a table holds of terms under a sun of mu0 E0 / pi = ``unit`` (n,)."""
    irradiance = np.nan_to_num(terms.ground_irradiance, nan=0.0) / np.pi
    lit = (terms.path_radiance, terms.direct, terms.adjacency, irradiance)
    return {
        **{n: np.maximum(v, 0.0) / unit for n, v in zip(("path", "direct", "adjacency", "ground"), lit, strict=True)},
        "wavelength_nm": terms.wavelength_nm, "spherical_albedo": terms.spherical_albedo,
        "gas": terms.gas_transmittance, "diffuse": terms.diffuse_fraction,
    }  # fmt: skip


_GREATEST_NODES = 20_000
_BUILT = [name for name in AXES if name in AtmosphericState.model_fields]  # an azimuth between two is no field


def build_table(
    base: AtmosphericState,
    axes: Mapping[str, Sequence[float]],
    *,
    cache_dir: Path | None = None,
    show_progress: bool | None = None,
) -> AtmosphericTable:
    """Run the embedded engine at every node of a grid.

    Parameters
    ----------
    base : the state that all nodes share but for the axes
    axes : field of the state -> increasing nodes; fields of the sun need a ``base`` whose sun is given by angles
    cache_dir, show_progress : of the engine; what it computed before is not computed again

    Returns
    -------
    AtmosphericTable with its leave-one-node-out error.

    Raises
    ------
    UsageError : an axis that a table cannot have, or a node that is no valid state.
    EngineError : the engine failed.
    """
    if base.engine != "sixs":
        raise UsageError(f"a table is built with engine: sixs, not {base.engine}")
    order = [name for name in _BUILT if name in axes]
    unknown = set(axes) - set(order)
    if unknown or not order:
        named = ", ".join(sorted(unknown)) or "no axis"
        raise UsageError(f"{named} in a table", expected="axes among " + ", ".join(_BUILT))
    nodes = {name: np.asarray(axes[name], dtype=float) for name in order}
    count = prod(n.size for n in nodes.values())
    if not 0 < count <= _GREATEST_NODES:
        raise UsageError(f"{count} nodes", expected=f"1 to {_GREATEST_NODES}")
    grid = product(*(n.tolist() for n in nodes.values()))
    states = [_at_node(base, dict(zip(order, c, strict=True))) for c in grid]
    folder, rows = cache_folder(cache_dir), []
    for state in track(states, "atmosphere table", total=len(states), show=show_progress):
        terms = sixs_terms(state, folder, False)
        sun = solar.extraterrestrial_irradiance(state.solar_spectrum, terms.wavelength_nm, state.distance_au)
        rows.append(_quantities(terms, np.cos(np.deg2rad(state.sun[0])) * sun / np.pi))
    engine = {k: v for k, v in terms.provenance.items() if k not in ("state", "solar_spectrum")}
    fixed: dict[str, Any] = {name: base.model_dump(mode="json")[name] for name in NAMED}
    fixed |= {name: round(value, 9) for name, value in coordinates(base).items() if name not in order}
    return _assembled(nodes, fixed, rows, {"engine": engine, "nodes": len(rows)})


def _at_node(base: AtmosphericState, changes: dict[str, float]) -> AtmosphericState:
    fields = base.model_dump(exclude_none=True)
    if "aot550" in changes:
        fields.pop("meteorological_range_km", None)
    try:
        return AtmosphericState(**{**fields, **changes})
    except ValueError as error:
        raise UsageError(f"no valid state at {changes}: {error}") from error
