"""Detectors on pixels: equal to SPy where both define the same, closed forms and limits elsewhere, and traps."""

from __future__ import annotations

import numpy as np
import pytest
import spectral

from hyperval.errors import UsageError
from hyperval.processing import DETECTORS, osp_filter, pixel_detector, whitener_of

BANDS = 12


@pytest.fixture
def scene():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(500, BANDS)) @ rng.normal(size=(BANDS, BANDS)) + 10
    target = 1.2 * x[0] + rng.normal(size=BANDS)
    return x, target, x.mean(axis=0), np.cov(x.T)


def score(name, scene, undesired=None):
    x, target, mean, covariance = scene
    return pixel_detector(name, target, mean, covariance, undesired).score(x, whitener_of(mean, covariance))


def close(found, expected):
    return np.max(np.abs(found - expected)) <= 1e-9 * np.max(np.abs(expected))


def test_equal_to_spy(scene):
    x, target, mean, covariance = scene
    image, background = x.reshape(50, 10, BANDS), spectral.GaussianStats(mean, covariance)
    assert close(score("cem", scene), spectral.matched_filter(image, target, background).ravel())
    assert close(score("ace", scene), spectral.ace(image, target, background=background).ravel())
    assert close(score("rx", scene), spectral.rx(image, background=background).ravel())
    assert close(score("sam", scene), -spectral.spectral_angles(image, target[None]).ravel())


def test_equal_to_their_definitions(scene):
    # The formulas of the other public package (its float32 outputs and removed NumPy names left out).
    x, target, mean, covariance = scene
    inverse, d, z = np.linalg.inv(covariance), target - mean, x - mean
    assert close(score("matched-filter", scene), z @ inverse @ d / (d @ inverse @ d))
    r = x.T @ x / len(x)
    n = len(x)
    own = pixel_detector("cem-correlation", target, mean, covariance * (n - 1) / n).score(x)
    assert close(own, x @ np.linalg.inv(r) @ target / (target @ np.linalg.inv(r) @ target))
    u = x[5:8]
    p = np.eye(BANDS) - u.T @ np.linalg.pinv(u.T)
    assert close(score("osp", scene, u), x @ p @ target / (target @ p @ target))


def test_scales_and_limits(scene):
    x, target, mean, covariance = scene
    at = {n: pixel_detector(n, target, mean, covariance, x[5:8]) for n in DETECTORS}
    whitener = whitener_of(mean, covariance)
    both = np.stack([target, mean])
    assert at["cem"].score(both) == pytest.approx([1, 0], abs=1e-10)
    assert at["cem-correlation"].score(target) == pytest.approx(1)
    assert at["osp"].score(np.stack([target, x[6]])) == pytest.approx([1, 0], abs=1e-10)
    assert at["ace"].score(mean + 0.01 * (target - mean), whitener) == pytest.approx(1)
    assert at["sam"].score(3.0 * target) == pytest.approx(0, abs=1e-7)
    assert score("smf", scene).std(ddof=1) == pytest.approx(1)  # over the sample that gave the covariance
    assert score("rx", scene).mean() == pytest.approx(BANDS * (len(x) - 1) / len(x))
    assert np.all((score("ace", scene) >= 0) & (score("ace", scene) <= 1))
    # smf is the matched filter in other units, and ace the cosine of smf against rx.
    assert np.corrcoef(score("smf", scene), score("cem", scene))[0, 1] == pytest.approx(1)
    assert score("ace", scene) == pytest.approx(score("smf", scene) ** 2 / score("rx", scene))


def test_a_nan_pixel_is_nan_and_a_zero_pixel_has_no_angle(scene):
    _, target, mean, covariance = scene
    whitener = whitener_of(mean, covariance)
    bad = np.full(BANDS, 5.0)
    bad[3] = np.nan
    for name in DETECTORS:
        detector = pixel_detector(name, target, mean, covariance, np.ones((1, BANDS)))
        assert np.isnan(detector.score(bad, whitener)), name
    assert np.isnan(pixel_detector("sam", target, mean, covariance).score(np.zeros(BANDS)))
    assert np.isnan(pixel_detector("ace", target, mean, covariance).score(mean, whitener))


def test_undesired_spectra_that_depend_on_each_other(scene):
    x, target, _, _ = scene
    one, doubled = osp_filter(target, x[:2]), osp_filter(target, np.stack([x[0], x[1], x[0] + 2 * x[1]]))
    assert doubled.weights == pytest.approx(one.weights, rel=1e-9)
    with pytest.raises(UsageError, match="mixture of the undesired"):
        osp_filter(0.3 * x[0] + 0.7 * x[1], x[:2])
    with pytest.raises(UsageError, match="needs the spectra"):
        osp_filter(target, None)
    with pytest.raises(UsageError, match="11 bands"):
        osp_filter(target, x[:2, :11])


def test_a_pseudo_inverse_never_hides_a_lost_rank(scene):
    # 60 pixels of rank 58: the peers' pseudo-inverse gives plausible scores.
    x = np.random.default_rng(1).normal(size=(59, 60))
    for name in ("cem", "smf", "ace"):
        with pytest.raises(UsageError, match="rank 58 of 60"):
            pixel_detector(name, np.ones(60), x.mean(axis=0), np.cov(x.T))
    with pytest.raises(UsageError, match="rank 58 of 60"):
        whitener_of(x.mean(axis=0), np.cov(x.T))


def test_a_near_duplicate_band_is_refused(scene):
    x, target, _, _ = scene
    twice = np.hstack([x, x[:, :1] * (1 + 1e-9 * np.random.default_rng(2).normal(size=(500, 1)))])
    with pytest.raises(UsageError, match="singular to working precision"):
        pixel_detector("cem", np.append(target, target[0]), twice.mean(axis=0), np.cov(twice.T))


def test_target_pixels_in_the_covariance_spoil_the_filter():
    # 5 % of target pixels and a signature off by 4 %: the filter suppresses what it looks for.
    rng = np.random.default_rng(3)
    bands, n = 60, 8000
    background = rng.normal(size=(n, bands)) * 0.01 + 0.2
    true = 0.2 + 0.05 * np.sin(np.arange(bands) / 5)
    planted = np.vstack([background, true + rng.normal(size=(n // 20, bands)) * 0.01])
    signatures = true + 0.04 * 0.25 * np.cos(np.arange(bands) / 3)

    def separation(sample):
        w = pixel_detector("smf", signatures, sample.mean(axis=0), np.cov(sample.T))
        noise = w.score(background)
        return (w.score(true) - noise.mean()) / noise.std()

    clean = separation(background)
    assert clean > 20
    assert separation(planted) < 0.6 * clean


def test_what_cannot_be_made_is_refused(scene):
    x, target, mean, covariance = scene
    with pytest.raises(UsageError, match="unknown detector 'amf'"):
        pixel_detector("amf", target, mean, covariance)
    with pytest.raises(UsageError, match="needs a target"):
        pixel_detector("ace", None, mean, covariance)
    with pytest.raises(UsageError, match="needs the covariance"):
        pixel_detector("cem", target, mean, None)
    with pytest.raises(UsageError, match="no direction"):
        pixel_detector("sam", np.zeros(BANDS), mean, None)
    with pytest.raises(UsageError, match="whitener"):
        pixel_detector("rx", None, mean, covariance).score(x)
