"""Scenario files: what is accepted, and that a mistake is named with its line."""

from __future__ import annotations

from pathlib import Path

import pytest

from hyperval.errors import InputError, UsageError
from hyperval.scenario import builtin_scenarios, load_scenario

GOOD = """schema: 1
name: small
scene:
  classes:
    - {name: grass, fraction: 0.5, spectrum: {builtin: grass}}
    - {name: lot, fraction: 0.5, spectrum: {constant: 0.2}, covariance: {relative_sd: 0.1, band_sd: 0.01}}
  targets:
    - name: plank
      spectrum: {builtin: yellow-paint-plank}
      host: grass
      subjects:
        - {name: half, fill: {fixed: 0.5}}
        - {name: some, fill: {mean: 0.3, sd: 0.1}}
        - {name: lying, fill: {geometry: {side_m: 1, gsd_m: 0.7, psf_fwhm_pixels: 1, heading_deg: random}}}
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "scenario.yaml"
    path.write_text(text)
    return path


def test_a_scenario_in_the_reflectance_domain(tmp_path):
    scenario = load_scenario(write(tmp_path, GOOD))
    assert scenario.atmosphere is None
    assert [p.name for p in scenario.scene.targets[0].populations] == ["half", "some", "lying"]
    assert scenario.folder == tmp_path
    assert scenario.scene.adjacency.kappa == 0.001


def test_fill_is_short_for_one_subject(tmp_path):
    text = GOOD[: GOOD.index("      subjects:")] + "      fill: {fixed: 0.4}\n"
    populations = load_scenario(write(tmp_path, text)).scene.targets[0].populations
    assert [(p.name, p.fill.fixed) for p in populations] == [("plank", 0.4)]


@pytest.mark.parametrize("name", builtin_scenarios())
def test_builtin_scenarios_load_by_name(name):
    assert load_scenario(name).name == name


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("fraction: 0.5, spectrum: {builtin", "fraction: 0.6, spectrum: {builtin", 3, "sum to 1.1, not 1"),
        ("host: grass", "host: lawn", 3, "host 'lawn'"),
        ("name: some", "name: half", 3, "names of subjects stand twice: half"),
        ("spectrum: {constant: 0.2}", "spectrum: {constant: 0.2, file: a.csv}", 6, "exactly one of"),
        ("{mean: 0.3, sd: 0.1}", "{mean: 0.3}", 13, "mean and sd go together"),
        ("side_m: 1, ", "", 14, "a square has side_m"),
        ("fixed: 0.5", "fixed: 1.5", 12, "less than or equal to 1"),
        ("band_sd", "band_sdd", 6, "did you mean 'band_sd'"),
        ("schema: 1\n", "schema: 1\nprocessing: {detectors: [acme]}\n", 2, "unknown detector 'acme'"),
        ("schema: 1\n", "schema: 1\nprocessing: {elm: {reflectances: [0.6, 0.1]}}\n", 2, "darker"),
        (
            "schema: 1\n",
            "schema: 1\nuncertainty: {field_spectra: [{subject: x, relative: 0.1}]}\n",
            2,
            "no class, panel, site or target .x.",
        ),
    ],
)
def test_a_mistake_is_named_with_its_line(tmp_path, old, new, line, words):
    assert old in GOOD
    with pytest.raises(UsageError, match=words) as error:
        load_scenario(write(tmp_path, GOOD.replace(old, new, 1)))
    assert f"scenario.yaml:{line}:" in str(error.value)


def test_an_atmosphere_needs_a_sensor(tmp_path):
    text = GOOD + (
        "atmosphere: {aot550: 0.1, sensor_altitude_km: 1, solar_zenith_deg: 30, solar_azimuth_deg: 0, day_of_year: 1}\n"
    )
    with pytest.raises(UsageError, match="needs a sensor"):
        load_scenario(write(tmp_path, text))


def test_unknown_name_and_missing_file(tmp_path):
    with pytest.raises(UsageError, match="one of green-planks-grass, panels"):
        load_scenario("yellow-planks")
    with pytest.raises(InputError, match="no such file"):
        load_scenario(tmp_path / "none.yaml")


def test_a_campaign_is_told_from_a_scenario(tmp_path):
    path = tmp_path / "campaign.yaml"
    path.write_text("schema: 1\nname: a\ncollection: {}\nscenarios: []\n")
    with pytest.raises(UsageError, match=r"a campaign, not a scenario\n.*hyperval validate .*campaign\.yaml -o DIR"):
        load_scenario(path)
