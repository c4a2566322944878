"""Compared quantities: which curves are looked at, and the errors of what was measured."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from hyperval import compare, products
from hyperval.attribute import alarm_ratios, explain_ratio, quantities, sampled_covariance, stack_of
from hyperval.spectra import SpectralAxis

AXIS = SpectralAxis(np.array([500.0, 600.0]), np.full(2, 10.0))
PFA = np.array([1e-4, 1e-3, 1e-2, 0.1, 1.0])
PIXEL, OBJECT, ALONE = ("p", "cem", "pixel"), ("p", "cem", "object"), ("q", "cem", "pixel")


def curve(n: int | None = None) -> products.RocCurve:
    return products.RocCurve(PFA, np.sqrt(PFA), np.sqrt(PFA), np.sqrt(PFA), -np.log10(PFA), n_background=n)


def test_spectra_are_compared_where_both_have_bands_and_some_light():
    def spectrum(*values: float) -> products.SpectralEstimate:
        return products.SpectralEstimate(np.array(values), np.eye(2))

    predicted = {"grass": spectrum(2.0, 4.0), "dark": spectrum(1.0, 1.0), "gaps": spectrum(np.nan, np.nan)}
    observed = {"grass": spectrum(1.0, 3.0), "dark": spectrum(0.0, 0.0), "gaps": spectrum(1.0, 1.0)}
    told = products.PredictedProducts(AXIS, radiance=predicted)
    found = quantities(told, products.ObservedProducts(AXIS, radiance=observed | {"x": observed["grass"]}))
    assert found == {("radiance", "grass", "", "ratio_windows"): pytest.approx(3.0 / 2.0)}


def test_spectra_that_lose_light_or_stand_in_other_light():
    means = {"grass": [1.0, 3.0], "roof": [2.0, 2.0]}
    seen = {name: products.SpectralEstimate(np.array(mean), np.eye(2)) for name, mean in means.items()}
    stack = stack_of(products.PredictedProducts(AXIS, radiance=seen), products.ObservedProducts(AXIS, radiance=seen))
    assert stack.spectral_stray_light(stack.observed).tolist() == [1.0, -1.0, 0.0, 0.0]
    shade, _, cut = stack.subject_errors(np.array([1.0, 4.0, 2.0, 2.0])).items()
    assert (shade[0].name, shade[1][:, 0].tolist()) == ("light on grass", [-0.5, -2.0, 0.0, 0.0])  # half of the light
    assert (cut[0].labels, cut[1][:, 0].tolist()) == (("at 3",), [0.0, -1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("pixels", "bands", "known"),
    [(36, 16, 0.0), (36, 16, 1.0), pytest.param(200, 16, 0.0, marks=pytest.mark.slow), (30, 3, 0.1)],
)
def test_few_pixels_reject_a_right_model_at_their_level(pixels, bands, known):
    """A mean lies beyond the 95 % point of chi-square in 5 %; unwidened, in 53 % of regions of 36 pixels, 16 bands."""
    rng, beyond, eye = np.random.default_rng(3), [], np.eye(bands)
    for x in rng.standard_normal((2000, pixels, bands)):
        part = products.EstimatedPart(2.0 * (s := np.cov(x.T) / pixels), pixels - 1.0, s)  # wider, in single bands
        mean = x.mean(axis=0) + rng.standard_normal(bands) * np.sqrt(known / pixels)
        spectrum = products.SpectralEstimate(mean, part.covariance + known / pixels * eye, estimated=(part,))
        covariance = sampled_covariance(spectrum, np.ones(bands, dtype=bool), 1e-12 * eye)
        beyond.append(mean @ np.linalg.solve(covariance, mean) > stats.chi2.isf(0.05, bands))
    assert 0.03 < np.mean(beyond) < 0.07


def test_curves_of_pixels_that_both_sides_have_are_compared_from_twenty_alarms_on():
    """Rates of 1e-2 and of 1e-3, each where the background has twenty pixels above the threshold."""
    predicted = products.PredictedProducts(AXIS, roc={PIXEL: curve(), OBJECT: curve()})
    observed = products.ObservedProducts(AXIS, roc={key: curve(2000) for key in (PIXEL, OBJECT, ALONE)})
    curves = [("roc", "p", "cem/pixel", "pd@1e-2"), ("roc", "p", "cem/pixel", "pd@1e-3")]
    assert list(quantities(predicted, observed)) == curves
    (block,) = stack_of(predicted, observed).blocks
    assert block.observed == pytest.approx(np.log([1e-2]))
    assert stack_of(predicted, products.ObservedProducts(AXIS, roc={PIXEL: curve(1999)})).blocks == ()
    assert quantities(products.PredictedProducts(AXIS), observed) == {}


def test_the_errors_of_a_measured_snr_and_of_scores_have_their_floors():
    """Of an SNR relative; of the scores of n normal pixels s^2/n and, in the logarithm of s, 1/(2 (n - 1))."""
    predicted = products.PredictedProducts(
        AXIS,
        snr={"p": products.SpectralEstimate(np.array([90.0, 60.0]), np.zeros((2, 2)))},
        scores={("p", "cem"): products.ScoreDistribution(0.5, 0.1)},
    )
    measured = products.SpectralEstimate(np.array([100.0, 50.0]), np.diag([9.0, 4.0]))
    scores = {("p", "cem"): products.ScoreDistribution(0.4, 0.2, n=5)}
    snr, score = stack_of(
        predicted, products.ObservedProducts(AXIS, snr={"p": measured, "elsewhere": measured}, scores=scores)
    ).blocks
    assert np.exp([snr.observed, snr.read(predicted)]) == pytest.approx(np.array([[100.0, 50.0], [90.0, 60.0]]))
    assert np.diag(snr.covariance) == pytest.approx([0.03**2 + 0.02**2, 0.04**2 + 0.02**2])
    assert score.read(predicted) == pytest.approx([0.5, np.log(0.1)])
    assert np.diag(score.covariance) == pytest.approx([0.2**2 / 5 + 0.005**2, 0.5 / 4 + 0.02**2])


P = np.geomspace(0.5, 1e-5, 200)


def exceedance(threshold, p, n=None, width=2.0):
    return products.ExceedanceCurve(threshold, p, p / width, np.minimum(p * width, 1.0), n)


@pytest.mark.parametrize(("n", "levels"), [(50_000, ("1e-2", "1e-3")), (5_000, ("1e-2",))])
def test_ratios_of_false_alarms_are_those_of_two_laws_where_there_are_ten(n, levels):
    """Measured scores with the tails of a t, predicted ones normal: the nearest point of the grid is 3 % off."""
    told, measured = exceedance(stats.norm.isf(P), P), exceedance(stats.t.isf(P, 10.0), P, n)
    predicted = products.PredictedProducts(AXIS, exceedance={("roof", "cem"): told})
    observed = products.ObservedProducts(AXIS, exceedance={("roof", "cem"): measured})
    found = alarm_ratios(predicted, observed)
    assert list(found) == [("roof background", "cem", f"pfa_ratio@{level}") for level in levels]
    for level, ratio in zip(levels, found.values(), strict=True):
        assert ratio.value == pytest.approx(stats.norm.sf(stats.t.isf(float(level), 10.0)) / float(level), rel=0.3)
        assert ratio.lower < ratio.value < ratio.upper
    assert alarm_ratios(products.PredictedProducts(AXIS), observed) == {}


def test_objects_and_alarms_that_come_in_clusters_count_as_what_they_are():
    """Pixels of one object are one, and a rate is known as well as blocks of the image say, not as its count.

    Whatever a subject is called: it need not begin with the name of what is looked for.
    """
    key, n = ("roof planks", "cem"), 50_000
    draws = np.array([[0.8, 1.0], [1.2, 1.4]])
    rising = [products.RocCurve(P[::-1], P[::-1], P[::-1], P[::-1], t, n_background=n)
              for t in (stats.norm.isf(P[::-1]), stats.t.isf(P[::-1], 10.0))]  # fmt: skip
    predicted = products.PredictedProducts(
        AXIS, scores={key: products.ScoreDistribution(1.0, 0.3)}, object_scores={key: products.ObjectScores(draws)},
        roc={(*key, "pixel"): rising[0]},
    )  # fmt: skip
    observed = products.ObservedProducts(
        AXIS, scores={key: products.ScoreDistribution(0.9, 0.3, 40)},
        roc={(*key, "pixel"): replace(rising[1], design_effect=np.full(P.size, 12.0))},
        object_scores={key: products.ObjectScores(np.array([0.7, 0.9, np.nan]))},
    )  # fmt: skip
    objects, alarms = stack_of(predicted, observed).blocks
    assert objects.observed == pytest.approx([0.8])
    assert objects.read(predicted) == pytest.approx([1.1])
    assert objects.covariance == pytest.approx(np.array([[np.var(draws) / 2 + 0.005**2]]))
    assert np.exp(alarms.observed) == pytest.approx([1e-2, 1e-3])
    assert np.diag(alarms.covariance) == pytest.approx([12 / (p * n) for p in (1e-2, 1e-3)])
    assert np.exp(alarms.read(predicted)) == pytest.approx(stats.norm.sf(stats.t.isf([1e-2, 1e-3], 10.0)), rel=0.02)
    bare = stack_of(predicted, replace(observed, roc={(*key, "pixel"): rising[1]})).blocks[1]
    assert np.diag(bare.covariance) == pytest.approx([1 / (p * n) + 0.1**2 for p in (1e-2, 1e-3)])


def ratio(value, spread=1.2):
    return compare.row("pfa_ratio@1e-2", value, (value / spread, value * spread))


@pytest.mark.parametrize(
    ("before", "tried", "words"),
    [
        (6.0, (0.4, 1.3, 9.0), "off by a factor of 6; 'B' leaves 1.3, which would explain it"),
        (1 / 6.0, (0.4, 9.0), "off by a factor of 6; 'A' leaves 0.4, the largest reduction, not sufficient"),
        (6.0, (9.0,), "off by a factor of 6; no what-if reduces it"),
        (1.9, (0.4, 1.3), "within a factor of two"),
    ],
)
def test_the_reason_is_the_experiment_that_leaves_least(before, tried, words):
    assert explain_ratio(ratio(before), zip("ABC", map(ratio, tried), strict=False)) == words
    wide = explain_ratio(ratio(before, spread=5.0), [])
    assert ("within its interval" in wide) == (before != 1.9)
