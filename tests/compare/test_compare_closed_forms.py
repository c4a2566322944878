"""Signs, sides and intervals of rows that the other tests leave free, each by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from hyperval.compare import (
    RowMaker,
    compare_abundance,
    compare_area_errors,
    compare_roc,
    compare_spectra,
    far_at_detection_rows,
    leading_source,
)
from hyperval.compare.covariance import _eigenvalue_rows, _space_rows
from hyperval.model import Z95
from hyperval.pixels import SamplingBand, Statistics
from hyperval.products import Abundance, AlarmsAtDetection, RocCurve, SpectralEstimate
from hyperval.results import Outcome
from hyperval.spectra import SpectralAxis, in_window

MAKE = RowMaker("product", "planks", "cem/object")
NAMES = {"subject": "planks", "method": "cem/object"}


def by_metric(rows):
    return {r.metric: r for r in rows}


def test_a_measured_area_is_judged_by_the_predicted_interval_alone():
    for predicted, observed, inside in ((0.6, 0.1, 1.0), (0.1, 0.6, 0.0)):
        rows = compare_abundance(Abundance(11.0, predicted), Abundance(10.0, observed, 9, 10.5), **NAMES)
        assert by_metric(rows)["area_in_predicted_95"].value == inside


def test_errors_of_areas_by_hand():
    rows = compare_abundance(Abundance(5.0, 0.3), Abundance(4.0, 0.4, 9, 2.5), **NAMES)
    row = by_metric(rows)
    half = {metric: (r.upper - r.lower) / 2.0 / Z95 for metric, r in row.items() if np.isfinite(r.upper)}
    # d(o/p) = do/p - o dp/p^2; d(p/o - 1) = dp/o - p do/o^2.
    assert half["area_ratio"] == pytest.approx(np.hypot(0.4 / 5.0, 4.0 * 0.3 / 25.0))
    assert half["area_difference_ratio"] == pytest.approx(np.hypot(0.3 / 4.0, 5.0 * 0.4 / 16.0))
    for side, u in (("predicted", 0.3), ("observed", 0.4)):
        assert (half[f"area_{side}"], half[f"area_error_{side}"]) == pytest.approx((u, u))
    assert half["area_nominal_ratio"] == pytest.approx(0.4 / 2.5)
    assert (row["area_ratio"].value, row["area_difference_ratio"].value) == pytest.approx((4.0 / 5.0, 1.0 / 4.0))
    assert row["area_observed"].unit == "m2"
    none = by_metric(compare_abundance(Abundance(11.0, 0.0), Abundance(-1.0, 0.0), **NAMES))
    assert {none[m].outcome for m in ("area_difference_ratio", "area_inside_95")} == {Outcome.SKIPPED}
    assert row["area_z"].value == pytest.approx(1.0 / 0.5)
    assert row["area_inside_95"].value == 0.0  # 2.0 is beyond 1.96
    assert row["area_in_predicted_95"].value == 0.0  # 1.0 is beyond 1.96 of 0.3
    near = compare_abundance(Abundance(4.9, 0.3), Abundance(4.0, 0.4), **NAMES)
    assert by_metric(near)["area_inside_95"].value == 1.0


def test_intervals_of_the_errors_of_several_areas():
    error, spread = np.array([0.4, -0.1, 0.3]), np.array([0.2, 0.3, 0.6])
    observed = {(k, "fcls"): Abundance(2.0 + e, 0.1, 9, 2.0) for k, e in zip("abc", error, strict=True)}
    predicted = {(k, "fcls"): Abundance(2.05, s, 9, 2.0) for k, s in zip("abc", spread, strict=True)}
    observed["d", "fcls"] = predicted["d", "fcls"] = Abundance(9.0, 0.1, 9, 9.0)  # one of a size has no spread
    rows = by_metric(compare_area_errors(predicted, observed))
    assert rows["area_rmse_predicted"].value == pytest.approx(np.sqrt(0.05**2 + np.mean(spread**2)))
    assert {r.subject for r in rows.values()} == {"all targets of 2 m2"}
    low, high = stats.t.interval(0.95, 2, loc=error.mean(), scale=stats.sem(error))
    bias = rows["area_bias_observed"]
    assert (bias.lower, bias.value, bias.upper) == pytest.approx((low, error.mean(), high))
    model = rows["area_bias_predicted"]
    assert (model.upper - model.value, model.value - model.lower) == pytest.approx(
        [Z95 * np.sqrt(0.04 + 0.09 + 0.36) / 3] * 2
    )
    square = np.sum(error**2)  # over chi-square of three: the mean square of errors of mean 0
    rmse = rows["area_rmse_observed"]
    ends = np.sqrt(square / stats.chi2.ppf([0.975, 0.025], 3))
    assert (rmse.lower, rmse.value, rmse.upper) == pytest.approx((ends[0], np.sqrt(square / 3), ends[1]))


def band(eigenvalues, angles):
    return SamplingBand(eigenvalues, eigenvalues.sum(axis=1), np.zeros(119), angles)


def test_an_angle_is_too_large_where_five_of_119_draws_exceed_it():
    drawn = band(np.ones((119, 1)), np.random.default_rng(0).permutation(np.linspace(1.0, 60.0, 119))[:, None])
    ordered = np.sort(drawn.angles_deg[:, 0])
    for angle, inside in ((ordered[113] - 1e-6, 1.0), (ordered[113] + 1e-6, 0.0)):
        overlap = np.array([[np.cos(np.radians(angle))]])
        rows = _space_rows(MAKE, Statistics(np.ones(1), 1.0, 0.0, overlap), drawn, (1,), 200)
        assert by_metric(rows)["subspace_inside_95@1"].value == inside


def test_the_ratio_of_an_eigenvalue_is_expected_over_measured():
    values = np.linspace(1.0, 3.0, 119)[:, None]
    rows = _eigenvalue_rows(MAKE, Statistics(np.array([4.0]), 5.0, 0.0, np.empty((0, 0))), band(values, values), 200)
    row = by_metric(rows)["eigenvalue_ratio@1"]
    step = 2.0 / 118
    assert (row.lower, row.value, row.upper) == pytest.approx(((1 + 2 * step) / 4, 0.5, (3 - 2 * step) / 4))
    row = by_metric(rows)["total_variance_ratio"]
    assert (row.lower, row.value, row.upper) == pytest.approx(((1 + 2 * step) / 5, 0.4, (3 - 2 * step) / 5))


def curve(pd, half=0.0, **more):
    pfa = np.array([1e-4, 1e-3, 1e-2, 1e-1, 1.0])
    pd = np.asarray(pd, float)
    return RocCurve(pfa, pd, np.clip(pd - half, 0, 1), np.clip(pd + half, 0, 1), np.zeros(5), "object", **more)


def test_differences_are_predicted_less_measured():
    high, low = curve([0.2, 0.4, 0.8, 0.9, 1.0]), curve([0.1, 0.2, 0.6, 0.8, 1.0])
    rows = by_metric(compare_roc(high, low, **NAMES))
    assert rows["pd_difference@1e-2"].value == pytest.approx(0.2)
    assert rows["auc_difference"].value > 0.0
    rows = by_metric(compare_roc(low, high, **NAMES))
    assert rows["pd_difference@1e-2"].value == pytest.approx(-0.2)
    assert rows["auc_difference"].value < 0.0


def test_predicted_alarms_lie_where_the_band_reaches_the_stated_detection():
    # Straight in log P_FA, 0.2 a decade, a band of 0.1: half a decade on either side.
    measured = curve(
        [0.0, 0.2, 0.5, 0.8, 1.0], n_target=20, n_background=1000, background_area_km2=0.5,
        at_detection=(AlarmsAtDetection(0.5, 1.0, 10, 0.01, 0.004, 0.03, 0.005, 0.02),),
    )  # fmt: skip
    density = 2000.0
    predicted = curve([0.2, 0.4, 0.6, 0.8, 1.0], 0.1)
    rows = by_metric(far_at_detection_rows(MAKE, predicted, measured))
    row = rows["far_predicted@pd0.5"]
    assert np.array([row.lower, row.value, row.upper]) / density == pytest.approx([1e-3, 10**-2.5, 1e-2])
    assert rows["far_measured@pd0.5"].value == pytest.approx(20.0)
    assert rows["far_difference@pd0.5"].value == pytest.approx(density * 10**-2.5 - 20.0)
    # An upper limit that begins above that P_D bounds P_FA from below by nothing.
    wide = by_metric(far_at_detection_rows(MAKE, curve([0.2, 0.4, 0.6, 0.8, 1.0], 0.4), measured))
    row = wide["far_predicted@pd0.5"]
    assert (row.lower, row.upper / density) == pytest.approx((0.0, 10**-0.5))


def test_a_leading_source_holds_more_than_half_of_the_variance():
    def side(**parts):
        budget = {name: np.full(3, np.sqrt(v)) for name, v in parts.items()}
        return SpectralEstimate(np.ones(3), np.eye(3), budget=budget)

    everything = np.ones(3, bool)
    assert leading_source(side(spectrum=0.45, noise=0.1), side(sampling=0.45), everything) == ""
    told = leading_source(side(spectrum=0.6, noise=0.1), side(sampling=0.3), everything)
    assert told == "60 % of the variance: spectrum"


def test_a_prediction_that_is_too_bright_has_a_positive_z():
    axis = SpectralAxis(np.linspace(450.0, 890.0, 12), 10.0)
    covariance = 1e-4 * (0.5 * np.eye(12) + 0.5)
    predicted, observed = (SpectralEstimate(np.full(12, v), covariance) for v in (1.03, 1.0))
    rows = compare_spectra(predicted, observed, product="radiance", subject="s", method="m", axis=axis)
    z = [r.value for r in rows if r.metric == "z"]
    assert z == pytest.approx([0.03 / np.sqrt(2e-4)] * 12)
    # The mean over bands of (p - c)/c: half of the error is common to all, the other half falls with their number.
    bias = by_metric(rows)["bias_ratio"]
    used = np.count_nonzero(in_window(axis.centre_nm))
    half = Z95 * np.sqrt(1e-4 * (1 + 1.03**2) * (0.5 + 0.5 / used))
    assert (bias.value, bias.upper - bias.value) == pytest.approx((0.03, half), rel=1e-9)
