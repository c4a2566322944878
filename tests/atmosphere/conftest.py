"""States computed once for all tests of the room, in a cache of their own."""

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import pytest
from solver_nodes import run_solver_at

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms, atmospheric_terms


@pytest.fixture(scope="session")
def engine_cache(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("engine-cache")


@pytest.fixture(scope="session")
def terms_of(engine_cache):
    """Terms of a state, kept for the session."""

    @cache
    def compute(state: AtmosphericState) -> AtmosphericTerms:
        return atmospheric_terms(state, cache_dir=engine_cache, show_progress=False)

    return compute


@pytest.fixture
def solver_at(engine_cache, monkeypatch) -> Callable[..., Callable[..., AtmosphericTerms]]:
    """Terms by a solver that runs at the given wavelengths alone [nm]."""

    def run_at(*nodes_nm: float) -> Callable[..., AtmosphericTerms]:
        run_solver_at(monkeypatch, *nodes_nm)
        return partial(atmospheric_terms, cache_dir=engine_cache, show_progress=False)

    return run_at
