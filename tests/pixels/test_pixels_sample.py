"""What a sample says of its population: independent pixels, factors, noise, and covariances drawn."""

import numpy as np
import pytest
from scipy import ndimage, stats

from hyperval import pixels
from hyperval.compare import chi_square_full, chi_square_shape, covariance_dof, whitening
from hyperval.model import bhattacharyya_distance
from hyperval.products import EstimatedPart
from hyperval.simulate import correlated_field
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import builtin_class

P = 8


VALUES = np.geomspace(4.0, 0.02, P)


def sigma():
    q = np.linalg.qr(np.random.default_rng(2).normal(size=(P, P)))[0]
    return q @ np.diag(VALUES) @ q.T


def standard(n, rng, dof=np.inf):
    z = rng.standard_normal((n, P)) @ np.linalg.cholesky(sigma()).T
    return z if np.isinf(dof) else z * np.sqrt((dof - 2) / rng.chisquare(dof, n))[:, None]


def sample_eigenvalues(n, draws, dof=np.inf):
    rng = np.random.default_rng(7)
    return np.array([np.linalg.eigvalsh(np.cov(standard(n, rng, dof).T))[::-1] for _ in range(draws)])


@pytest.mark.parametrize("n", [6, 15, 400])
def test_drawn_eigenvalues_are_those_of_samples_of_pixels(n):
    # n = 6 is of less than full rank; 15 is strongly biased. Two-sample Kolmogorov-Smirnov on the first and third
    # eigenvalue; at p > 1e-3 each of the 6 comparisons rejects a right sampler once in a thousand.
    truth = sample_eigenvalues(n, 600)
    directions, rng = pixels.EigenDirections.from_covariance(sigma()), np.random.default_rng(3)
    band = pixels.sampling_band(directions, n - 1.0, 3, (1,), rng, draws=600)
    for k in (0, 2):
        assert stats.ks_2samp(band.eigenvalues[:, k], truth[:, k]).pvalue > 1e-3


def test_covariance_distance_is_bhattacharyya_without_a_difference_of_means():
    other = np.cov(standard(40, np.random.default_rng(9)).T)
    factor = pixels.EigenDirections.from_covariance(sigma()).whitened_factor(other)
    expected = bhattacharyya_distance(np.zeros(P), sigma(), np.zeros(P), other)
    assert pixels.covariance_distance(factor @ factor.T) == pytest.approx(expected, rel=1e-9)
    assert pixels.covariance_distance(np.eye(P)) == pytest.approx(0.0, abs=1e-15)
    assert pixels.covariance_distance(np.diag([1.0, 0.0])) == np.inf


def test_principal_angle_of_a_turned_plane():
    a = np.radians(25.0)
    turned = np.array([[np.cos(a), 0.0], [0.0, 1.0]])
    found = pixels.principal_angles_deg([turned, np.eye(2)], (1, 2))
    assert found == pytest.approx(np.array([[25.0, 25.0], [0.0, 0.0]]))


BANDS = 80


W = np.linspace(0.0, 1.0, BANDS)


SHAPES = np.stack([np.sin(3 * W), np.cos(7 * W)])


SPREAD = 0.5 + W


def drawn(rng, n, amplitude):
    return rng.normal(size=(n, BANDS)) * SPREAD + amplitude * rng.normal(size=(n, 2)) @ SHAPES


def test_pure_noise_has_no_factors():
    rng = np.random.default_rng(1)
    found, _, dof = pixels.factor_covariance(np.cov(drawn(rng, 30, 0.0).T), 30)
    assert np.count_nonzero(found - np.diag(np.diag(found))) == 0
    # 2 tr(D^2)/m against {tr(C^2) + tr(C)^2}/nu, all variances alike.
    assert dof == pytest.approx(29 * (1 + BANDS) / 2)


def test_factors_that_stand_out_are_found_and_the_rest_is_diagonal():
    rng = np.random.default_rng(2)
    x = drawn(rng, 40, 20.0)
    found, _, dof = pixels.factor_covariance(np.cov(x.T), 40)
    sd = np.sqrt(np.diag(np.cov(x.T)))
    off = found / np.outer(sd, sd)
    values = np.linalg.eigvalsh(off)
    assert np.sum(values > 1.0) == 2
    assert values[0] > 0
    assert 39 <= dof < 60
    # The diagonal is the sample's, but for what the factors took along (m/(m - 2) of a small part).
    assert np.allclose(np.diag(found), sd**2, rtol=0.06)
    # Noise of the bands to 3.3 standard errors of a variance from 37 degrees of freedom, all bands together.
    own = np.linalg.eigvalsh(found)[: BANDS - 2].sum() / (SPREAD**2).sum()
    assert abs(own - 1.0) < 3.3 * np.sqrt(2.0 / 37 / BANDS) + 2 / BANDS


@pytest.mark.slow
@pytest.mark.parametrize(("n", "known"), [(16, 0.0), (40, 0.0), (200, 0.0), (40, 0.004)])
def test_p_values_of_true_means_are_uniform_where_bands_hang_together(n, known):
    """Pixels of asphalt in 163 bands with noise, 300 means each: what a scene's small regions are.

    Along the samples' own leading directions the mean p-value was 0.87 to 0.90 and 42 % lay above 0.95.  Standard
    errors: 0.017 of the mean, 0.0126 of a share of 5 %; limits at 3.5: one false failure in 700 for the nine.
    """
    axis = SpectralAxis(np.linspace(420.0, 2400.0, 163), np.full(163, 6.0))
    asphalt = builtin_class("asphalt", axis).covariance + 0.002**2 * np.eye(163)
    values, vectors = np.linalg.eigh(asphalt)
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    rng, found = np.random.default_rng(17), []
    for _ in range(300):
        x = rng.standard_normal((n, 163)) @ root.T
        sample = np.cov(x.T)
        covariance, common, dof = pixels.factor_covariance(sample, n) if n < 163 else (sample, sample, n - 1.0)
        part = EstimatedPart(covariance / n, dof, None, sample / n, n - 1.0, common / n)
        mean, error = x.mean(0) + known * rng.standard_normal(163), known**2 * np.eye(163)
        found.append(chi_square_full(mean, whitening(covariance / n + error, [part])).p_value)
    p = np.array(found)
    assert abs(p.mean() - 0.5) < 0.058
    assert abs(np.mean(p < 0.05) - 0.05) < 0.045
    assert abs(np.mean(p > 0.95) - 0.05) < 0.045


def test_lags_are_the_products_of_all_pairs_of_pixels():
    rng = np.random.default_rng(4)
    windows = [(rng.standard_normal((2, *shape)), rng.random(shape) < 0.7) for shape in ((9, 14), (9, 14), (3, 20))]
    reach = 4
    found, counted = pixels.lag_correlation(windows, reach)
    total, pairs = np.zeros((2, 2 * reach + 1, 2 * reach + 1)), np.zeros((2 * reach + 1, 2 * reach + 1))
    for values, mask in windows:
        at = np.argwhere(mask)
        for one in at:
            for other in at[np.abs(at - one).max(axis=1) <= reach]:
                lag = tuple(other - one + reach)
                pairs[lag] += 1
                total[:, *lag] += values[:, *one] * values[:, *other]
    assert np.array_equal(counted, pairs)
    mean = total / np.maximum(pairs, 1)
    assert found == pytest.approx(mean / mean[:, reach, reach][:, None, None], abs=1e-12)


def test_neighbour_shares_by_counting_shifted_masks():
    mask = np.random.default_rng(3).random((9, 12)) < 0.4
    shares = pixels.neighbour_shares(mask, 3, np.random.default_rng(0))
    padded = np.pad(mask, 3)
    for i, down in enumerate(range(-3, 4)):
        for j, right in enumerate(range(-3, 4)):
            moved = padded[3 + down : 12 + down, 3 + right : 15 + right]
            assert shares[i, j] == pytest.approx((mask & moved).sum() / mask.sum(), abs=1e-15)


REACH = 24


@pytest.mark.parametrize(("side", "correlation"), [(12, 4.0), (10, 4.0), (8, 2.0), (20, 4.0), (24, 6.0)])
def test_intervals_of_regions_of_a_few_patches_hold_the_truth(side, correlation):
    # 300 fields: a share of 95 % has a standard error of 1.3 %; 90 % is what a coverage of 94 % falls below once in
    # a thousand.  Before, 77 % (10, 4), 78 % (12, 4), 85 % (8, 2), 87 % (24, 6) and 89 % (20, 4).
    rng = np.random.default_rng(17)
    inside, reach = np.ones((side, side), bool), min(REACH, side - 1)
    shares = pixels.neighbour_shares(inside, reach, rng)
    gap = int(side + 6 * correlation)  # so far apart, cuts of one field are independent
    held = count = 0
    while count < 300:
        wide = correlated_field((4 * side + 140, 4 * side + 140), correlation, rng)
        for line in range(20, wide.shape[0] - side - 20, gap):
            for sample in range(20, wide.shape[1] - side - 20, gap):
                f = wide[line : line + side, sample : sample + side].astype(float)
                n, _ = pixels.independent_pixels([((f - f.mean())[None], inside)], shares, f.size, reach)
                u = f.std(ddof=1) * np.sqrt(pixels.small_sample_factor(n[0]) / n[0])
                held += abs(f.mean()) <= 1.959964 * u
                count += 1
    assert held / count > 0.90


def test_small_samples_are_widened_and_large_ones_are_not():
    assert pixels.small_sample_factor(1e6) == pytest.approx(1.0, abs=1e-5)
    # Half of 22, less 1: the t of ten degrees of freedom is 2.228 (tables).
    assert pixels.small_sample_factor(22.0) == pytest.approx((2.228 / 1.960) ** 2, rel=1e-3)
    assert pixels.small_sample_factor(1.0) == pixels.small_sample_factor(4.0)


def test_a_covariance_of_few_directions_has_no_other_components():
    along = pixels.covariance_components(np.diag([4.0, 1.0, 0.0]), np.random.default_rng(1), count=2)
    assert along.mixtures.shape == (3, 0)
    np.testing.assert_allclose(along.values, [4.0, 1.0])
    np.testing.assert_allclose(along.scores(np.array([[[2.0, 1.0, 0.0]]]))[:, 0, 0] ** 2, [1.0, 1.0])


def test_independent_pixels_behind_a_variance_are_those_of_the_squared_correlation():
    # Blurred noise, sd w: rho = exp(-h^2/(4 w^2)).  Over 12 fields of 4,096 pixels the number is known to some 3 %.
    rng = np.random.default_rng(9)
    size, w, reach = 64, 1.6, 16
    shares = pixels.neighbour_shares(np.ones((size, size), bool), reach, rng)
    steps = np.arange(-reach, reach + 1)
    rho = np.exp(-(np.hypot(steps[:, None], steps[None]) ** 2) / (4 * w**2))
    found = []
    for _ in range(12):
        z = ndimage.gaussian_filter(rng.standard_normal((size, size)), w, mode="wrap")
        windows = [(((z - z.mean()) / z.std())[None], np.ones((size, size), bool))]
        found.append([v[0] for v in pixels.independent_pixels(windows, shares, size**2, reach)])
    for_mean, for_variance = np.mean(found, axis=0)
    assert for_variance == pytest.approx(size**2 / np.sum(rho**2 * shares), rel=0.15)
    assert for_mean == pytest.approx(size**2 / np.sum(rho * shares), rel=0.25)


def test_a_ring_counts_where_its_mean_is_two_standard_errors_of_its_pairs_above_nought():
    # 101 pixels of +-1 in a line, of whose 100 pairs c differ: rho = 1 - c / 50, and 0.2 is two standard errors.
    shares = np.array([[0.0, 0, 0], [1, 1, 1], [0, 0, 0]])
    q = 1.48 / (1.0 - 1.52 / 101.0) / 101.0  # of the variance, which the mean of the line takes away
    put_back = (1.0 - q) ** 2 * (1.0 + 2.0 * 0.24**2) + 2.0 * q * (1.0 - q) * 1.48 + 3.0 * q**2
    for changes, independent in ((41, 101.0), (38, 101.0 / put_back)):
        sign = np.ones((1, 1, 101))
        sign[..., np.linspace(1, 100, changes).astype(int)] = -1.0
        found = pixels.independent_pixels([(np.cumprod(sign, axis=-1), np.ones((1, 101), bool))], shares, 101, 1)[1]
        assert found == pytest.approx([independent])


def test_noise_of_one_band_has_the_scatter_of_normal_pixels_and_of_its_columns():
    # 2/n of the square for the pixels, whose texture alone has tails, 2/(columns - 1) for what the columns share.
    factor, uncertainty = pixels.noise_part([[8.0]], [[4.0]], [4.0], 100.0, 2.0, calibration=[1.0], samples=11)
    assert (factor, uncertainty**2) == pytest.approx((2.0, 4.0 * 2.0 / 100.0 + 0.2 / 16.0))
    # Standard deviations off by r = 0.3 z turn 4 into 4 (1 + r)^2, the noise beside by 0.5 z (E z^4 = 3).
    off = pixels.noise_part([[8.0]], [[4.0]], [4.0], 100.0, 2.0, errors=np.array([[[0.3]], [[0.5]]]))[1]
    assert off**2 - 4.0 * 2.0 / 100.0 == pytest.approx(((0.6 * 4.0 + 0.5) ** 2 + 3.0 * (0.09 * 4.0) ** 2) / 16.0)
    # Of two bands the texture is in the first alone, whose pixels are ten: the noise is known by those of the second.
    s = np.diag([101.0, 1.0])
    assert pixels.noise_part(s, s, [1.0, 1.0], [10.0, 1000.0])[1] ** 2 == pytest.approx(2.0 / 1000.0, rel=1e-6)


def test_kurtosis_rank_and_directions():
    assert [pixels.kurtosis_parameter(dof) for dof in (np.inf, 6.0, 4.0)] == [0.0, 1.0, np.inf]
    assert pixels.is_full_rank(24.0, 8)
    assert not pixels.is_full_rank(np.array([100.0, 23.0]), 8)
    assert pixels.EigenDirections.from_covariance(np.diag([0.0, 2.0, 0.0])).values.tolist() == [2.0]  # no rounding


def test_degrees_of_freedom_of_a_covariance():
    eye = np.eye(5)
    assert covariance_dof([]) == np.inf
    assert covariance_dof([(eye, 40.0)]) == pytest.approx(40.0)  # all of it estimated: its own
    assert covariance_dof([(0.1 * eye, 40.0)]) == pytest.approx(4000.0)  # a tenth: (1/0.1)^2 times as many
    # Half from each of two samples in one dimension: Welch and Satterthwaite.
    one = np.eye(1)
    assert covariance_dof([(0.5 * one, 10.0), (0.5 * one, 30.0)]) == pytest.approx(1.0 / (0.25 / 10 + 0.25 / 30))


def test_directions_are_left_out_until_the_covariance_is_known_well_enough():
    rng = np.random.default_rng(3)
    c = np.diag(np.linspace(1.0, 2.0, 10))
    c[0, 1] = c[1, 0] = 0.9
    r = rng.standard_normal(10)
    some = chi_square_full(r, whitening(c, [EstimatedPart(c, 12.0)]))
    assert (some.dof, some.covariance_dof) == (4, pytest.approx(12.0))
    assert 0.0 < some.p_value < 1.0
    shape = chi_square_shape(r, np.ones(10), whitening(c, [EstimatedPart(c, 12.0)]))
    assert (shape.dof, shape.covariance_dof) == (3, pytest.approx(12.0))
    assert 0.0 < shape.value < some.value
