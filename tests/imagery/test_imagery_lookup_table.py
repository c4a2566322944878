"""Lookup tables: map coordinates to raw pixels of a rolling flight line whose geometry is known in closed form."""

from __future__ import annotations

import json

import numpy as np
import pytest
from affine import Affine
from rasterio.crs import CRS
from scanned_line import LINES, SAMPLES, UTM18, ScannedLine, write_table

from hyperval.errors import InputError
from hyperval.imagery import open_lookup_table, polygon_mask, read_regions, read_targets

SHAPE = (LINES, SAMPLES)


@pytest.fixture
def line() -> ScannedLine:
    return ScannedLine()


@pytest.fixture
def table(tmp_path, line):
    return open_lookup_table(write_table(tmp_path / "glt.dat", *line.table()), SHAPE)


def some_places(n: int = 400) -> np.ndarray:
    rng = np.random.default_rng(2)
    return np.column_stack([rng.uniform(4, SAMPLES - 4, n), rng.uniform(4, LINES - 4, n)])


def test_places_come_back_to_a_part_of_a_pixel(line, table):
    places = some_places()
    error = table.to_pixel(line.on_map(*places.T), where="t") - places
    # A cell names a whole pixel (rounding of 0.29 in each coordinate); the fit averages 49 of them.
    assert np.sqrt(np.mean(error**2)) < 0.12
    assert np.abs(error).max() < 0.5
    assert np.abs(error.mean(axis=0)).max() < 0.02  # no half-pixel shift


@pytest.mark.parametrize(("size", "cell"), [(1.0, 1.0), (2.0, 1.0), (1.0, 2.0)])
def test_the_area_of_a_raw_pixel_is_not_that_of_a_cell(tmp_path, size, cell):
    line = ScannedLine(size=size)
    table = open_lookup_table(write_table(tmp_path / "glt.dat", *line.table(cell)), SHAPE)
    assert table.pixel_area_m2 == pytest.approx(size**2, rel=0.03)
    places = some_places()
    error = table.to_pixel(line.on_map(*places.T), where="t") - places
    assert np.sqrt(np.mean(error**2)) < 0.35  # half a pixel of roll across the cells that are fitted, at most


def test_every_layout_of_the_table_is_the_same(tmp_path, line, table):
    stored, transform = line.table()
    places = line.on_map(*some_places(50).T)
    swapped = write_table(
        tmp_path / "s.dat", stored[..., ::-1], transform, band_names=("GLT Line", "GLT Sample"), interleave="bsq",
        data_type=2, byte_order=1,
    )  # fmt: skip
    again = open_lookup_table(swapped, SHAPE)
    assert again.swapped
    assert np.array_equal(again.to_pixel(places, where="t"), table.to_pixel(places, where="t"))


def square(line: ScannedLine, n: int = 4):
    """A long region near the edge of the line, and its vertices on the map."""
    raw = np.array([(15.0, 30.0), (60.0, 25.0), (65.0, 190.0), (20.0, 200.0)])
    return raw, line.on_map(*raw.T)


def test_regions_drawn_on_the_map_fall_on_the_raw_pixels(tmp_path, line, table):
    _, ring = square(line)
    data = {"type": "Polygon", "coordinates": [[*ring.tolist(), ring[0].tolist()]]}
    (tmp_path / "r.geojson").write_text(json.dumps(data))
    (region,) = read_regions(tmp_path / "r.geojson", SHAPE, coordinates="map", transform=table, crs=table.crs).values()
    # By another route: the pixels whose own centres lie in the polygon on the map.
    sample, row = np.meshgrid(np.arange(SAMPLES) + 0.5, np.arange(LINES) + 0.5)
    centres = line.on_map(sample, row)
    low = ring.min(axis=0)
    fine = 20  # of a metre, to decide whether a centre is in the polygon
    on_grid = polygon_mask(
        (ring - low) * fine, tuple(np.ceil(np.ptp(ring, axis=0)[::-1] * fine).astype(int)), where="t"
    )
    at = np.floor((centres - low) * fine).astype(int)
    held = (at >= 0).all(axis=-1) & (at[..., 0] < on_grid.shape[1]) & (at[..., 1] < on_grid.shape[0])
    expected = np.zeros(SHAPE, bool)
    expected[held] = on_grid[at[held][:, 1], at[held][:, 0]]
    differing = np.count_nonzero(region.mask ^ expected)
    border = 2 * (45 + 170)  # pixels along it; each may fall to either side where it lies within 0.1 pixel of it
    assert differing < 0.25 * border
    assert abs(region.n - expected.sum()) < 0.03 * expected.sum()
    # Joining the four corners by straight lines in the raw image would be far off: the line rolls by 3 pixels.
    plain = polygon_mask(table.to_pixel(ring, where="t"), SHAPE, where="t")
    assert np.count_nonzero(plain ^ expected) > 2 * differing


def test_longitude_and_latitude_go_through_the_tables_system(tmp_path, line, table):
    from rasterio.warp import transform as reproject

    _, ring = square(line)
    east, north = reproject(UTM18, CRS.from_epsg(4326), *ring.T.tolist())[:2]
    masks = []
    for points, kind in ((ring.tolist(), "map"), (list(zip(east, north, strict=True)), "lonlat")):
        data = {"type": "Polygon", "coordinates": [[*points, points[0]]]}
        (tmp_path / f"{kind}.geojson").write_text(json.dumps(data))
        read = read_regions(tmp_path / f"{kind}.geojson", SHAPE, coordinates=kind, transform=table, crs=table.crs)
        masks += [region.mask for region in read.values()]
    assert masks[0].any()
    assert np.count_nonzero(masks[0] ^ masks[1]) <= 2  # rounding of the projection


def test_targets_on_the_map_keep_size_and_heading(tmp_path, line, table):
    east, north = line.on_map(40.5, 100.5)
    row = "material,easting,northing,width_m,length_m,heading_deg\n"
    (tmp_path / "t.csv").write_text(row + f"plank,{east},{north},2,12,20\n")
    (target,) = read_targets(tmp_path / "t.csv", SHAPE, transform=table)
    assert target.centre_pixel == (100, 40)
    # The line flies at 20 degrees, as the plank lies: along the lines of the raw image, 12 long and 2 wide.
    rows, cols = np.nonzero(target.mask)
    assert 12 <= np.ptp(rows) + 1 <= 14
    assert np.ptp(cols) + 1 <= 6  # 2 wide, sheared by the roll: up to 3 x 2 pi / 60 x 12 = 3.8
    (tmp_path / "t.csv").write_text("material,row0,col0,side_m\nplank,100,40,2\n")
    (pixel,) = read_targets(tmp_path / "t.csv", SHAPE, transform=table)
    assert pixel.mask.sum() == 9
    assert pixel.area_m2 == 4.0


def test_a_place_off_the_line_is_named(table):
    with pytest.raises(InputError, match=r"(?s)r: the place \(9\.00, 9\.00\) has no pixel.*belongs to this image"):
        table.to_pixel(np.array([(9.0, 9.0)]), where="r")
    with pytest.raises(InputError, match="not finite"):
        table.to_pixel(np.array([(np.nan, 9.0)]), where="r")


@pytest.mark.parametrize(
    ("change", "shape", "message"),
    [
        (lambda s: s[..., :1], SHAPE, "1 bands of int32"),
        (lambda s: s * 0, SHAPE, "names no pixel"),
        (lambda s: s, (LINES, SAMPLES - 1), r"goes to line 240, sample 80 .from 1.\n.*240 lines and 79 samples"),
        (lambda s: np.abs(s) * (1, -1), SHAPE, "one of sample and line is 0 or negative"),
        (lambda s: s * (1, 0), SHAPE, "one of sample and line is 0 or negative"),
    ],
)
def test_what_is_no_table_of_this_line(tmp_path, line, change, shape, message):
    stored, transform = line.table()
    made = change(stored)
    names = tuple(f"b{i}" for i in range(made.shape[2]))
    path = write_table(tmp_path / "glt.dat", made, transform, band_names=names)
    with pytest.raises(InputError, match=message):
        open_lookup_table(path, shape)


def test_a_table_needs_a_map_and_integers(tmp_path, line):
    stored, transform = line.table()
    with pytest.raises(InputError, match="has no 'map info'"):
        open_lookup_table(write_table(tmp_path / "a.dat", stored, None), SHAPE)
    with pytest.raises(InputError, match="2 bands of float32"):
        open_lookup_table(write_table(tmp_path / "b.dat", stored, transform, data_type=4), SHAPE)
    degrees = Affine(1e-5, 0, -77.0, 0, -1e-5, 42.0)
    table = open_lookup_table(write_table(tmp_path / "c.dat", stored, degrees, crs=CRS.from_epsg(4326)), SHAPE)
    assert table.pixel_area_m2 is None
    with pytest.raises(InputError, match="not in a known unit of length"):
        _ = table.metres_per_unit
