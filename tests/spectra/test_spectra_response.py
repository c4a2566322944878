"""Averages of spectra over bands."""

import numpy as np
import pytest

from hyperval.spectra import SIGMA_PER_FWHM, SpectralAxis, band_average


def by_brute_force(nm, values, centre, fwhm):
    """Mean of the straight lines between the samples under exp(-x^2 / 2) within 3 sigma, by 2e5 trapezia."""
    sigma = fwhm * SIGMA_PER_FWHM
    low, high = max(centre - 3 * sigma, nm[0]), min(centre + 3 * sigma, nm[-1])
    at = np.union1d(np.linspace(low, high, 200_001), nm[(nm > low) & (nm < high)])
    response = np.exp(-0.5 * ((at - centre) / sigma) ** 2)
    return np.trapezoid(response * np.interp(at, nm, values), at) / np.trapezoid(response, at)


@pytest.mark.parametrize("step", [0.02, 0.08, 1.0, 7.0])
def test_lines_of_a_hundredth_of_a_band_are_seen_whole(step):
    """Twelve points a width gave single bands of these up to 1.1 % too much."""
    rng = np.random.default_rng(4)
    nm = np.arange(380.0, 445.0, step)
    values = np.ones(nm.size)
    for at in rng.uniform(382.0, 438.0, 60):
        values -= 0.5 * np.exp(-0.5 * ((nm - at) / (0.08 * SIGMA_PER_FWHM)) ** 2)
    axis = SpectralAxis(np.array([384.0, 397.3, 410.0, 435.5]), np.array([5.5, 10.0, 0.5, 3.0]))
    want = [by_brute_force(nm, values, c, w) for c, w in zip(axis.centre_nm, axis.fwhm_nm, strict=True)]
    assert band_average(nm, values, axis) == pytest.approx(want, rel=1e-7)


def test_a_single_line_weighs_as_the_response_at_its_place():
    """Closed form: a triangle of 0.08 nm, and the area of the cut Gaussian, 0.9973 sqrt(2 pi) sigma."""
    nm = np.arange(390.0, 410.0, 0.08)
    at, axis = nm[110], SpectralAxis(np.array([400.0]), np.array([5.0]))
    sigma = 5.0 * SIGMA_PER_FWHM
    response = np.exp(-0.5 * ((at - 400.0) / sigma) ** 2) / (0.9973002 * np.sqrt(2.0 * np.pi) * sigma)
    assert band_average(nm, (nm == at) * 1.0, axis)[0] == pytest.approx(0.08 * response, rel=2e-4)


def test_a_band_narrower_than_the_samples_takes_the_line_between_them():
    nm = np.array([400.0, 410.0, 430.0])
    axis = SpectralAxis(np.array([402.0, 417.0]), np.array([0.1, 1.0]))
    assert band_average(nm, np.array([1.0, 2.0, 6.0]), axis) == pytest.approx([1.2, 3.4], rel=1e-12)


def test_what_reaches_beyond_the_samples_is_cut_by_up_to_half_a_width():
    nm = np.arange(400.0, 501.0)
    axis = SpectralAxis(np.array([395.0, 402.5, 450.0]), np.array([5.0, 5.0, 5.0]))
    got = band_average(nm, nm**2, axis, outside="nan")
    assert np.isnan(got[0])
    assert got[1:] == pytest.approx([by_brute_force(nm, nm**2, c, 5.0) for c in (402.5, 450.0)], rel=1e-9)
