"""Decks and printed answers of 6S, and the traps in both."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hyperval.atmosphere import sixs, state
from hyperval.atmosphere.sixs import run_sixs
from hyperval.errors import EngineError, UsageError

SUN = sixs.SunAndView(40.0, 0.0, 0.0)


def test_zero_altitude_is_not_minus_zero():
    assert sixs.altitude_card(0.0) == "0"
    assert sixs.altitude_card(1e-9) == "0"
    assert sixs.altitude_card(0.35) == "-0.35000"


def test_space_is_written_as_space_and_ground_as_ground():
    assert "\n-1000\n-1\n0.5500" in sixs.deck(SUN, "0\n", 0.0, None, "-1\n0.5500")
    assert "\n0\n0\n-2\n" in sixs.deck(SUN, "0\n", 0.0, 0.0, "-2\n0.35 2.5")


def test_ground_is_always_uniform_and_lambertian():
    # Non-uniform ground is wrong under an aircraft in the blue: after the spectral card stand 0 (uniform),
    # 0 (no directional effects), 0 (constant reflectance).
    aerosol = sixs.Aerosol("1", 0.2, 0.1)
    for deck in (
        sixs.deck(SUN, "0\n", 0.3, 2.0, "-1\n0.5500", aerosol, 0.25),
        sixs.deck(SUN, "0\n", 0.3, None, "-1\n0.5500"),
    ):
        assert re.search(r"-1\n0\.5500\n0\n0\n0\n0\.[0-9]{6}\n-1\n$", deck)


def test_every_node_is_on_the_solvers_grid():
    # Other wavelengths snap to 2.5 nm, and 761 nm came out as NaN.
    np.testing.assert_allclose(np.mod(sixs.NODES_NM, 2.5), 0.0)
    assert np.all(np.diff(sixs.NODES_NM) > 0)


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
    text = "\n".join(
        f"*{w / 1e3:.4f} 1.0000 " + " ".join(f"{v:.4f}" for v in row) + "  0 *"
        for w, row in zip(nm, columns, strict=True)
    )
    nodes = sixs.NODES_NM[sixs.NODES_NM < 1000.0]
    found = sixs.solved_at(text, nodes)
    for name, values in exact.items():
        np.testing.assert_allclose(found[name], at(values, nodes), atol=4e-5)
        assert np.sqrt(np.mean((found[name] - at(values, nodes)) ** 2)) < 2e-5


def printed(reflectance="0.0155055", gas="1.00000", up="0.97465"):
    return f"""
*       apparent reflectance  {reflectance}  appar. rad.(w/m2/sr/mic)    7.021    *
*      global gas. trans. :     1.00000        1.00000        {gas}         *
*      total  sca.   "    :     0.89369        {up}        0.87103         *
*      spherical albedo   :     0.07886        0.06402        0.12426         *
*      optical depth total:     0.09300        0.20000        0.29300         *
*      optical depth plane:     0.02273        0.10000        0.12273         *
"""


def test_reads_the_printed_numbers():
    run = sixs.parse_monochromatic(printed())
    assert (run.reflectance, run.down, run.up, run.spherical_albedo) == (0.0155055, 0.89369, 0.97465, 0.12426)
    assert (run.depth_rayleigh, run.depth_aerosol, run.gas) == (0.02273, 0.1, 1.0)
    from_space = sixs.parse_monochromatic(re.sub(r".*depth plane.*\n", "", printed()))
    assert from_space.depth_aerosol == 0.2


@pytest.mark.parametrize("word", ["NaN", "*******", "Infinity"])
def test_asterisks_and_nan_are_refused(word):
    with pytest.raises(EngineError, match="where numbers belong"):
        sixs.parse_monochromatic(printed(up=word))
    with pytest.raises(EngineError, match="where numbers belong"):
        sixs.parse_steps(f"*0.3500 0.9962 0.7\n*0.3525 {word} 0.7\n")


def test_output_without_the_numbers_is_refused():
    with pytest.raises(EngineError, match="did not print"):
        sixs.parse_monochromatic("nothing")
    with pytest.raises(EngineError, match="no spectral table"):
        sixs.parse_steps("nothing")


@pytest.mark.parametrize(
    ("number", "model"),
    [
        (1, "tropical"),
        (2, "midlatitude-summer"),
        (3, "midlatitude-winter"),
        (4, "subarctic-summer"),
        (5, "subarctic-winter"),
        (6, "us-standard-1962"),
    ],
)
def test_standard_atmospheres_are_those_of_the_solver(engine_cache, number, model):
    # The solver holds the six models too: pressures and columns it prints for ground at 1.3 km, sensor 60 km above.
    out = run_sixs(sixs.deck(SUN, f"{number}\n", 1.3, 60.0, "-1\n0.5500"), engine_cache)
    profile = state.standard_profile(model)
    assert float(re.search(r"ground pressure  \[mb\]\s+(\S+)", out).group(1)) == pytest.approx(
        state.pressure_at(profile, 1.3), abs=0.01
    )
    water = state.column_g_cm2(profile, profile.water_g_m3, 1.3)
    ozone = state.column_g_cm2(profile, profile.ozone_g_m3, 1.3) / state.OZONE_G_CM2_PER_ATM_CM
    assert float(re.search(r"h2o   content\s+(\S+)", out).group(1)) == pytest.approx(water, rel=0.005, abs=5e-4)
    assert float(re.search(r"ozone content\s+(\S+)", out).group(1)) == pytest.approx(ozone, rel=0.01)


@pytest.mark.parametrize(("ground_km", "height_km"), [(0.0, 60.0), (0.35, 60.0), (2.0, 60.0)])
def test_user_columns_hold_over_raised_ground(engine_cache, ground_km, height_km):
    # The solver's own user columns come out as 0.40 of the request over ground at 2 km.
    profile = state.scaled_profile("midlatitude-summer", ground_km, 1.5, 0.3)
    card = sixs.profile_atmosphere(profile)
    assert card.count("\n") == 35  # the 7 and 34 levels
    deck = sixs.deck(SUN, card, ground_km, height_km, "-1\n0.5500")
    out = run_sixs(deck, engine_cache)
    assert float(re.search(r"h2o   content\s+(\S+)", out).group(1)) == pytest.approx(1.5, rel=0.01)
    assert float(re.search(r"ozone content\s+(\S+)", out).group(1)) == pytest.approx(0.3, rel=0.01)


def test_scaling_and_pressure_of_a_profile():
    us62 = state.standard_profile("us-standard-1962")
    assert state.altitude_of_air_column(us62, state.air_column(us62, 3.3)) == pytest.approx(3.3)
    assert state.altitude_of_air_column(us62, 1e9) == 0.0
    own = state.scaled_profile("tropical", 1.0, None, None)
    np.testing.assert_array_equal(own.water_g_m3, state.standard_profile("tropical").water_g_m3)
    with pytest.raises(UsageError, match="unknown standard atmosphere"):
        state.standard_profile("venus")
