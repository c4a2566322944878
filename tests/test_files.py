"""Whole or not at all: what stands on disk after a failure at any point."""

import os
import stat
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from hyperval.errors import InputError
from hyperval.storage import scratch_folder, sha256_of, size_of, whole_file, write_text


class Broken(Exception):
    pass


def left_over(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def ended(script: str) -> int:
    """The code with which a program ends that runs the script."""
    return subprocess.run([sys.executable, "-B", "-c", textwrap.dedent(script)], check=False).returncode


def test_a_file_is_whole_or_the_old_one(tmp_path: Path):
    path = tmp_path / "deep" / ("n" * 251 + ".csv")  # a name as long as a name can be
    before = os.umask(0o027)
    try:
        write_text(path, "λ\n")
    finally:
        os.umask(before)
    assert path.read_bytes() == b"\xce\xbb\n"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640

    def half_write() -> None:
        with whole_file(path) as temporary:
            assert (temporary.parent, temporary.suffix) == (path.parent, ".csv")
            temporary.write_text("ne")
            raise Broken

    with pytest.raises(Broken):
        half_write()
    assert path.read_bytes() == b"\xce\xbb\n"
    assert left_over(path.parent) == [path.name]


def test_digests(tmp_path: Path):
    # NIST FIPS 180-4 example: the one-block message "abc".
    (tmp_path / "abc").write_bytes(b"abc")
    assert sha256_of(tmp_path / "abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    with pytest.raises(InputError, match="cannot read"):
        sha256_of(tmp_path / "none")
    for folder, name in (("a", "0.0"), ("b", "0.1")):  # a folder is known by the names of its files, too
        (tmp_path / folder / "inner").mkdir(parents=True)
        (tmp_path / folder / "inner" / name).write_bytes(b"1")
    assert sha256_of(tmp_path / "a") != sha256_of(tmp_path / "b")
    assert size_of(tmp_path / "a") == 1


def test_a_killed_process_keeps_the_old_file_and_the_next_one_removes_what_it_left(tmp_path: Path):
    path = tmp_path / "result.csv"
    path.write_text("old")
    script = f"""
        import os, signal
        from pathlib import Path
        from hyperval.storage import whole_file
        with whole_file(Path({str(path)!r})) as t:
            t.write_text("ne")
            os.kill(os.getpid(), signal.SIGKILL)
    """
    assert ended(script) == -9
    assert path.read_text() == "old"
    (left,) = (p for p in tmp_path.iterdir() if p != path)
    write_text(path, "new")
    assert left.exists()  # too new: perhaps of a process on another machine
    os.utime(left, (0, 0))
    other = tmp_path / ".result.csv.backup.csv"  # the user's
    other.write_text("mine")
    os.utime(other, (0, 0))
    write_text(path, "newer")
    assert left_over(tmp_path) == [other.name, "result.csv"]
    with whole_file(path) as outer:  # what a running process writes is left alone
        outer.write_text("outer")
        os.utime(outer, (0, 0))
        write_text(path, "inner")
        assert outer.exists()
    assert path.read_text() == "outer"


def test_full_disk_keeps_the_old_file(tmp_path: Path):
    # A limit on file size stands in for a full disk: the write fails in the middle with EFBIG.
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    script = f"""
        import resource, signal
        from pathlib import Path
        from hyperval.storage import whole_file
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
        try:
            with whole_file(Path({str(path)!r})) as t:
                t.write_bytes(bytes(10000))
        except OSError:
            raise SystemExit(7)
    """
    assert ended(script) == 7
    assert path.read_bytes() == b"old"
    assert left_over(tmp_path) == ["a.bin"]


def test_scratch_of_killed_processes_goes_with_the_next(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    script = f"""
        import os, signal, tempfile
        tempfile.tempdir = {str(tmp_path)!r}
        from hyperval.storage import scratch_folder
        with scratch_folder("trial") as folder:
            (folder / "cube.img").write_bytes(bytes(100))
            os.utime(folder, (0, 0))
            os.kill(os.getpid(), signal.SIGKILL)
    """
    assert ended(script) == -9
    (left,) = tmp_path.iterdir()
    other = tmp_path / f"hyperval-trial-{os.getpid()}-abcdefgh"
    other.mkdir()
    os.utime(other, (0, 0))
    with scratch_folder("trial") as folder:
        assert {p.name for p in tmp_path.iterdir()} == {folder.name, other.name}
    assert not left.exists()
    assert list(tmp_path.iterdir()) == [other]
