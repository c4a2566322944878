"""Ten thousand requests made from the API's description; the statuses that each operation gave.

    python validation/robustness/web_api.py [--examples 460] [--campaign FOLDER]

Needs Schemathesis, which the development set does not bring.  Of requests that are made to be right some name
what is there: runs of the session, files that they offer, bodies that are carried out; so every operation succeeds
sometimes.  Exit code 1 where an answer is not what the description says, a request that must be refused is taken,
or an operation never succeeded.
"""

from __future__ import annotations

import argparse
import atexit
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any

import requests

PLACE = "HYPERVAL_API_CASES"  # of the file by which this script and Schemathesis, which imports it, know each other
SHARE = 0.4  # of right requests that name what is there
STUDY = {
    "name": "fill", "scenario": "panels",
    "inputs": [{"name": "gain", "path": "scene.classes.0.gain", "values": [0.9, 1.0]}],
    "outputs": [{"name": "snr", "kind": "snr", "subject": "grass", "band_nm": 550}],
}  # fmt: skip


def hooks(shared: dict[str, Any]) -> None:
    """Let some requests name what is there, and count what is answered."""
    import schemathesis

    chance, counts = random.Random(18), Counter[str]()  # noqa: S311 - no secret
    sensor = (resources.files("hyperval.sensor") / "library" / "enmap.yaml").read_bytes()
    bodies: dict[str, tuple[int, dict[str, Any]]] = {  # how often at most; a campaign takes its time
        "/predictions": (10**9, {"json": {"name": "panels"}}),
        "/studies": (5, {"json": {"study": STUDY}}),
        "/validations": (1, {"json": {"campaign": shared["campaign"]}}),
        "/uploads": (50, {"files": [("spectra", ("a.csv", b"nm,a\n400,0.1\n500,0.2\n")),
                                    ("sensors", ("a.yaml", sensor))]}),
    }  # fmt: skip

    @schemathesis.hook
    def before_call(context: Any, case: Any, kwargs: dict[str, Any]) -> None:
        method, path = case.operation.method.upper(), case.operation.path.removeprefix("/api/v1")
        if case.meta is None or not case.meta.generation.mode.is_positive or chance.random() > SHARE:
            return
        if "run_id" in (case.path_parameters or {}):
            run = (_new_run(shared) if chance.random() < 0.1 else None) if method == "DELETE" else shared["run"]
            case.path_parameters["run_id"] = run or case.path_parameters["run_id"]
            if path.endswith("{name}"):
                case.path_parameters["name"] = chance.choice(("scenario.yaml", "results.csv", "figures/scores.svg"))
            (case.query or {}).pop("beside", None)
        elif "name" in (case.path_parameters or {}):
            case.path_parameters["name"] = chance.choice(("enmap", "prospectir-vs"))
        elif method == "POST" and path in bodies and counts[f"{path} body"] < bodies[path][0]:
            counts[f"{path} body"] += 1
            kwargs.update(bodies[path][1])

    @schemathesis.hook
    def after_call(context: Any, case: Any, response: Any) -> None:
        path = case.operation.path.removeprefix("/api/v1")
        counts[f"{case.operation.method.upper()} {path} -> {response.status_code}"] += 1

    atexit.register(lambda: Path(shared["counts"]).write_text(json.dumps(counts)))


def _new_run(shared: dict[str, Any]) -> str | None:
    headers = shared["headers"]
    answer = requests.post(f"{shared['api']}/predictions", json={"name": "panels"}, headers=headers, timeout=60)
    return str(answer.json()["id"]) if answer.status_code == 201 else None


def main() -> int:
    """Start a server, run the cases, and tell."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--examples", type=int, default=460, help="of each operation, besides those of its edges")
    parser.add_argument("--phases", default="coverage,fuzzing", help="of Schemathesis")
    parser.add_argument("--campaign", type=Path, help="folder of a campaign that may be run")
    parser.add_argument("--port", type=int, default=8766)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        words = [] if options.campaign is None else ["--campaigns", str(options.campaign.resolve().parent)]
        with served(options.port, folder / "web", "--queue", "1000", *words):
            return run(f"http://127.0.0.1:{options.port}/api/v1", folder, options)


@contextmanager
def served(port: int, folder: Path, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """A server of this machine that answers, in a session of its own, which ends behind its use."""
    command = [sys.executable, "-m", "hyperval", "serve", "--port", str(port), "--folder", str(folder), *words]
    server = subprocess.Popen(command, start_new_session=True)  # noqa: S603 - our own
    try:
        for _ in range(300):
            try:
                requests.get(f"http://127.0.0.1:{port}", timeout=60)
                break
            except requests.ConnectionError:
                time.sleep(0.2)
        if server.poll() is not None:
            sys.exit("the server ended")
        yield server
    finally:
        server.terminate()
        server.wait()


def run(api: str, folder: Path, options: argparse.Namespace) -> int:
    """Run the cases against a server."""
    session = requests.Session()
    session.get(f"{api}/sensors", timeout=60)
    cookie = "; ".join(f"{c.name}={c.value}" for c in session.cookies)
    headers = {"Cookie": cookie}
    order = session.post(f"{api}/predictions?wait=60", json={"name": "yellow-planks-asphalt"}, timeout=90).json()
    shared = {"api": api, "headers": headers, "run": order["id"], "counts": str(folder / "counts.json"),
             "campaign": options.campaign.name if options.campaign else "none"}  # fmt: skip
    (folder / "known.json").write_text(json.dumps(shared))
    (folder / "schemathesis.toml").write_text(
        "[checks.negative_data_rejection]\nexpected-statuses = [400, 403, 404, 405, 409, 413, 415, 422, 429, 503]\n"
    )
    environment = {PLACE: str(folder / "known.json"), "SCHEMATHESIS_HOOKS": str(Path(__file__).resolve())}
    words = [part for name, value in headers.items() for part in ("-H", f"{name}: {value}")]
    words += ["--max-examples", str(options.examples), "--seed", "18", "--continue-on-failure", "--no-color"]
    # A body may be of its form and be refused for what it says: a scenario whose fractions sum to 2.
    words += ["--request-timeout", "60", "--phases", options.phases, "--exclude-checks", "positive_data_acceptance"]
    start = [sys.executable, "-m", "schemathesis.cli", "run", f"{api}/openapi.json", *words]
    code = subprocess.run(start, env=os.environ | environment, check=False, cwd=folder).returncode  # noqa: S603 - our own
    counts = json.loads((folder / "counts.json").read_text())
    table: dict[str, dict[str, int]] = {}
    for what, count in counts.items():
        operation, arrow, status = what.partition(" -> ")
        if arrow:
            table.setdefault(operation, {})[status] = count
    for operation, statuses in sorted(table.items()):
        print(f"{operation:38}", ", ".join(f"{status}: {n}" for status, n in sorted(statuses.items())))
    never = [o for o, s in table.items() if not any(status.startswith("2") for status in s)]
    total = sum(sum(s.values()) for s in table.values())
    print(f"{total:,} requests; never carried out: {', '.join(never) or 'none'}")
    return 1 if code or never else 0


if PLACE in os.environ and __name__ != "__main__":
    hooks(json.loads(Path(os.environ[PLACE]).read_text()))
elif __name__ == "__main__":
    sys.exit(main())
