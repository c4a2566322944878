"""States computed once for all tests of the room, in a cache of their own."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms, atmospheric_terms, sixs


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
def solver_at(
    engine_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Callable[[AtmosphericState], AtmosphericTerms]]:
    """Terms by a solver that runs at the given wavelengths alone [nm], some below 1 um: there they stay the same.

    Twenty nodes of one hazy state take eight seconds, and between nodes there is but interpolation.
    """

    def run_at(*nodes_nm: float) -> Callable[[AtmosphericState], AtmosphericTerms]:
        nodes = np.array(nodes_nm)
        monkeypatch.setattr(sixs, "NODES_NM", nodes)
        monkeypatch.setattr(sixs, "_MOLECULAR", int(np.sum(nodes < 1000.0)))
        return partial(atmospheric_terms, cache_dir=engine_cache, show_progress=False)

    return run_at
