"""Stored numbers of an ENVI file, read with plain reads into one buffer: memory does not grow with the file."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS

from hyperval.envi_header import EnviHeader
from hyperval.errors import InputError, UsageError
from hyperval.imagery.georeference import crs_of, transform_of
from hyperval.imagery.stores import StoredFile

Index = npt.NDArray[np.intp]
_PACKED = {
    b"\x1f\x8b": "gzip", b"PK\x03\x04": "zip", b"BZh": "bzip2", b"\xfd7zXZ\x00": "xz",
    b"(\xb5/\xfd": "zstandard", b"7z\xbc\xaf": "7-zip",
}  # fmt: skip


@dataclass(frozen=True)
class EnviRaster:
    """An ENVI data file whose size is exactly what its header says.

    Attributes
    ----------
    divisors_path : file of what its whole numbers are divided by to give radiance, where one lies beside it
    """

    path: Path
    header: EnviHeader
    divisors_path: Path | None = None
    description: None = None

    @property
    def lines(self) -> int:
        """Number of lines."""
        return self.header.lines

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.header.samples

    @property
    def bands(self) -> int:
        """Number of bands."""
        return self.header.bands

    @property
    def dtype(self) -> np.dtype:
        """Type of a stored value."""
        return self.header.dtype

    @cached_property
    def transform(self) -> Affine | None:
        """Pixel (sample, line) to map coordinates, from ``map info``."""
        return transform_of(self.header)

    @cached_property
    def crs(self) -> CRS | None:
        """Coordinate reference system, from the header."""
        return crs_of(self.header)

    @property
    def source_files(self) -> tuple[Path, ...]:
        """The files that were read."""
        return (self.path, self.header.path, *([self.divisors_path] if self.divisors_path else []))

    @cached_property
    def _file(self) -> StoredFile:
        return StoredFile(self.path)

    def kept_open(self) -> AbstractContextManager[object]:
        """Inside, the file is opened once for all reads."""
        return self._file.kept_open()

    def read_lines(self, first: int, count: int) -> npt.NDArray[Any]:
        """(count, samples, bands) stored numbers of consecutive lines."""
        return self.read_bands(first, count).transpose(1, 2, 0)

    def read_bands(self, first: int, count: int, buffer: npt.NDArray[Any] | None = None) -> npt.NDArray[Any]:
        """(bands, count, samples) stored numbers of consecutive lines: a view in the order of the file.

        ``buffer`` is a flat array of ``dtype`` to read into, with room for the lines.
        """
        samples, bands, size = self.samples, self.bands, self.dtype.itemsize
        if first < 0 or count < 1 or first + count > self.lines:
            raise UsageError(f"lines {first}-{first + count - 1} of a cube of {self.lines} lines")
        wanted = count * samples * bands
        flat = np.empty(wanted, self.dtype) if buffer is None else buffer[:wanted]
        if self.header.interleave == "bsq":
            by_band = flat.reshape(bands, count, samples)
            with self._file.kept_open():
                for band in range(bands):
                    offset = self.header.header_offset + (band * self.lines + first) * samples * size
                    self._file.fill(by_band[band], offset)
            return by_band
        self._file.fill(flat, self.header.header_offset + first * samples * bands * size)
        if self.header.interleave == "bil":
            return flat.reshape(count, bands, samples).transpose(1, 0, 2)
        return flat.reshape(count, samples, bands).transpose(2, 0, 1)

    def read_pixels(self, rows: Index, cols: Index) -> npt.NDArray[Any]:
        """(n, bands) stored numbers of single pixels."""
        samples, lines, bands = self.samples, self.lines, self.bands
        shape = {
            "bsq": (bands, lines, samples), "bil": (lines, bands, samples), "bip": (lines, samples, bands)
        }[self.header.interleave]  # fmt: skip
        stored = np.memmap(self.path, self.dtype, "r", self.header.header_offset, shape)
        if self.header.interleave == "bsq":
            return np.array(stored[:, rows, cols].T)
        if self.header.interleave == "bil":
            return np.array(stored[rows, :, cols])
        return np.array(stored[rows, cols])


def header_beside(data: Path) -> Path | None:
    """The header of a data file: ``name.img.hdr`` or ``name.hdr``; None when there is none."""
    candidates = {data.with_name(data.name + end) for end in (".hdr", ".HDR")}
    candidates |= {data.with_suffix(end) for end in (".hdr", ".HDR")}
    headers = sorted(p for p in candidates if p.is_file())
    # One file under two names on a file system that ignores case is one header.
    unique = {p.resolve().stat().st_ino: p for p in reversed(headers)}
    if len(unique) > 1:
        raise UsageError(
            "two headers beside the data file: " + ", ".join(p.name for p in headers),
            where=str(data),
            mend="state which one is meant (header:)",
        )
    return next(iter(unique.values()), None)


def check_size(data: Path, header: EnviHeader) -> None:
    """Raise InputError unless the data file has exactly the size that its header describes."""
    size, expected = data.stat().st_size, header.expected_bytes
    if size == expected:
        return
    described = (
        f"{header.header_offset} + {header.samples} samples x {header.lines} lines x {header.bands} bands "
        f"x {header.dtype.itemsize} bytes = {expected} bytes ({header.path})"
    )
    packed = packing_of(data)
    if packed is not None:
        raise InputError(
            f"the data file is compressed ({packed})", where=str(data), expected=described, mend="decompress it"
        )
    if size < expected:
        missing = 100.0 * (expected - size) / expected
        what = f"the file is truncated: {size} bytes, {missing:.3g} % missing"
        mend = "copy the file again, or correct the header"
    else:
        what = f"the file is longer than its header says: {size} bytes, {size - expected} too many"
        mend = "correct the header (lines, bands, data type or header offset)"
    raise InputError(what, where=str(data), expected=described, mend=mend)


def packing_of(path: Path) -> str | None:
    """How a file is compressed, by its first bytes; None when it is not."""
    with open(path, "rb") as stream:
        head = stream.read(6)
    return next((name for mark, name in _PACKED.items() if head.startswith(mark)), None)
