"""Numbers that the other tests leave free: each against a closed form, a definition in plain loops, or draws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, ndimage, optimize, stats
from scipy.special import logit

from hyperval.compare import chi_square_full
from hyperval.errors import UsageError
from hyperval.model import (
    WHOLE,
    ClassLaw,
    ClassScores,
    PositiveDefinite,
    darkest_level,
    greatest_class_false_alarm,
    log_false_alarm,
    measured_error,
    object_detection_probability,
    score_density,
    with_distances,
)
from hyperval.processing import MeasuredPanel, darkest_pixel_panel, fit_elm
from hyperval.processing.alarm_blocks import AlarmBlocks, exceedance_curve, false_alarm_ratio
from hyperval.processing.laws import fit_tail_dof, left_out_distances, tail_log_likelihood
from hyperval.processing.roc import (
    area_estimates,
    area_variance,
    average_roc,
    clustered_variance,
    counts_of,
    empirical_roc,
    interval_of_mean,
    logit_interval,
    pooled_roc,
    with_summary,
)
from hyperval.processing.sample import SamplingBand, drawn_factor, independent_pixels, neighbour_shares, noise_part
from hyperval.processing.snr import snr_decorrelated
from hyperval.products import ClassificationError, EstimatedPart, ExceedanceCurve, RocCurve

# Empirical line -----------------------------------------------------------------------------------


def one(name, rho, u, radiance, variance):
    rho, u, radiance, variance = (np.atleast_1d(np.asarray(v, float)) for v in (rho, u, radiance, variance))
    return MeasuredPanel(name, rho, u**2, radiance, variance, 9)


def test_a_gain_is_refused_from_a_fifth_of_itself_on():
    # Two panels half apart: u(k) = sqrt(2 var)/0.5.
    for share, refused in ((0.19, False), (0.21, True)):
        panels = [one(str(r), r, 0.0, 10.0 * r, (share * 10.0 * 0.5) ** 2 / 2) for r in (0.1, 0.6)]
        if refused:
            with pytest.raises(UsageError, match="below 5 times"):
                fit_elm(panels)
        else:
            assert fit_elm(panels).gain == pytest.approx([10.0])


def test_errors_of_radiance_keep_their_correlation_between_bands():
    gain, rho = np.array([20.0, 8.0]), (0.1, 0.5)
    together = np.array([[0.04, 0.012], [0.012, 0.01]])
    made = [MeasuredPanel(str(r), [r, r], [0.0, 0.0], gain * r, together) for r in rho]
    found = fit_elm(made).error_covariance(gain * 0.2)
    # Weights 3/4 and 1/4 of the panels, over the gains.
    assert found == pytest.approx((0.75**2 + 0.25**2) * together / np.outer(gain, gain), rel=1e-4)


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
        difference, error, parts = fit.reflectance(level) - 0.3, fit.error_covariance(level), fit.estimated(level)
        np.testing.assert_allclose(sum(p.covariance for p in parts), error, rtol=1e-9)
        refused += [chi_square_full(difference, error, known).p_value < 0.05 for known in (parts, ())]
    assert refused[0] / 400 < 0.083
    assert refused[1] / 400 > 0.1


def test_gain_without_offset_is_the_least_of_its_sum_of_squares():
    rho, radiance = np.array([0.1, 0.4, 0.7]), np.array([2.6, 7.4, 14.9])
    u, variance = np.array([0.03, 0.01, 0.02]), np.array([0.01, 0.09, 0.04])
    made = [one(str(i), *v) for i, v in enumerate(zip(rho, u, radiance, variance, strict=True))]
    line = fit_elm(made, intercept=False)

    def squares(k):
        return float(np.sum((radiance - k * rho) ** 2 / (variance + k**2 * u**2)))

    best = optimize.minimize_scalar(squares, bounds=(10.0, 40.0), method="bounded", options={"xatol": 1e-10})
    assert line.gain[0] == pytest.approx(best.x, rel=1e-6)
    assert line.reduced_chi2[0] == pytest.approx(best.fun / 2, rel=1e-9)
    for i in range(3):
        others = fit_elm([made[j] for j in range(3) if j != i], intercept=False)
        assert line.leave_one_out[i, 0] == pytest.approx(radiance[i] / others.gain[0] - rho[i], rel=1e-12)
    # A black panel alone gives no gain; with a white one it does, and only the white one's own error is unknown.
    black, white = one("black", 0.02, 0.01, 0.5, 0.01), one("white", 0.5, 0.01, 10.0, 0.01)
    assert np.isnan(fit_elm([black, white], intercept=False).leave_one_out[:, 0]).tolist() == [False, True]
    # Ten panels are ten fits, not one for every order of leaving them out.
    many = [one(str(i), r, 0.01, 20.0 * r, 0.01) for i, r in enumerate(np.linspace(0.1, 0.9, 12))]
    assert fit_elm(many, intercept=False).leave_one_out == pytest.approx(np.zeros((12, 1)), abs=1e-12)


def test_a_darkest_pixel_may_lie_below_nought_by_noise_alone():
    assert darkest_pixel_panel([-0.29], [0.01]).radiance == pytest.approx([-0.29])
    with pytest.raises(UsageError, match="negative"):
        darkest_pixel_panel([-0.31], [0.01])


def test_the_darkest_of_many_pixels_is_a_median():
    # 4,001 scenes of 50 pixels: a share of one half is known to 0.008, 4.5 of which are allowed.
    rng = np.random.default_rng(0)
    level = darkest_level([0.3, 0.7], [[1.0], [2.0]], [[0.2], [0.5]], 50)[0]
    dark = rng.random((4001, 50)) < 0.3
    least = np.where(dark, rng.normal(1.0, 0.2, dark.shape), rng.normal(2.0, 0.5, dark.shape)).min(axis=1)
    assert np.mean(least < level) == pytest.approx(0.5, abs=0.036)
    alone = darkest_level([1.0], [[3.0]], [[0.4]], 9)[0]
    assert alone == pytest.approx(3.0 + 0.4 * stats.norm.ppf(1 - 0.5 ** (1 / 9)), abs=1e-12)


# Filters ------------------------------------------------------------------------------------------


def with_eigenvalues(values):
    """A correlation-like matrix with these eigenvalues along orthonormal directions."""
    n = len(values)
    q = np.linalg.qr(np.random.default_rng(1).normal(size=(n, n)))[0]
    return q @ np.diag(values) @ q.T


def test_condition_is_that_of_the_matrix_at_unit_diagonal():
    covariance = with_eigenvalues(np.geomspace(1.0, 1e-6, 9)) * np.outer(np.arange(1, 10), np.arange(1, 10))
    sd = np.sqrt(np.diag(covariance))
    assert PositiveDefinite(covariance).condition == pytest.approx(
        np.linalg.cond(covariance / np.outer(sd, sd), 1), rel=0.3
    )


def test_a_small_eigenvalue_counts_for_the_rank_and_a_lost_one_does_not():
    values = np.ones(12)
    values[0], values[1] = 1e-10, 0.0
    with pytest.raises(UsageError, match="rank 11 of 12"):
        PositiveDefinite(with_eigenvalues(values))


# ROC ----------------------------------------------------------------------------------------------


def test_one_score_on_a_side_has_the_bound_of_birnbaum_and_klose():
    # Targets' part by the bound; background's by the definition: V = 1 three times and 0 once.
    of_targets, of_background = area_variance(counts_of([2.5], [0.0, 1.0, 2.0, 3.0]))
    assert (of_targets, of_background) == pytest.approx((0.75 * 0.25, 0.25 / 4))


def test_everything_is_declared_at_a_false_alarm_probability_of_one():
    found = empirical_roc([0.0, 1.0, 2.0], [0.5, 1.5], 1.0)
    assert (found.pd[0], found.pd_lower[0], found.pd_upper[0]) == (1.0, 1.0, 1.0)


def test_limits_of_a_curve_never_fall_though_those_at_single_points_may():
    fell = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        t, b = rng.normal(1.0, 1.0, 9), rng.normal(size=60)
        grid = np.linspace(0.02, 1.0, 50)
        curve, alone = empirical_roc(t, b, grid), [empirical_roc(t, b, p) for p in grid]
        lower, upper = (np.concatenate([getattr(one, side) for one in alone]) for side in ("pd_lower", "pd_upper"))
        fell += np.any(np.diff(lower) < 0) or np.any(np.diff(upper) < 0)
        assert curve.pd_lower == pytest.approx([lower[i:].min() for i in range(50)], abs=0)
        assert curve.pd_upper == pytest.approx([upper[: i + 1].max() for i in range(50)], abs=0)
    assert fell  # else this says nothing


def test_average_of_predicted_curves_is_by_weight():
    pfa = np.array([1e-3, 1e-2])
    parts = [RocCurve(pfa, *([np.array(v)] * 3), np.zeros(2), "pixel") for v in ([0.2, 0.4], [0.6, 1.0])]
    assert average_roc(parts, [3, 1]).pd == pytest.approx([0.3, 0.55])
    assert average_roc(parts, [3, 1]).pd_lower == pytest.approx([0.3, 0.55])


def test_pool_of_unequal_groups_by_hand():
    rng = np.random.default_rng(3)
    groups = [(rng.normal(1.0, 1.0, 40), rng.normal(size=900)), (rng.normal(0.5, 1.0, 10), rng.normal(size=400))]
    curves = [with_summary(empirical_roc(t, b, [0.1, 1.0]), t, b) for t, b in groups]
    pool = pooled_roc(curves)
    assert (pool.n_target, pool.n_background) == (
        50,
        400,
    )  # what the smaller background cannot say, the pool cannot
    each = [c.areas["auc"] for c in curves]
    # What the background brings goes together: standard deviations are added by the share of the targets.
    background = (0.8 * np.sqrt(each[0].background_variance) + 0.2 * np.sqrt(each[1].background_variance)) ** 2
    assert pool.areas["auc"].background_variance == pytest.approx(background, rel=1e-12)
    placed = np.concatenate([e.placements for e in each])
    assert min(placed.sum(), (1 - placed).sum()) > 8  # the logit interval alone
    limits = logit_interval(placed.mean(), placed.var(ddof=1) / 50 + background, 50, 400)
    assert (pool.areas["auc"].lower, pool.areas["auc"].upper) == pytest.approx(limits, rel=1e-12)


def test_logit_interval_has_student_s_quantile_of_the_smaller_sample():
    low, high = logit_interval(0.8, 0.01, 5, 2000)
    half = stats.t.ppf(0.975, 4) * 0.1 / 0.16
    assert np.log(high / (1 - high)) - np.log(4.0) == pytest.approx(half, rel=1e-9)
    assert np.log(4.0) - np.log(low / (1 - low)) == pytest.approx(half, rel=1e-9)


def test_far_limit_of_an_area_of_few_targets_holds_without_assumptions():
    # Seven of eight found before all alarms, the last before 0.9 of them: Stringer's bound, of Clopper & Pearson's
    # limits at 0.70 for 0 and 1 of 8, and beside it in quadrature what the background leaves open.
    none, one = stats.beta.ppf(0.85, [1, 2], [8, 7])
    least, value = 1.0 - none - 0.1 * (one - none), 1.0 - 0.1 / 8
    for background in (0.0, 1e-4):
        low = interval_of_mean(np.array([0.9, *7 * [1.0]]), 1e-6, background, 1000)[0]
        assert low == pytest.approx(value - np.hypot(value - least, 1.959964 * np.sqrt(background)), rel=1e-6)


def test_an_area_whose_background_is_few_blocks_is_known_by_their_part_of_the_variance():
    rng = np.random.default_rng(4)
    scores = rng.standard_normal((4, 4)).repeat(20, 0).repeat(20, 1)
    blocks, counts = AlarmBlocks.of_map(scores, np.ones(scores.shape, bool)), counts_of(rng.normal(0, 1, 60), scores)
    found = area_estimates(counts, {"a": WHOLE}, "pixel", 0, rng, blocks)["a"]
    background, dof = clustered_variance(counts, WHOLE, blocks)
    whole = background + area_variance(counts)[0]
    # Satterthwaite: V^2 over the sum of squares over degrees of freedom, those of the targets being many.
    half = stats.t.ppf(0.975, whole**2 / (background**2 / dof)) * np.sqrt(whole) / (found.value * (1 - found.value))
    assert logit(found.upper) - logit(found.value) == pytest.approx(half, rel=1e-6)


@pytest.mark.parametrize(("m", "n"), [(5, 300), (12, 14)])
def test_bootstrap_over_objects_has_the_variance_of_delong_few_objects_or_many(m, n):
    # 20,000 draws know a variance to 1 %; the two estimates are unbiased and differ by some parts of 1/m^2, 1/n.
    rng = np.random.default_rng(m)
    t, b = rng.normal(0.7, 1.0, m), rng.normal(size=n)
    counts = counts_of(t, b)
    found = area_estimates(counts, {"auc": WHOLE}, "object", 20_000, rng)["auc"]
    a = found.value
    half = np.log(found.upper / (1 - found.upper)) - np.log(a / (1 - a))
    variance = (half * a * (1 - a) / stats.norm.ppf(0.975)) ** 2  # towards the near end, with few targets lost
    assert variance == pytest.approx(sum(area_variance(counts)), rel=0.1)


# Scores of the model ------------------------------------------------------------------------------


@pytest.mark.parametrize("dof", [np.inf, 5.0])
def test_density_is_the_slope_of_the_false_alarms(dof):
    one = ClassScores(*np.array([[[0.3, 0.7]], [[0.2, -0.1]], [[0.4, 0.2]], [[dof, np.inf]]]))
    low, high = 0.05, 0.9
    between = np.exp(log_false_alarm(np.array([low, high]), one.rows(np.zeros(2, int)))[0])
    area = integrate.quad(lambda x: float(score_density(np.array([[x]]), one)[0, 0]), low, high, epsabs=1e-12)[0]
    assert area == pytest.approx(between[0] - between[1], rel=1e-9)
    t_scale = 0.4 * np.sqrt((dof - 2) / dof) if np.isfinite(dof) else 0.4
    first = stats.t.sf(0.5, dof, 0.2, t_scale) if np.isfinite(dof) else stats.norm.sf(0.5, 0.2, 0.4)
    worst = max(first, stats.norm.sf(0.5, -0.1, 0.2))
    assert greatest_class_false_alarm(np.array([0.5]), one)[0] == pytest.approx(worst, rel=1e-12)


def test_an_object_is_missed_where_all_its_pixels_are():
    means, sds = np.array([[0.5, 0.2, -0.1], [0.3, 0.3, 0.3]]), np.array([[0.2, 0.4, 0.3], [0.1, 0.1, 0.1]])
    x = 0.35
    missed = [
        np.prod([stats.norm.cdf(x, m, s) for m, s in zip(at, spread, strict=True)])
        for at, spread in zip(means, sds, strict=True)
    ]
    assert object_detection_probability(np.array([[x]]), means[None], sds[None])[0, 0] == pytest.approx(
        1 - np.mean(missed), rel=1e-12
    )


# Exceedance and covariances -----------------------------------------------------------------------


def test_interval_of_exceedance_by_blocks_in_plain_loops():
    rng = np.random.default_rng(5)
    image = ndimage.gaussian_filter(rng.standard_normal((22, 30)), 1.0)  # 30 columns: blocks of 4 leave two over
    counted = rng.random(image.shape) < 0.9
    curve = exceedance_curve(AlarmBlocks.of_map(image, counted, side=4))
    total = counted.sum()
    effects, struck = [], []
    for t, p in zip(curve.threshold, curve.probability, strict=True):
        left, part = np.zeros((2, 8, 10))  # a ring of nothing around 6 x 8 blocks
        for i in range(6):
            for j in range(8):
                inside = counted[4 * i : 4 * i + 4, 4 * j : 4 * j + 4]
                alarms = np.sum(image[4 * i : 4 * i + 4, 4 * j : 4 * j + 4][inside] > t)
                left[i + 1, j + 1] = alarms - p * inside.sum()
                part[i + 1, j + 1] = inside.sum() / total
        squares, taken = (
            sum(x[i : i + 2, j : j + 2].sum() ** 2 / 4 for i in range(7) for j in range(9)) for x in (left, part)
        )
        alone = np.sum(left**2) / (1 - np.sum(part**2))
        # The variance of sum e^2: e^4 less its mean by block, and products of neighbours, each pair twice.
        scatter = np.sum(left**4) - np.sum(left**2) ** 2 * np.sum(part**2)
        for i in range(1, 7):
            for j in range(1, 9):
                for down, along in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
                    weight = 1 / (1 + abs(down)) / (1 + abs(along))
                    scatter += 2 * weight**2 * left[i, j] ** 2 * left[i + down, j + along] ** 2
        widened = stats.t.ppf(0.975, max(2 * np.sum(left**2) ** 2 / scatter - 1, 1)) / stats.norm.ppf(0.975)
        beyond = max(squares / (1 - taken), alone) / (total * p * (1 - p)) - 1 if p else 0.0
        effects.append(max(1 + beyond * widened**2, 1.0))
        struck.append(np.count_nonzero(np.abs(left[1:-1, 1:-1] + p * np.array([
            [counted[4 * i : 4 * i + 4, 4 * j : 4 * j + 4].sum() for j in range(8)] for i in range(6)
        ])) > 1e-9))  # fmt: skip
    checked = 0
    for i, (p, low, high) in enumerate(zip(curve.probability, curve.lower, curve.upper, strict=True)):
        if struck[i] < 2:
            assert np.isnan(low)
            continue
        near = [e for e, q in zip(effects, curve.probability, strict=True) if p <= q <= 10 * p]
        effect = 0.75 * max(near) + 0.25 * np.mean(near)
        k, n = total * p / effect, total / effect
        limits = stats.beta.ppf([0.025, 0.975], k + 0.5, n - k + 0.5)
        assert (low, high) == pytest.approx(limits, rel=1e-9)
        checked += 1
    assert checked > 5


def test_the_point_of_a_level_is_the_nearest_by_ratio():
    grid = np.arange(3.0)
    measured = ExceedanceCurve(grid, np.array([0.5, 0.017, 0.004]), *np.full((2, 3), 0.01), 1000)
    found = false_alarm_ratio(measured, measured, 1e-2)
    assert (found.at, found.value) == (1, pytest.approx(1.0))


def test_limits_of_draws_are_the_third_from_each_end_of_119():
    low, high = SamplingBand.limits(np.random.default_rng(0).permutation(119).astype(float) + 1)
    assert (low, high) == (3.0, 117.0)  # a further draw is below 3 of 120 places, or above: 6/120 = 0.05


@pytest.mark.parametrize("kappa", [0.0, 2.0])
def test_variance_of_a_single_direction_has_the_scatter_of_its_tails(kappa):
    # (2 + 3 kappa)/n (Waternaux 1976); 6,000 draws know a variance to 2 %, 4.5 of which are allowed.
    rng = np.random.default_rng(6)
    drawn = np.array([drawn_factor(1, 3000, rng, kappa)[0, 0] ** 2 for _ in range(6000)])
    assert drawn.var() == pytest.approx((2 + 3 * kappa) / 3000, rel=0.09)


# SNR, tails, independence -------------------------------------------------------------------------


def test_snr_of_few_pixels_by_definition():
    n, dof, bands = 24, 21, 5
    rng = np.random.default_rng(7)
    x = np.array([50.0, 60.0, 66.0, 70.0, 71.0]) * (1 + 0.02 * rng.normal(size=(n, 1))) + rng.normal(size=(n, bands))
    m, s = x.mean(axis=0), np.cov(x.T) * (n - 1) / dof
    expected = []
    for b, (i, j) in enumerate([(1, 2), (0, 2), (1, 3), (2, 4), (2, 3)]):
        design = np.column_stack([np.ones(n), x[:, i], x[:, j]])
        c, rest, *_ = np.linalg.lstsq(design, x[:, b], rcond=None)
        errors = (rest[0] / dof * np.linalg.inv(design.T @ design))[1:, 1:]  # ordinary least squares
        pairs = [(k, q) for k in range(bands) for q in range(k) if b not in (k, q) and max(abs(k - b), abs(q - b)) <= 2]
        texture = np.mean([s[k, q] * m[b] ** 2 / m[k] / m[q] for k, q in pairs])
        h = m[[i, j]] / m[b]
        unexplained = ((1 - c[1:] @ h) ** 2 - h @ errors @ h) * texture
        assert abs(unexplained) < (rest[0] / dof) ** 2 / (2 * texture)
        noise = (rest[0] / dof - unexplained) / (1 + c[1:] @ c[1:] - np.trace(errors))
        expected.append(m[b] / np.sqrt(noise / (1 - 2 / (9 * dof)) ** 3))
    found = snr_decorrelated(x)
    assert found.mean == pytest.approx(expected, rel=1e-9)
    assert found.budget["mean"] == pytest.approx(np.full(bands, 1 / np.sqrt(n)))


@pytest.mark.simulation
@pytest.mark.parametrize("estimated", [False, True])
def test_limits_of_tails_are_where_the_likelihood_has_dropped(estimated):
    rng = np.random.default_rng(8)
    n, p, nu = 400, 6, 7.0
    x = rng.standard_normal((n, p)) * np.sqrt((nu - 2) / rng.chisquare(nu, n))[:, None]
    z = x - x.mean(axis=0)
    d = np.einsum("ij,jk,ik->i", z, np.linalg.inv(np.cov(x.T)), z)
    found = fit_tail_dof(d, p, estimated_on=n if estimated else None)
    # Distances from the other pixels of a normal law are a t of n - 1 - p degrees of freedom already.
    used, offset = (left_out_distances(d, n), 1 / (n - 1 - p)) if estimated else (d, 0.0)
    grid = np.linspace(0.0, 0.49 - offset, 4000)
    likelihood = np.array([tail_log_likelihood(a + offset, used, p) for a in grid])
    top = likelihood.max()
    inside = grid[likelihood >= top - stats.chi2.ppf(0.95, 1) / 2]
    assert 1 / found.dof == pytest.approx(grid[likelihood.argmax()], abs=2e-4)
    assert (1 / found.upper, 1 / found.lower) == pytest.approx((inside[0], inside[-1]), abs=2e-4)
    # Half the tail of chi-square, as nu = inf is the end of the range.
    p_value = 0.5 * stats.chi2.sf(2 * (top - likelihood[0]), 1)
    assert found.normality_p_value == pytest.approx(p_value, rel=0.01, abs=0)


def test_independent_pixels_behind_a_variance_are_those_of_the_squared_correlation():
    # Blurred noise, sd w: rho = exp(-h^2/(4 w^2)).  Over 12 fields of 4,096 pixels the number is known to some 3 %.
    rng = np.random.default_rng(9)
    size, w, reach = 64, 1.6, 16
    shares = neighbour_shares(np.ones((size, size), bool), reach, rng)
    steps = np.arange(-reach, reach + 1)
    rho = np.exp(-(np.hypot(steps[:, None], steps[None]) ** 2) / (4 * w**2))
    found = []
    for _ in range(12):
        z = ndimage.gaussian_filter(rng.standard_normal((size, size)), w, mode="wrap")
        windows = [(((z - z.mean()) / z.std())[None], np.ones((size, size), bool))]
        found.append([v[0] for v in independent_pixels(windows, shares, size**2, reach)])
    for_mean, for_variance = np.mean(found, axis=0)
    assert for_variance == pytest.approx(size**2 / np.sum(rho**2 * shares), rel=0.15)
    assert for_mean == pytest.approx(size**2 / np.sum(rho * shares), rel=0.25)


def test_a_ring_counts_where_its_mean_is_two_standard_errors_of_its_pairs_above_nought():
    # 101 pixels of +-1 in a line, of whose 100 pairs c differ: rho = 1 - c / 50, and 0.2 is two standard errors.
    shares = np.array([[0.0, 0, 0], [1, 1, 1], [0, 0, 0]])
    for changes, independent in ((41, 101.0), (38, 101.0 / (1.0 + 2.0 * 0.24**2))):
        sign = np.ones((1, 1, 101))
        sign[..., np.linspace(1, 100, changes).astype(int)] = -1.0
        found = independent_pixels([(np.cumprod(sign, axis=-1), np.ones((1, 101), bool))], shares, 101, 1)[1]
        assert found == pytest.approx([independent])


def test_noise_of_one_band_has_the_scatter_of_its_tails_and_of_its_columns():
    # (2 + 3 kappa)/n of the square for the pixels (Waternaux 1976), 2/(columns - 1) for what the columns share.
    found = noise_part([[8.0]], [[4.0]], [4.0], 100.0, 2.0, calibration=[1.0], samples=11)
    assert (found.factor, found.uncertainty**2) == pytest.approx((2.0, 4.0 * 8.0 / 100.0 + 0.2 / 16.0))


# Classification -----------------------------------------------------------------------------------


def test_pixels_of_a_t_law_have_the_covariance_that_is_stated():
    # 200,000 pixels of 8 degrees of freedom: a variance is known to 0.5 %.
    covariance = np.array([[2.0, 0.6], [0.6, 1.0]])
    x = ClassLaw(np.zeros(2), covariance, 8.0).draw(200_000, np.random.default_rng(10))
    assert np.cov(x.T) == pytest.approx(covariance, rel=0.025)


def test_distances_of_three_classes_take_the_nearest_pair():
    laws = [ClassLaw(np.array([at]), np.eye(1)) for at in (0.0, 1.0, 4.0)]
    found = with_distances(ClassificationError(0.2, 0.1, 0.3, 100), laws)
    distance = [d**2 / 8 for d in (1.0, 4.0, 3.0)]
    assert found.distance == pytest.approx(min(distance))
    pair = [0.5 - 0.5 * np.sqrt(1 - np.exp(-2 * d)) for d in distance]
    assert found.bound_lower == pytest.approx(2 / 3 * max(pair))
    assert found.bound_upper == pytest.approx(min(sum(np.exp(-d) for d in distance) / 3, 2 / 3))
    assert found.approximation == pytest.approx(sum(2 / 3 * stats.norm.cdf(-d / 2) for d in (1.0, 4.0, 3.0)))


def test_spread_of_the_error_from_block_to_block_by_hand():
    laws = [ClassLaw(np.array([at]), np.eye(1)) for at in (0.0, 10.0)]
    good, bad = np.zeros((10, 1)), np.full((10, 1), 10.0)
    # The first class: blocks of 0, 2 and 4 errors of 10; the second errs 3 times in 30, once a block.
    first = np.concatenate([good, good[:8], bad[:2], good[:6], bad[:4]])
    second = np.concatenate([np.concatenate([bad[:9], good[:1]])] * 3)
    block = np.repeat([0, 1, 2], 10)
    found = measured_error(laws, [first, second], [block, block])
    between = 3 / 2 * (2.0**2 + 2.0**2) / 30**2  # about 2 a block; that of the second class is 0
    variance = (between + 0.1 * 0.9 / 30) / 4
    assert found.error == pytest.approx(0.15)
    assert found.effective_n == pytest.approx(0.15 * 0.85 / variance)
