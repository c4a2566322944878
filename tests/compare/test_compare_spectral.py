"""Difference ratios and consistency tests: closed forms, Monte Carlo, and a tilt that only one test sees."""

import math

import numpy as np
import pytest
from scipy import stats

from hyperval import compare
from hyperval.errors import UsageError
from hyperval.model import Z95, difference_ratio, difference_ratio_covariance
from hyperval.products import EstimatedPart, SpectralEstimate
from hyperval.results import Cause, Outcome, Result
from hyperval.spectra import SpectralAxis, in_window

AXIS = SpectralAxis(np.arange(420.0, 2450.0, 20.0), 20.0)
B = len(AXIS)


def spectrum(mean, covariance=1e-4, n=100):
    mean = np.broadcast_to(np.asarray(mean, float), (B,)).copy()
    covariance = covariance * np.eye(B) if np.ndim(covariance) == 0 else covariance
    return SpectralEstimate(mean, covariance, n=n)


def compared(predicted, observed, product="radiance", axis=AXIS):
    """Rows by metric, those of single bands as a list."""
    rows = list(compare.compare_spectra(predicted, observed, axis, product))
    bands = {name: [r for r in rows if r.metric == name] for name in ("difference_ratio", "z")}
    return {r.metric: r for r in rows} | bands


def full_test(difference, covariance):
    return compare.chi_square_full(difference, compare.whitening(covariance))


def test_ratio_covariance_by_monte_carlo():
    # 40000 draws, errors of 1 % so that the first order holds: covariances good to 1 %; band 5 %.
    rng = np.random.default_rng(1)
    common = lambda u, r: u**2 * (r * np.ones((3, 3)) + (1 - r) * np.eye(3))  # noqa: E731
    p = SpectralEstimate(np.array([5.0, 4.0, 3.0]), common(0.04, 0.8))
    c = SpectralEstimate(np.array([4.8, 4.2, 2.0]), common(0.03, 0.3))
    draws = (rng.multivariate_normal(side.mean, side.error_covariance, 40000) for side in (p, c))
    assert np.cov(difference_ratio(*draws).T) == pytest.approx(difference_ratio_covariance(p, c), rel=0.05)


def test_diagonal_and_full_agree_without_correlation():
    rng = np.random.default_rng(3)
    variance, r = rng.uniform(0.5, 2.0, 30), rng.normal(size=30)
    diagonal, full = compare.chi_square_diagonal(r, np.diag(variance)), full_test(r, np.diag(variance))
    assert full.value == pytest.approx(diagonal.value, rel=1e-12) == pytest.approx(np.sum(r**2 / variance))
    assert (full.dof, diagonal.dof) == (30, 30)
    assert full.p_value == pytest.approx(stats.chi2.sf(full.value, 30))
    # Of one band Student's test.
    assert compare.ChiSquare(4.0, 1, 5.0).p_value == pytest.approx(2.0 * stats.t.sf(2.0, 5.0))


def test_full_test_rejects_true_cases_at_its_level():
    # 2000 consistent residuals with a correlated covariance: 5 % rejected, sd 0.5 %; 3 to 7 % is 4 sd.
    rng = np.random.default_rng(4)
    x = np.linspace(0, 1, 25)
    covariance = 0.03**2 * np.exp(-np.abs(x[:, None] - x[None, :])) + 0.005**2 * np.eye(25)
    draws, tested = rng.multivariate_normal(np.zeros(25), covariance, 2000), compare.whitening(covariance)
    assert 0.03 < np.mean([compare.chi_square_full(r, tested).p_value < 0.05 for r in draws]) < 0.07


def test_a_tilt_outside_the_budget_is_seen_by_the_full_test_alone():
    # A 3 % tilt from end to end with 2.6 % of common gain error and 0.85 % of independent error per band.
    mean = spectrum(5.0).mean
    tilt = 0.03 * np.linspace(-1, 1, B) * mean
    covariance = (0.026**2 * np.ones((B, B)) + 0.0085**2 * np.eye(B)) * np.outer(mean, mean)
    diagonal, full = compare.chi_square_diagonal(tilt, covariance), full_test(tilt, covariance)
    assert (diagonal.reduced, full.reduced) == (pytest.approx(0.41, abs=0.02), pytest.approx(4.15, abs=0.2))
    rows = compared(spectrum(mean + tilt, covariance), spectrum(mean, 0.0))
    assert rows["p_value_diagonal"].value > 0.99
    assert rows["p_value_full"].value < 1e-6
    # In the budget, the same tilt is accepted by both.
    assert full_test(tilt, covariance + np.outer(tilt, tilt)).p_value > 0.05


def test_singular_covariance_keeps_only_real_directions():
    direction = np.linspace(1, 2, 10)
    full = full_test(2.0 * direction, np.outer(direction, direction))
    assert (full.dof, full.value) == (1, pytest.approx(4.0))
    nothing = full_test(np.zeros(3), np.zeros((3, 3)))
    assert (nothing.dof, math.isnan(nothing.p_value)) == (0, True)
    # Two copies of one band: one direction less, same verdict as without the copy.
    rng = np.random.default_rng(6)
    a, r, twice = rng.normal(size=(4, 4)), rng.normal(size=4), np.array([0, 1, 2, 3, 3])
    doubled = full_test(r[twice], (a @ a.T)[np.ix_(twice, twice)])
    assert (doubled.dof, doubled.value) == (4, pytest.approx(full_test(r, a @ a.T).value, rel=1e-6))
    # A band without a variance is in no tested direction.
    tested = compare.whitening(np.diag([0.01, 0.0, 0.04]))
    assert tested.transform == pytest.approx(np.diag([10.0, 0.0, 5.0])[[0, 2]])
    assert compare.chi_square_full([0.1, 7.0, 0.2], tested).value == pytest.approx(2.0)


def test_shape_is_what_the_full_test_has_beyond_a_common_factor():
    rng = np.random.default_rng(7)
    a = rng.normal(size=(12, 12))
    covariance, reference, r = a @ a.T, rng.uniform(1, 2, 12), rng.normal(size=12)
    tested, inverse = compare.whitening(covariance), np.linalg.inv(covariance)
    shape = compare.chi_square_shape(r, reference, tested)
    of_factor = (reference @ inverse @ r) ** 2 / (reference @ inverse @ reference)
    assert of_factor + shape.value == pytest.approx(compare.chi_square_full(r, tested).value, rel=1e-6)
    dark = compare.chi_square_shape([0.1, -0.2], [0.0, 0.0], compare.whitening(np.eye(2)))
    assert (shape.dof, dark.value, dark.dof) == (11, pytest.approx(0.05), 2)
    assert compare.chi_square_shape(0.07 * reference, reference, tested).value == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("difference", "common"), [([1.0, np.nan], 0.0), ([1.0, 1.0], np.nan)])
def test_nan_never_reaches_a_test_statistic(difference, common):
    with pytest.raises(UsageError, match="NaN"):
        full_test(difference, [[1.0, common], [common, 1.0]])


@pytest.mark.parametrize("product", ["radiance", "snr"])
def test_rows_of_a_known_offset(product):
    rows = compared(spectrum(5.25, 0.01), spectrum(5.0, 0.03), product)
    per_band, count = rows.pop("difference_ratio"), in_window(AXIS.centre_nm).sum()
    assert [r.band_nm for r in per_band] == AXIS.centre_nm.tolist()
    assert {r.outcome for r in per_band} == {Outcome.NONE}
    half = 1.959964 * np.sqrt((0.1 / 5) ** 2 + (5.25 * np.sqrt(0.03) / 25) ** 2)
    expected = pytest.approx((0.05, 0.05 - half, 0.05 + half), rel=1e-6)
    assert (per_band[0].value, per_band[0].lower, per_band[0].upper) == expected
    parts = ("windows", "vnir", "swir1", "swir2", "absorption")
    known = {f"median_abs_difference_ratio_{part}": 0.05 for part in parts} | {"bias_ratio": 0.05}
    known |= {"chi2_reduced_diagonal": 0.25**2 / 0.04, "chi2_reduced_full": 0.25**2 / 0.04}
    known |= {"chi2_reduced_shape": 0.0, "fraction_inside_95": 1.0, "spectral_angle": 0.0}
    assert {name: rows[name].value for name in known} == pytest.approx(known, abs=1e-5)
    assert rows["chi2_reduced_diagonal"].n == count


def test_sides_that_are_one_and_the_same_are_no_evidence():
    # An empirical line of two panels gives their own reflectance back, whatever was collected.
    mean = np.linspace(0.1, 0.9, B)
    rows = compared(spectrum(mean * (1.0 + 1e-14)), spectrum(mean))
    for metric in ("p_value_full", "chi2_reduced_full", "p_value_shape", "bias_ratio"):
        assert rows[metric].outcome is Outcome.SKIPPED
        assert "derived from the other" in rows[metric].reason
    assert rows["spectral_angle"].value == pytest.approx(0.0, abs=1e-5)


def test_bad_bands_and_gaps_are_left_out_and_absorption_does_not_touch_the_windows():
    good = np.ones(B, bool)
    good[3] = False
    axis = SpectralAxis(AXIS.centre_nm, AXIS.fwhm_nm, good)
    observed = spectrum(5.0)
    observed.mean[7] = np.nan
    observed.error_covariance[9, 9] = np.nan
    assert np.flatnonzero(~compare.comparable_bands(spectrum(5.0), observed, axis)).tolist() == [3, 7, 9]
    observed.mean[[3, 9]] = 1.0  # far off, but not to be used
    rows = compared(spectrum(np.where(in_window(AXIS.centre_nm), 5.001, 50.0)), observed, axis=axis)
    assert rows["max_abs_difference_ratio_windows"].value == pytest.approx(2e-4)
    assert rows["chi2_reduced_full"].value == pytest.approx(0.001**2 / 2e-4)
    assert rows["median_abs_difference_ratio_absorption"].value == pytest.approx(9.0)
    assert np.isfinite([r.value for r in rows["difference_ratio"]]).sum() == B - 3


def test_a_region_without_bands_is_skipped_with_its_reason():
    # A part of the spectrum that the sensor does not see is not planned.
    vnir = SpectralAxis(np.arange(420.0, 900.0, 20.0), 20.0)
    part = SpectralEstimate(np.ones(len(vnir)), np.eye(len(vnir)) * 1e-4)
    assert not [metric for metric in compared(part, part, axis=vnir) if metric.endswith("_swir2")]
    # One that it sees, but in bad bands only, is skipped with the reason.
    blind = SpectralAxis(AXIS.centre_nm, AXIS.fwhm_nm, AXIS.centre_nm < 1800.0)
    skipped = compared(spectrum(5.0), spectrum(5.0), axis=blind)["median_abs_difference_ratio_swir2"]
    assert (skipped.outcome, skipped.reason) == (Outcome.SKIPPED, "no comparable band in swir2")
    exact = spectrum(5.0, 0.0)
    assert compared(exact, exact)["p_value_full"].outcome is Outcome.SKIPPED


def test_the_detectable_tilt_is_found_in_four_cases_of_five():
    """By simulation: spectra tilted by it are rejected at the level of 0.001 in both tails with probability 0.8."""
    rng = np.random.default_rng(21)
    w = np.linspace(450.0, 900.0, 20)
    mean = 1.0 + 0.5 * np.sin(w / 90.0)
    c = 1e-4 * np.exp(-np.abs(np.subtract.outer(w, w)) / 60.0) + 1e-5 * np.eye(20)
    tested, root = compare.whitening(c), np.linalg.cholesky(c)
    full, shape = compare.detectable_tilts(mean, w, tested)
    of_shape = lambda r: compare.chi_square_shape(r, mean, tested)  # noqa: E731
    for size, test in ((full, lambda r: compare.chi_square_full(r, tested)), (shape, of_shape)):
        tilted = size * mean * np.linspace(-1.0, 1.0, 20)
        p = np.array([test(tilted + root @ rng.standard_normal(20)).p_value for _ in range(1000)])
        # Standard error 0.0126; five of them: one false failure in 1.7 million.
        assert abs(np.mean(p < 0.0005) - 0.8) < 0.064
    assert np.isnan(compare.detectable_tilts([1.0, 1.0], [500.0, 500.0], compare.whitening(np.eye(2)))).all()
    sampled = compare.whitening(np.eye(2), [EstimatedPart(np.eye(2), 1.0)])
    assert math.isnan(compare.detectable_tilts([1.0, 1.0], [400.0, 500.0], sampled)[0])
    few = compare.whitening(np.eye(2), [EstimatedPart(np.eye(2), 10.0)])  # whose inverse is 10/7 times too great
    size, limit = compare.detectable_tilts([1.0, 1.0], [400.0, 500.0], few)[0], stats.f.isf(5e-4, 2, 9)
    assert stats.ncf.sf(limit, 2, 9, 0.7 * 2.0 * size**2) == pytest.approx(0.8, rel=1e-4)


def test_a_size_made_of_errors_alone_is_no_disagreement_and_a_true_one_is_held():
    """Two hundred worlds: errors of 5 % without any difference, and a difference of 10 % with errors of 2 %."""
    rng, c, low_of_nothing, inside = np.random.default_rng(22), np.eye(40), [], 0
    for _ in range(200):
        none = 0.05 * rng.standard_normal(40)
        low_of_nothing.append([ends[0] for ends in compare.summary_intervals(none, 0.0025 * c)[1:]])
        low, high = compare.summary_intervals(0.1 + 0.02 * rng.standard_normal(40), 0.0004 * c)[1]
        inside += low <= 0.1 <= high
    assert np.all(np.mean(np.array(low_of_nothing) > 0.0, axis=0) < 0.07)  # of the median, and of the greatest
    assert inside >= 186  # 95 % of 200 is 190, sd 3.1


@pytest.mark.parametrize("length", [1e-6, 20.0, 300.0])
def test_the_interval_of_the_share_inside_holds_what_right_errors_give(length):
    """0.95 in at least 95 % of 400 worlds, whatever hangs together; four standard errors are 17 of 400."""
    rng = np.random.default_rng(33)
    w = np.linspace(450.0, 900.0, 60)
    c = np.exp(-0.5 * ((w[:, None] - w) / length) ** 2) + 1e-9 * np.eye(60)
    root = np.linalg.cholesky(c)
    limits = np.array([compare.share_inside(root @ rng.standard_normal(60), c)[1] for _ in range(400)])
    assert np.mean((limits[:, 0] <= 0.95) & (limits[:, 1] >= 0.95)) >= 0.95 - 4 * 0.011
    # Errors twice as large as stated are seen where bands are many.
    wide = np.array([compare.share_inside(2.0 * root @ rng.standard_normal(60), c)[1][1] for _ in range(100)])
    assert (np.mean(wide < 0.95) > 0.9) == (length < 1.0)


def test_a_prediction_that_is_too_bright_has_a_positive_z():
    axis = SpectralAxis(np.linspace(450.0, 890.0, 12), 10.0)
    covariance = 1e-4 * (0.5 * np.eye(12) + 0.5)
    rows = compared(*(SpectralEstimate(np.full(12, v), covariance) for v in (1.03, 1.0)), axis=axis)
    assert [r.value for r in rows["z"]] == pytest.approx([0.03 / np.sqrt(2e-4)] * 12)
    # The mean over bands of (p - c)/c: half of the error is common to all, the other half falls with their number.
    bias, used = rows["bias_ratio"], np.count_nonzero(in_window(axis.centre_nm))
    half = Z95 * np.sqrt(1e-4 * (1 + 1.03**2) * (0.5 + 0.5 / used))
    assert (bias.value, bias.upper - bias.value) == pytest.approx((0.03, half), rel=1e-9)


def told(metric, value, *, product="radiance", limits=None, **more) -> Result:
    limits = limits or {"within": (-0.05, 0.05)}
    gate = compare.Gate(product=product, metric=metric, reason="r", chosen_after=True, before="nothing", **limits)
    (row,) = compare.judge_rows([Result("", product, "s", "m", metric, value, **more)], [gate])
    return row


def test_a_number_is_told_in_units_of_the_field():
    row = told("median_difference_ratio_vnir", 0.01, lower=-0.02, upper=0.04)
    assert (row.effect, row.effect_lower, row.effect_upper) == pytest.approx((1.0, -2.0, 4.0))
    assert (row.accepted_low, row.accepted_high, row.ideal) == pytest.approx((-5.0, 5.0, 0.0))
    reach = 5.0 + 3.0 * (1.0 + stats.norm.ppf(0.8) / stats.norm.ppf(0.975))
    assert (row.detectable_low, row.detectable_high) == pytest.approx((-reach, reach))
    assert (row.effect_unit, row.set_after) == ("% of radiance", True)
    ratio = told("area_ratio", 1.1, product="abundance", lower=0.9, upper=1.3, limits={"within": (0.75, 1.25)})
    assert (ratio.effect, ratio.effect_upper, ratio.accepted_low, ratio.ideal) == pytest.approx((10.0, 30.0, -25.0, 0))
    (unplanned,) = compare.judge_rows([Result("", "radiance", "s", "m", "bias_ratio", 0.1, lower=0.0, upper=0.2)], [])
    assert math.isnan(unplanned.effect)


def test_a_test_agrees_only_where_its_whole_interval_lies_in_the_range():
    """Of 11 bands a difference of 1.5 times its uncertainty may be one of 2.1, which chance alone does not give."""

    def of_size(size):
        found = compare.ChiSquare(size**2 * 11, 11)
        return told("p_value_full", found.p_value, limits={"at_least": 0.001}, detectable=0.01, about=found.effect)

    near, beyond, far, none = map(of_size, (1.1, 1.5, 2.5, 0.03))
    assert [r.outcome for r in (near, beyond, far)] == [Outcome.AGREES, Outcome.UNDECIDED, Outcome.DISAGREES]
    assert (beyond.cause, beyond.p_value > 0.001) == (Cause.WIDE_INTERVAL, True)
    assert beyond.effect_upper > beyond.accepted_high > beyond.effect
    assert far.effect > far.accepted_high == pytest.approx(math.sqrt(stats.chi2.isf(5e-4, 11) / 11))
    assert (none.cause, none.effect < none.accepted_low, none.ideal) == (Cause.TOO_WIDE, True, 1.0)


@pytest.mark.parametrize("nu", [math.inf, 60.0])
def test_the_interval_of_an_effect_holds_its_size_in_95_of_100(nu):
    """Statistics of noncentrality lambda are drawn; their intervals hold sqrt(1 + lambda / p)."""
    rng, dof, size, draws = np.random.default_rng(7), 12, 1.7, 150
    drawn = rng.noncentral_chisquare(dof, (size**2 - 1.0) * dof, draws)
    if math.isfinite(nu):  # Hotelling's statistic
        drawn = drawn * nu / rng.chisquare(nu - dof + 1.0, draws)
    effects = [compare.ChiSquare(float(x), dof, nu).effect for x in drawn]
    held = np.mean([e.lower <= size <= e.upper for e in effects])
    assert held == pytest.approx(0.95, abs=4.0 * math.sqrt(0.95 * 0.05 / draws))
    found = np.mean([e.value > e.accepted(0.001)[1] for e in effects])
    assert (found > 0.8) == (size > effects[0].detectable[1])


YEARS = np.array([0.0, 0.1, 0.15, 0.4, 0.7, 1.1, 1.2, 2.0])


def test_a_drift_holds_the_truth_as_often_as_it_says():
    """Seed 3; of 2000 draws 1900 hold it on average, with a standard deviation of 9.7: fails once in 10,000."""
    rng, inside = np.random.default_rng(3), 0
    for _ in range(2000):
        found = compare.drift(YEARS, 0.02 * YEARS + 0.005 * rng.standard_normal(YEARS.size))
        inside += found.lower <= 0.02 <= found.upper
    assert abs(inside - 1900) < 38


def test_a_drift_against_a_range():
    values = 0.02 * YEARS + 1e-3 * np.sin(40.0 * YEARS)
    found = compare.drift(YEARS, values)
    ranges = ((-0.05, 0.05), (-0.01, 0.01), (-0.05, found.value))
    told = [compare.compare_with_range(found.lower, found.upper, *limits) for limits in ranges]
    assert told == [Outcome.AGREES, Outcome.DISAGREES, Outcome.UNDECIDED]
    assert compare.drift(YEARS, values + 0.3).value == pytest.approx(found.value), "an error of all days cancels"
    for years in ([0.0, 1.0], [1.0, 1.0, 1.0]):
        with pytest.raises(UsageError, match="days or more"):
            compare.drift(years, np.zeros(len(years)))
