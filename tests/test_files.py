"""Whole or not at all: what stands on disk after a failure at any point."""

from __future__ import annotations

import hashlib
import os
import stat
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from hyperval.errors import InputError, UsageError
from hyperval.files import sha256_of, whole_file, whole_folder, write_text


class Broken(Exception):
    pass


def left_over(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_new_file_appears_with_its_content(tmp_path: Path):
    with whole_file(tmp_path / "deep" / "a.csv") as temporary:
        assert temporary.parent == tmp_path / "deep"
        assert temporary.suffix == ".csv"
        temporary.write_text("1,2")
        assert not (tmp_path / "deep" / "a.csv").exists()
    assert (tmp_path / "deep" / "a.csv").read_text() == "1,2"
    assert left_over(tmp_path / "deep") == ["a.csv"]


def test_failure_in_the_middle_keeps_the_old_file(tmp_path: Path):
    path = tmp_path / "a.csv"
    path.write_text("old")

    def half_write() -> None:
        with whole_file(path) as temporary:
            temporary.write_text("ne")
            raise Broken

    with pytest.raises(Broken):
        half_write()
    assert path.read_text() == "old"
    assert left_over(tmp_path) == ["a.csv"]


def test_written_file_obeys_the_umask(tmp_path: Path):
    before = os.umask(0o027)
    try:
        write_text(tmp_path / "a.txt", "x")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == 0o640


def test_text_is_utf8_with_unix_line_ends(tmp_path: Path):
    write_text(tmp_path / "a.txt", "λ\n")
    assert (tmp_path / "a.txt").read_bytes() == b"\xce\xbb\n"


def test_folder_is_replaced_as_a_whole(tmp_path: Path):
    path = tmp_path / "report"
    path.mkdir()
    (path / "stale.csv").write_text("old")
    with whole_folder(path) as temporary:
        (temporary / "new.csv").write_text("new")
        assert (path / "stale.csv").read_text() == "old"
    assert left_over(path) == ["new.csv"]
    assert left_over(tmp_path) == ["report"]


def test_failure_in_the_middle_keeps_the_old_folder(tmp_path: Path):
    path = tmp_path / "report"
    path.mkdir()
    (path / "old.csv").write_text("old")

    def half_write() -> None:
        with whole_folder(path) as temporary:
            (temporary / "new.csv").write_text("ne")
            raise Broken

    with pytest.raises(Broken):
        half_write()
    assert left_over(path) == ["old.csv"]
    assert left_over(tmp_path) == ["report"]


def test_failure_of_the_last_step_puts_the_old_folder_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "report"
    path.mkdir()
    (path / "old.csv").write_text("old")
    real = os.replace
    calls = []

    def second_fails(source, target):
        calls.append(source)
        if len(calls) == 2:
            raise OSError("no room")
        real(source, target)

    monkeypatch.setattr("hyperval.files.os.replace", second_fails)
    with pytest.raises(OSError, match="no room"), whole_folder(path) as temporary:
        (temporary / "new.csv").write_text("new")
    assert left_over(path) == ["old.csv"]
    assert left_over(tmp_path) == ["report"]


def test_a_folder_of_somebody_else_is_never_replaced(tmp_path: Path):
    path = tmp_path / "thesis"
    path.mkdir()
    (path / "chapter.tex").write_text("years of work")
    with pytest.raises(UsageError, match="would be replaced"), whole_folder(path, ours="results.json"):
        raise AssertionError("the block must not begin")
    assert left_over(path) == ["chapter.tex"]


@pytest.mark.parametrize("content", [[], ["results.json", "more"]])
def test_an_empty_folder_and_one_of_ours_are_replaced(tmp_path: Path, content: list[str]):
    path = tmp_path / "report"
    path.mkdir()
    for name in content:
        (path / name).write_text("old")
    with whole_folder(path, ours="results.json") as temporary:
        (temporary / "results.json").write_text("new")
    assert left_over(path) == ["results.json"]


def test_a_file_in_place_of_the_folder(tmp_path: Path):
    (tmp_path / "report").write_text("x")
    with pytest.raises(UsageError, match="is a file"), whole_folder(tmp_path / "report"):
        raise AssertionError("the block must not begin")
    assert (tmp_path / "report").read_text() == "x"


def test_a_place_where_no_folder_can_be_made_is_the_users_to_mend(tmp_path: Path):
    (tmp_path / "notes.txt").write_text("mine")
    with (
        pytest.raises(UsageError, match=r"notes\.txt/out: no folder can be made here"),
        whole_folder(tmp_path / "notes.txt" / "out"),
    ):
        pytest.fail("never entered")


def test_first_folder_fails_and_leaves_nothing(tmp_path: Path):
    with pytest.raises(Broken), whole_folder(tmp_path / "report"):
        raise Broken
    assert left_over(tmp_path) == []


@pytest.mark.parametrize("kind", ["whole_file", "whole_folder"])
def test_a_killed_process_keeps_the_old_result(tmp_path: Path, kind: str):
    path = tmp_path / "result"
    if kind == "whole_file":
        path.write_text("old")
    else:
        path.mkdir()
        (path / "part").write_text("old")
    script = f"""
        import os, signal
        from pathlib import Path
        from hyperval.files import {kind}
        with {kind}(Path({str(path)!r})) as t:
            ((t / "part") if t.is_dir() else t).write_text("ne")
            os.kill(os.getpid(), signal.SIGKILL)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], check=False)
    assert done.returncode == -9
    assert (path if kind == "whole_file" else path / "part").read_text() == "old"


def test_full_disk_keeps_the_old_file(tmp_path: Path):
    # A limit on file size stands in for a full disk: the write fails in the middle with EFBIG.
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    script = f"""
        import resource, signal
        from pathlib import Path
        from hyperval.files import whole_file
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
        try:
            with whole_file(Path({str(path)!r})) as t:
                t.write_bytes(bytes(10000))
        except OSError:
            raise SystemExit(7)
    """
    done = subprocess.run([sys.executable, "-B", "-c", textwrap.dedent(script)], check=False)
    assert done.returncode == 7
    assert path.read_bytes() == b"old"
    assert left_over(tmp_path) == ["a.bin"]


def test_sha256_equals_the_plain_computation(tmp_path: Path):
    content = bytes(range(256)) * 5000
    (tmp_path / "a.bin").write_bytes(content)
    assert sha256_of(tmp_path / "a.bin") == hashlib.sha256(content).hexdigest()
    # NIST FIPS 180-4 example: the one-block message "abc".
    (tmp_path / "abc").write_bytes(b"abc")
    assert sha256_of(tmp_path / "abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def test_sha256_of_nothing_is_an_input_error(tmp_path: Path):
    with pytest.raises(InputError, match="cannot read"):
        sha256_of(tmp_path / "none")
