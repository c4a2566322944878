"""What a scenario file says: scene, atmosphere, sensor, processing and what is uncertain.

Without ``atmosphere`` the scenario lives in the reflectance domain: no radiance, no sensor noise.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, PrivateAttr, ValidationInfo, field_validator, model_validator

from hyperval.atmosphere import AtmosphericState
from hyperval.config import Model, load_model, load_yaml
from hyperval.errors import UsageError, reader
from hyperval.processing.ace_model import NUMERICAL_DETECTORS
from hyperval.processing.filters import LINEAR_DETECTORS
from hyperval.scenario_sources import CovarianceSource as CovarianceSource
from hyperval.scenario_sources import SpectrumSource as SpectrumSource
from hyperval.scenario_sources import exactly_one
from hyperval.scenario_uncertainty import SpectrumUncertainty as SpectrumUncertainty
from hyperval.scenario_uncertainty import Uncertainty
from hyperval.scene.components import MOST_COMPONENTS
from hyperval.sensor.operation import SensorChanges, SensorOperation

MODEL_DETECTORS = (*LINEAR_DETECTORS, *NUMERICAL_DETECTORS)

Fraction = Annotated[float, Field(ge=0, le=1)]
Channel = Annotated[int, Field(ge=0, lt=5000)]
BlurWidth = Annotated[float, Field(ge=0, le=5)]


class Surface(Model):
    """A surface with its spectrum; the covariance comes from the same source when it is not named."""

    name: str = Field(min_length=1)
    spectrum: SpectrumSource
    covariance: CovarianceSource | None = None


class BackgroundClass(Surface):
    """A class that covers a part of the scene."""

    fraction: Fraction = Field(description="area fraction f_m; the fractions of all classes sum to 1")
    gain: float = Field(1.0, ge=0, description="g_B: factor on the covariance")
    tail_dof: Annotated[float, Field(gt=2)] | Literal["measured"] | None = Field(
        None, description="multivariate t with this many degrees of freedom, or as fitted to the measured region"
    )
    mixture: Annotated[int, Field(ge=1, le=MOST_COMPONENTS)] | Literal["auto"] | None = Field(
        None,
        description="scores of a class of clusters: this many components, fitted to the measured region or stored "
        "in the statistics library; auto: as many as predict other parts of the image best, or all that are "
        "stored; None or 1: one law. The components are normal laws, or t laws where tail_dof is given",
    )

    @property
    def has_mixture(self) -> bool:
        """Whether the class is more than one law."""
        return self.mixture is not None and self.mixture != 1


class Geometry(Model):
    """Fill fractions from the geometry of target and pixel."""

    shape: Literal["square", "rectangle"] = "square"
    side_m: float | None = Field(None, gt=0)
    length_m: float | None = Field(None, gt=0)
    width_m: float | None = Field(None, gt=0)
    heading_deg: float | Literal["random"] = Field(
        0.0, description="of the length, from the direction of the lines"
    )
    gsd_m: float = Field(gt=0, description="ground side of a pixel")
    psf_fwhm_pixels: BlurWidth | tuple[BlurWidth, BlurWidth] | None = Field(
        None, description="Gaussian blur besides the square aperture, or (along, across); None: the sensor's, or 0"
    )
    phase: Literal["random", "centred"] = Field("random", description="where in its pixel the target's centre lies")
    pixels: Literal["best", "ranked", "touched"] = Field(
        "best",
        description="the fullest pixel of an object alone; its n fullest, as a truth that counts so many has; or "
        "all that its outline meets, as a truth by outlines has",
    )
    n: int | None = Field(None, ge=1, le=400, description="pixels of an object, with ranked")

    @model_validator(mode="after")
    def _check(self) -> Geometry:
        square = self.shape == "square"
        if square != (self.side_m is not None) or square == (
            self.length_m is not None and self.width_m is not None
        ):
            raise ValueError("a square has side_m; a rectangle has length_m and width_m")
        if (self.pixels == "ranked") != (self.n is not None):
            raise ValueError("ranked pixels need n, the number of pixels of an object; best takes none")
        return self


class Fill(Model):
    """Part of a pixel that the target fills: fixed, by moments, or from geometry."""

    fixed: Fraction | None = Field(None, description="the same in every pixel")
    mean: Fraction | None = Field(None, description="with sd: a beta distribution")
    sd: float | None = Field(None, gt=0, lt=0.5)
    geometry: Geometry | None = None
    truth: Literal[True] | None = Field(
        None, description="true: those of the collection's truth, which a finer image or abundances tell by pixel"
    )
    listed: list[Annotated[list[Fraction], Field(min_length=1, max_length=4096)]] | None = Field(
        None, min_length=1, max_length=4096, description="of the pixels of each of some equally likely objects"
    )

    @model_validator(mode="after")
    def _check(self) -> Fill:
        exactly_one(self, ("fixed", "mean", "geometry", "truth", "listed"))
        if (self.mean is None) != (self.sd is None):
            raise ValueError("mean and sd go together")
        return self


class TargetSubject(Model):
    """One population of target pixels: a fill under a name."""

    name: str = Field(min_length=1)
    fill: Fill
    scene_fraction: float = Field(0.0, ge=0, lt=1, description="part of all pixels, for filter_statistics: scene")
    position_m: tuple[float, float] | None = Field(
        None,
        description="centre along lines and samples [m] in a frame common to all subjects: targets beside each "
        "other then share pixels, in object scores and in mean spectra",
    )


class Illumination(Model):
    """Light on a target in shade, as parts of that on open ground; the host beside it stays in the open."""

    beam: Fraction = Field(1.0, description="part of the sun's beam that reaches the target")
    sky_view: Fraction = Field(1.0, description="part of the sky's light that reaches it")


class Target(Surface):
    """A target material on its host class, in one or several fills."""

    host: str = Field(description="background class that fills the rest of the pixel")
    gain: float = Field(1.0, ge=0, description="g_T: factor on the covariance")
    fill: Fill | None = Field(None, description="short for one subject with the target's own name")
    subjects: list[TargetSubject] = Field(default_factory=list)
    illumination: Illumination | None = None
    filter_spectrum: SpectrumSource | None = Field(
        None, description="what the detector looks for, when it is not the target's own spectrum"
    )

    @model_validator(mode="after")
    def _check(self) -> Target:
        if (self.fill is None) == (not self.subjects):
            raise ValueError("give either fill or subjects")
        return self

    @property
    def populations(self) -> list[TargetSubject]:
        """The subjects, one in the target's own name when only ``fill`` is given."""
        return self.subjects or [TargetSubject(name=self.name, fill=self.fill or Fill(fixed=1.0))]


class Adjacency(Model):
    """The surroundings seen through scattering."""

    effective_neighbours: float | None = Field(
        1000.0, ge=1, description="N_eff; kappa = 1/N_eff of (3.11); null: the neighbourhood does not vary"
    )
    spectrum: SpectrumSource | None = Field(
        None,
        description="reflectance of the surroundings, such as that of the image around a site (measured: REGION); "
        "null: the average of the classes (3.8)",
    )

    @property
    def kappa(self) -> float:
        """1 / N_eff of (3.11)."""
        return 1.0 / self.effective_neighbours if self.effective_neighbours else 0.0


class Scene(Model):
    """What lies on the ground."""

    classes: list[BackgroundClass] = Field(min_length=1)
    panels: list[Surface] = Field(default_factory=list, description="subjects of no area")
    sites: list[Surface] = Field(default_factory=list, description="subjects of no area")
    targets: list[Target] = Field(default_factory=list)
    adjacency: Adjacency = Adjacency()
    fractions: Literal["stated", "measured"] = Field(
        "stated",
        description="measured: in a campaign the pixels of the classes' regions take the place of their fractions",
    )

    @model_validator(mode="after")
    def _check(self) -> Scene:
        total = sum(c.fraction for c in self.classes)
        if abs(total - 1.0) > 1e-6:
            raise ValueError(f"the fractions of the classes sum to {total:g}, not 1")
        names = [s.name for s in (*self.classes, *self.panels, *self.sites)]
        names += [p.name for t in self.targets for p in t.populations]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ValueError(f"names of subjects stand twice: {', '.join(twice)}")
        classes = {c.name for c in self.classes}
        for target in self.targets:
            if target.host not in classes:
                raise ValueError(f"target {target.name!r}: host {target.host!r} is none of {sorted(classes)}")
        return self


class ElmPanels(Model):
    """Two panels of the empirical line, by reflectance."""

    reflectances: tuple[Fraction, Fraction] = (0.1, 0.6)

    @model_validator(mode="after")
    def _check(self) -> ElmPanels:
        if not self.reflectances[0] < self.reflectances[1]:
            raise ValueError("the first panel is the darker one")
        return self


class DarkestPixel(Model):
    """Darkest-pixel compensation: the scene's darkest pixel stands for a dark surface, a panel gives the gain."""

    darkest_pixel: int = Field(
        ge=1, le=1_000_000_000, description="pixels of the scene, the darkest of which counts"
    )
    dark_reflectance: float = Field(0.0, ge=0, lt=1, description="what it is taken for")
    panel: Fraction = Field(0.6, description="reflectance of the bright panel")

    @model_validator(mode="after")
    def _check(self) -> DarkestPixel:
        if not self.dark_reflectance < self.panel:
            raise ValueError("the panel is brighter than the dark surface")
        return self


class Features(Model):
    """Linear features in place of bands (Psi of 3.21), from the statistics that the filter is built on."""

    pca: int | None = Field(None, ge=1, le=5000, description="principal components kept")
    mnf: int | None = Field(None, ge=1, le=5000, description="minimum-noise-fraction components kept")

    @model_validator(mode="after")
    def _check(self) -> Features:
        exactly_one(self, ("pca", "mnf"))
        return self


class BandChoice(Model):
    """Bands that the detectors use (a Psi of unit rows, 3.21)."""

    drop_bad: bool = Field(True, description="leave out bands of the sensor's or cube's bad-band list")
    windows_only: bool = Field(False, description="leave out the absorption bands of the atmosphere")
    ranges: list[tuple[float, float]] = Field(default_factory=list, description="keep these ranges only [nm]")
    channels: list[Channel] = Field(default_factory=list, description="keep these bands only, counted from 0")
    bad_channels: list[Channel] = Field(default_factory=list, description="leave out these bands, counted from 0")


class FalseAlarmGrid(Model):
    """False-alarm probabilities of the ROC."""

    lowest: float = Field(1e-9, gt=0, le=0.1)
    per_decade: int = Field(20, ge=1, le=200)


class Processing(Model):
    """From radiance to detection."""

    elm: ElmPanels | DarkestPixel | Literal["none"] = ElmPanels()
    detectors: list[str] = Field(default_factory=lambda: ["cem"])
    bands: BandChoice = BandChoice()
    features: Features | None = None
    samples: int = Field(
        4000, ge=100, le=200_000, description="random pixels per class for detectors that have no closed form (ace)"
    )
    seed: int = Field(0, ge=0, description="of those pixels")
    filter_statistics: Literal["background", "scene"] = Field(
        "background", description="the filter's mean and covariance: background alone, or with the target pixels"
    )
    filter_classes: list[str] = Field(
        default_factory=list, description="classes that give the filter its statistics; empty: all of them"
    )
    false_alarm_grid: FalseAlarmGrid = FalseAlarmGrid()

    @model_validator(mode="after")
    def _check(self) -> Processing:
        for name in self.detectors:
            if name not in MODEL_DETECTORS:
                raise ValueError(f"unknown detector {name!r}; one of {', '.join(MODEL_DETECTORS)}")
        return self


class Scenario(Model):
    """One scenario."""

    schema_version: Literal[1] = Field(1, alias="schema")
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
    title: str = ""
    description: str = ""
    formulation: Literal["corrected", "thesis"] = "corrected"
    atmosphere: AtmosphericState | None = None
    sensor: str | None = Field(None, description="name in the sensor library, or a sensor file")
    sensor_operation: SensorOperation | None = None
    sensor_changes: SensorChanges | None = Field(None, description="numbers that differ from the sensor file")
    scene: Scene
    processing: Processing = Processing()
    uncertainty: Uncertainty = Uncertainty()

    _folder: Path | None = PrivateAttr(None)

    @model_validator(mode="after")
    def _check(self) -> Scenario:
        if self.atmosphere is not None and self.sensor is None and (self.scene.targets or not self.is_of_space):
            raise ValueError("a scenario with an atmosphere needs a sensor, save for mean spectra above it")
        if self.sensor_operation is not None and self.sensor is None:
            raise ValueError("sensor_operation needs a sensor")
        if self.sensor_changes is not None and self.sensor is None:
            raise ValueError("sensor_changes needs a sensor")
        classes = {c.name for c in self.scene.classes}
        for name in self.processing.filter_classes:
            if name not in classes:
                raise ValueError(f"filter_classes: {name!r} is none of {sorted(classes)}")
        return self

    @field_validator("uncertainty")
    @classmethod
    def _is_of_what_is_stated(cls, value: Uncertainty, info: ValidationInfo) -> Uncertainty:
        atmosphere, scene = info.data.get("atmosphere"), info.data.get("scene")
        if atmosphere is not None:
            value.check_atmosphere(atmosphere)
        if scene is not None:
            surfaces = {s.name for s in (*scene.classes, *scene.panels, *scene.sites, *scene.targets)}
            targets = {name for t in scene.targets for name in (t.name, *(p.name for p in t.populations))}
            value.check_subjects(surfaces, targets, {c.name for c in scene.classes})
        return value

    @property
    def is_of_space(self) -> bool:
        """Whether it is looked at from above the atmosphere."""
        return self.atmosphere is not None and self.atmosphere.in_space

    @property
    def folder(self) -> Path | None:
        """Folder of the file that the scenario was read from; file references are relative to it."""
        return self._folder


def builtin_scenarios() -> tuple[str, ...]:
    """Names of the scenarios that ship with the project."""
    folder = resources.files("hyperval") / "scenarios"
    return tuple(sorted(p.name.removesuffix(".yaml") for p in folder.iterdir() if p.name.endswith(".yaml")))


@reader
def load_scenario(name_or_path: str | Path) -> Scenario:
    """A built-in scenario by name, or a scenario file by path.

    Raises
    ------
    UsageError : no such name, or every mistake of the file with its line.
    InputError : no such file.
    """
    text = str(name_or_path)
    if text in builtin_scenarios():
        with resources.as_file(resources.files("hyperval") / "scenarios" / f"{text}.yaml") as path:
            return _load(path)
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml") and not path.exists():
        raise UsageError(
            f"unknown scenario {text!r}", expected="a YAML file or one of " + ", ".join(builtin_scenarios())
        )
    return _load(path)


def _load(path: Path) -> Scenario:
    data, _ = load_yaml(path)
    if "collection" in data and "scene" not in data:
        raise UsageError(
            "this is a campaign, not a scenario", where=str(path),
            mend=f"hyperval validate {path} -o DIR runs all of it; predict takes the file of a scenario",
        )  # fmt: skip
    scenario = load_model(Scenario, path)
    scenario._folder = path.resolve().parent
    return scenario
