"""The results table: columns of the contract, views, and what the exit code says."""

from __future__ import annotations

import math

import pytest

from hyperval.errors import UsageError
from hyperval.results import COLUMNS, Outcome, Result, ResultTable, Role


def row(outcome: Outcome = Outcome.NONE, **fields) -> Result:
    base = {
        "campaign": "c",
        "product": "radiance",
        "subject": "grass",
        "method": "m",
        "metric": "bias_ratio",
        "role": Role.GATE,
    }
    return Result(**{**base, **fields}, outcome=outcome)


@pytest.mark.parametrize(
    ("statuses", "code"),
    [
        ([], 5),
        ([Outcome.NONE], 5),
        ([Outcome.SKIPPED, Outcome.NONE], 5),
        ([Outcome.AGREES], 0),
        ([Outcome.AGREES, Outcome.SKIPPED, Outcome.NONE], 0),
        ([Outcome.AGREES, Outcome.DISAGREES], 1),
        ([Outcome.DISAGREES], 1),
        ([Outcome.AGREES, Outcome.ERROR], 1),
        ([Outcome.ERROR], 1),
        ([Outcome.UNDECIDED], 5),
        ([Outcome.AGREES, Outcome.UNDECIDED], 0),
    ],
)
def test_exit_code(statuses, code):
    assert ResultTable(row(s) for s in statuses).exit_code() == code


def test_frame_has_the_columns_of_the_contract():
    contract = [
        "campaign", "product", "subject", "method", "band_nm", "metric", "value", "unit", "lower", "upper", "n",
        "limit_low", "limit_high", "role", "evidence", "outcome", "cause", "detectable", "reason",
        "effect", "effect_unit", "effect_lower", "effect_upper", "accepted_low", "accepted_high", "detectable_low",
        "detectable_high", "ideal", "p_value", "set_after",
    ]  # fmt: skip
    frame = ResultTable([row(value=0.1, n=3), row()]).frame()
    assert list(frame.columns) == list(COLUMNS)
    assert list(frame.columns) == contract


def test_frame_keeps_missing_numbers_missing():
    frame = ResultTable([row(value=0.1, n=3), row()]).frame()
    assert frame["n"].tolist()[0] == 3
    assert frame["n"].isna().tolist() == [False, True]
    assert math.isnan(frame["value"][1])
    assert frame["outcome"].tolist() == ["none", "none"]
    assert frame["evidence"].tolist() == ["model", "model"]


def test_a_metric_that_the_table_does_not_have_cannot_be_put_in_a_row():
    with pytest.raises(UsageError, match=r"'bias_ration' is not a metric(.|\n)*did you mean 'bias_ratio'"):
        row(metric="bias_ration")


def test_strict_wants_every_gate_decided():
    for outcome in (Outcome.UNDECIDED, Outcome.SKIPPED):
        assert ResultTable([row(Outcome.AGREES), row(outcome)]).exit_code(strict=True) == 1
    assert ResultTable([row(Outcome.AGREES)]).exit_code(strict=True) == 0
