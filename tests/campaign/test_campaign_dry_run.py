"""Dry run: values to fill in, several runs, collections that are not public, every name that does not fit."""

import copy
import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from hyperval import cli
from hyperval.campaign import WRONG, dry_run, load_job, load_jobs, overview, read_jobs, summary
from hyperval.errors import UsageError
from hyperval.imagery import write_cube
from hyperval.results import Outcome, Result, ResultTable, Role
from hyperval.run import Run
from hyperval.spectra import SpectralAxis
from small_campaign import data_of, scene_data, write_yaml

CAMPAIGN, SCENARIO = data_of("lines"), data_of("lines_scenario")


@pytest.fixture
def places(tmp_path, no_data, monkeypatch) -> Path:
    """A campaign folder with an empty data folder; returns the campaign file."""
    (tmp_path / "data").mkdir()
    monkeypatch.setenv("HYPERVAL_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("HYPERVAL_WORKERS", "1")  # starting processes takes longer than these tests
    return written(tmp_path, CAMPAIGN, SCENARIO)


def written(tmp_path: Path, campaign: dict, scenario: dict) -> Path:
    (path := tmp_path / "campaign.yaml").write_text(yaml.safe_dump(campaign, sort_keys=False))
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(scenario, sort_keys=False))
    return path


def complete(tmp_path: Path) -> Path:
    """The campaign with its values, and all its files."""
    campaign = copy.deepcopy(CAMPAIGN)
    campaign["collection"]["regions"] = [{"name": n, "rectangle": [i, 0, 1, 4]} for i, n in enumerate("ab")]
    campaign["collection"]["cube"]["scale"] = 0.001
    scenario = copy.deepcopy(SCENARIO)
    scenario["scene"]["classes"] = [
        {"name": n, "fraction": f, "spectrum": {"builtin": "grass"}} for n, f in (("a", 0.75), ("b", 0.25))
    ]
    lines = tmp_path / "data" / "share2012" / "lines"
    lines.mkdir(parents=True)
    for run in campaign["runs"]:
        axis = SpectralAxis(np.array([450.0, 550.0]), np.full(2, 10.0))
        write_cube(lines / f"{run['line']}_rad.dat", np.ones((3, 4, 2)), data_type=4, axis=axis)
    return written(tmp_path, campaign, scenario)


def test_everything_that_is_lacking_is_listed_and_once_where_runs_share_it(places, tmp_path, capsys):
    items = [i for i in dry_run([places]) if i.campaign == "line-0920-1638"]
    assert [(i.kind, i.state, i.what) for i in items] == [
        ("file", "missing", "data:share2012/lines/0920-1638_rad.dat"),
        ("file", "missing", "rois.geojson"),
        ("file", "found", "scenario.yaml"),
        ("value", "to fill in", "collection.cube.scale"),
        ("value", "to fill in", "scene.classes.0.fraction"),
        ("comparison", "planned", "radiance median_abs_difference_ratio_windows of a"),
        ("comparison", "planned", "radiance median_abs_difference_ratio_windows of b"),
    ]
    assert {i.detail for i in items} >= {f"scale of the radiance ({places}:12)", "at most 0.1, acceptance criterion"}
    said = summary(items)
    assert said[0] == "line-0920-1638: 2 files missing, 2 values to fill in"
    assert summary(dry_run([places]))[0] == "line-{line} (2 campaigns): 2 files missing, 2 values to fill in"
    assert "held by Rochester Institute of Technology" in said[1]
    rows = overview(dry_run([places]))
    assert {i.campaign for i in rows} == {"2 campaigns, line-{line}"}
    assert [(i.state, i.what) for i in rows] == [
        ("missing", "data:share2012/lines/{line}_rad.dat"),
        ("missing", "rois.geojson"),
        ("found", "scenario.yaml"),
        ("to fill in", "collection.cube.scale"),
        ("to fill in", "scene.classes.0.fraction"),
        ("planned", "comparisons: 2, of which acceptance criteria: 2"),
    ]
    assert cli.run(["validate", "--dry-run", str(places)]) == 3
    assert capsys.readouterr().out.splitlines()[0].split("\t") == ["campaign", "kind", "state", "what", "detail"]
    # What one run alone lacks stands under its own name, with its own words.
    complete(tmp_path)
    (tmp_path / "data/share2012/lines/0920-1638_rad.dat").unlink()
    (tmp_path / "data/share2012/lines/0920-1631_rad.hdr").unlink()
    assert [(i.campaign, i.what) for i in overview(dry_run([places])) if i.is_blocking] == [
        ("line-0920-1631", "data:share2012/lines/0920-1631_rad.dat.hdr"),
        ("line-0920-1638", "data:share2012/lines/0920-1638_rad.dat"),
    ]
    assert cli.run(["-q", "validate", str(places), "-o", str(tmp_path / "out")]) == 3
    skipped = [r for r in Run.open(tmp_path / "out").table if r.campaign == "line-0920-1638"]
    assert {r.outcome for r in skipped} == {"skipped"}
    assert "held by Rochester" in skipped[0].reason


def test_what_is_complete_is_ready_and_nothing_is_written(places, tmp_path, capsys):
    path = complete(tmp_path)
    before = sorted(p.name for p in tmp_path.rglob("*"))
    assert cli.run(["validate", "--dry-run", str(path)]) == 0
    assert "line-{line} (2 campaigns): ready" in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.rglob("*")) == before
    assert read_jobs(path)[1].words == {"line": "0920-1638"}
    with pytest.raises(UsageError, match="holds 2 runs"):
        load_job(path)


def test_what_a_finished_run_left_inconclusive_is_told(small, tmp_path, capsys):
    decides = {"role": Role.GATE, "outcome": Outcome.UNDECIDED, "reason": "it takes sunlight to 1 %"}
    rows = [Result(name, "radiance", "field", "sixs", "bias_ratio", **decides) for name in ("small", "another")]
    Run(ResultTable(rows)).write(tmp_path, "")
    assert cli.run(["validate", "--dry-run", str(small.write()), "-o", str(tmp_path)]) == 0
    told = f"inconclusive\tradiance field sixs bias_ratio\tin {tmp_path}: it takes sunlight to 1 %"
    assert capsys.readouterr().out.count(told) == 1


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("campaign", "scale: 0.001", "scale: -1", r"campaign\.yaml:12: collection\.cube\.scale.*greater than 0"),
        ("scenario", "0.75", "0.25", r"scenario\.yaml.*sum to 0\.5"),
        ("campaign", "title:", "titel:", r"titel: unknown key; did you mean 'title'"),
        ("campaign", "line: 0920-1638", "lime: a", "other words than the first"),
        ("campaign", "line: 0920-1638", "line: 5", "the run has line"),
        ("campaign", "name: line-{line}", "name: line", "two campaigns are named 'line'"),
    ],
)
def test_mistakes_in_what_is_read_are_named(places, tmp_path, name, old, new, words):
    path = complete(tmp_path)
    file = path.with_name(f"{name}.yaml")
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(UsageError, match=words):
        (load_jobs if "two campaigns" in words else lambda p: dry_run([p]))(path)


@pytest.mark.parametrize("runs", [[], "a", [{}], ["a"], [{"line": str(i)} for i in range(101)]])
def test_runs_that_are_none(places, tmp_path, runs):
    with pytest.raises(UsageError, match="not a list of runs"):
        read_jobs(written(tmp_path, {**CAMPAIGN, "runs": runs}, SCENARIO))


def test_a_collection_of_others_waits_until_a_file_of_it_is_there(places, tmp_path, capsys):
    assert cli.run(["-q", "validate", str(places), "-o", str(tmp_path / "out")]) == 5  # nothing was checked
    rows = list(Run.open(tmp_path / "out").table)
    assert {r.outcome for r in rows} == {"skipped"}
    assert "2 values are to be filled in then" in rows[0].reason
    capsys.readouterr()
    file = tmp_path / "data/share2012/lines/0920-1631_rad.dat"
    file.parent.mkdir(parents=True)
    file.write_bytes(b"1")
    assert cli.run(["-q", "validate", str(places), "-o", str(tmp_path / "new")]) == 2
    said = capsys.readouterr().err
    assert "2 values are still to be filled in" in said
    assert f"{places}:12: collection.cube.scale: scale of the radiance" in said
    assert not (tmp_path / "new").exists()
    # A public or local collection never waits.
    places.write_text(places.read_text().replace("data:share2012/lines/{line}_rad.dat", "cube.dat"))
    with pytest.raises(UsageError, match="2 values are still to be filled in"):
        load_jobs(places)


@pytest.mark.parametrize("held", [True, False])
def test_a_mistyped_name_is_a_mistake_and_not_a_missing_set(small, tmp_path, no_data, held):
    """Whether the data are at hand or not: what the registry cannot know is refused before anything runs."""
    if held:
        (tmp_path / "hysu/published/svc").mkdir(parents=True)
        (tmp_path / "hysu/published/svc/DLR_HySU_SVC.lib").write_bytes(b"x")
    small.scenario["scene"]["panels"][0]["spectrum"] = {"file": "data:hysu/published/svc/DLR_HySU_SCV.lib"}
    path = small.write()
    with pytest.raises(UsageError, match="no such file in any registered data set") as caught:
        load_jobs(path)
    assert caught.value.exit_code == 2
    assert "data:hysu/published/svc/DLR_HySU_SVC.lib" in caught.value.expected
    assert "campaign.yaml: scenarios.scene.panels.spectrum.file" in caught.value.where
    (item,) = [i for i in dry_run([path]) if "SCV" in i.what]
    assert "perhaps data:hysu/published/svc/DLR_HySU_SVC.lib" in item.detail


def mistakes(path: Path) -> list[tuple[str, str]]:
    return [(i.what, i.detail) for i in dry_run([path]) if i.state == WRONG]


NAMES = data_of("names_that_do_not_fit")


@pytest.mark.parametrize("key", NAMES)
def test_a_name_that_does_not_fit_is_told_with_its_line(small, key):
    value, words = NAMES[key]
    *inside, last = [int(part) if part.isdigit() else part for part in key.split(".")]
    at = small.data
    for part in inside:
        at = at[part]
    if isinstance(last, int) and last == len(at):
        at.append(value)
    else:
        at[last] = value
    path = small.write()
    ((where, what),) = [m for m in mistakes(path) if words in m[1]]
    file, line = where.split(": ")[0].rsplit(":", 1)
    assert file == str(path)
    named = [part for part in where.split(": ")[1].split(".") if not part.isdigit()]
    text = path.read_text().splitlines()[int(line) - 1]
    assert f"{named[-1]}:" in text or text.lstrip().startswith("- ")
    assert what


def test_what_the_files_of_a_collection_lack_stands_at_the_key_that_needs_it(small, capsys):
    small.data["scenarios"][0]["sensor"] = (small.folder / "sensor.yaml").rename(small.folder / "MINE.YAML").name
    assert summary(dry_run([small.write()])) == ["small: ready"]
    small.edit("targets.csv", lambda text: text.replace("39.5,3.5", "39.5,9000.5", 1))
    ((where, what),) = mistakes(small.write())  # and none that follows from it
    assert where.endswith(": collection.targets")
    assert "targets.csv" in what
    small.edit("targets.csv", lambda text: text.replace("39.5,9000.5", "39.5,3.5", 1))
    small.edit("small_rad.hdr", lambda t: re.sub(r"(?m)^(map info|coordinate system string) = .*\n", "", t))
    found = {where.split(": ")[1]: what for where, what in mistakes(small.write())}
    assert "ground area of a pixel" in found["detection.areas"]
    assert cli.run(["validate", "--dry-run", str(small.write())]) == 2
    assert f"small: {len(found)} unknown names" in capsys.readouterr().err


def test_names_of_a_simulated_collection_are_those_of_its_scene(small):
    write_yaml(small.folder / "scene.yaml", scene_data())
    small.data["collection"] |= {"simulate": "scene.yaml", "leave_out": ["white-pannel"]}
    small.data["comparisons"][0] |= {"product": "radiance", "subjects": ["all subjects", "unseen subjects"]}
    small.data = json.loads(json.dumps(small.data).replace("collection/", "simulated:"))
    small.data["collection"]["empirical_line"]["panels"][1]["spectrum"]["record"] = "black"
    (region_name, names), (line, record) = sorted(mistakes(small.write()))
    assert line.endswith("collection.empirical_line.panels.1.spectrum")
    assert "no spectrum 'black'; expected: one of white-panel, black-panel" in record
    assert region_name.endswith("collection.leave_out.0")
    assert "one of white-panel, black-panel" in names


def test_warnings_of_a_run_stand_on_the_console_and_beside_its_results(small, tmp_path, capsys):
    panels = small.data["collection"]["empirical_line"]["panels"]
    for entry in panels:
        entry["relative_uncertainty"] = 0.01
    panels[2]["spectrum"] = {"constant": 0.6}  # grey, and not as bright as is said
    cli.run(["observe", str(small.write()), "-o", str(tmp_path / "out")])
    assert "small: warning: the panels of the empirical line do not lie on one line" in capsys.readouterr().err
    record = json.loads((tmp_path / "out/provenance.json").read_text())
    assert any("do not lie on one line" in w for w in record["warnings"])
