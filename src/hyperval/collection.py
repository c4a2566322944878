"""What a campaign says of its collection, and how targets are looked for in it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from hyperval.config import Model, OneOf, RadianceUnit, WavelengthUnit, twice, unknown
from hyperval.pixels import ANOMALY_DETECTORS, LOCAL_DETECTORS, detector_names
from hyperval.scenario import CorrelationLength, SpectrumSource

_PLAIN = ("", ".img", ".bil", ".bip", ".bsq", ".dat", ".raw", ".bin", ".hdr", ".mat", ".npy")
Fwhm = Annotated[float, Field(ge=0, le=8)]


class CubeSource(Model):
    """An image cube on disk."""

    path: str
    variable: str | None = Field(None, description="which array is the image, where a file holds several")
    engine: str | None = Field(None, description="engine of xarray that opens the file; None: by its content")
    header: str | None = Field(None, description="ENVI header that describes it, when it is not beside the cube")
    quantity: Literal["radiance", "reflectance", "counts"] = Field(description="counts: values of unknown unit")
    unit: RadianceUnit | None = Field(
        None, description="of the scaled radiance; None: the product's own, or that of a simulation"
    )
    scale: float | None = Field(None, gt=0, description="stored value times this is the value; None: the header's")
    wavelength_unit: WavelengthUnit | None = Field(None, description="stated when the header does not say nm or um")
    sort_bands: bool = Field(False, description="sort bands whose wavelengths fall, as where detectors overlap")
    by_number: bool = Field(
        False, description="bands go by number, as no wavelength is known: what needs wavelengths is left out"
    )
    glt: str | None = Field(
        None, description="lookup table (GLT) or places of pixels (IGM); None: the product's own, or one beside it"
    )

    refused: ClassVar = {
        "by_number is for reflectance or counts without known wavelengths": lambda c: (
            c.by_number and (c.quantity == "radiance" or c.wavelength_unit or c.sort_bands)
        ),
        "unit is of radiance; of percent the scale is 0.01": lambda c: c.unit and c.quantity != "radiance",
    }

    @property
    def may_state_unit(self) -> bool:
        """Whether files of this kind can say themselves what unit their radiance is in."""
        return Path(self.path).suffix.lower() not in _PLAIN


class SpectrumCollection(Model):
    """A collected radiance spectrum of one site, where no cube is held."""

    subject: str
    path: str
    record: str | int | None = Field(None, description="which spectrum of a file of several, as for reflectances")
    unit: RadianceUnit | None = Field(None, description="of the radiance; None: the file's, else uW cm-2 sr-1 nm-1")
    wavelength_unit: Literal["nm", "um"] = "nm"
    pixels: int | None = Field(None, ge=1, description="pixels averaged (integrations), when known")
    line: str | None = Field(None, description="flight line: sites of one line share an empirical line")


class RadCalNetSource(Model):
    """Top-of-atmosphere reflectance that RadCalNet computed for a day of a site."""

    path: str = Field(description="daily file that ends in .output")
    subject: str = Field("{site} {time}", description="name of a half hour; {site}, {time} are those of the file")
    times: list[str] = Field([], description="half hours, such as 04:00; empty: all with values")
    fwhm_nm: float | None = Field(
        None, gt=0, le=100, description="width of the bands; None: as the oxygen band at 760 nm shows it"
    )
    correlation_nm: CorrelationLength = None
    shared_inputs: bool = Field(
        False,
        description="true: the prediction starts from the same surface and state as the network's computation, "
        "whose stated uncertainty is then mostly common to both sides; rounding alone is an error of their "
        "difference, and the share of bands inside the stated uncertainty is told apart",
    )


class BandTableFile(Model):
    """A text table with the band centres and widths of collected spectra."""

    path: str
    wavelength_unit: Literal["nm", "um"]
    centre_column: int = Field(0, ge=0, description="0-based column of the band centres")
    fwhm_column: int | None = Field(None, ge=0, description="0-based column of the FWHM; None: the band spacing")


class NormalizedDifference(Model):
    """Pixels whose normalised difference of two band averages lies between two limits."""

    high_nm: tuple[float, float]
    low_nm: tuple[float, float]
    above: float = -1.0
    below: float = 1.0


class Half(Model):
    """One of the two halves of another region, cut across its longer side."""

    of: str = Field(description="a region that stands above in the list")
    which: Literal["first", "second"] = Field(description="first: the lower line numbers, or sample numbers")


class Ring(OneOf):
    """The ground around another region, by the distance of pixel centres from its nearest pixel."""

    one_of = ("outer_m", "outer_pixels")
    of: str = Field(description="a region that stands above in the list")
    inner_m: float = Field(0.0, ge=0, le=100_000, description="beyond this distance [m]")
    outer_m: float | None = Field(None, gt=0, le=100_000, description="up to this distance [m]")
    inner_pixels: float = Field(0.0, ge=0, le=10_000, description="the same [pixels]")
    outer_pixels: float | None = Field(None, gt=0, le=10_000, description="the same [pixels]")

    refused: ClassVar = {
        "inner and outer distance are in one unit: metres, or pixels": lambda r: (
            r.inner_pixels if r.outer_pixels is None else r.inner_m
        ),
        "the outer distance must exceed the inner one, {:g}": lambda r: (
            (inner := r.inner_pixels or r.inner_m) >= (r.outer_pixels or r.outer_m) and [inner]
        ),
    }


class VectorSource(Model):
    """How the drawings of a vector file are placed and named."""

    coordinates: Literal["pixel", "map", "lonlat"] | None = Field(
        None, description="where the file states none; GeoJSON is lonlat otherwise"
    )
    name_field: str | None = Field(None, description="attribute that names the drawings")


class RegionSource(VectorSource, OneOf):
    """One region of interest, or every region of a file."""

    one_of = ("file", "rectangle", "normalized_difference", "whole_image", "half", "ring")
    name: str | None = Field(None, description="None: take the names of the file")
    file: str | None = None
    classes: dict[str, int] = Field(
        {}, description="name: its number in a band of the file, such as a map of materials"
    )
    band: int | str | None = Field(
        None, description="with classes: which band, by number (from 1) or name (* and ? stand for any characters)"
    )
    rectangle: tuple[int, int, int, int] | None = Field(
        None, description="first line, first sample, lines, samples (0-based pixels)"
    )
    normalized_difference: NormalizedDifference | None = None
    whole_image: Literal[True] | None = Field(
        None, description="true: every pixel; the statistics leave out targets, as those of every region do"
    )
    half: Half | None = Field(
        None, description="of another region: statistics of one half can then predict those of the other"
    )
    ring: Ring | None = Field(
        None, description="around another region: the surroundings that its light is scattered from"
    )

    refused: ClassVar = {
        "a region that is not read from a file needs a name": lambda r: r.name is None and r.file is None,
        "classes name the regions of a file: give file, and no name": lambda r: (
            r.classes and (r.file is None or r.name is not None)
        ),
        "band says where classes are: give classes": lambda r: r.band is not None and not r.classes,
    }


class TargetRasters(Model):
    """Target objects as the overlap of a material mask with a size-class raster."""

    materials: dict[str, str] = Field(description="material: mask file")
    size_classes: str = Field(description="raster whose values name the size of the target in each pixel")
    side_m: dict[int, float] = Field(description="raster value: side of the square target [m]")


class TargetRegions(VectorSource):
    """Target objects of one material as regions of a file: polygons, points, pixels, or a mask."""

    material: str
    file: str = Field(description="any file of regions: ENVI ROI, GeoJSON, Shapefile, mask or class raster, ...")
    regions: list[str] = Field(
        [], description="which regions of the file; * and ? stand for any characters; empty: all of them"
    )
    objects: Literal["patches", "regions"] = Field(
        "patches", description="what one object is: a group of touching pixels, or a region of the file"
    )
    side_m: Annotated[float, Field(gt=0, le=10_000)] | Literal["marked"] | None = Field(
        None,
        description="side of these square targets [m], where known; 'marked': each has the area of the pixels that "
        "are marked for it",
    )


class BandRange(Model):
    """Cells of a picture whose value in a band lies between two limits, both of them included."""

    band: int = Field(1, ge=1, description="counted from 1")
    above: float | None = None
    below: float | None = None


class FinerTruth(OneOf):
    """Targets and the fills of their pixels by a map of classes, or a picture, finer than the cube."""

    one_of = ("registration_m", "registration_pixels")  # 0 where there is none
    together = ("corner", "times_finer")
    image: str = Field(description="ENVI or GeoTIFF, its sides along those of the cube")
    classes: dict[str, int | BandRange] = Field(
        min_length=1, description="material: value of the first band, or {band, above, below} of a picture"
    )
    psf_fwhm_pixels: Fwhm | tuple[Fwhm, Fwhm] = Field(
        description="FWHM of the sensor's PSF besides the aperture [pixels], one number or (along, across)"
    )
    registration_m: float | None = Field(
        None, ge=0, le=1000, description="standard error of its place on the cube, in each direction [m]"
    )
    registration_pixels: float | None = Field(None, ge=0, le=10, description="the same [pixels of the cube]")
    corner: tuple[float, float] | None = Field(
        None, description="line and sample of the cube, continuous, where it begins; None: by its map position"
    )
    times_finer: float | None = Field(None, ge=2, le=1000, description="cells along the side of a pixel, with corner")
    objects: Literal["patches", "classes"] = Field(
        "patches", description="what one object is: cells that touch, or all of a class"
    )


class AbundanceTruth(Model):
    """Targets by the bands of a truth image that hold the part of each pixel that a material fills (DIRSIG).

    Pixels that are filled less than 0.02 are none of a target, and count for its area where they touch it.
    """

    image: str = Field(description="ENVI or GeoTIFF of the cube's size")
    materials: dict[str, int | str] = Field(
        min_length=1, description="material: number (from 1) or name of its band; a name may hold * and ?"
    )
    objects: Literal["patches", "bands"] = Field(
        "patches", description="what one object is: pixels that touch, or all of a band"
    )


class TargetTruth(OneOf):
    """Where the target objects are."""

    one_of = ("regions", "rasters", "csv", "finer", "abundances")
    regions: list[TargetRegions] = Field([])
    rasters: TargetRasters | None = None
    csv: str | None = None
    finer: FinerTruth | None = Field(
        None, description="a finer image, which gives the fill fraction of each pixel as well"
    )
    abundances: AbundanceTruth | None = Field(
        None, description="bands of a truth image that hold the fill fraction of each pixel, as DIRSIG writes them"
    )
    pixels: Literal["touched", "centre"] = Field(
        "touched", description="pixels of an object: all it may touch, or the one that holds its centre (csv only)"
    )
    pixel_size_m: float | None = Field(
        None, gt=0, le=1000, description="ground size of a pixel, where the cube's map does not give it"
    )
    guard_pixels: int = Field(1, ge=0, description="pixels around every target left out of the background")

    refused: ClassVar = {
        "only a list (csv) says where a target's centre is: pixels must be 'touched'": lambda t: (
            t.csv is None and t.pixels == "centre"
        )
    }


class PanelReference(Model):
    """A calibration panel of the image with its reflectance measured on the ground."""

    region: str
    spectrum: SpectrumSource
    relative_uncertainty: float = Field(0.0, ge=0, lt=1, description="of the panel reflectance, standard")
    correlation_nm: CorrelationLength = None
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
        [],
        description="with spectra: black ground as an engine sees it, for each flight line; used where a single "
        "other site is known, which makes a one-point line",
    )
    intercept: bool = Field(True, description="false: a line through the origin, for radiance without path radiance")
    saturation: float | None = Field(
        None,
        gt=0,
        description="value of the cube at which its detector saturates: a panel with such a pixel is refused; the "
        "greatest integer of the stored type always counts as full",
    )

    refused: ClassVar = {
        "an empirical line needs two panels, or one and darkest_pixel or path_radiance, or intercept: false": (
            lambda e: e.intercept and len(e.panels) + bool(e.darkest_pixel or e.path_radiance) < 2
        ),
        "darkest_pixel and path_radiance give the path part, which intercept: false says is none": lambda e: (
            not e.intercept and (e.darkest_pixel or e.path_radiance)
        ),
        "path_radiance: a flight line occurs twice": lambda e: twice(str(entry.line) for entry in e.path_radiance),
    }


class CalibrationUncertainty(OneOf):
    """Relative standard uncertainty of the collected radiance, common to all pixels."""

    one_of = ("relative", "file")
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


class CollectionSection(OneOf):
    """What was collected."""

    one_of = ("cube", "spectra", "radcalnet")
    simulate: str | None = Field(
        None, description="scene file: the collection is generated; its files are 'simulated:NAME' below"
    )
    cube: CubeSource | None = None
    spectra: list[SpectrumCollection] = Field([])
    radcalnet: RadCalNetSource | None = Field(None, description="top-of-atmosphere reflectance of a network's site")
    bands: BandTableFile | None = Field(
        None, description="needed with spectra; for a cube, takes the place of its wavelengths and bad-band list"
    )
    regions: list[RegionSource] = Field([])
    targets: TargetTruth | None = None
    leave_out: list[str] = Field([], description="regions that count as neither background nor false alarm")
    leave_out_guard_pixels: int = Field(0, ge=0, le=100, description="pixels around these that do not count either")
    empirical_line: EmpiricalLineSource | None = None
    calibration: CalibrationUncertainty | None = None
    detector: str | None = Field(
        None,
        description="with spectra: sensor of the library, or file, whose noise over the pixels of a site is "
        "an error of its mean",
    )
    snr_regions: list[str] = Field([], description="regions whose SNR the image gives")

    refused: ClassVar = {
        "detector is for spectra, each of which states its pixels: a cube shows its own noise": lambda c: (
            c.detector is not None and not (c.spectra and all(site.pixels for site in c.spectra))
        ),
        "empirical_line is for a cube or spectra": lambda c: c.empirical_line and not (c.cube or c.spectra),
        "empirical_line.path_radiance is for spectra; a cube shows its darkest_pixel": lambda c: (
            c.empirical_line and c.empirical_line.path_radiance and c.cube
        ),
        "empirical_line: spectra show no darkest_pixel and no saturation": lambda c: (
            c.spectra and (line := c.empirical_line) and (line.darkest_pixel or line.saturation is not None)
        ),
        "a simulated collection is a cube: give cube.path as simulated:NAME_rad.img": lambda c: (
            c.simulate and not c.cube
        ),
        "the unit of the radiance is not stated: cube.unit, such as uW cm-2 sr-1 nm-1": lambda c: (
            c.cube and c.cube.quantity == "radiance" and not (c.cube.unit or c.simulate or c.cube.may_state_unit)
        ),
        "spectra need 'bands': a table of band centres and widths": lambda c: c.spectra and c.bands is None,
    }


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
    """What a classifier sees: a few bands, principal components, or every usable band in the atmospheric windows."""

    name: str = Field(min_length=1, description="stands in the table as the method")
    bands_nm: list[float] = Field([], max_length=400, description="the usable bands nearest to these; empty: all")
    pca: int | None = Field(
        None, ge=1, le=400, description="principal components of the classes taken together; None: bands"
    )


class Classification(Model):
    """Classes that a Gaussian maximum-likelihood classifier is to tell apart, and how its error is measured."""

    classes: list[str] = Field(min_length=2, max_length=12, description="regions, each the subject of its class")
    features: list[ClassFeatures] = Field(min_length=1)
    pairs: bool = Field(False, description="every pair of classes as well")
    block_lines: int = Field(
        8, ge=1, description="lines of a block: whole blocks train or test, as neighbouring pixels resemble each other"
    )
    pixels: int = Field(20_000, ge=100, le=200_000, description="at most so many pixels of a class train, or test")
    seed: int = Field(0, ge=0)

    refused: ClassVar = {"{!r} occurs twice": lambda c: twice(c.classes) or twice(f.name for f in c.features)}


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
    correlation_nm: CorrelationLength = None


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
    seed: int = Field(0, ge=0)


class LocalWindowSource(Model):
    """Squares around each pixel, whose pixels between the two give it a background mean of its own."""

    outer_pixels: int = Field(ge=5, le=201, description="side of the outer square, odd")
    inner_pixels: int = Field(ge=1, le=199, description="side of the inner square, odd: wider than the target")

    refused: ClassVar = {
        "outer_pixels and inner_pixels are odd, and the inner one is less": lambda w: (
            w.outer_pixels % 2 == 0 or w.inner_pixels % 2 == 0 or w.inner_pixels >= w.outer_pixels
        )
    }


class Detection(Model):
    """How targets are looked for in the image, or anomalies where no target is named."""

    targets: list[DetectionTarget] = Field([], description="what to detect; none: anomalies, by the detector rx alone")
    detectors: list[str] = Field(["cem"], min_length=1)
    background: list[str] = Field(
        ["scene"],
        description="regions whose pixels give the filter its statistics; 'scene': all that is not left out; "
        "'image': every pixel, targets included",
    )
    false_alarms: list[str] = Field(["scene"], description="regions whose pixels count for the false-alarm rate")
    undesired: list[str] = Field([], description="regions whose mean spectra the detector 'osp' projects away")
    local_window: LocalWindowSource | None = Field(
        None,
        description="the background mean is local to the pixel, the covariance stays that of the whole background; "
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
        False, description="also: false alarms before the first true detection of a subject, as RIT's self-test counts"
    )
    bands: Literal["all", "good", "windows"] = "good"
    least_snr: float | None = Field(None, gt=0, description="bands with less in the background are left out")
    group: str = Field(
        "{name}", description="subject of a target object; the columns of the truth stand in braces, such as {material}"
    )
    pools: list[Pool] = Field([])
    areas: list[AreaCheck] = Field([])
    unmixing: Unmixing | None = None

    refused: ClassVar = {
        "detectors: unknown detector {!r}; one of {}": lambda d: unknown(d.detectors, detector_names()),
        f"without targets the detectors can only be {', '.join(ANOMALY_DETECTORS)}": lambda d: (
            not d.targets and not set(d.detectors) <= set(ANOMALY_DETECTORS)
        ),
        "pools, areas, unmixing and halo_pixels need targets": lambda d: (
            not d.targets and (d.pools or d.areas or d.unmixing or d.halo_pixels)
        ),
        "local_window: the detector {!r} has no mean that could be local": lambda d: (
            d.local_window and unknown(d.detectors, LOCAL_DETECTORS)
        ),
        "the detector 'osp' and 'undesired', the regions that it projects away, go together": lambda d: (
            ("osp" in d.detectors) != bool(d.undesired)
        ),
        "two detection targets are named {!r}": lambda d: twice(t.name for t in d.targets),
        "areas and unmixing: no detection target {!r}; one of {}": lambda d: unknown(
            (one.target for one in (*d.areas, *(d.unmixing.targets if d.unmixing else ()))), (t.name for t in d.targets)
        ),
        "areas: the detector {!r} is none of this campaign; one of {}": lambda d: unknown(
            (area.detector for area in d.areas), d.detectors
        ),
    }
