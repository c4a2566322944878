"""An aerosol that follows a stated Angstrom exponent, with the absorption and phase function of its type."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from hyperval.atmosphere import AerosolMix, AtmosphericState, sixs, sixs_terms
from hyperval.atmosphere.sixs import NODES_NM, Monochromatic, aerosol_extinction, angstrom_law

STATE = {
    "aot550": 0.3, "sensor_altitude_km": 1000.0, "solar_zenith_deg": 30.0, "solar_azimuth_deg": 0.0,
    "day_of_year": 150, "water_vapour_g_cm2": 1.0,
}  # fmt: skip


def test_the_law():
    assert angstrom_law(np.array([550.0]), 1.3).tolist() == [1.0]
    assert angstrom_law(np.array([1100.0, 275.0]), 1.0) == pytest.approx([0.5, 2.0])


def test_each_node_is_run_with_the_depth_of_the_law(monkeypatch, tmp_path):
    """The depth at 550 nm that each run is given, times what the type makes of it, is that of the law."""
    given = {}

    def run(text):
        lines = text.split("\n")
        if lines[3] == "4":
            given[float(lines[-7]) * 1e3] = float(lines[6])
        return text

    monkeypatch.setattr(sixs, "_run_all", lambda decks, folder, what, show: [run(d) for d in decks])
    monkeypatch.setattr(sixs, "parse_monochromatic", lambda text: Monochromatic(0.05, 0.9, 0.9, 0.1, 0.1, 0.0, 1.0))
    monkeypatch.setattr(sixs, "sixs_fingerprint", lambda: "a stand-in")
    state = AtmosphericState(angstrom_exponent=0.2, **STATE)
    node = sixs._scattering(state, sixs._Setting(sixs.SunAndView(30.0, 0.0, 0.0), 0.0, None), tmp_path, False)
    extinction = aerosol_extinction("rural")
    law = 0.3 * (NODES_NM / 550.0) ** -0.2
    assert [given[nm] for nm in NODES_NM] == pytest.approx(law / extinction, abs=1e-6)  # decks have six decimals
    assert node["depth_aerosol"] == pytest.approx(law, rel=1e-12)


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


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"aot550": None, "meteorological_range_km": 20.0}, "needs aot550"), ({"engine": "modtran"}, "sixs alone"),
        ({"angstrom_exponent": 5.0}, "less than or equal to 3"),
    ],
)  # fmt: skip
def test_what_it_does_not_go_with(change, words):
    with pytest.raises(ValidationError, match=words):
        AtmosphericState(**{**STATE, "angstrom_exponent": 0.2, **change})


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
