"""What changed since another commit, as one table: size, walks, times, and the accepted numbers.

python scripts/regression.py origin/main                    # some five minutes; HYPERVAL_DATA for real collections
python scripts/regression.py v0.3.0 --skip validate         # without the campaigns

Both commits are run by this checkout's environment, one after the other on the same machine, each time the better
of two runs.  Run it with nothing beside it.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lines_of_code import measured

ROOT = Path(__file__).resolve().parents[1]
SIZES = ("all.lines", "all.files", "all.classes", "all.class_names_used_twice", "tests.lines", "tests.inner_imports",
         "validation.lines", "docs.words")  # fmt: skip
WALKS = ("yellow-planks-asphalt", "panels")
HYPERVAL = "from hyperval.cli import main; main()"


def run(root: Path, *arguments: str | Path) -> tuple[str, float]:
    """What Python prints with the package of ``root``, and the wall time [s]."""
    environment = os.environ | {"PYTHONPATH": str(root / "src"), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    start = time.perf_counter()
    done = subprocess.run(  # noqa: S603
        [sys.executable, *map(str, arguments)], cwd=root, env=environment, capture_output=True, text=True, check=False
    )
    return done.stdout + done.stderr, time.perf_counter() - start


def timed(root: Path, *arguments: str | Path) -> str:
    """The better wall time of two."""
    return f"{min(run(root, *arguments)[1] for _ in range(2)):.2f} s"


def walk(root: Path, scenario: str) -> str:
    """Modules and returns of a prediction."""
    found = re.search(r"\d+ modules, \d+ returns", run(root, "scripts/walk.py", scenario)[0])
    return found[0] if found else "-"


def detection(root: Path) -> str:
    """How long a detection takes beside a bare read of the file and beside SPy."""
    text, _ = run(root, "benchmarks/detect_speed.py", "--lines", "1000", "--long-lines", "1200")
    found = [re.search(pattern, text) for pattern in (r"ours .* ([\d.]+) x floor", r"SPy .* ([\d.]+) x ours")]
    return "{} x floor, SPy {} x".format(*(f[1] if f else "-" for f in found))


def campaigns(root: Path, scratch: Path) -> Iterator[tuple[str, str]]:
    """Time of all campaigns, what they found, and how many numbers are as accepted."""
    files = sorted(root.glob("campaigns/*/campaign*.yaml"))
    report = scratch / f"{root.name}-validate"
    text, seconds = run(root, "-c", HYPERVAL, "validate", *files, "-o", report)
    yield "validate", f"{seconds:.0f} s"
    found = re.search(r"acceptance criteria: (.*)", text)
    yield "acceptance criteria", found[1] if found else "-"
    text, _ = run(root, "-c", HYPERVAL, "check", *files, "--sensors", "all", "--from", report)
    moved = sum(int(m) for m in re.findall(r": (\d+) of \d+ numbers are not as accepted", text))
    same = sum(int(m) for m in re.findall(r": (\d+) numbers as accepted", text))
    yield "check", f"{same} numbers as accepted, {moved} not"


def rows(root: Path, scratch: Path, skip: set[str]) -> Iterator[tuple[str, str]]:
    """Every figure of a checkout."""
    counts = measured(root)
    yield from ((name, f"{counts[name]:,}") for name in SIZES)
    if "walk" not in skip:
        yield from ((f"walk {name}", walk(root, name)) for name in WALKS)
    if "predict" not in skip:
        yield "predict panels", timed(root, "-c", HYPERVAL, "-q", "predict", "panels", "-o", scratch / f"{root.name}-p")
        yield "--help", timed(root, "-c", HYPERVAL, "--help")
    if "detect_speed" not in skip:
        yield "detect_speed", detection(root)
    if "validate" not in skip:
        yield from campaigns(root, scratch)


@contextmanager
def checkout(commit: str, folder: Path) -> Iterator[Path]:
    """A commit in a folder of its own."""
    git = ["git", "-C", str(ROOT), "worktree"]
    subprocess.run([*git, "add", "-q", "--detach", folder, commit], check=True)  # noqa: S603
    try:
        yield folder
    finally:
        subprocess.run([*git, "remove", "--force", folder], check=True)  # noqa: S603


def main() -> None:
    """Print the table, in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commit", help="what to compare this checkout with")
    parser.add_argument("--skip", default="", help="of walk, predict, detect_speed, validate, with commas between")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, checkout(options.commit, Path(name) / "before") as before:
        skip = set(options.skip.split(","))
        old, new = (dict(rows(root, Path(name), skip)) for root in (before, ROOT))
    print(f"| | {options.commit} | this checkout |\n| --- | --- | --- |")
    for key, value in new.items():
        print(f"| {key} | {old.get(key, '-')} | {value} |")


if __name__ == "__main__":
    main()
