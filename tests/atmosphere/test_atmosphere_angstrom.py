"""An aerosol that follows a stated Angstrom exponent, with the absorption and phase function of its type."""

from __future__ import annotations

import pytest

from hyperval.atmosphere import NODES_NM, AerosolMix, AtmosphericState, aerosol_extinction, sixs, sixs_terms

STATE = {
    "aot550": 0.3, "sensor_altitude_km": 1000.0, "solar_zenith_deg": 30.0, "solar_azimuth_deg": 0.0,
    "day_of_year": 150, "water_vapour_g_cm2": 1.0,
}  # fmt: skip


@pytest.mark.slow
def test_extinction_of_every_type_is_what_the_solver_prints(engine_cache):
    mix = AerosolMix(dust=0.2, water_soluble=0.3, oceanic=0.45, soot=0.05)
    nodes = NODES_NM.tolist()
    for aerosol in ("rural", "continental", "maritime", "urban", "desert", mix):
        state = AtmosphericState(**{**STATE, "aerosol": aerosol})
        for nm in (412.5, 860.0, 2250.0, 2600.0):
            haze = sixs.Aerosol(sixs._aerosol_card(state.aerosol), 1.0, 1.0)
            run = sixs.deck(sixs.SunAndView(0.0, 0.0, 0.0), "0\n", 0.0, None, f"-1\n{nm / 1e3:.4f}", haze)
            printed = sixs.parse_monochromatic(sixs.run_sixs(run, engine_cache)).depth_aerosol
            assert aerosol_extinction(aerosol)[nodes.index(nm)] == pytest.approx(printed, rel=4e-4)


@pytest.mark.slow
def test_an_exponent_changes_the_colour_alone(engine_cache, solver_at):
    """Rural particles follow a power law roughly: at 550 nm nothing changes, in the blue the depth does."""
    solver_at(442.5, 470.0, 550.0, 860.0)
    plain = sixs_terms(AtmosphericState(**STATE), engine_cache, False)
    steep = sixs_terms(AtmosphericState(angstrom_exponent=1.0, **STATE), engine_cache, False)
    flat = sixs_terms(AtmosphericState(angstrom_exponent=0.0, **STATE), engine_cache, False)
    blue = plain.wavelength_nm == 450.0
    # The depth in the blue is less by 18 % with a flat law, and so is the aerosol's part of the path.
    assert flat.path_radiance[blue] < steep.path_radiance[blue]
    green = plain.wavelength_nm == 550.0
    for found in (steep, flat):
        assert found.path_radiance[green] == pytest.approx(plain.path_radiance[green], rel=2e-3)
        assert found.direct[green] == pytest.approx(plain.direct[green], rel=2e-3)
