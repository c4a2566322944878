"""Scenarios that leave to the collection what it tells: fractions of the classes, fills of the targets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hyperval.collection import Detection
from hyperval.errors import UsageError
from hyperval.imagery.truth import TargetObject
from hyperval.observe.objects import target_groups
from hyperval.observe.place import Place
from hyperval.observe.truth_images import fills_of
from hyperval.scenario import BackgroundClass, Fill, Scenario, Target


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


def with_fills_of_truth(
    scenarios: Sequence[Scenario], place: Place | None, detection: Detection | None
) -> list[Scenario]:
    """The scenarios with ``fill: {truth: true}`` replaced by the fills of the objects of the same subject.

    Raises
    ------
    UsageError : a subject whose objects the truth does not know, or not by the fill of their pixels.
    """
    if not any(_asks(item) for scenario in scenarios for item in scenario.scene.targets):
        return list(scenarios)
    groups: dict[str, list[TargetObject]] = {}
    if place is not None and detection is not None:
        for target in detection.targets:
            groups |= target_groups(place.targets, target, detection.group)
    known = fills_of(groups)

    def fill(stated: Fill | None, subject: str) -> Fill | None:
        if stated is None or stated.truth is None:
            return stated
        if subject not in known:
            raise UsageError(
                f"fill: {{truth: true}} of {subject!r}: the truth does not tell the fills of its pixels",
                expected="one of " + ", ".join(known) if known else "targets from a finer image or from abundances",
                mend="name the subject as detection.group does, or state its fill",
            )
        return Fill(listed=known[subject])

    def with_fill(item: Target) -> Target:
        subjects = [s.model_copy(update={"fill": fill(s.fill, s.name)}) for s in item.subjects]
        return item.model_copy(update={"fill": fill(item.fill, item.name), "subjects": subjects})

    out = []
    for scenario in scenarios:
        scene = scenario.scene.model_copy(update={"targets": [with_fill(item) for item in scenario.scene.targets]})
        out.append(scenario.model_copy(update={"scene": scene}))
    return out


def _asks(item: Target) -> bool:
    return any(population.fill.truth is not None for population in item.populations)
