"""Gain without offset and the darkest pixel: closed forms, Monte Carlo of the stated variance, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.errors import UsageError
from hyperval.processing import MeasuredPanel, darkest_pixel_panel, fit_elm


def panel(name, rho, radiance, u_rho=0.0, variance=0.0):
    rho, radiance = np.atleast_1d(rho).astype(float), np.atleast_1d(radiance).astype(float)
    return MeasuredPanel(name, rho, np.full(rho.shape, u_rho**2), radiance, np.full(rho.shape, variance), 25)


def test_one_panel_gives_the_ratio_and_its_variance():
    line = fit_elm([panel("white", [0.5, 0.6], [10.0, 9.0], 0.01, 0.04)], intercept=False)
    assert line.gain == pytest.approx([20.0, 15.0])
    assert not line.offset.any()
    # First order: var k = (var L + k^2 var rho)/rho^2.
    assert line.covariance[:, 0, 0] == pytest.approx([(0.04 + 400 * 1e-4) / 0.25, (0.04 + 225 * 1e-4) / 0.36])
    assert line.reflectance([5.0, 9.0]) == pytest.approx([0.25, 0.6])
    assert np.isnan(line.reduced_chi2).all()
    assert line.leave_one_out is None


def test_error_free_panels_give_least_squares():
    rho, radiance = np.array([0.1, 0.3, 0.6]), np.array([2.1, 5.8, 12.3])
    line = fit_elm([panel(str(i), r, x) for i, (r, x) in enumerate(zip(rho, radiance, strict=True))], intercept=False)
    assert line.gain[0] == pytest.approx(rho @ radiance / (rho @ rho))
    assert line.leave_one_out.shape == (3, 1)


def test_the_stated_variance_is_that_of_repetition():
    # 4,000 repetitions: the sd of an sd is 1.1 %, five of them allowed (fixed seed; fails by chance below 1e-6).
    rng = np.random.default_rng(0)
    truth, rho = 20.0, np.array([0.2, 0.5, 0.7])
    n, u, s = 4000, 0.01, 0.15
    seen = [
        panel(str(i), r + u * rng.normal(size=n), truth * r + s * rng.normal(size=n), u, s**2)
        for i, r in enumerate(rho)
    ]
    line = fit_elm(seen, intercept=False)
    assert line.gain.mean() == pytest.approx(truth, abs=5 * line.gain.std() / np.sqrt(n) + 0.02)
    assert line.gain.std() == pytest.approx(np.sqrt(line.covariance[:, 0, 0]).mean(), rel=0.055)
    assert line.reduced_chi2.mean() == pytest.approx(1.0, abs=5 / np.sqrt(n))


def test_panels_that_give_no_gain_are_refused():
    with pytest.raises(UsageError, match="0 panel"):
        fit_elm([], intercept=False)
    with pytest.raises(UsageError, match="below 5 times"):
        fit_elm([panel("black", 0.0, 0.1, 0.01, 0.01)], intercept=False)
    with pytest.raises(UsageError, match="saturated"):
        fit_elm([panel("white", 0.5, 40.0)], intercept=False, saturation=40.0)
    with pytest.raises(UsageError, match="divide percent"):
        fit_elm([panel("white", 50.0, 40.0)], intercept=False)
    with pytest.raises(UsageError, match="others have none"):
        fit_elm([panel("white", 0.5, 10.0), panel("grey", 0.2, 4.0, 0.01)], intercept=False)


def test_the_darkest_pixel_and_one_panel_make_a_line():
    path, gain = np.array([3.0, 1.0]), np.array([20.0, 15.0])
    dark = darkest_pixel_panel(path + 0.02 * gain, np.full(2, 1e-4), 0.02, 0.005)
    line = fit_elm([dark, panel("white", [0.5, 0.5], path + 0.5 * gain, 0.005, 1e-4)])
    assert line.gain == pytest.approx(gain)
    assert line.offset == pytest.approx(path)
    # The assumed reflectance carries into the offset: at least k u(rho).
    assert np.all(np.sqrt(line.covariance[:, 1, 1]) > 0.9 * gain * 0.005)
    with pytest.raises(UsageError, match="negative or unknown in 1 bands"):
        darkest_pixel_panel([-1.0, 2.0], [0.01, 0.01])
