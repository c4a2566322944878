"""Accepted numbers: their files, and hyperval check and baseline accept from end to end."""

import math
import re
import shlex
import shutil
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hyperval import baseline, cli
from hyperval.baseline import Accepted, accept, accepted_numbers, campaign_metrics, check, compare, load_baseline
from hyperval.errors import UsageError
from hyperval.metrics import Tolerance, default_tolerance
from hyperval.model import clopper_pearson
from hyperval.results import Outcome, Result, split_key
from hyperval.run import read_rows
from small_campaign import data_of, sensor_data, stand_in_atmosphere, write_yaml

# Baseline files: written to be read by people, refused when their tolerances mean nothing.


MEDIAN = "median_difference_ratio_windows"
KEY = f"radiance | white panel | sixs | {MEDIAN}"
PD = "roc | planks | cem/pixel | pd_predicted@1e-2"
HEAD = 'schema: 1\nkind: campaign\nname: mine\nreason: "because"\ndate: "2026-01-02"\nversions: {hyperval: "0"}\n'
LINE = "{accepted: 0.5, tolerance: 0.001, of: unit}"


def written(folder: Path, line: str = LINE, key: str = KEY) -> Path:
    path = folder / "mine.yaml"
    path.write_text(f'{HEAD}metrics:\n  "{key}": {line}\n')
    return path


def measured(value: float, half: float = math.nan, key: str = KEY, **more) -> dict[str, Result]:
    return {key: Result("", *split_key(key), value, lower=value - half, upper=value + half, **more)}


def number(value: float, key: str = KEY, half: float = math.nan, **more) -> Accepted:
    return accepted_numbers(measured(value, half, key, **more), {})[key]


@pytest.mark.parametrize(("old", "new", "message"), data_of("baseline_mistakes"))
def test_what_means_nothing_is_refused(tmp_path, old, new, message):
    path = written(tmp_path)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(UsageError, match=message):
        load_baseline(path)


def test_a_tolerance_that_can_never_fail_is_refused(tmp_path):
    line = '{accepted: 0.5, tolerance: 1.0, of: value, why: "noisy"}'
    with pytest.raises(UsageError, match=r"lies between 0 and 1.*can never fail"):
        load_baseline(written(tmp_path, line, PD))
    assert load_baseline(written(tmp_path, line.replace("1.0, of", "0.5, of"), PD)).metrics[PD].width == 0.25
    loose = '{accepted: 0.5, tolerance: 0.01, of: unit, why: "a random forest"}'
    assert load_baseline(written(tmp_path, loose)).metrics[KEY].width == 0.01
    assert load_baseline(written(tmp_path, LINE)).metrics[KEY].width == 0.001  # a tight one needs no words


def test_names_of_numbers_and_files_of_something_else(tmp_path, capsys):
    (tmp_path / "sensors").mkdir()
    written(tmp_path).rename(tmp_path / "sensors" / "casi-1500.yaml")
    assert cli.run(["check", "--sensors", "casi-1500", "--baselines", str(tmp_path)]) == 2
    assert "is the baseline of campaign 'mine'" in capsys.readouterr().err


@given(st.floats(1e-30, 1e30), st.sampled_from((-1.0, 1.0)))
def test_rounding_alone_never_trips_a_check(value, sign):
    # The tightest tolerance there is: 0, of the unit.
    key = "bands | all | sensor | band_count"
    now = measured(sign * value, key=key)
    accepted = accepted_numbers(now, {})
    assert accepted[key].tolerance == 0.0
    assert [row.reason for row in compare("it", accepted, now)] == [""]


@pytest.mark.parametrize(("metric", "half", "tolerance", "of"), data_of("default_tolerances"))
def test_defaults(metric, half, tolerance, of):
    assert default_tolerance(metric, half) == Tolerance(tolerance, of)


def test_one_count_more_or_less_is_tolerated():
    # An exact interval is narrowest, about 3.7 / n, where none or all were counted.
    for n, hits in ((5, 0), (5, 2), (80, 1), (80, 40), (1000, 0), (1000, 1), (1000, 1000)):
        low, high = clopper_pearson(hits, n)
        half = float(high - low) / 2
        assert default_tolerance("pd_measured@1e-2", half).width(hits / n, half) > 1.0 / n


def row(metric: str, value: float = 0.1, outcome: Outcome = Outcome.NONE, subject: str = "s", **more) -> Result:
    named = {"product": "roc", "method": "cem/pixel", **more}
    return Result("c", subject=subject, metric=metric, value=value, outcome=outcome, **named)


def test_what_a_baseline_keeps_of_a_campaign():
    """What is planned, and of its subjects and methods what stands behind it; the worst of several outcomes."""
    rows = [
        row("pd_inside_interval@1e-2_fraction", 1.0, Outcome.AGREES, "near *, far *"),
        row("pd_predicted@1e-2", subject="near 1"),
        row("pd_predicted@1e-2", subject="elsewhere"),
        row("pd_predicted@1e-2", subject="near 1", method="ace/pixel"),
        row("pd_difference@1e-2", subject="near 1"),
        row("auc", outcome=Outcome.UNDECIDED),
        row("partial_auc_measured", reason="would pass; informs only: so"),
        row("difference_ratio", 0.1, Outcome.AGREES, band_nm=500.0),
        row("pd", 0.3, Outcome.AGREES),
        row("pd", 0.3, Outcome.SKIPPED),
    ]
    found = campaign_metrics(rows)
    assert sorted(split_key(k)[1:] for k in found) == [
        ("near *, far *", "cem/pixel", "pd_inside_interval@1e-2_fraction"),
        ("near 1", "cem/pixel", "pd_predicted@1e-2"),
        ("s", "cem/pixel", "auc"),
        ("s", "cem/pixel", "pd"),
    ]
    assert found["roc | s | cem/pixel | pd"].outcome is Outcome.SKIPPED


@pytest.mark.parametrize(
    ("accepted", "now", "words"),
    [
        (number(0.1), measured(0.1005), ""),
        (number(0.1), measured(0.103), r"moved from 0\.1 to 0\.103: \+0\.003, tolerance 0\.002"),
        (number(0.1), measured(math.nan), "moved from 0.1 to no value"),
        (number(0.1), measured(math.inf), "moved from 0.1 to no value"),
        (number(math.nan), measured(0.1), "moved from no value to 0.1"),
        (number(math.nan), measured(math.nan), ""),
        (number(0.1), None, r"missing: the run does not give this number \(accepted 0\.1\)"),
        (None, measured(0.1), "not accepted"),
        (number(0.1, outcome=Outcome.AGREES), measured(0.1, outcome=Outcome.DISAGREES, reason="too large"),
         r"the outcome changed from agrees to disagrees \(too large\)"),
        (number(0.1, outcome=Outcome.AGREES), measured(0.1), "the outcome changed from agrees to none"),
    ],
)  # fmt: skip
def test_what_fails_and_the_limit_that_was_crossed(accepted, now, words):
    (found,) = compare("it", {KEY: accepted} if accepted else {}, now or {})
    assert found.outcome is (Outcome.DISAGREES if words else Outcome.AGREES)
    assert re.search(words, found.reason)
    assert bool(found.reason) == bool(words)
    assert found.subject == "white panel"
    if accepted and accepted.accepted is not None:
        assert (found.limit_low, found.limit_high) == pytest.approx((0.098, 0.102))


def test_tolerances_are_kept_and_lost_intervals_fall_back():
    tight = Accepted(accepted=0.5, tolerance=0.0001, of="unit")
    assert accepted_numbers(measured(0.6), {KEY: tight})[KEY].tolerance == 0.0001
    key = "scores | x | cem | score_mean_difference"
    before = {key: number(0.5, key, 0.2)}
    assert before[key].of == "interval"
    assert accepted_numbers(measured(0.5, key=key), before)[key].of == "value"


# hyperval check and hyperval baseline accept, from end to end on the small campaign and a sensor.


@pytest.fixture
def place(tmp_path, monkeypatch) -> Path:
    """An empty folder to work in, so that validation/baselines is there."""
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    return tmp_path / "work"


@pytest.fixture(scope="module")
def run_once(tmp_path_factory) -> Path:
    """Where the run of the small campaign stands that all tests copy; empty until the first asks for it."""
    return tmp_path_factory.mktemp("run") / "finished"


@pytest.fixture
def finished(small, run_once, tmp_path) -> Path:
    """Folder of a finished run of the small campaign."""
    path = small.write()
    if not run_once.exists():
        assert cli.run(["-q", "validate", str(path), "-o", str(run_once)]) == 0
    return Path(shutil.copytree(run_once, tmp_path / "finished"))


def failures(junit: Path) -> dict[str, str]:
    """Name of each failed test case and its message."""
    cases = ElementTree.fromstring(junit.read_bytes()).iter("testcase")  # noqa: S314 - written by the check
    return {c.attrib["name"]: c[0].attrib["message"] for c in cases if len(c) and c[0].tag == "failure"}


def test_no_baseline_then_accepted_then_moved(small, finished, place, capsys, monkeypatch):
    campaign = str(small.folder / "campaign.yaml")
    given = [campaign, "--from", str(finished)]
    file = place / "validation/baselines/small.yaml"
    candidate = file.with_suffix(".candidate.yaml")

    assert cli.run(["check", *given, "--junit", "no.xml"]) == 1
    said = capsys.readouterr().err
    assert "no baseline" in said
    assert f'to make them one: hyperval baseline accept {campaign} --reason "..."' in said
    assert [*failures(place / "no.xml")] == ["small campaign baseline"]
    assert candidate.is_file()
    assert not file.exists()
    for without in ([], ["--reason", " \n"]):
        assert cli.run(["baseline", "accept", *given, *without]) == 2
        assert "--reason" in capsys.readouterr().err
    assert not file.exists()
    assert cli.run(["baseline", "accept", *given, "--reason", "First numbers"]) == 0
    said = capsys.readouterr()
    assert "Science changes" in said.err
    assert len(said.out.splitlines()) > 20
    assert not candidate.exists()
    first = file.read_bytes()

    assert cli.run(["check", *given, "--junit", "ok.xml"]) == 0
    assert failures(place / "ok.xml") == {}
    assert len(capsys.readouterr().out.splitlines()) == 1  # nothing moved: the header alone
    assert cli.run(["check", *given, "--all"]) == 0
    assert len(capsys.readouterr().out.splitlines()) > 20
    assert cli.run(["baseline", "accept", *given, "--reason", "Again"]) == 0
    assert file.read_bytes() == first  # nothing changed: reason and date stay

    held = yaml.safe_load(first)
    moved, new, gone = sorted(held["metrics"])[:3]
    held["metrics"][moved]["accepted"] += 0.5
    held["metrics"]["radiance | nowhere | sixs | z"] = held["metrics"].pop(gone)
    del held["metrics"][new]
    write_yaml(file, held)
    assert cli.run(["check", *given, "--junit", "moved.xml", "-o", "out"]) == 1
    messages = failures(place / "moved.xml")
    assert len(messages) == 4
    names = {key: " ".join(key.split(" | ")[1:]) for key in (moved, new, gone)}
    assert f"{moved.split(' | ')[-1]} moved from " in messages[names[moved]]
    assert "not accepted" in messages[names[new]]
    assert "not accepted" in messages[names[gone]]
    assert "missing" in messages["nowhere sixs z"]
    said = capsys.readouterr()
    assert (said.out + said.err).count(messages[names[moved]].split(" (")[0]) == 1
    assert len(said.out.splitlines()) == 2 + 4, "two headers (the acceptance before has one), and failures alone"
    assert "likely cause: the code, the campaign's files or its data" in said.err
    assert f'if the change is meant: hyperval baseline accept {campaign} --reason "..."' in said.err
    rows = list(read_rows(place / "out"))
    assert sum(r.outcome is Outcome.DISAGREES for r in rows) == 4
    for page in ("out/report.html", "out/small/report.html"):
        text = (place / page).read_text()
        assert f"4 of {len(rows)} numbers are not as accepted." in text
        # What is set beside accepted numbers is no verdict about the model.
        assert not re.search("acceptance criteria are|Model and collection", text)
    assert (place / "out/junit.xml").read_bytes() == (place / "moved.xml").read_bytes()

    assert cli.run(["baseline", "accept", *given, "--reason", "Mended"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1 + 4  # the diff, and nothing but it
    assert cli.run(["check", *given]) == 0
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    for name in ("one", "two"):
        accept([small.folder / "campaign.yaml"], reason="First", baselines=place / name, source=finished)
    assert (place / "one/small.yaml").read_bytes() == (place / "two/small.yaml").read_bytes()
    assert 'date: "1970-01-01"' in (place / "one/small.yaml").read_text()


def test_a_check_runs_the_campaign_itself_and_keeps_the_run(small, place):
    path = small.write()
    accept([path], reason="First", baselines=place / "b")
    assert baseline.joined_rows(check([path], baselines=place / "b", output=place / "out")).exit_code() == 0
    assert baseline.joined_rows(check([path], baselines=place / "b", source=place / "out")).exit_code() == 0  # out/runs
    small.scenario["atmosphere"] = {**small.scenario["atmosphere"], "aot550": 0.21}
    wrong = baseline.joined_rows(check([small.write()], baselines=place / "b")).where(outcome=Outcome.DISAGREES)
    assert "radiance" in {row.product for row in wrong}
    assert all("moved from" in row.reason or "verdict" in row.reason for row in wrong)


def test_a_run_with_an_error_is_no_baseline(small, place, capsys):
    small.gate("radiance")["subjects"] = ["nowhere"]
    given = [str(small.write()), "--from", "run"]
    assert cli.run(["-q", "validate", given[0], "-o", "run"]) == 1
    assert cli.run(["-q", "baseline", "accept", *given, "--reason", "Anyway"]) == 2
    assert "cannot become a baseline" in capsys.readouterr().err
    read = ["check", *given], ["figures", "run"], ["compare", "run", "run"]  # whose results they would replace
    assert [cli.run(["-q", *words, "-o", "run"]) for words in read] == [2, 2, 2]
    assert (cli.run(["-q", "check", *given]), [*place.rglob("*.yaml")]) == (1, [])
    assert "this run cannot become one" in capsys.readouterr().err
    small.data["collection"]["calibration"] = {"file": str(place / "run" / "results.csv")}
    for command in ("validate", "observe", "check", "benchmark"):
        assert cli.run(["-q", command, str(small.write()), "-o", "run"]) == 2
        assert "holds what this command reads" in capsys.readouterr().err


def test_a_finished_run_of_other_files_or_another_source_is_refused(small, finished, place, capsys):
    small.data["title"] = "Another title"
    assert cli.run(["check", str(small.write()), "--from", str(finished)]) == 2
    assert "was made with other files, another program" in capsys.readouterr().err
    small.data["name"] = "other"
    assert cli.run(["check", str(small.write()), "--from", str(finished)]) == 3
    assert "no run of campaign 'other'" in capsys.readouterr().err
    assert cli.run(["check", str(small.write()), "--from", "nowhere"]) == 3
    small.data |= {"title": "A small campaign", "name": "small"}
    record = finished / "provenance.json"
    for added, code in (("", 1), (" ", 2)):
        record.write_text(record.read_text() + added)
        assert cli.run(["check", str(small.write()), "--from", str(finished)]) == code


def test_lacking_data_are_skipped(small, place, no_data, capsys):
    path = str(small.of_a_data_set().write())
    assert cli.run(["check", path, "--junit", "skipped.xml"]) == 5
    assert "hyperval data fetch hysu" in capsys.readouterr().err
    assert 'failures="0" errors="0" skipped="1"' in Path("skipped.xml").read_text()
    assert cli.run(["baseline", "accept", path, "--reason", "First"]) == 5


def test_a_finished_run_of_a_campaign_that_waits_for_its_collection_is_read(tmp_path, no_data, capsys):
    """Its values are still to be filled in, and its file holds several runs."""
    template = str(Path(__file__).parents[2] / "campaigns" / "radcalnet-sensor" / "campaign.yaml")
    assert cli.run(["-q", "validate", template, "-o", str(tmp_path / "out")]) == 5
    assert cli.run(["check", template, "--from", str(tmp_path / "out")]) == 5
    assert "skipped: radcalnet-sensor is not on this machine" in capsys.readouterr().err


def test_a_sensor_of_ones_own(place, tmp_path, own_atmosphere, monkeypatch):
    monkeypatch.setattr("hyperval.sensor_check.suite.atmospheric_terms", stand_in_atmosphere)
    data, folder = sensor_data(), place / "b"
    file = str(write_yaml(tmp_path / "mine.yaml", data))
    (done,) = accept([], [file], reason="First", baselines=folder)
    assert (done.owner, bool(done.changes)) == ("sensor small-sensor", True)
    assert (folder / "sensors/small-sensor.yaml").is_file()
    (done,) = check([], [file], baselines=folder, output=tmp_path / "out")
    assert done.rows.exit_code() == 0
    assert re.search("(?s)Accepted numbers: 1 run<.*<h2>Sensors<", (tmp_path / "out/report.html").read_text())
    told = shlex.split(done.accept_command(folder))  # the command that is printed names the file
    assert told[told.index("--sensors") + 1] == file
    data["measured_noise"]["table"][0][1] *= 1.01
    write_yaml(tmp_path / "mine.yaml", data)
    wrong = check([], [file], baselines=folder)[0].rows.where(outcome=Outcome.DISAGREES)
    moved = {row.metric for row in wrong}
    assert {"median_snr", "median_electrons_per_radiance", "median_noise_shot"} <= moved
    assert not any("SWIR2" in row.subject for row in wrong)  # its noise stands in another row of the table


def test_nothing_named_and_a_mistyped_folder(place, capsys):
    assert cli.run(["check"]) == 2
    assert "nothing to run" in capsys.readouterr().err
    assert cli.run(["check", "--sensors", "no-such-sensor"]) == 2
    assert cli.run(["check", "--sensors", "casi-1500", "--baselines", "validation/baseline"]) == 2
    assert "no such folder" in capsys.readouterr().err
    assert list(place.iterdir()) == []
