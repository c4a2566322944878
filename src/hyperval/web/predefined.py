"""Scenarios that go by name: those of the package, and scenes of public collections where their files are here."""

from __future__ import annotations

from functools import lru_cache
from importlib import resources

from hyperval.datasets import resolve
from hyperval.errors import HypervalError
from hyperval.scenario import Scenario, builtin_scenarios, load_scenario


@lru_cache(maxsize=1)
def predefined() -> dict[str, Scenario]:
    """Scenarios by name."""
    known = {name: load_scenario(name) for name in builtin_scenarios()}
    with resources.as_file(resources.files("hyperval.web") / "scenarios") as folder:
        scenes = [load_scenario(path) for path in sorted(folder.glob("*.yaml"))]
    return known | {scene.name: scene for scene in scenes}


@lru_cache(maxsize=1)
def known_files() -> frozenset[str]:
    """Files of data sets that the predefined scenarios name, and that anybody may name therefore."""
    return frozenset(
        surface.spectrum.file
        for scenario in predefined().values()
        for surface in scenario.scene.targets
        if surface.spectrum.file is not None
    )


def is_here(file: str) -> bool:
    """Whether a file of a data set is on this machine."""
    try:
        resolve(file)
    except HypervalError:
        return False
    return True


def set_of(file: str) -> str:
    """The data set of a file."""
    return file.removeprefix("data:").partition("/")[0]


def needs(scenario: Scenario) -> str:
    """The data set that is missing on this machine for a predefined scenario; empty where there is none."""
    files = [t.spectrum.file for t in scenario.scene.targets if t.spectrum.file is not None]
    missing = {set_of(file) for file in files if not is_here(file)}
    return ", ".join(sorted(missing))
