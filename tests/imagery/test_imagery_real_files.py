"""Real collections: the same numbers through every way that leads to them."""

import csv

import numpy as np
import pytest

from hyperval.imagery import intersected_objects, objects, open_raster, read_regions

pytestmark = pytest.mark.data

SHAPE = (86, 123)
MATERIALS = ("bitumen", "redMetal", "blueFabric", "redFabric", "greenFabric")
SIDES = {1: 3.0, 2: 2.0, 3: 1.0, 4: 0.5, 5: 0.25}


def test_hysu_targets_from_rasters_are_those_of_the_list(data_dir):
    masks = {}
    for file in MATERIALS:
        (region,) = read_regions(data_dir(f"hysu/published/rois/{file}"), SHAPE).values()
        masks[file.replace("M", "_m").replace("F", "_f")] = region.mask
        assert region.name.lower() == file.lower()
    sizes = open_raster(data_dir("hysu/published/rois/targetsSizeROI")).read_bands(0, 86)[0]
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
