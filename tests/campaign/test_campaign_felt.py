"""The felt campaigns on stand-in lines: real headers, masks and spectra, simulated pixels."""

from __future__ import annotations

import csv
import re
import shutil
from pathlib import Path

import pytest

from felt_stand_in import LINES, MARK, stand_in
from hyperval import cli
from hyperval.campaign.one import jobs_of, run_campaign
from hyperval.imagery.cube import open_cube
from hyperval.results import Outcome, Role

CAMPAIGNS = Path(__file__).parents[2] / "campaigns"
FILES = {
    "share2012-felt": "share2012-felt/campaign.yaml",
    "share2010-felt": "share2010-felt/campaign.yaml",
    "share2010-felt-chip": "share2010-felt/campaign-chip.yaml",
}
# Felts by the patches of the masks, and the pixels that these mark.
FELTS = {
    "share2012-felt": {"blue-felt": (9, 76), "red-felt": (7, 68)},
    "share2010-felt": {"blue-felt": (8, 57), "red-felt": (8, 96)},
    "share2010-felt-chip": {"red-felt": (4, 61)},
}


@pytest.mark.parametrize("name", FILES)
def test_without_images_a_campaign_is_skipped_with_the_command_that_fetches_them(name, tmp_path, monkeypatch):
    monkeypatch.delenv("HYPERVAL_DATA", raising=False)
    monkeypatch.setenv("HYPERVAL_CACHE", str(tmp_path))
    (job,) = jobs_of(CAMPAIGNS / FILES[name])
    run = run_campaign(job)
    assert {row.outcome for row in run.table} == {Outcome.SKIPPED}
    assert "hyperval data fetch " + name.removesuffix("-chip") in run.notes[0]


@pytest.mark.data
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[] if name.endswith("chip") else [pytest.mark.slow]) for name in FILES],
)
def test_stand_in_lines_close(name, tmp_path, data_dir, monkeypatch):
    """Felts that were put where the masks have them are all found, and their areas come back to a tenth."""
    real = data_dir("share2012-felt/images/avon_reflectance.hdr").parents[2]
    stand_in(name, real, tmp_path / "data")
    monkeypatch.setenv("HYPERVAL_DATA", str(tmp_path / "data"))
    cube = open_cube(tmp_path / "data" / LINES[name].cube, quantity="reflectance", scale=None, check_values=False)
    assert cube.description == MARK
    assert cli.run(["-q", "observe", str(CAMPAIGNS / FILES[name]), "-o", str(tmp_path / "out")]) == 0
    with open(tmp_path / "out" / "results.csv", newline="") as stream:
        rows = {(r["product"], r["subject"], r["method"], r["metric"]): r for r in csv.DictReader(stream)}
    for felt, (objects, pixels) in FELTS[name].items():
        by_object = rows["roc", felt, "matched-filter/object", "pd@1e-2"]
        assert (float(by_object["value"]), int(by_object["n"])) == (1.0, objects)
        by_pixel = rows["roc", felt, "matched-filter/pixel", "pd@1e-2"]
        assert float(by_pixel["value"]) > 0.8
        assert int(by_pixel["n"]) == pixels
        area = float(rows["abundance", felt, "cem", "area"]["value"])
        assert area == pytest.approx(pixels / objects, rel=0.1)  # pixels of 1 m2
        assert ("roc", felt, "sam/pixel", "pd@1e-2") in rows
        assert ("roc", felt, "ace/pixel", "pd@1e-2") in rows


@pytest.mark.slow
@pytest.mark.data
def test_prediction_and_measurement_meet_on_a_stand_in_line(tmp_path, data_dir, monkeypatch):
    """The chip by its own campaign, without ACE and what-ifs, which take most of its time: P_D, alarms, area."""
    real = data_dir("share2012-felt/images/avon_reflectance.hdr").parents[2]
    stand_in("share2010-felt-chip", real, tmp_path / "data")
    monkeypatch.setenv("HYPERVAL_DATA", str(tmp_path / "data"))
    shutil.copytree(CAMPAIGNS / "share2010-felt", tmp_path / "campaign")
    for path in (tmp_path / "campaign").glob("*-chip.yaml"):
        text = re.sub(r"(?ms)^attribution:.*\Z", "", path.read_text())
        path.write_text(text.replace(", ace, sam]", "]").replace(", ace]", "]"))
    (job,) = jobs_of(tmp_path / "campaign/campaign-chip.yaml")
    rows = {(r.subject, r.method, r.metric): r for r in run_campaign(job, show_progress=False).table}
    by_pixel = rows["red-felt", "matched-filter/pixel", "pd_difference@1e-3"]
    # Three of the 61 marked pixels hardly hold any felt: the model counts the fullest, the mask what was drawn.
    assert (by_pixel.outcome, by_pixel.value) == (Outcome.AGREES, pytest.approx(0.05, abs=0.04))
    assert by_pixel.n == 61
    assert rows["red-felt", "matched-filter/object", "pd_difference@1e-2"].value == pytest.approx(0.0, abs=1e-3)
    assert rows["red-felt", "cem", "area_ratio"].value == pytest.approx(1.0, abs=0.05)
    # 12,068 pixels of background: blocks know their rate at a tenth to 15 %.
    assert rows["red-felt background", "cem", "pfa_ratio@1e-1"].value == pytest.approx(1.0, abs=0.15)
    assert rows["red-felt", "matched-filter/object", "alarms_before_first"].value == 0
    gates = {r.outcome for r in rows.values() if r.role is Role.GATE}
    assert Outcome.AGREES in gates
    assert not gates & {Outcome.ERROR, Outcome.DISAGREES}
