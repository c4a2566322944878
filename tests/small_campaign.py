"""A campaign small enough to run in seconds: a simulated collection of 16 bands under a stand-in atmosphere.

The collection is written once for a test session; every test gets a copy that it may damage.
"""

import re
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from stand_in_atmosphere import blue_and_haze, smooth_terms, sunlight

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms

DATA = Path(__file__).parent / "data"
PANELS = ("white-panel", "black-panel", "grey-panel-35")


def data_of(name: str) -> dict[str, Any]:
    """The content of a YAML file of tests/data, the caller's to change."""
    return yaml.safe_load((DATA / f"{name}.yaml").read_text("utf-8"))


sensor_data, scene_data, scenario_data = (partial(data_of, f"small_{kind}") for kind in ("sensor", "scene", "scenario"))
ATMOSPHERE = scene_data()["atmosphere"]
CENTRES_NM = tuple(int(nm) for nm, *_ in sensor_data()["bands"]["table"])


def stand_in_atmosphere(state: AtmosphericState, **options: Any) -> AtmosphericTerms:
    """Smooth terms of plausible size, in place of the radiative-transfer engine (which takes minutes)."""
    w = np.arange(340.0, 2601.0, 5.0)
    blue, haze = blue_and_haze(state.aot550 or 0.2, w)
    direct = sunlight(w) * np.exp(-0.5 * haze - 0.05 * blue) / np.pi
    return smooth_terms(blue, haze, sunlight(w), direct, w=w)


def with_stand_in_atmosphere(patch: pytest.MonkeyPatch) -> None:
    """Let predictions and simulations use the stand-in."""
    patch.setenv("HYPERVAL_WORKERS", "1")  # a campaign in another process would not see it
    patch.setattr("hyperval.model.stated.atmospheric_terms", stand_in_atmosphere)
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
    patch.setattr("hyperval.compare.covariance._MAX_DRAWN", 2000)  # of few bands: most tests share most spreads


def fill_in(campaign: Path, values: Mapping[str, str]) -> None:
    """Put values in the place of what a campaign and its scenarios leave open, each by its key."""
    from hyperval.campaign import read_jobs

    for mark in read_jobs(campaign)[0].to_fill_in:
        name, _, number = mark.where.rpartition(":")
        lines = Path(name).read_text().splitlines()
        lines[int(number) - 1] = re.sub(r'"FILL_IN.*"', values[mark.key], lines[int(number) - 1])
        Path(name).write_text("\n".join(lines) + "\n")


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
    from hyperval.simulate import SceneFile, load_inputs, simulate

    folder.mkdir(parents=True, exist_ok=True)
    write_yaml(folder / "sensor.yaml", sensor_data())
    scene = SceneFile.model_validate(scene_data())
    simulate(scene, folder / "collection", inputs=load_inputs(scene, folder, stand_in_atmosphere))


class SmallCampaign:
    """A copy of the small campaign in a folder of its own."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.data = data_of("small_campaign") | {"scenarios": [scenario_data()]}

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

    def of_a_data_set(self) -> "SmallCampaign":
        """The same campaign, whose cube is a file of a registered data set."""
        file = "data:hysu/published/full/DLR_HySU_HS_full.tif"
        self.data["collection"]["cube"] = {"path": file, "quantity": "reflectance"}
        return self

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
