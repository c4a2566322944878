"""The program of the engine, and what is kept of its runs."""

import os
import shutil
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from processes import awaited, is_at_work

from hyperval.atmosphere import cached, sixs
from hyperval.errors import EngineError

# Starting the executable on a machine with and without a Fortran run-time library.


@pytest.fixture(autouse=True)
def _forget():
    sixs._library_folder.cache_clear()
    yield
    sixs._library_folder.cache_clear()


def test_borrowed_library_is_linked_and_works_and_one_that_does_not_suit_is_passed_over(tmp_path, monkeypatch):
    works, good = sixs._works, sixs.fortran_libraries()
    if works(None):  # the same path, on a machine that would not need it
        monkeypatch.setattr(sixs, "_works", lambda folder: folder is not None and works(folder))
    bad = tmp_path / "elsewhere.libs" / "libgfortran-bad.so.5.0.0"
    bad.parent.mkdir()
    bad.write_bytes(b"not a library")
    if not works(None):
        monkeypatch.setattr(sixs, "fortran_libraries", lambda: [bad, *good])
    folder = sixs._library_folder(str(tmp_path))
    link = tmp_path / "libraries" / os.path.basename(folder) / "libgfortran.so.5"
    assert link.is_symlink()
    assert link.resolve() in [p.resolve() for p in good]
    assert "6SV version 2.1" in sixs.run_sixs(sixs._TRIAL, tmp_path)


def test_user_search_path_is_kept(tmp_path, monkeypatch):
    seen, said = {}, subprocess.CompletedProcess([], 0, sixs._BANNER)
    monkeypatch.setattr(sixs, "run_program", lambda *_, env, **__: seen.update(env) or said)
    monkeypatch.setenv("LD_LIBRARY_PATH", "/opt/mine")
    sixs._start(sixs._TRIAL, str(tmp_path))
    assert seen["LD_LIBRARY_PATH"] == f"{tmp_path}{os.pathsep}/opt/mine"


def test_links_are_shared_and_those_that_lead_nowhere_replaced(tmp_path):
    (library, *_) = sixs.fortran_libraries()
    with ThreadPoolExecutor(8) as pool:  # who starts at once shares one folder
        (folder,) = set(pool.map(lambda _: sixs._linked(library, tmp_path), range(16)))
    (folder / "libgfortran.so.5").unlink()
    (folder / "libgfortran.so.5").symlink_to(tmp_path / "gone")
    assert sixs._linked(library, tmp_path) == folder
    assert (folder / "libgfortran.so.5").resolve() == library.resolve()
    assert not list(folder.glob(".*"))  # nothing temporary stays behind


def test_a_file_that_may_not_be_started(tmp_path, monkeypatch):
    text = tmp_path / "sixs"
    text.touch(0o644)
    monkeypatch.setattr(sixs, "sixs_path", lambda: text)
    for tied in (True, False):  # where the system has a way to end it with its run, and where it has none
        if not tied:
            monkeypatch.setattr("hyperval.atmosphere.terms.tie", tuple)
        with pytest.raises(EngineError, match=r"6S cannot be started: .*Permission denied"):
            sixs._start(sixs._TRIAL, None)


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="the system has no setpriv")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_it_ends_with_the_process_that_started_it(tmp_path, number):
    """A worker that was killed left it at work for up to five minutes, a processor each."""
    slow = tmp_path / "sixs"
    slow.write_text(f"#!/bin/sh\necho $$ > {tmp_path}/new; mv {tmp_path}/new {tmp_path}/pid; exec sleep 60\n")
    slow.chmod(0o755)
    code = (
        "import sys; from pathlib import Path; from hyperval.atmosphere import sixs as s;"
        "s.sixs_path = lambda: Path(sys.argv[1]); s._start('', None)"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(slow)]) as worker:
        engine = int(awaited(lambda: (tmp_path / "pid").is_file() and (tmp_path / "pid").read_text()))
        worker.send_signal(number)
    assert awaited(lambda: not is_at_work(engine))


def test_a_run_that_cannot_be_is_told_with_what_mends_it(tmp_path, monkeypatch):
    with pytest.raises(EngineError, match="6S ended with code"):
        sixs.run_sixs("0\nnonsense\n", tmp_path)
    sixs._library_folder.cache_clear()
    monkeypatch.setattr(sixs, "_works", lambda folder: False)
    with pytest.raises(EngineError, match="apt-get install libgfortran5"):
        sixs.run_sixs(sixs._TRIAL, tmp_path)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(EngineError, match="executable is missing"):
        sixs.run_sixs(sixs._TRIAL, tmp_path)


# The cache: computed once, never trusted blindly.


INPUTS = {"depth": 0.1, "card": "4\n"}
ARRAYS = {"a": np.arange(3.0), "b": np.ones((2, 2))}


@pytest.fixture
def entry(tmp_path):
    """What is stored, and what asks for it and tells how often it has been computed."""
    calls = []

    def found(inputs=INPUTS):
        arrays = cached(tmp_path, "kind", inputs, lambda: calls.append(1) or ARRAYS)
        np.testing.assert_equal(arrays, ARRAYS)
        return len(calls)

    assert found() == found() == 1
    (path,) = (tmp_path / "kind").iterdir()
    return path, found


def test_any_flipped_byte_of_an_entry_is_seen_or_harmless(entry):
    path, found = entry
    raw = path.read_bytes()
    for at in range(0, len(raw), 3):
        path.write_bytes(raw[:at] + bytes([raw[at] ^ 0x55]) + raw[at + 1 :])
        found()
    assert found() > len(raw) / 6


def test_an_entry_that_is_cut_or_of_other_inputs_is_computed_again(entry):
    path, found = entry
    raw, other = path.read_bytes(), {**INPUTS, "depth": 0.1000001}
    for number, left in enumerate((raw[: len(raw) // 2], b""), 2):
        path.write_bytes(left)
        assert found() == found() == number
    assert found(other) == 4
    first, second = sorted(path.parent.iterdir())
    first.write_bytes(second.read_bytes())  # the right bytes under the wrong name
    assert {found(), found(other)} <= {4, 5}
    assert found() == found(other) == 5


def test_many_writers_leave_one_whole_entry_and_a_folder_that_cannot_be_written_is_no_error(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    for folder in (tmp_path, tmp_path / "file"):
        with ThreadPoolExecutor(8) as pool:
            for arrays in pool.map(lambda _, at: cached(at, "kind", INPUTS, lambda: ARRAYS), range(32), [folder] * 32):
                np.testing.assert_equal(arrays, ARRAYS)
    assert [p.suffix for p in (tmp_path / "kind").iterdir()] == [".npz"]
