"""ROC of the model: thresholds, areas and readings by other routes; limits of curves; errors of fitted laws; ACE."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, stats
from scipy.special import ndtr, ndtri
from scipy.stats import norm
from score_classes import classes, roc_of

from hyperval import model
from hyperval.pixels import moments_without_each
from hyperval.products import ExceedanceCurve, RocCurve
from hyperval.scenario import load_scenario
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import ClassStatistics


def test_a_target_like_its_background_is_on_the_diagonal():
    pfa, alike = model.false_alarm_grid(), roc_of(0.2, 0.3, 1.0, classes((1.0, 0.2, 0.3)))
    assert alike.detection(pfa[None])[0] == pytest.approx(pfa, rel=1e-6)


def binormal(pfa: np.ndarray, d: float = 2.5) -> RocCurve:
    """Two normal scores ``d`` standard deviations apart, in closed form."""
    pd = norm.sf(norm.isf(pfa) - d)
    return RocCurve(pfa, pd, pd - 0.01, pd + 0.01, norm.isf(pfa))


def test_a_coarse_grid_reads_as_a_fine_one():
    """Curves of normal scores are straight in probits, so that a grid of one point a decade loses nothing."""
    coarse, at = binormal(10.0 ** np.arange(-5.0, 0.0)), np.geomspace(1e-5, 0.1, 40)
    truth = norm.sf(norm.isf(at) - 2.5)
    assert model.detection_at(coarse, at) == pytest.approx(truth, abs=1e-12)
    straight = np.interp(np.log(at), np.log(coarse.pfa), coarse.pd)
    assert np.abs(straight - truth).max() > 0.01  # the reading in P_D itself is not right


def test_points_of_the_curve_are_read_as_they_stand():
    curve = binormal(np.logspace(-6, -1, 11))
    assert model.detection_at(curve, curve.pfa) == pytest.approx(curve.pd, abs=0, rel=0)
    assert model.detection_at(curve, 1e-3, curve.pd_lower) == curve.pd_lower[6]
    assert np.isnan(model.detection_at(curve, [1e-7, 0.2])).all()
    # Steps of a measured curve that have no probit.
    curve = RocCurve(np.array([1e-3, 1e-2, 1e-1]), np.array([0.0, 0.5, 1.0]), *(np.zeros(3),) * 3)
    assert model.detection_at(curve, np.sqrt([1e-5, 1e-3])) == pytest.approx([0.25, 0.75])
    one = RocCurve(np.array([1e-2]), np.array([0.5]), *(np.zeros(1),) * 3)
    assert model.detection_at(one, 1e-2) == 0.5
    assert np.isnan(model.detection_at(one, 1e-3))


# Two classes, one with a tail, and targets of two fills.
FRACTION, MEAN, SD, DOF = (0.7, 0.3), (0.0, 0.1), (0.05, 0.08), (np.inf, 5.0)
MEANS, SDS, WEIGHTS = (0.15, 0.3), (0.04, 0.06), (0.4, 0.6)


def law(m):
    if np.isinf(DOF[m]):
        return stats.norm(MEAN[m], SD[m])
    return stats.t(DOF[m], MEAN[m], SD[m] * np.sqrt((DOF[m] - 2.0) / DOF[m]))


def scores(fills=slice(None), classes=slice(None)):
    background = model.ClassScores(*(np.array([np.array(a)[classes]]) for a in (FRACTION, MEAN, SD, DOF)))
    target = (np.array([np.array(a)[fills]]) for a in (MEANS, SDS, WEIGHTS))
    return model.RocScores(background, np.zeros(1, int), *target)


def test_the_area_is_the_integral_over_background_and_target():
    def outscored(x):
        return sum(w * stats.norm.sf(x, m, s) for m, s, w in zip(MEANS, SDS, WEIGHTS, strict=True))

    expected = sum(
        f * integrate.quad(lambda x, m=m: law(m).pdf(x) * outscored(x), -2.0, 2.0, points=[0.1, 0.3], epsabs=1e-10)[0]
        for m, f in enumerate(FRACTION)
    )
    assert scores().auc() == pytest.approx([expected], abs=2e-5)  # 64 nodes in the quantile of the tail
    whole = scores()
    pfa = np.geomspace(1e-7, 0.999, 4000)[None]
    assert np.trapezoid(whole.detection(pfa)[0], pfa[0]) == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("fills", [slice(0, 1), slice(None)])
@pytest.mark.parametrize("pd", [0.05, 0.5, 0.9])
def test_false_alarms_at_a_detection_are_those_of_the_threshold_that_gives_it(fills, pd):
    made = scores(fills)
    made = model.RocScores(made.classes, made.which, made.means, made.sds, made.weights / made.weights.sum())
    pfa = 10.0 ** made.log10_false_alarm(np.array([pd]))
    assert made.detection(pfa[:, None])[0, 0] == pytest.approx(pd, abs=1e-9)
    if made.means.size == 1:
        at = stats.norm.isf(pd, MEANS[0], SDS[0])
        assert pfa[0] == pytest.approx(sum(f * law(m).sf(at) for m, f in enumerate(FRACTION)), rel=1e-9)


def test_evaluations_without_scores_have_no_threshold():
    background = model.ClassScores(*(np.array([a, a]) for a in (FRACTION, MEAN, SD, DOF)))
    background.mean[1, 0] = np.nan
    made = model.RocScores(background, np.array([0, 1]), *[np.array([a, a]) for a in (MEANS, SDS, WEIGHTS)])
    threshold = made.thresholds(np.array([[1e-2, 1e-1]]))
    assert np.isfinite(threshold[0]).all()
    assert np.isnan(threshold[1]).all()
    assert np.isnan(made.thresholds(np.array([[0.0, 0.1], [0.1, 1.1]]))).all()


def test_thresholds_beside_a_class_that_hardly_varies():
    """A narrow class of a millionth of the area puts a small step into a smooth tail."""
    rows = [[1.0 - 1e-6, 1e-6], [0.0, 0.05], [0.02, 1e-9], [np.inf, np.inf]]
    scores = model.ClassScores(*np.array(rows)[:, None, :])
    step = float(np.exp(model.log_false_alarm(np.array([0.05]), scores)[0][0]))
    pfa = step + np.linspace(-0.7e-6, 0.7e-6, 41)
    x = model.thresholds_at(pfa[None], scores)[0]
    value, _ = model.log_false_alarm(x, scores.rows(np.zeros(x.size, int)))
    np.testing.assert_allclose(value, np.log(pfa), rtol=0, atol=1e-11)


# Limits of curves whose inputs move them.
ROC = ("s", "cem", "pixel")
GRID = np.logspace(-9, -0.01, 60)


def straight(d: float = 3.0) -> RocCurve:
    pd = ndtr(d + ndtri(GRID))
    return RocCurve(GRID, pd, pd, pd, -ndtri(GRID))


def limits(base: RocCurve, changes) -> tuple[np.ndarray, np.ndarray]:
    up, down = (np.array([pair[i] for pair in changes]) for i in (0, 1))
    found = model.with_pd_limits({ROC: base}, {ROC: (up, down)})[ROC]
    return found.pd_lower, found.pd_upper


def test_one_input_that_shifts_the_curve_gives_its_own_interval():
    """2048 evenly spread draws of one number: limits to 1 % of the half width."""
    low, high = limits(straight(), [(np.full(60, 0.3), np.full(60, -0.3))])
    z = 3.0 + ndtri(GRID)
    assert ndtri(high) - z == pytest.approx(1.96 * 0.3, rel=0.01)
    assert z - ndtri(low) == pytest.approx(1.96 * 0.3, rel=0.01)


def test_a_change_that_one_side_alone_makes_widens_that_side_alone():
    """An input that can only hurt; 2048 draws know its limits to half a per cent."""
    low, high = limits(straight(), [(np.zeros(60), np.full(60, -0.5))])
    z = 3.0 + ndtri(GRID)
    assert ndtri(high) == pytest.approx(z, abs=0.005)
    assert z - ndtri(low) == pytest.approx(1.96 * 0.5, abs=0.005)


@given(st.integers(0, 10_000))
@settings(max_examples=30)
def test_limits_rise_and_hold_the_curve(seed):
    rng = np.random.default_rng(seed)
    base = straight(float(rng.uniform(0, 6)))
    changes = [tuple(rng.normal(0, 2, 2)[:, None] * rng.normal(0, 1, 60).cumsum() / 8) for _ in range(3)]
    low, high = limits(base, changes)
    assert np.all(np.diff(low) >= 0)
    assert np.all(np.diff(high) >= 0)
    assert np.all(low <= base.pd)
    assert np.all(high >= base.pd)


# Errors of a law that was fitted to pixels.
BANDS, PIXELS = 6, 3200
AXIS = SpectralAxis(np.linspace(450.0, 850.0, BANDS), np.full(BANDS, 10.0))
WIDE = 2.131449545559323 / 1.959963984540054  # t of 15 degrees of freedom
KEY = ("panel", "cem")
LAW = load_scenario(Path(__file__).with_name("law.yaml"))


@pytest.fixture(scope="module")
def origins():
    rng = np.random.default_rng(8)
    root = 0.03 * np.tril(np.ones((BANDS, BANDS))) * np.linspace(1.0, 0.4, BANDS)
    pixels = 0.3 + rng.normal(size=(PIXELS, BANDS)) @ root.T
    part = np.repeat(np.arange(16), PIXELS // 16)
    whole = ClassStatistics("field", AXIS, pixels.mean(axis=0), np.cov(pixels.T), PIXELS)
    without = [replace(whole, mean=m, covariance=c) for m, c in moments_without_each(pixels, part)]
    return model.Origins(AXIS, {"field": whole}, left_out=lambda: [("field", without)])


def test_independent_pixels_have_the_error_of_the_delta_method(origins):
    """ln P_FA of a normal law at z: (phi/P)^2 (1 + z^2/2)/n; 16 parts know a variance to 37 %."""
    curve = model.predict(LAW, origins).exceedance[KEY]
    for level in (1e-1, 1e-2, 1e-3):
        at = int(np.argmin(np.abs(np.log(curve.probability / level))))
        z = norm.isf(curve.probability[at])
        expected = norm.pdf(z) / curve.probability[at] * np.sqrt((1.0 + z**2 / 2.0) / PIXELS)
        sd = np.log(curve.upper[at] / curve.lower[at]) / 2.0 / 1.96 / WIDE
        assert sd == pytest.approx(expected, rel=0.55)  # three standard errors of the root


def test_detection_at_a_false_alarm_rate_has_it_too(origins):
    """P_D at a P_FA moves by the change of ln P_FA at the threshold, times the slope of the curve over ln P_FA."""
    prediction = model.predict(LAW, origins)
    curve, alarms = prediction.roc[("panel", "cem", "pixel")], prediction.exceedance[KEY]
    at = int(np.argmin(np.abs(curve.pd - 0.9)))
    assert alarms.probability[::-1] == pytest.approx(curve.pfa)
    error = np.log(alarms.upper / alarms.probability)[::-1][at]
    slope = np.gradient(curve.pd, np.log(curve.pfa))[at]
    assert 0.5 * (curve.pd_upper - curve.pd_lower)[at] == pytest.approx(error * slope, rel=0.15)
    stated = model.predict(LAW, replace(origins, left_out=None))
    plain = stated.roc[("panel", "cem", "pixel")]
    np.testing.assert_array_equal(plain.pd, curve.pd)  # values stay
    np.testing.assert_array_equal(plain.pd_lower, plain.pd)
    np.testing.assert_array_equal(stated.exceedance[KEY].upper, stated.exceedance[KEY].probability)


def test_what_a_law_does_not_say_far_out_stays_there():
    """Where P_FA of 1e-6 is known to a factor of a million, P_D at 1e-2 has the limits of P_FA at 1e-2."""
    pfa = np.logspace(-6, -0.01, 60)
    pd = ndtr(2.0 + ndtri(pfa))
    curve = RocCurve(pfa, pd, pd, pd, -ndtri(pfa))
    half = np.log(1.1) * np.maximum(np.log(pfa) / np.log(1e-2), 0.1) ** 6
    alarms = ExceedanceCurve(-ndtri(pfa)[::-1], pfa[::-1], *((pfa * np.exp(s * half))[::-1] for s in (-1, 1)))
    limits = model.with_law_limits(curve, alarms)
    assert np.all(np.diff(limits.pd_lower) >= 0)
    assert np.all(np.diff(limits.pd_upper) >= 0)
    at = int(np.argmin(np.abs(pfa - 1e-2)))
    for limit, factor in ((limits.pd_lower, 1.0 / 1.1), (limits.pd_upper, 1.1)):
        expected = ndtr(2.0 + ndtri(pfa[at] * factor ** ((np.log(pfa[at]) / np.log(1e-2)) ** 6)))
        assert limit[at] == pytest.approx(expected, rel=0.02)
    own = replace(curve, pd_lower=ndtr(ndtri(pd) - 0.3), pd_upper=ndtr(ndtri(pd) + 0.4))
    both = model.with_law_limits(own, alarms)
    z = ndtri(pd[at])
    assert ndtri(both.pd_upper[at]) - z == pytest.approx(np.hypot(0.4, ndtri(limits.pd_upper[at]) - z), rel=1e-6)
    assert z - ndtri(both.pd_lower[at]) == pytest.approx(np.hypot(0.3, z - ndtri(limits.pd_lower[at])), rel=1e-6)


# ACE on statistics.


@pytest.fixture(scope="module")
def space():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(BANDS, 3 * BANDS))
    covariance = a @ a.T / (3 * BANDS)
    mean = rng.normal(size=BANDS)
    return model.ace_space(mean + rng.normal(size=BANDS), mean, covariance), mean, covariance


def test_stated_error_is_the_scatter_of_repetition(space):
    # 60 repetitions know a standard deviation to 9 %; four of that are allowed.
    of, mean, covariance = space
    far = mean + np.linspace(0.5, 2.0, BANDS)
    rngs = map(np.random.default_rng, range(60))
    runs = [model.ace_exceedance(of, far, covariance, 500, rng, scores=[0.2, 0.6]) for rng in rngs]
    scatter = np.std([r.probability for r in runs], axis=0, ddof=1)
    assert np.mean([r.standard_error for r in runs], axis=0) == pytest.approx(scatter, rel=0.37)


def test_threshold_and_exceedance_are_inverse():
    law = stats.beta(0.5, 3.0)
    scores = np.tanh(np.linspace(1e-3, 3.0, 400)) ** 2
    population = model.Exceedance(scores, law.sf(scores), np.zeros(scores.size))
    pfa = np.array([0.3, 1e-2, 1e-4])
    at = model.ace_threshold(pfa, [1.0], [population])
    assert at == pytest.approx(law.isf(pfa), rel=2e-3)
    assert model.exceedance_at(at, population) == pytest.approx(pfa, rel=1e-2)
    # Two classes of which one never alarms: the other's own P_FA is twice as large.
    silent = model.Exceedance(scores, np.full(scores.size, 1e-300), np.zeros(scores.size))
    assert model.ace_threshold(pfa / 2, [0.5, 0.5], [population, silent]) == pytest.approx(at, rel=1e-9)
