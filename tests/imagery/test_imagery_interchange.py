"""Cubes and libraries to SPy and xarray and back; what ``hyperval explain`` says of a file."""

from pathlib import Path

import numpy as np
import product_shells as shells
import pytest
import spectral
from affine import Affine
from rasterio.crs import CRS

from hyperval import api, cli
from hyperval.errors import UsageError
from hyperval.figures import ScoreMap
from hyperval.imagery import open_cube, write_cube
from hyperval.spectra import library_to_spy, library_to_xarray, read_records


@pytest.mark.parametrize("interleave", ["bsq", "bil", "bip"])
@pytest.mark.parametrize("order", [0, 1])
def test_an_envi_cube_becomes_a_mapped_image_of_spy(tmp_path: Path, axis, values, interleave: str, order: int):
    options = {"data_type": 2, "axis": axis, "reflectance_scale_factor": 10000.0, "header_offset": 13}
    path = write_cube(tmp_path / "c.img", values, interleave=interleave, byte_order=order, **options)
    image = open_cube(path, quantity="reflectance").to_spy()
    assert isinstance(image, spectral.io.spyfile.SpyFile)
    assert np.allclose(image.load(), values, atol=1e-7)
    assert image.open_memmap(interleave="bip").shape == values.shape
    assert (image.bands.centers, image.bands.band_unit) == (axis.centre_nm.tolist(), "nm")
    back = open_cube(image, quantity="reflectance")  # the file is known by its name
    assert np.allclose(back.read(0, 6).values, values, atol=1e-12)


def test_xarray_reads_by_parts_and_goes_both_ways(tmp_path: Path, monkeypatch):
    want = shells.tree(tmp_path / "n.h5", "neon")
    cube = open_cube(tmp_path / "n.h5", quantity="reflectance")
    array = cube.to_xarray()
    read = []
    plain = type(cube.raster).read_bands
    monkeypatch.setattr(type(cube.raster), "read_bands", lambda *a: read.append(a[1:3]) or plain(*a))
    part = array.isel(line=slice(3, 5), wavelength=2)
    assert not read  # nothing yet
    assert np.allclose(part.values, want[3:5, :, 2], equal_nan=True)
    assert read == [(3, 2)]
    assert np.allclose(array.sel(wavelength=650.0).values, want[:, :, 1], equal_nan=True)
    assert np.allclose(array.isel(line=[0, 11], sample=-1).values, want[[0, 11], -1], equal_nan=True)
    assert (array.attrs["units"], array.name) == ("1", "reflectance")
    array.to_netcdf(tmp_path / "again.nc", engine="h5netcdf")
    for again in (array, tmp_path / "again.nc"):
        back = open_cube(again, quantity="reflectance")
        assert (back.transform, back.crs) == (cube.transform, cube.crs)
        assert back.axis.good.tolist() == cube.axis.good.tolist()
        assert np.allclose(back.read(0, 12).values, want, equal_nan=True)


def test_a_library_goes_both_ways(tmp_path: Path):
    (tmp_path / "l.csv").write_text("wavelength nm,grass,tile\n400,0.05,0.2\n500,0.1,0.3\n600,0.2,0.4\n")
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


# hyperval explain: the reader's own record ------------------------------------------------------


def rows(*given, **options):
    return {what: (value, origin) for what, value, origin in api.explain(*given, **options) if what != "assumed"}


def test_numbers_of_a_header_come_with_file_and_line_and_what_lacks_with_what_mends_it(tmp_path, axis, values, capsys):
    extra = {"reflectance scale factor": "10000"}
    cube = write_cube(tmp_path / "c.img", values, data_type=4, axis=axis, ignore_value=-9.0, extra=extra)
    told, header = rows(cube), cube.with_suffix(".hdr")
    assert told["size"] == ("6 lines, 5 samples, 4 bands of float32", f"{header}:3 'samples'")
    value, origin = told["wavelengths"]
    assert value == "4, 450 to 850 nm"
    assert header.read_text().splitlines()[int(origin.rsplit(":", 1)[1]) - 1].startswith("wavelength =")
    assert told["no data"][0] == "-9"
    assert told["scale of reflectance"] == (
        "x 0.0001 to 0.0001, + 0 to 0",
        "stored values / 10000 (reflectance scale factor)",
    )
    assert told["quantity"] == ("not known", "state quantity: (init: --quantity)")
    assert "exclude each other" in told["scale of radiance"][0]
    assert "state scale:" in told["scale of radiance"][1]
    assert told["position"][0] == "none"
    assert cli.run(["explain", str(cube)]) == 0
    assert "quantity\tnot known\tstate quantity: (init: --quantity)\n" in capsys.readouterr().out
    header.write_text(header.read_text().replace("wavelength units = Nanometers", "wavelength units = Unknown"))
    assert rows(cube)["wavelength unit"] == ("nm", "guess: by the values")


def test_an_array_without_wavelengths_and_a_file_of_spectra(tmp_path):
    np.save(tmp_path / "a.npy", np.ones((3, 4, 5), np.uint16))
    told = rows(tmp_path / "a.npy")
    assert told["is"] == ("array 'a' of a NumPy file", "its first bytes")
    assert "collection.bands" in told["wavelengths"][1]
    (tmp_path / "s.txt").write_text("wavelength_nm reflectance\n" + "".join(f"{w} 0.5\n" for w in range(400, 500, 10)))
    assert rows(tmp_path / "s.txt")["spectrum"][0] == "s: 10 values, 400 to 490 nm"
