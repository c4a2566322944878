"""Cubes of other programs: GeoTIFF, and arrays and cubes of SPy and xarray."""

import os
import struct
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import product_shells as shells
import pytest
import rasterio
import rasterio.shutil
import spectral
from affine import Affine
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning
from small_files import write_raster

from hyperval import api, cli
from hyperval.errors import InputError, UsageError
from hyperval.imagery import open_cube, open_raster, tiff, write_cube
from hyperval.run import ScoreMap
from hyperval.spectra import SpectralAxis, library_to_spy, library_to_xarray, read_records

# GeoTIFFs: wavelengths in tags, what lies beside them, and what is refused.


CENTRE = (450.0, 550.0, 650.0, 850.0)


def retagged(path: Path, change: Callable[..., object]) -> Path:
    """A GeoTIFF without a map position after a change of it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "r+") as out:
            change(out)
    return path


def tagged(path: Path, values: np.ndarray, tags: list[dict[str, str]]) -> Path:
    """A GeoTIFF without a map position, with tags for each band."""
    write_raster(path, values.astype(np.float32).transpose(2, 0, 1))
    return retagged(path, lambda out: [out.update_tags(band, **e) for band, e in enumerate(tags, start=1)])


@pytest.fixture
def placed(tmp_path, values) -> Path:
    """A GeoTIFF of integers with its place and a no-data value."""
    place = {"crs": "EPSG:32618", "transform": Affine(2, 0, 3e5, 0, -2, 47e5), "nodata": -99}
    return write_raster(tmp_path / "t.tif", np.rint(values * 10000).astype("int16").transpose(2, 0, 1), **place)


@pytest.mark.parametrize("domain", ["ENVI", None, "names"])
@pytest.mark.parametrize("each", [True, False])
@pytest.mark.parametrize(("unit", "per_nm"), [("nm", 1.0), ("Micrometers", 1e-3)])
def test_wavelengths_in_tags_of_bands_or_data_set_or_in_names(tmp_path, values, domain, each, unit, per_nm):
    listed = {"wavelength": [f"{w * per_nm:g}" for w in CENTRE], "fwhm": [f"{9.5 * per_nm:g}"] * 4}
    listed["bbl"] = ["1", "1", "0", "1"]

    def state(out):
        if domain == "names":
            out.descriptions = [f"{w} {unit}" if each else f"Band ({float(w):.5f})" for w in listed["wavelength"]]
        for band in range((4 if each else 1) * (domain != "names")):
            entries = {key: texts[band] if each else ",".join(texts) for key, texts in listed.items()}
            out.update_tags(*([band + 1] if each else []), ns=domain, **{"wavelength units": unit, **entries})

    cube = open_cube(retagged(tagged(tmp_path / "c.tif", values, []), state), quantity="reflectance")
    assert cube.axis.centre_nm == pytest.approx(CENTRE)
    if domain == "names":
        assert any("names of the bands" in note for note in cube.notes)
    else:
        assert cube.axis.fwhm_nm == pytest.approx([9.5] * 4)
        assert cube.axis.good.tolist() == [True, True, False, True]


def two_wavelengths(out):
    for band, w in enumerate(CENTRE, start=1):
        out.update_tags(band, ns="IMAGERY", CENTRAL_WAVELENGTH_UM=f"{w / 1e3 + 0.002:.4f}")


def masked(out):
    out.write_mask(np.arange(30).reshape(6, 5) > 5)


@pytest.mark.parametrize(
    ("spoil", "change", "message"),
    [
        ({"wavelength_units": "inches"}, None, "in 'inches' cannot be used"),
        ({"wavelength": "blue"}, None, "item 1 of 'wavelength' is not a number"),
        ({"wavelength": "nan"}, None, "item 1 of 'wavelength' is not finite"),
        ({"fwhm": "-1"}, None, r"width \(fwhm\) of -1, which is not positive"),
        ({}, two_wavelengths, "the bands have two wavelengths"),
        ({}, masked, "mask or alpha band"),
    ],
)
def test_tags_that_contradict_and_masks_are_refused(tmp_path, values, spoil, change, message):
    tags = [{"wavelength": f"{w}", "wavelength_units": "nm", **spoil} for w in CENTRE]
    path = tagged(tmp_path / "c.tif", values, tags)
    if change is not None:
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
            retagged(path, change)
    with pytest.raises(InputError, match=message):
        open_cube(path, quantity="reflectance")


def test_a_file_that_gdal_converted_keeps_its_wavelengths(tmp_path, values):
    """GDAL writes them twice, once rounded to a nanometre, and the widths rounded alone."""
    axis = SpectralAxis([433.29, 446.58, 659.87, 873.15], [5.3, 5.3, 5.4, 5.4])
    write_cube(tmp_path / "a.img", values, axis=axis, interleave="bsq")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        rasterio.shutil.copy(tmp_path / "a.img", tmp_path / "a.tif", driver="GTiff")
    (tmp_path / "a.hdr").rename(tmp_path / "no.header")
    cube = open_cube(tmp_path / "a.tif", quantity="reflectance")
    assert cube.axis.centre_nm == pytest.approx(axis.centre_nm, abs=1e-9)
    assert cube.axis.fwhm_nm == pytest.approx([5.0] * 4)
    assert any("whole nanometres" in note for note in cube.notes)


def test_threads_that_read_a_file_without_position_warn_of_nothing(tmp_path, values, monkeypatch):
    monkeypatch.setattr(tiff, "MAX_READ_BYTES", 0)  # as of a large image: each opens the file
    raster = open_raster(tagged(tmp_path / "c.tif", np.tile(values, (40, 8, 1)), []))
    with warnings.catch_warnings(record=True) as seen, ThreadPoolExecutor(8) as pool:
        warnings.simplefilter("always")
        blocks = list(pool.map(lambda line: raster.read_bands(line, 1), range(raster.lines)))
    # Others may come from what earlier tests left to be collected.
    assert not [w for w in seen if issubclass(w.category, NotGeoreferencedWarning)]
    assert np.array_equal(np.concatenate(blocks, axis=1), raster.read_bands(0, raster.lines))


def test_other_sidecars_of_a_geotiff_are_not_read(placed, axis, values):
    """Overviews and masks beside the file; a world file does not move one that knows its place."""
    for name, size in (("t.tif.ovr", (3, 3)), ("t.tif.msk", (6, 5))):
        write_raster(placed.with_name(name), np.zeros((4, *size), "u1"))
    placed.with_suffix(".tfw").write_text("9\n0\n0\n-9\n0\n0\n")
    with rasterio.open(placed, "r+") as dataset:  # these are read, once
        dataset.scales, dataset.offsets = (1e-4,) * 4, (0.01,) * 4
    cube = open_cube(placed, quantity="reflectance", axis=axis)
    assert np.allclose(cube.read(0, 6).values, values + 0.01, atol=1e-12)
    cube = open_cube(placed, quantity="reflectance", scale=1e-4, axis=axis)
    assert (cube.ignore_value, cube.pixel_area_m2, cube.crs.to_epsg()) == (-99, 4.0, 32618)
    assert np.allclose(cube.read(0, 6).values, values, atol=1e-15)
    assert cube.read(0, 6).valid.all()
    assert cube.transform == Affine(2, 0, 3e5, 0, -2, 47e5)
    assert {p.name for p in cube.raster.source_files} == {"t.tif"}


def test_damaged_files_other_containers_and_a_header_of_another_size(tmp_path, placed, cube_file):
    header = cube_file.with_suffix(".hdr").read_text()
    placed.with_suffix(".hdr").write_text(header.replace("lines = 6", "lines = 7"))
    with pytest.raises(InputError, match="its header says"):
        open_cube(placed, quantity="reflectance")
    placed.with_suffix(".hdr").unlink()
    fake = tmp_path / "v.tif"
    fake.write_text(f"<VRTDataset rasterXSize='5' rasterYSize='6'><SRSDataset>{placed}</SRSDataset></VRTDataset>")
    with pytest.raises(InputError, match="not a readable GeoTIFF"):
        open_cube(fake, quantity="reflectance")
    os.truncate(placed, placed.stat().st_size // 2)
    with pytest.raises(InputError, match="GeoTIFF"):
        list(open_cube(placed, quantity="other", axis=SpectralAxis(np.arange(4) + 400.0, 1.0)).blocks())
    (tmp_path / "scene.hdf").write_bytes(b"\x0e\x03\x13\x01" + bytes(600))
    with pytest.raises(InputError, match=r"(?s)HDF4.*not read as a cube.*docs/formats.md, Cubes"):
        open_raster(tmp_path / "scene.hdf")


def test_more_bands_than_an_imager_has_are_refused(tmp_path):
    # One pixel of 32,769 bands in 1.4 kB: width, height, bits, samples per pixel, strip and its place.
    entries = [(256, 4, 1), (257, 4, 1), (258, 3, 8), (259, 3, 1), (262, 3, 1), (273, 4, 8), (277, 3, 32_769)]
    entries += [(278, 4, 1), (279, 4, 1), (284, 3, 1)]
    body = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in entries)
    (path := tmp_path / "many.tif").write_bytes(struct.pack("<2sHIH", b"II", 42, 8, len(entries)) + body + bytes(1300))
    with pytest.raises(InputError, match="32769 bands\n  expected: at most 20000"):
        open_cube(path, quantity="other")
    path.write_bytes(path.read_bytes().replace(struct.pack("<I", 32_769), struct.pack("<I", 16_385)))
    with pytest.raises(InputError, match="1430 bytes for 16385 bands of 1 lines and 1 samples"):
        open_cube(path, quantity="other")


# Cubes and libraries to SPy and xarray and back; what ``hyperval explain`` says of a file.


@pytest.mark.parametrize("interleave", ["bsq", "bil", "bip"])
@pytest.mark.parametrize("order", [0, 1])
def test_an_envi_cube_becomes_a_mapped_image_of_spy(tmp_path, axis, values, interleave, order):
    stated = {"reflectance scale factor": "10000.0", "header offset": "13", "byte order": str(order)}
    options = {"data_type": 2, "axis": axis, "interleave": interleave, "extra": stated}
    path = write_cube(tmp_path / "c.img", values * 10000.0, **options)
    image = open_cube(path, quantity="reflectance").to_spy()
    assert isinstance(image, spectral.io.spyfile.SpyFile)
    assert np.allclose(image.load(), values, atol=1e-7)
    assert image.open_memmap(interleave="bip").shape == values.shape
    assert (image.bands.centers, image.bands.band_unit) == (axis.centre_nm.tolist(), "nm")
    back = open_cube(image, quantity="reflectance")  # the file is known by its name
    assert np.allclose(back.read(0, 6).values, values, atol=1e-12)


def test_xarray_reads_by_parts_and_goes_both_ways(tmp_path, monkeypatch):
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
    for again in (array, array.expand_dims("time"), tmp_path / "again.nc"):
        back = open_cube(again, quantity="reflectance")
        assert (back.transform, back.crs) == (cube.transform, cube.crs)
        assert back.axis.good.tolist() == cube.axis.good.tolist()
        assert np.allclose(back.read(0, 12).values, want, equal_nan=True)


def test_a_library_goes_both_ways(tmp_path):
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
    extra = {"reflectance scale factor": "10000", "data units": "W/m^2/sr/um"}
    cube = write_cube(tmp_path / "c.img", values, data_type=4, axis=axis, ignore_value=-9.0, extra=extra)
    told, header = rows(cube), cube.with_suffix(".hdr")
    assert told["size"] == ("6 lines, 5 samples, 4 bands of float32", f"{header}:3 'samples'")
    value, origin = told["wavelengths"]
    assert value == "4, 450 to 850 nm"
    assert header.read_text().splitlines()[int(origin.rsplit(":", 1)[1]) - 1].startswith("wavelength =")
    assert told["no data"][0] == "-9"
    scale = "x 0.0001", "stored values / 10000 (reflectance scale factor)"
    assert told["scale of reflectance"] == scale
    assert told["quantity"] == ("not known", "state quantity: (init: --quantity)")
    assert all(map(str.__contains__, told["scale of radiance"], ("exclude each other", "state scale:")))
    with pytest.raises(InputError, match=r"(?s)are reflectances as they stand.*scale: 1 .*scale: 0\.0001"):
        open_cube(cube, quantity="reflectance")  # whose numbers were divided by 10000 before
    assert [open_cube(cube, quantity="reflectance", scale=s).gain[0] for s in (1.0, 1e-4)] == [1.0, 1e-4]
    assert (told["position"][0], told["unit of radiance"][0]) == ("none", "W/m^2/sr/um")
    assert cli.run(["explain", str(cube)]) == 0
    assert "quantity\tnot known\tstate quantity: (init: --quantity)\n" in capsys.readouterr().out
    header.write_text(header.read_text().replace("wavelength units = Nanometers", "wavelength units = Unknown"))
    assert rows(cube)["wavelength unit"] == ("nm", "guess: by the values")


def test_an_array_without_wavelengths_and_a_file_of_spectra(tmp_path):
    np.save(tmp_path / "a.npy", np.ones((3, 4, 5), np.uint16))
    told = rows(tmp_path / "a.npy")
    assert told["is"] == ("array 'a' of a NumPy file", "its first bytes")
    assert "collection.bands" in told["wavelengths"][1]
    (tmp_path / "a.hdr").write_text("ENVI\nlines = 3\nsamples = 4\nbands = 5\nwavelength = {400, 410, 420, 430, 440}\n")
    assert rows(tmp_path / "a.npy")["wavelengths"] == ("5, 400 to 440 nm", f"{tmp_path / 'a.hdr'}:5")
    (tmp_path / "s.txt").write_text("wavelength_nm reflectance\n" + "".join(f"{w} 0.5\n" for w in range(400, 500, 10)))
    assert rows(tmp_path / "s.txt")["spectrum"][0] == "s: 10 values, 400 to 490 nm"
