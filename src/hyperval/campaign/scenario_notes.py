"""What header, map and truth of the collection say, held against what the scenarios of the campaign say of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from rasterio.crs import CRS
from rasterio.warp import transform as reproject

from hyperval.atmosphere.solar import parse_utc
from hyperval.collection import Detection
from hyperval.imagery.acquisition import time_notes
from hyperval.imagery.companions import sun_zenith_deg
from hyperval.imagery.truth import TargetObject
from hyperval.observe.objects import scored_pixels, target_groups
from hyperval.observe.place import Place
from hyperval.prediction.fills import geometry_of, pixels_of_object
from hyperval.scenario import Fill, Geometry, Scenario
from hyperval.scene.fill import touched_counts

# A flight line is seldom longer; over this distance the sun's zenith angle changes by a tenth of a degree.
MAX_KM = 10.0
MAX_SUN_DEG = 1.0  # a path of 1 % more or less at a zenith angle of 30 degrees
_KM_PER_DEGREE = 111.2
# Half a pixel of three is common where targets lie at random on the grid; a factor of 1.5 is another footprint.
MAX_PIXEL_RATIO = 1.5
MAX_LENGTH_RATIO = 1.05


def header_notes(place: Place | None, scenarios: Sequence[Scenario]) -> list[str]:
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


def truth_notes(place: Place | None, detection: Detection | None, scenarios: Sequence[Scenario]) -> list[str]:
    """Warnings where a scenario's geometry counts other pixels, or states other lengths, than truth and image.

    A prediction of 12 pixels for each object, beside a truth that scores 3, is of another population: its P_D by
    pixel is too low and that by object too high, and nothing else in the table would say why.
    """
    if place is None or detection is None:
        return []
    groups: dict[str, list[TargetObject]] = {}
    for target in detection.targets:
        groups |= target_groups(place.targets, target, detection.group)
    notes = []
    for scenario in scenarios:
        for item in scenario.scene.targets:
            for population in item.populations:
                geometry, members = population.fill.geometry, groups.get(population.name)
                if geometry is not None and members:
                    differences = ", ".join(_differences(place, geometry, _pixels(population.fill), members))
                    if differences:
                        notes.append(f"warning: {population.name!r} of scenario {scenario.name!r}: {differences}")
    return list(dict.fromkeys(notes))


def _pixels(fill: Fill) -> float:
    """Pixels that the prediction counts for an object, on average over its places on the grid."""
    if fill.geometry is not None and fill.geometry.pixels == "touched":
        return float(np.mean(touched_counts(geometry_of(fill))))
    return float(pixels_of_object(fill))


def _differences(place: Place, geometry: Geometry, stated: float, members: Sequence[TargetObject]) -> Iterator[str]:
    counted = float(np.mean([np.count_nonzero(scored_pixels(o, place)[1]) for o in members]))
    if max(counted / stated, stated / counted) > MAX_PIXEL_RATIO:
        yield f"the prediction counts {stated:.3g} pixels for each object, the truth {counted:.3g}"
    if place.pixel_area_m2 is not None:
        pixel = math.sqrt(place.pixel_area_m2)
        if _apart(pixel, geometry.gsd_m):
            yield f"its pixels are {geometry.gsd_m:g} m wide (gsd_m), those of the image {pixel:.3g} m"
    sides = [o.side_m for o in members if math.isfinite(o.side_m)]
    if sides and geometry.side_m is not None and _apart(float(np.mean(sides)), geometry.side_m):
        yield f"its sides are {geometry.side_m:g} m (side_m), those of the truth {np.mean(sides):.3g} m"


def _apart(a: float, b: float) -> bool:
    return max(a / b, b / a) > MAX_LENGTH_RATIO
