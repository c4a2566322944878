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


def both(
    rng=None, shared=0.03, own=0.04, calibration=0.02, noise=0.005, offset=0.1, day="", unstated=0.0, light=0, gain=None
):
    """Sites whose predictions are ``offset`` too high, with one draw of their errors; without ``rng`` none."""
    draw = (lambda *size: np.zeros(size)) if rng is None else (lambda *size: rng.standard_normal(size))
    light, gain, predicted, measured = light + draw(2), draw(B) if gain is None else gain, {}, {}
    offsets, shares = np.broadcast_to(offset, 3), np.broadcast_to(shared, 3)
    for (name, level), offset, shared in zip(LEVEL.items(), offsets, shares, strict=True):
        rough = unstated * np.repeat(draw(B), 5)[:B]  # not from band to band
        moved = (1 + offset) * level * np.exp((shared * light + own * draw(2)) @ SMOOTH + rough)
        rows = {"aerosol": Errors(shared * moved * SMOOTH, draw=day), "field spectrum": Errors(own * moved * SMOOTH)}
        predicted[name + day] = SpectralEstimate(moved, sum(e.covariance for e in rows.values()), errors=rows)
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
        half = 1.959964 * 0.04 * np.hypot(1, tilt) / np.sqrt(averaged)
        assert np.log((1 + level.upper) / (1 + level.value)) == pytest.approx(half, rel=1e-3)
    rows = rows_of(both())
    found = rows["joint_difference_ratio@450-700"].value, rows["p_value_between@450-700"].value
    assert found == pytest.approx((0.1, 1.0), abs=1e-12)
    assert rows["sensor_gain@415"].value == pytest.approx(1 / 1.1) == rows["sensor_gain_beside_offset@525"].value


def test_an_input_that_shows_in_all_pieces_is_none_of_the_sensor():
    # Light that is off by two of its uncertainties, and twice as much on the lot, is found by what the sites differ in.
    rows = rows_of(both(shared=(0.04, 0.04, 0.08), own=0.001, calibration=0, noise=0.0005, light=2))
    gains = np.array([(r.lower, r.value, r.upper) for r in rows.values() if r.metric.startswith("sensor_gain@")])
    assert np.all((gains[:, 0] < 1 / 1.1) & (gains[:, 2] > 1 / 1.1) & (np.ptp(gains[:, 1]) < 0.02))
    assert "aerosol 1.9" in rows["unstated_difference_ratio"].reason


def two_days(rng):
    """The same sites on two days, which share the sensor and not the atmosphere."""
    gain = rng.standard_normal(B)
    lines = both(rng, gain=gain), both(rng, day="2", gain=gain)
    return [type(a)(AXIS, radiance={**a.radiance, **b.radiance}) for a, b in zip(*lines, strict=True)]


def rough(rng):
    return both(rng, shared=(0.03, 0.02, 0.06), unstated=0.015)


@pytest.mark.simulation
@pytest.mark.parametrize("world", [both, two_days, rough])
def test_intervals_hold_the_truth_and_subjects_differ_as_stated(world):
    # 500 draws: the share of 0.95 lies within 0.92 to 0.975 in all but 1 of 300 runs, and so does that of p-values.
    rng, found = np.random.default_rng(5), []
    truths = {"joint_difference_ratio@450-700": 0.1, "joint_difference_ratio@400-450": 0.1, "sensor_gain@": 1 / 1.1}
    truths |= {"sensor_gain_beside_offset@": 1 / 1.1, "sensor_offset@": 0.0}
    for _ in range(500):
        rows = rows_of(world(rng))
        every = [([r for r in rows.values() if r.metric.startswith(name)], truth) for name, truth in truths.items()]
        found.append([np.mean([r.lower <= truth <= r.upper for r in some]) for some, truth in every])
        found[-1].append(rows["p_value_between@450-700"].value > 0.05)
    held = np.mean(found, axis=0)
    assert np.all(np.abs(held - 0.9475) < 0.0275), held
