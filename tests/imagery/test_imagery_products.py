"""Products of today: each shell is read as another reader reads it, and everything that must be refused is."""

from __future__ import annotations

import pickle
import re
import warnings
from pathlib import Path

import h5py
import numpy as np
import product_shells as shells
import pytest
import rasterio
import xarray as xr
from affine import Affine
from rasterio.crs import CRS

from hyperval.errors import InputError, UsageError
from hyperval.imagery import (
    Cube,
    layouts,
    lookup_raster,
    open_cube,
    open_lookup_table,
    open_raster,
    sun_zenith_deg,
    table_of,
)
from hyperval.units import radiance_to_internal

LINES, SAMPLES = shells.LINES, shells.SAMPLES


def by_gdal(path: Path, name: str) -> np.ndarray:
    """An array of an HDF5 file as GDAL reads it, in the order of the file."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(f'HDF5:"{path}"://{name.replace(" ", "_")}') as dataset:
            return dataset.read()


def values_of(cube: Cube) -> np.ndarray:
    whole = np.concatenate([block.values for block in cube.blocks(5)])
    assert np.array_equal(whole, cube.read(0, cube.lines).values, equal_nan=True)
    stored, usable = cube.read_stored(0, cube.lines)
    assert stored.shape == (cube.bands, *cube.shape)
    assert np.array_equal(usable, np.concatenate([block.valid for block in cube.blocks(5)]))
    rows, cols = np.array([0, 3, 11, 3]), np.array([8, 4, 0, 4])
    assert np.array_equal(cube.pixels((rows, cols)), whole[rows, cols], equal_nan=True)
    return whole


@pytest.mark.parametrize("chunks", [None, (3, 4, 5)])
def test_aviris_3_radiance_with_its_lookup_table(tmp_path: Path, chunks):
    path = tmp_path / "AV320250814t180211_000_L1B_RDN_0001_RDN.nc"
    shells.aviris(path, chunks=chunks)
    cube = open_cube(path, quantity="radiance")
    assert cube.shape == (LINES, SAMPLES)
    assert cube.axis.centre_nm.tolist() == [400, 500, 600, 700, 1600, 2200]
    assert np.allclose(cube.axis.fwhm_nm, 7.4)
    assert cube.notes[0] == "read as AVIRIS-3/-5 L1B radiance"
    assert cube.extras["acquisition time"] == "2025-08-14T18:02:11Z"
    with xr.open_dataset(path, group="radiance", engine="h5netcdf") as other:
        assert np.allclose(values_of(cube), other["radiance"].values.transpose(1, 2, 0), rtol=1e-7, equal_nan=True)
    assert not cube.read(3, 1).valid[0, 4]
    assert cube.transform is None  # scanner geometry: the table places it
    table = open_lookup_table(lookup_raster(cube.raster), cube.shape)
    assert (table.transform, table.crs) == (shells.MAP, shells.UTM11)
    # The centre of raw pixel (line 5, sample 4) lies in the cell moved by one line and two samples.
    with xr.open_dataset(path, group="geolocation_lookup_table", engine="h5netcdf") as other:
        for band, name in enumerate(("sample", "line")):
            assert np.array_equal(table.raster.read_bands(0, other[name].shape[0])[band], np.nan_to_num(other[name]))
    place = (shells.MAP.c + 4 * (4.5 + 2), shells.MAP.f - 4 * (5.5 + 1))
    assert np.allclose(table.to_pixel(np.array([place]), where="here"), [[4.5, 5.5]], atol=1e-6)
    assert table.pixel_area_m2 == pytest.approx(16.0, rel=1e-6)


def test_neon_radiance_is_the_sum_of_two_arrays(tmp_path: Path):
    shells.neon_radiance(tmp_path / "n.h5")
    cube = open_cube(tmp_path / "n.h5", quantity="radiance")
    assert cube.dtype == np.float32
    whole, part = (by_gdal(tmp_path / "n.h5", f"SERC/Radiance/Radiance{p}Part") for p in ("Integer", "Decimal"))
    want = np.where(whole == 255, np.nan, whole + part / 50_000.0)
    assert np.allclose(values_of(cube), want, rtol=0, atol=2e-6, equal_nan=True)
    assert not cube.read(5, 1).valid[0, 5]


def test_prisma_radiance_joins_two_cubes_in_order_of_wavelength(tmp_path: Path):
    path = tmp_path / "PRS_L1_STD_OFFL_20230602100931_20230602100935_0001.he5"
    shells.prisma(path)
    cube = open_cube(path, quantity="radiance")
    assert np.allclose(cube.axis.centre_nm, [402.5, 650.8, 951.0, 972.7, 2496.9])
    assert np.allclose(cube.axis.fwhm_nm, [11.0, 10.0, 10.5, 12.0, 9.0])
    fields = "HDFEOS/SWATHS/PRS_L1_HCO/Data Fields"
    vnir, swir = (by_gdal(path, f"{fields}/{name}").transpose(0, 2, 1) for name in ("VNIR_Cube", "SWIR_Cube"))
    stored = np.stack([vnir[..., 2], vnir[..., 1], swir[..., 1], vnir[..., 0], swir[..., 0]], axis=-1)
    # W m-2 sr-1 um-1 are 0.1 uW cm-2 sr-1 nm-1; scale and offset as the specification has them.
    assert np.allclose(values_of(cube), 0.1 * (stored / 100.0 - 0.5), rtol=1e-6)
    assert "2 stored bands without a wavelength are left out" in cube.notes


@pytest.mark.parametrize("edges", [False, True])
def test_prisma_reflectance_has_its_corners_at_centres_or_edges(tmp_path: Path, edges: bool):
    path = tmp_path / "PRS_L2D_STD_1.he5"
    shells.prisma(path, "L2D", edges=edges)
    cube = open_cube(path, quantity="reflectance")
    vnir, swir = (
        by_gdal(path, f"HDFEOS/SWATHS/PRS_L2D_HCO/Data Fields/{name}").transpose(0, 2, 1)
        for name in ("VNIR_Cube", "SWIR_Cube")
    )
    found = values_of(cube)
    assert np.allclose(found[..., 1], 0.9 * vnir[..., 1] / 65535.0, rtol=1e-6)
    assert np.allclose(found[..., 4], 0.01 + 0.69 * swir[..., 0] / 65535.0, rtol=1e-6)
    half = 0.0 if edges else 15.0
    assert cube.transform == Affine(30.0, 0, 600_000 - half, 0, -30.0, 4_900_000 + half)
    assert cube.crs.to_epsg() == 32632


@pytest.mark.parametrize(
    ("sensor", "level", "factor"),
    [("EnMAP", "L1C", 100.0), ("DESIS", "L1C", 1.0), ("EnMAP", "L2A", 1.0), ("DESIS", "L2A", 1.0)],
)
@pytest.mark.parametrize("named", ["image", "metadata"])
def test_enmap_and_desis_by_their_metadata(tmp_path: Path, sensor: str, level: str, factor: float, named: str):
    image, _ = shells.enmap(tmp_path, level, sensor=sensor)
    metadata = next(p for p in tmp_path.iterdir() if p.suffix.lower() == ".xml")
    quantity = "radiance" if level == "L1C" else "reflectance"
    cube = open_cube(image if named == "image" else metadata, quantity=quantity)
    assert cube.axis.centre_nm.tolist() == [423.0, 650.0, 902.3, 911.6]
    assert cube.axis.fwhm_nm.tolist() == [6.6, 7.0, 8.0, 9.1]
    with rasterio.open(image) as other:
        stored = other.read(masked=True).astype(float).filled(np.nan)
        assert (cube.transform, cube.crs) == (other.transform, other.crs)
    gain, offset = np.array([1.2e-4, 1.1e-4, 0.9e-4, 0.5e-4]), np.array([1e-3, 0.0, -2e-3, 0.0])
    if sensor == "DESIS":
        gain = 10 * gain
    if level == "L2A":
        gain, offset = np.full(4, 1e-4), np.zeros(4)
    want = factor * (gain[:, None, None] * stored + offset[:, None, None])
    assert np.allclose(values_of(cube), want[[0, 1, 3, 2]].transpose(1, 2, 0), rtol=1e-12, equal_nan=True)
    assert {p.name for p in cube.source_files} == {image.name, metadata.name}
    assert cube.extras["sensor"] == sensor


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_detectors_of_enmap_level_1b_are_two_cubes(tmp_path: Path):
    stored = shells.enmap_two_detectors(tmp_path)
    metadata = next(tmp_path.glob("*.XML"))
    gain, offset = np.array([1.2e-4, 1.1e-4, 0.9e-4, 0.5e-4]), np.array([1e-3, 0.0, -2e-3, 0.0])
    for detector, bands, centres in (("VNIR", [0, 1], [423.0, 650.0]), ("SWIR", [3, 2], [902.3, 911.6])):
        cube = open_cube(metadata, quantity="radiance", variable=detector)
        assert cube.axis.centre_nm.tolist() == centres
        with rasterio.open(next(tmp_path.glob(f"*_{detector}.TIF"))) as other:
            values = other.read(masked=True).astype(float).filled(np.nan)
        assert np.array_equal(values[0][values[0] > 0], stored[detector][0][stored[detector][0] > 0])
        want = 100.0 * (gain[bands, None, None] * values[np.argsort(bands)] + offset[bands, None, None])
        assert np.allclose(values_of(cube), want.transpose(1, 2, 0), rtol=1e-12, equal_nan=True)
        assert cube.transform is None
        assert any("a place some lines apart" in note for note in cube.notes)
        same = open_cube(next(tmp_path.glob(f"*_{detector}.TIF")), quantity="radiance")
        assert np.array_equal(values_of(same), values_of(cube), equal_nan=True)
    listed = r"(?s)2 images could be meant: .*_SWIR.TIF, .*_VNIR.TIF.*variable: SWIR or VNIR"
    for variable in (None, "NIR"):
        with pytest.raises(UsageError, match=listed):
            open_cube(metadata, quantity="radiance", variable=variable)


def test_stac_item_beside_a_geotiff(tmp_path: Path):
    image, values = shells.stac(tmp_path)
    cube = open_cube(image, quantity="radiance")
    assert np.allclose(cube.axis.centre_nm, [503, 650, 799])
    assert np.allclose(cube.axis.fwhm_nm, 20.0)
    assert np.allclose(values_of(cube), 0.1 * values.transpose(1, 2, 0), rtol=1e-6)
    with rasterio.open(image) as other:
        stored = other.read().transpose(1, 2, 0)
        assert np.array_equal(other.read(masked=True).mask.any(axis=0), np.isnan(values_of(cube)).any(axis=2))
        assert (cube.transform, cube.crs) == (other.transform, other.crs)
    assert np.allclose(values_of(cube), 0.1 * stored, rtol=1e-6)


def labelled(path: Path, **more) -> Path:
    values = shells.radiances(4)
    values[1, 1] = np.nan
    data = xr.Dataset(
        {
            "Lt": (
                ("y", "x", "band"),
                np.nan_to_num(values, nan=-1.0),
                {"units": "uW cm-2 sr-1 nm-1", "_FillValue": -1.0},
            )
        },
        coords={
            "wavelength": ("band", [0.45, 0.55, 0.65, 0.85], {"units": "um"}),
            "y": 3_800_000.0 - 2 - 4 * np.arange(LINES),
            "x": 400_000.0 + 2 + 4 * np.arange(SAMPLES),
            "spatial_ref": ((), 0, {"crs_wkt": shells.UTM11.to_wkt()}),
        },
    ).assign(**more)
    data["Lt"].attrs["grid_mapping"] = "spatial_ref"
    if path.suffix == ".zarr":
        data.to_zarr(path, zarr_format=2, consolidated=True)
    else:
        data.to_netcdf(path, engine="scipy" if path.suffix == ".nc3" else "h5netcdf")
    return path


@pytest.mark.parametrize("name", ["a.nc", "a.nc3", "a.zarr"])
def test_any_array_with_a_wavelength_coordinate_is_a_cube(tmp_path: Path, name: str):
    cube = open_cube(labelled(tmp_path / name), quantity="radiance")
    want = shells.radiances(4)
    want[1, 1] = np.nan
    assert np.allclose(values_of(cube), want, rtol=1e-6, equal_nan=True)
    assert np.allclose(cube.axis.centre_nm, [450, 550, 650, 850])
    assert (cube.transform, cube.crs) == (shells.MAP, shells.UTM11)


def test_where_several_arrays_could_be_meant_the_message_lists_them(tmp_path: Path):
    noise = (("y", "x", "band"), np.ones((LINES, SAMPLES, 4), np.float32))
    path = labelled(tmp_path / "a.nc", noise=noise)
    with pytest.raises(UsageError, match=r"(?s)2 arrays could be meant.*Lt .*noise .*state variable"):
        open_cube(path, quantity="radiance")
    assert open_cube(path, quantity="radiance", variable="Lt").shape == (LINES, SAMPLES)
    with pytest.raises(UsageError, match=r"(?s)0 arrays 'L'.*one of Lt"):
        open_cube(path, quantity="radiance", variable="L")


def test_another_quantity_or_unit_than_the_products_is_refused(tmp_path: Path):
    shells.emit(tmp_path / "e.nc")
    with pytest.raises(InputError, match="holds radiance, the campaign says reflectance"):
        open_cube(tmp_path / "e.nc", quantity="reflectance")
    with pytest.raises(UsageError, match=r"radiance in uW cm-2 sr-1 nm-1, the campaign in W m-2 sr-1 um-1"):
        open_cube(tmp_path / "e.nc", quantity="radiance", unit="W m-2 sr-1 um-1")
    assert open_cube(tmp_path / "e.nc", quantity="radiance", unit="uW/cm2/sr/nm").unit == "uW cm-2 sr-1 nm-1"


def test_a_file_that_states_another_unit_than_the_layout_is_believed(tmp_path: Path):
    shells.aviris(tmp_path / "a.nc")
    with h5py.File(tmp_path / "a.nc", "r+") as file:
        file["radiance/radiance"].attrs["units"] = "W m-2 sr-1 um-1"
    cube = open_cube(tmp_path / "a.nc", quantity="radiance")
    assert any("as the file states" in note for note in cube.notes)
    assert np.allclose(cube.gain, 0.1)


@pytest.mark.parametrize("keep", [0.5, 0.9, 0.999])
def test_a_product_cut_short_is_one_clear_error(tmp_path: Path, keep: float):
    shells.neon_reflectance(tmp_path / "n.h5")
    raw = (tmp_path / "n.h5").read_bytes()
    (tmp_path / "n.h5").write_bytes(raw[: int(keep * len(raw))])
    with pytest.raises(InputError, match=r"n\.h5: not a readable HDF5 file"):
        open_cube(tmp_path / "n.h5", quantity="reflectance")


def test_values_in_other_files_are_refused(tmp_path: Path):
    shells.emit(tmp_path / "e.nc")
    (tmp_path / "secret").write_bytes(bytes(LINES * SAMPLES * 5 * 4))
    with h5py.File(tmp_path / "e.nc", "r+") as file:
        del file["radiance"]
        size = LINES * SAMPLES * 5 * 4
        file.create_dataset("radiance", (LINES, SAMPLES, 5), "f4", external=[(str(tmp_path / "secret"), 0, size)])
    with pytest.raises(InputError, match="lie in another file"):
        open_cube(tmp_path / "e.nc", quantity="radiance")
    with h5py.File(tmp_path / "e.nc", "r+") as file:
        del file["radiance"]
        file["radiance"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/radiance")
    with pytest.raises(InputError, match="'radiance' lie in another file"):
        open_cube(tmp_path / "e.nc", quantity="radiance")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.__delitem__("sensor_band_parameters/wavelengths"), "no array of the file has a wavelength"),
        (lambda f: f["sensor_band_parameters/wavelengths"].__setitem__(slice(None), 0.0), "no band has a wavelength"),
        (lambda f: f["sensor_band_parameters/wavelengths"].__setitem__(slice(None), 5e6), "cannot be in nm"),
        (lambda f: f["sensor_band_parameters/fwhm"].__setitem__(slice(None), -1.0), "not positive"),
        (lambda f: f["sensor_band_parameters/good_wavelengths"].__setitem__(slice(None), 0.0), "every band as bad"),
    ],
)
def test_band_tables_that_cannot_be_true(tmp_path: Path, change, message: str):
    shells.emit(tmp_path / "e.nc")
    with h5py.File(tmp_path / "e.nc", "r+") as file:
        change(file)
    with pytest.raises((InputError, UsageError), match=message):
        open_cube(tmp_path / "e.nc", quantity="radiance")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<level_X>", "<!DOCTYPE a><level_X>", "DOCTYPE"),
        ("</level_X>", "", "not valid XML"),
        ("423.0", "blue", "wavelengthCenterOfBand: 'blue' is no number"),
        ('<bandID number="4">', '<other number="4">', "not valid XML"),
    ],
)
def test_metadata_that_are_broken(tmp_path: Path, old: str, new: str, message: str):
    image, _ = shells.enmap(tmp_path)
    metadata = next(tmp_path.glob("*.XML"))
    metadata.write_text(metadata.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        open_cube(image, quantity="radiance")


def test_another_process_opens_a_product_for_itself(tmp_path: Path):
    shells.aviris(tmp_path / "a.nc", chunks=(3, 4, 5))
    cube = open_cube(tmp_path / "a.nc", quantity="radiance")
    cube.read(0, 2)
    again = pickle.loads(pickle.dumps(cube))  # noqa: S301 - our own
    assert np.array_equal(again.read(0, LINES).values, cube.read(0, LINES).values, equal_nan=True)


def test_an_hdf5_tree_without_dimensions_is_a_cube_where_wavelengths_lie_beside(tmp_path: Path):
    values = shells.radiances(7)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["scene/image"] = values
    with pytest.raises(InputError, match=r"(?s)no array of the file has a wavelength coordinate.*scene/image \("):
        open_cube(tmp_path / "a.h5", quantity="radiance")
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["scene/wavelength"] = np.linspace(400.0, 1000.0, 7)
        file["scene/dark"] = np.zeros((3, 4))
    cube = open_cube(tmp_path / "a.h5", quantity="radiance", unit="uW cm-2 sr-1 nm-1")
    assert np.allclose(values_of(cube), values, rtol=1e-6)


@pytest.mark.parametrize(
    ("product", "image", "angles"),
    [
        ("aviris", "AV320250814t180211_005_L1B_RDN_RDN.nc", "AV320250814t180211_005_L1B_RDN_OBS.nc"),
        ("emit", "EMIT_L1B_RAD_001_20240501T191103.nc", "EMIT_L1B_OBS_001_20240501T191103.nc"),
    ],
)
def test_the_sun_of_an_observation_file_beside_a_product(tmp_path: Path, product: str, image: str, angles: str):
    getattr(shells, product)(tmp_path / image)
    raster = open_raster(tmp_path / image)
    assert sun_zenith_deg(raster) is None
    zenith = np.full((LINES, SAMPLES), 41.5)
    zenith[0] = -9999.0
    shells.observation(tmp_path / angles, product, zenith)
    assert sun_zenith_deg(raster) == (41.5, angles)
    shells.observation(tmp_path / angles, product, zenith[1:])
    assert sun_zenith_deg(raster) is None  # of another image
    (tmp_path / angles).write_bytes(b"no HDF5")
    assert sun_zenith_deg(raster) is None


@pytest.mark.parametrize("chunks", [(3, 4, 5), (6, 12, 9), (1, 12, 2), None])
def test_lines_and_pixels_are_those_of_the_array_however_it_is_stored(tmp_path: Path, chunks, monkeypatch):
    shells.aviris(tmp_path / "a.nc", chunks=chunks)
    raster = open_raster(tmp_path / "a.nc")
    with h5py.File(tmp_path / "a.nc") as file:
        stored = file["radiance/radiance"][:]
    rng = np.random.default_rng(5)
    rows, cols = rng.integers(0, LINES, 40), rng.integers(0, SAMPLES, 40)
    for slab in (8 << 20, 1):  # kept in memory, or in a file
        monkeypatch.setattr("hyperval.imagery.arrays.SLAB_BYTES", slab)
        fresh = open_raster(tmp_path / "a.nc")
        for first, count in ((0, 2), (2, 2), (4, 5), (9, 3), (1, 1)):
            np.testing.assert_array_equal(fresh.read_bands(first, count), stored[:, first : first + count])
        np.testing.assert_array_equal(fresh.read_pixels(rows, cols), stored[:, rows, cols].T)
        np.testing.assert_array_equal(fresh.read_some_bands(3, 4, [5, 0]), stored[[5, 0], 3:7])
    assert raster.read_pixels(rows[:0], cols[:0]).shape == (0, 6)


def test_a_map_position_of_level_1b_is_no_map_and_the_sun_is_in_the_metadata(tmp_path: Path):
    image, _ = shells.enmap(tmp_path, "L1B")
    metadata = next(tmp_path.glob("*.XML"))
    sun = "<sunElevationAngle><upper_left>40</upper_left><center>52.5</center></sunElevationAngle>"
    metadata.write_text(metadata.read_text().replace("<specific>", "<specific>" + sun, 1))
    cube = open_cube(image, quantity="radiance")
    assert (cube.transform, cube.crs) == (None, None)
    assert any("a fit to its corners" in note for note in cube.notes)
    assert sun_zenith_deg(cube.raster) == (37.5, metadata.name)


def test_desis_without_a_no_data_value_has_that_of_its_layout(tmp_path: Path):
    image, _ = shells.enmap(tmp_path, "L2A", sensor="DESIS")
    metadata = next(tmp_path.glob("*.xml"))
    text = metadata.read_text().replace(
        "<backgroundValue>-32768</backgroundValue>", "<sunZenithAngle>30</sunZenithAngle>"
    )
    metadata.write_text(text)
    with rasterio.open(image, "r+") as file:
        file.nodata = None
    cube = open_cube(image, quantity="reflectance")
    assert np.isnan(values_of(cube)[0, 0]).all()
    assert np.isfinite(values_of(cube)[1:]).all()
    assert sun_zenith_deg(cube.raster) == (30.0, metadata.name)


@pytest.mark.parametrize("both", [False, True])
def test_an_image_cut_into_tiles_for_the_cloud_is_found_by_its_metadata(tmp_path: Path, both: bool):
    image, _ = shells.enmap(tmp_path, "L2A")
    tiles = image.with_name(f"{image.stem}_COG.TIF")
    tiles.write_bytes(image.read_bytes())
    if not both:
        image.unlink()
    cube = open_cube(next(tmp_path.glob("*.XML")), quantity="reflectance")
    assert cube.raster.path == (image if both else tiles)


MAPPED = {  # writer, place of the first corner and pixel, zone, and the angle of the sun that the file states
    "aviris": (lambda path: shells.aviris(path, "reflectance"), shells.MAP, 32611, None),
    "emit": (lambda path: shells.emit(path, "reflectance"), None, None, None),
    "neon": (shells.neon_reflectance, Affine(1.0, 0, 368_000.0, 0, -1.0, 4_306_000.0), 32618, 27.5),
    "prisma": (lambda path: shells.prisma(path, "L2D"), Affine(30, 0, 599_985.0, 0, -30, 4_900_015.0), 32632, 31.25),
    "tanager": (
        lambda path: shells.tanager(path, "surface_reflectance", ortho=True),
        Affine(30, 0, 4e5, 0, -30, 38e5), 32611, 33.0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("product", MAPPED)
def test_reflectance_with_its_place_and_sun(tmp_path: Path, product: str):
    write, place, zone, sun = MAPPED[product]
    path = tmp_path / ("a.nc" if product in ("aviris", "emit") else "a.h5")
    stored = write(path)
    cube = open_cube(path, quantity="reflectance")
    found = values_of(cube)
    if product != "prisma":
        scale = 1e-4 if product == "neon" else 1.0
        assert np.allclose(found, np.where(stored == -9999, np.nan, scale * stored), rtol=1e-7, equal_nan=True)
        assert np.isnan(found).any()
        some = cube.read_some_bands(2, 3, [3, 0])
        assert np.allclose(some, found[2:5, :, [3, 0]], rtol=1e-6, equal_nan=True)
    assert cube.axis.good.all() == (product in ("aviris", "prisma"))
    assert cube.transform == place
    assert (cube.crs.to_epsg() if zone else cube.crs) == (zone or cube.crs)
    assert sun_zenith_deg(cube.raster) == (None if sun is None else (sun, path.name))
    if product == "aviris":  # the system of a grid mapping under its other name
        with h5py.File(path, "r+") as file:
            file["transverse_mercator"].attrs["crs_wkt"] = file["transverse_mercator"].attrs["spatial_ref"]
            del file["transverse_mercator"].attrs["spatial_ref"]
        assert open_cube(path, quantity="reflectance").crs.to_epsg() == 32611


ARRAY_KEYS = re.compile("path|dimensions|wavelength|fwhm|good|plus|scale|divisor|offset|subtract|range")
TREE_KEYS = re.compile(
    "product|sensor|quantity|unit|arrays|wavelength_unit|source|remark|sorts|ignore|bad_ranges_nm|lookup_table|location|"
    "geotransform|map_info|crs|epsg|corner_pixels|pixel_size|struct_metadata|sun_zenith|entries"
)


def test_every_layout_names_its_source_and_states_what_is_read():
    for tree in layouts().trees:
        assert tree.source
        assert all(map(TREE_KEYS.fullmatch, tree))  # a key that nothing reads would change nothing
        assert all(ARRAY_KEYS.fullmatch(key) for array in tree.arrays for key in array)
        assert all(re.fullmatch("[lsb]{3}", array.dimensions) for array in tree.arrays)
        assert tree.quantity in ("radiance", "reflectance")
        assert tree.unit == "1" or radiance_to_internal(tree.unit) > 0
    assert all(radiance_to_internal(s.radiance_unit) > 0 and s.source for s in layouts().sidecars)


@pytest.mark.parametrize("product", ["emit", "tanager", "prisma"])
def test_radiance_in_scanner_geometry_with_what_places_it(tmp_path: Path, product: str):
    path = tmp_path / "a.nc"
    stored = getattr(shells, product)(path)
    cube = open_cube(path, quantity="radiance")
    assert cube.transform is None
    if product != "prisma":
        factor = {"emit": 1.0, "tanager": 1e-3}[product]  # the unit that the file states
        assert np.allclose(values_of(cube), np.where(stored == -9999, np.nan, factor * stored), equal_nan=True)
        assert not cube.read(0, LINES).valid.all()
        assert cube.axis.good.tolist() == [True, True, True, product == "tanager", True]
    if product == "tanager":
        return
    table, _ = table_of(cube.raster)
    assert table.crs == CRS.from_epsg(4326)
    if product == "emit":
        with xr.open_dataset(path, group="location", engine="h5netcdf") as other:
            assert np.array_equal(table.raster.read_bands(0, 14)[0], np.nan_to_num(other["glt_x"].values))
    back = open_cube(cube.to_spy(), quantity="radiance", unit="uW cm-2 sr-1 nm-1")  # loaded: no ENVI file of one scale
    assert back.axis.matches(cube.axis)
    assert np.allclose(back.read(2, 3).values, cube.read(2, 3).values, rtol=1e-6, equal_nan=True)


def test_bands_in_a_group_of_their_own(tmp_path: Path):
    """As in other products of EMIT and OCI, whose images no layout names."""
    values = shells.radiances(4)
    with shells.netcdf.Dataset(tmp_path / "a.nc", "w") as file:
        file.createDimension("bands", 4)
        shells.put(file.createGroup("geophysical_data"), "Lt", ("lines", "pixels", "bands"), values, units="W/m2/sr/um")
        shells.put(file.createGroup("parameters"), "wavelengths", ("bands",), [400.0, 500.0, 600.0, 700.0], units="nm")
        shells.put(file["parameters"], "fwhm", ("bands",), [8.5] * 4, units="nm")
    cube = open_cube(tmp_path / "a.nc", quantity="radiance")
    assert np.allclose(values_of(cube), 0.1 * values, rtol=1e-6)
    assert (cube.axis.centre_nm.tolist(), cube.axis.fwhm_nm.tolist()) == ([400, 500, 600, 700], [8.5] * 4)


@pytest.mark.parametrize(("product", "quantity", "factor"), [("hypso", "radiance", 0.1), ("oci", "reflectance", 1.0)])
def test_swaths_with_the_place_of_every_pixel(tmp_path: Path, product: str, quantity: str, factor: float):
    path = tmp_path / "a.nc"
    values = getattr(shells, product)(path)
    cube = open_cube(path, quantity=quantity)
    assert np.allclose(values_of(cube), factor * values, rtol=1e-6, equal_nan=True)
    assert np.array_equal(cube.read(0, LINES).valid, np.isfinite(values).all(axis=2))
    assert cube.transform is None
    table, _ = table_of(cube.raster)
    assert np.allclose(table.to_pixel(np.array([[10.0 + 0.0037 * 3 + 0.0008, 44.0 - 0.0054 + 0.0015]]), where="here"),
                       [[3.5, 2.5]], atol=0.02)  # fmt: skip
    assert sun_zenith_deg(cube.raster) == ((pytest.approx(41.5), "a.nc") if product == "hypso" else None)
    assert any("HYPSO-1" in note or "PACE OCI" in note for note in cube.notes)
