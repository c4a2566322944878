"""SNR of a region against known noise."""

import numpy as np
import pytest

from hyperval.pixels import snr_decorrelated, snr_from_moments

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


@pytest.mark.simulation
@pytest.mark.parametrize("texture", [0.0, 1.0, 5.0])
def test_few_pixels_have_the_snr_of_many_and_their_scatter(texture):
    # Medians of 16 bands over 150 regions of 36 pixels, each good to 1.6 %: their mean to 0.5 %
    # (allowed: 4 sd, false failure 1e-4). The regression alone was 3 % high without texture, 3 % low where it
    # equals the noise.
    # A scatter of 150 is known to 6 %, its mean over the bands to 2 % (allowed: 4 sd); 18 % were missing.
    values = [snr_decorrelated(region(seed, n=36, texture=0.004 * texture)[0]) for seed in range(150)]
    ratio = np.array([v.mean for v in values])[:, 2:-2] / (np.linspace(4.0, 6.0, BANDS) / 0.02)[2:-2]
    assert np.median(ratio, axis=0).mean() == pytest.approx(1.0, abs=0.02)
    stated = np.median([v.standard_uncertainty / v.mean for v in values], axis=0)[2:-2]
    assert (np.log(ratio).std(axis=0) / stated).mean() == pytest.approx(1.0, abs=0.08)
    # Neighbours err together where texture makes each residual a second difference: (2/3)^2 of the variance.
    common = np.mean([correlation(v.error_covariance) for v in values])
    scatter = np.mean(np.diag(np.corrcoef(np.log(ratio).T), 1))
    assert common == pytest.approx(scatter, abs=0.1)
    assert (common > 0.3) == (texture > 2)
    assert values[0].n == 36
    budget = values[0].budget.values()
    assert sum(u**2 for u in budget) == pytest.approx(np.diag(values[0].error_covariance))


def correlation(covariance):
    u = np.sqrt(np.diag(covariance))
    return np.diag(covariance / np.outer(u, u), 1)[2:-2].mean()


def test_texture_of_another_colour_than_the_mean_costs_little():
    # A red edge: texture that is no brightness. What is taken for the rest of the texture is limited.
    rng = np.random.default_rng(17)
    slope = 1.0 + 0.6 * np.cos(np.arange(40) / 2.0)
    for texture in (0.5, 1.0, 5.0, 30.0):
        x = 100.0 + texture * rng.normal(size=(4000, 1)) * slope + rng.normal(size=(4000, 40))
        found = snr_decorrelated(x).mean[2:-2] / 100.0
        assert np.all(np.abs(found - 1.0) < 0.18), texture
        assert np.median(found) == pytest.approx(1.0, abs=0.04)


def test_a_band_that_does_not_vary_has_no_snr():
    covariance = np.diag([1.0, 0.0, 1.0, 4.0])
    assert snr_from_moments([10.0] * 4, covariance, np.ones(4)) == pytest.approx([10, np.nan, 10, 5], nan_ok=True)
