"""Packed symmetric matrices against whole ones."""

import numpy as np
import pytest

from hyperval.model import (
    condition_number,
    factor,
    near_singular,
    packed,
    solved,
)

SIZES = [1, 2, 3, 8, 9, 60]  # odd and even ones are laid out differently


def positive(size: int, seed: int = 0) -> np.ndarray:
    a = np.random.default_rng(seed).normal(size=(size, size + 4))
    return a @ a.T


@pytest.mark.parametrize("size", SIZES)
def test_solutions_and_condition_number(size):
    matrix = positive(size) * np.outer(*[np.geomspace(1.0, 1e4, size)] * 2)
    values, right = packed(matrix), np.random.default_rng(2).normal(size=(size, 2))
    cholesky = factor(values.copy(), size)
    assert cholesky is not None
    assert solved(cholesky, right) == pytest.approx(np.linalg.solve(matrix, right), rel=1e-6)
    scale = 1.0 / np.sqrt(np.diag(matrix))
    # LAPACK's estimate is a lower bound, nearly always within a factor of three.
    ratio = condition_number(values, cholesky, size) / np.linalg.cond(matrix * np.outer(scale, scale), 1)
    assert 0.33 < ratio < 1 + 1e-9


@pytest.mark.parametrize(("correlation", "suspect"), [(0.5, False), (1 - 1e-10, True)])
def test_pivots_tell_matrices_that_may_be_near_singular(correlation, suspect):
    matrix = np.array([[1.0, correlation], [correlation, 1.0]]) * np.outer([1.0, 1e6], [1.0, 1e6])
    values = packed(matrix)
    cholesky = factor(values.copy(), 2)
    assert near_singular(np.diag(matrix), cholesky) is suspect
    expected = (1 + correlation) / (1 - correlation)
    assert condition_number(values, cholesky, 2) == pytest.approx(expected, rel=1e-5)
