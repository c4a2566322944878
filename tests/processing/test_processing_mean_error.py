"""Error of the mean of pixels that resemble their neighbours, and of an empirical line between bands."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.compare import chi_square_full, chi_square_shape, covariance_dof
from hyperval.processing import (
    MeasuredPanel,
    components,
    fit_elm,
    independent_pixels,
    mean_error_covariance,
    neighbour_shares,
    small_sample_factor,
)
from hyperval.products import EstimatedPart
from hyperval.simulate.surface import correlated_field

SIDE, REACH = 40, 24


def _fields(correlation: float, count: int, rng: np.random.Generator) -> np.ndarray:
    wide = SIDE + 60
    return np.stack([correlated_field((wide, wide), correlation, rng)[30:-30, 30:-30] for _ in range(count)]).astype(
        float
    )


@pytest.mark.parametrize(("correlation", "tolerance"), [(0.0, 0.2), (3.0, 0.25), (5.0, 0.3)])
def test_independent_pixels_give_the_spread_of_the_mean(correlation, tolerance):
    # 150 fields: the sd of the means is known to 5.8 %, 20 % is 3.5 of that: false failure below 1e-3; correlated
    # fields of this size also have a bias of their own, which the wider limit allows for.
    rng = np.random.default_rng(4)
    inside = np.ones((SIDE, SIDE), bool)
    shares = neighbour_shares(inside, REACH, rng)
    fields = _fields(correlation, 150, rng)
    stated = []
    for f in fields:
        n, _ = independent_pixels([((f - f.mean())[None], inside)], shares, f.size, REACH)
        stated.append(f.var(ddof=1) / n[0])
    assert np.sqrt(np.mean(stated)) == pytest.approx(fields.mean(axis=(1, 2)).std(), rel=tolerance)


@pytest.mark.parametrize(("side", "correlation"), [(12, 4.0), (10, 4.0), (8, 2.0), (20, 4.0), (24, 6.0)])
def test_intervals_of_regions_of_a_few_patches_hold_the_truth(side, correlation):
    # 300 fields: a share of 95 % has a standard error of 1.3 %; 90 % is what a coverage of 94 % falls below once in
    # a thousand.  Before, 77 % (10, 4), 78 % (12, 4), 85 % (8, 2), 87 % (24, 6) and 89 % (20, 4).
    rng = np.random.default_rng(17)
    inside, reach = np.ones((side, side), bool), min(REACH, side - 1)
    shares = neighbour_shares(inside, reach, rng)
    gap = int(side + 6 * correlation)  # so far apart, cuts of one field are independent
    held = count = 0
    while count < 300:
        wide = correlated_field((4 * side + 140, 4 * side + 140), correlation, rng)
        for line in range(20, wide.shape[0] - side - 20, gap):
            for sample in range(20, wide.shape[1] - side - 20, gap):
                f = wide[line : line + side, sample : sample + side].astype(float)
                n, _ = independent_pixels([((f - f.mean())[None], inside)], shares, f.size, reach)
                u = f.std(ddof=1) * np.sqrt(small_sample_factor(n[0]) / n[0])
                held += abs(f.mean()) <= 1.959964 * u
                count += 1
    assert held / count > 0.90


def test_small_samples_are_widened_and_large_ones_are_not():
    assert small_sample_factor(1e6) == pytest.approx(1.0, abs=1e-5)
    # Half of 22, less 1: the t of ten degrees of freedom is 2.228 (tables).
    assert small_sample_factor(22.0) == pytest.approx((2.228 / 1.960) ** 2, rel=1e-3)
    assert small_sample_factor(1.0) == small_sample_factor(4.0)


def test_white_noise_counts_every_pixel_and_components_add_up():
    rng = np.random.default_rng(6)
    pixels = rng.standard_normal((SIDE, SIDE, 30)) @ np.diag(np.linspace(0.1, 1.0, 30))
    covariance = np.cov(pixels.reshape(-1, 30).T)
    along = components(covariance, rng, count=5)
    inside = np.ones((SIDE, SIDE), bool)
    scores = along.scores(pixels - pixels.mean(axis=(0, 1)))
    np.testing.assert_allclose(scores.reshape(scores.shape[0], -1).var(axis=1), 1.0, rtol=1e-3)
    n, of_variance = independent_pixels([(scores, inside)], neighbour_shares(inside, REACH, rng), SIDE**2, REACH)
    assert np.all(n > 0.75 * SIDE**2)
    assert np.all(of_variance > 0.95 * SIDE**2)
    exact = mean_error_covariance(covariance, along, np.full(n.size, float(SIDE**2)))
    np.testing.assert_allclose(exact, covariance / SIDE**2, rtol=1e-9, atol=1e-12)


def test_a_covariance_of_few_directions_has_no_other_components():
    along = components(np.diag([4.0, 1.0, 0.0]), np.random.default_rng(1), count=2)
    assert along.rest.shape == (3, 0)
    np.testing.assert_allclose(along.values, [4.0, 1.0])
    np.testing.assert_allclose(along.scores(np.array([[[2.0, 1.0, 0.0]]]))[:, 0, 0] ** 2, [1.0, 1.0])


def _panels(bands: int = 6):
    rho = (np.full(bands, 0.1), np.full(bands, 0.6))
    gain, offset = np.linspace(10, 20, bands), np.linspace(1, 2, bands)
    made = [
        MeasuredPanel(name, r, np.outer(0.02 * r, 0.02 * r), offset + gain * r, (0.01 * gain) ** 2, 100)
        for name, r in zip(("dark", "bright"), rho, strict=True)
    ]
    return made, gain, offset


def test_line_of_two_panels_has_the_variance_of_the_closed_form_and_the_correlation_of_its_panels():
    panels, gain, offset = _panels()
    found = fit_elm(panels)
    rho = np.full(6, 0.3)
    level = offset + gain * rho
    c = found.error_covariance(level)
    of = found.covariance
    variance = (rho**2 * of[:, 0, 0] + 2.0 * rho * of[:, 0, 1] + of[:, 1, 1]) / found.gain**2
    np.testing.assert_allclose(np.diag(c), variance, rtol=1e-4)
    # By hand: weights (0.6 - 0.3) / 0.5 and (0.3 - 0.1) / 0.5 of the two panels' errors.
    systematic = (0.6 * 0.02 * 0.1) ** 2 + (0.4 * 0.02 * 0.6) ** 2
    np.testing.assert_allclose(c[0, 1], systematic, rtol=1e-4)
    np.testing.assert_allclose(c[0, 0] - c[0, 1], (0.6**2 + 0.4**2) * 0.01**2, rtol=1e-4)


def test_a_panel_of_the_line_keeps_the_error_of_its_reflectance_alone():
    panels, _, _ = _panels()
    found = fit_elm(panels)
    c = found.error_covariance(panels[1].radiance, own="bright")
    np.testing.assert_allclose(c, (0.02 * 0.6) ** 2, rtol=1e-3)


@pytest.mark.slow
def test_line_through_three_panels_against_draws():
    # 4,000 draws of panels with errors common to all bands; a variance is known to 2.2 %, 4.5 of that is 10 %.  The
    # covariance of two bands is a third of their variances: known to 7 %, and 4.5 of that is 32 %.
    rng = np.random.default_rng(8)
    panels, gain, offset = _panels()
    grey = np.full(6, 0.35)
    panels.append(
        MeasuredPanel("grey", grey, np.outer(0.02 * grey, 0.02 * grey), offset + gain * grey, (0.01 * gain) ** 2, 100)
    )
    level = offset + gain * 0.25
    stated = fit_elm(panels).error_covariance(level)
    draws = []
    for _ in range(4000):
        moved = [
            MeasuredPanel(
                p.name, p.reflectance * (1 + 0.02 * rng.standard_normal()), p.reflectance_error,
                p.radiance + 0.01 * gain * rng.standard_normal(6), p.radiance_error, p.n,
            )
            for p in panels
        ]  # fmt: skip
        draws.append(fit_elm(moved).reflectance(level))
    drawn = np.cov(np.array(draws).T)
    np.testing.assert_allclose(np.diag(drawn), np.diag(stated), rtol=0.1)
    np.testing.assert_allclose(drawn[0, 1:], stated[0, 1:], rtol=0.32)


@pytest.mark.simulation
def test_consistency_with_a_covariance_from_few_samples_rejects_as_often_as_stated():
    # 2,000 draws, 60 samples in 8 bands beside a known part: rejections binomial(2000, 0.05), sd 0.5 %; within 3 sd
    # for the F test, false failure 0.3 %; the chi-square test rejects clearly more.
    rng = np.random.default_rng(12)
    p, n = 8, 30
    root = np.eye(p) + 0.3 * rng.standard_normal((p, p))
    known = 0.2 * np.eye(p)
    with_f, with_chi2 = 0, 0
    for _ in range(2000):
        x = rng.standard_normal((n, p)) @ root
        part = np.cov(x.T)
        r = rng.standard_normal(p) @ root + np.sqrt(0.2) * rng.standard_normal(p)
        with_f += chi_square_full(r, known + part, [EstimatedPart(part, n - 1.0)]).p_value < 0.05
        with_chi2 += chi_square_full(r, known + part).p_value < 0.05
    assert with_f / 2000 == pytest.approx(0.05, abs=0.02)
    assert with_chi2 / 2000 > 0.08


def test_degrees_of_freedom_of_a_covariance():
    eye = np.eye(5)
    assert covariance_dof([]) == np.inf
    assert covariance_dof([(eye, 40.0)]) == pytest.approx(40.0)  # all of it estimated: its own
    assert covariance_dof([(0.1 * eye, 40.0)]) == pytest.approx(4000.0)  # a tenth: (1/0.1)^2 times as many
    # Half from each of two samples in one dimension: Welch and Satterthwaite.
    one = np.eye(1)
    assert covariance_dof([(0.5 * one, 10.0), (0.5 * one, 30.0)]) == pytest.approx(1.0 / (0.25 / 10 + 0.25 / 30))


def test_directions_are_left_out_until_the_covariance_is_known_well_enough():
    rng = np.random.default_rng(3)
    c = np.diag(np.linspace(1.0, 2.0, 10))
    c[0, 1] = c[1, 0] = 0.9
    r = rng.standard_normal(10)
    some = chi_square_full(r, c, [EstimatedPart(c, 12.0)])
    assert (some.dof, some.covariance_dof) == (4, pytest.approx(12.0))
    assert 0.0 < some.p_value < 1.0
    shape = chi_square_shape(r, np.ones(10), c, [EstimatedPart(c, 12.0)])
    assert (shape.dof, shape.covariance_dof) == (3, pytest.approx(12.0))
    assert 0.0 < shape.value < some.value
