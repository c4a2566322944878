"""Processes of a server: bounded in time and memory, replaced when they end, ended with their server."""

import os
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
from processes import awaited, is_at_work

pytest.importorskip("fastapi", reason="needs the extra web")

from hyperval.cli import keep_caches
from hyperval.web import Cancelled, Full, TaskFailed, WorkerPool, WorkerTask

HERE = Path(__file__).parent
pytestmark = pytest.mark.filterwarnings("default")  # of the libraries behind the scheduler


@pytest.fixture(scope="module", params=["processes", "scheduler"])
def pool(request):
    """Processes of this machine, or a worker of a Dask scheduler: who hands tasks out sees no difference."""
    with ExitStack() as stack:
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        patch.syspath_prepend(str(HERE))
        patch.setenv("HYPERVAL_WORKERS", "1")
        if request.param == "processes":
            one = WorkerPool(1, 8, seconds=2.0, memory_bytes=1_500_000_000, module="web_tasks")
        else:
            distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")
            options = {"processes": False, "threads_per_worker": 1, "dashboard_address": None}
            cluster = stack.enter_context(distributed.LocalCluster(1, **options))
            one = WorkerPool(0, 1, 2.0, 0, cluster.scheduler_address, "web_tasks")
        yield one
        one.close()
        if request.param == "scheduler":  # a place that never had a task kept the others from ending
            WorkerPool(0, 1, 2.0, 0, cluster.scheduler_address, "web_tasks").close()
        with pytest.raises(Full):
            one.submit(WorkerTask("add", {"a": 1, "b": 2}))


def result(pool, task, **arguments):
    return pool.submit(WorkerTask(task, arguments)).future.result(30.0)


def test_what_ends_a_process_ends_its_task_alone(pool, request):
    assert result(pool, "add", a=1, b=2) == 3
    if request.node.callspec.params["pool"] == "processes":
        first = result(pool, "pid")
        assert result(pool, "pid") == first  # it stays warm
        with pytest.raises(TaskFailed, match="process was killed"):
            result(pool, "die")
        assert result(pool, "pid") != first
        with pytest.raises(TaskFailed, match="more memory"):
            result(pool, "hoard")


def test_task_that_takes_too_long_is_ended(pool, tmp_path):
    with pytest.raises(TaskFailed, match="longer than 2 s"):
        result(pool, "count", folder=str(tmp_path), seconds=60.0)
    assert result(pool, "add", a=1, b=1) == 2


def test_failure_is_told_without_paths(pool, capfd):
    words = {
        "wrong": "no such thing; expected: a thing of place",
        "unforeseen": "an internal error; the server's log has it",
    }
    for task, said in words.items():
        with pytest.raises(TaskFailed) as told:
            result(pool, task)
        assert str(told.value) == said


def test_task_tells_how_far_it_is_and_is_called_off(pool, tmp_path):
    running = WorkerTask("count", {"folder": str(tmp_path), "seconds": 60.0})
    pool.submit(running)
    awaited(lambda: running.progress[1])
    assert running.progress[0] == "counting"
    assert running.started
    waiting = pool.submit(WorkerTask("add", {"a": 1, "b": 1}))
    waiting.is_cancelled = running.is_cancelled = True
    for job in (running, waiting):
        with pytest.raises(Cancelled):
            job.future.result(30.0)
    assert result(pool, "add", a=2, b=2) == 4  # the worker is free again


def test_processes_end_with_a_server_that_was_killed(tmp_path):
    code = (
        "import sys, time; from hyperval.web.store import WorkerPool, WorkerTask\n"
        "if __name__ == '__main__':\n"
        f"    sys.path.insert(0, {str(HERE)!r})\n"
        "    pool = WorkerPool(1, 4, 60.0, 10**9, module='web_tasks')\n"
        "    print(pool.submit(WorkerTask('pid', {})).future.result(30.0), flush=True)\n"
        f"    pool.submit(WorkerTask('write', {{'path': {str(tmp_path / 'sign')!r}}}))\n"
        "    time.sleep(60)\n"
    )
    (tmp_path / "server.py").write_text(code)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(HERE), *sys.path])}
    server = subprocess.Popen([sys.executable, tmp_path / "server.py"], stdout=subprocess.PIPE, env=environment)
    worker = int(server.stdout.readline())
    awaited((tmp_path / "sign").exists)
    server.send_signal(signal.SIGKILL)
    server.wait()
    server.stdout.close()
    assert awaited(lambda: not is_at_work(worker))


def test_caches_of_a_user_without_a_home_are_the_servers(tmp_path, monkeypatch):
    """Under a system's service no worker could start: the engine found no place for its results."""
    monkeypatch.setenv("HYPERVAL_CACHE", str(tmp_path / "mine"))
    keep_caches(tmp_path / "web")
    assert os.environ["HYPERVAL_CACHE"] == str(tmp_path / "mine")
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("HYPERVAL_CACHE", str(tmp_path / "file" / "cache"))
    monkeypatch.setenv("MPLCONFIGDIR", str(tmp_path / "own"))
    keep_caches(tmp_path / "web")
    assert os.environ["HYPERVAL_CACHE"] == str(tmp_path / "web" / "cache")
    assert os.environ["MPLCONFIGDIR"] == str(tmp_path / "own")
