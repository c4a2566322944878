"""Inputs of the budget: what they change, what they are called, and the moments of their draws."""

from __future__ import annotations

import re

import numpy as np
import pytest
from uncertain_scene import ATMOSPHERE, AXIS, ORIGINS, run, scenario

from hyperval.errors import UsageError
from hyperval.model import (
    UncertainInput,
    correlation,
    covariance_directions,
    directions,
    drawn_truths,
    form_in_words,
    inputs_of,
    read,
    value_at,
)
from hyperval.scenario import Scenario, SpectralForm, Uncertainty

EVERYTHING = (
    ATMOSPHERE
    + """
uncertainty:
  aot550: 0.04
  water_vapour_g_cm2: 0.17
  ozone_atm_cm: 0.02
  solar_zenith_deg: 0.5
  solar_azimuth_deg: 1
  view_zenith_deg: 1
  sensor_altitude_km: 0.05
  ground_altitude_km: 0.02
  solar_irradiance_relative: 0.01
  adjacency_reflectance_relative: 0.2
  engine: {relative: 0.01, per_optical_depth: 0.1, path_relative: 0.05, correlation_nm: 200}
  field_spectra:
    - {subject: plank, relative: 0.05, correlation_nm: 300}
    - {subject: grass, absolute: 0.01, correlation: random}
  sensor_gain: {relative: 0.02, correlation_nm: 300}
  sensor_offset: {absolute: 0.01}
  noise: {relative: 0.1, correlation: arms}
  electrons: {relative: 0.05}
  elm_panels: {relative: 0.02}
  wavelength_shift: {absolute: 0.5, correlation: arms}
  fills: [{subject: tenth, absolute: 0.02}]
  fractions: [{subject: grass, absolute: 0.05}, {subject: asphalt, absolute: 0.02}]
  sampled_statistics: [{subject: asphalt, effective_n: 200}]
"""
)


def inputs(s: Scenario) -> dict[str, UncertainInput]:
    found = inputs_of(read(s, ORIGINS))
    assert len({i.name for i in found}) == len(found)
    return {i.name: i for i in found}


def test_every_input_of_the_scene_is_there_moves_something_and_can_be_drawn_with_the_others():
    s = scenario(EVERYTHING)
    found = inputs(s)
    kinds = {i.kind for i in found.values()}
    assert kinds == {"atmosphere", "surface", "sensor", "scene", "engine", "sampling"}
    base = run(s.model_copy(update={"uncertainty": Uncertainty()}))
    plain = s.model_copy(update={"uncertainty": Uncertainty()})
    blind = {"solar azimuth", "view zenith angle", "sensor altitude", "ground height"}  # to the stand-in engine
    for name, item in found.items():
        off = run(plain, truth=item.moved(1.0))
        moved = [
            not np.allclose(off.radiance["tenth"].mean, base.radiance["tenth"].mean, rtol=1e-9),
            not np.allclose(off.snr["panel"].mean, base.snr["panel"].mean, rtol=1e-9),
            not np.allclose(off.roc["tenth", "cem", "pixel"].pd, base.roc["tenth", "cem", "pixel"].pd, rtol=1e-9),
        ]
        assert any(moved) != (name in blind), name
        assert item.correlation
    draws = [run(plain, truth=truth) for truth in drawn_truths(list(found.values()), 3, 1)]
    assert len({float(d.radiance["grass"].mean[0]) for d in draws}) == 3


def test_directions_give_back_the_covariance_of_each_form():
    sd = np.linspace(0.01, 0.03, len(AXIS))
    cases = {
        "systematic": (SpectralForm(), np.outer(sd, sd)),
        "random": (SpectralForm(correlation="random"), np.diag(sd**2)),
        "length": (SpectralForm(correlation_nm=200), np.outer(sd, sd) * correlation(AXIS, 200.0)),
    }
    assert form_in_words(cases["length"][0]) == "correlation length 200 nm"
    for name, (form, expected) in cases.items():
        rows = directions(sd, form, AXIS)
        np.testing.assert_allclose(rows.T @ rows, expected, atol=1e-5 * expected.max(), err_msg=name)
        norms = (rows**2).sum(axis=1)
        assert np.all(np.diff(norms) <= 1e-15) or name == "random"
    assert covariance_directions(np.zeros((3, 3))).shape == (0, 3)
    # Less than a millionth of the variance is left out, and no more directions are followed than that needs.
    rows = covariance_directions(np.diag([1.0, 1e-3, 1e-5, 1e-7, 1e-9]))
    assert rows.shape == (5, 5)
    assert UncertainInput("x", "scene", "fill", np.zeros(5), rows).size == 3
    with pytest.raises(UsageError, match="needs a sensor with arms"):
        directions(sd, SpectralForm(correlation="arms"), AXIS)


def test_drawn_field_spectrum_has_the_covariance_that_is_stated():
    item = inputs(scenario(EVERYTHING))["field spectrum of plank"]
    rng = np.random.default_rng(11)
    plain = scenario(EVERYTHING)
    x = np.array([item.drawn(rng)[item.path] for _ in range(4000)]) - value_at(read(plain, ORIGINS), item.path)
    base = run(plain).reflectance["tenth"]  # the plank fills a tenth: its error times 0.1
    stated = base.budget["field spectrum"]
    # Standard deviation of 4,000 draws: standard error 1.1 %; the host (asphalt) states no error here.
    np.testing.assert_allclose(0.1 * x.std(axis=0), stated, rtol=0.06)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("aot550: {standard: 0.1, distribution: uniform}", "a number; errors are normal"),
        ("aot550: -1", "greater than 0"),
        ("{aot550: 0.1, meteorological_range_km: 3}", "one uncertainty"),
        ("engine: {relative: 0.1, distribution: uniform, correlation_nm: 100}", "is gone; errors are normal"),
        ("engine: {relative: 0.1, nugget: 0.1, correlation_nm: 100}", "is gone; .* entry of its own"),
        ("sensor_gain: {relative: 0.1, correlation: random, correlation_nm: 9}", "not both"),
        ("solar_irradiance_relative: 1.5", "below 1"),
        ("fills: [{subject: tenth, absolute: 0.1}, {subject: tenth, absolute: 0.1}]", "stands twice"),
        ("{fills: [{subject: nobody, absolute: 0.1}]}", "no target or subject 'nobody'; there are .*tenth"),
        ("{fractions: [{subject: nobody, absolute: 0.1}]}", "no class 'nobody'; there are"),
        ("{sampled_statistics: [{subject: nobody, effective_n: 50}]}", "no class, panel, site or target 'nobody'"),
        ("{field_spectra: [{subject: nobody, relative: 0.1}]}", "no class, panel, site or target 'nobody'"),
        ("{meteorological_range_km: 3}", "uncertainty: meteorological_range_km is given, but atmosphere.met"),
    ],
)
def test_mistakes_are_refused_when_the_scenario_is_read(text, match):
    inner = text if text.startswith("{") else "{" + text + "}"
    with pytest.raises(UsageError, match=match):
        scenario(ATMOSPHERE + f"uncertainty: {inner}\n")


@pytest.mark.parametrize("name", ["ozone_atm_cm", "water_vapour_g_cm2"])
def test_an_amount_of_gas_that_is_left_to_the_engine_has_no_uncertainty(name):
    without = re.sub(rf"{name}: [\d.]+, ", "", ATMOSPHERE)
    assert without != ATMOSPHERE
    with pytest.raises(UsageError, match=f"uncertainty: {name} is given, but atmosphere.{name} is not"):
        scenario(without + f"uncertainty: {{{name}: 0.02}}\n")


def test_statistics_of_unknown_samples_have_no_sampling_error():
    with pytest.raises(UsageError, match="does not say how many"):
        inputs(scenario(ATMOSPHERE + "uncertainty: {sampled_statistics: [{subject: grass}]}\n"))
