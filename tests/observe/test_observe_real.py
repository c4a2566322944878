"""The campaign of docs/flight-line.md on a stand-in of its folder."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from small_world import moments

from hyperval import cli
from hyperval.collection import CollectionSection
from hyperval.imagery import open_raster
from hyperval.observe import observe
from hyperval.run import read_rows

PAGE = Path(__file__).parents[2] / "docs/flight-line.md"
BLOCKS = re.findall(r"```yaml\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
LINES, SAMPLES, BANDS = 40, 48, 30
WAVELENGTH = np.linspace(400.0, 2450.0, BANDS)


def delivered(folder: Path) -> np.ndarray:
    """Radiances in units of 0.001 as 16-bit BIL, wavelengths without a unit, and a lookup table beside."""
    rng = np.random.default_rng(7)
    level = 3.0 * np.exp(-(((WAVELENGTH - 550.0) / 700.0) ** 2)) + 0.2
    brightness = np.full((LINES, SAMPLES), 0.3)
    brightness[20:26, 4:10], brightness[20:26, 20:26] = 0.5, 2.0
    values = level[:, None, None] * brightness * rng.normal(1.0, 0.01, (BANDS, LINES, SAMPLES))
    values[:, 31:33, 40] *= np.linspace(0.7, 1.4, BANDS)[:, None]  # two pixels of another colour
    stored = np.rint(1000.0 * values).astype("<i2")
    table = np.stack(np.meshgrid(np.arange(1, SAMPLES + 1), np.arange(1, LINES + 1))).astype("<i4")
    waves = "wavelength units = Unknown\nwavelength = {" + ", ".join(f"{w:.2f}" for w in WAVELENGTH) + "}\n"
    place = "map info = {UTM, 1, 1, 250000, 3350000, 4, 4, 17, North, WGS-84, units=Meters}\n"
    for name, array, bands, kind, rest in (
        ("rad", stored.transpose(1, 0, 2), BANDS, 2, "interleave = bil\n" + waves),
        ("rad_glt", table, 2, 3, "interleave = bsq\n" + place),
    ):
        array.tofile(folder / f"Suwannee_0609-1331_{name}.dat")
        (folder / f"Suwannee_0609-1331_{name}.hdr").write_text(
            f"ENVI\nsamples = {SAMPLES}\nlines = {LINES}\nbands = {bands}\nheader offset = 0\ndata type = {kind}\n"
            f"byte order = 0\n{rest}"
        )
    return stored * 0.001


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_pages_campaign_runs_from_the_delivered_folder(tmp_path):
    values, collection = delivered(tmp_path), yaml.safe_load(BLOCKS[0])["collection"]

    def observed(**more):
        return observe(CollectionSection.model_validate(collection | more), None, tmp_path.joinpath).observation

    found = observed()
    want = values[:, 4:16, 4:16].reshape(BANDS, -1).mean(axis=1)
    np.testing.assert_allclose(found.radiance["water"].mean, want, rtol=1e-6)
    # Noise of 1 % is 100; its spread from 144 pixels is 6 %, and rounding adds 0.3 of the smallest step.
    assert np.median(found.snr["water"].mean) == pytest.approx(100.0, rel=0.2)
    assert any("rad_glt.dat lies beside the cube and places its pixels" in note for note in found.notes)
    for name, level in (("road", 0.05), ("roof", 0.2)):
        rows = "".join(f"{w:.2f},{level}\n" for w in WAVELENGTH)
        (tmp_path / f"{name}.txt").write_text("wavelength_nm,reflectance\n" + rows)
    lit = observed(**yaml.safe_load("collection:\n" + BLOCKS[1])["collection"])
    # The line goes through both panels: 0.05 and 0.2 at brightness 0.5 and 2, so water at 0.3 reflects 0.03.
    assert np.allclose(lit.reflectance["water"].mean, 0.03, atol=0.003)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_page_as_it_stands_gives_a_report_with_anomalies(tmp_path):
    """The first block alone, by the command of the page: no target, no truth, no edit."""
    values = delivered(tmp_path)
    (tmp_path / "campaign.yaml").write_text(BLOCKS[0])
    assert cli.run(["-q", "observe", str(tmp_path / "campaign.yaml"), "-o", str(tmp_path / "out")]) == 0
    scores = open_raster(tmp_path / "out/scores/rx.tif").read_bands(0, LINES)[0]
    mean, covariance = moments(values.transpose(1, 2, 0))
    away = values.reshape(BANDS, -1) - mean[:, None]
    distance = np.einsum("bn,bn->n", away, np.linalg.solve(covariance, away)).reshape(LINES, SAMPLES)
    np.testing.assert_allclose(scores, distance, rtol=1e-4)
    assert scores[31:33, 40].min() > np.partition(scores, -3, axis=None)[-3]  # the two that were planted lead
    report = (tmp_path / "out/report.html").read_text("utf-8")
    # 1,920 pixels: at 1e-2 nineteen lie above the threshold.
    threshold = np.sort(scores, axis=None)[-20]
    found = re.search(r"rx: (\d+) anomalies, groups of touching pixels beyond ([\d.]+), which 0.01 of", report)
    assert float(found[2]) == pytest.approx(threshold, rel=1e-3)
    assert 1 <= int(found[1]) <= 19
    line = int(np.argmax(scores[31:33, 40])) + 31
    assert f"line {line}, sample 40: {scores[line, 40]:.4g}, 2 pixels" in report
    level = next(r for r in read_rows(tmp_path / "out") if r.metric == "anomaly_threshold@1e-2")
    assert np.mean(scores > level.value) == pytest.approx(0.01, abs=1.0 / scores.size + 1e-6)
