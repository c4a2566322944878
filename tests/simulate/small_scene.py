"""A small scene on invented surfaces, atmosphere and sensor: nothing here depends on the model's rooms."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hyperval.atmosphere import AtmosphericTerms
from hyperval.sensor import NoiseModel
from hyperval.simulate import SceneFile, SimulationInputs
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import ClassStatistics

BANDS = 12
AXIS = SpectralAxis(np.linspace(450.0, 2200.0, BANDS), np.full(BANDS, 10.0))


def surface(name: str, level: float, spread: float) -> ClassStatistics:
    """A class with a sloped mean and a covariance of full rank with strong correlation between bands."""
    x = np.linspace(-1.0, 1.0, BANDS)
    modes = np.stack([np.ones(BANDS), x, x**2 - 0.3]) * np.array([[1.0], [0.4], [0.3]]) * spread
    covariance = modes.T @ modes + (0.2 * spread) ** 2 * np.eye(BANDS)
    return ClassStatistics(name, AXIS, level * (1.0 + 0.3 * x), covariance)


LEVELS = {
    "grass": (0.30, 0.02), "asphalt": (0.12, 0.008), "soil": (0.25, 0.02), "yellow-paint-plank": (0.45, 0.02),
    "white-panel": (0.60, 0.004),
}  # fmt: skip
CLASSES = {name: surface(name, *level) for name, level in LEVELS.items()}


def terms() -> AtmosphericTerms:
    """Terms of plausible size that fall with wavelength."""
    fall, one = (500.0 / AXIS.centre_nm) ** 2, np.ones(BANDS)
    parts = 2.0 * fall**2, 40.0 * fall, 4.0 * fall**2, 0.15 * fall, 100 * fall, one
    return AtmosphericTerms(AXIS.centre_nm, *parts, {"engine": "invented"})


def noise_model(**changes: Any) -> NoiseModel:
    """A sensor with every source of noise; one number stands for all bands."""
    of_bands = {
        "electrons_per_radiance": 5000.0, "fixed_noise": 60.0, "calibration_percent": 0.5, "lsb_electrons": 25.0,
    }  # fmt: skip
    values: dict[str, Any] = {"detector_gain": 1.0, "bits": 14, "bit_error_rate": 0.0}
    values |= {name: np.full(BANDS, changes.pop(name, value)) for name, value in of_bands.items()}
    return NoiseModel(**(values | changes))


INPUTS = SimulationInputs("invented", AXIS, noise_model(), terms(), CLASSES)


def area(surface: str, lines: list[int], samples: list[int], **more: Any) -> dict[str, Any]:
    return {"surface": surface, "lines": lines, "samples": samples} | more


def planks(**changes: Any) -> dict[str, Any]:
    """The scene's group of six planks on the asphalt."""
    return scene_data()["targets"][0] | changes


def scene_data(**changes: Any) -> dict[str, Any]:
    """Plain data of a small scene, as a YAML file would hold it."""
    return yaml.safe_load((Path(__file__).parent / "scene.yaml").read_text()) | changes


def small_scene(**changes: Any) -> SceneFile:
    """The small scene as a model."""
    return SceneFile.model_validate(scene_data(**changes))


SCENE = small_scene()
