"""A study on a real Dask scheduler with two workers, one of which is killed in the middle."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from hyperval.study import study_to_folder

pytest.importorskip("distributed", reason="the extra dask is not installed")

TEXT = """
inputs:
  - {name: c, path: sensor_changes.calibration_error_percent, grid: {start: 0.1, stop: 3, count: 40}}
  - {name: s, path: sensor_changes.signal_factor, grid: {start: 0.5, stop: 2, count: 30}}
outputs: [{name: log_auc, kind: log-auc, subject: plank}]
"""
PATIENCE = 120.0  # seconds for scheduler and workers to come up on a busy machine


def until(condition, what: str):
    end = time.monotonic() + PATIENCE
    while not (found := condition()):
        if time.monotonic() > end:
            raise TimeoutError(what)
        time.sleep(0.02)
    return found


@pytest.fixture
def cluster(tmp_path):
    """Address of a scheduler, and its two workers as processes of their own that nobody starts again."""
    file, started = tmp_path / "scheduler.json", []

    def start(*words: str) -> subprocess.Popen:
        with open(tmp_path / f"log{len(started)}", "wb") as log:
            command = [sys.executable, "-m", "dask", *words, "--scheduler-file", str(file)]
            started.append(subprocess.Popen(command, stdout=log, stderr=log, cwd=tmp_path))
        return started[-1]

    try:
        start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        until(lambda: file.exists() and file.read_text().strip().endswith("}"), "the scheduler did not come up")
        both = [start("worker", "--no-nanny", "--nthreads", "1", "--no-dashboard") for _ in range(2)]
        address = json.loads(file.read_text())["address"]
        from distributed import Client

        with Client(address, timeout=f"{PATIENCE:.0f}s") as client:
            client.wait_for_workers(2, timeout=PATIENCE)
        yield address, both
    finally:
        for process in reversed(started):
            process.kill()
            process.wait()


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of the libraries behind the scheduler
def test_the_same_table_with_one_worker_killed_in_the_middle(make_study, tmp_path, monkeypatch, cluster):
    address, both = cluster
    monkeypatch.setattr("hyperval.study.run._SMALLEST", 32)
    path = make_study(TEXT)
    study_to_folder(path, tmp_path / "here")
    kept: Path = tmp_path / "there" / ".hyperval-partial" / "values.f64"
    seen = []

    def kill_one() -> None:
        until(lambda: kept.exists() and kept.stat().st_size > 0, "no chunk was finished")
        seen.append(kept.stat().st_size)
        both[0].kill()

    killer = threading.Thread(target=kill_one)
    killer.start()
    study_to_folder(path, tmp_path / "there", scheduler=address)
    killer.join()
    assert 0 < seen[0] < 1200 * 8  # it was in the middle
    assert both[0].wait() != 0
    assert both[1].poll() is None
    for name in ("table.csv", "table.nc", "results.csv"):
        assert (tmp_path / "there" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()
