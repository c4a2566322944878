"""Opening an image of whatever format: what a file is, its content says first, its neighbours last."""

from __future__ import annotations

from pathlib import Path

from hyperval.envi_header import header_beside
from hyperval.errors import reader, refusal
from hyperval.imagery.arrays import MATRICES, check_own_values, open_labelled, open_matrix
from hyperval.imagery.description import Raster
from hyperval.imagery.envi import open_envi
from hyperval.imagery.products import open_product
from hyperval.imagery.sidecars import image_of
from hyperval.imagery.tiff import TIFF_MARKS, TIFF_SUFFIXES, open_tiff
from hyperval.paths import checked_file, checked_folder

_TIFF, _HDF5, _NETCDF3 = "GeoTIFF", "HDF5 or NetCDF-4", "NetCDF-3"
_MARKS = (
    dict.fromkeys(TIFF_MARKS, _TIFF)
    | MATRICES
    | {
        b"\x89HDF\r\n\x1a\n": _HDF5,
        b"CDF\x01": _NETCDF3,
        b"CDF\x02": _NETCDF3,
        b"\x0e\x03\x13\x01": "HDF4",
    }
)
_DATA_SUFFIXES = ("", ".img", ".dat", ".raw", ".bil", ".bsq", ".bip", ".rad", ".cub", ".sli", ".lib")


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
    its place.  MATLAB and NumPy files hold an image (lines, samples, bands).  HDF5 and NetCDF-4 are read by the
    layout of their product, else, as whatever an engine of xarray opens, by the one array that has wavelengths, or
    by ``variable``; ``engine`` is one of xarray's.

    Raises
    ------
    InputError : a file is missing, truncated, too long, or contradicts its header.
    UsageError : a path that may not be opened, or two headers to choose from.
    """
    data = Path(path)
    if data.suffix.lower() == ".zarr":
        return open_labelled(checked_folder(data, root=root, what="Zarr store"), variable, engine)
    data = checked_file(path, root=root, what="image file")
    if engine is not None:
        return open_labelled(data, variable, engine)
    ending = data.suffix.lower()
    if header is None and ending == ".hdr":
        header, data = data, checked_file(_data_beside(data), root=root, what="image file")
    elif header is None and ending == ".xml":
        data = checked_file(image_of(data, variable), root=root, what="GeoTIFF")
    if data.suffix.lower() == ".hdr":
        raise refusal("image.is_header", data)
    kind = kind_of(data)
    if kind == _TIFF:
        return open_tiff(data, header, root)
    if header is None and kind == _NETCDF3:
        return open_labelled(data, variable, "scipy")
    if header is None and kind == _HDF5:
        check_own_values(data)
        product = open_product(data) if variable is None else None
        return product if product is not None else open_labelled(data, variable, "h5netcdf")
    beside = Path(header) if header is not None else header_beside(data)
    if beside is not None:
        return open_envi(data, beside, root)
    if kind in MATRICES.values():
        return open_matrix(data, str(kind), variable)
    if kind is not None:
        raise refusal("image.kind", data, kind=kind)
    raise refusal("image.no_header", data, first=f"{data.name}.hdr", second=data.with_suffix(".hdr").name)


def kind_of(path: Path) -> str | None:
    """What kind of image file this is by its first bytes, or its name as a GeoTIFF; None when it is none known."""
    with open(path, "rb") as stream:
        head = stream.read(16)
    kind = next((name for mark, name in _MARKS.items() if head.startswith(mark)), None)
    return _TIFF if path.suffix.lower() in TIFF_SUFFIXES else kind


def needs_header(path: Path) -> bool:
    """Whether a file is a cube only with an ENVI header beside it: no GeoTIFF, and no file of arrays."""
    own = (_TIFF, _HDF5, _NETCDF3, *MATRICES.values())
    return path.suffix.lower() not in (".xml", ".zarr") and kind_of(path) not in own


def _data_beside(header: Path) -> Path:
    stem = header.with_suffix("")
    found = [p for end in _DATA_SUFFIXES if (p := stem.with_name(stem.name + end)).is_file()]
    if len(found) != 1:
        raise refusal("image.data_files", header, names=", ".join(p.name for p in found) or "none")
    return found[0]


def raster_of_size(path: Path, shape: tuple[int, int], root: Path | None = None, variable: str | None = None) -> Raster:
    """Open a raster of a cube's size (lines, samples); InputError for one of another.

    ``variable`` : which map of a MATLAB or NumPy file, where it holds several
    """
    path = checked_file(path, root=root, what="image file")
    kind = kind_of(path)
    matrix = kind in MATRICES.values() and header_beside(path) is None
    raster = open_matrix(path, str(kind), variable, shape) if matrix else open_raster(path, root=root)
    if raster.size[:2] != shape:
        raise refusal("image.size", path, lines=raster.lines, samples=raster.samples, shape=shape)
    return raster
