"""One call for every engine: state in, terms out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hyperval.atmosphere.cache import cache_folder
from hyperval.atmosphere.modtran import modtran_terms
from hyperval.atmosphere.sixs import sixs_terms
from hyperval.atmosphere.state import AtmosphericState
from hyperval.atmosphere.table_files import read_table
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.errors import InputError

Resolve = Callable[[str], Path]


@dataclass(frozen=True)
class _Surroundings:
    """What an engine may use: the cache folder, whether to draw progress, where referenced files are."""

    folder: Path
    show_progress: bool | None
    resolve: Resolve


Engine = Callable[[AtmosphericState, _Surroundings], AtmosphericTerms]


def _table_terms(state: AtmosphericState, use: _Surroundings) -> AtmosphericTerms:
    assert state.table is not None  # noqa: S101 - the state's own check
    try:
        path = use.resolve(state.table)
    except InputError as error:
        if "a folder" not in error.what:
            raise
        raise InputError(
            "is a folder",
            where=state.table,
            expected="a NetCDF file, or the run template of a folder of channel files",
            mend=f"name the template: {state.table.rstrip('/')}/NAME.json",
        ) from error
    return read_table(path).terms(state)


ENGINES: dict[str, Engine] = {
    "sixs": lambda state, use: sixs_terms(state, use.folder, use.show_progress),
    "modtran": lambda state, use: modtran_terms(state, use.folder, use.show_progress),
    "table": _table_terms,
}


def atmospheric_terms(
    state: AtmosphericState,
    *,
    cache_dir: Path | None = None,
    show_progress: bool | None = None,
    resolve: Resolve | None = None,
) -> AtmosphericTerms:
    """The terms of equation 3.7 for one state, from the engine that the state names.

    Parameters
    ----------
    state : atmosphere, sun and sensor
    cache_dir : where results are kept; default HYPERVAL_CACHE or the user's cache folder
    show_progress : draw a progress bar; default: when standard error is a terminal
    resolve : turns the state's ``table`` into a path; default: relative to the working directory

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
    use = _Surroundings(cache_folder(cache_dir), show_progress, resolve or Path)
    return ENGINES[state.engine](state, use)
