"""An atmosphere that answers at once: what 6S has at any state, from numbers fitted to its runs at some.

Gases: 6S's own band model (Goody, Malkmus) sees a slanted way through two numbers, the amount u of a gas and the
amount weighted by pressure, and the transmittances of gases multiply:

    T = T_dry T_water T_ozone        -ln T = e^a u / sqrt(1 + e^b u / p) exp(c (p - p0) + d ln(u)^2)

with p the mean pressure on the way [atm] and a to d fitted for each wavelength, gas and standard atmosphere; ozone goes
with its amount alone.  So sun, heights, water and ozone need no run.

Scattering at the nodes of 6S: each quantity over its form for single scattering is a parabola in five inputs (sun,
haze, ground, air and haze below the sensor) and a Gaussian process on it, between stored states.

The numbers (``emulator.npz``) and how far they are from 6S, by wavelength and over states that they were not made from,
come from ``validation/atmosphere/emulator.py``; that error is the uncertainty of the terms.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import sixs
from hyperval.atmosphere.physics import amounts
from hyperval.atmosphere.state import AtmosphericState, air_column, coordinates, standard_profile
from hyperval.atmosphere.terms import Arrays, AtmosphericTerms, content_digest
from hyperval.errors import refuse

Array = npt.NDArray[np.float64]

FILE = "emulator.npz"
_MIDDLE_ATM = {"dry": 0.5, "water": 0.8}  # p0
_LOST = {"molecules": 0.5, "haze": 0.16}  # part of the scattered light that does not go on forward
_HEIGHTS_KM = (0.5, 20.0)
_LEAST_DEPTH = 0.015  # thinner haze is this one, scaled
_RHO = 0.3  # ground over which the error of the transmittances is stated


class Air(NamedTuple):
    """What scattering follows: the sun, and molecules and haze below and above the sensor.

    Attributes
    ----------
    mu0 : cosine of the solar zenith angle
    pressure : molecules above the ground over those above the sea [1]
    below : share of them below the sensor [1]
    depth, share : (nodes,) optical depth of the haze at 550 nm that 6S is run with, and its share below the sensor
    scale_km : scale height of the haze that puts this share below the sensor [km]
    total, part : (nodes,) the state's whole depth, and that below the sensor, over those of the run
    """

    mu0: float
    pressure: float
    below: float
    ground_km: float
    depth: Array
    share: Array
    scale_km: float
    total: Array
    part: Array

    def features(self) -> Array:
        """(5,) where the state lies between the stored ones, each about -1 to 1."""
        sun, haze = 2.0 * np.sqrt(1.0 / self.mu0 - 1.0) - 1.0, 4.0 * np.sqrt(self.depth[0]) - 2.0
        return np.array([sun, haze, self.ground_km / 1.5 - 1.0, np.log(self.below) + 1.0, self.scale_km - 2.0])


def air_of(state: AtmosphericState) -> Air:
    """The same of a state, in the air of the US standard 1962 in which 6S scatters."""
    setting, us62 = sixs.setting_of(state), standard_profile("us-standard-1962")
    *_, ground, height = sixs.in_standard_air(state, setting)
    air, above = air_column(us62, ground), 0.0 if height is None else air_column(us62, ground + height)
    depth, fraction = state.aerosol_optical_depth, state.aerosol_fraction_below
    used, share = sixs.trusted_stand_ins(np.full(sixs.NODES_NM.size, max(depth, _LEAST_DEPTH)), fraction, height)
    scale = 2.0 if height is None else min(-height / np.log1p(-min(share[0], 1.0 - 1e-9)), 4.0)
    total, part = depth / used, depth * fraction / (used * share)
    return Air(
        setting.cosines[0], air / air_column(us62, 0.0), 1.0 - above / air, ground, used, share, scale, total, part
    )


def single_scattering(air: Air, molecules: Array) -> Arrays:
    """Forms (nodes,) by which the quantities are divided, seen from above.

    Parameters
    ----------
    molecules : (nodes,) optical depth of all air above the sea
    """
    ways, r = 1.0 / air.mu0 + 1.0, molecules * air.pressure
    a, low = sixs.aerosol_extinction("rural") * air.depth, r * air.below
    d = a * air.share

    def reflected(below: Array, above: Array) -> Array:
        return np.asarray(-np.expm1(-below * ways) / (below * ways) * np.exp(-above / air.mu0) / (4.0 * air.mu0))

    thin, hazy = _LOST["molecules"], _LOST["haze"]
    phase = 0.75 * (1.0 + air.mu0**2)
    return {
        "clear_reflectance": phase * low * reflected(thin * low, thin * (r - low)),
        "clear_down": r / air.mu0, "clear_up": low, "clear_albedo": r,
        "reflectance": d * reflected(thin * low + hazy * d, thin * (r - low) + hazy * (a - d)),
        "down": a / air.mu0, "up": d, "albedo": a,
    }  # fmt: skip


def basis(x: Array) -> Array:
    """(n, 21) of a parabola in (n, 5) features."""
    squares = [x[:, i] * x[:, j] for i in range(x.shape[1]) for j in range(i, x.shape[1])]
    return np.stack([np.ones(len(x)), *x.T, *squares], axis=1)


def kernel(a: Array, b: Array, shape: Array) -> Array:
    """Long waves over all features, and shorter ones over the sun alone: the phase function, the same in every state.

    Parameters
    ----------
    a, b : (n, 5), (m, 5) features
    shape : logarithms of the lengths of the features, of that of the sun's waves, and of their height
    """
    apart = (a[:, None] - b[None]) / np.exp(shape[:5])
    sun = (a[:, None, 0] - b[None, :, 0]) / np.exp(shape[5])
    return np.asarray(np.exp(-0.5 * (apart**2).sum(axis=2)) + np.exp(2.0 * shape[6] - 0.5 * sun**2))


def scattering(state: AtmosphericState, held: Arrays) -> Arrays:
    """The quantities (nodes,) that a run of 6S would give of a state."""
    air, molecules = air_of(state), held["molecules"]
    x, form, at = air.features()[None], single_scattering(air, molecules), dict[str, Array]()
    for name in form:
        weights = held[f"{name}.weights"]  # of clear air for some of the states
        near = kernel(x, held["features"][: len(weights)], held[f"{name}.shape"])
        at[name] = (basis(x) @ held[f"{name}.parabola"] + near @ weights)[0]
    clear_down, clear_up = (np.exp(-at[name] * form[name]) for name in ("clear_down", "clear_up"))
    clear_albedo = at["clear_albedo"] * form["clear_albedo"]
    clear = {
        "reflectance_rayleigh": np.exp(at["clear_reflectance"]) * form["clear_reflectance"],
        "depth_rayleigh": molecules * air.pressure * air.below,
    }
    depth = state.aerosol_optical_depth * state.aerosol_fraction_below
    haze = {
        "reflectance_aerosol": air.part * np.exp(at["reflectance"]) * form["reflectance"],
        "depth_aerosol": sixs.aerosol_extinction("rural") * depth,
    }
    return clear | (haze if depth else {}) | {
        "down": clear_down * np.exp(-at["down"] * form["down"] * air.total),
        "up": clear_up * np.exp(-at["up"] * form["up"] * air.part),
        "spherical_albedo": clear_albedo + air.total * at["albedo"] * form["albedo"],
    }  # fmt: skip


def band_depth(numbers: Array, amount: Array, middle_atm: float) -> Array:
    """(n,) optical depth of a gas from (4, n) numbers, for its amount and that weighted by pressure."""
    a, b, c, d = numbers
    u, pressure = amount[0], amount[1] / amount[0]
    bent = np.clip(c * (pressure - middle_atm) + d * np.log(u) ** 2, -2.0, 2.0)
    return np.asarray(np.exp(a) * u / np.sqrt(1.0 + np.exp(b) * u / pressure) * np.exp(bent))


def gas(state: AtmosphericState, held: Arrays) -> Arrays:
    """Gas transmittance on the grid, as four tables of 6S have it."""
    numbers = {name: held[f"{state.model}.{name}"] for name in ("dry", "water", "ozone")}
    depths = []
    for dry, water, ozone in amounts(state):
        alone = band_depth(numbers["dry"], dry, _MIDDLE_ATM["dry"]) + numbers["ozone"] * ozone[0]
        whole, half = (band_depth(numbers["water"], s * water, _MIDDLE_ATM["water"]) for s in (1.0, 0.5))
        depths.append({"dry": alone, "half": alone + half, "full": alone + whole})
    found = {**depths[1], "ground": depths[0]["full"]}
    return {name: np.maximum(np.exp(-depth), sixs.LEAST_GAS) for name, depth in found.items()}


def emulated(state: AtmosphericState, held: Arrays) -> AtmosphericTerms:
    """The terms of a state by some numbers, without a word on their error."""
    engine = f"emulator of 6S {content_digest(held)[:16]}"
    return sixs.assembled(state, sixs.setting_of(state), scattering(state, held), gas(state, held), engine=engine)


def emulator_terms(
    state: AtmosphericState, folder: Path | None = None, show_progress: bool | None = None
) -> AtmosphericTerms:
    """The terms of a state in some milliseconds, with how far they may be from those of 6S.

    Raises
    ------
    UsageError : a state outside the ones that the numbers were made from.
    """
    height, zenith = state.sensor_altitude_km - state.ground_altitude_km, state.sun[0]
    at = coordinates(state)
    for name, value, low, high in (
        ("view_zenith_deg", state.view_zenith_deg, 0.0, 0.0),
        ("solar zenith [deg]", zenith, 0.0, 75.0),
        ("aerosol optical depth", state.aerosol_optical_depth, 0.0, 0.8),
        ("ground_altitude_km", state.ground_altitude_km, 0.0, 3.0),
        ("water vapour [g cm-2]", at["water_vapour_g_cm2"], 0.1, 6.0),
        ("ozone [atm cm]", at["ozone_atm_cm"], 0.2, 0.5),
        ("sensor above the ground [km]", _HEIGHTS_KM[1] if state.in_space else height, *_HEIGHTS_KM),
    ):
        refuse(not low - 1e-9 <= value <= high + 1e-9, "emulator.value", name=name, value=value, low=low, high=high)
    refuse(state.aerosol not in ("rural", "none"), "emulator.aerosol", aerosol=state.aerosol)
    held = stored()
    terms = emulated(state, held)
    path, direct = held["path_error"] * terms.path_radiance, held["direct_error"] * _RHO * terms.direct
    return replace(terms, path_uncertainty=np.hypot(path, direct))


@cache
def stored() -> Arrays:
    """The numbers that the package ships."""
    with resources.files("hyperval.atmosphere").joinpath(FILE).open("rb") as stream, np.load(stream) as held:
        return {name: np.asarray(held[name], dtype=float) for name in held.files}
