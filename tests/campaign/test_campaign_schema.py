"""Mistakes in a campaign file: each with its file and line, all at once, and what was probably meant."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hyperval.campaign.job import job_of, read_texts
from hyperval.campaign.schema import Campaign
from hyperval.collection_files import CubeSource
from hyperval.errors import InputError, UsageError

ROOT = Path(__file__).parents[2]
GOOD = """\
schema: 1
name: lawn
title: A lawn
description: Two sites.
collection:
  spectra:
    - {subject: lawn, path: lawn.txt}
  bands: {path: bands.txt, wavelength_unit: nm}
  calibration: {relative: 0.03}
scenarios: [scenario.yaml]
comparisons:
  - product: radiance
    subjects: [lawn]
    metric: median_abs_difference_ratio_windows
    at_most: 0.05
    reason: enough
"""


def load(tmp_path: Path, *replacements: tuple[str, str]):
    text = GOOD
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "campaign.yaml"
    path.write_text(text)
    return job_of(path).campaign


def test_a_good_campaign(tmp_path):
    campaign = load(tmp_path)
    assert campaign.name == "lawn"
    assert campaign.detection is None
    assert campaign.simulated is False
    assert campaign.comparisons[0].at_most == 0.05


@pytest.mark.parametrize(
    "path", sorted((ROOT / "campaigns").glob("*/campaign*.yaml")), ids=lambda p: f"{p.parent.name}-{p.stem}"
)
def test_the_campaigns_of_the_project_are_valid(path):
    # A campaign with values to be filled in has tests of its own.
    waiting = "FILL_IN" in path.read_text()
    for campaign in [read_texts(path)[0].outline()] if waiting else [text.campaign() for text in read_texts(path)]:
        assert any(gate.gate for gate in campaign.comparisons) or "broken" in campaign.name
        assert campaign.assumptions


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("title:", "titel:", 3, r"titel: unknown key; did you mean 'title'\?"),
        ("    at_most", "    at_mots", 15, r"at_mots: unknown key; did you mean 'at_most'\?"),
        ("calibration:", "calibraton:", 9, r"did you mean 'calibration'\?"),
        ("wavelength_unit: nm", "wavelength_units: nm", 8, r"did you mean 'wavelength_unit'\?"),
        ("wavelength_unit: nm", "wavelength_unit: mm", 8, "Input should be 'nm' or 'um'"),
        ("  bands: {path: bands.txt, wavelength_unit: nm}\n", "", 5, "spectra need 'bands'"),
        (
            "  calibration",
            "  cube: {path: a.img, quantity: radiance}\n  calibration",
            5,
            "exactly one of cube, spectra",
        ),
        ("{relative: 0.03}", "{}", 9, "give exactly one of relative, file"),
        ("{relative: 0.03}", "{relative: 3}", 9, "less than 1"),
        ("{relative: 0.03}", "{relative: .nan}", 9, "finite number"),
        ("name: lawn", "name: A Lawn", 2, "a name of small letters, digits and hyphens"),
        ("name: lawn", "name: ../lawn", 2, "a name of small letters, digits and hyphens"),
        ("schema: 1", "schema: 2", 1, "Input should be 1"),
        ("    at_most: 0.05", "    at_most: 5", 12, "100 % or more"),
        ("    at_most: 0.05\n", "", 12, "a limit is missing"),
        ("    reason: enough\n", "", 12, "reason: Field required"),
        ("product: radiance", "product: radience", 12, "Input should be 'radiance'"),
        ("title: A lawn", "title: A lawn\ntitle: Again", 4, "'title' stands twice"),
        ("title: A lawn", "title: &a A lawn", 3, "anchors and aliases are not allowed"),
        ("title: A lawn", "title: [A lawn", 4, "not valid YAML"),
    ],
)
def test_each_mistake_is_named_with_its_line(tmp_path, old, new, line, message):
    with pytest.raises(UsageError, match=message) as caught:
        load(tmp_path, (old, new))
    assert f"campaign.yaml:{line}:" in str(caught.value)
    assert caught.value.exit_code == 2


def test_all_mistakes_are_listed_at_once(tmp_path):
    with pytest.raises(UsageError) as caught:
        load(tmp_path, ("title:", "titel:"), ("    at_most", "    at_mots"), ("relative: 0.03", "relative: 3"))
    lines = [int(x) for x in re.findall(r"campaign\.yaml:(\d+):", str(caught.value))]
    assert {3, 9, 15} <= set(lines)
    assert lines == sorted(lines)


def test_a_mistake_in_a_written_out_scenario_is_named(tmp_path):
    written = """scenarios:
  - name: inline
    scene:
      classes:
        - {name: lawn, fraction: 1, spectrum: {constnt: 0.3}}
"""
    with pytest.raises(
        UsageError, match=r"campaign\.yaml:14: .*constnt: unknown key; did you mean 'constant'\?"
    ) as caught:
        load(tmp_path, ("scenarios: [scenario.yaml]\n", written))
    # Of a scenario alone: neither of a day that it is not, nor keys that a scenario has as unknown.
    assert "radcalnet" not in str(caught.value)
    assert "did you mean 'scene'" not in str(caught.value)


def test_half_hours_of_a_day_lack_their_file(tmp_path):
    with pytest.raises(UsageError, match=r"scenarios\.0\.radcalnet: Field required") as caught:
        load(tmp_path, ("scenarios: [scenario.yaml]\n", "scenarios: [{scenario: day.yaml}]\n"))
    assert "atmosphere" not in str(caught.value)


def test_a_simulated_collection_must_say_so(tmp_path):
    collection = GOOD[GOOD.index("  spectra:") : GOOD.index("scenarios:")]
    cube = "  simulate: scene.yaml\n  cube: {path: 'simulated:a.img', quantity: radiance}\n"
    with pytest.raises(UsageError, match="says 'simulated: true'"):
        load(tmp_path, (collection, cube))
    assert load(tmp_path, (collection, cube), ("title:", "simulated: true\ntitle:")).simulated
    without_cube = collection + "  simulate: scene.yaml\n"
    with pytest.raises(UsageError, match="a simulated collection is a cube"):
        load(tmp_path, (collection, without_cube), ("title:", "simulated: true\ntitle:"))


def test_the_unit_of_a_radiance_must_be_stated(tmp_path):
    collection = GOOD[GOOD.index("  spectra:") : GOOD.index("scenarios:")]
    cube = "  cube: {path: a.img, quantity: radiance}\n"
    with pytest.raises(UsageError, match="the unit of the radiance is not stated"):
        load(tmp_path, (collection, cube))
    stated = cube.replace("radiance}", "radiance, unit: W m-2 sr-1 um-1}")
    assert load(tmp_path, (collection, stated)).collection.cube.unit == "W m-2 sr-1 um-1"
    assert load(tmp_path, (collection, cube.replace("radiance", "reflectance"))).collection.cube.unit is None


def test_detection_needs_a_cube(tmp_path):
    block = "detection:\n  targets: [{name: a, material: b, spectrum: {constant: 0.3}}]\n"
    with pytest.raises(UsageError, match="detection needs a cube"):
        load(tmp_path, ("scenarios:", block + "scenarios:"))


def test_no_such_file(tmp_path):
    with pytest.raises(InputError, match=r"none\.yaml: no such file"):
        job_of(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"quantity": "radiance", "unit": "uW cm-2 sr-1 nm-1"}, "no wavelength is known"),
        ({"wavelength_unit": "nm"}, "no wavelength is known"),
    ],
)
def test_bands_by_number_are_of_a_reflectance_without_wavelengths(change, words):
    cube = {"path": "a.img", "quantity": "reflectance", "by_number": True} | change
    with pytest.raises(ValueError, match=words):
        CubeSource.model_validate(cube)


def test_bands_by_number_have_no_windows():
    cube = {"path": "a.img", "quantity": "reflectance", "by_number": True}
    named = {"schema": 1, "name": "n", "title": "t", "description": "d", "collection": {"cube": cube}}
    target = {"name": "a", "material": "a", "spectrum": {"file": "a.txt"}}
    Campaign.model_validate(named | {"detection": {"targets": [target]}})
    with pytest.raises(ValueError, match="no windows of the atmosphere"):
        Campaign.model_validate(named | {"detection": {"targets": [target], "bands": "windows"}})
