"""Abundances of endmembers in a pixel by fully constrained least squares, and their error."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy

from hyperval.errors import UsageError
from hyperval.processing.filters import PositiveDefinite

Array = npt.NDArray[np.float64]


def whitened(spectra: npt.ArrayLike, noise: PositiveDefinite | None) -> Array:
    """Spectra (..., B) in coordinates in which the noise is white; as they stand without a noise covariance."""
    x = np.asarray(spectra, dtype=float)
    return x if noise is None else noise.whiten(x.reshape(-1, x.shape[-1]).T).T.reshape(x.shape)


def fully_constrained(
    spectra: npt.ArrayLike, endmembers: npt.ArrayLike, noise: PositiveDefinite | None = None
) -> Array:
    """Abundances (..., M) of spectra (..., B): non-negative, sum 1, least (x - a E)^T C^-1 (x - a E).

    Exact: for u = s a with sum a = 1, |s (E^T - x) a|^2 + (s - 1)^2 is least over s at D/(1 + D) with
    D = |(E^T - x) a|^2, which grows with D, so that non-negative least squares of [E^T - x; 1] u = [0; 1] gives the
    direction of the constrained solution (Lawson & Hanson 1974, section 23.4; problem of Heinz & Chang, IEEE TGRS
    39, 529-545, 2001).

    Parameters
    ----------
    endmembers : (M, B), or (..., M, B) with a set of its own for each spectrum
    noise : covariance C; None weighs all bands alike

    Raises
    ------
    UsageError : shapes that do not fit, or numbers that are not finite.
    """
    x, e = np.asarray(spectra, dtype=float), np.asarray(endmembers, dtype=float)
    if e.ndim < 2 or x.shape[-1:] != e.shape[-1:]:
        raise UsageError(f"spectra {x.shape} and endmembers {e.shape} do not stand on the same bands")
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(e))):
        raise UsageError("unmixing needs spectra and endmembers that are finite in every band")
    if e.shape[-2] == 2:
        return _between_two(x, e, noise)
    x, e = whitened(x, noise), whitened(e, noise)
    flat = x.reshape(-1, x.shape[-1])
    sets = np.broadcast_to(e, (*x.shape[:-1], *e.shape[-2:])).reshape(-1, *e.shape[-2:])
    out = np.array([_closest_in_simplex(p, s) for p, s in zip(flat, sets, strict=True)])
    return out.reshape(*x.shape[:-1], e.shape[-2])


def _between_two(x: Array, e: Array, noise: PositiveDefinite | None) -> Array:
    """Two endmembers: the point of the line between them that is nearest, kept between its ends."""
    d = e[..., 0, :] - e[..., 1, :]
    # The endmembers are weighted and not the spectra, of which there are many.
    weighted = d if noise is None else noise.solve(d.reshape(-1, d.shape[-1]).T).T.reshape(d.shape)
    length = np.einsum("...b,...b->...", d, weighted)
    along = np.einsum("...b,...b->...", x, weighted) - np.einsum("...b,...b->...", e[..., 1, :], weighted)
    a = np.clip(along / length, 0.0, 1.0)
    return np.stack([a, 1.0 - a], axis=-1)


def _closest_in_simplex(pixel: Array, endmembers: Array) -> Array:
    differences = (endmembers - pixel).T
    scale = float(np.abs(differences).max()) or 1.0
    # An orthogonal reduction to as many rows as there are endmembers leaves the problem as it is.
    reduced = np.linalg.qr(differences / scale, mode="r")
    matrix = np.vstack([reduced, np.ones(endmembers.shape[0])])
    right = np.zeros(matrix.shape[0])
    right[-1] = 1.0
    u, _ = scipy.optimize.nnls(matrix, right)
    return np.asarray(u / u.sum())
