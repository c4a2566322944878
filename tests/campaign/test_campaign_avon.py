"""share2012-avon without its collection: what it lacks, where the sun is, and that it runs once it is filled in.

The files of one line are simulated here under the names that its README gives, with all 360 bands.
"""

from __future__ import annotations

import json
import math
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from hyperval.atmosphere.solar import parse_utc, solar_position
from hyperval.campaign.draft import read_texts
from hyperval.campaign.dry_run import dry_run
from hyperval.campaign.one import jobs_of, run_campaign
from hyperval.campaign.run import validate
from hyperval.compare.difference import Z95
from hyperval.config import load_yaml
from hyperval.report.stored import read_results
from hyperval.results import Cause, Outcome
from hyperval.scene.builtin import builtin_class
from hyperval.simulate import SceneFile, simulate
from hyperval.simulate.inputs import SimulationInputs, sensor_numbers
from hyperval.spectra.axis import SpectralAxis
from small_campaign import PANELS, scene_data, stand_in_atmosphere

FOLDER = Path(__file__).parents[2] / "campaigns" / "share2012-avon"
CAMPAIGN = FOLDER / "campaign.yaml"
LINES = ["0920-1631", "0920-1638", "0920-1646", "0920-1654", "0920-1706"]
VALUES = {
    "collection.cube.scale": "0.001",
    "collection.empirical_line.panels.0.relative_uncertainty": "0.02",
    "collection.empirical_line.panels.1.relative_uncertainty": "0.02",
    "collection.calibration.relative": "0.05",
    "atmosphere.water_vapour_g_cm2": "1.4",
    "atmosphere.meteorological_range_km": "40.0",
    "atmosphere.sensor_altitude_km": "0.95",
    "uncertainty.meteorological_range_km": "5.0",
    "scene.classes.0.fraction": "0.43",
    "scene.classes.1.fraction": "0.57",
    "scene.targets.0.subjects.0.fill.geometry.length_m": "0.47",
    "scene.targets.0.subjects.0.fill.geometry.width_m": "0.47",
    "scene.targets.1.subjects.0.fill.geometry.length_m": "0.47",
    "scene.targets.1.subjects.0.fill.geometry.width_m": "0.47",
}


@pytest.fixture
def no_data(tmp_path, monkeypatch) -> Path:
    data = tmp_path / "data"
    data.mkdir()
    monkeypatch.setenv("HYPERVAL_DATA", str(data))
    monkeypatch.setenv("HYPERVAL_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("HYPERVAL_WORKERS", "1")
    return data


def test_five_lines_each_with_its_files_and_values(no_data):
    items = dry_run([CAMPAIGN])
    assert list(dict.fromkeys(i.campaign for i in items)) == [f"share2012-avon-{line}" for line in LINES]
    for line in LINES:
        own = [i for i in items if i.campaign == f"share2012-avon-{line}"]
        assert {i.what for i in own if i.kind == "value"} == set(VALUES)
        missing = [i.what for i in own if i.state == "missing"]
        assert len(missing) == 9
        assert f"data:share2012/lines/{line}_rad.dat" in missing
        assert any(i.kind == "comparison" and i.detail.endswith("decides") for i in own)


def test_the_readme_names_every_file_and_every_line(no_data):
    text = (FOLDER / "README.md").read_text()
    for item in dry_run([CAMPAIGN]):
        if item.state == "missing":
            name = re.sub(r"0920-\d{4}", "LINE", item.what.removeprefix("data:share2012/"))
            assert name.split("/")[-1] in text, name
    assert all(line.removeprefix("0920") in text for line in LINES)


def test_without_the_collection_it_is_skipped_and_the_run_does_not_fail(no_data, tmp_path):
    assert validate([CAMPAIGN], tmp_path / "out", show_progress=False) == 5  # nothing was checked, nothing failed
    rows = read_results(tmp_path / "out" / "results.json")
    assert {str(r.outcome) for r in rows} == {"skipped"}
    assert {r.campaign for r in rows} == {f"share2012-avon-{line}" for line in LINES}
    assert all("held by Rochester Institute of Technology" in r.reason for r in rows)


def test_the_sun_stands_42_to_43_degrees_from_the_zenith():
    """Declination 0.9 deg on that day: at noon (about 17:04 UTC there) the zenith angle is 42.9 - 0.9 = 42.0."""
    data, _ = load_yaml(FOLDER / "scenario.yaml")
    place = data["atmosphere"]
    found = []
    for text in read_texts(CAMPAIGN):
        when = parse_utc(place["time_utc"].replace("{start}", text.words["start"]))
        assert when.strftime("%m%d-%H%M") == text.words["line"]
        zenith, azimuth = solar_position(place["latitude_deg"], place["longitude_deg"], when)
        found.append(zenith)
        # Another route: declination and equation of time of the Astronomical Almanac's low-precision sun.
        assert zenith == pytest.approx(low_precision_zenith(when, 42.9, -77.75), abs=0.03)
        assert 160 < azimuth < 185
    assert all(42.0 < z < 43.0 for z in found)
    assert found == sorted(found, reverse=True)  # all before noon, or close to it


def low_precision_zenith(when, latitude: float, longitude: float) -> float:
    """Solar zenith [deg] from the Almanac's low-precision formulas (0.01 deg in longitude)."""
    n = when.timestamp() / 86400.0 + 2440587.5 - 2451545.0
    g = np.radians((357.528 + 0.9856003 * n) % 360)
    lam = np.radians((280.460 + 0.9856474 * n + 1.915 * np.sin(g) + 0.020 * np.sin(2 * g)) % 360)
    eps = np.radians(23.439 - 4e-7 * n)
    ra, dec = np.arctan2(np.cos(eps) * np.sin(lam), np.cos(lam)), np.arcsin(np.sin(eps) * np.sin(lam))
    hour = np.radians(((18.697374558 + 24.06570982441908 * n) % 24) * 15 + longitude) - ra
    lat = np.radians(latitude)
    return float(np.degrees(np.arccos(np.sin(lat) * np.sin(dec) + np.cos(lat) * np.cos(dec) * np.cos(hour))))


def filled_in(folder: Path) -> Path:
    """A copy of the campaign for the first line, every value filled in by what VALUES says."""
    shutil.copytree(FOLDER, folder)
    (text, *_) = read_texts(folder / "campaign.yaml")
    for mark in text.named.to_fill_in:
        name, _, number = mark.where.rpartition(":")
        lines = Path(name).read_text().splitlines()
        at = int(number) - 1
        lines[at] = re.sub(r'"FILL_IN.*"', VALUES[mark.key], lines[at])
        Path(name).write_text("\n".join(lines) + "\n")
    path = folder / "campaign.yaml"
    kept = [row for row in path.read_text().splitlines() if not re.match(r"  - \{line: 0920-(?!1631)", row)]
    # Reasons of each subject are looked for elsewhere; here the what-ifs are enough.
    path.write_text("\n".join(kept).replace('each: ["*"]', "each: []") + "\n")
    return path


def collected(data: Path) -> None:
    """One flight line under the names of the README: cube, regions, planks, field spectra."""
    scene = scene_data() | {"sensor": "prospectir-vs-2012", "name": "avon"}
    scene["regions"] = [
        {"name": "grass-field", "surface": "grass"},
        {"name": "asphalt-court", "surface": "asphalt"},
    ]
    # As the template takes them: at any phase, any way round.
    planks = {"spacing_pixels": 6, "count": 24, "side_m": 0.47, "phase": "random", "heading_deg": "random"}
    scene["targets"] = [
        {**planks, "name": "yellow-planks", "material": "yellow-paint-plank", "host": "asphalt",
         "area": {"lines": [36, 84], "samples": [0, 72]}},
        {**planks, "name": "green-planks", "material": "green-paint-plank", "host": "grass",
         "area": {"lines": [14, 36], "samples": [0, 72]}},
    ]  # fmt: skip
    sensor = sensor_numbers("prospectir-vs-2012")
    made = SceneFile.model_validate(scene)
    terms = stand_in_atmosphere(made.atmosphere).at_bands(sensor.axis)
    classes = {name: builtin_class(name, sensor.axis) for name in made.materials()}
    simulate(made, data / "raw", inputs=SimulationInputs(sensor, terms, classes))
    root = data / "share2012"
    for name in ("lines", "regions", "truth", "spectra"):
        (root / name).mkdir(parents=True)
    shutil.move(data / "raw" / "avon_rad.img", root / "lines" / "0920-1631_rad.dat")
    shutil.move(data / "raw" / "avon_rad.hdr", root / "lines" / "0920-1631_rad.hdr")
    planks_csv = (data / "raw" / "targets.csv").read_text()
    (root / "truth" / "0920-1631_planks.csv").write_text(planks_csv.replace("-paint-plank", "-plank"))
    (root / "regions" / "0920-1631_regions.xml").write_text(as_xml(data / "raw" / "regions.geojson"))
    grid = SpectralAxis(np.arange(380.0, 2501.0, 1.0), np.full(2121, 1.0))
    sources = {"white-panel": "white-panel", "black-panel": "black-panel", "grass": "grass", "asphalt": "asphalt",
               "yellow-plank": "yellow-paint-plank", "green-plank": "green-paint-plank"}  # fmt: skip
    for name, builtin in sources.items():
        mean = builtin_class(builtin, grid).mean
        rows = [f"{w:g}\t{v:.6f}" for w, v in zip(grid.centre_nm, mean, strict=True)]
        (root / "spectra" / f"{name}.txt").write_text("\n".join(["wavelength [nm]\treflectance [1]", *rows]) + "\n")


def as_xml(geojson: Path) -> str:
    """The regions as ENVI 5 writes them, in pixel coordinates."""
    out = ['<?xml version="1.0"?>', "<RegionsOfInterest>"]
    for feature in json.loads(geojson.read_text())["features"]:
        name = feature["properties"]["name"]
        if name in PANELS and name not in ("white-panel", "black-panel"):
            continue
        geometry = feature["geometry"]
        polygons = geometry["coordinates"] if geometry["type"] == "MultiPolygon" else [geometry["coordinates"]]
        out.append(f'<Region name="{name}"><GeometryDef><CoordSysStr>none</CoordSysStr>')
        for rings in polygons:
            out.append("<Polygon>")
            for kind, ring in zip(["Exterior"] + ["Interior"] * len(rings), rings, strict=False):
                points = " ".join(f"{x} {y}" for x, y in ring)
                out.append(f"<{kind}><LinearRing><Coordinates>{points}</Coordinates></LinearRing></{kind}>")
            out.append("</Polygon>")
        out.append("</GeometryDef></Region>")
    return "\n".join([*out, "</RegionsOfInterest>"])


@pytest.mark.slow
@pytest.mark.usefixtures("own_atmosphere")
def test_filled_in_it_runs_through(no_data, tmp_path, monkeypatch):
    # Draws of covariances in 360 bands take half of the run, and other campaigns have them.
    monkeypatch.setattr("hyperval.compare.covariance.sampled", lambda *words: None)
    monkeypatch.setattr("hyperval.campaign.curves.sampled", lambda *words: None)
    collected(no_data)
    path = filled_in(tmp_path / "campaign")
    assert "FILL_IN" not in "".join(str(yaml.safe_load(p.read_text())) for p in path.parent.glob("*.yaml"))
    assert [i for i in dry_run([path]) if i.lacking] == []
    (job,) = jobs_of(path)
    run = run_campaign(job, show_progress=False)
    rows = list(run.table)
    decided = {
        r.subject: r
        for r in rows
        if math.isfinite(r.limit_high) and r.product == "radiance" and "median_abs" in r.metric
    }
    assert set(decided) == {"white-panel", "black-panel", "grass-field", "asphalt-court"}
    # The stand-in atmosphere is the same on both sides: the radiances meet, save for the panels' 2 % of the area.
    met = [r for s, r in decided.items() if s != "asphalt-court"]
    assert max(r.value for r in met) < 0.01
    # A calibration of 5 % alone reaches 1.96 x 5 % and the atmosphere adds to it, so that no interval fits below
    # the 10 % that the template asks for: undecided, whatever the line shows.
    assert {(r.outcome, r.cause) for r in met} == {(Outcome.UNDECIDED, Cause.WIDE_INTERVAL)}
    assert min(r.upper for r in met) > Z95 * math.hypot(0.05, 0.01)
    explained = {
        (r.product, r.subject): r.value
        for r in rows
        if r.metric == "p_value_full" and r.product in ("radiance", "reflectance") and r.subject in decided
    }
    assert not any(("reflectance", f"{panel}-panel") in explained for panel in ("white", "black"))
    assert len(explained) == 6
    # One seed; a right model falls below this once in a thousand runs.
    assert all(p > 1e-3 / 6 for p in explained.values())
    curves = {key[0] for key in run.observation.roc} & {key[0] for key in run.prediction.roc}
    assert {"yellow-planks", "green-planks"} <= curves
    # Like pixels with like: all that a plank touches on both sides, of which the emptier ones are not found.
    gaps = {
        (r.subject, r.method): r for r in rows if r.metric == "pd_difference@1e-2" and r.subject.endswith("planks")
    }
    # 24 planks of each colour; with the fullest pixel of each in the prediction the first two were off by 0.4.
    found = {
        ("yellow-planks", "cem/pixel"): 0.02, ("green-planks", "cem/pixel"): -0.06,
        ("yellow-planks", "cem/object"): 0.0, ("green-planks", "cem/object"): -0.11,
    }  # fmt: skip
    # One plank of the 24 more or fewer is 0.04.
    assert {key: r.value for key, r in gaps.items()} == pytest.approx(found, abs=0.06)
    assert all(r.lower <= 0.0 <= r.upper for r in gaps.values())
    assert not [r for r in rows if r.outcome == "error"]
    # The small scene has too few background pixels for the lowest false-alarm rate, and the two panels of the line
    # give themselves back: both are said.
    known = ("alarms", "no evidence")
    assert not [r for r in rows if r.outcome == "skipped" and not any(k in r.reason for k in known)]
    assert run.campaign == "share2012-avon-0920-1631"
