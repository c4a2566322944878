"""The results table: columns of the contract, views, and what the exit code says."""

import math

import pytest

from hyperval.errors import UsageError
from hyperval.results import COLUMNS, Outcome, Result, ResultTable, Role


def row(outcome: Outcome = Outcome.NONE, **fields) -> Result:
    fields = {"metric": "bias_ratio", "role": Role.GATE} | fields
    return Result("c", "radiance", "grass", "m", outcome=outcome, **fields)


@pytest.mark.parametrize(
    ("outcomes", "code", "strict"),
    [
        ([], 5, 5),
        ([Outcome.SKIPPED, Outcome.NONE], 5, 1),
        ([Outcome.AGREES], 0, 0),
        ([Outcome.AGREES, Outcome.SKIPPED], 0, 1),
        ([Outcome.AGREES, Outcome.DISAGREES], 1, 1),
        ([Outcome.AGREES, Outcome.ERROR], 1, 1),
        ([Outcome.UNDECIDED], 5, 1),
        ([Outcome.AGREES, Outcome.UNDECIDED], 0, 1),
    ],
)
def test_exit_code(outcomes, code, strict):
    table = ResultTable(row(s) for s in outcomes)
    assert (table.exit_code(), table.exit_code(strict=True)) == (code, strict)


def test_frame_has_the_columns_of_the_contract():
    contract = [
        "campaign", "product", "subject", "method", "band_nm", "metric", "value", "unit", "lower", "upper", "n",
        "limit_low", "limit_high", "role", "evidence", "outcome", "cause", "detectable", "reason",
        "effect", "effect_unit", "effect_lower", "effect_upper", "accepted_low", "accepted_high", "detectable_low",
        "detectable_high", "ideal", "p_value", "set_after", "subjects_seen", "before",
    ]  # fmt: skip
    frame = ResultTable([row(value=0.1, n=3), row()]).frame()
    assert list(frame.columns) == list(COLUMNS) == contract
    assert frame["n"].isna().tolist() == [False, True]  # what is missing stays missing
    assert (math.isnan(frame["value"][1]), frame["outcome"].tolist()) == (True, ["none", "none"])


def test_a_metric_that_the_table_does_not_have_cannot_be_put_in_a_row():
    with pytest.raises(UsageError, match=r"'bias_ration' is not a metric(.|\n)*did you mean 'bias_ratio'"):
        row(metric="bias_ration")
