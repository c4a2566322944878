"""ENVI files, written by blocks of lines: whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS

from hyperval.envi_header import BYTE_ORDERS, DATA_TYPES, INTERLEAVES, EnviHeader, parse_header
from hyperval.errors import refusal, refuse
from hyperval.spectra.axis import SpectralAxis
from hyperval.storage import whole_file, write_text


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
            raise refusal("write.shape", shape=block.shape, samples=header.samples, bands=header.bands)
        refuse(self.lines_written + block.shape[0] > header.lines, "write.many", lines=header.lines)
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
            if self.ignore is None and not np.isfinite(values).all():
                raise refusal("write.not_finite")
            values = np.rint(np.where(np.isfinite(values), values, self.ignore or 0.0))
        limits = np.iinfo(dtype)
        if values.size and (values.min() < limits.min or values.max() > limits.max):
            raise refusal("write.range", least=values.min(), most=values.max(), dtype=dtype.name)
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
    refuse(path.suffix.lower() == ".hdr", "write.header", path)
    if interleave not in INTERLEAVES or byte_order not in BYTE_ORDERS or data_type not in DATA_TYPES:
        known = f"{INTERLEAVES}, {tuple(BYTE_ORDERS)}, {tuple(DATA_TYPES)}"
        raise refusal("write.kind", interleave=interleave, order=byte_order, code=data_type, known=known)
    if gain is not None and reflectance_scale_factor is not None:
        raise refusal("write.scales")
    if axis is not None and len(axis) != bands:
        raise refusal("write.axis", size=len(axis), bands=bands)
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
            refuse(writer.lines_written != lines, "write.few", path, written=writer.lines_written, lines=lines)
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
    refuse(transform.b or transform.d or transform.a <= 0 or transform.e >= 0, "write.north_up")
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
