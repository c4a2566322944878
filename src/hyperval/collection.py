"""What a campaign says of its collection, and how targets are looked for in it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import Field, field_validator, model_validator

from hyperval.collection_files import (
    BandTableFile,
    CubeSource,
    RadCalNetSource,
    RegionSource,
    SpectrumCollection,
    TargetTruth,
)
from hyperval.config import Model
from hyperval.pixels import ANOMALY_DETECTORS, LOCAL_DETECTORS, detector_names
from hyperval.scenario import SpectrumSource


def _twice(names: Sequence[str]) -> list[str]:
    """The names that stand more than once, in order."""
    return sorted({n for n in names if names.count(n) > 1})


class PanelReference(Model):
    """A calibration panel of the image with its reflectance measured on the ground."""

    region: str
    spectrum: SpectrumSource
    relative_uncertainty: float = Field(0.0, ge=0, lt=1, description="of the panel reflectance, standard")
    correlation_nm: float | None = Field(
        None, gt=0, description="correlation length of that error between bands; None: fully correlated"
    )
    divisor: Literal["standard_error", "spread"] = Field(
        "standard_error",
        description="the standard deviation that the spectrum's file carries is divided by the root of its n, or "
        "not, where it stands for the difference between the readings and the pixels",
    )


class PathRadiance(Model):
    """Path radiance that an atmosphere engine gives, as a black panel."""

    scenario: str = Field(description="scenario file with the atmosphere, surroundings and uncertainties")
    line: str | None = Field(None, description="flight line that it holds for, as its spectra state it")


class DarkestPixelPanel(Model):
    """The darkest radiance of the scene, band by band, as a panel of assumed reflectance."""

    reflectance: float = Field(0.0, ge=0, lt=1)
    uncertainty: float = Field(0.01, gt=0, lt=1, description="of the reflectance, standard")
    radiance_noise: float = Field(0.0, ge=0, description="standard deviation of one pixel's noise [uW cm-2 sr-1 nm-1]")


class EmpiricalLineSource(Model):
    """Panels for the empirical line; a material of known spectrum in the scene is a panel too."""

    panels: list[PanelReference] = Field(min_length=1)
    darkest_pixel: DarkestPixelPanel | None = Field(None, description="a dark panel where none was laid out")
    path_radiance: list[PathRadiance] = Field(
        default_factory=list,
        description="with spectra: black ground as an engine sees it, for each flight line; used where a single "
        "other site is known, which makes a one-point line",
    )
    intercept: bool = Field(True, description="false: a line through the origin, for radiance without path part")
    saturation: float | None = Field(
        None,
        gt=0,
        description="value of the cube at which its detector is full: a panel with such a pixel is refused; the "
        "greatest integer of the stored type always counts as full",
    )

    @model_validator(mode="after")
    def _enough(self) -> EmpiricalLineSource:
        if self.intercept and len(self.panels) + bool(self.darkest_pixel or self.path_radiance) < 2:
            raise ValueError(
                "an empirical line needs two panels, or one and darkest_pixel or path_radiance, or intercept: false"
            )
        if not self.intercept and (self.darkest_pixel or self.path_radiance):
            raise ValueError("darkest_pixel and path_radiance give the path part, which intercept: false says is none")
        lines = [entry.line for entry in self.path_radiance]
        if len(set(lines)) < len(lines):
            raise ValueError("path_radiance: a flight line stands twice")
        return self


class CalibrationUncertainty(Model):
    """Relative standard uncertainty of the collected radiance, common to all pixels."""

    relative: float | None = Field(None, ge=0, lt=1)
    file: str | None = Field(None, description="text table: wavelength nm, relative standard uncertainty")
    correlation_nm: float | None = Field(
        None,
        gt=0,
        description="correlation length between bands; None: one error for all bands, but one for each where a "
        "file states it band by band",
    )
    uncorrelated: float | None = Field(
        None, gt=0, lt=1, description="besides: a relative standard uncertainty of each band by itself"
    )

    @model_validator(mode="after")
    def _one_source(self) -> CalibrationUncertainty:
        if (self.relative is None) == (self.file is None):
            raise ValueError("give exactly one of relative, file")
        return self


class CollectionSection(Model):
    """What was collected."""

    simulate: str | None = Field(
        None, description="scene file: the collection is generated; its files are 'simulated:NAME' below"
    )
    cube: CubeSource | None = None
    spectra: list[SpectrumCollection] = Field(default_factory=list)
    radcalnet: RadCalNetSource | None = Field(None, description="top-of-atmosphere reflectance of a network's site")
    bands: BandTableFile | None = Field(
        None, description="needed with spectra; for a cube, takes the place of its wavelengths and bad-band list"
    )
    regions: list[RegionSource] = Field(default_factory=list)
    targets: TargetTruth | None = None
    leave_out: list[str] = Field(
        default_factory=list, description="regions that count as neither background nor false alarm"
    )
    empirical_line: EmpiricalLineSource | None = None
    calibration: CalibrationUncertainty | None = None
    detector: str | None = Field(
        None,
        description="with spectra: sensor of the library, or file, whose noise over the pixels of a site is "
        "an error of its mean",
    )
    snr_regions: list[str] = Field(default_factory=list, description="regions whose SNR the image gives")

    @model_validator(mode="after")
    def _one_source(self) -> CollectionSection:
        if bool(self.cube) + bool(self.spectra) + bool(self.radcalnet) != 1:
            raise ValueError("give exactly one of cube, spectra, radcalnet")
        if self.detector is not None and not (self.spectra and all(site.pixels for site in self.spectra)):
            raise ValueError("detector is for spectra, each of which states its pixels: a cube shows its own noise")
        line = self.empirical_line
        if line is not None and self.cube is None and not self.spectra:
            raise ValueError("empirical_line is for a cube or spectra")
        if line is not None and line.path_radiance and self.cube is not None:
            raise ValueError("empirical_line.path_radiance is for spectra; a cube shows its darkest_pixel")
        if line is not None and self.spectra and (line.darkest_pixel or line.saturation is not None):
            raise ValueError("empirical_line: spectra show no darkest_pixel and no saturation")
        if self.simulate and self.cube is None:
            raise ValueError("a simulated collection is a cube: give cube.path as simulated:NAME_rad.img")
        cube = self.cube
        if cube and cube.quantity == "radiance" and not (cube.unit or self.simulate or cube.may_state_unit):
            raise ValueError("the unit of the radiance is not stated: cube.unit, such as uW cm-2 sr-1 nm-1")
        if self.spectra and self.bands is None:
            raise ValueError("spectra need 'bands': a table of band centres and widths")
        return self


class DetectionTarget(Model):
    """A spectrum to look for and the material of the truth it stands for."""

    name: str = Field(description="names the score map; several spectra may stand for one material")
    material: str
    spectrum: SpectrumSource


class Pool(Model):
    """Curves of several subjects counted together, such as all materials of one size."""

    name: str
    subjects: list[str] = Field(min_length=2)


class AreaCheck(Model):
    """Area of each target object from the sum of its scores."""

    target: str = Field(description="name of a detection target")
    detector: str
    margin_pixels: int = Field(1, ge=0, description="pixels around the object included in the sum")


class ClassFeatures(Model):
    """What a classifier sees of a spectrum: a few bands, principal components, or every usable band."""

    name: str = Field(min_length=1, description="stands in the table as the method")
    bands_nm: list[float] = Field(
        default_factory=list, max_length=400, description="the bands nearest to these wavelengths; empty: all"
    )
    pca: int | None = Field(
        None, ge=1, le=400, description="principal components of the classes taken together; None: bands"
    )


class Classification(Model):
    """Classes that a Gaussian maximum-likelihood classifier is to tell apart, and how its error is measured."""

    classes: list[str] = Field(min_length=2, max_length=12, description="regions, each the subject of its class")
    features: list[ClassFeatures] = Field(min_length=1)
    pairs: bool = Field(False, description="every pair of classes as well")
    block_lines: int = Field(
        8,
        ge=1,
        description="lines of a block: whole blocks train or test, as neighbouring pixels resemble each other",
    )
    pixels: int = Field(20_000, ge=100, le=200_000, description="at most so many pixels of a class train, or test")
    seed: int = Field(0, ge=0)

    @model_validator(mode="after")
    def _names_differ(self) -> Classification:
        for names in (self.classes, [f.name for f in self.features]):
            if twice := _twice(names):
                raise ValueError(f"{twice[0]!r} stands twice")
        return self


class UnmixedTarget(Model):
    """A detection target whose area is found by unmixing, and what the model takes it for."""

    target: str = Field(description="name of a detection target: its spectrum is the endmember")
    scenario_target: str | None = Field(
        None, description="target of the scenario that gives fills, host and spread; None: the one of the same name"
    )
    endmembers: str = Field("", description="where the spectrum is from, such as field; told apart in the results")
    relative_uncertainty: float = Field(
        0.0, ge=0, lt=1, description="of the endmember as a picture of the target, standard"
    )
    correlation_nm: float | None = Field(None, gt=0, description="of that uncertainty; None: fully correlated")


class Unmixing(Model):
    """Area of each target object from its abundances: endmembers are its spectrum and the background around it."""

    targets: list[UnmixedTarget] = Field(min_length=1)
    background: str = Field(description="region whose pixels around the object give the other endmember")
    ring_pixels: int = Field(8, ge=1, le=64, description="how far around the object they are taken")
    weights: tuple[Literal["equal", "background"], ...] = Field(
        ("equal",),
        min_length=1,
        description="all bands alike (method fcls), or by the inverse covariance of the background (fcls-weighted)",
    )
    draws: int = Field(400, ge=50, le=5000, description="objects drawn for the prediction")
    seed: int = Field(0, ge=0)


class LocalWindowSource(Model):
    """Squares around each pixel, whose pixels between the two give it a background mean of its own."""

    outer_pixels: int = Field(ge=5, le=201, description="side of the outer square, odd")
    inner_pixels: int = Field(ge=1, le=199, description="side of the inner square, odd: wider than the target")

    @model_validator(mode="after")
    def _fits(self) -> LocalWindowSource:
        if self.outer_pixels % 2 == 0 or self.inner_pixels % 2 == 0 or self.inner_pixels >= self.outer_pixels:
            raise ValueError("outer_pixels and inner_pixels are odd, and the inner one is less")
        return self


class Bootstrap(Model):
    """Resampling of target objects, for the intervals of areas under the ROC."""

    draws: int = Field(1000, ge=100, le=100_000)
    seed: int = Field(0, ge=0)


class Detection(Model):
    """How targets are looked for in the image, or anomalies where no target is named."""

    targets: list[DetectionTarget] = Field(
        default_factory=list, description="what is looked for; none: anomalies, by the detector rx alone"
    )
    detectors: list[str] = Field(default_factory=lambda: ["cem"], min_length=1)
    background: list[str] = Field(
        default_factory=lambda: ["scene"],
        description="regions whose pixels give the filter its statistics; 'scene': all that is not left out; "
        "'image': every pixel, targets included",
    )
    false_alarms: list[str] = Field(
        default_factory=lambda: ["scene"], description="regions whose pixels count for the false-alarm rate"
    )
    undesired: list[str] = Field(
        default_factory=list, description="regions whose mean spectra the detector 'osp' projects away"
    )
    local_window: LocalWindowSource | None = Field(
        None,
        description="the background mean moves with the pixel, the covariance stays that of the whole background; "
        "not for 'osp' and 'sam', which have no mean",
    )
    halo_pixels: int = Field(
        0,
        ge=0,
        le=50,
        description="pixels around a target whose greatest score counts for the object; the background is then "
        "scored by the same footprint",
    )
    first_detection: bool = Field(
        False,
        description="besides: false alarms before the first true detection of a subject, as RIT's self-test counts",
    )
    bands: Literal["all", "good", "windows"] = "good"
    least_snr: float | None = Field(None, gt=0, description="bands with less in the background are left out")
    group: str = Field(
        "{name}",
        description="subject of a target object; the columns of the truth stand in braces, such as {material}",
    )
    pools: list[Pool] = Field(default_factory=list)
    bootstrap: Bootstrap = Field(default_factory=Bootstrap)
    areas: list[AreaCheck] = Field(default_factory=list)
    unmixing: Unmixing | None = None

    @field_validator("detectors")
    @classmethod
    def _known(cls, names: list[str]) -> list[str]:
        for name in names:
            if name not in detector_names():
                raise ValueError(f"unknown detector {name!r}; one of {', '.join(detector_names())}")
        return names

    @model_validator(mode="after")
    def _anomalies_alone(self) -> Detection:
        if not self.targets and not set(self.detectors) <= set(ANOMALY_DETECTORS):
            raise ValueError(f"without targets the detectors can only be {', '.join(ANOMALY_DETECTORS)}")
        if not self.targets and (self.pools or self.areas or self.unmixing or self.halo_pixels):
            raise ValueError("pools, areas, unmixing and halo_pixels need targets")
        return self

    @model_validator(mode="after")
    def _detectors_fit(self) -> Detection:
        without = [name for name in self.detectors if name not in LOCAL_DETECTORS]
        if self.local_window is not None and without:
            raise ValueError(f"local_window: the detector {without[0]!r} has no mean that could be local")
        if ("osp" in self.detectors) != bool(self.undesired):
            raise ValueError("the detector 'osp' and 'undesired', the regions that it projects away, go together")
        if twice := _twice([t.name for t in self.targets]):
            raise ValueError(f"two detection targets are named {twice[0]!r}")
        return self
