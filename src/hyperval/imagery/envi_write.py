"""Writing ENVI cubes by blocks of lines: whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS

from hyperval.envi_header import BYTE_ORDERS, DATA_TYPES, INTERLEAVES, parse_header
from hyperval.errors import UsageError
from hyperval.files import whole_file, write_text
from hyperval.spectra.axis import SpectralAxis


class EnviWriter:
    """Takes blocks of lines in order; made by :func:`envi_writer`."""

    def __init__(self, stream: Any, header: Mapping[str, Any], gain: npt.NDArray[np.float64]):
        self._stream, self._gain = stream, gain
        self.lines, self.samples, self.bands = header["lines"], header["samples"], header["bands"]
        self._interleave, self._start = header["interleave"], header["header offset"]
        self._dtype = np.dtype(BYTE_ORDERS[header["byte order"]] + DATA_TYPES[header["data type"]])
        self._ignore = header.get("data ignore value")
        self.lines_written = 0

    def write(self, block: npt.NDArray[Any]) -> None:
        """Append (lines, samples, bands) physical values.

        Raises
        ------
        UsageError : wrong shape, more lines than announced, values that do not fit the stored type.
        """
        block = np.asarray(block)
        count = block.shape[0]
        if block.ndim != 3 or block.shape[1:] != (self.samples, self.bands):
            raise UsageError(f"a block of {block.shape} for {self.samples} samples and {self.bands} bands")
        if self.lines_written + count > self.lines:
            raise UsageError(f"more than {self.lines} lines were written")
        stored = self._stored(block)
        size = self._dtype.itemsize
        if self._interleave == "bsq":
            for band in range(self.bands):
                at = self._start + (band * self.lines + self.lines_written) * self.samples * size
                self._stream.seek(at)
                self._stream.write(np.ascontiguousarray(stored[:, :, band]).tobytes())
        else:
            axes = (0, 2, 1) if self._interleave == "bil" else (0, 1, 2)
            self._stream.seek(self._start + self.lines_written * self.samples * self.bands * size)
            self._stream.write(np.ascontiguousarray(stored.transpose(axes)).tobytes())
        self.lines_written += count

    def _stored(self, block: npt.NDArray[Any]) -> npt.NDArray[Any]:
        values = block if np.all(self._gain == 1.0) else block / self._gain
        if self._dtype.kind == "f":
            return values.astype(self._dtype)
        if values.dtype.kind == "f":
            finite = np.isfinite(values)
            if not finite.all():
                if self._ignore is None:
                    raise UsageError("values that are not finite need an ignore value to be stored as integers")
                values = np.where(finite, values, self._ignore)
            values = np.rint(values)
        limits = np.iinfo(self._dtype)
        if values.size and (values.min() < limits.min or values.max() > limits.max):
            raise UsageError(
                f"values from {values.min():g} to {values.max():g} do not fit {self._dtype.name}",
                mend="choose a larger data type or another scale",
            )
        return values.astype(self._dtype)


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
    factor = np.ones(bands)
    if gain is not None:
        factor = np.broadcast_to(np.asarray(gain, dtype=float), (bands,)).copy()
    elif reflectance_scale_factor is not None:
        factor = np.full(bands, 1.0 / reflectance_scale_factor)
    entries: dict[str, Any] = {
        "description": "{" + description + "}",
        "samples": samples,
        "lines": lines,
        "bands": bands,
        "header offset": header_offset,
        "file type": file_type,
        "data type": data_type,
        "interleave": interleave,
        "byte order": byte_order,
    }
    if gain is not None:
        entries["data gain values"] = _listed(factor, "{!r}")
        entries["data offset values"] = _listed(np.zeros(bands), "{:g}")
    if reflectance_scale_factor is not None:
        entries["reflectance scale factor"] = repr(float(reflectance_scale_factor))
    entries |= _georeference(transform, crs)
    if axis is not None:
        if len(axis) != bands:
            raise UsageError(f"an axis of {len(axis)} bands for a cube of {bands}")
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
    header_path = path.with_suffix(".hdr")
    size = parse_header(text, header_path).expected_bytes  # what is written can be read
    entries["data ignore value"] = ignore_value
    with whole_file(path) as temporary:
        with open(temporary, "wb") as stream:
            stream.truncate(size)
            writer = EnviWriter(stream, entries, factor)
            yield writer
            if writer.lines_written != lines:
                raise UsageError(f"{writer.lines_written} of {lines} lines were written", where=str(path))
        # Without its header a cube cannot be read: an old header never describes new data.
        header_path.unlink(missing_ok=True)
    write_text(header_path, text)


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
