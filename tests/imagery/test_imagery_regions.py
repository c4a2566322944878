"""Regions: the same region from every format, the pixel-centre rule, and what is refused."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.crs import CRS
from rasterio.warp import transform as reproject
from region_files import (
    SHAPE,
    SQUARE,
    TRANSFORM,
    UTM18,
    collection,
    expected,
    feature,
    on_map,
    polygon,
    ring,
    roi_ascii,
    roi_binary,
    written,
    xml,
)  # fmt: skip
from scipy import ndimage

from hyperval.errors import HypervalError, InputError, UsageError
from hyperval.imagery import Region, guard, holes, polygon_mask, read_regions, write_cube

KINDS = (
    "geojson-pixel geojson-map geojson-lonlat geojson-points xml-pixel xml-map txt gz csv-0 csv-1 csv-semicolon "
    "roi-points roi-polygon img tif gpkg-map gpkg-lonlat gpkg-pixel shp-map shp-lonlat shp-pixel kml"
)


@pytest.mark.parametrize("kind", KINDS.split())
def test_every_format_gives_the_same_region(tmp_path: Path, kind: str):
    path, options = written(tmp_path, kind)
    regions = read_regions(path, SHAPE, **options)
    assert list(regions) == ["grass"]
    assert np.array_equal(regions["grass"].mask, expected())
    assert regions["grass"].n == 20
    assert regions["grass"].source == str(path)


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


def test_holes_and_united_features(tmp_path: Path):
    hole = [(3.0, 4.0), (5.0, 4.0), (5.0, 6.0), (3.0, 6.0)]
    mask = expected()
    mask[4:6, 3:5] = False
    assert np.array_equal(polygon_mask(SQUARE, SHAPE, [hole], where="h"), mask)
    path = tmp_path / "h.xml"
    path.write_text(xml(f"<Polygon>{ring(SQUARE)}{ring(hole, 'Interior')}</Polygon>"))
    assert np.array_equal(read_regions(path, SHAPE)["grass"].mask, mask)
    path = tmp_path / "h.geojson"
    geometry = {"type": "Polygon", "coordinates": [[*SQUARE, SQUARE[0]], [*hole, hole[0]]]}
    point = {"type": "Point", "coordinates": [0.2, 9.9]}
    path.write_text(collection(feature(geometry, name="a"), feature(point, name="a")))
    mask[9, 0] = True
    assert np.array_equal(read_regions(path, SHAPE, coordinates="pixel")["a"].mask, mask)


def test_names_select_and_rename(tmp_path: Path):
    path = tmp_path / "two.csv"
    path.write_text("region,line,sample\na,1,1\nb,2,2\n")
    assert list(read_regions(path, SHAPE, names=["b"])) == ["b"]
    assert list(read_regions(path, SHAPE, names={"a": "grass"})) == ["grass"]
    with pytest.raises(UsageError, match="no region 'c'"):
        read_regions(path, SHAPE, names=["c"])
    with pytest.raises(UsageError, match="same name"):
        read_regions(path, SHAPE, names={"a": "x", "b": "x"})


# What is refused --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([(2, 3), (13, 3), (13, 8)], r"samples 2.00 to 13.00.*\n.*samples 0 to 12, lines 0 to 10"),
        ([(-1, 3), (6, 3), (6, 8)], "leaves the image"),
        ([(1, 1), (2, 2)], "2 different vertices"),
        ([(1, 1), (2, 2), (1, 1)], "2 different vertices"),
        ([(1, 1), (float("nan"), 2), (3, 3)], "not finite"),
        ([(1.6, 1.6), (1.9, 1.6), (1.9, 1.9)], "holds no pixel"),
    ],
)
def test_bad_polygons(points, message: str):
    with pytest.raises(InputError, match=message):
        Region("p", polygon_mask(points, SHAPE, where="p"), "inline")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.txt", roi_ascii(np.ones(SHAPE, bool), dimension="10 x 12"), "12 lines x 10 samples"),
        ("a.txt", roi_ascii(np.ones(SHAPE, bool)).rsplit("\r\n", 1)[0], "119 follow"),
        ("a.txt", roi_ascii(np.ones(SHAPE, bool)).replace("120 12 10", "120 13 10"), "sample 12"),
        ("a.txt", roi_ascii(np.ones(SHAPE, bool)).replace("120 12 10", "120 0 10"), "sample -1"),
        ("a.txt", roi_ascii(np.ones(SHAPE, bool)).replace("120 12 10", "120 x 10"), "not a whole number"),
        ("a.txt", "; ENVI Output of ROIs (4.8)\n; Number of ROIs: 0\n", "no 'File Dimension'"),
        ("a.xml", '<!DOCTYPE a [<!ENTITY b "c">]>' + xml(""), "DOCTYPE"),
        ("a.xml", xml("<Polygon>"), "not valid XML"),
        ("a.xml", "<rois></rois>", "RegionsOfInterest"),
        ("a.xml", xml("<LineString/>"), "has no area"),
        ("a.xml", xml("<Polygon></Polygon>"), "0 exterior rings"),
        ("a.xml", xml(f"<Polygon>{ring(SQUARE)}</Polygon>").replace("2 3 6", "2 3 6 6"), "pairs x y"),
        ("a.xml", xml(f"<Polygon>{ring(SQUARE)}</Polygon>", "NONSENSE[]"), "unknown coordinate system"),
        ("a.xml", xml(f"<Polygon>{ring(SQUARE)}</Polygon>", UTM18.to_wkt()), "coordinate system of the cube"),
        ("a.xml", xml(""), "holds no pixel"),
        ("a.xml", "<RegionsOfInterest><Region><ThresholdDef/></Region></RegionsOfInterest>", "a threshold is not eval"),
        ("a.xml", "<RegionsOfInterest>" + " " * (8 << 20), "larger than 8 MiB"),
        (
            "a.txt",
            roi_ascii(np.ones(SHAPE, bool)).replace("ID    X    Y", "ID   MapX   MapY"),
            "no pixel numbers among",
        ),
        ("a.csv", "row0,col0\n1," + "9" * 30, "a.csv:2: no whole numbers"),
        ("a.csv", "row0,col0\n1,1_0", "no whole numbers"),
        ("a.csv", "x,y\n1,2\n", "row0,col0"),
        ("a.csv", "line,sample\n1,2.5\n", "no whole numbers"),
        ("a.csv", "line,sample\n1\n", "no whole numbers"),
        ("a.csv", "line,sample\n1,2,3\n", "3 cells for 2 columns"),
        ("a.csv", "line,line\n1,2\n", "same name"),
        ("a.csv", "line,sample\n", "no region"),
        ("a.csv", "line,sample\n10,0\n", "outside the image"),
        ("a.csv", 'line,sample\n1,"' + "9" * 200_000 + '"\n', "not a CSV file"),
    ],
)
def test_bad_files(tmp_path: Path, name: str, text: str, message: str):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_regions(path, SHAPE)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not valid GeoJSON"),
        ('{"type": "Feature"}', "without geometry"),
        ('{"type": 5}', "geometry 5"),
        ('{"type": "FeatureCollection", "features": 3}', "not a GeoJSON object"),
        ('{"type": "Point", "type": "Point", "coordinates": [1, 2]}', "stands twice"),
        ('{"type": "Point", "coordinates": [NaN, 2]}', "no JSON number"),
        ('{"type": "Point", "coordinates": "ab"}', "not pairs of numbers"),
        ('{"type": "Point", "coordinates": [1]}', "not pairs of numbers"),
        ('{"type": "LineString", "coordinates": [[1, 2], [3, 4]]}', "LineString"),
        ('{"type": "Polygon", "coordinates": []}', "without vertices"),
        ('{"type": "MultiPolygon", "coordinates": 7}', "without vertices"),
        ('{"type": "Point", "coordinates": [1, 2], "crs": 7}', None),
        ("{" + '"a":[' * 100_000, "not valid GeoJSON"),
    ],
)
def test_bad_geojson(tmp_path: Path, text: str, message: str | None):
    path = tmp_path / "g.geojson"
    path.write_text(text)
    if message is None:
        assert read_regions(path, SHAPE, coordinates="pixel")["g"].n == 1
        return
    with pytest.raises(InputError, match=message):
        read_regions(path, SHAPE, coordinates="pixel")


def test_geojson_is_longitude_and_latitude_without_being_asked(tmp_path: Path):
    path, options = written(tmp_path, "geojson-lonlat")
    stated = read_regions(path, SHAPE, **options)
    options.pop("coordinates")
    unasked = read_regions(path, SHAPE, **options)
    assert {n: r.mask.tolist() for n, r in unasked.items()} == {n: r.mask.tolist() for n, r in stated.items()}
    path, options = written(tmp_path, "geojson-map")
    with pytest.raises(UsageError, match=r"(?s)no longitude and latitude.*state coordinates: pixel or map"):
        read_regions(path, SHAPE, **{**options, "coordinates": None})


@given(st.binary(max_size=200), st.sampled_from(["", "<", "{", "JoeB", "; ENVI Output of ROIs\n", "line,sample\n"]))
@settings(max_examples=150)
def test_any_bytes_give_regions_or_a_clear_error(tmp_path_factory, data: bytes, head: str):
    path = tmp_path_factory.mktemp("fuzz") / "f.csv"
    path.write_bytes(head.encode() + data)
    try:
        found = read_regions(path, SHAPE, coordinates="pixel")
    except HypervalError:  # anything else fails the test
        found = {}
    assert all(r.mask.shape == SHAPE for r in found.values())


# Sets -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("radius", "pixels"), [(0, 1), (0.9, 1), (1, 5), (1.5, 9), (2, 13)])
def test_guard_is_a_disc(radius: float, pixels: int):
    mask = np.zeros(SHAPE, bool)
    mask[5, 5] = True
    grown = guard(mask, radius)
    assert grown.sum() == pixels  # lattice points of a circle: 1, 5, 9, 13
    assert np.array_equal(guard(mask, 1), ndimage.binary_dilation(mask))
    assert not guard(np.zeros(SHAPE, bool), 3).any()
    with pytest.raises(UsageError):
        guard(mask, float("nan"))


def test_the_header_of_a_class_raster_must_lie_in_the_root(tmp_path: Path):
    inside = tmp_path / "root"
    inside.mkdir()
    write_cube(inside / "classes.img", np.ones((*SHAPE, 1), "u1"), data_type=1)
    (inside / "classes.hdr").rename(tmp_path / "classes.hdr")
    (inside / "classes.hdr").symlink_to(tmp_path / "classes.hdr")
    with pytest.raises(UsageError, match="outside the data root"):
        read_regions(inside / "classes.img", SHAPE, root=inside)
    assert read_regions(inside / "classes.img", SHAPE, root=tmp_path)["classes"].n == SHAPE[0] * SHAPE[1]


def raster(path: Path, bands: np.ndarray, **options) -> Path:
    with rasterio.open(
        path, "w", driver="GTiff", height=10, width=12, count=len(bands), dtype=bands.dtype, transform=TRANSFORM,
        **options,
    ) as out:  # fmt: skip
        out.write(bands)
    return path


@pytest.mark.parametrize("fill", [255.0, -9999.0, np.nan])
@pytest.mark.parametrize("count", [1, 2])
def test_what_a_mask_marks_as_no_data_is_no_region(tmp_path: Path, fill: float, count: int):
    bands = np.repeat(expected()[None].astype("f4"), count, axis=0)
    bands[:, 0] = fill
    if fill == 255.0:
        bands = bands.astype("u1")
    found = read_regions(raster(tmp_path / "m.tif", bands, nodata=fill), SHAPE)
    assert list(found) == (["m"] if count == 1 else ["band-1", "band-2"])
    assert all(np.array_equal(region.mask, expected()) for region in found.values())


@pytest.mark.parametrize("zone", [32617, 32618, 4326])
def test_a_geojson_that_states_its_system_needs_no_other_word(tmp_path: Path, zone: int):
    own = CRS.from_epsg(zone)
    x, y = zip(*on_map(SQUARE), strict=True)
    data = json.loads(collection(feature(polygon(list(zip(*reproject(UTM18, own, x, y), strict=True))), name="a")))
    data["crs"] = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{zone}"}}
    if zone == 4326:  # longitude first, as GeoJSON has it
        data["crs"]["properties"]["name"] = "urn:ogc:def:crs:OGC:1.3:CRS84"
    (tmp_path / "r.geojson").write_text(json.dumps(data))
    found = read_regions(tmp_path / "r.geojson", SHAPE, transform=TRANSFORM, crs=UTM18)
    assert np.array_equal(found["a"].mask, expected())
    if zone != 4326:
        with pytest.raises(InputError, match="not in longitude and latitude"):
            read_regions(tmp_path / "r.geojson", SHAPE, transform=TRANSFORM, crs=UTM18, coordinates="lonlat")


def test_only_the_wanted_regions_must_lie_in_the_image(tmp_path: Path):
    away = [(x + 100.0, y) for x, y in SQUARE]
    text = collection(feature(polygon(SQUARE), name="grass [1]"), feature(polygon(away), name="road"))
    (tmp_path / "r.geojson").write_text(text)
    options = {"coordinates": "pixel"}
    found = read_regions(tmp_path / "r.geojson", SHAPE, patterns=["grass [1]"], **options)
    assert list(found) == ["grass [1]"]
    assert list(read_regions(tmp_path / "r.geojson", SHAPE, patterns=["gr*"], **options)) == ["grass [1]"]
    for patterns in ([], ["road"], ["sea"]):
        with pytest.raises(InputError, match="leaves the image"):
            read_regions(tmp_path / "r.geojson", SHAPE, patterns=patterns, **options)


@pytest.mark.parametrize(
    ("columns", "rows"),
    [
        ("ID    X    Y      MapX      MapY    Lat    Lon   B1", "{n} {x} {y} 300001.5 4699999.5 42 -77 7"),
        ("ID X Y Map X Map Y", "{n} {x} {y} 300001.5 4699999.5"),
        ("X Y B1 B2", "{x} {y} 12.5 13"),
    ],
)  # fmt: skip
def test_an_ascii_export_with_other_columns(tmp_path: Path, columns: str, rows: str):
    lines = roi_ascii(expected()).replace("ID    X    Y", columns).split("\r\n")
    head = [line for line in lines if line.startswith(";")]
    body = [rows.format(n=n, x=x, y=y) for n, x, y in (line.split() for line in lines if not line.startswith(";"))]
    (tmp_path / "r.txt").write_text("\r\n".join([*head, *body]))
    assert np.array_equal(read_regions(tmp_path / "r.txt", SHAPE)["grass"].mask, expected())


@pytest.mark.parametrize(
    ("raw", "error", "message"),
    [
        (roi_binary("grass", points=[1], size=(11, 10)), InputError, "made for 10 lines x 11 samples"),
        *(
            (roi_binary("grass", points=list(range(20)))[:cut], InputError, "b.roi")
            for cut in (4, 8, 20, 100, 200, 210)
        ),
        (b"\x01\x02\x03", UsageError, "format of the region file"),
    ],
)
def test_binary_files_that_are_no_regions_of_this_image(tmp_path: Path, raw: bytes, error, message: str):
    (tmp_path / "b.roi").write_bytes(raw)
    with pytest.raises(error, match=message):
        read_regions(tmp_path / "b.roi", SHAPE)


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
def test_a_polygon_holds_centres_and_what_leaves_the_image_is_counted(tmp_path: Path, points, pixels, note):
    (tmp_path / "r.geojson").write_text(collection(feature(polygon(points), name="r", plot="west")))
    region = read_regions(tmp_path / "r.geojson", SHAPE, coordinates="pixel")["r"]
    assert region.n == pixels
    assert [remark[: len(note or "")] for remark in region.remarks] == ([] if note is None else [note])
    assert list(read_regions(tmp_path / "r.geojson", SHAPE, coordinates="pixel", name_field="Plot")) == ["west"]
    with pytest.raises(UsageError, match=r"(?s)no property 'site'.*one of name, plot"):
        read_regions(tmp_path / "r.geojson", SHAPE, coordinates="pixel", name_field="site")


@pytest.mark.parametrize(
    ("options", "points", "message"),
    [
        ({"coordinates": "map"}, [[-75.0, 42.0], [-74.9, 42.0], [-74.9, 42.1]], "longitude/latitude"),
        ({"coordinates": "lonlat"}, [[500.0, 500.0], [600.0, 500.0], [600.0, 600.0]], r"feature 1 \(a\).*cannot be pl"),
    ],
)
def test_places_that_cannot_be_are_one_clear_error(tmp_path: Path, options, points, message: str):
    (tmp_path / "r.geojson").write_text(collection(feature(polygon(points), name="a")))
    with pytest.raises(InputError, match=message):
        read_regions(tmp_path / "r.geojson", SHAPE, transform=TRANSFORM, crs=UTM18, **options)


def test_what_a_file_states_beside_its_pixels(tmp_path: Path):
    path = tmp_path / "b.roi"
    for count, remarks in (
        (20, []),
        (24, ["the region 'grass' has 24 pixels as its file says; 20 have their centre in"]),
    ):
        path.write_bytes(roi_binary("grass", polygons=[SQUARE], count=count))
        region = read_regions(path, SHAPE)["grass"]
        assert (region.n, [r[: len(remarks[0])] for r in region.remarks] if remarks else region.remarks) == (
            20,
            remarks,
        )
    path, _ = written(tmp_path, "geojson-pixel")
    for coordinates, error, message in (
        (None, UsageError, "coordinates: pixel, map"),
        ("map", InputError, "no position"),
    ):
        with pytest.raises(error, match=message):
            read_regions(path, SHAPE, coordinates=coordinates)
    path = tmp_path / "rois.txt"  # 40 MB of blanks in 40 kB: read no further than the limit
    path.write_bytes(gzip.compress(b"; ENVI Output of ROIs (4.8)\n" + b" " * (40 << 20)))
    with pytest.raises(InputError, match="larger than 32 MiB"):
        read_regions(path, SHAPE)
    for values, message in (
        (np.ones((9, 12, 1)), "9 lines and 12 samples"),
        (np.full((10, 12, 1), 1.5), "no class num"),
    ):
        with pytest.raises(InputError, match=message):
            read_regions(write_cube(tmp_path / "c.img", values), SHAPE)


def test_holes_are_those_of_another_package():
    rng = np.random.default_rng(4)
    for _ in range(40):
        mask = rng.random((15, 20)) < 0.7
        empty = ndimage.binary_fill_holes(mask) & ~mask  # holes of 4 neighbours
        assert holes(mask) == (ndimage.label(empty)[1], int(empty.sum()))
    assert holes(np.zeros((3, 3), bool)) == (0, 0)
    assert holes(np.ones((3, 3), bool)) == (0, 0)


@pytest.mark.parametrize("shift", [(20.0, 0.0), (0.0, -30.0), (3e5, 4.7e6), (1e300, 0.0)])
def test_nothing_left_inside_is_an_error(tmp_path, shift):
    points = [(8 + shift[0], 2 + shift[1]), (16 + 2 * shift[0], 2 + shift[1]), (16 + shift[0], 6 + shift[1])]
    (tmp_path / "r.geojson").write_text(collection(feature(polygon(points), name="r0")))
    with pytest.raises(InputError, match=r"r0.*leaves the image: samples .*\n.*expected: samples 0 to 12") as caught:
        read_regions(tmp_path / "r.geojson", SHAPE, coordinates="pixel")
    assert "pixel, map or longitude/latitude" in str(caught.value)
