"""Target lists and objects from rasters."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from affine import Affine

from hyperval.errors import InputError, UsageError
from hyperval.imagery import Region, guard, intersected_objects, read_targets, region_objects

SHAPE = (20, 30)
TRANSFORM = Affine(2.0, 0, 1000.0, 0, -2.0, 5000.0)


def targets(tmp_path: Path, text: str, **options):
    path = tmp_path / "t.csv"
    path.write_text(text)
    return read_targets(path, SHAPE, **options)


@pytest.mark.parametrize(
    "place", ["row0,col0\n{},7,11", "row1,col1\n{},8,12", "line,sample\n{},7.5,11.5", "easting,northing\n{},1023,4985"]
)
def test_one_place_in_every_coordinate_system(tmp_path: Path, place: str):
    head, row = place.split("\n")
    text = f"material,{head},side_m,name\n{row.format('plank')},2.0,p1\n"
    (target,) = targets(tmp_path, text, transform=TRANSFORM)
    assert (target.name, target.material, target.side_m, target.area_m2) == ("p1", "plank", 2.0, 4.0)
    # 2 m is one pixel: the target fills pixel (7, 11) and at most touches its neighbours.
    assert target.mask[7, 11]
    assert not target.mask[:6].any()
    assert not target.mask[9:].any()


def test_heading_turns_a_long_target(tmp_path: Path):
    text = "material,line,sample,width_m,length_m,heading_deg\na,10.5,10.5,0.2,8,0\nb,10.5,10.5,0.2,8,90\n"
    north, east = targets(tmp_path, text, pixel_size_m=1.0)
    assert sorted(set(np.argwhere(north.mask)[:, 1])) == [10]
    assert sorted(set(np.argwhere(east.mask)[:, 0])) == [10]
    assert north.mask.sum() == east.mask.sum() == 9
    assert north.area_m2 == pytest.approx(1.6)
    assert np.isnan(north.side_m)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("material,side_m\na,1\n", "row0,col0"),
        ("row0,col0,side_m\n1,1,1\n", "expected: material"),
        ("material,row0,col0,side_m\na,1,x,1\n", "col0 is 'x'"),
        ("material,row0,col0,side_m\na,1,inf,1\n", "col0 is 'inf'"),
        ("material,row0,col0,side_m\na,1,,1\n", "no row0, col0"),
        ("material,row0,col0,side_m\na,1,1,0\n", "no size"),
        ("material,row0,col0,side_m\na,1,1,\n", "no size"),
        ("material,row0,col0,side_m\na,25,1,1\n", "leaves the image"),
        ("material,name,row0,col0,side_m\na,p,1,1,1\na,p,2,2,1\n", "stands twice"),
        ("material,row0,col0,side_m\n", "holds no target"),
        ("material,row0,col0,side_m,shape\na,5,5,1,star\n", "t.csv:2: shape is 'star'"),
        ("material,row0,col0,width_m,length_m,shape\na,5,5,1,2,circle\n", "a circle of 1 m by 2 m"),
        ("material,row0,col0,side_m,area_m2\na,5,5,1,-4\n", "area_m2 is -4"),
        ("material,row0,col0,side_m,position_uncertainty_m\na,5,5,1,-2\n", "position_uncertainty_m is -2"),
    ],
)
def test_bad_lists(tmp_path: Path, text: str, message: str):
    with pytest.raises(InputError, match=message):
        targets(tmp_path, text, pixel_size_m=1.0)
    with pytest.raises(UsageError, match="pixel_size_m"):
        targets(tmp_path, "material,row0,col0,side_m\na,1,1,1\n")


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
def test_a_widened_mask_in_a_window_is_that_in_the_whole_image(tmp_path: Path, row, col, doubt):
    text = f"material,line,sample,side_m,position_uncertainty_m\na,{row},{col},0.6,{{}}\n"
    (sure,) = targets(tmp_path, text.format(""), pixel_size_m=1.0)
    (unsure,) = targets(tmp_path, text.format(doubt), pixel_size_m=1.0)
    assert np.array_equal(unsure.mask, guard(sure.mask, doubt))


def test_a_round_target_has_the_area_of_its_circle(tmp_path: Path):
    path = tmp_path / "t.csv"
    path.write_text(
        "name,material,row0,col0,side_m,width_m,length_m,shape\nround,wood,10,10,8,,,circle\n"
        "square,wood,10,10,8,,,square\nlong,wood,10,10,,1,8,ellipse\n"
    )
    found = {t.name: t for t in read_targets(path, (21, 21), pixel_size_m=1.0)}
    assert found["round"].area_m2 == pytest.approx(16.0 * math.pi)
    assert found["long"].area_m2 == pytest.approx(2.0 * math.pi)
    assert math.isnan(found["round"].side_m)
    assert found["square"].side_m == 8.0
    # Of the square's pixels those are left that the circle reaches: nearest corner within 4 pixels.
    line, sample = np.indices((21, 21))
    near = np.hypot(np.maximum(abs(line - 10) - 0.5, 0.0), np.maximum(abs(sample - 10) - 0.5, 0.0))
    assert np.array_equal(found["round"].mask, near < 4.0)
    assert found["round"].mask.sum() < found["square"].mask.sum()
    assert found["long"].mask.sum(axis=0).max() == 9


def test_a_list_as_a_spreadsheet_writes_it(tmp_path: Path):
    (tmp_path / "a.csv").write_text("name,material,row0,col0,side_m\np,wood,5.5,5,1.5\n")
    (tmp_path / "b.csv").write_bytes("\ufeffName;Material;Row0;Col0;Side_m\r\np;wood;5,5;5;1,5\r\n".encode())
    a, b = (read_targets(tmp_path / n, (10, 10), pixel_size_m=1.0)[0] for n in ("a.csv", "b.csv"))
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


def test_a_small_target_lies_in_its_pixel_a_shifted_one_in_four_and_a_doubted_one_around(tmp_path: Path):
    text = "material,line,sample,side_m,position_uncertainty_m\na,7.5,11.5,0.5,\nb,3.0,5.0,0.5,0\nc,7.5,11.5,0.5,2\n"
    inside, corner, unsure = targets(tmp_path, text, pixel_size_m=1.0)
    assert np.argwhere(inside.mask).tolist() == [[7, 11]]
    assert np.argwhere(corner.mask).tolist() == [[2, 4], [2, 5], [3, 4], [3, 5]]
    assert unsure.mask.sum() == 13  # lattice points within 2 pixels
    assert [inside.name, corner.name] == ["a 1", "b 2"]
