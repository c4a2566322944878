"""What the collection's header says of time and place, held against the scenarios of the campaign."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rasterio.crs import CRS
from rasterio.warp import transform as reproject

from hyperval.atmosphere.solar import parse_utc
from hyperval.imagery.acquisition import time_notes
from hyperval.imagery.companions import sun_zenith_deg
from hyperval.observe.place import Place
from hyperval.scenario import Scenario

# A flight line is seldom longer; over this distance the sun's zenith angle changes by a tenth of a degree.
MAX_KM = 10.0
MAX_SUN_DEG = 1.0  # a path of 1 % more or less at a zenith angle of 30 degrees
_KM_PER_DEGREE = 111.2


def scenario_notes(place: Place | None, scenarios: Sequence[Scenario]) -> list[str]:
    """Warnings where the cube was taken at another time or place than a scenario says."""
    if place is None:
        return []
    notes: list[str] = []
    where = centre_of(place)
    sun = sun_zenith_deg(place.cube.raster)
    for scenario in scenarios:
        state = scenario.atmosphere
        if state is None:
            continue
        if state.time_utc is not None:
            notes += time_notes(place.cube.extras, parse_utc(str(state.time_utc)), scenario.name)
        latitude, longitude = state.latitude_deg, state.longitude_deg
        if sun is not None and abs(sun[0] - state.sun[0]) > MAX_SUN_DEG:
            notes.append(
                f"warning: the sun stands at a zenith angle of {sun[0]:.2f} degrees in {sun[1]}, at "
                f"{state.sun[0]:.2f} in scenario {scenario.name!r}"
            )
        if where is not None and latitude is not None and longitude is not None:
            km = distance_km(where, (latitude, longitude))
            if km > MAX_KM:
                notes.append(
                    f"warning: the cube lies at latitude {where[0]:.3f}, longitude {where[1]:.3f}, {km:.0f} km "
                    f"from the place of scenario {scenario.name!r} ({latitude:g}, {longitude:g})"
                )
    return list(dict.fromkeys(notes))


def centre_of(place: Place) -> tuple[float, float] | None:
    """Latitude and longitude of the middle of the cube [degrees], by its map or its table; None without."""
    raster, table = place.cube.raster, place.table
    crs = table.crs if table is not None else raster.crs
    if crs is None:
        return None
    if table is not None:
        x, y = table.middle
    elif raster.transform is None:
        return None
    else:
        x, y = raster.transform @ (raster.samples / 2.0, raster.lines / 2.0)
    longitude, latitude = reproject(crs, CRS.from_epsg(4326), [x], [y])[:2]
    return (latitude[0], longitude[0]) if math.isfinite(latitude[0]) and math.isfinite(longitude[0]) else None


def distance_km(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Distance of two near places (latitude, longitude) in degrees, on a sphere."""
    north = a[0] - b[0]
    east = ((a[1] - b[1] + 180.0) % 360.0 - 180.0) * math.cos(math.radians(0.5 * (a[0] + b[0])))
    return _KM_PER_DEGREE * math.hypot(north, east)
