"""Terms near a coarse table: exact at its nodes, and right between them where the ratio of engines is smooth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hyperval import datasets
from hyperval.atmosphere import AtmosphericState
from hyperval.atmosphere.table import AtmosphericTable
from hyperval.scenario import load_scenario
from hyperval.scoreboard.engines import ENGINES, NotApplicable, OutOfReach, nearest_state, transported
from hyperval.spectra.axis import SpectralAxis
from small_campaign import ATMOSPHERE, stand_in_atmosphere

ROOT = Path(__file__).parents[2]
CENTRES = np.arange(400.0, 2300.0, 10.0)
CHANNELS = SpectralAxis(CENTRES, np.full(CENTRES.size, 10.0))
NODES = np.array([0.1, 0.4])
TERMS = ("path_radiance", "direct", "adjacency", "spherical_albedo", "ground_irradiance", "gas_transmittance")


def state(**changes) -> AtmosphericState:
    return AtmosphericState.model_validate({**ATMOSPHERE, **changes})


def table(factor: float = 1.0) -> AtmosphericTable:
    """The stand-in engine at two nodes of haze, its path radiance times ``factor``, under a sun of one unit."""
    rows = [stand_in_atmosphere(state(aot550=a)).at_bands(CHANNELS) for a in NODES]
    mu0 = np.cos(np.deg2rad(30.0))
    unit = mu0 / state().distance_au ** 2 / np.pi
    stack = {
        "path": np.stack([r.path_radiance * factor for r in rows]) / unit,
        "direct": np.stack([r.direct for r in rows]) / unit,
        "adjacency": np.stack([r.adjacency for r in rows]) / unit,
        "ground": np.stack([r.ground_irradiance for r in rows]) / unit / np.pi,
        "spherical_albedo": np.stack([r.spherical_albedo for r in rows]),
        "gas": np.stack([r.gas_transmittance for r in rows]),
    }
    fixed = {"model": "midlatitude-summer", "aerosol": "rural", "water_vapour_g_cm2": 2.0, "solar_zenith_deg": 30.0}
    return AtmosphericTable(
        CENTRES, {"aot550": NODES}, fixed, stack, solar_irradiance=np.ones(CENTRES.size), fwhm_nm=CHANNELS.fwhm_nm
    )


@pytest.fixture(autouse=True)
def flat_sun(monkeypatch):
    monkeypatch.setattr(
        "hyperval.scoreboard.engines.solar.extraterrestrial_irradiance", lambda name, w, d: np.ones(w.size)
    )


@pytest.mark.parametrize("aot", [0.1, 0.4])
def test_at_a_node_it_is_the_table(aot):
    made = table(1.2)
    at = state(aot550=aot)
    near, moves = nearest_state(made, at)
    assert moves == []
    found, exact = transported(made, near, stand_in_atmosphere)(at), made.terms(at)
    for name in TERMS:
        assert getattr(found, name) == pytest.approx(getattr(exact, name), rel=1e-9)


def test_between_nodes_it_beats_the_straight_line_where_terms_bend():
    """Both engines bend as exp(-tau); their ratio of 1.2 does not, so nothing is lost between the nodes."""
    made, at = table(1.2), state(aot550=0.25)
    exact = stand_in_atmosphere(at).at_bands(CHANNELS)
    found = transported(made, nearest_state(made, at)[0], stand_in_atmosphere)(at)
    assert found.path_radiance == pytest.approx(1.2 * exact.path_radiance, rel=1e-9)
    assert found.direct == pytest.approx(exact.direct, rel=1e-9)
    line = made.terms(at).direct / exact.direct - 1.0
    assert np.max(np.abs(line)) > 1e-3


def test_a_state_beside_the_table_takes_the_ratio_of_its_edge():
    made, at = table(1.2), state(aot550=0.43)
    near, moves = nearest_state(made, at)
    assert near.aot550 == pytest.approx(0.4)
    assert moves == ["aot550 0.4 to 0.43"]
    exact = stand_in_atmosphere(at).at_bands(CHANNELS)
    found = transported(made, near, stand_in_atmosphere)(at)
    assert found.path_radiance == pytest.approx(1.2 * exact.path_radiance, rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"aot550": 0.6}, "aot550 is 0.6"),
        ({"water_vapour_g_cm2": 3.0}, "water_vapour_g_cm2 is 3"),
        ({"solar_zenith_deg": 33.0}, "solar_zenith_deg is 33"),
        ({"aerosol": "urban"}, "aerosol is 'urban'"),
        ({"model": "tropical"}, "model is 'tropical'"),
    ],
)
def test_a_state_too_far_off_is_refused_with_the_input(changes, words):
    with pytest.raises(OutOfReach, match=words):
        nearest_state(table(), state(**changes))


def test_where_neither_engine_has_light_there_is_none():
    made = table()

    def dark(at: AtmosphericState):
        terms = stand_in_atmosphere(at)
        return replace(terms, direct=np.where(terms.wavelength_nm > 1800.0, 0.0, terms.direct))

    found = transported(made, nearest_state(made, state())[0], dark)(state())
    assert np.all(found.direct[CENTRES > 1830.0] == 0.0)
    assert np.all(np.isfinite(found.direct))


@pytest.mark.data
def test_a_registered_table_refuses_a_flight_under_another_sun(data_dir):
    data_dir("modtran/modtran6_airborne_lut")
    flight = load_scenario(ROOT / "campaigns" / "pasadena-2017" / "line-184227.yaml")
    on_the_table = flight.atmosphere.model_copy(update={"ground_altitude_km": 0.35})
    flight = flight.model_copy(update={"atmosphere": on_the_table})
    with pytest.raises(NotApplicable, match=r"solar_zenith_deg is 52\.51"):
        ENGINES["modtran6-airborne"].serve(flight, lambda reference: datasets.resolve(reference, flight.folder))


def test_a_registered_table_that_is_not_at_hand_names_the_command_that_fetches_it(tmp_path, monkeypatch):
    monkeypatch.setenv("HYPERVAL_DATA", str(tmp_path))
    monkeypatch.setenv("HYPERVAL_CACHE", str(tmp_path / "cache"))
    flight = load_scenario(ROOT / "campaigns" / "pasadena-2017" / "line-184227.yaml")
    with pytest.raises(NotApplicable, match="hyperval data fetch modtran6-airborne"):
        ENGINES["modtran6-airborne"].serve(flight, lambda reference: datasets.resolve(reference, flight.folder))
