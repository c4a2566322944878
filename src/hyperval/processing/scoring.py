"""Score maps from radiance blocks, with the empirical line folded into the filter."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.elm import EmpiricalLine
from hyperval.processing.streaming import BlockLike

Array = npt.NDArray[np.float64]


class LinearFilterLike(Protocol):
    """A detector whose score is affine in the spectrum."""

    @property
    def weights(self) -> Array:
        """(B,) weights."""

    def score(self, x: Array) -> Array:
        """(...,) scores of spectra (..., B)."""


def folded_filter(
    linear: LinearFilterLike, elm: EmpiricalLine | None, bands: npt.NDArray[Any] | None = None
) -> tuple[Array, float]:
    """Weights (B,) and constant that give the score of a reflectance straight from the radiance.

    With rho = (L - b)/k the score w rho + c is (w/k) L + (c - sum w b/k).

    Raises
    ------
    UsageError : the filter does not fit the bands, or the line has no gain in one of them.
    """
    w = np.asarray(linear.weights, dtype=float)
    constant = float(linear.score(np.zeros_like(w)))  # whatever sign the filter gives its offset
    if elm is None:
        return w, constant
    k, b = (elm.gain, elm.offset) if bands is None else (elm.gain[bands], elm.offset[bands])
    if k.shape != w.shape:
        raise UsageError(f"a filter of {w.size} bands for an empirical line of {k.size} bands")
    if not np.all(np.isfinite(k)):
        raise UsageError(
            f"the empirical line has no gain in {int(np.sum(~np.isfinite(k)))} of the filter's bands",
            mend="leave out the bands where EmpiricalLine.usable is False",
        )
    return w / k, constant - float(np.sum(w * b / k))


def score_blocks(
    blocks: Iterable[BlockLike],
    filters: Mapping[str, LinearFilterLike],
    elm: EmpiricalLine | None = None,
    bands: npt.NDArray[Any] | None = None,
) -> dict[str, Array]:
    """Score map of every filter in one pass; no reflectance cube is made.

    Parameters
    ----------
    blocks : blocks of the radiance cube, in any order, each line once
    filters : by name; weights of the selected bands
    elm : line over all bands of the cube; None when the filters work on what the cube holds
    bands : mask or indices of the bands that the filters use

    Returns
    -------
    (lines, samples) score by name; NaN where the pixel is invalid or not finite in a used band

    Raises
    ------
    UsageError : no filter, filters that do not fit the bands, missing or repeated lines.
    """
    if not filters:
        raise UsageError("no filter to score with")
    folded = {name: folded_filter(linear, elm, bands) for name, linear in filters.items()}
    sizes = {w.size for w, _ in folded.values()}
    if len(sizes) > 1:
        raise UsageError(f"filters of different numbers of bands: {sorted(sizes)}")
    weights = np.stack([w for w, _ in folded.values()], axis=1)
    constant = np.array([c for _, c in folded.values()])
    parts: dict[int, Array] = {}
    for block in blocks:
        cube = block.values
        x = np.asarray(cube if bands is None else cube[..., bands], dtype=float)
        if x.shape[-1] != weights.shape[0]:
            raise UsageError(f"filters of {weights.shape[0]} bands for blocks of {x.shape[-1]}")
        with np.errstate(invalid="ignore", over="ignore"):
            score = x.reshape(-1, x.shape[-1]) @ weights + constant
        usable = np.asarray(block.valid, dtype=bool).ravel() & np.isfinite(score).all(axis=1)
        score[~usable] = np.nan
        if block.first_line in parts:
            raise UsageError(f"line {block.first_line} of the cube came twice")
        parts[block.first_line] = score.reshape(*x.shape[:2], -1)
    expected = 0
    for first in sorted(parts):
        if first != expected:
            raise UsageError(f"the blocks leave or repeat lines between {expected} and {first}")
        expected += parts[first].shape[0]
    if not parts:
        raise UsageError("the cube has no lines")
    whole = np.concatenate([parts[first] for first in sorted(parts)])
    return {name: np.ascontiguousarray(whole[..., i]) for i, name in enumerate(folded)}
