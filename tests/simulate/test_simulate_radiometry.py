"""The simulated detector against direct Monte Carlo and limits."""

import numpy as np
import pytest
from scipy.stats import skew
from small_scene import BANDS, INPUTS, noise_model

from hyperval.sensor import library_names, load_sensor
from hyperval.simulate import Detector, detector

N = 40_000


def chain(noise) -> Detector:
    zero = np.zeros(noise.electrons_per_radiance.size, np.float32)
    return Detector(noise, zero, zero + 1, 1000.0)


def quiet(**changes):
    """A sensor with shot noise alone, unless told otherwise."""
    return noise_model(**{"fixed_noise": 0.0, "calibration_percent": 0.0, "lsb_electrons": 0.0} | changes)


def measured(noise, level: float, seed: int = 1, n: int = N) -> np.ndarray:
    radiance = np.full((n, noise.electrons_per_radiance.size), level, np.float32)
    return chain(noise).measure(radiance, np.random.default_rng(seed)).astype(float)


def assert_same_spread(found: np.ndarray, expected: np.ndarray) -> None:
    """Means and variances of two samples within 5 standard errors (fails by chance once in 1.7 million)."""
    a, b = found.ravel(), expected.ravel()
    assert abs(a.mean() - b.mean()) < 5 * np.hypot(a.std() / a.size**0.5, b.std() / b.size**0.5)

    def error(x: np.ndarray) -> float:
        d = x - x.mean()
        return float(np.sqrt((np.mean(d**4) - np.mean(d**2) ** 2) / x.size))

    assert abs(a.var() - b.var()) < 5 * np.hypot(error(a), error(b))
    # 5 standard errors of a skewness, about sqrt(15/n): few electrons are skewed, as a Poisson law is.
    assert skew(a) == pytest.approx(skew(b), abs=5 * np.sqrt(15 / a.size + 15 / b.size))


@pytest.mark.parametrize("electrons", [0.5, 4.0, 300.0, 900.0, 1100.0, 60_000.0])
def test_shot_and_fixed_noise_agree_with_counting(electrons):
    gain, fixed = 5000.0, 7.0
    found = measured(quiet(fixed_noise=fixed), electrons / gain)
    rng = np.random.default_rng(2)
    counted = rng.poisson(np.float64(np.float32(electrons / gain)) * gain, N * BANDS)
    assert_same_spread(found * gain, counted + fixed * rng.standard_normal(N * BANDS))


def test_the_noise_factor_multiplies_the_noise_and_not_the_signal():
    plain, doubled = measured(quiet(), 2.0), measured(quiet(detector_gain=2.0), 2.0)
    assert np.allclose(doubled - 2.0, 2.0 * (plain - 2.0), atol=1e-6)


def test_digital_numbers_are_whole_and_the_rounding_is_uniform():
    lsb = 0.05  # two and a half times the shot noise of 0.02: the rounding shows
    found = measured(quiet(lsb_electrons=5000.0 * lsb), 2.0)
    assert np.max(np.abs(found / lsb - np.rint(found / lsb))) < 1e-3
    raw = np.random.default_rng(3).poisson(2.0 * 5000.0, N * BANDS) / 5000.0
    assert_same_spread(found, np.rint(raw / lsb) * lsb)


@pytest.mark.parametrize("level", [1.0, 10.0])
def test_relative_calibration_error_scales_with_the_signal_and_is_independent_from_band_to_band(level):
    relative = measured(quiet(electrons_per_radiance=1e9, calibration_percent=2.0), level) / level - 1.0
    # 5 standard errors of a standard deviation: sqrt(1/(2 n)).
    assert relative.std() == pytest.approx(0.02, rel=5 / np.sqrt(2 * N * BANDS) + 1e-3)
    assert np.max(np.abs(np.corrcoef(relative.T)[np.triu_indices(BANDS, 1)])) < 6 / np.sqrt(N)


def test_bit_errors_flip_the_expected_share_by_powers_of_two():
    rate, bits, lsb = 1e-3, 8, 0.05
    common = {"electrons_per_radiance": 1e12, "lsb_electrons": 1e12 * lsb, "bits": bits}
    steps = np.rint(measured(quiet(bit_error_rate=rate, **common), 100 * lsb) / lsb - 100).astype(int)
    share = 1 - (1 - rate) ** bits
    assert np.mean(steps != 0) == pytest.approx(share, abs=5 * np.sqrt(share / steps.size))
    # 100 = 0b01100100: set bits fall, clear bits rise.
    words = 100 ^ (np.random.default_rng(4).random((N * 4, bits)) < rate) @ (1 << np.arange(bits))
    assert_same_spread(steps, words - 100)


def test_radiance_is_the_sum_over_all_bounces_between_ground_and_sky():
    average = np.linspace(0.1, 0.4, BANDS)
    rho = np.linspace(0.05, 0.6, BANDS).astype(np.float32)
    t = INPUTS.terms
    # Light that has bounced n times carries another factor (S rho_ave)^n.
    bounces = sum((t.spherical_albedo * average) ** n for n in range(40))
    expected = t.path_radiance + (t.direct * rho + t.adjacency * average) * bounces
    assert np.allclose(detector(INPUTS, average, 1000.0).radiance(rho[None, :])[0], expected, rtol=1e-6)


def test_full_scale_limits_the_numbers_and_is_counted():
    sensor = quiet(bits=8, lsb_electrons=50.0)
    c = chain(sensor)
    radiance = np.full((5, BANDS), 3.0, np.float32)
    assert c.measure(radiance, np.random.default_rng(0)).max() == pytest.approx(2.55)
    assert c.count_saturated(radiance) == 5 * BANDS
    assert c.count_saturated(radiance - 1.0) == 0


def test_stored_integers_round_and_count_what_does_not_fit():
    values, clipped = chain(noise_model()).to_integers(np.array([[1.2344, -0.0016, 32.7671, 33.0, -40.0]], np.float32))
    assert values.tolist() == [[1234, -2, 32767, 32767, -32768]]
    assert values.dtype == np.dtype("<i2")
    assert clipped == 2


@pytest.mark.parametrize("name", library_names())
@pytest.mark.parametrize("level", [0.5, 5.0])
def test_every_sensor_of_the_library_draws_the_noise_that_its_model_predicts(name, level):
    noise = load_sensor(name).noise()
    bands, n = noise.electrons_per_radiance.size, 2000
    found = measured(noise, level, seed=6, n=n)
    variance = noise.variance(np.full(bands, level))
    # What lies beyond the full scale is cut there: the model's variance is that of bands that hold the level.
    held = np.full(bands, np.inf) if noise.full_scale is None else noise.full_scale
    held = level + 6 * np.sqrt(variance) < held
    assert np.count_nonzero(held) >= 0.6 * bands
    ratio = (found.var(axis=0, ddof=1) / variance)[held]
    # Relative standard error of a normal variance: sqrt(2/n). 6 of them for the worst of some 400 bands (fails
    # by chance once in a million runs), 5 of the error of the mean, with 1 % for rounding that is not uniform.
    assert np.max(np.abs(ratio - 1)) < 6 * np.sqrt(2 / n)
    assert abs(ratio.mean() - 1) < 5 * np.sqrt(2 / (n * held.sum())) + 0.01
