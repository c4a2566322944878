"""Studies: designs, tables, answers, knees, interruption, workers, exit codes."""

import os
import signal
import threading
import time
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
import yaml
from scipy.optimize import brentq
from scipy.stats import kstest, truncnorm

from hyperval import api, cli
from hyperval.errors import UsageError
from hyperval.executors import workers
from hyperval.model import predict, read_world
from hyperval.run import Run, read_rows
from hyperval.scenario import load_scenario
from hyperval.settings import with_settings
from hyperval.study import Output, Required, knee, load_study, output_values, required_values, study_to_folder

PD = Output(name="pd", kind="pd", subject="plank", pfa=1e-3)


FILL = "scene.targets.plank.fill.fixed"
OUT = "outputs: [{name: pd, kind: pd, subject: plank, pfa: 1.0e-3}]\n"


def text_of(name: str) -> str:
    """A file beside this one."""
    return (Path(__file__).parent / f"{name}.yaml").read_text()


TEXT, MISTAKES = text_of("trial"), yaml.safe_load(text_of("mistakes"))


@pytest.fixture
def table_of(make_study):
    """From YAML text to the table of the study."""
    return lambda text: api.study(make_study(text), show_progress=False).to_dataframe()


@pytest.fixture
def quick(monkeypatch):
    """Small chunks, so that a short study has several."""
    monkeypatch.setattr("hyperval.study.run._SMALLEST", 32)


def test_paths_of_the_model_are_moved_within_their_limits(make_study, table_of):
    text = "inputs: [{{name: gain, path: sensor.gain, values: [1.0, 1.1]}}, {{name: haze, path: light.path,\n"
    text += " values: [0.5, {}]}}]\noutputs: [{{name: seen, kind: radiance, subject: grass, band_nm: 550}}]\n"
    seen = table_of(text.format("null"))["seen"].to_numpy().reshape(2, 2)  # as it stands
    assert seen[1] == pytest.approx(1.1 * seen[0], rel=1e-12)
    assert seen[0, 0] < seen[0, 1]
    with pytest.raises(UsageError, match=r"light\.path at -1"):
        table_of(text.format(-1.0))


def tables(folder) -> dict[str, bytes]:
    return {n: (folder / n).read_bytes() for n in ("table.csv", "table.nc", "results.csv")}


def test_a_study_writes_everything(make_study, tmp_path, quick, scenario_file, monkeypatch):
    path, out = make_study(TEXT), tmp_path / "out"
    monkeypatch.setattr("hyperval.study.run.find_spec", lambda name: None)
    assert cli.run(["-q", "study", str(path), "-o", str(out)]) == 0
    assert not (out / "table.parquet").exists(), "pyarrow is an extra"
    table = pd.read_csv(out / "table.csv")
    assert list(table) == ["point", "c", "haze", "fill", "pd", "snr", "signal", "signal.snr", "never", "reason"]
    assert (len(table), table["pd"].between(0, 1).all()) == (150, True)
    with xr.open_dataset(out / "table.nc", engine="h5netcdf") as data:
        for name in ("c", "fill", "pd", "signal", "reason"):
            np.testing.assert_array_equal(data[name].values, table[name].fillna("" if name == "reason" else np.nan))
        assert (data["c"].attrs["units"], data["c"].attrs["long_name"]) == ("%", "calibration error")
    assert {str(r.outcome) for r in read_rows(out)} <= {"none", "skipped"}
    unsolved = table["signal"].isna()
    assert table.loc[unsolved, "reason"].str.contains("stays below 0.99.*; never: no solution").all()
    page = (out / "report.html").read_text()
    assert page.count('<div class="chart"') == len(list((out / "figures").glob("*.svg"))) == 2
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert {"provenance.json", "products.nc"} <= {p.name for p in out.iterdir()}
    assert not (out / ".hyperval-partial").exists()


def test_an_answer_is_that_of_another_solver_of_the_plain_model(table_of, scenario_file):
    row = table_of(TEXT.replace("count: 15", "count: 2")).dropna(subset="signal").iloc[0]
    stated = {"sensor_changes.calibration_error_percent": row["c"], "atmosphere.aot550": row["haze"], FILL: row["fill"]}

    def at(log_signal: float):
        changes = {**stated, "sensor_changes.signal_factor": float(np.exp(log_signal))}
        return predict(with_settings(load_scenario(scenario_file), changes))

    def miss(log_signal: float) -> float:
        curve = at(log_signal).roc["plank", "cem", "pixel"]
        return float(curve.pd[np.argmin(np.abs(curve.pfa - 1e-3))]) - 0.99

    root = brentq(miss, np.log(0.01), np.log(100.0), xtol=1e-10)
    assert row["signal"] == pytest.approx(np.exp(root), rel=1e-6)
    there = at(root)
    w = there.axis.centre_nm
    bands = (w >= 450) & (w <= 650) & there.axis.good
    assert row["signal.snr"] == pytest.approx(there.snr["asphalt"].mean[bands].mean(), rel=1e-3)


def test_parquet_holds_the_table_of_the_csv(make_study, tmp_path):
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    study_to_folder(make_study(TEXT.replace("count: 15", "count: 2")), tmp_path / "out")
    read = {"keep_default_na": False, "na_values": {name: [""] for name in ("signal", "signal.snr", "never")}}
    written = pd.read_csv(tmp_path / "out" / "table.csv", **read)
    found = pd.read_parquet(tmp_path / "out" / "table.parquet")
    assert list(found.columns) == list(written.columns)
    for name in found.columns:
        np.testing.assert_array_equal(found[name].to_numpy(), written[name].to_numpy())


def test_an_interrupted_run_goes_on_to_the_same_bytes(make_study, tmp_path, quick, monkeypatch):
    """Also where the last chunk was cut in the middle; another study begins anew."""
    path, broken = make_study(TEXT.replace("count: 15", "count: 10")), tmp_path / "broken"
    study_to_folder(path, tmp_path / "whole")
    from hyperval.study import run as study_run

    calls, right = [], study_run.run_chunk

    def failing(piece):
        calls.append(piece[2])
        if 3 <= len(calls) <= 6:
            raise KeyboardInterrupt
        return right(piece)

    monkeypatch.setattr("hyperval.study.run.run_chunk", failing)
    with pytest.raises(KeyboardInterrupt):
        study_to_folder(path, broken)
    assert all(p.name.startswith(".hyperval") for p in broken.iterdir())
    kept = broken / ".hyperval-partial"
    assert len(list(kept.iterdir())) == 2
    (kept / f".chunk-0.json.hyperval-{os.getpid()}-abcdefgh.json").write_text("[[[0.5, 0.5, 0.5")
    for name in ("study.run.package_versions", "datasets.InputLog.entries", "study.StudyFile.model_dump"):
        with monkeypatch.context() as patch:
            patch.setattr(f"hyperval.{name}", dict)
            with pytest.raises(KeyboardInterrupt):
                study_to_folder(path, broken)
    study_to_folder(path, broken)
    assert calls[2:7] == [96, 32, 32, 32, 96], "from the third chunk on, of the same versions, files and study"
    other = tmp_path / "other" / ".hyperval-partial"
    other.mkdir(parents=True)
    (other / "chunk-0123456789abcdef-0.json").write_text("[[], []]")
    study_to_folder(path, other.parent)
    assert tables(broken) == tables(other.parent) == tables(tmp_path / "whole")


@pytest.mark.slow
def test_processes_give_the_same_bytes(make_study, tmp_path, quick, monkeypatch):
    path = make_study(TEXT)
    study_to_folder(path, tmp_path / "one")
    monkeypatch.setattr("hyperval.study.run.workers", lambda count, scheduler: workers(2))
    study_to_folder(path, tmp_path / "two")
    assert tables(tmp_path / "one") == tables(tmp_path / "two")


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of the libraries behind the scheduler
def test_a_cluster_gives_the_same_bytes_with_one_worker_killed_in_the_middle(make_study, tmp_path, quick):
    """On a real Dask scheduler, whose two workers are processes that nobody starts again."""
    pytest.importorskip("distributed", reason="the extra dask is not installed")
    from distributed import Client
    from distributed.deploy.subprocess import SubprocessCluster

    grids = "grid: {start: 0.1, stop: 3, count: 40}}, {name: s, path: sensor_changes.signal_factor, "
    grids += "grid: {start: 0.5, stop: 2, count: 30}}]\n"
    path = make_study("inputs: [{name: c, path: sensor_changes.calibration_error_percent, " + grids + OUT)
    study_to_folder(path, tmp_path / "here")
    kept, finished = tmp_path / "there" / ".hyperval-partial", []

    def kill(process: int) -> None:
        while not (chunks := list(kept.glob("chunk-*.json"))):
            time.sleep(0.02)
        finished.append(len(chunks))
        os.kill(process, signal.SIGKILL)

    options = {"worker_class": "distributed.Worker", "n_workers": 2, "worker_kwargs": {"nthreads": 1}}
    with SubprocessCluster(dashboard_address=":0", **options) as cluster, Client(cluster) as client:
        client.wait_for_workers(2, timeout=120.0)
        first, second = client.run(os.getpid).values()
        killer = threading.Thread(target=kill, args=(first,), daemon=True)
        killer.start()
        study_to_folder(path, tmp_path / "there", scheduler=cluster.scheduler_address)
        killer.join()
        os.kill(second, 0)  # it lives
    assert 0 < finished[0] < -(-1200 // 32)  # it was in the middle
    assert tables(tmp_path / "here") == tables(tmp_path / "there")


def test_draws_follow_their_distributions_and_the_seed(table_of):
    """Sobol points are more even than random ones, of which Kolmogorov's distance has a 5 % limit of 0.06."""
    whole = table_of(text_of("drawn"))
    assert len(whole) == 3 * 512
    assert whole["fill"].tolist()[:4] == [0.1, 0.2, 0.3, 0.1], "the last listed input moves fastest"
    assert kstest(whole["c"][::3] / 4.0, "uniform").statistic < 0.01
    assert kstest((np.log10(whole["s"][::3]) + 1.0) / 2.0, "uniform").statistic < 0.01
    assert kstest(whole["f"][::3], truncnorm(-1.0, 4.0, 1.0, 0.5).cdf).statistic < 0.01
    other = table_of(text_of("drawn").replace("seed: 4", "seed: 5").replace("count: 512", "count: 8"))
    assert not np.isin(other["c"], whole["c"]).any()


def test_several_entries_move_together(table_of, scenario_file):
    table = table_of(text_of("together"))
    ways = [(1, "after recording"), (4, "before recording")]
    for (grass, (frames, way)), snr in zip(product((0.1, 0.3), ways), table["snr"], strict=True):
        changes = {"scene.classes.grass.fraction": grass, "scene.classes.asphalt.fraction": 0.8 - grass,
                   "sensor_operation.frames_averaged": frames, "sensor_operation.averaged": way}  # fmt: skip
        alone = predict(with_settings(load_scenario(scenario_file), changes))
        band = np.argmin(np.abs(alone.axis.centre_nm - 550.0))
        assert snr == pytest.approx(alone.snr["asphalt"].mean[band], rel=1e-9)


def test_one_at_a_time_gives_a_tornado(make_study, tmp_path):
    study_to_folder(make_study(text_of("tornado")), tmp_path / "out")
    table = pd.read_csv(tmp_path / "out" / "table.csv")
    assert (table["fill"].isna().tolist(), table["pd"].notna().all()) == ([True] * 4 + [False] * 2, True)
    assert table["pd"].iloc[0] == pytest.approx(table["pd"].iloc[3], rel=1e-9)  # the same sensor, read anew
    assert "read anew for each value" in (tmp_path / "out" / "report.html").read_text()
    assert {"as stated", "haze = 0.4"} <= {row.method for row in read_rows(tmp_path / "out")}


def test_random_atmosphere_is_interpolated_and_says_so_and_each_draw_has_its_bend(make_study, tmp_path):
    path = make_study(text_of("drawn_haze"))
    study_to_folder(path, tmp_path / "out")
    rows = Run.open(tmp_path / "out").table
    error = {r.subject: r.value for r in rows if r.metric == "error_at_held_out_states"}
    assert 0 < error["radiance, worst"] < 0.03
    assert error["radiance, rms"] <= error["radiance, worst"]
    assert 0 < error["output pd"] < 0.03
    assert "is interpolated between engine runs" in (tmp_path / "out" / "report.html").read_text()
    assert [r.metric for r in rows].count("knee") == 32


def test_areas_and_false_alarms_against_the_curve(table_of):
    """AUC in closed form, with Gaussian and t backgrounds, and P_FA at a P_D against the curve, finely drawn."""
    pfa = np.concatenate([np.geomspace(1e-10, 0.01, 300, endpoint=False), np.linspace(0.01, 1.0 - 1e-9, 500)])
    head = """settings: {scene.targets.plank.fill: {mean: 0.03, sd: 0.01}}
inputs:
  - {name: tail, path: scene.classes.asphalt.tail_dof, values: [2.5, 6.0, 40.0]}
"""
    curves = table_of(f"{head}  - {{name: x, path: pfa, values: {pfa.tolist()}}}\n"
                      "outputs: [{name: pd, kind: pd, subject: plank}]")["pd"].to_numpy().reshape(3, -1)  # fmt: skip
    found = table_of(head + "outputs: [{name: auc, kind: auc, subject: plank}, "
                     "{name: log_pfa, kind: log10-pfa, subject: plank, pd: 0.7}]")  # fmt: skip
    np.testing.assert_allclose(found["auc"], np.trapezoid(curves, pfa, axis=1), atol=2e-4)
    back = [np.interp(log_pfa, np.log10(pfa), curve) for log_pfa, curve in zip(found["log_pfa"], curves, strict=True)]
    np.testing.assert_allclose(back, 0.7, rtol=2e-3)


def test_a_point_that_can_not_be_gets_a_reason(scenario_file):
    """Fractions that do not sum to 1 at one of four points: that one alone has no value."""
    columns = {"scene.classes.asphalt.fraction": np.array([0.5, 0.5, 0.6, 0.5])}
    found, problems = output_values(read_world(load_scenario(scenario_file)), columns, [PD])
    assert np.isnan(found[:, 0]).tolist() == [False, False, True, False]
    assert [(at, "partition" in why) for at, why in problems.items()] == [(2, True)]


@pytest.mark.parametrize(("several", "root"), [(True, 1.0 / 7.0), (False, 0.31)])
def test_of_several_solutions_the_lowest_is_told(several, root):
    """Of sin(7 x - 1), or of x."""
    question = {"name": "q", "path": FILL, "between": (0.0, 1.0), "output": "pd", "equals": 0.0 if several else 0.31}
    of_x = (lambda x: np.sin(7.0 * x - 1.0)) if several else np.array
    question, point = Required.model_validate(question), {"other": np.zeros(1)}
    found = required_values(lambda columns, outputs: (of_x(columns[FILL])[:, None], {}), point, question, [PD])
    np.testing.assert_allclose(found.solutions, root, rtol=1e-6)
    assert found.reasons == ({0: "not monotone: 2 solutions; the lowest is reported"} if several else {})


@pytest.mark.parametrize("case", MISTAKES, ids=[case["words"] for case in MISTAKES])
def test_mistakes_are_told(make_study, case):
    inputs = yaml.safe_dump({"inputs": case["inputs"]}, sort_keys=False)
    with pytest.raises(UsageError, match=case["words"]):
        load_study(make_study(inputs + OUT + case.get("more", "")))


@pytest.mark.parametrize(("old", "new", "code", "words"), yaml.safe_load(text_of("refused")))
def test_bad_studies_stop_at_once(make_study, tmp_path, capsys, old, new, code, words):
    path = make_study(TEXT)
    path.write_text(path.read_text().replace(old, new))
    assert cli.run(["-q", "study", str(path), "-o", str(tmp_path / "out")]) == code
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["mine.txt", ".hyperval-partial/thesis.txt"])
def test_a_folder_of_something_else_is_refused_and_left_alone(make_study, tmp_path, name):
    kept = tmp_path / "out" / name
    kept.parent.mkdir(parents=True)
    kept.write_text("mine")
    assert cli.run(["-q", "study", str(make_study(TEXT)), "-o", str(tmp_path / "out")]) == 2
    assert kept.read_text() == "mine"


# The knee against closed forms.


U = np.linspace(0.0, 1.0, 41)
SATURATING = 1.0 - np.exp(-6.0 * U)


def test_exponential_saturation_by_hand():
    """v = c (1 - exp(-k u)), c = 1 / (1 - exp(-k)), has the slope s = c k exp(-k u) and the curvature
    k s / (1 + s^2)^(3/2), which is greatest at s^2 = 1/2, so u = ln(sqrt(2) c k) / k."""
    k = 6.0
    x = np.linspace(0.0, 50.0, 401)
    found = knee(x, 3.0 + 2.0 * (1.0 - np.exp(-k * x / 50.0)))
    c = 1.0 / (1.0 - np.exp(-k))
    assert found.x == pytest.approx(50.0 * np.log(np.sqrt(2.0) * c * k) / k, rel=2e-3)
    assert found.curvature == pytest.approx(k * np.sqrt(0.5) / 1.5**1.5, rel=2e-3)


def test_units_and_the_logarithm_of_the_input():
    plain, scaled = knee(U, SATURATING), knee(10.0 ** (2.0 * U), SATURATING, logarithmic=True)
    assert knee(1000.0 * U, 0.01 * SATURATING).x == pytest.approx(1000.0 * plain.x, rel=1e-9)
    assert np.log10(scaled.x) / 2.0 == pytest.approx(plain.x, rel=1e-9)


def test_concave_and_convex_parts_of_an_s_curve():
    x = np.linspace(-1.0, 1.0, 81)
    up, down = (knee(x, np.tanh(4.0 * x), bend=bend) for bend in ("convex", "concave"))
    assert up.x == pytest.approx(-down.x, abs=1e-6)
    assert up.x < 0.0 < down.x


SQUARE = np.linspace(0, 1, 9) ** 2
NO_KNEE = [
    (np.ones(9), "any", "flat"), (np.full(9, np.nan), "any", "0 points"),
    (SQUARE, "concave", "concave"), (SQUARE, "any", "end of the range"),
]  # fmt: skip


@pytest.mark.parametrize(("y", "bend", "reason"), NO_KNEE)
def test_no_knee_is_an_answer(y, bend, reason):
    found = knee(np.linspace(0.0, 1.0, 9), y, bend=bend)
    assert np.isnan(found.x)
    assert reason in found.reason
