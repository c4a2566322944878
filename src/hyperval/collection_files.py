"""What a campaign says of the files of its collection: cube, spectra, band table, regions, truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from hyperval.config import Model, RadianceUnit, WavelengthUnit

_SELF_DESCRIBING = (".nc", ".nc4", ".h5", ".hdf5", ".he5", ".hdf", ".zarr", ".xml", ".tif", ".tiff")
Fwhm = Annotated[float, Field(ge=0, le=8)]
LeastFill = Annotated[float, Field(gt=0, lt=1)]


class CubeSource(Model):
    """An image cube on disk."""

    path: str
    variable: str | None = Field(None, description="which array is the image, where a file holds several")
    engine: str | None = Field(None, description="engine of xarray that opens the file; None: as its content says")
    header: str | None = Field(None, description="ENVI header that describes it, when it is not beside the cube")
    quantity: Literal["radiance", "reflectance", "counts"] = Field(
        description="counts: numbers of which nobody knows the unit"
    )
    unit: RadianceUnit | None = Field(
        None, description="of the scaled radiance; None: the product's own, or that of a simulation"
    )
    scale: float | None = Field(None, gt=0, description="stored value times this is the value; None: the header's")
    wavelength_unit: WavelengthUnit | None = Field(None, description="stated when the header does not say nm or um")
    sort_bands: bool = Field(False, description="sort bands whose wavelengths fall, as where detectors overlap")
    by_number: bool = Field(
        False,
        description="bands go by number, as no wavelength is known: what needs wavelengths is left out",
    )
    glt: str | None = Field(
        None, description="lookup table (GLT) or places of pixels (IGM); None: the product's own, or one beside it"
    )

    @model_validator(mode="after")
    def _known_bands(self) -> CubeSource:
        if self.by_number and (self.quantity == "radiance" or self.wavelength_unit or self.sort_bands):
            raise ValueError("by_number is for reflectance or counts of which no wavelength is known")
        return self

    @property
    def may_state_unit(self) -> bool:
        """Whether files of this kind can say themselves what unit their radiance is in."""
        return Path(self.path).suffix.lower() in _SELF_DESCRIBING


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
    times: list[str] = Field(default_factory=list, description="half hours, such as 04:00; empty: all with values")
    fwhm_nm: float = Field(10.0, gt=0, le=100, description="width of the bands, which the file does not state")
    correlation_nm: float | None = Field(
        None, gt=0, description="correlation length of the stated uncertainty; None: fully correlated"
    )
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


class Ring(Model):
    """The ground around another region, by the distance of pixel centres from its nearest pixel."""

    of: str = Field(description="a region that stands above in the list")
    inner_m: float = Field(0.0, ge=0, le=100_000, description="beyond this distance [m]")
    outer_m: float | None = Field(None, gt=0, le=100_000, description="up to this distance [m]")
    inner_pixels: float = Field(0.0, ge=0, le=10_000, description="the same [pixels]")
    outer_pixels: float | None = Field(None, gt=0, le=10_000, description="the same [pixels]")

    @model_validator(mode="after")
    def _one_unit(self) -> Ring:
        if (self.outer_m is None) == (self.outer_pixels is None):
            raise ValueError("give exactly one of outer_m, outer_pixels")
        if self.inner_pixels if self.outer_pixels is None else self.inner_m:
            raise ValueError("inner and outer distance are in one unit: metres, or pixels")
        inner, outer = self.inner_pixels or self.inner_m, self.outer_pixels or self.outer_m
        if outer is not None and inner >= outer:
            raise ValueError(f"the outer distance must exceed the inner one, {inner:g}")
        return self


class VectorSource(Model):
    """How the drawings of a vector file are placed and named."""

    coordinates: Literal["pixel", "map", "lonlat"] | None = Field(
        None, description="where the file states none; GeoJSON is lonlat otherwise"
    )
    name_field: str | None = Field(None, description="attribute that names the drawings")


class RegionSource(VectorSource):
    """One region of interest, or every region of a file."""

    name: str | None = Field(None, description="None: take the names of the file")
    file: str | None = None
    classes: dict[str, int] = Field(
        default_factory=dict, description="name: its number in a band of the file, such as a map of materials"
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

    @model_validator(mode="after")
    def _one_source(self) -> RegionSource:
        sources = ("file", "rectangle", "normalized_difference", "whole_image", "half", "ring")
        if sum(getattr(self, source) is not None for source in sources) != 1:
            raise ValueError("give exactly one of " + ", ".join(sources))
        if self.name is None and self.file is None:
            raise ValueError("a region that is not read from a file needs a name")
        if self.classes and (self.file is None or self.name is not None):
            raise ValueError("classes name the regions of a file: give file, and no name")
        if self.band is not None and not self.classes:
            raise ValueError("band says where classes are: give classes")
        return self


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
        default_factory=list,
        description="which regions of the file; * and ? stand for any characters; empty: all of them",
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


class FinerTruth(Model):
    """Targets and the fills of their pixels by a map of classes, or a picture, finer than the cube."""

    image: str = Field(description="ENVI or GeoTIFF, its sides along those of the cube")
    classes: dict[str, int | BandRange] = Field(
        min_length=1, description="material: value of the first band, or {band, above, below} of a picture"
    )
    psf_fwhm_pixels: Fwhm | tuple[Fwhm, Fwhm] = Field(
        description="FWHM of the sensor's blur besides the aperture [pixels], one number or (along, across)"
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
    least_fill: LeastFill = Field(0.02, description="pixels that are filled less are none of the target")

    @model_validator(mode="after")
    def _placed(self) -> FinerTruth:
        if (self.corner is None) != (self.times_finer is None):
            raise ValueError("corner and times_finer go together")
        if self.registration_m is not None and self.registration_pixels is not None:
            raise ValueError("give registration_m or registration_pixels")
        if self.registration_m is None and self.registration_pixels is None:
            raise ValueError(
                "state the error of registration: registration_m or registration_pixels, 0 if there is none"
            )
        return self


class AbundanceTruth(Model):
    """Targets by the bands of a truth image that hold the part of each pixel that a material fills (DIRSIG)."""

    image: str = Field(description="ENVI or GeoTIFF of the cube's size")
    materials: dict[str, int | str] = Field(
        min_length=1, description="material: number (from 1) or name of its band; a name may hold * and ?"
    )
    objects: Literal["patches", "bands"] = Field(
        "patches", description="what one object is: pixels that touch, or all of a band"
    )
    least_fill: LeastFill = Field(0.02, description="pixels that are filled less are none of the target")


class TargetTruth(Model):
    """Where the target objects are."""

    regions: list[TargetRegions] = Field(default_factory=list)
    rasters: TargetRasters | None = None
    csv: str | None = None
    finer: FinerTruth | None = Field(None, description="a finer image, which tells the fill of each pixel as well")
    abundances: AbundanceTruth | None = Field(
        None, description="bands of a truth image that hold the fill of each pixel, as DIRSIG writes them"
    )
    pixels: Literal["touched", "centre"] = Field(
        "touched", description="pixels of an object: all it may touch, or the one that holds its centre (csv only)"
    )
    pixel_size_m: float | None = Field(
        None, gt=0, le=1000, description="ground size of a pixel, where the cube's map does not give it"
    )
    guard_pixels: int = Field(1, ge=0, description="pixels around every target left out of the background")

    @model_validator(mode="after")
    def _one_source(self) -> TargetTruth:
        sources = (self.rasters, self.csv, self.finer, self.abundances)
        if bool(self.regions) + sum(source is not None for source in sources) != 1:
            raise ValueError("give exactly one of regions, rasters, csv, finer, abundances")
        if self.csv is None and self.pixels == "centre":
            raise ValueError("only a list (csv) says where a target's centre is: pixels must be 'touched'")
        return self
