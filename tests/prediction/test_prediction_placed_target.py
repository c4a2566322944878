"""Mean spectra of objects with a place: against pixels painted finely, and what the test of them can tell."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, uniform_filter

from hyperval.compare import chi_square_full
from hyperval.config import parse_yaml, validate
from hyperval.model import HOST, PLACE, Origins, Shares, predict, shares_of
from hyperval.scenario import Scenario
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import builtin_class

AXIS = SpectralAxis(np.array([450.0, 550, 670, 750, 860, 1050, 1240, 1650, 2130, 2250]), np.full(10, 10.0))
BLUR, GSD, N = 0.8, 0.7, 6
SCENE = """
schema: 1
name: small
scene:
  classes:
    - {name: grass, fraction: 1.0, spectrum: {builtin: grass}}
  targets:
    - name: plank
      spectrum: {builtin: yellow-paint-plank}
      covariance: {relative_sd: 0.02}
      host: grass
      subjects:
        - {name: square, PLACE fill: {geometry: {
            side_m: SIDE, gsd_m: 0.7, heading_deg: 0, psf_fwhm_pixels: 0.8, pixels: ranked, n: 6}}}
    - name: other
      spectrum: {builtin: green-paint-plank}
      covariance: {relative_sd: 0.02}
      host: grass
      subjects:
        - {name: beside, THERE fill: {geometry: {
            side_m: 1, gsd_m: 0.7, heading_deg: 0, psf_fwhm_pixels: 0.8, pixels: ranked, n: 6}}}
processing: {detectors: [cem], elm: none}
"""


def scenario(place="position_m: [0, 0],", there="position_m: [0, 1.4],", side="1", extra="", paint="yellow"):
    text = SCENE.replace("yellow", paint).replace("PLACE", place).replace("THERE", there).replace("SIDE", side) + extra
    data, lines = parse_yaml(text, "small.yaml")
    return validate(Scenario, data, lines, "small.yaml")


def shares(position=None, **changes) -> Shares:
    world = scenario(**changes)
    target = world.scene.targets[0]
    found = shares_of(target, target.populations[0], world.scene.targets, position, 1)
    assert found is not None
    return found


def painted(draws: int, rng: np.random.Generator) -> np.ndarray:
    """(draws, 2) shares of the six fullest pixels: squares painted on a grid of 1/14 pixel, blurred and binned."""
    fine, across = 14, 15
    sigma = BLUR / 2.354820045 * fine
    side, away = 1.0 / GSD * fine, 1.4 / GSD * fine
    out = []
    for _ in range(draws):
        top, left = rng.uniform(-0.5, 0.5, 2) * fine + 0.5 * across * fine - 0.5 * side
        edges = np.arange(across * fine)
        rows = np.clip(edges + 1 - top, 0, 1) * np.clip(top + side - edges, 0, 1)
        layers = []
        for first in (left, left + away):
            columns = np.clip(edges + 1 - first, 0, 1) * np.clip(first + side - edges, 0, 1)
            blurred = gaussian_filter(np.outer(rows, columns), sigma)
            layers.append(uniform_filter(blurred, fine, origin=-1)[::fine, ::fine])
        fullest = np.argsort(-layers[0].ravel())[:N]
        out.append([layer.ravel()[fullest].mean() for layer in layers])
    return np.array(out)


def test_shares_are_those_of_squares_painted_finely():
    # 60 places: the sd of a share (0.02) over sqrt(60) is 0.0026; 0.012 is 4.6 of it, false failure 4e-6 for each.
    drawn = painted(60, np.random.default_rng(2))
    found = shares()
    assert found.names == ("plank", "other")
    assert found.mean == pytest.approx(drawn.mean(axis=0), abs=0.012)
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(drawn.std(axis=0), abs=0.012)
    assert found.mean[1] > 0.02


def test_an_object_alone_has_the_mean_of_its_fill_and_the_spread_of_its_host():
    found = shares(there="position_m: [0, 40],")
    p = predict(scenario(there="position_m: [0, 40],"), Origins(axis=AXIS))
    q = predict(scenario(place="", there="position_m: [0, 40],"), Origins(axis=AXIS))
    np.testing.assert_allclose(p.reflectance["square"].mean, q.reflectance["square"].mean, rtol=2e-3)
    grass = builtin_class("grass", AXIS)
    u = p.reflectance["square"].budget
    np.testing.assert_allclose(u[HOST], found.rest * np.sqrt(np.diag(grass.covariance)), rtol=1e-9)
    contrast = builtin_class("yellow-paint-plank", AXIS).mean - grass.mean
    np.testing.assert_allclose(u[PLACE], np.sqrt(found.covariance[0, 0]) * np.abs(contrast), rtol=1e-9)
    assert HOST not in q.reflectance["square"].budget  # without a place: many objects, not one


def test_true_worlds_pass_and_false_ones_do_not():
    # 1,000 worlds: rejections of true ones are binomial with sd 0.7 %.  Shares are bounded, not normal, so that the
    # rate lies at or below 5 %: 8 % is 4 sd above, false failure below 1e-4.
    extra = "uncertainty: {position_m: 0.2, field_spectra: [{subject: plank, relative: 0.05}]}\n"
    told = {
        "true": predict(scenario(extra=extra), Origins(axis=AXIS)),
        "of the neighbour's material": predict(scenario(paint="green", extra=extra), Origins(axis=AXIS)),
        "target too small": predict(scenario(side="0.6", extra=extra), Origins(axis=AXIS)),
    }
    full = {n: builtin_class(f"{n}-paint-plank", AXIS).mean for n in ("yellow", "green")}
    grass, found = builtin_class("grass", AXIS), shares(position=0.2)
    rng = np.random.default_rng(5)
    half = np.linalg.cholesky(found.covariance)
    rejected = dict.fromkeys(told, 0)
    for _ in range(1000):
        own, other = found.mean + half @ rng.standard_normal(2)
        host = rng.multivariate_normal(grass.mean, grass.covariance)
        truth = own * full["yellow"] * (1 + 0.05 * rng.standard_normal()) + other * full["green"]
        seen = truth + (1.0 - own - other) * host
        for name, p in told.items():
            expected = p.reflectance["square"]
            rejected[name] += chi_square_full(expected.mean - seen, expected.error_covariance).p_value < 0.05
    assert 0.01 < rejected["true"] / 1000 < 0.08
    assert rejected["of the neighbour's material"] / 1000 > 0.9
    assert rejected["target too small"] / 1000 > 0.9
