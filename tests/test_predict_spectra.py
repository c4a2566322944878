"""Spectra of files on the bands of a prediction."""

from __future__ import annotations

import numpy as np

from hyperval.model.surfaces import in_bands
from hyperval.spectra import SpectralAxis, band_average

AXIS = SpectralAxis(np.arange(420.0, 900.0, 3.6), 4.8)


def test_a_library_at_the_bands_own_centres_is_taken_as_it_stands():
    values = np.sin(AXIS.centre_nm / 7.0)
    assert np.array_equal(in_bands(AXIS.centre_nm + 0.01, values, AXIS), values)


def test_a_library_that_lacks_some_bands_is_taken_as_it_stands_in_the_others():
    values, there = np.sin(AXIS.centre_nm / 7.0), np.ones(len(AXIS), bool)
    there[[0, 5, 6, len(AXIS) - 1]] = False
    found = in_bands(AXIS.centre_nm[there], values[there], AXIS)
    assert np.array_equal(found[there], values[there])
    assert np.isnan(found[~there]).all()


def test_any_other_sampling_is_averaged_over_the_responses():
    grid = np.arange(400.0, 950.0, 1.0)
    values = np.sin(grid / 7.0)
    assert np.array_equal(in_bands(grid, values, AXIS), band_average(grid, values, AXIS))
    shifted = in_bands(AXIS.centre_nm + 1.0, np.sin((AXIS.centre_nm + 1.0) / 7.0), AXIS)
    assert not np.array_equal(shifted, np.sin((AXIS.centre_nm + 1.0) / 7.0))
