"""Truth images: finer than the cube, or of its size with bands of material numbers and of abundances.

A finer map of classes says which part of the ground is target.  The fill of a pixel is the integral of its
response, the square aperture convolved with the Gaussian of the sensor, over that part (f of 3.10).  The response
is a product of one along lines and one along samples, so that the fills of a window are W_y M W_x^T with closed W:
exact for cells whose sides run along those of the pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt
from affine import Affine
from scipy.special import ndtri

from hyperval.collection import AbundanceTruth, BandRange, FinerTruth, RegionSource
from hyperval.errors import InputError, refusal
from hyperval.imagery import Cube, Raster, open_raster, raster_of_size
from hyperval.imagery.drawing import outside_error
from hyperval.imagery.regions import Region, patches
from hyperval.imagery.truth import TargetObject, cut_out
from hyperval.model.fill import aperture_weights
from hyperval.spectra.axis import SIGMA_PER_FWHM

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
MAX_CELLS = 400_000_000
MAX_OBJECTS = 10_000
LEAST_FILL = 0.02  # pixels that are filled less are none of the target
SHIFTS = 32  # drawn places of the finer image, where its registration has an error
_SQUARE_OFF = 0.02  # pixels that a side of the finer image may run aslant over its whole length
_REACH_SD = 5.0
_LINES = 64  # read at once


@dataclass(frozen=True)
class FinerGrid:
    """Where the cells of a finer image lie on the cube, and how its pixels see them.

    Attributes
    ----------
    line, sample : of the corner of its first cell, continuous pixel coordinates of the cube
    line_step, sample_step : sides of a cell [pixels]
    blur : FWHM of the sensor's Gaussian along lines and along samples [pixels]
    shifts : (K, 2) equally likely displacements of the cells along lines and samples [pixels]
    """

    line: float
    sample: float
    line_step: float
    sample_step: float
    blur: tuple[float, float] = (0.0, 0.0)
    shifts: Array = field(default_factory=lambda: np.zeros((1, 2)))

    def beginning(self, row: int, column: int) -> FinerGrid:
        """The part of the grid from a cell on."""
        line, sample = self.line + self.line_step * row, self.sample + self.sample_step * column
        return replace(self, line=line, sample=sample)


def window_fills(cells: Array | Mask, grid: FinerGrid, corner: tuple[int, int], size: tuple[int, int]) -> Array:
    """(K, lines, samples) fills of the pixels of a window by the cells of an image (f of 3.10).

    Parameters
    ----------
    cells : (h, w) part of each that is target
    grid : where the first of them lies
    corner, size : first line and sample of the window, and its lines and samples
    """
    y = grid.line + grid.line_step * np.arange(cells.shape[0] + 1)
    x = grid.sample + grid.sample_step * np.arange(cells.shape[1] + 1)
    part = cells.astype(float)
    out = np.empty((len(grid.shifts), *size))
    for k, (down, right) in enumerate(grid.shifts):
        along = aperture_weights(y + down, corner[0], size[0], grid.blur[0])
        across = aperture_weights(x + right, corner[1], size[1], grid.blur[1])
        out[k] = along @ part @ across.T
    return np.clip(out, 0.0, 1.0)


def registration_shifts(error_pixels: float, count: int = SHIFTS) -> Array:
    """(K, 2) equally likely displacements, normal with this standard deviation in each direction [pixels].

    A low-discrepancy sequence with mean 0 and exactly that spread; one displacement of 0 where there is no error.
    """
    if error_pixels == 0.0:
        return np.zeros((1, 2))
    even = (0.5 + np.arange(count)[:, None] * np.array([0.7548776662466927, 0.5698402909980532])) % 1.0
    normal = ndtri(np.clip(even, 1e-3, 1.0 - 1e-3))
    normal -= normal.mean(axis=0)
    return np.asarray(error_pixels * normal / normal.std(axis=0))


def image_targets(
    truth: FinerTruth | AbundanceTruth, cube: Cube, pixel_area_m2: float | None, resolve: Callable[[str], Path]
) -> tuple[list[TargetObject], list[str]]:
    """The targets of a truth image with the fills of their pixels, and what is to be said of them.

    Abundances are cells of a pixel each, seen without blur where they lie; DIRSIG writes them as bands of 64-bit
    numbers in the size of the radiance image, each with its name.

    Raises
    ------
    InputError : a finer image that is not finer, lies aslant or elsewhere, has none of the classes, or a target that
        leaves the cube; abundances of another size, in no such band, or that are no parts of a pixel.
    UsageError : an image without a place on the cube.
    """
    path, pixel_area = resolve(truth.image), math.nan if pixel_area_m2 is None else pixel_area_m2
    images: Iterator[tuple[str, Array | Mask]]
    if isinstance(truth, FinerTruth):
        raster, error = open_raster(path), truth.registration_pixels or 0.0
        if truth.registration_m is not None:
            if pixel_area_m2 is None:
                raise refusal("finer.size", str(path))
            error = truth.registration_m / math.sqrt(pixel_area)
        blur = truth.psf_fwhm_pixels
        both = blur if isinstance(blur, tuple) else (blur, blur)
        grid = replace(_grid(truth, raster, cube, str(path)), blur=both, shifts=registration_shifts(error))
        images = _class_cells(truth, raster, path)
    else:
        grid, error = FinerGrid(0.0, 0.0, 1.0, 1.0), 0.0
        images = _abundances(truth, raster_of_size(path, cube.shape), path)
    out: list[TargetObject] = []
    for material, cells in images:
        listed = list(islice(patches(cells > 0, material, whole=truth.objects != "patches"), MAX_OBJECTS + 1))
        if len(listed) > MAX_OBJECTS:
            raise refusal("finer.patches", str(path), most=MAX_OBJECTS, material=material)
        for name, window, inside in listed:
            part, there = np.where(inside, cells[window], 0), grid.beginning(window[0].start, window[1].start)
            corner, fills = _seen(name, part, there, cube.shape, str(path))
            area = float(part.sum()) * grid.line_step * grid.sample_step * pixel_area
            out.append(object_of_fills(name, material, fills, corner, cube.shape, area, str(path)))
    known = [(o.fills, o.part) for o in out if o.fills is not None]
    mean, spread = (np.concatenate([of(fills, axis=0)[part] for fills, part in known]) for of in (np.mean, np.std))
    if isinstance(truth, FinerTruth):
        note = f"{len(out)} targets from {path.name}, {1 / grid.sample_step:.3g} times finer: {mean.size} pixels of "
        note += f"fill {mean.min():.3g} to {mean.max():.3g}, mean {mean.mean():.3g}"
        if error:
            note += f"; registration of {error:.3g} pixels makes {float(np.sqrt(np.mean(spread**2))):.2g} (RMS) of it"
        return out, [note]
    remarks = [f"{len(out)} targets of {mean.size} pixels by the abundances in {path.name}"]
    if np.all(mean == 1.0):
        remarks.append(
            f"warning: no pixel in {path.name} is filled in part: was each pixel sampled by one ray? Their number "
            "in the simulation is what fills are counted by"
        )
    return out, remarks


def _grid(truth: FinerTruth, raster: Raster, cube: Cube, where: str) -> FinerGrid:
    """Place and size of the cells, by the map or as the campaign states them."""
    if truth.corner is not None and truth.times_finer is not None:
        step = 1.0 / truth.times_finer
        grid = FinerGrid(*truth.corner, step, step)
    else:
        if raster.transform is None or cube.transform is None:
            raise refusal("finer.map", where)
        if raster.crs is not None and cube.crs is not None and raster.crs != cube.crs:
            raise refusal("finer.crs", where, own=raster.crs.to_string()[:60], other=cube.crs.to_string()[:60])
        to_pixels: Affine = ~cube.transform @ raster.transform
        aslant = max(abs(to_pixels.b) * raster.lines, abs(to_pixels.d) * raster.samples)
        if aslant > _SQUARE_OFF or to_pixels.a <= 0 or to_pixels.e <= 0:
            raise refusal("finer.aslant", where)
        grid = FinerGrid(to_pixels.f, to_pixels.c, to_pixels.e, to_pixels.a)
    if max(grid.line_step, grid.sample_step) > 0.5:
        raise refusal("finer.cells", where, line_step=grid.line_step, sample_step=grid.sample_step)
    return grid


def _class_cells(truth: FinerTruth, raster: Raster, path: Path) -> Iterator[tuple[str, Mask]]:
    """Material -> which cells it fills; a class is a value of the first band, or a range of a band."""
    if raster.lines * raster.samples > MAX_CELLS:
        raise InputError(f"{raster.lines} x {raster.samples} cells", where=str(path), expected=f"at most {MAX_CELLS}")
    for material, chosen in truth.classes.items():
        one = chosen if isinstance(chosen, BandRange) else BandRange(band=1, above=chosen, below=chosen)
        low, high = -np.inf if one.above is None else one.above, np.inf if one.below is None else one.below
        mask = np.empty((raster.lines, raster.samples), bool)
        for rows, values in _rows(raster, _band(raster, one.band, path)):
            mask[rows] = (values >= low) & (values <= high)
        if not mask.any():
            raise InputError(f"no cell of {material!r}", where=str(path), expected="a value that the image holds")
        yield material, mask


def _abundances(truth: AbundanceTruth, raster: Raster, path: Path) -> Iterator[tuple[str, Array]]:
    """Material -> (lines, samples) part of each pixel that it fills, 0 below the least."""
    for material, wanted in truth.materials.items():
        band = _band(raster, wanted, path)
        fill = _values(raster, band)
        if not np.all((fill >= -1e-6) & (fill <= 1 + 1e-6)):
            raise refusal("truth.abundance", str(path), band=band + 1, low=np.nanmin(fill), high=np.nanmax(fill))
        fill = np.where(fill >= LEAST_FILL, np.minimum(fill, 1.0), 0.0)
        if not fill.any():
            raise InputError(f"no pixel is filled by {material!r}", where=str(path), expected=f"{LEAST_FILL:g}")
        yield material, fill


def _seen(
    name: str, cells: Array | Mask, grid: FinerGrid, shape: tuple[int, int], where: str
) -> tuple[tuple[int, int], Array]:
    """Corner of the window of pixels that see some of the cells of a target, and their fills (K, h, w)."""
    starts = np.array([grid.line, grid.sample])
    ends = starts + np.array([grid.line_step, grid.sample_step]) * cells.shape
    if np.any(starts < 0) or np.any(ends > shape):
        mend = "check where the finer image lies; a target that the cube cuts is taken out of it"
        raise outside_error(np.array([starts, ends])[:, ::-1], shape, where, f"the target {name!r}", mend)
    away = np.ceil(_REACH_SD * np.array(grid.blur) * SIGMA_PER_FWHM + np.abs(grid.shifts).max(axis=0))
    low = np.maximum(np.floor(starts) - away, 0).astype(int)
    high = np.minimum(np.ceil(ends) + away, shape).astype(int)
    corner, size = (int(low[0]), int(low[1])), (int(high[0] - low[0]), int(high[1] - low[1]))
    return corner, window_fills(cells, grid, corner, size)


def object_of_fills(
    name: str, material: str, fills: Array, corner: tuple[int, int], shape: tuple[int, int], area_m2: float, where: str
) -> TargetObject:
    """A target by the fills (K, h, w) of a window: its pixels are those of which the mean reaches 0.02."""
    mask = fills.mean(axis=0) >= LEAST_FILL
    if not mask.any():
        raise refusal("truth.fill", where, name=name, least=LEAST_FILL)
    (line, sample), part = cut_out(mask)
    kept = fills[:, line : line + part.shape[0], sample : sample + part.shape[1]].copy()
    attributes = {"material": material, "region": name}
    return TargetObject(
        name, material, math.nan, area_m2, shape, (corner[0] + line, corner[1] + sample), part,
        attributes=attributes, fills=kept,
    )  # fmt: skip


def fills_of(targets: Mapping[str, list[TargetObject]], rows: int = 64) -> dict[str, list[list[float]]]:
    """Subject -> fills of the pixels of its objects in falling order, a row for each object and drawn place.

    Rows are equally likely; of many drawn places so many are taken that there are about ``rows``.
    """
    out: dict[str, list[list[float]]] = {}
    for subject, members in targets.items():
        known = [(o.fills, o.part) for o in members if o.fills is not None]
        if len(known) < len(members):
            continue
        most = max(1, rows // len(known))
        least = min(len(fills) for fills, _ in known)  # each object in as many places as any other
        count = min(most, least)
        out[subject] = [
            np.sort(fills[k][part])[::-1].tolist()
            for fills, part in known
            for k in np.linspace(0, len(fills) - 1, count).astype(int)
        ]
    return out


def material_regions(source: RegionSource, cube: Cube, path: Path) -> dict[str, Region]:
    """Regions by the numbers of materials in a band of a truth image.

    Raises
    ------
    InputError : another size than the cube's, no such band, or a number that no pixel has.
    """
    raster = raster_of_size(path, cube.shape)
    band = _band(raster, source.band if source.band is not None else 1, path)
    values = _values(raster, band)
    regions = {}
    for name, number in source.classes.items():
        mask = values == number
        if not mask.any():
            present = ", ".join(f"{v:g}" for v in np.unique(values[np.isfinite(values)])[:20])
            raise InputError(f"no pixel of material {number} ({name!r})", where=str(path), expected=f"one of {present}")
        regions[name] = Region(name, mask, str(path))
    return regions


def _band(raster: Raster, wanted: int | str, path: Path) -> int:
    """Number from 0 of a band that is named or numbered (from 1)."""
    names = raster.description.band_names
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
            expected="one of " + ", ".join(names)
            if names
            else f"a number, 1 to {raster.bands}: its header has no name for each band",
        )
    return fits[0]


def _rows(raster: Raster, band: int) -> Iterator[tuple[slice, Array]]:
    """Blocks of lines of one band, and which they are."""
    with raster.kept_open():
        for first in range(0, raster.lines, _LINES):
            rows = slice(first, min(first + _LINES, raster.lines))
            yield rows, raster.read_bands(first, rows.stop - first)[band]


def _values(raster: Raster, band: int) -> Array:
    """(lines, samples) of one band."""
    return np.concatenate([values for _, values in _rows(raster, band)]).astype(float)
