"""A small synthetic reflectance or radiance collection with known truth, written as ENVI."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine
from rasterio.crs import CRS

from hyperval.collection import CollectionSection, Detection
from hyperval.imagery import write_cube
from hyperval.model import Sources
from hyperval.observe import Observed, observe
from hyperval.scenario import SpectrumSource
from hyperval.spectra import SpectralAxis

LINES, SAMPLES, BANDS = 50, 40, 8
AXIS = SpectralAxis(np.array([450.0, 550, 660, 680, 790, 870, 1050, 1650]), np.full(BANDS, 2.0))
BACKGROUND = np.array([0.04, 0.08, 0.05, 0.05, 0.40, 0.42, 0.38, 0.25])
TARGET = np.array([0.30, 0.35, 0.10, 0.10, 0.20, 0.20, 0.30, 0.50])
# Pixels that hold a target, with the part that it fills; each stands alone.
PLANTED = {(10, 10): 0.8, (10, 20): 0.8, (20, 10): 0.3, (20, 20): 0.3, (30, 20): 0.3}


def background_spread() -> np.ndarray:
    """(B, B) covariance: one mode of brightness, one of slope, and band noise."""
    x = np.linspace(-1.0, 1.0, BANDS)
    return 0.05**2 * np.outer(BACKGROUND, BACKGROUND) + 1e-5 * np.outer(x, x) + 1e-5 * np.eye(BANDS)


def reflectances() -> np.ndarray:
    """(LINES, SAMPLES, BANDS) background draws with the targets mixed in."""
    rng = np.random.default_rng(5)
    scene = rng.multivariate_normal(BACKGROUND, background_spread(), (LINES, SAMPLES))
    for (line, sample), fill in PLANTED.items():
        scene[line, sample] = fill * TARGET + (1.0 - fill) * scene[line, sample]
    return scene


@dataclass
class World:
    """Files of one collection in one folder, and the settings that read them."""

    folder: Path
    values: np.ndarray
    collection: dict[str, Any] = field(default_factory=dict)
    detection: dict[str, Any] | None = None

    def write(self, values: np.ndarray | None = None, **options: Any) -> None:
        """Write the cube as float64, so that what is read is what was drawn."""
        if values is not None:
            self.values = values
        given = {"data_type": 5, "axis": AXIS, "transform": Affine(2.0, 0, 500000.0, 0, -2.0, 4700000.0),
                 "crs": CRS.from_epsg(32618)}  # fmt: skip
        write_cube(self.folder / "cube.img", self.values, **(given | options))

    def text(self, name: str, content: str) -> str:
        """Write a text file of the collection; returns its name."""
        (self.folder / name).write_text(content)
        return name

    def library(self, name: str, *spectra: tuple[str, np.ndarray]) -> str:
        """A table of reflectance spectra that are straight lines between the bands' centres."""
        grid = np.arange(400.0, 1701.0, 1.0)
        columns = [np.interp(grid, AXIS.centre_nm, values) for _, values in spectra]
        rows = [",".join(["wavelength_nm", *(label for label, _ in spectra)])]
        rows += [",".join([f"{w:g}", *(f"{v:.9f}" for v in row)]) for w, *row in zip(grid, *columns, strict=True)]
        return self.text(name, "\n".join(rows) + "\n")

    def source(self, file: str, record: str) -> dict[str, str]:
        """How a spectrum of :meth:`library` is named in a campaign."""
        return {"file": file, "record": record, "wavelength_unit": "nm", "reflectance_unit": "fraction"}

    def on_bands(self, file: str, record: str) -> np.ndarray:
        """(B,) a spectrum of :meth:`library` as the bands see it."""
        source = SpectrumSource.model_validate(self.source(file, record))
        return Sources(AXIS, {}, self.resolve).spectrum(source, record).mean

    def resolve(self, reference: str) -> Path:
        return self.folder / reference

    def observe(self) -> Observed:
        """Run the pipeline on the settings as they stand."""
        detection = None if self.detection is None else Detection.model_validate(self.detection)
        return observe(CollectionSection.model_validate(self.collection), detection, self.resolve, show_progress=False)


@dataclass
class RadianceWorld:
    """A world in radiance, with the line and the reflectances behind it."""

    world: World
    gain: np.ndarray
    offset: np.ndarray
    reflectance: np.ndarray


def target_rows(planted: dict[tuple[int, int], float]) -> str:
    """Target list: a name, the pixel and an area of fill times 4 m2; the group is the fill."""
    rows = ["name,material,row0,col0,side_m,area_m2,group"]
    for i, ((line, sample), fill) in enumerate(planted.items()):
        rows.append(f"t{i},paint,{line},{sample},0.5,{4.0 * fill:g},fill {fill:g}")
    return "\n".join(rows) + "\n"
