"""Wavelengths against features: shifts that were made are found, on closed forms and on measured spectra."""

import functools
import os
from pathlib import Path

import numpy as np
import pytest

from hyperval import pixels
from hyperval.compare import compare_spectra
from hyperval.observe import wavelength_notes
from hyperval.products import SpectralEstimate
from hyperval.spectra import SpectralAxis

OXYGEN, WATER, _ = pixels.FEATURES


SITES = ("184227_rdn_v2p11_AstroGreenBaseball", "184227_rdn_v2p11_BeckmanLawn", "184829_rdn_v2p11_darklot")


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
    centre, depth = pixels.absorption_centre(w, level * (1.0 - lines), OXYGEN)
    assert centre == pytest.approx((0.3 * 761.9 + 0.5 * 763.9) / 0.8, abs=0.05)
    assert 0.5 < depth < 0.8


@pytest.mark.parametrize("name", SITES)
def test_collected_spectra_stand_where_they_should_and_planted_shifts_are_found(name):
    w, radiance = site(name)
    bands = np.full(w.size, 5.5)
    unmoved = {s.feature: s for s in pixels.wavelength_shifts(radiance, SpectralAxis(w, bands))}
    assert set(unmoved) == {f.name for f in pixels.FEATURES}
    assert not any(s.is_significant for s in unmoved.values())
    for planted in (2.0, 5.0, 10.0, -2.0, -5.0, -10.0):
        found = {s.feature: s for s in pixels.wavelength_shifts(radiance, SpectralAxis(w + planted, bands))}
        for feature, shift in found.items():
            assert shift.nm - unmoved[feature].nm == pytest.approx(planted, abs=0.05)
        # The oxygen band sees 5 nm with certainty on every site; 2 nm from the side on which it stood.
        if abs(planted) >= 5.0:
            assert found[OXYGEN.name].is_significant
            assert found[WATER.name].is_significant


def test_a_shift_is_warned_of_in_the_notes():
    (w, *_), means = zip(*map(site, SITES), strict=True)
    (told,) = wavelength_notes(means, SpectralAxis(w, np.full(w.size, 5.5)), reflectance=False)
    assert "oxygen A band +0." in told
    assert "shown by 3 of the spectra" in told
    for planted in (2.0, 5.0, 10.0):
        notes = wavelength_notes(means, SpectralAxis(w + planted, np.full(w.size, 5.5)), reflectance=False)
        warned = [n for n in notes if n.startswith("warning: the oxygen A band lies ")]
        assert len(warned) == 1
        assert float(warned[0].split()[6]) == pytest.approx(planted, abs=1.0)


def test_what_cannot_be_checked_is_said():
    axis = SpectralAxis(np.linspace(400, 700, 50), np.full(50, 6.0))
    assert wavelength_notes([np.ones(50)], axis, reflectance=True) == [
        "the wavelengths could not be checked: no spectrum shows a red edge of plants or a residual of the oxygen band"
    ]


@pytest.mark.simulation
def test_the_uncertainty_of_a_centre_is_its_spread_over_draws():
    """1,000 draws of noise and of errors over 6 nm: standard error of a spread 2.2 %, limit 15 %: six of them,
    and first order, in a window that stays.  A level common to all bands moves no centre."""
    w = np.arange(700.0, 830.0, 2.5)
    y = (40.0 - 0.05 * (w - 760.0)) * (1.0 - 0.5 * np.exp(-0.5 * ((w - 762.9) / 4.0) ** 2))
    u = 0.02 * y
    for length in (1e-6, 6.0):
        c = np.outer(u, u) * np.exp(-0.5 * ((w[:, None] - w) / length) ** 2)
        root = np.linalg.cholesky(c + 1e-12 * np.eye(w.size))
        rng = np.random.default_rng(31)
        drawn = (y + root @ rng.standard_normal(w.size) for _ in range(1000))
        found = np.array([pixels.absorption_centre(w, one, OXYGEN)[0] for one in drawn])
        stated = pixels.centre_uncertainty(w, y, c, OXYGEN, pixels.absorption_centre(w, y, OXYGEN)[0])
        assert stated == pytest.approx(found.std(), rel=0.15)
    assert pixels.centre_uncertainty(w, y, np.outer(u, u), OXYGEN, 762.9) < 1e-3 * stated


@pytest.mark.parametrize("shift", [0.0, 1.0, -2.5])
def test_a_shift_of_one_side_is_the_difference_of_the_centres(shift):
    """Predicted less measured, and the interval by the stated errors of both sides."""
    w = np.arange(700.0, 830.0, 2.5)

    def side(centre):
        y = (40.0 - 0.05 * (w - 760.0)) * (1.0 - 0.5 * np.exp(-0.5 * ((w - centre) / 4.0) ** 2))
        return SpectralEstimate(y, np.diag((0.01 * y) ** 2), None, 100)

    rows = compare_spectra(side(762.9 + shift), side(762.9), SpectralAxis(w, np.full(w.size, 5.0)))
    (row,) = [r for r in rows if r.metric.startswith("absorption_centre_difference")]
    assert row.metric.endswith("@oxygen-763")
    assert row.value == pytest.approx(shift, abs=0.05)
    assert row.lower < shift < row.upper
    assert 0.1 < row.upper - row.lower < 1.0


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


@pytest.mark.parametrize("surface", [grass, roof])
@pytest.mark.parametrize("too_much", [0.8, 1.0, 1.2])
@pytest.mark.parametrize("shift", [-5.0, -2.0, 1.0, 2.0, 5.0])
def test_a_planted_shift_is_found(surface, too_much, shift):
    found = pixels.oxygen_residual(*compensated(shift, too_much, surface))
    assert found is not None
    assert abs(found.nm - shift) < 1.25
    assert 1.0 < found.uncertainty_nm < 1.3


@pytest.mark.parametrize(("too_much", "relabelled"), [(0.6, 0.0), (1.5, 0.0), (0.8, -8.0), (0.8, 3.0), (0.8, 5.0)])
def test_too_much_or_too_little_oxygen_lies_where_the_labels_are(too_much, relabelled):
    labels, reflectance, fwhm = compensated(0.0, too_much, grass)
    found = pixels.oxygen_residual(labels + relabelled, reflectance, fwhm)  # by whoever changed them afterwards
    assert found.nm == pytest.approx(relabelled, abs=0.3)


def test_where_nothing_is_left_nothing_is_said():
    """One draw in a thousand at most is taken for a rest: more than one of 60 with 0.0017."""
    rng = np.random.default_rng(3)
    w = np.arange(735.0, 795.0, 3.6)
    draws = [roof(w) * (1.0 + 0.005 * rng.standard_normal(w.size)) for _ in range(60)]
    assert sum(pixels.oxygen_residual(w, y, np.full(w.size, 4.8)) is not None for y in draws) <= 1
    assert pixels.oxygen_residual(w, roof(w), np.full(w.size, 4.8)) is None
    coarse = np.arange(735.0, 795.0, 10.0)
    assert pixels.oxygen_residual(coarse, grass(coarse), np.full(coarse.size, 10.0)) is None


@pytest.mark.data
def test_the_wavelengths_of_a_compensated_image_are_checked_to_a_nanometre():
    root = Path(os.environ.get("HYPERVAL_DATA") or "-") / "hysu/image_spectra_hyspex_135bands.csv"
    if not root.is_file():
        pytest.skip("needs HYPERVAL_DATA: hysu")
    table = np.genfromtxt(root, delimiter=",")[1:]
    w = table[:, 0] * (1000.0 if table[0, 0] < 10.0 else 1.0)
    fwhm = np.full(w.size, 4.76)
    stands = [(y, s) for y in table.T[1:] if (s := pixels.oxygen_residual(w, y, fwhm)) is not None]
    assert len(stands) >= 3  # of six materials, the rest of which varies more
    assert all(abs(s.nm) < 1.0 for _, s in stands)
    notes = wavelength_notes([stands[0][0]], SpectralAxis(w, fwhm), reflectance=True)
    assert any("rest of the oxygen A band" in note for note in notes)


NM = np.arange(740.0, 790.0, 2.5)


def dip(nm=NM, centre=762.9, depth=0.4):
    return 10.0 * (1.0 - depth * np.exp(-0.5 * ((nm - centre) / 4.0) ** 2))


WIDE = np.arange(400.0, 1250.0, 5.0)


def spectrum_at(nm, shift):
    out = np.full(nm.size, 10.0)
    for feature, width, depth in zip(pixels.FEATURES, (3.5, 18.0, 15.0), (0.5, 0.6, 0.6), strict=True):
        out *= 1.0 - depth * np.exp(-0.5 * ((nm - feature.centre_nm - shift) / width) ** 2)
    return out


def test_wide_bands_and_few_of_them_tell_nothing():
    wide = SpectralAxis(WIDE, np.full(WIDE.size, 20.0))
    assert pixels.FEATURES[0].name not in {s.feature for s in pixels.wavelength_shifts(spectrum_at(WIDE, 0.0), wide)}
    few = SpectralAxis(WIDE[:3], np.full(3, 5.0))
    assert list(pixels.wavelength_shifts(np.ones(3), few)) == []
    unknown = SpectralAxis(WIDE, np.full(WIDE.size, 5.0))
    assert list(pixels.wavelength_shifts(np.full(WIDE.size, np.nan), unknown)) == []


def test_reflectance_is_looked_at_for_the_red_edge():
    plant = 0.04 + 0.4 / (1.0 + np.exp(-(WIDE - 717.0 - 6.0) / 9.0))
    axis = SpectralAxis(WIDE, np.full(WIDE.size, 5.0))
    found = {s.feature: s.nm for s in pixels.wavelength_shifts(plant, axis, reflectance=True)}
    assert found[pixels.RED_EDGE.name] == pytest.approx(6.0, abs=1.0)
    assert set(found) <= {pixels.RED_EDGE.name, pixels.OXYGEN_RESIDUAL}
    assert np.isnan(pixels.red_edge(WIDE, np.full(WIDE.size, 0.2)))  # nothing rises
    assert np.isnan(pixels.red_edge(WIDE[WIDE < 640.0], plant[WIDE < 640.0]))  # nothing is seen of it


@pytest.mark.parametrize(
    ("kept", "options", "found"),
    [
        (slice(None), {"centre": 765.0}, True),
        (slice(None), {"depth": 0.05}, False),  # hardly anything is absorbed
        (slice(None), {"depth": -0.4}, False),  # light in place of its lack
        (NM < 765.0, {}, False),  # no shoulder after it
        (NM > 762.0, {}, False),  # none before it
        (slice(None, None, 8), {}, False),  # too few bands
        (np.abs(NM - 762.5) > 3.0, {}, False),  # bands left out hide the centre
    ],
)
def test_an_absorption_has_a_centre_where_all_of_it_is_seen(kept, options, found):
    centre, depth = pixels.absorption_centre(NM[kept], dip(**options)[kept], pixels.FEATURES[0])
    assert np.isfinite(centre) == found
    if found:
        assert (depth > 0.3, centre) == (True, pytest.approx(options["centre"], abs=2.5))
