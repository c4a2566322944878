"""Engines that the benchmark sets against each other, and a table's terms brought to states near it.

A table of few nodes serves any state near it as 6S, corrected by the ratio that the table has to it at its nodes:

    T(state) = T_6S(state) r(state)        r = T_table / T_6S at the nodes, each term, channel by channel

with r multilinear between the nodes and that of the table's edge beside it.  The ratio of two engines varies far
less over the state than their terms do, so two nodes of haze do, a budget may move inputs off the table, and ozone
or the sun may differ a little from what the table was computed for.  At a node this is the table itself.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval import atmosphere
from hyperval.atmosphere import AtmosphericState, AtmosphericTerms, solar
from hyperval.atmosphere.interpolation import Interpolator, Rule
from hyperval.atmosphere.table import AXES, NAMED, AtmosphericTable, coordinates
from hyperval.atmosphere.table_files import read_table
from hyperval.errors import MissingDataError, UsageError
from hyperval.scenario import Scenario
from hyperval.settings import with_settings
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.response import band_average

Array = npt.NDArray[np.float64]
TermsOf = Callable[[AtmosphericState], AtmosphericTerms]

# How far a state may lie from the table, and the unit.  Beyond, 6S would tell more than the table.
REACH: dict[str, tuple[float, str]] = {
    "aot550": (0.05, "at 550 nm"),
    "water_vapour_g_cm2": (0.5, "g cm-2"),
    "ozone_atm_cm": (0.05, "atm cm"),
    "ground_altitude_km": (0.15, "km"),  # 2 % of the air
    "sensor_altitude_km": (0.1, "km"),
    "solar_zenith_deg": (1.0, "deg"),
    "view_zenith_deg": (0.5, "deg"),
    "relative_azimuth_deg": (5.0, "deg"),
}
_SUNLIT = ("path_radiance", "direct", "adjacency", "ground_irradiance")
_LEAST = 1e-12  # of a term at which a ratio is formed [its unit]
_FINE_NM = 0.5


class NotApplicable(Exception):
    """An engine that cannot serve a scenario; the message says why, and becomes the reason of a SKIPPED row."""


class OutOfReach(NotApplicable):
    """A state that the table does not serve; the message says which input."""


def nearest_state(table: AtmosphericTable, state: AtmosphericState) -> tuple[AtmosphericState, list[str]]:
    """The state of the table next to ``state``, and in words what differs.

    Raises
    ------
    OutOfReach : another standard atmosphere or aerosol, or an input farther off than :data:`REACH`.
    """
    given = state.model_dump(mode="json")
    for name in NAMED:
        if name in table.fixed and table.fixed[name] != given[name]:
            raise OutOfReach(f"{name} is {given[name]!r}, the table's {table.fixed[name]!r}")
    at, near, moves = coordinates(state), {}, []
    for name in AXES:
        if name in table.axes:
            low, high = float(table.axes[name][0]), float(table.axes[name][-1])
            span, there = f"{low:g} to {high:g}", float(np.clip(at[name], low, high))
        elif name in table.fixed:
            there = float(table.fixed[name])
            span = f"{there:g}"
        else:
            continue
        if name == "relative_azimuth_deg" and at["view_zenith_deg"] == 0.0:
            there = at[name]  # every azimuth is the same at nadir
        reach, unit = REACH[name]
        if abs(there - at[name]) > reach:
            raise OutOfReach(f"{name} is {at[name]:.4g}, the table holds {span}: more than {reach:g} {unit} away")
        near[name] = there
        if there != at[name]:
            moves.append(f"{name} {there:.4g} to {at[name]:.4g}")
    return _moved(state, near), moves


def _moved(state: AtmosphericState, near: dict[str, float]) -> AtmosphericState:
    """The state with its sun as angles and the inputs of the table."""
    zenith, azimuth = state.sun
    data: dict[str, Any] = state.model_dump(mode="python", exclude_unset=True)
    for name in ("latitude_deg", "longitude_deg", "time_utc", "day_of_year", "meteorological_range_km", "table"):
        data.pop(name, None)
    data |= {
        "engine": "sixs", "solar_zenith_deg": zenith, "solar_azimuth_deg": azimuth,
        "earth_sun_distance_au": state.distance_au, "aot550": state.aerosol_optical_depth,
    }  # fmt: skip
    if state.aerosol == "none":
        del data["aot550"]
    relative = near.pop("relative_azimuth_deg", None)
    data |= near
    if relative is not None:
        data["solar_azimuth_deg"] = state.view_azimuth_deg + relative
    return AtmosphericState.model_validate(data)


def transported(table: AtmosphericTable, near: AtmosphericState, other: TermsOf) -> TermsOf:
    """The table's terms at its nodes, and near them those of ``other`` times the ratio of the two.

    The sun is that of the state's solar spectrum, averaged over the channels: engines are compared, not suns.

    Parameters
    ----------
    near : the state of the table next to those that will be asked for: it has what all nodes share
    """
    width = table.fwhm_nm if table.fwhm_nm is not None else np.gradient(table.wavelength_nm)
    # The other engine ends at 340 and 2600 nm; no band of a sensor needs the outermost channels.
    inner = (table.wavelength_nm - width >= 342.0) & (table.wavelength_nm + width <= 2598.0)
    channels = SpectralAxis(table.wavelength_nm[inner], width[inner])
    seen: dict[AtmosphericState, AtmosphericTerms] = {}

    def other_at(state: AtmosphericState) -> AtmosphericTerms:
        if state not in seen:
            seen[state] = other(state).at_bands(channels)
        return seen[state]

    nodes = list(itertools.product(*table.axes.values()))
    own, ratios = table.terms(near), []
    for node in nodes:
        state = _moved(near, dict(zip(table.axes, map(float, node), strict=True)))
        exact = _under_sun(table.terms(state), table, state, inner, channels)
        ratios.append({name: _ratio(value, getattr(other_at(state), name)) for name, value in exact.items()})
    stack = {name: np.stack([r[name] for r in ratios]) for name in ratios[0]}
    between = Interpolator(table.axes, dict.fromkeys(table.axes, Rule("linear")), stack)

    def terms_of(state: AtmosphericState) -> AtmosphericTerms:
        at = coordinates(state)
        edge = {name: np.clip([at[name]], nodes[0], nodes[-1]) for name, nodes in table.axes.items()}
        here = other_at(state)
        changed = {name: getattr(here, name) * ratio[0] for name, ratio in between(edge).items()}
        record = {**own.provenance, "solar_spectrum": state.solar_spectrum, "state": state.model_dump(mode="json")}
        record["between_nodes"] = "6S times the ratio of the table to it"
        return replace(here, **changed, provenance=record, fwhm_nm=channels.fwhm_nm)

    return terms_of


def _ratio(a: Array, b: Array) -> Array:
    """a / b, 0 where b is nothing: there neither engine has light."""
    known = (b > _LEAST) & np.isfinite(a)
    return np.where(known, a / np.where(known, b, 1.0), 0.0)


def _under_sun(
    terms: AtmosphericTerms,
    table: AtmosphericTable,
    state: AtmosphericState,
    inner: npt.NDArray[np.bool_],
    channels: SpectralAxis,
) -> dict[str, Array]:
    """The terms in the channels that are kept, under the solar spectrum of the state in place of the table's."""
    kept = {
        name: np.asarray(getattr(terms, name))[inner]
        for name in (*_SUNLIT, "spherical_albedo", "gas_transmittance")
    }
    if table.solar_irradiance is None:
        return kept
    fine = np.arange(channels.centre_nm[0] - 30.0, channels.centre_nm[-1] + 30.0, _FINE_NM)
    sun = solar.extraterrestrial_irradiance(state.solar_spectrum, fine, 1.0)
    factor = band_average(fine, sun[None], channels)[0] / table.solar_irradiance[inner]
    return kept | {name: kept[name] * factor for name in _SUNLIT}


Resolve = Callable[[str], Path]


@dataclass(frozen=True)
class Served:
    """A scenario as an engine serves it.

    Attributes
    ----------
    terms_of : stands in for the engine that the scenario names; None: the one it names
    note : what the reader must know of it
    """

    scenario: Scenario
    terms_of: TermsOf | None = None
    note: str = ""


@dataclass(frozen=True)
class Engine:
    """An entry of the registry.

    Attributes
    ----------
    serve : (scenario, finder of files) -> Served; raises :class:`NotApplicable`
    """

    name: str
    title: str
    serve: Callable[[Scenario, Resolve], Served]


ENGINES: dict[str, Engine] = {}


def register_engine(engine: Engine) -> Engine:
    """Add an engine: every campaign with an atmosphere gives it a row.

    Raises
    ------
    UsageError : the name is taken.
    """
    if ENGINES.get(engine.name, engine) is not engine:
        raise UsageError(f"there is an engine {engine.name!r} already")
    ENGINES[engine.name] = engine
    return engine


def state_of(scenario: Scenario) -> AtmosphericState:
    """The atmosphere of a scenario, or NotApplicable."""
    if scenario.atmosphere is None:
        raise NotApplicable("the collection holds reflectance: no engine takes part")
    return scenario.atmosphere


def _embedded(scenario: Scenario, resolve: Resolve) -> Served:
    if state_of(scenario).engine == "sixs":
        return Served(scenario)
    return Served(with_settings(scenario, {"atmosphere.engine": "sixs", "atmosphere.table": None}))


def _own_modtran(scenario: Scenario, resolve: Resolve) -> Served:
    if state_of(scenario).engine == "modtran":
        return Served(scenario)
    if not os.environ.get("HYPERVAL_MODTRAN"):
        raise NotApplicable("HYPERVAL_MODTRAN names no executable")
    return Served(with_settings(scenario, {"atmosphere.engine": "modtran", "atmosphere.table": None}))


def table_engine(name: str, title: str, files: tuple[str, ...], template: str) -> Engine:
    """An engine from channel files that MODTRAN wrote for a grid of states.

    Parameters
    ----------
    files : references of the channel files, all in one folder
    template : reference of the run template
    """

    def serve(scenario: Scenario, resolve: Resolve) -> Served:
        state = state_of(scenario)
        try:
            paths = [resolve(reference) for reference in files]
            table = read_table(paths[0].parent, resolve(template))
        except MissingDataError as error:
            raise NotApplicable(str(error)) from error
        near, moves = nearest_state(table, state)
        note = "solar spectrum of the scenario; between and beside the nodes 6S times the ratio of the table to it"
        if moves:
            note += f", from the table's {', '.join(moves)}"
        return Served(scenario, transported(table, near, _sixs), note)

    return Engine(name, title, serve)


def _sixs(state: AtmosphericState) -> AtmosphericTerms:
    return atmosphere.atmospheric_terms(state.model_copy(update={"engine": "sixs", "table": None}))


def _grid(folder: str, depths: tuple[str, ...], waters: tuple[str, ...], ending: str) -> tuple[str, ...]:
    return tuple(f"{folder}/AOT550-{a}_H2OSTR-{w}.chn{ending}" for a in depths for w in waters)


register_engine(Engine("sixs", "6S, embedded", _embedded))
register_engine(Engine("modtran", "MODTRAN of the user", _own_modtran))
register_engine(
    table_engine(
        "modtran6-pasadena",
        "MODTRAN 6 table of the Pasadena flight",
        _grid("data:pasadena/lut", ("0.0100", "0.1000"), ("1.5000", "2.0000"), ""),
        "data:pasadena/templates/ang20171108t184227_modtran.json",
    )
)
register_engine(
    table_engine(
        "modtran6-airborne",
        "MODTRAN 6 table of an airborne campaign",
        _grid("data:modtran/modtran6_airborne_lut", ("0.0500", "0.2000"), ("0.7500", "1.2500", "2.2500"), ".gz"),
        "data:modtran/modtran6_airborne_lut/modtran_template.json",
    )
)
