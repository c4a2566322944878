"""The reflectance cube that observe writes on request: read back, whole or not at all, refused without a line."""

import numpy as np
import pytest
import rasterio
from small_world import AXIS, BANDS, GRID, LINES

from hyperval import cli
from hyperval.errors import UsageError
from hyperval.imagery import open_cube
from hyperval.observe import NO_DATA, SCALE, write_reflectance

OUTSIDE = [12, 17]  # a reflectance beyond what the integers hold
FILL = [25, 30]


@pytest.fixture
def measured(make_radiance):
    """Radiance with a pixel without data, one too bright, a band without a gain and a bad band; its cube and line."""
    made = make_radiance()
    world, values = made.world, made.world.values.copy()
    values[tuple(OUTSIDE)] = made.offset + 4.0 * made.gain
    values[..., 3] = 1.0 + 1e-4 * np.random.default_rng(1).standard_normal(values.shape[:2])  # a dark band
    values[tuple(FILL)] = 0.0
    world.write(values, axis=type(AXIS)(AXIS.centre_nm, AXIS.fwhm_nm, np.arange(BANDS) != 5))
    world.detection = None
    seen = world.observe()
    assert seen.elm.usable.tolist() == [True, True, True, False, True, True, True, True]
    return made, seen.place.cube, seen.elm


@pytest.mark.parametrize("form", ["envi", "cog"])
def test_what_is_read_back_is_the_reflectance_to_half_a_step(measured, tmp_path, form):
    made, cube, elm = measured
    path, note = write_reflectance(tmp_path / "out", "r", cube, elm, form)
    found = open_cube(path, quantity="reflectance")
    assert np.array_equal(found.axis.centre_nm, AXIS.centre_nm)
    assert found.axis.fwhm_nm == pytest.approx(AXIS.fwhm_nm, rel=1e-12)
    assert np.flatnonzero(~found.axis.good).tolist() == [3, 5]
    assert (found.transform, found.crs) == (GRID, cube.crs)
    assert found.scaling.gain == pytest.approx(1e-4)
    block = found.read(0, LINES)
    assert np.argwhere(~block.valid).tolist() == [OUTSIDE, FILL]
    assert np.isnan(block.values[..., 3]).all()
    assert np.isnan(block.values[tuple(OUTSIDE)]).all()
    assert np.isnan(block.values[tuple(FILL)]).all()
    difference = np.abs(block.values - made.reflectance)[block.valid][:, elm.usable]
    assert difference.max() <= 0.5 / SCALE * (1 + 1e-9)
    assert "1 bands without a gain; 6 values of good bands beyond 3.2767" in note
    with rasterio.open(path) as dataset:
        assert dataset.nodata == NO_DATA
        if form == "cog":
            assert dataset.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
            assert dataset.units == ("1",) * BANDS
            assert "bad band" in dataset.descriptions[3]
    expected = {"envi": ["r.hdr", "r.img"], "cog": ["r.tif"]}[form]
    assert sorted(p.name for p in path.parent.iterdir()) == expected
    assert path.read_bytes() == write_reflectance(tmp_path / "again", "r", cube, elm, form)[0].read_bytes()


@pytest.mark.parametrize("form", ["envi", "cog"])
def test_a_pass_that_breaks_off_leaves_nothing(measured, tmp_path, monkeypatch, form):
    _, cube, elm = measured
    read, calls = type(cube).read, []

    def failing(self, first, count, *options):
        calls.append(first)
        if first + count >= LINES:
            raise KeyboardInterrupt
        return read(self, first, count, *options)

    monkeypatch.setattr(type(cube), "read", failing)
    with pytest.raises(KeyboardInterrupt):
        write_reflectance(tmp_path / "out", "r", cube, elm, form)
    assert calls
    assert list((tmp_path / "out").iterdir()) == []


def test_a_rotated_grid_keeps_its_own_words(measured, tmp_path):
    _, cube, elm = measured
    header = cube.raster.header.path
    text = header.read_text()
    turned = text.replace("WGS-84, units=Meters", "WGS-84, units=Meters, rotation=12.5")
    assert turned != text
    header.write_text(turned)
    cube = open_cube(cube.raster.path, quantity="radiance", unit="uW cm-2 sr-1 nm-1")
    for form in ("envi", "cog"):
        found = open_cube(write_reflectance(tmp_path / form, "r", cube, elm, form)[0], quantity="reflectance")
        assert found.transform.almost_equals(cube.transform, 1e-6)
        assert found.transform.b != 0


def test_no_line_or_no_radiance_is_refused(measured, world, tmp_path):
    _, cube, elm = measured
    with pytest.raises(UsageError, match="empirical line"):
        write_reflectance(tmp_path, "r", cube, None, "envi")
    path, _ = write_reflectance(tmp_path, "r", cube, elm, "envi")
    with pytest.raises(UsageError, match="needs radiance"):
        write_reflectance(tmp_path, "again", open_cube(path, quantity="reflectance"), elm, "cog")


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
