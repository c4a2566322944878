"""Damaged files through every reader: python validation/robustness/mutation_study.py --mutants 1000000 -o FOLDER

Each batch runs in a process of its own with limits of memory and time, so that a crash, a hang or a reader that
takes all memory costs one mutant and is counted.  What is done is kept in FOLDER: the same command goes on there.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from mutants import mutant
from samples import ImplausibleError, Sample, samples

from hyperval.errors import HypervalError
from hyperval.storage import write_text

BATCH = 2000
MEMORY_BYTES = 1 << 30  # beyond what the process has at its start
SECONDS = 10  # one mutant; a reader written by hand needs a thousandth of it
HANG_SECONDS = 60  # in a library that no signal ends
# What may come of a damaged file, and what may not.
READ, REFUSED, UNFORESEEN = "read", "refused", "refused by the wrapper alone"
DEFECTS = ("internal error", "implausible", "out of memory", "too long", "crash", "hang")
OUTCOMES = (READ, REFUSED, UNFORESEEN, *DEFECTS)
ENDED = ("hang", "crash")  # of these the process ends
_EXAMPLES = 20


class TooLong(BaseException):
    """Not an Exception, so that no reader takes it for damage."""


def outcome(sample: Sample, folder: Path) -> tuple[str, str]:
    """What comes of reading the folder as it stands, and words on it."""
    try:
        sample.read_in(folder)
        return READ, ""
    except HypervalError as error:
        if isinstance(error.__cause__, MemoryError):
            return "out of memory", str(error)
        if error.exit_code not in (2, 3):
            return "internal error", str(error)
        unforeseen = "damaged, or not of the kind that its name says" in str(error)
        return (UNFORESEEN if unforeseen else REFUSED), str(error)
    except ImplausibleError as error:
        return "implausible", str(error)
    except MemoryError as error:
        return "out of memory", str(error)
    except TooLong:
        return "too long", ""
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return "internal error", f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"


def nothing() -> dict[str, Any]:
    """No outcome yet: how many of each, some defects with the mutant's number, and errors that no reader foresaw."""
    return {"counts": {}, "examples": [], "unforeseen": {}}


def batch(sample: Sample, numbers: range) -> dict[str, Any]:
    """Outcomes of the mutants of these numbers, read in a process with limits, in another one behind what ended it."""
    total, place = nothing(), "/dev/shm" if Path("/dev/shm").is_dir() else None  # noqa: S108 - memory in place of a disk
    processes: Any = multiprocessing.get_context("fork")  # a sample holds functions, which no pipe carries
    while numbers:
        told, tell = processes.Pipe(duplex=False)
        with tempfile.TemporaryDirectory(dir=place) as name, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            child = processes.Process(target=_in_child, args=(sample, numbers, Path(name), tell))
            child.start()
            tell.close()
            found = READ
            while numbers and found not in ENDED:
                try:
                    if not told.poll(HANG_SECONDS):
                        child.kill()
                    found, words = told.recv()
                except EOFError:
                    child.join()
                    found, words = ENDED[child.exitcode != -signal.SIGKILL], f"exit code {child.exitcode}"
                _count(total, numbers[0], found, words)
                numbers = numbers[1:]
            child.join()
    return total


def _in_child(sample: Sample, numbers: range, folder: Path, tell: Connection) -> None:
    """Tell the outcome of one mutant after the other."""

    def stop(*_: object) -> None:
        raise TooLong

    signal.signal(signal.SIGALRM, stop)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # HDF5 and GDAL print
    held = int(Path("/proc/self/statm").read_text("ascii").split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (held + MEMORY_BYTES,) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    (damaged, content), *others = sample.files.items()
    for name, raw in others:
        (folder / name).write_bytes(raw)
    for number in numbers:
        (folder / damaged).write_bytes(mutant(content, sample.name, number))
        signal.alarm(SECONDS)
        try:
            found = outcome(sample, folder)
        except TooLong:
            found = "too long", ""
        finally:
            signal.alarm(0)
        tell.send(found)


def _count(total: dict[str, Any], number: int, found: str, words: str) -> None:
    total["counts"][found] = total["counts"].get(found, 0) + 1
    if found in DEFECTS and len(total["examples"]) < _EXAMPLES:
        total["examples"].append([number, found, words[:300]])
    if found == UNFORESEEN:
        total["unforeseen"].setdefault(words.rpartition("(")[2][:80], number)


def _add(total: dict[str, Any], more: dict[str, Any]) -> None:
    total["counts"] = dict(Counter(total["counts"]) + Counter(more["counts"]))
    total["examples"] = (total["examples"] + more["examples"])[:_EXAMPLES]
    total["unforeseen"] = {**more["unforeseen"], **total["unforeseen"]}


def table(done: dict[str, Any]) -> str:
    """The outcomes of every sample, as a table of Markdown."""
    lines = ["| sample | mutants | " + " | ".join(OUTCOMES) + " |", "| --- |" + " ---: |" * (len(OUTCOMES) + 1)]
    every: Counter[str] = Counter()
    for name, found in done.items():
        every.update(found["counts"])
        lines.append(_line(name, found["counts"]))
    return "\n".join([*lines, _line("all", every)]) + "\n"


def _line(name: str, counts: dict[str, int]) -> str:
    numbers = [sum(counts.values()), *(counts.get(o, 0) for o in OUTCOMES)]
    return f"| {name} | " + " | ".join(f"{n:,}" for n in numbers) + " |"


def main() -> int:
    """Run what is left of the mutants; exit code 1 where one shows a defect."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mutants", type=int, default=1_000_000, help="of all samples together")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--only", default="", help="samples whose name holds this")
    options = parser.parse_args()
    state = options.output / "outcomes.json"
    done: dict[str, Any] = json.loads(state.read_text()) if state.is_file() else {}
    options.output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        listed = samples(Path(folder))
    weight = sum(s.share for s in listed)
    for sample in (s for s in listed if options.only in s.name):
        most = round(options.mutants * sample.share / weight)
        found = done.setdefault(sample.name, nothing())
        while (first := sum(found["counts"].values())) < most:
            _add(found, batch(sample, range(first, min(first + BATCH, most))))
            write_text(state, json.dumps(done, indent=1) + "\n")
        print(_line(sample.name, found["counts"]), flush=True)
    write_text(options.output / "outcomes.md", table(done))
    bad = [(name, example) for name, found in done.items() for example in found["examples"]]
    for name, (number, what, words) in bad:
        print(f"{name}, mutant {number}: {what}: {words}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
