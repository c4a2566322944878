"""Empirical line: exact cases, Monte Carlo of its covariance, errors between bands, and every refusal."""

import numpy as np
import pytest
from scipy import optimize

from hyperval.compare import chi_square_full, whitening
from hyperval.pixels import MeasuredPanel, fit_elm, fit_line
from hyperval.products import EstimatedPart

GAIN, OFFSET = np.array([10.0, 6.0, 2.0]), np.array([1.0, 0.5, 0.1])


def panel(name, rho, sd=0.0, variance=0.0, radiance=None):
    rho = np.broadcast_to(np.asarray(rho, float), (3,))
    radiance = OFFSET + GAIN * rho if radiance is None else radiance
    return MeasuredPanel(name, rho, np.full(3, sd * abs(sd)), radiance, np.full(3, variance), 50)


def test_two_panels_are_exact():
    line = fit_elm([panel("black", 0.05, 0.01, 1e-4), panel("white", 0.6, 0.02, 1e-3)])
    assert line.gain == pytest.approx(GAIN, rel=1e-13)
    assert line.offset == pytest.approx(OFFSET, rel=1e-12)
    assert line.reflectance(OFFSET + GAIN * np.array([0.2, 0.3, 0.4])) == pytest.approx([0.2, 0.3, 0.4], rel=1e-13)
    assert np.isnan(line.reduced_chi2).all()
    assert np.isnan(line.leave_one_out_errors).all()
    # Closed form of two points: var k = (1/W1 + 1/W2)/(rho_2 - rho_1)^2 with 1/W = var L + k^2 var rho.
    inverse = (1e-4 + GAIN**2 * 0.01**2) + (1e-3 + GAIN**2 * 0.02**2)
    assert line.covariance[:, 0, 0] == pytest.approx(inverse / 0.55**2, rel=1e-12)


def test_pearson_york_published_example():
    # Pearson's data with York's weights, the standard test of such fits (York et al. 2004, Table II).
    x = np.array([0.0, 0.9, 1.8, 2.6, 3.3, 4.4, 5.2, 6.1, 6.5, 7.4])[:, None]
    y = np.array([5.9, 5.4, 4.4, 4.6, 3.5, 3.7, 2.8, 2.8, 2.4, 1.5])[:, None]
    wx = np.array([1000, 1000, 500, 800, 200, 80, 60, 20, 1.8, 1.0])[:, None]
    wy = np.array([1.0, 1.8, 4, 8, 20, 20, 70, 70, 100, 500])[:, None]
    fit = fit_line(x, y, 1 / wx, 1 / wy)
    assert fit.slope[0] == pytest.approx(-0.480533407, abs=1e-9)
    assert fit.intercept[0] == pytest.approx(5.47991022, abs=1e-8)
    assert np.sqrt(fit.covariance[0, 0, 0]) == pytest.approx(0.0579850090, abs=1e-8)
    assert np.sqrt(fit.covariance[0, 1, 1]) == pytest.approx(0.294970735, abs=1e-7)
    assert fit.reduced_chi2[0] == pytest.approx(1.4833, abs=1e-4)


def test_covariance_and_chi_square_by_monte_carlo():
    # 4000 draws: the sample sd is good to 1.1 %, the mean chi-square to 1.6 %; bands of 5 sd (below 1e-5).
    rng = np.random.default_rng(2)
    draws, rho = 4000, np.array([0.04, 0.15, 0.35, 0.55])[:, None]
    u_rho, u_l = np.array([0.003, 0.004, 0.006, 0.008])[:, None], np.array([0.02, 0.03, 0.05, 0.06])[:, None]
    shape = (4, draws)
    x = rho + u_rho * rng.normal(size=shape)
    y = 0.4 + 8.0 * rho + u_l * rng.normal(size=shape)
    fit = fit_line(x, y, np.broadcast_to(u_rho**2, shape), np.broadcast_to(u_l**2, shape))
    seen = np.cov(np.stack([fit.slope, fit.intercept]))
    stated = fit.covariance.mean(axis=0)
    assert np.sqrt(np.diag(seen)) == pytest.approx(np.sqrt(np.diag(stated)), rel=0.055)
    assert seen[0, 1] / np.sqrt(seen[0, 0] * seen[1, 1]) == pytest.approx(
        stated[0, 1] / np.sqrt(stated[0, 0] * stated[1, 1]), abs=0.05
    )
    assert fit.slope.mean() == pytest.approx(8.0, abs=5 * fit.slope.std() / np.sqrt(draws))
    assert fit.reduced_chi2.mean() == pytest.approx(1.0, abs=0.08)


def test_leave_one_out_finds_the_wrong_panel():
    panels = [panel(f"{r:g}", r, 0.002, 1e-4) for r in (0.03, 0.2, 0.45, 0.65)]
    wrong = panel("0.2", 0.2, 0.002, 1e-4, radiance=OFFSET + GAIN * 0.26)
    line = fit_elm([panels[0], wrong, *panels[2:]])
    assert line.leave_one_out_errors[1] == pytest.approx(np.full(3, 0.06), abs=1e-9)  # the others fix the true line
    # With the wrong panel kept every other one misses; the darkest is an extrapolation and misses by more.
    assert np.all(np.abs(line.leave_one_out_errors[[0, 2, 3]]) > 0.01)
    assert np.all(np.abs(line.leave_one_out_errors[0]) > 0.06)
    assert np.all(line.reduced_chi2 > 10)
    assert fit_elm(panels).leave_one_out_errors == pytest.approx(np.zeros((4, 3)), abs=1e-12)


def test_bands_without_contrast_are_marked_not_guessed():
    black, white = np.array([0.05, 0.05, 0.30]), np.array([0.6, 0.6, 0.33])
    line = fit_elm([panel("a", black), panel("b", white)])
    assert line.usable.tolist() == [True, True, False]
    assert np.isnan(line.gain[2])
    assert np.isnan(line.reflectance([1.0, 1.0, 1.0])[2])


def seen(name, rho, radiance, u_rho=0.0, variance=0.0):
    rho, radiance = np.atleast_1d(rho).astype(float), np.atleast_1d(radiance).astype(float)
    return MeasuredPanel(name, rho, np.full(rho.shape, u_rho**2), radiance, np.full(rho.shape, variance), 25)


def test_one_panel_gives_the_ratio_and_its_variance():
    line = fit_elm([seen("white", [0.5, 0.6], [10.0, 9.0], 0.01, 0.04)], intercept=False)
    assert line.gain == pytest.approx([20.0, 15.0])
    assert not line.offset.any()
    # First order: var k = (var L + k^2 var rho)/rho^2.
    assert line.covariance[:, 0, 0] == pytest.approx([(0.04 + 400 * 1e-4) / 0.25, (0.04 + 225 * 1e-4) / 0.36])
    assert line.reflectance([5.0, 9.0]) == pytest.approx([0.25, 0.6])
    assert np.isnan(line.reduced_chi2).all()
    assert np.isnan(line.leave_one_out_errors).all()


def test_a_line_is_known_by_the_pixels_of_its_panels():
    """Reflectances of a right line are refused as often as stated, and too often where it counts as known exactly.

    400 lines through two panels of 40 pixels in 8 bands.  A share of 0.05 is above 0.083 once in 500.
    """
    rng = np.random.default_rng(7)
    bands, pixels, gain = 8, 40, np.linspace(8.0, 20.0, 8)
    true = 0.04 * (np.eye(bands) + 0.5)
    root, rho = np.linalg.cholesky(true), (0.1, 0.5)
    refused = np.zeros(2)
    for _ in range(400):
        made = []
        for r in rho:
            seen = gain * r + rng.standard_normal((pixels, bands)) @ root.T
            part = EstimatedPart(np.cov(seen.T) / pixels, pixels - 1.0)
            values = np.full(bands, r), np.zeros(bands), seen.mean(axis=0), part.covariance
            made.append(MeasuredPanel(str(r), *values, pixels, part))
        fit = fit_elm(made)
        level = gain * 0.3
        difference, error, parts = fit.reflectance(level) - 0.3, fit.error_covariance(level), fit.estimated_parts(level)
        np.testing.assert_allclose(sum(p.covariance for p in parts), error, rtol=1e-9)
        refused += [chi_square_full(difference, whitening(error, known)).p_value < 0.05 for known in (parts, ())]
    assert refused[0] / 400 < 0.083
    assert refused[1] / 400 > 0.1


def test_gain_without_offset_is_the_least_of_its_sum_of_squares():
    rho, radiance = np.array([0.1, 0.4, 0.7]), np.array([2.6, 7.4, 14.9])
    u, variance = np.array([0.03, 0.01, 0.02]), np.array([0.01, 0.09, 0.04])
    made = [seen(str(i), *v) for i, v in enumerate(zip(rho, radiance, u, variance, strict=True))]
    line = fit_elm(made, intercept=False)

    def squares(k):
        return float(np.sum((radiance - k * rho) ** 2 / (variance + k**2 * u**2)))

    best = optimize.minimize_scalar(squares, bounds=(10.0, 40.0), method="bounded", options={"xatol": 1e-10})
    assert line.gain[0] == pytest.approx(best.x, rel=1e-6)
    assert line.reduced_chi2[0] == pytest.approx(best.fun / 2, rel=1e-9)


def _panels(bands: int = 6):
    rho = (np.full(bands, 0.1), np.full(bands, 0.6))
    gain, offset = np.linspace(10, 20, bands), np.linspace(1, 2, bands)
    made = [
        MeasuredPanel(name, r, np.outer(0.02 * r, 0.02 * r), offset + gain * r, (0.01 * gain) ** 2, 100)
        for name, r in zip(("dark", "bright"), rho, strict=True)
    ]
    return made, gain, offset


def test_line_of_two_panels_has_the_variance_of_the_closed_form_and_the_correlation_of_its_panels():
    panels, gain, offset = _panels()
    found = fit_elm(panels)
    rho = np.full(6, 0.3)
    level = offset + gain * rho
    c = found.error_covariance(level)
    of = found.covariance
    variance = (rho**2 * of[:, 0, 0] + 2.0 * rho * of[:, 0, 1] + of[:, 1, 1]) / found.gain**2
    np.testing.assert_allclose(np.diag(c), variance, rtol=1e-4)
    # By hand: weights (0.6 - 0.3) / 0.5 and (0.3 - 0.1) / 0.5 of the two panels' errors.
    systematic = (0.6 * 0.02 * 0.1) ** 2 + (0.4 * 0.02 * 0.6) ** 2
    np.testing.assert_allclose(c[0, 1], systematic, rtol=1e-4)
    np.testing.assert_allclose(c[0, 0] - c[0, 1], (0.6**2 + 0.4**2) * 0.01**2, rtol=1e-4)


def test_a_panel_of_the_line_keeps_the_error_of_its_reflectance_alone():
    panels, _, _ = _panels()
    found = fit_elm(panels)
    c = found.error_covariance(panels[1].radiance, own="bright")
    np.testing.assert_allclose(c, (0.02 * 0.6) ** 2, rtol=1e-3)
