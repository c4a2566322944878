"""Predicted scores of objects: limits and closed forms, and pixels drawn one by one."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.config import parse_yaml, validate
from hyperval.model import (
    Origins,
    design_filter,
    predict,
    predictions,
    read,
    value_at,
)
from hyperval.products import background_of
from hyperval.scenario import Scenario, load_scenario
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import builtin_class

AXIS = SpectralAxis(np.array([450.0, 550, 670, 750, 860, 1050, 1240, 1650, 2130, 2250]), np.full(10, 10.0))
SCENE = """
schema: 1
name: small
scene:
  classes:
    - {name: grass, fraction: 0.7, spectrum: {builtin: grass}}
    - {name: asphalt, fraction: 0.3, spectrum: {builtin: asphalt}}
  targets:
    - name: plank
      spectrum: {builtin: yellow-paint-plank}
      covariance: {relative_sd: 0.02}
      host: asphalt
      subjects:
        - {name: tenth, fill: {fixed: 0.1}}
        - {name: square, PLACE fill: {geometry: {
            side_m: 1, gsd_m: 0.7, heading_deg: 10, psf_fwhm_pixels: 0.8, pixels: ranked, n: 6}}}
    - name: other
      spectrum: {builtin: green-paint-plank}
      covariance: {relative_sd: 0.02}
      host: asphalt
      subjects:
        - {name: beside, THERE fill: {geometry: {
            side_m: 1, gsd_m: 0.7, heading_deg: 10, psf_fwhm_pixels: 0.8, pixels: ranked, n: 6}}}
processing: {detectors: [cem], elm: none}
"""


def scenario_of(extra="", place="", there="", text=SCENE):
    text = text.replace("PLACE", place).replace("THERE", there) + extra
    data, lines = parse_yaml(text, "small.yaml")
    return validate(Scenario, data, lines, "small.yaml")


def run(extra="", place="", there="", text=SCENE):
    return predict(scenario_of(extra, place, there, text), Origins(axis=AXIS), objects=True)


def filter_of():
    """The filter for the plank by its definition, from the mixture of the classes."""
    grass, asphalt = builtin_class("grass", AXIS), builtin_class("asphalt", AXIS)
    mean = 0.7 * grass.mean + 0.3 * asphalt.mean
    spread = 0.21 * np.outer(grass.mean - asphalt.mean, grass.mean - asphalt.mean)
    covariance = 0.7 * grass.covariance + 0.3 * asphalt.covariance + spread
    return design_filter("cem", builtin_class("yellow-paint-plank", AXIS).mean, mean, covariance)


def test_error_of_the_spectrum_moves_a_whole_row():
    p = run("uncertainty: {field_spectra: [{subject: plank, relative: 0.05}, {subject: plank, relative: 0.12}]}\n")
    values = p.object_scores["tenth", "cem"].values
    # The entries add up to 13 % of the target's part of the score.
    w, rho = filter_of(), builtin_class("yellow-paint-plank", AXIS).mean
    expected = 0.1 * 0.13 * abs(float(w.weights @ rho))
    inside = values.std(axis=1, ddof=1).mean()
    between = np.sqrt(values.mean(axis=1).var() - inside**2 / values.shape[1])
    assert between == pytest.approx(expected, rel=0.09)  # 800 independent pairs: 2.5 %; 3.5 of them
    same = p.object_scores["beside", "cem"].values  # the other target's own spectrum is certain
    assert np.std(same.mean(axis=1)) < 1.5 * np.std(same) / np.sqrt(same.shape[1])


def test_a_neighbour_adds_its_part_of_the_pixels():
    alone = run(place="position_m: [0, 0],")
    apart = run(place="position_m: [0, 0],", there="position_m: [0, 40],")
    close = run(place="position_m: [0, 0],", there="position_m: [0, 1.0],")
    key = ("square", "cem")
    assert np.array_equal(alone.object_scores[key].values, apart.object_scores[key].values)
    # Green paint scores by the yellow filter what (3.26) says; a pixel gets it by the fill that (3.10) gives.
    w = filter_of()
    green = w.score(builtin_class("green-paint-plank", AXIS).mean) - w.score(builtin_class("asphalt", AXIS).mean)
    moved = close.object_scores[key].values.mean() - alone.object_scores[key].values.mean()
    assert np.sign(moved) == np.sign(green)
    assert 0.005 < moved / green < 0.3


def test_a_neighbour_spreads_the_score_in_place_of_the_host():
    # Along the grid and without blur 0.4 x 0.4 of the pixel is plank, 0.25 x 0.8 the neighbour, the rest the host.
    text = SCENE.replace("psf_fwhm_pixels: 0.8, pixels: ranked, n: 6", "psf_fwhm_pixels: 0, phase: centred")
    own, other = text.replace("gsd_m: 0.7, heading_deg: 10", "gsd_m: 1").split("- name: other")
    text = own.replace("side_m: 1", "side_m: 0.4") + "- name: other" + other.replace("side_m: 1", "side_m: 0.8")
    text = text.replace("covariance: {relative_sd: 0.02}", "covariance: {builtin: grass}")
    found = run(place="position_m: [0, 0],", there="position_m: [0, 0.65],", text=text).object_scores["square", "cem"]
    grass, asphalt = (filter_of().variance(builtin_class(name, AXIS).covariance) for name in ("grass", "asphalt"))
    expected = (0.16**2 + 0.2**2) * grass + 0.64**2 * asphalt
    assert found.values.var() == pytest.approx(expected, rel=0.036)  # 38,400 draws: 0.7 %, five of these


def test_each_of_several_truths_has_the_objects_of_its_own_scene():
    # The first truth of a batch once lent its fills to all others.
    scenario = scenario_of(place="position_m: [0, 0],", there="position_m: [0, 1.0],")
    world = read(scenario, Origins(axis=AXIS))
    moves = [("fill.square", 0.2), ("surfaces.other.mean", 0.1), ("surfaces.grass.mean", 0.1)]
    more, brighter, greener = ({path: value_at(world, path)[0] + step} for path, step in moves)
    blurred = {"scene.targets.plank.subjects.[square].fill.geometry.psf_fwhm_pixels": 3.0}
    truths = [{}, more, blurred, brighter, greener]
    together = list(predictions(scenario, truths, Origins(axis=AXIS), objects=300))
    for truth, one in zip(truths, together, strict=True):
        (alone,) = predictions(scenario, [truth], Origins(axis=AXIS), objects=300)
        for key, scores in alone.object_scores.items():
            assert one.object_scores[key].values == pytest.approx(scores.values, abs=1e-9)
    stated, fuller, wider, bright, _ = (p.object_scores["square", "cem"].values.mean() for p in together)
    assert wider < stated < fuller
    assert bright != stated  # the neighbour's part
    assert np.array_equal(*(together[i].object_scores["tenth", "cem"].values for i in (0, 3)))


def test_expected_scores_of_target_pixels_and_background_are_the_means_of_their_laws():
    """By another route: the spline over the fill, and the laws of classes, under light and an empirical line."""
    scenario = load_scenario("yellow-planks-asphalt")
    p = predict(scenario, objects=1)
    for target in scenario.scene.targets:
        for detector in ("cem", "cem-correlation"):
            expected = {
                what: score for (what, *of), score in p.expected_scores.items() if of == [target.name, detector]
            }
            for population in target.populations:
                assert expected[population.name] == pytest.approx(p.scores[population.name, detector].mean, rel=1e-9)
                mixed = sum(c.fraction * expected[c.name] for c in scenario.scene.classes)
                background = p.scores[background_of(population.name), detector].mean
                assert mixed == pytest.approx(background, rel=1e-6, abs=1e-12)


def test_expected_scores_of_classes_and_other_targets_follow_from_the_filter():
    p, cem = run(), filter_of()
    host = builtin_class("asphalt", AXIS).mean
    fill = p.expected_scores["beside", "other", "cem"]  # by its own filter: its mean fill but for its host's score
    empty = p.expected_scores["asphalt", "other", "cem"]
    fill = (fill - empty) / (1.0 - empty)
    other = fill * builtin_class("green-paint-plank", AXIS).mean + (1.0 - fill) * host
    for name, spectrum in (("asphalt", host), ("beside", other)):
        expected = cem.weights @ spectrum - cem.offset
        assert p.expected_scores[name, "plank", "cem"] == pytest.approx(expected, rel=1e-9)
