"""How much of a quantity's variance each input brings, alone and together with the others.

Inputs are standard normal; the quantity is fitted by Hermite polynomials of degree two, whose squared coefficients
are the shares of the variance.  Source: Sudret, Reliab. Eng. Syst. Saf. 93, 964-979, 2008; indices: Sobol 1993,
Homma & Saltelli 1996.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt
from scipy import special
from scipy.stats import qmc

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
    predictivity : (Q,) 1 minus the leave-one-out error over the variance; far below 1 the indices mean little
    """

    first: Array
    total: Array
    standard_deviation: Array
    predictivity: Array


def normal_design(inputs: int, samples: int, seed: int) -> Array:
    """(samples, inputs) scrambled Sobol points through the normal quantile.

    Raises
    ------
    UsageError : fewer samples than a fit of degree two needs, twice over.
    """
    least = 2 * terms_of_degree_two(inputs)
    if samples < least:
        raise UsageError(f"{samples} samples for {inputs} inputs", expected=f"at least {least}")
    power = int(np.ceil(np.log2(samples)))
    points = qmc.Sobol(inputs, scramble=True, rng=np.random.default_rng(seed)).random_base2(power)[:samples]
    return np.asarray(special.ndtri(np.clip(points, 1e-12, 1 - 1e-12)))


def terms_of_degree_two(inputs: int) -> int:
    """Number of polynomials of degree two and less: (k + 1)(k + 2)/2."""
    return (inputs + 1) * (inputs + 2) // 2


def sensitivity_indices(design: npt.ArrayLike, values: npt.ArrayLike) -> Indices:
    """Indices of quantities (n, Q) evaluated at the points (n, k) of a normal design.

    A quantity without variance has NaN.
    """
    z, y = np.asarray(design, dtype=float), np.asarray(values, dtype=float)
    y = y[:, None] if y.ndim == 1 else y
    basis, members = _hermite(z)
    coefficients, *_ = np.linalg.lstsq(basis, y, rcond=None)
    squares = coefficients[1:] ** 2  # orthonormal: they sum to the variance
    variance = squares.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        shares = np.where(variance > 1e-24 * (1.0 + coefficients[0] ** 2), squares / variance, np.nan)
        alone = np.array([[m == (i,) for m in members] for i in range(z.shape[1])], dtype=float)
        joint = np.array([[i in m for m in members] for i in range(z.shape[1])], dtype=float)
        leverage = np.einsum("ij,ji->i", basis, np.linalg.pinv(basis))
        left_out = (y - basis @ coefficients) / (1.0 - leverage)[:, None]
        predictivity = 1.0 - np.mean(left_out**2, axis=0) / np.var(y, axis=0)
    return Indices((alone @ shares).T, (joint @ shares).T, np.sqrt(variance), predictivity)


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
