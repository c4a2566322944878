"""Two runs side by side."""

import dataclasses
import json
import re

import pytest
from synthetic_run import make_run

from hyperval import cli
from hyperval.errors import InputError
from hyperval.report import write_outputs
from hyperval.report.side_by_side import _names, compare_runs, difference_table, paired
from hyperval.results import Outcome, Result, ResultTable, Role
from hyperval.run import Run, read_rows


def _row(metric="bias_ratio", value=1.0, outcome=Outcome.AGREES, **more):
    interval = {"lower": value - 0.1, "upper": value + 0.1}
    return Result("c", "radiance", "grass", "sixs", metric, value, role=Role.GATE, outcome=outcome, **interval, **more)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    tmp_path = tmp_path_factory.mktemp("pair")
    run = make_run()
    changed = []
    for row in run.table:
        row = dataclasses.replace(row, campaign="another")  # two single campaigns, whatever their names
        if row.outcome is Outcome.AGREES:
            row = dataclasses.replace(row, outcome=Outcome.DISAGREES, value=row.value + 1.0, upper=row.upper + 1.0)
        changed.append(row)
    for name, table in (("a", run.table), ("b", ResultTable(changed))):
        (tmp_path / name).mkdir()
        write_outputs(dataclasses.replace(run, table=table), tmp_path / name)
    return tmp_path


def test_a_stored_table_is_read_back_as_it_was(folders):
    stored = Run.open(folders / "a")
    assert stored.table.frame().equals(make_run().table.frame())
    assert stored.figures


def test_a_table_of_the_version_before_is_read_too(folders, tmp_path):
    """It repeated the names of the columns in each row; results of earlier days stay comparable."""
    now = json.loads((folders / "a" / "results.json").read_text())
    before = {
        **now, "schema_version": 2, "rows": [dict(zip(now["columns"], row, strict=True)) for row in now["rows"]],
    }  # fmt: skip
    (tmp_path / "results.json").write_text(json.dumps(before))
    assert Run.open(tmp_path).table.frame().equals(Run.open(folders / "a").table.frame())


def test_a_verdict_that_turned_stands_first(folders):
    assert cli.run(["-q", "compare", str(folders / "a"), str(folders / "b"), "-o", str(folders / "out")]) == 0
    page = (folders / "out" / "report.html").read_text("utf-8")
    changed = page[page.index("Outcomes that changed") : page.index("What moved")]
    assert "disagrees" in changed
    assert "agrees" in changed
    assert not re.search(r'(src|href)="https?:', page)
    assert len(page) < 5_000_000


def test_curves_that_moved_stand_in_one_chart(folders, tmp_path):
    run = make_run()
    (tmp_path / "moved").mkdir()
    radiance = {k: dataclasses.replace(e, mean=1.1 * e.mean) for k, e in run.prediction.radiance.items()}
    moved = dataclasses.replace(run.prediction, radiance=radiance)
    table = ResultTable(dataclasses.replace(row, value=row.value * 1.1) for row in run.table)
    write_outputs(dataclasses.replace(run, prediction=moved, table=table), tmp_path / "moved")
    compare_runs(folders / "a", tmp_path / "moved", tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "run A (dashed) and run B" in page
    assert page.count('id="chart-radiance"') == page.count('id="chart-snr"') == 1
    compare_runs(folders / "a", folders / "b", tmp_path / "verdicts")  # of the same curves
    assert 'class="chart"' not in (tmp_path / "verdicts" / "report.html").read_text("utf-8")


def test_a_run_against_itself_has_no_difference(folders):
    compare_runs(folders / "a", folders / "a", folders / "same")
    rows = list(read_rows(folders / "same"))
    assert rows
    assert all(r.value == 0 or r.value != r.value for r in rows)
    page = (folders / "same" / "report.html").read_text("utf-8")
    assert f"Identical: all {len(rows)} comparisons have the same value" in page
    assert "Outcomes that changed" not in page
    assert "<img" not in page
    figures = len(list((folders / "a" / "figures").iterdir()))
    assert f"{figures} of {figures} are the same in both:" in page


def test_differences_count_in_half_intervals():
    (pair,) = paired(ResultTable([_row(value=1.0)]), ResultTable([_row(value=1.3)]))
    assert pair.difference == pytest.approx(0.3)
    assert pair.size == pytest.approx(3.0)
    assert not pair.verdict_changed


def test_rounding_beside_an_interval_of_no_width_is_no_news():
    def area(value):
        return dataclasses.replace(_row(value=value), lower=value - 1e-16, upper=value + 1e-16)

    (pair,) = paired(ResultTable([area(1.0)]), ResultTable([area(1.000001)]))
    assert 0.0 < pair.size < 0.01


def test_runs_in_folders_of_one_name_are_told_apart(tmp_path):
    assert _names(tmp_path / "old" / "hysu", tmp_path / "new" / "hysu") == ("old/hysu", "new/hysu")
    assert _names(tmp_path / "a", tmp_path / "b") == ("a", "b")
    assert _names(tmp_path / "a", tmp_path / "a") == ("a", "a")


def test_a_gate_that_one_run_lacks_is_a_changed_verdict():
    pairs = paired(ResultTable([_row("bias_ratio"), _row("z")]), ResultTable([_row("bias_ratio")]))
    assert [p.verdict_changed for p in pairs] == [False, True]
    rows = list(difference_table(pairs))
    assert [r.outcome for r in rows] == [Outcome.NONE, Outcome.SKIPPED]
    assert rows[1].reason == "only in run A"


@pytest.mark.parametrize("text", ["{}", "[1]", "{", '{"schema_version": 1, "rows": [{"value": 1}]}'])
def test_other_files_are_refused(tmp_path, text):
    (tmp_path / "results.json").write_text(text)
    with pytest.raises(InputError):
        list(read_rows(tmp_path))


def test_a_folder_without_results_is_exit_code_3(tmp_path, capsys):
    assert cli.run(["compare", str(tmp_path), str(tmp_path), "-o", str(tmp_path / "out")]) == 3
    assert "results.json" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
