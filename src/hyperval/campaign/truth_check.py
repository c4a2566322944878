"""What the truth says of the targets, held against what the scenarios of the campaign say of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from hyperval.collection import Detection
from hyperval.imagery.truth import TargetObject
from hyperval.observe.objects import scored_pixels, target_groups
from hyperval.observe.place import Place
from hyperval.prediction.fills import geometry_of, pixels_of_object
from hyperval.scenario import Fill, Geometry, Scenario
from hyperval.scene.fill import touched_counts

# Half a pixel of three is common where targets lie at random on the grid; a factor of 1.5 is another footprint.
MAX_PIXEL_RATIO = 1.5
MAX_LENGTH_RATIO = 1.05


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
