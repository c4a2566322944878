"""Fills under a point spread function that differs along and across the track (f of 3.10)."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.errors import UsageError
from hyperval.model import TargetGeometry, pixel_fills
from hyperval.spectra import SIGMA_PER_FWHM

BLUR = (1.4, 0.3)  # along (y), across (x)


def geometry(blur, heading=0.0, length=1.3, width=0.6) -> TargetGeometry:
    return TargetGeometry(length, width, 1.0, heading, blur)


def test_a_turn_by_a_right_angle_changes_the_directions():
    # A target turned by 90 degrees under blur (a, b) is the mirror image of the target under blur (b, a).
    fills = pixel_fills(geometry(BLUR), np.array([[0.2, 0.1]]), np.array([90.0]))[0]
    mirror = pixel_fills(geometry(BLUR[::-1]), np.array([[0.1, 0.2]]), np.array([0.0]))[0]
    assert fills == pytest.approx(mirror.T, abs=1e-9)


def test_rotated_target_by_counting_points():
    """1e6 ground points of the target, each with its own blurred position; |z| < 5, false failure 6e-7."""
    rng = np.random.default_rng(77)
    n, angle = 1_000_000, np.deg2rad(35.0)
    u, v = rng.uniform(-0.65, 0.65, n), rng.uniform(-0.3, 0.3, n)
    # Clockwise from the y axis: the length runs along (sin, cos), the width along (cos, -sin).
    x, y = u * np.sin(angle) + v * np.cos(angle) + 0.2, u * np.cos(angle) - v * np.sin(angle) - 0.1
    x += rng.normal(0, BLUR[1] * SIGMA_PER_FWHM, n)
    y += rng.normal(0, BLUR[0] * SIGMA_PER_FWHM, n)
    part = ((np.abs(x) <= 0.5) & (np.abs(y) <= 0.5)).mean()
    fills = pixel_fills(geometry(BLUR), np.array([[0.2, -0.1]]), np.array([35.0]))[0]
    found = fills[fills.shape[0] // 2, fills.shape[1] // 2] / (1.3 * 0.6)
    assert abs(found - part) < 5 * np.sqrt(part * (1 - part) / n)


def test_a_negative_width_is_refused():
    with pytest.raises(UsageError, match="PSF width not negative"):
        geometry((1.0, -0.1))
