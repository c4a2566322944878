"""A scenario that speaks of other targets than the truth does is told so."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hyperval.campaign.sides import truth_notes
from hyperval.collection import Detection
from hyperval.imagery import TargetObject
from hyperval.scenario import Scenario

SQUARE = {"side_m": 2.0, "gsd_m": 1.0, "pixels": "ranked", "n": 9}


def place(side_m=2.0, pixels=9, area=1.0, target_pixels="touched"):
    part = np.ones((3, 3), bool)
    part.ravel()[pixels:] = False
    objects = [
        TargetObject(f"t{i}", "tarp", side_m, side_m**2, (20, 20), (5, 5 * i), part, (6, 5 * i + 1)) for i in (1, 2)
    ]
    return SimpleNamespace(targets=objects, pixel_area_m2=area, target_pixels=target_pixels)


def told(held, **change):
    geometry = {k: v for k, v in {**SQUARE, **change}.items() if v is not None}
    scenario = Scenario.model_validate(
        {
            "name": "s",
            "scene": {
                "classes": [{"name": "grass", "fraction": 1, "spectrum": {"builtin": "grass"}}],
                "targets": [
                    {"name": "tarp", "host": "grass", "spectrum": {"constant": 0.5}, "fill": {"geometry": geometry}}
                ],
            },
        }
    )
    detection = Detection.model_validate(
        {"targets": [{"name": "tarp", "material": "tarp", "spectrum": {"constant": 0.5}}], "group": "{target}"}
    )
    return truth_notes(held, detection, [scenario])


def test_truth_and_scenario_that_agree_are_not_spoken_of():
    assert told(place()) == []
    assert told(place(pixels=7)) == []
    assert told(place(side_m=np.nan, area=None)) == []
    assert told(place(target_pixels="centre"), pixels="best", n=None) == []
    assert truth_notes(None, None, []) == []


@pytest.mark.parametrize(
    ("held", "change", "message"),
    [
        ({"pixels": 3}, {}, "the prediction counts 9 pixels for each object, the truth 3"),
        ({}, {"pixels": "best", "n": None}, "the prediction counts 1 pixels for each object, the truth 9"),
        ({"target_pixels": "centre"}, {}, "counts 9 pixels for each object, the truth 1"),
        ({"area": 1.44}, {}, "its pixels are 1 m wide (gsd_m), those of the image 1.2 m"),
        ({"side_m": 1.0}, {}, "its sides are 2 m (side_m), those of the truth 1 m"),
    ],
)
def test_each_difference_is_a_warning(held, change, message):
    (note,) = told(place(**held), **change)
    assert note.startswith("warning: 'tarp' of scenario 's': ")
    assert message in note
