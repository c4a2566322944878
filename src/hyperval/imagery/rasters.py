"""Stored numbers of a raster, by lines or by pixels, whatever the file format."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hyperval.envi_header import read_header
from hyperval.errors import InputError, UsageError, reader
from hyperval.imagery.array_raster import ArrayRaster
from hyperval.imagery.description import Scaling, divided, gain_file_beside, header_scaling, scaled
from hyperval.imagery.envi_raster import EnviRaster, check_size, header_beside
from hyperval.imagery.sidecars import image_of
from hyperval.imagery.stores import check_own_values
from hyperval.imagery.tiff_raster import TIFF_SUFFIXES, TiffRaster, open_tiff
from hyperval.imagery.trees import open_tree
from hyperval.paths import checked_file, checked_folder

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
                mend="save its array as an ENVI cube, wavelengths in the header (docs/formats.md, Other formats)",
            )
        raise InputError(
            "no header beside the data file",
            where=str(data),
            expected=f"{data.name}.hdr or {data.with_suffix('.hdr').name}",
        )
    parsed = read_header(checked_file(beside, root=root, what="ENVI header"))
    check_size(data, parsed)
    whole = (
        parsed.dtype.kind in "iu" and not {"data gain values", "reflectance scale factor"} & parsed.entries.keys()
    )
    divisors = gain_file_beside(data) if whole else None
    if divisors is not None:
        divisors = checked_file(divisors, root=root, what="gain file")
    return EnviRaster(data, parsed, divisors)


def _labelled(path: Path, variable: str | None, engine: str | None) -> ArrayRaster:
    from hyperval.imagery.labelled import open_labelled  # xarray takes 70 MB, which most runs need not

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
        raise InputError(
            f"data files beside the header: {names}", where=str(header), mend="name the data file instead"
        )
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
