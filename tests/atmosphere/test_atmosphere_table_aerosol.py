"""Between two amounts of aerosol: laws that the rules meet exactly, limits, and the error for the budget."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.atmosphere import aot550_from_range
from hyperval.atmosphere.table import PATH_ERROR, between_aerosols, depth_below, path_error

GROUND, SENSOR = 0.35, 2.3
NODES = np.array([0.05, 0.1, 0.2, 0.6])
TILT = np.linspace(0.5, 1.5, 7)  # of extinction over wavelength


def atmosphere(tau, sensor=SENSOR):
    """Single scattering: Beer's law both ways, light scattered into the view, path in proportion to the haze."""
    tau = np.asarray(tau, dtype=float)
    d = depth_below(tau, GROUND, sensor)
    tau, d = tau[..., None] * TILT, d[..., None] * TILT
    ground = 0.9 * np.exp(-0.3 * tau)
    direct = ground * 0.85 * np.exp(-1.1 * d)
    return {
        "path": 0.03 + 0.08 * d, "direct": direct, "adjacency": ground * (0.95 - 0.02 * d) - direct,
        "ground": ground, "spherical_albedo": 0.05 + 0.1 * tau, "gas": np.ones_like(tau), "diffuse": 0.2 * tau,
    }  # fmt: skip


@pytest.mark.parametrize("tau", [0.05, 0.07, 0.1, 0.15, 0.33, 0.6])
@pytest.mark.parametrize("sensor", [1.0, SENSOR, 705.0])
def test_single_scattering_is_met_exactly(tau, sensor):
    got = between_aerosols(NODES, atmosphere(NODES, sensor), tau, GROUND, sensor)
    for name, value in atmosphere(tau, sensor).items():
        np.testing.assert_allclose(got[name], value, rtol=1e-12, err_msg=name)


def test_depth_below_is_that_of_the_profile_and_the_whole_from_space():
    ranges = np.array([60.0, 23.0, 10.0])
    tau = [aot550_from_range(v, GROUND) for v in ranges]
    below = [aot550_from_range(v, GROUND, SENSOR) for v in ranges]
    np.testing.assert_allclose(depth_below(tau, GROUND, SENSOR), below, rtol=1e-6)
    np.testing.assert_allclose(depth_below(tau, GROUND, 705.0), tau, rtol=1e-9)
    assert depth_below([0.0], GROUND, SENSOR) == 0.0
    # Clear air: nearly nothing below an aircraft, which a straight line over the whole depth does not know.
    assert depth_below([0.05], GROUND, SENSOR)[0] < 0.2 * 0.05


def test_bands_without_light_stay_dark():
    values = atmosphere(NODES)
    for name in ("ground", "direct", "adjacency", "path"):
        values[name] = values[name].copy()
        values[name][:, 3] = 0.0
    got = between_aerosols(NODES, values, 0.15, GROUND, SENSOR)
    for name in ("ground", "direct", "adjacency", "path"):
        assert got[name][3] == 0.0
        assert np.all(np.isfinite(got[name]))


def test_error_of_the_path_is_none_at_nodes_and_grows_with_the_step():
    for node in NODES:
        assert path_error(NODES, float(node), GROUND, SENSOR) == pytest.approx(0.0, abs=1e-12)
    four = np.array([0.1, 0.4])
    most = max(path_error(four, t, GROUND, SENSOR) for t in np.linspace(0.1, 0.4, 61))
    assert most == pytest.approx(PATH_ERROR, rel=1e-3)
    two = np.array([0.1, 0.2])
    assert max(path_error(two, t, GROUND, SENSOR) for t in np.linspace(0.1, 0.2, 61)) == pytest.approx(
        0.5 * PATH_ERROR, rel=1e-3
    )
    # The logarithm of the ratio: three is to four as ln 3 to ln 4.
    three = np.array([0.1, 0.3])
    assert max(path_error(three, t, GROUND, SENSOR) for t in np.linspace(0.1, 0.3, 61)) == pytest.approx(
        PATH_ERROR * np.log(3) / np.log(4), rel=1e-3
    )


def test_only_the_two_nodes_around_count():
    rng = np.random.default_rng(0)
    values = {name: v * rng.uniform(0.9, 1.1, v.shape) for name, v in atmosphere(NODES).items()}
    got = between_aerosols(NODES, values, 0.15, GROUND, SENSOR)
    ends = {name: v.copy() for name, v in values.items()}
    for v in ends.values():
        v[[0, 3]] *= 0.5
    for name, value in between_aerosols(NODES, ends, 0.15, GROUND, SENSOR).items():
        assert np.array_equal(value, got[name]), name


def test_a_sensor_on_the_ground_has_no_haze_below_it():
    # Nothing lies between: the place between the nodes is that of the whole depth.
    values = atmosphere(NODES)
    values["path"] = 0.03 + 0.1 * NODES[:, None] * np.ones(7)
    got = between_aerosols(NODES, values, 0.15, GROUND, GROUND)
    assert got["path"] == pytest.approx(np.full(7, 0.045))
    assert path_error(NODES, 0.15, GROUND, GROUND) == 0.0


def test_error_of_the_path_in_clear_air_counts_from_a_hundredth():
    def most(low, high):
        nodes = np.array([low, high])
        return max(path_error(nodes, t, GROUND, 705.0) for t in np.linspace(low, high, 81))

    assert most(0.02, 0.08) == pytest.approx(PATH_ERROR, rel=1e-3)
    assert most(0.0, 0.04) == pytest.approx(PATH_ERROR, rel=1e-3)
