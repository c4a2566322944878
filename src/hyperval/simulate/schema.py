"""The scene file of a simulation: surfaces, targets, sensor, and which assumptions are broken.

Random streams are independent, so that a pixel's draw depends on its place and not on the order of work.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from hyperval.atmosphere.state import AtmosphericState
from hyperval.config import Model, OneOf, load_model, twice, unknown
from hyperval.errors import reader

PLACEMENT, TARGET_SPECTRA, FIELDS, SURFACE, NOISE, FIELD_SPECTRA = range(6)


def generator(seed: int, stream: int, index: int) -> np.random.Generator:
    """The generator of one stream and one line, group or field."""
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed, spawn_key=(stream, index))))


# First words of what the cube's header says of how it is read.
WRITTEN = r"(?i)(samples|lines|bands|header|file|data|interleave|byte|map|coordinate|wavelength|fwhm|bbl)\b"
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=64)]


class Area(Model):
    """A rectangle of pixels, [first, end) along each axis."""

    lines: tuple[int, int]
    samples: tuple[int, int]

    refused: ClassVar = {
        "lines {}, samples {}: expected [first, end) with 0 <= first < end": lambda a: (
            [list(a.lines), list(a.samples)] * any(not 0 <= first < end for first, end in (a.lines, a.samples))
        )
    }


class PaintedArea(Area):
    """A rectangle covered by one surface class; later ones cover earlier ones."""

    surface: str = Field(
        description="a built-in surface: grass, asphalt, soil, yellow-paint-plank, green-paint-plank, white-panel, "
        "black-panel, grey-panel-NN (percent)"
    )


class Panel(PaintedArea):
    """A calibration panel: a painted rectangle whose interior becomes a region of interest."""

    name: Name
    border_pixels: int = Field(1, ge=0, description="pixels left out along the border of the region")


class TargetGroup(OneOf):
    """Square planks of one material and size on a grid in one area."""

    one_of = ("fill", "side_m")
    name: Name
    material: str = Field(description="built-in surface of the planks")
    host: str = Field(description="built-in surface they lie on")
    fill: float | None = Field(
        None, ge=1e-4, lt=1.0, description="fill fraction of a pixel with a plank at its centre: sets the side"
    )
    side_m: float | None = Field(None, gt=0.0, description="side [m], when given instead of the fill")
    count: int = Field(ge=1, le=100_000)
    area: Area
    spacing_pixels: int = Field(7, ge=6, description="of the grid; planks closer than 6 pixels would overlap")
    phase: Literal["centred", "random"] = "centred"
    heading_deg: float | Literal["random"] = 0.0

    @model_validator(mode="after")
    def _check_room(self) -> TargetGroup:
        rows, columns = ((end - first) // self.spacing_pixels for first, end in (self.area.lines, self.area.samples))
        if self.count > rows * columns:
            raise ValueError(f"{self.count} planks on a grid of {rows} x {columns}")
        return self


class SimulatedRegion(Model):
    """A region of interest: all pixels of a class away from its borders and from targets."""

    name: Name
    surface: str
    border_pixels: int = Field(3, ge=0)


class Admixture(Model):
    """A second surface mixed into a class: its share varies from place to place (beta distribution)."""

    host: str
    surface: str
    mean: float = Field(gt=0.0, lt=1.0, description="mean share")
    sd: float = Field(gt=0.0, lt=0.5, description="standard deviation of the share")
    correlation_pixels: float = Field(0.0, ge=0.0, le=200.0)

    refused: ClassVar = {
        "no share between 0 and 1 has this mean and standard deviation": lambda a: a.sd**2 >= a.mean * (1.0 - a.mean)
    }


class HeavyTails(Model):
    """Pixels of every class that covers ground drawn from a multivariate t of the same mean and covariance."""

    dof: float = Field(gt=2.0, le=1000.0)


class Texture(Model):
    """Brightness that varies smoothly over the ground: a factor of mean 1 common to all bands."""

    relative_sd: float = Field(gt=0.0, lt=0.5)
    correlation_pixels: float = Field(gt=0.0, le=200.0, description="lag at which the correlation is 1/e")


class Shade(Model):
    """Patches where less light reaches the ground, equally in all bands."""

    area_fraction: float = Field(gt=0.0, lt=1.0)
    illumination: float = Field(ge=0.0, lt=1.0, description="share of the open-sky ground signal that is left")
    correlation_pixels: float = Field(gt=0.0, le=200.0, description="size of the patches")


class Broken(Model):
    """Which assumptions of the model the surfaces break; each stands alone."""

    soft_edges: bool = Field(False, description="class borders blurred by the point spread function")
    admixtures: list[Admixture] = Field([])
    heavy_tails: HeavyTails | None = None
    texture: Texture | None = None
    shade: Shade | None = None


class MapOrigin(Model):
    """Upper-left corner of the first pixel on the UTM grid (WGS-84), north up."""

    utm_zone: int = Field(ge=1, le=60)
    hemisphere: Literal["north", "south"] = "north"
    easting_m: float = Field(ge=100_000.0, le=900_000.0)
    northing_m: float = Field(ge=0.0, le=10_000_000.0)


class FieldSpectra(Model):
    """What the field spectrometer delivers of the panels: means of repeated readings at 1 nm."""

    readings: int = Field(10, ge=1)
    relative_noise: float = Field(0.0, ge=0.0, le=0.1, description="of one reading, independent between samples")


class SceneFile(Model):
    """One scene to simulate."""

    schema_version: Literal[1] = Field(alias="schema")
    name: Name
    mode: Literal["closure", "broken"]
    seed: int = Field(ge=0, lt=2**63)
    lines: int = Field(ge=1, le=20_000)
    samples: int = Field(ge=1, le=20_000)
    gsd_m: float = Field(gt=0.0, le=100.0)
    map: MapOrigin
    acquired_utc: str = Field("", description="written into the header")
    atmosphere: AtmosphericState
    sensor: str = Field(description="name of a sensor of the library, or a sensor file")
    psf_fwhm_pixels: float = Field(ge=0.01, le=4.0)
    counts_per_radiance: float = Field(1000.0, gt=0.0, le=1e6, description="stored integers per uW cm-2 sr-1 nm-1")
    layout: list[PaintedArea] = Field(min_length=1)
    panels: list[Panel] = Field([])
    targets: list[TargetGroup] = Field([])
    regions: list[SimulatedRegion] = Field([])
    target_guard_pixels: int = Field(3, ge=0, le=10_000, description="around planks, left out of the regions")
    field_spectra: FieldSpectra = FieldSpectra()
    header: dict[str, str] = Field(
        {}, description="further entries of the cube's header, as files of this sensor carry them"
    )
    broken: Broken = Broken()

    refused: ClassVar = {
        "mode 'broken' needs at least one option under 'broken'; mode 'closure' takes none": lambda s: (
            (s.mode == "broken") == (s.broken == Broken())
        ),
        "lines {}, samples {} reach outside the image of {} lines x {} samples": lambda s: next(
            (
                [list(area.lines), list(area.samples), s.lines, s.samples]
                for area in (*s.layout, *s.panels, *(g.area for g in s.targets))
                if area.lines[1] > s.lines or area.samples[1] > s.samples
            ),
            [],
        ),
        "header: the simulation writes {!r}": lambda s: [k for k in s.header if re.match(WRITTEN, k)],
        "two regions carry the same name": lambda s: twice(r.name for r in (*s.panels, *s.regions)),
        "two target groups carry the same name": lambda s: twice(g.name for g in s.targets),
        "the class {!r} covers no area; the layout has {}": lambda s: unknown(
            [*(g.host for g in s.targets), *(r.surface for r in s.regions), *(a.host for a in s.broken.admixtures)],
            sorted(s.surfaces()),
        ),
    }

    def surfaces(self) -> list[str]:
        """Names of the classes that cover ground, in the order they are first painted."""
        return list(dict.fromkeys(a.surface for a in (*self.layout, *self.panels)))

    def materials(self) -> list[str]:
        """Names of every class whose spectra are needed, the covering ones first."""
        extra = [g.material for g in self.targets] + [a.surface for a in self.broken.admixtures]
        return list(dict.fromkeys([*self.surfaces(), *extra]))


@reader
def load_scene(path: Path) -> SceneFile:
    """Read and check a scene file.

    Raises
    ------
    InputError : no such file.
    UsageError : every mistake with its file and line.
    """
    return load_model(SceneFile, path)
