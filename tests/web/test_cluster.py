"""Tasks on a Dask scheduler: carried out, told of, called off, bounded."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")
pytest.importorskip("fastapi", reason="needs the extra web")
from hyperval.web import Cancelled, Cluster, Full, TaskFailed, WorkerTask

HERE = Path(__file__).parent
pytestmark = pytest.mark.filterwarnings("default")  # of the libraries behind the scheduler


@pytest.fixture(scope="module")
def crew():
    with (
        pytest.MonkeyPatch.context() as patch,
        distributed.LocalCluster(1, processes=False, threads_per_worker=1, dashboard_address=None) as cluster,
    ):
        patch.syspath_prepend(str(HERE))
        patch.setenv("HYPERVAL_WORKERS", "1")
        one = Cluster(cluster.scheduler_address, most=1, seconds=2.0, module="web_tasks")
        yield one
        one.close()
        with pytest.raises(Full):
            one.submit(WorkerTask("add", {"a": 1, "b": 2}))


def result(crew, task, **arguments):
    return crew.submit(WorkerTask(task, arguments)).future.result(30.0)


def test_task_is_carried_out_or_fails_without_paths(crew):
    assert result(crew, "add", a=1, b=2) == 3
    with pytest.raises(TaskFailed) as told:
        result(crew, "wrong")
    assert str(told.value) == "no such thing; expected: a thing of place"
    with pytest.raises(TaskFailed) as told:
        result(crew, "unforeseen")
    assert "secret" not in str(told.value)


def test_task_tells_how_far_it_is_and_is_called_off(crew, tmp_path):
    begun = []
    running = WorkerTask("count", {"folder": str(tmp_path), "seconds": 60.0}, begun=lambda: begun.append(True))
    crew.submit(running)
    end = time.monotonic() + 30.0
    while not running.progress[1] and time.monotonic() < end:
        time.sleep(0.02)
    assert running.progress[0] == "counting"
    assert begun == [True]
    waiting = crew.submit(WorkerTask("add", {"a": 1, "b": 1}))
    with pytest.raises(Full):
        crew.submit(WorkerTask("add", {"a": 1, "b": 1}))
    running.is_cancelled = True
    with pytest.raises(Cancelled):
        running.future.result(30.0)
    assert waiting.future.result(30.0) == 2  # the worker is free again


def test_task_that_takes_too_long_is_ended(crew, tmp_path):
    with pytest.raises(TaskFailed, match="longer than 2 s"):
        result(crew, "count", folder=str(tmp_path), seconds=60.0)
    assert result(crew, "add", a=2, b=2) == 4
