"""A hyperspectral cube on disk, or in memory from SPy and xarray: physical values by blocks of lines or by pixels.

What a file is, its content says first, its neighbours last.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS

from hyperval.data import Array, Index, Mask, equals
from hyperval.envi_header import data_beside, header_beside
from hyperval.errors import HypervalError, InputError, needed, reader, refusal, refuse
from hyperval.imagery import arrays
from hyperval.imagery.description import Bands, Description, ListedBands, Raster, fill_notes, filled
from hyperval.imagery.envi import EnviRaster, described_by, open_envi, pixel_area_m2
from hyperval.imagery.products import image_of, open_product
from hyperval.imagery.tiff import TIFF_MARKS, TIFF_SUFFIXES, open_tiff
from hyperval.paths import checked_file, checked_folder, refuse_own
from hyperval.spectra.axis import SpectralAxis

if TYPE_CHECKING:
    import spectral
    import xarray as xr
    from spectral.io.spyfile import SpyFile

Quantity = Literal["radiance", "reflectance", "counts", "other"]
Where = Mask | tuple[npt.ArrayLike, npt.ArrayLike]

BLOCK_BYTES = 8 << 20
# Above these the 95th percentile of a cube says that its scale was not stated: a white surface under the zenith sun
# gives a radiance of about 65.
PLAUSIBLE = {"reflectance": 1.5, "radiance": 200.0}
_LOWEST = -0.1  # of these, that the median is not below: a dark image of noise and path radiance taken off too much
_DARK = 0.01  # reflectance that nothing reaches in an image that was scaled twice
_MIN_CHECKED = 256  # pixels, before a band is said to hold one number
_MAX_LISTED = 5


@dataclass(frozen=True, eq=False)
class Block:
    """Consecutive lines of a cube.

    Attributes
    ----------
    first_line : 0-based number of the first line
    values : (lines, samples, B) in the cube's unit; NaN where the stored value is the ignore value
    valid : (lines, samples) False where a good band holds the ignore value or is not finite, or
        where every band is stored as 0 or as one negative number (fill of all but an "other" cube)
    """

    first_line: int
    values: npt.NDArray[Any]
    valid: Mask


@dataclass(frozen=True, eq=False)
class Cube:
    """A cube that stays on disk; memory does not grow with its size.

    Attributes
    ----------
    raster : the stored numbers
    axis : bands in increasing wavelength; ``axis.good`` is the bad-band list
    quantity : "radiance" [uW cm-2 sr-1 nm-1], "reflectance" [1], "counts" or "other"
    unit : unit of the values handed out
    gain, offset : (B,) value = gain * stored + offset, in the bands of the axis
    stored_band : (B,) number of the stored band behind each band of ``axis``
    ignore_value : stored value that means no data, None when there is none
    description : the header's description
    notes : what was assumed or applied on reading
    """

    raster: Raster
    axis: SpectralAxis
    quantity: Quantity
    unit: str
    gain: Array
    offset: Array
    stored_band: Index
    ignore_value: float | None = None
    description: str = ""
    notes: tuple[str, ...] = ()

    @property
    def lines(self) -> int:
        """Number of lines."""
        return self.raster.lines

    @property
    def samples(self) -> int:
        """Number of samples in a line."""
        return self.raster.samples

    @property
    def bands(self) -> int:
        """Number of bands."""
        return len(self.axis)

    @property
    def shape(self) -> tuple[int, int]:
        """(lines, samples)."""
        return self.lines, self.samples

    @property
    def dtype(self) -> np.dtype:
        """Type of a stored number."""
        return self.raster.dtype

    @property
    def bytes_per_line(self) -> int:
        """Bytes of one line in the file."""
        return self.samples * self.raster.bands * self.dtype.itemsize

    @property
    def transform(self) -> Affine | None:
        """Affine transform from continuous (sample, line) to map coordinates, None without one."""
        return self.raster.transform

    @property
    def crs(self) -> CRS | None:
        """Coordinate reference system, None when unknown."""
        return self.raster.crs

    @property
    def pixel_area_m2(self) -> float | None:
        """Ground area of a pixel [m2], None when the map unit is unknown."""
        return pixel_area_m2(self.transform, self.crs, self.raster.description.entries)

    @cached_property
    def step(self) -> Array | None:
        """(B,) step of values that are whole numbers in the file, or of so many decimals; None of others.

        Programs keep counts as floats, at times times 0.001, and packed numbers are handed out unpacked.

        >>> import xarray as xr
        >>> nm = {"wavelength": ("b", [500.0, 600.0], {"units": "nm"})}
        >>> counts = np.arange(100, 118).reshape(3, 3, 2)
        >>> packed = xr.DataArray(counts, nm, ("y", "x", "b"), attrs={"scale_factor": 1e-3, "add_offset": 0.1})
        >>> plain = packed.drop_attrs(deep=False)
        >>> [open_cube(of, quantity="counts").step for of in (packed, plain.astype("f4"), plain / 7.0)]
        [array([0.001, 0.001]), array([1., 1.]), None]
        >>> [open_cube((plain * 1e-3).astype(kind), quantity="counts").step for kind in ("f4", "f8")]
        [array([0.001, 0.001]), array([0.001, 0.001])]
        """
        stored, (gain, offset) = self.raster.some_pixels()[:, self.stored_band], self.raster.description.packing
        seen = stored[self._usable(stored.T, self.axis.good)][:, self.axis.good] - float(offset)
        slack = 4.0 * np.finfo(np.result_type(self.dtype, np.float32)).eps * (np.abs(seen) + 2.0 * abs(offset))
        for step in (gain * 10.0 ** -np.arange(7.0 if seen.size else 0.0)).tolist():  # of up to six decimals
            # Of a step as small as the precision of a number every number is a multiple.
            if np.all(np.abs(step * np.rint(seen / step) - seen) <= np.minimum(slack, step / 32.0)):
                return np.asarray(np.abs(self.gain * step))
        return None

    def read(self, first_line: int, count: int, dtype: npt.DTypeLike = np.float64) -> Block:
        """The lines ``first_line`` to ``first_line + count - 1``."""
        stored, valid = self.read_stored(first_line, count, self.axis.good)
        return Block(first_line, self._scaled(stored.transpose(1, 2, 0), np.dtype(dtype)), valid)

    def read_some_bands(self, first_line: int, count: int, bands: Sequence[int]) -> npt.NDArray[np.float32]:
        """(count, samples, n) values of a few bands of the axis, as for a picture; NaN for ignored values."""
        order = self.stored_band[list(bands)]
        stored = self.raster.read_some_bands(first_line, count, order.tolist()).transpose(1, 2, 0)
        return self._scaled(stored, np.dtype(np.float32), list(bands))

    def handed_out(self, first_line: int, count: int, dtype: npt.DTypeLike = np.float64) -> npt.NDArray[Any]:
        """Values (count, samples, B) as other programs take them: NaN also in pixels that are fill in every band.

        >>> import xarray as xr
        >>> nm = {"wavelength": ("b", [500.0, 600.0], {"units": "nm"})}
        >>> two = xr.DataArray([[[0.1, 0.0], [0.0, 0.0]]], nm, ("y", "x", "b"))
        >>> open_cube(two, quantity="reflectance").to_xarray().values.tolist()
        [[[0.1, 0.0], [nan, nan]]]
        """
        stored, valid = self.read_stored(first_line, count, np.zeros(self.bands, bool))
        return np.where(valid[..., None], self._scaled(stored.transpose(1, 2, 0), np.dtype(dtype)), np.nan)

    def blocks(self, lines_per_block: int | None = None, *, dtype: npt.DTypeLike = np.float64) -> Iterator[Block]:
        """All lines in order, ``lines_per_block`` at a time (default: about 8 MiB of values)."""
        size = self.samples * self.bands * np.dtype(dtype).itemsize
        step = max(1, lines_per_block or BLOCK_BYTES // size)
        for first in range(0, self.lines, step):
            yield self.read(first, min(step, self.lines - first), dtype)

    def to_spy(self) -> SpyFile | spectral.image.ImageArray:
        """As an image of SPy: memory-mapped where it is an ENVI file of one scale, else loaded as float32.

        SPy divides stored values by ``scale_factor``, which is 1/gain here; of ignore values it knows nothing, so that
        they come as numbers (``metadata["data ignore value"]``) from a mapped file and as NaN from a loaded one.
        """
        import spectral
        from spectral.io import envi

        raster, bands, gain = self.raster, spectral.BandInfo(), self.gain
        bands.centers, bands.bandwidths = self.axis.centre_nm.tolist(), self.axis.fwhm_nm.tolist()
        bands.band_unit, bands.band_quantity = "nm", "Wavelength"
        if isinstance(raster, EnviRaster) and self._order == slice(None) and not (np.ptp(gain) or np.any(self.offset)):
            image = envi.open(str(raster.header.path), str(raster.path))
            image.scale_factor, image.bands = 1.0 / float(gain[0]), bands
            return image
        return _image_array(self.handed_out(0, self.lines, np.float32), bands, str(raster.path))

    def to_xarray(self) -> xr.DataArray:
        """As a lazy array (line, sample, wavelength) in its unit, NaN where there is no data.

        Parts are read when they are asked for; ``fwhm`` and ``good`` stand beside the wavelengths, and the position as
        ``spatial_ref`` with ``GeoTransform``, as rioxarray has it.
        """
        import xarray as xr
        from xarray.core import indexing

        nm = {"units": "nm", "standard_name": "radiation_wavelength"}
        coords: dict[str, Any] = {
            "wavelength": ("wavelength", self.axis.centre_nm, nm), "good": ("wavelength", self.axis.good),
            "fwhm": ("wavelength", self.axis.fwhm_nm, {"units": "nm"}),
        }  # fmt: skip
        lazy, about = indexing.LazilyIndexedArray(_lazy_cube(self)), {"units": self.unit, "quantity": self.quantity}
        values = xr.Variable(("line", "sample", "wavelength"), lazy, about)
        return _placed(xr.DataArray(values, coords, name=self.quantity), self.transform, self.crs)

    def read_stored(
        self, first_line: int, count: int, needed: Mask | None = None, buffer: npt.NDArray[Any] | None = None
    ) -> tuple[npt.NDArray[Any], Mask]:
        """Stored numbers (B, count, samples) in the bands of the axis, as a view in the order of the file.

        Also which pixels (count, samples) hold data in the ``needed`` bands (all by default); gain and
        offset are not applied.  ``buffer``: as for :meth:`EnviRaster.read_bands`.
        """
        stored = self.raster.read_bands(first_line, count, buffer)[self._order]
        return stored, self._usable(stored, needed)

    def spectra(self, where: Where) -> Array:
        """(m, B) values of the valid pixels among ``where``."""
        values, valid = self.marked_pixels(where)
        return values if valid.all() else values[valid]

    def marked_pixels(self, where: Where) -> tuple[Array, Mask]:
        """(n, B) values of the pixels of a mask (in line order) or of (rows, cols), and (n,) which of them are valid.

        Ignored values are NaN.
        """
        if isinstance(where, tuple):
            rows, cols = (np.atleast_1d(np.asarray(w)) for w in where)
            if rows.shape != cols.shape or rows.ndim != 1 or not {rows.dtype.kind, cols.dtype.kind} <= {"i", "u"}:
                raise refusal("cube.index")
            if not np.all((rows >= 0) & (rows < self.lines) & (cols >= 0) & (cols < self.samples)):
                box = {"top": rows.min(), "bottom": rows.max(), "left": cols.min(), "right": cols.max()}
                raise refusal("cube.outside", last_line=self.lines - 1, last_sample=self.samples - 1, **box)
        else:
            mask = np.asarray(where)
            if mask.dtype != bool or mask.shape != self.shape:
                raise refusal("cube.mask", dtype=mask.dtype, shape=mask.shape, cube=self.shape)
            rows, cols = np.nonzero(mask)
        stored = self.raster.read_pixels(rows.astype(np.intp, copy=False), cols.astype(np.intp, copy=False))
        stored = stored[:, self._order]
        return self._scaled(stored, np.dtype(np.float64)), self._usable(stored.T, self.axis.good)

    @property
    def _order(self) -> Index | slice:
        """The stored bands behind those of the axis, as an index: a slice where they are all of them in their order."""
        return slice(None) if np.array_equal(self.stored_band, np.arange(self.raster.bands)) else self.stored_band

    def _scaled(
        self, stored: npt.NDArray[Any], dtype: np.dtype, bands: list[int] | slice = slice(None)
    ) -> npt.NDArray[Any]:
        """Values (..., n) of stored numbers in some bands of the axis; NaN for ignored values."""
        values = np.empty(stored.shape, dtype)
        np.multiply(stored, self.gain[bands].astype(dtype), out=values, dtype=dtype, casting="unsafe")
        if np.any(self.offset):
            values += self.offset[bands].astype(dtype)
        if self.ignore_value is not None:
            values[equals(stored, self.ignore_value)] = np.nan
        return values

    def _usable(self, stored: npt.NDArray[Any], needed: Mask | None) -> Mask:
        """Which pixels (...) of stored numbers (B, ...) hold data.

        Those do not of which a ``needed`` band (B,), by default any, holds the ignore value or is not finite, or of
        which every band holds one number that is fill of any quantity but "other".
        """
        usable = np.ones(stored.shape[1:], bool)
        some = slice(None) if needed is None or needed.all() else needed
        if self.ignore_value is not None or stored.dtype.kind == "f":
            usable &= ~self.lacking(stored[some]).any(axis=0)
        if self.quantity != "other":
            usable &= ~filled(stored, self.ignore_value)
        return usable

    def lacking(self, stored: npt.NDArray[Any]) -> Mask:
        """Where stored numbers are no data: the ignore value, or not finite."""
        lost: Mask = ~np.isfinite(stored)
        return lost if self.ignore_value is None else lost | equals(stored, self.ignore_value)


def _checked(cube: Cube, scale: float | None, source: str) -> Cube:
    """The cube without the bands that hold no number in any pixel seen, and the bad ones that lack some where good ones
    do not; those that hold the same number everywhere are bad.

    ``scale`` is what the caller states, ``source`` what the file scales by.

    >>> import xarray as xr
    >>> nm = {"wavelength": ("b", [500.0, 600.0], {"units": "nm"})}
    >>> packed = xr.DataArray(np.full((2, 2, 2), [-20.0, -19.0]), nm, ("y", "x", "b"))
    >>> open_cube(packed, quantity="reflectance")
    Traceback (most recent call last):
    hyperval.errors.InputError: xarray: half of the reflectance values lie below -19.5...
    >>> from tempfile import TemporaryDirectory
    >>> from hyperval.imagery import write_cube
    >>> axis = SpectralAxis(np.array([500.0, 600.0, 700.0]), 10.0, np.array([True, True, False]))
    >>> values = np.linspace(0.1, 0.4, 3072).reshape(32, 32, 3)
    >>> values[:5, :, 2] = np.nan  # as bands of water vapour often are
    >>> with TemporaryDirectory() as folder:
    ...     cube = open_cube(write_cube(f"{folder}/x.img", values, axis=axis), quantity="reflectance")
    ...     (cube.bands, cube.marked_pixels(np.ones((32, 32), bool))[1].all().item())
    (2, True)

    Raises
    ------
    InputError : values that are too large or too low for the quantity: a scale that was not stated.  Reflectances that
        the scale of the file makes of numbers that are reflectances as they stand: it was applied before.
    """
    stored = cube.raster.some_pixels()[:, cube.stored_band]
    values = cube._scaled(stored, np.dtype(float))
    values = values[np.nan_to_num(values).any(axis=1) & ~filled(stored.T, cube.ignore_value)]
    cube = replace(cube, notes=(*cube.notes, *fill_notes(stored, cube.ignore_value)))
    valid = np.isfinite(values)
    usable = np.asarray(valid.any(axis=0)) & (cube.axis.good | valid[valid[:, cube.axis.good].all(axis=1)].all(axis=0))
    highest = np.max(values, axis=0, where=valid, initial=-np.inf)
    varies = highest > np.min(values, axis=0, where=valid, initial=np.inf)
    if len(values) >= _MIN_CHECKED and varies.any() and not np.all((varies | ~cube.axis.good) & usable):
        axis = SpectralAxis(cube.axis.centre_nm, cube.axis.fwhm_nm, cube.axis.good & varies)
        numbers = ", ".join(str(n + 1) for n in cube.stored_band[~(varies & usable)][:_MAX_LISTED])
        none = ~valid.any(axis=0)
        what = f"{np.sum(usable & ~varies)} bands hold one number in all pixels seen, {np.sum(none)} none"
        what += f", {np.sum(~usable & ~none)} bad ones not in all" * bool(np.any(~usable & ~none))
        notes = (*cube.notes, f"warning: {what} (the first: {numbers}): those are bad, these left out")
        arrays = {name: getattr(cube, name)[usable] for name in ("stored_band", "gain", "offset")}
        cube = replace(cube, axis=axis.select(usable), notes=notes, **arrays)
        values = values[:, usable]
    limit = PLAUSIBLE.get(cube.quantity, np.inf)
    judged = values[:, cube.axis.good]
    judged = judged[np.isfinite(judged).all(axis=1)]
    middle, high = np.percentile(judged, (50, 95)).tolist() if judged.size else (0.0, 0.0)
    names = {"cube": cube, "unit": "" if cube.unit == "1" else f" {cube.unit}"}
    refuse(high > limit, "scale.implausible", cube.raster.path, high=high, limit=limit, **names)
    refuse(middle < (least := _LOWEST * limit), "scale.low", cube.raster.path, middle=middle, least=least, **names)
    if scale is None and cube.quantity == "reflectance" and _is_twice(judged, gain := cube.gain[cube.axis.good]):
        raise refusal("scale.twice", cube.raster.path, by=source or "its unit", most=judged.max(), gain=gain[0])
    return cube


def _is_twice(values: Array, gain: Array) -> bool:
    """Whether a gain (B,) made values (n, B) that reach no usual reflectance, of numbers that are reflectances.

    >>> [_is_twice(np.array([stored]) * 1e-4, np.array([1e-4])) for stored in ([0.1, 0.5], [40.0, 80.0], [400.0])]
    [True, False, False]
    """
    dark = values.size and values.max() < _DARK and np.any(gain != 1.0)
    return bool(dark and np.percentile(values / gain, 95) <= PLAUSIBLE["reflectance"])


TIFF, HDF5, _NETCDF3 = "GeoTIFF", "HDF5 or NetCDF-4", "NetCDF-3"
_OTHERS = {b"\x0e\x03\x13\x01": "HDF4", b"PK\x03\x04": "zip (.npz)"}  # which nothing here reads
_HIERARCHIES = {b"\x89HDF\r\n\x1a\n": HDF5, b"CDF\x01": _NETCDF3, b"CDF\x02": _NETCDF3}
_MARKS = dict.fromkeys(TIFF_MARKS, TIFF) | arrays.MATRICES | _HIERARCHIES | _OTHERS
MATRICES = (*arrays.MATRICES.values(), HDF5)  # arrays that bear no labels, or need not


@reader
def open_raster(
    path: Path | str, *, header: Path | str | None = None, variable: str | None = None, engine: str | None = None
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
        return arrays.open_labelled(checked_folder(data), variable, engine)
    refuse(data.is_dir(), "image.folder", data)
    data = checked_file(path, what="image file")
    if engine is not None:
        return arrays.open_labelled(data, variable, engine)
    ending = data.suffix.lower()
    if header is None and ending == ".hdr":
        header, data = data, checked_file(data_beside(data), what="image file")
    elif header is None and ending == ".xml":
        data = checked_file(image_of(data, variable), what="GeoTIFF")
    refuse(data.suffix.lower() == ".hdr", "image.is_header", data)
    refuse(data.suffix.lower() == ".json", "image.is_item", data)
    kind = kind_of(data)
    if kind == TIFF:
        return open_tiff(data, header)
    if header is None and kind == _NETCDF3:
        return arrays.open_labelled(data, variable, "scipy")
    if header is None and kind == HDF5:
        refuse_own(data)
        arrays.check_own_values(data)
        try:
            product = open_product(data) if variable is None else None
            return product or arrays.open_labelled(data, variable, "h5netcdf")
        except HypervalError:  # such as no array with wavelengths: it may be a bare one
            with suppress(HypervalError):
                return arrays.open_matrix(data, HDF5, variable)
            raise
    sidecar = Path(header) if header is not None else header_beside(data)
    matrix: Raster | None = None
    if kind in MATRICES:
        with suppress(*([] if sidecar is None else [InputError])):  # else numbers that the header describes
            matrix = arrays.open_matrix(data, str(kind), variable)
    if matrix is not None:
        return matrix if sidecar is None else described_by(matrix, sidecar)
    if sidecar is not None:
        return open_envi(data, sidecar)
    refuse(kind is not None, "image.kind", data, kind=kind)
    raise refusal("image.no_header", data, first=f"{data.name}.hdr", second=data.with_suffix(".hdr").name)


def kind_of(path: Path) -> str | None:
    """What kind of image file this is by its first bytes, else its name; None when it is none known.

    >>> from tempfile import NamedTemporaryFile
    >>> with NamedTemporaryFile(suffix=".mat") as damaged:
    ...     kind_of(Path(damaged.name))
    'MATLAB 5'
    >>> kind_of(Path("no.tif"))
    Traceback (most recent call last):
    hyperval.errors.InputError: no.tif: no such file
    """
    with open(checked_file(path), "rb") as stream:
        head = stream.read(16)
    kind = next((name for mark, name in _MARKS.items() if head.startswith(mark)), None)
    if path.suffix.lower() == ".mat":  # without its mark: HDF5 of another program, in its order, and MATLAB 4
        return {HDF5: "MATLAB 7.3", None: "MATLAB 5"}.get(kind, kind)
    return TIFF if path.suffix.lower() in TIFF_SUFFIXES else kind


def needs_header(path: Path) -> bool:
    """Whether a file is a cube only with an ENVI header beside it: no GeoTIFF, and no file of arrays."""
    return path.suffix.lower() not in (".xml", ".zarr") and kind_of(path) not in (TIFF, _NETCDF3, *MATRICES)


@reader
def open_cube(
    path: Path | str | Any,
    *,
    quantity: Quantity,
    unit: str | None = None,
    scale: float | None = None,
    wavelength_unit: str | None = None,
    header: Path | str | None = None,
    axis: Bands = None,
    sort_bands: bool = False,
    check_values: bool = True,
    variable: str | None = None,
    engine: str | None = None,
) -> Cube:
    """Open an ENVI cube (BSQ, BIL, BIP), a GeoTIFF, or the image of an HDF5, NetCDF or Zarr product.

    Parameters
    ----------
    path : data file, ENVI header, GeoTIFF or its METADATA.XML; or an image of SPy, or an array of xarray
    quantity : what the values are; "counts" and "other" are handed out as stored
    unit : unit of the (scaled) values; required for a radiance whose file states none
    scale : multiplies the stored values and replaces the header's scale factors; None takes those
    wavelength_unit : nm or um, where the header states none
    header : the ENVI header, when it does not lie beside the data
    axis : the bands, for a file that lists no wavelengths; "numbers" counts them
    sort_bands : sort bands whose wavelengths do not increase; ``stored_band`` records the permutation
    check_values : look at some pixels for a scale that was not stated, and for bands that tell nothing
    variable, engine : array that is the image, where a file of arrays leaves a choice, and the engine of xarray

    Raises
    ------
    InputError : missing, truncated or overlong files, headers that contradict them, implausible values.
    UsageError : a unit that is not stated, or paths that may not be opened.
    """
    image = path if isinstance(path, Path | str | Raster) else raster_of(path, variable)
    raster = image if isinstance(image, Raster) else open_raster(image, header=header, variable=variable, engine=engine)
    about, where = raster.description, str(raster.path)
    axis, stored_band, remarks = about.band_table(wavelength_unit, where, sort_bands, axis, raster.bands)
    scaling = about.scaling(quantity, unit, scale, raster.bands, where)
    origin = f" of {about.sensor}" if about.sensor and about.sensor.lower() not in about.product.lower() else ""
    notes: tuple[str, ...] = (f"read as {about.product}{origin}",) if about.product else ()
    notes += about.notes + remarks + ((scaling.source,) if scaling.source else ())
    if raster.transform is not None and raster.crs is None:  # an unreadable one is refused here
        notes += ("the coordinate system is not known: map coordinates are taken as the cube's own",)
    cube = Cube(
        raster=raster,
        axis=axis,
        quantity=quantity,
        unit=str(scaling.unit),
        gain=np.asarray(scaling.gain)[stored_band],
        offset=np.asarray(scaling.offset)[stored_band],
        stored_band=stored_band,
        ignore_value=about.no_data(),
        description=" ".join(about.entries.get("description", "").split()),
        notes=notes,
    )
    return _checked(cube, scale, scaling.source) if check_values and quantity != "other" else cube


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
            breaks = np.flatnonzero(np.abs(np.diff(np.ravel(lines))) > 4) + 1  # lines between are not read
            parts = [part for part in np.split(np.ravel(lines), breaks) if part.size]
            read = [self.cube.handed_out(int(part.min()), int(np.ptp(part)) + 1)[part - part.min()] for part in parts]
            values = np.concatenate([np.empty((0, *self.shape[1:])), *read])
            return np.asarray(values.reshape(*lines.shape, *self.shape[1:])[..., key[1], key[2]])

    return LazyCube(cube)


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
        return arrays.labelled_array(image, variable)
    import spectral
    from spectral.io.spyfile import SpyFile

    refuse(not isinstance(image, SpyFile | spectral.image.ImageArray), "exchange.no_cube", kind=type(image).__name__)
    path, about = Path(str(image.filename or "SPy image")), image.bands
    if isinstance(image, SpyFile) and path.is_file() and header_beside(path) is not None:
        return path
    centres = np.asarray(needed(about.centers, "exchange.no_wavelengths"), float)
    widths = None if about.bandwidths is None else np.asarray(about.bandwidths, float)
    bands = ListedBands(centres, widths, about.band_unit)
    dtype = np.dtype(np.float32 if isinstance(image, SpyFile) else image.dtype)
    values = np.asarray(image) if isinstance(image, np.ndarray) else image
    piece = arrays.BandArrays((arrays.Term("image"),), "lsb", tuple(image.shape), dtype)
    store = arrays.ArrayFile(path, arrays.at_hand, "image", values)
    return arrays.array_raster(store, (piece,), Description("image of SPy", bands))


def _placed(array: xr.DataArray, transform: Affine | None, crs: CRS | None) -> xr.DataArray:
    attrs = {} if crs is None else dict.fromkeys(("crs_wkt", "spatial_ref"), crs.to_wkt())
    attrs |= {} if transform is None else {"GeoTransform": " ".join(repr(float(v)) for v in transform.to_gdal())}
    placed = array.assign_coords(spatial_ref=((), 0, attrs)).assign_attrs(grid_mapping="spatial_ref")
    return placed if attrs else array


def _image_array(values: npt.NDArray[Any], bands: spectral.BandInfo, filename: str) -> spectral.image.ImageArray:
    import spectral

    params = SimpleNamespace(
        nbands=values.shape[2], nrows=values.shape[0], ncols=values.shape[1], offset=0, dtype=values.dtype.str,
        filename=filename, byte_order=int(sys.byteorder == "big"),
    )  # fmt: skip
    source = SimpleNamespace(params=lambda: params, metadata={}, bands=bands, filename=filename)
    return spectral.image.ImageArray(values, source)
