"""The reflectance cube that observe writes on request: read back, whole or not at all, refused without a line."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.crs import CRS

from hyperval import cli
from hyperval.errors import UsageError
from hyperval.imagery import open_cube, write_cube
from hyperval.observe import NO_DATA, SCALE, quantised, reflectance_cube, write_reflectance
from hyperval.pixels import MeasuredPanel, fit_elm
from hyperval.spectra import SpectralAxis

LINES, SAMPLES, BANDS = 31, 17, 6
GAIN, OFFSET = np.array([20.0, 18.0, 15.0, 0.0, 9.0, 6.0]), np.array([3.0, 2.0, 1.5, 1.0, 0.4, 0.1])
AXIS = SpectralAxis(
    np.array([450.25, 550.0, 650.5, 1380.0, 1650.0, 2200.125]), np.array([5.5, 5.0, 5.0, 6.0, 7.0, 8.0]),
    np.array([True, True, True, True, True, False]),
)  # fmt: skip
PLACE = {"transform": Affine(2.0, 0, 500000.0, 0, -2.0, 4700000.0), "crs": CRS.from_epsg(32618)}


@pytest.fixture
def scene(tmp_path):
    """A radiance cube, its empirical line (none in the dark band) and the reflectance behind it."""
    rng = np.random.default_rng(0)
    rho = rng.uniform(0.02, 0.7, (LINES, SAMPLES, BANDS))
    rho[4, 5, 1] = 4.0  # does not fit
    radiance = OFFSET + GAIN * rho
    radiance[7, 8] = 0.0  # fill
    path = write_cube(tmp_path / "rad.img", radiance, data_type=5, axis=AXIS, **PLACE)
    levels = [
        MeasuredPanel(
            n, np.full(BANDS, r), np.full(BANDS, 0.002), OFFSET + GAIN * r, np.full(BANDS, 1e-4), 9
        )
        for n, r in (("black", 0.05), ("white", 0.6))
    ]  # fmt: skip
    return open_cube(path, quantity="radiance", unit="uW cm-2 sr-1 nm-1"), fit_elm(levels), rho


@pytest.mark.parametrize("form", ["envi", "cog"])
def test_what_is_read_back_is_the_reflectance_to_half_a_step(scene, tmp_path, monkeypatch, form):
    cube, elm, rho = scene
    assert elm.usable.tolist() == [True, True, True, False, True, True]
    monkeypatch.setattr(reflectance_cube, "_BLOCK_VALUES", 5 * SAMPLES * BANDS)
    path, note = write_reflectance(tmp_path / "out", "r", cube, elm, form)
    found = open_cube(path, quantity="reflectance")
    assert np.array_equal(found.axis.centre_nm, AXIS.centre_nm)
    assert found.axis.fwhm_nm == pytest.approx(AXIS.fwhm_nm, rel=1e-12)
    assert found.axis.good.tolist() == [True, True, True, False, True, False]
    assert (found.transform, found.crs) == (PLACE["transform"], PLACE["crs"])
    assert found.scaling.gain == pytest.approx(1e-4)
    block = found.read(0, LINES)
    lost = np.zeros((LINES, SAMPLES), bool)
    lost[4, 5] = lost[7, 8] = True
    assert np.array_equal(block.valid, ~lost)
    usable = elm.usable
    assert np.isnan(block.values[..., ~usable]).all()
    assert np.isnan(block.values[7, 8]).all()
    assert np.isnan(block.values[4, 5, 1])
    difference = np.abs(block.values[~lost][:, usable] - rho[~lost][:, usable])
    assert difference.max() <= 0.5 / SCALE * (1 + 1e-9)
    assert "1 bands without a gain; 1 values of good bands beyond 3.2767" in note
    with rasterio.open(path) as dataset:
        assert dataset.nodata == NO_DATA
        if form == "cog":
            assert dataset.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
            assert dataset.units == ("1",) * BANDS
            assert "bad band" in dataset.descriptions[3]
    expected = {"envi": ["r.hdr", "r.img"], "cog": ["r.tif"]}[form]
    assert sorted(p.name for p in path.parent.iterdir()) == expected


def test_the_same_input_gives_the_same_bytes(scene, tmp_path):
    cube, elm, _ = scene
    for form in ("envi", "cog"):
        one, two = (write_reflectance(tmp_path / str(i), "r", cube, elm, form)[0] for i in range(2))
        assert one.read_bytes() == two.read_bytes()


@pytest.mark.parametrize("form", ["envi", "cog"])
def test_a_pass_that_breaks_off_leaves_nothing(scene, tmp_path, monkeypatch, form):
    cube, elm, _ = scene
    monkeypatch.setattr(reflectance_cube, "_BLOCK_VALUES", 5 * SAMPLES * BANDS)
    read = type(cube).read

    def failing(self, first, count, *options):
        if first > 10:
            raise KeyboardInterrupt
        return read(self, first, count, *options)

    monkeypatch.setattr(type(cube), "read", failing)
    with pytest.raises(KeyboardInterrupt):
        write_reflectance(tmp_path / "out", "r", cube, elm, form)
    assert list((tmp_path / "out").iterdir()) == []


def test_a_rotated_grid_keeps_its_own_words(scene, tmp_path):
    cube, elm, _ = scene
    text = cube.raster.header.path.read_text()
    turned = text.replace("WGS-84, units=Meters", "WGS-84, units=Meters, rotation=12.5")
    assert turned != text
    cube.raster.header.path.write_text(turned)
    cube = open_cube(cube.raster.path, quantity="radiance", unit="uW cm-2 sr-1 nm-1")
    for form in ("envi", "cog"):
        path, _ = write_reflectance(tmp_path / form, "r", cube, elm, form)
        found = open_cube(path, quantity="reflectance")
        assert found.transform.almost_equals(cube.transform, 1e-6)
        assert found.transform.b != 0


def test_no_line_or_no_radiance_is_refused(scene, tmp_path):
    cube, elm, rho = scene
    with pytest.raises(UsageError, match="empirical line"):
        write_reflectance(tmp_path, "r", cube, None, "envi")
    already = open_cube(write_cube(tmp_path / "rho.img", np.clip(rho, 0, 1), axis=AXIS), quantity="reflectance")
    with pytest.raises(UsageError, match="needs radiance"):
        write_reflectance(tmp_path, "r", already, elm, "cog")


def test_rounding():
    assert quantised([0.12345, -0.00004, 3.2767, 3.27676, np.nan, np.inf, -4.0]).tolist() == [
        1234, 0, 32767, NO_DATA, NO_DATA, NO_DATA, NO_DATA,
    ]  # fmt: skip


def test_the_command_writes_it_and_refuses_a_campaign_without_a_line(small, tmp_path, capsys):
    out, other = tmp_path / "out", tmp_path / "other"
    path = small.write()
    assert cli.run(["-q", "observe", str(path), "-o", str(out), "--write-reflectance", "envi"]) == 0
    assert {p.name for p in (out / "reflectance").iterdir()} == {"reflectance.img", "reflectance.hdr"}
    found = open_cube(out / "reflectance" / "reflectance.img", quantity="reflectance")
    assert 0.0 < np.nanmean(found.read(0, 5).values) < 0.8
    assert "reflectance.img: reflectance by the empirical line" in (out / "report.html").read_text()
    del small.data["collection"]["empirical_line"]
    code = cli.run(["-q", "observe", str(small.write()), "-o", str(other), "--write-reflectance", "cog"])
    assert code == 2
    assert "there is no empirical line" in capsys.readouterr().err
    assert not other.exists()
