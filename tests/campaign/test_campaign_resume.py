"""Runs of several campaigns that are killed: the next gives the same files and repeats nothing that was whole."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hyperval import cli
from hyperval.campaign import run_campaign
from hyperval.datasets import InputLog
from hyperval.report import write_outputs
from hyperval.results import Cause, Result, ResultTable
from hyperval.run import Run, write_table
from hyperval.storage import PARTIAL, RECORD
from small_campaign import files_of, with_stand_in_atmosphere, without_figures

RUN = "hyperval.campaign.run"


@pytest.fixture
def two(make_small) -> list[Path]:
    first, second = make_small("one"), make_small("two")
    second.data["name"] = "other"
    return [first.write(), second.write()]


def validate(paths: list[Path], out: Path, *more: str) -> int:
    return cli.run(["validate", *map(str, paths), "-o", str(out), *more])


def die(*_: object, **__: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def validate_and_die(paths: list[Path], out: Path, where: str) -> None:
    """Run, and be killed in the middle."""

    def half_written(report, folder):
        write_outputs(report, folder)
        if report.campaign == "other":
            (folder / "results.json").write_text("{")
            die()

    def at_second(job, **options):
        return die() if job.campaign.name == "other" else run_campaign(job, **options)

    with pytest.MonkeyPatch.context() as patch:
        with_stand_in_atmosphere(patch)
        without_figures(patch)
        deadly = {"run_campaign": at_second, "write_outputs": half_written, "write_index": die}
        patch.setattr(f"{RUN}.{where}", deadly[where])
        validate(paths, out)


KILLED_AND_RUN_AGAIN = {"run_campaign": ["other"], "write_outputs": ["other"], "write_index": []}


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
def test_a_killed_run_goes_on_to_the_same_bytes(two, tmp_path, monkeypatch, capsys):
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
        capsys.readouterr()
        assert validate(two, out) == code, where
        said = capsys.readouterr().err
        assert [n for n in ("small", "other") if f"{n}: unchanged" not in said] == again, where
        assert files_of(out) == files_of(tmp_path / "whole"), where
        assert sorted(p.name for p in tmp_path.iterdir() if p.name.startswith(out.name)) == [out.name], where


@pytest.fixture
def quick(monkeypatch) -> list[str]:
    """Runs that read their files, find one number and draw nothing; the names of those that ran."""
    ran: list[str] = []

    def run(job, **_):
        log, own = InputLog(job.folder), job.campaign
        for path in (job.path, *job.folder.rglob("small_rad.*")):
            log.add(path)
        ran.append(own.name)
        cause = Cause.NO_DATA if "nowhere" in own.title else Cause.NONE
        table = ResultTable([Result(own.name, "radiance", "grass", "predicted", "mean", 1.0, cause=cause)])
        return Run(table, {"inputs": log.entries()}, title=own.title, campaign=own.name, simulated=own.simulated)

    def write(run, folder):
        write_table(run.table, folder)
        (folder / "figures").mkdir()
        (folder / "figures" / "none.svg").write_text("<svg/>")
        (folder / "provenance.json").write_text(json.dumps(run.provenance))

    monkeypatch.setattr(f"{RUN}.run_campaign", run)
    monkeypatch.setattr(f"{RUN}.write_outputs", write)
    return ran


def test_only_what_would_come_out_the_same_is_taken_over(two, quick, tmp_path, monkeypatch, capsys):
    out, path = tmp_path / "out", two[0]
    code = validate(two, out)
    first = files_of(out)

    def ran() -> list[str]:
        quick.clear()
        assert validate(two, out) == code
        return sorted(quick)

    assert ran() == []
    assert capsys.readouterr().err.count("unchanged") == 2
    assert files_of(out) == first
    (cube,) = path.parent.rglob("small_rad.img")
    record = out / "small" / RECORD
    for file, change in (
        (path, lambda raw: raw.replace(b"title: ", b"title: Another ", 1)),
        (path, lambda raw: raw + b"# nothing but a comment\n"),
        (cube, lambda raw: raw[:-1] + bytes([raw[-1] ^ 1])),
        (cube.with_suffix(".hdr"), lambda raw: raw + b"\n"),
        (record, lambda raw: raw[:-9]),
        (record, lambda raw: b"[]"),
        (record, lambda raw: b'{"identity": 1}'),
        (record.with_name("results.json"), lambda raw: raw[:-9]),
        (record.with_name("figures") / "none.svg", lambda raw: b""),
    ):
        before = file.read_bytes()
        assert change(before) != before
        file.write_bytes(change(before))
        assert ran() == ["small"], file
        if out not in file.parents:
            file.write_bytes(before)
            assert ran() == ["small"], file
    found = ("small_rad.img~", []), ("junit.xml", []), ("small_rad.img.hdr", ["small"]), ("small_rad.glt", ["small"])
    for name, again in found:  # a header and a grid are looked for, the others are not
        cube.with_name(name).touch()
        assert ran() == again
    monkeypatch.setattr(f"{RUN}._program_digest", lambda: "another")
    assert ran() == ["other", "small"]
    path.write_bytes(path.read_bytes().replace(b"title: ", b"title: nowhere ", 1))
    assert ran() == ["small"]
    assert ran() == ["small"]  # what was skipped is not kept


def test_a_campaign_more_does_not_make_the_others_run_again(make_small, quick, tmp_path, monkeypatch):
    paths = []
    for name in ("first", "second", "third", "fourth"):
        small = make_small(name)
        small.data["name"] = name
        paths.append(small.write())
    for count, more, ran in ((3, [], ["first", "second", "third"]), (4, [], ["fourth"]), (4, ["--strict"], [])):
        quick.clear()
        monkeypatch.setattr(sys, "argv", ["hyperval", str(count), *more])  # as in the program
        validate(paths[:count], tmp_path / "out", *more)
        assert sorted(quick) == ran, (count, more)


def test_a_flight_line_more_does_not_make_the_others_run_again(make_small, quick, tmp_path):
    """The file of several runs gets another one, whose image and header lie beside theirs."""
    small = make_small("lines")
    cube = small.folder / small.data["collection"]["cube"]["path"]
    small.data |= {"name": "line-{line}"}
    small.data["collection"]["cube"]["path"] = str(cube.with_name("line-{line}.img").relative_to(small.folder))
    for count, ran in ((3, ["line-1", "line-2", "line-3"]), (4, ["line-4"])):
        quick.clear()
        small.data["runs"] = [{"line": str(i + 1)} for i in range(count)]
        for line in range(1, count + 1):
            for end in (".img", ".hdr"):
                shutil.copy(cube.with_suffix(end), cube.with_name(f"line-{line}{end}"))
        validate([small.write()], tmp_path / "out")
        assert sorted(quick) == ran


def test_a_single_campaign_is_taken_over_and_what_is_interrupted_goes_on(two, quick, tmp_path, monkeypatch):
    path, out = two[0], tmp_path / "out"
    code = validate([path], out)
    first = files_of(out)
    for more, ran in ([], []), (["--again"], ["small"]):
        quick.clear()
        assert validate([path], out, *more) == code
        assert (quick, files_of(out)) == (ran, first)
    assert validate([path], out, "--again", "--scheduler", "no-such-protocol://nowhere:1") == 2  # it was left out
    with monkeypatch.context() as patch:
        patch.setattr(f"{RUN}.write_index", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt))
        assert validate(two, tmp_path / "both") == 130
    assert sorted(p.name for p in (tmp_path / "both" / PARTIAL / "campaigns").iterdir()) == ["other", "small"]
    quick.clear()
    assert validate(two, tmp_path / "both") == code
    assert (quick, (tmp_path / "both" / PARTIAL).exists()) == ([], False)


if __name__ == "__main__":
    output, *sys.argv = sys.argv[1:]
    killed_at_each(Path(output), [Path(name) for name in sys.argv[2:]])
