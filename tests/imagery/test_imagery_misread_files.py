"""Good files that were read as other numbers: packed arrays, numbered bands, tables and headers of one name."""

from __future__ import annotations

import re
from pathlib import Path

import h5py
import numpy as np
import product_shells as shells
import pytest
import xarray as xr

from hyperval.collection import AbundanceTruth
from hyperval.errors import InputError
from hyperval.imagery import open_cube, open_raster, read_regions, sun_zenith_deg, write_cube
from hyperval.observe import abundance_targets

TRUE = np.linspace(0.05, 0.6, 3 * 4 * 5).reshape(3, 4, 5)


def packed(path: Path, stored: np.ndarray, name: str = "reflectance", **attrs) -> Path:
    """A NetCDF-4 file of one array (wavelength, y, x), its numbers and attributes as given."""
    data = xr.Dataset(
        {name: (("wavelength", "y", "x"), stored, attrs)},
        coords={"wavelength": ("wavelength", [500.0, 600.0, 700.0], {"units": "nm"})},
    )
    data.to_netcdf(path, engine="h5netcdf")
    return path


def values(path: Path, **options) -> np.ndarray:
    """(3, 4, 5) values band by band."""
    cube = open_cube(path, **({"quantity": "reflectance"} | options))
    return cube.read(0, cube.lines).values.transpose(2, 0, 1)


def test_unsigned_numbers_in_a_signed_type(tmp_path: Path):
    stored = np.round(TRUE / 1e-5).astype(np.uint16)
    assert stored.max() > 32767
    path = packed(tmp_path / "a.nc", stored.view(np.int16), scale_factor=1e-5, _Unsigned="true")
    assert np.allclose(values(path), TRUE, atol=1e-5)


def test_a_missing_value_beside_a_fill_value(tmp_path: Path):
    stored = np.round(TRUE * 1e4).astype(np.int16)
    stored[:, 0, 0], stored[:, 1, 1] = -32768, -9999
    path = packed(
        tmp_path / "a.nc", stored, scale_factor=1e-4, _FillValue=np.int16(-9999), missing_value=np.int16(-32768)
    )
    cube = open_cube(path, quantity="reflectance")
    assert (~cube.read(0, 4).valid).sum() == 2
    assert np.isnan(values(path)[:, [0, 1], [0, 1]]).all()
    assert np.allclose(values(path)[:, 2:], TRUE[:, 2:], atol=1e-4)


@pytest.mark.parametrize("unit", ["%", "percent"])
def test_an_array_in_percent(tmp_path: Path, unit: str):
    path = packed(tmp_path / "a.nc", 2.0 * TRUE, units=unit)  # at most 1.2 %: dark, and plausible as a fraction
    assert np.allclose(values(path), 0.02 * TRUE)
    assert np.allclose(values(packed(tmp_path / "b.nc", 100 * TRUE, "albedo", units=unit)), TRUE)


def test_a_stated_scale_multiplies_the_numbers_in_the_file(tmp_path: Path):
    stored = np.round(TRUE * 1e4).astype(np.int16)
    path = packed(tmp_path / "a.nc", stored, scale_factor=0.01, add_offset=3.0, units="%")
    assert np.allclose(values(path, scale=1e-4), TRUE, atol=1e-4)
    assert np.allclose(values(path), TRUE + 0.03, atol=1e-4)


def test_an_array_at_hand_is_unpacked_once(tmp_path: Path):
    path = packed(tmp_path / "a.nc", np.round(TRUE * 1e4).astype(np.int16), scale_factor=1e-4)
    for decode in (False, True):
        with xr.open_dataset(path, engine="h5netcdf", mask_and_scale=decode) as data:
            assert np.allclose(values(data["reflectance"]), TRUE, atol=1e-4)


def test_the_layout_of_a_product_knows_a_scale_factor(tmp_path: Path):
    shells.aviris(tmp_path / "a.nc")
    plain = open_cube(tmp_path / "a.nc", quantity="radiance")
    want = plain.read(0, plain.lines).values
    with h5py.File(tmp_path / "a.nc", "a") as file:
        array = file["radiance/radiance"]
        array[...] = np.where(array[...] == -9999, -9999, (array[...] - 2.0) / 0.01)
        array.attrs["scale_factor"], array.attrs["add_offset"] = 0.01, 2.0
    cube = open_cube(tmp_path / "a.nc", quantity="radiance")
    assert np.allclose(cube.read(0, cube.lines).values, want, rtol=1e-5, equal_nan=True)


def test_bands_of_enmap_go_by_their_number(tmp_path: Path):
    image, _ = shells.enmap(tmp_path)
    before = open_cube(image, quantity="radiance")
    metadata = next(tmp_path.glob("*.XML"))
    text = metadata.read_text()
    items = re.findall(r"<bandID.*?</bandID>", text)
    metadata.write_text(text.replace("".join(items), "".join(items[::-1])))
    after = open_cube(image, quantity="radiance")
    assert after.axis.matches(before.axis)
    assert after.stored_band.tolist() == before.stored_band.tolist()
    assert np.array_equal(after.read(0, 3).values, before.read(0, 3).values, equal_nan=True)
    metadata.write_text(text.replace('number="3"', 'number="2"'))
    with pytest.raises(InputError, match="4 bands whose numbers are not 1 to 4"):
        open_cube(image, quantity="radiance")


def test_a_table_beside_an_image_of_the_same_name_is_no_image(tmp_path: Path, axis):
    write_cube(tmp_path / "line1.img", np.full((6, 5, len(axis)), 0.2), data_type=4, axis=axis)
    assert (tmp_path / "line1.hdr").is_file()
    (tmp_path / "line1.csv").write_text("region,line,sample\nroof,1,2\nroof,1,3\n")
    regions = read_regions(tmp_path / "line1.csv", (6, 5))
    assert np.argwhere(regions["roof"].mask).tolist() == [[1, 2], [1, 3]]
    with pytest.raises(InputError, match="no header beside the data file"):
        open_raster(tmp_path / "line1.csv")


def test_more_names_than_bands_name_no_band(tmp_path: Path, axis):
    image = write_cube(tmp_path / "f01_rdn_img", np.full((6, 5, len(axis)), 2.0), data_type=4, axis=axis)
    path = write_cube(tmp_path / "f01_rdn_obs", np.full((6, 5, 2), 0.5), data_type=5)
    header = next(p for p in tmp_path.glob("f01_rdn_obs*.hdr"))
    header.write_text(header.read_text() + "band names = {Path length, To-sensor, To-sun zenith}\n")
    assert sun_zenith_deg(open_raster(image)) is None
    truth = AbundanceTruth(image=path.name, materials={"panel": "To-sun zenith"})
    with pytest.raises(InputError, match="a number, 1 to 2: its header has no name for each band"):
        abundance_targets(truth, open_cube(image, quantity="other"), 1.0, lambda name: tmp_path / name)
