"""Built-in surfaces, class statistics and fills: what they promise, counted another way, and what cannot be."""

import numpy as np
import pytest

from hyperval import model
from hyperval.scenario import Geometry
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import builtin_class, builtin_mean

AXIS = SpectralAxis(np.linspace(380, 2480, 320), np.full(320, 7.0))


@pytest.mark.parametrize("name", ["grass", "soil", "yellow-paint-plank", "white-panel", "grey-panel-30"])
def test_a_surface_is_physical_and_of_full_rank(name):
    found = builtin_class(name, AXIS)
    assert builtin_mean(name, AXIS).tolist() == found.mean.tolist()
    assert np.all((found.mean > 0) & (found.mean < 1))
    eigenvalues = np.linalg.eigvalsh(found.covariance)
    assert eigenvalues[0] > 0
    assert eigenvalues[-1] / eigenvalues[0] < 1e6
    assert "not a measurement" in found.source


def neighbour_fill_geometry(length=1.0, width=1.4, heading=12.0, blur=1.0, phase="random"):
    sides = {"shape": "rectangle", "length_m": length, "width_m": width, "gsd_m": 0.7}
    return Geometry(**sides, heading_deg=heading, psf_fwhm_pixels=blur, phase=phase)


@pytest.mark.parametrize("blur", [0.5, 1.0, (1.0, 0.6)])
@pytest.mark.parametrize("heading", [0.0, 12.0, 80.0])
def test_alone_it_is_the_fill_of_the_object(blur, heading):
    own, others = model.shared_pixel_fills(neighbour_fill_geometry(heading=heading, blur=blur), 60, [])
    assert own == pytest.approx(model.object_fills(neighbour_fill_geometry(heading=heading, blur=blur), 60), abs=2e-4)
    assert others.shape == (377, 60, 0)


def test_the_neighbour_lies_where_it_is_said_to():
    """Lines first: a neighbour below fills pixels below, by another route at one stated place."""
    own = neighbour_fill_geometry(1.0, 1.0, 20.0, phase="centred")
    offset = (2.2, -0.7)
    fills, others = model.shared_pixel_fills(own, 25, [(own, offset)])
    mine = model.pixel_fills(own, [[0.0, 0.0]], [20.0])[0]
    beside = model.pixel_fills(own, [[offset[1] % 1.0 - 1.0, offset[0] % 1.0]], [20.0])[0]  # (x, y) within a pixel
    # Its grid is moved by whole pixels: two lines down, no sample (the -0.7 is already within a pixel's reach).
    shift = int(np.floor(offset[0])), int(np.floor(offset[1])) + 1
    half = mine.shape[0] // 2
    for rank in np.argsort(-mine.ravel(), kind="stable")[:6]:
        line, sample = np.unravel_index(rank, mine.shape)
        at = line - half - shift[0] + beside.shape[0] // 2, sample - half - shift[1] + beside.shape[1] // 2
        k = int(np.argmin(np.abs(fills[0] - mine[line, sample]) + np.abs(others[0, :, 0] - beside[at])))
        assert fills[0, k] == pytest.approx(mine[line, sample], abs=2e-4)
        assert others[0, k, 0] == pytest.approx(beside[at], abs=2e-4)


def test_places_known_roughly_never_fill_a_pixel_twice():
    rng = np.random.default_rng(1)
    square = neighbour_fill_geometry(2.0, 2.0, 0.0)
    own, others = model.shared_pixel_fills(square, 16, [(square, (0.0, 2.2))], rng.normal(0.0, 0.5, (377, 1, 2)))
    assert np.all(own + others.sum(axis=2) <= 1.0 + 1e-12)
