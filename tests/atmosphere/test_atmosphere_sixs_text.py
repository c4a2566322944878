"""Decks and printed answers of 6S, and the traps in both."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hyperval.atmosphere import run_sixs, sixs, state
from hyperval.errors import EngineError

SUN = sixs.SunAndView(40.0, 0.0, 0.0)


def test_ground_is_always_uniform_and_lambertian():
    # Non-uniform ground is wrong under an aircraft in the blue: after the spectral card stand 0 (uniform),
    # 0 (no directional effects), 0 (constant reflectance).
    aerosol = sixs.Aerosol("1", 0.2, 0.1)
    for deck in (
        sixs.deck(SUN, "0\n", 0.3, 2.0, "-1\n0.5500", aerosol, 0.25),
        sixs.deck(SUN, "0\n", 0.3, None, "-1\n0.5500"),
    ):
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


@pytest.mark.parametrize("word", ["NaN", "*******", "Infinity"])
def test_asterisks_and_nan_are_refused(word):
    with pytest.raises(EngineError, match="where numbers belong"):
        sixs.parse_monochromatic(printed(up=word))
    with pytest.raises(EngineError, match="where numbers belong"):
        sixs.parse_steps(f"*0.3500 0.9962 0.7\n*0.3525 {word} 0.7\n")


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
