"""The command line: exit codes, streams, bars of progress, and that each command calls its function."""

import json
import os
import re
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

import hyperval
from hyperval import cli
from hyperval.errors import EngineError, InputError, MissingDataError, UsageError, internal_error
from hyperval.progress import bars, step, track, watch_lines, working
from hyperval.results import Outcome, Result, Role
from hyperval.run import results_json

# The command line: exit codes, streams, and that each command calls its function.


pytestmark = pytest.mark.usefixtures("no_data")


@pytest.fixture
def calls(monkeypatch) -> dict[str, object]:
    """Stand-ins for the rooms behind the commands: they give, or raise, `result`."""
    record: dict[str, object] = {"result": 0}

    def stand_in(*args: object, **options: object) -> object:
        if isinstance(record["result"], BaseException):
            raise record["result"]
        return record["result"]

    for name in ("predict_to_folder", "observe", "validate"):
        monkeypatch.setattr(f"hyperval.campaign.{name}", stand_in)
    return record


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (UsageError("bad key", where="c.yaml:3"), 2),
        (InputError("cut short", where="cube.img"), 3),
        (MissingDataError("not here", where="data:x", mend="hyperval data fetch x"), 3),
        (EngineError("6S is missing"), 3),
        (KeyboardInterrupt(), 130),
        (ValueError("a bug"), 4),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, BaseException) else str(value),
)
def test_each_error_has_its_exit_code_and_no_traceback(calls, capsys, error, code):
    calls["result"] = error
    assert cli.run(["observe", "c.yaml", "-o", "out"]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("hyperval: ")
    assert "Traceback" not in err


def test_a_full_disk_is_called_so_without_a_log(calls, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    calls["result"] = OSError(28, "No space left on device", "out/products.nc")
    assert cli.run(["predict", "panels", "-o", "out"]) == 4
    err = capsys.readouterr().err
    assert err.startswith("hyperval: [Errno 28] No space left on device: 'out/products.nc'\n  to fix it: free space")
    assert list(tmp_path.iterdir()) == []


def test_internal_error_says_where_its_traceback_is(calls, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    calls["result"] = ZeroDivisionError("a bug")
    assert cli.run(["observe", "c.yaml", "-o", "out"]) == 4
    (line,) = capsys.readouterr().err.splitlines()
    named = re.search(r"traceback in (\S+\.log)", line)
    assert named is not None
    assert "Traceback" in Path(named[1]).read_text()
    assert "ZeroDivisionError: a bug" in Path(named[1]).read_text()


@pytest.mark.parametrize("error", [ZeroDivisionError("a bug"), UsageError("bad key")])
def test_debug_shows_the_traceback(calls, capsys, error):
    calls["result"] = error
    assert cli.run(["--debug", "observe", "c.yaml", "-o", "out"]) == (4 if isinstance(error, ArithmeticError) else 2)
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        [], ["bogus"], ["validate"], ["validate", "a.yaml"], ["validate", "-o", "out"],
        ["observe", "a", "b", "-o", "x"], ["--bogus"], ["data"], ["data", "fetch"], ["data", "fetch", "bogus"],
        ["sensor", "show"], ["sensor", "show", "bogus"], ["--data-dir", "/nowhere/at/all", "data", "list"],
    ],
    ids=" ".join,
)  # fmt: skip
def test_wrong_usage_is_exit_code_2(arguments, capsys):
    assert cli.run(arguments) == 2
    out, err = capsys.readouterr()
    assert "Traceback" not in err
    assert (f"{out}{err}".split(" ")[0], "Options:" in err) == ("hyperval:" if err else "Usage:", False)


@pytest.mark.parametrize("arguments", [["--help"], ["data", "-h"], ["--version"]])
def test_help_and_version_go_to_standard_output(arguments, capsys):
    assert cli.run(arguments) == 0
    out, err = capsys.readouterr()
    assert (out.startswith(("Usage: hyperval", f"hyperval {hyperval.__version__}\n")), err) == (True, "")


def test_notes_go_to_standard_error_and_quiet_leaves_them_out(calls, capsys):
    cli.run(["observe", "c.yaml", "-o", "out"])
    assert capsys.readouterr() == ("", "results in out\n")
    cli.run(["--quiet", "observe", "c.yaml", "-o", "out"])
    assert capsys.readouterr() == ("", "")
    cli.run(["observe", "c.yaml", "-o", "out"])
    assert capsys.readouterr().err != "", "the options of one run do not reach the next"


def test_validate_says_the_verdict_of_each_campaign_and_errors_even_when_quiet(calls, capsys, tmp_path):
    verdicts = {
        "one": (Outcome.AGREES, ""), "two": (Outcome.ERROR, "turf.txt: no such file"),
        "three": (Outcome.SKIPPED, "sees 3 pixels"), "four": (Outcome.SKIPPED, "sees 4 pixels"),
    }  # fmt: skip
    rows = [
        Result(name, "radiance", "lawn", "sixs", "z", value=0.1, role=Role.GATE, outcome=outcome, reason=reason)
        for name, (outcome, reason) in verdicts.items()
    ]
    (tmp_path / "results.json").write_text(results_json(rows), "utf-8")
    cli.run(["validate", "a.yaml", "-o", str(tmp_path)])
    out, err = capsys.readouterr()
    assert (out, "three: Not run" in err) == ("", False)
    assert "one: Met. 1 acceptance criterion is met (" in err
    assert "two: Ended in an error: no acceptance criterion was evaluated." in err
    assert err.endswith("acceptance criteria: 1 error, 2 not run, 1 met\n")
    assert "two: error: turf.txt: no such file\n" in err
    assert "\nthree, four: skipped: sees 3 pixels (and 1 more like it)\n" in err
    cli.run(["-q", "validate", "a.yaml", "-o", str(tmp_path)])
    assert capsys.readouterr() == ("", "two: error: turf.txt: no such file\n")


def test_data_list_is_tab_separated_for_programs(capsys):
    assert cli.run(["data", "list"]) == 0
    header, *rows = [line.split("\t") for line in capsys.readouterr().out.splitlines()]
    assert header[0] == "name"
    assert {"hysu", "pasadena"} <= {row[0] for row in rows}
    assert {len(row) for row in rows} == {len(header)}


def test_data_dir_option_is_a_local_copy(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HYPERVAL_DATA", "")
    place = tmp_path / "copy"
    (place / "hysu/published/full").mkdir(parents=True)
    (place / "hysu/published/full/DLR_HySU_HS_full.hdr").write_text("not the real one")
    assert cli.run(["--data-dir", str(place), "data", "verify", "hysu"]) == 3
    said = capsys.readouterr().out
    assert "DLR_HySU_HS_full.hdr\tdiffers" in said
    assert "\tmissing\n" in said


def test_sensors_are_listed_and_shown(capsys):
    assert cli.run(["sensor", "list"]) == 0
    names = [line.split("\t")[0] for line in capsys.readouterr().out.splitlines()[1:]]
    assert "prospectir-vs" in names
    assert cli.run(["sensor", "show", "prospectir-vs"]) == 0
    shown = capsys.readouterr().out
    assert "name: prospectir-vs" in shown
    assert shown.count("source:") > 5, "every number stands with its source"


# The installed command, as a process.

COMMAND = [sys.executable, "-c", "from hyperval.cli import main; main()"]


def test_closed_pipe_does_not_look_like_a_failed_comparison():
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([*COMMAND, "data", "verify"], stdout=write, stderr=subprocess.PIPE, check=False)
    os.close(write)
    assert done.returncode == 141
    assert b"Traceback" not in done.stderr


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_signals_end_the_run_and_remove_what_is_half_written(tmp_path, number, code):
    script = f"""
import sys, types, time
from pathlib import Path
from hyperval.storage import whole_folder
fake = types.ModuleType("hyperval.campaign.run")
def observe(campaign, output, **options):
    with whole_folder(output) as t:
        (t / "half").write_text("x")
        print("ready", flush=True)
        time.sleep(30)
fake.observe = observe
sys.modules["hyperval.campaign.run"] = fake
sys.argv = ["hyperval", "observe", "c.yaml", "-o", {str(tmp_path / "out")!r}]
from hyperval.cli import main
main()
"""
    # A shell starts what it runs in the background with SIGINT ignored, and its children inherit that.
    heeds = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, preexec_fn=heeds
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        process.send_signal(number)
        _, err = process.communicate(timeout=20)
    assert process.returncode == code
    assert err.startswith(b"hyperval: ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("date", ["", " ", "today", "-1", "1e9", "9" * 15])
def test_an_empty_date_is_none_and_one_that_is_no_number_a_mistake_of_the_user(date, monkeypatch, capsys):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", date)
    assert cli.run(["metrics"]) == (2 if date.strip() else 0)
    assert date.strip() or "SOURCE_DATE_EPOCH" not in os.environ
    assert not date.strip() or f"SOURCE_DATE_EPOCH is {date!r}" in capsys.readouterr().err


def test_a_name_too_long_for_a_file_is_a_mistake_of_the_user(tmp_path, capsys, monkeypatch):
    def check(*args: object, **options: object) -> None:
        (tmp_path / ("n" * 300)).write_text("x")

    monkeypatch.setattr("hyperval.baseline.check", check)
    assert cli.run(["check", "--sensors", "casi-1500", "--junit", "n" * 300 + ".xml"]) == 2
    assert "name another file or folder" in capsys.readouterr().err
    assert cli.run(["sensor", "new", "x", "-o", f"{__file__}/x.yaml"]) == 2  # in what is a file
    assert cli.run(["schema", "campaign", "-o", str(tmp_path)]) == 2
    assert f"\nhyperval: {tmp_path}: Is a directory" in capsys.readouterr().err


# Words for internal errors.


def test_an_internal_error_says_where_it_arose_in_another_package_too():
    with pytest.raises(json.JSONDecodeError) as caught:
        json.loads("{")
    assert re.match(r"internal error: JSONDecodeError: .*\(at decoder\.py:", internal_error(caught.value), re.DOTALL)


# Progress says which campaign and step it belongs to, and nothing where nobody watches.


def said(capsys) -> str:
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", capsys.readouterr().err)


def test_bars_name_campaign_step_and_count(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with step("hysu", 3, 4, "compare"), bars(True):
        assert list(track([1, 2, 3], "inputs")) == [1, 2, 3]
        with working("figures"):
            pass
        assert len(list(watch_lines("scores", 10, 2)(iter([(range(1), 0), (range(1, 2), 0)])))) == 2
    words = said(capsys)
    assert "hysu 3/4 compare: inputs" in words
    assert "3/3" in words
    assert "hysu 3/4 compare: figures" in words
    assert "hysu 3/4 compare: scores" in words
    assert list(track([1], "alone", show=True)) == [1]
    assert "hysu" not in said(capsys)
    with step("hysu", 3, 4, "compare"), bars(False), bars(None), working("figures"):  # where nobody watches
        assert list(track(iter([1, 2]), "inputs")) == [1, 2]
    assert said(capsys) == ""


def test_quiet_draws_no_bars_where_somebody_watches(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    for words, is_drawn in ((["metrics"], True), (["-q", "metrics"], False), (["metrics"], True)):
        assert cli.run(words) == 0
        assert list(track([1], "inputs")) == [1]
        assert ("inputs" in said(capsys)) == is_drawn
