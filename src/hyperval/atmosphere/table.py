"""Terms from a table computed before: interpolated over the state, with an estimate of the error.

A table holds what does not depend on the strength of the sun, at the resolution of its engine; F = mu0 E0 / pi:

    path = L_a / F, direct = A / F, adjacency = B / F, S, ground = E_ground / (pi F), gas: two-way
    transmittance, and diffuse: the sky's part of E_ground, where the engine tells it

Interpolated are these products, before any band is averaged.  The rules (:mod:`hyperval.atmosphere.terms`):
aerosol by :mod:`hyperval.atmosphere.table` (a range as depth); altitudes by monotone cubic; angles by cubic
spline; water logarithms of the transmittances, linear in the square root of the column; ozone likewise, linear in
the column.

Terms of a table between two amounts of aerosol.

What the haze does goes along two optical depths: the sun comes through all of it, tau, the view passes what lies
below the sensor, d.  The rule of MODTRAN's profile (:mod:`hyperval.atmosphere.state`) ties d to tau, and not
as a straight line: under an aircraft d is nearly nothing up to tau = 0.05 and grows with tau above it.  So

    ground G             straight in ln G over tau        (Beer's law for the way of the sun)
    direct A             straight in ln(A/G) over d       (Beer's law for the view)
    both, A + B          straight in (A + B)/G over d     (scattering moves light from A to B, loses little)
    path                 straight over d                  (single scattering; its limit is the Rayleigh path)
    S, gas, diffuse      straight over tau

At a sensor above the atmosphere d is tau.  docs/atmosphere.md has what was measured with the embedded engine.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import solar
from hyperval.atmosphere.state import (
    OZONE_G_CM2_PER_ATM_CM,
    SPACE_KM,
    AtmosphericState,
    column_g_cm2,
    fraction_below,
    standard_profile,
)
from hyperval.atmosphere.terms import AS_THEY_ARE, AtmosphericTerms, Rule, along, inside
from hyperval.errors import UsageError
from hyperval.units import PLAUSIBLE_NM

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
    depths: shape and size were fitted to what the embedded engine shows between its nodes (docs/atmosphere.md).
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
                raise UsageError(
                    f"{name} is {given!r}, and the table was computed for {value!r}",
                    expected=f"{name}: {value!r}",
                    mend="change the state, or compute a table for it",
                )


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
    shape = (*(nodes.size for nodes in table.axes.values()), table.wavelength_nm.size)
    for name, nodes in table.axes.items():
        if name not in AXES:
            raise UsageError(f"no axis {name!r}", expected="one of " + ", ".join(AXES))
        if nodes.ndim != 1 or nodes.size < 2 or np.any(np.diff(nodes) <= 0) or not np.all(np.isfinite(nodes)):
            raise UsageError(f"the nodes of {name} are {nodes.tolist()}", expected="two or more, increasing")
    for name in (*QUANTITIES, *(n for n in OPTIONAL if n in table.quantities)):
        array = table.quantities.get(name)
        if array is None or array.shape != shape:
            got = "missing" if array is None else f"of shape {array.shape}"
            raise UsageError(f"{name} is {got}", expected=f"shape {shape}")
        if not np.all(np.isfinite(array)) or np.any(array < 0.0):
            raise UsageError(f"{name} has values that are negative or not finite", expected="finite values from 0")
    if np.any(table.quantities["spherical_albedo"] >= 1.0):
        raise UsageError("spherical_albedo reaches 1", expected="below 1")
    if table.wavelength_nm.size < 2 or np.any(np.diff(table.wavelength_nm) <= 0):
        raise UsageError("the wavelengths do not increase", expected="increasing wavelengths [nm]")
    widest = table.wavelength_nm
    for name, array, least, most in (
        ("wavelength_nm", table.wavelength_nm, *PLAUSIBLE_NM),
        ("fwhm_nm", table.fwhm_nm, _LEAST_WIDTH_NM, widest),
        ("solar_irradiance", table.solar_irradiance, *_SUN),
    ):
        if array is None:
            continue
        if array.shape != widest.shape:
            raise UsageError(f"{name} is of shape {array.shape}", expected=f"shape {widest.shape}")
        wrong = np.flatnonzero(~((array >= least) & (array <= most)))
        if wrong.size:
            at = int(wrong[0])
            low, high = least, np.broadcast_to(most, array.shape)[at]
            raise UsageError(
                f"{name} is {array[at]:g} at {table.wavelength_nm[at]:g} nm", expected=f"{low:g} to {high:g}"
            )
