"""Truth as masks: objects of class rasters and of regions drawn on the image."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from hyperval.errors import InputError, UsageError
from hyperval.imagery.regions import Region, objects
from hyperval.imagery.truth import Mask, TargetObject, cut_out


def intersected_objects(
    materials: Mapping[str, Mask],
    size_class: npt.ArrayLike,
    side_m: Mapping[int, float],
) -> list[TargetObject]:
    """Objects as the intersection of material masks with a raster of size classes.

    Parameters
    ----------
    materials : (lines, samples) mask by material
    size_class : (lines, samples) whole numbers, 0 where there is no target
    side_m : side [m] of each class; classes that are left out make no object

    Returns
    -------
    One object for every material and listed class, named "material side m", in the order given.

    Raises
    ------
    InputError : shapes differ, or a material has no pixel of a listed class.
    """
    classes = np.asarray(size_class)
    out = []
    for material, mask in materials.items():
        if mask.shape != classes.shape:
            raise InputError(f"{material}: mask {mask.shape} and size classes {classes.shape} differ in shape")
        for value, side in side_m.items():
            here = mask & (classes == value)
            if not here.any():
                raise InputError(f"{material} has no pixel of size class {value}")
            attributes = {"material": material, "side_m": f"{side:g}"}
            name, area = f"{material} {side:g} m", float(side) ** 2
            size = (here.shape[0], here.shape[1])
            out.append(TargetObject(name, material, float(side), area, size, *cut_out(here), attributes=attributes))
    return out


def region_objects(
    regions: Iterable[Region],
    material: str,
    *,
    patches: bool = True,
    side_m: float | Literal["marked"] | None = None,
    pixel_area_m2: float | None = None,
) -> list[TargetObject]:
    """Objects of one material drawn as regions.

    Parameters
    ----------
    patches : each connected group of pixels (8 neighbours) is an object; False: each region is one
    side_m : side of the square targets [m]; "marked": each has the area of its pixels; None: not known
    pixel_area_m2 : ground area of a pixel, for "marked"

    Returns
    -------
    Objects named by their region, with a number where it falls into several, lines first.  The column ``region``
    holds the region's name, ``pixels`` how many it marks.

    Raises
    ------
    UsageError : sides by marked pixels whose ground area is not known.
    """
    if side_m == "marked" and pixel_area_m2 is None:
        raise UsageError(
            "side_m: marked needs the ground area of a pixel",
            where="targets.regions",
            mend="state targets.pixel_size_m",
        )
    out = []
    for region in regions:
        labels, count = objects(region.mask) if patches else (region.mask.astype(np.int32), 1)
        shape = (labels.shape[0], labels.shape[1])
        for number, window in enumerate(ndimage.find_objects(labels), start=1):
            name = region.name if count == 1 else f"{region.name} {number}"
            corner = (int(window[0].start), int(window[1].start))
            part = labels[window] == number
            pixels = int(np.count_nonzero(part))
            side = math.sqrt(pixels * (pixel_area_m2 or 0.0)) if side_m == "marked" else side_m
            attributes = {"material": material, "region": region.name, "pixels": str(pixels)}
            if side is None:
                side = math.nan
            else:
                attributes["side_m"] = f"{side:.6g}"
            out.append(TargetObject(name, material, side, side**2, shape, corner, part, attributes=attributes))
    return out
