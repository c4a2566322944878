"""Truth images: finer than the cube, or of its size with bands of material numbers and of abundances.

A finer map of classes says which part of the ground is target.  The fill of a pixel is the integral of its
response, the square aperture convolved with the Gaussian of the sensor, over that part (f of 3.10).  The response
is a product of one along lines and one along samples, so that the fills of a window are W_y M W_x^T with closed W:
exact for cells whose sides run along those of the pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
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
SHIFTS = 32  # drawn places of the finer image, where its registration has an error
_SQUARE_OFF = 0.02  # pixels that a side of the finer image may run aslant over its whole length
_REACH_SD = 5.0
_LINES = 64  # read at once


@dataclass(frozen=True)
class FinerGrid:
    """Where the cells of a finer image lie on the cube.

    Attributes
    ----------
    line, sample : of the corner of its first cell, continuous pixel coordinates of the cube
    line_step, sample_step : sides of a cell [pixels]
    """

    line: float
    sample: float
    line_step: float
    sample_step: float

    def beginning(self, row: int, column: int) -> FinerGrid:
        """The part of the grid from a cell on."""
        line, sample = self.line + self.line_step * row, self.sample + self.sample_step * column
        return replace(self, line=line, sample=sample)


def window_fills(
    mask: Mask,
    grid: FinerGrid,
    corner: tuple[int, int],
    size: tuple[int, int],
    blur: tuple[float, float],
    shifts: Array,
) -> Array:
    """(K, lines, samples) fills of the pixels of a window by the cells of a mask (f of 3.10).

    Parameters
    ----------
    mask : (h, w) cells that are target
    grid : where the first of them lies
    corner, size : first line and sample of the window, and its lines and samples
    blur : FWHM of the sensor's Gaussian along lines and along samples [pixels]
    shifts : (K, 2) displacements of the cells along lines and samples [pixels]
    """
    y = grid.line + grid.line_step * np.arange(mask.shape[0] + 1)
    x = grid.sample + grid.sample_step * np.arange(mask.shape[1] + 1)
    part = mask.astype(float)
    out = np.empty((len(shifts), *size))
    for k, (down, right) in enumerate(shifts):
        along = aperture_weights(y + down, corner[0], size[0], blur[0])
        across = aperture_weights(x + right, corner[1], size[1], blur[1])
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


def finer_targets(
    truth: FinerTruth, cube: Cube, pixel_area_m2: float | None, resolve: Callable[[str], Path]
) -> tuple[list[TargetObject], list[str]]:
    """The targets of a finer image with the fills of their pixels, and what is to be said of them.

    Raises
    ------
    InputError : an image that is not finer, lies aslant or elsewhere, has none of the classes, or a target that
        leaves the cube.
    UsageError : an image without a place on the cube.
    """
    path = resolve(truth.image)
    raster = open_raster(path)
    if raster.lines * raster.samples > MAX_CELLS:
        raise InputError(f"{raster.lines} x {raster.samples} cells", where=str(path), expected=f"at most {MAX_CELLS}")
    grid = _grid(truth, raster, cube, str(path))
    error = truth.registration_pixels or 0.0
    if truth.registration_m is not None:
        if pixel_area_m2 is None:
            raise refusal("finer.size", str(path))
        error = truth.registration_m / math.sqrt(pixel_area_m2)
    shifts = registration_shifts(error)
    blur = truth.psf_fwhm_pixels
    both = blur if isinstance(blur, tuple) else (blur, blur)
    out: list[TargetObject] = []
    for material, mask in _class_masks(truth, raster, str(path)):
        listed = list(islice(patches(mask, material, whole=truth.objects == "classes"), MAX_OBJECTS + 1))
        if len(listed) > MAX_OBJECTS:
            raise refusal("finer.patches", str(path), most=MAX_OBJECTS, material=material)
        for name, (rows, columns), inside in listed:
            there, cells = grid.beginning(rows.start, columns.start), float(inside.sum())
            area = math.nan
            if pixel_area_m2 is not None:
                area = cells * grid.line_step * grid.sample_step * pixel_area_m2
            out.append(_object(name, material, inside, there, cube, both, shifts, area, truth, str(path)))
    fills = np.concatenate([o.fills.mean(axis=0)[o.part] for o in out if o.fills is not None])
    spread = np.concatenate([o.fills.std(axis=0)[o.part] for o in out if o.fills is not None])
    note = f"{len(out)} targets from {path.name}, {1 / grid.sample_step:.3g} times finer: {fills.size} pixels of fill "
    note += f"{fills.min():.3g} to {fills.max():.3g}, mean {fills.mean():.3g}"
    if error:
        note += f"; registration of {error:.3g} pixels makes {float(np.sqrt(np.mean(spread**2))):.2g} (RMS) of it"
    return out, [note]


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


def _class_masks(truth: FinerTruth, raster: Raster, where: str) -> Iterator[tuple[str, Mask]]:
    """Material -> cells; a class is a value of the first band, or a range of a band."""
    for material, chosen in truth.classes.items():
        one = chosen if isinstance(chosen, BandRange) else BandRange(band=1, above=chosen, below=chosen)
        if one.band > raster.bands:
            raise InputError(f"no band {one.band}", where=where, expected=f"1 to {raster.bands}")
        low, high = -np.inf if one.above is None else one.above, np.inf if one.below is None else one.below
        mask = np.empty((raster.lines, raster.samples), bool)
        for rows, values in _rows(raster, one.band - 1):
            mask[rows] = (values >= low) & (values <= high)
        if not mask.any():
            raise InputError(f"no cell of {material!r}", where=where, expected="a value that the image holds")
        yield material, mask


def _object(
    name: str, material: str, inside: Mask, grid: FinerGrid, cube: Cube, blur: tuple[float, float], shifts: Array,
    area_m2: float, truth: FinerTruth, where: str,
) -> TargetObject:  # fmt: skip
    shape = cube.shape
    starts = np.array([grid.line, grid.sample])
    ends = starts + np.array([grid.line_step, grid.sample_step]) * inside.shape
    if np.any(starts < 0) or np.any(ends > shape):
        mend = "check where the finer image lies; a target that the cube cuts is taken out of it"
        raise outside_error(np.array([starts, ends])[:, ::-1], shape, where, f"the target {name!r}", mend)
    away = np.ceil(_REACH_SD * np.array(blur) * SIGMA_PER_FWHM + np.abs(shifts).max(axis=0))
    low = np.maximum(np.floor(starts) - away, 0).astype(int)
    high = np.minimum(np.ceil(ends) + away, shape).astype(int)
    corner, size = (int(low[0]), int(low[1])), (int(high[0] - low[0]), int(high[1] - low[1]))
    fills = window_fills(inside, grid, corner, size, blur, shifts)
    return object_of_fills(name, material, fills, corner, shape, area_m2, truth.least_fill, where)


def object_of_fills(
    name: str,
    material: str,
    fills: Array,
    corner: tuple[int, int],
    shape: tuple[int, int],
    area_m2: float,
    least: float,
    where: str,
) -> TargetObject:
    """A target by the fills (K, h, w) of a window: its pixels are those of which the mean reaches ``least``."""
    mask = fills.mean(axis=0) >= least
    if not mask.any():
        raise refusal("truth.fill", where, name=name, least=least)
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


def abundance_targets(
    truth: AbundanceTruth, cube: Cube, pixel_area_m2: float | None, resolve: Callable[[str], Path]
) -> tuple[list[TargetObject], list[str]]:
    """Targets with the fills of their pixels by bands of abundances, and what is to be said of them.

    DIRSIG writes such bands as ENVI files of 64-bit numbers in the size of the radiance image, each with its name.

    Raises
    ------
    InputError : another size than the cube's, no such band, or values that are no parts of a pixel.
    """
    path = resolve(truth.image)
    raster = raster_of_size(path, cube.shape)
    out: list[TargetObject] = []
    for material, wanted in truth.materials.items():
        band = _band(raster, wanted, path)
        fill = _values(raster, band)
        if not np.all((fill >= -1e-6) & (fill <= 1 + 1e-6)):
            raise refusal("truth.abundance", str(path), band=band + 1, low=np.nanmin(fill), high=np.nanmax(fill))
        fill = np.clip(fill, 0.0, 1.0)
        mask = fill >= truth.least_fill
        if not mask.any():
            raise InputError(f"no pixel is filled by {material!r}", where=str(path), expected=f"{truth.least_fill:g}")
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
