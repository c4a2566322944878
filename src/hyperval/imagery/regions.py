"""Regions of interest: named masks on the grid of a cube, read from files, drawn, or made of other regions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import combinations
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rasterio.crs import CRS
from scipy import ndimage
from skimage.measure import label

from hyperval.errors import reader, refusal, refuse
from hyperval.imagery.drawing import WARNING, ImageGrid, Position
from hyperval.imagery.regions_files import drawings_of
from hyperval.paths import checked_file

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Region:
    """A named set of pixels.

    Attributes
    ----------
    name : as in the file, or as the campaign calls it
    mask : (lines, samples) True inside
    source : file, or "inline"
    notes : what was found in drawing it, such as a part outside the image, to stand after its name
    """

    name: str
    mask: Mask
    source: str
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        refuse(self.mask.dtype != bool or self.mask.ndim != 2, "region.mask", name=self.name)
        refuse(not self.mask.any(), "region.empty", self.source, name=self.name)

    @property
    def n(self) -> int:
        """Number of pixels."""
        return int(self.mask.sum())

    @property
    def remarks(self) -> list[str]:
        """The notes as sentences with the name of the region."""
        return [
            f"{WARNING * note.startswith(WARNING)}the region {self.name!r} {note.removeprefix(WARNING)}"
            for note in self.notes
        ]


@reader
def read_regions(
    path: Path | str,
    cube_shape: tuple[int, int],
    *,
    transform: Position = None,
    crs: CRS | None = None,
    coordinates: str | None = None,
    patterns: Sequence[str] = (),
    touched: bool = False,
    name_field: str | None = None,
) -> dict[str, Region]:
    """Read the regions of a file, whatever its format.

    The format is known from the content: ENVI ROI XML, ENVI ROI ASCII export (also gzipped), classic
    binary ENVI ROI, GeoJSON, GeoPackage, Shapefile and KML (with the extra ``vector``), CSV pixel list, ENVI or
    GeoTIFF class raster.

    Parameters
    ----------
    cube_shape : (lines, samples) of the cube that the regions belong to
    transform, crs : position of the cube, for regions in map coordinates: an affine transform, or a geographic
        lookup table
    coordinates : "pixel", "map" (the cube's own system) or "lonlat", for GeoJSON (which is "lonlat" otherwise), and
        for a GeoPackage or Shapefile without a coordinate system
    patterns : where names of the file match one of them (* and ? stand for any characters), only those are read;
        a region that is not wanted may then lie outside the image
    touched : take every pixel that a polygon touches, for targets smaller than a pixel
    name_field : attribute of a vector file that names the regions

    Raises
    ------
    InputError : missing, unreadable, empty, wholly outside the image, or made for an image of another size.
    UsageError : unknown format, or ``coordinates`` not stated.
    """
    path = checked_file(path, what="region file")
    drawn = drawings_of(path, ImageGrid(cube_shape, transform, crs, coordinates, name_field))
    refuse(not drawn, "region.none", path)
    wanted = {n: made for n, made in drawn.items() if any(n == p or fnmatchcase(n, p) for p in patterns)} or drawn
    out = {}
    for name, drawing in wanted.items():
        mask, notes = drawing.drawn(f"{path}: region {name!r}", touched=touched)
        out[name] = Region(name, mask, str(path), notes)
    return out


def rectangle_region(name: str, lines: tuple[int, int], samples: tuple[int, int], shape: tuple[int, int]) -> Region:
    """Region of the pixels from the first to the last line and sample, 0-based, both included."""
    (top, bottom), (left, right) = lines, samples
    if not (0 <= top <= bottom < shape[0] and 0 <= left <= right < shape[1]):
        box = {"top": top, "bottom": bottom, "left": left, "right": right}
        raise refusal("region.rectangle", f"region {name!r}", last=(shape[0] - 1, shape[1] - 1), **box)
    mask = np.zeros(shape, bool)
    mask[top : bottom + 1, left : right + 1] = True
    return Region(name, mask, "inline")


def half_region(name: str, region: Region, *, first: bool) -> Region:
    """The half of a region with the lower line numbers, or the other; by samples where it is wider than long.

    The cut lies where half of the pixels are on either side, up to those of one line.
    """
    lines, samples = np.nonzero(region.mask)
    along = lines if np.ptp(lines) >= np.ptp(samples) else samples
    before = along < np.sort(along)[along.size // 2]
    chosen = before if first else ~before
    refuse(not chosen.any(), "region.half", f"region {name!r}", of=region.name)
    mask = np.zeros(region.mask.shape, bool)
    mask[lines[chosen], samples[chosen]] = True
    return Region(name, mask, f"half of {region.name}")


def ring_region(
    name: str, region: Region, inner: float, outer: float, pixel: tuple[float, float] = (1.0, 1.0)
) -> Region:
    """The pixels whose centres lie more than ``inner`` and at most ``outer`` from the nearest of a region.

    ``pixel`` : distance between lines and between samples, in the unit of the other two
    """
    mask = np.zeros(region.mask.shape, bool)
    above, beside = (int(min(outer / step, max(mask.shape))) + 1 for step in pixel)
    part = window_of(region.mask, (above, beside))
    distance = ndimage.distance_transform_edt(~region.mask[part], sampling=pixel)
    mask[part] = (distance > inner) & (distance <= outer)
    refuse(not mask.any(), "region.ring", f"region {name!r}", of=region.name)
    return Region(name, mask, f"ring around {region.name}")


def window_of(mask: Mask, margin: tuple[int, int] = (0, 0)) -> tuple[slice, slice]:
    """Lines and samples of the window of a mask that holds all that is True in it, and a margin."""
    lines, samples = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    above, beside = margin
    return (
        slice(max(int(lines[0]) - above, 0), int(lines[-1]) + above + 1),
        slice(max(int(samples[0]) - beside, 0), int(samples[-1]) + beside + 1),
    )


def overlaps(regions: Iterable[Region]) -> list[tuple[str, str, int]]:
    """Pairs of regions that share pixels, with the number of shared pixels."""
    pairs = ((a.name, b.name, int(np.count_nonzero(a.mask & b.mask))) for a, b in combinations(regions, 2))
    return [pair for pair in pairs if pair[2]]


def holes(mask: Mask) -> tuple[int, int]:
    """Number of holes in a mask, and their pixels: groups (of 4 neighbours) that it encloses."""
    if not mask.any():
        return 0, 0
    part = mask[window_of(mask)]
    if part.all():
        return 0, 0
    labels, count = label(~np.pad(part, 1), connectivity=1, return_num=True)
    return int(count) - 1, int(np.count_nonzero(labels > 1))  # the first label is that of the surroundings


def objects(mask: Mask) -> tuple[npt.NDArray[np.int32], int]:
    """Connected groups of pixels (8 neighbours): labels (lines, samples), 0 outside, and their number."""
    labels, count = label(mask, connectivity=2, return_num=True)
    return labels.astype(np.int32), int(count)


def groups_by_size(mask: Mask) -> tuple[list[Mask], str]:
    """The masks of the groups of touching pixels of a mask, the largest first, and what they are in words.

    A single group of several pixels is cut into its halves; none where the mask holds more than half of the image.
    """
    if mask.mean() > 0.5:
        return [], f"the map marks {mask.mean():.0%} of the image: no objects before a background"
    labels, count = objects(mask)
    if count == 1 and mask.sum() > 1:
        one = Region("object", mask, "map")
        return [half_region("half", one, first=first).mask for first in (True, False)], "2 halves of one group"
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    return [labels == 1 + i for i in np.argsort(-sizes, kind="stable")], f"{count} touching groups"


def patches(mask: Mask, name: str, *, whole: bool = False) -> Iterator[tuple[str, tuple[slice, slice], Mask]]:
    """Name, window and mask within it of each group of touching pixels (8 neighbours), of all where ``whole``.

    A number stands after the name where there are several, lines first.
    """
    labels, count = (mask.astype(np.int32), 1) if whole else objects(mask)
    for number, window in enumerate(ndimage.find_objects(labels), start=1):
        yield name if count == 1 else f"{name} {number}", window, labels[window] == number


def guard(mask: Mask, radius_pixels: float) -> Mask:
    """The mask grown by a disc: every pixel whose centre is within the radius of a centre in the mask."""
    refuse(not radius_pixels >= 0, "region.guard", radius=radius_pixels)
    if not mask.any():
        return mask.copy()
    out, near = np.zeros(mask.shape, bool), window_of(mask, (int(radius_pixels),) * 2)
    out[near] = ndimage.distance_transform_edt(~mask[near]) <= radius_pixels  # of all pixels: 16 bytes for each
    return out
