"""Real collections: the same numbers through every way that leads to them."""

from __future__ import annotations

import csv
import itertools

import numpy as np
import pytest
import rasterio
import spectral

from hyperval.envi_header import DATA_TYPES
from hyperval.errors import InputError
from hyperval.imagery import intersected_objects, objects, open_cube, open_raster, overlaps, read_regions

pytestmark = pytest.mark.data

SHAPE = (86, 123)
MATERIALS = {
    "bitumen": "bitumen", "redMetal": "red_metal", "blueFabric": "blue_fabric", "redFabric": "red_fabric",
    "greenFabric": "green_fabric",
}  # fmt: skip
SIDES = {1: 3.0, 2: 2.0, 3: 1.0, 4: 0.5, 5: 0.25}


def test_published_geotiff_equals_the_envi_copy(data_dir):
    tiff = data_dir("hysu/published/full/DLR_HySU_HS_full.tif")
    envi = data_dir("hysu/hysu_full_refl.img")
    noted = open_cube(tiff, quantity="reflectance")
    assert any("can only be um" in note for note in noted.notes)
    a = open_cube(tiff, quantity="reflectance", wavelength_unit="um", root=tiff.parent)
    b = open_cube(envi, quantity="reflectance")
    assert (a.shape, a.bands) == (b.shape, b.bands) == (SHAPE, 135)
    assert np.allclose(a.axis.centre_nm, b.axis.centre_nm, rtol=0, atol=1e-6)
    assert np.allclose(a.axis.fwhm_nm, b.axis.fwhm_nm, rtol=0, atol=1e-6)
    for x, y in zip(a.blocks(10), b.blocks(10), strict=True):
        assert np.array_equal(x.values, y.values, equal_nan=True)
        assert np.array_equal(x.valid, y.valid)
    assert a.transform == b.transform
    assert a.crs == b.crs
    assert a.crs.to_epsg() == 32632
    assert a.pixel_area_m2 == pytest.approx(0.49)
    with rasterio.open(envi, driver="ENVI") as dataset:
        assert np.allclose(dataset.read().transpose(1, 2, 0) / 1e4, a.read(0, 86).values, atol=1e-12)
    image = spectral.open_image(str(envi.with_suffix(".hdr"))).load()
    assert np.allclose(np.asarray(image), a.read(0, 86).values, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "unit", "bands", "text"),
    [
        ("envi/av3_ivanpah_20250308/AV320250308t200738_rdn.img", "Micrometers", 284, True),
        ("envi/prism_20231110/prm20231110t071521_rdn_two_px", "Nanometers", 246, False),
    ],
)
def test_airborne_radiance_pixels(data_dir, name, unit, bands, text):
    path = data_dir(name)
    cube = open_cube(path, quantity="radiance", unit="uW cm-2 sr-1 nm-1")
    assert (cube.bands, cube.samples) == (bands, 1)
    assert 300 < cube.axis.centre_nm[0] < 400
    values = cube.read(0, cube.lines).values
    spy = spectral.open_image(str(cube.raster.header.path)).load()
    assert np.array_equal(values.astype("f4"), np.asarray(spy))
    if text:  # the distributor's own text copy of the same pixel
        table = np.loadtxt(path.with_suffix(".txt"))
        assert np.allclose(values[0, 0], table[:, -1], rtol=1e-6)
        assert np.allclose(cube.axis.centre_nm, table[:, 0] * (1000 if table[0, 0] < 10 else 1), atol=0.01)


def test_files_without_wavelengths_are_not_cubes(data_dir):
    path = data_dir("envi/av3_ivanpah_20250308/AV320250308t200738_obs.img")
    with pytest.raises(InputError, match="lists no wavelengths"):
        open_cube(path, quantity="other")
    stored = open_raster(path).read_lines(0, 1)[0, 0]
    text = data_dir("envi/av3_ivanpah_20250308/AV320250308t200738_obs.txt").read_text()
    assert np.allclose(stored, [float(word) for word in text.replace(",", " ").split()][-11:], rtol=1e-6)


def test_hysu_targets_from_rasters_are_those_of_the_list(data_dir):
    masks = {}
    for file, material in MATERIALS.items():
        (region,) = read_regions(data_dir(f"hysu/published/rois/{file}"), SHAPE).values()
        masks[material] = region.mask
        assert region.name.lower() == file.lower()
    sizes = open_raster(data_dir("hysu/published/rois/targetsSizeROI")).read_lines(0, 86)[:, :, 0]
    found = intersected_objects(masks, sizes, SIDES)
    with open(data_dir("hysu/targets.csv"), newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(found) == len(rows) == 25
    for target, row in zip(found, rows, strict=True):
        assert (target.material, target.side_m) == (row["material"], float(row["nominal_side_m"]))
        assert target.area_m2 == float(row["nominal_area_m2"])
        assert target.mask.sum() == int(row["roi_pixels"])
        assert objects(target.mask)[1] == int(row["connected_components"])
        centre = np.argwhere(target.mask).mean(axis=0)
        assert np.allclose(centre, [float(row["centroid_row0"]), float(row["centroid_col0"])], atol=0.006)


def test_hysu_masks_cube_and_pixel_list_agree_with_the_rasters(data_dir):
    bands = read_regions(data_dir("hysu/hysu_target_masks.img"), SHAPE)
    with open(data_dir("hysu/target_pixels.csv"), newline="") as stream:
        rows = list(csv.DictReader(stream))
    for file, material in MATERIALS.items():
        raster = next(iter(read_regions(data_dir(f"hysu/published/rois/{file}"), SHAPE).values()))
        assert np.array_equal(raster.mask, bands[material].mask)
        listed = [(int(r["row0"]), int(r["col0"])) for r in rows if r[material] == "1"]
        assert sorted(map(tuple, np.argwhere(raster.mask).tolist())) == sorted(listed)
    # Masks of different materials overlap at the edges of the targets; that is reported.
    assert overlaps([bands[m] for m in MATERIALS.values()])


def test_hysu_pixel_coordinates_are_those_of_the_list(data_dir):
    cube = open_cube(data_dir("hysu/hysu_full_refl.img"), quantity="reflectance")
    with open(data_dir("hysu/target_pixels.csv"), newline="") as stream:
        row = next(csv.DictReader(stream))
    t, x, y = cube.transform, int(row["col0"]) + 0.5, int(row["row0"]) + 0.5
    assert t.a * x + t.b * y + t.c == pytest.approx(float(row["utm32_e_center"]), abs=0.006)
    assert t.d * x + t.e * y + t.f == pytest.approx(float(row["utm32_n_center"]), abs=0.006)


def test_envi_ascii_export(data_dir):
    path = data_dir("roi/2013_IEEE_GRSS_DF_Contest_Samples_VA.txt.gz")
    regions = read_regions(path, (349, 1905))
    assert len(regions) == 15
    assert {n: regions[n].n for n in ("grass_healthy", "water", "running_track")} == {
        "grass_healthy": 1053, "water": 143, "running_track": 473,
    }  # fmt: skip
    assert regions["grass_healthy"].mask[11, 783]  # "1 784 12": X, Y counted from 1
    assert overlaps(regions.values()) == []
    with pytest.raises(InputError, match="made for 349 lines x 1905 samples"):
        read_regions(path, (348, 1905))


def test_the_published_cube_in_every_type_and_layout(data_dir, tmp_path):
    published = open_cube(
        data_dir("hysu/published/full/DLR_HySU_HS_full.tif"), quantity="reflectance", wavelength_unit="um"
    )
    stored = published.raster.read_lines(0, 20)
    expected = published.read(0, 20)
    waves = ", ".join(repr(w) for w in published.axis.centre_nm.tolist())
    mask = np.zeros((20, 123), bool)
    mask[::3, ::5] = True
    for code in sorted(set(DATA_TYPES) - {1}):  # a byte does not hold its numbers
        for order, (interleave, axes) in itertools.product(
            (0, 1), {"bsq": (2, 0, 1), "bil": (0, 2, 1), "bip": (0, 1, 2)}.items()
        ):
            offset = 13 * (code % 2)
            path = tmp_path / "c.img"
            kind = "<>"[order] + DATA_TYPES[code]
            path.write_bytes(b"\xff" * offset + stored.transpose(axes).astype(kind).tobytes())
            path.with_suffix(".hdr").write_text(
                f"ENVI\nsamples = 123\nlines = 20\nbands = 135\nheader offset = {offset}\ndata type = {code}\n"
                f"interleave = {interleave}\nbyte order = {order}\nwavelength units = nm\n"
                f"wavelength = {{{waves}}}\nreflectance scale factor = 10000\ndata ignore value = 15000\n"
            )
            cube = open_cube(path, quantity="reflectance")
            block = cube.read(0, 20)
            assert np.array_equal(block.values, expected.values, equal_nan=True), (code, order, interleave)
            assert np.array_equal(block.valid, expected.valid)
            assert np.array_equal(cube.pixels(mask), expected.values[mask], equal_nan=True)
            assert np.array_equal(cube.read_stored(3, 5)[0].transpose(1, 2, 0), stored[3:8])
