"""Target lists and objects from rasters."""

import math
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from small_files import table

from hyperval.errors import HypervalError, InputError, UsageError
from hyperval.imagery import Region, guard, intersected_objects, read_targets, region_objects

SHAPE = (20, 30)
TRANSFORM = Affine(2.0, 0, 1000.0, 0, -2.0, 5000.0)


def targets(folder: Path, text: str, **options):
    (folder / "t.csv").write_bytes(text.encode())
    return read_targets(folder / "t.csv", SHAPE, **({"pixel_size_m": 1.0} | options))


@pytest.mark.parametrize(
    "place", ["row0,col0\n{},7,11", "row1,col1\n{},8,12", "line,sample\n{},7.5,11.5", "easting,northing\n{},1023,4985"]
)
def test_one_place_in_every_coordinate_system(tmp_path, place):
    head, row = place.split("\n")
    text = f"material,{head},side_m,name\n{row.format('plank')},2.0,p1\n"
    (target,) = targets(tmp_path, text, transform=TRANSFORM, pixel_size_m=None)
    assert (target.name, target.material, target.side_m, target.area_m2) == ("p1", "plank", 2.0, 4.0)
    # 2 m is one pixel: the target fills pixel (7, 11) and at most touches its neighbours.
    assert target.mask[7, 11]
    assert not target.mask[:6].any()
    assert not target.mask[9:].any()


def test_heading_turns_a_long_target(tmp_path):
    text = "material,line,sample,width_m,length_m,heading_deg\na,10.5,10.5,0.2,8,0\nb,10.5,10.5,0.2,8,90\n"
    north, east = targets(tmp_path, text)
    assert sorted(set(np.argwhere(north.mask)[:, 1])) == [10]
    assert sorted(set(np.argwhere(east.mask)[:, 0])) == [10]
    assert north.mask.sum() == east.mask.sum() == 9
    assert north.area_m2 == pytest.approx(1.6)
    assert np.isnan(north.side_m)


@pytest.mark.parametrize("case", table("refused")["targets"], ids=str)
def test_lists_that_are_refused(tmp_path, case):
    with pytest.raises(HypervalError, match=case["says"]) as caught:
        targets(tmp_path, case["text"], **case.get("options", {}))
    assert caught.value.exit_code == case.get("exit", 3)


def test_objects_are_the_intersection_and_need_not_be_connected():
    cloth = np.zeros(SHAPE, bool)
    cloth[2, 2] = cloth[2, 9] = cloth[8, 3] = True
    sizes = np.zeros(SHAPE, int)
    sizes[2], sizes[8] = 1, 2
    large, small = intersected_objects({"cloth": cloth}, sizes, {1: 3.0, 2: 0.5})
    assert (large.name, large.area_m2, large.mask.sum()) == ("cloth 3 m", 9.0, 2)
    assert (small.name, small.area_m2, small.mask.sum()) == ("cloth 0.5 m", 0.25, 1)
    with pytest.raises(InputError, match="size class 4"):
        intersected_objects({"cloth": cloth}, sizes, {4: 1.0})
    with pytest.raises(InputError, match="differ in shape"):
        intersected_objects({"cloth": cloth[:5]}, sizes, {1: 1.0})


@pytest.mark.parametrize(("row", "col", "doubt"), [(0.5, 0.5, 3.0), (19.5, 29.5, 2.5), (10.2, 15.7, 1.0), (3, 3, 90)])
def test_a_widened_mask_in_a_window_is_that_in_the_whole_image(tmp_path, row, col, doubt):
    text = f"material,line,sample,side_m,position_uncertainty_m\na,{row},{col},0.6,{{}}\n"
    sure, unsure = (targets(tmp_path, text.format(value))[0] for value in ("", doubt))
    assert np.array_equal(unsure.mask, guard(sure.mask, doubt))


def test_a_round_target_has_the_area_of_its_circle(tmp_path):
    text = (
        "name,material,row0,col0,side_m,width_m,length_m,shape\nround,wood,10,10,8,,,circle\n"
        "square,wood,10,10,8,,,square\nlong,wood,10,10,,1,8,ellipse\n"
    )
    found = {t.name: t for t in targets(tmp_path, text)}
    assert found["round"].area_m2 == pytest.approx(16.0 * math.pi)
    assert found["long"].area_m2 == pytest.approx(2.0 * math.pi)
    assert math.isnan(found["round"].side_m)
    assert found["square"].side_m == 8.0
    # Of the square's pixels those are left that the circle reaches: nearest corner within 4 pixels.
    line, sample = np.indices(SHAPE)
    near = np.hypot(np.maximum(abs(line - 10) - 0.5, 0.0), np.maximum(abs(sample - 10) - 0.5, 0.0))
    assert np.array_equal(found["round"].mask, near < 4.0)
    assert found["round"].mask.sum() < found["square"].mask.sum()
    assert found["long"].mask.sum(axis=0).max() == 9


def test_a_list_as_a_spreadsheet_writes_it(tmp_path):
    (a,) = targets(tmp_path, 'name,material,row0,col0,side_m,"of x, y"\np,wood,5.5,0.5E+01,1.5\n')
    (b,) = targets(tmp_path, "\ufeffName;Material;Row0;Col0;Side_m;of x, y\r\np;wood;5,5;0,5E+01;1,5\r\n")
    assert np.array_equal(a.mask, b.mask)
    assert a.area_m2 == b.area_m2 == 2.25
    assert a.attributes == b.attributes


def test_a_drawn_object_has_the_area_of_its_pixels_where_that_is_said():
    mask = np.zeros((9, 9), bool)
    mask[1:3, 1:4], mask[6:8, 6:8] = True, True
    six, four = region_objects([Region("felt", mask, "")], "cloth", side_m="marked", pixel_area_m2=0.25)
    assert [(o.area_m2, o.attributes["pixels"]) for o in (six, four)] == [(pytest.approx(1.5), "6"), (1.0, "4")]
    assert four.attributes["side_m"] == "1"
    with pytest.raises(UsageError, match="pixel_size_m"):
        region_objects([Region("felt", mask, "")], "cloth", side_m="marked")


def test_a_small_target_lies_in_its_pixel_a_shifted_one_in_four_and_a_doubted_one_around(tmp_path):
    text = "material,line,sample,side_m,position_uncertainty_m\na,7.5,11.5,0.5,\nb,3.0,5.0,0.5,0\nc,7.5,11.5,0.5,2\n"
    inside, corner, unsure = targets(tmp_path, text)
    assert np.argwhere(inside.mask).tolist() == [[7, 11]]
    assert np.argwhere(corner.mask).tolist() == [[2, 4], [2, 5], [3, 4], [3, 5]]
    assert unsure.mask.sum() == 13  # lattice points within 2 pixels
    assert [inside.name, corner.name] == ["a 1", "b 2"]
