"""Built-in surfaces, mixtures and fills: what they promise, and bad input."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.errors import UsageError
from hyperval.model import FillDistribution, TargetGeometry, average_reflectance, ranked_pixel_fill
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import builtin_class, builtin_mean

AXIS = SpectralAxis(np.linspace(380, 2480, 320), np.full(320, 7.0))
NAMES = [
    "grass", "asphalt", "soil", "yellow-paint-plank", "green-paint-plank",
    "white-panel", "black-panel", "grey-panel-30",
]  # fmt: skip


def at(name: str, wavelength_nm: float) -> float:
    return float(np.interp(wavelength_nm, AXIS.centre_nm, builtin_class(name, AXIS).mean))


@pytest.mark.parametrize("name", NAMES)
def test_a_surface_is_physical_and_of_full_rank(name):
    found = builtin_class(name, AXIS)
    assert builtin_mean(name, AXIS).tolist() == found.mean.tolist()
    assert np.all((found.mean > 0) & (found.mean < 1))
    eigenvalues = np.linalg.eigvalsh(found.covariance)
    assert eigenvalues[0] > 0
    assert eigenvalues[-1] / eigenvalues[0] < 1e6
    assert "not a measurement" in found.source


def test_grass_has_the_features_of_vegetation():
    assert at("grass", 550) > at("grass", 670) < 0.08  # green peak above the red well
    assert at("grass", 800) > 5 * at("grass", 670)  # red edge
    for dip, shoulder in ((975, 900), (1195, 1090), (1450, 1280), (1940, 1700)):
        assert at("grass", dip) < at("grass", shoulder)


@pytest.mark.parametrize("name", ["lawn", "grey-panel-x", "grey-panel-100"])
def test_unknown_surface(name):
    with pytest.raises(UsageError, match="unknown built-in surface"):
        builtin_class(name, AXIS)


@pytest.mark.parametrize("fractions", [[0.5, 0.4], [1.5, -0.5], []])
def test_fractions_that_are_no_partition(fractions):
    with pytest.raises(UsageError, match="not a partition"):
        average_reflectance(fractions, np.ones((len(fractions), 2)))


def test_binned_distribution_keeps_mean_and_nearly_the_variance():
    rng = np.random.default_rng(1)
    fill = FillDistribution(rng.random(2000), np.full(2000, 1 / 2000))
    binned = fill.binned(48)
    assert binned.values.size <= 48
    assert binned.mean == pytest.approx(fill.mean, rel=1e-12)
    # Within a bin of width h the lost variance is h^2/12 = (1/48)^2/12.
    assert fill.variance - binned.variance == pytest.approx((1 / 48) ** 2 / 12, rel=0.2)


@pytest.mark.parametrize("side", [0.3, 0.5, 0.77, 0.9])
def test_positions_are_enough(side):
    """The sampled positions against the closed form of a small square at a random place: mean within 1e-4."""
    found = ranked_pixel_fill(TargetGeometry(side, side, 1.0), 1)
    assert found.mean == pytest.approx((side - side**2 / 4) ** 2, rel=1e-4)


@pytest.mark.parametrize("bad", [{"length_m": 0.0}, {"gsd_m": -1.0}, {"psf_fwhm_pixels": -0.1}, {"length_m": 1000.0}])
def test_impossible_geometry(bad):
    with pytest.raises(UsageError):
        TargetGeometry(**{"length_m": 1.0, "width_m": 1.0, "gsd_m": 1.0, **bad})
