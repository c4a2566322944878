"""The results table: columns of the contract, views, and what the exit code says."""

from __future__ import annotations

import math

import pytest

from hyperval.results import COLUMNS, Result, ResultTable, Status


def row(status: Status = Status.INFO, **fields) -> Result:
    base = {"campaign": "c", "product": "radiance", "subject": "grass", "method": "m", "metric": "bias"}
    return Result(**{**base, **fields}, status=status)


@pytest.mark.parametrize(
    ("statuses", "code"),
    [
        ([], 5),
        ([Status.INFO], 5),
        ([Status.SKIPPED, Status.INFO], 5),
        ([Status.PASS], 0),
        ([Status.PASS, Status.SKIPPED, Status.INFO], 0),
        ([Status.PASS, Status.FAIL], 1),
        ([Status.FAIL], 1),
        ([Status.PASS, Status.ERROR], 1),
        ([Status.ERROR], 1),
    ],
)
def test_exit_code(statuses, code):
    assert ResultTable(row(s) for s in statuses).exit_code() == code


@pytest.mark.parametrize("code_of", [[Status.PASS, Status.FAIL], [Status.FAIL, Status.PASS]])
def test_exit_code_does_not_depend_on_the_order(code_of):
    assert ResultTable(row(s) for s in code_of).exit_code() == 1


def test_frame_has_the_columns_of_the_contract():
    contract = [
        "campaign", "product", "subject", "method", "band_nm", "metric", "value", "unit", "lower", "upper", "n",
        "threshold", "status",
    ]  # fmt: skip
    frame = ResultTable([row(value=0.1, n=3), row()]).frame()
    assert list(frame.columns) == list(COLUMNS)
    assert list(frame.columns)[: len(contract)] == contract


def test_frame_keeps_missing_numbers_missing():
    frame = ResultTable([row(value=0.1, n=3), row()]).frame()
    assert frame["n"].tolist()[0] == 3
    assert frame["n"].isna().tolist() == [False, True]
    assert math.isnan(frame["value"][1])
    assert frame["status"].tolist() == ["INFO", "INFO"]


def test_empty_table_still_has_its_columns():
    frame = ResultTable().frame()
    assert len(frame) == 0
    assert list(frame.columns) == list(COLUMNS)


def test_where_and_gates_pick_rows():
    table = ResultTable([row(Status.PASS, metric="a"), row(Status.INFO, metric="a"), row(Status.FAIL, metric="b")])
    assert len(table.where(metric="a")) == 2
    assert [r.status for r in table.gates()] == [Status.PASS, Status.FAIL]
    assert len(table.where(metric="a", status=Status.PASS)) == 1


def test_where_refuses_a_field_that_does_not_exist():
    with pytest.raises(AttributeError):
        ResultTable([row()]).where(metrics="a")


def test_rows_are_added_in_order_and_cannot_be_changed():
    table = ResultTable()
    table.add(row(metric="a"), row(metric="b"))
    assert [r.metric for r in table] == ["a", "b"]
    with pytest.raises(AttributeError):
        next(iter(table)).value = 1.0
