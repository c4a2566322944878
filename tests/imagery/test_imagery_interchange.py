"""Cubes, maps and libraries to SPy and xarray and back: the same numbers, read by parts where they can be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import product_shells as shells
import pytest
import spectral
from affine import Affine
from rasterio.crs import CRS

from hyperval.errors import UsageError
from hyperval.figures import ScoreMap
from hyperval.imagery import open_cube, write_cube
from hyperval.spectra import library_to_spy, library_to_xarray, read_records


@pytest.mark.parametrize("interleave", ["bsq", "bil", "bip"])
@pytest.mark.parametrize("order", [0, 1])
def test_an_envi_cube_becomes_a_mapped_image_of_spy(tmp_path: Path, axis, values, interleave: str, order: int):
    path = write_cube(
        tmp_path / "c.img", values, data_type=2, interleave=interleave, byte_order=order, axis=axis,
        reflectance_scale_factor=10000.0, header_offset=13,
    )  # fmt: skip
    image = open_cube(path, quantity="reflectance").to_spy()
    assert isinstance(image, spectral.io.spyfile.SpyFile)
    assert np.allclose(image.load(), values, atol=1e-7)
    assert image.open_memmap(interleave="bip").shape == values.shape
    assert image.bands.centers == axis.centre_nm.tolist()
    assert image.bands.band_unit == "nm"
    back = open_cube(image, quantity="reflectance")  # the file is known by its name
    assert np.allclose(back.read(0, 6).values, values, atol=1e-12)


def test_xarray_reads_by_parts_and_goes_both_ways(tmp_path: Path, monkeypatch):
    shells.neon_reflectance(tmp_path / "n.h5")
    cube = open_cube(tmp_path / "n.h5", quantity="reflectance")
    array = cube.to_xarray()
    read = []
    plain = type(cube.raster).read_bands
    monkeypatch.setattr(type(cube.raster), "read_bands", lambda *a: read.append(a[1:3]) or plain(*a))
    part = array.isel(line=slice(3, 5), wavelength=2)
    assert not read  # nothing yet
    want = cube.read(0, cube.lines).values
    read.clear()
    assert np.array_equal(part.values, want[3:5, :, 2], equal_nan=True)
    assert read == [(3, 2)]
    assert np.array_equal(array.sel(wavelength=650.0).values, want[:, :, 1], equal_nan=True)
    assert np.array_equal(array.isel(line=[0, 11], sample=-1).values, want[[0, 11], -1], equal_nan=True)
    assert (array.attrs["units"], array.name) == ("1", "reflectance")
    back = open_cube(array, quantity="reflectance")
    assert (back.transform, back.crs) == (cube.transform, cube.crs)
    assert back.axis.good.tolist() == cube.axis.good.tolist()
    assert np.array_equal(back.read(0, 12).values, want, equal_nan=True)
    array.to_netcdf(tmp_path / "again.nc", engine="h5netcdf")
    again = open_cube(tmp_path / "again.nc", quantity="reflectance")
    assert np.array_equal(again.read(0, 12).values, want, equal_nan=True)
    assert again.transform == cube.transform


def test_a_library_goes_both_ways(tmp_path: Path):
    text = "wavelength nm,grass,tile\n400,0.05,0.2\n500,0.1,0.3\n600,0.2,0.4\n"
    (tmp_path / "l.csv").write_text(text)
    ours = read_records(tmp_path / "l.csv")
    for theirs in (library_to_spy(ours), library_to_xarray(ours)):
        back = read_records(theirs)
        assert [s.name for s in back] == ["grass", "tile"]
        for a, b in zip(ours, back, strict=True):
            assert np.array_equal(a.wavelength_nm, b.wavelength_nm)
            assert np.array_equal(a.values, b.values)
    library_to_spy(ours).save(str(tmp_path / "spy"))
    assert [s.name for s in read_records(tmp_path / "spy.sli")] == ["grass", "tile"]
    with pytest.raises(UsageError, match="one set of wavelengths"):
        library_to_spy([])
    with pytest.raises(UsageError, match="of type dict without wavelengths"):
        read_records({})


def test_a_score_map_becomes_theirs():
    values = np.arange(12.0).reshape(3, 4)
    scores = ScoreMap(values, tuple(Affine(2, 0, 5, 0, -2, 9))[:6], "EPSG:32633")
    array = scores.to_xarray()
    assert np.array_equal(array.values, values)
    assert CRS.from_wkt(array.spatial_ref.attrs["crs_wkt"]).to_epsg() == 32633
    assert np.array_equal(np.asarray(scores.to_spy())[:, :, 0], values)


@pytest.mark.parametrize("thing", [7, np.zeros((3, 4, 5)), None])
def test_what_is_no_cube_is_refused(thing):
    with pytest.raises(UsageError, match="is no cube"):
        open_cube(thing, quantity="other")
