"""Truth: the target objects of a collection, from a list or from class rasters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from affine import Affine

from hyperval.errors import InputError, UsageError
from hyperval.imagery.polygons import map_to_pixel, polygon_mask
from hyperval.imagery.regions import guard
from hyperval.imagery.regions_files import read_table
from hyperval.paths import checked_file

Mask = npt.NDArray[np.bool_]
_PLACES = {("row0", "col0"): 0.5, ("row1", "col1"): -0.5, ("line", "sample"): 0.0, ("easting", "northing"): None}


@dataclass(frozen=True, eq=False)
class TargetObject:
    """One target on the ground.

    Attributes
    ----------
    name, material : as in the list
    side_m : side of the (square) target [m], NaN when only the area is known
    area_m2 : area [m2], NaN when unknown
    mask : (lines, samples) the pixels that may hold a part of it; need not be connected
    centre_pixel : (line, sample) of the pixel that holds the centre, None where only the mask is known
    attributes : the columns of the list as text, for grouping
    """

    name: str
    material: str
    side_m: float
    area_m2: float
    mask: Mask
    centre_pixel: tuple[int, int] | None = None
    attributes: Mapping[str, str] = field(default_factory=dict)


def read_targets(
    path: Path | str,
    shape: tuple[int, int],
    *,
    transform: Affine | None = None,
    pixel_size_m: float | None = None,
    root: Path | None = None,
) -> list[TargetObject]:
    """Targets of a CSV list.

    Columns: ``material``; ``name`` (default: material and line); the place of the centre as ``row0,col0``
    or ``row1,col1`` (whole or fractional pixel numbers, an integer meaning the pixel centre), ``line,sample``
    (continuous, (0.5, 0.5) the centre of the first pixel) or ``easting,northing`` (the cube's map system);
    ``side_m`` or ``width_m`` with ``length_m``; optionally ``area_m2``, ``heading_deg`` (of the length,
    clockwise from the direction of decreasing line) and ``position_uncertainty_m``, which widens the mask.
    The mask holds every pixel that the target's rectangle touches.

    Parameters
    ----------
    pixel_size_m : ground size of a pixel where the cube has no transform

    Raises
    ------
    InputError : missing columns, numbers that are none, targets outside the image.
    """
    path = checked_file(path, root=root, what="target list")
    fields, rows = read_table(path)
    place = next((p for p in _PLACES if p[0] in fields and p[1] in fields), None)
    if place is None or "material" not in fields:
        raise InputError(
            f"columns {', '.join(fields) or 'none'}",
            where=f"{path}:1",
            expected="material and one of " + "; ".join(",".join(p) for p in _PLACES),
        )
    if transform is not None:
        pixel_size_m = math.sqrt(abs(transform.determinant))
    if pixel_size_m is None or not pixel_size_m > 0:
        raise UsageError(
            "the ground size of a pixel is not known", where=str(path), mend="state targets.pixel_size_m"
        )
    out: list[TargetObject] = []
    for line, row in rows:
        where = f"{path}:{line}"
        number = {key: _number(row.get(key), key, where) for key in fields if key not in ("name", "material")}
        material = row["material"]
        name = row.get("name") or f"{material} {line - 1}"
        if not material or any(t.name == name for t in out):
            raise InputError("no material, or a name that stands twice", where=where)
        width = number.get("width_m", number.get("side_m", math.nan))
        length = number.get("length_m", width)
        area = number.get("area_m2", math.nan)
        area = width * length if math.isnan(area) else area
        if not width > 0 or not length > 0:
            raise InputError("no size", where=where, expected="side_m, or width_m and length_m, above 0")
        first, second = number[place[0]], number[place[1]]
        if math.isnan(first) or math.isnan(second):
            raise InputError(f"no {place[0]}, {place[1]}", where=where)
        shift = _PLACES[place]
        if shift is None:
            x, y = map_to_pixel([(first, second)], transform, where=where)[0]
        else:
            x, y = second + shift, first + shift
        heading = number.get("heading_deg", 0.0)
        corners = _rectangle(
            x, y, width / pixel_size_m, length / pixel_size_m, 0.0 if math.isnan(heading) else heading
        )
        mask = polygon_mask(corners, shape, where=where, touched=True)
        doubt = number.get("position_uncertainty_m", math.nan)
        if doubt > 0:
            mask = guard(mask, doubt / pixel_size_m)
        side = width if width == length else math.nan
        centre = (math.floor(y), math.floor(x))
        out.append(TargetObject(name, material, side, area, mask, centre, dict(row)))
    if not out:
        raise InputError("the list holds no target", where=str(path))
    return out


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
            out.append(
                TargetObject(
                    f"{material} {side:g} m", material, float(side), float(side) ** 2, here, attributes=attributes
                )
            )
    return out


def _rectangle(x: float, y: float, width: float, length: float, heading_deg: float) -> npt.NDArray[np.float64]:
    """(4, 2) corners (sample, line) of a rectangle around (x, y), its length along the heading."""
    h = math.radians(heading_deg)
    along, across = np.array([math.sin(h), -math.cos(h)]), np.array([math.cos(h), math.sin(h)])
    half = [(-1, -1), (-1, 1), (1, 1), (1, -1)]
    return np.array([np.array([x, y]) + a * length / 2 * along + b * width / 2 * across for a, b in half])


def _number(text: str | None, key: str, where: str) -> float:
    if text is None or not text.strip():
        return math.nan
    try:
        value = float(text)
    except ValueError:
        return math.nan if key not in _NUMERIC else _refuse(text, key, where)
    if not math.isfinite(value):
        return _refuse(text, key, where)
    return value


_NUMERIC = frozenset(
    {"side_m", "width_m", "length_m", "area_m2", "heading_deg", "position_uncertainty_m"}
    | {column for pair in _PLACES for column in pair}
)


def _refuse(text: str, key: str, where: str) -> float:
    raise InputError(f"{key} is {text[:40]!r}", where=where, expected="a number")
