"""The engine that answers at once: its band model, how far it is from 6S, and what it refuses."""

import numpy as np
import pytest
from stored_cases import CASES

from hyperval.atmosphere import AtmosphericState, atmospheric_terms, physics, sixs
from hyperval.errors import UsageError
from hyperval.model import Origins, predict
from hyperval.scenario import Scenario
from hyperval.spectra import SpectralAxis

STATE = {
    "engine": "emulator", "water_vapour_g_cm2": 1.7, "ozone_atm_cm": 0.32, "aot550": 0.17, "ground_altitude_km": 0.4,
    "sensor_altitude_km": 3.1, "solar_zenith_deg": 41.0, "solar_azimuth_deg": 150.0, "day_of_year": 180,
}  # fmt: skip
NUMBERS = np.array([np.log([0.2, 0.2]), [-40.0, 9.0], [0.0, 0.0], [0.0, 0.0]])  # weak lines, strong lines


def terms(**changes):
    return atmospheric_terms(AtmosphericState(**{k: v for k, v in {**STATE, **changes}.items() if v is not None}))


def radiance(t, rho):
    return t.path_radiance + (t.direct + t.adjacency) * rho / (1 - rho * t.spherical_albedo)


def test_absorption_grows_with_the_amount_where_lines_are_weak_and_with_its_root_where_they_are_strong():
    depth = lambda u, pressure=1.0: sixs.band_depth(NUMBERS, np.array([u, u * pressure]), 0.8)  # noqa: E731
    assert depth(1e-3)[0] == pytest.approx(0.2e-3, rel=1e-9)
    assert (depth(8.0) / depth(2.0)).tolist() == pytest.approx([4.0, 2.0], rel=1e-3)
    assert (depth(2.0, 0.25) / depth(2.0)).tolist() == pytest.approx([1.0, 0.5], rel=1e-3)  # narrow lines


def test_amounts_on_the_way_down_and_up():
    down, both = physics.amounts(AtmosphericState(**{**STATE, "sensor_altitude_km": 700.0}))
    secant = 1.0 / np.cos(np.deg2rad(41.0))
    assert down[1:, 0] == pytest.approx([1.7 * secant, 0.32 * secant], rel=1e-6)
    assert both[:, 0] == pytest.approx(down[:, 0] * (1.0 + 1.0 / secant), rel=1e-9)
    assert 0.7 < down[1, 1] / down[1, 0] < 1.0  # mean pressure of the water


@pytest.mark.parametrize("place", [{}, {"sensor_altitude_km": 700.0}, {"aerosol": "none", "aot550": None}])
def test_a_slider_goes_on_without_a_step(place):
    steps = {"aot550": (0.05, 0.5), "solar_zenith_deg": (20.0, 70.0), "water_vapour_g_cm2": (0.5, 4.0)}
    for name, (low, high) in steps.items():
        if name == "aot550" and "aerosol" in place:
            continue
        path = np.array([terms(**place, **{name: x}).path_radiance[84] for x in np.linspace(low, high, 12)])
        bend = np.diff(path, 2) / path.mean()
        assert np.abs(bend).max() < 0.02, name


@pytest.mark.slow
@pytest.mark.parametrize("place", [{}, {"sensor_altitude_km": 700.0, "model": "us-standard-1962"}])
def test_radiance_is_that_of_6s_within_what_is_stated(engine_cache, place):
    ours = terms(**place)
    theirs = atmospheric_terms(AtmosphericState(**{**STATE, **place, "engine": "sixs"}), cache_dir=engine_cache)
    off = np.abs(radiance(ours, 0.3) - radiance(theirs, 0.3))
    seen = theirs.gas_transmittance > 0.1
    assert np.sqrt(np.mean((off / ours.path_uncertainty)[seen] ** 2)) < 2.0
    assert np.max((off / radiance(theirs, 0.3))[seen]) < 0.015


DUST = {"aot550": 0.3, "angstrom_exponent": 0.1, "sensor_altitude_km": 700.0}
MOVED = ("aot550", "water_vapour_g_cm2", "solar_zenith_deg")


@pytest.mark.slow
@pytest.mark.parametrize("place", [{}, DUST])
def test_a_step_from_a_run_of_6s_is_that_of_6s_to_a_fifth_of_itself_and_none_is_none(engine_cache, place, monkeypatch):
    stated = AtmosphericState(**{**STATE, **place, "engine": "sixs"})
    states = [stated] + [stated.model_copy(update={n: 1.1 * getattr(stated, n)}) for n in MOVED]
    exact = [sixs.sixs_terms(state, engine_cache) for state in states]
    monkeypatch.setattr(sixs, "run_sixs", None)  # no run but that of the stated state, which is in the cache
    near = [sixs.terms_near(stated, state, engine_cache) for state in states]
    seen = exact[0].gas_transmittance > 0.3
    true, found = ([radiance(t, 0.15)[seen] - radiance(exact[0], 0.15)[seen] for t in each] for each in (exact, near))
    assert all(np.linalg.norm(b - a) <= 0.2 * np.linalg.norm(a) for a, b in zip(true, found, strict=True))


@pytest.mark.parametrize(("changes", "said"), CASES["outside_emulator"])
def test_a_state_that_it_was_not_made_for_is_refused_with_what_mends_it_or_run(changes, said, monkeypatch):
    with pytest.raises(UsageError, match=said) as refused:
        terms(**changes)
    assert "choose engine: sixs" in refused.value.mend
    stated, state = (AtmosphericState(**{**STATE, **more, "engine": "sixs"}) for more in ({}, changes))
    monkeypatch.setattr(sixs, "sixs_terms", lambda state, *_: state)
    assert sixs.terms_near(stated, state, None) is state
    assert sixs.terms_near(state, stated, None) is stated


def test_its_error_is_a_source_of_the_budget_and_the_engine_is_stated():
    axis = SpectralAxis(np.array([450.0, 550.0, 860.0, 1650.0]), np.full(4, 10.0))
    grey = {"name": "grey", "fraction": 1.0, "spectrum": {"constant": 0.3}, "covariance": {"relative_sd": 0.05}}
    content = {
        "name": "fast", "atmosphere": STATE, "sensor": "emit", "scene": {"classes": [grey]},
        "processing": {"elm": "none", "detectors": []},
    }  # fmt: skip
    found = predict(Scenario.model_validate(content), Origins(axis=axis))
    stated = terms().at_bands(axis).path_uncertainty
    np.testing.assert_allclose(found.radiance["grey"].budget["interpolation of the table"], stated, rtol=1e-9)
    assert found.provenance["atmosphere"]["engine"].startswith("emulator of 6S ")
