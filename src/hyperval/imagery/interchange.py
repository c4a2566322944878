"""Images for other programs: ENVI files by blocks of lines, whole or not at all; objects of SPy and xarray."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS

from hyperval.envi_header import BYTE_ORDERS, DATA_TYPES, INTERLEAVES, EnviHeader, parse_header
from hyperval.errors import UsageError
from hyperval.imagery.arrays import MemoryStore, Piece, Term, array_raster, labelled_array
from hyperval.imagery.description import Description, ListedBands, Raster
from hyperval.imagery.envi import EnviRaster
from hyperval.imagery.rasters import open_raster
from hyperval.spectra.axis import SpectralAxis
from hyperval.storage import whole_file, write_text

if TYPE_CHECKING:
    import spectral
    import xarray as xr
    from spectral.io.spyfile import SpyFile

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
        bands = ListedBands(
            np.asarray(image.bands.centers, float),
            None if widths is None else np.asarray(widths, float),
            None if unit in (None, "<unspecified>") else str(unit),
        )
        dtype = np.dtype(np.float32 if isinstance(image, SpyFile) else image.dtype)
        piece = Piece((Term("image"),), "lsb", tuple(image.shape), dtype)
        path = Path(str(image.filename or "SPy image"))
        values = np.asarray(image) if isinstance(image, np.ndarray) else image
        return array_raster(path, MemoryStore(values, path), (piece,), Description("image of SPy", bands))
    raise UsageError(
        f"an object of type {type(image).__name__} is no cube",
        expected="a path, an array of xarray, or an image of SPy (spectral)",
    )


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


@dataclass(eq=False)
class EnviWriter:
    """Takes blocks of lines in order; made by :func:`envi_writer`."""

    stream: Any
    header: EnviHeader
    gain: npt.NDArray[np.float64]
    ignore: float | None
    lines_written: int = 0

    def write(self, block: npt.NDArray[Any]) -> None:
        """Append (lines, samples, bands) physical values.

        Raises
        ------
        UsageError : wrong shape, more lines than announced, values that do not fit the stored type.
        """
        block, header = np.asarray(block), self.header
        if block.ndim != 3 or block.shape[1:] != (header.samples, header.bands):
            raise UsageError(f"a block of {block.shape} for {header.samples} samples and {header.bands} bands")
        if self.lines_written + block.shape[0] > header.lines:
            raise UsageError(f"more than {header.lines} lines were written")
        stored, line_bytes = self._stored(block), header.samples * header.dtype.itemsize
        if header.interleave == "bsq":
            parts = [(band * header.lines + self.lines_written, stored[:, :, band]) for band in range(header.bands)]
        else:
            axes = (0, 2, 1) if header.interleave == "bil" else (0, 1, 2)
            parts = [(self.lines_written * header.bands, stored.transpose(axes))]
        for row, values in parts:
            self.stream.seek(header.header_offset + row * line_bytes)
            self.stream.write(np.ascontiguousarray(values).tobytes())
        self.lines_written += block.shape[0]

    def _stored(self, block: npt.NDArray[Any]) -> npt.NDArray[Any]:
        dtype = self.header.dtype
        values = block if np.all(self.gain == 1.0) else block / self.gain
        if dtype.kind == "f":
            return values.astype(dtype)
        if values.dtype.kind == "f":
            finite = np.isfinite(values)
            if not finite.all():
                if self.ignore is None:
                    raise UsageError("values that are not finite need an ignore value to be stored as integers")
                values = np.where(finite, values, self.ignore)
            values = np.rint(values)
        limits = np.iinfo(dtype)
        if values.size and (values.min() < limits.min or values.max() > limits.max):
            raise UsageError(
                f"values from {values.min():g} to {values.max():g} do not fit {dtype.name}",
                mend="choose a larger data type or another scale",
            )
        return values.astype(dtype)


@contextmanager
def envi_writer(
    path: Path,
    *,
    lines: int,
    samples: int,
    bands: int,
    data_type: int = 4,
    interleave: str = "bil",
    byte_order: int = 0,
    header_offset: int = 0,
    axis: SpectralAxis | None = None,
    description: str = "",
    file_type: str = "ENVI Standard",
    gain: npt.ArrayLike | None = None,
    reflectance_scale_factor: float | None = None,
    ignore_value: float | None = None,
    transform: Affine | None = None,
    crs: CRS | None = None,
    band_names: Sequence[str] | None = None,
    extra: Mapping[str, str] | None = None,
) -> Iterator[EnviWriter]:
    """Write an ENVI cube block by block; data file and header appear when the block ends well.

    Parameters
    ----------
    path : the data file; the header stands beside it with the suffix ``.hdr``
    data_type : ENVI code (1, 2, 3, 4, 5, 12, 13, 14, 15)
    axis : wavelengths [nm], widths and bad-band list for the header
    gain : scalar or (B,): values are stored divided by it, and it is written as ``data gain values``
    reflectance_scale_factor : values are stored multiplied by it, and it is written under this name
    ignore_value : stored value for no data
    transform : north-up affine transform, written as ``map info``
    extra : further header entries as text, in order

    Raises
    ------
    UsageError : an unknown type, interleave or byte order, both kinds of scale, too few lines.
    """
    path = Path(path)
    if path.suffix.lower() == ".hdr":
        raise UsageError("name the data file, not the header", where=str(path))
    if interleave not in INTERLEAVES or byte_order not in BYTE_ORDERS or data_type not in DATA_TYPES:
        raise UsageError(
            f"cannot write interleave {interleave!r}, byte order {byte_order}, data type {data_type}",
            expected=f"{INTERLEAVES}, {tuple(BYTE_ORDERS)}, {tuple(DATA_TYPES)}",
        )
    if gain is not None and reflectance_scale_factor is not None:
        raise UsageError("a cube has either a gain or a reflectance scale factor")
    if axis is not None and len(axis) != bands:
        raise UsageError(f"an axis of {len(axis)} bands for a cube of {bands}")
    entries: dict[str, Any] = {
        "description": "{" + description + "}", "samples": samples, "lines": lines, "bands": bands,
        "header offset": header_offset, "file type": file_type, "data type": data_type, "interleave": interleave,
        "byte order": byte_order,
    }  # fmt: skip
    factor = np.ones(bands)
    if gain is not None:
        factor = np.broadcast_to(np.asarray(gain, dtype=float), (bands,)).copy()
        entries["data gain values"] = _listed(factor, "{!r}")
        entries["data offset values"] = _listed(np.zeros(bands), "{:g}")
    if reflectance_scale_factor is not None:
        factor = np.full(bands, 1.0 / reflectance_scale_factor)
        entries["reflectance scale factor"] = repr(float(reflectance_scale_factor))
    entries |= _georeference(transform, crs)
    if axis is not None:
        entries["wavelength units"] = "Nanometers"
        entries["wavelength"] = _listed(axis.centre_nm, "{!r}")
        entries["fwhm"] = _listed(axis.fwhm_nm, "{!r}")
        entries["bbl"] = _listed(axis.good.astype(int), "{:d}")
    if band_names is not None:
        entries["band names"] = "{" + ", ".join(band_names) + "}"
    entries |= dict(extra or {})
    if ignore_value is not None:
        entries["data ignore value"] = f"{ignore_value:.17g}"
    text = "ENVI\n" + "".join(f"{key} = {value}\n" for key, value in entries.items())
    header = parse_header(text, path.with_suffix(".hdr"))  # what is written can be read
    with whole_file(path) as temporary:
        with open(temporary, "wb") as stream:
            stream.truncate(header.expected_bytes)
            writer = EnviWriter(stream, header, factor, ignore_value)
            yield writer
            if writer.lines_written != lines:
                raise UsageError(f"{writer.lines_written} of {lines} lines were written", where=str(path))
        # Without its header a cube cannot be read: an old header never describes new data.
        header.path.unlink(missing_ok=True)
    write_text(header.path, text)


def write_cube(path: Path, values: npt.NDArray[Any], **options: Any) -> Path:
    """Write a whole array (lines, samples, bands) with the options of :func:`envi_writer`; returns ``path``."""
    lines, samples, bands = values.shape
    with envi_writer(path, lines=lines, samples=samples, bands=bands, **options) as writer:
        writer.write(values)
    return Path(path)


def _listed(values: npt.NDArray[Any], form: str) -> str:
    parts = [form.format(v) for v in values.tolist()]
    rows = [", ".join(parts[i : i + 8]) for i in range(0, len(parts), 8)]
    return "{\n " + ",\n ".join(rows) + "}"


def _georeference(transform: Affine | None, crs: CRS | None) -> dict[str, str]:
    if transform is None:
        return {}
    if transform.b or transform.d or transform.a <= 0 or transform.e >= 0:
        raise UsageError("only a north-up transform can be written as 'map info'")
    place = f"1, 1, {transform.c!r}, {transform.f!r}, {transform.a!r}, {-transform.e!r}"
    epsg = crs.to_epsg() if crs is not None else None
    if epsg is not None and (32601 <= epsg <= 32660 or 32701 <= epsg <= 32760):
        side = "North" if epsg < 32700 else "South"
        info = f"UTM, {place}, {epsg % 100}, {side}, WGS-84, units=Meters"
    else:
        info = f"Arbitrary, {place}" + (", units=Meters" if crs is None or crs.is_projected else ", units=Degrees")
    out = {"map info": "{" + info + "}"}
    if crs is not None:
        out["coordinate system string"] = "{" + crs.to_wkt(version="WKT1_ESRI") + "}"
    return out
