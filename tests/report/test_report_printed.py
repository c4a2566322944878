"""Figures for print are drawn from products.nc, and what is read back is what was written."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_run import make_run

from hyperval.cli.main import run as command
from hyperval.errors import InputError
from hyperval.report.netcdf import write_products
from hyperval.report.netcdf_read import read_products

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
    for side, original in zip(
        read_products(folder / "products.nc"), (run.prediction, run.observation), strict=True
    ):
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


@pytest.mark.parametrize(
    ("kind", "style"), [pytest.param("pdf", "journal", marks=pytest.mark.slow), ("png", "house")]
)
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
