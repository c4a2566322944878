"""How far the embedded engine departs from MODTRAN 6 from one band to the next: the budget of its fine structure.

    HYPERVAL_DATA=... python validation/atmosphere/fine_structure.py

In the windows the ratio of the total radiances is divided by itself smoothed over 50 nm (Gaussian), state by state;
what is left changes from band to band, and no smooth error explains it.  Printed: its root mean square by optical
depth of the gases (two ways), and how it hangs together between bands.
"""

from __future__ import annotations

import os
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from compare_modtran import RHO, compared
from modtran_cases import cases, total_radiance

from hyperval.spectra.windows import in_window

SMOOTH_NM = 50.0
DEPTHS = (0.0, 0.005, 0.01, 0.02, 0.04, 0.08, 0.15, 0.3)
LAGS = (1, 2, 3, 4, 8)


def smoothed(wavelength_nm: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Gaussian mean over SMOOTH_NM of the values that there are."""
    there = np.isfinite(values)
    weights = np.exp(-0.5 * ((wavelength_nm[:, None] - wavelength_nm) / SMOOTH_NM) ** 2) * there
    return (weights @ np.where(there, values, 0.0)) / weights.sum(axis=1)


def main() -> None:
    """Print the figures."""
    root = os.environ.get("HYPERVAL_DATA")
    if not root:
        sys.exit("set HYPERVAL_DATA to the data directory")
    rest, depth = [], []
    for case in cases(lambda relative: Path(root) / relative):
        ours, theirs = compared(case)
        w = ours.wavelength_nm
        ratio = np.where(in_window(w), total_radiance(ours, RHO) / total_radiance(theirs, RHO), np.nan)
        rest.append(ratio / smoothed(w, ratio) - 1.0)
        depth.append(-np.log(np.clip(ours.gas_transmittance, 1e-6, 1.0)))
    r, tau = np.array(rest), np.array(depth)
    print("| optical depth of gases | channels | rms [%] |\n| --- | --- | --- |")
    for low, high in pairwise(DEPTHS):
        here = np.isfinite(r) & (tau >= low) & (tau < high)
        print(f"| {low:g} - {high:g} | {here.sum()} | {100 * np.sqrt(np.mean(r[here] ** 2)):.2f} |")
    common = np.nanmean(r[:, np.isfinite(r).all(axis=0)], axis=0)
    all_of_it = np.sqrt(np.nanmean(r**2))
    print(
        f"\nall windows {100 * all_of_it:.2f} %, "
        f"of which common to all states {100 * np.sqrt(np.mean(common**2)):.2f} %"
    )
    pattern = np.nanmean(np.where(np.isfinite(r).all(axis=0), r, np.nan), axis=0)
    step = float(np.median(np.diff(w)))
    for lag in LAGS:
        pairs = pattern[:-lag] * pattern[lag:]
        print(f"correlation at {lag * step:.0f} nm: {np.nanmean(pairs) / np.nanmean(pattern**2):+.2f}")


if __name__ == "__main__":
    main()
