"""What the embedded engine is still off by from one band to the next, in states its numbers were not made from.

    HYPERVAL_DATA=... python validation/atmosphere/fine_structure.py

Each state is predicted with the ratio made from the other flight's states (engine_ratio.py).  The total radiance
over ground of 0.3 against MODTRAN 6 is divided by itself smoothed over 50 nm (Gaussian), where the gases let
through more than exp(-0.3) two ways.  Printed: root mean square of the smooth part and of the rest by depth of the
gases, and how the rest, in units of the budget, hangs together between channels.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from compare_modtran import RHO
from engine_ratio import Pair, fitted, pairs_of
from modtran_cases import data_file, markdown, smoothed, total_radiance

SMOOTH_NM = 50.0
RANGE_NM = (400.0, 2450.0)
DEPTHS = (0.0, 0.005, 0.01, 0.02, 0.04, 0.08, 0.15, 0.3)
LAGS = (1, 2, 3, 4, 8)
# The budget of the fine structure: relative, and per optical depth of the gases.
RELATIVE, PER_OPTICAL_DEPTH = 0.0015, 0.06


def residuals(pairs: list[Pair]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(states, n) smooth part and rest of ours over MODTRAN less one, NaN where gases absorb much; their depth."""
    ratios = {name: fitted([p for p in pairs if p.flight != name]) for name in {p.flight for p in pairs}}
    smooth, rest, depth = [], [], []
    for pair in pairs:
        ours = pair.ours(ratios[pair.flight])
        w = ours.wavelength_nm
        tau = -np.log(np.clip(ours.gas_transmittance, 1e-6, 1.0))
        here = (w >= RANGE_NM[0]) & (w <= RANGE_NM[1]) & (tau < DEPTHS[-1])
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.where(here, total_radiance(ours, RHO) / total_radiance(pair.theirs, RHO) - 1.0, np.nan)
        smooth.append(np.where(here, smoothed(w, error, SMOOTH_NM), np.nan))
        rest.append(error - smooth[-1])
        depth.append(tau)
    return np.array(smooth), np.array(rest), np.array(depth)


def correlations(rest: np.ndarray, depth: np.ndarray) -> dict[int, float]:
    """Correlation of the rest, in units of its budget, between channels so many apart."""
    z = rest / np.hypot(RELATIVE, PER_OPTICAL_DEPTH * depth)
    level = float(np.nanmean(z**2))
    return {lag: float(np.nanmean(z[:, :-lag] * z[:, lag:])) / level for lag in LAGS}


def main() -> None:
    """Print the figures."""
    pairs = pairs_of(data_file)
    smooth, rest, depth = residuals(pairs)
    rows = []
    for low, high in pairwise(DEPTHS):
        here = np.isfinite(rest) & (depth >= low) & (depth < high)
        of = (smooth[here], rest[here], np.hypot(RELATIVE, PER_OPTICAL_DEPTH * depth[here]))
        rows.append([f"{low:g} - {high:g}", str(here.sum()), *(f"{100 * np.sqrt(np.mean(x**2)):.2f}" for x in of)])
    print(markdown(["optical depth of gases", "channels", "smooth [%]", "rest [%]", "budget of the rest [%]"], rows))
    step = float(np.median(np.diff(pairs[0].theirs.wavelength_nm)))
    for lag, value in correlations(rest, depth).items():
        print(f"correlation at {lag * step:.0f} nm: {value:+.2f}")


if __name__ == "__main__":
    main()
