"""A server of the whole application for tests, a thread in place of its processes."""

import queue
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import requests
import uvicorn
import yaml

from hyperval import web
from hyperval.progress import set_listener

REFUSED, ORDERED = (
    yaml.safe_load((Path(__file__).parent / f"{name}.yaml").read_text("utf-8")) for name in ("refused", "ordered")
)


class Crew:
    """A thread in place of the processes."""

    def __init__(self, most: int = 64):
        self.waiting: queue.Queue[web.WorkerTask | None] = queue.Queue(most)
        self.gate = threading.Event()
        self.gate.set()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def submit(self, job: web.WorkerTask) -> web.WorkerTask:
        try:
            self.waiting.put_nowait(job)
        except queue.Full:
            raise web.Full from None
        return job

    def close(self) -> None:
        self.gate.set()
        self.waiting.put(None)
        self._thread.join(20.0)

    def _run(self) -> None:
        while (job := self.waiting.get()) is not None:
            self.gate.wait(30.0)
            if job.is_cancelled:
                job.future.set_exception(web.Cancelled("cancelled before it began"))
                continue
            job.started = time.monotonic()
            set_listener(lambda what, done, total, job=job: self._report(job, what, done, total))
            try:
                job.future.set_result(web.perform_task(web.TASKS, job.task, job.arguments))
            except web.TaskFailed as error:
                job.future.set_exception(error)
            finally:
                set_listener(None)

    @staticmethod
    def _report(job: web.WorkerTask, what: str, done: int, total: int | None) -> None:
        job.progress = (what, done, total)
        if job.is_cancelled:
            raise web.Cancelled("cancelled")


@dataclass
class Server:
    """A running server."""

    address: str
    app: Any
    quick: Crew
    long: Crew
    folder: Path

    def session(self) -> requests.Session:
        """A program's session with its cookie."""
        own = requests.Session()
        own.get(f"{self.address}/api/v1/sensors", timeout=20)
        return own


def finished(server: Server, client: requests.Session, run: dict[str, Any]) -> dict[str, Any]:
    """What is told of a run when it has finished, within ten minutes of a busy machine."""
    for _ in range(10):
        run = client.get(f"{server.address}/api/v1/runs/{run['id']}", params={"wait": 60}).json()
    assert run["state"] == "finished", run
    return run


def serve(folder: Path, campaigns: Path | None = None, data: Path | None = None, **limits: Any) -> Iterator[Server]:
    quick, long = Crew(limits.get("queue", 64)), Crew(limits.get("queue", 64))
    app = web.make_app(web.ServerSettings(folder, campaigns, data, **limits), (quick, long))
    config = uvicorn.Config(
        app, host="127.0.0.1", port=0, log_level="error", server_header=False, ws="none", http=web.connection_class(256)
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    port = server.servers[0].sockets[0].getsockname()[1]
    yield Server(f"http://127.0.0.1:{port}", app, quick, long, folder)
    server.should_exit = True
    thread.join(20.0)
