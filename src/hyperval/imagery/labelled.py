"""Any file that an installed engine of xarray opens: an array with a wavelength coordinate is a cube."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from affine import Affine
from rasterio.crs import CRS

from hyperval.errors import InputError, UsageError, reader
from hyperval.hdf5 import check_hdf5
from hyperval.imagery.array_raster import ArrayRaster, Piece, Term
from hyperval.imagery.description import Description
from hyperval.imagery.georeference import crs_of_wkt, gdal_transform
from hyperval.imagery.layouts import stated_number
from hyperval.imagery.stores import MemoryStore, OpenedFile, Selection, Store
from hyperval.units import radiance_to_internal, wavelength_to_nm

Array = npt.NDArray[np.float64]
_WAVE = re.compile(r"wave|wvl|lambda|band_?cent", re.IGNORECASE)
_WIDTH = re.compile(r"fwhm|band_?width", re.IGNORECASE)
_GOOD = re.compile(r"good|bbl", re.IGNORECASE)
_SAMPLE = re.compile(r"^(x|lon|longitude|easting|samples?|cross.?track|col(umn)?s?|ortho_x)$", re.IGNORECASE)
_LINE = re.compile(r"^(y|lat|latitude|northing|lines?|down.?track|along.?track|rows?|ortho_y)$", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Candidate:
    """An array of three axes, and the coordinate that may tell its wavelengths."""

    group: str
    name: str
    array: xr.DataArray
    data: xr.Dataset
    wave: xr.DataArray | None

    @property
    def label(self) -> str:
        """Its path, axes and type, for messages."""
        axes = ", ".join(f"{axis} {size}" for axis, size in self.array.sizes.items())
        return f"{self.group.strip('/')}/{self.name}".strip("/") + f" ({axes}; {self.array.dtype})"


@reader
def open_labelled(path: Path, variable: str | None = None, engine: str | None = None) -> ArrayRaster:
    """The image of a file that xarray opens: the only array with a wavelength coordinate, or ``variable``.

    ``engine`` is one of xarray's; None takes the one that says it can open the file.

    Raises
    ------
    InputError : no installed engine opens it, or no array has three axes and wavelengths.
    UsageError : several arrays could be meant, or ``variable`` is none of them.
    """
    groups = _groups(path, engine)
    chosen = _chosen(list(_candidates(groups)), variable, str(path))
    group = None if chosen.group == "/" else chosen.group
    return _raster(chosen, XarrayStore(path, engine, group), path)


def _groups(path: Path, engine: str | None) -> list[tuple[str, xr.Dataset]]:
    """The groups of a file, their arrays not yet read."""
    if path.is_file():  # whatever the engine, HDF5 is read by the one library
        check_hdf5(path)
    try:
        try:
            tree = xr.open_datatree(path, engine=engine, cache=False, **as_stored(engine))
        except (NotImplementedError, TypeError, ValueError):  # an engine without groups
            with xr.open_dataset(path, engine=engine, cache=False, **as_stored(engine)) as data:
                return [("/", data)]
        with tree:
            return [(node.path, node.to_dataset()) for node in tree.subtree]
    except Exception as error:  # each engine has errors of its own
        raise InputError(
            "no installed engine of xarray opens it: " + str(error).split("\n", 1)[0],
            where=str(path),
            expected="a file of " + ", ".join(sorted(xr.backends.list_engines())),
            mend="install the engine of its kind, or save the array as an ENVI cube with its wavelengths",
        ) from error


def labelled_array(array: xr.DataArray | xr.Dataset, variable: str | None = None) -> ArrayRaster:
    """The image of an array of xarray that is at hand, read by parts when it is lazy.

    Raises
    ------
    InputError, UsageError : as for :func:`open_labelled`.
    """
    path = Path(str(array.encoding.get("source") or "xarray"))
    if isinstance(array, xr.DataArray):
        array = array.to_dataset(name=array.name or "array")
    chosen = _chosen(list(_candidates([("/", array)])), variable, str(path))
    return _raster(chosen, MemoryStore(chosen.array.variable, path), path)


def _candidates(groups: list[tuple[str, xr.Dataset]]) -> Iterator[Candidate]:
    for group, data in groups:
        for name, array in data.data_vars.items():
            if array.ndim == 3 and array.dtype.kind in "iuf" and 0 not in array.shape:
                yield Candidate(group, str(name), array, data, _wavelengths(array, data))


def _wavelengths(array: xr.DataArray, data: xr.Dataset) -> xr.DataArray | None:
    """The coordinate of one axis that holds wavelengths, by its name, its standard name or its unit."""
    listed = [v for v in data.variables if data[v].ndim == 1 and data[v].dims[0] in array.dims]
    for test in (_is_wavelength, _has_wavelength_unit):
        fits = [v for v in listed if data[v].dtype.kind in "iuf" and test(str(v), data[v])]
        if len(fits) == 1:
            return data[fits[0]]
    return None


def _is_wavelength(name: str, array: xr.DataArray) -> bool:
    standard = array.attrs.get("standard_name", "")
    return standard == "radiation_wavelength" or (_WAVE.search(name) is not None and not _WIDTH.search(name))


def _has_wavelength_unit(name: str, array: xr.DataArray) -> bool:
    try:
        wavelength_to_nm(str(array.attrs.get("units", "")))
    except UsageError:
        return False
    return not _WIDTH.search(name)


def _chosen(candidates: list[Candidate], variable: str | None, where: str) -> Candidate:
    if variable is not None:
        wanted = variable.strip("/")
        named = [c for c in candidates if wanted in (c.name, f"{c.group.strip('/')}/{c.name}".strip("/"))]
        if len(named) != 1:
            listed = "; ".join(c.label for c in candidates) or "none"
            raise UsageError(f"{len(named)} arrays {variable!r}", where=where, expected=f"one of {listed}")
        if named[0].wave is None:
            raise InputError(
                f"{named[0].label} has no wavelength coordinate",
                where=where,
                mend="give a table of the bands, and save the array as an ENVI cube (docs/formats.md)",
            )
        return named[0]
    cubes = [c for c in candidates if c.wave is not None]
    if len(cubes) == 1:
        return cubes[0]
    if not cubes:
        listed = "; ".join(c.label for c in candidates) or "none of three axes"
        raise InputError(
            "no array of the file has a wavelength coordinate",
            where=where,
            expected=f"one of its arrays with wavelengths along an axis; it has {listed}",
            mend="save the array as an ENVI cube, wavelengths in the header (docs/formats.md, Other formats)",
        )
    raise UsageError(
        f"{len(cubes)} arrays could be meant",
        where=where,
        expected="; ".join(c.label for c in cubes),
        mend="state variable: which of them is the image",
    )


def _raster(chosen: Candidate, store: Store, path: Path) -> ArrayRaster:
    array, data, wave = chosen.array, chosen.data, chosen.wave
    assert wave is not None  # noqa: S101 - chosen by it
    axes = _axes(array, str(wave.dims[0]))
    along = {str(d): letter for d, letter in zip(array.dims, axes, strict=True)}
    piece = Piece((Term(chosen.name),), axes, array.shape, array.dtype.newbyteorder("="))
    attrs = array.attrs
    unit = str(attrs.get("units", attrs.get("unit", ""))) or None
    quantity, notes = _quantity(unit, chosen.name)
    description = Description(
        product=f"array {chosen.name!r}",
        wavelength=np.asarray(wave.values, float),
        fwhm=_beside(data, wave, _WIDTH),
        wavelength_unit=str(wave.attrs.get("units", wave.attrs.get("unit", ""))) or None,
        good=None if (flags := _beside(data, wave, _GOOD)) is None else flags != 0,
        gain=float(attrs.get("scale_factor", 1.0)),
        offset=float(attrs.get("add_offset", 0.0)),
        quantity=quantity,
        unit=unit if quantity == "radiance" else "1" if quantity == "reflectance" else None,
        ignore_value=stated_number(attrs, ("_FillValue", "missing_value")),
        sensor=str(data.attrs.get("instrument", data.attrs.get("sensor", ""))),
        entries={str(k): str(v) for k, v in data.attrs.items() if isinstance(v, str | int | float)},
        notes=notes,
    )
    transform, crs = _position(data, array, along)
    return ArrayRaster(path, store, (piece,), transform, crs, description)


def _axes(array: xr.DataArray, band_axis: str) -> str:
    """Which axis is lines, samples, bands: by name, else lines before samples."""
    others = [str(d) for d in array.dims if d != band_axis]
    swapped = bool(_SAMPLE.match(others[0]) or _LINE.match(others[1]))
    letters = {band_axis: "b", others[0]: "s" if swapped else "l", others[1]: "l" if swapped else "s"}
    return "".join(letters[str(d)] for d in array.dims)


def _quantity(unit: str | None, name: str) -> tuple[str | None, tuple[str, ...]]:
    """Radiance where the unit is one, reflectance where the name says so; None leaves it to the campaign."""
    try:
        radiance_to_internal(unit or "")
        return "radiance", ()
    except UsageError:
        pass
    if re.search("reflectance|rfl|rrs", name, re.IGNORECASE) and (unit or "1").lower() in ("1", "unitless", "none"):
        return "reflectance", ()
    return None, (f"the array states its unit as {unit!r}, which is not known",) if unit else ()


def _beside(data: xr.Dataset, wave: xr.DataArray, name: re.Pattern[str]) -> Array | None:
    """Another array along the axis of the wavelengths, by its name."""
    fits = [v for v in data.variables if data[v].dims == wave.dims and name.search(str(v))]
    fits = [v for v in fits if data[v].dtype.kind in "iufb"]
    return np.asarray(data[fits[0]].values, float) if len(fits) == 1 else None


def _position(data: xr.Dataset, array: xr.DataArray, along: dict[str, str]) -> tuple[Affine | None, CRS | None]:
    """From the grid mapping (CF, GDAL), else from evenly spaced coordinates of lines and samples."""
    mapping = str(array.attrs.get("grid_mapping", array.encoding.get("grid_mapping", "spatial_ref")))
    attrs = data[mapping].attrs if mapping in data.variables else {}
    wkt = attrs.get("crs_wkt", attrs.get("spatial_ref"))
    crs = crs_of_wkt(wkt) if isinstance(wkt, str) else None
    transform = gdal_transform(str(attrs.get("GeoTransform", "")))
    if transform is not None:
        return transform, crs
    steps = {}
    for dim, letter in along.items():
        if letter == "b" or dim not in data.variables or data[dim].ndim != 1 or data[dim].size < 2:
            continue
        at = np.asarray(data[dim].values, float)
        step = np.diff(at)
        if np.all(np.isfinite(at)) and step[0] != 0 and np.allclose(step, step[0], rtol=1e-3):
            steps[letter] = (at[0], (at[-1] - at[0]) / (at.size - 1))
    if set(steps) != {"l", "s"} or crs is None:
        return None, crs
    (y, dy), (x, dx) = steps["l"], steps["s"]
    return Affine(dx, 0.0, x - 0.5 * dx, 0.0, dy, y - 0.5 * dy), crs


class XarrayStore(OpenedFile):
    """A group of a file as an engine of xarray opens it, values as they are stored."""

    def __init__(self, path: Path, engine: str | None = None, group: str | None = None) -> None:
        super().__init__(path)
        self.engine, self.group = engine, group

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process opens it for itself."""
        return type(self), (self.path, self.engine, self.group)

    def open(self) -> xr.Dataset:
        """The group; InputError when no installed engine opens it."""
        try:
            return xr.open_dataset(
                self.path, engine=self.engine, group=self.group, cache=False, **as_stored(self.engine)
            )
        except Exception as error:  # each engine has errors of its own
            raise InputError(f"no engine of xarray opens it: {error}", where=str(self.path)) from error

    def read(self, name: str, selection: Selection) -> npt.NDArray[Any]:
        """A part of an array."""
        with self.kept_open() as data:
            return np.asarray(data[name][selection].values)

    def chunks(self, name: str) -> tuple[int, ...] | None:
        """Size of the blocks that an array is stored in."""
        with self.kept_open() as data:
            size: tuple[int, ...] | None = data[name].encoding.get("chunksizes")
            return size


def as_stored(engine: str | None) -> dict[str, Any]:
    """Options of xarray that hand out stored values, and let HDF5 files be read that name no dimensions."""
    plain = {"mask_and_scale": False, "decode_times": False}
    return plain | {"phony_dims": "sort"} if engine == "h5netcdf" else plain
