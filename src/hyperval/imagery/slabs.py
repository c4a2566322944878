"""Consecutive lines of an image that are kept for the next read: in memory, or unpacked in a file."""

from __future__ import annotations

import tempfile
import weakref
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.imagery.stores import page_array


@dataclass(frozen=True, eq=False)
class InMemory:
    """Lines in memory, as values (bands, lines, samples)."""

    first: int
    lines: int
    values: npt.NDArray[Any]

    def read(self, start: int, count: int) -> npt.NDArray[Any]:
        """(bands, count, samples) values from line ``start`` of the slab on."""
        return self.values[:, start : start + count]


@dataclass(frozen=True, eq=False)
class Unpacked:
    """Lines in a file without a name, one after the other with all their bands; it goes when it is closed."""

    first: int
    lines: int
    bands: int
    samples: int
    dtype: np.dtype
    file: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - open for as long as the slab is there
        weakref.finalize(self, file.close)
        object.__setattr__(self, "file", file)

    def write(self, band: int, values: npt.NDArray[Any]) -> None:
        """Put some bands (n, lines, samples) in their places, ``band`` the first of them."""
        row = self.samples * self.dtype.itemsize
        for line in range(self.lines):
            self.file.seek((line * self.bands + band) * row)
            self.file.write(np.ascontiguousarray(values[:, line], self.dtype).data)

    def read(self, start: int, count: int) -> npt.NDArray[Any]:
        """(bands, count, samples) values from line ``start`` of the slab on."""
        out = page_array((count, self.bands, self.samples), self.dtype)
        self.file.seek(start * self.bands * self.samples * self.dtype.itemsize)
        self.file.readinto(out.data.cast("B"))
        return out.transpose(1, 0, 2)


Slab = InMemory | Unpacked
