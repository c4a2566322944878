"""The verdict says "agrees" only when something passed and nothing failed."""

import math
from dataclasses import replace

import pytest

from hyperval.report.glossary import explained, meaning
from hyperval.report.verdict import (
    informs_of_disagreement,
    interval_text,
    is_planned,
    number_text,
    threshold_text,
    value_text,
    verdict,
)
from hyperval.results import Result, Status


def row(status, reason="", subject="grass"):
    return Result("c", "radiance", subject, "6S", "ratio", 0.01, status=status, reason=reason)


@pytest.mark.parametrize(
    ("statuses", "tone"),
    [
        ([Status.PASS, Status.PASS], "agree"),
        ([Status.PASS, Status.SKIPPED], "agree"),
        ([Status.PASS, Status.FAIL], "disagree"),
        ([Status.FAIL], "disagree"),
        ([Status.PASS, Status.ERROR], "undecided"),
        ([Status.SKIPPED], "undecided"),
        ([Status.INFO], "undecided"),
        ([], "undecided"),
    ],
)
def test_tone_follows_the_statuses(statuses, tone):
    found, words = verdict([row(s) for s in statuses])
    assert found == tone
    assert words.startswith("Agrees") == (tone == "agree")
    assert ("Nothing was checked" in words) == (Status.PASS not in statuses and not {Status.FAIL} & set(statuses))


def test_failures_errors_and_skips_are_named():
    _, words = verdict([row(Status.FAIL, subject="lawn"), row(Status.ERROR, subject="turf"), row(Status.PASS)])
    assert "lawn" in words
    assert "turf" in words
    assert "1 of 2 gating comparisons failed" in words


def test_a_falsified_pass_turns_the_verdict():
    rows = [row(Status.PASS) for _ in range(20)]
    assert verdict(rows)[0] == "agree"
    rows[7] = row(Status.FAIL)
    assert verdict(rows)[0] == "disagree"


def test_informing_disagreement_is_told_and_does_not_fail():
    tone, words = verdict([row(Status.PASS), row(Status.INFO, "disagrees: p = 0.001", "green planks")])
    assert tone == "mixed"
    assert words.startswith("Passes its gates (the one gating comparison passed), but not everything agrees.")
    assert "Agrees" not in words
    assert "found a disagreement (radiance green planks 6S)" in words


def test_a_full_test_that_rejects_is_told_but_not_planned():
    rejected = replace(row(Status.INFO, ""), metric="p_value_full", value=1e-9)
    assert informs_of_disagreement(rejected)
    assert not informs_of_disagreement(replace(rejected, value=0.5))
    assert not is_planned(rejected)


@pytest.mark.parametrize(
    ("reason", "told"),
    [
        ("would not pass at most 0.06; informs only: aerosol is not known", True),
        ("8 of 10 rows at most 2; outside: a, b; would not pass at least 0.9", True),
        ("would be an error: the value is NaN", True),
        ("differs by more than the margin", True),
        ("would pass at most 0.06; informs only: first campaign", False),
        ("", False),
    ],
)
def test_reasons_that_tell_of_a_disagreement(reason, told):
    assert informs_of_disagreement(row(Status.INFO, reason)) == told
    assert not informs_of_disagreement(row(Status.PASS, reason))
    assert is_planned(row(Status.INFO, reason)) == bool(reason)


@pytest.mark.parametrize(
    ("value", "spread", "text"),
    [
        (0.123456, math.nan, "0.1235"),
        (12345.678, math.nan, "12346"),
        (3.0, math.nan, "3"),
        (0.123456, 0.01, "0.123"),
        (-0.5, 0.2, "−0.50"),
        (1.2e-7, math.nan, "1.2e−07"),
        (math.nan, math.nan, "–"),
        (math.inf, math.nan, "∞"),
        (0.0, math.nan, "0"),
    ],
)
def test_numbers_have_sensible_digits(value, spread, text):
    assert number_text(value, spread) == text


def test_value_and_interval_share_their_digits():
    r = Result("c", "abundance", "t", "CEM", "area", 8.21234, "m2", lower=7.1, upper=9.4)
    assert value_text(r) == "8.2 m2"
    assert interval_text(r) == "7.1 to 9.4"


def _full_test(value):
    return Result(
        "c", "reflectance", "panel", "statistics", "p_value_full", value, reason="144 of 163 directions kept"
    )


def test_a_spectrum_that_the_full_test_rejects_is_told_beside_passes():
    assert verdict([row(Status.PASS), _full_test(0.0)])[0] == "mixed"
    assert verdict([row(Status.PASS), _full_test(0.02)])[0] == "agree"
    assert verdict([row(Status.PASS), _full_test(math.nan)])[0] == "agree"


def test_many_disagreements_are_counted_by_product():
    rows = [row(Status.INFO, "differs", f"field {i}") for i in range(8)]
    _, words = verdict([row(Status.PASS), *rows, _full_test(0.0)])
    assert "9 comparisons found a disagreement (8 of radiance, 1 of reflectance)" in words


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "< 1e−300"), (0.18472, "0.18"), (3.219e-7, "3.2e−07"), (0.99979, "> 0.999")]
)
def test_p_values_have_two_digits_and_are_never_nothing(value, text):
    assert value_text(_full_test(value)) == text


@pytest.mark.parametrize(
    ("value", "status", "reason", "text"),
    [
        (0.9, Status.PASS, "", "≥ 0.75"),
        (0.6, Status.FAIL, "", "≥ 0.75"),
        (0.6, Status.PASS, "", "≤ 0.75"),
        (0.9, Status.INFO, "would not pass within 0.1 to 0.75; informs only: x", "≤ 0.75"),
        (0.75, Status.INFO, "would pass at least 0.75; informs only: x", "≥ 0.75"),
        (0.75, Status.PASS, "", "0.75"),
        (math.nan, Status.ERROR, "", "0.75"),
    ],
)
def test_the_side_of_a_threshold_is_told(value, status, reason, text):
    one = Result("c", "abundance", "t", "cem", "area_ratio", value, threshold=0.75, status=status, reason=reason)
    assert threshold_text(one) == text


def test_metrics_are_explained_in_words():
    assert "predicted over measured variance" in meaning("eigenvalue_ratio@3")
    assert meaning("nobody's metric") == ""
    assert explained([_full_test(0.5), _full_test(0.1)]) == [("p_value_full", meaning("p_value_full"))]


def test_a_campaign_without_gates_does_not_say_that_nothing_was_found():
    tone, words = verdict([row(Status.INFO, "differs")])
    assert tone == "undecided"
    assert words.startswith("Nothing was checked by a gate: every comparison of this campaign only informs. ")
    assert "1 comparison found a disagreement" in words
