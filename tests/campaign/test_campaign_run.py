"""Running campaigns end to end: what is written, that it repeats to the byte, and what is never missing."""

import collections
import csv
import json
import os
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from hyperval import api, cli
from hyperval.campaign import ObservedCampaign, command_without_output
from hyperval.errors import InputError
from hyperval.products import ScoreDistribution
from hyperval.results import COLUMNS, Cause, Outcome
from hyperval.run import Run
from hyperval.units import to_internal
from small_campaign import files_of, scenario_data, scene_data, write_yaml

PAGES = {"results.csv", "summary.csv", "results.json", "report.html"}
CONTRACT = PAGES | {"products.nc", "provenance.json", "junit.xml"}
MEDIAN = "median_abs_difference_ratio_windows"


def rows_of(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "results.csv").read_text().splitlines()))


def test_the_folder_holds_every_file_of_the_contract_and_repeats_to_the_byte(figures, small, tmp_path):
    path = small.write()
    first, second = tmp_path / "first", tmp_path / "elsewhere" / "second"
    assert cli.run(["-q", "validate", str(path), "-o", str(first), "--junit", str(tmp_path / "a/b.xml")]) == 0
    assert cli.run(["-q", "validate", str(path), "-o", str(second)]) == 0
    one, two = files_of(first), files_of(second)
    assert CONTRACT | {"scores/yellow-cem.tif"} <= set(one)
    assert any(name.startswith("figures/") for name in one)
    assert sorted(one) == sorted(two)
    assert [name for name in one if one[name] != two[name]] == []
    assert (tmp_path / "a/b.xml").read_bytes() == one["junit.xml"]
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []  # nothing half-written is left

    rows = rows_of(first)
    assert tuple(rows[0]) == COLUMNS
    counts = collections.Counter(r["outcome"] for r in rows if r["role"] == "gate")
    assert counts == {"agrees": 8, "undecided": 2}  # the curves are inside an interval, which is coverage
    one_sided = [r for r in rows if r["metric"] == "comparison"]  # products without a plan are information
    assert {r["outcome"] for r in one_sided} == {"none"}
    assert all(r["reason"].startswith("not compared: no ") for r in one_sided)
    assert len(json.loads((first / "results.json").read_text())["rows"]) == len(rows)
    assert "simulated" in (first / "report.html").read_text()
    record = json.loads((first / "provenance.json").read_text())
    own = ("small_rad.img", "small_rad.hdr", "regions.geojson", "targets.csv", "panel_spectra.csv")
    read = {"campaign.yaml", "sensor.yaml", *(f"collection/{name}" for name in own)}
    assert {entry["reference"] for entry in record["inputs"]} == read
    assert all(len(entry["sha256"]) == 64 for entry in record["inputs"])
    assert record["formulation"] == "corrected"
    assert str(tmp_path) not in (first / "provenance.json").read_text()

    with h5py.File(first / "products.nc", "r+") as file:
        del file["observed/good_band"]
    with pytest.raises(InputError, match="was written by another version of hyperval"):
        _ = Run.open(first).sides


def test_a_simulated_campaign_from_its_scene_and_a_scenario_in_a_file_beside_it(small, monkeypatch):
    small.data["collection"]["simulate"], small.data["scenarios"] = "scene.yaml", ["scenario.yaml"]
    write_yaml(small.folder / "scene.yaml", scene_data())
    scenario = write_yaml(small.folder / "scenario.yaml", scenario_data())
    small.data = json.loads(json.dumps(small.data).replace("collection/", "simulated:"))
    run = api.validate(small.write())
    assert run.results.exit_code() == 0
    assert run.provenance["seed"] == scene_data()["seed"]
    references = {entry["reference"] for entry in run.provenance["inputs"]}
    assert {"scene.yaml", "scenario.yaml", "simulated:small_rad.img", "simulated:small_rad.hdr"} <= references
    other = small.folder / "elsewhere"  # one of that name in the working directory is not the campaign's
    other.mkdir()
    scenario.rename(other / "scenario.yaml")
    monkeypatch.chdir(other)
    assert cli.run(["-q", "validate", str(small.folder / "campaign.yaml"), "-o", str(other / "out")]) == 3


@pytest.mark.parametrize("lacking", ["cube", "scenario"])
def test_a_missing_data_set_is_skipped_with_the_command_that_fetches_it(lacking, small, tmp_path, no_data, capsys):
    if lacking == "scenario":
        small.scenario["scene"]["targets"][0]["spectrum"] = {"file": "data:hysu/published/svc/DLR_HySU_SVC.lib"}
    path, out = (small if lacking == "scenario" else small.of_a_data_set()).write(), tmp_path / "out"
    assert cli.run(["-q", "validate", str(path), "-o", str(out)]) == 5
    rows = rows_of(out)
    planned = [(g["product"], s, g["metric"]) for g in small.data["comparisons"] for s in g["subjects"]]
    assert [(r["product"], r["subject"], r["metric"]) for r in rows] == planned
    assert {r["outcome"] for r in rows} == {"skipped"}
    assert all("hyperval data fetch hysu" in r["reason"] for r in rows)
    assert set(files_of(out)) >= CONTRACT
    capsys.readouterr()
    if lacking == "cube":  # nothing but the collection was asked for
        assert cli.run(["-q", "observe", str(path), "-o", str(tmp_path / "alone")]) == 3
        assert "hyperval data fetch hysu" in capsys.readouterr().err


def test_a_fault_of_ours_is_named_with_its_place_in_the_rows_of_its_campaign(make_small, tmp_path, monkeypatch):
    monkeypatch.setattr("hyperval.campaign.run.run_campaign", lambda *_, **__: to_internal(None, "wavelength"))
    one, two = make_small("one"), make_small("two")
    two.data["name"] = "other"
    out = tmp_path / "out"
    assert cli.run(["-q", "validate", str(one.write()), str(two.write()), "-o", str(out)]) == 4
    rows = rows_of(out)
    assert {r["outcome"] for r in rows} == {"error"}
    assert all("AttributeError" in r["reason"] and "(at hyperval/units.py:" in r["reason"] for r in rows)


def test_of_several_campaigns_a_broken_and_a_skipped_one_do_not_hide_another(make_small, tmp_path, no_data):
    good, lacking, broken = make_small("good"), make_small("lacking").of_a_data_set(), make_small("broken")
    lacking.data["name"], good.data["name"] = "other", "b" * 120  # of more letters than its folder has
    os.truncate(broken.collection / "small_rad.img", 100)
    out = tmp_path / "out"
    both = [str(good.write()), str(lacking.write())]
    assert cli.run(["-q", "validate", str(broken.write()), *both, "-o", str(out)]) == 3
    rows = rows_of(out)
    lost = [r for r in rows if r["campaign"] == "small"]
    assert [r["outcome"] for r in lost] == ["error"] * sum(len(g["subjects"]) for g in broken.data["comparisons"])
    assert all("small_rad.img" in r["reason"] and "bytes" in r["reason"] for r in lost)
    assert {r["outcome"] for r in rows if r["campaign"] == "other"} == {"skipped"}
    assert sum(r["outcome"] == "agrees" and r["role"] == "gate" for r in rows if r["campaign"] == "b" * 120) == 8
    assert PAGES | {"b" * 100 + "/report.html"} <= set(files_of(out))
    assert cli.run(["-q", "validate", *both, "-o", str(tmp_path / "two")]) == 0  # skipped beside passing
    good.data["title"] = "edited since"
    assert cli.run(["-q", "check", str(good.write()), f"--from={out}"]) == 2  # its run is of another file


def test_pools_and_areas_are_predicted_and_compared(small):
    small.data["detection"]["pools"] = [{"name": "both", "subjects": ["small-planks", "large-planks"]}]
    one = {"product": "roc", "subjects": ["both"], "method": "cem/object", "metric": "pd_inside_interval@1e-2"}
    small.data["comparisons"].append(one | {"at_least": 1, "reason": "closure"})
    small.data["fitted_on"] = ["small-planks"]
    run = api.validate(small.write())
    predicted = run.prediction.products.roc
    parts = [predicted[s, "cem", "object"].pd for s in ("small-planks", "large-planks")]
    assert predicted["both", "cem", "object"].pd == pytest.approx((parts[0] + parts[1]) / 2, abs=1e-12)
    assert run.observation.products.roc["both", "cem", "object"].n_target == 96
    (row,) = run.results.where(subject="both", method="cem/object", metric="pd_inside_interval@1e-2")
    found = row.value, row.outcome, row.cause, row.subjects_seen  # one of both was fitted on
    assert found == (1.0, Outcome.UNDECIDED, Cause.COVERAGE, "fitted")
    for subject in ("small-planks", "large-planks"):
        with (small.collection / "targets.csv").open() as stream:
            stated = [float(r["area_m2"]) for r in csv.DictReader(stream) if r["group"] == subject]
        assert run.prediction.abundance[subject, "cem"].area_m2 == pytest.approx(sum(stated) / 48)


def test_nothing_planned_is_missing(small):
    small.data["comparisons"] += [
        {"product": "radiance", "subjects": ["nowhere"], "metric": MEDIAN, "at_most": 0.1, "gate": False,
         "reason": "a slip"},
        {"product": "snr", "subjects": ["field"], "metric": MEDIAN, "at_most": 0.1, "reason": "not measured"},
        {"product": "roc", "subjects": ["*"], "metric": "pd_inside_interval@1e-9", "at_least": 1,
         "reason": "no curve"},
    ]  # fmt: skip
    run = api.validate(small.write())
    for where, words in (
        ({"product": "radiance", "subject": "nowhere"}, "planned but absent"),
        ({"product": "snr", "subject": "field"}, "no snr of field in the observation"),
        ({"product": "roc", "metric": "pd_inside_interval@1e-9"}, ""),
    ):
        (row,) = run.results.where(**where)
        assert row.outcome is Outcome.ERROR
        assert words in row.reason
    assert run.results.exit_code() == 1
    small.data["comparisons"] = [{**small.gate("snr"), "gate": False, "metric": MEDIAN}]
    assert api.validate(small.write()).results.exit_code() == 5  # nothing was checked


@pytest.mark.parametrize("arguments", ["-o /a/out", "--output /b", "--output=/c", "-o/d", "--data-dir /e --again"])
def test_the_recorded_command_does_not_name_this_run_s_places(arguments):
    given = ["/usr/bin/hyperval", "validate", "/x/y/lawn/campaign.yaml", *arguments.split()]
    assert command_without_output(given) == ["hyperval", "validate", "lawn/campaign.yaml"]


def test_observe_alone_needs_neither_scenario_nor_comparison_and_validate_both(small, tmp_path, capsys):
    results = []
    for lacking in ((), ("scenarios", "comparisons")):
        for key in lacking:
            del small.data[key]
        out = tmp_path / f"without-{len(lacking)}"
        assert cli.run(["-q", "observe", str(small.write()), "-o", str(out)]) == 0
        assert set(files_of(out)) >= CONTRACT | {"scores/yellow-cem.tif"}
        results.append(rows_of(out))
    assert results[0] == results[1]
    assert {r["outcome"] for r in results[0]} == {"none"}
    expected = {"radiance", "snr", "reflectance", "covariance", "scores", "roc", "abundance"}
    assert {r["product"] for r in results[0]} == expected
    capsys.readouterr()
    assert cli.run(["-q", "validate", str(small.folder / "campaign.yaml"), "-o", str(tmp_path / "v")]) == 2
    said = capsys.readouterr().err
    assert "the campaign has no scenarios and no comparisons" in said
    assert "hyperval observe needs neither" in said


def test_of_the_pixels_of_a_class_those_are_shared_that_false_alarms_are_counted_on():
    regions, of = {"lawn": [1, 1, 1, 0], "field": [0, 1, 1, 1]}, SimpleNamespace
    place = of(pixels_of=lambda name: np.array(regions[name], bool))
    scenario = of(scene=of(classes=[of(spectrum=of(measured=name)) for name in ("lawn", None)]))
    side = of(scenarios=[scenario], observed=of(place=place), campaign=of(detection=of(false_alarms=["field"])))
    assert ObservedCampaign.with_shared_count(side, ScoreDistribution(0.0, 1.0, 3)).shared == 2
