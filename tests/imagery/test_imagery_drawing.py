"""Drawings that leave the image are cut off and counted; holes are found."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from hyperval.errors import InputError
from hyperval.imagery import RegionDrawing, area_inside, holes, polygon_mask, polygon_of, read_regions

SHAPE = (10, 12)
BORDER = 20  # pixels around the image in the larger one that the cut is compared with


def star(rng: np.random.Generator) -> np.ndarray:
    """A star-shaped polygon somewhere around the image."""
    angle = np.sort(rng.uniform(0, 2 * np.pi, 9))
    radius = rng.uniform(2.0, 12.0, 9)
    centre = rng.uniform((-2, -2), (14, 12))
    return centre + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def test_the_cut_is_that_of_a_larger_image():
    rng = np.random.default_rng(3)
    for _ in range(60):
        ring = star(rng)
        hole = ring.mean(axis=0) + 0.2 * (ring - ring.mean(axis=0))
        drawing = RegionDrawing(SHAPE)
        drawing.add_polygon(ring, [hole], where="t")
        larger = polygon_mask(ring + BORDER, (SHAPE[0] + 2 * BORDER, SHAPE[1] + 2 * BORDER), [hole + BORDER], where="t")
        part = larger[BORDER : BORDER + SHAPE[0], BORDER : BORDER + SHAPE[1]]
        assert np.array_equal(drawing.mask, part)
        # Areas by counting points of a grid 16 times finer; each of 9 sides of up to 30 pixels crosses at most
        # about 16 x 30 x 2 cells, whose errors of half a cell average out.
        fine = polygon_mask(16 * (ring + BORDER), tuple(16 * s for s in larger.shape), where="t")
        inside = fine[16 * BORDER : 16 * (BORDER + SHAPE[0]), 16 * BORDER : 16 * (BORDER + SHAPE[1])]
        assert polygon_of([ring]).area == pytest.approx(fine.sum() / 256, rel=0.01, abs=0.2)
        assert area_inside(polygon_of([ring]), SHAPE) == pytest.approx(inside.sum() / 256, rel=0.01, abs=0.2)


def test_areas_of_known_figures():
    square = np.array([(2.0, 3), (6, 3), (6, 8), (2, 8)])
    assert polygon_of([square]).area == polygon_of([square[::-1]]).area == 20.0
    assert area_inside(polygon_of([square - (4.0, 0.0)]), SHAPE) == 10.0
    assert area_inside(polygon_of([square * 100.0]), SHAPE) == 0.0
    around = np.array([(-5.0, -5), (50, -5), (50, 50), (-5, 50)])
    assert area_inside(polygon_of([around]), SHAPE) == 120.0
    # A bow tie is its two triangles, as the mask has it.
    assert polygon_of([square[[0, 2, 1, 3]]]).area == pytest.approx(10.0)


def test_what_is_said_of_a_polygon_that_leaves_the_image():
    drawing = RegionDrawing(SHAPE)
    drawing.add_polygon([(8, 2), (16, 2), (16, 6), (8, 6)], where="t")
    assert drawing.mask.sum() == 16
    assert drawing.notes() == ("warning: leaves the image: 50.0 % of its area is outside, 16 pixels are left",)
    drawing.add_polygon([(0, 0), (8, 0), (8, 4), (0, 4)], where="t")  # 16 of 64 pixels of both are outside
    assert drawing.notes() == ("warning: leaves the image: 25.0 % of its area is outside, 48 pixels are left",)
    little = RegionDrawing(SHAPE)
    little.add_polygon([(0, 0), (12.06, 0), (12.06, 10), (0, 10)], where="t")
    assert little.notes() == ("leaves the image: 0.5 % of its area is outside, 120 pixels are left",)
    inside = RegionDrawing(SHAPE)
    inside.add_polygon([(0, 0), (12 + 1e-8, 0), (12, 10), (0, 10)], where="t")
    assert inside.notes() == ()


def test_a_hole_that_leaves_the_image_with_its_polygon():
    drawing = RegionDrawing(SHAPE)
    drawing.add_polygon([(6, 0), (18, 0), (18, 10), (6, 10)], [[(10, 2), (14, 2), (14, 8), (10, 8)]], where="t")
    assert drawing.mask.sum() == 60 - 12
    # 120 - 24 in all, 60 - 12 inside.
    assert drawing.notes()[0].startswith("warning: leaves the image: 50.0 % of its area is outside, 48 pixels")


def test_points_outside_are_counted():
    drawing = RegionDrawing(SHAPE)
    drawing.add_points([(0.5, 0.5), (11.9, 9.9), (-3.0, 2.0)], where="t")
    assert drawing.mask.sum() == 2
    assert drawing.notes() == ("warning: leaves the image: 1 of 3 points are outside, 2 pixels are left",)


def geojson(tmp_path: Path, *rings) -> Path:
    features = [
        {
            "type": "Feature",
            "properties": {"name": f"r{i}"},
            "geometry": {"type": "Polygon", "coordinates": [[*ring, ring[0]]]},
        }
        for i, ring in enumerate(rings)
    ]
    path = tmp_path / "r.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def test_the_region_carries_what_was_found(tmp_path):
    path = geojson(tmp_path, [(8, 2), (16, 2), (16, 6), (8, 6)], [(1, 1), (3, 1), (3, 3), (1, 3)])
    regions = read_regions(path, SHAPE, coordinates="pixel")
    assert regions["r0"].remarks == [
        "warning: the region 'r0' leaves the image: 50.0 % of its area is outside, 16 pixels are left"
    ]
    assert regions["r1"].remarks == []


@pytest.mark.parametrize("shift", [(20.0, 0.0), (0.0, -30.0), (3e5, 4.7e6), (1e300, 0.0)])
def test_nothing_left_inside_is_an_error(tmp_path, shift):
    ring = [(8 + shift[0], 2 + shift[1]), (16 + 2 * shift[0], 2 + shift[1]), (16 + shift[0], 6 + shift[1])]
    with pytest.raises(InputError, match=r"r0.*leaves the image: samples .*\n.*expected: samples 0 to 12") as caught:
        read_regions(geojson(tmp_path, ring), SHAPE, coordinates="pixel")
    assert "pixel, map or longitude/latitude" in str(caught.value)


def test_holes_are_those_of_another_package():
    rng = np.random.default_rng(4)
    for _ in range(40):
        mask = rng.random((15, 20)) < 0.7
        empty = ndimage.binary_fill_holes(mask) & ~mask  # holes of 4 neighbours
        assert holes(mask) == (ndimage.label(empty)[1], int(empty.sum()))
    assert holes(np.zeros((3, 3), bool)) == (0, 0)
    assert holes(np.ones((3, 3), bool)) == (0, 0)
