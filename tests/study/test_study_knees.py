"""The knee against closed forms."""

import numpy as np
import pytest

from hyperval.study import knee

U = np.linspace(0.0, 1.0, 41)
SATURATING = 1.0 - np.exp(-6.0 * U)


def test_exponential_saturation_by_hand():
    """v = c (1 - exp(-k u)), c = 1 / (1 - exp(-k)), has the slope s = c k exp(-k u) and the curvature
    k s / (1 + s^2)^(3/2), which is greatest at s^2 = 1/2, so u = ln(sqrt(2) c k) / k."""
    k = 6.0
    x = np.linspace(0.0, 50.0, 401)
    found = knee(x, 3.0 + 2.0 * (1.0 - np.exp(-k * x / 50.0)))
    c = 1.0 / (1.0 - np.exp(-k))
    assert found.x == pytest.approx(50.0 * np.log(np.sqrt(2.0) * c * k) / k, rel=2e-3)
    assert found.curvature == pytest.approx(k * np.sqrt(0.5) / 1.5**1.5, rel=2e-3)


def test_units_and_the_logarithm_of_the_input():
    plain, scaled = knee(U, SATURATING), knee(10.0 ** (2.0 * U), SATURATING, logarithmic=True)
    assert knee(1000.0 * U, 0.01 * SATURATING).x == pytest.approx(1000.0 * plain.x, rel=1e-9)
    assert np.log10(scaled.x) / 2.0 == pytest.approx(plain.x, rel=1e-9)


def test_concave_and_convex_parts_of_an_s_curve():
    x = np.linspace(-1.0, 1.0, 81)
    up, down = (knee(x, np.tanh(4.0 * x), bend=bend) for bend in ("convex", "concave"))
    assert up.x == pytest.approx(-down.x, abs=1e-6)
    assert up.x < 0.0 < down.x


@pytest.mark.parametrize(
    ("y", "bend", "reason"),
    [
        (np.ones(9), "any", "flat"),
        (np.linspace(0, 1, 9) ** 2, "concave", "concave"),
        (np.full(9, np.nan), "any", "0 points"),
        (np.linspace(0, 1, 9) ** 2, "any", "end of the range"),
    ],
)
def test_no_knee_is_an_answer(y, bend, reason):
    found = knee(np.linspace(0.0, 1.0, 9), y, bend=bend)
    assert np.isnan(found.x)
    assert reason in found.reason
