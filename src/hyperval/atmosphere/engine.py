"""One call for every engine: state in, terms out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hyperval.atmosphere.modtran import modtran_terms
from hyperval.atmosphere.sixs import emulator_terms, sixs_terms, terms_near
from hyperval.atmosphere.state import AtmosphericState
from hyperval.atmosphere.table import read_table
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.datasets import cache_root
from hyperval.errors import InputError, refuse
from hyperval.progress import bars

# State and cache folder: what computes the terms when they are asked for.
ENGINES: dict[str, Callable[[AtmosphericState, Path], AtmosphericTerms]] = {
    "sixs": sixs_terms,
    "modtran": modtran_terms,
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
