"""Equations 3.7-3.12 against numbers worked out by hand, derivatives and Monte Carlo.

Worked atmosphere of one band: L_a = 2, A = 10, B = 3, S = 0.2.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from hyperval.atmosphere import AtmosphericTerms
from hyperval.model import (
    adjacency_slope,
    aperture_weights,
    average_reflectance,
    beta_fill,
    direct_slope,
    fill_distribution,
    fixed_fill,
    lattice_positions,
    mean_radiance,
    object_fills,
    pixel_fills,
    radiance_covariance,
    shared_pixel_fills,
    target_pixel_covariance,
    target_pixel_reflectance,
    toa_reflectance,
    touched_counts,
)
from hyperval.model.radiance import Background
from hyperval.scenario import Fill, Geometry
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import _SURFACES, _modes, builtin_class, builtin_mean


def atmosphere(bands: int = 1) -> AtmosphericTerms:
    one = np.ones(bands)
    return AtmosphericTerms(500 + 10 * np.arange(bands), 2 * one, 10 * one, 3 * one, 0.2 * one, one, one)


def test_3_7_mean_radiance_by_hand():
    # 1 - S rho_ave = 0.95; (10 * 0.4 + 3 * 0.25) / 0.95 = 4.75 / 0.95 = 5; plus 2 is 7.
    assert mean_radiance(atmosphere(), [0.4], [0.25]) == pytest.approx([7.0], rel=1e-14)
    # Printed: 4 / (1 - 0.08) = 4.347826; 0.75 / 0.95 = 0.789474; plus 2.
    assert mean_radiance(atmosphere(), [0.4], [0.25], "thesis") == pytest.approx([7.137299771], rel=1e-9)


def test_3_7_limits():
    black = mean_radiance(atmosphere(), [0.0], [0.0])
    assert black == pytest.approx([2.0])  # path radiance alone
    # Over uniform ground the printed and the corrected form are one: A + B share the trapping term.
    for form in ("corrected", "thesis"):
        assert mean_radiance(atmosphere(), [0.5], [0.5], form) == pytest.approx([2 + 6.5 / 0.9], rel=1e-14)


def test_3_7_is_the_sum_of_all_bounces():
    # Light that goes between ground and sky: sum of (S rho_ave)^n, n = 0, 1, 2...
    bounces = sum((0.2 * 0.25) ** n for n in range(40))
    assert mean_radiance(atmosphere(), [0.4], [0.25]) == pytest.approx([2 + (4 + 0.75) * bounces], rel=1e-14)


def test_3_8_average_and_mixture_by_hand():
    assert average_reflectance([0.25, 0.75], [[0.4], [0.2]]) == pytest.approx([0.25])
    # Within 0.25 * 4e-4 + 0.75 * 1e-4 = 1.75e-4; between 0.25 * 0.15^2 + 0.75 * 0.05^2 = 7.5e-3.
    f, means, spread = np.array([[0.25, 0.75]]), np.array([[[0.4], [0.2]]]), (np.array([[4e-4]]), np.array([[1e-4]]))
    found = Background(f, f**0, means, means - 0.25, spread, f[..., None] ** 0, (), f, f[0] > 1, {}).covariance()
    assert found == pytest.approx(np.array([[7.675e-3]]), rel=1e-12)


def test_3_10_target_pixel_by_hand():
    assert target_pixel_reflectance(0.4, [0.6], [0.1]) == pytest.approx([0.30])
    assert target_pixel_reflectance([0.0, 1.0], [0.6], [0.1]) == pytest.approx(np.array([[0.1], [0.6]]))


def test_3_11_slopes_by_hand_and_by_differences():
    assert direct_slope(atmosphere(), [0.25]) == pytest.approx([10 / 0.95])
    assert direct_slope(atmosphere(), [0.25], "thesis") == pytest.approx([12.5])
    assert adjacency_slope(atmosphere(), [0.4], [0.25]) == pytest.approx([3.8 / 0.9025])
    assert adjacency_slope(atmosphere(), [0.4], [0.25], "thesis") == pytest.approx([3.75])
    h = 1e-6
    pixel = (mean_radiance(atmosphere(), [0.4 + h], [0.25]) - mean_radiance(atmosphere(), [0.4 - h], [0.25])) / (2 * h)
    around = (mean_radiance(atmosphere(), [0.4], [0.25 + h]) - mean_radiance(atmosphere(), [0.4], [0.25 - h])) / (2 * h)
    assert direct_slope(atmosphere(), [0.25]) == pytest.approx(pixel, rel=1e-8)
    assert adjacency_slope(atmosphere(), [0.4], [0.25]) == pytest.approx(around, rel=1e-8)


def test_3_11_covariance_by_hand():
    # Sigma = 4e-4, Sigma_ave = 2.5e-3, kappa = 0.01, g_B = 2 on the adjacency term.
    # (10/0.95)^2 * 4e-4 = 0.04432133; 2 * 0.01 * (3.8/0.9025)^2 * 2.5e-3 = 8.864266e-4.
    found = radiance_covariance(atmosphere(), [0.4], [[4e-4]], [0.25], [[2.5e-3]], adjacency_gain=2.0, kappa=0.01)
    assert found == pytest.approx(np.array([[0.04432133 + 8.864266e-4]]), rel=1e-6)
    # Printed: 12.5^2 * 4e-4 + 3.75^2 * 2.5e-3, whatever kappa is.
    printed = radiance_covariance(atmosphere(), [0.4], [[4e-4]], [0.25], [[2.5e-3]], kappa=0.01, formulation="thesis")
    assert printed == pytest.approx(np.array([[0.0625 + 0.03515625]]), rel=1e-12)


def covariance_z(sample: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """(sample covariance - expected) in standard errors: normal data, var S_ij = (s_ii s_jj + s_ij^2)/(n-1)."""
    found = np.cov(sample.T)
    error = np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / (len(sample) - 1))
    return (found - expected) / error


def test_3_11_covariance_by_monte_carlo():
    """Pixel and neighbourhood drawn, the exact radiance formed: 6 entries, |z| < 5, false failure 4e-6."""
    rng = np.random.default_rng(311)
    terms, n, kappa = atmosphere(3), 1_000_000, 0.04
    rho, ave = np.array([0.3, 0.4, 0.2]), np.array([0.25, 0.3, 0.2])
    sigma = 1e-4 * np.array([[4, 2, 1], [2, 5, -1], [1, -1, 3]])
    sigma_ave = 1e-4 * np.array([[9, 5, 2], [5, 8, 3], [2, 3, 7]])
    pixel = rng.multivariate_normal(rho, sigma, n)
    around = rng.multivariate_normal(ave, kappa * sigma_ave, n)
    trapping = 1 - 0.2 * around
    radiance = 2 + (10 * pixel + 3 * around) / trapping
    expected = radiance_covariance(terms, rho, sigma, ave, sigma_ave, kappa=kappa)
    assert np.abs(covariance_z(radiance, expected)).max() < 5
    printed = radiance_covariance(terms, rho, sigma, ave, sigma_ave, kappa=kappa, formulation="thesis")
    assert np.abs(covariance_z(radiance, printed)).max() > 50  # the printed form is ruled out by the same draw


def test_3_12_by_hand():
    # f = 0.4 +- 0.1: E[f^2] = 0.17, E[(1-f)^2] = 0.37; contrast 0.5; g_T = 2, g_B = 3.
    # 0.17 * 2 * 1e-4 + 0.37 * 3 * 2e-4 + 0.01 * 0.25 = 2.756e-3
    common = {"target_gain": 2.0, "host_gain": 3.0}
    found = target_pixel_covariance(0.4, 0.01, [0.6], [[1e-4]], [0.1], [[2e-4]], **common)
    assert found == pytest.approx(np.array([[2.756e-3]]), rel=1e-12)
    # Printed: 0.16 * 2e-4 + 0.36 * 6e-4 = 2.48e-4
    printed = target_pixel_covariance(0.4, 0.0, [0.6], [[1e-4]], [0.1], [[2e-4]], **common)
    assert printed == pytest.approx(np.array([[2.48e-4]]), rel=1e-12)


def test_3_12_by_monte_carlo():
    """Fill, target and host drawn; per entry a z from 200 batches, |z| < 5, false failure under 1e-5."""
    rng = np.random.default_rng(312)
    n = 1_000_000
    target, host = np.array([0.6, 0.3]), np.array([0.1, 0.25])
    s_t, s_h = 1e-4 * np.array([[4, 1], [1, 2]]), 1e-4 * np.array([[3, -1], [-1, 5]])
    fill = beta_fill(0.4, 0.1)
    f = rng.choice(fill.values, n, p=fill.weights)[:, None]
    x = f * rng.multivariate_normal(target, s_t, n) + (1 - f) * rng.multivariate_normal(host, s_h, n)
    expected = target_pixel_covariance(fill.mean, fill.variance, target, s_t, host, s_h)
    batches = np.array([np.cov(part.T) for part in x.reshape(200, -1, 2)])
    z = (batches.mean(axis=0) - expected) / (batches.std(axis=0, ddof=1) / np.sqrt(200))
    assert np.abs(z).max() < 5
    printed = target_pixel_covariance(fill.mean, 0.0, target, s_t, host, s_h)
    assert expected[0, 0] / printed[0, 0] > 5  # the variance of the fill dominates at this contrast


def test_3_12_of_texture_that_is_finer_than_the_pixel():
    """A pixel of 100 facets, f of them target: by f Sigma_T; |z| < 5 over 200 batches, false failure 1e-6."""
    rng = np.random.default_rng(3121)
    facets, part, variance = 100, 30, 4e-4
    x = rng.normal(0.6, np.sqrt(variance * facets), (40_000, part)).sum(axis=1) / facets
    batches = x.reshape(200, -1).var(axis=1, ddof=1)

    def z(fine):
        expected = target_pixel_covariance(0.3, 0.0, [0.6], [[variance]], [0.0], [[0.0]], fine_texture=fine)[0, 0]
        return (batches.mean() - expected) / (batches.std(ddof=1) / np.sqrt(200))

    assert abs(z(1.0)) < 5
    assert z(0.0) > 40  # f squared is ruled out by the same draw
    assert z(0.5) > 40


def aligned_fill(length, width, offset, blur):
    """Fill of a pixel by an aligned rectangle in closed form; sides along y and x, offset (x, y) of centres."""

    def ramp(z, s):  # integral of the normal distribution function
        return z * ndtr(z / s) + s * np.exp(-0.5 * (z / s) ** 2) / np.sqrt(2 * np.pi) if s else max(z, 0.0)

    fill = 1.0
    for u, side, fwhm in zip(offset, (width, length), blur[::-1], strict=True):
        s = fwhm / (2 * np.sqrt(2 * np.log(2)))
        ends = [(sign, u + 0.5 * sign * side) for sign in (1, -1)]
        fill *= sum(sign * (ramp(end + 0.5, s) - ramp(end - 0.5, s)) for sign, end in ends)
    return fill


def test_the_closed_form_by_hand():
    # A square of 1 pixel side shifted by (0.25, 0.4): (1 - 0.25)(1 - 0.4) = 0.45 of the pixel.
    assert aligned_fill(1.0, 1.0, [0.25, 0.4], (0.0, 0.0)) == pytest.approx(0.45, rel=1e-14)
    # Side 0.5 inside the pixel: its area, 0.25.
    assert aligned_fill(0.5, 0.5, [0.1, 0.1], (0.0, 0.0)) == pytest.approx(0.25, rel=1e-14)


def rectangle(length: float, width: float, blur: Any = 0.0, **more: Any) -> Geometry:
    return Geometry(shape="rectangle", length_m=length, width_m=width, psf_fwhm_pixels=blur, **{"gsd_m": 1.0} | more)


@pytest.mark.parametrize("blur", [0.0, 0.7, 1.5, (1.4, 0.3), (0.0, 1.0), (1.0, 0.0)])
def test_pixel_fills_agree_with_the_closed_form_and_conserve_area(blur):
    geometry = rectangle(1.3, 0.8, blur, gsd_m=0.7)
    offset = np.array([[0.13, -0.31], [0.5, 0.5]])
    fills = pixel_fills(geometry, offset, [0.0, 0.0])
    half = fills.shape[1] // 2
    both = blur if isinstance(blur, tuple) else (blur, blur)
    for k in range(2):
        for along in (-1, 0, 1):
            for across in (-1, 0, 1):
                expected = aligned_fill(1.3 / 0.7, 0.8 / 0.7, offset[k] - [across, along], both)
                assert fills[k, half + along, half + across] == pytest.approx(expected, abs=1e-9)
    turned = pixel_fills(geometry, offset, [37.0, 81.0])
    for each in (fills, turned):
        assert each.sum(axis=(1, 2)) * 0.7**2 == pytest.approx([1.3 * 0.8] * 2, rel=1e-6)


def test_rotated_fill_by_counting_points():
    """1e6 points in the target, aperture alone: binomial, |z| < 5 over 9 pixels, false failure 5e-6."""
    rng = np.random.default_rng(7)
    n, angle = 1_000_000, np.deg2rad(30.0)
    along, across = rng.uniform(-1, 1, n) * 0.9, rng.uniform(-1, 1, n) * 0.4
    x = along * np.sin(angle) + across * np.cos(angle) + 0.2
    y = along * np.cos(angle) - across * np.sin(angle) - 0.1
    fills = pixel_fills(rectangle(1.8, 0.8, heading_deg=30.0), np.array([[0.2, -0.1]]), [30.0])[0]
    half = fills.shape[0] // 2
    for j in (-1, 0, 1):
        for i in (-1, 0, 1):
            part = np.mean((np.abs(x - i) <= 0.5) & (np.abs(y - j) <= 0.5))
            expected = fills[half + j, half + i] / (1.8 * 0.8)
            error = np.sqrt(max(expected * (1 - expected), 1e-9) / n)
            assert abs(part - expected) < 5 * error + 1e-9


def test_best_pixel_of_a_small_square_by_closed_form():
    # A square of side a < 1 at a random place: in one direction the best pixel holds a when it does not
    # cross an edge (probability 1 - a), else uniform between a/2 and a: mean a - a^2/4, squared for two.
    a = 0.6
    found = fill_distribution(Fill(geometry=rectangle(a, a)))
    assert found.mean == pytest.approx((a - a**2 / 4) ** 2, rel=1e-4)  # 377 positions stand for the integral
    centred = fill_distribution(Fill(geometry=rectangle(a, a, phase="centred")))
    assert (centred.mean, centred.variance) == pytest.approx((0.36, 0.0))


def test_places_on_the_grid_average_what_is_smooth():
    # Evenly spread over a pixel: mean 0, variance 1/12 in each direction, and no correlation.
    x, y = lattice_positions(377).T
    assert (x.mean(), y.mean(), (x * y).mean()) == pytest.approx((0.0, 0.0, 0.0), abs=2e-3)
    assert ((x**2).mean(), (y**2).mean()) == pytest.approx((1 / 12, 1 / 12), rel=1e-3)


def test_ranked_pixels_hold_the_whole_target():
    geometry = rectangle(1.0, 1.0, 0.5, pixels="ranked", n=4)
    objects = object_fills(geometry, 25)
    assert np.all(np.diff(objects, axis=1) <= 0)
    assert objects.sum(axis=1) == pytest.approx(np.ones(len(objects)), abs=1e-6)
    assert fill_distribution(Fill(geometry=geometry)).mean == pytest.approx(objects[:, :4].mean(), rel=1e-12)


def test_fills_by_moments():
    assert (fixed_fill(0.3).mean, fixed_fill(0.3).variance) == (0.3, 0.0)
    fill = beta_fill(0.4, 0.1)
    assert (fill.mean, fill.variance) == pytest.approx((0.4, 0.01), rel=1e-12)


def test_builtin_covariance_is_the_sum_of_its_modes():
    axis = SpectralAxis(np.linspace(400, 2450, 50), np.full(50, 10.0))
    surface = _SURFACES["grass"]
    modes = _modes(surface, builtin_mean("grass", axis), axis.centre_nm)
    expected = sum(np.outer(m, m) for m in modes) + surface["band_spread"] ** 2 * np.eye(50)
    assert builtin_class("grass", axis).covariance == pytest.approx(expected, rel=1e-12)


def test_builtin_mean_is_that_of_the_whole_statistics():
    axis = SpectralAxis(np.linspace(400, 2450, 50), np.full(50, 10.0))
    assert np.array_equal(builtin_mean("grass", axis), builtin_class("grass", axis).mean)
    assert builtin_mean("grey-panel-30", axis) == pytest.approx(0.3, rel=0.05)  # what its name says


def test_toa_reflectance_of_a_worked_sun():
    # mu0 = cos 60 deg, E0 = 180 uW cm-2 nm-1 at 1 au, the Earth at 1.01 au, L = 7 uW cm-2 sr-1 nm-1.
    white = 0.5 * 180.0 / (np.pi * 1.01**2)
    assert toa_reflectance([7.0, white], white) == pytest.approx([7.0 * np.pi * 1.0201 / 90.0, 1.0])


@pytest.mark.parametrize(("length", "width"), [(0.47, 0.47), (0.9, 0.3), (2.4, 1.1)])
def test_3_10_pixels_that_a_target_touches_are_as_many_as_steiner_says(length, width):
    """Mean number of unit squares that meet a convex figure: area + 1 + 2/pi of the perimeter where its
    heading is any, (1 + a)(1 + b) along the grid.  The 377 places of the lattice know it to 1 %."""
    along = rectangle(length, width, 1.0)
    anyhow = rectangle(length, width, 1.0, heading_deg="random")
    assert np.mean(touched_counts(along)) == pytest.approx((1 + length) * (1 + width), rel=0.01)
    assert np.mean(touched_counts(anyhow)) == pytest.approx(1 + length * width + 4 / np.pi * (length + width), rel=0.01)
    # The fullest pixel is among them, and blur puts a part of the area beside them all.
    of = [anyhow.model_copy(update={"pixels": which}) for which in ("touched", "best")]
    touched, best = (fill_distribution(Fill(geometry=geometry)) for geometry in of)
    assert np.nanmax(object_fills(of[0], 20)) == pytest.approx(object_fills(of[1], 1).max())
    assert touched.mean < best.mean
    assert touched.mean * np.mean(touched_counts(anyhow)) < length * width


def test_3_10_two_targets_share_a_pixel():
    # Two squares of one pixel side by side are a strip of two by one, whose fill is the sum of theirs.
    square = rectangle(1.0, 1.0, 0.8, phase="centred")
    own, others = shared_pixel_fills(square, 9, [(square, (0.0, 1.0))])
    strip = pixel_fills(rectangle(1.0, 2.0, 0.8), [[0.5, 0.0]], [0.0])[0]
    assert np.max(own + others[..., 0]) == pytest.approx(np.max(strip), abs=2e-4)
    assert own[0, 0] == pytest.approx(np.max(pixel_fills(square, [[0.0, 0.0]], [0.0])), abs=2e-4)


def test_3_10_weights_of_cells_along_one_direction():
    """Without blur, the overlap of intervals; with it, the integral of the response by the trapezium rule."""
    assert aperture_weights([0.25, 0.5, 1.5], 0, 2, 0.0).tolist() == [[0.25, 0.5], [0.0, 0.5]]
    sigma = 0.8 / np.sqrt(8.0 * np.log(2.0))
    below = np.linspace(-6.0, 0.3, 20_001)
    response = ndtr(below / sigma) - ndtr((below - 1.0) / sigma)
    weights = aperture_weights([-6.0, 0.3, 7.0], 0, 1, 0.8)[0]
    assert weights[0] == pytest.approx(float(np.trapezoid(response, below)), abs=1e-7)
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)
