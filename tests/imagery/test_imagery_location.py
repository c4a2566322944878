"""Pixels placed one by one: IGM and location files, swath products, and which files belong to a cube."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import product_shells as shells
import pytest
from rasterio.crs import CRS
from rasterio.warp import transform as reproject

from hyperval.errors import InputError
from hyperval.imagery import (
    LocationTable,
    companion,
    metres_per_degree,
    open_cube,
    open_raster,
    read_regions,
    sun_zenith_deg,
    table_of,
    write_cube,
)

LINES, SAMPLES = 60, 40


def ground(line: np.ndarray, sample: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Map coordinates of continuous pixel coordinates on a line that turns and bends."""
    east = 400_000.0 + 2.0 * sample + 0.4 * line + 1.5 * np.sin(line / 12.0)
    north = 3_800_000.0 - 2.5 * line + 0.3 * sample
    return east, north


def pair(folder: Path, axis, values, kind: str = "igm", **names) -> tuple[Path, Path]:
    cube = write_cube(folder / names.get("cube", "f01_rdn_v2n1_img"), values, data_type=4, axis=axis)
    line, sample = np.mgrid[0:LINES, 0:SAMPLES] + 0.5
    places = np.stack(ground(line, sample), axis=-1)
    table = write_cube(folder / names.get("table", f"f01_rdn_{kind}"), places, data_type=5)
    return cube, table


@pytest.fixture
def line_values() -> np.ndarray:
    return np.random.default_rng(2).uniform(1.0, 5.0, (LINES, SAMPLES, 4))


def test_places_come_back_to_their_pixels(tmp_path: Path, axis, line_values):
    pair(tmp_path, axis, line_values)
    table, notes = table_of(open_raster(tmp_path / "f01_rdn_v2n1_img"))
    assert isinstance(table, LocationTable)
    assert notes == ("f01_rdn_igm lies beside the cube and places its pixels",)
    rng = np.random.default_rng(4)
    want = np.column_stack([rng.uniform(0, SAMPLES, 200), rng.uniform(0, LINES, 200)])
    places = np.column_stack(ground(want[:, 1], want[:, 0]))
    found = table.to_pixel(places, where="here")
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
def test_which_file_belongs_to_a_cube(tmp_path: Path, image: str, table: str, kind: str, fits: bool):
    for name in (image, table):
        (tmp_path / name).write_bytes(b"x")
        (tmp_path / f"{name}.hdr").write_text("ENVI\n")
    assert companion(tmp_path / image, kind) == (tmp_path / table if fits else None)


def test_a_table_of_another_size_is_left_aside_with_a_warning(tmp_path: Path, axis, line_values):
    pair(tmp_path, axis, line_values)
    write_cube(tmp_path / "f01_rdn_v2n1_img", line_values[:50], data_type=4, axis=axis)
    table, notes = table_of(open_raster(tmp_path / "f01_rdn_v2n1_img"))
    assert table is None
    assert notes[0].startswith("warning: f01_rdn_igm lies beside the cube and is left aside: 60 lines")


def test_swath_products_place_regions_by_longitude_and_latitude(tmp_path: Path):
    shells.prisma(tmp_path / "p.he5")
    cube = open_cube(tmp_path / "p.he5", quantity="radiance")
    table, _ = table_of(cube.raster)
    assert table.crs == CRS.from_epsg(4326)
    corners = np.array([[2.0, 3.0], [6.0, 3.0], [6.0, 8.0], [2.0, 8.0]])  # sample, line
    at = corners - 0.5  # the arrays hold the centres of pixels
    lonlat = [(10.0 + 0.00037 * s + 0.00004 * n, 44.0 - 0.00027 * n + 0.00005 * s) for s, n in at]
    ring = ", ".join(f"[{x:.9f}, {y:.9f}]" for x, y in [*lonlat, lonlat[0]])
    (tmp_path / "r.geojson").write_text(f'{{"type": "Polygon", "coordinates": [[{ring}]]}}')
    region = read_regions(tmp_path / "r.geojson", cube.shape, transform=table, crs=table.crs)["r"]
    # Stored as float32, a longitude is known to a few metres: a tenth of a pixel of 30 m.
    want = np.zeros(cube.shape, bool)
    want[3:8, 2:6] = True
    assert np.array_equal(region.mask, want)
    east, north = metres_per_degree(44.0)
    exact = (0.00037 * 0.00027 + 0.00004 * 0.00005) * east * north
    assert table.pixel_area_m2 == pytest.approx(exact, rel=0.02)


@pytest.mark.parametrize("latitude", [0.0, 34.0, -62.0])
def test_metres_of_a_degree_are_those_of_a_map(latitude: float):
    """Against the azimuthal equidistant projection about the place."""
    local = CRS.from_proj4(f"+proj=aeqd +lat_0={latitude} +lon_0=10 +datum=WGS84 +units=m")
    x, y = reproject(CRS.from_epsg(4326), local, [10.0005, 10.0], [latitude, latitude + 0.0005])[:2]
    east, north = metres_per_degree(latitude)
    assert x[0] / 0.0005 == pytest.approx(east, rel=1e-6)
    assert y[1] / 0.0005 == pytest.approx(north, rel=1e-5)


def test_places_that_are_none(tmp_path: Path, axis, line_values):
    _, table = pair(tmp_path, axis, line_values)
    from hyperval.imagery import location_table

    write_cube(tmp_path / "empty", np.zeros((LINES, SAMPLES, 2)), data_type=4)
    with pytest.raises(InputError, match="no pixel has a place"):
        location_table(open_raster(tmp_path / "empty"), (LINES, SAMPLES))
    with pytest.raises(InputError, match="two bands: x and y"):
        location_table(open_raster(table), (LINES, SAMPLES + 1))


@pytest.mark.parametrize(
    ("names", "want"),
    [("Path length (m), To-sun zenith (0 to 90 degrees from zenith)", 41.5), ("Path length, To-sensor zenith", None)],
)
def test_the_angle_of_the_sun_in_an_observation_file(tmp_path: Path, axis, line_values, names: str, want):
    cube = write_cube(tmp_path / "f01_rdn_v2n1_img", line_values, data_type=4, axis=axis)
    angles = np.stack([np.full((LINES, SAMPLES), 4000.0), np.full((LINES, SAMPLES), 41.5)], axis=-1)
    angles[:, :3] = -9999.0
    path = write_cube(tmp_path / "f01_rdn_obs", angles, data_type=5)
    header = next(p for p in tmp_path.glob("f01_rdn_obs*.hdr"))
    header.write_text(header.read_text() + f"band names = {{{names}}}\n")
    found = sun_zenith_deg(open_raster(cube))
    assert found == (None if want is None else (want, path.name))
