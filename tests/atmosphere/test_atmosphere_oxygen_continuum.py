"""Collision-induced absorption of oxygen: published strengths, closed forms, limits, effect on the terms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from hyperval.atmosphere import (
    OXYGEN,
    AtmosphericState,
    binary_coefficient,
    collision_column,
    pressure_at,
    sixs_terms,
    standard_profile,
)

NITROGEN = 0.7808
US = standard_profile("us-standard-1962")
OFF_NADIR = AtmosphericState(
    model="us-standard-1962",
    aerosol="none",
    ground_altitude_km=0.4,
    sensor_altitude_km=2.3,
    solar_zenith_deg=40.0,
    solar_azimuth_deg=150.0,
    view_zenith_deg=30.0,
    view_azimuth_deg=60.0,
    earth_sun_distance_au=1.0,
)


def strength(low_cm, high_cm):
    nu = np.arange(low_cm, high_cm, 1.0)
    return np.trapezoid(binary_coefficient(nu), nu)


def test_band_strength_at_1270_nm_is_the_published_one():
    # Maté et al., J. Geophys. Res. 104 (1999), 30585, abstract, 296 K: O2-O2 3.499(16)e-4, O2-N2 0.679(36)e-4 cm-2
    # amagat-2.  In air their uncertainty is 2.2 %.
    published = OXYGEN * 3.499e-4 + NITROGEN * 0.679e-4
    assert strength(7500.0, 8600.0) == pytest.approx(published, rel=0.005)


def test_band_strength_at_1060_nm_is_that_of_the_laboratory_within_its_uncertainty():
    # Banerjee et al., Phys. Chem. Chem. Phys. 21 (2019), 1805: 2.10(31)e-4 cm-2 amagat-2 in pure oxygen.  Nitrogen,
    # which would add to it, is not measured there.
    assert abs(strength(9000.0, 11100.0) - OXYGEN * 2.10e-4) < 2.0 * OXYGEN * 0.31e-4


def test_bands_peak_where_they_should_and_end():
    nu = np.arange(7000.0, 12000.0, 1.0)
    k = binary_coefficient(nu)
    first = nu < 8600.0
    assert nu[first][k[first].argmax()] == pytest.approx(7890.0, abs=15.0)
    above_half = nu[first][k[first] > 0.5 * k[first].max()]
    assert above_half[[0, -1]] == pytest.approx([7843.3, 7954.3], abs=2.0)  # where the published values cross it
    assert nu[~first][k[~first].argmax()] == pytest.approx(9375.0, abs=10.0)
    assert np.all(k >= 0.0)
    outside = (nu < 7550) | ((nu > 8490) & (nu < 9100)) | (nu > 11000)
    np.testing.assert_array_equal(k[outside], 0.0)
    assert np.all(k[~outside] > 0.0)


def test_isothermal_air_has_the_column_of_its_closed_form():
    height_km = 8.0
    z = np.linspace(0.0, 100.0, US.altitude_km.size)
    isothermal = replace(
        US, altitude_km=z, pressure_hpa=1013.25 * np.exp(-z / height_km), temperature_k=np.full(z.size, 273.15)
    )
    # rho = exp(-z/H), so rho_O2 rho integrates to OXYGEN H/2
    assert collision_column(isothermal, 0.0) == pytest.approx(OXYGEN * height_km * 1e5 / 2.0, rel=1e-4)
    ratio = collision_column(isothermal, 0.0, 2.0) / collision_column(isothermal, 0.0)
    assert ratio == pytest.approx(1.0 - np.exp(-2.0 * 2.0 / height_km), rel=1e-4)


def test_standard_air_has_the_column_of_a_constant_lapse_rate():
    # Beirle et al., Atmos. Meas. Tech. 15 (2022), 987: hydrostatic air that cools by 6.5 K km-1 from 288.15 K,
    # p/p0 = (T/T0)^a, has integral p^2/T^2 = p0^2 / (T0 lapse (2 a - 1)).
    lapse, t0 = 6.5, 288.15
    a = 9.80665 * 28.9644 / (8.31446 * lapse)
    closed = OXYGEN * 273.15**2 / (t0 * lapse * (2.0 * a - 1.0)) * 1e5
    # The tropopause at 11 km, above which air no longer cools, changes the column by less than 1 %.
    assert collision_column(US, 0.0) == pytest.approx(closed, rel=0.01)


def test_terms_are_dimmed_by_beers_law_along_the_slanted_paths(engine_cache):
    with_it = sixs_terms(OFF_NADIR, engine_cache, False, ratio=None)
    without = sixs_terms(OFF_NADIR, engine_cache, False, oxygen_continuum=False, ratio=None)
    nm = with_it.wavelength_nm

    def squared(z):
        air = pressure_at(US, z) / 1013.25 * 273.15 / np.interp(z, US.altitude_km, US.temperature_k)
        return OXYGEN * air**2 * 1e5

    def vertical(top):
        levels = US.altitude_km[(US.altitude_km > 0.4) & (US.altitude_km < top)]
        return binary_coefficient(1e7 / nm) * quad(squared, 0.4, top, points=levels, limit=200)[0]

    down = np.exp(-vertical(100.0) / np.cos(np.deg2rad(40.0)))
    both = down * np.exp(-vertical(2.3) / np.cos(np.deg2rad(30.0)))
    for name in ("path_radiance", "direct", "adjacency", "gas_transmittance"):
        np.testing.assert_allclose(getattr(with_it, name), getattr(without, name) * both, rtol=1e-4)
    np.testing.assert_allclose(with_it.ground_irradiance, without.ground_irradiance * down, rtol=1e-4)
    np.testing.assert_array_equal(with_it.spherical_albedo, without.spherical_albedo)
    np.testing.assert_array_equal(with_it.diffuse_fraction, without.diffuse_fraction)
    outside = (nm < 909.0) | ((nm > 1100.0) & (nm < 1177.0)) | (nm > 1325.0)
    np.testing.assert_array_equal(with_it.direct[outside], without.direct[outside])
    assert both.min() == pytest.approx(0.88, abs=0.02)
    assert (with_it.provenance["oxygen_continuum"], without.provenance["oxygen_continuum"]) == (True, False)
