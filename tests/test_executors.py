"""One seam: here, in processes, on a cluster; what comes out is the same and in order."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Thread

import pytest
from processes import awaited, is_at_work
from threadpoolctl import threadpool_info, threadpool_limits

from hyperval import executors
from hyperval.errors import UsageError
from hyperval.progress import track


def square(x):
    return next(track([x * x], "squares"))


def fails_at_three(x):
    if x == 3:
        raise ValueError("three")
    return x


def blas_threads(_=None):
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


def dies_once(piece):
    flag, value = piece
    if value == 2 and not flag.exists():
        flag.write_text("died")
        os._exit(9)
    return value * value


def dies(_):
    os._exit(9)


def test_results_come_in_the_order_of_the_pieces(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with ThreadPoolExecutor(3) as pool:
        assert list(executors.in_order(executors.Workers(pool, 3), square, range(50))) == [k * k for k in range(50)]
        assert capsys.readouterr().err == ""  # who hands pieces out draws the bars
        results = executors.in_order(executors.Workers(pool, 3), fails_at_three, range(6))
        assert [next(results) for _ in range(3)] == [0, 1, 2]
        with pytest.raises(ValueError, match="three"):
            next(results)
    handed = []
    results = executors.in_order(executors.Workers(), square, (handed.append(k) or k for k in range(100)))
    assert next(results) == 0
    assert len(handed) <= 2  # as they are needed


def test_one_blas_thread_inside_and_the_old_number_after():
    with threadpool_limits(2, user_api="blas"):
        with executors.single_blas_thread() as alone:
            assert alone
            assert set(blas_threads()) == {1}
        assert set(blas_threads()) == {2}
        assert set(next(executors.in_order(executors.Workers(), blas_threads, [0]))) == {1}


def test_number_of_workers(monkeypatch):
    assert executors.worker_count(1) == 1 <= executors.available_cores()
    monkeypatch.setenv("HYPERVAL_WORKERS", "3")
    assert (executors.worker_count(), executors.worker_count(2), executors.worker_count(9)) == (3, 2, 3)
    monkeypatch.setenv("HYPERVAL_WORKERS", "many")
    with pytest.raises(UsageError, match="HYPERVAL_WORKERS"):
        executors.worker_count()


def test_a_process_that_dies_is_replaced(tmp_path):
    pieces = [(tmp_path / "flag", k) for k in range(6)]
    with executors.workers(2) as where:
        assert list(executors.in_order(where, dies_once, pieces)) == [0, 1, 4, 9, 16, 25]


class EndedInPassing:
    """Told to end, the first time, while the pool packs it: outside the piece that made it."""

    def __init__(self, piece):
        self.piece = piece

    def __reduce__(self):
        flag, number = self.piece
        if not flag.exists():
            flag.touch()
            os.kill(os.getpid(), signal.SIGTERM)
        return int, (number,)


def swallows(piece):
    flag, number = piece
    if not flag.exists():
        flag.touch()
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.1)
        except BaseException:
            return -1
    return number


@pytest.mark.parametrize("piece", [EndedInPassing, swallows])
def test_a_process_told_to_end_ends_and_its_piece_is_done_again(tmp_path, piece):
    """Between pieces the pool kept what the signal raised, and the run waited for ever."""
    with executors.workers(2) as where:
        assert list(executors.in_order(where, piece, [(tmp_path / "flag", k) for k in range(4)])) == [0, 1, 2, 3]


def test_processes_that_always_die_are_given_up(monkeypatch):
    monkeypatch.setattr("hyperval.executors._RENEWALS", 0)
    with pytest.raises(executors.WorkersLostError, match="worker process died"), executors.workers(2) as where:
        list(executors.in_order(where, dies, [1]))


def sleeps(piece):
    folder, number = piece
    try:
        (folder / f"{number}.pid").write_text(str(os.getpid()))  # who reads it may end this process at once
        time.sleep(60)
    finally:
        (folder / f"{number}.unwound").touch()


def workers_of(folder):
    """Process ids of two pieces at work."""
    ids = awaited(lambda: len(ids := [p.read_text() for p in folder.glob("*.pid")]) == 2 and all(ids) and ids)
    return [int(text) for text in ids]


class Ended(BaseException):
    pass


def run_until(folder, signal_number):
    """Two pieces at work, then a signal to the process that handed them out."""

    def end():
        workers_of(folder)
        os.kill(os.getpid(), signal_number)

    with executors.workers(2) as where:
        Thread(target=end, daemon=True).start()
        list(executors.in_order(where, sleeps, [(folder, 1), (folder, 2)]))


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_their_run(tmp_path, number):
    """They went on until their pieces were done, a minute here; what pieces made for the time being goes."""
    # A program of its own: a fork of this process would inherit locks that threads of other tests hold.
    command = [sys.executable, __file__, str(tmp_path), str(int(number))]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    code = subprocess.run(command, env=environment, check=False, timeout=120).returncode
    assert code in (7, -signal.SIGKILL)
    pieces = workers_of(tmp_path)
    assert awaited(lambda: not any(map(is_at_work, pieces)))
    # What is ended the hard way leaves no such file.
    assert len(list(tmp_path.glob("*.unwound"))) == 2


def test_a_scheduler_that_is_not_there():
    pytest.importorskip("distributed", reason="the extra dask is not installed")
    with pytest.raises(UsageError, match="scheduler"), executors.workers(scheduler="no-such-protocol://nowhere:1"):
        pass


def first_of(piece):
    return executors.opened(piece[0])[piece[1]], isinstance(piece[0], Path)


@pytest.mark.parametrize("count", [1, 2])
def test_what_all_pieces_need_is_packed_once(count):
    """Processes of this machine read it from a file that is gone afterwards; here it needs none."""
    value = {k: k * k for k in range(5)}
    with executors.workers(count) as where:
        with executors.parcel(where, value) as packed:
            found = list(executors.in_order(where, first_of, [(packed, k) for k in range(5)]))
        assert isinstance(packed, bytes) or not packed.exists()
    assert found == [(k * k, count == 2) for k in range(5)]
    with ThreadPoolExecutor(1) as pool, executors.parcel(executors.Workers(pool), [3, 4]) as packed:  # they carry it
        assert list(executors.in_order(executors.Workers(pool), first_of, [(packed, 1)])) == [(4, False)]


def unwind(number, frame):
    raise Ended


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, unwind)
    try:
        run_until(Path(sys.argv[1]), int(sys.argv[2]))
    except Ended:
        os._exit(7)
