"""Baseline files: written to be read by people, refused when their tolerances mean nothing."""

import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperval import cli
from hyperval.baseline import Accepted, accepted_of, campaign_metrics, compare, load_baseline, split_key
from hyperval.errors import UsageError
from hyperval.metrics import Tolerance, default_tolerance
from hyperval.model import clopper_pearson
from hyperval.results import Outcome, Result
from small_campaign import data_of

MEDIAN = "median_difference_ratio_windows"
KEY = f"radiance | white panel | sixs | {MEDIAN}"
PD = "roc | planks | cem/pixel | pd_predicted@1e-2"
HEAD = 'schema: 1\nkind: campaign\nname: mine\nreason: "because"\ndate: "2026-01-02"\nversions: {hyperval: "0"}\n'
LINE = "{accepted: 0.5, tolerance: 0.001, of: unit}"


def written(folder: Path, line: str = LINE, key: str = KEY) -> Path:
    path = folder / "mine.yaml"
    path.write_text(f'{HEAD}metrics:\n  "{key}": {line}\n')
    return path


def measured(value: float, half: float = math.nan, key: str = KEY, **more) -> dict[str, Result]:
    return {key: Result("", *split_key(key), value, lower=value - half, upper=value + half, **more)}


def number(value: float, key: str = KEY, half: float = math.nan, **more) -> Accepted:
    return accepted_of(measured(value, half, key, **more), {})[key]


@pytest.mark.parametrize(("old", "new", "message"), data_of("baseline_mistakes"))
def test_what_means_nothing_is_refused(tmp_path, old, new, message):
    path = written(tmp_path)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(UsageError, match=message):
        load_baseline(path)


def test_a_tolerance_that_can_never_fail_is_refused(tmp_path):
    line = '{accepted: 0.5, tolerance: 1.0, of: value, why: "noisy"}'
    with pytest.raises(UsageError, match=r"lies between 0 and 1.*can never fail"):
        load_baseline(written(tmp_path, line, PD))
    assert load_baseline(written(tmp_path, line.replace("1.0, of", "0.5, of"), PD)).metrics[PD].width == 0.25
    loose = '{accepted: 0.5, tolerance: 0.01, of: unit, why: "a random forest"}'
    assert load_baseline(written(tmp_path, loose)).metrics[KEY].width == 0.01
    assert load_baseline(written(tmp_path, LINE)).metrics[KEY].width == 0.001  # a tight one needs no words


def test_names_of_numbers_and_files_of_something_else(tmp_path, capsys):
    assert split_key("roc | a | b | cem | pd") == ("roc", "a | b", "cem", "pd")
    (tmp_path / "sensors").mkdir()
    written(tmp_path).rename(tmp_path / "sensors" / "casi-1500.yaml")
    assert cli.run(["check", "--sensors", "casi-1500", "--baselines", str(tmp_path)]) == 2
    assert "is the baseline of campaign 'mine'" in capsys.readouterr().err


@given(st.floats(1e-30, 1e30), st.sampled_from((-1.0, 1.0)))
def test_rounding_alone_never_trips_a_check(value, sign):
    # The tightest tolerance there is: 0, of the unit.
    key = "bands | all | sensor | band_count"
    now = measured(sign * value, key=key)
    accepted = accepted_of(now, {})
    assert accepted[key].tolerance == 0.0
    assert [row.reason for row in compare("it", accepted, now)] == [""]


@pytest.mark.parametrize(("metric", "half", "tolerance", "of"), data_of("default_tolerances"))
def test_defaults(metric, half, tolerance, of):
    assert default_tolerance(metric, half) == Tolerance(tolerance, of)


def test_one_count_more_or_less_is_tolerated():
    # An exact interval is narrowest, about 3.7 / n, where none or all were counted.
    for n, hits in ((5, 0), (5, 2), (80, 1), (80, 40), (1000, 0), (1000, 1), (1000, 1000)):
        low, high = clopper_pearson(hits, n)
        half = float(high - low) / 2
        assert default_tolerance("pd_measured@1e-2", half).width(hits / n, half) > 1.0 / n


def row(metric: str, value: float = 0.1, outcome: Outcome = Outcome.NONE, subject: str = "s", **more) -> Result:
    named = {"product": "roc", "method": "cem/pixel", **more}
    return Result("c", subject=subject, metric=metric, value=value, outcome=outcome, **named)


def test_what_a_baseline_keeps_of_a_campaign():
    """What is planned, and of its subjects and methods what stands behind it; the worst of several outcomes."""
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
def test_what_fails_and_the_limit_that_was_crossed(accepted, now, words):
    (found,) = compare("it", {KEY: accepted} if accepted else {}, now or {})
    assert found.outcome is (Outcome.DISAGREES if words else Outcome.AGREES)
    assert re.search(words, found.reason)
    assert bool(found.reason) == bool(words)
    assert found.subject == "white panel"
    if accepted and accepted.accepted is not None:
        assert (found.limit_low, found.limit_high) == pytest.approx((0.098, 0.102))


def test_tolerances_are_kept_and_lost_intervals_fall_back():
    tight = Accepted(accepted=0.5, tolerance=0.0001, of="unit")
    assert accepted_of(measured(0.6), {KEY: tight})[KEY].tolerance == 0.0001
    key = "scores | x | cem | score_mean_difference"
    before = {key: number(0.5, key, 0.2)}
    assert before[key].of == "interval"
    assert accepted_of(measured(0.5, key=key), before)[key].of == "value"
