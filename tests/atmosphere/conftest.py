"""States computed once for all tests of the room, in a cache of their own."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

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
