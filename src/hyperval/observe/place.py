"""A collection opened: the cube, its regions, its targets, and which pixels count for what."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.collection import Collection
from hyperval.collection_files import BandTable, CubeSource, TargetTruth
from hyperval.errors import UsageError
from hyperval.imagery.acquisition import acquisition_notes
from hyperval.imagery.companions import table_of
from hyperval.imagery.cube import Cube, open_cube
from hyperval.imagery.lookup_table import LookupTable, location_table, open_lookup_table
from hyperval.imagery.rasters import open_raster
from hyperval.imagery.regions import guard, read_regions
from hyperval.imagery.truth import TargetObject, all_pixels, intersected_objects, read_targets, region_objects
from hyperval.observe.regions import collection_regions, region_notes, regions_of_file, target_overlaps
from hyperval.observe.site_spectra import read_band_table
from hyperval.observe.truth_images import abundance_targets, finer_targets
from hyperval.processing.mask_bits import PackedMasks
from hyperval.units import RADIANCE_UNIT

Mask = npt.NDArray[np.bool_]
Resolve = Callable[[str], Path]
SCENE = "scene"
IMAGE = "image"


@dataclass(frozen=True, eq=False)
class Place:
    """An opened collection.

    Attributes
    ----------
    cube : the image
    regions : name -> mask, as drawn; each is handed out as an array of its own
    targets : the target objects of the truth
    near_targets : target pixels with their guard ring
    left_out : pixels that count as neither background nor false alarm (targets with guard, named regions)
    pixel_area_m2 : ground area of a pixel, None when the cube is not georeferenced
    by_rule : names of the regions that a rule on the spectra found
    target_pixels : which pixels of an object are scored: "touched" or "centre"
    notes : what was assumed or found on opening
    table : geographic lookup table of a cube in scanner geometry, None without
    leave_out : names of the regions that are left out
    by_number : the bands go by number, their wavelengths are not known
    """

    cube: Cube
    regions: Mapping[str, Mask]
    targets: Sequence[TargetObject] = ()
    near_targets: Mask = field(default_factory=lambda: np.zeros((0, 0), bool))
    left_out: Mask = field(default_factory=lambda: np.zeros((0, 0), bool))
    pixel_area_m2: float | None = None
    target_pixels: str = "touched"
    by_rule: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()
    table: LookupTable | None = None
    leave_out: frozenset[str] = frozenset()
    by_number: bool = False

    @property
    def source_files(self) -> tuple[Path, ...]:
        """The files of the cube and of its lookup table."""
        return self.cube.source_files + (self.table.raster.source_files if self.table is not None else ())

    def background(self, names: Sequence[str]) -> Mask:
        """Pixels of the union of regions, or of the whole scene, that are not left out.

        "image" is every pixel, the targets too: what a detector does that is told nothing of them.
        """
        if IMAGE in names:
            return np.ones(self.cube.shape, bool)
        if SCENE in names:
            return ~self.left_out
        out = np.zeros(self.cube.shape, bool)
        for name in names:
            out |= self.pixels_of(name)
        return out

    def pixels_of(self, name: str) -> Mask:
        """Pixels of a region that count: without targets, their guard and other regions that are left out."""
        mask = self.region(name) & ~self.near_targets if self.targets else self.region(name)
        for other in () if name in self.leave_out else self.leave_out:
            mask = mask & ~self.region(other)
        return mask

    def region(self, name: str) -> Mask:
        """The mask of a region; raises UsageError for a name that no region has."""
        if name not in self.regions:
            raise UsageError(
                f"no region {name!r}", expected="one of " + ", ".join(self.regions) if self.regions else "a region"
            )
        return self.regions[name]


def open_place(collection: Collection, resolve: Resolve, *, show_progress: bool | None = None) -> Place:
    """Open the cube of a collection with its regions and truth.

    Raises
    ------
    InputError : missing or corrupt files, regions outside the image.
    UsageError : names that do not fit.
    """
    if collection.cube is None:
        raise UsageError("the collection has no cube")
    cube = open_source(collection.cube, resolve, collection.bands)
    table, source_of = _lookup_table(cube, collection.cube, resolve)
    area_m2 = _pixel_area_m2(cube, table, collection.targets)
    regions = collection_regions(cube, table, collection.regions, resolve, area_m2, show_progress)
    targets, remarks = _targets(cube, table, collection.targets, area_m2, resolve)
    near = all_pixels(targets, cube.shape)
    if targets and collection.targets and collection.targets.guard_pixels:
        near = guard(near, collection.targets.guard_pixels)
    left_out = near
    for name in collection.leave_out:
        if name not in regions:
            raise UsageError(f"leave_out names {name!r}, which is no region", expected=", ".join(regions))
        left_out = left_out | regions[name].mask
    notes = [*cube.notes, *source_of, *header_notes(cube)]
    if table is not None:
        size = f", pixels of {table.pixel_area_m2:.3g} m2" if table.pixel_area_m2 else ""
        notes.append(f"places on the map are found by the lookup table {table.raster.path.name}{size}")
    by_rule = frozenset(str(r.name) for r in collection.regions if r.normalized_difference is not None)
    notes += [*region_notes(regions.values(), by_rule), *remarks]
    notes += target_overlaps(regions.values(), targets, near)
    return Place(
        cube,
        PackedMasks((name, region.mask) for name, region in regions.items()),
        targets,
        near,
        left_out,
        area_m2,
        collection.targets.pixels if collection.targets else "touched",
        by_rule,
        tuple(notes),
        table,
        frozenset(collection.leave_out),
        collection.cube.by_number,
    )


def check_line_for_detection(place: Place, collection: Collection) -> None:
    """Raise UsageError where targets are looked for in radiance and no empirical line tells their reflectance."""
    if place.cube.quantity == "radiance" and collection.empirical_line is None:
        raise UsageError(
            "detection on radiance needs an empirical line", mend="add collection.empirical_line with two panels"
        )


def _lookup_table(cube: Cube, source: CubeSource, resolve: Resolve) -> tuple[LookupTable | None, tuple[str, ...]]:
    """What places the pixels of a cube in scanner geometry, stated or found, and notes on it."""
    if source.glt is None:
        return table_of(cube.raster)
    if cube.transform is not None:
        raise UsageError(
            "the cube has a map position, and 'cube.glt' is stated",
            where=source.path,
            mend="take glt out, or name the cube in scanner geometry",
        )
    raster = open_raster(resolve(source.glt))
    if raster.dtype.kind == "f" and raster.transform is None:
        return location_table(raster, cube.shape), ()
    return open_lookup_table(raster, cube.shape), ()


def _pixel_area_m2(cube: Cube, table: LookupTable | None, truth: TargetTruth | None) -> float | None:
    """Ground area of a pixel [m2]: of the map grid or lookup table, else as the campaign states its size."""
    if table is not None:
        return table.pixel_area_m2
    if cube.pixel_area_m2 is None and truth is not None and truth.pixel_size_m is not None:
        return truth.pixel_size_m**2
    return cube.pixel_area_m2


def header_notes(cube: Cube) -> tuple[str, ...]:
    """What the header of a cube says of its acquisition."""
    return acquisition_notes(
        cube.extras, cube.axis, cube.samples, cube.raster.bands, lines=cube.lines, quantity=cube.quantity
    )


def open_source(source: CubeSource, resolve: Resolve, bands: BandTable | None = None) -> Cube:
    """Open the cube that a campaign names, with its bands from a table where the campaign names one."""
    unit = source.unit if source.quantity == "radiance" else None
    if unit is None and source.quantity == "radiance" and not source.may_state_unit:
        unit = RADIANCE_UNIT  # as simulations write it; others that state none were refused with the campaign
    return open_cube(
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


def _targets(
    cube: Cube, table: LookupTable | None, truth: TargetTruth | None, area: float | None, resolve: Resolve
) -> tuple[list[TargetObject], list[str]]:
    """The target objects, and what is to be said of how they were drawn."""
    if truth is None:
        return [], []
    if truth.pixel_size_m is not None and (cube.pixel_area_m2 is not None or table is not None):
        raise UsageError("the cube has a map position, and 'targets.pixel_size_m' is stated", mend="take it out")
    if truth.csv is not None:
        if area is None and table is None and cube.crs is not None and cube.crs.is_geographic:
            raise UsageError(
                "pixels in degrees have no ground size", where=truth.csv, mend="state targets.pixel_size_m"
            )
        listed = read_targets(
            resolve(truth.csv),
            cube.shape,
            transform=table or cube.transform,
            pixel_size_m=None if area is None else math.sqrt(area),
        )
        return listed, []
    if truth.finer is not None:
        return finer_targets(truth.finer, cube, area, resolve)
    if truth.abundances is not None:
        return abundance_targets(truth.abundances, cube, area, resolve)
    if truth.regions:
        return _drawn_targets(cube, table, truth, area, resolve)
    rasters = truth.rasters
    assert rasters is not None  # noqa: S101 - one of them is given
    masks = {}
    for material, reference in rasters.materials.items():
        union = np.zeros(cube.shape, bool)
        for region in read_regions(resolve(reference), cube.shape, transform=cube.transform, crs=cube.crs).values():
            union |= region.mask
        masks[material] = union
    sizes = np.zeros(cube.shape, np.int64)
    path = resolve(rasters.size_classes)
    wanted: dict[str | int, str] = {value: str(value) for value in rasters.side_m}
    coded = read_regions(path, cube.shape, transform=cube.transform, crs=cube.crs, names=wanted)
    for name, region in coded.items():
        sizes[region.mask] = int(name)
    return intersected_objects(masks, sizes, rasters.side_m), []


def _drawn_targets(
    cube: Cube, table: LookupTable | None, truth: TargetTruth, area: float | None, resolve: Resolve
) -> tuple[list[TargetObject], list[str]]:
    """Objects drawn as regions: every pixel that a polygon touches, as targets may be smaller than a pixel."""
    out: list[TargetObject] = []
    remarks: list[str] = []
    for source in truth.regions:
        path = resolve(source.file)
        drawn = regions_of_file(cube, table, path, source, patterns=source.regions, touched=True)
        for pattern in source.regions:
            if not any(fnmatchcase(name, pattern) for name in drawn):
                raise UsageError(
                    f"no region {pattern!r}", where=str(path), expected="one of " + ", ".join(sorted(drawn))
                )
        chosen = [
            region
            for name, region in drawn.items()
            if not source.regions or any(fnmatchcase(name, pattern) for pattern in source.regions)
        ]
        remarks += [f"{remark} (targets)" for region in chosen for remark in region.remarks]
        new = region_objects(
            chosen, source.material, whole=source.objects == "regions", side_m=source.side_m, pixel_area_m2=area
        )
        # A class raster for each material, of one name: the material tells the objects apart.
        taken = {o.name for o in out if o.material != source.material}
        out += [replace(o, name=f"{o.material} {o.name}") if o.name in taken else o for o in new]
    names = [o.name for o in out]
    double = sorted({name for name in names if names.count(name) > 1})
    if double:
        raise UsageError(
            f"two targets are named {double[0]!r}",
            where="targets.regions",
            mend="name a region under one material only",
        )
    return out, remarks
