"""The regions of a collection: read from files, drawn, found by rules on spectra, or made of other regions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from glob import escape
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.collection_files import NormalizedDifference, RegionSource, Ring, VectorSource
from hyperval.errors import InputError, UsageError
from hyperval.imagery.cube import Cube
from hyperval.imagery.georeference import pixel_sides_m
from hyperval.imagery.lookup_table import LookupTable
from hyperval.imagery.regions import (
    Region,
    half_region,
    holes,
    overlaps,
    read_regions,
    rectangle_region,
    ring_region,
)
from hyperval.imagery.truth import TargetObject
from hyperval.observe.truth_images import material_regions
from hyperval.progress import track

Mask = npt.NDArray[np.bool_]
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
            new = {
                name: rectangle_region(name, (line, line + lines - 1), (sample, sample + samples - 1), cube.shape)
            }
        elif source.whole_image:
            new = {name: Region(name, np.broadcast_to(np.True_, cube.shape), "the whole image")}
        elif source.half is not None:
            whole = _above(name, "half of", source.half.of, regions)
            new = {name: half_region(name, whole, first=source.half.which == "first")}
        elif source.ring is not None:
            new = {
                name: _ring(
                    name, source.ring, _above(name, "a ring around", source.ring.of, regions), cube, area_m2
                )
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
    notes += [
        f"the regions {first!r} and {second!r} share {count} pixels" for first, second, count in overlaps(listed)
    ]
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
