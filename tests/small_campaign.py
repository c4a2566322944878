"""A campaign small enough to run in seconds: a simulated collection of 16 bands under a stand-in atmosphere.

The collection is written once for a test session; every test gets a copy that it may damage.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from stand_in_atmosphere import blue_and_haze, smooth_terms, sunlight

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms

ATMOSPHERE = {
    "aot550": 0.2,
    "water_vapour_g_cm2": 2.0,
    "sensor_altitude_km": 1.0,
    "solar_zenith_deg": 30.0,
    "solar_azimuth_deg": 0.0,
    "day_of_year": 200,
}
CENTRES_NM = (450, 490, 530, 560, 600, 640, 670, 700, 745, 785, 865, 1020, 1050, 1220, 1640, 2200)
PANELS = ("white-panel", "black-panel", "grey-panel-35")


def stand_in_atmosphere(state: AtmosphericState, **options: Any) -> AtmosphericTerms:
    """Smooth terms of plausible size, in place of the radiative-transfer engine (which takes minutes)."""
    w = np.arange(340.0, 2601.0, 5.0)
    blue, haze = blue_and_haze(state.aot550 or 0.2, w)
    direct = sunlight(w) * np.exp(-0.5 * haze - 0.05 * blue) / np.pi
    return smooth_terms(blue, haze, sunlight(w), direct, w=w)


def with_stand_in_atmosphere(patch: pytest.MonkeyPatch) -> None:
    """Let predictions and simulations use the stand-in."""
    patch.setenv("HYPERVAL_WORKERS", "1")  # a campaign in another process would not see it
    patch.setattr("hyperval.model.world.atmospheric_terms", stand_in_atmosphere)
    patch.setattr("hyperval.atmosphere.atmospheric_terms", stand_in_atmosphere)


def undrawn(patch: pytest.MonkeyPatch, pictures: Any = lambda *_, **__: []) -> None:
    """Leave out the figures of a page; ``pictures`` stands for what draws those of the scene."""
    patch.setattr("hyperval.figures.pictures.draw_pictures", pictures)
    patch.setattr("hyperval.report.html.first_figures", lambda sides, table: [])
    patch.setattr("hyperval.report.html.further_figures", lambda *_: [])


def without_figures(patch: pytest.MonkeyPatch) -> None:
    """Leave out figures, charts and arrays, which are most of a small run's time."""
    undrawn(patch)
    patch.setattr("hyperval.run.write_products", lambda folder, *sides, **words: (folder / "products.nc").touch())
    # Sets of objects for p-values that no test of the small campaign asks for: a fifth of what is left.
    patch.setattr("hyperval.compare.detection.REPLICATES", 400)
    patch.setattr("hyperval.compare.detection.POWER_DRAWS", 40)


def sensor_data() -> dict[str, Any]:
    """A quiet sensor of 16 bands."""
    assumed = "assumed: for tests"
    rows = [[nm, a, 0.5, 0.0] for nm, a in ((400.0, 0.004), (1000.0, 0.003), (2500.0, 0.001))]
    return {
        "schema": 1,
        "name": "small-sensor",
        "title": "A sensor of 16 bands",
        "source": assumed,
        "bands": {"table": [[float(nm), 10.0, 1] for nm in CENTRES_NM], "source": assumed},
        "measured_noise": {"table": rows, "source": assumed},
        "calibration_error_percent": {"value": 0.1, "source": assumed},
    }


def scene_data() -> dict[str, Any]:
    """Grass above, asphalt below, three panels, 96 yellow planks in two sizes."""
    planks = {"material": "yellow-paint-plank", "host": "asphalt", "count": 48, "spacing_pixels": 6}
    return {
        "schema": 1,
        "name": "small",
        "mode": "closure",
        "seed": 20,
        "lines": 84,
        "samples": 72,
        "gsd_m": 1.0,
        "map": {"utm_zone": 18, "easting_m": 275400.0, "northing_m": 4753700.0},
        "atmosphere": ATMOSPHERE,
        "sensor": "sensor.yaml",
        "psf_fwhm_pixels": 1.0,
        "counts_per_radiance": 1000.0,
        "layout": [
            {"surface": "grass", "lines": [0, 36], "samples": [0, 72]},
            {"surface": "asphalt", "lines": [36, 84], "samples": [0, 72]},
        ],
        "panels": [
            {"name": name, "surface": name, "lines": [4, 12], "samples": [4 + 12 * i, 12 + 12 * i]}
            for i, name in enumerate(PANELS)
        ],
        "regions": [{"name": "field", "surface": "grass"}, {"name": "court", "surface": "asphalt"}],
        "target_guard_pixels": 2,
        "targets": [
            {**planks, "name": "small-planks", "fill": 0.08, "area": {"lines": [36, 60], "samples": [0, 72]}},
            {**planks, "name": "large-planks", "fill": 0.15, "area": {"lines": [60, 84], "samples": [0, 72]}},
        ],
    }


def scenario_data() -> dict[str, Any]:
    """What the model is told of the scene."""
    return {
        "schema": 1,
        "name": "small",
        "atmosphere": ATMOSPHERE,
        "sensor": "sensor.yaml",
        "scene": {
            "classes": [
                {"name": "field", "fraction": 36 / 84, "spectrum": {"builtin": "grass"}},
                {"name": "court", "fraction": 48 / 84, "spectrum": {"builtin": "asphalt"}},
            ],
            "adjacency": {"effective_neighbours": None},
            "panels": [{"name": name, "spectrum": {"builtin": name}} for name in PANELS],
            "targets": [
                {
                    "name": "yellow",
                    "spectrum": {"builtin": "yellow-paint-plank"},
                    "host": "court",
                    "subjects": [
                        {"name": "small-planks", "fill": {"fixed": 0.08}},
                        {"name": "large-planks", "fill": {"fixed": 0.15}},
                    ],
                }
            ],
        },
        "processing": {"elm": {"reflectances": [0.1, 0.6]}, "detectors": ["cem"]},
    }


def campaign_data() -> dict[str, Any]:
    """Collection on disk, one written-out scenario, gates on radiance, reflectance, ROC and areas."""
    line = [
        {"region": name, "spectrum": {"file": "collection/panel_spectra.csv", "record": name,
                                      "wavelength_unit": "nm", "reflectance_unit": "fraction"}}
        for name in PANELS
    ]  # fmt: skip
    surfaces = ["field", "court", *PANELS]
    median = "median_abs_difference_ratio_windows"
    return {
        "schema": 1,
        "name": "small",
        "title": "A small campaign",
        "description": "Simulated; for tests.",
        "simulated": True,
        "assumptions": ["Nothing here was measured."],
        "collection": {
            "cube": {"path": "collection/small_rad.img", "quantity": "radiance", "unit": "uW cm-2 sr-1 nm-1"},
            "regions": [{"file": "collection/regions.geojson", "coordinates": "pixel"}],
            "targets": {"csv": "collection/targets.csv", "pixels": "centre", "guard_pixels": 2},
            "leave_out": list(PANELS),
            "empirical_line": {"panels": line},
            "snr_regions": ["white-panel"],
        },
        "detection": {
            "group": "{group}",
            "targets": [
                {"name": "yellow", "material": "yellow-paint-plank", "spectrum": {"builtin": "yellow-paint-plank"}}
            ],
            "areas": [{"target": "yellow", "detector": "cem", "margin_pixels": 1}],
        },
        "scenarios": [scenario_data()],
        "comparisons": [
            {"product": "radiance", "subjects": surfaces, "metric": median, "at_most": 0.02, "reason": "closure"},
            {"product": "reflectance", "subjects": ["field", "court"], "metric": median, "at_most": 0.03,
             "reason": "closure"},
            {"product": "roc", "subjects": ["small-planks", "large-planks"], "method": "cem/pixel",
             "metric": "pd_inside_interval@1e-2", "at_least": 1, "reason": "closure"},
            {"product": "abundance", "subjects": ["large-planks"], "metric": "area_ratio", "within": [0.8, 1.2],
             "reason": "scores add up to the area"},
            {"product": "snr", "subjects": ["white-panel"], "metric": median, "at_most": 0.5, "gate": False,
             "reason": "36 pixels"},
        ],
    }  # fmt: skip


class _Plain(yaml.SafeDumper):
    """Writes every entry out: the strict reader refuses anchors."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def write_yaml(path: Path, data: Mapping[str, Any]) -> Path:
    """Write plain data as a YAML file."""
    path.write_text(yaml.dump(dict(data), Dumper=_Plain, sort_keys=False, width=110))
    return path


def files_of(folder: Path) -> dict[str, bytes]:
    """Content of every file below a folder, by its name there."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def write_collection(folder: Path) -> None:
    """Simulate the scene into ``folder``/collection, with the sensor file beside it."""
    from hyperval.simulate import SceneFile, SimulationInputs, sensor_numbers, simulate
    from hyperval.statistics_library import builtin_class

    folder.mkdir(parents=True, exist_ok=True)
    sensor = sensor_numbers(str(write_yaml(folder / "sensor.yaml", sensor_data())))
    scene = SceneFile.model_validate(scene_data())
    terms = stand_in_atmosphere(scene.atmosphere).at_bands(sensor.axis)
    classes = {name: builtin_class(name, sensor.axis) for name in scene.materials()}
    simulate(scene, folder / "collection", inputs=SimulationInputs(sensor, terms, classes))


class SmallCampaign:
    """A copy of the small campaign in a folder of its own."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.data = copy.deepcopy(campaign_data())

    @property
    def collection(self) -> Path:
        """Folder of the simulated files."""
        return self.folder / "collection"

    @property
    def scenario(self) -> dict[str, Any]:
        """The scenario, to be changed."""
        return self.data["scenarios"][0]

    def gate(self, product: str) -> dict[str, Any]:
        """The first planned comparison of a product."""
        return next(g for g in self.data["comparisons"] if g["product"] == product)

    def write(self, name: str = "campaign.yaml") -> Path:
        """The campaign file with all changes."""
        return write_yaml(self.folder / name, self.data)

    def edit(self, name: str, change: Callable[[str], str]) -> None:
        """Change the text of a file of the collection; something must change."""
        path = self.collection / name
        before = path.read_text()
        after = change(before)
        assert after != before
        path.write_text(after)
