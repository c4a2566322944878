"""Predicted areas by unmixing: against the linear error, and its limits."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from hyperval.model import Origins, UnmixedSubject, predicted_areas, predicted_classification
from hyperval.products import PixelDistribution, PredictedProducts, SpectralEstimate
from hyperval.scenario import Scenario
from hyperval.spectra import SpectralAxis

AXIS = SpectralAxis(np.linspace(450.0, 900.0, 10), 10.0)
B = len(AXIS)
GRASS = np.linspace(0.05, 0.5, B)
SPREAD = 1e-4 * np.outer(GRASS, GRASS) + 1e-6 * np.eye(B)
DIRECTION = np.full(B, 0.3) - GRASS


def scenario(fill, pixels=1):
    target = {"name": "paint", "spectrum": {"constant": 0.3}, "host": "grass",
              "subjects": [{"name": "paint 1 m", "fill": fill}]}  # fmt: skip
    scene = {"classes": [{"name": "grass", "fraction": 1.0, "spectrum": {"constant": 0.2}}], "targets": [target]}
    return Scenario.model_validate({"name": "s", "scene": scene})


def predicted(fill, *, uncertainty=0.0, spread=SPREAD, method="fcls", covariances=None, draws=4000, truth=None,
              clusters=(), objects=1, ring=10**6):  # fmt: skip
    grass = SpectralEstimate(GRASS, np.zeros((B, B)), spread)
    prediction = PredictedProducts(
        AXIS, reflectance={"grass": grass}, distribution={"grass": PixelDistribution(clusters=clusters)}
    )
    words, error = ("paint 1 m", "paint 1 m", "paint"), (uncertainty, 300.0, "")
    subject = UnmixedSubject(*words, np.full(B, 0.3), *error, objects, 1.0, ring)
    found = predicted_areas(
        scenario(fill), Origins(AXIS), truth or {}, prediction, [subject], np.ones(B, bool),
        covariances or {"fcls": None}, 4.0, draws=draws,
    )  # fmt: skip
    return found["paint 1 m", method]


def test_spread_is_the_linear_error_where_no_limit_binds():
    area = predicted({"fixed": 0.4})
    gain = DIRECTION / (DIRECTION @ DIRECTION)  # of the fill, as least squares between two spectra give it
    error = 0.6**2 * gain @ SPREAD @ gain
    assert area.area_m2 == pytest.approx(1.6, abs=0.01)
    # A standard deviation of 4000 draws is known to 1.1 %, and so is that of the pool they are from: 5 % is three
    # of both.
    assert area.standard_uncertainty == pytest.approx(4.0 * np.sqrt(error), rel=0.05)
    # The mean of four objects, whose background is known by the three pixels around them.
    few = predicted({"fixed": 0.4}, objects=4, ring=3).standard_uncertainty
    assert few == pytest.approx(4.0 * np.sqrt(error * (1.0 + 1.0 / 3.0) / 4.0), rel=0.05)


def test_a_truth_with_another_fill_or_material_is_unmixed_with_the_endmembers_as_they_were():
    smaller = predicted({"fixed": 0.4}, truth={"fill.[paint 1 m]": 0.32})
    assert smaller.area_m2 == pytest.approx(4.0 * 0.32, abs=0.01)
    # A target a tenth of the way to the background looks like nine tenths of its area.
    greener = predicted({"fixed": 0.4}, truth={"surfaces.paint.mean": 0.3 + 0.1 * (GRASS - 0.3)})
    assert greener.area_m2 == pytest.approx(0.9 * 1.6, abs=0.01)


def test_an_empty_pixel_of_clusters_is_biased_by_each_of_them():
    # Two clusters along the target's direction, their mean that of the class: E[max(0, X)] of each, in closed form.
    ends, parts = np.array([-0.05, 0.45]), np.array([0.9, 0.1])
    clusters = [(p, f * DIRECTION, 0.25 * SPREAD, np.inf) for p, f in zip(parts, ends, strict=True)]
    gain = DIRECTION / (DIRECTION @ DIRECTION)
    sd = 0.5 * np.sqrt(gain @ SPREAD @ gain)
    expected = parts @ (ends * norm.cdf(ends / sd) + sd * norm.pdf(ends / sd))
    area = predicted({"fixed": 1e-9}, clusters=clusters, draws=40_000).area_m2
    # A share of a tenth of 40,000 draws from a pool of each is known to 0.0015: 3 % is two of it and more.
    assert area == pytest.approx(4.0 * expected, rel=0.03)


def test_whole_objects_have_their_own_fills():
    geometry = {"side_m": 1.0, "gsd_m": 2.0, "psf_fwhm_pixels": 0.5, "pixels": "ranked", "n": 9}
    area = predicted({"geometry": geometry}, spread=1e-12 * np.eye(B), draws=500)
    assert area.n == 9
    assert area.area_m2 == pytest.approx(1.0, abs=0.05)  # nearly all of the target lies in the nine best pixels


WIDE = 30.0 * SPREAD


def two_classes(spread=WIDE):
    means = {"grass": GRASS, "paint": GRASS + 0.02}
    spectra = {name: SpectralEstimate(mean, np.zeros((B, B)), spread) for name, mean in means.items()}
    return PredictedProducts(AXIS, radiance=spectra)


def test_two_classes_of_one_covariance_are_told_apart_by_their_distance():
    """The best one errs in Phi(-d / 2) of the pixels, d the Mahalanobis distance; false failure below 1e-4."""
    bands = SimpleNamespace(name="2 bands", bands_nm=[500.0, 850.0], pca=None)
    first = SimpleNamespace(name="all", bands_nm=[], pca=2)
    found = predicted_classification(two_classes(), [("grass", "paint")], [bands, first], "radiance")
    used = [int(np.argmin(np.abs(AXIS.centre_nm - nm))) for nm in bands.bands_nm]
    step = np.full(2, 0.02)
    exact = norm.cdf(-0.5 * np.sqrt(step @ np.linalg.solve(WIDE[np.ix_(used, used)], step)))
    error = found["grass / paint", "2 bands"]
    assert 0.001 < exact < 0.2
    assert abs(error.error - exact) < 4.0 * np.sqrt(exact * (1.0 - exact) / error.n)
    assert error.distance == pytest.approx(norm.ppf(exact) ** 2 / 2.0, rel=1e-6)  # Bhattacharyya's of one covariance
    assert set(found) == {("grass / paint", "2 bands"), ("grass / paint", "all")}
