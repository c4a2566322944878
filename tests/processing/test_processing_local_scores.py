"""Scores against a moving mean, pixel by pixel by brute force, and what must not change them."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from hyperval.collection import LocalWindowSource
from hyperval.errors import UsageError
from hyperval.imagery import open_cube, write_cube
from hyperval.processing import (
    LOCAL_DETECTORS,
    LocalWindow,
    MeasuredPanel,
    fit_elm,
    moving_means,
    pixel_detector,
    score_cube_locally,
    whitener_of,
)
from hyperval.processing import detectors as local_scores
from hyperval.spectra import SpectralAxis

LINES, SAMPLES, BANDS = 37, 29, 7
AXIS = SpectralAxis(np.linspace(450, 1650, BANDS), np.full(BANDS, 9.0))


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A radiance cube over a background that drifts, a line, an unused band, a pixel without data."""
    rng = np.random.default_rng(0)
    drift = np.linspace(0, 0.2, LINES)[:, None, None] * np.linspace(1, 2, BANDS)
    rho = 0.1 + drift + 0.02 * rng.normal(size=(LINES, SAMPLES, BANDS)) @ rng.normal(size=(BANDS, BANDS))
    gain, offset = np.linspace(20, 8, BANDS), np.linspace(3, 0.2, BANDS)
    radiance = offset + gain * rho
    radiance[5, 7] = -9999.0
    levels = [
        MeasuredPanel(n, np.full(BANDS, r), np.zeros(BANDS), offset + gain * r, np.zeros(BANDS), 9)
        for n, r in (("black", 0.05), ("white", 0.6))
    ]
    path = tmp_path_factory.mktemp("local") / "c.img"
    write_cube(path, radiance, data_type=5, axis=AXIS, ignore_value=-9999)
    cube = open_cube(path, quantity="radiance", unit="uW cm-2 sr-1 nm-1", check_values=False)
    bands = np.ones(BANDS, bool)
    bands[3] = False
    counted = np.ones((LINES, SAMPLES), bool)
    counted[20:23, 10:14] = False
    return cube, fit_elm(levels), rho, bands, counted


@pytest.mark.parametrize("window", [LocalWindow(9, 3), LocalWindow(5, 1), LocalWindow(101, 5)])
def test_every_detector_equals_its_definition_with_the_mean_of_its_own_window(scene, monkeypatch, window):
    cube, elm, rho, bands, counted = scene
    x = rho[..., bands]
    valid = np.ones((LINES, SAMPLES), bool)
    valid[5, 7] = False
    mean, covariance = x[valid].mean(axis=0), np.cov(x[valid].T)
    target = mean + np.linspace(0.05, 0.3, mean.size)
    detectors = {name: (name, None if name == "rx" else target) for name in LOCAL_DETECTORS}
    monkeypatch.setattr(local_scores, "_VALUES_AT_ONCE", 0)  # strips that end within the image
    found, _ = score_cube_locally(cube, detectors, whitener_of(mean, covariance), window, counted, elm, bands)
    use = counted & valid
    for line, sample in ((0, 0), (5, 8), (18, 14), (21, 12), (36, 28), (30, 0), (8, 19), (9, 20)):
        ring = np.zeros_like(use)
        for side, value in ((window.outer, True), (window.inner, False)):
            h = side // 2
            ring[max(line - h, 0) : line + h + 1, max(sample - h, 0) : sample + h + 1] = value
        pixels = x[ring & use]
        own = pixels.mean(axis=0) if len(pixels) >= 10 else mean
        for name in LOCAL_DETECTORS:
            detector = pixel_detector(name, None if name == "rx" else target, own, covariance)
            expected = detector.score(x[line, sample], whitener_of(own, covariance))
            assert found[name][line, sample] == pytest.approx(float(expected), rel=1e-9, abs=1e-10), name
    assert all(np.isnan(m[5, 7]) and np.isfinite(m).sum() == LINES * SAMPLES - 1 for m in found.values())


def test_tiles_and_threads_change_nothing(scene, monkeypatch):
    cube, elm, rho, bands, counted = scene
    x = rho[..., bands].reshape(-1, int(bands.sum()))
    whitener = whitener_of(x.mean(axis=0), np.cov(x.T))
    detectors = {"rx": ("rx", None), "ace": ("ace", x.mean(axis=0) + 0.1)}
    reference, _ = score_cube_locally(cube, detectors, whitener, LocalWindow(7, 3), counted, elm, bands, threads=1)
    monkeypatch.setattr(local_scores, "_VALUES_AT_ONCE", 0)
    monkeypatch.setattr(local_scores, "_LINES_AT_ONCE", 1)  # segments of 16 lines
    other, _ = score_cube_locally(cube, detectors, whitener, LocalWindow(7, 3), counted, elm, bands, threads=2)
    for name in detectors:
        assert other[name] == pytest.approx(reference[name], rel=1e-10, abs=1e-12, nan_ok=True)


def test_a_pixel_without_surroundings_takes_the_global_mean_and_is_counted(scene):
    cube, elm, rho, bands, _ = scene
    x = rho[..., bands].reshape(-1, int(bands.sum()))
    mean, covariance = x.mean(axis=0), np.cov(x.T)
    nobody = np.zeros((LINES, SAMPLES), bool)
    whitener = whitener_of(mean, covariance)
    found, lonely = score_cube_locally(cube, {"rx": ("rx", None)}, whitener, LocalWindow(7, 3), nobody, elm, bands)
    assert lonely == LINES * SAMPLES - 1
    expected = pixel_detector("rx", None, mean, covariance).score(rho[..., bands], whitener)
    assert found["rx"][0, 0] == pytest.approx(expected[0, 0], rel=1e-9)


def test_a_background_that_drifts_hides_less(scene):
    # The drift is most of the global spread: against their surroundings the pixels stand out of less.
    cube, elm, rho, bands, counted = scene
    x = rho[..., bands].reshape(-1, int(bands.sum()))
    whitener = whitener_of(x.mean(axis=0), np.cov(x.T))
    local, _ = score_cube_locally(cube, {"rx": ("rx", None)}, whitener, LocalWindow(9, 3), counted, elm, bands)
    globally = pixel_detector("rx", None, whitener.mean, np.cov(x.T)).score(rho[..., bands], whitener)
    inside = np.isfinite(local["rx"])
    assert local["rx"][inside].mean() < globally[inside].mean()


def moved(y, counted, window):
    """Means and numbers (lines, samples) of one channel."""
    size, half = y.shape[1], window.outer // 2
    empty = np.zeros((2, size)), np.zeros(size, bool), np.zeros(size, bool)
    lines = [(np.stack([row, np.ones(size)]), np.ones(size, bool), c) for row, c in zip(y, counted, strict=True)]
    out = list(moving_means([*[empty] * half, *lines, *[empty] * half], window))
    return np.concatenate([m for _, _, m, _ in out]), np.stack([n for *_, n in out])


def test_the_moving_mean_by_hand():
    y = np.arange(49.0).reshape(7, 7)
    counted = np.ones((7, 7), bool)
    mean, number = moved(y, counted, LocalWindow(5, 3))
    assert (number[3, 3], mean[3, 3]) == (16, 24.0)  # symmetric about the pixel
    assert (number[0, 0], mean[0, 0]) == (9 - 4, 0.0)  # five pixels are too few
    counted[3, 1] = False
    mean, number = moved(y, counted, LocalWindow(5, 3))
    assert (number[3, 3], mean[3, 3]) == (15, pytest.approx((16 * 24 - 22) / 15))
    counted[1, 1:6] = False  # ten are enough, nine are not
    mean, number = moved(y, counted, LocalWindow(5, 3))
    assert (number[3, 3], mean[3, 3]) == (10, pytest.approx((16 * 24 - 22 - 5 * 10) / 10))
    counted[5, 5] = False
    mean, number = moved(y, counted, LocalWindow(5, 3))
    assert (number[3, 3], mean[3, 3]) == (9, 0.0)


def test_what_makes_no_sense_is_refused(scene):
    cube, elm, _, bands, counted = scene
    for outer, inner in ((8, 3), (5, 5), (3, 5), (9, 2), (3, 1)):
        with pytest.raises(ValidationError, match="_pixels"):
            LocalWindowSource(outer_pixels=outer, inner_pixels=inner)
    w = whitener_of(np.zeros(6), np.eye(6))
    with pytest.raises(UsageError, match="no local form"):
        score_cube_locally(cube, {"a": ("sam", np.ones(6))}, w, LocalWindow(7, 3), counted, elm, bands)
    with pytest.raises(UsageError, match="6 bands"):
        score_cube_locally(cube, {"a": ("cem", np.ones(5))}, w, LocalWindow(7, 3), counted, elm, bands)
    with pytest.raises(UsageError, match="has shape"):
        score_cube_locally(cube, {"a": ("rx", None)}, w, LocalWindow(7, 3), counted[:3], elm, bands)
