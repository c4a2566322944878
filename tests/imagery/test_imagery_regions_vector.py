"""GeoPackage and Shapefile: the same region as from every other format, holes, several layers, what is refused."""

from __future__ import annotations

import struct
import sys

import numpy as np
import pytest
from region_files import PLACED, SHAPE, SQUARE, expected, on_map, polygon_wkb, write_vector, written

from hyperval.errors import InputError, UsageError
from hyperval.imagery import read_regions

HOLE = [(3.0, 4.0), (5.0, 4.0), (5.0, 6.0), (3.0, 6.0)]


def test_every_layer_is_read_and_names_the_region(tmp_path):
    path = write_vector(tmp_path / "l.gpkg", [polygon_wkb(on_map(SQUARE))], layer="grass")
    write_vector(path, [polygon_wkb(on_map(HOLE))], layer="panel", append=True)
    regions = read_regions(path, SHAPE, **PLACED)
    assert {name: r.n for name, r in regions.items()} == {"grass": 20, "panel": 4}


@pytest.mark.parametrize(
    ("crs", "stated", "error", "message"),
    [
        (None, None, UsageError, "states no coordinate system"),
        ("EPSG:32618", "pixel", InputError, "not in pixel coordinates"),
        ("EPSG:32617", "map", InputError, "the cube in"),
        ("EPSG:32618", "lonlat", InputError, "not in longitude and latitude"),
    ],
)
def test_coordinates_that_nobody_states_or_that_contradict(tmp_path, crs, stated, error, message):
    path = write_vector(tmp_path / "c.shp", [polygon_wkb(on_map(SQUARE))], ["grass"], crs=crs)
    with pytest.raises(error, match=message):
        read_regions(path, SHAPE, coordinates=stated, **PLACED)


def test_which_attribute_names_the_regions_is_asked_where_none_is_known(tmp_path):
    pyogrio = pytest.importorskip("pyogrio", reason="the extra 'vector' (pyogrio) is not installed")
    pyogrio.raw.write(
        tmp_path / "r.gpkg",
        np.array([polygon_wkb(on_map(SQUARE)), polygon_wkb(on_map(HOLE))], dtype=object),
        field_data=[np.array(["lawn", "panel"], dtype=object), np.array([3, 4])],
        fields=["plot", "number"],
        geometry_type="Polygon",
        crs="EPSG:32618",
    )
    with pytest.raises(UsageError, match=r"(?s)no attribute that names the regions.*plot, number.*name_field"):
        read_regions(tmp_path / "r.gpkg", SHAPE, **PLACED)
    assert {n: r.n for n, r in read_regions(tmp_path / "r.gpkg", SHAPE, name_field="Plot", **PLACED).items()} == {
        "lawn": 20,
        "panel": 4,
    }


def test_a_companion_outside_the_root_is_refused(tmp_path):
    inside = tmp_path / "root"
    inside.mkdir()
    path = write_vector(inside / "s.shp", [polygon_wkb(on_map(SQUARE))], ["grass"])
    path.with_suffix(".dbf").rename(tmp_path / "s.dbf")
    path.with_suffix(".dbf").symlink_to(tmp_path / "s.dbf")
    with pytest.raises(UsageError, match="outside the data root"):
        read_regions(path, SHAPE, root=inside, **PLACED)


@pytest.mark.parametrize("head", [b"SQLite format 3\0", b"\x00\x00\x27\x0a" + bytes(96)])
def test_a_broken_file_is_one_clear_error(tmp_path, head):
    pytest.importorskip("pyogrio", reason="the extra 'vector' (pyogrio) is not installed")
    path = tmp_path / "broken.gpkg"
    path.write_bytes(head + b"\x01" * 50)
    with pytest.raises(InputError, match=r"cannot be read|no region"):
        read_regions(path, SHAPE, **PLACED)


@pytest.mark.parametrize("head", [b"SQLite format 3\0", b"\x00\x00\x27\x0a"])
def test_without_the_package_the_message_says_how_to_get_it(tmp_path, monkeypatch, head):
    monkeypatch.setitem(sys.modules, "pyogrio", None)
    path = tmp_path / "r.bin"
    path.write_bytes(head + bytes(100))
    with pytest.raises(UsageError, match=r"pip install hyperval\[vector\]"):
        read_regions(path, SHAPE)


@pytest.mark.parametrize("end", ["gpkg", "shp"])
def test_parts_and_holes_are_kept_and_lines_have_no_area(tmp_path, end):
    def parts(kind: int, *members: bytes) -> bytes:
        return struct.pack("<BII", 1, kind, len(members)) + b"".join(members)

    small = [(8.0, 1.0), (10.0, 1.0), (10.0, 2.0), (8.0, 2.0)]
    whole = parts(6, polygon_wkb(on_map(SQUARE), on_map(HOLE)), polygon_wkb(on_map(small)))
    path = write_vector(tmp_path / f"r.{end}", [whole], ["grass"], kind="MultiPolygon")
    want = expected(hole=True)
    want[1, 8:10] = True
    assert np.array_equal(read_regions(path, SHAPE, **PLACED)["grass"].mask, want)
    line = struct.pack("<BII4d", 1, 2, 2, *on_map([(1, 1)])[0], *on_map([(4, 4)])[0])
    with pytest.raises(InputError, match="geometry 'LineString'"):
        read_regions(write_vector(tmp_path / f"l.{end}", [line], ["road"], kind="LineString"), SHAPE, **PLACED)
    points = [struct.pack("<BI2d", 1, 1, *p) for p in on_map([(0.5, 0.5), (1.5, 0.5), (7.9, 9.9)])]
    path = write_vector(tmp_path / f"p.{end}", points, ["a", "a", "b"], kind="Point")
    found = {name: np.argwhere(r.mask).tolist() for name, r in read_regions(path, SHAPE, **PLACED).items()}
    assert found == {"a": [[0, 0], [0, 1]], "b": [[9, 7]]}
    if end == "shp":
        path.with_suffix(".dbf").unlink()
        with pytest.raises(InputError, match=r"the \.dbf file of the Shapefile is missing"):
            read_regions(path, SHAPE, **PLACED)


def test_an_entity_in_a_kml_is_refused(tmp_path):
    path, options = written(tmp_path, "kml")
    path.write_text(path.read_text().replace("<kml", '<!DOCTYPE x [<!ENTITY a "b">]>\n<kml'))
    with pytest.raises(InputError, match="DOCTYPE or ENTITY"):
        read_regions(path, SHAPE, **options)
