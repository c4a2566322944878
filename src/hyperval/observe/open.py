"""A collection opened: the cube, its regions, its targets, and which pixels count for what.

The regions of a collection are read from files, drawn, found by rules on spectra, or made of other regions; they and
the target pixels are one label image.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cached_property
from glob import escape
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval import imagery
from hyperval.collection import (
    BandTableFile,
    CollectionSection,
    CubeSource,
    NormalizedDifference,
    RegionSource,
    Ring,
    TargetRasters,
    TargetTruth,
    VectorSource,
)
from hyperval.data import SampleStatistics
from hyperval.errors import InputError, UsageError, one_of, reader, refusal
from hyperval.imagery import Cube, LookupTable, Region, TargetObject
from hyperval.observe.truth_images import image_targets, material_regions
from hyperval.paths import checked_file
from hyperval.pixels import EmpiricalLine, Labels
from hyperval.progress import track
from hyperval.spectra import SpectralAxis, fwhm_from_spacing, number_table
from hyperval.units import RADIANCE_UNIT, wavelength_to_nm

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Index = npt.NDArray[np.intp]
Resolve = Callable[[str], Path]

SCENE = "scene"
IMAGE = "image"
MAX_TABLE_BYTES = 10 << 20
_TOGETHER = 1024  # pixels whose spectra are read at once
_NEAR = "\0targets with their guard"  # among the labels: a name that no region has


@dataclass(frozen=True, eq=False)
class Place:
    """An opened collection.

    Attributes
    ----------
    cube : the image
    labels : regions as drawn, and the target pixels with their guard ring, as one label image
    targets : the target objects of the truth
    pixel_area_m2 : ground area of a pixel, None when the cube is not georeferenced
    target_pixels : which pixels of an object are scored: "touched" or "centre"
    by_rule : names of the regions that a rule on the spectra found
    notes : what was assumed or found on opening
    table : geographic lookup table of a cube in scanner geometry, None without
    leave_out : names of the regions that are left out
    by_number : the bands go by number, their wavelengths are not known
    statistics : of the regions and of the subjects of a detection, in the cube's values, once they are measured
    line : the empirical line, once it is fitted
    """

    cube: Cube
    labels: Labels
    targets: Sequence[TargetObject] = ()
    pixel_area_m2: float | None = None
    target_pixels: str = "touched"
    by_rule: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()
    table: LookupTable | None = None
    leave_out: frozenset[str] = frozenset()
    by_number: bool = False
    statistics: Mapping[str, SampleStatistics] = field(default_factory=dict)
    line: EmpiricalLine | None = None

    @cached_property
    def regions(self) -> Labels:
        """The regions as drawn; a mask is handed out as an array of its own."""
        return replace(self.labels, members={n: own for n, own in self.labels.members.items() if n != _NEAR})

    @cached_property
    def classes(self) -> npt.NDArray[np.int32]:
        """(lines, samples) number of the class of each pixel: pixels that lie in the same regions are of one."""
        if not self.regions:
            return np.zeros(self.cube.shape, np.int32)
        inside = np.stack(list(self.regions.members.values()), axis=1)
        _, number = np.unique(inside, axis=0, return_inverse=True)
        return np.asarray(number.reshape(-1).astype(np.int32)[self.labels.number])

    @property
    def near_targets(self) -> Mask:
        """(lines, samples) target pixels with their guard ring."""
        return self.labels[_NEAR]

    @property
    def in_scene(self) -> Mask:
        """(K,) labels of the scene: neither targets with their guard nor regions that are left out."""
        return self._free(self.leave_out)

    def _free(self, leave_out: Iterable[str]) -> Mask:
        return np.asarray(~np.any([self.labels.members[name] for name in (_NEAR, *leave_out)], axis=0))

    @property
    def source_files(self) -> tuple[Path, ...]:
        """The files of the cube and of its lookup table."""
        return self.cube.source_files + (self.table.raster.source_files if self.table is not None else ())

    def background_labels(self, names: Sequence[str]) -> Mask:
        """(K,) labels of the union of regions, or of the whole scene, that are not left out.

        "image" is every pixel, the targets too: what a detector does that is told nothing of them.
        """
        if IMAGE in names:
            return np.ones_like(self.in_scene)
        if SCENE in names:
            return self.in_scene
        return np.asarray(np.any([self.counted(name) for name in names], axis=0))

    def background(self, names: Sequence[str]) -> Mask:
        """(lines, samples) pixels of :meth:`background_labels`."""
        return self.labels.mask(self.background_labels(names))

    def counted(self, name: str) -> Mask:
        """(K,) labels of a region that count: without targets, their guard and other regions that are left out."""
        self._known(name)
        return self.regions.members[name] & self._free(() if name in self.leave_out else self.leave_out)

    def pixels_of(self, name: str) -> Mask:
        """(lines, samples) pixels of :meth:`counted`."""
        return self.labels.mask(self.counted(name))

    def in_reflectance(self, sample: SampleStatistics) -> tuple[Array, Array]:
        """Mean (B,) and covariance (B, B) after the empirical line; as they stand without one."""
        if self.line is None:
            return sample.mean, sample.covariance
        return self.line.reflectance(sample.mean), sample.covariance / np.outer(self.line.gain, self.line.gain)

    def pixels_at(self, lines: Index, samples: Index) -> tuple[Array, Mask]:
        """(n, B) values of pixels (n,), in reflectance with a line, and (n,) which of them hold data."""
        values, usable = self.cube.marked_pixels((lines, samples))
        return values if self.line is None else self.line.reflectance(values), usable

    def valid_pixels(
        self, lines: Index, samples: Index, bands: npt.NDArray[Any] | None = None
    ) -> Iterator[tuple[Array, Mask]]:
        """Values (m, b) of those of the pixels (n,) that hold data, and which they are; some of the pixels at a time.

        ``bands``: handed out, and known in every pixel; None: all, whatever they hold.
        """
        for start in range(0, lines.size, _TOGETHER):
            some = slice(start, start + _TOGETHER)
            values, valid = self.cube.marked_pixels((lines[some], samples[some]))
            if bands is not None:
                values = values[:, bands]
                valid &= np.isfinite(values).all(axis=1)
            yield values[valid], valid

    def region(self, name: str) -> Mask:
        """The mask of a region; raises UsageError for a name that no region has."""
        self._known(name)
        return self.regions[name]

    def _known(self, name: str) -> None:
        if name not in self.regions:
            raise UsageError(f"no region {name!r}", expected=one_of(self.regions, "a region"))


def open_place(collection: CollectionSection, resolve: Resolve, *, show_progress: bool | None = None) -> Place:
    """Open the cube of a collection with its regions and truth.

    Raises
    ------
    InputError : missing or corrupt files, regions outside the image.
    UsageError : names that do not fit.
    """
    if collection.cube is None:
        raise UsageError("the collection has no cube")
    cube = open_source(collection.cube, resolve, collection.bands)
    table, notes = _lookup_table(cube, collection.cube, resolve)
    truth, area_m2 = collection.targets, table.pixel_area_m2 if table is not None else cube.pixel_area_m2
    if truth is not None and truth.pixel_size_m is not None:
        if table is not None or cube.pixel_area_m2 is not None:
            raise UsageError("the cube has a map position, and 'targets.pixel_size_m' is stated", mend="take it out")
        area_m2 = truth.pixel_size_m**2
    site = _Site(cube, table, area_m2, resolve, show_progress)
    regions: dict[str, Region] = {}
    for source in collection.regions:
        new = site.regions_of(source, regions)
        if twice := sorted(set(new) & set(regions)):
            raise UsageError(f"two regions are named {twice[0]!r}")
        regions |= new
    targets, remarks = ([], []) if truth is None else site.targets_of(truth)
    near = imagery.all_pixels(targets, cube.shape)
    if targets and truth is not None and truth.guard_pixels:
        near = imagery.guard(near, truth.guard_pixels)
    for name in collection.leave_out:
        if name not in regions:
            raise UsageError(f"leave_out names {name!r}, which is no region", expected=", ".join(regions))
    sides = cube.samples, cube.raster.bands
    told = imagery.acquisition_notes(cube.extras, cube.axis, *sides, lines=cube.lines, quantity=cube.quantity)
    notes = (*cube.notes, *notes, *told)
    if table is not None:
        size = f", pixels of {table.pixel_area_m2:.3g} m2" if table.pixel_area_m2 else ""
        notes = (*notes, f"places on the map are found by the lookup table {table.raster.path.name}{size}")
    by_rule = frozenset(str(r.name) for r in collection.regions if r.normalized_difference is not None)
    notes = (*notes, *_region_notes(regions.values(), by_rule), *remarks)
    return Place(
        cube,
        Labels.of(cube.shape, {name: region.mask for name, region in regions.items()} | {_NEAR: near}),
        targets,
        area_m2,
        truth.pixels if truth else "touched",
        by_rule,
        (*notes, *_target_notes(regions.values(), targets, near)),
        table,
        frozenset(collection.leave_out),
        collection.cube.by_number,
    )


def check_line_for_detection(place: Place, collection: CollectionSection) -> None:
    """Raise UsageError where targets are looked for in radiance and no empirical line tells their reflectance."""
    if place.cube.quantity == "radiance" and collection.empirical_line is None:
        raise refusal("place.line")


def open_source(source: CubeSource, resolve: Resolve, bands: BandTableFile | None = None) -> Cube:
    """Open the cube that a campaign names, with its bands from a table where the campaign names one."""
    unit = source.unit if source.quantity == "radiance" else None
    if unit is None and source.quantity == "radiance" and not source.may_state_unit:
        unit = RADIANCE_UNIT  # as simulations write it; others that state none were refused with the campaign
    return imagery.open_cube(
        resolve(source.path),
        axis="numbers" if source.by_number else read_band_table(resolve(bands.path), bands) if bands else None,
        quantity=source.quantity,
        unit=unit,
        variable=source.variable,
        engine=source.engine,
        scale=source.scale,
        wavelength_unit=source.wavelength_unit,
        header=resolve(source.header) if source.header else None,
        sort_bands=source.sort_bands,
    )


@reader
def number_rows(path: Path, what: str) -> tuple[Array, int]:
    """Rows (n, columns) of a text table whose headings begin with #, and the line of the first."""
    checked_file(path, what=what, most=MAX_TABLE_BYTES)
    lines = [line.split("#")[0] for line in path.read_text("utf-8", errors="replace").splitlines()]
    start = next((number for number, line in enumerate(lines, start=1) if line.strip()), None)
    if start is None:
        raise InputError("holds no band", where=str(path), expected="a row of numbers for each band")
    header, rows, first = number_table("\n".join(lines), path)
    if header:
        raise InputError("not a row of numbers", where=f"{path}:{start}", expected="numbers; a heading begins with #")
    return rows, first


@reader
def read_band_table(path: Path, table: BandTableFile) -> SpectralAxis:
    """The spectral axis of a whitespace-separated text table."""
    needed = max(table.centre_column, table.fwhm_column or 0)
    rows, first = number_rows(path, "table of bands")
    if rows.shape[1] <= needed:
        raise InputError(f"{rows.shape[1]} columns", where=f"{path}:{first}", expected=f"{needed + 1} or more")
    factor = wavelength_to_nm(table.wavelength_unit)
    centre = rows[:, table.centre_column] * factor
    try:
        fwhm = fwhm_from_spacing(centre) if table.fwhm_column is None else rows[:, table.fwhm_column] * factor
        return SpectralAxis(centre, fwhm)
    except UsageError as error:
        raise InputError(f"not a table of bands: {error.what}", where=str(path), expected=error.expected) from error


def _lookup_table(cube: Cube, source: CubeSource, resolve: Resolve) -> tuple[LookupTable | None, tuple[str, ...]]:
    """What places the pixels of a cube in scanner geometry, stated or found, and notes on it."""
    if source.glt is None:
        return imagery.table_of(cube.raster)
    if cube.transform is not None:
        raise refusal("place.glt", source.path)
    raster = imagery.open_raster(resolve(source.glt))
    if raster.dtype.kind == "f" and raster.transform is None:
        return imagery.location_table(raster, cube.shape), ()
    return imagery.open_lookup_table(raster, cube.shape), ()


@dataclass(frozen=True)
class _Site:
    """Where regions and targets are drawn on: the cube, what places its pixels, and their ground area [m2]."""

    cube: Cube
    table: LookupTable | None
    area_m2: float | None
    resolve: Resolve
    show: bool | None

    def read(self, path: Path, source: VectorSource, patterns: Sequence[str], **options: Any) -> dict[str, Region]:
        """Regions of a file, placed by the lookup table where there is one, else as the cube lies."""
        table, cube = self.table, self.cube
        return imagery.read_regions(
            path, cube.shape, transform=table or cube.transform, crs=table.crs if table else cube.crs,
            coordinates=source.coordinates, name_field=source.name_field, patterns=patterns, **options,
        )  # fmt: skip

    def regions_of(self, source: RegionSource, above: Mapping[str, Region]) -> dict[str, Region]:
        """The regions of one entry of a collection by name; ``above``: those of the entries before it."""
        name, shape = str(source.name), self.cube.shape
        if source.file is not None:
            return self._of_file(source, self.resolve(source.file))
        if source.rectangle is not None:
            line, sample, lines, samples = source.rectangle
            return {
                name: imagery.rectangle_region(name, (line, line + lines - 1), (sample, sample + samples - 1), shape)
            }
        if source.whole_image:
            return {name: Region(name, np.broadcast_to(np.True_, shape), "the whole image")}
        if source.half is not None:
            whole = _above(name, "half of", source.half.of, above)
            return {name: imagery.half_region(name, whole, first=source.half.which == "first")}
        if source.ring is not None:
            return {name: self._ring(name, source.ring, _above(name, "a ring around", source.ring.of, above))}
        assert source.normalized_difference is not None  # noqa: S101 - one of them is given
        mask = self._normalized_difference(source.normalized_difference)
        return {name: Region(name, mask, "normalised difference")}

    def _of_file(self, source: RegionSource, path: Path) -> dict[str, Region]:
        if source.classes:
            return material_regions(source, self.cube, path)
        new = self.read(path, source, [] if source.name is None else [escape(source.name)])
        if source.name is None:
            return new
        if len(new) == 1:
            return {source.name: replace(next(iter(new.values())), name=source.name)}
        if source.name not in new:
            raise InputError(f"no region {source.name!r} among {', '.join(new)}", where=str(path))
        return {source.name: new[source.name]}

    def _ring(self, name: str, ring: Ring, around: Region) -> Region:
        if ring.outer_m is None:
            return imagery.ring_region(name, around, ring.inner_pixels, float(ring.outer_pixels or 0.0))
        if self.area_m2 is None:
            raise refusal("place.metres", f"region {name!r}")
        return imagery.ring_region(
            name, around, ring.inner_m, ring.outer_m, imagery.pixel_sides_m(self.cube.transform, self.area_m2)
        )

    def _normalized_difference(self, rule: NormalizedDifference) -> Mask:
        """Pixels (lines, samples) whose (high - low)/(high + low) lies above and below the limits of ``rule``."""
        cube, chosen = self.cube, []
        for low, high in (rule.high_nm, rule.low_nm):
            bands = np.flatnonzero((cube.axis.centre_nm >= low) & (cube.axis.centre_nm <= high) & cube.axis.good)
            if bands.size == 0:
                raise UsageError(f"no usable band between {low:g} and {high:g} nm for a normalised difference")
            chosen.append(bands)
        out = np.zeros(cube.shape, bool)
        for block in track(cube.blocks(dtype=np.float32), "normalised difference", show=self.show):
            high, low = (block.values[..., bands].mean(axis=-1, dtype=np.float64) for bands in chosen)
            with np.errstate(divide="ignore", invalid="ignore"):
                index = (high - low) / (high + low)
            rows = slice(block.first_line, block.first_line + block.values.shape[0])
            out[rows] = block.valid & (index >= rule.above) & (index < rule.below)
        return out

    def targets_of(self, truth: TargetTruth) -> tuple[list[TargetObject], list[str]]:
        """The target objects, and what is to be said of how they were drawn."""
        cube, table, area = self.cube, self.table, self.area_m2
        if truth.csv is not None:
            if area is None and table is None and cube.crs is not None and cube.crs.is_geographic:
                mend = "state targets.pixel_size_m"
                raise UsageError("pixels in degrees have no ground size", where=truth.csv, mend=mend)
            side, path = None if area is None else math.sqrt(area), self.resolve(truth.csv)
            return imagery.read_targets(path, cube.shape, transform=table or cube.transform, pixel_size_m=side), []
        if (image := truth.finer or truth.abundances) is not None:
            return image_targets(image, cube, area, self.resolve)
        if truth.rasters is not None:
            return self._of_rasters(truth.rasters), []
        return self._drawn(truth)

    def _of_rasters(self, rasters: TargetRasters) -> list[TargetObject]:
        cube, drawn = self.cube, VectorSource()
        masks, sizes = {}, np.zeros(cube.shape, np.int64)
        for material, reference in rasters.materials.items():
            found = self.read(self.resolve(reference), drawn, ())
            masks[material] = np.any([np.zeros(cube.shape, bool), *(region.mask for region in found.values())], axis=0)
        wanted: dict[str | int, str] = {value: str(value) for value in rasters.side_m}
        for name, region in self.read(self.resolve(rasters.size_classes), drawn, (), names=wanted).items():
            sizes[region.mask] = int(name)
        return imagery.intersected_objects(masks, sizes, rasters.side_m)

    def _drawn(self, truth: TargetTruth) -> tuple[list[TargetObject], list[str]]:
        """Objects drawn as regions: every pixel that a polygon touches, as targets may be smaller than a pixel."""
        out: list[TargetObject] = []
        remarks: list[str] = []
        for source in truth.regions:
            path = self.resolve(source.file)
            drawn = self.read(path, source, source.regions, touched=True)
            fits = {p: [name for name in drawn if fnmatchcase(name, p)] for p in source.regions}
            for pattern, names in fits.items():
                if not names:
                    raise UsageError(f"no region {pattern!r}", where=str(path), expected=one_of(sorted(drawn)))
            kept = set().union(*fits.values()) if fits else set(drawn)
            chosen = [region for name, region in drawn.items() if name in kept]
            remarks += [f"{remark} (targets)" for region in chosen for remark in region.remarks]
            whole = source.objects == "regions"
            new = imagery.region_objects(
                chosen, source.material, whole=whole, side_m=source.side_m, pixel_area_m2=self.area_m2
            )
            # A class raster for each material, of one name: the material tells the objects apart.
            taken = {o.name for o in out if o.material != source.material}
            out += [replace(o, name=f"{o.material} {o.name}") if o.name in taken else o for o in new]
        names = [o.name for o in out]
        if double := sorted({name for name in names if names.count(name) > 1}):
            mend = "name a region under one material only"
            raise UsageError(f"two targets are named {double[0]!r}", where="targets.regions", mend=mend)
        return out, remarks


def _above(name: str, what: str, of: str, regions: Mapping[str, Region]) -> Region:
    """The region that another one is made of."""
    if of not in regions:
        raise refusal(
            "place.above", "collection.regions", name=name, what=what, of=of, known=one_of(regions, "a region above it")
        )
    return regions[of]


def _region_notes(regions: Iterable[Region], by_rule: frozenset[str]) -> list[str]:
    """What leaves the image, which regions have holes (but those that a rule found), which share pixels."""
    listed = list(regions)
    notes = [remark for region in listed for remark in region.remarks]
    for region in listed:
        count, pixels = (0, 0) if region.name in by_rule else imagery.holes(region.mask)
        if count:
            what = "a hole" if count == 1 else f"{count} holes"
            notes.append(f"the region {region.name!r} has {what} of {pixels} pixels, which are not part of it")
    return notes + [f"the regions {a!r} and {b!r} share {n} pixels" for a, b, n in imagery.overlaps(listed)]


def _target_notes(regions: Iterable[Region], targets: Sequence[TargetObject], near: Mask) -> list[str]:
    """Which regions hold pixels of targets or of their guard, and what becomes of these; likewise two targets."""
    notes: list[str] = []
    if not targets:
        return notes
    touched = np.zeros(near.shape, np.int32)
    for target in targets:
        touched[target.window] += target.part
    for region in regions:
        inside, guarded = int(np.sum(region.mask & (touched > 0))), int(np.sum(region.mask & near))
        what = f"the region {region.name!r} holds {inside} pixels of targets and {guarded - inside} of their guard"
        if guarded == region.n:
            notes.append(f"warning: {what}, which is all of it: they stay in its statistics")
        elif guarded:
            notes.append(f"{what} among {region.n}: left out of its statistics")
    shared = int(np.sum(touched > 1))
    if shared:
        materials = dict.fromkeys(o.material for o in targets)
        masks = {m: imagery.all_pixels([o for o in targets if o.material == m], near.shape) for m in materials}
        pairs = [(a, b, int(np.sum(masks[a] & masks[b]))) for a, b in combinations(masks, 2)]
        words = ", ".join(f"{n} of {a!r} and {b!r}" for a, b, n in pairs if n)
        notes.append(f"{shared} pixels may hold parts of more than one target" + (f": {words}" if words else ""))
    return notes
