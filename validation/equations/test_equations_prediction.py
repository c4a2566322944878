"""What predict() gives, against the same scene worked out by plain arithmetic (``plain_scene.py``).

Nothing of the model is used but the inputs (spectra, terms, noise of the sensor).
"""

from __future__ import annotations

import numpy as np
import pytest
from plain_scene import PlainScene
from scipy.stats import norm
from stand_in_atmosphere import blue_and_haze, smooth_terms, sunlight
from uncertain_scene import AXIS, scenario

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.model import Origins, predict
from hyperval.products import background_of
from hyperval.scenario import Scenario
from hyperval.sensor import load_sensor
from hyperval.statistics_library import builtin_class

SHARES = {"grass": 0.7, "asphalt": 0.3}


def engine(state: AtmosphericState) -> AtmosphericTerms:
    """A smooth atmosphere; a dim sun makes noise half of the variance of the score at a fill of a tenth."""
    blue, haze = blue_and_haze(0.2)
    sun = 0.01 * sunlight() + 0.19
    return smooth_terms(blue, haze, sun, sun * np.exp(-0.5 * haze) / np.pi, path=(0.05, 0.02))


def by_hand() -> PlainScene:
    """The scene, without neighbours."""
    surfaces = {n: builtin_class(n, AXIS) for n in (*SHARES, "yellow-paint-plank")}
    terms, noise = engine(scene().atmosphere).at_bands(AXIS), load_sensor("prospectir-vs").noise(AXIS)
    return PlainScene(terms, noise, surfaces, SHARES, "yellow-paint-plank", "asphalt")


def scene() -> Scenario:
    """That of the budgets, without neighbours and with a full pixel besides."""
    alone, full = "scene:\n  adjacency: {effective_neighbours: null}", "        - {name: full, fill: {fixed: 1}}\n"
    return scenario(**{"scene:": alone, "processing:": full + "processing:"})


@pytest.mark.parametrize(("subject", "fill"), [("tenth", 0.1), ("full", 1.0)])
def test_3_26_and_3_28_scores_of_a_fill_by_plain_arithmetic(subject, fill):
    hand = by_hand()
    mean, variance = hand.scores(hand.pixel(fill))
    scores = predict(scene(), Origins(axis=AXIS, engine=engine)).scores[subject, "cem"]
    assert scores.mean == pytest.approx(mean, rel=1e-9)
    assert scores.sd**2 == pytest.approx(variance, rel=1e-6)


def test_3_28_scores_of_a_random_fill_by_the_law_of_total_variance():
    """Mean and variance given the fill, averaged over it; both are smooth, so its two moments say nearly all."""
    hand = by_hand()
    f = np.array([0.15 - 0.05, 0.15 + 0.05])  # the two points that have the fill's mean and variance
    means, variances = np.array([hand.scores(hand.pixel(x)) for x in f]).T
    scores = predict(scene(), Origins(axis=AXIS, engine=engine)).scores["loose", "cem"]
    assert scores.mean == pytest.approx(means.mean(), rel=1e-6)
    assert scores.sd**2 == pytest.approx(variances.mean() + means.var(), rel=1e-4)


def test_3_27_and_3_29_scores_of_the_background_by_plain_arithmetic():
    hand = by_hand()
    theta, sigma2 = np.array([hand.scores(own) for own in hand.classes.values()]).T
    share = np.array(list(SHARES.values()))
    scores = predict(scene(), Origins(axis=AXIS, engine=engine)).scores[background_of("tenth"), "cem"]
    assert scores.mean == pytest.approx(share @ theta, abs=1e-9)
    assert scores.sd**2 == pytest.approx(share @ (sigma2 + theta**2), rel=1e-6)


def test_3_30_to_3_33_the_curve_by_plain_arithmetic():
    hand = by_hand()
    curve = predict(scene(), Origins(axis=AXIS, engine=engine)).roc["tenth", "cem", "pixel"]
    mean, variance = hand.scores(hand.pixel(0.1))
    classes = {share: hand.scores(hand.classes[name]) for name, share in SHARES.items()}
    pfa = sum(share * norm.sf(curve.threshold, theta, np.sqrt(own)) for share, (theta, own) in classes.items())
    some = (curve.pfa > 1e-8) & (curve.pfa < 0.99)
    assert some.sum() > 20
    assert curve.pfa[some] == pytest.approx(pfa[some], rel=1e-5)
    assert curve.pd[some] == pytest.approx(norm.sf(curve.threshold[some], mean, np.sqrt(variance)), abs=1e-6)
