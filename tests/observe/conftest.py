"""A small synthetic collection, in reflectance or in radiance."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_world import (
    AXIS,
    BACKGROUND,
    BANDS,
    PLANTED,
    TARGET,
    UNIT,
    RadianceWorld,
    World,
    background_spread,
    reflectances,
    target_rows,
)


@pytest.fixture
def world(tmp_path: Path) -> World:
    """A reflectance cube with a region and five targets of two groups, ready to observe."""
    made = World(tmp_path, reflectances())
    made.write()
    made.library("library.csv", paint=TARGET, ground=BACKGROUND)
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
def make_field(world: World) -> Callable[..., World]:
    """Turn the world into one region ``all``, by default drawn pixels (lines, samples) of a t law, without targets."""

    def make(values: np.ndarray | None = None, dof: float = np.inf, shape: tuple[int, int] = (60, 60)) -> World:
        if values is None:
            rng = np.random.default_rng(3)
            z = rng.multivariate_normal(np.zeros(BANDS), background_spread(), shape)
            if np.isfinite(dof):
                z *= np.sqrt((dof - 2) / rng.chisquare(dof, shape))[..., None]
            values = 0.3 + z
        world.write(values)
        world.detection, world.collection["targets"] = None, None
        world.regions(all=[0, 0, *values.shape[:2]])
        return world

    return make


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
        world.library("panels.csv", white=0.6, black=0.05)
        world.collection["cube"] |= UNIT
        world.regions(corner=[35, 5, 10, 20], white=[0, 30, 4, 4], black=[0, 36, 4, 4])
        world.collection["leave_out"] = ["white", "black"]
        world.collection["empirical_line"] = {
            "panels": [{"region": n, "spectrum": world.source("panels.csv", n)} for n in ("white", "black")]
        }
        return RadianceWorld(world, gain, offset, scene)

    return make


@pytest.fixture
def sites(tmp_path: Path) -> World:
    """Collected spectra of sites: two of one flight line and one of another, without an error; see the constants."""
    made = World(tmp_path, np.empty(0))
    made.text("bands.txt", "# centre width\n" + "".join(f"{w / 1000:.5f} 0.0020\n" for w in AXIS.centre_nm))
    made.collection = {
        "spectra": [],
        "bands": {"path": "bands.txt", "wavelength_unit": "um", "centre_column": 0, "fwhm_column": 1},
        "calibration": {"relative": 0.02},
    }
    return made
