"""What every metric of detection follows from: the share of the background that outscores each object, by blocks.

All detectors see the same pixels, so blocks of the background and objects are resampled for all of them at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.processing.alarm_blocks import block_side

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class BlockCounts:
    """Background pixels above and level with each object's score, block by block.

    P looks (an object through the filter of one target spectrum), D detectors, K blocks.

    Attributes
    ----------
    detectors : names, in the order of the second dimension
    over, tie : (P, D, K) background pixels above the object's score, and equal to it
    pixels : (K,) background pixels of each block
    item : (P,) number of the object on the ground that is looked at
    group : name -> looks of a subject or of a pool
    density_km2 : background pixels on a square kilometre; NaN when the ground area is not known
    """

    detectors: tuple[str, ...]
    over: Counts
    tie: Counts
    pixels: Counts
    item: npt.NDArray[np.intp]
    group: Mapping[str, Sequence[int]]
    density_km2: float = float("nan")

    @property
    def n(self) -> int:
        """Background pixels."""
        return int(self.pixels.sum())

    @property
    def orders(self) -> list[int]:
        """(D,) number of the order in which each detector puts the pixels; those that order alike share it.

        Told by the counts of every look: two detectors that agree in all blocks about all objects.
        """
        seen: dict[bytes, int] = {}
        columns = [self.over[:, d].tobytes() + self.tie[:, d].tobytes() for d in range(len(self.detectors))]
        return [seen.setdefault(column, len(seen)) for column in columns]

    def shares(self, weights: Array | None = None) -> tuple[Array, Array]:
        """Share of the background above each look's score and level with it, each (P, D) or (P, D, R).

        Parameters
        ----------
        weights : (K, R) how often each block is drawn; None: once
        """
        if weights is None:
            return self.over.sum(axis=2) / self.n, self.tie.sum(axis=2) / self.n
        total = self.pixels @ weights
        flat = (-1, self.pixels.size)
        shape = (*self.over.shape[:2], weights.shape[1])
        return (
            (self.over.reshape(flat) @ weights / total).reshape(shape),
            (self.tie.reshape(flat) @ weights / total).reshape(shape),
        )


def blocks_of(counted: Mask) -> npt.NDArray[np.intp]:
    """(n,) number of the square block, of about 64, that holds each counted pixel, in the order of the image."""
    lines, samples = np.nonzero(counted)
    side = block_side(lines.size)
    cell = lines // side * (counted.shape[1] // side + 1) + samples // side
    return np.asarray(np.unique(cell, return_inverse=True)[1], dtype=np.intp)


def counts_by_block(
    scores: Array, background: Array, block: npt.NDArray[np.intp], blocks: int
) -> tuple[Counts, Counts]:
    """(P, K) background scores above, and equal to, each of the scores (P,), in each block.

    Parameters
    ----------
    background, block : (n,) scores and the number of the block of each
    """
    value, place = np.unique(scores, return_inverse=True)
    # A background score b lies above value[k] for k < left, on value[left] where it is equal.
    left = np.searchsorted(value, background, side="left")
    equal = (left < value.size) & (value[np.minimum(left, value.size - 1)] == background)
    size = value.size + 1
    cells = np.bincount(block[~equal] * size + left[~equal], minlength=blocks * size).reshape(blocks, size)
    ties = np.bincount(block[equal] * size + left[equal], minlength=blocks * size).reshape(blocks, size)[:, :-1]
    # Above value[k]: what is not tied and has left > k, and ties on the values after k.
    above = cells[:, ::-1].cumsum(axis=1)[:, ::-1][:, 1:]
    above[:, :-1] += ties[:, ::-1].cumsum(axis=1)[:, ::-1][:, 1:]
    return above.T[place], ties.T[place]
