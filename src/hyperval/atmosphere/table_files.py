"""Tables in files: NetCDF, and folders of MODTRAN channel files named after their state.

A table computed from an engine over a grid of states.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import solar, state
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
from hyperval.atmosphere.state import AtmosphericState
from hyperval.atmosphere.table import AXES, NAMED, OPTIONAL, QUANTITIES, AtmosphericTable, coordinates, leave_one_out
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.errors import InputError, UsageError, reader
from hyperval.hdf5 import check_hdf5
from hyperval.progress import track
from hyperval.storage import sha256_of, whole_file

if TYPE_CHECKING:
    import xarray as xr


Array = npt.NDArray[np.float64]

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
    files = sorted(
        p for p in folder.iterdir() if p.name.removesuffix(".gz").endswith(".chn") and _PART.search(_stem(p))
    )
    if len(files) < 2:
        raise InputError(
            f"{len(files)} channel files", where=str(folder), expected="names such as AOT550-0.05_H2OSTR-0.75.chn"
        )
    return files


def _stem(path: Path) -> str:
    return path.name.removesuffix(".gz").removesuffix(".chn")


def _values_in(path: Path) -> dict[str, float]:
    values = {}
    for name, value in _PART.findall(_stem(path)):
        axis = _FILE_NAMES.get(name, name)
        if axis not in AXES:
            raise InputError(
                f"{name!r} is no axis", where=str(path), expected="among " + ", ".join([*_FILE_NAMES, *AXES])
            )
        values[axis] = float(value)
    return values


@lru_cache(maxsize=8)
def _from_folder(stamps: tuple[_Stamp, ...], folder: str, template: _Stamp) -> AtmosphericTable:
    files = [Path(name) for name, _, _ in stamps]
    values = [_values_in(f) for f in files]
    names = [name for name in AXES if any(name in v for v in values)]
    if any(set(v) != set(names) for v in values):
        raise InputError("the file names have different parts", where=folder, expected="_".join(names))
    nodes = {name: np.array(sorted({v[name] for v in values})) for name in names}
    at = {tuple(v[name] for name in names): i for i, v in enumerate(values)}
    grid = [tuple(c) for c in np.array(np.meshgrid(*nodes.values(), indexing="ij")).reshape(len(names), -1).T]
    absent = [c for c in grid if c not in at]
    if absent or len(at) != len(files):
        lacking = ", ".join(f"{n} {v:g}" for n, v in zip(names, absent[0], strict=True)) if absent else "a node twice"
        raise InputError(
            f"the grid is not complete: {lacking}",
            where=folder,
            expected=f"one file for each of {len(grid)} states",
        )
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
        raise InputError(
            "the sun is not stated", where=folder, expected="a run template (.json) with IDAY and the sun's place"
        )
    rows = [_row(files[at[c]], albedos) for c in grid]
    first = rows[0]
    if any(not np.array_equal(r["wavelength_nm"], first["wavelength_nm"]) for r in rows):
        raise InputError("the files have different channels", where=folder)
    zenith = np.array(
        [dict(zip(names, c, strict=True)).get("solar_zenith_deg", fixed.get("solar_zenith_deg")) for c in grid]
    )
    irradiance = np.array([r["unit"] for r in rows]) * np.pi / np.cos(np.deg2rad(zenith.astype(float)))[:, None]
    if np.any(np.ptp(irradiance, axis=0) > 1e-3 * irradiance.max(axis=0)):
        raise InputError("the runs have different suns", where=folder, expected="one solar spectrum, day and zenith")
    shape = (*(n.size for n in axes.values()), first["wavelength_nm"].size)
    present = [name for name in (*QUANTITIES, *OPTIONAL) if all(r[name] is not None for r in rows)]
    table = AtmosphericTable(
        wavelength_nm=first["wavelength_nm"],
        axes=axes,
        fixed=fixed,
        quantities={name: np.stack([r[name] for r in rows]).reshape(shape) for name in present},
        solar_irradiance=irradiance[0] * solar.distance_on_day(int(stated["day_of_year"])) ** 2,
        fwhm_nm=first["fwhm_nm"],
        source={
            "engine": "MODTRAN channel files",
            "files": {f.name: sha256_of(f) for f in (*files, Path(template[0]))},
            "terms": "from the runs" if first["solved"] else "from the printed coefficients",
        },
    )
    return replace(table, errors=leave_one_out(table))


def _template_file(folder: Path, first: Path) -> Path:
    templates = [p for p in (folder / f"LUT_{_stem(first)}.json",) if p.is_file()] or sorted(
        folder.glob("*template*.json")
    )
    if len(templates) != 1:
        raise InputError(
            f"{len(templates)} run templates",
            where=str(folder),
            expected="one *template*.json, or LUT_NAME.json beside each file",
        )
    return templates[0]


def _stated(template: Path) -> tuple[dict[str, Any], list[float] | None]:
    """What the run template states, and the ground reflectances of its runs."""
    cases = read_modtran_json(template)
    stated = stated_fields(cases[0], str(template))
    if "meteorological_range_km" in stated:
        ground = stated.get("ground_altitude_km", 0.0)
        stated["aot550"] = state.aot550_from_range(stated["meteorological_range_km"], ground)
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
    irradiance = np.nan_to_num(terms.ground_irradiance, nan=0.0)
    return {
        "wavelength_nm": terms.wavelength_nm,
        "path": np.maximum(terms.path_radiance, 0.0) / unit,
        "direct": np.maximum(terms.direct, 0.0) / unit,
        "adjacency": np.maximum(terms.adjacency, 0.0) / unit,
        "spherical_albedo": terms.spherical_albedo,
        "ground": np.maximum(irradiance, 0.0) / (np.pi * unit),
        "gas": terms.gas_transmittance,
        "diffuse": terms.diffuse_fraction,
    }


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
    shape = tuple(n.size for n in nodes.values())
    if np.prod(shape) > _GREATEST_NODES:
        raise UsageError(f"{np.prod(shape)} nodes", expected=f"at most {_GREATEST_NODES}")
    combinations = list(product(*(n.tolist() for n in nodes.values())))
    states = [_at_node(base, dict(zip(order, c, strict=True))) for c in combinations]
    folder = cache_folder(cache_dir)
    rows = [
        _computed(state, folder) for state in track(states, "atmosphere table", total=len(states), show=show_progress)
    ]
    wavelength = rows[0]["wavelength_nm"]
    quantities = {
        name: np.stack([row[name] for row in rows]).reshape((*shape, wavelength.size))
        for name in (*QUANTITIES, *OPTIONAL)
    }
    engine = {k: v for k, v in rows[0]["provenance"].items() if k not in ("state", "solar_spectrum")}
    table = AtmosphericTable(
        wavelength, nodes, _fixed(base, order), quantities, source={"engine": engine, "nodes": len(rows)}
    )
    return replace(table, errors=leave_one_out(table))


def _at_node(base: AtmosphericState, changes: dict[str, float]) -> AtmosphericState:
    fields = base.model_dump(exclude_none=True)
    if "aot550" in changes:
        fields.pop("meteorological_range_km", None)
    try:
        return AtmosphericState(**{**fields, **changes})
    except ValueError as error:
        raise UsageError(f"no valid state at {changes}: {error}") from error


def _computed(state: AtmosphericState, folder: Path) -> dict[str, Any]:
    terms = sixs_terms(state, folder, False)
    mu0 = np.cos(np.deg2rad(state.sun[0]))
    irradiance = solar.extraterrestrial_irradiance(state.solar_spectrum, terms.wavelength_nm, state.distance_au)
    return {**_quantities(terms, mu0 * irradiance / np.pi), "provenance": terms.provenance}


def _fixed(base: AtmosphericState, axes: list[str]) -> dict[str, Any]:
    fixed: dict[str, Any] = {n: base.model_dump(mode="json")[n] for n in ("model", "aerosol")}
    return fixed | {name: round(value, 9) for name, value in coordinates(base).items() if name not in axes}
