"""Empirical line: exact cases, Monte Carlo of its covariance, and every refusal."""

import numpy as np
import pytest

from hyperval.errors import UsageError
from hyperval.processing import MeasuredPanel, fit_elm, fit_line

GAIN, OFFSET = np.array([10.0, 6.0, 2.0]), np.array([1.0, 0.5, 0.1])


def panel(name, rho, sd=0.0, variance=0.0, radiance=None):
    rho = np.broadcast_to(np.asarray(rho, float), (3,))
    radiance = OFFSET + GAIN * rho if radiance is None else radiance
    return MeasuredPanel(name, rho, np.full(3, sd * abs(sd)), radiance, np.full(3, variance), 50)


def test_two_panels_are_exact():
    line = fit_elm([panel("black", 0.05, 0.01, 1e-4), panel("white", 0.6, 0.02, 1e-3)])
    assert line.gain == pytest.approx(GAIN, rel=1e-13)
    assert line.offset == pytest.approx(OFFSET, rel=1e-12)
    assert line.reflectance(line.radiance([0.2, 0.3, 0.4])) == pytest.approx([0.2, 0.3, 0.4], rel=1e-13)
    assert line.residuals == pytest.approx(np.zeros((2, 3)), abs=1e-13)
    assert np.isnan(line.reduced_chi2).all()
    assert line.leave_one_out is None
    # Closed form of two points: var k = (1/W1 + 1/W2)/(rho_2 - rho_1)^2 with 1/W = var L + k^2 var rho.
    inverse = (1e-4 + GAIN**2 * 0.01**2) + (1e-3 + GAIN**2 * 0.02**2)
    assert line.covariance[:, 0, 0] == pytest.approx(inverse / 0.55**2, rel=1e-12)


def test_panels_without_errors_are_ordinary_least_squares():
    rng = np.random.default_rng(1)
    rho = np.array([0.05, 0.2, 0.4, 0.7])
    panels = [panel(str(r), r, radiance=OFFSET + GAIN * r + rng.normal(0, 0.01, 3)) for r in rho]
    line = fit_elm(panels)
    for b in range(3):
        k, c = np.polyfit(rho, [p.radiance[b] for p in panels], 1)
        assert (line.gain[b], line.offset[b]) == pytest.approx((k, c), rel=1e-11)
    assert np.all(line.covariance == 0)


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
    assert line.leave_one_out[1] == pytest.approx(np.full(3, 0.06), abs=1e-9)  # the others fix the true line
    # With the wrong panel kept every other one misses; the darkest is an extrapolation and misses by more.
    assert np.all(np.abs(line.leave_one_out[[0, 2, 3]]) > 0.01)
    assert np.all(np.abs(line.leave_one_out[0]) > 0.06)
    assert np.all(line.reduced_chi2 > 10)
    assert fit_elm(panels).leave_one_out == pytest.approx(np.zeros((4, 3)), abs=1e-12)


def test_bands_without_contrast_are_marked_not_guessed():
    black, white = np.array([0.05, 0.05, 0.30]), np.array([0.6, 0.6, 0.33])
    line = fit_elm([panel("a", black), panel("b", white)])
    assert line.usable.tolist() == [True, True, False]
    assert np.isnan(line.gain[2])
    assert np.isnan(line.reflectance([1.0, 1.0, 1.0])[2])


@pytest.mark.parametrize(
    ("panels", "keywords", "message"),
    [
        ([panel("only", 0.5)], {}, "1 panel for"),
        ([panel("a", 0.55), panel("b", 0.6)], {}, "differ by 0.05"),
        ([panel("a", 0.5), panel("b", 0.5)], {}, "differ by 0"),
        ([panel("a", 5.0), panel("b", 60.0)], {}, "divide percent by 100"),
        ([panel("a", 0.05), panel("b", 0.6)], {"saturation": 6.9}, "'b' is saturated in 1 bands .first: band 1"),
        ([panel("a", 0.05, 0, 25.0), panel("b", 0.6, 0, 25.0)], {}, "gain is below 5 times"),
        ([panel("a", 0.6, radiance=GAIN * 0), panel("b", 0.05, radiance=GAIN)], {}, "check which panel"),
        ([panel("a", 0.05, 0.01), panel("b", 0.6)], {}, "some panels have an error"),
        ([panel("a", -0.2), panel("b", 0.6)], {}, "reflectance of -0.2"),
    ],
)
def test_refusals_give_their_reason(panels, keywords, message):
    with pytest.raises(UsageError, match=message):
        fit_elm(panels, **keywords)


def test_a_panel_with_gaps_is_refused():
    for other, message in ((panel("a", [0.1, np.nan, 0.1]), "NaN"), (panel("a", 0.1, -0.1), "negative")):
        with pytest.raises(UsageError, match=message):
            fit_elm([other, panel("b", 0.6)])
    with pytest.raises(UsageError, match="shape"):
        MeasuredPanel("a", np.ones(3), np.ones(2), np.ones(3), np.ones(3), 4)
