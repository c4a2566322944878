"""Cubes and maps as objects of SPy and xarray, and back."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS

from hyperval.errors import refusal
from hyperval.imagery.arrays import Piece, Store, Term, array_raster, at_hand, labelled_array
from hyperval.imagery.description import Description, ListedBands, Raster
from hyperval.imagery.envi import EnviRaster
from hyperval.spectra.axis import SpectralAxis

if TYPE_CHECKING:
    import spectral
    import xarray as xr
    from spectral.io.spyfile import SpyFile


def cube_to_spy(cube: Any) -> SpyFile | spectral.image.ImageArray:
    """A ``Cube`` as an image of SPy: memory-mapped where it is an ENVI file of one scale, else loaded as float32.

    SPy divides stored values by ``scale_factor``, which is 1/gain here; of ignore values it knows nothing, so that
    they come as numbers (``metadata["data ignore value"]``) from a mapped file and as NaN from a loaded one.
    """
    from spectral.io import envi

    gain, raster = cube.gain, cube.raster
    bands = _band_info(cube.axis)
    whole = np.array_equal(cube.stored_band, np.arange(raster.bands))
    if isinstance(raster, EnviRaster) and whole and np.all(gain == gain[0]) and not np.any(cube.offset):
        image = envi.open(str(raster.header.path), str(raster.path))
        image.scale_factor = 1.0 / float(gain[0])
        image.bands = bands
        return image
    values = np.concatenate([block.values for block in cube.blocks(dtype=np.float32)])
    return _image_array(values, bands, str(raster.path))


def _lazy_cube(cube: Any) -> Any:
    """The values of a cube as xarray takes them, which is loaded here: a run needs none of it."""
    from xarray.backends import BackendArray
    from xarray.core import indexing

    class LazyCube(BackendArray):
        """The values of a cube, read by lines when xarray asks for them."""

        def __init__(self, cube: Any) -> None:
            self.cube = cube
            self.shape = (cube.lines, cube.samples, cube.bands)
            self.dtype = np.dtype(np.float64)

        def __reduce__(self) -> tuple[Any, ...]:
            return _lazy_cube, (self.cube,)

        def __getitem__(self, key: indexing.ExplicitIndexer) -> npt.NDArray[Any]:
            part = indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._read)
            return np.asarray(part)

        def _read(self, key: tuple[Any, ...]) -> npt.NDArray[Any]:
            lines = np.arange(self.cube.lines)[key[0]]
            if not np.size(lines):
                return np.empty((0, *self.shape[1:]))[:, key[1], key[2]]
            if np.ptp(lines) >= 4 * np.size(lines):  # far apart: what lies between is not read
                return np.concatenate([self.cube.read(int(n), 1).values for n in lines])[:, key[1], key[2]]
            first = int(np.min(lines))
            values = self.cube.read(first, int(np.ptp(lines)) + 1).values
            return np.asarray(values[lines - first][..., key[1], key[2]])

    return LazyCube(cube)


def cube_to_xarray(cube: Any) -> xr.DataArray:
    """A ``Cube`` as a lazy array (line, sample, wavelength) in its unit, NaN where there is no data.

    Parts are read when they are asked for; ``fwhm`` and ``good`` stand beside the wavelengths, and the position as
    ``spatial_ref`` with ``GeoTransform``, as rioxarray has it.
    """
    import xarray as xr
    from xarray.core import indexing

    lazy = indexing.LazilyIndexedArray(_lazy_cube(cube))
    coords: dict[str, Any] = {
        "wavelength": ("wavelength", cube.axis.centre_nm, {"units": "nm", "standard_name": "radiation_wavelength"}),
        "fwhm": ("wavelength", cube.axis.fwhm_nm, {"units": "nm"}),
        "good": ("wavelength", cube.axis.good),
    }
    array = xr.DataArray(
        xr.Variable(("line", "sample", "wavelength"), lazy, {"units": cube.unit, "quantity": cube.quantity}),
        coords=coords,
        name=cube.quantity,
    )
    return _placed(array, cube.transform, cube.crs)


def map_to_xarray(values: npt.NDArray[Any], transform: Any, crs: str | None, name: str) -> xr.DataArray:
    """A map (line, sample), such as a detector's score, with its position."""
    import xarray as xr

    array = xr.DataArray(values, dims=("line", "sample"), name=name)
    place = None if transform is None else Affine(*tuple(transform)[:6])
    return _placed(array, place, None if crs is None else CRS.from_user_input(crs))


def map_to_spy(values: npt.NDArray[Any], name: str) -> spectral.image.ImageArray:
    """A map (line, sample) as an image of SPy with one band."""
    import spectral

    return _image_array(np.asarray(values)[:, :, None], spectral.BandInfo(), name)


def raster_of(image: Any, variable: str | None = None) -> Raster | Path:
    """The raster of an object of SPy or xarray, read by parts where it is lazy; the path of one that SPy maps.

    Raises
    ------
    UsageError : another kind of object, or an image without wavelengths.
    """
    xarray = sys.modules.get("xarray")  # where it was never loaded, nothing is an array of it
    if xarray is not None and isinstance(image, xarray.DataArray | xarray.Dataset):
        return labelled_array(image, variable)
    import spectral
    from spectral.io.spyfile import SpyFile

    if not isinstance(image, SpyFile | spectral.image.ImageArray):
        raise refusal("exchange.no_cube", kind=type(image).__name__)
    path, about = Path(str(image.filename or "SPy image")), image.bands
    headers = (path.with_suffix(".hdr"), Path(f"{path}.hdr"))
    if isinstance(image, SpyFile) and path.is_file() and any(h.is_file() for h in headers):
        return path
    if about.centers is None:
        raise refusal("exchange.no_wavelengths")
    widths = None if about.bandwidths is None else np.asarray(about.bandwidths, float)
    bands = ListedBands(np.asarray(about.centers, float), widths, about.band_unit)
    dtype = np.dtype(np.float32 if isinstance(image, SpyFile) else image.dtype)
    values = np.asarray(image) if isinstance(image, np.ndarray) else image
    piece = Piece((Term("image"),), "lsb", tuple(image.shape), dtype)
    return array_raster(path, Store(path, at_hand, "image", values), (piece,), Description("image of SPy", bands))


def _placed(array: xr.DataArray, transform: Affine | None, crs: CRS | None) -> xr.DataArray:
    if transform is None and crs is None:
        return array
    attrs: dict[str, Any] = {}
    if crs is not None:
        attrs |= {"crs_wkt": crs.to_wkt(), "spatial_ref": crs.to_wkt()}
    if transform is not None:
        attrs["GeoTransform"] = " ".join(repr(float(v)) for v in transform.to_gdal())
    array = array.assign_coords(spatial_ref=((), 0, attrs))
    array.attrs["grid_mapping"] = "spatial_ref"
    return array


def _band_info(axis: SpectralAxis) -> spectral.BandInfo:
    import spectral

    bands = spectral.BandInfo()
    bands.centers, bands.bandwidths = axis.centre_nm.tolist(), axis.fwhm_nm.tolist()
    bands.band_unit, bands.band_quantity = "nm", "Wavelength"
    return bands


def _image_array(values: npt.NDArray[Any], bands: spectral.BandInfo, filename: str) -> spectral.image.ImageArray:
    import spectral

    params = SimpleNamespace(
        nbands=values.shape[2], nrows=values.shape[0], ncols=values.shape[1], offset=0, dtype=values.dtype.str,
        filename=filename, byte_order=int(sys.byteorder == "big"),
    )  # fmt: skip
    source = SimpleNamespace(params=lambda: params, metadata={}, bands=bands, filename=filename)
    return spectral.image.ImageArray(values, source)
