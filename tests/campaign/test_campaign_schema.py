"""Mistakes in a campaign file: each with its file and line, all at once, and what was probably meant."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hyperval.campaign import job_of, read_jobs
from hyperval.errors import UsageError

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


SPECTRA = GOOD[GOOD.index("  spectra:") : GOOD.index("scenarios:")]
CUBE = "  cube: {path: a.img, quantity: reflectance}\n"
BY_NUMBER = "  cube: {path: a.img, quantity: reflectance, by_number: true}\n"
TARGETS = "targets: [{name: a, material: b, spectrum: {constant: 0.3}}]"


def load(tmp_path: Path, *replacements: tuple[str, str]):
    text = GOOD
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "campaign.yaml"
    path.write_text(text)
    return job_of(path).campaign


@pytest.mark.parametrize(
    "path", sorted((ROOT / "campaigns").glob("*/campaign*.yaml")), ids=lambda p: f"{p.parent.name}-{p.stem}"
)
def test_the_campaigns_of_the_project_are_valid(path):
    # A campaign with values to be filled in has tests of its own.
    waiting = "FILL_IN" in path.read_text()
    for campaign in [read_jobs(path)[0].outline] if waiting else [job.campaign for job in read_jobs(path)]:
        assert any(gate.gate for gate in campaign.comparisons) or "broken" in campaign.name
        assert campaign.assumptions


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("  bands: {path: bands.txt, wavelength_unit: nm}\n", "", 5, "spectra need 'bands'"),
        ("  calibration", f"{CUBE}  calibration", 5, "exactly one of cube, spectra"),
        ("{relative: 0.03}", "{}", 9, "give exactly one of relative, file"),
        ("name: lawn", "name: ../lawn", 2, "a name of small letters, digits and hyphens"),
        ("    at_most: 0.05", "    at_most: 5", 12, "100 % or more"),
        ("    at_most: 0.05\n", "", 12, "a limit is missing"),
        ("    reason: enough\n", "", 12, "reason: Field required"),
        ("product: radiance", "product: radience", 12, "Input should be 'radiance'"),
        ("scenarios:", f"detection:\n  {TARGETS}\nscenarios:", 1, "detection needs a cube"),
        (SPECTRA, CUBE.replace("reflectance", "radiance"), 5, "the unit of the radiance is not stated"),
        (SPECTRA, CUBE + "  simulate: scene.yaml\n", 1, "says 'simulated: true'"),
        ("  calibration", "  simulate: scene.yaml\n  calibration", 5, "a simulated collection is a cube"),
        (SPECTRA, BY_NUMBER.replace("reflectance", "radiance"), 6, "no wavelength is known"),
        (SPECTRA, BY_NUMBER.replace("by_n", "wavelength_unit: nm, by_n"), 6, "no wavelength is known"),
        (SPECTRA, f"{BY_NUMBER}detection: {{{TARGETS}, bands: windows}}\n", 1, "no windows of the atmosphere"),
        ("[scenario.yaml]", "[{scenario: day.yaml}]", 10, r"scenarios\.0\.radcalnet: Field required"),
        ("[scenario.yaml]", "[{name: i, scene: {classes: [{name: a, fraction: 1, spectrum: {constnt: 0.3}}]}}]", 10,
         r"constnt: unknown key; did you mean 'constant'\?"),
    ],
)  # fmt: skip
def test_each_mistake_is_named_with_its_line_and_nothing_else(tmp_path, old, new, line, message):
    with pytest.raises(UsageError, match=message) as caught:
        load(tmp_path, (old, new))
    assert f"campaign.yaml:{line}:" in str(caught.value)
    assert caught.value.exit_code == 2
    # Of a scenario alone: neither of a day that it is not, nor keys that a scenario has as unknown.
    assert "did you mean 'scene'" not in str(caught.value)
    assert "radcalnet: Field" not in str(caught.value) or "radcalnet" in message


def test_all_mistakes_are_listed_at_once(tmp_path):
    with pytest.raises(UsageError) as caught:
        load(tmp_path, ("title:", "titel:"), ("    at_most", "    at_mots"), ("relative: 0.03", "relative: 3"))
    lines = [int(x) for x in re.findall(r"campaign\.yaml:(\d+):", str(caught.value))]
    assert {3, 9, 15} <= set(lines)
    assert lines == sorted(lines)
    for key, meant in (("titel", "title"), ("at_mots", "at_most")):
        assert f"{key}: unknown key; did you mean '{meant}'?" in str(caught.value)
