"""What the fast tests of the rooms of formulas reach: python validation/robustness/room_coverage.py [--missing]

Exit code 1 where it is below 95 % of a room's lines and branches together.  Each folder of tests runs in a process
of its own, as many at a time as there are processors.  --room takes some rooms, and their own tests alone.
--output keeps what each test reached in FOLDER/data, for code_mutants.py.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from reach import ROOMS

ROOT = Path(__file__).parents[2]
AIM = 0.95
# What runs whole campaigns is left out: it passes through every line and looks at few.
OTHER_TESTS = (
    "tests/test_predict*.py",
    "tests/test_scenario.py",
    "tests/imagery/test_imagery_interchange.py",
    "tests/study/test_study_columns.py",
    "validation/equations",
)
COUNTS = ("covered_lines", "num_statements", "covered_branches", "num_branches")


def tests_of(rooms: Sequence[str]) -> list[list[str]]:
    """Files and folders of tests, those of one process each."""
    out = [[str(ROOT / "tests" / room)] for room in rooms]
    if set(rooms) == set(ROOMS):
        out.append([str(path) for pattern in OTHER_TESTS for path in sorted(ROOT.glob(pattern))])
    return out


def measure(tests: Sequence[str], folder: Path) -> int:
    """Run tests, and leave what they reach in ``folder``; pytest's exit code."""
    done = subprocess.run(  # noqa: S603 - the project's own tests
        [sys.executable, str(Path(__file__).with_name("reach.py")), str(folder / "data"), *tests],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        print(done.stdout[-3000:], done.stderr[-1000:])
    return done.returncode


def report(folder: Path) -> dict[str, Any]:
    """Coverage of every file, as coverage.py writes it."""
    environment = os.environ | {"COVERAGE_FILE": str(folder / "data")}
    for words in (["combine", "-q", str(folder)], ["json", "-q", "-o", str(folder / "all.json")]):
        command = [sys.executable, "-m", "coverage", *words]
        subprocess.run(command, env=environment, cwd=ROOT, check=True)  # noqa: S603 - as above
    found: dict[str, Any] = json.loads((folder / "all.json").read_text("utf-8"))
    return found


def main() -> int:
    """Print the table, and where asked for every line and branch that is not reached."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--room", choices=ROOMS, action="append")
    parser.add_argument("--missing", action="store_true", help="name lines and branches that are not reached")
    parser.add_argument("-o", "--output", type=Path, help="an empty folder, which keeps the data")
    options = parser.parse_args()
    rooms = options.room or ROOMS
    with tempfile.TemporaryDirectory() as name:
        folder = options.output or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            codes = list(pool.map(lambda tests: measure(tests, folder), tests_of(rooms)))
        files = report(folder)["files"]
    print("| room | lines | branches | both |\n| --- | ---: | ---: | ---: |")
    low = 0
    for room in rooms:
        total: Counter[str] = Counter()
        for path, entry in files.items():
            if Path(path).is_relative_to(f"src/hyperval/{room}"):
                total.update({key: entry["summary"][key] for key in COUNTS})
        lines, of_lines, branches, of_branches = (total[key] for key in COUNTS)
        both = (lines + branches) / (of_lines + of_branches)
        low += both < AIM
        print(f"| `{room}` | {lines / of_lines:.1%} | {branches / of_branches:.1%} | {both:.1%} |")
    for path, entry in files.items() if options.missing else ():
        if Path(path).parts[2] in rooms and (entry["missing_lines"] or entry["missing_branches"]):
            print(f"{path}: lines {entry['missing_lines']}, branches {entry['missing_branches']}")
    return 1 if low or any(codes) else 0


if __name__ == "__main__":
    sys.exit(main())
