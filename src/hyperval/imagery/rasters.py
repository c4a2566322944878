"""Stored numbers of a raster, by lines or by pixels, whatever the file format.

Cubes and maps as objects of ``spectral`` (SPy) and xarray, and theirs as ours.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS

from hyperval.envi_header import header_beside, read_header
from hyperval.errors import InputError, UsageError, reader
from hyperval.imagery.arrays import ArrayRaster, MemoryStore, Piece, Term, check_own_values
from hyperval.imagery.description import Description, Scaling, divided, gain_file_beside, header_scaling, scaled
from hyperval.imagery.envi import EnviRaster, check_size
from hyperval.imagery.products import labelled_array, open_tree
from hyperval.imagery.tiff import TIFF_SUFFIXES, TiffRaster, image_of, open_tiff
from hyperval.paths import checked_file, checked_folder
from hyperval.spectra.axis import SpectralAxis

if TYPE_CHECKING:
    import spectral
    import xarray as xr
    from spectral.io.spyfile import SpyFile

_HDF5 = "HDF5 or NetCDF-4"
_ARRAYS = (_HDF5, "NetCDF-3")
_CONTAINERS = {
    b"MATLAB 7.3": "MATLAB 7.3 (HDF5)",
    b"MATLAB": "MATLAB",
    b"\x89HDF\r\n\x1a\n": _HDF5,
    b"CDF\x01": "NetCDF-3",
    b"CDF\x02": "NetCDF-3",
    b"\x0e\x03\x13\x01": "HDF4",
    b"\x93NUMPY": "NumPy",
}
_DATA_SUFFIXES = ("", ".img", ".dat", ".raw", ".bil", ".bsq", ".bip", ".rad", ".cub", ".sli", ".lib")

Raster = EnviRaster | TiffRaster | ArrayRaster


@reader
def open_raster(
    path: Path | str,
    *,
    header: Path | str | None = None,
    root: Path | None = None,
    variable: str | None = None,
    engine: str | None = None,
) -> Raster:
    """Open an ENVI file (data file or header may be named), a GeoTIFF, or the image of a file of arrays.

    A GeoTIFF may have an ENVI header, METADATA.XML or an item of STAC beside it; the METADATA.XML may be named in
    its place.  HDF5 and NetCDF-4 are read by the layout of their product, else, as whatever an engine of xarray
    opens, by the one array that has wavelengths, or by ``variable``; ``engine`` is one of xarray's.

    Raises
    ------
    InputError : a file is missing, truncated, too long, or contradicts its header.
    UsageError : a path that may not be opened, or two headers to choose from.
    """
    if Path(path).suffix.lower() in TIFF_SUFFIXES and engine is None:
        return open_tiff(checked_file(path, root=root, what="GeoTIFF"), header, root)
    data = Path(path)
    if data.suffix.lower() == ".zarr":
        return _labelled(checked_folder(data, root=root, what="Zarr store"), variable, engine)
    if engine is not None:
        return _labelled(checked_file(data, root=root, what="file of arrays"), variable, engine)
    if data.suffix.lower() == ".xml" and header is None:
        image = image_of(checked_file(data, root=root, what="metadata file"), variable)
        return open_tiff(checked_file(image, root=root, what="GeoTIFF"), None, root)
    if header is None and data.suffix.lower() == ".hdr":
        header = checked_file(data, root=root, what="ENVI header")
        data = _data_beside(data)
    data = checked_file(data, root=root, what="ENVI data file")
    if data.suffix.lower() == ".hdr":
        raise UsageError("the cube is a header file", where=str(data), mend="name the data file")
    beside = Path(header) if header is not None else header_beside(data)
    if beside is None:
        container = container_of(data)
        if container in _ARRAYS:
            if container != _HDF5:
                return _labelled(data, variable, "scipy")
            check_own_values(data)
            tree = open_tree(data) if variable is None else None
            return tree if tree is not None else _labelled(data, variable, "h5netcdf")
        if container is not None:
            raise InputError(
                f"a {container} file, which is not read as a cube",
                where=str(data),
                expected="an ENVI cube with its header, or a GeoTIFF",
                mend="save its array as an ENVI cube, wavelengths in the header (docs/formats.md, Cubes)",
            )
        raise InputError(
            "no header beside the data file",
            where=str(data),
            expected=f"{data.name}.hdr or {data.with_suffix('.hdr').name}",
        )
    parsed = read_header(checked_file(beside, root=root, what="ENVI header"))
    check_size(data, parsed)
    whole = parsed.dtype.kind in "iu" and not {"data gain values", "reflectance scale factor"} & parsed.entries.keys()
    divisors = gain_file_beside(data) if whole else None
    if divisors is not None:
        divisors = checked_file(divisors, root=root, what="gain file")
    return EnviRaster(data, parsed, divisors)


def _labelled(path: Path, variable: str | None, engine: str | None) -> ArrayRaster:
    from hyperval.imagery.products import open_labelled  # xarray takes 70 MB, which most runs need not

    return open_labelled(path, variable, engine)


def needs_header(path: Path) -> bool:
    """Whether a file is a cube only with an ENVI header beside it: no GeoTIFF, and no file of arrays."""
    if path.suffix.lower() in (*TIFF_SUFFIXES, ".xml", ".zarr"):
        return False
    return container_of(path) not in _ARRAYS


def container_of(path: Path) -> str | None:
    """What other kind of file of arrays this is, by its first bytes; None when it is none that is known."""
    with open(path, "rb") as stream:
        head = stream.read(16)
    return next((name for mark, name in _CONTAINERS.items() if head.startswith(mark)), None)


def _data_beside(header: Path) -> Path:
    stem = header.with_suffix("")
    candidates = [stem.with_name(stem.name + end) for end in _DATA_SUFFIXES]
    candidates = [p for p in candidates if p.is_file()]
    if len(candidates) != 1:
        names = ", ".join(p.name for p in candidates) or "none"
        raise InputError(f"data files beside the header: {names}", where=str(header), mend="name the data file instead")
    return candidates[0]


def raster_of_size(path: Path, shape: tuple[int, int], root: Path | None = None) -> Raster:
    """Open a raster of a cube's size (lines, samples); InputError for one of another."""
    raster = open_raster(path, root=root)
    if (raster.lines, raster.samples) != shape:
        raise InputError(
            f"the raster has {raster.lines} lines and {raster.samples} samples",
            where=str(path),
            expected=f"{shape[0]} lines and {shape[1]} samples, as the cube",
        )
    return raster


def stated_ignore_value(raster: Raster) -> float | None:
    """The stored value that means no data, by the header, the product's own description or a GeoTIFF."""
    stated = raster.header.number("data ignore value") if raster.header is not None else None
    if stated is None and raster.description is not None:
        stated = raster.description.ignore_value
    return raster.nodata if stated is None and isinstance(raster, TiffRaster) else stated


def file_scaling(raster: Raster, *, quantity: str, unit: str | None, scale: float | None) -> Scaling:
    """Gain and offset of every band of a file that is no product with a description of its own.

    ``scale`` replaces whatever the header, the tags of a GeoTIFF or a file of divisors beside the cube says.

    Raises
    ------
    InputError : the header gives a scale factor that is zero or two that exclude each other, or so does the file.
    UsageError : an unknown unit or quantity, a radiance without unit, or a scale that is no number.
    """
    one, zero, header = np.ones(raster.bands), np.zeros(raster.bands), raster.header
    if isinstance(raster, TiffRaster):
        own, of_file = (np.array(raster.gains), np.array(raster.offsets)), "scale and offset tags of the GeoTIFF"
    else:
        path = raster.divisors_path if isinstance(raster, EnviRaster) else None
        gains, unit = divided(path, raster.bands, quantity, unit, scale)
        own = one if gains is None else gains, zero
        of_file = "" if path is None else f"stored values / those of {path.name}"
    gain, offset, note = header_scaling(header, raster.bands, quantity) if scale is None else (one, zero, "")
    if scale is None and (np.any(own[0] != 1.0) or np.any(own[1] != 0.0)):
        if note:
            raise InputError(
                f"its header scales the values, and so do the {of_file}",
                where=str(header.path) if header else None,
                mend="state scale: in the campaign",
            )
        (gain, offset), note = own, of_file
    return scaled(gain, offset, note, quantity=quantity, unit=unit, scale=scale)


_SPY_METADATA = ("map info", "coordinate system string", "data ignore value", "default bands")


def cube_to_spy(cube: Any) -> SpyFile | spectral.image.ImageArray:
    """A ``Cube`` as an image of SPy: memory-mapped where it is an ENVI file of one scale, else loaded as float32.

    SPy divides stored values by ``scale_factor``, which is 1/gain here; of ignore values it knows nothing, so that
    they come as numbers (``metadata["data ignore value"]``) from a mapped file and as NaN from a loaded one.
    """
    from spectral.io import bilfile, bipfile, bsqfile

    gain, raster = cube.gain, cube.raster
    bands = _band_info(cube.axis)
    whole = np.array_equal(cube.stored_band, np.arange(raster.bands))
    if isinstance(raster, EnviRaster) and whole and np.all(gain == gain[0]) and not np.any(cube.offset):
        header = raster.header
        metadata = {key: header.entries[key] for key in _SPY_METADATA if key in header.entries}
        shape = raster.lines, raster.samples, raster.bands
        params = _params(shape, str(raster.path), header.dtype, header.header_offset, header.byte_order)
        files = {"bil": bilfile.BilFile, "bip": bipfile.BipFile, "bsq": bsqfile.BsqFile}
        image = files[header.interleave](params, metadata)
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
            wanted = np.atleast_1d(lines)
            if not wanted.size:
                values = np.empty((0, *self.shape[1:]))[:, key[1], key[2]]
            elif np.ptp(wanted) + 1 <= 4 * wanted.size:
                first = int(wanted.min())
                values = self.cube.read(first, int(np.ptp(wanted)) + 1).values[wanted - first][:, key[1], key[2]]
            else:
                values = np.concatenate([self.cube.read(int(n), 1).values[:, key[1], key[2]] for n in wanted])
            return values if np.ndim(lines) else values[0]

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


def raster_of(image: Any, variable: str | None = None) -> Raster:
    """The raster of an object of SPy or xarray, read by parts where it is lazy.

    Raises
    ------
    UsageError : another kind of object, or an image without wavelengths.
    """
    xarray = sys.modules.get("xarray")  # where it was never loaded, nothing is an array of it
    if xarray is not None and isinstance(image, xarray.DataArray | xarray.Dataset):
        return labelled_array(image, variable)
    import spectral
    from spectral.io.spyfile import SpyFile

    if isinstance(image, SpyFile) and Path(f"{image.filename}").is_file():
        headers = [Path(image.filename).with_suffix(".hdr"), Path(f"{image.filename}.hdr")]
        if any(h.is_file() for h in headers):
            return open_raster(image.filename)
    if isinstance(image, SpyFile | spectral.image.ImageArray):
        if image.bands.centers is None:
            raise UsageError("the image of SPy has no wavelengths", mend="set its bands.centers and bands.band_unit")
        widths = image.bands.bandwidths
        unit = image.bands.band_unit
        about = Description(
            product="image of SPy",
            wavelength=np.asarray(image.bands.centers, float),
            fwhm=None if widths is None else np.asarray(widths, float),
            wavelength_unit=None if unit in (None, "<unspecified>") else str(unit),
        )
        dtype = np.dtype(np.float32 if isinstance(image, SpyFile) else image.dtype)
        piece = Piece((Term("image"),), "lsb", tuple(image.shape), dtype)
        path = Path(str(image.filename or "SPy image"))
        return ArrayRaster(path, MemoryStore(_plain(image), path), (piece,), description=about)
    raise UsageError(
        f"an object of type {type(image).__name__} is no cube",
        expected="a path, an array of xarray, or an image of SPy (spectral)",
    )


def _plain(image: Any) -> Any:
    return np.asarray(image) if isinstance(image, np.ndarray) else image


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


def _params(
    shape: tuple[int, int, int], filename: str, dtype: np.dtype, offset: int = 0, byte_order: int | None = None
) -> SimpleNamespace:
    """What SPy knows of an image (lines, samples, bands); its byte order is the machine's where none is given."""
    lines, samples, bands = shape
    return SimpleNamespace(
        nbands=bands, nrows=lines, ncols=samples, offset=offset, dtype=dtype.str, filename=filename,
        byte_order=int(sys.byteorder == "big") if byte_order is None else byte_order,
    )  # fmt: skip


def _image_array(values: npt.NDArray[Any], bands: spectral.BandInfo, filename: str) -> spectral.image.ImageArray:
    import spectral

    params = _params(values.shape, filename, values.dtype)
    source = SimpleNamespace(params=lambda: params, metadata={}, bands=bands, filename=filename)
    return spectral.image.ImageArray(values, source)
