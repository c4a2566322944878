"""Make the numbers of the engine `emulator` from runs of 6S, and say how far it is from 6S where it was not made.

    HYPERVAL_CACHE=... python validation/atmosphere/emulator.py [--write]

Runs are kept in the cache, so that what was ended goes on where it was.  ``--write`` puts the numbers, with the error
that was found, into ``src/hyperval/atmosphere/emulator.npz``.  States are points of a Sobol sequence, a little
past the corners of what the engine takes.  The error is stated from states of another sequence, and tested over those
of a third.
"""

from __future__ import annotations

import sys
from itertools import product
from pathlib import Path
from typing import get_args

import numpy as np
from modtran_cases import total_radiance
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.stats import qmc

from hyperval.atmosphere import AtmosphericState, sixs
from hyperval.atmosphere.physics import amounts
from hyperval.atmosphere.state import AtmosphereModel
from hyperval.datasets import cache_root
from hyperval.progress import bars, track

MODELS = get_args(AtmosphereModel)
MADE_FROM, CLEAR_FROM, OF_A_MODEL = 256, 128, 48  # clear air follows three inputs alone
HEIGHTS_KM = {"below 8 km": (0.0, 8.0), "8-22 km": (8.0, 99.0), "space": (99.0, 1e3)}
SUN_DEG, DEPTH = 77.0, (0.015, 0.9)
REGIONS = {
    "400-450 nm": (400, 450, 0.9, 1.0), "450-700 nm": (450, 700, 0.9, 1.0), "700-1000 nm": (700, 1000, 0.9, 1.0),
    "1000-2450 nm": (1000, 2450, 0.9, 1.0), "gases 0.7-0.9": (400, 2450, 0.7, 0.9),
    "gases 0.3-0.7": (400, 2450, 0.3, 0.7), "gases 0.1-0.3": (400, 2450, 0.1, 0.3),
}  # fmt: skip
# What rounding leaves unknown of each quantity; relative of the first and the last.
NOISE = {
    "clear_reflectance": 1.5e-5, "clear_down": 1e-6, "clear_up": 1e-6, "clear_albedo": 3e-5, "reflectance": 2e-5,
    "down": 3e-5, "up": 3e-5, "albedo": 4e-5,
}  # fmt: skip
SMOOTH = 41  # steps of 2.5 nm over which the error is averaged


def states(count: int, seed: int) -> list[AtmosphericState]:
    """Points of a sequence; a quarter of the sensors is in space."""
    made = []
    for k, (depth, sun, ground, height, space, water, ozone) in enumerate(qmc.Sobol(7, seed=seed).random(count)):
        ground_km = round(float(np.clip(3.4 * ground - 0.2, 0.0, None)), 3)
        airborne = round(float(ground_km + 0.45 * (22.0 / 0.45) ** height), 3)
        made.append(AtmosphericState(
            model=MODELS[k % 6], aerosol="rural", solar_azimuth_deg=180.0, earth_sun_distance_au=1.0,
            aot550=round(float(DEPTH[0] * (DEPTH[1] / DEPTH[0]) ** depth), 4),
            solar_zenith_deg=round(float(SUN_DEG * sun), 3),
            water_vapour_g_cm2=round(float(0.1 * (6.0 / 0.1) ** water), 4),
            ozone_atm_cm=round(float(0.2 + 0.3 * ozone), 4), ground_altitude_km=ground_km,
            sensor_altitude_km=700.0 if space < 0.25 else airborne,
        ))  # fmt: skip
    return made


def quantities(state: AtmosphericState, folder: Path) -> dict[str, np.ndarray]:
    """What 6S scatters at the nodes, of clear air and of what haze adds to it, for the haze that it was run with."""
    air, setting = sixs.air_of(state), sixs.setting_of(state)
    hazy = sixs._scattering(state, setting, folder)
    clear = sixs._scattering(state.model_copy(update={"aerosol": "none", "aot550": None}), setting, folder)
    return {
        "clear_reflectance": clear["reflectance_rayleigh"], "clear_down": clear["down"], "clear_up": clear["up"],
        "clear_albedo": clear["spherical_albedo"], "reflectance": hazy["reflectance_aerosol"] / air.part,
        "down": (hazy["down"] / clear["down"]) ** (1.0 / air.total),
        "up": (hazy["up"] / clear["up"]) ** (1.0 / air.part),
        "albedo": (hazy["spherical_albedo"] - clear["spherical_albedo"]) / air.total,
        "molecules": clear["depth_rayleigh"] / (air.pressure * air.below),
    }  # fmt: skip


def fitted_scattering(made_from: list[AtmosphericState], folder: Path) -> dict[str, np.ndarray]:
    """Parabola and weights of a Gaussian process for each quantity over its form."""
    runs = [bars(False)(quantities)(state, folder) for state in track(made_from, "scattering", total=len(made_from))]
    airs = [sixs.air_of(state) for state in made_from]
    held = {"molecules": np.mean([run["molecules"] for run in runs], axis=0)}
    held["features"] = np.array([air.features()[0] for air in airs]).astype("f4").astype(float)
    forms = [sixs.single_scattering(air, held["molecules"]) for air in airs]
    for name, noise in NOISE.items():
        value, form = (np.array([of[name] for of in every]) for every in (runs, forms))
        if name.endswith("reflectance"):
            y, sigma = np.log(np.maximum(value, 1e-8) / form), noise / np.maximum(value, 1e-8)
        elif name.endswith("albedo"):
            y, sigma = value / form, noise / form
        else:
            y, sigma = -np.log(value) / form, noise / form
        of = slice(CLEAR_FROM if name.startswith("clear") else None)
        found = fitted_process(held["features"][of], y[of], np.minimum(sigma[of], 1e3))
        held |= {f"{name}.{part}": array for part, array in zip(("shape", "parabola", "weights"), found, strict=True)}
    return held


def fitted_process(x: np.ndarray, y: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shape of the kernel (the same for all nodes), (21, nodes) parabola and (n, nodes) weights."""
    h, start = sixs.basis(x), np.array([0.7] * 5 + [-2.0, -1.0, -3.0])

    def solved(k0: np.ndarray, j: int, height: float) -> tuple[float, np.ndarray, np.ndarray]:
        scale = np.exp(height) * max(float(np.std(y[:, j])), 1e-6)
        factor = cho_factor(scale**2 * k0 + np.diag(sigma[:, j] ** 2 + (1e-5 * scale) ** 2 + 1e-14), lower=True)
        kh = cho_solve(factor, h)
        within = h.T @ kh + 1e-10 * np.eye(h.shape[1])
        parabola = np.linalg.solve(within, kh.T @ y[:, j])
        rest = y[:, j] - h @ parabola
        alpha = cho_solve(factor, rest)
        lost = 0.5 * rest @ alpha + np.log(np.diag(factor[0])).sum() + 0.5 * np.linalg.slogdet(within)[1]
        return float(lost), parabola, scale**2 * alpha

    def unlikely(theta: np.ndarray) -> float:
        k0 = sixs.kernel(x, x, theta)
        return sum(solved(k0, j, theta[-1])[0] for j in (1, 7, 13, 16)) + 0.02 * float(((theta - start) ** 2).sum())

    bounds = [(-1.2, 3.5)] * 5 + [(-3.5, 0.0), (-7.0, 2.0), (-9.0, 1.0)]
    theta = minimize(unlikely, start, method="L-BFGS-B", bounds=bounds, options={"maxiter": 20}).x
    k0 = sixs.kernel(x, x, theta)
    columns = [solved(k0, j, theta[-1])[1:] for j in range(y.shape[1])]
    return theta[:-1], np.stack([c[0] for c in columns], 1), np.stack([c[1] for c in columns], 1)


def fitted_gas(model: str, folder: Path) -> dict[str, np.ndarray]:
    """Numbers of the band model of each gas in one standard atmosphere."""

    def tables(state: AtmosphericState) -> dict[str, np.ndarray]:
        return sixs._gas(state, sixs.setting_of(state), folder)

    of = [state.model_copy(update={"model": model}) for state in states(OF_A_MODEL, 7)]
    space = {"solar_zenith_deg": 60.0, "sensor_altitude_km": 700.0, "ground_altitude_km": 0.0}
    thin, thick = (tables(of[0].model_copy(update={**space, "ozone_atm_cm": u}))["dry"] for u in (0.05, 0.95))
    ozone = np.maximum(-np.log(thick / thin) / (0.9 * 3.0), 0.0)
    printed = [bars(False)(tables)(state) for state in track(of, f"gases, {model}", total=len(of))]
    both = np.array([amounts(state)[1] for state in of])
    dry = np.array([t["dry"] for t in printed])
    alone = np.minimum(dry * np.exp(ozone * both[:, 2, :1]), 1.0)
    wet = np.concatenate([[t[name] / t["dry"] for t in printed] for name in ("full", "half")])
    water = np.concatenate([both[:, 1], 0.5 * both[:, 1]])
    seen = np.concatenate([dry, dry]) ** 2
    return {
        f"{model}.ozone": ozone,
        f"{model}.dry": fitted_band(both[:, 0], alone, 0.5, np.ones_like(dry)),
        f"{model}.water": fitted_band(water, np.clip(wet, 0.0, 1.0), 0.8, seen),
    }


def fitted_band(amount: np.ndarray, t: np.ndarray, middle: float, seen: np.ndarray) -> np.ndarray:
    """(4, n) numbers to transmittances (states, n), by Levenberg and Marquardt at all wavelengths at once."""
    prior = np.array([0.0, 1e-4, 1e-4, 1e-3])[:, None]  # weak: what does not show stays 0
    model = lambda p: np.stack([np.exp(-sixs.band_depth(p, u, middle)) for u in amount])  # noqa: E731
    cost = lambda p, r: (seen * r**2).sum(0) + (prior**2 * p**2).sum(0)  # noqa: E731
    par = np.zeros((4, t.shape[1]))
    par[0] = np.log(np.median(-np.log(np.clip(t, 2.5e-5, 1 - 2e-5)) / amount[:, :1], axis=0)) + 0.3
    damping, rest = np.full(t.shape[1], 1e-2), t - model(par)
    for _ in range(60):
        slopes = np.stack([(model(par + 1e-5 * np.eye(4)[k][:, None]) - (t - rest)) / 1e-5 for k in range(4)])
        normal = np.einsum("imn,jmn->nij", slopes * seen, slopes) + np.diag(prior[:, 0] ** 2)
        pull = np.einsum("imn,mn->ni", slopes * seen, rest) - (prior**2 * par).T
        more = np.eye(4) * (damping[:, None] * np.einsum("nii->ni", normal))[:, :, None] + 1e-14 * np.eye(4)
        new = par + np.clip(np.linalg.solve(normal + more, pull[..., None])[..., 0].T, -1.0, 1.0)
        left = t - model(new)
        better = cost(new, left) < cost(par, rest)
        par, rest = np.where(better, new, par), np.where(better, left, rest)
        damping = np.where(better, damping / 3, damping * 4)
    return par


def beside(count: int, seed: int, held: dict[str, np.ndarray], folder: Path) -> tuple[list, list, list]:
    """States that the engine takes, and their terms by 6S and by the numbers."""
    apart = [s for s in states(count, seed) if s.sun[0] <= 75.0 and s.aot550 <= 0.8]
    theirs = [bars(False)(sixs.sixs_terms)(state, folder) for state in track(apart, "beside 6S", total=len(apart))]
    return apart, theirs, [sixs.emulated(state, held) for state in apart]


def main() -> None:
    """Make the numbers, print the error."""
    folder = cache_root()
    held = fitted_scattering(states(MADE_FROM, 3), folder)
    for model in MODELS:
        held |= fitted_gas(model, folder)
    apart, theirs, ours = beside(24, 11, held, folder)
    seen = np.array([t.gas_transmittance for t in theirs]) > 0.05
    for name, field in (("path_error", "path_radiance"), ("direct_error", "direct")):
        off = np.array([getattr(a, field) / getattr(b, field) - 1.0 for a, b in zip(ours, theirs, strict=True)])
        square = (np.where(seen, off, 0.0) ** 2).sum(0) / np.maximum(seen.sum(0), 1)
        held[name] = np.sqrt(np.convolve(np.pad(square, SMOOTH // 2, "edge"), np.full(SMOOTH, 1 / SMOOTH), "valid"))
    apart, theirs, ours = beside(36, 12, held, folder)
    print(f"{MADE_FROM} states, {len(apart)} others; percent of 6S: median, 95 %, worst\n")
    print("| ground, sensor above it | " + " | ".join(REGIONS) + " |\n| --- |" + " --- |" * len(REGIONS))
    height = np.array([s.sensor_altitude_km - s.ground_altitude_km for s in apart])
    gas, nm = np.array([t.gas_transmittance for t in theirs]), sixs.GRID_NM
    for rho, (words, (above, below)) in product((0.02, 0.3), HEIGHTS_KM.items()):
        own, cells = (height >= above) & (height < below), []
        off = [np.abs(total_radiance(a, rho) / total_radiance(b, rho) - 1.0) for a, b in zip(ours, theirs, strict=True)]
        for low, high, least, most in REGIONS.values():
            at = own[:, None] & (nm >= low) & (nm < high) & (gas > least) & (gas <= most)
            median, great, worst = 100.0 * np.quantile(np.array(off)[at], [0.5, 0.95, 1.0])
            cells.append(f"{median:.2f}, {great:.2f}, {worst:.1f}")
        print(f"| {rho:g}, {words} ({own.sum()} states) | " + " | ".join(cells) + " |")
    if "--write" in sys.argv:
        place = Path(__file__).parents[2] / "src" / "hyperval" / "atmosphere" / sixs.EMULATOR
        rounded = {n: a.astype("f4") for n, a in held.items() if n.startswith(MODELS) or n.endswith("error")}
        np.savez_compressed(place, **held | rounded)


if __name__ == "__main__":
    main()
