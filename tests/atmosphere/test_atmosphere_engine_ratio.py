"""What MODTRAN 6 has over the embedded engine: the form of the correction, and how it predicts other states."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.atmosphere import (
    GREATEST_WATER_G_CM2,
    AtmosphericState,
    EngineRatio,
    low_share,
    molecular_albedo,
    sixs,
    ways,
)

STATE = AtmosphericState(
    water_vapour_g_cm2=2.0, ozone_atm_cm=0.3, aot550=0.1, ground_altitude_km=0.4, sensor_altitude_km=2.3,
    solar_zenith_deg=45.0, solar_azimuth_deg=150.0, day_of_year=180, view_zenith_deg=0.0,
)  # fmt: skip
NM = np.array([400.0, 500.0, 600.0])
FLAT = EngineRatio(NM, np.full(3, 0.1), np.full(3, 0.2), np.full(3, 0.9), np.full(3, 0.8))


def test_transmittances_go_with_the_amounts_and_beyond_the_states_with_their_root():
    assert FLAT.gas(NM, 1.5, 2.0) == pytest.approx(np.exp(-0.1 * 1.5 - 0.2 * 2.0))
    depth = lambda u: -np.log(FLAT.gas(NM, 0.0, u)[0]) / 0.2  # noqa: E731
    edge = GREATEST_WATER_G_CM2
    assert depth(edge + 1e-6) == pytest.approx(edge + 1e-6, abs=1e-9)  # neither a jump nor a kink
    assert depth(4.0 * edge) == pytest.approx(3.0 * edge)


def test_spherical_albedo_has_the_aerosol_that_is_below_the_free_troposphere():
    own, molecules = np.full(3, 0.1), np.full(3, 0.04)
    assert FLAT.spherical_albedo(NM, own, molecules, 0.75) == pytest.approx(0.04 + 0.8 * 0.75 * 0.06)
    assert np.array_equal(FLAT.spherical_albedo(NM, molecules, molecules, 0.75), molecules)


def test_the_free_troposphere_holds_the_same_aerosol_under_every_haze():
    above = [(1.0 - low_share(STATE.model_copy(update={"aot550": depth}))) * depth for depth in (0.05, 0.1, 0.2, 0.6)]
    assert above == pytest.approx(4 * [0.032], abs=5e-4)
    assert low_share(STATE.model_copy(update={"aerosol": "none", "aot550": None})) == 1.0
    # Half of the thin haze is stated to lie above the aircraft at most: no more than that is above 5 km.
    stated = STATE.model_copy(update={"aot550": 0.05, "aerosol_share_below": 0.7})
    assert low_share(stated) == pytest.approx(0.7)
    assert 0.0 <= low_share(STATE.model_copy(update={"aot550": 0.01, "ground_altitude_km": 1.8})) < 0.5


def test_albedo_of_molecules_goes_from_their_depth_to_one():
    # Thin air sends back its depth to the first order; a cloud of molecules all light.
    assert molecular_albedo(np.array([1e-4]))[0] == pytest.approx(1e-4, rel=2e-3)
    assert molecular_albedo(np.array([1000.0]))[0] == pytest.approx(1.0, abs=0.01)
    assert np.all(np.diff(molecular_albedo(np.linspace(0.01, 3.0, 50))) > 0.0)


def test_ways_of_the_light():
    low = STATE.model_copy(update={"solar_zenith_deg": 60.0})
    down, both = ways(low)
    assert down.water_g_cm2 == pytest.approx(4.0)  # 2 g cm-2 with the sun at 60 degrees
    assert 0.0 < both.water_g_cm2 - down.water_g_cm2 < 2.0
    space = ways(low.model_copy(update={"sensor_altitude_km": 700.0}))[1]
    assert space.water_g_cm2 == pytest.approx(6.0)
    assert space.air_atm == pytest.approx(1.5 * down.air_atm)


@pytest.fixture
def engine(monkeypatch, tmp_path):
    """The engine with made-up air in the place of what 6S prints: nothing is run."""
    n = sixs.NODES_NM.size

    def scattering(state, *_):
        haze = {"reflectance_aerosol": np.full(n, 0.01), "depth_aerosol": np.full(n, 0.04)}
        clear = {
            "reflectance_rayleigh": 0.02,
            "down": 0.9,
            "up": 0.95,
            "spherical_albedo": 0.1,
            "depth_rayleigh": 0.05,
        }
        return {k: np.full(n, v) for k, v in clear.items()} | (haze if state.aerosol_optical_depth else {})

    gas = {"dry": 0.9, "half": 0.8, "full": 0.7, "ground": 0.8}
    monkeypatch.setattr(sixs, "_scattering", scattering)
    monkeypatch.setattr(sixs, "_gas", lambda *_: {k: np.full(sixs.GRID_NM.size, v) for k, v in gas.items()})
    monkeypatch.setattr(sixs, "sixs_fingerprint", lambda: "none")
    return lambda state, ratio="shipped": sixs.sixs_terms(state, tmp_path, False, ratio=ratio)


def test_the_engine_dims_each_part_of_the_light_by_its_own_way(engine):
    plain = engine(STATE, None)
    one = np.ones(3)
    flat = EngineRatio(NM, 0.1 * one, 0.02 * one, one, one)
    dimmed = engine(STATE, flat)
    down, both = ways(STATE)
    expected = np.exp(-0.1 * both.air_atm - 0.02 * both.water_g_cm2)
    for name in ("direct", "adjacency", "gas_transmittance"):
        np.testing.assert_allclose(getattr(dimmed, name), getattr(plain, name) * expected, rtol=1e-12)
    np.testing.assert_allclose(
        dimmed.ground_irradiance,
        plain.ground_irradiance * np.exp(-0.1 * down.air_atm - 0.02 * down.water_g_cm2),
        rtol=1e-12,
    )
    inside = dimmed.path_radiance / plain.path_radiance  # between dry light and light through half of the water
    assert np.all(inside <= np.exp(-0.1 * both.air_atm) * (1 + 1e-12))
    assert np.all(inside >= np.exp(-0.1 * both.air_atm - 0.01 * both.water_g_cm2) * (1 - 1e-12))
    assert (dimmed.provenance["engine_ratio"], plain.provenance["engine_ratio"]) == (True, False)


def test_no_more_than_half_of_the_absorption_is_taken_back(engine):
    one = np.ones(3)
    bright = EngineRatio(NM, -9.0 * one, -9.0 * one, one, one)
    at_600_nm = engine(STATE, bright).gas_transmittance[104]
    assert at_600_nm == pytest.approx(np.sqrt(0.9))  # half of all and half of the water: the dry gas has half left


def test_clear_air_keeps_its_albedo_and_aerosol_of_a_stated_colour_its_path(engine):
    clear = STATE.model_copy(update={"aerosol": "none", "aot550": None})
    for state in (clear, STATE.model_copy(update={"angstrom_exponent": 1.3})):
        np.testing.assert_array_equal(engine(state).spherical_albedo, engine(state, None).spherical_albedo)
    one = np.ones(3)
    path = EngineRatio(NM, 0.0 * one, 0.0 * one, 0.5 * one, one)
    less = engine(STATE, path).path_radiance / engine(STATE, None).path_radiance
    assert less == pytest.approx((0.02 * 0.9 + 0.5 * 0.01 * 0.8) / (0.02 * 0.9 + 0.01 * 0.8))
