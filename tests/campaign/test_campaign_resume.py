"""Runs of several campaigns that are killed: the next gives the same files and repeats nothing that was whole."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from itertools import product
from pathlib import Path

import pytest

from hyperval import cli
from hyperval.campaign import run as campaign_jobs
from hyperval.campaign import run as campaign_run
from hyperval.campaign.job import jobs_of
from hyperval.campaign.run import Finished
from hyperval.datasets import InputLog
from hyperval.report import RunReport
from hyperval.results import Result, ResultTable
from hyperval.run import write_table
from hyperval.storage import PARTIAL, RECORD
from small_campaign import SmallCampaign, with_stand_in_atmosphere, without_figures


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture
def two(make_small: Callable[[str], SmallCampaign]) -> list[Path]:
    first, second = make_small("one"), make_small("two")
    second.data["name"] = "other"
    return [first.write(), second.write()]


def validate(paths: list[Path], out: Path) -> int:
    return cli.run(["-q", "validate", *map(str, paths), "-o", str(out)])


def runs(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the campaigns that are run from now on."""
    names, right = [], campaign_jobs.run_campaign

    def counted(job, **options):
        names.append(job.campaign.name)
        return right(job, **options)

    monkeypatch.setattr(campaign_jobs, "run_campaign", counted)
    return names


def die(*_: object, **__: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def interrupted(paths: list[Path], out: Path) -> None:
    """Run until the second campaign is about to be run."""
    right = campaign_jobs.run_campaign

    def end_at_second(job, **options):
        if job.campaign.name == "other":
            raise KeyboardInterrupt
        return right(job, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign_jobs, "run_campaign", end_at_second)
        assert validate(paths, out) == 130


def validate_and_die(paths: list[Path], out: Path, where: str) -> None:
    """Run, and be killed in the middle."""
    run, keep, write = campaign_jobs.run_campaign, Finished.keep, campaign_jobs.write_outputs

    def half_written(report, folder):
        write(report, folder)
        if report.campaign == "other":
            (folder / "results.json").write_text("{")
            die()

    def at_second(job, right, *rest, **options):
        return die() if job.campaign.name == "other" else right(*rest, **options)

    with pytest.MonkeyPatch.context() as patch:
        with_stand_in_atmosphere(patch)
        without_figures(patch)
        if where == "in the second campaign":
            patch.setattr(campaign_jobs, "run_campaign", lambda job, **o: at_second(job, run, job, **o))
        elif where == "in the files of the second":
            patch.setattr(campaign_jobs, "write_outputs", half_written)
        elif where == "before the second is known to be whole":
            patch.setattr(Finished, "keep", lambda self, job, r: at_second(job, keep, self, job, r))
        else:
            patch.setattr(campaign_run, "write_index", die)
        validate(paths, out)


KILLED_AND_RUN_AGAIN = {
    "in the second campaign": ["other"],
    "in the files of the second": ["other"],
    "before the second is known to be whole": ["other"],
    "on the page of both": [],
}


def killed_at_each(folder: Path, paths: list[Path]) -> None:
    """A run for each place at which it is killed, as copies of this process; their outputs are numbered folders."""
    for number, where in enumerate(KILLED_AND_RUN_AGAIN):
        child = os.fork()
        if child == 0:
            try:
                validate_and_die(paths, folder / f"out{number}", where)
            finally:
                os._exit(0)
        _, status = os.waitpid(child, 0)
        assert os.WIFSIGNALED(status)
        assert os.WTERMSIG(status) == signal.SIGKILL


@pytest.mark.slow
def test_a_killed_run_goes_on_to_the_same_bytes(two, tmp_path, monkeypatch):
    arguments = ["hyperval", "validate", *map(str, two)]
    monkeypatch.setattr(sys, "argv", arguments)  # as in the program
    # A program of its own: copies of this process would inherit locks that threads of other tests hold.
    program = [sys.executable, __file__, str(tmp_path), *arguments]
    found = {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run(program, env=os.environ | found, check=True, timeout=600)
    code = validate(two, tmp_path / "whole")
    for number, (where, again) in enumerate(KILLED_AND_RUN_AGAIN.items()):
        out = tmp_path / f"out{number}"
        assert "results.csv" not in files_of(out), where
        names = runs(monkeypatch)
        assert validate(two, out) == code, where
        assert names == again, where
        assert files_of(out) == files_of(tmp_path / "whole"), where
        assert sorted(p.name for p in tmp_path.iterdir() if p.name.startswith(out.name)) == [out.name], where


def test_only_what_would_come_out_the_same_is_taken_over(two, tmp_path, monkeypatch):
    interrupted(two, tmp_path / "out")
    kept, path = tmp_path / "out" / PARTIAL, two[0]
    assert [p.name for p in (kept / "campaigns").iterdir()] == ["small"]
    record = kept / "campaigns" / "small" / RECORD

    def taken_over() -> bool:
        copy = tmp_path / "copy"
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(kept, copy)
        (job,) = jobs_of(path)
        run = Finished(copy).load(job)
        # What is not taken over is gone: nothing of it can get among the new files.
        assert (copy / "campaigns" / "small").exists() is (run is not None)
        return run is not None

    assert taken_over()
    (cube,) = path.parent.rglob("small_rad.img")
    for file, change in (
        (path, lambda raw: raw.replace(b"title: ", b"title: Another ", 1)),
        (path, lambda raw: raw + b"# nothing but a comment\n"),
        (cube, lambda raw: raw[:-1] + bytes([raw[-1] ^ 1])),
        (cube.with_suffix(".hdr"), lambda raw: raw + b"\n"),
        (record, lambda raw: raw[:-9]),
        (record, lambda raw: b"[]"),
        (record, lambda raw: b'{"identity": 1}'),
        (record.with_name("results.json"), lambda raw: raw[:-9]),
        (record.with_name("report.html"), lambda raw: raw.replace(b"agrees", b"agreed", 1)),
    ):
        before = file.read_bytes()
        assert change(before) != before
        file.write_bytes(change(before))
        assert not taken_over(), file
        file.write_bytes(before)
        assert taken_over()
    beside = cube.with_name("small_rad.glt")  # read from now on, if it were a grid
    beside.touch()
    assert not taken_over()
    beside.unlink()
    assert taken_over()
    monkeypatch.setattr("hyperval.campaign.run._program", lambda: "another")
    assert not taken_over()


def test_what_was_skipped_or_went_wrong_is_not_kept(two, tmp_path, monkeypatch):
    (cube,) = two[0].parent.rglob("small_rad.img")
    cube.unlink()
    interrupted(two, tmp_path / "out")
    (folder,) = (tmp_path / "out" / PARTIAL / "campaigns").iterdir()
    assert (folder / "results.json").is_file()
    assert not (folder / RECORD).exists()
    (job,) = jobs_of(two[0])
    assert Finished(tmp_path / "out" / PARTIAL).load(job) is None


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Runs that read their files, find one number and draw nothing; the names of those that ran."""
    ran: list[str] = []

    def run(job, **_):
        log = InputLog(job.folder)
        for path in (job.path, *job.folder.rglob("small_rad.*")):
            log.add(path)
        ran.append(job.campaign.name)
        row = Result(job.campaign.name, "radiance", "grass", "predicted", "mean", 1.0)
        provenance = {"inputs": log.entries(), "warnings": []}
        own = job.campaign
        return RunReport(own.name, own.title, "", own.simulated, ResultTable([row]), provenance=provenance)

    def write(run, folder):
        write_table(run.table, folder)
        (folder / "figures").mkdir()
        (folder / "figures" / "none.svg").write_text("<svg/>")
        (folder / "provenance.json").write_text(json.dumps(run.provenance))

    for place in (campaign_jobs, campaign_run):
        monkeypatch.setattr(place, "run_campaign", run)
        monkeypatch.setattr(place, "write_outputs", write)
    return ran


def test_a_second_run_takes_over_what_did_not_change(two, quick, tmp_path, capsys):
    out = tmp_path / "out"
    code = validate(two, out)
    assert sorted(quick) == ["other", "small"]
    first = files_of(out)
    quick.clear()
    assert cli.run(["validate", *map(str, two), "-o", str(out)]) == code
    assert quick == []
    assert capsys.readouterr().err.count("nothing changed") == 2
    assert files_of(out) == first

    two[0].write_bytes(two[0].read_bytes() + b"# nothing but a comment\n")
    assert validate(two, out) == code
    assert quick == ["small"]


def test_a_campaign_more_does_not_make_the_others_run_again(make_small, quick, tmp_path, monkeypatch):
    paths = []
    for name in ("first", "second", "third", "fourth"):
        small = make_small(name)
        small.data["name"] = name
        paths.append(small.write())

    def command(count: int, *more: str) -> int:
        quick.clear()
        arguments = ["-q", "validate", *map(str, paths[:count]), "-o", str(tmp_path / "out"), *more]
        monkeypatch.setattr(sys, "argv", ["hyperval", *arguments])  # as in the program
        return cli.run(arguments)

    for count, more, ran in ((3, [], ["first", "second", "third"]), (4, [], ["fourth"]), (4, ["--strict"], [])):
        command(count, *more)
        assert sorted(quick) == ran, (count, more)
    assert {"first", "second", "third", "fourth"} < {p.name for p in (tmp_path / "out").iterdir()}


def test_a_flight_line_more_does_not_make_the_others_run_again(make_small, quick, tmp_path):
    """The file of several runs gets another one, whose image and header lie beside theirs."""
    small = make_small("lines")
    cube = small.folder / small.data["collection"]["cube"]["path"]
    small.data |= {"name": "line-{line}"}
    small.data["collection"]["cube"]["path"] = str(cube.with_name("line-{line}.img").relative_to(small.folder))
    for count, ran in ((3, ["line-1", "line-2", "line-3"]), (4, ["line-4"])):
        quick.clear()
        small.data["runs"] = [{"line": str(i + 1)} for i in range(count)]
        for line, end in product(range(1, count + 1), (".img", ".hdr")):
            shutil.copy(cube.with_suffix(end), cube.with_name(f"line-{line}{end}"))
        validate([small.write()], tmp_path / "out")
        assert sorted(quick) == ran


def test_a_run_into_a_folder_whose_name_begins_alike_takes_nothing_away(make_small, quick, tmp_path, monkeypatch):
    path, (one, other) = make_small("one").write(), (tmp_path / ("n" * 60 + end) for end in "ab")
    right, codes = campaign_run.write_outputs, []

    def neighbour_runs(run, folder):
        right(run, folder)
        with monkeypatch.context() as patch:
            patch.setattr(campaign_run, "write_outputs", right)
            codes.append(validate([path], other))

    monkeypatch.setattr(campaign_run, "write_outputs", neighbour_runs)
    assert validate([path], one) == codes[0]
    assert files_of(one) == files_of(other)


def test_a_single_campaign_is_taken_over(make_small, quick, tmp_path):
    path, out = make_small("one").write(), tmp_path / "out"
    code = validate([path], out)
    first = files_of(out)
    quick.clear()
    assert validate([path], out) == code
    assert (quick, files_of(out)) == ([], first)
    assert cli.run(["-q", "validate", str(path), "-o", str(out), "--again"]) == code
    assert (quick, files_of(out)) == (["small"], first)


if __name__ == "__main__":
    output, *sys.argv = sys.argv[1:]
    killed_at_each(Path(output), [Path(name) for name in sys.argv[2:]])
