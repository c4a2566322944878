"""Compared quantities: which curves are looked at, and the errors of what was measured."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from hyperval.products import (
    EstimatedPart,
    ObservedProducts,
    PredictedProducts,
    RocCurve,
    ScoreDistribution,
    SpectralEstimate,
)
from hyperval.spectra import SpectralAxis
from hyperval.uncertainty.attribution.residuals import (
    LEAST_ALARMS,
    LOG_FLOOR,
    SCORE_FLOOR,
    ComparedQuantity,
    _false_alarms,
    _moments,
    _snr,
    quantities,
    sampled_covariance,
)
from hyperval.uncertainty.attribution.run import gaps_of

AXIS = SpectralAxis(np.array([500.0, 600.0]), np.full(2, 10.0))
PFA = np.array([1e-4, 1e-3, 1e-2, 0.1, 1.0])
PIXEL, OBJECT, ALONE = ("p", "cem", "pixel"), ("p", "cem", "object"), ("q", "cem", "pixel")


def curve(n: int | None = None) -> RocCurve:
    return RocCurve(PFA, np.sqrt(PFA), np.sqrt(PFA), np.sqrt(PFA), -np.log10(PFA), n_background=n)


def test_curves_of_pixels_that_both_sides_have_are_compared():
    observed = ObservedProducts(AXIS, roc={PIXEL: curve(10_000), OBJECT: curve(10_000), ALONE: curve(10_000)})
    items = quantities(PredictedProducts(AXIS, roc={PIXEL: curve(), OBJECT: curve()}), observed)
    assert {(i.product, i.subject) for i in items} == {("roc", "p")}
    assert len(items) == 2
    assert quantities(PredictedProducts(AXIS), observed) == []


def test_spectra_are_compared_where_both_have_bands_and_some_light():
    def spectrum(*values: float) -> SpectralEstimate:
        return SpectralEstimate(np.array(values), np.eye(2))

    predicted = {"grass": spectrum(2.0, 4.0), "dark": spectrum(1.0, 1.0), "gaps": spectrum(np.nan, np.nan)}
    observed = {"grass": spectrum(1.0, 3.0), "dark": spectrum(0.0, 0.0), "gaps": spectrum(1.0, 1.0)}
    items = quantities(
        PredictedProducts(AXIS, radiance=predicted),
        ObservedProducts(AXIS, radiance=observed | {"x": observed["grass"]}),
    )
    (item,) = items
    assert (item.product, item.subject, item.metric, item.observed) == ("radiance", "grass", "ratio_windows", 1.0)
    assert item.read(PredictedProducts(AXIS, radiance=predicted)) == pytest.approx(3.0 / 2.0)


def test_gaps_are_of_what_both_sides_have():
    def quantity(product: str, metric: str, observed: float, value: float) -> ComparedQuantity:
        return ComparedQuantity(product, "p", "", metric, observed, lambda products: value)

    radiance = [quantity("radiance", "r", 1.0, v) for v in (1.1, 0.6, 1.2, np.nan)]
    rates = [quantity("roc", "pd@1e-2", o, v) for o, v in ((0.5, 0.7), (0.9, 0.8), (np.nan, 0.5))]
    gaps = gaps_of([*radiance, *rates, quantity("snr", "r", 0.0, 1.0)], PredictedProducts(AXIS))
    assert gaps == pytest.approx({"median |radiance difference ratio|": 0.2, "mean |pd@1e-2 difference|": 0.15})


def test_a_rate_counts_from_the_least_number_of_alarms_on():
    predicted = PredictedProducts(AXIS, roc={PIXEL: curve()})
    just = 100 * LEAST_ALARMS
    (block,) = _false_alarms(predicted, ObservedProducts(AXIS, roc={PIXEL: curve(just)}))
    assert block.observed.size == 1
    assert _false_alarms(predicted, ObservedProducts(AXIS, roc={PIXEL: curve(just - 1)})) == []


def test_the_error_of_a_measured_snr_is_relative_and_has_its_floor():
    predicted = PredictedProducts(AXIS, snr={"p": SpectralEstimate(np.array([90.0, 60.0]), np.zeros((2, 2)))})
    measured = SpectralEstimate(np.array([100.0, 50.0]), np.diag([9.0, 4.0]))
    (block,) = _snr("p", predicted, measured)
    np.testing.assert_allclose(block.observed, np.log([100.0, 50.0]))
    assert np.diag(block.covariance) == pytest.approx([0.03**2 + LOG_FLOOR**2, 0.04**2 + LOG_FLOOR**2])
    np.testing.assert_allclose(block.read(predicted), np.log([90.0, 60.0]))
    assert _snr("elsewhere", predicted, measured) == []


def test_moments_of_scores_have_the_variances_of_normal_ones():
    block = _moments("p", "cem", ScoreDistribution(0.4, 0.2, n=5))
    variances = [0.2**2 / 5 + SCORE_FLOOR**2, 0.5 / 4 + LOG_FLOOR**2]
    assert np.diag(block.covariance) == pytest.approx(variances)


@pytest.mark.parametrize(("pixels", "bands", "known"), [(36, 16, 0.0), (36, 16, 1.0), (200, 16, 0.0), (30, 3, 0.1)])
def test_few_pixels_reject_a_right_model_at_their_level(pixels, bands, known):
    """A mean lies beyond the 95 % point of chi-square in 5 %; unwidened, in 53 % of regions of 36 pixels, 16 bands."""
    rng, beyond, eye = np.random.default_rng(3), [], np.eye(bands)
    for x in rng.standard_normal((2000, pixels, bands)):
        part = EstimatedPart(np.cov(x.T) / pixels, pixels - 1.0)
        mean = x.mean(axis=0) + rng.standard_normal(bands) * np.sqrt(known / pixels)
        spectrum = SpectralEstimate(mean, part.covariance + known / pixels * eye, estimated=(part,))
        covariance = sampled_covariance(spectrum, np.ones(bands, dtype=bool), 1e-12 * eye)
        beyond.append(mean @ np.linalg.solve(covariance, mean) > stats.chi2.isf(0.05, bands))
    assert 0.03 < np.mean(beyond) < 0.07
