"""The part of the ground's light that comes from the sky: closed form, and one answer from any height."""

from __future__ import annotations

import numpy as np
import pytest
from test_atmosphere_sixs import AIRBORNE, at, state

pytestmark = pytest.mark.slow  # two states of the engine


@pytest.fixture
def pair(solver_at):
    terms_at = solver_at(350.0, 412.5, 550.0, 860.0, 1650.0, 2600.0)
    return terms_at(state()), terms_at(state(AIRBORNE, sensor_altitude_km=705.0))


def test_the_sky_is_the_same_from_an_aircraft_and_from_space(pair):
    # The airborne runs know the depths below the aircraft alone: the rest comes from their shares.
    airborne, space = pair
    assert airborne.diffuse_fraction == pytest.approx(space.diffuse_fraction, rel=5e-3, abs=5e-4)


def test_the_beam_follows_from_the_optical_depths(pair):
    # At 550 nm: Rayleigh depth 0.0973 at sea level (Bodhaine 1999), 4 % less at 0.35 km; aerosol 0.2; mu0 = cos 40.
    airborne, _ = pair
    i = at(airborne, 550.0)
    beam = np.exp(-(0.0973 * np.exp(-0.35 / 8.4) + 0.2) / np.cos(np.deg2rad(40.0)))
    down = beam / (1.0 - airborne.diffuse_fraction[i])
    # What is left of the global light after scattering alone: 0.8-0.97 for such a sky.
    assert 0.85 < down < 0.95
    assert np.all(np.diff(airborne.diffuse_fraction[at(airborne, 400.0) : at(airborne, 1000.0) : 20]) < 0)
