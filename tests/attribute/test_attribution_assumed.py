"""Reasons with a usual error: those that a scenario has and whose error it does not state, and no others."""

from __future__ import annotations

import numpy as np

from hyperval.attribute import assumed_inputs
from hyperval.model import Origins, read
from hyperval.scenario import Scenario
from hyperval.spectra import SpectralAxis
from small_campaign import ATMOSPHERE, stand_in_atmosphere

AXIS = SpectralAxis(np.array([500.0, 600.0, 800.0]), np.full(3, 10.0))
GROUND = {"name": "ground", "fraction": 1.0, "spectrum": {"constant": 0.2}}
PAINT = {"name": "paint", "spectrum": {"constant": 0.5}, "host": "ground", "fill": {"fixed": 0.1}}
AIR = {"sensor": "aviris-ng", "atmosphere": ATMOSPHERE}


def names(*classes, targets=(), **changes) -> list[str]:
    """Names of the usual inputs of a small scenario."""
    scenario = Scenario.model_validate({
        "name": "s",
        "scene": {"classes": list(classes or [GROUND]), "targets": list(targets)},
        "processing": {"elm": "none", "detectors": []},
        **changes,
    })  # fmt: skip
    return [i.name for i in assumed_inputs(read(scenario, Origins(axis=AXIS, engine=stand_in_atmosphere)))]


def test_a_reflectance_image_has_neither_air_nor_noise_of_a_sensor():
    assert names() == ["sensor gain", "spread of ground", "field spectrum of ground"]


def test_of_two_classes_one_share_is_an_input_and_of_three_each():
    def shares(*fractions):
        classes = [{**GROUND, "name": f"c{i}", "fraction": f} for i, f in enumerate(fractions)]
        return [name for name in names(*classes) if name.startswith("fraction")]

    assert shares(0.3, 0.7) == ["fraction of c0"]
    assert shares(0.3, 0.3, 0.4) == ["fraction of c0", "fraction of c1", "fraction of c2"]


def test_fills_are_inputs_where_there_are_targets_and_blur_where_their_geometry_has_one():
    assert "fill of the targets" not in names()
    assert {"fill of the targets", "blur of the image"} & {*names(targets=[PAINT])} == {"fill of the targets"}


def test_air_without_water_or_aerosol_has_none_to_be_off():
    own = {"aerosol optical depth", "water vapour", "wavelength shift", "sensor noise"}
    assert own <= {*names(**AIR)}
    clear = {**ATMOSPHERE, "aerosol": "none"}
    del clear["aot550"]
    assert "aerosol optical depth" not in names(**{**AIR, "atmosphere": clear})


def test_what_the_scenario_states_is_left_out():
    stated = {"sensor_gain": {"relative": 0.02}, "water_vapour_g_cm2": 0.1}
    left = names(**AIR, uncertainty=stated)
    assert {"sensor gain", "water vapour"} & {*left} == set()
    assert "aerosol optical depth" in left
