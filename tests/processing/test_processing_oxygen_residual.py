"""What a compensation leaves of the oxygen band: a planted shift is found, and nothing where nothing is left."""

from __future__ import annotations

import functools
import os
from pathlib import Path

import numpy as np
import pytest

from hyperval.observe import wavelength_notes
from hyperval.processing import RANGE_NM, oxygen_absorption, oxygen_residual
from hyperval.spectra import SpectralAxis

FINE = np.arange(735.0, 795.0, 0.002)
# The band line by line, from the constants of the molecule: origin, rotation below and above [cm-1] (Huber &
# Herzberg, Constants of Diatomic Molecules, 1979); air of 270 K, half width 0.05 cm-1.
ORIGIN, BELOW, ABOVE, THERMAL, HALF_WIDTH = 13120.91, 1.4377, 1.3913, 187.7, 0.05
PATH = 280.0  # optical depth in the middle of the strongest lines, about


@functools.cache
def transmitted(path: float) -> np.ndarray:
    """Lorentz lines of odd rotation, the two branches twice each, 2 cm-1 apart."""
    depth, wavenumber = np.zeros(FINE.size), 1e7 / FINE
    for n in range(1, 40, 2):
        strength = path * n / 8.0 * np.exp(-BELOW * n * (n + 1) / THERMAL)
        for m in (-n, n + 1):
            line = ORIGIN + (ABOVE + BELOW) * m + (ABOVE - BELOW) * m**2
            for part in (0.0, 2.0):
                depth += strength * HALF_WIDTH**2 / ((wavenumber - line - part) ** 2 + HALF_WIDTH**2)
    return np.exp(-depth)


def through_bands(spectrum: np.ndarray, centres: np.ndarray, fwhm: float) -> np.ndarray:
    weight = np.exp(-0.5 * ((FINE - centres[:, None]) * 2.3548 / fwhm) ** 2)
    return np.asarray((weight @ spectrum) / weight.sum(axis=1))


def compensated(shift: float, too_much: float, surface, step: float = 3.6, fwhm: float = 4.8):
    """Reflectance of bands that are labelled ``shift`` above their places, with a path that is off by a factor."""
    labels = np.arange(735.0, 795.0, step)
    seen = through_bands(surface(FINE) * transmitted(PATH), labels - shift, fwhm)
    return labels, seen / through_bands(transmitted(PATH * too_much), labels, fwhm), np.full(labels.size, fwhm)


def grass(w):
    return 0.25 + 0.1 / (1.0 + np.exp(-(w - 745.0) / 12.0))


def roof(w):
    return 0.2 + 3e-4 * (w - 760.0)


def test_the_stand_in_has_the_strength_and_the_place_of_the_band():
    absorbed = 1.0 - transmitted(PATH)
    assert 3.0 < np.trapezoid(absorbed, FINE) < 6.0
    assert np.trapezoid(absorbed * FINE, FINE) / np.trapezoid(absorbed, FINE) == pytest.approx(763.0, abs=0.5)
    w = np.arange(700.0, 830.0, 0.5)
    assert np.trapezoid(oxygen_absorption(w, np.full(w.size, 5.0)), w) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("surface", [grass, roof])
@pytest.mark.parametrize("too_much", [0.8, 1.0, 1.2])
@pytest.mark.parametrize("shift", [-5.0, -2.0, 1.0, 2.0, 5.0])
def test_a_planted_shift_is_found(surface, too_much, shift):
    found = oxygen_residual(*compensated(shift, too_much, surface))
    assert found is not None
    assert abs(found.shift_nm - shift) < 1.25
    assert 1.0 < found.uncertainty_nm < 1.3


def test_too_much_or_too_little_oxygen_is_no_shift():
    for too_much in (0.6, 1.5):
        found = oxygen_residual(*compensated(0.0, too_much, roof))
        assert found is not None
        assert abs(found.shift_nm) < 0.3


def test_where_nothing_is_left_nothing_is_said():
    """One draw in a thousand at most is taken for a rest: more than one of 60 with 0.0017."""
    rng = np.random.default_rng(3)
    w = np.arange(735.0, 795.0, 3.6)
    draws = [roof(w) * (1.0 + 0.005 * rng.standard_normal(w.size)) for _ in range(60)]
    assert sum(oxygen_residual(w, y, np.full(w.size, 4.8)) is not None for y in draws) <= 1
    assert oxygen_residual(w, roof(w), np.full(w.size, 4.8)) is None
    coarse = np.arange(735.0, 795.0, 10.0)
    assert oxygen_residual(coarse, grass(coarse), np.full(coarse.size, 10.0)) is None


@pytest.mark.data
def test_the_wavelengths_of_a_compensated_image_are_checked_to_a_nanometre():
    root = Path(os.environ.get("HYPERVAL_DATA") or "-") / "hysu/image_spectra_hyspex_135bands.csv"
    if not root.is_file():
        pytest.skip("needs HYPERVAL_DATA: hysu")
    table = np.genfromtxt(root, delimiter=",", names=True)
    names = table.dtype.names
    w = table[names[0]]
    w = w * (1000.0 if w[0] < 10.0 else 1.0)
    fwhm = np.full(w.size, 4.76)
    stands = [oxygen_residual(w, table[name], fwhm) for name in names[1:]]
    assert sum(s is not None for s in stands) >= 3  # of six materials, the rest of which varies more
    assert all(abs(s.shift_nm) < 1.0 for s in stands if s is not None)
    y = next(table[name] for name, s in zip(names[1:], stands, strict=True) if s is not None)
    (told,) = [n for n in wavelength_notes([y], SpectralAxis(w, fwhm), reflectance=True) if "rest of the" in n]
    assert "rest of the oxygen A band" in told
    near = (w > RANGE_NM[0] - 20.0) & (w < RANGE_NM[1] + 20.0)
    for shift in (-5.0, 5.0):
        k, there = oxygen_absorption(w, fwhm), oxygen_absorption(w - shift, fwhm)
        moved = np.where(near, y * (1.0 - 4.5 * there) / (1.0 - 4.5 * k), y)
        notes = wavelength_notes([moved], SpectralAxis(w, fwhm), reflectance=True)
        assert any(n.startswith("warning: the rest of the oxygen A band lies") for n in notes)
