"""Baseline files: written to be read by people, refused when their tolerances mean nothing."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperval.baseline.accepted import (
    BEHIND,
    Accepted,
    accepted_of,
    baseline_path,
    campaign_metrics,
    candidate_path,
    load_baseline,
    rounded,
    skipped_reason,
    split_key,
    stored,
    today,
    write_baseline,
)
from hyperval.baseline.check import compare
from hyperval.errors import UsageError
from hyperval.metrics import Tolerance, default_tolerance
from hyperval.model import clopper_pearson
from hyperval.results import Outcome, Result

MEDIAN = "median_difference_ratio_windows"
KEY = f"radiance | white panel | sixs | {MEDIAN}"
PD = "roc | planks | cem/pixel | pd_predicted@1e-2"
HEAD = 'schema: 1\nkind: campaign\nname: mine\nreason: "because"\ndate: "2026-01-02"\nversions: {hyperval: "0"}\n'


def written(folder: Path, line: str, key: str = KEY) -> Path:
    path = folder / "mine.yaml"
    path.write_text(f'{HEAD}metrics:\n  "{key}": {line}\n')
    return path


def measured(value: float, half: float = math.nan, key: str = KEY, **more) -> dict[str, Result]:
    return {key: Result("", *split_key(key), value, lower=value - half, upper=value + half, **more)}


def number(value: float, key: str = KEY, half: float = math.nan, **more) -> Accepted:
    return accepted_of(measured(value, half, key, **more), {})[key]


def test_a_baseline_comes_back_as_it_was_written(tmp_path):
    numbers = {
        **measured(0.0123456789, 0.01, outcome=Outcome.AGREES),
        **measured(0.5, key=PD),
        **measured(math.nan, key="roc | a | b | cem/object | pd_inside_interval@1e-2", outcome=Outcome.SKIPPED),
        **measured(0.02, 0.004, "scores | x | cem | score_mean_difference"),
    }
    metrics = accepted_of(numbers, {})
    path = baseline_path(tmp_path, "campaign", "mine")
    write_baseline(path, "campaign", "mine", 'why: "so"', {"hyperval": "0"}, metrics)
    back = stored(tmp_path, "campaign", "mine")
    assert back is not None
    assert back.metrics == metrics
    assert back.reason == 'why: "so"'
    assert back.metrics[KEY].accepted == 0.0123457
    lines = path.read_text().split("metrics:\n")[1].splitlines()
    assert len(lines) == len(metrics)
    assert lines == sorted(lines)


def test_the_date_is_that_of_the_sources(monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1000000000")
    assert today() == "2001-09-09"
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    with pytest.raises(UsageError, match="seconds since 1970"):
        today()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{accepted: 0.5, tolerance: 1.5, of: value}", "never above 1"),
        ("{accepted: 0.5, tolerance: 1.01, of: interval, half_width: 0.1}", "never above 1"),
        ("{accepted: 0.5, tolerance: 0.2, of: unit}", "never above 0.1"),
        ("{accepted: 0.5, tolerance: -0.1, of: value}", "never below 0"),
        ("{accepted: 0.5, tolerance: 0.1, of: interval}", "needs half_width"),
        ("{accepted: 0.5, tolerance: 0.01, of: unit}", r"above the default needs 'why'"),
        ('{accepted: 0.5, tolerance: 0.01, of: unit, why: ""}', "at least 1 character"),
        ("{accepted: 0.5, tolerance: .nan, of: unit}", "finite number"),
        ("{accepted: .inf, tolerance: 0.001, of: unit}", "finite number"),
        ("{accepted: 0.5, tolerance: 0.001, of: everything}", "Input should be"),
        ("{accepted: 0.5, tolerance: 0.001, of: unit, outcome: FAIL}", "Input should be"),
        ("{accepted: 0.5, tolerence: 0.001, of: unit}", "did you mean 'tolerance'"),
    ],
)
def test_tolerances_that_mean_nothing_are_refused(tmp_path, line, message):
    with pytest.raises(UsageError, match=message):
        load_baseline(written(tmp_path, line))


def test_a_tolerance_that_can_never_fail_is_refused(tmp_path):
    line = '{accepted: 0.5, tolerance: 1.0, of: value, why: "noisy"}'
    with pytest.raises(UsageError, match=r"lies between 0 and 1.*can never fail"):
        load_baseline(written(tmp_path, line, PD))
    assert load_baseline(written(tmp_path, line.replace("1.0, of", "0.5, of"), PD)).metrics[PD].width == 0.25


def test_a_loosened_tolerance_needs_words_and_a_tight_one_none(tmp_path):
    loose = '{accepted: 0.5, tolerance: 0.01, of: unit, why: "a random forest"}'
    assert load_baseline(written(tmp_path, loose)).metrics[KEY].width == 0.01
    tight = "{accepted: 0.5, tolerance: 0.0005, of: unit}"
    assert load_baseline(written(tmp_path, tight)).metrics[KEY].width == 0.0005


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD.replace('"because"', '"FILL_IN: why"'), "still to be filled in"),
        (HEAD.replace('"because"', '""'), "at least 1 character"),
        (HEAD.replace("2026-01-02", "today"), "date"),
        (HEAD.replace("schema: 1", "schema: 2"), "schema"),
        (HEAD.replace("mine", "../mine"), "name"),
    ],
)
def test_heads_that_say_nothing_are_refused(tmp_path, text, message):
    path = tmp_path / "mine.yaml"
    path.write_text(f'{text}metrics:\n  "{KEY}": {{accepted: 0.5, tolerance: 0.001, of: unit}}\n')
    with pytest.raises(UsageError, match=message):
        load_baseline(path)


def test_names_of_numbers(tmp_path):
    assert split_key("roc | a | b | cem | pd") == ("roc", "a | b", "cem", "pd")
    with pytest.raises(UsageError, match=r"is not .product \| subject \| method \| metric"):
        load_baseline(written(tmp_path, "{accepted: 0.5, tolerance: 0.001, of: unit}", "pd"))


def test_a_baseline_of_something_else_is_refused(tmp_path):
    written(tmp_path, "{accepted: 0.5, tolerance: 0.001, of: unit}").rename(tmp_path / "other.yaml")
    with pytest.raises(UsageError, match="is the baseline of campaign 'mine'"):
        stored(tmp_path, "campaign", "other")
    assert stored(tmp_path, "sensor", "other") is None


def test_sensors_stand_apart(tmp_path):
    assert baseline_path(tmp_path, "sensor", "emit") == tmp_path / "sensors" / "emit.yaml"
    assert candidate_path(tmp_path, "campaign", "v1.2").name == "v1.2.candidate.yaml"


@given(st.floats(1e-30, 1e30), st.sampled_from((-1.0, 1.0)))
def test_rounding_alone_never_trips_a_check(value, sign):
    # The tightest tolerance there is: 0, of the unit.
    key = "bands | all | sensor | band_count"
    now = measured(sign * value, key=key)
    accepted = accepted_of(now, {})
    assert accepted[key].tolerance == 0.0
    assert [row.reason for row in compare("it", accepted, now)] == [""]


@given(st.floats(0.01, 100.0), st.floats(-0.4, 0.4))
def test_the_verdict_turns_at_the_tolerance(value, part):
    key = "noise | VNIR | sensor | median_electrons_per_radiance"
    value = rounded(value)
    accepted = Accepted.model_validate({"accepted": value, "tolerance": 0.2, "of": "value", "why": "a test"})
    (found,) = compare("it", {key: accepted}, measured(value * (1.0 + part), key=key))
    if abs(abs(part) - 0.2) > 1e-9:
        assert (found.outcome is Outcome.DISAGREES) == (abs(part) > 0.2)


@pytest.mark.parametrize(
    ("metric", "half", "expected"),
    [
        ("pd_inside_interval@1e-2", None, Tolerance(0.0, "unit")),
        ("pd_inside_interval@1e-2_fraction", 0.1, Tolerance(0.02, "unit")),
        ("fraction_inside_95", None, Tolerance(0.02, "unit")),
        ("pd_predicted@1e-2", 0.1, Tolerance(0.005, "unit")),
        ("pd_measured@1e-2", 0.1, Tolerance(0.8, "interval")),
        ("pd_measured@1e-2", None, Tolerance(0.005, "unit")),
        ("median_difference_ratio_swir1", 0.1, Tolerance(0.002, "unit")),
        ("p_value_full", None, Tolerance(0.05, "unit")),
        ("objects_inside_95_p_value", None, Tolerance(0.05, "unit")),
        ("pit_uniformity_p_value", None, Tolerance(0.05, "unit")),
        ("score_mean_difference", 0.1, Tolerance(0.1, "interval")),
        ("reduced_chi_square", None, Tolerance(0.01, "value")),
    ],
)
def test_defaults(metric, half, expected):
    assert default_tolerance(metric, half) == expected


def test_one_count_more_or_less_is_tolerated():
    # An exact interval is narrowest, about 3.7 / n, where none or all were counted.
    for n in (5, 20, 80, 1000):
        for hits in {0, 1, n // 2, n - 1, n}:
            low, high = clopper_pearson(hits, n)
            half = float(high - low) / 2
            assert default_tolerance("pd_measured@1e-2", half).width(hits / n, half) > 1.0 / n


def row(metric: str, value: float = 0.1, outcome: Outcome = Outcome.NONE, subject: str = "s", **more) -> Result:
    named = {"product": "roc", "method": "cem/pixel", **more}
    return Result("c", subject=subject, metric=metric, value=value, outcome=outcome, **named)


def test_what_a_baseline_keeps_of_a_campaign():
    rows = [
        row("pd_inside_interval@1e-2_fraction", 1.0, Outcome.AGREES, "near *, far *"),
        row("pd_predicted@1e-2", subject="near 1"),
        row("pd_predicted@1e-2", subject="elsewhere"),
        row("pd_predicted@1e-2", subject="near 1", method="ace/pixel"),
        row("pd_difference@1e-2", subject="near 1"),
        row("auc", outcome=Outcome.UNDECIDED),
        row("partial_auc_measured", reason="would pass; informs only: so"),
        row("difference_ratio", 0.1, Outcome.AGREES, band_nm=500.0),
        row("pd", 0.3, Outcome.AGREES),
        row("pd", 0.3, Outcome.SKIPPED),
    ]
    found = campaign_metrics(rows)
    assert sorted(split_key(k)[1:] for k in found) == [
        ("near *, far *", "cem/pixel", "pd_inside_interval@1e-2_fraction"),
        ("near 1", "cem/pixel", "pd_predicted@1e-2"),
        ("s", "cem/pixel", "auc"),
        ("s", "cem/pixel", "pd"),
    ]
    assert found["roc | s | cem/pixel | pd"].outcome is Outcome.SKIPPED
    assert "pd_predicted@*" in BEHIND["roc"]


def test_a_campaign_is_skipped_when_all_of_it_is():
    lost = row("pd", math.nan, Outcome.SKIPPED, reason="no data")
    assert skipped_reason([lost, lost]) == "no data"
    assert skipped_reason([lost, row("z")]) is None
    assert skipped_reason([]) is None


@pytest.mark.parametrize(
    ("accepted", "now", "words"),
    [
        (number(0.1), measured(0.1005), ""),
        (number(0.1), measured(0.103), r"moved from 0\.1 to 0\.103: \+0\.003, tolerance 0\.002"),
        (number(0.1), measured(math.nan), "moved from 0.1 to no value"),
        (number(0.1), measured(math.inf), "moved from 0.1 to no value"),
        (number(math.nan), measured(0.1), "moved from no value to 0.1"),
        (number(math.nan), measured(math.nan), ""),
        (number(0.1), None, r"missing: the run does not give this number \(accepted 0\.1\)"),
        (None, measured(0.1), "not accepted"),
        (number(0.1, outcome=Outcome.AGREES), measured(0.1, outcome=Outcome.DISAGREES, reason="too large"),
         r"the outcome changed from agrees to disagrees \(too large\)"),
        (number(0.1, outcome=Outcome.AGREES), measured(0.1), "the outcome changed from agrees to none"),
    ],
)  # fmt: skip
def test_what_fails(accepted, now, words):
    (found,) = compare("it", {KEY: accepted} if accepted else {}, now or {})
    assert found.outcome is (Outcome.DISAGREES if words else Outcome.AGREES)
    assert re.search(words, found.reason)
    assert bool(found.reason) == bool(words)


def test_a_row_tells_the_limit_that_was_crossed():
    (found,) = compare("it", {KEY: number(0.1)}, measured(0.09))
    assert (found.limit_low, found.limit_high) == pytest.approx((0.098, 0.102))
    assert found.subject == "white panel"


def test_tolerances_are_kept_and_lost_intervals_fall_back():
    tight = Accepted.model_validate({"accepted": 0.5, "tolerance": 0.0001, "of": "unit"})
    assert accepted_of(measured(0.6), {KEY: tight})[KEY].tolerance == 0.0001
    key = "scores | x | cem | score_mean_difference"
    before = {key: number(0.5, key, 0.2)}
    assert before[key].of == "interval"
    assert accepted_of(measured(0.5, key=key), before)[key].of == "value"
