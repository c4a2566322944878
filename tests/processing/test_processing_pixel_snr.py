"""SNR estimates against known noise."""

import numpy as np
import pytest

from hyperval.errors import UsageError
from hyperval.processing.snr import snr_decorrelated, snr_from_moments

BANDS = 20


def region(seed, n=2000, texture=0.0, noise=0.02):
    rng = np.random.default_rng(seed)
    common = rng.normal(size=(n, 1))
    mean = np.linspace(4.0, 6.0, BANDS)
    return mean * (1.0 + texture * common) + noise * rng.normal(size=(n, BANDS)), mean / noise


@pytest.mark.parametrize("texture", [0.0, 0.05, 0.3])
def test_decorrelated_estimate_is_right_with_and_without_texture(texture):
    # n = 2000: each SNR good to 1.6 %; 20 bands, band of 5 sd (false failure 1e-5).
    pixels, truth = region(2, texture=texture)
    found = snr_decorrelated(pixels)
    assert found.mean == pytest.approx(truth, rel=0.08)
    if texture:
        assert np.all(pixels.mean(axis=0) / pixels.std(axis=0, ddof=1) < 0.2 * truth)


def test_noise_that_changes_with_band_is_followed():
    rng = np.random.default_rng(3)
    noise = np.linspace(0.01, 0.03, BANDS)
    pixels = 5.0 + 0.5 * rng.normal(size=(4000, 1)) + noise * rng.normal(size=(4000, BANDS))
    found = snr_decorrelated(pixels).mean * noise / 5.0
    assert found[1:-1] == pytest.approx(np.ones(BANDS - 2), rel=0.08)


def test_stated_uncertainty_is_the_scatter():
    # 400 regions of 60 pixels: the sd of one band is good to 3.5 %, the mean over 20 bands to below 1 %; the
    # one stated value carries 2 % of its own (20 bands of 9 %): band of 4 sd.
    values = np.array([snr_decorrelated(region(1000 + s, n=60)[0]).mean for s in range(400)])
    stated = snr_decorrelated(region(1, n=60)[0])
    ratio = values.std(axis=0).mean() / stated.standard_uncertainty.mean()
    assert ratio == pytest.approx(1.0, abs=0.08)
    assert sum(u**2 for u in stated.budget.values()) == pytest.approx(np.diag(stated.error_covariance))
    assert stated.n == 60


def test_what_cannot_be_estimated_is_refused():
    with pytest.raises(UsageError, match="at least 5"):
        snr_decorrelated(np.ones((4, 5)))
    with pytest.raises(UsageError, match="two neighbours"):
        snr_decorrelated(np.ones((10, 2)))
    with pytest.raises(UsageError, match="NaN"):
        snr_decorrelated(np.full((5, 3), np.nan))
    assert np.isnan(snr_decorrelated(np.ones((5, 3))).mean).all()  # no spread: no SNR, not an infinite one


def test_from_moments_it_is_that_of_the_pixels():
    rng = np.random.default_rng(12)
    n = 400
    x = 20.0 + rng.normal(0, 2.0, (n, 1)) * np.linspace(0.5, 1.5, 7) + rng.normal(0, 0.3, (n, 7))
    found = snr_from_moments(x.mean(axis=0), np.cov(x.T))
    # The residuals lose three degrees of freedom, the covariance one.
    assert found == pytest.approx(snr_decorrelated(x).mean * np.sqrt((n - 1) / (n - 3)), rel=1e-9)


def test_a_band_that_does_not_vary_has_no_snr():
    covariance = np.diag([1.0, 0.0, 1.0, 4.0])
    assert snr_from_moments([10.0, 10.0, 10.0, 10.0], covariance) == pytest.approx([10, np.nan, 10, 5], nan_ok=True)
