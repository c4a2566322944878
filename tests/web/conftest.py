"""The whole application on this machine, its tasks carried out in this process under a stand-in atmosphere."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import requests

pytest.importorskip("fastapi", reason="needs the extra web")

from web_browser import BROWSER
from web_server import Server, serve

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from small_campaign import stand_in_atmosphere


def hazy(state: AtmosphericState, **options: Any) -> AtmosphericTerms:
    """The stand-in with a haze that follows the meteorological range, so that two ranges differ: 0.2 at 23 km."""
    depth = state.aot550 or 0.2 * 23.0 / (state.meteorological_range_km or 23.0)
    return stand_in_atmosphere(state.model_copy(update={"aot550": depth}), **options)


@pytest.fixture(scope="module")
def atmosphere() -> Iterator[None]:
    """A stand-in for the engine, for one file: tests of other files in this process have the engine itself."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HYPERVAL_WORKERS", "1")
        patch.setattr("hyperval.model.stated.atmospheric_terms", hazy)
        patch.setattr("hyperval.atmosphere.atmospheric_terms", hazy)
        yield


@pytest.fixture(scope="module")
def server(tmp_path_factory, atmosphere) -> Iterator[Server]:
    """A server for the tests of a file."""
    yield from serve(tmp_path_factory.mktemp("web"))


@pytest.fixture
def make_server(tmp_path, atmosphere) -> Iterator[Callable[..., Server]]:
    """Servers for one test."""
    running: list[Iterator[Server]] = []

    def make(folder: Path | None = None, **limits: Any) -> Server:
        running.append(serve(folder or tmp_path / f"web{len(running)}", **limits))
        return next(running[-1])

    yield make
    for one in running:
        list(one)


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """The distribution's own browser."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    with sync_api.sync_playwright() as play:
        one = play.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        yield one
        one.close()


@pytest.fixture
def client(server) -> requests.Session:
    return server.session()
