"""A small synthetic collection, in reflectance or in radiance."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_world import BACKGROUND, BANDS, PLANTED, TARGET, RadianceWorld, World, reflectances, target_rows


@pytest.fixture
def world(tmp_path: Path) -> World:
    """A reflectance cube with a region and five targets of two groups, ready to observe."""
    made = World(tmp_path, reflectances())
    made.write()
    made.library("library.csv", ("paint", TARGET), ("ground", BACKGROUND))
    made.text("targets.csv", target_rows(PLANTED))
    made.collection = {
        "cube": {"path": "cube.img", "quantity": "reflectance"},
        "regions": [{"name": "corner", "rectangle": [35, 5, 10, 20]}],
        "targets": {"csv": "targets.csv", "guard_pixels": 1},
    }
    made.detection = {
        "targets": [{"name": "paint", "material": "paint", "spectrum": made.source("library.csv", "paint")}],
        "group": "{group}",
    }
    return made


@pytest.fixture
def make_radiance(world: World) -> Callable[..., RadianceWorld]:
    """Turn the world into radiance L = offset + gain rho with two flat panels of known reflectance."""

    def make(relative_noise: float = 0.0) -> RadianceWorld:
        gain, offset = np.linspace(20.0, 5.0, BANDS), np.linspace(2.0, 0.1, BANDS)
        scene = world.values.copy()
        scene[0:4, 30:34] = 0.60
        scene[0:4, 36:40] = 0.05
        noise = np.random.default_rng(8).standard_normal(scene.shape)
        world.write((offset + gain * scene) * (1.0 + relative_noise * noise))
        world.text("panels.csv", "wavelength_nm,white,black\n" + "".join(
            f"{w},0.6,0.05\n" for w in range(400, 1701)
        ))  # fmt: skip
        world.collection["cube"] |= {"quantity": "radiance", "unit": "uW cm-2 sr-1 nm-1"}
        world.collection["regions"] += [
            {"name": "white", "rectangle": [0, 30, 4, 4]}, {"name": "black", "rectangle": [0, 36, 4, 4]},
        ]  # fmt: skip
        world.collection["leave_out"] = ["white", "black"]
        world.collection["empirical_line"] = {
            "panels": [{"region": n, "spectrum": world.source("panels.csv", n)} for n in ("white", "black")]
        }
        return RadianceWorld(world, gain, offset, scene)

    return make
