"""Start of a command, a whole prediction and the page of a campaign, beside another version in the same run.

    python benchmarks/page_speed.py OTHER               # OTHER: a checkout of the version to compare with
    python benchmarks/page_speed.py OTHER --campaigns   # `hyperval validate` of every campaign that both have

Each is a process of its own, of which the processor time counts (user and system, with its children): what a person
waits for on a quiet machine, whatever else runs here.  The two versions alternate and the least of ROUNDS counts,
after one round that fills their caches.  Of campaigns one round counts, with the user's cache of the atmosphere:
run it twice where that is not warm.  The page is that of the tests' made-up campaign: 8 subjects, 360 bands.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

ROUNDS = 3
ROOT = Path(__file__).resolve().parents[1]
COMMAND = "import sys; from hyperval.cli import main; sys.argv[0] = 'hyperval'; main()"
PAGE = """
import sys; sys.path.insert(0, sys.argv[1] + "/tests/report")
from pathlib import Path
from synthetic_run import make_run
from hyperval.report import write_outputs
write_outputs(make_run(subjects=[f"surface {i}" for i in range(8)], bands=360, curves=6), Path(sys.argv[2]))
"""


def processor_time(source: Path, folder: str, words: list[str], exits: tuple[int, ...] = (0,)) -> float:
    """Seconds that a process of one version takes, which ends with one of ``exits``."""
    environment = {
        **os.environ, "PYTHONPATH": str(source / "src"),
        "PYTHONPYCACHEPREFIX": f"{folder}/code-{source.name}", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1",
    }  # fmt: skip
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    if "validate" not in words:
        environment["HYPERVAL_CACHE"] = f"{folder}/cache-{source.name}"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-c", *words]  # of this file, and two checkouts that the user names
    done = subprocess.run(command, env=environment, check=False, capture_output=True, cwd=source)  # noqa: S603
    if done.returncode not in exits:
        sys.exit(done.stderr.decode())
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def campaigns(versions: list[Path], folder: str) -> None:
    """Print the processor times of the campaigns that both versions have, and of all together."""
    files = [sorted(str(f.relative_to(v)) for f in v.glob("campaigns/*/campaign*.yaml")) for v in versions]
    both, total = [f for f in files[0] if f in files[1]], [0.0, 0.0]
    for v in versions:  # compiles what both have in common
        processor_time(v, folder, [COMMAND, "predict", "panels", "-o", f"{folder}/{v.name}"])
    for file in both:
        # A gate that disagrees is a result, and so is a collection that is not here.
        now, before = times = [
            processor_time(v, folder, [COMMAND, "validate", file, "-o", f"{folder}/{v.name}-run"], (0, 1, 5))
            for v in versions
        ]
        total = [a + b for a, b in zip(total, times, strict=True)]
        print(f"| {file} | {before:.1f} | {now:.1f} | {now / before:.2f} |", flush=True)
    print(f"| all {len(both)} | {total[1]:.1f} | {total[0]:.1f} | {total[0] / total[1]:.2f} |")


def main() -> None:
    """Print the least processor times of both versions and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", type=Path, help="checkout of the version to compare with")
    parser.add_argument("--campaigns", action="store_true", help="every campaign, in place of start and page")
    options = parser.parse_args()
    versions = [ROOT, options.other.resolve()]
    with tempfile.TemporaryDirectory() as folder:
        print("| | before [s] | now [s] | ratio |\n| --- | ---: | ---: | ---: |")
        if options.campaigns:
            campaigns(versions, folder)
            return
        for name, words in (
            ("`hyperval --help`", [COMMAND, "--help"]),
            ("`hyperval predict panels`", [COMMAND, "predict", "panels", "-o", f"{folder}/panels"]),
            ("all files of a campaign's folder", [PAGE, "SOURCE", f"{folder}/page"]),
        ):
            Path(folder, "page").mkdir(exist_ok=True)
            rounds = [
                [processor_time(v, folder, [str(v) if w == "SOURCE" else w for w in words]) for v in versions]
                for _ in range(ROUNDS + 1)
            ]
            now, before = (min(times) for times in zip(*rounds[1:], strict=True))
            print(f"| {name} | {before:.2f} | {now:.2f} | {now / before:.2f} |")


if __name__ == "__main__":
    main()
