"""What no formula can answer is refused in words, beside the nearest thing that it can."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from hyperval.errors import UsageError
from hyperval.model import (
    ClassLaw,
    clopper_pearson,
    correlation_filter,
    feature_bands,
    minimum_noise_fraction,
    principal_components,
    with_distances,
)
from hyperval.processing import MeasuredPanel, fit_elm
from hyperval.processing.detectors import pixel_detector, register_detector
from hyperval.processing.objects import footprint, with_halo
from hyperval.processing.roc import average_roc, empirical_roc, pooled_roc
from hyperval.processing.sample import EigenDirections
from hyperval.processing.wavelength_check import FEATURES, absorption_centre

EYE = np.eye(3)


def panel(name="white", rho=0.6, sd=0.01, variance=1e-4, n=30, bands=3):
    full = np.full(bands, rho)
    return MeasuredPanel(name, full, np.full(bands, sd**2), 10.0 * full, np.full(bands, variance), n)


def line_with(**white):
    """The line through a black panel and a white one of which something is wrong."""
    return fit_elm((replace(panel(), **white), panel("black", 0.05)))


def curve(pfa=(1e-2, 1e-1)):
    made = empirical_roc(np.linspace(1.0, 3.0, 30), np.linspace(-2.0, 2.0, 2000))
    at = np.array([int(np.argmin(np.abs(made.pfa - p))) for p in pfa])
    return replace(made, pfa=made.pfa[at], pd=made.pd[at], pd_lower=made.pd_lower[at], pd_upper=made.pd_upper[at])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: with_halo(EYE > 0, -1), "halo of -1 pixels"),
        (lambda: footprint(np.zeros((3, 3), bool), 2), "the object holds no pixel"),
        (lambda: correlation_filter(np.zeros(3), EYE), "the target spectrum is zero in every band"),
        (lambda: pixel_detector("sam", np.zeros(3), np.ones(3), None), "it has no direction"),
        (lambda: pixel_detector("cem", np.ones(3), np.zeros(3), None), "'cem' needs the covariance"),
        (lambda: pixel_detector("cem", None, np.zeros(3), EYE), "'cem' needs a target spectrum"),
        (lambda: pixel_detector("CEM", np.ones(3), np.zeros(3), EYE), "unknown detector 'CEM'"),
        (lambda: register_detector("My detector", lambda *a: None), "detector name 'My detector'"),
        (lambda: register_detector("cem", lambda *a: None), "there is a detector 'cem' already"),
        (lambda: feature_bands(np.arange(3.0), np.zeros(3, bool), ()), "no usable band for classification"),
        (lambda: principal_components(EYE, 0), "0 principal components of 3 bands"),
        (lambda: principal_components(EYE, 4), "4 principal components of 3 bands"),
        (lambda: minimum_noise_fraction(EYE, np.array([1.0, 0.0, 1.0]), 1), "need noise in every band"),
        (lambda: EigenDirections.of(np.zeros((3, 3))), "a covariance without variance has no eigenvalues"),
        (lambda: with_distances(None, [ClassLaw("a", np.zeros(3), EYE)]), "classification needs two classes"),
        (lambda: line_with(reflectance_error=-np.ones(3)), "panel 'white': a variance is negative"),
        (lambda: line_with(radiance_error=-np.ones(3)), "panel 'white': a variance is negative"),
        (lambda: line_with(n=0), "panel 'white' has no pixels"),
        (lambda: line_with(radiance=np.full(3, np.nan)), "panel 'white' holds NaN or infinity"),
        (lambda: replace(panel(), radiance=np.ones(2)), r"radiance has shape \(2,\), reflectance \(3,\)"),
        (lambda: fit_elm((panel(),)), "1 panel for an empirical line"),
        (lambda: fit_elm((panel(), panel("black", 0.05, bands=2))), "the panels have different numbers of bands"),
        (lambda: pooled_roc([]), "no curve to pool"),
        (lambda: pooled_roc([curve(), replace(curve(), unit="object")]), "that count the same thing"),
        (lambda: pooled_roc([curve(), replace(curve(), n_target=None)]), "only measured curves"),
        (lambda: pooled_roc([curve((1e-2,)), curve((1e-1,))]), "no false-alarm probability in common"),
        (lambda: average_roc([], []), "no curve to average"),
        (lambda: average_roc([curve()], [1.0, 1.0]), "weights that do not fit"),
        (lambda: average_roc([curve()], [0.0]), "weights that do not fit"),
        (lambda: average_roc([curve(), curve((1e-2,))], [1.0, 1.0]), "on different false-alarm probabilities"),
    ],
)
def test_what_has_no_answer_is_refused(call, words):
    with pytest.raises(UsageError, match=words):
        call()


def test_what_lies_beside_it_has_one():
    assert with_halo(EYE > 0, 0).tolist() == (EYE > 0).tolist()
    assert with_halo(EYE > 0, 2).all()
    assert feature_bands(np.arange(3.0), np.array([True, False, True]), ()).tolist() == [0, 2]
    assert principal_components(np.diag([1.0, 3.0, 2.0]), 3).tolist() == [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
    assert EigenDirections.of(np.diag([0.0, 2.0, 0.0])).values.tolist() == [2.0]
    assert fit_elm((panel(), panel("black", 0.05))).reflectance(np.full(3, 3.0)) == pytest.approx(np.full(3, 0.3))


def test_an_average_and_a_pool_of_equal_curves_is_the_curve():
    one = curve()
    assert average_roc([one, one], [1.0, 3.0]).pd == pytest.approx(one.pd)
    pooled = pooled_roc([one, one])
    assert pooled.pd == pytest.approx(one.pd)
    assert pooled.n_target == 60
    assert np.all(pooled.pd_upper - pooled.pd_lower < one.pd_upper - one.pd_lower)


NM = np.arange(740.0, 790.0, 2.5)


def dip(nm=NM, centre=762.9, depth=0.4):
    return 10.0 * (1.0 - depth * np.exp(-0.5 * ((nm - centre) / 4.0) ** 2))


@pytest.mark.parametrize(
    ("nm", "radiance", "found"),
    [
        (NM, dip(), True),
        (NM, dip(centre=765.0), True),
        (NM, np.full(NM.size, 10.0), False),  # nothing is absorbed
        (NM, dip(depth=-0.4), False),  # light in place of its lack
        (NM[NM < 765.0], dip(NM[NM < 765.0]), False),  # no shoulder after it
        (NM[NM > 762.0], dip(NM[NM > 762.0]), False),  # none before it
        (NM[::8], dip(NM[::8]), False),  # too few bands
        (np.delete(NM, slice(8, 11)), np.delete(dip(), slice(8, 11)), False),  # bands left out hide the centre
    ],
)
def test_an_absorption_has_a_centre_where_all_of_it_is_seen(nm, radiance, found):
    centre, depth = absorption_centre(nm, radiance, FEATURES[0])
    assert np.isfinite(centre) == found
    if found:
        assert depth > 0.3
        assert centre == pytest.approx(nm[np.argmin(radiance)], abs=2.5)


def test_words_name_what_is_expected():
    with pytest.raises(UsageError) as caught:
        clopper_pearson(1, 2, 95.0)
    assert re.search(r"expected: a number between 0 and 1", str(caught.value))
