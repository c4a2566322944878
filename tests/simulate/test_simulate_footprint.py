"""Fills by brute force against quadrature, conservation and limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from hyperval.model import TargetGeometry, pixel_fills
from hyperval.simulate.layout import centred_fill, pixel_weights, side_for_fill, square_footprint

SIGMA_PER_FWHM = 1.0 / (2.0 * math.sqrt(2.0 * math.log(2.0)))


def quadrature_fill(offset: float, side: float, fwhm: float) -> float:
    """One-dimensional fill of a pixel whose centre lies ``offset`` from the middle of a strip, by quadrature."""
    sigma = fwhm * SIGMA_PER_FWHM

    def response(x: float) -> float:
        return float(norm.cdf((x + 0.5) / sigma) - norm.cdf((x - 0.5) / sigma))

    return quad(response, -offset - side / 2, -offset + side / 2, epsabs=1e-12)[0]


@pytest.mark.parametrize("heading", [0.0, 17.0, 45.0, 90.0])
@pytest.mark.parametrize(("line", "sample"), [(10.5, 20.5), (10.13, 20.91)])
def test_the_fills_of_a_plank_add_up_to_its_area(heading, line, sample):
    for side in (0.3, 1.0, 2.4):
        fill = square_footprint(line, sample, side, heading, 1.1).fill
        assert fill.sum() == pytest.approx(side**2, rel=1e-5)
        assert fill.min() >= 0.0
        assert fill.max() <= 1.0 + 1e-9


@pytest.mark.parametrize("fwhm", [0.5, 1.0, 1.8])
@pytest.mark.parametrize("side", [0.25, 0.9, 2.2])
def test_an_unturned_plank_agrees_with_quadrature(fwhm, side):
    print_ = square_footprint(5.3, 8.8, side, 0.0, fwhm)
    lines = print_.first_line + np.arange(print_.fill.shape[0]) + 0.5
    samples = print_.first_sample + np.arange(print_.fill.shape[1]) + 0.5
    down = np.array([quadrature_fill(y - 5.3, side, fwhm) for y in lines])
    across = np.array([quadrature_fill(x - 8.8, side, fwhm) for x in samples])
    # 32 cells per pixel: the error of the midpoint rule is of the order 1/32^2, here on a fill up to 1.
    assert np.max(np.abs(print_.fill - down[:, None] * across[None, :])) < 1.2e-3


def test_a_finer_grid_comes_closer_to_quadrature():
    exact = quadrature_fill(0.0, 1.0, 1.0) ** 2
    errors = [abs(centred_fill(1.0, 1.0, cells) - exact) for cells in (16, 32, 64)]
    assert errors[0] > 3 * errors[1] > 9 * errors[2]  # the midpoint rule gains a factor of 4 each time
    assert errors[1] < 5e-4


def test_a_turned_plank_agrees_with_random_points():
    rng = np.random.default_rng(3)
    side, heading, fwhm = 1.3, 30.0, 1.0
    points = rng.uniform(-side / 2, side / 2, (200_000, 2))
    a = math.radians(heading)
    x, y = points @ np.array([math.cos(a), -math.sin(a)]), points @ np.array([math.sin(a), math.cos(a)])
    sigma = fwhm * SIGMA_PER_FWHM

    def response(u: np.ndarray) -> np.ndarray:
        return norm.cdf((u + 0.5) / sigma) - norm.cdf((u - 0.5) / sigma)

    # Pixel whose centre lies 1 right of and 0 below the centre of the plank.
    values = response(x - 1.0) * response(y) * side**2
    found = square_footprint(4.5, 4.5, side, heading, fwhm)
    fill = found.fill[4 - found.first_line, 5 - found.first_sample]
    # 5 standard errors: fails by chance once in 1.7 million runs; 5e-4 for the grid.
    assert abs(fill - values.mean()) < 5 * values.std() / math.sqrt(len(values)) + 5e-4


def test_without_blur_a_small_plank_fills_by_its_area():
    assert centred_fill(0.5, 0.01) == pytest.approx(0.25, abs=1e-6)


def test_a_large_plank_fills_its_middle_pixel():
    assert centred_fill(12.0, 1.0) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("fill", [0.03, 0.4, 0.8])
def test_the_side_gives_the_fill(fill):
    assert centred_fill(side_for_fill(fill, 1.0), 1.0) == pytest.approx(fill, abs=1e-9)


@pytest.mark.parametrize("fwhm", [0.3, 1.0, 2.5])
def test_pixel_weights_agree_with_quadrature(fwhm):
    weights = pixel_weights(fwhm)
    k = np.arange(weights.size) - weights.size // 2
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert np.array_equal(weights, weights[::-1])
    # Weight k is what a strip one pixel wide and k pixels away contributes.
    exact = [quadrature_fill(i, 1.0, fwhm) for i in k]
    assert np.max(np.abs(weights - exact)) < 1e-3


def test_the_model_and_the_simulation_find_the_same_fills():
    """Two routes that share no line: error functions and quadrature there, cells here."""
    rng = np.random.default_rng(11)
    for _ in range(6):
        side, fwhm, heading = rng.uniform(0.2, 1.8), rng.uniform(0.4, 1.5), rng.uniform(0.0, 90.0)
        dx, dy = rng.uniform(-0.5, 0.5, 2)
        geometry = TargetGeometry(side, side, 1.0, heading, fwhm)
        # A heading runs clockwise with lines counted downwards; the model's second axis points up.
        model = pixel_fills(geometry, [[dx, -dy]], [heading])[0][::-1]
        half = model.shape[0] // 2
        found = square_footprint(20.5 + dy, 20.5 + dx, side, heading, fwhm)
        here = np.zeros((41, 41))
        lines, samples = found.fill.shape
        here[found.first_line :, found.first_sample :][:lines, :samples] = found.fill
        window = here[20 - half : 21 + half, 20 - half : 21 + half]
        assert np.max(np.abs(window - model)) < 3e-4  # the cells' error on a fill up to 1
        assert model.max() > 0.02
