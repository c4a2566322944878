"""Independent pixels: white and smooth fields, against the spread of means and variances over many fields."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from hyperval.processing import independent_for_mean, independent_for_variance, lag_correlation, neighbour_shares

SIZE, REACH = 64, 12


def field(rng, width):
    z = rng.standard_normal((SIZE, SIZE))
    if width:
        z = ndimage.gaussian_filter(z, width, mode="wrap")
    return z / z.std()


def test_white_pixels_are_all_independent():
    rng = np.random.default_rng(1)
    mask = np.ones((SIZE, SIZE), bool)
    found = lag_correlation([(field(rng, 0)[None], mask)], REACH)
    assert found.value[0, REACH, REACH] == 1.0
    shares = neighbour_shares(mask, REACH, rng)
    # 625 lags at 3.5 sigma: 0.3 false ones expected, each worth 12/4096 of a pixel.
    assert independent_for_variance(mask.size, found.significant()[0], shares) == pytest.approx(mask.size, rel=0.03)


@pytest.mark.parametrize("width", [1.0, 2.5])
def test_smooth_pixels_count_as_the_spread_over_many_fields_says(width):
    rng = np.random.default_rng(2)
    raw = [ndimage.gaussian_filter(rng.standard_normal((SIZE, SIZE)), width, mode="wrap") for _ in range(600)]
    sigma2 = np.mean([np.mean(z**2) for z in raw])
    # Relative variance of a variance is 2/n of normal values, that of the mean sigma^2/n; 600 fields know either
    # to 6 %.
    for_variance = 2.0 / np.var([np.mean(z**2) / sigma2 for z in raw])
    for_mean = 1.0 / np.var([np.mean(z) / np.sqrt(sigma2) for z in raw])
    mask = np.ones((SIZE, SIZE), bool)
    rho = lag_correlation([(z[None], mask) for z in raw[:60]], REACH).significant()[0]
    shares = np.ones((2 * REACH + 1, 2 * REACH + 1))  # fields that wrap round have a neighbour at every lag
    assert independent_for_variance(mask.size, rho, shares) == pytest.approx(for_variance, rel=0.25)
    assert independent_for_mean(mask.size, rho, shares) == pytest.approx(for_mean, rel=0.25)


def test_pixels_outside_the_mask_do_not_count():
    rng = np.random.default_rng(3)
    z = field(rng, 2.0)
    mask = np.zeros((SIZE, SIZE), bool)
    mask[:, :20] = True
    spoiled = np.where(mask, z, 1e6)
    one = lag_correlation([(z[None], mask)], REACH)
    two = lag_correlation([(spoiled[None], mask)], REACH)
    assert two.value == pytest.approx(one.value, abs=1e-6)
    assert one.pairs[REACH, REACH] == mask.sum()
    assert one.pairs[REACH, REACH + 3] == 17 * SIZE


def test_lags_are_the_products_of_all_pairs_of_pixels():
    rng = np.random.default_rng(4)
    windows = [(rng.standard_normal((2, *shape)), rng.random(shape) < 0.7) for shape in ((9, 14), (9, 14), (3, 20))]
    reach = 4
    found = lag_correlation(windows, reach)
    total, pairs = np.zeros((2, 2 * reach + 1, 2 * reach + 1)), np.zeros((2 * reach + 1, 2 * reach + 1))
    for values, mask in windows:
        at = np.argwhere(mask)
        for one in at:
            for other in at[np.abs(at - one).max(axis=1) <= reach]:
                lag = tuple(other - one + reach)
                pairs[lag] += 1
                total[:, *lag] += values[:, *one] * values[:, *other]
    assert np.array_equal(found.pairs, pairs)
    mean = total / np.maximum(pairs, 1)
    assert found.value == pytest.approx(mean / mean[:, reach, reach][:, None, None], abs=1e-12)


def test_neighbours_of_a_strip():
    mask = np.zeros((40, 40), bool)
    mask[:, 10:15] = True
    shares = neighbour_shares(mask, 3, np.random.default_rng(0))
    assert shares[3, 3] == 1.0
    assert shares[3, 5] == pytest.approx(3 / 5)  # two to the right: three of five columns stay inside
    assert shares[5, 3] == pytest.approx(38 / 40)
