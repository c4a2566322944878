"""The whole command: tables, interruption, workers, exit codes."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from hyperval import cli
from hyperval.executors import workers
from hyperval.run import Run, read_rows
from hyperval.study import run as study_run
from hyperval.study.run import study_to_folder

TEXT = """
title: A trial
inputs:
  - {name: c, label: calibration error, unit: "%", path: sensor_changes.calibration_error_percent,
     grid: {start: 0.1, stop: 3, count: 15}}
  - {name: haze, path: atmosphere.aot550, values: [0.1, 0.4]}
  - {name: fill, label: fill, path: scene.targets.plank.fill.fixed, values: [0.02, 0.05, 0.1, 0.15, 0.2]}
outputs:
  - {name: pd, kind: pd, subject: plank, pfa: 1.0e-3}
  - {name: snr, kind: snr, subject: asphalt, range_nm: [450, 650]}
required:
  - {name: signal, path: sensor_changes.signal_factor, between: [0.01, 100], spacing: log, output: pd, equals: 0.99}
knees: [{output: pd, along: fill, bend: concave}]
plots:
  - {kind: lines, x: c, output: pd, family: fill}
  - {kind: heat, x: c, y: fill, output: pd}
"""


@pytest.fixture
def quick(monkeypatch):
    """Small chunks, so that a short study has several."""
    monkeypatch.setattr(study_run, "_SMALLEST", 32)


def tables(folder) -> dict[str, bytes]:
    return {n: (folder / n).read_bytes() for n in ("table.csv", "table.nc", "results.csv")}


def test_a_study_writes_everything(make_study, tmp_path, quick):
    _, path = make_study(TEXT)
    assert cli.run(["-q", "study", str(path), "-o", str(tmp_path / "out")]) == 0
    out = tmp_path / "out"
    table = pd.read_csv(out / "table.csv")
    assert len(table) == 150
    assert table["pd"].between(0, 1).all()
    with xr.open_dataset(out / "table.nc", engine="h5netcdf") as data:
        np.testing.assert_array_equal(data["pd"].values, table["pd"].to_numpy())
        np.testing.assert_array_equal(data["fill"].values, table["fill"].to_numpy())
        assert data["c"].attrs["units"] == "%"
    assert {str(r.outcome) for r in read_rows(out)} <= {"none", "skipped"}
    unsolved = table["signal"].isna()
    assert table.loc[unsolved, "reason"].str.contains("no solution").all()
    page = (out / "report.html").read_text()
    assert page.count('<div class="chart"') == len(list((out / "figures").glob("*.svg"))) == 2
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert (out / "provenance.json").is_file()
    assert (out / "products.nc").is_file()
    assert not (tmp_path / "out" / ".hyperval-partial").exists()


@pytest.mark.slow
def test_parquet_holds_the_table_of_the_csv(make_study, tmp_path, quick):
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    _, path = make_study(TEXT)
    study_to_folder(path, tmp_path / "out")
    written = pd.read_csv(
        tmp_path / "out" / "table.csv",
        keep_default_na=False,
        na_values={"signal": [""]},
    )
    found = pd.read_parquet(tmp_path / "out" / "table.parquet")
    assert list(found.columns) == list(written.columns)
    for name in found.columns:
        np.testing.assert_array_equal(found[name].to_numpy(), written[name].to_numpy())


def test_without_pyarrow_there_is_no_parquet(make_study, tmp_path, quick, monkeypatch):
    monkeypatch.setattr("hyperval.study.tables.find_spec", lambda name: None)
    _, path = make_study(TEXT)
    study_to_folder(path, tmp_path / "out")
    assert not (tmp_path / "out" / "table.parquet").exists()
    assert (tmp_path / "out" / "table.csv").is_file()


def test_an_interrupted_run_goes_on_to_the_same_bytes(make_study, tmp_path, quick, monkeypatch):
    _, path = make_study(TEXT)
    study_to_folder(path, tmp_path / "whole")
    calls = []

    def failing(piece):
        calls.append(piece[2])
        if len(calls) == 3:
            raise KeyboardInterrupt
        return right(piece)

    right = study_run.run_chunk
    monkeypatch.setattr(study_run, "run_chunk", failing)
    with pytest.raises(KeyboardInterrupt):
        study_to_folder(path, tmp_path / "broken")
    assert all(p.name.startswith(".hyperval") for p in (tmp_path / "broken").iterdir())
    assert (tmp_path / "broken" / ".hyperval-partial" / "values.f64").stat().st_size == 2 * 32 * 3 * 8
    monkeypatch.setattr(study_run, "run_chunk", right)
    study_to_folder(path, tmp_path / "broken")
    assert tables(tmp_path / "broken") == tables(tmp_path / "whole")


@pytest.mark.slow
def test_processes_give_the_same_bytes(make_study, tmp_path, quick):
    _, path = make_study(TEXT)
    study_to_folder(path, tmp_path / "one")
    with workers(2) as where:
        study_to_folder(path, tmp_path / "two", executor=where)
    assert tables(tmp_path / "one") == tables(tmp_path / "two")


def test_random_atmosphere_is_interpolated_and_says_so(make_study, tmp_path):
    _, path = make_study("""
inputs:
  - {name: haze, path: atmosphere.aot550, random: {uniform: [0.05, 0.9]}}
  - {name: fill, path: scene.targets.plank.fill.fixed, random: {uniform: [0.02, 0.2]}}
design: {count: 64}
atmosphere: {nodes: 9, checked: 4}
outputs: [{name: pd, kind: pd, subject: plank, pfa: 1.0e-3}]
plots: [{kind: lines, x: haze, output: pd}, {kind: heat, x: haze, y: fill, output: pd}]
""")
    study_to_folder(path, tmp_path / "out")
    rows = Run.open(tmp_path / "out").table
    error = {r.subject: r.value for r in rows if r.metric == "error_at_held_out_states"}
    assert 0 < error["radiance, worst"] < 0.01
    assert error["radiance, rms"] <= error["radiance, worst"]
    assert 0 < error["output pd"] < 0.01
    assert "is interpolated between engine runs" in (tmp_path / "out" / "report.html").read_text()


def test_one_at_a_time_gives_a_tornado(make_study, tmp_path):
    _, path = make_study("""
design: {kind: one-at-a-time}
inputs:
  - {name: haze, path: atmosphere.aot550, values: [0.1, 0.4]}
  - {name: sensor, path: sensor, values: [prospectir-vs]}
  - {name: fill, path: scene.targets.plank.fill.fixed, values: [0.02, 0.1]}
outputs: [{name: pd, kind: pd, subject: plank, pfa: 1.0e-3}]
plots: [{kind: tornado, output: pd}]
""")
    study_to_folder(path, tmp_path / "out")
    table = pd.read_csv(tmp_path / "out" / "table.csv")
    assert table["pd"].notna().all()
    assert table["pd"].iloc[0] == pytest.approx(table["pd"].iloc[3], rel=1e-9)  # the same sensor, read anew
    assert "read anew for each value" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        (("fill.fixed", "fill.fixt"), 2, "fixt"),
        (("stop: 3,", "stop: 300,"), 2, "less than 100"),
        (("subject: plank", "subject: plonk"), 2, "no subject 'plonk'"),
        (("range_nm: [450, 650]", "range_nm: [3000, 4000]"), 2, "no usable band"),
        (("scenario: small.yaml", "scenario: none.yaml"), 3, "no such file"),
    ],
)
def test_bad_studies_stop_at_once(make_study, tmp_path, capsys, changes, code, words):
    _, path = make_study(TEXT)
    path.write_text(path.read_text().replace(*changes))
    assert cli.run(["-q", "study", str(path), "-o", str(tmp_path / "out")]) == code
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_folder_of_something_else_is_refused_before_anything_runs(make_study, tmp_path, monkeypatch):
    _, path = make_study(TEXT)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("x")
    monkeypatch.setattr(study_run, "plan_study", lambda *a, **k: pytest.fail("it ran"))
    assert cli.run(["-q", "study", str(path), "-o", str(tmp_path / "out")]) == 2
