"""An aerosol that follows a stated Angstrom exponent, with the absorption and phase function of its type."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from hyperval.atmosphere import AtmosphericState, sixs
from hyperval.atmosphere.sixs import NODES_NM, Monochromatic, angstrom_law, sixs_terms

STATE = {
    "aot550": 0.3, "sensor_altitude_km": 1000.0, "solar_zenith_deg": 30.0, "solar_azimuth_deg": 0.0,
    "day_of_year": 150, "water_vapour_g_cm2": 1.0,
}  # fmt: skip


def test_the_law():
    assert angstrom_law(np.array([550.0]), 1.3).tolist() == [1.0]
    assert angstrom_law(np.array([1100.0, 275.0]), 1.0) == pytest.approx([0.5, 2.0])


def test_each_node_is_run_with_the_depth_of_the_law(monkeypatch, tmp_path):
    """The depth at 550 nm that each run is given, times what the type makes of it, is that of the law."""
    extinction = (NODES_NM / 550.0) ** -0.8

    def parse(text):
        lines = text.split("\n")
        nm = float(lines[-7]) * 1e3
        depth = 0.0 if lines[3] == "0" else float(lines[6])
        own = depth * float(np.interp(nm, NODES_NM, extinction))
        return Monochromatic(0.05 + 0.1 * own, 0.9, 0.9, 0.1, 0.1, own, 1.0)

    monkeypatch.setattr(sixs, "_run_all", lambda decks, folder, what, show: decks)
    monkeypatch.setattr(sixs, "parse_monochromatic", parse)
    monkeypatch.setattr(sixs, "sixs_fingerprint", lambda: "a stand-in")
    state = AtmosphericState(angstrom_exponent=0.2, **STATE)
    node = sixs._scattering(state, sixs._Setting(sixs.SunAndView(30.0, 0.0, 0.0), 0.0, None), tmp_path, False)
    assert node["depth_aerosol"] == pytest.approx(0.3 * (NODES_NM / 550.0) ** -0.2, rel=1e-5)  # decks have six decimals


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"aot550": None, "meteorological_range_km": 20.0}, "needs aot550"),
        ({"engine": "modtran"}, "sixs alone"),
        ({"angstrom_exponent": 5.0}, "less than or equal to 3"),
    ],
)
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
