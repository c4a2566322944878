"""What the tests of several rooms share: a small campaign that runs in seconds."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from small_campaign import SmallCampaign, with_stand_in_atmosphere, without_figures, write_collection


@pytest.fixture(scope="session")
def small_collection(tmp_path_factory) -> Path:
    """The simulated files of the small campaign, written once; never change them, copy them."""
    folder = tmp_path_factory.mktemp("small")
    write_collection(folder)
    return folder


@pytest.fixture
def own_atmosphere(monkeypatch):
    """Predictions and simulations use the stand-in atmosphere."""
    with_stand_in_atmosphere(monkeypatch)


@pytest.fixture
def no_data(tmp_path, monkeypatch):
    """A machine without data: HYPERVAL_DATA is the test's own folder."""
    monkeypatch.setenv("HYPERVAL_DATA", str(tmp_path))
    monkeypatch.setenv("HYPERVAL_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def figures():
    """Reports of the small campaign with figures, charts and arrays: for a test that asks for this alone."""


@pytest.fixture
def make_small(small_collection, tmp_path, own_atmosphere, request, monkeypatch) -> Callable[..., SmallCampaign]:
    """Make copies of the small campaign, each in a folder of its own."""
    if "figures" not in request.fixturenames:
        without_figures(monkeypatch)

    def make(name: str = "small") -> SmallCampaign:
        shutil.copytree(small_collection, tmp_path / name)
        return SmallCampaign(tmp_path / name)

    return make


@pytest.fixture
def small(make_small) -> SmallCampaign:
    """A copy of the small campaign that passes as it stands."""
    return make_small()
