"""Pixels placed by tables: lookup tables of a rolling flight line, IGM and location files, swath products."""

import json
from pathlib import Path

import numpy as np
import product_shells as shells
import pytest
from affine import Affine
from rasterio.crs import CRS
from rasterio.warp import transform as reproject
from scanned_line import LINES, SAMPLES, UTM18, ScannedLine, write_table
from small_files import polygon

from hyperval import imagery
from hyperval.errors import InputError

SHAPE = (LINES, SAMPLES)
RING = [(15.0, 30.0), (60.0, 25.0), (65.0, 190.0), (20.0, 200.0)]  # raw, near the edge of the line
DEGREES = Affine(1e-5, 0, -77.0, 0, -1e-5, 42.0)


@pytest.fixture
def line() -> ScannedLine:
    return ScannedLine()


@pytest.fixture
def table(tmp_path, line):
    return imagery.open_lookup_table(write_table(tmp_path / "glt.dat", *line.table()), SHAPE)


def some_places(n: int = 400) -> np.ndarray:
    rng = np.random.default_rng(2)
    return np.column_stack([rng.uniform(4, SAMPLES - 4, n), rng.uniform(4, LINES - 4, n)])


def regions_at(path: Path, points, shape, table, **options) -> np.ndarray:
    """The mask of a polygon on the map."""
    path.write_text(json.dumps(polygon([tuple(map(float, p)) for p in points])))
    (region,) = imagery.read_regions(path, shape, transform=table, crs=table.crs, **options).values()
    return region.mask


# Lookup tables ----------------------------------------------------------------------------------


def test_places_come_back_to_a_part_of_a_pixel_in_every_layout(tmp_path, line, table):
    places = some_places()
    found = table.to_pixel(line.on_map(*places.T), where="t")
    # A cell names a whole pixel (rounding of 0.29 in each coordinate); the fit averages 49 of them.
    assert np.sqrt(np.mean((found - places) ** 2)) < 0.12
    assert np.abs(found - places).max() < 0.5
    assert np.abs((found - places).mean(axis=0)).max() < 0.02  # no half-pixel shift
    stored, transform = line.table()
    layout = {"extra": {"band names": "{GLT Line, GLT Sample}", "byte order": "1"}, "interleave": "bsq"}
    swapped = imagery.open_lookup_table(write_table(tmp_path / "s.dat", stored[..., ::-1], transform, **layout), SHAPE)
    assert np.array_equal(swapped.to_pixel(line.on_map(*places.T), where="t"), found)


@pytest.mark.parametrize(("size", "cell"), [(1.0, 1.0), (2.0, 1.0), (1.0, 2.0)])
def test_the_area_of_a_raw_pixel_is_not_that_of_a_cell(tmp_path, size, cell):
    line = ScannedLine(size=size)
    table = imagery.open_lookup_table(write_table(tmp_path / "glt.dat", *line.table(cell)), SHAPE)
    assert table.pixel_area_m2 == pytest.approx(size**2, rel=0.03)
    places = some_places()
    error = table.to_pixel(line.on_map(*places.T), where="t") - places
    assert np.sqrt(np.mean(error**2)) < 0.35  # half a pixel of roll across the cells that are fitted, at most


def test_regions_drawn_on_the_map_fall_on_the_raw_pixels(tmp_path, line, table):
    ring = line.on_map(*np.array(RING).T)
    mask = regions_at(tmp_path / "r.geojson", ring, SHAPE, table, coordinates="map")
    # By another route: the pixels whose own centres lie in the polygon on the map.
    sample, row = np.meshgrid(np.arange(SAMPLES) + 0.5, np.arange(LINES) + 0.5)
    low, fine = ring.min(axis=0), 20  # of a metre, to decide whether a centre is in the polygon
    size = tuple(np.ceil(np.ptp(ring, axis=0)[::-1] * fine).astype(int))
    on_grid = imagery.polygon_mask((ring - low) * fine, size, where="t")
    at = np.floor((line.on_map(sample, row) - low) * fine).astype(int)
    held = (at >= 0).all(axis=-1) & (at[..., 0] < on_grid.shape[1]) & (at[..., 1] < on_grid.shape[0])
    expected = np.zeros(SHAPE, bool)
    expected[held] = on_grid[at[held][:, 1], at[held][:, 0]]
    differing = np.count_nonzero(mask ^ expected)
    border = 2 * (45 + 170)  # pixels along it; each may fall to either side where it lies within 0.1 pixel of it
    assert differing < 0.25 * border
    assert abs(mask.sum() - expected.sum()) < 0.03 * expected.sum()
    # Joining the four corners by straight lines in the raw image would be far off: the line rolls by 3 pixels.
    plain = imagery.polygon_mask(table.to_pixel(ring, where="t"), SHAPE, where="t")
    assert np.count_nonzero(plain ^ expected) > 2 * differing
    east, north = reproject(UTM18, CRS.from_epsg(4326), *ring.T.tolist())[:2]  # through the system of the table
    again = regions_at(tmp_path / "d.geojson", np.column_stack([east, north]), SHAPE, table, coordinates="lonlat")
    assert np.count_nonzero(mask ^ again) <= 2  # rounding of the projection


def test_targets_on_the_map_keep_size_and_heading(tmp_path, line, table):
    east, north = line.on_map(40.5, 100.5)
    row = "material,easting,northing,width_m,length_m,heading_deg\n"
    (tmp_path / "t.csv").write_text(row + f"plank,{east},{north},2,12,20\n")
    (target,) = imagery.read_targets(tmp_path / "t.csv", SHAPE, transform=table)
    assert target.centre_pixel == (100, 40)
    # The line flies at 20 degrees, as the plank lies: along the lines of the raw image, 12 long and 2 wide.
    rows, cols = np.nonzero(target.mask)
    assert 12 <= np.ptp(rows) + 1 <= 14
    assert np.ptp(cols) + 1 <= 6  # 2 wide, sheared by the roll: up to 3 x 2 pi / 60 x 12 = 3.8
    (tmp_path / "t.csv").write_text("material,row0,col0,side_m\nplank,100,40,2\n")
    (pixel,) = imagery.read_targets(tmp_path / "t.csv", SHAPE, transform=table)
    assert (pixel.mask.sum(), pixel.area_m2) == (9, 4.0)


def test_places_off_the_line_and_units_that_are_none(tmp_path, line, table):
    with pytest.raises(InputError, match=r"(?s)r: the place \(9, 9\) has no pixel.*belongs to this image"):
        table.to_pixel(np.array([(9.0, 9.0)]), where="r")
    with pytest.raises(InputError, match="not finite"):
        table.to_pixel(np.array([(np.nan, 9.0)]), where="r")
    path = write_table(tmp_path / "c.dat", line.table()[0], DEGREES, crs=CRS.from_epsg(4326))
    in_degrees = imagery.open_lookup_table(path, SHAPE)
    (tmp_path / "t.csv").write_text("material,easting,northing,side_m\nplank,-77,42,2\n")
    unknown = type(in_degrees)(in_degrees.raster, None)
    with pytest.raises(InputError, match="in no known unit of length"):
        imagery.read_targets(tmp_path / "t.csv", SHAPE, transform=unknown, pixel_size_m=1.0)
    cell = abs(DEGREES.determinant) * np.prod(in_degrees.metres_per_unit)  # a cell of the table is as large as a pixel
    assert in_degrees.pixel_area_m2 == pytest.approx(cell, rel=0.01)
    assert in_degrees.metres_per_unit[1] == pytest.approx(111e3, rel=0.01)


@pytest.mark.parametrize(
    ("change", "shape", "options", "message"),
    [
        (lambda s: s[..., :1], SHAPE, {}, "1 bands of int32"),
        (lambda s: s / 2, SHAPE, {"data_type": 4}, r"178 samples and 2 bands\n.*240 lines.*whole numbers"),
        (lambda s: s, SHAPE, {"transform": None}, "has no 'map info'"),
        (lambda s: s * 0, SHAPE, {}, "names no pixel"),
        (lambda s: s, (LINES, SAMPLES - 1), {}, r"goes to line 240, sample 80 .from 1.\n.*240 lines and 79 samples"),
        (lambda s: np.abs(s) * (1, -1), SHAPE, {}, "one of sample and line is 0 or negative"),
        (lambda s: s * (1, 0), SHAPE, {}, "one of sample and line is 0 or negative"),
    ],
)
def test_what_is_no_table_of_this_line(tmp_path, line, change, shape, options, message):
    stored, transform = line.table()
    made = change(stored)
    names = ", ".join(f"b{i}" for i in range(made.shape[2]))
    options = {"transform": transform, "extra": {"band names": f"{{{names}}}"}} | options
    path = write_table(tmp_path / "glt.dat", made, **options)
    with pytest.raises(InputError, match=message):
        imagery.open_lookup_table(path, shape)


# The place of every pixel -----------------------------------------------------------------------

BENT = (60, 40)


def ground(line: np.ndarray, sample: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Map coordinates of continuous pixel coordinates on a line that turns and bends."""
    east = 400_000.0 + 2.0 * sample + 0.4 * line + 1.5 * np.sin(line / 12.0)
    return east, 3_800_000.0 - 2.5 * line + 0.3 * sample


@pytest.fixture
def bent(tmp_path, axis) -> Path:
    """A cube with the places of its pixels beside it."""
    values = np.random.default_rng(2).uniform(1.0, 5.0, (*BENT, 4))
    line, sample = np.mgrid[0 : BENT[0], 0 : BENT[1]] + 0.5
    imagery.write_cube(tmp_path / "f01_rdn_igm", np.stack(ground(line, sample), axis=-1), data_type=5)
    return imagery.write_cube(tmp_path / "f01_rdn_v2n1_img", values, data_type=4, axis=axis)


def test_places_of_pixels_come_back_to_them(bent):
    table, notes = imagery.table_of(imagery.open_raster(bent))
    assert notes == ("f01_rdn_igm lies beside the cube and places its pixels",)
    rng = np.random.default_rng(4)
    want = np.column_stack([rng.uniform(0, BENT[1], 200), rng.uniform(0, BENT[0], 200)])
    found = table.to_pixel(np.column_stack(ground(want[:, 1], want[:, 0])), where="here")
    # The plane over 7 lines misses the bend by 1.5 (3/12)^2/2 m at most, 0.03 pixels.
    assert np.abs(found - want).max() < 0.05
    assert table.crs is None
    with pytest.raises(InputError, match="has no pixel in the image"):
        table.to_pixel(np.array([[400_000.0, 3_810_000.0]]), where="far")


@pytest.mark.parametrize(
    ("image", "table", "kind", "fits"),
    [
        ("ang20160217t083024_rdn_v1n2_img", "ang20160217t083024_rdn_glt", "glt", True),
        ("ang20160217t083024_rdn_v1n2_img", "ang20160217t083024_rdn_igm", "igm", True),
        ("f100826t01p00r05rdn_b_ort_img", "f100826t01p00r05rdn_b_ort_igm", "igm", True),
        ("ang20160217t083024_rdn_v1n2_img", "ang20160217t090000_rdn_glt", "glt", False),
        ("ang20160217t083024_rdn_v1n2_img", "ang20160217t083024_rdn_obs", "glt", False),
    ],
)
def test_which_file_belongs_to_a_cube(tmp_path, image, table, kind, fits):
    for name in (image, table):
        (tmp_path / name).write_bytes(b"x")
        (tmp_path / f"{name}.hdr").write_text("ENVI\n")
    assert imagery.companion_file(tmp_path / image, kind) == (tmp_path / table if fits else None)


def test_tables_of_another_size_or_without_places(tmp_path, bent, axis):
    imagery.write_cube(bent, np.ones((50, BENT[1], 4)), data_type=4, axis=axis)
    table, notes = imagery.table_of(imagery.open_raster(bent))
    assert table is None
    assert notes[0].startswith("warning: f01_rdn_igm lies beside the cube and is ignored: 60 lines")
    imagery.write_cube(tmp_path / "empty", np.zeros((*BENT, 2)), data_type=4)
    with pytest.raises(InputError, match="no pixel has coordinates"):
        imagery.open_lookup_table(tmp_path / "empty", BENT)
    with pytest.raises(InputError, match="two bands: x and y"):
        imagery.open_lookup_table(tmp_path / "f01_rdn_igm", (BENT[0], BENT[1] + 1))


@pytest.mark.parametrize(
    ("named", "step", "system"), [(4269, 1e-5, 4269), (32618, 1e-5, 4326), (32618, 2.0, 32618), (None, 2.0, None)]
)
def test_degrees_are_told_from_metres_near_an_origin_by_the_step_of_a_pixel(tmp_path, named, step, system):
    wkt = CRS.from_epsg(named).to_wkt(version="WKT1_ESRI") if named else ""
    places, extra = 3.3 + step * np.stack(np.mgrid[:20, 20:0:-1], -1), {"coordinate system string": f"{{{wkt}}}"}
    table = imagery.open_lookup_table(imagery.write_cube(tmp_path / "igm", places, data_type=5, extra=extra), (20, 20))
    assert (table.crs and table.crs.to_epsg(), table.meridian is None) == (system, step == 2.0)


def test_swath_products_place_regions_by_longitude_and_latitude(tmp_path):
    shells.tree(tmp_path / "p.he5", "prisma")
    cube = imagery.open_cube(tmp_path / "p.he5", quantity="radiance")
    table, _ = imagery.table_of(cube.raster)
    assert table.crs == table.raster.crs == CRS.from_epsg(4326)  # stated, whatever the size of the pixels
    corners = np.array([[2.0, 3.0], [6.0, 3.0], [6.0, 8.0], [2.0, 8.0]]) - 0.5  # the arrays hold the centres of pixels
    lonlat = [(10.0 + 0.0037 * s + 0.0004 * n, 44.0 - 0.0027 * n + 0.0005 * s) for s, n in corners]
    want = np.zeros(cube.shape, bool)
    want[3:8, 2:6] = True
    assert np.array_equal(regions_at(tmp_path / "r.geojson", lonlat, cube.shape, table), want)
    east, north = imagery.metres_per_degree(44.0)
    exact = (0.0037 * 0.0027 + 0.0004 * 0.0005) * east * north
    assert table.pixel_area_m2 == pytest.approx(exact, rel=0.02)


@pytest.mark.parametrize("latitude", [0.0, 34.0, -62.0])
def test_metres_of_a_degree_are_those_of_a_map(latitude):
    """Against the azimuthal equidistant projection about the place."""
    local = CRS.from_proj4(f"+proj=aeqd +lat_0={latitude} +lon_0=10 +datum=WGS84 +units=m")
    x, y = reproject(CRS.from_epsg(4326), local, [10.0005, 10.0], [latitude, latitude + 0.0005])[:2]
    east, north = imagery.metres_per_degree(latitude)
    assert x[0] / 0.0005 == pytest.approx(east, rel=1e-6)
    assert y[1] / 0.0005 == pytest.approx(north, rel=1e-5)


@pytest.mark.parametrize(
    ("second", "want"), [("To-sun zenith (0 to 90 degrees from zenith)", 41.5), ("To-sensor zenith", None)]
)
def test_the_angle_of_the_sun_in_an_observation_file(tmp_path, bent, second, want):
    angles = np.stack([np.full(BENT, 4000.0), np.full(BENT, 41.5)], axis=-1)
    angles[:, :3] = -9999.0
    path = write_table(tmp_path / "f01_rdn_obs", angles, None, data_type=5, extra={"band names": f"{{Path, {second}}}"})
    assert imagery.sun_zenith_deg(imagery.open_raster(bent)) == (None if want is None else (want, path.name))
