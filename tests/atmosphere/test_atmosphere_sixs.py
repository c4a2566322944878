"""The embedded engine: against the solver's own radiances, closed forms, limits, and its traps."""

import re
from functools import cache, partial

import numpy as np
import pytest

from hyperval import atmosphere as air
from hyperval.atmosphere import NODES_NM, AtmosphericState, run_sixs, sixs, solar
from hyperval.atmosphere import state as profiles
from hyperval.errors import EngineError
from hyperval.spectra import in_window

AIRBORNE = {  # 2.65 km above the ground
    "model": "midlatitude-summer", "aot550": 0.2, "ground_altitude_km": 0.35, "sensor_altitude_km": 3.0,
    "solar_zenith_deg": 40.0, "solar_azimuth_deg": 150.0, "earth_sun_distance_au": 1.0,
}  # fmt: skip
RAYLEIGH_FROM_SPACE = {
    "model": "us-standard-1962", "aerosol": "none", "sensor_altitude_km": 705.0, "solar_zenith_deg": 40.0,
    "solar_azimuth_deg": 0.0, "earth_sun_distance_au": 1.0,
}  # fmt: skip
SUN = sixs.Setting(40.0, 0.0, 0.0, 0.0, None)
MU0 = np.cos(np.deg2rad(40.0))


def state(base=AIRBORNE, **changes):
    return AtmosphericState(**{k: v for k, v in {**base, **changes}.items() if v is not None})


def apparent_reflectance(terms, st, rho):
    """pi L / (mu0 E0) on the grid."""
    e0 = solar.extraterrestrial_irradiance(st.solar_spectrum, terms.wavelength_nm, st.distance_au)
    radiance = terms.path_radiance + (terms.direct + terms.adjacency) * rho / (1.0 - terms.spherical_albedo * rho)
    return np.pi * radiance / (e0 * np.cos(np.deg2rad(st.sun[0])))


def at(terms, nm):
    return int(np.flatnonzero(np.abs(terms.wavelength_nm - nm) < 1e-6)[0])


def solver_reflectance(st, nm, rho, folder, depth=None):
    """The solver's own answer, aerosol, gas and ground together, with its own copy of the standard atmosphere."""
    depth, share = st.aerosol_optical_depth if depth is None else depth, st.aerosol_fraction_below
    aerosol = (sixs._aerosol_card(st.aerosol), depth, depth * share) if depth else None
    deck = sixs.deck(sixs.setting_of(st), "2\n", f"-1\n{nm / 1e3:.4f}", aerosol, rho)
    return sixs.parse_monochromatic(run_sixs(deck, folder))["reflectance"]


@cache
def as_the_solver(st, folder):
    """Terms without what the solver does not have: absorption by colliding oxygen, the ratio of MODTRAN to it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sixs, "continuum_depth", lambda nm, *_: 0.0 * nm)
        return sixs.sixs_terms(st, folder, ratio=None)


@pytest.mark.slow
@pytest.mark.parametrize("nm", [442.5, 550.0, 860.0, 940.0, 1240.0, 1650.0, 2250.0])
def test_both_parts_are_the_solvers_own_less_its_extra_molecules(engine_cache, nm):
    st = state()
    terms = as_the_solver(st, engine_cache)
    i = at(terms, nm)
    black, their_black = apparent_reflectance(terms, st, 0.0)[i], solver_reflectance(st, nm, 0.0, engine_cache)
    for rho in (0.1, 1.0):
        theirs = solver_reflectance(st, nm, rho, engine_cache) - their_black
        # 1e-3, and the half unit of the four decimals in which gas transmittance is printed
        close = pytest.approx(theirs, rel=1e-3 + 5e-5 / terms.gas_transmittance[i])
        assert apparent_reflectance(terms, st, rho)[i] - black == close
    if nm == 940.0:
        return  # the half of the water that is taken to lie above the aerosol shows
    # The solver puts some 2 % more molecules below an aircraft as soon as there is any aerosol.  What the
    # least aerosol adds to its clear run is that error; the rest must agree.
    none, least, twice = (solver_reflectance(st, nm, 0.0, engine_cache, depth) for depth in (0.0, 0.002, 0.004))
    extra = 2 * least - twice - none
    assert abs(extra) < 0.05 * their_black
    assert black == pytest.approx(their_black - extra, rel=4e-3, abs=2e-6)


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
    for name, values in terms.spectra().items():
        assert values.shape == terms.wavelength_nm.shape
        assert np.all(np.isfinite(values))
        assert np.all(values > (-1e-12 if name == "adjacency" else 0.0))
    assert max(terms.spherical_albedo.max(), terms.gas_transmittance.max()) <= 1.0
    incoming = solar.extraterrestrial_irradiance(state().solar_spectrum, terms.wavelength_nm) * MU0
    # Energy: no more reaches the ground or comes back than comes in.
    assert np.all(terms.ground_irradiance < incoming)
    assert np.all(np.pi * (terms.direct + terms.adjacency) < terms.ground_irradiance * (1 + 1e-3))
    assert np.all(terms.gas_transmittance[in_window(terms.wavelength_nm)] > 0.5)


def test_molecular_atmosphere_has_its_published_optical_depth(engine_cache, terms_of):
    # Bodhaine et al., J. Atmos. Oceanic Technol. 16 (1999), table 3: 0.09718 at 550 nm, 1013.25 hPa, 45 N.
    st = state(RAYLEIGH_FROM_SPACE)
    seen = sixs.parse_monochromatic(run_sixs(sixs.deck(SUN, "6\n", "-1\n0.5500"), engine_cache))
    assert seen["depth_rayleigh"] == pytest.approx(0.0972, rel=0.02)
    # The closed form for molecules, beside what the solver integrates.
    assert seen["spherical_albedo"] == pytest.approx(
        float(air.molecular_albedo(np.array(seen["depth_rayleigh"]))), rel=0.01
    )
    terms = terms_of(st)
    # Thin conservative Rayleigh layer, first order in tau: path reflectance P(Theta) tau / (4 mu0 mu_v), with the
    # depolarised phase function; S = tau; T_down = 1 - tau / (2 mu0).  At 1240 nm tau = 0.0036.
    i, gas = at(terms, 1240.0), terms.gas_transmittance[at(terms, 1240.0)]
    depth, depth_550 = (  # Bodhaine et al. (1999), equation 30, over a constant
        (1.0455996 - 341.29061 * w**-2 - 0.9023085 * w**2) / (1 + 0.0027059889 * w**-2 - 85.968563 * w**2)
        for w in (1.24, 0.55)
    )
    tau = 0.0972 * depth / depth_550
    gamma = 0.0279 / (2 - 0.0279)
    phase = 3.0 / (4.0 * (1.0 + 2.0 * gamma)) * ((1.0 + 3.0 * gamma) + (1.0 - gamma) * MU0**2)
    path = apparent_reflectance(terms, st, 0.0)[i] / gas
    assert path == pytest.approx(phase * tau / (4.0 * MU0), rel=0.03)
    assert terms.spherical_albedo[i] == pytest.approx(tau, rel=0.03)
    down = (terms.direct[i] + terms.adjacency[i]) / (terms.diffuser_radiance[i] * gas)  # T_down T_up
    assert 1.0 - down == pytest.approx(0.5 * tau * (1.0 / MU0 + 1.0), rel=0.03)


def test_more_water_absorbs_more_leaves_windows_alone_and_absorbs_the_same_over_raised_ground(terms_of):
    dry, wet = (terms_of(state(water_vapour_g_cm2=w)) for w in (1.0, 3.0))
    i, window = at(wet, 940.0), at(wet, 557.5)  # water has a weak band at 543 nm
    assert np.all(wet.gas_transmittance <= dry.gas_transmittance + 1e-4)
    assert wet.gas_transmittance[i] < 0.75 * dry.gas_transmittance[i]
    assert wet.gas_transmittance[window] == pytest.approx(dry.gas_transmittance[window], abs=2e-3)
    np.testing.assert_array_equal(wet.spherical_albedo, dry.spherical_albedo)  # scattering comes from the cache
    # The same column over higher ground: thinner air absorbs a little less, not 0.4 of it.
    base = dict(RAYLEIGH_FROM_SPACE, model="midlatitude-summer", water_vapour_g_cm2=1.5)
    low, high = (np.log(terms_of(state(base, ground_altitude_km=z)).gas_transmittance[i]) for z in (0.0, 2.0))
    assert 0.85 < high / low < 1.0


@pytest.mark.slow
def test_thin_aerosol_under_an_aircraft_stays_linear(terms_of, engine_cache, solver_at):
    complete = terms_of(state())
    wavelengths = (550.0, 860.0, 1650.0, 2250.0)
    terms_at = solver_at(*wavelengths)
    clean, hazy = terms_at(state(aerosol="none", aot550=None)), {a: terms_at(state(aot550=a)) for a in (0.2, 0.02)}
    i = [at(clean, nm) for nm in wavelengths]
    # Run by itself a node has what is found from a table of four decimals.
    most = {"path_radiance": 5e-3, "direct": 1e-4, "adjacency": 1e-3, "spherical_albedo": 1e-3}
    for name, off in most.items():
        assert getattr(hazy[0.2], name)[i] == pytest.approx(getattr(complete, name)[i], rel=off)
    thin = state(aot550=0.003)
    hazy[0.003] = terms_at(thin)
    few, some, much = (
        (terms.path_radiance - clean.path_radiance)[i] / (depth * state(aot550=depth).aerosol_fraction_below)
        for depth, terms in sorted(hazy.items())
    )
    assert few == pytest.approx(some, rel=1e-3)
    # Multiple scattering and the lower place of the thicker haze change the part per depth by a few per cent.
    assert some == pytest.approx(much, rel=0.1)
    ours = apparent_reflectance(hazy[0.003], thin, 0.0)[i[0]]
    assert solver_reflectance(thin, 550.0, 0.0, engine_cache) > ours * 1.01  # the trap is still there, and avoided


@pytest.mark.slow
def test_cached_state_is_equal_and_runs_nothing(tmp_path, monkeypatch, solver_at):
    solver_at(550.0, 860.0)
    terms_at = partial(air.atmospheric_terms, cache_dir=tmp_path, show_progress=False)
    first = terms_at(state(water_vapour_g_cm2=2.0))
    monkeypatch.setattr(sixs, "run_sixs", None)  # called, it would raise TypeError
    np.testing.assert_array_equal(first.direct, terms_at(state(water_vapour_g_cm2=2.0)).direct)
    turned = terms_at(state(water_vapour_g_cm2=2.0, solar_azimuth_deg=20.0))
    np.testing.assert_array_equal(first.path_radiance, turned.path_radiance)  # at nadir every azimuth is the same
    assert {p.name for p in tmp_path.iterdir()} >= {"gas", "haze", "molecules"}
    assert re.match(r"6S 2\.1 [0-9a-f]{64}", first.provenance["engine"])
    assert first.provenance["state"]["aot550"] == 0.2


@pytest.mark.slow
def test_the_sky_is_the_same_from_an_aircraft_and_from_space_and_the_beam_follows_from_the_depths(solver_at):
    # The airborne runs know the depths below the aircraft alone: the rest comes from their shares.
    terms_at = solver_at(350.0, 412.5, 550.0, 860.0, 1650.0, 2600.0)
    airborne, space = terms_at(state()), terms_at(state(sensor_altitude_km=705.0))
    assert airborne.diffuse_fraction == pytest.approx(space.diffuse_fraction, rel=5e-3, abs=5e-4)
    # At 550 nm: Rayleigh depth 0.0973 at sea level (Bodhaine 1999), 4 % less at 0.35 km; aerosol 0.2; mu0 = cos 40.
    beam = np.exp(-(0.0973 * np.exp(-0.35 / 8.4) + 0.2) / MU0)
    # What is left of the global light after scattering alone: 0.8-0.97 for such a sky.
    assert 0.85 < beam / (1.0 - airborne.diffuse_fraction[at(airborne, 550.0)]) < 0.95
    assert np.all(np.diff(airborne.diffuse_fraction[at(airborne, 400.0) : at(airborne, 1000.0) : 20]) < 0)


@pytest.mark.slow
def test_extinction_of_every_type_is_what_the_solver_prints(engine_cache):
    mix = air.AerosolMix(dust=0.2, water_soluble=0.3, oceanic=0.45, soot=0.05)
    for aerosol in ("rural", "continental", "maritime", "urban", "desert", mix):
        haze = (sixs._aerosol_card(aerosol), 1.0, 1.0)
        for nm in (412.5, 860.0, 2250.0, 2600.0):
            run = sixs.deck(sixs.Setting(0.0, 0.0, 0.0, 0.0, None), "0\n", f"-1\n{nm / 1e3:.4f}", haze)
            printed = sixs.parse_monochromatic(run_sixs(run, engine_cache))["depth_aerosol"]
            assert air.aerosol_extinction(aerosol)[NODES_NM.tolist().index(nm)] == pytest.approx(printed, rel=4e-4)


@pytest.mark.slow
def test_a_stated_share_moves_the_haze_below_the_sensor_and_an_exponent_changes_the_colour_alone(solver_at):
    terms_at = solver_at(442.5, 470.0, 550.0, 860.0)
    few, many = (terms_at(state(aerosol_share_below=s)) for s in (0.4, 0.8))
    green = at(few, 550.0)
    assert 1.1 < many.path_radiance[green] / few.path_radiance[green] < 2.0
    assert many.ground_irradiance[green] == pytest.approx(few.ground_irradiance[green], rel=5e-3)
    # Light from the ground crosses 0.08 more of optical depth: less of it comes straight.
    assert many.direct[green] / few.direct[green] == pytest.approx(np.exp(-0.08), rel=5e-3)
    # Rural particles follow a power law roughly: at 550 nm nothing changes, in the blue the depth does.
    plain, steep, flat = (terms_at(state(sensor_altitude_km=1000.0, angstrom_exponent=e)) for e in (None, 1.0, 0.0))
    # The depth in the blue is less by 18 % with a flat law, and so is the aerosol's part of the path.
    assert flat.path_radiance[at(flat, 450.0)] < steep.path_radiance[at(flat, 450.0)]
    for found in (steep, flat):
        for name in ("path_radiance", "direct"):
            assert getattr(found, name)[green] == pytest.approx(getattr(plain, name)[green], rel=2e-3)


def test_ground_is_always_uniform_and_lambertian():
    # Non-uniform ground is wrong under an aircraft in the blue: after the spectral card stand 0 (uniform),
    # 0 (no directional effects), 0 (constant reflectance).
    for height, *more in ((2.0, "-1\n0.5500", ("1", 0.2, 0.1), 0.25), (None, "-1\n0.5500")):
        deck = sixs.deck(SUN._replace(ground_km=0.3, height_km=height), "0\n", *more)
        assert re.search(r"-1\n0\.5500\n0\n0\n0\n0\.[0-9]{6}\n-1\n$", deck)


def test_a_table_of_four_decimals_gives_what_is_solved_to_a_hundred_thousandth():
    """Straight lines in the logarithms between the wavelengths at which the solver solves, printed as it prints."""
    solved, rng = sixs._SOLVED_NM, np.random.default_rng(4)
    exact = {name: rng.uniform(0.02, 0.9, solved.size) for name in sixs.SCATTERED}
    nm = np.arange(340.0, 1000.1, 2.5)

    def at(values, wavelength_nm):
        inside = np.clip(wavelength_nm, solved[0], None)
        first = (np.log(wavelength_nm) - np.log(inside)) / np.log(solved[1] / solved[0]) * np.log(values[1] / values[0])
        return np.exp(np.interp(np.log(inside), np.log(solved), np.log(values)) + first)

    columns = np.stack([at(values, nm) for values in exact.values()], axis=1)
    rows = [" ".join(f"{v:.4f}" for v in row) for row in columns]
    text = "\n".join(f"*{w / 1e3:.4f} 1.0000 {row}  0 *" for w, row in zip(nm, rows, strict=True))
    nodes = NODES_NM[NODES_NM < 1000.0]
    found = sixs.solved_at(text, nodes)
    for name, values in exact.items():
        np.testing.assert_allclose(found[name], at(values, nodes), atol=4e-5)
        assert np.sqrt(np.mean((found[name] - at(values, nodes)) ** 2)) < 2e-5


@pytest.mark.parametrize("word", ["NaN", "*******", "Infinity"])
def test_asterisks_and_nan_are_refused(word, engine_cache):
    printed = run_sixs(sixs._TRIAL, engine_cache)
    assert 0.9 < sixs.parse_monochromatic(printed)["up"] < 1.0
    with pytest.raises(EngineError, match="in place of numbers"):
        sixs.parse_monochromatic(re.sub(r'(total  sca\.   "    :\s+\S+\s+)\S+', rf"\g<1>{word}", printed))
    with pytest.raises(EngineError, match="in place of numbers"):
        sixs.parse_steps(f"*0.3500 0.9962 0.7 0.7 0.7 0.7\n*0.3525 {word} 0.7 0.7 0.7 0.7\n")


def test_standard_atmospheres_are_those_of_the_solver(engine_cache):
    # The solver holds the six models too: pressures and columns it prints for ground at 1.3 km, sensor 60 km above.
    for number, model in enumerate(profiles._MODELS, 1):
        deck = sixs.deck(SUN._replace(ground_km=1.3, height_km=60.0), f"{number}\n", "-1\n0.5500")
        out = run_sixs(deck, engine_cache)
        pressure, water, ozone = (
            float(re.search(rf"{words}\s+(\S+)", out).group(1))
            for words in (r"ground pressure  \[mb\]", "h2o   content", "ozone content")
        )
        profile = profiles.standard_profile(model)
        assert pressure == pytest.approx(profiles.pressure_at(profile, 1.3), abs=0.01)
        ours = [profiles.column_g_cm2(profile, column, 1.3) for column in (profile.water_g_m3, profile.ozone_g_m3)]
        assert water == pytest.approx(ours[0], rel=0.005, abs=5e-4)
        assert ozone == pytest.approx(ours[1] / profiles.OZONE_G_CM2_PER_ATM_CM, rel=0.01)
