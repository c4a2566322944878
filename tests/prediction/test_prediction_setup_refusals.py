"""What a setup refuses, and what it takes for dark."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hyperval.errors import InputError, UsageError
from hyperval.model import Light
from hyperval.model.world import _sensor


def nowhere(name: str):
    raise InputError("no such file", where=name)


def test_a_sensor_that_there_is_not_is_a_missing_file_where_it_is_meant_as_one():
    with pytest.raises(UsageError, match=r"unknown sensor 'hydyce'(?s:.*)hydice"):
        _sensor("hydyce", nowhere)
    for name in ("mine.yaml", "data:set/sensor"):
        with pytest.raises(InputError, match="no such file"):
            _sensor(name, nowhere)


def test_bands_that_no_light_of_the_ground_reaches_are_dark_and_so_are_all_of_them():
    for direct, lit in (([1.0, 0.0, 2e-9, 0.5e-9], [True, False, True, False]), ([0.0] * 4, [False] * 4)):
        light = Light(SimpleNamespace(direct=np.array(direct)), np.full((1, 4), 0.2), None, np.full((1, 1, 1), 0.1))
        np.testing.assert_array_equal(light.lit(), lit)
