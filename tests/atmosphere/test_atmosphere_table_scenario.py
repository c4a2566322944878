"""A scenario that names a table: from the YAML file to radiance at the sensor."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from hyperval.atmosphere import AtmosphericTable, atmospheric_terms, read_table, write_table
from hyperval.atmosphere.table import PATH_ERROR, QUANTITIES
from hyperval.errors import InputError, UsageError
from hyperval.model import Origins, predict
from hyperval.scenario import load_scenario
from hyperval.spectra import SpectralAxis

SCENARIO = """\
schema: 1
name: from-a-table
title: Constant panel under a table
description: A grey scene.
atmosphere:
  engine: table
  table: {table}
  model: midlatitude-summer
  aerosol: rural
  aot550: {aot550}
  water_vapour_g_cm2: 1.0
  ozone_atm_cm: 0.3
  ground_altitude_km: 0.401945
  sensor_altitude_km: 2.300449
  latitude_deg: 34.45333858
  longitude_deg: -118.59692454
  time_utc: "2018-09-11T18:57:00Z"
sensor: emit
scene:
  classes:
    - {{name: grey, fraction: 1.0, spectrum: {{constant: 0.3}}, covariance: {{relative_sd: 0.05}}}}
processing: {{elm: none, detectors: []}}
"""


def scenario(tmp_path, table, aot550=0.13):
    path = tmp_path / "scenario.yaml"
    path.write_text(SCENARIO.format(table=table, aot550=aot550))
    return load_scenario(path)


def flat_table(wavelength_nm):
    """The same terms at every optical depth."""
    shape = (2, wavelength_nm.size)
    level = {"path": 0.02, "direct": 0.7, "adjacency": 0.05, "spherical_albedo": 0.1, "ground": 0.8, "gas": 0.95}
    quantities = {name: np.full(shape, level[name]) for name in QUANTITIES}
    return AtmosphericTable(wavelength_nm, {"aot550": np.array([0.05, 0.2])}, {"aerosol": "rural"}, quantities)


def test_a_table_beside_the_scenario_gives_its_radiance(tmp_path):
    write_table(flat_table(np.arange(340.0, 2601.0, 2.5)), tmp_path / "lut.nc")
    asked = scenario(tmp_path, "lut.nc")
    axis = SpectralAxis(np.array([550.0, 1000.0, 1650.0]), np.full(3, 10.0))
    found = predict(asked, Origins(axis=axis, show_progress=False))
    got = found.radiance["grey"].mean
    terms = atmospheric_terms(asked.atmosphere, resolve=lambda r: tmp_path / r).at_bands(axis)
    # 3.7 over uniform ground of 0.3.
    want = terms.path_radiance + (terms.direct + terms.adjacency) * 0.3 / (1 - 0.1 * 0.3)
    np.testing.assert_allclose(got, want, rtol=1e-12)
    assert found.provenance["atmosphere"]["engine"] == "table"
    # The state lies between two nodes, so that the path has an error by interpolation.
    part = found.provenance["atmosphere"]["interpolation_path_relative"]
    assert 0.0 < part <= PATH_ERROR
    budget = found.radiance["grey"].budget["interpolation of the table"]
    np.testing.assert_allclose(budget, part * terms.path_radiance, rtol=1e-9)
    assert found.provenance["atmosphere"]["leave_one_out_error"] == {"aot550": None}
    # A table that changes is read again.
    brighter = flat_table(np.arange(340.0, 2601.0, 2.5))
    brighter = replace(brighter, quantities={**brighter.quantities, "path": brighter.quantities["path"] * 2})
    write_table(brighter, tmp_path / "lut.nc")
    assert np.all(predict(asked, Origins(axis=axis, show_progress=False)).radiance["grey"].mean > got)


def test_what_is_wrong_with_the_reference_is_said(tmp_path):
    axis = SpectralAxis(np.array([550.0]), np.array([10.0]))
    with pytest.raises(InputError, match=r"absent\.nc"):
        predict(scenario(tmp_path, "absent.nc"), Origins(axis=axis, show_progress=False))
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=r"name the template: folder/NAME\.json"):
        predict(scenario(tmp_path, "folder"), Origins(axis=axis, show_progress=False))
    write_table(flat_table(np.arange(340.0, 2601.0, 2.5)), tmp_path / "lut.nc")
    with pytest.raises(UsageError, match="lies outside the table"):
        predict(scenario(tmp_path, "lut.nc", aot550=0.3), Origins(axis=axis, show_progress=False))


@pytest.mark.data
def test_a_data_reference_to_real_runs_predicts_at_their_channels(tmp_path, data_dir):
    template = data_dir("modtran/modtran6_airborne_lut/modtran_template.json")
    table = read_table(template)
    axis = SpectralAxis(table.wavelength_nm, table.fwhm_nm)
    asked = scenario(tmp_path, "data:modtran/modtran6_airborne_lut/modtran_template.json", aot550=0.2)
    found = predict(asked, Origins(axis=axis, show_progress=False))
    terms = table.terms(asked.atmosphere)
    want = terms.path_radiance + (terms.direct + terms.adjacency) * 0.3 / (1 - terms.spherical_albedo * 0.3)
    np.testing.assert_allclose(found.radiance["grey"].mean, want, rtol=1e-9)
    json.dumps(found.provenance)  # it can be written down
    wide = SpectralAxis(np.array([550.0]), np.array([2.0]))
    with pytest.raises(UsageError, match="channels that do not suit the band"):
        predict(asked, Origins(axis=wide, show_progress=False))
