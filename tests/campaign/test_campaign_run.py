"""Running campaigns end to end: what is written, that it repeats to the byte, and what is never missing."""

from __future__ import annotations

import collections
import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest

from hyperval import cli
from hyperval.campaign.job import job_of
from hyperval.campaign.one import run_campaign
from hyperval.campaign.provenance import command_without_output
from hyperval.errors import MissingDataError, UsageError
from hyperval.results import COLUMNS, Cause, Outcome
from hyperval.storage import LIST
from hyperval.units import wavelength_to_nm
from small_campaign import SmallCampaign, scene_data, write_yaml

CONTRACT = {
    "results.csv",
    "summary.csv",
    "results.json",
    "report.html",
    "products.nc",
    "provenance.json",
    "junit.xml",
}
MEDIAN = "median_abs_difference_ratio_windows"


def rows_of(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "results.csv").read_text().splitlines()))


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def run_alone(small: SmallCampaign, **options):
    """One campaign without writing its folder."""
    path = small.write()
    return run_campaign(job_of(path), show_progress=False, **options)


def data_only(small: SmallCampaign) -> SmallCampaign:
    """The same campaign, whose cube is a file of a registered data set."""
    small.data["collection"]["cube"] = {
        "path": "data:hysu/published/full/DLR_HySU_HS_full.tif", "quantity": "reflectance",
    }  # fmt: skip
    return small


@pytest.fixture
def no_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "empty").mkdir()
    monkeypatch.setenv("HYPERVAL_DATA", str(tmp_path / "empty"))
    monkeypatch.setenv("HYPERVAL_CACHE", str(tmp_path / "cache"))


def test_the_folder_holds_every_file_of_the_contract_and_repeats_to_the_byte(figures, small, tmp_path):
    path = small.write()
    first, second = tmp_path / "first", tmp_path / "elsewhere" / "second"
    assert cli.run(["-q", "validate", str(path), "-o", str(first)]) == 0
    assert cli.run(["-q", "validate", str(path), "-o", str(second)]) == 0
    one, two = files_of(first), files_of(second)
    assert CONTRACT | {"scores/yellow-cem.tif"} <= set(one)
    assert any(name.startswith("figures/") for name in one)
    assert sorted(one) == sorted(two)
    assert [name for name in one if one[name] != two[name]] == []
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []  # nothing half-written is left

    rows = rows_of(first)
    assert tuple(rows[0]) == COLUMNS
    gates = [r for r in rows if r["role"] == "gate"]
    counts = collections.Counter(r["outcome"] for r in gates)
    assert counts == {"agrees": 8, "undecided": 2}  # the curves are inside an interval, which is coverage
    assert {r["outcome"] for r in rows} <= {"agrees", "disagrees", "undecided", "none", "skipped"}
    assert len(json.loads((first / "results.json").read_text())["rows"]) == len(rows)
    assert "simulated" in (first / "report.html").read_text()
    record = json.loads((first / "provenance.json").read_text())
    references = {entry["reference"] for entry in record["inputs"]}
    assert references == {
        "campaign.yaml", "sensor.yaml", "collection/small_rad.img", "collection/small_rad.hdr",
        "collection/regions.geojson", "collection/targets.csv", "collection/panel_spectra.csv",
    }  # fmt: skip
    assert all(len(entry["sha256"]) == 64 for entry in record["inputs"])
    assert record["formulation"] == "corrected"
    assert str(tmp_path) not in (first / "provenance.json").read_text()


def test_observe_alone_writes_what_the_collection_says(small, tmp_path):
    out = tmp_path / "out"
    assert cli.run(["-q", "observe", str(small.write()), "-o", str(out)]) == 0
    assert set(files_of(out)) >= CONTRACT | {"scores/yellow-cem.tif"}
    rows = rows_of(out)
    assert {r["outcome"] for r in rows} == {"none"}
    expected = {"radiance", "snr", "reflectance", "covariance", "scores", "roc", "abundance"}
    assert {r["product"] for r in rows} == expected


def test_a_simulated_campaign_from_its_scene(small):
    small.data["collection"]["simulate"] = "scene.yaml"
    scene = scene_data()
    write_yaml(small.folder / "scene.yaml", scene)
    text = json.dumps(small.data).replace("collection/", "simulated:")
    small.data = json.loads(text)
    run = run_alone(small)
    assert run.table.exit_code() == 0
    assert run.simulated is True
    assert run.provenance["seed"] == scene["seed"]
    references = {entry["reference"] for entry in run.provenance["inputs"]}
    assert {"scene.yaml", "simulated:small_rad.img", "simulated:small_rad.hdr", "sensor.yaml"} <= references


def test_simulated_files_without_a_simulation(small):
    small.data["collection"]["cube"]["path"] = "simulated:small_rad.img"
    with pytest.raises(UsageError, match="this campaign simulates nothing") as caught:
        run_alone(small)
    assert "set collection.simulate" in str(caught.value)


def test_a_missing_data_set_is_skipped_with_the_command_that_fetches_it(small, tmp_path, no_data):
    out = tmp_path / "out"
    assert cli.run(["-q", "validate", str(data_only(small).write()), "-o", str(out)]) == 5
    rows = rows_of(out)
    assert {r["outcome"] for r in rows} == {"skipped"}
    planned = [(g["product"], s, g["metric"]) for g in small.data["comparisons"] for s in g["subjects"]]
    assert [(r["product"], r["subject"], r["metric"]) for r in rows] == planned
    assert all("hyperval data fetch hysu" in r["reason"] for r in rows)
    assert set(files_of(out)) >= CONTRACT
    assert "hyperval data fetch hysu" in (out / "report.html").read_text()


def test_observe_without_its_data_set_is_an_input_error(small, tmp_path, no_data, capsys):
    assert cli.run(["-q", "observe", str(data_only(small).write()), "-o", str(tmp_path / "out")]) == 3
    assert "hyperval data fetch hysu" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_fault_of_ours_is_named_with_its_place_in_the_rows_of_its_campaign(make_small, tmp_path, monkeypatch):
    def faulty(*_, **__):
        return wavelength_to_nm(None)

    monkeypatch.setattr("hyperval.campaign.run.run_campaign", faulty)
    monkeypatch.setenv("HYPERVAL_WORKERS", "1")
    one, two = make_small("one"), make_small("two")
    two.data["name"] = "other"
    out = tmp_path / "out"
    assert cli.run(["-q", "validate", str(one.write()), str(two.write()), "-o", str(out)]) == 4
    rows = rows_of(out)
    assert {r["outcome"] for r in rows} == {"error"}
    assert all("AttributeError" in r["reason"] and "(at hyperval/units.py:" in r["reason"] for r in rows)


def test_a_skipped_campaign_beside_a_passing_one_passes(make_small, tmp_path, no_data):
    one, two = make_small("one"), data_only(make_small("two"))
    two.data["name"] = "other"
    out = tmp_path / "out"
    assert cli.run(["-q", "validate", str(one.write()), str(two.write()), "-o", str(out)]) == 0
    statuses = {r["campaign"]: set() for r in rows_of(out)}
    for row in rows_of(out):
        statuses[row["campaign"]].add(row["outcome"])
    assert statuses["other"] == {"skipped"}
    assert "agrees" in statuses["small"]
    assert set(files_of(out)) >= {
        "results.csv",
        "summary.csv",
        "results.json",
        "report.html",
        "small/report.html",
        "other/report.html",
    }


def test_one_broken_campaign_does_not_hide_the_other(make_small, tmp_path):
    good, broken = make_small("good"), make_small("broken")
    broken.data["name"] = "broken"
    cube = broken.collection / "small_rad.img"
    cube.write_bytes(cube.read_bytes()[:-100])
    out = tmp_path / "out"
    assert cli.run(["-q", "validate", str(broken.write()), str(good.write()), "-o", str(out)]) == 3
    rows = rows_of(out)
    lost = [r for r in rows if r["campaign"] == "broken"]
    assert len(lost) == sum(len(g["subjects"]) for g in broken.data["comparisons"])
    assert {r["outcome"] for r in lost} == {"error"}
    assert all("small_rad.img" in r["reason"] and "bytes" in r["reason"] for r in lost)
    assert sum(r["outcome"] == "agrees" and r["role"] == "gate" for r in rows if r["campaign"] == "small") == 8
    assert (out / "broken" / "report.html").is_file()


def test_two_campaigns_of_one_name_are_refused(make_small, tmp_path):
    one, two = make_small("one"), make_small("two")
    assert cli.run(["-q", "validate", str(one.write()), str(two.write()), "-o", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "before", [{}, {"results.json": "{}", LIST: '{"schema": 1, "kind": "results", "files": ["results.json"]}'}]
)
def test_a_single_broken_campaign_leaves_what_was_there(small, tmp_path, before):
    out = tmp_path / "out"
    for name, text in before.items():
        out.mkdir(exist_ok=True)
        (out / name).write_text(text)
    (small.collection / "small_rad.img").unlink()
    assert cli.run(["-q", "validate", str(small.write()), "-o", str(out)]) == 3
    assert out.exists() is bool(before)
    assert not before or {p.name: p.read_text() for p in out.iterdir()} == before
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["small", *(["out"] if before else [])])


def test_a_folder_of_something_else_is_never_replaced(small, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    (out / "thesis.tex").write_text("years of work")
    assert cli.run(["-q", "validate", str(small.write()), "-o", str(out)]) == 2
    assert "holds files that no run wrote there: thesis.tex" in capsys.readouterr().err
    assert files_of(out) == {"thesis.tex": b"years of work"}


def test_statistics_taken_from_the_collection_are_not_compared_with_it(small):
    classes = small.scenario["scene"]["classes"]
    for item in classes:
        item["spectrum"] = {"measured": item["name"]}
    run = run_alone(small)
    assert "field" not in run.prediction.radiance
    assert "white-panel" in run.prediction.radiance
    assert any(n.startswith("not compared, as their statistics come from the collection") for n in run.notes)
    for subject in ("field", "court"):
        (row,) = run.table.where(product="radiance", subject=subject)
        # The plan names them, so their absence is an error and not silence.
        assert row.outcome is Outcome.ERROR
        assert "no radiance of" in row.reason
    small.gate("radiance")["subjects"] = ["*-panel", "grey-panel-35"]
    small.data["comparisons"] = [small.gate("radiance")]
    run = run_alone(small)
    (row,) = run.table.where(product="radiance", subject="court")
    assert row.outcome is Outcome.NONE
    assert row.reason.startswith("not compared: ")
    assert run.table.exit_code() == 0


def test_pools_are_predicted_and_compared(small):
    small.data["detection"]["pools"] = [{"name": "both", "subjects": ["small-planks", "large-planks"]}]
    small.data["comparisons"].append(
        {"product": "roc", "subjects": ["both"], "method": "cem/object", "metric": "pd_inside_interval@1e-2",
         "at_least": 1, "reason": "closure"}
    )  # fmt: skip
    run = run_alone(small)
    predicted = run.prediction.roc
    parts = [predicted[s, "cem", "object"].pd for s in ("small-planks", "large-planks")]
    assert predicted["both", "cem", "object"].pd == pytest.approx((parts[0] + parts[1]) / 2, abs=1e-12)
    assert run.observation.roc["both", "cem", "object"].n_target == 96
    (row,) = run.table.where(subject="both", method="cem/object", metric="pd_inside_interval@1e-2")
    assert (row.value, row.outcome, row.cause) == (1.0, Outcome.UNDECIDED, Cause.COVERAGE)


def test_areas_are_compared_with_the_truth(small):
    run = run_alone(small)
    for subject in ("small-planks", "large-planks"):
        with (small.collection / "targets.csv").open() as stream:
            stated = [float(r["area_m2"]) for r in csv.DictReader(stream) if r["group"] == subject]
        assert run.prediction.abundance[subject, "cem"].area_m2 == pytest.approx(sum(stated) / 48)


def test_nothing_planned_is_missing(small):
    small.data["comparisons"] += [
        {"product": "radiance", "subjects": ["nowhere", "court"], "metric": MEDIAN, "at_most": 0.1, "gate": False,
         "reason": "a slip"},
        {"product": "snr", "subjects": ["field"], "metric": MEDIAN, "at_most": 0.1, "reason": "not measured"},
        {"product": "roc", "subjects": ["*"], "metric": "pd_inside_interval@1e-9", "at_least": 1,
         "reason": "no curve"},
    ]  # fmt: skip
    table = run_alone(small).table
    (slip,) = table.where(product="radiance", subject="nowhere")
    assert slip.outcome is Outcome.ERROR
    assert "planned but absent" in slip.reason
    (unmeasured,) = table.where(product="snr", subject="field")
    assert unmeasured.outcome is Outcome.ERROR
    assert "no snr of field in the observation" in unmeasured.reason
    assert [r.outcome for r in table.where(product="roc", metric="pd_inside_interval@1e-9")] == [Outcome.ERROR]
    assert table.exit_code() == 1


def test_products_without_a_plan_are_information(small):
    table = run_alone(small).table
    one_sided = [r for r in table if r.metric == "comparison"]
    assert one_sided
    assert {r.outcome for r in one_sided} == {Outcome.NONE}
    assert all(r.reason.startswith("not compared: no ") for r in one_sided)


def test_only_information_means_that_nothing_was_checked(small, tmp_path):
    for gate in small.data["comparisons"]:
        gate["gate"] = False
    table = run_alone(small).table
    assert table.exit_code() == 5


def test_two_scenarios_on_the_same_subject_are_refused(small):
    small.data["scenarios"].append(small.scenario)
    with pytest.raises(UsageError, match="two scenarios predict the radiance of"):
        run_alone(small)


def test_scenarios_of_a_file_and_by_name(small, monkeypatch):
    write_yaml(small.folder / "scenario.yaml", small.scenario)
    small.data["scenarios"] = ["scenario.yaml"]
    run = run_alone(small)
    assert run.table.exit_code() == 0
    assert "scenario.yaml" in {entry["reference"] for entry in run.provenance["inputs"]}
    # A file of that name in the working directory is not the campaign's.
    other = small.folder / "elsewhere"
    other.mkdir()
    (small.folder / "scenario.yaml").rename(other / "scenario.yaml")
    monkeypatch.chdir(other)
    assert cli.run(["-q", "validate", str(small.folder / "campaign.yaml"), "-o", str(other / "out")]) == 3
    assert not (other / "out").exists()


def test_missing_data_of_a_scenario_is_skipped_too(small, no_data):
    small.scenario["scene"]["targets"][0]["spectrum"] = {
        "file": "data:hysu/published/svc/DLR_HySU_SVC.lib", "record": "Bitumen", "reflectance_unit": "scaled:10000",
    }  # fmt: skip
    table = run_alone(small).table
    assert {r.outcome for r in table} == {Outcome.SKIPPED}
    with pytest.raises(MissingDataError):
        run_alone(data_only(small), predicts=False)


@pytest.mark.parametrize(
    "arguments",
    [
        ["-o", "/a/out"], ["--output", "/b"], ["--output=/c"], ["-o/d"], ["--data-dir", "/data"],
        ["--data-dir=/data"],
    ],
)  # fmt: skip
def test_the_recorded_command_does_not_name_this_run_s_places(arguments):
    given = ["/usr/bin/hyperval", "validate", "/x/y/lawn/campaign.yaml", *arguments]
    assert command_without_output(given) == ["hyperval", "validate", "lawn/campaign.yaml"]


@pytest.mark.parametrize("lacking", ["scenarios", "comparisons"])
def test_observe_needs_neither_scenario_nor_comparison_and_validate_both(lacking, small, tmp_path, capsys):
    whole = small.data.copy()
    del small.data[lacking]
    assert cli.run(["-q", "observe", str(small.write()), "-o", str(tmp_path / "out")]) == 0
    small.data = whole
    assert cli.run(["-q", "observe", str(small.write("whole.yaml")), "-o", str(tmp_path / "whole")]) == 0
    assert (tmp_path / "out/results.csv").read_bytes() == (tmp_path / "whole/results.csv").read_bytes()
    capsys.readouterr()
    assert cli.run(["-q", "validate", str(small.folder / "campaign.yaml"), "-o", str(tmp_path / "v")]) == 2
    said = capsys.readouterr().err
    assert f"the campaign has no {lacking}" in said
    assert "hyperval observe needs neither" in said
    assert not (tmp_path / "v").exists()


def test_a_halo_adds_the_curve_with_alarms_by_pixel_to_every_output(small, tmp_path):
    small.data["detection"]["halo_pixels"] = 1
    out = tmp_path / "out"
    assert cli.run(["-q", "validate", str(small.write()), "-o", str(out)]) in (0, 1)
    methods = {r["method"] for r in rows_of(out) if r["product"] == "roc"}
    assert {"cem/pixel", "cem/object", "cem/object-by-pixel"} <= methods
    predicted = {
        r["metric"] for r in rows_of(out) if r["method"] == "cem/object-by-pixel" and r["outcome"] != "skipped"
    }
    assert not any(metric.startswith("pd_difference") for metric in predicted)
    assert "they favour detection" in (out / "report.html").read_text()


def test_libraries_of_results_and_suns_are_not_loaded_before_they_are_needed():
    """They take 130 MB and a second: an image is read without them."""
    late = ("pandas", "xarray", "matplotlib", "pvlib", "requests")
    code = f"import sys, hyperval.campaign.run; print([m for m in {late!r} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
