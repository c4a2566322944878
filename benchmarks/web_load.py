"""Fifty people at once: pages, predictions of their own and charts over loopback, for two minutes.

    python benchmarks/web_load.py [--users 50] [--seconds 120]

Starts a server with two workers of its own, warms it, and lets each user begin at a random time: a page, an order
that is refused, a prediction with a value of the user's own, its result, its charts, then some seconds to look.
Tells
the times of each kind of request, errors, and results that were another user's.
"""

from __future__ import annotations

import argparse
import os
import random
import statistics
import sys
import tempfile
import threading
import time
from collections import defaultdict
from contextlib import suppress
from pathlib import Path

import requests

sys.path.insert(0, str(Path(__file__).parents[1] / "validation" / "robustness"))
from web_api import served

PORT = 8765
ADDRESS = f"http://127.0.0.1:{PORT}"


class User(threading.Thread):
    """One user, with a session and a value of the meteorological range of its own."""

    def __init__(self, number: int, end: float, think: float, charts: bool):
        super().__init__(daemon=True)
        self.number, self.end, self.think, self.charts = number, end, think, charts
        self.times: dict[str, list[float]] = defaultdict(list)
        self.errors: list[str] = []

    def timed(self, kind: str, method: str, path: str, status: int | None = None, **more: object) -> requests.Response:
        """A request, its time noted; ``status`` where another than success is due."""
        start = time.perf_counter()
        answer = self.session.request(method, ADDRESS + path, timeout=60, **more)  # type: ignore[arg-type]
        self.times[kind].append(time.perf_counter() - start)
        if answer.status_code >= 400 if status is None else answer.status_code != status:
            self.errors.append(f"{answer.status_code} {method} {path}: {answer.text[:200]}")
        return answer

    def run(self) -> None:
        """Work until the end; a user whose request is not answered gives up."""
        try:
            self.work()
        except requests.RequestException as error:
            self.errors.append(f"given up: {error}")

    def work(self) -> None:
        """Page, prediction, result, charts, again and again."""
        chance = random.Random(self.number)  # noqa: S311 - when people click is no secret
        self.session = requests.Session()
        time.sleep(chance.uniform(0.0, 2.0 * self.think))
        round_ = 0
        while time.monotonic() < self.end:
            self.timed("page", "GET", "/predict?scenario=yellow-planks-asphalt")
            time.sleep(chance.uniform(0.5, 1.5) * self.think)
            title = f"user {self.number} round {round_}"
            wrong = {"name": "yellow-planks-asphalt", "settings": {"processing.samples": 10**9}}
            self.timed("refusal", "POST", "/api/v1/predictions", 422, json=wrong)
            order = {"name": "yellow-planks-asphalt", "settings": {
                "title": title, "scene.classes.asphalt.gain": 1.0 + self.number / 100 + round_ / 1000}}  # fmt: skip
            run = self.timed("prediction", "POST", "/api/v1/predictions", json=order).json()
            round_ += 1
            if run.get("state") != "finished":
                self.errors.append(f"prediction: {run}")
                continue
            shown = self.timed("result", "GET", f"/runs/{run['id']}").text
            if title not in shown:
                self.errors.append(f"a result of another: {title}")
            if self.charts:
                self.timed("charts", "GET", f"/api/v1/runs/{run['id']}/charts")
            time.sleep(chance.uniform(0.5, 1.5) * self.think)


def processor_seconds(session: int) -> float:
    """What the processes of a session have used: workers are no children of the server."""
    ticks = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            if os.getsid(int(path.parent.name)) == session:
                ticks += sum(map(int, path.read_text().rpartition(")")[2].split()[11:13]))
    return ticks / os.sysconf("SC_CLK_TCK")


def main() -> int:
    """Run, and tell."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--users", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--think", type=float, default=5.0, help="mean time between a user's clicks [s]")
    parser.add_argument("--no-charts", action="store_true", help="results and their numbers alone")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, served(PORT, Path(folder) / "web", "--queue", "200") as server:
        warm()
        end = time.monotonic() + options.seconds
        users = [User(number, end, options.think, not options.no_charts) for number in range(options.users)]
        for user in users:
            user.start()
        for user in users:
            user.join(options.seconds + 120.0)
        used = processor_seconds(server.pid)
    rounds = sum(len(user.times["result"]) for user in users)
    seconds = used / max(1, rounds)
    print(f"processor time of the server and its workers: {seconds:.2f} s a round, their start included")
    for kind in ("page", "refusal", "prediction", "result", "charts"):
        times = sorted(t for user in users for t in user.times[kind])
        if times:
            at95 = times[min(int(0.95 * len(times)), len(times) - 1)]
            middle = statistics.median(times)
            print(f"{kind}: {len(times)}, median {middle:.3f} s, 95 % {at95:.3f} s, at most {times[-1]:.2f} s")
    errors = [text for user in users for text in user.errors]
    print(f"errors: {len(errors)}", *errors[:5], sep="\n  ")
    return 1 if errors else 0


def warm() -> None:
    """Ask both workers once, and tell how long one prediction takes."""
    session = requests.Session()
    times = []
    for number in range(24):
        start = time.perf_counter()
        url = f"{ADDRESS}/api/v1/predictions?wait=60"
        run = session.post(url, json={"name": "yellow-planks-asphalt"}, timeout=90).json()
        times.append(time.perf_counter() - start)
        if number < 4:
            session.get(f"{ADDRESS}/api/v1/runs/{run['id']}/charts", timeout=90)
    print(f"one prediction alone, warm: median {statistics.median(times[4:]):.3f} s of 20")
    start = time.perf_counter()
    requests.get(ADDRESS, timeout=30)
    print(f"first page: {time.perf_counter() - start:.3f} s")


if __name__ == "__main__":
    sys.exit(main())
