"""The reflectance after the empirical line as an image cube, ENVI or cloud-optimised GeoTIFF."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import rasterio
import rasterio.shutil
from rasterio.errors import NotGeoreferencedWarning
from rasterio.windows import Window

from hyperval.data import Mask
from hyperval.errors import refusal
from hyperval.imagery import Cube, EnviRaster, envi_writer
from hyperval.pixels import EmpiricalLine
from hyperval.progress import watch_lines
from hyperval.spectra.axis import SpectralAxis
from hyperval.storage import whole_file

Stored = npt.NDArray[np.int16]
Form = Literal["envi", "cog"]

# Stored value of a reflectance of 1; a step is 1e-4, far below the noise of any imager.
SCALE = 10_000
NO_DATA = -32768
_INT16 = 2
_TILE = 128
_CACHE_MB = 64


Write = Callable[[int, Stored], None]  # lines (lines, samples, B) from a number on


def write_reflectance(folder: Path, name: str, cube: Cube, elm: EmpiricalLine | None, form: Form) -> tuple[Path, str]:
    """Write (L - b)/k of every pixel as 16-bit integers of 1e-4; line by line, whole or not at all.

    No data stands where the pixel has none, in bands in which the line has no gain (marked bad), and where the
    value does not fit (beyond -3.2767 to 3.2767).

    Parameters
    ----------
    folder, name : the file is ``folder/name.img`` with its header, or ``folder/name.tif``

    Returns
    -------
    The file, and a note that says what it holds.

    Raises
    ------
    UsageError : no empirical line, or a cube that is reflectance already.
    """
    if elm is None or cube.quantity == "reflectance":
        raise refusal("reflectance.line")
    axis = SpectralAxis(cube.axis.centre_nm, cube.axis.fwhm_nm, cube.axis.good & elm.usable)
    what = f"reflectance by the empirical line through {', '.join(elm.names)}; stored value = {SCALE} x reflectance"
    path = folder / f"{name}.{'img' if form == 'envi' else 'tif'}"
    watch = watch_lines("reflectance", cube.bytes_per_line, cube.lines)
    clipped = 0
    with _write_envi(path, cube, axis, what) if form == "envi" else _write_cog(path, cube, axis, what) as write:
        for lines, (block, misfits) in watch(_stored_blocks(cube, elm, axis.good)):
            write(lines.start, block)
            clipped += misfits
    note = f"{path.name}: {what}; no data is {NO_DATA}; {int((~elm.usable).sum())} bands without a gain"
    if clipped:
        note += f"; {clipped} values of good bands beyond {32767 / SCALE:g} are no data"
    return path, note


def _stored_blocks(cube: Cube, elm: EmpiricalLine, good: Mask) -> Iterator[tuple[range, tuple[Stored, int]]]:
    """Stored numbers (lines, samples, B) of the blocks in order, and how many good values did not fit."""
    for block in cube.blocks():
        with np.errstate(invalid="ignore", over="ignore"):
            block.values[~block.valid] = np.nan
            scaled = np.rint(elm.reflectance(block.values) * SCALE)
            stored = np.where(np.abs(scaled) <= 32767, scaled, NO_DATA).astype(np.int16)  # NaN does not fit
        misfits = int(np.count_nonzero(stored[block.valid][:, good] == NO_DATA))
        yield range(block.first_line, block.first_line + len(stored)), (stored, misfits)


@contextmanager
def _write_envi(path: Path, cube: Cube, axis: SpectralAxis, what: str) -> Iterator[Write]:
    # The scale is written, not applied: blocks come as stored numbers.
    extra = {"reflectance scale factor": repr(float(SCALE)), "z plot titles": "{Wavelength [nm], Reflectance [1]}"}
    place: dict[str, Any] = {"transform": cube.transform, "crs": cube.crs}
    stated = cube.raster.description.entries
    if isinstance(cube.raster, EnviRaster) and stated.get("map info", "").strip():
        # As it stands: a rotated grid, a datum or a unit that we would have to put in our own words.
        place = {}
        for key in ("map info", "coordinate system string"):
            if text := stated.get(key, "").strip():
                extra[key] = text if text.startswith("{") else "{" + text + "}"
    with envi_writer(
        path, lines=cube.lines, samples=cube.samples, bands=cube.bands, data_type=_INT16, interleave="bil",
        axis=axis, description=what, ignore_value=NO_DATA, extra=extra, **place,
    ) as writer:  # fmt: skip
        yield lambda _, block: writer.write(block)  # in order


@contextmanager
def _write_cog(path: Path, cube: Cube, axis: SpectralAxis, what: str) -> Iterator[Write]:
    """Strips into a plain GeoTIFF, which is then copied tile by tile: the format wants its index first."""
    profile = {
        "driver": "GTiff", "height": cube.lines, "width": cube.samples, "count": cube.bands, "dtype": "int16",
        "nodata": NO_DATA, "interleave": "pixel", "bigtiff": "if_safer", "tiled": False, "blockysize": 1,
        "transform": cube.transform, "crs": cube.crs,
    }  # fmt: skip
    with warnings.catch_warnings(), rasterio.Env(GDAL_CACHEMAX=_CACHE_MB, GDAL_PAM_ENABLED="NO"):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with whole_file(path) as temporary:
            strips = temporary.with_name(f"{temporary.stem}-strips.tif")
            try:
                with rasterio.open(strips, "w", **profile) as dataset:
                    dataset.update_tags(TIFFTAG_IMAGEDESCRIPTION=what)
                    dataset.scales = [1.0 / SCALE] * cube.bands
                    dataset.offsets = [0.0] * cube.bands
                    dataset.units = ["1"] * cube.bands
                    for i in range(cube.bands):
                        centre, width = float(axis.centre_nm[i]), float(axis.fwhm_nm[i])
                        dataset.set_band_description(i + 1, f"{centre:.10g} nm{'' if axis.good[i] else ' (bad band)'}")
                        dataset.update_tags(
                            i + 1, ns="IMAGERY", CENTRAL_WAVELENGTH_UM=repr(centre / 1e3), FWHM_UM=repr(width / 1e3)
                        )
                        dataset.update_tags(i + 1, GOOD_BAND=str(int(axis.good[i])))

                    def write(line: int, block: Stored) -> None:
                        window = Window(0, line, cube.samples, len(block))
                        dataset.write(np.ascontiguousarray(block.transpose(2, 0, 1)), window=window)

                    yield write
                rasterio.shutil.copy(
                    strips, temporary, driver="COG", compress="DEFLATE", predictor="YES", blocksize=_TILE,
                    bigtiff="IF_SAFER", overviews="NONE",
                )  # fmt: skip
            finally:
                strips.unlink(missing_ok=True)
