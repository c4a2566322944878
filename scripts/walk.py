"""How far one prediction, or one campaign's job, walks through the modules of the package.

python scripts/walk.py panels                                 # a scenario, by name or file
python scripts/walk.py campaigns/hysu-2018/campaign.yaml      # a campaign's job (its data have to be at hand)

Functions of the package are taken in the order in which they are called first.  Modules: how many of them the walk
enters.  Returns: how often it comes back to one that it has left.  What a first call only loads does not count: the
job runs once before it is watched.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType

import hyperval


def modules_in_order(work: Callable[[], object]) -> list[str]:
    """The module of each function that ``work`` calls, in the order of first calls, a module once in a row."""
    folder = str(Path(hyperval.__file__).parent)
    seen: dict[tuple[str, int, str], str] = {}

    def watch(frame: FrameType, event: str, argument: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(folder) and not code.co_name.startswith("<"):
            module = str(Path(code.co_filename).relative_to(folder).with_suffix("")).replace("/", ".")
            seen.setdefault((module, code.co_firstlineno, code.co_name), module)

    sys.setprofile(watch)
    try:
        work()
    finally:
        sys.setprofile(None)
    modules = list(seen.values())
    return [m for before, m in zip(["", *modules], modules, strict=False) if m != before]


def job(name: str) -> Callable[[], object]:
    """What is walked through."""
    if Path(name).name.startswith("campaign"):
        from hyperval.campaign import load_jobs, run_campaign

        return lambda: [run_campaign(one) for one in load_jobs(Path(name))]
    from hyperval.model import predict
    from hyperval.scenario import load_scenario

    scenario = load_scenario(name)
    return lambda: predict(scenario)


def main(names: list[str]) -> int:
    """Print modules and returns of each walk."""
    for name in names or ["panels"]:
        work = job(name)
        work()
        walk = modules_in_order(work)
        print(f"{name}: {len(set(walk))} modules, {len(walk) - len(set(walk))} returns")
        print("  " + " > ".join(walk))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
