"""Statistics and fills that cannot be are refused, and what the limits of a fill do."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.data import ClassStatistics
from hyperval.errors import UsageError
from hyperval.model import beta_fill
from hyperval.spectra import SpectralAxis

AXIS = SpectralAxis(np.array([500.0, 600.0]), np.full(2, 10.0))
MEAN, COVARIANCE = [0.1, 0.2], [[4e-4, 1e-4], [1e-4, 9e-4]]


@pytest.mark.parametrize(
    ("mean", "covariance", "tail_dof", "words"),
    [
        ([0.1], COVARIANCE, None, r"mean \(1,\) and covariance \(2, 2\) do not fit 2 bands"),
        (MEAN, [4e-4, 9e-4], None, r"mean \(2,\) and covariance \(2,\) do not fit 2 bands"),
        ([0.1, np.nan], COVARIANCE, None, "mean and covariance must be finite"),
        (MEAN, [[4e-4, np.inf], [np.inf, 9e-4]], None, "mean and covariance must be finite"),
        (MEAN, [[4e-4, 1e-4], [2e-4, 9e-4]], None, "the covariance is not symmetric"),
        (MEAN, [[4e-4, 7e-4], [7e-4, 9e-4]], None, "the covariance is not positive semi-definite"),
        (MEAN, COVARIANCE, 2.0, "tail_dof must exceed 2, got 2"),
        (MEAN, COVARIANCE, np.nan, "tail_dof must exceed 2, got nan"),
    ],
)
def test_statistics_that_are_none_are_refused_by_the_name_of_their_class(mean, covariance, tail_dof, words):
    with pytest.raises(UsageError, match=f"class 'grass': {words}"):
        ClassStatistics("grass", AXIS, np.array(mean), np.array(covariance), tail_dof=tail_dof)


@pytest.mark.parametrize(("mean", "sd"), [(0.0, 0.1), (1.0, 0.1), (0.5, 0.5), (0.5, 0.6), (0.1, 0.31)])
def test_moments_that_no_fill_has_are_refused(mean, sd):
    with pytest.raises(UsageError, match="no fill fraction between 0 and 1 has mean"):
        beta_fill(mean, sd)
