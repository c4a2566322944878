"""What charts and figures take from the two sides of a run, without what either draws with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.processing.difference import difference_ratio, difference_ratio_uncertainty
from hyperval.products import Products, RocCurve, SpectralEstimate

Array = npt.NDArray[np.float64]
Sides = tuple[Products | None, Products | None]
MOST_EIGENVALUES = 30


def of_side(side: Products | None, product: str) -> Mapping[Any, Any]:
    """A product of a side, empty where the side is absent."""
    return {} if side is None else getattr(side, product)


def eigenvalues(estimate: SpectralEstimate) -> Array:
    """(K,) leading eigenvalues of the pixel covariance over its finite bands, largest first."""
    covariance = np.asarray(estimate.pixel_covariance, dtype=float)
    finite = np.isfinite(np.diag(covariance))
    block = covariance[np.ix_(finite, finite)]
    if block.size == 0 or not np.isfinite(block).all():
        return np.empty(0)
    values = np.linalg.eigvalsh(block)[::-1]
    rank = block.shape[0] if estimate.n is None else min(block.shape[0], max(estimate.n - 1, 0))
    values = values[: min(rank, MOST_EIGENVALUES)]
    return values[values > 1e-13 * max(values[0], 0.0)] if values.size else values


def both_first(predicted: Mapping[Any, Any], collected: Mapping[Any, Any]) -> list[Any]:
    """Keys of either side: those of both sides before those of one."""
    common = [key for key in predicted if key in collected]
    return common + [k for k in predicted if k not in collected] + [k for k in collected if k not in predicted]


def difference(predicted: SpectralEstimate, collected: SpectralEstimate, ratio: bool) -> tuple[Array, Array]:
    """(B,) predicted - collected, or that over collected, and its standard uncertainty, independent."""
    p, c, up, uc = predicted.mean, collected.mean, predicted.standard_uncertainty, collected.standard_uncertainty
    if ratio:
        return difference_ratio(p, c), difference_ratio_uncertainty(p, c, up, uc)
    return p - c, np.hypot(up, uc)


def best_counted(keys: list[Any], measured: Mapping[Any, RocCurve], most: int) -> list[Any]:
    """``keys``, of too many those ``most`` with the most targets (pools of targets among them)."""
    if len(keys) <= most:
        return keys

    def count(key: Any) -> int:
        return (measured[key].n_target or 0) if key in measured else -1

    chosen = set(sorted(keys, key=lambda key: -count(key))[:most])
    return [key for key in keys if key in chosen]
