"""Truth images of a simulation, such as DIRSIG's: a band of material numbers, bands of abundances.

DIRSIG writes them as ENVI files of 64-bit numbers in the size of the radiance image, each band with its name.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.collection_files import AbundanceTruth, RegionSource
from hyperval.errors import InputError
from hyperval.imagery.cube import Cube
from hyperval.imagery.rasters import Raster, open_raster
from hyperval.imagery.regions import Region, patches
from hyperval.imagery.truth import TargetObject
from hyperval.observe.finer import object_of_fills

Array = npt.NDArray[np.float64]


def material_regions(source: RegionSource, cube: Cube, path: Path) -> dict[str, Region]:
    """Regions by the numbers of materials in a band of a truth image.

    Raises
    ------
    InputError : another size than the cube's, no such band, or a number that no pixel has.
    """
    raster = _of_cube(path, cube)
    band = _band(raster, source.band if source.band is not None else 1, path)
    values = _values(raster, band)
    regions = {}
    for name, number in source.classes.items():
        mask = values == number
        if not mask.any():
            present = ", ".join(f"{v:g}" for v in np.unique(values[np.isfinite(values)])[:20])
            raise InputError(
                f"no pixel of material {number} ({name!r})", where=str(path), expected=f"one of {present}"
            )
        regions[name] = Region(name, mask, str(path))
    return regions


def abundance_targets(
    truth: AbundanceTruth, cube: Cube, pixel_area_m2: float | None, resolve: Callable[[str], Path]
) -> tuple[list[TargetObject], list[str]]:
    """Targets with the fills of their pixels by bands of abundances, and what is to be said of them.

    Raises
    ------
    InputError : another size than the cube's, no such band, or values that are no parts of a pixel.
    """
    path = resolve(truth.image)
    raster = _of_cube(path, cube)
    out: list[TargetObject] = []
    for material, wanted in truth.materials.items():
        band = _band(raster, wanted, path)
        fill = _values(raster, band)
        if not np.all((fill >= -1e-6) & (fill <= 1 + 1e-6)):
            raise InputError(
                f"band {band + 1} holds {np.nanmin(fill):g} to {np.nanmax(fill):g}",
                where=str(path),
                expected="the part of each pixel that the material fills, 0 to 1",
                mend="name a band of abundances; a band of material numbers makes regions (band, classes)",
            )
        fill = np.clip(fill, 0.0, 1.0)
        mask = fill >= truth.least_fill
        if not mask.any():
            raise InputError(
                f"no pixel is filled by {material!r}", where=str(path), expected=f"{truth.least_fill:g}"
            )
        for name, window, inside in patches(mask, material, whole=truth.objects == "bands"):
            part = np.where(inside, fill[window], 0.0)
            area = math.nan if pixel_area_m2 is None else float(part.sum()) * pixel_area_m2
            corner = int(window[0].start), int(window[1].start)
            out.append(
                object_of_fills(name, material, part[None], corner, cube.shape, area, truth.least_fill, str(path))
            )
    pixels = sum(int(o.part.sum()) for o in out)
    remarks = [f"{len(out)} targets of {pixels} pixels by the abundances in {path.name}"]
    if all(np.isin(o.fills[o.fills > 0], 1.0).all() for o in out if o.fills is not None):
        remarks.append(
            f"warning: no pixel in {path.name} is filled in part: was each pixel sampled by one ray? Their number "
            "in the simulation is what fills are counted by"
        )
    return out, remarks


def _of_cube(path: Path, cube: Cube) -> Raster:
    raster = open_raster(path)
    if (raster.lines, raster.samples) != cube.shape:
        raise InputError(
            f"{raster.lines} lines and {raster.samples} samples",
            where=str(path),
            expected=f"{cube.lines} lines and {cube.samples} samples, as the cube",
        )
    return raster


def _band(raster: Raster, wanted: int | str, path: Path) -> int:
    """Number from 0 of a band that is named or numbered (from 1)."""
    names = (raster.header.strings("band names") if raster.header is not None else None) or ()
    if isinstance(wanted, int):
        if not 1 <= wanted <= raster.bands:
            raise InputError(f"no band {wanted}", where=str(path), expected=f"1 to {raster.bands}")
        return wanted - 1
    fits = [i for i, name in enumerate(names) if name == wanted]
    fits = fits or [i for i, name in enumerate(names) if fnmatchcase(name.lower(), wanted.lower())]
    if len(fits) != 1:
        raise InputError(
            f"{len(fits)} bands are called {wanted!r}",
            where=str(path),
            expected="one of " + ", ".join(names) if names else f"a number, 1 to {raster.bands}",
        )
    return fits[0]


def _values(raster: Raster, band: int) -> Array:
    """(lines, samples) of one band, read by blocks of lines."""
    out = np.empty((raster.lines, raster.samples))
    with raster.kept_open():
        for first in range(0, raster.lines, 64):
            count = min(64, raster.lines - first)
            out[first : first + count] = raster.read_bands(first, count)[band]
    return out
