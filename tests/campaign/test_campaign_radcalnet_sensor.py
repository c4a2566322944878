"""The template over a RadCalNet site: what it lacks, and from files to verdict and drift on a stand-in scene."""

import json
import re
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from affine import Affine
from rasterio.crs import CRS
from rasterio.warp import transform as warp

from hyperval import cli
from hyperval.atmosphere import AtmosphericTerms
from hyperval.campaign import DayScenarios, dry_run, load_scenarios
from hyperval.datasets import resolve
from hyperval.imagery import write_cube
from hyperval.model import Origins, predict
from hyperval.results import Cause
from hyperval.run import Run, read_rows
from hyperval.sensor import load_sensor
from small_campaign import data_of, fill_in, write_yaml

FOLDER = Path(__file__).parents[2] / "campaigns" / "radcalnet-sensor"
VALUES = data_of("radcalnet_sensor_values")
GATES = ("median_difference_ratio_vnir", "p_value_shape")
SENSOR = "hyspex-vnir-1600"
GRID = np.arange(340.0, 1101.0, 5.0)
TRANSFORM = Affine(30.0, 0.0, 640_000.0, 0.0, -30.0, 3_376_000.0)
OVERPASSES = {"2020-06-08": 160, "2020-12-08": 343, "2021-06-08": 159, "2021-12-08": 342}


def terms(state, **_) -> AtmosphericTerms:
    """Light that falls off toward the infrared; the sun's height dims it."""
    white = np.cos(np.deg2rad(state.sun[0])) * 60.0 * np.exp(-GRID / 900.0)
    one = np.ones(GRID.size)
    path = 0.1 * (550.0 / GRID) ** 2 * (1.0 + state.aot550)
    return AtmosphericTerms(
        GRID, path * white, 0.6 * white, 0.12 * white, 0.15 * one, 2.5 * white, one, diffuser_radiance=white
    )


def day_file(folder: Path, name: str, day: int) -> None:
    state = "P:\t869\nT:\t290\nWV:\t0.5\nO3:\t280\nAOD:\t0.1\nAng:\t0.5\n"
    errors = "P:\t26\nT:\t8\nWV:\t0.05\nO3:\t28\nAOD:\t0.005\nAng:\t0.02\n"
    nm = range(400, 1001, 10)
    values = "".join(f"{x}\t{0.2 + x / 1e4:.4f}\n" for x in nm)
    spread = "".join(f"{x}\t0.006\n" for x in nm)
    (folder / f"{name}.input").write_text(
        f"Site:\tXXXX01\nLat:\t30.5\nLon:\t-109.5\nAlt:\t1270\n\nYear:\t{name[:4]}\nDOY(U):\t{day}\nUTC:\t18:30\n"
        f"DOY(L):\t{day}\nLocal:\t11:30\n{state}Type:\tR\n{values}\n{errors}{spread}"
    )


@pytest.fixture
def overpasses(tmp_path, monkeypatch):
    """The template filled in, and a cube for each of four overpasses; the sensor gains 2 % a year."""
    data = tmp_path / "data"
    for name in ("radcalnet-portal", "radcalnet-sensor"):
        (data / name).mkdir(parents=True)
    monkeypatch.setenv("HYPERVAL_DATA", str(data))
    monkeypatch.setenv("HYPERVAL_WORKERS", "1")  # the stand-in for the engine lives in this process
    monkeypatch.setattr("hyperval.model.stated.atmospheric_terms", terms)
    campaign = shutil.copytree(FOLDER, tmp_path / "campaign") / "campaign.yaml"
    fill_in(campaign, VALUES)
    content = yaml.safe_load(campaign.read_text())
    content["runs"] = [
        {"run": run, "day": run, "half_hour": "18:30", "overpass": f"{run}T18:40:00Z"} for run in OVERPASSES
    ]
    write_yaml(campaign, content)
    rng = np.random.default_rng(5)
    for number, (run, day) in enumerate(OVERPASSES.items()):
        day_file(data / "radcalnet-portal", run, day)
        source = DayScenarios(scenario="scenario.yaml", radcalnet=f"data:radcalnet-portal/{run}.input")
        words = {"overpass": f"{run}T18:40:00Z"}
        ((scenario, *_),) = load_scenarios(source, partial(resolve, base=campaign.parent), campaign.parent, words)
        truth = predict(scenario, Origins(axis=load_sensor(SENSOR).axis)).radiance["site"].mean
        pixels = np.nan_to_num(truth) * (1.0 + 0.02 * 0.5 * number + 0.002 * rng.standard_normal((24, 24, 1)))
        path, place = data / "radcalnet-sensor" / f"{run}.img", {"transform": TRANSFORM, "crs": CRS.from_epsg(32612)}
        write_cube(path, pixels, axis=load_sensor(SENSOR).axis, data_type=4, **place)
        corners = [TRANSFORM @ xy for xy in ((4, 4), (20, 4), (20, 20), (4, 20), (4, 4))]
        square = list(zip(*warp(place["crs"], "EPSG:4326", *zip(*corners, strict=True)), strict=True))
        shape = {"type": "Polygon", "coordinates": [square]}
        features = [{"type": "Feature", "properties": {"name": "site"}, "geometry": shape}]
        written = json.dumps({"type": "FeatureCollection", "features": features})
        path.with_name(f"{run}_site.geojson").write_text(written)
    return campaign


def test_without_files_it_waits_and_says_for_what(monkeypatch, tmp_path):
    monkeypatch.setenv("HYPERVAL_DATA", str(tmp_path))
    items = dry_run([FOLDER / "campaign.yaml"])
    assert {i.what for i in items if i.state == "to fill in"} == set(VALUES)
    lacking = {"data:radcalnet-sensor/2018-05-28.img", "data:radcalnet-portal/BTCN02_2018_148_v00.03.input"}
    assert {i.what for i in items if i.state == "missing"} >= lacking
    for command in ("validate", "benchmark"):
        assert cli.run(["-q", command, str(FOLDER / "campaign.yaml"), "-o", str(tmp_path / command)]) == 5
        assert {str(r.outcome) for r in read_rows(tmp_path / command)} == {"skipped"}


@pytest.mark.slow
def test_from_files_to_verdict_and_drift(overpasses, tmp_path, capsys):
    out = tmp_path / "out"
    code = cli.run(["-q", "validate", str(overpasses), "-o", str(out)])
    rows = Run.open(out).table
    bias = {r.campaign[-10:]: r for r in rows if r.metric == "bias_ratio"}
    # Predicted over collected: a sensor that gains 1 % each half year.
    assert [bias[run].value for run in OVERPASSES] == pytest.approx([0.0, -0.0099, -0.0196, -0.0291], abs=4e-4)
    assert {str(r.outcome) for r in bias.values()} == {"agrees"}
    gates = {name: [r for r in rows if str(r.role) == "gate" and r.metric == name] for name in GATES}
    assert [str(r.outcome) for r in gates["median_difference_ratio_vnir"]] == ["agrees"] * 4
    # The stand-in has none of the errors that the budget holds, and the full test says so.
    assert all(r.cause is Cause.TOO_WIDE for r in gates["p_value_shape"]), gates
    assert code == 1
    capsys.readouterr()
    assert cli.run(["drift", str(out), "--within", "-0.005", "0.005"]) == 1
    printed = capsys.readouterr()
    assert len(printed.out.strip().splitlines()) == 5
    assert printed.out.splitlines()[1].startswith("2020-06-08T18:40:00Z\tradcalnet-sensor-2020-06-08\t")
    assert re.search(r"changes by -0\.0(19|20)\d* in a year", printed.err)
    for code, *words in (
        (0, out, "--within", "-0.05", "0.05"),
        (5, out, "--within", "-0.0195", "0.05"),
        *((2, out, "--metric", metric) for metric in ("bias", "difference_ratio")),  # none, and one for each band
        (3, tmp_path / "none"),
        (2, out, "--within", "1", "0"),
    ):
        assert cli.run(["-q", "drift", *map(str, words)]) == code
