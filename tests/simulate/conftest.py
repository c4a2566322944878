"""A small scene and what it needs: see ``small_scene``."""

from __future__ import annotations

import pytest
from small_scene import LEVELS, numbers, small_scene, surface, terms

from hyperval.data import ClassStatistics
from hyperval.simulate import SceneFile, SimulationInputs


@pytest.fixture
def scene() -> SceneFile:
    return small_scene()


@pytest.fixture
def classes() -> dict[str, ClassStatistics]:
    return {name: surface(name, *level) for name, level in LEVELS.items()}


@pytest.fixture
def inputs(classes: dict[str, ClassStatistics]) -> SimulationInputs:
    return SimulationInputs(numbers(), terms(), classes)
