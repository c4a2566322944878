"""How much of a quantity's variance each input brings, alone and together with the others.

Inputs are standard normal; the quantity is taken as a polynomial of degree two through a few evaluations, whose
squared Hermite coefficients are the shares of the variance.  Source: Sudret, Reliab. Eng. Syst. Saf. 93,
964-979, 2008; indices: Sobol 1993, Homma & Saltelli 1996.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Indices:
    """Variance-based sensitivity of Q quantities to k inputs.

    Attributes
    ----------
    first : (Q, k) part of the variance that an input brings alone
    total : (Q, k) the same with all its interactions
    standard_deviation : (Q,) of each quantity under the inputs' distributions
    misfit : (Q,) root mean square error at points that were not used, over the standard deviation; NaN without such
    """

    first: Array
    total: Array
    standard_deviation: Array
    misfit: Array


def quadratic_design(inputs: int) -> Array:
    """Points that a polynomial of degree two needs: the middle, each input at -1 and 1, each pair at (1, 1).

    Returns (n, inputs) with n = (k + 1)(k + 2)/2.
    """
    unit = np.eye(inputs)
    pairs = [unit[i] + unit[j] for i, j in combinations(range(inputs), 2)]
    return np.concatenate([np.zeros((1, inputs)), unit, -unit, *([np.array(pairs)] if pairs else [])])


def sensitivity_indices(
    design: npt.ArrayLike,
    values: npt.ArrayLike,
    check: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
) -> Indices:
    """Indices of quantities (n, Q) evaluated at the points (n, k) of a design.

    Parameters
    ----------
    check : further points (m, k) and the values there (m, Q), to see what the polynomial misses

    Raises
    ------
    UsageError : fewer points than the polynomial has terms.

    A quantity without variance has NaN.
    """
    z, y = np.asarray(design, dtype=float), np.asarray(values, dtype=float)
    y = y[:, None] if y.ndim == 1 else y
    basis, members = _hermite(z)
    if len(basis) < basis.shape[1]:
        raise UsageError(f"{len(basis)} evaluations for {z.shape[1]} inputs", expected=f"{basis.shape[1]} and more")
    coefficients, *_ = np.linalg.lstsq(basis, y, rcond=None)
    squares = coefficients[1:] ** 2  # orthonormal: they sum to the variance
    variance = squares.sum(axis=0)
    moves = variance > 1e-24 * (1.0 + coefficients[0] ** 2)
    shares = np.where(moves, squares / np.where(moves, variance, 1.0), np.nan)
    alone = np.array([[m == (i,) for m in members] for i in range(z.shape[1])], dtype=float)
    joint = np.array([[i in m for m in members] for i in range(z.shape[1])], dtype=float)
    sd = np.sqrt(variance)
    misfit = np.full(y.shape[1], np.nan)
    if check is not None:
        there = np.asarray(check[1], dtype=float)
        off = (there[:, None] if there.ndim == 1 else there) - _hermite(np.asarray(check[0], float))[
            0
        ] @ coefficients
        misfit = np.where(moves, np.sqrt(np.mean(off**2, axis=0)) / np.where(moves, sd, 1.0), np.nan)
    return Indices((alone @ shares).T, (joint @ shares).T, sd, misfit)


def _hermite(z: Array) -> tuple[Array, list[tuple[int, ...]]]:
    """Orthonormal Hermite polynomials to degree two (n, P), and which inputs each one but the first holds."""
    k = z.shape[1]
    columns: list[Array] = [np.ones(len(z))]
    members: list[tuple[int, ...]] = []
    for i in range(k):
        columns += [z[:, i], (z[:, i] ** 2 - 1.0) / np.sqrt(2.0)]
        members += [(i,), (i,)]
    for i, j in combinations(range(k), 2):
        columns.append(z[:, i] * z[:, j])
        members.append((i, j))
    return np.stack(columns, axis=1), members
