"""Inputs whose uncertainty a scenario does not state, each with a usual one: they too may be the reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hyperval.prediction.budget import AEROSOL, SURROUNDINGS, WATER, field_spectrum_of, inputs_of
from hyperval.prediction.forms import form_in_words
from hyperval.prediction.input import Input, Kind, number_input, spectral_input
from hyperval.prediction.input_paths import Given
from hyperval.scenario_uncertainty import SpectralForm

SHIFT_NM = 0.2
SPREAD = 0.10
FRACTION = 0.10
# A surface that is described by another one of its kind: part of its reflectance, over so many nm together, along
# the directions that hold nine tenths of its variance between 400 and 2500 nm.
SURFACE, SURFACE_NM, SURFACE_DIRECTIONS = 0.10, 300.0, 4
# Name, kind, path, usual size as a part of what stands there.
_PARTS: tuple[tuple[str, Kind, str, float], ...] = (
    (SURROUNDINGS, "scene", "light.surroundings", 0.10),
    (AEROSOL, "atmosphere", "atmosphere.aot550", 0.10),
    (WATER, "atmosphere", "atmosphere.water_vapour_g_cm2", 0.10),
    ("sensor gain", "sensor", "sensor.gain", 0.01),
    ("sensor noise", "sensor", "sensor.noise", 0.05),
    ("fill of the targets", "scene", "fill", 0.05),
    ("blur of the image", "scene", "blur", 0.10),
)


def assumed_inputs(given: Given) -> list[Input]:
    """Every input of a scenario that may be off and whose uncertainty it does not state, with a usual one."""
    stated = {item.path for item in inputs_of(given)}
    return [item for item in _usual(given) if item.path not in stated]


def _usual(given: Given) -> list[Input]:
    unmoved = _unmoved(given)
    inputs = [_part(given, *row) for row in _PARTS if row[2] not in unmoved]
    if given.scenario.atmosphere is not None:
        path, words = "sensor.wavelength_shift_nm", f"{SHIFT_NM:g} nm"
        inputs.append(
            number_input(
                given, "wavelength shift", "sensor", path, np.array([SHIFT_NM]), source="usual", words=words
            )
        )
    classes = given.scenario.scene.classes
    for c in classes:
        inputs.append(_part(given, f"spread of {c.name}", "surface", f"surfaces.[{c.name}].spread", SPREAD))
    inputs += _spectra(given)
    for c in classes if len(classes) > 1 else ():
        if 0 < c.fraction < 1:
            inputs.append(_part(given, f"fraction of {c.name}", "scene", f"fraction.[{c.name}]", FRACTION))
            if len(classes) == 2:
                break  # the other one's is the same input
    return inputs


def _part(given: Given, name: str, kind: Kind, path: str, part: float) -> Input:
    one = number_input(given, name, kind, path, np.zeros(1), source="usual", words=f"{100 * part:g} %")
    return replace(one, rows=part * np.atleast_1d(np.asarray(one.nominal, dtype=float))[None, :])


def _unmoved(given: Given) -> set[str]:
    """Paths of usual inputs that this scenario does not have."""
    scenario, state = given.scenario, given.scenario.atmosphere
    paths = set()
    if state is None:
        paths |= {"light.surroundings", "sensor.noise"}
    if state is None or state.engine == "table" or not state.aerosol_optical_depth:
        paths.add("atmosphere.aot550")
    if state is None or state.engine == "table" or not state.water_vapour_g_cm2:
        paths.add("atmosphere.water_vapour_g_cm2")
    fills = [p.fill for t in scenario.scene.targets for p in t.populations]
    if not fills:
        paths.add("fill")
    if not any(np.any(f.geometry.psf_fwhm_pixels or 0.0) for f in fills if f.geometry is not None):
        paths.add("blur")
    return paths


def _spectra(given: Given) -> list[Input]:
    """Mean spectra that the collection itself does not vouch for.

    Those of targets are left out: mixed with their hosts they look like their fill, which is there already.
    """
    scene, form = given.scenario.scene, SpectralForm(correlation_nm=SURFACE_NM)
    inputs = []
    for s in (*scene.classes, *scene.panels, *scene.sites):
        if s.spectrum.measured is None:
            sd = SURFACE * np.nan_to_num(given.surfaces[s.name].mean)
            one = spectral_input(given, field_spectrum_of(s.name), "surface", f"surfaces.[{s.name}].mean", sd, form)
            words = f"{100 * SURFACE:g} %, {form_in_words(form)}"
            inputs.append(replace(one, rows=one.rows[:SURFACE_DIRECTIONS], source="usual", correlation=words))
    return inputs
