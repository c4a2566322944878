"""A scenario of few bands with a synthetic atmosphere, and studies of it."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hyperval.atmosphere import AtmosphericTable, write_table


@pytest.fixture(scope="session")
def scenario_file(tmp_path_factory) -> Path:
    """The scenario with its atmosphere table beside it."""
    folder = tmp_path_factory.mktemp("scenario")
    w, depth = np.arange(340.0, 2601.0, 20.0), np.linspace(0.0, 1.0, 5)[:, None]
    haze = 1.0 - np.exp(-depth * 550.0 / w)
    quantities = {
        "path": 0.03 * (450.0 / w) ** 3 + 0.12 * haze, "direct": 0.8 * np.exp(-1.2 * depth * 550.0 / w),
        "adjacency": 0.15 * haze * np.exp(-0.4 * depth), "spherical_albedo": 0.05 * (450.0 / w) ** 3 + 0.15 * haze,
        "ground": 0.9 * np.exp(-0.2 * depth * 550.0 / w), "gas": np.full((5, w.size), 0.95),
        "diffuse": 0.1 + 0.5 * haze,
    }  # fmt: skip
    fixed = {"water_vapour_g_cm2": 2.0, "ozone_atm_cm": 0.3, "ground_altitude_km": 0.0, "sensor_altitude_km": 1.0,
             "solar_zenith_deg": 35.0, "view_zenith_deg": 0.0}  # fmt: skip
    write_table(AtmosphericTable(w, {"aot550": depth[:, 0]}, fixed, quantities), folder / "sky.nc")
    return Path(shutil.copy(Path(__file__).parent / "small.yaml", folder))


@pytest.fixture
def make_study(scenario_file) -> Callable[[str], Path]:
    """From YAML text to the file of a study of the small scenario."""

    def make(text: str) -> Path:
        path = scenario_file.parent / "study.yaml"
        head = "" if "scenario:" in text else "schema: 1\nname: trial\nscenario: small.yaml\n"
        path.write_text(head + text)
        return path

    return make
