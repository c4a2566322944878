"""Fractions of the classes by the pixels of their regions, where a scenario leaves them to the image."""

from __future__ import annotations

import numpy as np

from hyperval.errors import UsageError
from hyperval.observe.place import Place
from hyperval.scenario import BackgroundClass, Scenario


def with_measured_fractions(scenario: Scenario, place: Place | None) -> Scenario:
    """The scenario with the fractions of ``scene.fractions: measured``; as it is where they are stated.

    A class counts the pixels of the region of its name, else of the one that its statistics come from; targets,
    their guard and what the collection leaves out do not count.

    Raises
    ------
    UsageError : no image, a class without a region, or no pixel in any.
    """
    if scenario.scene.fractions == "stated":
        return scenario
    if place is None:
        raise UsageError(
            f"scenario {scenario.name!r}: scene.fractions is measured, and the campaign has no image",
            mend="take it out: the stated fractions then hold",
        )
    counts = [int(np.count_nonzero(place.pixels_of(_region_of(c, place)))) for c in scenario.scene.classes]
    total = sum(counts)
    if total == 0:
        raise UsageError(f"scenario {scenario.name!r}: no pixel in the regions of its classes")
    classes = [
        c.model_copy(update={"fraction": n / total}) for c, n in zip(scenario.scene.classes, counts, strict=True)
    ]
    return scenario.model_copy(update={"scene": scenario.scene.model_copy(update={"classes": classes})})


def _region_of(surface: BackgroundClass, place: Place) -> str:
    spread = surface.covariance.measured if surface.covariance is not None else None
    for name in (surface.name, surface.spectrum.measured, spread):
        if name is not None and name in place.regions:
            return name
    raise UsageError(
        f"scene.fractions is measured, and class {surface.name!r} has no region",
        expected="one of " + ", ".join(place.regions) if place.regions else "a region of its name",
    )
