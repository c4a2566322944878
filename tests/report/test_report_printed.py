"""Figures for print are drawn from products.nc, and what is read back is what was written."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_run import make_run

from hyperval.campaign import spread_curves
from hyperval.cli.main import run as command
from hyperval.errors import InputError
from hyperval.figures import Print
from hyperval.products import ObjectScores, ObservedProducts, PixelDistribution, PredictedProducts
from hyperval.report.html import run_drawings
from hyperval.run import read_pair, write_products
from hyperval.spectra import SpectralAxis

BEGINNING = {"pdf": b"%PDF-", "png": b"\x89PNG"}


@pytest.fixture(scope="module")
def run():
    return make_run(bands=12, subjects=("grass",), curves=2)


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory):
    path = tmp_path_factory.mktemp("run")
    sides = {"predicted": run.prediction, "observed": run.observation}
    write_products(path, sides, title=run.title, simulated=True)
    return path


def test_spread_of_pixels_and_scores_of_objects_are_read_as_laws(tmp_path):
    """Of a predicted score the file has quantiles: the values read have these, to a hundredth of their spread."""
    axis = SpectralAxis(np.array([500.0, 600.0]), 10.0)
    law = PixelDistribution(
        6.0, 5.0, 8.0, 0.01, 2, 7.0, 6.0, 9.0, 2, 50, np.array([30.0, 20.0]), np.linspace(0.1, 9.0, 7),
        np.linspace(0.9, 0.0, 7), 5,
    )  # fmt: skip
    draws = np.random.default_rng(3).normal(0.5, 0.1, (40, 50))
    predicted = PredictedProducts(
        axis, distribution={"grass": PixelDistribution(5.0)}, object_scores={("a", "cem"): ObjectScores(draws)}
    )
    measured = ObservedProducts(
        axis, distribution={"grass": law}, object_scores={("a", "cem"): ObjectScores(np.array([0.4]), ("a1",))}
    )
    write_products(tmp_path, {"predicted": predicted, "observed": measured}, title="", simulated=False)
    first, second = read_pair(tmp_path)
    assert second.distribution["grass"] == law
    assert (first.distribution["grass"].tail_dof, first.distribution["grass"].n) == (5.0, None)
    parts = [0.025, 0.3, 0.5, 0.975]
    read = np.quantile(first.object_scores["a", "cem"].values, parts)
    np.testing.assert_allclose(read, np.quantile(draws, parts), atol=1e-3)
    names = {d.name for d in run_drawings(tmp_path, Print("svg"), spread_curves)}
    assert {"object-scores", "object-transforms", "pixel-tails"} <= names


@pytest.mark.parametrize(("kind", "style"), [pytest.param("pdf", "journal", marks=pytest.mark.slow), ("png", "house")])
def test_figures_are_drawn_in_each_format(folder, tmp_path, kind, style):
    assert command(["figures", str(folder), "-o", str(tmp_path / "out"), "--format", kind, "--style", style]) == 0
    files = {p.name: p.read_bytes() for p in (tmp_path / "out").glob(f"*.{kind}")}
    assert {f"radiance.{kind}", f"roc.{kind}", f"radiance-budget.{kind}", f"scores.{kind}"} <= set(files)
    assert all(content.startswith(BEGINNING[kind]) for content in files.values())
    assert b"CreationDate" not in b"".join(files.values())


def test_what_is_no_run_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"products\.nc"):
        read_pair(tmp_path)
    (tmp_path / "products.nc").write_bytes(b"no netcdf")
    with pytest.raises(InputError, match="cannot be read"):
        read_pair(tmp_path)
    assert command(["figures", str(tmp_path), "-o", str(tmp_path / "out")]) == 3
    assert not (tmp_path / "out").exists()
