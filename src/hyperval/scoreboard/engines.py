"""Registry of atmosphere engines that the benchmark sets against each other."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hyperval import atmosphere
from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.atmosphere.table_files import read_table
from hyperval.errors import MissingDataError, UsageError
from hyperval.scenario import Scenario
from hyperval.scoreboard.transport import OutOfReach, nearest_state, transported
from hyperval.settings import with_settings

Resolve = Callable[[str], Path]
TermsOf = Callable[[AtmosphericState], AtmosphericTerms]


class NotApplicable(Exception):
    """An engine that cannot serve a scenario; the message says why, and becomes the reason of a SKIPPED row."""


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
        try:
            near, moves = nearest_state(table, state)
        except OutOfReach as error:
            raise NotApplicable(str(error)) from error
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
