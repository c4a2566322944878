"""Masks of large images at one bit a pixel."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class MaskBits:
    """A mask (lines, samples) at one bit a pixel, which is read by lines.

    Attributes
    ----------
    bits : (lines, bytes of a line) eight samples in a byte, the first in its highest bit
    samples : of a line
    """

    bits: npt.NDArray[np.uint8]
    samples: int

    @classmethod
    def of(cls, mask: Mask) -> MaskBits:
        """The mask, packed.

        Examples
        --------
        >>> packed = MaskBits.of(np.array([[True, False, True], [False, False, True]]))
        >>> packed.bits.ravel().tolist(), packed[1:2].tolist()
        ([160, 32], [[False, False, True]])
        """
        return cls(np.packbits(mask, axis=1), mask.shape[1])

    def __getitem__(self, lines: slice) -> Mask:
        """Some lines."""
        return np.unpackbits(self.bits[lines], axis=1, count=self.samples).view(bool)


class PackedMasks(Mapping[str, Mask]):
    """Masks by name: kept packed, each handed out whole as an array of its own."""

    def __init__(self, masks: Iterable[tuple[str, Mask]] = ()) -> None:
        self._bits: dict[str, MaskBits] = {}
        for name, mask in masks:
            self.add(name, mask)

    def add(self, name: str, mask: Mask) -> None:
        """Pack one more mask, or another one of that name."""
        self._bits[name] = MaskBits.of(mask)

    def same(self, others: PackedMasks) -> set[str]:
        """Names under which both have the same pixels.

        Examples
        --------
        >>> mask = np.array([[True, False, True]])
        >>> PackedMasks([("a", mask), ("b", mask)]).same(PackedMasks([("a", mask), ("b", ~mask), ("c", mask)]))
        {'a'}
        """
        both = self._bits.keys() & others._bits.keys()
        return {name for name in both if np.array_equal(self._bits[name].bits, others._bits[name].bits)}

    def __getitem__(self, name: str) -> Mask:
        return self._bits[name][:]

    def __iter__(self) -> Iterator[str]:
        return iter(self._bits)

    def __len__(self) -> int:
        return len(self._bits)
