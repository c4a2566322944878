"""A right model closes: covariances, noise, expected maps, the first campaign; and its bytes are always the same."""

import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hyperval
import small_campaign
from hyperval import api, cli
from hyperval.campaign import expected_maps, load_job, run_campaign, scene_content
from hyperval.figures import draw_pictures
from hyperval.results import Outcome
from hyperval.run import Run
from hyperval.scenario import load_scenario
from small_campaign import PANELS, SmallCampaign, files_of, scene_data, write_collection

# A small simulated campaign whose model is right: the intervals of its covariances hold the truth.


TWIN = Path(__file__).parents[2] / "campaigns" / "share2012-twin"


def test_closure_makes_its_filters_of_the_classes_that_the_model_is_told_of():
    # 112 pixels on the rims of the panels made the mean score of cem-correlation 0.00078 in place of 0.00058.
    detection, scenario = load_job(TWIN / "campaign.yaml").campaign.detection, load_scenario(TWIN / "scenario.yaml")
    told = {each.name for each in scenario.scene.classes}
    assert set(detection.background) == set(detection.false_alarms) == told


def test_covariances_of_a_right_model_are_as_far_apart_as_sampling_makes_them(small):
    # The number of independent pixels was half of what it is: sampling seemed to make twice the distance found.
    run = api.validate(small.write()).to_dataframe()
    rows = run[(run.metric == "bhattacharyya_covariance_excess") & run.subject.isin(["field", "court"])]
    assert len(rows) == 4
    assert (rows.lower <= 0.0).all()
    assert (rows.upper >= 0.0).all()


def test_noise_of_a_right_model_in_a_file_of_coarse_steps(tmp_path, own_atmosphere, monkeypatch):
    # Steps of 0.01 add a fifth and more to the variance of noise in most bands.
    monkeypatch.setattr(small_campaign, "scene_data", lambda: {**scene_data(), "counts_per_radiance": 100.0})
    write_collection(tmp_path)
    run = api.validate(SmallCampaign(tmp_path).write()).to_dataframe()
    rows = run[run.metric == "noise_ratio"]
    assert set(rows.subject) == {"field", "court"}
    assert (rows.lower <= 1.0).all()
    assert (rows.upper >= 1.0).all()


# Maps of the scores that the model expects: what is said of a pixel, and what it then measures.


def test_expected_maps_of_a_closure_campaign(small):
    small.data["comparisons"] = small.data["comparisons"][:1]
    path, seen = small.write(), []
    job = load_job(path)
    run = run_campaign(job, with_observed=seen.append)
    (score_map,) = run.score_maps.values()
    place, detection = seen[0].place, job.campaign.detection
    whole = slice(None), slice(None)
    expected = score_map.expected.of(whole)

    # The measured mean of each kind of ground and target meets what is expected there, within five standard errors
    # (one false failure in a million) and the hundredth to which the filters of pixels and model agree.
    numbers, contents = scene_content(place, detection, {s for s, *_ in run.pair[0].expected_scores})
    names = [next(iter(content.values())) for content in contents]
    assert sorted(names) == sorted(["field", "court", *PANELS, "small-planks", "large-planks"])
    for number in range(len(contents)):
        there = numbers == number
        measured, (value,) = score_map.values[there], np.unique(expected[there])
        error = measured.std(ddof=1) / np.sqrt(there.sum())
        assert abs(measured.mean() - value) < 5.0 * error + 0.01
    # Nothing is said of what is beside the pixel that holds a plank's centre.
    assert np.isnan(expected[numbers == -1]).all()
    assert {names[n] for n in np.unique(numbers[place.region("white-panel")])} == {"white-panel"}
    beside = place.near_targets.copy()
    beside[tuple(np.transpose([t.centre_pixel for t in place.targets]))] = False
    assert (numbers[beside] == -1).all()

    # A pixel of two targets holds an unknown part of each, of three too; one target alone keeps its own.
    first, second, third = (replace(t, part=np.ones((2, 2), bool)) for t in place.targets[:3])
    corner = first.corner[0], first.corner[1]
    second, third = (
        replace(second, corner=(corner[0], corner[1] + 1)),
        replace(third, corner=(corner[0] + 1, corner[1] + 1)),
    )
    crowded = replace(place, targets=[first, second, third], target_pixels="touched")
    numbers, _ = scene_content(crowded, detection.model_copy(update={"group": "{name}"}), {"field"})
    window = numbers[corner[0] : corner[0] + 3, corner[1] : corner[1] + 3]
    np.testing.assert_array_equal(
        window >= 0, [[True, False, True], [True, False, False], [window[2, 0] >= 0, True, True]]
    )
    assert expected_maps(place, detection, {}) == {}
    assert expected_maps(place, detection, {("elsewhere", "yellow", "cem"): 1.0}) == {}

    measured, drawn = draw_pictures(None, run.score_maps, simulated=True)
    assert (measured.name, drawn.name) == ("score-map-1", "score-map-1-expected")
    assert measured.width_px == drawn.width_px
    assert "blank where" in drawn.title


# The page for newcomers is a campaign that runs and passes, as it stands there.


PAGE = Path(__file__).parents[2] / "docs" / "tutorial.md"


@pytest.mark.slow
def test_the_first_campaign_runs_and_passes(tmp_path):
    for name, text in re.findall(r"<!-- file: (\S+) -->\n```yaml\n(.*?)```", PAGE.read_text(), re.DOTALL):
        (tmp_path / name).write_text(text)
    campaign, out = str(tmp_path / "campaign.yaml"), tmp_path / "first"
    assert cli.run(["-q", "validate", "--dry-run", campaign]) == 0
    assert cli.run(["-q", "validate", campaign, "-o", str(out)]) == 0
    table = Run.open(out).table
    passed = table.where(outcome=Outcome.AGREES)
    assert {r.subject for r in passed if r.product == "radiance"} == {"field", "court", "white-panel", "black-panel"}
    # The page closes: seven full tests, each of which has p below 0.002 or above 0.998 once in 250 right models.
    full = {(r.product, r.subject): r.value for r in table if r.metric == "p_value_full"}
    assert set(full) >= {("radiance", "black-panel"), ("reflectance", "field"), ("reflectance", "court")}
    assert all(0.002 < p < 0.998 for p in full.values()), full
    lines = [r for r in table if r.product == "reflectance" and r.subject in ("white-panel", "black-panel")]
    assert len(lines) == 2
    assert all("no degree of freedom" in r.reason for r in lines)  # the line goes through both panels
    assert next(r.value for r in table if r.metric == "pd_inside_interval@1e-2") == 1.0


def test_marks_of_the_file_and_of_the_table_are_the_same():
    marks = set(re.findall(r"# \(([a-z])\)", PAGE.read_text()))
    assert marks == set(re.findall(r"^\| ([a-z]) \|", PAGE.with_name("first-campaign.md").read_text(), re.MULTILINE))


# The same campaigns give the same bytes, whoever computes them: processes, threads, blocks of lines.


# Read again by every process that the run starts.
SCRIPT = """
import os, sys
from small_campaign import stand_in_atmosphere
import hyperval.atmosphere, hyperval.imagery.cube, hyperval.model.stated, hyperval.pixels.statistics
from hyperval import cli

hyperval.atmosphere.atmospheric_terms = hyperval.model.stated.atmospheric_terms = stand_in_atmosphere
if "CORES" in os.environ:
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: int(os.environ["CORES"])])
if "LINES" in os.environ:
    hyperval.pixels.statistics.BLOCK_PIXELS = 72 * int(os.environ["LINES"])
    hyperval.imagery.cube.BLOCK_BYTES = 72 * 16 * 8 * int(os.environ["LINES"])
if __name__ == "__main__":
    sys.exit(cli.run(sys.argv[1:]))
"""
AS_IT_IS = {"HYPERVAL_WORKERS": "1", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def run(tmp_path: Path, name: str, paths: list[Path], **environment: str) -> dict[str, bytes]:
    (tmp_path / "script.py").write_text(SCRIPT)
    tests = Path(__file__).parents[1]
    places = [str(Path(hyperval.__file__).parents[1]), str(tests), str(tests / "shared")]
    inherited = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    command = [sys.executable, str(tmp_path / "script.py"), "-q", "validate", *map(str, paths), "-o", name]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, check=False,
        env={**inherited, "PYTHONPATH": os.pathsep.join(places), **AS_IT_IS, **environment},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr.decode()
    return files_of(tmp_path / name)


@pytest.mark.slow
def test_results_pages_figures_and_products_do_not_depend_on_who_computes_them(small_collection, tmp_path):
    paths = []
    for name in ("one", "two"):
        shutil.copytree(small_collection, tmp_path / name)
        campaign = SmallCampaign(tmp_path / name)
        campaign.data["name"] = name
        campaign.data["detection"]["targets"][0]["name"] = "yellow"
        paths.append(campaign.write())
    first = run(tmp_path, "first", paths, CORES="1")
    assert {"results.csv", "report.html", "one/products.nc", "two/report.html", "one/results.csv"} <= set(first)
    assert sum(name.endswith(".png") for name in first) >= 4
    threads = {"OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"}
    other = run(tmp_path, "other", paths, HYPERVAL_WORKERS="2", LINES="5", **threads)
    assert sorted(other) == sorted(first)
    assert [path for path in first if other[path] != first[path]] == []
