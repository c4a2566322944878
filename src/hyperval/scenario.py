"""The scenario file: scene, atmosphere, sensor and processing, sources of spectra and covariances, and uncertainties.

Without ``atmosphere`` the scenario lives in the reflectance domain: no radiance, no sensor noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from hyperval.atmosphere import AtmosphericState
from hyperval.config import FileModel, Model, OneOf, file_of, load_model, shipped, twice, unknown
from hyperval.data import LINEAR_DETECTORS, MAX_COMPONENTS, NUMERICAL_DETECTORS
from hyperval.errors import reader
from hyperval.sensor.specification import SensorChanges, SensorOperation
from hyperval.settings import with_settings


class Replicates(Model):
    """Several spectra of one surface, whose mean, covariance and number are taken.

    A bare name or list of names stands for ``files``.
    """

    files: str | list[str] = Field(
        description="files, or patterns such as spectra/grass*.asd; every spectrum of every file counts"
    )
    records: list[str | int] | None = Field(
        None, min_length=2, description="which spectra of the files, by name or number from 0; None: all"
    )
    wavelength_unit: str | None = Field(None, description="stated when the files do not say")
    reflectance_unit: str | None = Field(None, description="stated when the files do not say: fraction, percent")

    @model_validator(mode="before")
    @classmethod
    def _bare(cls, value: Any) -> Any:
        return {"files": value} if isinstance(value, str | list) else value

    @property
    def references(self) -> tuple[str, ...]:
        """The files as they are named."""
        return (self.files,) if isinstance(self.files, str) else tuple(self.files)


class SpectrumSource(OneOf):
    """A reflectance spectrum: built in, constant, from a file, or measured on the imagery."""

    one_of = ("builtin", "constant", "file", "replicates", "library", "measured")
    builtin: str | None = Field(None, title="built-in surface")
    constant: float | None = Field(None, title="constant reflectance", ge=0, le=1.5, description="in every band [1]")
    file: str | None = Field(None, title="spectrum file", description="field spectrum or library file")
    replicates: Replicates | None = Field(
        None, description="field spectra of one surface: their mean, covariance and standard error"
    )
    library: str | None = Field(None, description="statistics library: mean and covariance of classes (NetCDF)")
    measured: str | None = Field(None, description="region of the collection whose statistics are handed in")
    record: str | int | None = Field(
        None, description="which spectrum of a file of several: name, number from 0, or mean of all"
    )
    gaps: Literal["refused", "allowed"] = Field(
        "refused", title="bands beyond its ends", description="usable ones; left out where allowed, or a tenth at most"
    )
    wavelength_unit: str | None = Field(None, description="stated when the file does not say")
    reflectance_unit: str | None = Field(None, description="stated when the file does not say: fraction, percent")

    refused: ClassVar = {
        "record and units belong to a file": lambda s: s.file is None and (
            s.wavelength_unit or s.reflectance_unit or (s.library is None and s.record is not None)
        ),
        "a record of a statistics library goes by name": lambda s: s.library and not isinstance(s.record, str | None),
    }  # fmt: skip


CorrelationLength = Annotated[float | None, Field(ge=0.001, description="correlation length; None: fully correlated")]


class CovarianceSource(OneOf):
    """Spread from pixel to pixel: built in, measured, none, or a relative one with a correlation length."""

    one_of = ("builtin", "replicates", "library", "measured", "relative_sd")
    builtin: str | None = Field(None, title="built-in surface")
    replicates: Replicates | None = Field(None, description="field spectra of one surface")
    library: str | None = Field(None, description="statistics library (NetCDF)")
    record: str | None = Field(None, description="with library: name of the class")
    measured: str | None = None
    relative_sd: float | None = Field(
        None, title="relative standard deviation", ge=0, le=10, description="as a part of the mean [1]; 0: none"
    )
    correlation_nm: CorrelationLength = None
    band_sd: float = Field(0.0, ge=0, le=10, description="with relative_sd: independent part of each band [1]")

    refused: ClassVar = {"record belongs to a library": lambda s: s.record is not None and s.library is None}


Spread = Annotated[float, Field(gt=0)]


class SpectralForm(OneOf):
    """How an error hangs together between bands."""

    at_most_one_of = ("correlation", "correlation_nm")
    correlation_nm: CorrelationLength = None
    correlation: Literal["systematic", "random", "arms"] | None = Field(
        None,
        description="systematic: one error for all bands; random: one for each; arms: one for each arm of the sensor; "
        "None: systematic, or by correlation_nm",
    )


class SpectrumUncertainty(SpectralForm):
    """Standard uncertainty of the field spectrum of one subject."""

    one_of = ("relative", "absolute", "from_file")
    subject: str = Field(description="entries of the same subject are independent and add up")
    relative: float | None = Field(None, gt=0, lt=1, description="as a part of the reflectance")
    absolute: float | None = Field(None, gt=0, lt=1, description="in reflectance")
    from_file: bool = Field(False, description="the standard deviation that the spectrum's file carries")
    divisor: Literal["standard_error", "spread"] = Field(
        "spread", description="with from_file: divide by the root of the file's n, or not"
    )


class FineStructure(SpectralForm):
    """Error of the shape of single absorption lines and bands, as a part of the ground-reflected radiance.

    u = relative + per_optical_depth * (-ln T_gas).
    """

    relative: float = Field(ge=0, lt=1)
    per_optical_depth: float = Field(0.0, ge=0, lt=10)


class EngineUncertainty(FineStructure):
    """How far the radiative-transfer engine itself may be off, as a part of the ground-reflected radiance.

    u = relative + per_optical_depth * (-ln T_gas) + per_aerosol_depth * tau: absorption bands are worse than windows,
    and haze, of optical depth tau at 550 nm above the ground, worse than clear air.
    """

    per_aerosol_depth: float = Field(0.0, ge=0, lt=10)
    path_relative: float = Field(0.0, ge=0, lt=1, description="of the path radiance")
    fine_structure: FineStructure | None = Field(
        None, description="besides: the error that changes from band to band, with a form of its own"
    )


class CollectedReflectance(Model):
    """Error of the reflectance that the collection holds, common to all its pixels: that of its compensation.

    Statistics taken from the image have it, field spectra have not: it enters what is compared with these, scores and
    P_D.
    """

    relative: float = Field(0.0, ge=0, lt=1, description="as a part of the reflectance")
    absolute: float = Field(0.0, ge=0, lt=1, description="in reflectance")
    correlation_nm: CorrelationLength = None


class RelativeUncertainty(SpectralForm):
    """Standard uncertainty of a factor on something that varies with wavelength."""

    relative: float = Field(gt=0, lt=1, description="as a part of it")


class RadianceUncertainty(SpectralForm):
    """Standard uncertainty of an added radiance."""

    absolute: float = Field(gt=0, description="[uW cm-2 sr-1 nm-1]")


class ShiftUncertainty(SpectralForm):
    """Standard uncertainty of the places of the bands."""

    absolute: float = Field(gt=0, le=50, description="[nm]")


class NamedSpread(Model):
    """Standard uncertainty of a number of one subject."""

    subject: str
    absolute: Spread = Field(description="standard uncertainty, in the unit of the number")


class Uncertainty(OneOf):
    """Standard uncertainties of the inputs; each is a source of the budget."""

    at_most_one_of = ("aot550", "meteorological_range_km")
    method: Literal["linear", "monte-carlo", "both"] = Field(
        "linear",
        description="propagation: linearised; by draws; or both, compared, where the draws give the interval of "
        "P_D wherever the two differ",
    )
    samples: int = Field(400, ge=40, le=100_000, description="draws of the budget")
    seed: int = Field(0, ge=0, description="of the draws")
    psf_fwhm_pixels: Spread | None = Field(
        None, description="of the PSF width of targets with geometry, common to all [pixels]"
    )
    position_m: float | None = Field(
        None, gt=0, lt=100, description="of the places of neighbours in line and sample; for object scores"
    )
    collected_reflectance: CollectedReflectance | None = None

    aot550: Spread | None = Field(None, title="aerosol optical depth", description="absolute")
    angstrom_exponent: Spread | None = Field(None, description="absolute")
    aerosol_share_below: Spread | None = Field(None, description="absolute")
    meteorological_range_km: Spread | None = Field(None, description="absolute [km], in place of aot550")
    water_vapour_g_cm2: Spread | None = Field(None, description="absolute [g cm-2]")
    ozone_atm_cm: Spread | None = Field(None, description="absolute [atm cm]")
    solar_zenith_deg: Spread | None = Field(None, description="absolute [deg]")
    solar_azimuth_deg: Spread | None = Field(None, description="absolute [deg]")
    view_zenith_deg: Spread | None = Field(None, description="absolute [deg]")
    view_azimuth_deg: Spread | None = Field(None, description="absolute [deg]")
    sensor_altitude_km: Spread | None = Field(None, description="absolute [km]")
    ground_altitude_km: Spread | None = Field(None, description="absolute [km]")
    solar_irradiance_relative: Spread | None = Field(None, lt=1, description="common to all bands")
    adjacency_reflectance_relative: Spread | None = Field(
        None, lt=1, description="of the reflectance of the surroundings, common to all bands"
    )
    engine: EngineUncertainty | None = None
    field_spectra: list[SpectrumUncertainty] = Field([])
    sensor_gain: RelativeUncertainty | None = Field(
        None, description="of the recorded radiance; leave it out where the collection states its calibration"
    )
    sensor_offset: RadianceUncertainty | None = Field(None, description="of the recorded radiance")
    noise: RelativeUncertainty | None = Field(None, description="of the noise standard deviation")
    electrons: RelativeUncertainty | None = Field(None, description="of the electrons per radiance")
    elm_panels: RelativeUncertainty | None = Field(
        None,
        description="of the reflectance of each panel of the empirical line, independent between panels; for "
        "detection, as the collection states it for its reflectance",
    )
    wavelength_shift: ShiftUncertainty | None = Field(None, description="of the band centres")
    fills: list[NamedSpread] = Field([], description="mean fill fraction of targets or subjects [1]")
    fractions: list[NamedSpread] = Field([], description="area fractions of classes; the others give way in proportion")

    refused: ClassVar = {  # field_spectra: entries of a subject add up
        "fills: a subject occurs twice": lambda u: twice(i.subject for i in u.fills),
        "fractions: a subject occurs twice": lambda u: twice(i.subject for i in u.fractions),
    }


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

    fraction: Fraction = Field(title="area fraction", description="f_m; the fractions of all classes sum to 1")
    gain: float = Field(1.0, title="factor on the covariance", ge=0, description="g_B")
    tail_dof: Annotated[float, Field(gt=2)] | Literal["measured"] | None = Field(
        None, title="degrees of freedom of the tails", description="of a multivariate t, or as the measured region has"
    )
    mixture: Annotated[int, Field(ge=1, le=MAX_COMPONENTS)] | Literal["auto"] | None = Field(
        None,
        description="components of the law of its scores, fitted to the measured region or stored "
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
    heading_deg: float | Literal["random"] = Field(0.0, description="of the length, counter-clockwise from the lines")
    gsd_m: float = Field(title="ground sampling distance", gt=0, description="ground side of a pixel")
    psf_fwhm_pixels: BlurWidth | tuple[BlurWidth, BlurWidth] | None = Field(
        None,
        title="PSF width (FWHM)",
        description="besides the square aperture, or (along, across); None: the sensor's",
    )
    phase: Literal["random", "centred"] = Field("random", title="position in the pixel")
    pixels: Literal["best", "ranked", "touched"] = Field(
        "best",
        description="the fullest pixel of an object alone; its n fullest, as a truth that counts so many has; or "
        "all that its outline meets, as a truth by outlines has",
    )
    n: int | None = Field(None, ge=1, le=400, description="pixels of an object, with ranked")

    refused: ClassVar = {
        "a square has side_m; a rectangle has length_m and width_m": lambda g: (
            (g.side_m is None) == (g.shape == "square") or (None in (g.length_m, g.width_m)) == (g.shape != "square")
        ),
        "ranked pixels need n, the number of pixels of an object; best takes none": lambda g: (
            (g.pixels == "ranked") == (g.n is None)
        ),
    }

    @property
    def sides_pixels(self) -> tuple[float, float]:
        """Length, which runs along the heading, and width [pixels]."""
        length, width = self.side_m or self.length_m or 0.0, self.side_m or self.width_m or 0.0
        return length / self.gsd_m, width / self.gsd_m


class Fill(OneOf):
    """Part of a pixel that the target fills: fixed, by moments, or from geometry."""

    one_of = ("fixed", "mean", "geometry", "truth", "listed")
    together = ("mean", "sd")
    fixed: Fraction | None = Field(None, title="fill fraction", description="the same in every pixel")
    mean: Fraction | None = Field(None, title="mean fill fraction", description="with sd: a beta distribution")
    sd: float | None = Field(None, title="standard deviation of the fill fraction", ge=1e-6, lt=0.5)
    geometry: Geometry | None = None
    truth: Literal[True] | None = Field(
        None, description="true: those of the collection's truth, which a finer image or abundances tell by pixel"
    )
    listed: tuple[Annotated[tuple[Fraction, ...], Field(min_length=1, max_length=4096)], ...] | None = Field(
        None, min_length=1, max_length=4096, description="of the pixels of each of some equally likely objects"
    )


class TargetSubject(Model):
    """One population of target pixels: a fill under a name."""

    name: str = Field(min_length=1)
    fill: Fill
    position_m: tuple[float, float] | None = Field(
        None,
        description="centre along lines and samples [m] in a frame common to all subjects: targets beside each "
        "other then share pixels, in object scores and in mean spectra",
    )


class Illumination(Model):
    """Light on a target in shade, as parts of that on open ground; the host beside it stays in the open."""

    beam: Fraction = Field(1.0, title="direct beam", description="part of it that reaches the target")
    sky_view: Fraction = Field(1.0, title="sky view factor", description="part of the sky's light that reaches it")


class Target(Surface, OneOf):
    """A target material on its host class, in one or several fills."""

    one_of = ("fill", "subjects")
    host: str = Field(title="host class", description="background that fills the rest of the pixel")
    gain: float = Field(1.0, title="factor on the covariance", ge=0, description="g_T")
    fill: Fill | None = Field(None, description="short for one subject with the target's own name")
    subjects: list[TargetSubject] = Field([], title="fill populations")
    illumination: Illumination | None = None
    filter_spectrum: SpectrumSource | None = Field(
        None, title="spectrum sought", description="by the detector, when it is not the target's own"
    )

    @property
    def populations(self) -> list[TargetSubject]:
        """The subjects, one in the target's own name when only ``fill`` is given."""
        return self.subjects or [TargetSubject(name=self.name, fill=self.fill or Fill(fixed=1.0))]


class Adjacency(Model):
    """The surroundings seen through scattering."""

    effective_neighbours: float | None = Field(
        1000.0, title="effective number of neighbours", ge=1, description="N_eff = 1/kappa of (3.11); null: no variance"
    )
    spectrum: SpectrumSource | None = Field(
        None,
        title="spectrum of the surroundings",
        description="reflectance of the surroundings, such as that of the image around a site (measured: REGION); "
        "null: the average of the classes (3.8)",
    )


class Scene(Model):
    """What lies on the ground."""

    classes: list[BackgroundClass] = Field(title="backgrounds", min_length=1)
    panels: list[Surface] = Field([], description="predicted, without a share of the scene's area")
    sites: list[Surface] = Field([], description="predicted, without a share of the scene's area")
    targets: list[Target] = Field([])
    adjacency: Adjacency = Adjacency()
    fractions: Literal["stated", "measured"] = Field(
        "stated",
        description="measured: in a campaign the pixels of the classes' regions take the place of their fractions",
    )

    refused: ClassVar = {
        "classes: their fractions sum to {:g}, not 1": lambda s: (
            abs((total := sum(c.fraction for c in s.classes)) - 1.0) > 1e-6 and [total]
        ),
        "names of subjects occur twice: {names}": lambda s: (
            twice(x.name for x in (*s.classes, *s.panels, *s.sites, *(p for t in s.targets for p in t.populations)))
            or twice(x.name for x in (*s.classes, *s.panels, *s.sites, *s.targets))
        ),
        "targets: {!r}: host {!r} is not one of {}": lambda s: next(
            ([t.name, *wrong] for t in s.targets if (wrong := unknown([t.host], (c.name for c in s.classes)))), []
        ),
    }


class ElmPanels(Model):
    """Two panels of the empirical line, by reflectance."""

    reflectances: tuple[Fraction, Fraction] = (0.1, 0.6)
    refused: ClassVar = {"the first panel is the darker one": lambda e: not e.reflectances[0] < e.reflectances[1]}


class DarkestPixel(Model):
    """Darkest-pixel compensation: the scene's darkest pixel stands for a dark surface, a panel gives the gain."""

    darkest_pixel: int = Field(ge=1, le=1_000_000_000, description="pixels of the scene, the darkest of which counts")
    reflectances: ClassVar = (0.0, 0.6)  # what it is taken for, and that of the bright panel


class Features(Model):
    """Linear features in place of bands (Psi of 3.21), from the statistics that the filter is built on."""

    pca: int = Field(title="principal components", ge=1, le=5000)


class BandChoice(Model):
    """Bands that the detectors use (a Psi of unit rows, 3.21)."""

    drop_bad: bool = Field(True, description="leave out bands of the sensor's or cube's bad-band list")
    windows_only: bool = Field(False, description="leave out the absorption bands of the atmosphere")
    ranges: list[tuple[float, float]] = Field([], description="keep these ranges only [nm]")
    channels: list[Channel] = Field([], description="keep these bands only, counted from 0")
    bad_channels: list[Channel] = Field([], description="leave out these bands, counted from 0")


class FalseAlarmGrid(Model):
    """False-alarm probabilities of the ROC."""

    lowest: float = Field(1e-9, title="lowest P_FA", gt=0, le=0.1)
    per_decade: int = Field(20, title="points a decade", ge=1, le=200)


class Processing(Model):
    """From radiance to detection."""

    elm: ElmPanels | DarkestPixel | Literal["none"] = Field(ElmPanels(), title="empirical line")
    detectors: list[str] = Field(["cem"])
    bands: BandChoice = BandChoice()
    features: Features | None = None
    samples: int = Field(
        4000, title="random pixels", ge=100, le=200_000, description="per class, for detectors of no closed form (ace)"
    )
    seed: int = Field(0, ge=0, description="of those pixels")
    filter_classes: list[str] = Field([], description="classes that give the filter its statistics; empty: all of them")
    false_alarm_grid: FalseAlarmGrid = FalseAlarmGrid()

    refused: ClassVar = {"detectors: unknown detector {!r}; one of {}": lambda p: unknown(p.detectors, MODEL_DETECTORS)}

    @property
    def linear_detectors(self) -> list[str]:
        """Those whose score is linear in the pixel."""
        return [d for d in self.detectors if d in LINEAR_DETECTORS]


class Scenario(FileModel):
    """One scenario."""

    formulation: Literal["corrected", "thesis"] = "corrected"
    atmosphere: AtmosphericState | None = None
    sensor: str | None = Field(None, description="name in the sensor library, or a sensor file")
    sensor_operation: SensorOperation | None = None
    sensor_changes: SensorChanges | None = Field(None, description="numbers that differ from the sensor file")
    scene: Scene
    processing: Processing = Processing()
    uncertainty: Uncertainty = Uncertainty()

    refused: ClassVar = {
        "an atmosphere needs a sensor, unless sensor_altitude_km is 100 or more and there is no target": lambda s: (
            s.atmosphere and not s.sensor and (s.scene.targets or not s.is_of_space)
        ),
        "sensor_operation needs a sensor": lambda s: s.sensor_operation and not s.sensor,
        "sensor_changes needs a sensor": lambda s: s.sensor_changes and not s.sensor,
        "processing.filter_classes: {!r} is not one of {}": lambda s: unknown(
            s.processing.filter_classes, (c.name for c in s.scene.classes)
        ),
        "uncertainty.{0}: is given, but atmosphere.{0} is not: state it there, too": lambda s: s.atmosphere and [
            name for name in ("meteorological_range_km", "water_vapour_g_cm2", "ozone_atm_cm", "angstrom_exponent",
                              "aerosol_share_below")
            if getattr(s.uncertainty, name) is not None and getattr(s.atmosphere, name) is None
        ],
        "uncertainty.field_spectra: no class, panel, site or target {!r}; there are {}": lambda s: unknown(
            (one.subject for one in s.uncertainty.field_spectra),
            sorted(x.name for x in (*s.scene.classes, *s.scene.panels, *s.scene.sites, *s.scene.targets)),
        ),
        "uncertainty.fills: no target or subject {!r}; there are {}": lambda s: unknown(
            (one.subject for one in s.uncertainty.fills),
            sorted({n for t in s.scene.targets for n in (t.name, *(p.name for p in t.populations))}),
        ),
        "uncertainty.fractions: no class {!r}; there are {}": lambda s: unknown(
            (one.subject for one in s.uncertainty.fractions), sorted(c.name for c in s.scene.classes)
        ),
    }  # fmt: skip

    def with_values(self, values: Mapping[str, Any]) -> Scenario:
        """A copy with other values at dotted paths, checked as a file is; None takes an entry back.

        >>> plain = load_scenario("yellow-planks-asphalt")
        >>> plain.with_values({"scene.classes.grass.tail_dof": 5}).scene.classes[1].tail_dof
        5.0

        Raises
        ------
        UsageError : a path that leads nowhere, or values that contradict the rest.
        """
        return with_settings(self, values)

    @property
    def is_of_space(self) -> bool:
        """Whether it is looked at from above the atmosphere."""
        return self.atmosphere is not None and self.atmosphere.in_space


def builtin_scenarios() -> dict[str, Path]:
    """Name -> file of the scenarios that ship with the project."""
    return shipped("hyperval", "scenarios")


def refuse_unknown(name: str, folder: Path) -> None:
    """Raise UsageError for what is neither a file of the folder nor a scenario that goes by name."""
    if not (folder / name).exists():
        file_of(name, builtin_scenarios(), "scenario")


@reader
def load_scenario(name_or_path: str | Path) -> Scenario:
    """A built-in scenario by name, or a scenario file by path.

    >>> load_scenario("panels").sensor
    'prospectir-vs'

    Raises
    ------
    UsageError : no such name, or every mistake of the file with its line.
    InputError : no such file.
    """
    library = builtin_scenarios()
    path = file_of(name_or_path, library, "scenario")
    scenario = load_model(Scenario, path)
    if path in library.values():  # it has no files of its own: those that are set in it are the user's
        scenario._folder = None
    return scenario
