"""What the header of a cube says of time and place against the scenarios of its campaign."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from affine import Affine
from rasterio.crs import CRS

from hyperval.campaign.job import jobs_of
from hyperval.campaign.one import run_campaign
from hyperval.campaign.sides import centre_of, distance_km, header_notes
from hyperval.imagery import LookupTable, Raster, open_raster, table_of, write_cube
from hyperval.observe import Place

UTM18 = CRS.from_epsg(32618)


GRID = Affine(1, 0, 275400.0, 0, -1, 4753700.0)


def place(transform: Affine | None = GRID, extras: Any = None, table: Any = None):
    position = transform, UTM18 if transform else None
    raster = Raster(Path("nowhere.img"), (100, 200, 1), np.dtype(np.uint8), position=position)
    cube = SimpleNamespace(extras=extras or {}, raster=raster)
    return cast(Place, SimpleNamespace(cube=cube, table=table))


def scenario(**state: Any) -> Any:
    given = {"time_utc": "2012-09-20T16:31:00Z", "latitude_deg": 42.9, "longitude_deg": -77.75} | state
    return SimpleNamespace(name="line", atmosphere=SimpleNamespace(**given))


def test_a_cube_at_its_place_and_time_says_nothing():
    assert header_notes(place(extras={"gps start time": "16:31:02"}), [scenario()]) == []
    assert header_notes(None, [scenario()]) == []
    assert header_notes(place(), [SimpleNamespace(name="r", atmosphere=None)]) == []


def test_another_place_or_time_is_a_warning_once():
    notes = header_notes(
        place(extras={"gps start time": "12:31:02"}), [scenario(latitude_deg=43.9), scenario(latitude_deg=43.9)]
    )
    assert [n.split(",")[0] for n in notes] == [
        "warning: header: 'gps start time = 12:31:02' is 240 minutes before the time of scenario 'line'",
        "warning: the cube lies at latitude 42.902",
    ]
    assert "111 km from the place of scenario 'line' (43.9, -77.75)" in notes[1]


def test_another_sun_in_the_observation_file_is_a_warning(tmp_path: Path):
    cube = write_cube(tmp_path / "f01_rdn_img", np.ones((4, 5, 2)), data_type=4)
    angles = write_cube(tmp_path / "f01_rdn_obs", np.full((4, 5, 2), 41.5), data_type=5)
    header = next(p for p in tmp_path.glob("f01_rdn_obs*.hdr"))
    header.write_text(header.read_text() + "band names = {Path length, To-sun zenith}\n")
    raw = place(None)
    raw.cube.raster = open_raster(cube)  # type: ignore[misc]
    assert header_notes(raw, [scenario(sun=(41.0, 180.0))]) == []
    notes = header_notes(raw, [scenario(sun=(44.0, 180.0))])
    assert notes == [
        f"warning: the sun stands at a zenith angle of 41.50 degrees in {angles.name}, at 44.00 in scenario 'line'"
    ]


def test_the_lookup_table_places_a_raw_cube():
    table = LookupTable(place().cube.raster, GRID, UTM18, (90, 210))
    assert centre_of(place(None)) is None
    assert header_notes(place(None), [scenario(latitude_deg=0.0)]) == []
    found = centre_of(place(None, table=table))
    assert found == centre_of(place())
    assert len(header_notes(place(None, table=table), [scenario(latitude_deg=0.0)])) == 1


@pytest.mark.parametrize(
    ("a", "b", "km"),
    [((0.0, 0.0), (1.0, 0.0), 111.2), ((60.0, 10.0), (60.0, 11.0), 55.6), ((0.0, 179.5), (0.0, -179.5), 111.2)],
)
def test_distances(a, b, km):
    assert distance_km(a, b) == pytest.approx(km, rel=2e-3)


def test_the_report_of_a_campaign_holds_the_warning(small):
    small.edit("small_rad.hdr", lambda text: text + "acquisition time = 2011-01-01T03:00:00Z\n")
    given = small.scenario["atmosphere"]
    for key in ("solar_zenith_deg", "solar_azimuth_deg", "day_of_year"):
        given.pop(key)
    given |= {"latitude_deg": 42.9, "longitude_deg": -77.75, "time_utc": "2012-07-18T17:00:00Z"}
    (job,) = jobs_of(small.write())
    notes = run_campaign(job).notes
    assert any("2011-01-01T03:00:00Z' is not the day of scenario 'small', 2012-07-18" in n for n in notes)
    assert not any("the cube lies" in n for n in notes)


def test_places_of_every_pixel_say_where_a_cube_lies(tmp_path: Path):
    line, sample = np.mgrid[0:9, 0:7]
    degrees = np.stack([-77.75 + 1e-5 * sample, 42.9 - 1e-5 * line], axis=-1)
    degrees[:, :5] = -9999.0  # pixels without a place, the middle among them
    cube = open_raster(write_cube(tmp_path / "f01_rdn_img", np.ones((9, 7, 2)), data_type=4))
    write_cube(tmp_path / "f01_rdn_igm", degrees, data_type=5)
    raw = place(None)
    raw.cube.raster = cube  # type: ignore[misc]
    known = cast(Place, SimpleNamespace(cube=raw.cube, table=table_of(cube)[0]))
    found = centre_of(known)
    assert found == pytest.approx((42.9 - 4e-5, -77.75 + 5e-5), abs=2e-5)
    assert len(header_notes(known, [scenario(latitude_deg=43.9)])) == 1
