"""A small scene on invented surfaces, atmosphere and sensor: nothing here depends on the model's rooms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hyperval.atmosphere import AtmosphericTerms
from hyperval.data import ClassStatistics
from hyperval.simulate.inputs import SensorNumbers, SimulationInputs
from hyperval.simulate.schema import SceneFile
from hyperval.spectra import SpectralAxis

BANDS = 12
AXIS = SpectralAxis(np.linspace(450.0, 2200.0, BANDS), np.full(BANDS, 10.0))
ATMOSPHERE = {
    "aerosol": "rural",
    "meteorological_range_km": 40.0,
    "sensor_altitude_km": 1.0,
    "solar_zenith_deg": 40.0,
    "solar_azimuth_deg": 180.0,
    "day_of_year": 264,
}


def surface(name: str, level: float, spread: float) -> ClassStatistics:
    """A class with a sloped mean and a covariance of full rank with strong correlation between bands."""
    x = np.linspace(-1.0, 1.0, BANDS)
    modes = np.stack([np.ones(BANDS), x, x**2 - 0.3]) * np.array([[1.0], [0.4], [0.3]]) * spread
    covariance = modes.T @ modes + (0.2 * spread) ** 2 * np.eye(BANDS)
    return ClassStatistics(name, AXIS, level * (1.0 + 0.3 * x), covariance)


CLASSES = {
    "grass": surface("grass", 0.30, 0.02),
    "asphalt": surface("asphalt", 0.12, 0.008),
    "soil": surface("soil", 0.25, 0.02),
    "yellow-paint-plank": surface("yellow-paint-plank", 0.45, 0.02),
    "white-panel": surface("white-panel", 0.60, 0.004),
}


def terms() -> AtmosphericTerms:
    """Terms of plausible size that fall with wavelength."""
    w = AXIS.centre_nm
    fall = (500.0 / w) ** 2
    return AtmosphericTerms(
        w,
        2.0 * fall**2,
        40.0 * fall,
        4.0 * fall**2,
        0.15 * fall,
        100 * fall,
        np.ones(BANDS),
        {"engine": "invented"},
    )


def numbers(**changes: Any) -> SensorNumbers:
    """A sensor with every source of noise."""
    values: dict[str, Any] = {
        "name": "invented",
        "axis": AXIS,
        "electrons_per_radiance": np.full(BANDS, 5000.0),
        "fixed_noise_electrons": np.full(BANDS, 60.0),
        "noise_factor": 1.0,
        "relative_calibration": np.full(BANDS, 0.005),
        "lsb_radiance": np.full(BANDS, 0.005),
        "bits": 14,
        "bit_error_rate": 0.0,
    }
    return SensorNumbers(**(values | changes))


def scene_data(**changes: Any) -> dict[str, Any]:
    """Plain data of a small scene, as a YAML file would hold it."""
    data: dict[str, Any] = {
        "schema": 1,
        "name": "small",
        "mode": "closure",
        "seed": 7,
        "lines": 60,
        "samples": 48,
        "gsd_m": 2.0,
        "map": {"utm_zone": 18, "easting_m": 275400.0, "northing_m": 4753700.0},
        "atmosphere": ATMOSPHERE,
        "sensor": "invented",
        "psf_fwhm_pixels": 1.0,
        "layout": [
            {"surface": "grass", "lines": [0, 60], "samples": [0, 48]},
            {"surface": "asphalt", "lines": [30, 60], "samples": [0, 48]},
        ],
        "panels": [{"name": "white", "surface": "white-panel", "lines": [10, 18], "samples": [30, 38]}],
        "targets": [
            {
                "name": "yellow-30",
                "material": "yellow-paint-plank",
                "host": "asphalt",
                "fill": 0.3,
                "count": 6,
                "area": {"lines": [36, 50], "samples": [4, 25]},
                "spacing_pixels": 7,
            }
        ],
        "regions": [{"name": "grass-field", "surface": "grass"}, {"name": "court", "surface": "asphalt"}],
    }
    return data | changes


def small_scene(**changes: Any) -> SceneFile:
    """The small scene as a model."""
    return SceneFile.model_validate(scene_data(**changes))


@pytest.fixture
def scene() -> SceneFile:
    return small_scene()


@pytest.fixture
def make_scene():
    return small_scene


@pytest.fixture
def make_scene_data():
    return scene_data


@pytest.fixture
def make_sensor():
    return numbers


@pytest.fixture
def classes() -> dict[str, ClassStatistics]:
    return CLASSES


@pytest.fixture
def inputs() -> SimulationInputs:
    return SimulationInputs(numbers(), terms(), CLASSES)
