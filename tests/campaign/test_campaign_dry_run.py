"""Dry run, values to fill in, campaigns of several runs, and collections that are not public."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest
import yaml

from hyperval import cli
from hyperval.campaign.dry_run import dry_run, overview, summary
from hyperval.campaign.job import job_of, jobs_of, read_texts
from hyperval.campaign.one import run_campaign
from hyperval.campaign.run import validate
from hyperval.campaign.schema import campaign_runs, with_words
from hyperval.config import load_yaml, placeholders
from hyperval.errors import InputError, UsageError
from hyperval.imagery import write_cube
from hyperval.spectra import SpectralAxis

CAMPAIGN = {
    "schema": 1,
    "name": "line-{line}",
    "title": "Line {line}",
    "description": "For tests.",
    "runs": [{"line": "0920-1631"}, {"line": "0920-1638"}],
    "collection": {
        "cube": {"path": "data:share2012/lines/{line}_rad.dat", "quantity": "radiance",
                 "scale": "FILL_IN: scale of the radiance", "unit": "uW cm-2 sr-1 nm-1"},
        "regions": [{"file": "rois.geojson", "coordinates": "pixel"}],
    },
    "scenarios": ["scenario.yaml"],
    "comparisons": [
        {"product": "radiance", "subjects": ["a", "b"], "metric": "median_abs_difference_ratio_windows",
         "at_most": 0.1, "reason": "enough"}
    ],
}  # fmt: skip
SCENARIO = {
    "schema": 1,
    "name": "line-{line}",
    "scene": {"classes": [{"name": "a", "fraction": "FILL_IN: part of a", "spectrum": {"builtin": "grass"}}]},
}


@pytest.fixture
def places(tmp_path, monkeypatch) -> Path:
    """A campaign folder with an empty data folder; returns the campaign file."""
    (tmp_path / "data").mkdir()
    monkeypatch.setenv("HYPERVAL_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("HYPERVAL_WORKERS", "1")  # starting processes takes longer than these tests
    monkeypatch.setenv("HYPERVAL_CACHE", str(tmp_path / "cache"))
    return written(tmp_path)


def written(tmp_path: Path, campaign: dict | None = None, scenario: dict | None = None) -> Path:
    path = tmp_path / "campaign.yaml"
    path.write_text(yaml.safe_dump(campaign or CAMPAIGN, sort_keys=False))
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(scenario or SCENARIO, sort_keys=False))
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


def test_everything_that_is_lacking_is_listed(places):
    items = [i for i in dry_run([places]) if i.campaign == "line-0920-1638"]
    assert [(i.kind, i.state, i.what) for i in items] == [
        ("file", "missing", "data:share2012/lines/0920-1638_rad.dat"),
        ("file", "missing", "rois.geojson"),
        ("file", "found", "scenario.yaml"),
        ("value", "to fill in", "collection.cube.scale"),
        ("value", "to fill in", "scene.classes.0.fraction"),
        ("comparison", "planned", "radiance median_abs_difference_ratio_windows of a, b"),
    ]
    assert items[3].detail == f"scale of the radiance ({places}:12)"
    assert items[5].detail == "at most 0.1, acceptance criterion"
    said = summary(items)
    assert said[0] == "line-0920-1638: 2 files missing, 2 values to fill in"
    assert summary(dry_run([places]))[0] == "line-{line} (2 campaigns): 2 files missing, 2 values to fill in"
    assert "held by Rochester Institute of Technology" in said[1]


def test_the_overview_names_once_what_runs_share(places, tmp_path):
    rows = overview(dry_run([places]))
    assert [(i.campaign, i.state, i.what) for i in rows] == [
        ("2 campaigns, line-{line}", "missing", "data:share2012/lines/{line}_rad.dat"),
        ("2 campaigns, line-{line}", "missing", "rois.geojson"),
        ("2 campaigns, line-{line}", "found", "scenario.yaml"),
        ("2 campaigns, line-{line}", "to fill in", "collection.cube.scale"),
        ("2 campaigns, line-{line}", "to fill in", "scene.classes.0.fraction"),
        ("2 campaigns, line-{line}", "planned", "1 comparisons, 1 acceptance criteria"),
    ]
    # What one run alone lacks stands under its own name, with its own words.
    complete(tmp_path)
    (tmp_path / "data/share2012/lines/0920-1638_rad.dat").unlink()
    (row,) = [i for i in overview(dry_run([places])) if i.lacking]
    assert (row.campaign, row.what) == ("line-0920-1638", "data:share2012/lines/0920-1638_rad.dat")


def test_exit_codes_and_no_folder(places, tmp_path, capsys):
    assert cli.run(["validate", "--dry-run", str(places)]) == 3
    out = capsys.readouterr().out
    assert out.splitlines()[0].split("\t") == ["campaign", "kind", "state", "what", "detail"]
    path = complete(tmp_path)
    before = sorted(p.name for p in tmp_path.rglob("*"))
    assert cli.run(["validate", "--dry-run", str(path)]) == 0
    assert "line-{line} (2 campaigns): ready" in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.rglob("*")) == before  # nothing is written


def test_a_cube_without_its_header_is_not_ready(places, tmp_path):
    path = complete(tmp_path)
    (tmp_path / "data/share2012/lines/0920-1631_rad.hdr").unlink()
    (row,) = [i for i in dry_run([path]) if i.lacking]
    assert (row.campaign, row.what) == ("line-0920-1631", "data:share2012/lines/0920-1631_rad.dat.hdr")


def test_a_campaign_that_is_filled_in_wrongly_is_refused(places, tmp_path):
    path = complete(tmp_path)
    path.write_text(path.read_text().replace("scale: 0.001", "scale: -1"))
    with pytest.raises(UsageError, match=r"campaign\.yaml:12: collection\.cube\.scale.*greater than 0"):
        dry_run([path])
    path = complete_again(tmp_path)
    (tmp_path / "scenario.yaml").write_text((tmp_path / "scenario.yaml").read_text().replace("0.75", "0.25"))
    with pytest.raises(UsageError, match=r"scenario\.yaml.*sum to 0\.5"):
        dry_run([path])


def complete_again(tmp_path: Path) -> Path:
    path = tmp_path / "campaign.yaml"
    path.write_text(path.read_text().replace("scale: -1", "scale: 0.001"))
    return path


def test_mistakes_in_what_the_dry_run_reads_are_named(places):
    places.write_text(places.read_text().replace("title:", "titel:"))
    with pytest.raises(UsageError, match=r"titel: unknown key; did you mean 'title'"):
        dry_run([places])


def test_without_any_file_of_the_collection_it_is_skipped_with_who_holds_it(places, tmp_path):
    jobs = jobs_of(places)
    assert [j.campaign.name for j in jobs] == ["line-0920-1631", "line-0920-1638"]
    rows = list(run_campaign(jobs[0]).table)
    assert [(r.subject, r.outcome) for r in rows] == [("a", "skipped"), ("b", "skipped")]
    assert "held by Rochester Institute of Technology" in rows[0].reason
    assert "2 values are to be filled in then" in rows[0].reason
    assert validate([places], tmp_path / "out", show_progress=False) == 5  # nothing was checked


def test_with_a_file_of_the_collection_every_value_left_is_named(places, tmp_path):
    file = tmp_path / "data/share2012/lines/0920-1631_rad.dat"
    file.parent.mkdir(parents=True)
    file.write_bytes(b"1")
    with pytest.raises(UsageError) as caught:
        validate([places], tmp_path / "out", show_progress=False)
    assert caught.value.exit_code == 2
    assert "2 values are still to be filled in" in str(caught.value)
    assert f"{places}:12: collection.cube.scale: scale of the radiance" in str(caught.value)
    assert "scene.classes.0.fraction: part of a" in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_public_or_local_campaign_with_values_to_fill_in_is_refused(places, tmp_path):
    places.write_text(places.read_text().replace("data:share2012/lines/{line}_rad.dat", "cube.dat"))
    with pytest.raises(UsageError, match="2 values are still to be filled in"):
        jobs_of(places)
    with pytest.raises(UsageError, match="1 values are still to be filled in"):
        [text.campaign() for text in read_texts(places)]


def test_a_filled_in_campaign_whose_cube_is_missing_is_skipped(places, tmp_path):
    path = complete(tmp_path)
    (tmp_path / "data/share2012/lines/0920-1638_rad.dat").unlink()
    rows = list(run_campaign(jobs_of(path)[1], show_progress=False).table)
    assert {r.outcome for r in rows} == {"skipped"}
    assert "held by Rochester" in rows[0].reason


def test_the_words_of_a_run_reach_the_campaign_and_no_other_braces(tmp_path):
    data = {"name": "x-{line}", "group": "{name} {side_m}", "list": ["{line}{line}"], "n": 1}
    assert with_words(data, {"line": "7"}) == {"name": "x-7", "group": "{name} {side_m}", "list": ["77"], "n": 1}
    path = complete_run(tmp_path)
    first, second = [text.campaign() for text in read_texts(path)]
    assert (first.name, second.name) == ("line-0920-1631", "line-0920-1638")
    assert second.run == {"line": "0920-1638"}
    with pytest.raises(UsageError, match="holds 2 runs"):
        job_of(path)


def complete_run(tmp_path: Path) -> Path:
    (tmp_path / "data").mkdir(exist_ok=True)
    return complete(tmp_path)


@pytest.mark.parametrize(
    ("runs", "message"),
    [
        ([], "no list of runs"),
        ("a", "no list of runs"),
        ([{}], "no list of runs"),
        (["a"], "no list of runs"),
        ([{"line": 5}], "the run has line"),
        ([{"a b": "5"}], "the run has a b"),
        ([{"line": "a"}, {"lime": "b"}], "other words than the first"),
        ([{"line": "a"}] * 101, "no list of runs"),
    ],
)
def test_runs_that_are_none(runs, message):
    with pytest.raises(UsageError, match=message):
        campaign_runs({"runs": runs}, {}, "c.yaml")


def test_two_runs_of_one_name_are_refused(places, tmp_path):
    places.write_text(places.read_text().replace("name: line-{line}", "name: line", 1))
    with pytest.raises(UsageError, match="two campaigns are named 'line'"):
        validate([places], tmp_path / "out", show_progress=False)


def test_placeholders_are_found_with_their_lines(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text('a:\n  - b: 1\n  - c: "FILL_IN: the height [m]"\nd: FILL_IN\ne: "no FILL_IN"\n')
    data, lines = load_yaml(path)
    assert [(p.key, p.where, p.what) for p in placeholders(data, lines, "a.yaml")] == [
        ("a.1.c", "a.yaml:3", "the height [m]"),
        ("d", "a.yaml:4", "a value"),
    ]


def test_validate_without_a_folder_says_so(places, capsys):
    assert cli.run(["validate", str(places)]) == 2
    assert "--output" in capsys.readouterr().err


def test_a_missing_campaign_file():
    with pytest.raises(InputError, match="no such file"):
        dry_run([Path("none.yaml")])


def test_data_commands_know_the_set_that_is_not_public(places, tmp_path, capsys):
    assert cli.run(["data", "list"]) == 0
    (row,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("share2012\t")]
    assert row.split("\t")[3].startswith("held by Rochester Institute of Technology")
    assert cli.run(["data", "fetch", "share2012"]) == 3
    assert "ask the laboratory" in capsys.readouterr().err
    assert cli.run(["data", "verify", "share2012"]) == 0
    complete(tmp_path)
    assert cli.run(["data", "list"]) == 0
    assert "share2012\t-\tnot public\t4 files here" in capsys.readouterr().out
