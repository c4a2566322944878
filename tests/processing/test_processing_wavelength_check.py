"""Wavelengths against features: planted shifts are found, on closed forms and on collected spectra."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from hyperval.compare import compare_spectra
from hyperval.observe import wavelength_notes
from hyperval.processing import FEATURES, RED_EDGE, absorption_centre, centre_uncertainty, red_edge, wavelength_shifts
from hyperval.products import SpectralEstimate
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import builtin_class

OXYGEN, WATER, _ = FEATURES
SITES = ("184227_rdn_v2p11_AstroGreenBaseball", "184227_rdn_v2p11_BeckmanLawn", "184829_rdn_v2p11_darklot")
PLANTED = (2.0, 5.0, 10.0, -2.0, -5.0, -10.0)


def site(name: str) -> tuple[np.ndarray, np.ndarray]:
    root = os.environ.get("HYPERVAL_DATA")
    path = Path(root or "-") / f"pasadena/remote/ang20171108t{name}.txt"
    if not path.is_file():
        pytest.skip("needs HYPERVAL_DATA: pasadena")
    table = np.loadtxt(path)
    return table[:, 0] * (1000.0 if table[0, 0] < 10.0 else 1.0), table[:, 1]


@pytest.mark.parametrize("width", [2.0, 4.0])
def test_the_centre_of_an_absorption_is_its_first_moment_whatever_the_band_width(width):
    # Two lines of unequal depth; the moment of their sum is the average by area, 762.9 + 0.25.
    w = np.arange(700.0, 830.0, 1.0)
    lines = 0.3 * np.exp(-0.5 * ((w - 761.9) / width) ** 2) + 0.5 * np.exp(-0.5 * ((w - 763.9) / width) ** 2)
    level = 40.0 - 0.1 * (w - 760.0)
    centre, depth = absorption_centre(w, level * (1.0 - lines), OXYGEN)
    assert centre == pytest.approx((0.3 * 761.9 + 0.5 * 763.9) / 0.8, abs=0.05)
    assert 0.5 < depth < 0.8


def test_a_spectrum_without_the_absorption_has_no_centre():
    w = np.arange(700.0, 830.0, 1.0)
    assert np.isnan(absorption_centre(w, 40.0 - 0.1 * (w - 760.0), OXYGEN)[0])
    assert list(wavelength_shifts(np.ones(50), SpectralAxis(np.linspace(400, 700, 50), np.full(50, 6.0)))) == []


def test_the_red_edge_lies_at_half_of_the_rise():
    w = np.arange(640.0, 820.0, 2.0)
    assert red_edge(w, 0.05 + 0.4 / (1.0 + np.exp(-(w - 718.0) / 8.0))) == pytest.approx(718.0, abs=0.3)
    assert np.isnan(red_edge(w, np.full(w.size, 0.2)))
    grass = builtin_class("grass", SpectralAxis(w, np.full(w.size, 4.0))).mean
    assert abs(red_edge(w, grass) - RED_EDGE.centre_nm) < 2.0 * RED_EDGE.uncertainty_nm


@pytest.mark.parametrize("name", SITES)
def test_collected_spectra_stand_where_they_should_and_planted_shifts_are_found(name):
    w, radiance = site(name)
    bands = np.full(w.size, 5.5)
    unmoved = {s.feature: s for s in wavelength_shifts(radiance, SpectralAxis(w, bands))}
    assert set(unmoved) == {f.name for f in FEATURES}
    assert not any(s.certain for s in unmoved.values())
    for planted in PLANTED:
        found = {s.feature: s for s in wavelength_shifts(radiance, SpectralAxis(w + planted, bands))}
        for feature, shift in found.items():
            assert shift.nm - unmoved[feature].nm == pytest.approx(planted, abs=0.05)
        # The oxygen band sees 5 nm with certainty on every site; 2 nm from the side on which it stood.
        if abs(planted) >= 5.0:
            assert found[OXYGEN.name].certain
            assert found[WATER.name].certain


def test_a_shift_is_warned_of_in_the_notes():
    spectra = [site(name) for name in SITES]
    w = spectra[0][0]
    means = [radiance for _, radiance in spectra]
    (told,) = wavelength_notes(means, SpectralAxis(w, np.full(w.size, 5.5)), reflectance=False)
    assert "oxygen A band +0." in told
    assert "3 spectra" in told
    for planted in (2.0, 5.0, 10.0):
        notes = wavelength_notes(means, SpectralAxis(w + planted, np.full(w.size, 5.5)), reflectance=False)
        warned = [n for n in notes if n.startswith("warning: the oxygen A band lies ")]
        assert len(warned) == 1
        assert float(warned[0].split()[6]) == pytest.approx(planted, abs=1.0)


def test_what_cannot_be_checked_is_said():
    axis = SpectralAxis(np.linspace(400, 700, 50), np.full(50, 6.0))
    assert wavelength_notes([np.ones(50)], axis, reflectance=True) == [
        "the wavelengths could not be checked: no spectrum shows a red edge of plants or a rest of the oxygen band"
    ]


def test_an_absorption_of_which_bands_are_left_out_has_no_centre():
    # The polished products leave out the middle of the water vapour at 940 nm: what remains of it lies to one side.
    w = np.arange(820.0, 1080.0, 5.0)
    radiance = 10.0 * (1.0 - 0.6 * np.exp(-0.5 * ((w - WATER.centre_nm) / 20.0) ** 2))
    assert absorption_centre(w, radiance, WATER)[0] == pytest.approx(WATER.centre_nm, abs=0.5)
    kept = (w < 919.0) | (w > 964.0)
    assert np.isnan(absorption_centre(w[kept], radiance[kept], WATER)[0])


@pytest.mark.simulation
def test_the_uncertainty_of_a_centre_is_its_spread_over_draws():
    """1,000 draws of noise and of errors over 6 nm: standard error of a spread 2.2 %, limit 15 %: six of them,
    and first order, which leaves the line between the shoulders out."""
    w = np.arange(700.0, 830.0, 2.5)
    y = (40.0 - 0.05 * (w - 760.0)) * (1.0 - 0.5 * np.exp(-0.5 * ((w - 762.9) / 4.0) ** 2))
    u = 0.02 * y
    for length in (1e-6, 6.0):
        c = np.outer(u, u) * np.exp(-0.5 * ((w[:, None] - w) / length) ** 2)
        root = np.linalg.cholesky(c + 1e-12 * np.eye(w.size))
        rng = np.random.default_rng(31)
        found = np.array([absorption_centre(w, y + root @ rng.standard_normal(w.size), OXYGEN)[0] for _ in range(1000)])
        stated = centre_uncertainty(w, y, c, OXYGEN, absorption_centre(w, y, OXYGEN)[0])
        assert stated == pytest.approx(found.std(), rel=0.15)


@pytest.mark.parametrize("shift", [0.0, 1.0, -2.5])
def test_a_shift_of_one_side_is_the_difference_of_the_centres(shift):
    """Predicted less measured, and the interval by the stated errors of both sides."""
    w = np.arange(700.0, 830.0, 2.5)

    def side(centre):
        y = (40.0 - 0.05 * (w - 760.0)) * (1.0 - 0.5 * np.exp(-0.5 * ((w - centre) / 4.0) ** 2))
        return SpectralEstimate(y, np.diag((0.01 * y) ** 2), None, 100)

    rows = compare_spectra(
        side(762.9 + shift), side(762.9), product="radiance", subject="s", method="m",
        axis=SpectralAxis(w, np.full(w.size, 5.0)),
    )  # fmt: skip
    (row,) = [r for r in rows if r.metric.startswith("absorption_centre_difference")]
    assert row.metric.endswith("@oxygen-763")
    assert row.value == pytest.approx(shift, abs=0.05)
    assert row.lower < shift < row.upper
    assert 0.1 < row.upper - row.lower < 1.0
