"""A small synthetic reflectance or radiance collection with known truth, written as ENVI."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine
from rasterio.crs import CRS

from hyperval import datasets
from hyperval.collection import CollectionSection, Detection
from hyperval.imagery import write_cube
from hyperval.model import Sources
from hyperval.observe import Observed, Place, observe, open_place
from hyperval.scenario import SpectrumSource
from hyperval.spectra import SpectralAxis

LINES, SAMPLES, BANDS = 50, 40, 8
AXIS = SpectralAxis(np.array([450.0, 550, 660, 680, 790, 870, 1050, 1650]), np.full(BANDS, 2.0))
GRID = Affine(2.0, 0, 500000.0, 0, -2.0, 4700000.0)
BACKGROUND = np.array([0.04, 0.08, 0.05, 0.05, 0.40, 0.42, 0.38, 0.25])
TARGET = np.array([0.30, 0.35, 0.10, 0.10, 0.20, 0.20, 0.30, 0.50])
# Pixels that hold a target, with the part that it fills; each stands alone.
PLANTED = {(10, 10): 0.8, (10, 20): 0.8, (20, 10): 0.3, (20, 20): 0.3, (30, 20): 0.3}
UNIT = {"quantity": "radiance", "unit": "uW cm-2 sr-1 nm-1"}
# Sites of a flight line, and the radiance of their field spectra: path + gain x reflectance.
SURFACES = {"lawn": BACKGROUND, "turf": TARGET, "sand": np.linspace(0.35, 0.55, BANDS)}
FIELD_GAIN, PATH = np.linspace(60.0, 8.0, BANDS), np.linspace(3.0, 0.02, BANDS)
WAVES = "wavelength units = Micrometers\nwavelength = {0.45, 0.55, 0.65, 0.80, 1.00}\n"
DIRSIG = (Path(__file__).parent / "dirsig.yaml").read_text("utf-8")


def background_spread() -> np.ndarray:
    """(B, B) covariance: one mode of brightness, one of slope, and band noise."""
    x = np.linspace(-1.0, 1.0, BANDS)
    return 0.05**2 * np.outer(BACKGROUND, BACKGROUND) + 1e-5 * np.outer(x, x) + 1e-5 * np.eye(BANDS)


def reflectances() -> np.ndarray:
    """(LINES, SAMPLES, BANDS) background draws with the targets mixed in."""
    scene = np.random.default_rng(5).multivariate_normal(BACKGROUND, background_spread(), (LINES, SAMPLES))
    for (line, sample), fill in PLANTED.items():
        scene[line, sample] = fill * TARGET + (1.0 - fill) * scene[line, sample]
    return scene


def near_targets(radius: int = 1) -> np.ndarray:
    """(LINES, SAMPLES) the targets and what lies within so many pixels of them."""
    line, sample = np.indices((LINES, SAMPLES))
    return np.any([np.hypot(line - i, sample - j) <= radius for i, j in PLANTED], axis=0)


def moments(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (B,) and covariance (B, B) of pixels (..., B) by plain NumPy."""
    flat = pixels.reshape(-1, pixels.shape[-1])
    return flat.mean(axis=0), np.cov(flat, rowvar=False)


def matched_filter(pixels: np.ndarray, target: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Plain NumPy: (x - m) C^-1 (t - m) / ((t - m) C^-1 (t - m))."""
    d = target - mean
    weights = np.linalg.inv(covariance) @ d
    return (pixels - mean) @ weights / (d @ weights)


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
        given = {"data_type": 5, "axis": AXIS, "transform": GRID, "crs": CRS.from_epsg(32618)}
        write_cube(self.folder / "cube.img", self.values, **(given | options))

    def text(self, name: str, content: str) -> str:
        """Write a text file of the collection; returns its name."""
        (self.folder / name).write_text(content)
        return name

    def library(self, name: str, **spectra: np.ndarray | float) -> str:
        """A table of reflectance spectra that are straight lines between the bands' centres."""
        grid = np.arange(400.0, 1701.0, 1.0)
        columns = [np.interp(grid, AXIS.centre_nm, np.broadcast_to(values, BANDS)) for values in spectra.values()]
        rows = [",".join(["wavelength_nm", *spectra])]
        rows += [",".join([f"{w:g}", *(f"{v:.9f}" for v in row)]) for w, *row in zip(grid, *columns, strict=True)]
        return self.text(name, "\n".join(rows) + "\n")

    def source(self, file: str, record: str) -> dict[str, str]:
        """How a spectrum of :meth:`library` is named in a campaign."""
        return {"file": file, "record": record, "wavelength_unit": "nm", "reflectance_unit": "fraction"}

    def site(self, name: str, radiance: np.ndarray, **more: str) -> None:
        """A collected spectrum of the bands, mean of nine pixels."""
        rows = zip(AXIS.centre_nm, radiance, strict=True)
        self.text(f"{name}.txt", "".join(f"{w} {v:.12g}\n" for w, v in rows))
        self.collection["spectra"].append({"subject": name, "path": f"{name}.txt", "pixels": 9} | more)

    def on_bands(self, record: str = "paint", file: str = "library.csv") -> np.ndarray:
        """(B,) a spectrum of :meth:`library` as the bands see it."""
        source = SpectrumSource.model_validate(self.source(file, record))
        return Sources(AXIS, {}, self.resolve).spectrum(source, record).mean

    def resolve(self, reference: str) -> Path:
        return datasets.resolve(reference, self.folder)

    def regions(self, *more: dict[str, Any], **rectangles: list[int]) -> None:
        """Give the collection these regions alone."""
        self.collection["regions"] = [{"name": n, "rectangle": r} for n, r in rectangles.items()] + list(more)

    def squares(self, name: str, **corners: tuple[float, float, float]) -> dict[str, str]:
        """A vector file of squares by their names: (sample, line) of the corner and side, in pixels."""
        features = ",".join(
            f'{{"type":"Feature","properties":{{"name":"{n}"}},"geometry":{{"type":"Polygon","coordinates":'
            f"[[[{x},{y}],[{x + s},{y}],[{x + s},{y + s}],[{x},{y + s}],[{x},{y}]]]}}}}"
            for n, (x, y, s) in corners.items()
        )
        self.text(name, f'{{"type":"FeatureCollection","features":[{features}]}}')
        return {"file": name, "coordinates": "pixel"}

    def place(self) -> Place:
        """Open the collection as it stands."""
        return open_place(CollectionSection.model_validate(self.collection), self.resolve)

    def observe(self, **options: Any) -> Observed:
        """Run the pipeline on the settings as they stand."""
        detection = None if self.detection is None else Detection.model_validate(self.detection)
        return observe(CollectionSection.model_validate(self.collection), detection, self.resolve, **options)


@dataclass
class RadianceWorld:
    """A world in radiance, with the line and the reflectances behind it."""

    world: World
    gain: np.ndarray
    offset: np.ndarray
    reflectance: np.ndarray

    @property
    def panels(self) -> list[dict[str, Any]]:
        """The panels of the line, which a test may change."""
        return self.world.collection["empirical_line"]["panels"]

    def more_panels(self, noise: float = 0.0, **stated: float) -> World:
        """Panels more, of 0.30 and 0.45 on the ground, under the reflectances that the field has of them."""
        values = self.world.values.copy()
        draws = 1.0 + noise * np.random.default_rng(4).standard_normal((2, 4, 4, BANDS))
        for place, level, factor, name in zip((30, 36), (0.30, 0.45), draws, stated, strict=True):
            values[6:10, place : place + 4] = (self.offset + self.gain * level) * factor
            self.world.collection["regions"].append({"name": name, "rectangle": [6, place, 4, 4]})
        self.world.write(values)
        self.world.library("more.csv", **stated)
        self.panels.extend({"region": n, "spectrum": self.world.source("more.csv", n)} for n in stated)
        return self.world


def target_rows(planted: dict[tuple[int, int], float], side_m: float = 0.5) -> str:
    """Target list: a name, the pixel and an area of fill times 4 m2; the group is the fill."""
    rows = ["name,material,row0,col0,side_m,area_m2,group"]
    for i, ((line, sample), fill) in enumerate(planted.items()):
        rows.append(f"t{i},paint,{line},{sample},{side_m},{4.0 * fill:g},fill {fill:g}")
    return "\n".join(rows) + "\n"


def envi(path: Path, values: np.ndarray, entries: str) -> None:
    """BIP of 64-bit numbers, the header under the name of the data file and .hdr: as DIRSIG writes its images."""
    lines, samples, bands = values.shape
    values.astype("<f8").tofile(path)
    path.with_name(path.name + ".hdr").write_text(
        f"ENVI\nsamples = {samples}\nlines = {lines}\nbands = {bands}\nheader offset = 0\n"
        f"file type = ENVI Standard\ndata type = 5\ninterleave = bip\nbyte order = 0\n{entries}"
    )


def scene_of_a_tenth() -> np.ndarray:
    """Two planks that lie aslant, on cells of a tenth of a pixel of a cube of 12 x 10 pixels."""
    y, x = (np.indices((120, 100)) + 0.5) / 10.0
    out = np.zeros((120, 100), np.uint8)
    for value, (cy, cx, angle, a, b) in ((1, (4.2, 3.7, 30.0, 2.6, 0.8)), (2, (8.3, 6.1, -20.0, 1.0, 1.0))):
        c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
        along, across = (y - cy) * c + (x - cx) * s, (x - cx) * c - (y - cy) * s
        out[(np.abs(along) < a / 2) & (np.abs(across) < b / 2)] = value
    return out


def finer_map(folder: Path, classes: np.ndarray, name: str = "finer.tif") -> None:
    """Cells of 0.2 m on the map."""
    with rasterio.open(
        folder / name, "w", driver="GTiff", width=100, height=120, count=1, dtype=classes.dtype,
        crs="EPSG:32618", transform=Affine(0.2, 0, 300_000, 0, -0.2, 4_500_000),
    ) as dataset:  # fmt: skip
        dataset.write(classes, 1)


def dirsig_images(folder: Path, rays: int = 20) -> np.ndarray:
    """A radiance image and its truth in DIRSIG's layout; the abundance of the panel, counted by rays."""
    rng = np.random.default_rng(9)
    material = np.where(np.arange(30)[:, None] < 15, 3.0, 12.0) * np.ones((30, 20))
    abundance = np.zeros((30, 20))
    abundance[5:7, 8:10], abundance[22, 4] = [[0.2, 1.0], [0.5, 0.75]], 0.6
    abundance = np.round(abundance * rays) / rays + 0.01 * (np.arange(600) == 22 * 20 + 5).reshape(30, 20)  # an edge
    reflectance = np.where(material[..., None] == 3.0, 0.3, 0.1) * (1 + 0.05 * rng.standard_normal((30, 20, 5)))
    reflectance += abundance[..., None] * (0.6 - reflectance)
    envi(folder / "scene.img", reflectance * 8e-3, WAVES)
    names = "band names = {Material Index, Panel Abundance, Abundance - panel 7}\n"
    envi(folder / "truth.img", np.stack([material, np.zeros((30, 20)), abundance], axis=2), names)
    return abundance
