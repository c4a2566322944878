"""Regions: the same region from every format, the pixel-centre rule, and what is refused."""

import gzip
import json
import struct
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.crs import CRS
from rasterio.warp import transform as reproject
from scipy import ndimage
from small_files import (
    HOLE,
    PLACED,
    SHAPE,
    SQUARE,
    TRANSFORM,
    UTM18,
    expected,
    geojson,
    on_map,
    polygon,
    polygon_wkb,
    roi_ascii,
    roi_binary,
    table,
    wkb,
    write_raster,
    write_vector,
    written,
    xml,
)

from hyperval.errors import HypervalError, InputError, UsageError
from hyperval.imagery import guard, holes, polygon_mask, read_regions, write_cube

KINDS = (
    "geojson-pixel geojson-map geojson-lonlat geojson-points xml-pixel xml-map txt txt-map txt-system txt-bands gz "
    "csv-0 csv-1 csv-semicolon roi-points roi-polygon img tif gpkg-map gpkg-lonlat gpkg-pixel shp-map shp-lonlat "
    "shp-pixel kml"
)


@pytest.mark.parametrize("kind", KINDS.split())
def test_every_format_gives_the_same_region(tmp_path, kind):
    path, options = written(tmp_path, kind)
    regions = read_regions(path, SHAPE, **options)
    assert list(regions) == ["grass"]
    assert np.array_equal(regions["grass"].mask, expected())
    assert (regions["grass"].n, regions["grass"].source) == (20, str(path))
    if kind == "geojson-lonlat":  # as GeoJSON is without being asked
        options.pop("coordinates")
        assert np.array_equal(read_regions(path, SHAPE, **options)["grass"].mask, expected())


@given(st.lists(st.tuples(st.floats(0, 12, width=16), st.floats(0, 10, width=16)), min_size=3, max_size=3, unique=True))
@settings(max_examples=100)
def test_triangles_hold_the_centres_on_the_inner_side_of_their_edges(points):
    x, y = np.meshgrid(np.arange(12) + 0.5, np.arange(10) + 0.5)
    sides = []
    for (x0, y0), (x1, y1) in zip(points, [*points[1:], points[0]], strict=True):
        length = np.hypot(x1 - x0, y1 - y0)
        sides.append(((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)) / length)  # signed distance of every centre
    # Centres closer than 1e-6 to an edge may fall either way.
    low, high = np.min(sides, axis=0), np.max(sides, axis=0)
    inside, outside = (low > 1e-6) | (high < -1e-6), (low < -1e-6) & (high > 1e-6)
    try:
        mask = polygon_mask(points, SHAPE, where="t")
    except InputError:
        mask = np.zeros(SHAPE, bool)
    assert np.all(mask[inside])
    assert not np.any(mask[outside])


def test_holes_and_united_features(tmp_path):
    mask = expected(hole=True)
    with pytest.raises(InputError, match=r"samples 2.00 to 13.00.*\n.*samples 0 to 12, lines 0 to 10"):
        polygon_mask([(2, 3), (13, 3), (13, 8)], SHAPE, where="h")
    (tmp_path / "h.xml").write_text(xml(SQUARE, HOLE))
    assert np.array_equal(read_regions(tmp_path / "h.xml", SHAPE)["grass"].mask, mask)
    point = {"type": "Point", "coordinates": [0.2, 9.9]}
    (tmp_path / "h.geojson").write_text(geojson(polygon(SQUARE, HOLE), point, names=("a", "a")))
    mask[9, 0] = True
    assert np.array_equal(read_regions(tmp_path / "h.geojson", SHAPE, coordinates="pixel")["a"].mask, mask)


@pytest.mark.parametrize("case", table("refused")["regions"], ids=str)
def test_regions_that_are_refused(tmp_path, case):
    options = {"coordinates": "pixel"} | case.get("options", {})
    if "square" in case:
        path, given = written(tmp_path, f"geojson-{case['square']}")
        options = PLACED | given | options
    elif "system" in case:
        fields = {"name": ["grass"]}
        path = write_vector(tmp_path / "c.shp", [polygon_wkb(on_map(SQUARE))], crs=case["system"], fields=fields)
        options = PLACED | options
    elif "text" in case:
        (path := tmp_path / case["name"]).write_text(case["text"])
    elif "polygon" in case:
        path, options = tmp_path / "r.geojson", PLACED | options
        path.write_text(geojson(polygon(case["polygon"]), names=("r0",)))
    else:
        kind = "ascii" if "ascii" in case else "xml"
        path = tmp_path / "a.txt"
        text = roi_ascii(np.ones(SHAPE, bool)) if kind == "ascii" else xml(SQUARE)
        path.write_bytes(text.replace(*case[kind]).encode())
    with pytest.raises(HypervalError, match=case["says"]) as caught:
        read_regions(path, SHAPE, **options)
    assert caught.value.exit_code == case.get("exit", 3)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "error", "message"),
    [
        ("a.xml", b"<RegionsOfInterest>" + b" " * (8 << 20), InputError, "larger than 8 MiB"),
        # 40 MB of blanks in 40 kB: read no further than the limit
        ("a.txt", gzip.compress(b"; ENVI Output of ROIs (4.8)\n" + b" " * (40 << 20)), InputError, "than 32 MiB"),
        ("a.csv", b'line,sample\n1,"' + b"9" * 200_000 + b'"\n', InputError, "not a CSV file"),
        ("a.json", b"{" + b'"a":[' * 100_000, InputError, "damaged"),
        ("b.roi", roi_binary(points=[1], size=(11, 10)), InputError, "made for 10 lines x 11 samples"),
        *(("b.roi", roi_binary(points=range(20))[:cut], InputError, "b.roi") for cut in (4, 8, 20, 100, 200, 210)),
        ("b.roi", b"\x01\x02\x03", UsageError, "format of the region file"),
        ("b.gpkg", b"SQLite format 3\0" + b"\x01" * 50, InputError, "damaged|no region"),
        ("b.gpkg", b"\x00\x00\x27\x0a" + bytes(96) + b"\x01" * 50, InputError, "damaged|no region"),
    ],
)
def test_damaged_and_too_large_files_are_one_clear_error(tmp_path, name, content, error, message):
    if name.endswith("gpkg"):
        pytest.importorskip("pyogrio", reason="the extra 'vector' (pyogrio) is not installed")
    (tmp_path / name).write_bytes(content)
    with pytest.raises(error, match=message):
        read_regions(tmp_path / name, SHAPE)


@given(st.binary(max_size=200), st.sampled_from(["", "<", "{", "JoeB", "; ENVI Output of ROIs\n", "line,sample\n"]))
@settings(max_examples=150)
def test_any_bytes_give_regions_or_a_clear_error(tmp_path_factory, data, head):
    path = tmp_path_factory.mktemp("fuzz") / "f.csv"
    path.write_bytes(head.encode() + data)
    try:
        found = read_regions(path, SHAPE, coordinates="pixel")
    except HypervalError:  # anything else fails the test
        found = {}
    assert all(r.mask.shape == SHAPE for r in found.values())


@pytest.mark.parametrize(("radius", "pixels"), [(0, 1), (0.9, 1), (1, 5), (1.5, 9), (2, 13)])
def test_guard_is_a_disc(radius, pixels):
    mask = np.zeros(SHAPE, bool)
    mask[5, 5] = True
    assert guard(mask, radius).sum() == pixels  # lattice points of a circle: 1, 5, 9, 13
    assert np.array_equal(guard(mask, 1), ndimage.binary_dilation(mask))
    assert not guard(np.zeros(SHAPE, bool), 3).any()
    with pytest.raises(UsageError):
        guard(mask, float("nan"))


def test_holes_are_those_of_another_package():
    rng = np.random.default_rng(4)
    for _ in range(40):
        mask = rng.random((15, 20)) < 0.7
        empty = ndimage.binary_fill_holes(mask) & ~mask  # holes of 4 neighbours
        assert holes(mask) == (ndimage.label(empty)[1], int(empty.sum()))
    assert holes(np.zeros((3, 3), bool)) == holes(np.ones((3, 3), bool)) == (0, 0)


@pytest.mark.parametrize("fill", [255.0, -9999.0, np.nan])
@pytest.mark.parametrize("count", [1, 2])
def test_what_a_mask_marks_as_no_data_is_no_region(tmp_path, fill, count):
    bands = np.repeat(expected()[None].astype("f4"), count, axis=0)
    bands[:, 0] = fill
    stored = bands.astype("u1") if fill == 255.0 else bands
    found = read_regions(write_raster(tmp_path / "m.tif", stored, transform=TRANSFORM, nodata=fill), SHAPE)
    assert list(found) == (["m"] if count == 1 else ["band-1", "band-2"])
    assert all(np.array_equal(region.mask, expected()) for region in found.values())
    place = {"transform": TRANSFORM @ TRANSFORM.translation(0, 5), "crs": UTM18}
    names = {"extra": {"classes": "2", "class names": "{none, grass, dry}"}}
    for values, message, options in ((np.arange(240.0).reshape(10, 12, 2), "2 bands without names, of several", {}),
        (np.ones((9, 12, 1)), "9 lines and 12(?s:.*)--like", {}), (np.full((10, 12, 1), 1.5), "not class num", {}),
        (np.ones((10, 12, 1)), "5 pixels off the image", place), (np.ones((10, 12, 1)), "3 class names for 2", names),
    ):  # fmt: skip
        with pytest.raises(InputError, match=message):
            read_regions(write_cube(tmp_path / "c.img", values, **options), SHAPE, **PLACED)


@pytest.mark.parametrize("zone", [32617, 32618, 4326])
def test_a_geojson_that_states_its_system_needs_no_other_word(tmp_path, zone):
    x, y = zip(*on_map(SQUARE), strict=True)
    data = json.loads(geojson(polygon(list(zip(*reproject(UTM18, CRS.from_epsg(zone), x, y), strict=True)))))
    data["crs"] = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{zone}"}}
    if zone == 4326:  # longitude first, as GeoJSON has it
        data["crs"]["properties"]["name"] = "urn:ogc:def:crs:OGC:1.3:CRS84"
    (tmp_path / "r.geojson").write_text(json.dumps(data))
    assert np.array_equal(read_regions(tmp_path / "r.geojson", SHAPE, **PLACED)["grass"].mask, expected())
    if zone != 4326:
        with pytest.raises(InputError, match="not in longitude and latitude"):
            read_regions(tmp_path / "r.geojson", SHAPE, coordinates="lonlat", **PLACED)
    (tmp_path / "r.geojson").write_text('{"type": "Point", "coordinates": [1, 2], "crs": 7}')  # states none
    assert read_regions(tmp_path / "r.geojson", SHAPE, coordinates="pixel")["r"].n == 1


def test_only_the_wanted_regions_must_lie_in_the_image(tmp_path):
    away = [(x + 100.0, y) for x, y in SQUARE]
    (tmp_path / "r.geojson").write_text(geojson(polygon(SQUARE), polygon(away), names=("grass [1]", "road")))
    for patterns in (["grass [1]"], ["gr*"]):
        found = read_regions(tmp_path / "r.geojson", SHAPE, patterns=patterns, coordinates="pixel")
        assert list(found) == ["grass [1]"]
    for patterns in ([], ["road"], ["sea"]):
        with pytest.raises(InputError, match="leaves the image"):
            read_regions(tmp_path / "r.geojson", SHAPE, patterns=patterns, coordinates="pixel")


@pytest.mark.parametrize(
    ("points", "pixels", "note"),
    [
        ([(8, 2), (16, 2), (16, 6), (8, 6)], 16, "warning: the region 'r' leaves the image: 50.0 % of its area is"),
        ([(0, 0), (12.06, 0), (12.06, 10), (0, 10)], 120, "the region 'r' leaves the image: 0.5 % of its area is"),
        ([(0, 0), (12 + 1e-8, 0), (12, 10), (0, 10)], 120, None),
        ([(-5, -5), (50, -5), (50, 50), (-5, 50)], 120, "warning: the region 'r' leaves the image: 96.0 %"),
        ([(2, 3), (6, 8), (6, 3), (2, 8)], 8, None),  # a bow tie: odd and even
        ([(2.4, 0), (5.6, 0), (5.6, 1), (2.4, 1)], 4, None),  # centres 2.5 to 5.5
        ([(2.6, 0), (5.4, 0), (5.4, 1), (2.6, 1)], 2, None),  # centres 3.5 and 4.5
    ],
)
def test_a_polygon_holds_centres_and_what_leaves_the_image_is_counted(tmp_path, points, pixels, note):
    (tmp_path / "r.geojson").write_text(geojson(polygon(points), names=("r",), plot="west"))
    region = read_regions(tmp_path / "r.geojson", SHAPE, coordinates="pixel")["r"]
    assert region.n == pixels
    assert [remark[: len(note or "")] for remark in region.remarks] == ([] if note is None else [note])
    assert list(read_regions(tmp_path / "r.geojson", SHAPE, coordinates="pixel", name_field="Plot")) == ["west"]


@pytest.mark.parametrize(
    ("count", "remark"), [(20, None), (24, "the region 'grass' has 24 pixels as its file says; 20 h")]
)
def test_what_a_file_states_beside_its_pixels(tmp_path, count, remark):
    (tmp_path / "b.roi").write_bytes(roi_binary(polygons=[SQUARE], count=count))
    region = read_regions(tmp_path / "b.roi", SHAPE)["grass"]
    assert region.n == 20
    assert [r[: len(remark or "")] for r in region.remarks] == ([remark] if remark else [])


# GeoPackage and Shapefile -----------------------------------------------------------------------


def test_every_layer_is_read_and_names_the_region(tmp_path):
    path = write_vector(tmp_path / "l.gpkg", [polygon_wkb(on_map(SQUARE))], layer="grass")
    write_vector(path, [polygon_wkb(on_map(HOLE))], layer="panel", append=True)
    regions = read_regions(path, SHAPE, **PLACED)
    assert {name: r.n for name, r in regions.items()} == {"grass": 20, "panel": 4}


def test_which_attribute_names_the_regions_is_asked_where_none_is_known(tmp_path):
    shapes = [polygon_wkb(on_map(SQUARE)), polygon_wkb(on_map(HOLE))]
    path = write_vector(tmp_path / "r.gpkg", shapes, fields={"plot": ["lawn", "panel"], "number": [3, 4]})
    with pytest.raises(UsageError, match=r"(?s)no attribute that names the regions.*plot, number.*name_field"):
        read_regions(path, SHAPE, **PLACED)
    found = read_regions(path, SHAPE, name_field="Plot", **PLACED)
    assert {n: r.n for n, r in found.items()} == {"lawn": 20, "panel": 4}


@pytest.mark.parametrize("head", [b"SQLite format 3\0", b"\x00\x00\x27\x0a"])
def test_without_the_package_the_message_says_how_to_get_it(tmp_path, monkeypatch, head):
    monkeypatch.setitem(sys.modules, "pyogrio", None)
    (tmp_path / "r.bin").write_bytes(head + bytes(100))
    with pytest.raises(UsageError, match=r"pip install '?hyperval\[vector\]"):
        read_regions(tmp_path / "r.bin", SHAPE)


@pytest.mark.parametrize("end", ["gpkg", "shp"])
def test_parts_and_holes_are_kept_and_lines_have_no_area(tmp_path, end):
    small = [(8.0, 1.0), (10.0, 1.0), (10.0, 2.0), (8.0, 2.0)]
    whole = wkb(6, polygon_wkb(on_map(SQUARE), on_map(HOLE)), polygon_wkb(on_map(small)))
    path = write_vector(tmp_path / f"r[1].{end}", [whole], kind="MultiPolygon", fields={"name": ["grass"]})
    want = expected(hole=True)
    want[1, 8:10] = True
    assert np.array_equal(read_regions(path, SHAPE, **PLACED)["grass"].mask, want)
    line = struct.pack("<BII4d", 1, 2, 2, *on_map([(1, 1)])[0], *on_map([(4, 4)])[0])
    path = write_vector(tmp_path / f"l.{end}", [line], kind="LineString", fields={"name": ["road"]})
    with pytest.raises(InputError, match="geometry 'LineString'"):
        read_regions(path, SHAPE, **PLACED)
    points = [struct.pack("<BI2d", 1, 1, *p) for p in on_map([(0.5, 0.5), (1.5, 0.5), (7.9, 9.9)])]
    path = write_vector(tmp_path / f"p.{end}", points, kind="Point", fields={"Material": ["a", "a", "b"]})
    found = {name: np.argwhere(r.mask).tolist() for name, r in read_regions(path, SHAPE, **PLACED).items()}
    assert found == {"a": [[0, 0], [0, 1]], "b": [[9, 7]]}
    if end == "shp":
        path.with_suffix(".dbf").unlink()
        with pytest.raises(InputError, match=r"the \.dbf file of the Shapefile is missing"):
            read_regions(path, SHAPE, **PLACED)


def test_an_entity_in_a_kml_is_refused(tmp_path):
    path, options = written(tmp_path, "kml")
    path.write_text(path.read_text().replace("<kml", '<!DOCTYPE x [<!ENTITY a "b">]>\n<kml'), "utf-16")
    with pytest.raises(InputError, match="DOCTYPE or ENTITY"):
        read_regions(path, SHAPE, **options)
