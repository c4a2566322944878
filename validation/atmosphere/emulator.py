"""How far the engine `emulator` is from 6S at states that its numbers were not made from.

    HYPERVAL_CACHE=... python validation/atmosphere/emulator.py

Runs are kept in the cache, so that what was ended goes on where it was.  States are points of a Sobol sequence, a
little past the corners of what the engine takes, and of no sequence that its numbers or their error came from
(README.md says by which script these were made).
"""

from __future__ import annotations

from itertools import product
from typing import get_args

import numpy as np
from modtran_cases import markdown, total_radiance
from scipy.stats import qmc

from hyperval.atmosphere import AtmosphericState, sixs
from hyperval.atmosphere.state import AtmosphereModel
from hyperval.datasets import cache_root
from hyperval.progress import bars, track

MODELS = get_args(AtmosphereModel)
HEIGHTS_KM = {"below 8 km": (0.0, 8.0), "8-22 km": (8.0, 99.0), "space": (99.0, 1e3)}
SUN_DEG, DEPTH = 77.0, (0.015, 0.9)
REGIONS = {
    "400-450 nm": (400, 450, 0.9, 1.0), "450-700 nm": (450, 700, 0.9, 1.0), "700-1000 nm": (700, 1000, 0.9, 1.0),
    "1000-2450 nm": (1000, 2450, 0.9, 1.0), "gases 0.7-0.9": (400, 2450, 0.7, 0.9),
    "gases 0.3-0.7": (400, 2450, 0.3, 0.7), "gases 0.1-0.3": (400, 2450, 0.1, 0.3),
}  # fmt: skip


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


def main() -> None:
    """Print the differences of the radiance over two grounds, by height and region."""
    apart = [s for s in states(36, 12) if s.sun[0] <= 75.0 and s.aot550 <= 0.8]
    run = bars(False)(sixs.sixs_terms)
    theirs = [run(state, cache_root()) for state in track(apart, "beside 6S", total=len(apart))]
    ours = [sixs.emulated(state, sixs.stored()) for state in apart]
    print(f"{len(apart)} states; percent of 6S: median, 95 %, worst\n")
    height = np.array([s.sensor_altitude_km - s.ground_altitude_km for s in apart])
    gas, nm, rows = np.array([t.gas_transmittance for t in theirs]), sixs.GRID_NM, []
    for rho, (words, (above, below)) in product((0.02, 0.3), HEIGHTS_KM.items()):
        own = (height >= above) & (height < below)
        off = [np.abs(total_radiance(a, rho) / total_radiance(b, rho) - 1.0) for a, b in zip(ours, theirs, strict=True)]
        cells = []
        for low, high, least, most in REGIONS.values():
            at = own[:, None] & (nm >= low) & (nm < high) & (gas > least) & (gas <= most)
            median, great, worst = 100.0 * np.quantile(np.array(off)[at], [0.5, 0.95, 1.0])
            cells.append(f"{median:.2f}, {great:.2f}, {worst:.1f}")
        rows.append([f"{rho:g}, {words} ({own.sum()} states)", *cells])
    print(markdown(["ground, sensor above it", *REGIONS], rows))


if __name__ == "__main__":
    main()
