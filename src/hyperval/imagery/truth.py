"""Truth: the target objects of a collection, by a list of them, class rasters, or regions drawn on the image."""

from __future__ import annotations

import math
from collections import UserDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS

from hyperval.data import Array, Mask
from hyperval.errors import needed, package_table, reader, refusal, refuse
from hyperval.imagery import regions as roi
from hyperval.imagery.placing import LocationTable
from hyperval.imagery.regions import Position
from hyperval.paths import checked_file, read_table
from hyperval.storage import number_of

# First line and sample of a window, and a mask within it.
Placed = tuple[tuple[int, int], Mask]
_ON_MAP = ("easting", "northing")
_LONLAT = (("lon", "lat"), ("longitude", "latitude"))
_PLACES = {("row0", "col0"): 0.5, ("row1", "col1"): -0.5, ("line", "sample"): 0.0, _ON_MAP: None}
_PLACES |= dict.fromkeys(_LONLAT)
_CALLED: dict[str, str] = package_table("imagery/names.yaml")["columns_of_targets"]


@dataclass(frozen=True, eq=False)
class TargetObject:
    """One target on the ground.

    Attributes
    ----------
    name, material : as in the list
    side_m, area_m2 : side of the (square) target [m] and its area [m2], NaN where unknown
    shape, corner : (lines, samples) of the image, (line, sample) of the first pixel of the target's window
    part : (h, w) within that window, the pixels that may hold a part of the target; need not be connected
    centre_pixel : (line, sample) of the pixel that holds the centre, None where only the mask is known
    attributes : the columns of the list as text, for grouping
    fills : (K, h, w) part of each pixel of the window that it fills, at K equally likely places; None: unknown
    """

    name: str
    material: str
    side_m: float
    area_m2: float
    shape: tuple[int, int]
    corner: tuple[int, int]
    part: Mask
    centre_pixel: tuple[int, int] | None = None
    attributes: Mapping[str, str] = field(default_factory=dict)
    fills: Array | None = None

    def displaced(self, lines: int, samples: int) -> TargetObject:
        """The same elsewhere, as far as its window lies in the image."""
        last = np.subtract(self.shape, self.part.shape)
        down, right = np.clip(np.add(self.corner, (lines, samples)), 0, last) - self.corner
        centre = self.centre_pixel and (self.centre_pixel[0] + int(down), self.centre_pixel[1] + int(right))
        corner = self.corner[0] + int(down), self.corner[1] + int(right)
        return replace(self, corner=corner, centre_pixel=centre)

    @property
    def mask(self) -> Mask:
        """(lines, samples) the pixels that may hold a part of it, made anew each time."""
        return all_pixels([self], self.shape)

    @property
    def window(self) -> tuple[slice, slice]:
        """Lines and samples of the window."""
        (line, sample), (height, width) = self.corner, self.part.shape
        return slice(line, line + height), slice(sample, sample + width)

    def paint(self, image: Mask) -> None:
        """Set the target's pixels in a mask of the whole image."""
        image[self.window] |= self.part


class TargetMasks(UserDict[str, Any]):
    """Name -> (lines, samples) mask of each target, made of the target when it is asked for."""

    def __getitem__(self, name: str) -> Mask:
        target: TargetObject = self.data[name]
        return target.mask


def all_pixels(targets: Sequence[TargetObject], shape: tuple[int, int]) -> Mask:
    """(lines, samples) the pixels of all targets."""
    out = np.zeros(shape, bool)
    for target in targets:
        target.paint(out)
    return out


def mask_window(mask: Mask) -> Placed:
    """The window of a mask (lines, samples) that holds all that is True in it, of one pixel at least."""
    window = roi.window_of(mask)
    return (window[0].start, window[1].start), mask[window].copy()


@reader
def read_targets(
    path: Path | str,
    shape: tuple[int, int],
    *,
    transform: Position = None,
    crs: CRS | None = None,
    pixel_size_m: float | None = None,
) -> list[TargetObject]:
    """Targets of a CSV list.

    Columns: ``material``; ``name`` (default: material and line); the place of the centre as ``row0,col0``
    or ``row1,col1`` (whole or fractional pixel numbers, an integer meaning the pixel centre), ``line,sample``
    (continuous, (0.5, 0.5) the centre of the first pixel), ``easting,northing`` (the cube's map system, or that
    of its lookup table: ``crs``) or ``lon,lat`` (WGS 84); ``side_m`` or ``width_m`` with ``length_m``; optionally
    ``shape`` (``square``, ``rectangle``, or ``circle`` and ``ellipse``, whose side, width and length are diameters),
    ``area_m2``, ``heading_deg`` (of the length, clockwise from the direction of decreasing line; from grid north on a
    map) and ``position_uncertainty_m``, which widens the mask.
    The mask holds every pixel that the target's outline touches.  Where no size is known the uncertainty of the
    position stands alone: the mask holds every pixel whose centre is that near to the centre of the target's pixel.

    Parameters
    ----------
    pixel_size_m : ground size of a pixel; None takes the unit of the transform for metres

    >>> from tempfile import NamedTemporaryFile
    >>> utm, at = CRS.from_epsg(32618), Affine(1.0, 0.0, 500000.0, 0.0, -1.0, 4427800.0)
    >>> for row in ("lon,lat,material,side_m\\n-75,40,felt,2", "targets_utmx,targets_utmy,targets_type,targets_size,"
    ...             "\\n500000.5,4427757,felt,2,", "line,sample,material,position_uncertainty_m\\n5,9,felt,1",
    ...             "Material,UTM_E,UTM_N,Size (m)\\nfelt,500000.5,4427757,2"):
    ...     with NamedTemporaryFile("w", suffix=".csv") as file:
    ...         print(row, file=file, flush=True)
    ...         read_targets(file.name, (90, 9), transform=at @ Affine.translation(-4, 0), crs=utm)[0].centre_pixel
    (42, 4)
    (43, 4)
    (5, 8)
    (43, 4)

    Raises
    ------
    InputError : missing columns, numbers that are none, a shape that is none or that its sizes contradict, targets
        outside the image.
    """
    path = checked_file(path, what="target list")
    fields, rows = read_table(path, {"name", "material", "shape", *_NUMERIC, *_CALLED})
    fields = [_CALLED.get(name, name) for name in fields]
    place = next((p for p in _PLACES if p[0] in fields and p[1] in fields), None)
    if place is None or "material" not in fields:
        places = "; ".join(",".join(p) for p in _PLACES)
        raise refusal("target.columns", f"{path}:1", columns=", ".join(fields) or "none", places=places)
    pixel_m = pixel_size_m or 0.0
    if pixel_size_m is None and transform is not None:
        ground = transform.determinant if isinstance(transform, Affine) else transform.pixel_area_m2
        pixel_m = math.sqrt(abs(ground or 0.0))
    refuse(not pixel_m > 0, "target.pixel", path)
    out: dict[str, TargetObject] = {}
    for line, cells in rows:
        row = dict(zip(fields, cells.values(), strict=True))
        where, material = f"{path}:{line}", row["material"]
        name = row.get("name") or f"{material} {line - 1}"
        refuse(not material or name in out, "target.name", where)
        number = {key: number_of(row.get(key, "")) for key in sorted(_NUMERIC)}
        for key in (key for key, value in number.items() if row.get(key, "").strip() and not math.isfinite(value)):
            raise refusal("target.number", where, key=key, text=row[key][:40])
        width, length, doubt = _size(number, where)
        word, area = row.get("shape", "").lower(), number["area_m2"]
        refuse(word not in _FIGURES, "target.shape", where, shape=word[:40])
        if word in ("square", "circle") and width != length:
            raise refusal("target.sides", where, shape=word, width=width, length=length)
        figure = _FIGURES[word]
        if math.isnan(area) and width > 0:
            area = width * length * (math.pi / 4 if figure is _DISC else 1.0)
        if place in _LONLAT:
            xy = np.array([[number[key] for key in place]])
            number |= zip(_ON_MAP, roi.reprojected(xy, CRS.from_epsg(4326), crs, where)[0].tolist(), strict=True)
        system = _ON_MAP if place in _LONLAT else place
        centre, corners = _position(number, system, transform, pixel_m, figure * (length, width), where)
        if not roi.inside_image(corners, shape).all():
            mend = "check what kind its coordinates are; a target that the image cuts is taken out of the list"
            raise roi.outside_error(corners, shape, where, f"the target {name!r}", mend)
        centre_mask = roi.point_mask([centre], shape)
        mask = roi.polygon_mask(corners, shape, where=where, touched=True) if width > 0 else centre_mask
        placed = mask_window(roi.guard(mask, doubt / pixel_m) if doubt > 0 else mask)
        side = width if width == length and width > 0 and figure is _SQUARE else math.nan
        out[name] = TargetObject(name, material, side, area, shape, *placed, mask_window(centre_mask)[0], dict(row))
    refuse(not out, "target.none", path)
    return list(out.values())


def _size(number: Mapping[str, float], where: str) -> tuple[float, float, float]:
    """Width and length [m], 0 where nobody states a size, and the uncertainty of the position [m], maybe NaN."""
    for key in ("area_m2", "position_uncertainty_m"):
        refuse(number[key] < 0, "target.negative", where, key=key, value=number[key])
    # A list may hold squares and rectangles.
    width = number["side_m"] if math.isnan(number["width_m"]) else number["width_m"]
    length = width if math.isnan(number["length_m"]) else number["length_m"]
    doubt = number["position_uncertainty_m"]
    if math.isnan(width) and math.isnan(length) and doubt > 0:
        return 0.0, 0.0, doubt  # a place known to so many metres, of a target whose size nobody states
    refuse(not width > 0 or not length > 0, "target.size", where)
    return width, length, doubt


def _position(
    number: Mapping[str, float], place: tuple[str, str], transform: Position, pixel_m: float, sides: Array, where: str
) -> tuple[tuple[float, float], Array]:
    """Centre (sample, line) and corners (n, 2) of a target, in continuous pixel coordinates.

    >>> turned = Affine.rotation(30.0) @ Affine.scale(2.0, -2.0)  # of which the lines run from 30 degrees west of north
    >>> number = {"easting": 0.0, "northing": 0.0, "heading_deg": 20.0}
    >>> _position(number, ("easting", "northing"), turned, 2.0, np.array([(2.0, 0.0)]), "")[1].round(3).tolist()
    [[0.766, -0.643]]
    """
    first, second = number[place[0]], number[place[1]]
    refuse(math.isnan(first) or math.isnan(second), "target.place", where, place=place)
    heading = 0.0 if math.isnan(number["heading_deg"]) else number["heading_deg"]
    if (shift := _PLACES[place]) is not None:
        x, y = second + shift, first + shift
        return (x, y), _outline((x, y), sides, pixel_m, heading)
    one = pixel_m / math.sqrt(abs(transform.determinant)) if isinstance(transform, Affine) else 1.0
    unit_m = transform.metres_per_unit if isinstance(transform, LocationTable) else (one, one)
    unit_m = needed(unit_m, "place.unit", where)
    around = _outline((0.0, 0.0), sides, 1.0, heading) / unit_m * (1.0, -1.0)  # lines run down, northings up
    on_map = np.array([first, second]) + np.vstack([(0.0, 0.0), around])
    (x, y), *corners = roi.map_to_pixel(on_map, transform, where=where)
    return (x, y), np.array(corners)


# Points (along, across) of figures of unit size.
_TURN = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
_SQUARE = np.array([(-0.5, -0.5), (-0.5, 0.5), (0.5, 0.5), (0.5, -0.5)])
_DISC = np.column_stack([np.cos(_TURN), np.sin(_TURN)]) / 2
_FIGURES = {"": _SQUARE, "square": _SQUARE, "rectangle": _SQUARE, "circle": _DISC, "ellipse": _DISC}


def _outline(centre: tuple[float, float], sides: Array, scale: float, heading_deg: float) -> Array:
    """(n, 2) points (sample, line) of a figure about a centre, its length along the heading.

    ``sides`` (n, 2) points (along, across) [m], divided by ``scale``, the metres of a unit of the coordinates.
    """
    h = math.radians(heading_deg)
    along, across = np.array([math.sin(h), -math.cos(h)]), np.array([math.cos(h), math.sin(h)])
    return np.asarray(np.array(centre) + (sides[:, :1] / scale) * along + (sides[:, 1:] / scale) * across)


_SIZES = {"side_m", "width_m", "length_m", "area_m2", "heading_deg", "position_uncertainty_m"}
_NUMERIC = frozenset(_SIZES.union(*_PLACES))


def intersected_objects(
    materials: Mapping[str, Mask], size_class: npt.ArrayLike, side_m: Mapping[int, float]
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
        refuse(mask.shape != classes.shape, "target.classes", material=material, mask=mask.shape, classes=classes.shape)
        for value, side in side_m.items():
            part = mask & (classes == value)
            refuse(not part.any(), "target.class", material=material, value=value)
            attributes = {"material": material, "side_m": f"{side:g}"}
            facts = f"{material} {side:g} m", material, float(side), float(side) ** 2, (part.shape[0], part.shape[1])
            out.append(TargetObject(*facts, *mask_window(part), attributes=attributes))
    return out


def region_objects(
    regions: Iterable[roi.Region],
    material: str,
    *,
    whole: bool = False,
    side_m: float | Literal["marked"] | None = None,
    pixel_area_m2: float | None = None,
) -> list[TargetObject]:
    """Objects of one material drawn as regions.

    Parameters
    ----------
    whole : each region is an object, in place of each connected group of its pixels (8 neighbours)
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
    refuse(side_m == "marked" and pixel_area_m2 is None, "target.marked", "targets.regions")
    out = []
    for region in regions:
        shape = (region.mask.shape[0], region.mask.shape[1])
        for name, window, part in roi.connected_patches(region.mask, region.name, whole=whole):
            corner = (int(window[0].start), int(window[1].start))
            pixels = int(np.count_nonzero(part))
            side = math.sqrt(pixels * (pixel_area_m2 or 0.0)) if side_m == "marked" else side_m
            attributes = {"material": material, "region": region.name, "pixels": str(pixels)}
            attributes |= {} if side is None else {"side_m": f"{side:.6g}"}
            side = math.nan if side is None else side
            out.append(TargetObject(name, material, side, side**2, shape, corner, part, attributes=attributes))
    return out
