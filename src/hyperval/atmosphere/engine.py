"""One call for every engine: state in, terms out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hyperval.atmosphere.cache import cache_folder
from hyperval.atmosphere.modtran_run import modtran_terms
from hyperval.atmosphere.sixs import sixs_terms
from hyperval.atmosphere.state import AtmosphericState
from hyperval.atmosphere.terms import AtmosphericTerms

Engine = Callable[[AtmosphericState, Path, bool | None], AtmosphericTerms]

ENGINES: dict[str, Engine] = {"sixs": sixs_terms, "modtran": modtran_terms}


def atmospheric_terms(
    state: AtmosphericState, *, cache_dir: Path | None = None, show_progress: bool | None = None
) -> AtmosphericTerms:
    """The terms of equation 3.7 for one state, from the engine that the state names.

    Parameters
    ----------
    state : atmosphere, sun and sensor
    cache_dir : where results are kept; default HYPERVAL_CACHE or the user's cache folder
    show_progress : draw a progress bar; default: when standard error is a terminal

    Returns
    -------
    AtmosphericTerms on the engine's own grid (6S: 340-2600 nm by 2.5 nm); ``at_bands`` averages them
    over a sensor's bands.

    Raises
    ------
    EngineError : the engine cannot be started or failed.
    MissingDataError : the chosen solar spectrum is not at hand.
    """
    return ENGINES[state.engine](state, cache_folder(cache_dir), show_progress)
