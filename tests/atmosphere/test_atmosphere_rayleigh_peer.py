"""Path radiance of clear air under an aircraft against another solver: SASKTRAN2, vector, discrete ordinates."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.atmosphere import AtmosphericState, extraterrestrial_irradiance, standard_profile

NM = np.array([412.5, 442.5, 487.5, 550.0, 670.0, 860.0])  # 6S computes scattering here; no gas but a trace of ozone
# (ground km, sensor km, solar zenith, view zenith, relative azimuth [deg]) -> path reflectance pi L_a / (mu0 E0),
# midlatitude summer, black ground, SASKTRAN2 2026.10.1 with the settings below.
PEER = {
    (0.3, 2.3, 40.0, 0.0, 0.0): [0.024272, 0.018507, 0.012619, 0.0077657, 0.0034827, 0.001261],
    (0.3, 5.0, 40.0, 20.0, 150.0): [0.045316, 0.03422, 0.02311, 0.014108, 0.0062756, 0.0022614],
    (0.3, 2.3, 60.0, 0.0, 0.0): [0.025819, 0.020285, 0.014277, 0.0090283, 0.0041517, 0.0015237],
}


@pytest.mark.parametrize("case", PEER)
def test_airborne_rayleigh_path_radiance_within_1_percent(terms_of, case):
    ground, sensor, zenith, view, azimuth = case
    state = AtmosphericState(
        aerosol="none", ozone_atm_cm=0.01, water_vapour_g_cm2=0.01, ground_altitude_km=ground,
        sensor_altitude_km=sensor, solar_zenith_deg=zenith, solar_azimuth_deg=azimuth, view_zenith_deg=view,
        day_of_year=100,
    )  # fmt: skip
    terms = terms_of(state)
    irradiance = extraterrestrial_irradiance(state.solar_spectrum, terms.wavelength_nm, state.distance_au)
    reflectance = np.pi * terms.path_radiance / (np.cos(np.deg2rad(zenith)) * irradiance)
    ours = np.interp(NM, terms.wavelength_nm, reflectance)
    np.testing.assert_allclose(ours, PEER[case], rtol=0.01)


@pytest.mark.parametrize("case", PEER)
def test_the_peer_still_says_so(case):
    sk = pytest.importorskip("sasktran2", reason="the package sasktran2 is not installed")
    ground, sensor, zenith, view, azimuth = case
    mu0 = np.cos(np.deg2rad(zenith))
    levels = np.concatenate([np.arange(ground * 1e3, 20e3, 250.0), np.arange(20e3, 100.1e3, 1000.0)])
    settings = sk.Config()
    settings.num_streams, settings.num_stokes = 16, 3
    settings.multiple_scatter_source = sk.MultipleScatterSource.DiscreteOrdinates
    settings.single_scatter_source = sk.SingleScatterSource.Exact
    geometry = sk.Geometry1D(
        mu0, 0.0, 6.371e6, levels, sk.InterpolationMethod.LinearInterpolation, sk.GeometryType.PlaneParallel
    )
    viewing = sk.ViewingGeometry()
    # Its azimuth is that of the line of sight, ours that of the sensor.
    viewing.add_ray(sk.GroundViewingSolar(mu0, np.deg2rad(180.0 - azimuth), np.cos(np.deg2rad(view)), sensor * 1e3))
    air = sk.Atmosphere(geometry, settings, wavelengths_nm=NM, calculate_derivatives=False)
    profile = standard_profile("midlatitude-summer")
    height = profile.altitude_km * 1e3
    air.pressure_pa = 100.0 * np.exp(np.interp(levels, height, np.log(profile.pressure_hpa)))
    air.temperature_k = np.interp(levels, height, profile.temperature_k)
    air["rayleigh"] = sk.constituent.Rayleigh()
    air["surface"] = sk.constituent.LambertianSurface(0.0)
    radiance = sk.Engine(settings, geometry, viewing).calculate_radiance(air)["radiance"]
    found = radiance.isel(stokes=0).to_numpy().squeeze() * np.pi / mu0
    np.testing.assert_allclose(found, PEER[case], rtol=2e-3)
