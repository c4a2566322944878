"""Agreement with PySptools, where it is installed: for development only (pip install pysptools).

Its detectors take all pixels that they score for the background, divisor n - 1 (n for CEM), and it inverts by
scipy.linalg.inv.  docs/detectors.md has the table of definitions.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from hyperval.processing import osp_filter, pixel_detector, whitener_of


@pytest.fixture(scope="module")
def peer():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it is older than some rules of Python's grammar
        try:
            from pysptools.detection import detect
        except ImportError as error:
            pytest.skip(f"PySptools is not installed ({error}); pip install pysptools")
    return detect


@pytest.fixture(scope="module")
def pixels():
    """(n, B) pixels in float64 of a background with strong correlation between bands, and a target."""
    rng = np.random.default_rng(0)
    bands = 12
    mixing = rng.normal(size=(bands, bands)) * np.geomspace(0.1, 0.001, bands)
    x = 0.3 + rng.normal(size=(600, bands)) @ mixing
    return x, 0.3 + 0.2 * np.sin(np.arange(bands))


def agree(ours, theirs, relative):
    return np.max(np.abs(ours - theirs)) <= relative * np.max(np.abs(theirs))


def test_matched_filter(peer, pixels):
    x, target = pixels
    ours = pixel_detector("cem", target, x.mean(axis=0), np.cov(x.T)).score(x)
    assert agree(ours, peer.MatchedFilter(x, target), 1e-9)


def test_cem_is_the_correlation_form(peer, pixels):
    x, target = pixels
    ours = pixel_detector("cem-correlation", target, x.mean(axis=0), np.cov(x.T, bias=True)).score(x)
    assert agree(ours, peer.CEM(x, target), 1e-9)


def test_ace_to_the_float32_that_it_returns(peer, pixels):
    x, target = pixels
    mean, covariance = x.mean(axis=0), np.cov(x.T)
    ours = pixel_detector("ace", target, mean, covariance).score(x, whitener_of(mean, covariance))
    assert agree(ours, peer.ACE(x, target), 1e-7)


def test_osp(peer, pixels, monkeypatch):
    x, target = pixels
    monkeypatch.setattr(np, "float", float, raising=False)  # it asks NumPy 2 for a name that went with 1.24
    undesired = x[:3]
    assert agree(x @ osp_filter(target, undesired).weights, peer.OSP(x, undesired, target), 1e-9)
