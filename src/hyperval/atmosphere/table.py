"""Tables of atmospheric terms (NetCDF, named MODTRAN channel files, or computed), and the terms of a state.

A table holds what does not depend on the strength of the sun, at the resolution of its engine; F = mu0 E0 / pi:

    path = L_a / F, direct = A / F, adjacency = B / F, S, ground = E_ground / (pi F), gas: two-way
    transmittance, and diffuse: the sky's part of E_ground, where the engine tells it

Rules of interpolation stand in :mod:`hyperval.atmosphere.between`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import product
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperval.atmosphere import modtran, solar
from hyperval.atmosphere.between import AS_THEY_ARE, Rule, along, between_aerosols, inside, path_error
from hyperval.atmosphere.sixs import emulator_terms, sixs_terms, terms_near
from hyperval.atmosphere.state import SPACE_KM, AtmosphericState, aot550_from_range, coordinates
from hyperval.atmosphere.terms import Arrays, AtmosphericTerms, lit_by
from hyperval.data import Array
from hyperval.datasets import cache_root
from hyperval.errors import InputError, UsageError, needed, reader, refusal, refuse
from hyperval.hdf5 import opened_netcdf
from hyperval.paths import checked_file
from hyperval.progress import bars, track
from hyperval.storage import sha256_of, whole_file
from hyperval.units import PLAUSIBLE_NM

if TYPE_CHECKING:
    import xarray as xr


_LONG_NAMES = {
    "path": "path radiance over black ground, L_a / F",
    "direct": "direct-view coefficient, A / F",
    "adjacency": "adjacency coefficient, B / F",
    "spherical_albedo": "spherical albedo of the atmosphere",
    "ground": "irradiance of black ground, E / (pi F)",
    "gas": "two-way gas transmittance",
    "diffuse": "diffuse fraction of the irradiance of black ground",
}
*QUANTITIES, _ = _LONG_NAMES  # the last one may lack
AEROSOL_RULE = None  # all quantities together
_MONOTONE, _CUBIC, _STRAIGHT = Rule("monotone"), Rule("cubic"), Rule("linear")
# Rule of each axis, and by how much a state may miss a value that the table holds only once.
AXES: dict[str, tuple[Rule | None, float]] = {
    "aot550": (AEROSOL_RULE, 1e-3),
    "water_vapour_g_cm2": (Rule("linear", np.sqrt, logarithm=True), 5e-3),
    "ozone_atm_cm": (Rule("linear", logarithm=True), 2e-3),
    "ground_altitude_km": (_MONOTONE, 0.02),
    "sensor_altitude_km": (_MONOTONE, 0.02),
    "solar_zenith_deg": (_CUBIC, 0.3),
    "view_zenith_deg": (_CUBIC, 0.5),
    "relative_azimuth_deg": (_CUBIC, 5.0),
}
# Values that a table can be computed for only as a whole.
NAMED = ("model", "aerosol")
_MIN_WIDTH_NM = 1e-3
_SUN = (1e-9, 1e3)  # [uW cm-2 nm-1] at 1 au: its lines reach 250, and 1e-7 is left at 0.1 mm
_RHO = 0.3  # ground over which the error is stated
_MIN_GAS = 0.1  # and the two-way gas transmittance above which


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
        nm, shape = self.wavelength_nm, (*(nodes.size for nodes in self.axes.values()), self.wavelength_nm.size)
        for name, nodes in self.axes.items():
            refuse(name not in AXES, "table.axis", name=name, known=", ".join(AXES))
            rising = nodes.ndim == 1 and nodes.size > 1 and np.all(np.diff(nodes) > 0) and np.all(np.isfinite(nodes))
            refuse(not rising, "table.nodes", name=name, nodes=nodes.tolist())
        refuse(nm.size < 2 or np.any(np.diff(nm) <= 0), "table.wavelengths")
        for name in (n for n in _LONG_NAMES if n in (*QUANTITIES, *self.quantities)):
            refuse(name not in self.quantities, "table.missing", name=name)
            values = self.quantities[name]
            refuse(values.shape != shape, "table.shape", name=name, found=values.shape, wanted=shape)
            refuse(not np.all(np.isfinite(values)) or np.any(values < 0.0), "table.values", name=name)
        refuse(np.any(self.quantities["spherical_albedo"] >= 1.0), "table.albedo")
        for name, least, most in (
            ("wavelength_nm", *PLAUSIBLE_NM), ("fwhm_nm", _MIN_WIDTH_NM, nm), ("solar_irradiance", *_SUN),
        ):  # fmt: skip
            values = getattr(self, name)
            if values is not None:
                refuse(values.shape != nm.shape, "table.shape", name=name, found=values.shape, wanted=nm.shape)
                implausible, high = ~((values >= least) & (values <= most)), np.broadcast_to(most, nm.shape)
                where = {"value": values[implausible], "nm": nm[implausible], "low": least, "high": high[implausible]}
                refuse(implausible.any(), "table.beyond", name=name, **where)

    def terms(self, state: AtmosphericState) -> AtmosphericTerms:
        """The terms of a state inside the table.

        Raises
        ------
        UsageError : a value outside the axes, or other than the one the table was computed for.
        """
        place = coordinates(state)
        self._check_fixed(state, place)
        values, axes = dict(self.quantities), list(self.axes)
        # Aerosol last: its rule needs the altitudes, which may be axes themselves.
        for name in sorted(self.axes, key="aot550".__eq__):
            x, number = float(inside(name, self.axes[name], place[name])), axes.index(name)
            values = _along(self.axes[name], {q: np.moveaxis(v, number, 0) for q, v in values.items()}, x, name, place)
            axes.remove(name)
        path_relative = 0.0
        if "aot550" in self.axes:
            places = place["ground_altitude_km"], place["sensor_altitude_km"]
            path_relative = path_error(self.axes["aot550"], place["aot550"], *places)
        irradiance, lines = self.solar_irradiance, None
        if irradiance is None:
            irradiance = solar.extraterrestrial_irradiance(state.solar_spectrum, self.wavelength_nm, 1.0)
            lines = None if self.fwhm_nm is not None else solar.lines_between(state.solar_spectrum, self.wavelength_nm)
        unit = np.cos(np.deg2rad(state.sun[0])) * irradiance / state.distance_au**2 / np.pi
        return AtmosphericTerms(
            wavelength_nm=self.wavelength_nm.copy(),
            **lit_by(unit, values),
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
            solar_lines=lines,
            path_uncertainty=path_relative * unit * values["path"],
        )

    def _check_fixed(self, state: AtmosphericState, place: Mapping[str, float]) -> None:
        stated = state.model_dump(mode="json")
        for name, value in self.fixed.items():
            if name in NAMED:
                asked = stated[name]
                wrong = asked != value and not (name == "aerosol" and place["aot550"] == 0.0)
            else:  # at nadir every azimuth is the same
                asked = place.get(name)
                free = asked is None or (name == "relative_azimuth_deg" and place["view_zenith_deg"] == 0.0)
                wrong = not free and abs(float(value) - place[name]) > AXES[name][1]
            refuse(wrong, "table.other", name=name, given=asked, value=value)


def _along(nodes: Array, values: Mapping[str, Array], x: float, axis: str, targets: Mapping[str, float]) -> Arrays:
    """All quantities (k, ...) at ``x`` along their first dimension."""
    rule = AXES[axis][0]
    if rule is AEROSOL_RULE:
        return between_aerosols(nodes, values, x, targets["ground_altitude_km"], targets["sensor_altitude_km"])
    # Where transmittances are linear in their logarithm all other quantities are linear.
    rules = {q: _STRAIGHT if rule.logarithm and q in AS_THEY_ARE else rule for q in values}
    return {q: along(nodes, v, x, rules[q]) for q, v in values.items()}


def leave_one_out(table: AtmosphericTable) -> dict[str, dict[str, float] | None]:
    """Relative error of the total radiance over ground of 0.3 at nodes predicted from the others, axis by axis.

    Where the two-way gas transmittance is above 0.1.  Without the node the step is twice as wide, so this is an
    upper estimate: the error inside the table is about a quarter of it for a linear rule, less for a cubic.
    None for an axis of two nodes.
    """
    misses: dict[str, dict[str, float] | None] = {}
    for number, (name, nodes) in enumerate(table.axes.items()):
        place, part, errors = dict[str, float](), [slice(None)] * (len(table.axes) + 1), list[Array]()
        for level, default in (("ground_altitude_km", 0.0), ("sensor_altitude_km", SPACE_KM)):
            place[level] = table.fixed.get(level, default)
            if level in table.axes and name == "aot550":  # the haze below the sensor: that at the middle altitude
                middle = table.axes[level].size // 2
                place[level] = float(table.axes[level][middle])
                part[list(table.axes).index(level)] = slice(middle, middle + 1)
        moved = {q: np.moveaxis(v[tuple(part)], number, 0) for q, v in table.quantities.items()}
        for i in range(1, nodes.size - 1):
            keep = np.delete(np.arange(nodes.size), i)
            predicted = _along(nodes[keep], {q: v[keep] for q, v in moved.items()}, float(nodes[i]), name, place)
            exact = {q: v[i] for q, v in moved.items()}
            clear = exact["gas"] > _MIN_GAS
            errors.append((_total(predicted)[clear] / np.maximum(_total(exact)[clear], 1e-30)) - 1.0)
        ratios = np.concatenate([*errors, np.zeros(0)])
        worst, rms = np.max(np.abs(ratios), initial=0.0), np.sqrt(np.mean(ratios**2)) if ratios.size else 0.0
        misses[name] = {"worst": round(float(worst), 6), "rms": round(float(rms), 6)} if errors else None
    return misses


def _total(values: Mapping[str, Array]) -> Array:
    """Radiance over uniform ground by 3.7, in units of F."""
    ground = values["direct"] + values["adjacency"]
    return np.asarray(values["path"] + ground * _RHO / (1.0 - values["spherical_albedo"] * _RHO))


_MAX_VALUES = 1 << 27  # 1 GiB of float64
_FORMAT = "hyperval atmospheric table 1"
_COLUMNS = {"solar_irradiance": "uW cm-2 nm-1", "fwhm_nm": "nm"}
# What MODTRAN users and their tools call the axes.
_FILE_NAMES = {"AOT550": "aot550"} | {key: field for field, (_, key, *_) in modtran.FIELDS.items()}
_PART = re.compile(r"([A-Za-z][A-Za-z0-9_]*?)-(\d+(?:\.\d+)?)(?=_|$)")


@reader
def read_table(path: Path) -> AtmosphericTable:
    """A table from a NetCDF file, a folder of channel files, or the run template (.json) in such a folder.

    Tables are kept in memory for the life of the process, as long as their files do not change.

    Raises
    ------
    InputError : missing, corrupt, too large, or an incomplete grid.
    """
    path = Path(path)
    if path.is_dir() or path.suffix == ".json":
        folder = path if path.is_dir() else path.parent
        refuse(not folder.is_dir(), "table.no_folder", folder)
        files = sorted(p for p in folder.iterdir() if p.name != _stem(p) and _PART.search(_stem(p)))
        refuse(len(files) < 2, "table.files", folder, count=len(files))
        template = _template_file(folder, files[0]) if path.is_dir() else path
        return _from_folder(tuple(_stamp(f) for f in files), str(folder), _stamp(template))
    return _from_netcdf(*_stamp(path))


def write_table(table: AtmosphericTable, path: Path) -> None:
    """Write a table as NetCDF, whole or not at all; the same table gives the same bytes."""
    import xarray as xr  # 80 MB with pandas, which most runs do not need

    dims, names = (*table.axes, "wavelength_nm"), [n for n in _LONG_NAMES if n in table.quantities]
    columns = {name: getattr(table, name) for name in _COLUMNS if getattr(table, name) is not None}
    records = {
        "fixed": table.fixed,
        "source": table.source,
        "leave_one_out_error": table.errors or leave_one_out(table),
    }
    data = xr.Dataset(
        {
            **{n: (dims, table.quantities[n], {"units": "1", "long_name": _LONG_NAMES[n]}) for n in names},
            **{name: ("wavelength_nm", values, {"units": _COLUMNS[name]}) for name, values in columns.items()},
        },
        {"wavelength_nm": ("wavelength_nm", table.wavelength_nm, {"units": "nm"}), **table.axes},
        {"Conventions": "CF-1.11", "format": _FORMAT, **{k: json.dumps(v, sort_keys=True) for k, v in records.items()}},
    )
    packed = {"zlib": True, "complevel": 4, "shuffle": True, "fletcher32": True}  # the last: HDF5's own checksum
    with whole_file(Path(path)) as temporary:
        data.to_netcdf(temporary, mode="w", engine="h5netcdf", encoding=dict.fromkeys(map(str, data.variables), packed))


_Stamp = tuple[str, int, int]


def _stamp(path: Path) -> _Stamp:
    """Name, time of change and size: what tells whether a file is still the one that was read."""
    status = checked_file(path).stat()
    return str(path), status.st_mtime_ns, status.st_size


@lru_cache(maxsize=8)
def _from_netcdf(path: str, changed_ns: int, size: int) -> AtmosphericTable:
    try:
        with opened_netcdf(Path(path), "table", {"wavelength_nm": "nm"}, {"nm": _MAX_VALUES}) as data:
            return _table_of(data, path)
    except UsageError as error:
        raise refusal("table.invalid", path, why=error.what, wanted=error.expected) from error


def _table_of(data: xr.Dataset, path: str) -> AtmosphericTable:
    missing = ", ".join(name for name in QUANTITIES if name not in data.variables)
    why, names = f"lacks {missing}" if missing else "another format", ", ".join(QUANTITIES)
    refuse(missing or data.attrs.get("format") != _FORMAT, "table.form", path, why=why, form=_FORMAT, names=names)
    present = [name for name in _LONG_NAMES if name in data.variables]
    total = sum(int(np.prod(data[name].shape, dtype=object)) for name in present)
    refuse(total > _MAX_VALUES, "table.large", path, total=total, most=_MAX_VALUES)
    dims = [str(d) for d in data["path"].dims]
    return AtmosphericTable(
        wavelength_nm=_floats(data["wavelength_nm"]),
        axes={name: _floats(data[name]) for name in dims[:-1]},
        fixed=_record(data.attrs, "fixed"),
        quantities={name: _floats(data[name].transpose(*dims)) for name in present},
        **{name: _floats(data[name]) if name in data else None for name in _COLUMNS},
        source={**_record(data.attrs, "source"), "file": Path(path).name, "sha256": sha256_of(Path(path))},
        errors=_record(data.attrs, "leave_one_out_error"),
    )


def _floats(values: xr.DataArray) -> Array:
    return np.ascontiguousarray(values.to_numpy(), dtype=float)


def _record(attributes: dict[Any, Any], name: str) -> dict[str, Any]:
    record: dict[str, Any] = json.loads(str(attributes.get(name, "{}")))
    refuse(not isinstance(record, dict), "table.record", name=name)
    return record


def _stem(path: Path) -> str:
    """The name of a channel file without its ending; that of any other file as it is."""
    plain = path.name.removesuffix(".gz")
    return plain.removesuffix(".chn") if plain.endswith(".chn") else path.name


def _values_in(path: Path) -> dict[str, float]:
    values = {_FILE_NAMES.get(name, name): float(value) for name, value in _PART.findall(_stem(path))}
    unknown = next((axis for axis in values if axis not in AXES), "")
    refuse(unknown, "table.name", path, name=unknown, known=", ".join([*_FILE_NAMES, *AXES]))
    return values


@lru_cache(maxsize=8)
def _from_folder(stamps: tuple[_Stamp, ...], folder: str, template: _Stamp) -> AtmosphericTable:
    files = [Path(name) for name, _, _ in stamps]
    values = [_values_in(f) for f in files]
    names = [name for name in AXES if any(name in v for v in values)]
    refuse(any(set(v) != set(names) for v in values), "table.parts", folder, names="_".join(names))
    nodes = {name: np.array(sorted({v[name] for v in values})) for name in names}
    file_at = {tuple(v[name] for name in names): file for v, file in zip(values, files, strict=True)}
    grid = list(product(*(n.tolist() for n in nodes.values())))
    absent = [", ".join(f"{n} {v:g}" for n, v in zip(names, c, strict=True)) for c in grid if c not in file_at]
    lacking = absent[0] if absent else "a node twice"
    refuse(absent or len(file_at) != len(files), "table.incomplete", folder, lacking=lacking, count=len(grid))
    stated, albedos = _stated(Path(template[0]))
    slanted = stated.get("view_zenith_deg") != 0.0 or "view_zenith_deg" in names
    refuse(slanted and not {"view_zenith_deg", "relative_azimuth_deg"} <= set(names), "table.slanted", template[0])
    axes = {name: n for name, n in nodes.items() if n.size > 1}
    fixed = {k: v for k, v in stated.items() if k in (*AXES, *NAMED) and k not in axes}
    fixed |= {name: float(n[0]) for name, n in nodes.items() if n.size == 1}
    sunless = "solar_zenith_deg" not in (*axes, *fixed) or "day_of_year" not in stated
    refuse(sunless, "table.sunless", folder)
    rows = [_row(file_at[c], albedos) for c in grid]
    unlike = any(not np.array_equal(r["wavelength_nm"], rows[0]["wavelength_nm"]) for r in rows)
    refuse(unlike, "table.channels", folder)
    zeniths = [(fixed | dict(zip(names, c, strict=True)))["solar_zenith_deg"] for c in grid]
    irradiance = np.array([r["unit"] for r in rows]) * np.pi / np.cos(np.deg2rad(zeniths))[:, None]
    several = np.any(np.ptp(irradiance, axis=0) > 1e-3 * irradiance.max(axis=0))
    refuse(several, "table.suns", folder)
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
    present = [name for name in _LONG_NAMES if all(r[name] is not None for r in rows)]
    quantities = {name: np.stack([r[name] for r in rows]).reshape(shape) for name in present}
    table = AtmosphericTable(nm, axes, fixed, quantities, solar_irradiance, fwhm, source)
    return replace(table, errors=leave_one_out(table))


def _template_file(folder: Path, first: Path) -> Path:
    beside = folder / f"LUT_{_stem(first)}.json"
    templates = [beside] if beside.is_file() else sorted(folder.glob("*template*.json"))
    refuse(len(templates) != 1, "table.templates", folder, count=len(templates))
    return templates[0]


def _stated(template: Path) -> tuple[dict[str, Any], list[float] | None]:
    """What the run template states, and the ground reflectances of its runs."""
    cases = modtran.read_modtran_json(template)
    stated, *others = (modtran.stated_fields(case, str(template)) for case in cases)
    refuse(any(o != stated for o in others), "table.cases", template)
    if "meteorological_range_km" in stated:
        ground = stated.get("ground_altitude_km", 0.0)
        stated["aot550"] = aot550_from_range(stated["meteorological_range_km"], ground)
    albedos = [modtran.stated_albedo(c) for c in cases]
    return stated, [a for a in albedos if a is not None] if None not in albedos and len(albedos) > 1 else None


def _row(path: Path, albedos: list[float] | None) -> dict[str, Any]:
    runs = modtran.read_channels(path)
    solved = len(runs) >= 3
    terms = modtran.terms_from_runs(runs, albedos) if solved else modtran.read_chn(path)
    unit = needed(terms.diffuser_radiance, "table.overlap", path)
    refuse(np.any(unit <= 0.0) or np.any(np.diff(terms.wavelength_nm) <= 0), "table.overlap", path)
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


_MAX_NODES = 20_000
_BUILT = [name for name in AXES if name in AtmosphericState.model_fields]  # an azimuth between two is no field


def build_table(
    base: AtmosphericState, axes: Mapping[str, Sequence[float]], *, cache_dir: Path | None = None
) -> AtmosphericTable:
    """Run the embedded engine at every node of a grid.

    Parameters
    ----------
    base : the state that all nodes share but for the axes
    axes : field of the state -> increasing nodes; fields of the sun need a ``base`` whose sun is given by angles
    cache_dir : of the engine; what it computed before is not computed again

    Returns
    -------
    AtmosphericTable with its leave-one-node-out error.

    Raises
    ------
    UsageError : an axis that a table cannot have, or a node that is no valid state.
    EngineError : the engine failed.
    """
    refuse(base.engine != "sixs", "table.engine", engine=base.engine)
    order = [name for name in _BUILT if name in axes]
    unknown = ", ".join(sorted(set(axes) - set(order))) or ("" if order else "no axis")
    refuse(unknown, "table.built", name=unknown, known=", ".join(_BUILT))
    nodes = {name: np.asarray(axes[name], dtype=float) for name in order}
    count = prod(n.size for n in nodes.values())
    refuse(not 0 < count <= _MAX_NODES, "table.many", count=count, most=_MAX_NODES)
    grid = product(*(n.tolist() for n in nodes.values()))
    states = [_at_node(base, dict(zip(order, c, strict=True))) for c in grid]
    folder, rows = cache_dir or cache_root(), []
    for state in track(states, "atmosphere table", total=len(states)):
        with bars(False):
            terms = sixs_terms(state, folder)
        sun = solar.extraterrestrial_irradiance(state.solar_spectrum, terms.wavelength_nm, state.distance_au)
        rows.append(_quantities(terms, np.cos(np.deg2rad(state.sun[0])) * sun / np.pi))
    of_all = {k: v for k, v in terms.provenance.items() if k not in ("state", "solar_spectrum")}
    fixed: dict[str, Any] = {name: base.model_dump(mode="json")[name] for name in NAMED}
    fixed |= {name: round(value, 9) for name, value in coordinates(base).items() if name not in order}
    return _assembled(nodes, fixed, rows, {"engine": of_all, "nodes": len(rows)})


def _at_node(base: AtmosphericState, changes: dict[str, float]) -> AtmosphericState:
    fields = base.model_dump(exclude_none=True)
    if "aot550" in changes:
        fields.pop("meteorological_range_km", None)
    try:
        return AtmosphericState(**{**fields, **changes})
    except ValueError as error:
        raise refusal("table.state", changes=changes, why=error) from error


# State and cache folder: what computes the terms when they are asked for.
ENGINES: dict[str, Callable[[AtmosphericState, Path], AtmosphericTerms]] = {
    "sixs": sixs_terms,
    "modtran": modtran.modtran_terms,
    "emulator": emulator_terms,
}


def atmospheric_terms(
    state: AtmosphericState,
    *,
    cache_dir: Path | None = None,
    show_progress: bool | None = None,
    resolve: Callable[[str], Path] | None = None,
    near: AtmosphericState | None = None,
) -> AtmosphericTerms:
    """The terms of equation 3.7 for one state, from the engine that the state names.

    Parameters
    ----------
    state : atmosphere, sun and sensor
    cache_dir : where results are kept; default HYPERVAL_CACHE or the user's cache folder
    show_progress : draw a progress bar; default: when standard error is a terminal
    resolve : turns the state's ``table`` into a path; default: relative to the working directory
    near : a state from which a step of 6S may be told by its emulator (:func:`hyperval.atmosphere.terms_near`)

    Returns
    -------
    AtmosphericTerms on the engine's own grid (6S: 340-2600 nm by 2.5 nm); ``at_bands`` averages them
    over a sensor's bands.

    Raises
    ------
    EngineError : the engine cannot be started or failed.
    InputError : a table that is missing, corrupt or incomplete.
    MissingDataError : the chosen solar spectrum is not at hand.
    UsageError : a state outside the table, or that the engine cannot be told.
    """
    if state.engine == "table":
        try:
            return read_table((resolve or Path)(str(state.table))).terms(state)
        except InputError as error:
            name = str(state.table).rstrip("/")
            refuse("a folder" in error.what, "table.folder", name, name=name)
            raise
    with bars(show_progress):
        if near is not None and near.engine == state.engine == "sixs":
            return terms_near(near, state, cache_dir or cache_root())
        return ENGINES[state.engine](state, cache_dir or cache_root())
