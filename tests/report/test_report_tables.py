"""CSV, JSON and JUnit are the same table."""

import csv
import io
import json
import math
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from synthetic_run import NASTY, make_run

from hyperval.results import COLUMNS, Outcome, Result, ResultTable, Role
from hyperval.run import junit_xml, results_csv, results_json

ODD = Result(
    NASTY, "radiance", 'comma, "quote"\nline', "", "bias_ratio", 0.1 + 0.2, "1", band_nm=float(np.float64(1) / 3),
    lower=-math.inf, n=np.int64(3), role=Role.GATE, outcome=Outcome.DISAGREES, reason="µ \x00 ]]> <&>",
)  # fmt: skip


@pytest.fixture
def table() -> ResultTable:
    return make_run(rows=[ODD]).table


def test_csv_reads_back_exactly(table):
    rows = list(csv.DictReader(io.StringIO(results_csv(table), newline="")))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == len(table)
    for read, row in zip(rows, table, strict=True):
        for column in COLUMNS:
            value = getattr(row, column)
            if isinstance(value, float):
                got = float(read[column]) if read[column] else math.nan
                assert got == value or (math.isnan(got) and math.isnan(value)), column
            elif value is None:
                assert read[column] == ""
            elif column == "n":
                assert int(read[column]) == value
            else:
                assert read[column] == str(value)


def test_csv_writes_numpy_scalars_as_plain_numbers():
    text = results_csv([Result("c", "p", "s", "m", "z", np.float64(0.1), n=np.int64(4))])
    assert text.splitlines()[1] == "c,p,s,m,,z,0.1,1,,,4,,,inform,model,none,,,,,,,,,,,,,,False"


def test_json_has_the_same_rows_and_is_strict(table):
    def refuse(name):
        raise AssertionError(f"{name} is not JSON")

    document = json.loads(results_json(table), parse_constant=refuse)
    assert document["counts"] == {
        "agrees": 5, "disagrees": 2, "undecided": 0, "skipped": 1, "error": 0, "none": 81,
    }  # fmt: skip
    assert sum(document["counts"].values()) == len(document["rows"]) == len(table)
    last = dict(zip(document["columns"], document["rows"][-1], strict=True))
    assert last["value"] == ODD.value
    assert last["upper"] is None
    assert last["lower"] == "-inf"
    assert last["n"] == 3
    assert document["columns"] == list(COLUMNS)


def test_junit_counts_match_the_table(table):
    table.add(Result("other", "roc", "a", "CEM", "pd", role=Role.GATE, outcome=Outcome.ERROR, reason="singular"))
    root = ElementTree.fromstring(junit_xml(table))  # noqa: S314 - our own text
    gates = table.gates()
    assert int(root.get("tests")) == len(root.findall(".//testcase")) == len(gates)
    for outcome, element in (
        (Outcome.DISAGREES, "failure"),
        (Outcome.ERROR, "error"),
        (Outcome.SKIPPED, "skipped"),
    ):
        found = root.findall(f".//{element}")
        assert len(found) == len(gates.where(outcome=outcome))
        assert all(item.get("message") for item in found)
    assert int(root.get("failures")) == 1
    assert int(root.get("errors")) == 1
    assert int(root.get("skipped")) == 1
    assert [suite.get("name") for suite in root] == ["invented", NASTY, "other"]
    assert "difference_ratio 400" not in junit_xml(table), "rows that do not decide are no test cases"


def test_junit_of_an_empty_table_parses():
    root = ElementTree.fromstring(junit_xml([]))  # noqa: S314 - our own text
    assert root.get("tests") == "0"


@pytest.mark.parametrize("text", ["one\rtwo", "one\r\ntwo", "\rone", "one\r"])
def test_a_bare_carriage_return_ends_no_row(text):
    row = Result("c", "radiance", "s", "m", "bias_ratio", value=1.0, reason=text)
    table = results_csv([row])
    assert "\r" not in table
    (read,) = csv.DictReader(io.StringIO(table, newline=""))
    assert read["reason"].lstrip("'") == text.replace("\r\n", "\n").replace("\r", "\n")
    assert len(pd.read_csv(io.StringIO(table))) == 1


@pytest.mark.parametrize("text", ["=1+1", "+A1", "-2+3", "@SUM(A1)", "\t=1"])
def test_no_text_of_the_csv_is_a_formula_to_a_spreadsheet(text):
    row = Result(text, "radiance", text, text, "bias_ratio", value=-1.5, lower=-2.0, reason=text)
    (read,) = csv.DictReader(io.StringIO(results_csv([row]), newline=""))
    assert {read[k] for k in ("campaign", "subject", "method", "reason")} == {"'" + text}
    assert float(read["value"]) == -1.5  # numbers stay numbers
    assert float(read["lower"]) == -2.0
