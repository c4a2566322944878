"""Two runs side by side."""

import dataclasses
import json
import re

import pytest
from synthetic_run import make_run

from hyperval import cli
from hyperval.errors import InputError
from hyperval.report import compare_runs, write_outputs
from hyperval.results import Outcome, Result, ResultTable, Role, paired
from hyperval.run import Run, read_rows, write_table


def _row(metric="bias_ratio", value=1.0, half=0.1, **more):
    interval = {"lower": value - half, "upper": value + half, "outcome": Outcome.AGREES}
    return Result("c", "radiance", "grass", "sixs", metric, value, role=Role.GATE, **(interval | more))


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    tmp_path = tmp_path_factory.mktemp("pair")
    run = make_run()
    changed = [dataclasses.replace(row, campaign="another") for row in run.table]  # whatever their names
    for i, row in enumerate(changed):
        if row.outcome is Outcome.AGREES:
            turned = {"outcome": Outcome.DISAGREES, "value": row.value + 1.0, "upper": row.upper + 1.0}
            changed[i] = dataclasses.replace(row, **turned)
    for name, table in (("a", run.table), ("b", ResultTable(changed))):
        (tmp_path / name).mkdir()
        write_outputs(dataclasses.replace(run, table=table), tmp_path / name)
    return tmp_path


def compared(one, other, out) -> str:
    compare_runs(one, other, out)
    return (out / "report.html").read_text("utf-8")


def test_a_stored_table_is_read_back_as_it_was(folders, tmp_path):
    """Also one that repeats the names of the columns in each row: results of earlier days stay comparable."""
    stored = Run.open(folders / "a")
    assert stored.table.frame().equals(make_run().table.frame())
    assert stored.figures
    now = json.loads((folders / "a" / "results.json").read_text())
    rows = [dict(zip(now["columns"], row, strict=True)) for row in now["rows"]]
    (tmp_path / "results.json").write_text(json.dumps({**now, "schema_version": 2, "rows": rows}))
    assert Run.open(tmp_path).table.frame().equals(stored.table.frame())


def test_a_verdict_that_turned_stands_first(folders, tmp_path):
    assert cli.run(["-q", "compare", str(folders / "a"), str(folders / "b"), "-o", str(tmp_path / "out")]) == 0
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    changed = page[page.index("Outcomes that changed") : page.index("What moved")]
    assert "disagrees" in changed
    assert not re.search(r'(src|href)="https?:', page)
    assert 'class="chart"' not in page, "the curves are the same"


def test_curves_that_moved_stand_in_one_chart(folders, tmp_path):
    run = make_run()
    (tmp_path / "moved").mkdir()
    radiance = {k: dataclasses.replace(e, mean=1.1 * e.mean) for k, e in run.prediction.radiance.items()}
    table = ResultTable(dataclasses.replace(row, value=row.value * 1.1) for row in run.table)
    moved = dataclasses.replace(run.prediction, radiance=radiance)
    write_outputs(dataclasses.replace(run, prediction=moved, table=table), tmp_path / "moved")
    page = compared(folders / "a", tmp_path / "moved", tmp_path / "out")
    assert "run A (dashed) and run B" in page
    assert page.count('id="chart-radiance"') == page.count('id="chart-snr"') == 1


def test_a_run_against_itself_has_no_difference(folders, tmp_path):
    page = compared(folders / "a", folders / "a", tmp_path / "same")
    rows = list(read_rows(tmp_path / "same"))
    assert all(r.value == 0 or r.value != r.value for r in rows)
    assert f"Identical: all {len(rows)} comparisons have the same value" in page
    assert not re.search("Outcomes that changed|<img", page)
    figures = len(list((folders / "a" / "figures").iterdir()))
    assert f"{figures} of {figures} are the same in both:" in page


def test_a_gate_that_one_run_lacks_is_a_changed_verdict_and_folders_of_one_name_are_told_apart(tmp_path):
    for name, rows in (("old", [_row("bias_ratio"), _row("z")]), ("new", [_row("bias_ratio")])):
        (tmp_path / name / "hysu").mkdir(parents=True)
        write_table(ResultTable(rows), tmp_path / name / "hysu")
    page = compared(tmp_path / "old" / "hysu", tmp_path / "new" / "hysu", tmp_path / "out")
    assert all(words in page for words in ("Outcomes that changed", "old/hysu", "new/hysu"))
    told = [(row.outcome, row.reason) for row in read_rows(tmp_path / "out")]
    assert (told[0][0], told[1]) == (Outcome.NONE, (Outcome.SKIPPED, "only in run A"))


def test_differences_count_in_half_intervals():
    (pair,) = paired(ResultTable([_row(value=1.0)]), ResultTable([_row(value=1.3)]))
    assert (pair.difference, pair.size, pair.verdict_changed) == (pytest.approx(0.3), pytest.approx(3.0), False)
    # Rounding beside an interval of no width is no news.
    (pair,) = paired(ResultTable([_row(half=1e-16)]), ResultTable([_row(value=1.000001, half=1e-16)]))
    assert 0.0 < pair.size < 0.01


@pytest.mark.parametrize("text", ["{}", "[1]", "{", '{"schema_version": 1, "rows": [{"value": 1}]}'])
def test_other_files_are_refused(tmp_path, text, capsys):
    assert cli.run(["compare", str(tmp_path), str(tmp_path), "-o", str(tmp_path / "out")]) == 3
    assert "results.json" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    (tmp_path / "results.json").write_text(text)
    with pytest.raises(InputError):
        list(read_rows(tmp_path))
