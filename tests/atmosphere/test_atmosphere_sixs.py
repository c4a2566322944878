"""The embedded engine: against the solver's own radiances, closed forms, limits, and its traps."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pytest

from hyperval.atmosphere import AtmosphericState, atmospheric_terms, molecular_albedo, run_sixs, sixs, solar
from hyperval.spectra import in_window

AIRBORNE = {  # 2.65 km above the ground
    "model": "midlatitude-summer", "aot550": 0.2, "ground_altitude_km": 0.35, "sensor_altitude_km": 3.0,
    "solar_zenith_deg": 40.0, "solar_azimuth_deg": 150.0, "earth_sun_distance_au": 1.0,
}  # fmt: skip
RAYLEIGH_FROM_SPACE = {
    "model": "us-standard-1962", "aerosol": "none", "sensor_altitude_km": 705.0, "solar_zenith_deg": 40.0,
    "solar_azimuth_deg": 0.0, "earth_sun_distance_au": 1.0,
}  # fmt: skip


def state(base=AIRBORNE, **changes):
    return AtmosphericState(**{k: v for k, v in {**base, **changes}.items() if v is not None})


def apparent_reflectance(terms, st, rho):
    """pi L / (mu0 E0) on the grid."""
    e0 = solar.extraterrestrial_irradiance(st.solar_spectrum, terms.wavelength_nm, st.distance_au)
    radiance = terms.path_radiance + (terms.direct + terms.adjacency) * rho / (1.0 - terms.spherical_albedo * rho)
    return np.pi * radiance / (e0 * np.cos(np.deg2rad(st.sun[0])))


def at(terms, nm):
    return int(np.flatnonzero(np.abs(terms.wavelength_nm - nm) < 1e-6)[0])


def solver_reflectance(st, nm, rho, folder):
    """The solver's own answer, aerosol, gas and ground together, with its own copy of the standard atmosphere."""
    depth = st.aerosol_optical_depth
    aerosol = sixs.Aerosol(sixs._aerosol_card(st.aerosol), depth, depth * st.aerosol_fraction_below)
    geometry = sixs.SunAndView(st.sun[0], st.view_zenith_deg, (st.sun[1] - st.view_azimuth_deg) % 360.0)
    height = None if st.in_space else st.sensor_altitude_km - st.ground_altitude_km
    deck = sixs.deck(geometry, "2\n", st.ground_altitude_km, height, f"-1\n{nm / 1e3:.4f}", aerosol, rho)
    return sixs.parse_monochromatic(run_sixs(deck, folder)).reflectance


@cache
def as_the_solver(st, folder):
    """Terms without what the solver does not have: absorption by colliding oxygen, the ratio of MODTRAN to it."""
    return sixs.sixs_terms(st, folder, False, oxygen_continuum=False, ratio=None)


@pytest.mark.slow
@pytest.mark.parametrize("nm", [412.5, 480.0, 550.0, 670.0, 820.0, 860.0, 940.0, 1050.0, 1240.0, 1650.0, 2130.0])
def test_ground_part_is_the_solvers_own(engine_cache, nm):
    st = state()
    terms = as_the_solver(st, engine_cache)
    i = at(terms, nm)
    black = apparent_reflectance(terms, st, 0.0)[i]
    their_black = solver_reflectance(st, nm, 0.0, engine_cache)
    for rho in (0.1, 1.0):
        ours = apparent_reflectance(terms, st, rho)[i] - black
        theirs = solver_reflectance(st, nm, rho, engine_cache) - their_black
        # 1e-3, and the half unit of the four decimals in which gas transmittance is printed
        assert ours == pytest.approx(theirs, rel=1e-3 + 5e-5 / terms.gas_transmittance[i])


@pytest.mark.slow
@pytest.mark.parametrize("nm", [442.5, 550.0, 860.0, 1240.0, 1650.0, 2250.0])
def test_path_part_is_the_solvers_own_less_its_extra_molecules(engine_cache, nm):
    # The solver puts some 2 % more molecules below an aircraft as soon as there is any aerosol.  What the
    # least aerosol adds to its clear run is that error; the rest must agree.
    st = state()
    terms = as_the_solver(st, engine_cache)
    i = at(terms, nm)
    ours = apparent_reflectance(terms, st, 0.0)[i]
    theirs = solver_reflectance(st, nm, 0.0, engine_cache)
    least = 0.002
    card = sixs._aerosol_card(st.aerosol)

    def black_ground(depth):
        aerosol = sixs.Aerosol(card, depth, depth * st.aerosol_fraction_below) if depth else None
        deck = sixs.deck(sixs.SunAndView(40, 0, 0), "2\n", 0.35, 2.65, f"-1\n{nm / 1e3:.4f}", aerosol)
        return sixs.parse_monochromatic(run_sixs(deck, engine_cache)).reflectance

    extra = 2 * black_ground(least) - black_ground(2 * least) - black_ground(0.0)
    assert abs(extra) < 0.05 * theirs
    assert ours == pytest.approx(theirs - extra, rel=4e-3, abs=2e-6)


@pytest.mark.slow
def test_reproduces_the_solver_off_nadir_from_space(engine_cache, solver_at):
    st = state(sensor_altitude_km=705.0, view_zenith_deg=30.0, view_azimuth_deg=100.0)
    wavelengths = (442.5, 550.0, 670.0, 860.0, 1650.0)
    solver_at(*wavelengths)
    terms = as_the_solver.__wrapped__(st, engine_cache)
    for nm in wavelengths:
        for rho in (0.0, 0.1, 0.5, 1.0):
            ours = apparent_reflectance(terms, st, rho)[at(terms, nm)]
            gas = terms.gas_transmittance[at(terms, nm)]
            theirs = solver_reflectance(st, nm, rho, engine_cache)
            # 1e-5: the half of the water that is taken to lie above the aerosol
            assert ours == pytest.approx(theirs, rel=5e-4 + 1e-4 / gas, abs=1e-5), (nm, rho)


@pytest.mark.parametrize("base", [AIRBORNE, RAYLEIGH_FROM_SPACE])
def test_limits_hold_at_every_wavelength(terms_of, base):
    terms = terms_of(state(base))
    names = "path_radiance direct adjacency spherical_albedo ground_irradiance gas_transmittance"
    for values in (getattr(terms, name) for name in names.split()):
        assert values.shape == terms.wavelength_nm.shape
        assert np.all(np.isfinite(values))
    assert np.all((terms.spherical_albedo > 0) & (terms.spherical_albedo < 1))
    assert np.all(terms.path_radiance > 0)
    assert np.all(terms.direct > 0)
    assert np.all(terms.adjacency >= 0)
    assert np.all((terms.gas_transmittance > 0) & (terms.gas_transmittance <= 1))
    e0 = solar.extraterrestrial_irradiance(state().solar_spectrum, terms.wavelength_nm)
    incoming = e0 * np.cos(np.deg2rad(40.0))
    # Energy: no more reaches the ground or comes back than comes in.
    assert np.all(terms.ground_irradiance < incoming)
    assert np.all(np.pi * (terms.direct + terms.adjacency) < terms.ground_irradiance * (1 + 1e-3))
    window = in_window(terms.wavelength_nm)
    assert np.all(terms.gas_transmittance[window] > 0.5)


def test_molecular_atmosphere_has_its_published_optical_depth(engine_cache, terms_of):
    # Bodhaine et al., J. Atmos. Oceanic Technol. 16 (1999), table 3: 0.09718 at 550 nm, 1013.25 hPa, 45 N.
    st = state(RAYLEIGH_FROM_SPACE)
    out = run_sixs(sixs.deck(sixs.SunAndView(40.0, 0.0, 0.0), "6\n", 0.0, None, "-1\n0.5500"), engine_cache)
    depth = sixs.parse_monochromatic(out).depth_rayleigh
    assert depth == pytest.approx(0.0972, rel=0.02)
    terms = terms_of(st)
    # Thin conservative Rayleigh layer, first order in tau: path reflectance P(Theta) tau / (4 mu0 mu_v), with the
    # depolarised phase function; S = tau; T_down = 1 - tau / (2 mu0).  At 1240 nm tau = 0.0036.
    i = at(terms, 1240.0)
    mu0 = np.cos(np.deg2rad(40.0))
    tau = 0.0972 * _rayleigh_depth_ratio(1.24, 0.55)
    delta = 0.0279 / (2 - 0.0279)
    gamma = delta
    phase = 3.0 / (4.0 * (1.0 + 2.0 * gamma)) * ((1.0 + 3.0 * gamma) + (1.0 - gamma) * mu0**2)
    path = apparent_reflectance(terms, st, 0.0)[i] / terms.gas_transmittance[i]
    assert path == pytest.approx(phase * tau / (4.0 * mu0), rel=0.03)
    assert terms.spherical_albedo[i] == pytest.approx(tau, rel=0.03)
    # The closed form for molecules, beside what the solver integrates.
    seen = sixs.parse_monochromatic(out)
    assert seen.spherical_albedo == pytest.approx(float(molecular_albedo(np.array(depth))), rel=0.01)
    e0 = solar.extraterrestrial_irradiance(st.solar_spectrum, terms.wavelength_nm)[i]
    down = np.pi * (terms.direct[i] + terms.adjacency[i]) / (mu0 * e0 * terms.gas_transmittance[i])  # T_down T_up
    assert 1.0 - down == pytest.approx(0.5 * tau * (1.0 / mu0 + 1.0), rel=0.03)


def _rayleigh_depth_ratio(um, reference_um):
    def depth(w):  # Bodhaine et al. (1999), equation 30, over a constant
        return (1.0455996 - 341.29061 * w**-2 - 0.9023085 * w**2) / (1 + 0.0027059889 * w**-2 - 85.968563 * w**2)

    return depth(um) / depth(reference_um)


def test_more_water_absorbs_more_and_leaves_windows_alone(terms_of):
    dry, wet = (terms_of(state(water_vapour_g_cm2=w)) for w in (1.0, 3.0))
    assert np.all(wet.gas_transmittance <= dry.gas_transmittance + 1e-4)
    assert wet.gas_transmittance[at(wet, 940.0)] < 0.75 * dry.gas_transmittance[at(dry, 940.0)]
    # 557.5 nm: water has a weak band at 543 nm.
    assert wet.gas_transmittance[at(wet, 557.5)] == pytest.approx(dry.gas_transmittance[at(dry, 557.5)], abs=2e-3)
    np.testing.assert_array_equal(wet.spherical_albedo, dry.spherical_albedo)  # scattering comes from the cache


def test_user_water_column_absorbs_the_same_over_raised_ground(terms_of):
    # The same column over higher ground: thinner air absorbs a little less, not 0.4 of it.
    base = dict(RAYLEIGH_FROM_SPACE, model="midlatitude-summer", water_vapour_g_cm2=1.5)
    low, high = terms_of(state(base)), terms_of(state(base, ground_altitude_km=2.0))
    i = at(low, 940.0)
    ratio = np.log(high.gas_transmittance[i]) / np.log(low.gas_transmittance[i])
    assert 0.85 < ratio < 1.0


@pytest.mark.slow
def test_thin_aerosol_under_an_aircraft_stays_linear(terms_of, engine_cache, solver_at):
    complete = terms_of(state())
    wavelengths = (550.0, 860.0, 1650.0, 2250.0)
    terms_at = solver_at(*wavelengths)
    clean = terms_at(state(aerosol="none", aot550=None))
    share = {}
    for aot in (0.2, 0.02, 0.003):
        st = state(aot550=aot)
        terms = terms_at(st)
        added = terms.path_radiance - clean.path_radiance
        share[aot] = added / (aot * st.aerosol_fraction_below)
        if aot == 0.2:  # run by itself a node has what is found from a table of four decimals
            i = [at(clean, nm) for nm in wavelengths]
            most = {"path_radiance": 5e-3, "direct": 1e-4, "adjacency": 1e-3, "spherical_albedo": 1e-3}
            for name, off in most.items():
                assert getattr(terms, name)[i] == pytest.approx(getattr(complete, name)[i], rel=off)
    for nm in wavelengths:
        i = at(clean, nm)
        assert share[0.003][i] == pytest.approx(share[0.02][i], rel=1e-3)
        # Multiple scattering and the lower place of the thicker haze change the part per depth by a few per cent.
        assert share[0.02][i] == pytest.approx(share[0.2][i], rel=0.1)
    raw = [solver_reflectance(state(aot550=aot), 550.0, 0.0, engine_cache) for aot in (0.02, 0.003)]
    st = state(aot550=0.003)
    ours = apparent_reflectance(terms_at(st), st, 0.0)[at(clean, 550.0)]
    assert raw[1] > ours * 1.01  # the trap is still there, and avoided


@pytest.mark.slow
def test_cached_state_is_equal_and_runs_nothing(tmp_path, monkeypatch, solver_at):
    solver_at(550.0, 860.0)
    st = state(aot550=0.15, water_vapour_g_cm2=2.0)
    first = atmospheric_terms(st, cache_dir=tmp_path, show_progress=False)
    monkeypatch.setattr(sixs, "run_sixs", None)  # called, it would raise TypeError
    again = atmospheric_terms(st, cache_dir=tmp_path, show_progress=False)
    np.testing.assert_array_equal(first.direct, again.direct)
    assert {p.name for p in tmp_path.iterdir()} >= {"gas", "haze", "molecules"}
    assert re.match(r"6S 2\.1 [0-9a-f]{64}", first.provenance["engine"])
    assert first.provenance["state"]["aot550"] == 0.15


def test_azimuth_does_not_matter_at_nadir(terms_of, engine_cache):
    a = terms_of(state())
    entries = set((engine_cache / "haze").iterdir())
    b = terms_of(state(solar_azimuth_deg=20.0))
    np.testing.assert_array_equal(a.path_radiance, b.path_radiance)
    assert set((engine_cache / "haze").iterdir()) == entries


@pytest.mark.slow
def test_view_towards_the_sun_is_brighter_than_away(solver_at):
    terms_at = solver_at(550.0, 860.0)
    # Forward scattering: the sensor on the side opposite the sun looks into the forward peak.
    low = {"sensor_altitude_km": 705.0, "view_zenith_deg": 50.0, "solar_zenith_deg": 60.0, "aot550": 0.3}
    forward = terms_at(state(**low, view_azimuth_deg=330.0))
    backward = terms_at(state(**low, view_azimuth_deg=150.0))
    assert forward.path_radiance[at(forward, 860.0)] > backward.path_radiance[at(backward, 860.0)]


def test_ground_irradiance_agrees_with_an_independent_clear_sky_model(terms_of):
    # SPECTRL2 (Bird & Riordan, SERI/TR-215-2436, 1984) as pvlib has it; same columns, no aerosol, black ground.
    from pvlib import atmosphere, spectrum

    st = state(RAYLEIGH_FROM_SPACE, water_vapour_g_cm2=1.42, ozone_atm_cm=0.344)
    terms = terms_of(st)
    model = spectrum.spectrl2(
        apparent_zenith=40.0, aoi=40.0, surface_tilt=0.0, ground_albedo=0.0, surface_pressure=101325.0,
        relative_airmass=atmosphere.get_relative_airmass(40.0), precipitable_water=1.42, ozone=0.344,
        aerosol_turbidity_500nm=0.0, dayofyear=94,
    )  # fmt: skip
    nm = model["wavelength"]
    theirs = np.ravel(model["poa_global"]) * 100.0  # W m-2 nm-1 to uW cm-2 nm-1
    use = in_window(nm) & (nm > 450.0) & (nm < 1700.0)
    ratio = np.interp(nm[use], terms.wavelength_nm, terms.ground_irradiance) / theirs[use]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.02)
    fine = np.arange(450.0, 1000.0, 1.0)
    total = np.trapezoid(np.interp(fine, terms.wavelength_nm, terms.ground_irradiance), fine)
    assert total == pytest.approx(np.trapezoid(np.interp(fine, nm, theirs), fine), rel=0.03)
