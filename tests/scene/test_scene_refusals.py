"""Statistics and fills that cannot be are refused, and what the limits of a fill do."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.data import ClassStatistics
from hyperval.errors import UsageError
from hyperval.model import FillDistribution, beta_fill, fixed_fill
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


@pytest.mark.parametrize("covariance", [np.zeros((2, 2)), np.ones((2, 2)), COVARIANCE])
def test_a_class_without_spread_or_of_one_direction_is_one(covariance):
    made = ClassStatistics("panel", AXIS, np.array(MEAN), np.array(covariance), tail_dof=2.1)
    assert made.mean.tolist() == MEAN
    assert made.covariance.tolist() == np.asarray(covariance).tolist()


@pytest.mark.parametrize(("mean", "sd"), [(0.0, 0.1), (1.0, 0.1), (0.5, 0.5), (0.5, 0.6), (0.1, 0.31)])
def test_moments_that_no_fill_has_are_refused(mean, sd):
    with pytest.raises(UsageError, match="no fill fraction between 0 and 1 has mean"):
        beta_fill(mean, sd)


@pytest.mark.parametrize(("mean", "sd"), [(0.3, 0.1), (0.5, 0.2), (0.1, 0.02)])
def test_a_fill_has_the_moments_that_were_asked_for(mean, sd):
    made = beta_fill(mean, sd)
    assert (made.mean, made.variance) == pytest.approx((mean, sd**2), rel=1e-12)
    assert (made.values.min() > 0, made.values.max() < 1) == (True, True)


def test_a_fill_without_spread_is_one_value():
    assert vars(beta_fill(0.3, 0.0)) == vars(fixed_fill(0.3))
    assert (fixed_fill(0.3).mean, fixed_fill(0.3).variance) == (0.3, 0.0)


def test_binning_keeps_few_values_and_equal_ones_as_they_are_and_the_mean_of_many():
    few, equal = (
        FillDistribution(np.array([0.1, 0.9]), np.full(2, 0.5)),
        FillDistribution(np.ones(9), np.full(9, 1 / 9)),
    )
    assert few.binned(2) is few
    assert equal.binned(2) is equal
    many = FillDistribution(np.array([0.0, 0.1, 0.2, 1.0]), np.array([0.1, 0.2, 0.3, 0.4]))
    two = many.binned(2)
    assert two.values == pytest.approx([0.08 / 0.6, 1.0])  # 0.1*0 + 0.2*0.1 + 0.3*0.2 over 0.6
    assert two.weights == pytest.approx([0.6, 0.4])
    assert many.binned(10).values == pytest.approx([0.0, 0.1, 0.2, 1.0])  # empty bins are none
