"""What a planned comparison may say, and what each kind of row concludes about a range."""

import math

import pytest

from hyperval import compare
from hyperval.results import Cause, Outcome, Result, Role

RADIANCE = {"product": "radiance", "metric": "median_difference_ratio_windows", "reason": "r"}


def row(metric="median_difference_ratio_windows", value=0.0, lower=math.nan, upper=math.nan, **more):
    product = more.pop("product", "radiance")
    return Result("c", product, "field", "radiance", metric, value=value, lower=lower, upper=upper, **more)


def test_limits_and_their_words():
    limits = ({"at_most": 0.1}, {"at_least": -0.1}, {"within": [-0.1, 0.2]})
    told = [compare.Gate(**RADIANCE, **limit).limit_text for limit in limits]
    assert told == ["at most 0.1", "at least -0.1", "within -0.1 to 0.2"]


def test_the_rows_that_a_gate_is_about():
    gate = compare.Gate(**{**RADIANCE, "metric": "difference_ratio", "within": [-0.1, 0.1], "bands_nm": [500, 600]})
    bands = (499.9, 500.0, 600.0, 600.1)
    assert [gate.covers(row("difference_ratio", band_nm=band)) for band in bands] == [False, True, True, False]
    assert not gate.covers(row("difference_ratio", product="reflectance", band_nm=550.0))
    assert gate.covers(row(compare.COMPARISON))  # a skipped comparison has no band
    only = compare.Gate(**{**RADIANCE, "at_most": 0.1, "subjects": ["court*"], "method": "rad*"})
    assert not only.covers(row())
    at = compare.Gate(product="roc", metric="pd_difference", within=(-0.1, 0.1), reason="r")
    assert at.covers(row("pd_difference@1e-2", product="roc"))


def test_intervals_of_all_criteria_share_their_level():
    # On either side twenty intervals lie off equality by 2.5 standard errors, and one by 4: of 42 the worst has
    # 0.05/42 of the level (3.2 standard errors), so that one right campaign in twenty is called wrong.
    gate = compare.Gate(**RADIANCE, within=[-0.1, 0.1])
    beside = [row(value=k, lower=k - 1.96, upper=k + 1.96) for k in (*[2.5] * 20, 4.0)]
    beside += [row(value=-x.value, lower=-x.upper, upper=-x.lower) for x in beside]
    out = compare.judged(beside, [gate])
    assert [r.outcome for r in out] == ([Outcome.UNDECIDED] * 20 + [Outcome.DISAGREES]) * 2
    assert {r.cause for r in out if r.outcome is Outcome.UNDECIDED} == {Cause.MULTIPLICITY}
    assert compare.judged(beside[:1], [gate])[0].outcome is Outcome.DISAGREES  # alone it has the whole level
    assert compare.judged(beside[:20], [gate.model_copy(update={"gate": False})])[0].outcome is Outcome.DISAGREES


@pytest.mark.parametrize(
    ("metric", "value", "lower", "upper", "p"),
    [
        ("pd_difference@1e-2", 0.2, 0.0, 0.6, 0.05),  # the end on the side of equality counts
        ("pd_difference@1e-2", -0.2, -0.6, 0.0, 0.05),
        ("pd_difference@1e-2", 0.0, -0.1, 0.3, 1.0),
        ("pfa_ratio@1e-2", 4.0, 1.0, 9.0, 0.05),  # of a ratio in the logarithm
        ("pfa_ratio@1e-2", 4.0, 2.0, 8.0, 8.862e-5),  # twice as far: 3.92 standard errors
        ("pfa_ratio@1e-2", 0.25, 0.125, 1.0, 0.05),
        ("pfa_ratio@1e-2", 0.0, 0.0, 0.5, 8.862e-5),  # nothing was predicted
        ("pfa_ratio@1e-2", 3.0, 3.0, 3.0, 0.0),
        ("pd_inside_interval@1e-2_fraction", 0.0, 0.0, 0.25, 4.1e-15),
    ],
)
def test_the_level_at_which_an_interval_would_reach_equality(metric, value, lower, upper, p):
    assert compare.tail_probability(row(metric, value, lower, upper, product="roc")) == pytest.approx(p, rel=0.1)


def test_departures_that_a_range_would_see():
    reach = 1.0 + 0.8416212335729143 / 1.959963984540054
    both = row(value=0.01, lower=-0.01, upper=0.02)  # 0.02 below, 0.01 above
    assert compare.detectable_departure(both, -0.1, math.inf) == pytest.approx(0.1 + 0.01 * reach)
    assert compare.detectable_departure(both, -math.inf, 0.1) == pytest.approx(0.1 + 0.02 * reach)
    assert compare.detectable_departure(both, -0.1, 0.05) == pytest.approx(0.05 + 0.02 * reach)
    assert math.isnan(compare.detectable_departure(row(value=0.0), -0.1, 0.1))
    # A size cut at 0 says nothing of its width: the upper half stands for it.
    size = row("median_abs_difference_ratio_windows", 0.01, 0.0, 0.05)
    assert compare.detectable_departure(size, -math.inf, 0.1) == pytest.approx(0.1 + 0.04 * reach)
    assert compare.detectable_departure(row("p_value_full", 0.5, detectable=0.3), 0.01, math.inf) == 0.3
    assert math.isnan(compare.detectable_share(5, 0.1))  # even none of five leaves the share of 0.1 possible


def test_a_pooled_gate_counts_what_cannot_tell_against_it_below_and_for_it_above():
    def pool(good, bad, unsure, least, **more):
        limits = {"metric": "difference_ratio", "within": (-0.1, 0.1), "fraction_at_least": least}
        ends = [(0.0, -0.01, 0.01)] * good + [(0.3, 0.29, 0.31)] * bad + [(0.0, -0.5, 0.5)] * unsure
        rows = [row("difference_ratio", *numbers, band_nm=500.0 + i) for i, numbers in enumerate(ends)]
        *rows, share = compare.judged(rows, [compare.Gate(**RADIANCE | limits | more)])
        assert all(r.role is not Role.GATE for r in rows)
        return share

    share = pool(80, 6, 14, 0.5)
    assert (share.metric, share.value, share.n) == ("difference_ratio_fraction", 0.8, 100)
    # Clopper-Pearson: 80 of 100 has 0.7082 below, 94 of 100 has 0.9777 above.
    assert (share.lower, share.upper) == pytest.approx((0.7082, 0.9777), abs=1e-4)
    assert share.outcome is Outcome.AGREES
    assert "80 of 100 rows within -0.1 to 0.1, 14 without an outcome of their own; outside: field" in share.reason
    assert "580 nm" in share.reason
    assert "and 1 more" in share.reason
    assert (pool(20, 80, 0, 0.5).outcome, pool(50, 0, 50, 0.8).outcome) == (Outcome.DISAGREES, Outcome.UNDECIDED)
    assert pool(50, 5, 0, 0.8, gate=False).role is Role.INFORM
    assert pool(0, 0, 1, 0.5).cause is Cause.NEVER, "one row cannot put the share above a half"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"metric": "pd_inside_interval_preset"}, "did you mean 'pd_inside_interval@1e-"),
        ({"subjects": ("blau",)}, "rows with it: 'planks' (cem/pixel)"),
        ({"method": "ace/*"}, "rows with it: 'planks' (cem/pixel)"),
        ({"metric": "chi2_reduced_full"}, None),
    ],
)
def test_a_gate_that_meets_no_row_is_told_what_comes_near(change, told):
    rows = [Result("c", "roc", "planks", "cem/pixel", f"pd_inside_interval@{p}", 1.0) for p in ("1e-2", "1e-3")]
    given = {"product": "roc", "metric": "pd_inside_interval", "at_least": 1, "reason": "r", **change}
    (row,) = [r for r in compare.judged(rows, [compare.Gate(**given)]) if r.outcome is Outcome.ERROR]
    assert row.reason.startswith("planned but absent: no roc row")
    assert told is None or told in row.reason
    assert told is not None or "; " not in row.reason
