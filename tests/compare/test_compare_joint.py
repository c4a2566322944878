"""All subjects together: closed forms, and intervals that hold the truth."""

import numpy as np
import pytest

from hyperval import compare
from hyperval.data import Errors
from hyperval.products import ObservedProducts, PredictedProducts, SpectralEstimate
from hyperval.spectra import SpectralAxis, in_window

AXIS = SpectralAxis(np.arange(402.0, 700.0, 6.0), 6.0)
B = len(AXIS)
LEVEL = {"lawn": np.full(B, 5.0), "lot": np.full(B, 2.0), "sand": np.linspace(6.0, 9.0, B)}
SMOOTH = np.array([np.ones(B), np.linspace(-1.0, 1.0, B)])


def both(rng=None, shared=0.03, own=0.04, calibration=0.02, noise=0.005, offset=0.1, day=""):
    """Sites whose predictions are ``offset`` too high, with one draw of their errors; without ``rng`` none."""
    draw = (lambda *size: np.zeros(size)) if rng is None else (lambda *size: rng.standard_normal(size))
    light, gain, predicted, measured = draw(2), draw(B), {}, {}
    offsets, shares = np.broadcast_to(offset, 3), np.broadcast_to(shared, 3)
    for (name, level), offset, shared in zip(LEVEL.items(), offsets, shares, strict=True):
        rows = {"aerosol": Errors(shared * level * SMOOTH, draw=day), "field spectrum": Errors(own * level * SMOOTH)}
        covariance = sum(e.covariance for e in rows.values())
        moved = (1 + offset) * level + light @ rows["aerosol"].rows + draw(2) @ rows["field spectrum"].rows
        predicted[name + day] = SpectralEstimate(moved, covariance, errors=rows)
        every, own_noise = np.diag((calibration * level) ** 2), np.diag((noise * level) ** 2)
        seen = level * (1 + calibration * gain) + noise * level * draw(B)
        measured[name + day] = SpectralEstimate(
            seen, every + own_noise, calibration=every, budget={"noise": noise * level}
        )
    return PredictedProducts(AXIS, radiance=predicted), ObservedProducts(AXIS, radiance=measured)


def rows_of(sides):
    return {row.metric: row for row in compare.compare_jointly(*sides)}


def test_errors_that_all_share_stay_and_own_ones_average_out():
    tilt = SMOOTH[1, (AXIS.centre_nm >= 450) & in_window(AXIS.centre_nm)].mean()
    none = {"shared": 0, "own": 0, "calibration": 0, "noise": 0}
    for source, averaged in {"own": 3, "shared": 1}.items():
        level = rows_of(both(**none | {source: 0.04}))["joint_difference_ratio@450-700"]
        u = np.hypot(0.04 * np.hypot(1, tilt) / np.sqrt(averaged), 1.1e-4 / np.sqrt(3))
        assert (level.upper - level.value) / 1.959964 == pytest.approx(u, rel=1e-6)
    rows = rows_of(both())
    found = rows["joint_difference_ratio@450-700"].value, rows["p_value_between@450-700"].value
    assert found == pytest.approx((0.1, 1.0), abs=1e-12)
    # Weights of any sign would extrapolate from the lot, whose error is twice the others', to 0.09.
    rows = rows_of(both(**none | {"shared": (0.04, 0.04, 0.08), "offset": (0.1, 0.1, 0.11)}))
    assert 0.1 <= rows["joint_difference_ratio@450-700"].value <= 0.11


def two_days(rng):
    """The same sites on two days, which share the sensor and not the atmosphere."""
    lines = both(rng), both(rng, day="2")
    return [type(a)(AXIS, radiance={**a.radiance, **b.radiance}) for a, b in zip(*lines, strict=True)]


@pytest.mark.simulation
@pytest.mark.parametrize("world", [both, two_days])
def test_intervals_hold_the_truth_and_subjects_differ_as_stated(world):
    # 500 draws: the share of 0.95 lies within 0.92 to 0.975 in all but 1 of 300 runs, and so does that of p-values.
    rng, found = np.random.default_rng(5), []
    for _ in range(500):
        rows = rows_of(world(rng))
        truths = {
            "joint_difference_ratio@450-700": 0.1,
            "sensor_gain_beside_offset@595": 1 / 1.1,
            "sensor_offset@595": 0,
        }
        held = [rows[name].lower <= truth <= rows[name].upper for name, truth in truths.items()]
        found.append([*held, rows["p_value_between@450-700"].value > 0.05])
    assert np.all(np.abs(np.mean(found, axis=0) - 0.9475) < 0.0275), np.mean(found, axis=0)
