"""Products of imagers and other arrays: each is read as it was written, and everything that must be refused is."""

import pickle
import re
from pathlib import Path

import h5py
import numpy as np
import product_shells as shells
import pytest
import rasterio
import xarray as xr
from affine import Affine

from hyperval.collection import AbundanceTruth
from hyperval.errors import InputError, UsageError
from hyperval.imagery import Cube, layouts, open_cube, open_raster, read_regions, sun_zenith_deg, table_of, write_cube
from hyperval.observe import image_targets
from hyperval.units import to_internal

LINES, SAMPLES = shells.LINES, shells.SAMPLES


def values_of(cube: Cube) -> np.ndarray:
    whole = np.concatenate([block.values for block in cube.blocks(5)])
    assert np.array_equal(whole, cube.read(0, cube.lines).values, equal_nan=True)
    stored, usable = cube.read_stored(0, cube.lines)
    assert stored.shape == (cube.bands, *cube.shape)
    assert np.array_equal(usable, np.concatenate([block.valid for block in cube.blocks(5)]))
    rows, cols = np.array([0, 3, 11, 3]), np.array([8, 4, 0, 4])
    assert np.array_equal(cube.marked_pixels((rows, cols))[0], whole[rows, cols], equal_nan=True)
    some = cube.read_some_bands(2, 3, [cube.bands - 1, 0])
    assert np.allclose(some, whole[2:5][..., [-1, 0]], rtol=1e-6, equal_nan=True)
    return whole


# Trees of arrays --------------------------------------------------------------------------------


@pytest.mark.parametrize(("product", "kind"), shells.KINDS)
def test_a_product_is_read_as_it_was_written(tmp_path, product, kind):
    path, want = tmp_path / "a.h5", shells.part(product, kind, "read")
    truth = shells.tree(path, product, kind)
    cube = open_cube(path, quantity=shells.SHELLS[product]["kinds"][kind].get("quantity", kind))
    assert np.allclose(values_of(cube), truth, rtol=1e-6, equal_nan=True)
    assert np.array_equal(cube.read(0, LINES).valid, np.isfinite(truth).all(axis=2))
    assert cube.axis.centre_nm == pytest.approx(want["centre"])
    if "fwhm" in want:
        assert np.allclose(cube.axis.fwhm_nm, want["fwhm"])
    assert cube.axis.good.tolist() == [bool(flag) for flag in want.get("good", [1] * cube.bands)]
    assert any(want.get("note", "read as") in note for note in cube.notes)
    entries = cube.raster.description.entries
    assert entries.get("acquisition time") == want.get("time", entries.get("acquisition time"))
    assert sun_zenith_deg(cube.raster) == ((pytest.approx(want["sun"]), "a.h5") if "sun" in want else None)
    west, north, step = want.get("place", (None, None, None))
    assert cube.transform == (None if step is None else Affine(step, 0, west, 0, -step, north))
    assert (cube.crs and cube.crs.to_epsg()) == want.get("epsg")
    if "at" in want:  # by a lookup table, or the place of every pixel
        places, _ = table_of(cube.raster)
        assert np.allclose(places.to_pixel(np.array([want["at"]]), where="here"), [want["pixel"]], atol=1e-3)
        if "area" in want:
            assert places.raster.read_bands(0, 1)[:, 0, 0] == pytest.approx(shells.MAP @ (2.5, 1.5), rel=1e-12)
            assert places.crs == shells.UTM11
            assert places.pixel_area_m2 == pytest.approx(want["area"], rel=1e-6)
    if "fwhm" in want:  # loaded: no ENVI file of one scale
        back = open_cube(cube.to_spy(), quantity=cube.quantity, unit=cube.unit)
        assert np.allclose(back.read(2, 3).values, truth[2:5], rtol=1e-6, equal_nan=True)


@pytest.mark.parametrize("chunks", [(3, 4, 5), (6, 12, 9), (1, 12, 2), None])
def test_lines_and_pixels_are_those_of_the_array_however_it_is_stored(tmp_path, chunks, monkeypatch):
    shells.tree(tmp_path / "a.nc", "aviris", chunks=chunks)
    raster = open_raster(tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc", group="radiance", engine="h5netcdf", mask_and_scale=False) as other:
        stored = other["radiance"].values
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
    again = pickle.loads(pickle.dumps(raster))  # noqa: S301 - another process opens it for itself
    np.testing.assert_array_equal(again.read_bands(0, LINES), stored)


def changed(path: Path, product: str, change) -> Path:
    """The first kind of a product after a change of its file."""
    shells.tree(path, product)
    with h5py.File(path, "r+") as file:
        change(file)
    return path


def test_box_of_prisma_corners_at_edges_and_the_other_name_of_a_system(tmp_path):
    shells.tree(tmp_path / "a.h5", "prisma", "L2D")
    shells.tree(tmp_path / "b.h5", "aviris", "reflectance")
    with h5py.File(tmp_path / "a.h5", "r+") as file, h5py.File(tmp_path / "b.h5", "r+") as other:
        file.attrs["Product_URcorner_easting"] = 600_000.0 + 30 * SAMPLES
        file.attrs["Product_LLcorner_northing"] = 4_900_000.0 - 30 * LINES
        other["transverse_mercator"].attrs["crs_wkt"] = other["transverse_mercator"].attrs.pop("spatial_ref")
    cube = open_cube(tmp_path / "a.h5", quantity="reflectance")
    assert cube.transform == Affine(30.0, 0, 600_000, 0, -30.0, 4_900_000)
    assert open_cube(tmp_path / "b.h5", quantity="reflectance").crs.to_epsg() == 32611


def in_another_unit(file):
    file["radiance/radiance"].attrs["units"] = "W m-2 sr-1 um-1"


def packed_again(file):
    array = file["radiance/radiance"]
    array[...] = np.where(array[...] == -9999, -9999, (array[...] - 2.0) / 0.01)
    array.attrs["scale_factor"], array.attrs["add_offset"] = 0.01, 2.0


@pytest.mark.parametrize(
    ("change", "factor", "note"), [(in_another_unit, 0.1, "as the file states"), (packed_again, 1.0, "read as")]
)
def test_what_the_file_states_comes_before_the_layout(tmp_path, change, factor, note):
    want = shells.tree(tmp_path / "b.nc", "aviris")
    cube = open_cube(changed(tmp_path / "a.nc", "aviris", change), quantity="radiance")
    assert np.allclose(cube.read(0, LINES).values, factor * want, rtol=1e-5, equal_nan=True)
    assert any(note in said for said in cube.notes)


def in_another_file(file):
    del file["radiance"]
    size = LINES * SAMPLES * 5 * 4
    secret = Path(file.filename).with_name("secret")
    secret.write_bytes(bytes(size))
    file.create_dataset("radiance", (LINES, SAMPLES, 5), "f4", external=[(str(secret), 0, size)])


def linked(file):
    del file["radiance"]
    file["radiance"] = h5py.ExternalLink("other.h5", "/radiance")


def listed(name: str, value: float):
    return lambda file: file[f"sensor_band_parameters/{name}"].__setitem__(slice(None), value)


@pytest.mark.parametrize(
    ("change", "options", "error", "message"),
    [
        (in_another_file, {}, InputError, "lie in another file"),
        (linked, {}, InputError, "'radiance' lie in another file"),
        (
            lambda f: f.__delitem__("sensor_band_parameters/wavelengths"),
            {},
            InputError,
            "the file lists no wavelengths",
        ),
        (listed("wavelengths", 0.0), {}, InputError, "no band has a wavelength"),
        (listed("wavelengths", 5e6), {}, UsageError, "cannot be in nm"),
        (listed("fwhm", -1.0), {}, InputError, "not positive"),
        (listed("good_wavelengths", 0.0), {}, InputError, "every band as bad"),
        (list, {"quantity": "reflectance"}, InputError, "holds radiance, the campaign says reflectance"),
        (
            list,
            {"unit": "W m-2 sr-1 um-1"},
            UsageError,
            "radiance in uW cm-2 sr-1 nm-1, the campaign in W m-2 sr-1 um-1",
        ),
    ],
)
def test_products_that_are_refused(tmp_path, change, options, error, message):
    path = changed(tmp_path / "e.nc", "emit", change)
    with pytest.raises(error, match=message):
        open_cube(path, **({"quantity": "radiance"} | options))


@pytest.mark.parametrize("keep", [0.5, 0.9, 0.999])
def test_a_product_cut_short_is_one_clear_error(tmp_path, keep):
    shells.tree(tmp_path / "n.h5", "neon")
    raw = (tmp_path / "n.h5").read_bytes()
    (tmp_path / "n.h5").write_bytes(raw[: int(keep * len(raw))])
    with pytest.raises(InputError, match=r"n\.h5: not a readable HDF5 file"):
        open_cube(tmp_path / "n.h5", quantity="reflectance")


@pytest.mark.parametrize(
    ("product", "image", "angles"),
    [
        ("aviris", "AV320250814t180211_005_L1B_RDN_RDN.nc", "AV320250814t180211_005_L1B_RDN_OBS.nc"),
        ("emit", "EMIT_L1B_RAD_001_20240501T191103.nc", "EMIT_L1B_OBS_001_20240501T191103.nc"),
    ],
)
def test_the_sun_of_an_observation_file_beside_a_product(tmp_path, product, image, angles):
    shells.tree(tmp_path / image, product)
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


ARRAY_KEYS = re.compile("path|dimensions|wavelength|fwhm|widths|good|plus|scale|divisor|offset|subtract|range")
TREE_KEYS = re.compile(
    "product|sensor|quantity|unit|arrays|wavelength_unit|source|remark|sorts|ignore|bad_ranges_nm|lookup_table|(other_)?location|"
    "geotransform|map_info|crs|epsg|corner_pixels|pixel_size|struct_metadata|sun_zenith|time|day_and_clock|seconds"
)


def test_every_layout_names_its_source_and_states_what_is_read():
    for tree in layouts().trees:
        assert tree.source
        assert all(map(TREE_KEYS.fullmatch, tree))  # a key that nothing reads would change nothing
        assert all(ARRAY_KEYS.fullmatch(key) for array in tree.arrays for key in array)
        assert all(re.fullmatch("[lsb]{3}", array.dimensions) for array in tree.arrays)
        assert tree.quantity in ("radiance", "reflectance")
        assert tree.unit in ("1", "sr-1") or to_internal(tree.unit, "radiance") > 0
    assert all(to_internal(s.radiance_unit, "radiance") > 0 and s.source for s in layouts().sidecars)


# Metadata beside a GeoTIFF ----------------------------------------------------------------------


def metadata_in(folder: Path) -> Path:
    return next(p for p in folder.iterdir() if p.suffix.lower() == ".xml")


@pytest.mark.parametrize(
    ("sensor", "level", "factor"),
    [("EnMAP", "L1C", 100.0), ("DESIS", "L1C", 1.0), ("EnMAP", "L2A", 1.0), ("DESIS", "L2A", 1.0)],
)
@pytest.mark.parametrize("named", ["image", "metadata"])
def test_enmap_and_desis_by_their_metadata(tmp_path, sensor, level, factor, named):
    image, _ = shells.enmap(tmp_path, level, sensor=sensor)
    metadata = metadata_in(tmp_path)
    image.with_suffix(".hdr").write_text("ENVI\n")  # such as DLR delivers: the product's own file speaks
    quantity = "radiance" if level == "L1C" else "reflectance"
    cube = open_cube(image if named == "image" else metadata, quantity=quantity)
    assert [*cube.axis.centre_nm, *cube.axis.fwhm_nm] == [423.0, 650.0, 902.3, 911.6, 6.6, 7.0, 8.0, 9.1]
    with rasterio.open(image) as other:
        stored = other.read(masked=True).astype(float).filled(np.nan)
        assert (cube.transform, cube.crs) == (other.transform, other.crs)
    gain, offset = shells.scale_of(level, sensor)
    want = factor * (gain[:, None, None] * stored + offset[:, None, None])
    assert np.allclose(values_of(cube), want[[0, 1, 3, 2]].transpose(1, 2, 0), rtol=1e-12, equal_nan=True)
    assert {p.name for p in cube.raster.source_files} == {image.name, metadata.name}
    assert cube.raster.description.entries["sensor"] == sensor


def test_detectors_of_enmap_level_1b_are_two_cubes_on_no_map(tmp_path):
    stored = shells.enmap_two_detectors(tmp_path)
    metadata = metadata_in(tmp_path)
    gain, offset = shells.scale_of("L1B", "EnMAP")
    for detector, bands, centres in (("VNIR", [0, 1], [423.0, 650.0]), ("SWIR", [3, 2], [902.3, 911.6])):
        cube = open_cube(metadata, quantity="radiance", variable=detector)
        assert cube.axis.centre_nm.tolist() == centres
        values = np.where(stored[detector] == -32768, np.nan, stored[detector])[np.argsort(bands)]
        want = 100.0 * (gain[bands, None, None] * values + offset[bands, None, None])
        assert np.allclose(values_of(cube), want.transpose(1, 2, 0), rtol=1e-12, equal_nan=True)
        assert cube.transform is None
        assert any("a place some lines apart" in note for note in cube.notes)
        same = open_cube(next(tmp_path.glob(f"*_{detector}.TIF")), quantity="radiance")
        assert np.array_equal(values_of(same), values_of(cube), equal_nan=True)
    images = r"(?s)2 images could be meant: .*_SWIR.TIF, .*_VNIR.TIF.*variable: SWIR or VNIR"
    for variable in (None, "NIR"):
        with pytest.raises(UsageError, match=images):
            open_cube(metadata, quantity="radiance", variable=variable)


def test_stac_item_beside_a_geotiff(tmp_path):
    image, values = shells.stac(tmp_path)
    cube = open_cube(image, quantity="radiance")
    assert np.allclose(cube.axis.centre_nm, [503, 650, 799])
    assert np.allclose(cube.axis.fwhm_nm, 20.0)
    assert np.allclose(values_of(cube), 0.1 * values.transpose(1, 2, 0), rtol=1e-6)
    with rasterio.open(image) as other:
        assert (cube.transform, cube.crs) == (other.transform, other.crs)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<level_X>", "<!DOCTYPE a><level_X>", "DOCTYPE"),
        ("</level_X>", "", "not valid XML"),
        ("423.0", "blue", "wavelengthCenterOfBand: 'blue' is not a number"),
        ('<bandID number="4">', '<other number="4">', "not valid XML"),
        ('number="3"', 'number="2"', "4 bands whose numbers are not 1 to 4"),
    ],
)
def test_metadata_that_are_broken(tmp_path, old, new, message):
    image, _ = shells.enmap(tmp_path)
    metadata_in(tmp_path).write_text(metadata_in(tmp_path).read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        open_cube(image, quantity="radiance")


def test_bands_of_enmap_go_by_their_number(tmp_path):
    image, _ = shells.enmap(tmp_path)
    before = open_cube(image, quantity="radiance")
    metadata = metadata_in(tmp_path)
    items = re.findall(r"<bandID.*?</bandID>", metadata.read_text())
    metadata.write_text(metadata.read_text().replace("".join(items), "".join(items[::-1])))
    after = open_cube(image, quantity="radiance")
    assert after.axis.matches(before.axis)
    assert after.stored_band.tolist() == before.stored_band.tolist()
    assert np.array_equal(after.read(0, 3).values, before.read(0, 3).values, equal_nan=True)


@pytest.mark.parametrize(
    ("sensor", "old", "new", "sun"),
    [
        ("EnMAP", "<specific>", "<specific><sunElevationAngle><upper_left>40</upper_left><center>52.5</center>"
         "</sunElevationAngle>", 37.5),
        ("DESIS", "<backgroundValue>-32768</backgroundValue>", "<sunZenithAngle>30</sunZenithAngle>", 30.0),
    ],
)  # fmt: skip
def test_sun_and_no_data_of_metadata_and_no_map_of_level_1b(tmp_path, sensor, old, new, sun):
    level, quantity = ("L1B", "radiance") if sensor == "EnMAP" else ("L2A", "reflectance")
    image, _ = shells.enmap(tmp_path, level, sensor=sensor)
    metadata = metadata_in(tmp_path)
    metadata.write_text(metadata.read_text().replace(old, new, 1))
    with rasterio.open(image, "r+") as file:
        file.nodata = None
    cube = open_cube(image, quantity=quantity)
    assert np.isnan(values_of(cube)[0, 0]).all()
    assert np.isfinite(values_of(cube)[1:]).all()
    assert sun_zenith_deg(cube.raster) == (sun, metadata.name)
    assert ((cube.transform, cube.crs) == (None, None)) == (level == "L1B")
    assert any("a fit to its corners" in note for note in cube.notes) == (level == "L1B")


@pytest.mark.parametrize("both", [False, True])
def test_an_image_cut_into_tiles_for_the_cloud_is_found_by_its_metadata(tmp_path, both):
    image, _ = shells.enmap(tmp_path, "L2A")
    tiles = image.with_name(f"{image.stem}_COG.TIF")
    tiles.write_bytes(image.read_bytes())
    if not both:
        image.unlink()
    cube = open_cube(metadata_in(tmp_path), quantity="reflectance")
    assert cube.raster.path == (image if both else tiles)


# Arrays that no layout names --------------------------------------------------------------------


def labelled(path: Path, **more) -> tuple[Path, np.ndarray]:
    """An array (y, x, band) with its wavelengths [um] and its place by CF, and what it holds."""
    values = shells.drawn(4)[0]
    values[1, 1] = np.nan
    attributes = {"units": "uW cm-2 sr-1 nm-1", "_FillValue": -1.0, "grid_mapping": "spatial_ref"}
    data = xr.Dataset(
        {"Lt": (("y", "x", "band"), np.nan_to_num(values, nan=-1.0), attributes)},
        coords={
            "wavelength": ("band", [0.45, 0.55, 0.65, 0.85], {"units": "um"}),
            "y": 3_800_000.0 - 2 - 4 * np.arange(LINES),
            "x": 400_000.0 + 2 + 4 * np.arange(SAMPLES),
            "spatial_ref": ((), 0, {"crs_wkt": shells.UTM11.to_wkt()}),
        },
    ).assign(**more)
    if path.suffix == ".zarr":
        data.to_zarr(path, zarr_format=2, consolidated=True)
    else:
        data.to_netcdf(path, engine="scipy" if path.suffix == ".nc3" else "h5netcdf")
    return path, values


@pytest.mark.parametrize("name", ["a.nc", "a.nc3", "a.zarr"])
def test_any_array_with_a_wavelength_coordinate_is_a_cube(tmp_path, name):
    path, want = labelled(tmp_path / name)
    cube = open_cube(path, quantity="radiance")
    assert np.allclose(values_of(cube), want, rtol=1e-6, equal_nan=True)
    assert np.allclose(cube.axis.centre_nm, [450, 550, 650, 850])
    assert (cube.transform, cube.crs) == (shells.MAP, shells.UTM11)


def test_where_several_arrays_could_be_meant_the_message_lists_them(tmp_path):
    path, _ = labelled(tmp_path / "a.nc", noise=(("y", "x", "band"), np.ones((LINES, SAMPLES, 4), np.float32)))
    with pytest.raises(UsageError, match=r"(?s)2 arrays could be meant.*Lt .*noise .*state variable"):
        open_cube(path, quantity="radiance")
    assert open_cube(path, quantity="radiance", variable="Lt").shape == (LINES, SAMPLES)
    with pytest.raises(UsageError, match=r"(?s)0 arrays 'L'.*one of Lt"):
        open_cube(path, quantity="radiance", variable="L")


def test_an_hdf5_tree_without_dimensions_is_a_cube_where_wavelengths_lie_beside(tmp_path):
    values = shells.drawn(7)[0]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["scene/image"] = values
    with pytest.raises(InputError, match="the file lists no wavelengths"):
        open_cube(tmp_path / "a.h5", quantity="radiance")
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["scene/wavelength"] = np.linspace(400.0, 1000.0, 7)
        file["scene/dark"] = np.zeros((3, 4))
    cube = open_cube(tmp_path / "a.h5", quantity="radiance", unit="uW cm-2 sr-1 nm-1")
    assert np.allclose(values_of(cube), values, rtol=1e-6)


def test_bands_in_a_group_of_their_own(tmp_path):
    """As in other products of EMIT and OCI, whose images no layout names."""
    values = shells.drawn(4)[0]
    with h5py.File(tmp_path / "a.nc", "w") as file:
        shells.put(file, "geophysical_data/Lt", values, dims=["lines", "pixels", "bands"], units="W/m2/sr/um")
        shells.put(file, "parameters/wavelengths", [400.0, 500.0, 600.0, 700.0], dims=["bands"], units="nm")
        shells.put(file, "parameters/fwhm", [8.5] * 4, dims=["bands"], units="nm")
    cube = open_cube(tmp_path / "a.nc", quantity="radiance")
    assert np.allclose(values_of(cube), 0.1 * values, rtol=1e-6)
    assert (cube.axis.centre_nm.tolist(), cube.axis.fwhm_nm.tolist()) == ([400, 500, 600, 700], [8.5] * 4)


TRUE = np.linspace(0.05, 0.6, 3 * 4 * 5).reshape(3, 4, 5)
COUNTS = np.round(TRUE * 1e4).astype(np.int16)
GAPS, HOLED = COUNTS.copy(), TRUE.copy()
GAPS[:, 0, 0], GAPS[:, 1, 1], HOLED[:, [0, 1], [0, 1]] = -32768, -9999, np.nan
FILLS = {"_FillValue": np.int16(-9999), "missing_value": np.int16(-32768)}


def packed(path: Path, stored: np.ndarray, name: str = "reflectance", **attrs) -> Path:
    """A NetCDF-4 file of one array (wavelength, y, x), its numbers and attributes as given."""
    data = xr.Dataset(
        {name: (("wavelength", "y", "x"), stored, attrs)},
        coords={"wavelength": ("wavelength", [500.0, 600.0, 700.0], {"units": "nm"})},
    )
    data.to_netcdf(path, engine="h5netcdf")
    return path


@pytest.mark.parametrize(
    ("stored", "attributes", "options", "want"),
    [
        # unsigned numbers in a signed type
        (np.round(TRUE / 1e-5).astype("u2").view("i2"), {"scale_factor": 1e-5, "_Unsigned": "true"}, {}, TRUE),
        (2 * TRUE, {"units": "%"}, {}, 0.02 * TRUE),  # at most 1.2 %: dark, and plausible as a fraction
        (2 * TRUE, {"units": "percent"}, {}, 0.02 * TRUE),
        (100 * TRUE, {"units": "%", "name": "albedo"}, {}, TRUE),
        (COUNTS, {"scale_factor": 1e-4}, {}, TRUE),
        (GAPS, {"scale_factor": 1e-4, **FILLS}, {}, HOLED),
        # a stated scale multiplies the numbers in the file
        (COUNTS, {"scale_factor": 0.01, "add_offset": 3.0, "units": "%"}, {"scale": 1e-4}, TRUE),
        (COUNTS, {"scale_factor": 0.01, "add_offset": 3.0, "units": "%"}, {}, TRUE + 0.03),
    ],
)
def test_packed_arrays(tmp_path, stored, attributes, options, want):
    path = packed(tmp_path / "a.nc", stored, **attributes)
    block = open_cube(path, quantity="reflectance", **options).read(0, 4)
    assert np.allclose(block.values.transpose(2, 0, 1), want, atol=1e-4, equal_nan=True)
    assert np.array_equal(block.valid, np.isfinite(want).all(axis=0))
    if len(attributes) == 1:  # an array at hand is unpacked once
        for decode in (False, True):
            with xr.open_dataset(path, engine="h5netcdf", mask_and_scale=decode) as data:
                block = open_cube(data["reflectance"], quantity="reflectance").read(0, 4)
                assert np.allclose(block.values.transpose(2, 0, 1), want, atol=1e-4)


# What lies beside an image ----------------------------------------------------------------------


def test_a_table_beside_an_image_of_the_same_name_is_no_image(tmp_path, axis):
    write_cube(tmp_path / "line1.img", np.full((6, 5, len(axis)), 0.2), data_type=4, axis=axis)
    (tmp_path / "line1.csv").write_text("region,line,sample\nroof,1,2\nroof,1,3\n")
    regions = read_regions(tmp_path / "line1.csv", (6, 5))
    assert np.argwhere(regions["roof"].mask).tolist() == [[1, 2], [1, 3]]
    with pytest.raises(InputError, match=r"(?s)no header beside the data file.*gdal_translate"):
        open_raster(tmp_path / "line1.csv")


def test_more_names_than_bands_name_no_band(tmp_path, axis):
    image = write_cube(tmp_path / "f01_rdn_img", np.full((6, 5, len(axis)), 2.0), data_type=4, axis=axis)
    names = {"band names": "{Path length, To-sensor, To-sun zenith}"}
    path = write_cube(tmp_path / "f01_rdn_obs", np.full((6, 5, 2), 0.5), data_type=5, extra=names)
    assert sun_zenith_deg(open_raster(image)) is None
    truth = AbundanceTruth(image=path.name, materials={"panel": "To-sun zenith"})
    with pytest.raises(InputError, match="a number, 1 to 2: its header has no name for each band"):
        image_targets(truth, open_cube(image, quantity="other"), 1.0, lambda name: tmp_path / name)
