"""Real collections: the same numbers through every way that leads to them."""

import csv

import numpy as np
import pytest

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
