"""Figures for print are drawn from products.nc, and what is read back is what was written."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_run import make_run

from hyperval.campaign.sides import spread_curves
from hyperval.cli.main import run as command
from hyperval.errors import InputError
from hyperval.products import ObjectScores, ObservedProducts, PixelDistribution, PredictedProducts
from hyperval.report.figures import drawings_of
from hyperval.report.netcdf import read_products, write_products
from hyperval.report.style import Print
from hyperval.spectra.axis import SpectralAxis

BEGINNING = {"pdf": b"%PDF-", "png": b"\x89PNG"}


@pytest.fixture(scope="module")
def run():
    return make_run(bands=12, subjects=("grass",), curves=2)


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory):
    path = tmp_path_factory.mktemp("run")
    sides = {"predicted": run.prediction, "observed": run.observation}
    write_products(path / "products.nc", sides, title=run.title, simulated=True)
    return path


def test_products_are_read_as_they_were_written(run, folder):
    for side, original in zip(read_products(folder / "products.nc"), (run.prediction, run.observation), strict=True):
        assert side.axis.matches(original.axis)
        for name in ("radiance", "snr", "reflectance"):
            estimate, before = getattr(side, name)["grass"], getattr(original, name)["grass"]
            np.testing.assert_array_equal(estimate.mean, before.mean)
            np.testing.assert_allclose(estimate.standard_uncertainty, before.standard_uncertainty, rtol=1e-12)
            assert estimate.n == before.n
        assert {k: u.sum() for k, u in side.radiance["grass"].budget.items()} == pytest.approx(
            {k: u.sum() for k, u in original.radiance["grass"].budget.items()}
        )
        assert list(side.roc) == list(original.roc)
        for key, curve in original.roc.items():
            for name in ("pfa", "pd", "pd_lower", "pd_upper", "threshold"):
                np.testing.assert_array_equal(getattr(side.roc[key], name), getattr(curve, name))
            assert (side.roc[key].n_target, side.roc[key].n_background) == (curve.n_target, curve.n_background)
        assert side.scores == original.scores
        assert side.abundance == original.abundance


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
    write_products(tmp_path / "products.nc", {"predicted": predicted, "observed": measured}, title="", simulated=False)
    first, second = read_products(tmp_path / "products.nc")
    assert second.distribution["grass"] == law
    for name in ("effective_n", "distance", "exceedance"):
        np.testing.assert_array_equal(getattr(second.distribution["grass"], name), getattr(law, name))
        assert getattr(first.distribution["grass"], name) is None
    assert first.distribution["grass"].tail_dof == 5.0
    assert (first.distribution["grass"].n, first.distribution["grass"].samples) == (None, None)
    parts = [0.025, 0.3, 0.5, 0.975]
    read = np.quantile(first.object_scores["a", "cem"].values, parts)
    np.testing.assert_allclose(read, np.quantile(draws, parts), atol=1e-3)
    names = {d.name for d in drawings_of(tmp_path, Print("svg"), spread_curves)}
    assert {"object-scores", "object-transforms", "pixel-tails"} <= names


@pytest.mark.parametrize(("kind", "style"), [pytest.param("pdf", "journal", marks=pytest.mark.slow), ("png", "house")])
def test_figures_are_drawn_in_each_format(folder, tmp_path, kind, style):
    assert command(["figures", str(folder), "-o", str(tmp_path / "out"), "--format", kind, "--style", style]) == 0
    files = {p.name: p.read_bytes() for p in (tmp_path / "out").glob(f"*.{kind}")}
    assert {f"radiance-pair.{kind}", f"roc.{kind}", f"radiance-budget.{kind}", f"scores.{kind}"} <= set(files)
    assert all(content.startswith(BEGINNING[kind]) for content in files.values())
    assert b"CreationDate" not in b"".join(files.values())


def test_what_is_no_run_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"products\.nc"):
        read_products(tmp_path / "products.nc")
    (tmp_path / "products.nc").write_bytes(b"no netcdf")
    with pytest.raises(InputError, match="cannot be read"):
        read_products(tmp_path / "products.nc")
    assert command(["figures", str(tmp_path), "-o", str(tmp_path / "out")]) == 3
    assert not (tmp_path / "out").exists()
