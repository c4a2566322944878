"""A collection opened: the cube, its regions, its targets, and which pixels count for what.

The regions of a collection: read from files, drawn, found by rules on spectra, or made of other regions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from glob import escape
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.collection import CollectionSection
from hyperval.collection_files import (
    BandTableFile,
    CubeSource,
    NormalizedDifference,
    RegionSource,
    Ring,
    TargetTruth,
    VectorSource,
)
from hyperval.errors import InputError, UsageError
from hyperval.imagery import Cube, open_cube, open_raster
from hyperval.imagery.acquisition import acquisition_notes
from hyperval.imagery.envi import pixel_sides_m
from hyperval.imagery.placing import LookupTable, location_table, open_lookup_table, table_of
from hyperval.imagery.regions import (
    Region,
    guard,
    half_region,
    holes,
    overlaps,
    read_regions,
    rectangle_region,
    ring_region,
)
from hyperval.imagery.truth import TargetObject, all_pixels, intersected_objects, read_targets, region_objects
from hyperval.observe.site_spectra import read_band_table
from hyperval.observe.truth_images import abundance_targets, finer_targets, material_regions
from hyperval.pixels import EmpiricalLine, Labels
from hyperval.progress import track
from hyperval.units import RADIANCE_UNIT

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Index = npt.NDArray[np.intp]
Resolve = Callable[[str], Path]


def normalized_difference(cube: Cube, rule: NormalizedDifference, *, show: bool | None = None) -> Mask:
    """Pixels (lines, samples) whose (high - low)/(high + low) lies above and below the limits of ``rule``."""
    centre = cube.axis.centre_nm
    chosen = []
    for low, high in (rule.high_nm, rule.low_nm):
        bands = np.flatnonzero((centre >= low) & (centre <= high) & cube.axis.good)
        if bands.size == 0:
            raise UsageError(f"no usable band between {low:g} and {high:g} nm for a normalised difference")
        chosen.append(bands)
    out = np.zeros(cube.shape, bool)
    for block in track(cube.blocks(dtype=np.float32), "normalised difference", show=show):
        high, low = (block.values[..., bands].mean(axis=-1, dtype=np.float64) for bands in chosen)
        with np.errstate(divide="ignore", invalid="ignore"):
            index = (high - low) / (high + low)
        rows = slice(block.first_line, block.first_line + block.values.shape[0])
        out[rows] = block.valid & (index >= rule.above) & (index < rule.below)
    return out


def _above(name: str, what: str, of: str, regions: Mapping[str, Region]) -> Region:
    """The region that another one is made of."""
    if of not in regions:
        raise UsageError(
            f"{name!r} is {what} {of!r}, which is no region above it",
            where="collection.regions",
            expected="one of " + ", ".join(regions) if regions else "a region above it",
        )
    return regions[of]


def _ring(name: str, ring: Ring, around: Region, cube: Cube, area_m2: float | None) -> Region:
    if ring.outer_pixels is not None:
        return ring_region(name, around, ring.inner_pixels, ring.outer_pixels)
    if area_m2 is None:
        raise UsageError(
            "the ground size of a pixel is not known",
            where=f"region {name!r}",
            mend="give inner_pixels and outer_pixels in place of metres",
        )
    assert ring.outer_m is not None  # noqa: S101 - one of the two is given
    return ring_region(name, around, ring.inner_m, ring.outer_m, pixel_sides_m(cube.transform, area_m2))


def collection_regions(
    cube: Cube,
    table: LookupTable | None,
    sources: Sequence[RegionSource],
    resolve: Resolve,
    area_m2: float | None,
    show: bool | None,
) -> dict[str, Region]:
    """The regions of a collection by name, in their order.

    ``area_m2`` : ground area of a pixel, None when it is not known

    Raises
    ------
    InputError : missing or corrupt files, regions outside the image.
    UsageError : names that do not fit.
    """
    regions: dict[str, Region] = {}
    for source in sources:
        name, new = str(source.name), dict[str, Region]()
        if source.classes:
            new = material_regions(source, cube, resolve(str(source.file)))
        elif source.file is not None:
            path = resolve(source.file)
            only = [] if source.name is None else [escape(source.name)]
            new = regions_of_file(cube, table, path, source, patterns=only)
            if source.name is not None:
                if len(new) == 1:
                    new = {source.name: replace(next(iter(new.values())), name=source.name)}
                elif source.name in new:
                    new = {source.name: new[source.name]}
                else:
                    raise InputError(f"no region {source.name!r} among {', '.join(new)}", where=str(path))
        elif source.rectangle is not None:
            line, sample, lines, samples = source.rectangle
            new = {name: rectangle_region(name, (line, line + lines - 1), (sample, sample + samples - 1), cube.shape)}
        elif source.whole_image:
            new = {name: Region(name, np.broadcast_to(np.True_, cube.shape), "the whole image")}
        elif source.half is not None:
            whole = _above(name, "half of", source.half.of, regions)
            new = {name: half_region(name, whole, first=source.half.which == "first")}
        elif source.ring is not None:
            new = {
                name: _ring(name, source.ring, _above(name, "a ring around", source.ring.of, regions), cube, area_m2)
            }
        else:
            rule = source.normalized_difference
            assert rule is not None  # noqa: S101 - one of them is given
            new = {name: Region(name, normalized_difference(cube, rule, show=show), "normalised difference")}
        twice = sorted(set(new) & set(regions))
        if twice:
            raise UsageError(f"two regions are named {twice[0]!r}")
        regions.update(new)
    return regions


def regions_of_file(
    cube: Cube,
    table: LookupTable | None,
    path: Path,
    source: VectorSource,
    *,
    patterns: Sequence[str] = (),
    touched: bool = False,
) -> dict[str, Region]:
    """Regions of a file, placed by the lookup table where there is one, else as the cube lies."""
    return read_regions(
        path,
        cube.shape,
        transform=table or cube.transform,
        crs=table.crs if table else cube.crs,
        coordinates=source.coordinates,
        name_field=source.name_field,
        patterns=patterns,
        touched=touched,
    )


def region_notes(regions: Iterable[Region], by_rule: frozenset[str] = frozenset()) -> list[str]:
    """What leaves the image, which regions have holes (but those that a rule found), which share pixels."""
    listed = list(regions)
    notes = [remark for region in listed for remark in region.remarks]
    for region in listed:
        count, pixels = (0, 0) if region.name in by_rule else holes(region.mask)
        if count:
            what = "a hole" if count == 1 else f"{count} holes"
            notes.append(f"the region {region.name!r} has {what} of {pixels} pixels, which are not part of it")
    notes += [f"the regions {first!r} and {second!r} share {count} pixels" for first, second, count in overlaps(listed)]
    return notes


def target_overlaps(regions: Iterable[Region], targets: Sequence[TargetObject], near: Mask) -> list[str]:
    """Which regions hold pixels of targets or of their guard, and what becomes of these; likewise two targets."""
    notes: list[str] = []
    if not targets:
        return notes
    touched = np.zeros(near.shape, np.int32)
    for target in targets:
        touched[target.window] += target.part
    for region in regions:
        inside, guarded = int(np.sum(region.mask & (touched > 0))), int(np.sum(region.mask & near))
        if not guarded:
            continue
        what = f"the region {region.name!r} holds {inside} pixels of targets and {guarded - inside} of their guard"
        if guarded == region.n:
            notes.append(f"warning: {what}, which is all of it: they stay in its statistics")
        else:
            notes.append(f"{what} among {region.n}: left out of its statistics")
    shared = int(np.sum(touched > 1))
    if shared:
        notes.append(f"{shared} pixels may hold parts of more than one target" + _between(targets))
    return notes


def _between(targets: Sequence[TargetObject]) -> str:
    """Which materials share pixels, in words: ": 12 of 'a' and 'b'"."""
    masks: dict[str, Mask] = {}
    for target in targets:
        masks[target.material] = masks[target.material] | target.mask if target.material in masks else target.mask
    pairs = overlaps(Region(name, mask, "targets") for name, mask in masks.items())
    return ": " + ", ".join(f"{n} of {a!r} and {b!r}" for a, b, n in pairs) if pairs else ""


SCENE = "scene"
IMAGE = "image"
_TOGETHER = 2048  # pixels whose spectra are read at once
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
        taken = [self.labels.members[name] for name in (_NEAR, *leave_out)]
        return np.asarray(~np.any(taken, axis=0))

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

    def pixels_at(self, lines: Index, samples: Index, elm: EmpiricalLine | None = None) -> tuple[Array, Mask]:
        """(n, B) values of pixels (n,), in reflectance with a line, and (n,) which of them hold data."""
        values, usable = self.cube.marked_pixels((lines, samples))
        return values if elm is None else elm.reflectance(values), usable

    def valid_pixels(
        self, lines: Index, samples: Index, bands: npt.NDArray[Any] | None = None
    ) -> Iterator[tuple[Array, Mask]]:
        """Values (m, b) of those of the pixels (n,) that hold data, and which they are; some of the pixels at a time.

        ``bands``: handed out, and known in every pixel; None: all, whatever they hold.
        """
        for start in range(0, lines.size, _TOGETHER):
            values, valid = self.cube.marked_pixels(
                (lines[start : start + _TOGETHER], samples[start : start + _TOGETHER])
            )
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
            raise UsageError(
                f"no region {name!r}", expected="one of " + ", ".join(self.regions) if self.regions else "a region"
            )


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
    table, source_of = _lookup_table(cube, collection.cube, resolve)
    area_m2 = _pixel_area_m2(cube, table, collection.targets)
    regions = collection_regions(cube, table, collection.regions, resolve, area_m2, show_progress)
    targets, remarks = _targets(cube, table, collection.targets, area_m2, resolve)
    near = all_pixels(targets, cube.shape)
    if targets and collection.targets and collection.targets.guard_pixels:
        near = guard(near, collection.targets.guard_pixels)
    for name in collection.leave_out:
        if name not in regions:
            raise UsageError(f"leave_out names {name!r}, which is no region", expected=", ".join(regions))
    notes = [*cube.notes, *source_of, *header_notes(cube)]
    if table is not None:
        size = f", pixels of {table.pixel_area_m2:.3g} m2" if table.pixel_area_m2 else ""
        notes.append(f"places on the map are found by the lookup table {table.raster.path.name}{size}")
    by_rule = frozenset(str(r.name) for r in collection.regions if r.normalized_difference is not None)
    notes += [*region_notes(regions.values(), by_rule), *remarks]
    notes += target_overlaps(regions.values(), targets, near)
    return Place(
        cube,
        Labels.of(cube.shape, {name: region.mask for name, region in regions.items()} | {_NEAR: near}),
        targets,
        area_m2,
        collection.targets.pixels if collection.targets else "touched",
        by_rule,
        tuple(notes),
        table,
        frozenset(collection.leave_out),
        collection.cube.by_number,
    )


def check_line_for_detection(place: Place, collection: CollectionSection) -> None:
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


def open_source(source: CubeSource, resolve: Resolve, bands: BandTableFile | None = None) -> Cube:
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
