"""Damaged files through every reader: python validation/robustness/mutation_study.py --mutants 1000000 -o FOLDER

Each batch runs in a process of its own with limits of memory and time, so that a crash, a hang or a reader that
takes all memory costs one mutant and is counted.  What is done is kept in FOLDER: the same command goes on there.
"""

from __future__ import annotations

import argparse
import json
import mmap
import os
import resource
import signal
import struct
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Sequence
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
_EXAMPLES = 20


class TooLong(BaseException):
    """Not an Exception, so that no reader takes it for damage."""


def outcome(sample: Sample, folder: Path) -> tuple[str, str]:
    """What comes of reading the folder as it stands, and words on it."""
    try:
        sample.read(folder)
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


def run_batch(sample: Sample, numbers: Sequence[int], folder: Path, started: Any = None) -> dict[str, Any]:
    """Outcomes of the mutants of these numbers, in this process; ``started`` learns the number at hand."""
    counts: Counter[str] = Counter()
    examples: list[list[Any]] = []
    unforeseen: dict[str, int] = {}
    (damaged, content), *others = sample.files.items()
    for name, raw in others:
        (folder / name).write_bytes(raw)
    for number in numbers:
        if started is not None:
            started[:8] = struct.pack("<q", number)
        (folder / damaged).write_bytes(mutant(content, sample.name, number))
        signal.alarm(SECONDS)
        try:
            found, words = outcome(sample, folder)
        except TooLong:
            found, words = "too long", ""
        finally:
            signal.alarm(0)
        counts[found] += 1
        if found in DEFECTS and len(examples) < _EXAMPLES:
            examples.append([number, found, words[:300]])
        if found == UNFORESEEN:
            unforeseen.setdefault(words.rpartition("(")[2][:80], number)
    return {"counts": dict(counts), "examples": examples, "unforeseen": unforeseen}


def batch(sample: Sample, numbers: range) -> dict[str, Any]:
    """The same in a process with limits, and again behind a mutant that ended it."""
    total: dict[str, Any] = {"counts": {}, "examples": [], "unforeseen": {}}
    first = numbers.start
    while first < numbers.stop:
        first = _guarded(sample, range(first, numbers.stop), total)
    return total


def _guarded(sample: Sample, numbers: range, total: dict[str, Any]) -> int:
    place = "/dev/shm" if Path("/dev/shm").is_dir() else None  # noqa: S108 - memory in place of a disk
    with tempfile.TemporaryDirectory(dir=place) as name, mmap.mmap(-1, 8) as started:
        folder = Path(name)
        (folder / "in").mkdir()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            child = os.fork()
        if child == 0:
            _in_child(sample, numbers, folder, started)
        status = _waited(child, started)
        out = folder / "out.json"
        if out.is_file():
            _add(total, json.loads(out.read_text()))
            return numbers.stop
        # What came before the last mutant is counted by running it again without that one.
        (last,) = struct.unpack("<q", started[:8])
    if last > numbers.start:
        _guarded(sample, range(numbers.start, last), total)
    found = "hang" if status == signal.SIGKILL else "crash"
    _add(total, {"counts": {found: 1}, "examples": [[last, found, f"signal {status}"]], "unforeseen": {}})
    return last + 1


def _in_child(sample: Sample, numbers: range, folder: Path, started: Any) -> None:
    code = 1
    try:

        def stop(*_: object) -> None:
            raise TooLong

        signal.signal(signal.SIGALRM, stop)
        sink = os.open(os.devnull, os.O_WRONLY)
        os.dup2(sink, 2)  # HDF5 and GDAL print
        with open("/proc/self/statm", encoding="ascii") as stream:
            held = int(stream.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (held + MEMORY_BYTES,) * 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        warnings.simplefilter("ignore")
        text = json.dumps(run_batch(sample, numbers, folder / "in", started))
        (folder / "half").write_text(text)
        os.replace(folder / "half", folder / "out.json")
        code = 0
    finally:
        os._exit(code)


def _waited(child: int, started: Any) -> int:
    """The signal that ended the child, 0 where it ended by itself; killed when one mutant takes too long."""
    at, since = b"", time.monotonic()
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
        if started[:8] != at:
            at, since = started[:8], time.monotonic()
        elif time.monotonic() - since > HANG_SECONDS:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.02)


def _add(total: dict[str, Any], more: dict[str, Any]) -> None:
    for key, count in more["counts"].items():
        total["counts"][key] = total["counts"].get(key, 0) + count
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
        found = done.setdefault(sample.name, {"counts": {}, "examples": [], "unforeseen": {}})
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
