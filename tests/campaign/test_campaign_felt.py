"""The felt campaigns on stand-in lines: real headers, masks and spectra, simulated pixels."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from felt_stand_in import LINES, MARK, Departures, stand_in
from hyperval import cli
from hyperval.campaign import jobs_of, run_campaign
from hyperval.imagery import open_cube
from hyperval.results import Outcome, Role
from hyperval.run import Run

CAMPAIGNS = Path(__file__).parents[2] / "campaigns"


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("name", LINES)
def test_stand_in_lines_close(name, tmp_path, data_dir, monkeypatch):
    """P_D, alarms, areas and the joint scores of felts that were put where the masks have them, each of its size.

    One band of six; blur, level of the felts and errors of the image drawn as the scenario states them.  The chip's
    campaign runs as it stands, from the command line; the others without what takes most of their time: ACE and
    what-ifs in the model, and an uncertain blur.
    """
    real = data_dir("share2012-felt/images/avon_reflectance.hdr").parents[2]
    departs = Departures.drawn(name, np.random.default_rng(0))
    if not name.endswith("chip"):
        departs = replace(departs, blur=1.0)
    stand_in(name, real, tmp_path / "data", every=6, departs=departs)
    monkeypatch.setenv("HYPERVAL_DATA", str(tmp_path / "data"))
    monkeypatch.setattr("hyperval.datasets.DataFile.matches", lambda *_: True)  # they stand in for registered files
    cube = open_cube(tmp_path / "data" / LINES[name]["cube"], quantity="reflectance", scale=None, check_values=False)
    assert cube.description == MARK
    if name.endswith("chip"):
        assert cli.run(["-q", "validate", str(CAMPAIGNS / LINES[name]["campaign"]), "-o", str(tmp_path / "out")]) == 0
        table = Run.open(tmp_path / "out").table
    else:
        folder = tmp_path / "campaign"
        shutil.copytree((CAMPAIGNS / LINES[name]["campaign"]).parent, folder)
        for path in folder.glob("*.yaml"):
            text = re.sub(r"(?ms)^attribution:.*\Z", "", path.read_text())
            path.write_text(text.replace("cem, ace]", "cem]").replace("  psf_fwhm_pixels: 0.3\n", ""))
        (job,) = jobs_of(folder / "campaign.yaml")
        table = run_campaign(job, show_progress=False).table
    rows = {(r.subject, r.method, r.metric): r for r in table}
    for felt, (objects, sizes, pixels) in LINES[name]["holds"].items():
        by_pixel = rows[felt, "matched-filter/pixel", "pd_difference@1e-3"]
        # Some of the marked pixels hardly hold any felt: the model counts the fullest, the mask what was drawn.
        assert (by_pixel.outcome, by_pixel.value) == (Outcome.AGREES, pytest.approx(0.03, abs=0.06))
        assert by_pixel.n == pixels
        by_object = rows[felt, "matched-filter/object", "pd_difference@1e-2"]
        assert (by_object.value, by_object.n) == (pytest.approx(0.0, abs=1e-3), objects)
        assert rows[felt, "matched-filter/object", "alarms_before_first"].value == 0
        areas = [r for (s, m, k), r in rows.items() if k == "area_ratio" and m == "cem" and s.startswith(felt)]
        assert {r.outcome for r in areas} == {Outcome.AGREES}
        assert len(areas) == sizes
        # Blocks know the rate at a tenth to 15 %.
        assert rows[f"{felt} background", "cem", "pfa_ratio@1e-1"].value == pytest.approx(1.0, abs=0.15)
        # SAM has no model and ACE has none here: measured alone.
        assert {(felt, f"{d}/pixel") for d in ("sam", "ace")} <= {key[:2] for key in rows}
    # One draw: a right model fails this once in a hundred.
    assert rows["all objects", "matched-filter", "joint_distance_p_value"].value > 0.01
    gates = {r.outcome for r in rows.values() if r.role is Role.GATE}
    assert Outcome.AGREES in gates
    assert not gates & {Outcome.ERROR, Outcome.DISAGREES}
