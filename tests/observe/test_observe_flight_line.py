"""The campaign of docs/flight-line.md on a stand-in of the delivered folder, whose pixels are simulated."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rasterio
import yaml
from pydantic import ValidationError

from hyperval import cli
from hyperval.collection import CollectionSection, Detection
from hyperval.observe import anomaly_note, observe

PAGE = Path(__file__).parents[2] / "docs/flight-line.md"
LINES, SAMPLES, BANDS = 40, 48, 30


def delivered(folder: Path) -> np.ndarray:
    """Radiances in units of 0.001 as 16-bit BIL, wavelengths without a unit, and a lookup table beside."""
    rng = np.random.default_rng(7)
    wavelength = np.linspace(400.0, 2450.0, BANDS)
    level = 3.0 * np.exp(-(((wavelength - 550.0) / 700.0) ** 2)) + 0.2
    brightness = np.full((LINES, SAMPLES), 0.3)
    brightness[20:26, 4:10], brightness[20:26, 20:26] = 0.5, 2.0
    values = level[:, None, None] * brightness * rng.normal(1.0, 0.01, (BANDS, LINES, SAMPLES))
    values[:, 31:33, 40] *= np.linspace(0.7, 1.4, BANDS)[:, None]  # two pixels of another colour
    stored = np.rint(1000.0 * values).astype("<i2")
    stored.transpose(1, 0, 2).tofile(folder / "Suwannee_0609-1331_rad.dat")
    sizes = "ENVI\nsamples = {}\nlines = {}\nbands = {}\nheader offset = 0\ndata type = {}\n"
    (folder / "Suwannee_0609-1331_rad.hdr").write_text(
        sizes.format(SAMPLES, LINES, BANDS, 2)
        + "interleave = bil\nbyte order = 0\nwavelength units = Unknown\nwavelength = {"
        + ", ".join(f"{w:.2f}" for w in wavelength) + "}\n"
    )  # fmt: skip
    table = np.stack(np.meshgrid(np.arange(1, SAMPLES + 1), np.arange(1, LINES + 1))).astype("<i4")
    table.tofile(folder / "Suwannee_0609-1331_rad_glt.dat")
    (folder / "Suwannee_0609-1331_rad_glt.hdr").write_text(
        sizes.format(SAMPLES, LINES, 2, 3)
        + "interleave = bsq\nbyte order = 0\n"
        + "map info = {UTM, 1, 1, 250000, 3350000, 4, 4, 17, North, WGS-84, units=Meters}\n"
    )
    return stored * 0.001


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_pages_campaign_runs_from_the_delivered_folder(tmp_path: Path):
    values = delivered(tmp_path)
    blocks = re.findall(r"```yaml\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    collection = yaml.safe_load(blocks[0])["collection"]
    run = observe(CollectionSection.model_validate(collection), None, lambda name: tmp_path / name, show_progress=False)
    found = run.observation
    want = values[:, 4:16, 4:16].reshape(BANDS, -1).mean(axis=1)
    np.testing.assert_allclose(found.radiance["water"].mean, want, rtol=1e-6)
    # Noise of 1 % is 100; its spread from 144 pixels is 6 %, and rounding adds 0.3 of the smallest step.
    assert np.median(found.snr["water"].mean) == pytest.approx(100.0, rel=0.2)
    assert any("rad_glt.dat lies beside the cube and places its pixels" in note for note in found.notes)

    line = yaml.safe_load("collection:\n" + blocks[1])["collection"]["empirical_line"]
    wavelength = np.linspace(400.0, 2450.0, BANDS)
    for name, level in (("road", 0.05), ("roof", 0.2)):
        rows = "".join(f"{w:.2f},{level}\n" for w in wavelength)
        (tmp_path / f"{name}.txt").write_text("wavelength_nm,reflectance\n" + rows)
    whole = CollectionSection.model_validate(collection | {"empirical_line": line})
    lit = observe(whole, None, lambda name: tmp_path / name, show_progress=False).observation
    # The line goes through both panels: 0.05 and 0.2 at brightness 0.5 and 2, so water at 0.3 reflects 0.03.
    assert np.allclose(lit.reflectance["water"].mean, 0.03, atol=0.003)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_page_as_it_stands_gives_a_report_with_anomalies(tmp_path: Path):
    """The first block alone, by the command of the page: no target, no truth, no edit."""
    values = delivered(tmp_path)
    block = re.findall(r"```yaml\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)[0]
    (tmp_path / "campaign.yaml").write_text(block)
    assert cli.run(["-q", "observe", str(tmp_path / "campaign.yaml"), "-o", str(tmp_path / "out")]) == 0
    with rasterio.open(tmp_path / "out/scores/rx.tif") as stream:
        scores = stream.read(1)
    pixels = values.reshape(BANDS, -1)
    away = pixels - pixels.mean(axis=1, keepdims=True)
    distance = np.einsum("bn,bn->n", away, np.linalg.solve(np.cov(pixels), away)).reshape(LINES, SAMPLES)
    np.testing.assert_allclose(scores, distance, rtol=1e-4)
    assert scores[31:33, 40].min() > np.partition(scores, -3, axis=None)[-3]  # the two that were planted lead
    report = (tmp_path / "out/report.html").read_text("utf-8")
    assert re.search(r"rx: \d+ anomalies, groups of touching pixels beyond", report)
    line = int(np.argmax(scores[31:33, 40])) + 31
    assert f"line {line}, sample 40: {scores[line, 40]:.4g}, 2 pixels" in report
    with (tmp_path / "out/results.csv").open(newline="") as stream:
        rows = {r["metric"]: r for r in csv.DictReader(stream) if r["subject"] == "anomalies"}
    threshold = float(rows["anomaly_threshold@1e-2"]["value"])
    assert np.mean(scores > threshold) == pytest.approx(0.01, abs=1.0 / scores.size + 1e-6)
    assert float(rows["anomaly_threshold@1e-2"]["n"]) == scores.size


def test_the_threshold_of_anomalies_lets_the_stated_part_through():
    place = SimpleNamespace(cube=SimpleNamespace(transform=None))
    note = anomaly_note(place, "rx", np.arange(2000.0).reshape(20, 100), np.ones((20, 100), bool))
    assert "rx: 1 anomalies, groups of touching pixels beyond 1979, which 0.01 of" in note  # 20 lie above
    assert "sample 99: 1999, 20 pixels" in note


def test_without_targets_other_detectors_are_refused():
    with pytest.raises(ValidationError, match="without targets the detectors can only be rx"):
        Detection(detectors=["rx", "cem"])
    with pytest.raises(ValidationError, match="halo_pixels need targets"):
        Detection(detectors=["rx"], halo_pixels=1)
