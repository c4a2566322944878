"""The accepted power tables are of campaigns that are here, and say of every standard error what becomes of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from hyperval.attribute import injected_errors
from hyperval.report import PowerTable, accepted_table

ROOT = Path(__file__).parents[2]
TABLES = sorted((ROOT / "validation" / "power").glob("*.yaml"))


@pytest.fixture(params=TABLES, ids=lambda path: path.stem)
def table(request: pytest.FixtureRequest) -> PowerTable:
    found = accepted_table(request.param.stem, request.param.parent)
    assert found is not None
    return found


def test_there_are_tables():
    assert TABLES


def test_each_standard_error_stands_in_it(table):
    assert list(table.errors) == [error.name for error in injected_errors()]


def test_it_says_what_its_gates_gave(table):
    assert table.stated
    assert len(table.stated) <= table.gates + table.disagreeing


def test_its_files_are_those_of_a_campaign(table):
    folders = [p.parent for p in (ROOT / "campaigns").glob("*/campaign*.yaml") if p.name in table.files]
    assert any(all((folder / name).is_file() for name in table.files) for folder in folders)


def test_no_more_gates_turn_than_could(table):
    named = {gate for injected in table.errors.values() for gate in injected.gates}
    assert len(named) <= table.gates
