"""What predict() gives, against the same scene worked out here: by plain arithmetic, and by drawing its pixels.

Nothing of the model is used but the inputs (spectra, terms, noise of the sensor).  Slopes are differences of the
signal; every covariance is put together from them.  The filter is solved anew.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm
from stand_in_atmosphere import blue_and_haze, smooth_terms, sunlight

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.config import parse_yaml, validate
from hyperval.model import Origins, predict
from hyperval.products import background_of
from hyperval.scenario import Scenario
from hyperval.sensor import load_sensor
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import builtin_class

AXIS = SpectralAxis(np.array([450.0, 550, 670, 750, 860, 1050, 1240, 1650, 2130, 2250]), np.full(10, 10.0))
SCENE = """
schema: 1
name: small
scene:
  adjacency: {effective_neighbours: null}
  classes:
    - {name: grass, fraction: 0.7, spectrum: {builtin: grass}}
    - {name: asphalt, fraction: 0.3, spectrum: {builtin: asphalt}}
  targets:
    - name: plank
      spectrum: {builtin: yellow-paint-plank}
      host: asphalt
      subjects:
        - {name: tenth, fill: {fixed: 0.1}}
        - {name: loose, fill: {mean: 0.15, sd: 0.05}}
        - {name: full, fill: {fixed: 1}}
processing: {detectors: [cem], bands: {drop_bad: false}}
atmosphere: {aot550: 0.2, water_vapour_g_cm2: 2.0, sensor_altitude_km: 1, solar_zenith_deg: 30,
             solar_azimuth_deg: 0, day_of_year: 200}
sensor: prospectir-vs
"""
SHARES = {"grass": 0.7, "asphalt": 0.3}


def engine(state: AtmosphericState) -> AtmosphericTerms:
    """A smooth atmosphere; a dim sun makes noise half of the variance of the score at a fill of a tenth."""
    blue, haze = blue_and_haze(0.2)
    sun = 0.01 * sunlight() + 0.19
    return smooth_terms(blue, haze, sun, sun * np.exp(-0.5 * haze) / np.pi, path=(0.05, 0.02))


class ByHand:
    """The scene: signal of a reflectance, its retrieval, and the matched filter against the whole background."""

    def __init__(self) -> None:
        self.terms = engine(scene().atmosphere).at_bands(AXIS)
        self.noise = load_sensor("prospectir-vs").noise(AXIS)
        self.surfaces = {n: builtin_class(n, AXIS) for n in ("grass", "asphalt", "yellow-paint-plank")}
        self.average = sum(share * self.surfaces[n].mean for n, share in SHARES.items())
        low, high = self.signal(np.full(10, 0.1)), self.signal(np.full(10, 0.6))
        self.gain = (high - low) / 0.5  # signal per reflectance, two panels
        self.offset = low - 0.1 * self.gain
        self.slope = self.signal(self.average + 0.5) - self.signal(self.average - 0.5)
        d = self.surfaces["yellow-paint-plank"].mean - self.average
        within = sum(share * self.seen(n) for n, share in SHARES.items())
        between = sum(
            share * np.outer(self.surfaces[n].mean - self.average, self.surfaces[n].mean - self.average)
            for n, share in SHARES.items()
        )
        solved = np.linalg.solve(within + between, d)
        self.weights = solved / (d @ solved)

    def signal(self, rho):
        trapped = 1.0 / (1.0 - self.terms.spherical_albedo * self.average)
        return self.terms.path_radiance + (self.terms.direct * rho + self.terms.adjacency * self.average) * trapped

    def noise_of(self, rho):
        """Noise variance of the retrieved reflectance."""
        return self.noise.variance(self.signal(rho)) / self.gain**2

    def seen(self, name):
        """Covariance of the class's pixels as retrieved."""
        c, scale = self.surfaces[name], self.slope / self.gain
        return scale[:, None] * c.covariance * scale + np.diag(self.noise_of(c.mean))

    def score(self, rho):
        """Score of a retrieved reflectance: 0 at the background's mean, 1 at the target's."""
        return (rho - self.average) @ self.weights

    def moments(self, fill):
        """Mean and variance of the score of a pixel with this fill."""
        target, host = self.surfaces["yellow-paint-plank"], self.surfaces["asphalt"]
        rho = fill * target.mean + (1 - fill) * host.mean
        u = self.weights * self.slope / self.gain
        spread = fill**2 * (u @ target.covariance @ u) + (1 - fill) ** 2 * (u @ host.covariance @ u)
        return self.score(rho), spread + self.weights**2 @ self.noise_of(rho)


def scene() -> Scenario:
    data, lines = parse_yaml(SCENE)
    return validate(Scenario, data, lines, "text")


@pytest.mark.parametrize(("subject", "fill"), [("tenth", 0.1), ("full", 1.0)])
def test_3_26_and_3_28_scores_of_a_fill_by_plain_arithmetic(subject, fill):
    mean, variance = ByHand().moments(fill)
    scores = predict(scene(), Origins(axis=AXIS, engine=engine)).scores[subject, "cem"]
    assert scores.mean == pytest.approx(mean, rel=1e-9)
    assert scores.sd**2 == pytest.approx(variance, rel=1e-6)


def test_3_28_scores_of_a_random_fill_by_the_law_of_total_variance():
    """Mean and variance given the fill, averaged over it; both are smooth, so its two moments say nearly all."""
    hand = ByHand()
    f = np.array([0.15 - 0.05, 0.15 + 0.05])  # the two points that have the fill's mean and variance
    means, variances = np.array([hand.moments(x) for x in f]).T
    scores = predict(scene(), Origins(axis=AXIS, engine=engine)).scores["loose", "cem"]
    assert scores.mean == pytest.approx(means.mean(), rel=1e-6)
    assert scores.sd**2 == pytest.approx(variances.mean() + means.var(), rel=1e-4)


def test_3_27_and_3_29_scores_of_the_background_by_plain_arithmetic():
    hand = ByHand()
    theta = np.array([hand.score(hand.surfaces[n].mean) for n in SHARES])
    sigma2 = np.array([hand.weights @ hand.seen(n) @ hand.weights for n in SHARES])
    share = np.array(list(SHARES.values()))
    scores = predict(scene(), Origins(axis=AXIS, engine=engine)).scores[background_of("tenth"), "cem"]
    assert scores.mean == pytest.approx(share @ theta, abs=1e-9)
    assert scores.sd**2 == pytest.approx(share @ (sigma2 + theta**2), rel=1e-6)


def test_3_30_to_3_33_the_curve_by_plain_arithmetic():
    hand = ByHand()
    curve = predict(scene(), Origins(axis=AXIS, engine=engine)).roc["tenth", "cem", "pixel"]
    mean, variance = hand.moments(0.1)
    pfa = sum(
        share * norm.sf(curve.threshold, hand.score(hand.surfaces[n].mean),
                        np.sqrt(hand.weights @ hand.seen(n) @ hand.weights))
        for n, share in SHARES.items()
    )  # fmt: skip
    some = (curve.pfa > 1e-8) & (curve.pfa < 0.99)
    assert some.sum() > 20
    assert curve.pfa[some] == pytest.approx(pfa[some], rel=1e-5)
    assert curve.pd[some] == pytest.approx(norm.sf(curve.threshold[some], mean, np.sqrt(variance)), abs=1e-6)
