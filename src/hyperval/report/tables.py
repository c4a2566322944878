"""The results table as CSV, JSON and JUnit XML.

Floats are written as their shortest exact representation, so reading a file back gives the same
numbers.  Nothing in these files depends on the time of writing.
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from operator import attrgetter
from typing import Any
from xml.sax.saxutils import quoteattr

import hyperval
from hyperval.report.verdict import limits_text
from hyperval.results import COLUMNS, Outcome, Result

SCHEMA_VERSION = 3

_values = attrgetter(*COLUMNS)
# What XML 1.0 cannot hold at all, not even escaped.
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def outcome_counts(rows: Iterable[Result]) -> dict[str, int]:
    """Number of rows of each outcome, every outcome named."""
    count = Counter(row.outcome for row in rows)
    return {str(outcome): count[outcome] for outcome in Outcome}


def results_csv(rows: Iterable[Result]) -> str:
    """The table as CSV: the columns ``results.COLUMNS``, an empty cell for NaN and None."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows([_cell(value) for value in _values(row)] for row in rows)
    return out.getvalue()


def results_json(rows: Iterable[Result]) -> str:
    """The table as JSON: a header, and a list of values a row in the order of ``columns``.

    A line a row; null for NaN, "inf" and "-inf" for infinities.
    """
    rows = list(rows)
    document = {
        "schema_version": SCHEMA_VERSION,
        "hyperval_version": hyperval.__version__,
        "counts": outcome_counts(rows),
        "columns": list(COLUMNS),
        "rows": [],
    }
    head = json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False)
    if not rows:
        return head + "\n"
    encode = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode  # fast only without indentation
    listed = ",\n".join(f"  {encode([json_value(value) for value in _values(row)])}" for row in rows)
    return head.removesuffix("[]\n}") + f"[\n{listed}\n ]\n}}\n"


def junit_xml(rows: Iterable[Result]) -> str:
    """One test case for each gate and each error; what disagrees fails, what is undecided counts as skipped."""
    suites: dict[str, list[Result]] = {}
    for row in rows:
        suites.setdefault(row.campaign, [])
        if row.gates or row.outcome is Outcome.ERROR:
            suites[row.campaign].append(row)
    everything = [row for suite in suites.values() for row in suite]
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', f'<testsuites name="hyperval" {_totals(everything)}>']
    for campaign, suite in suites.items():
        lines.append(f" <testsuite name={_attribute(campaign)} {_totals(suite)}>")
        lines.extend(_test_case(row) for row in suite)
        lines.append(" </testsuite>")
    lines.append("</testsuites>")
    return "\n".join(lines) + "\n"


def json_value(value: Any) -> Any:
    """A value that JSON can hold: NaN becomes null, an infinity its name, anything unknown its text."""
    if isinstance(value, str):
        return str(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None if math.isnan(value) else str(value)
    if value is None or isinstance(value, int):
        return value
    if isinstance(value, dict):
        return {str(key): json_value(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_value(item) for item in value]
    if hasattr(value, "tolist"):  # NumPy scalars and arrays
        return json_value(value.tolist())
    if hasattr(value, "items"):
        return json_value(dict(value.items()))
    return str(value)


def row_name(row: Result) -> str:
    """Subject, method, metric and band in one line."""
    parts = [row.subject, row.method, row.metric]
    if math.isfinite(row.band_nm):
        parts.append(f"{row.band_nm:g} nm")
    return " ".join(part for part in parts if part)


def why(row: Result) -> str:
    """The reason of a row, or its numbers where it states none."""
    numbers = f"{row.metric} = {row.value:.6g} {row.unit}"
    if limits_text(row):
        numbers += f", accepted {limits_text(row)}"
    return f"{row.reason} ({numbers})" if row.reason and math.isfinite(row.value) else row.reason or numbers


def _cell(value: Any) -> Any:
    return harmless(value) if isinstance(value, str) else json_value(value)


_ELEMENTS = {
    Outcome.DISAGREES: "failure", Outcome.ERROR: "error", Outcome.SKIPPED: "skipped", Outcome.UNDECIDED: "skipped",
}  # fmt: skip


def harmless(text: str) -> str:
    """The text of a CSV cell, with an apostrophe before what a spreadsheet would take for a formula.

    A carriage return becomes a line feed: readers of CSV take a bare one for the end of the row.
    """
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    return f"'{text}" if text[:1] in ("=", "+", "-", "@", "\t", "\n") else text


def _totals(rows: Sequence[Result]) -> str:
    count = Counter(_ELEMENTS.get(row.outcome) for row in rows)
    return f'tests="{len(rows)}" failures="{count["failure"]}" errors="{count["error"]}" skipped="{count["skipped"]}"'


def _test_case(row: Result) -> str:
    head = f"  <testcase classname={_attribute(f'{row.campaign}.{row.product}')} name={_attribute(row_name(row))}"
    element = _ELEMENTS.get(row.outcome)
    if element is None:
        return head + "/>"
    words = "; ".join(
        part for part in (f"undecided: {row.cause}" if row.outcome is Outcome.UNDECIDED else "", why(row)) if part
    )
    return f"{head}><{element} message={_attribute(words)}/></testcase>"


def _attribute(text: str) -> str:
    return quoteattr(_NOT_XML.sub("\ufffd", text), {"\n": "&#10;", "\r": "&#13;", "\t": "&#9;"})
