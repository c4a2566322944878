"""How far the embedded engine is from MODTRAN 6, by window and by gas transmittance.

    HYPERVAL_DATA=... python validation/atmosphere/compare_modtran.py

Prints medians and worst channels over all airborne states of the data directory.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
from modtran_cases import cases, matched, total_radiance

from hyperval.atmosphere import atmospheric_terms

RHO = 0.3
WINDOWS_NM = (
    (400, 500), (500, 600), (600, 685), (740, 755), (775, 805), (845, 885), (1000, 1070), (1220, 1250),
    (1550, 1700), (2100, 2300),
)  # fmt: skip
CLASSES = ((0.85, 1.01), (0.7, 0.85), (0.5, 0.7), (0.3, 0.5), (0.1, 0.3))


def main() -> None:
    """Print the tables."""
    root = os.environ.get("HYPERVAL_DATA")
    if not root:
        sys.exit("set HYPERVAL_DATA to the data directory")
    rows = []
    for case in cases(lambda relative: Path(root) / relative):
        ours, theirs = matched(case, atmospheric_terms(case.state))
        w = ours.wavelength_nm
        total = total_radiance(ours, RHO) / total_radiance(theirs, RHO) - 1.0
        path = ours.path_radiance / theirs.path_radiance - 1.0
        albedo = ours.spherical_albedo / theirs.spherical_albedo - 1.0
        rows.append((case.name, w, total, path, albedo, theirs.gas_transmittance))
        inside = [(w >= a) & (w <= b) for a, b in WINDOWS_NM]
        print(case.name, "total %:", " ".join(f"{100 * np.median(total[m]):6.2f}" for m in inside))
        print(" " * len(case.name), " L_a  %:", " ".join(f"{100 * np.median(path[m]):6.2f}" for m in inside))
    names, w, total, path, albedo, gas = zip(*rows, strict=True)
    w, total, path, albedo, gas = (np.concatenate(x) for x in (w, total, path, albedo, gas))
    print(f"\n{len(names)} states. hyperval / MODTRAN 6 - 1 [%]: median (5 %, 95 % of channels and states)")
    print(f"{'window nm':>14} {'total rho 0.3':>24} {'path radiance':>24} {'spherical albedo':>24}")
    for a, b in WINDOWS_NM:
        m = (w >= a) & (w <= b)
        print(f"{a:>7}-{b:<6} " + " ".join(f"{_spread(x[m]):>24}" for x in (total, path, albedo)))
    print("by two-way gas transmittance, MODTRAN's coefficient A over its continuum")
    for a, b in CLASSES:
        m = (gas >= a) & (gas < b) & (w > 400) & (w < 2450)
        print(f"{a:>7.2f}-{b:<6.2f} " + " ".join(f"{_spread(x[m]):>24}" for x in (total, path)))


def _spread(x: np.ndarray) -> str:
    low, mid, high = 100 * np.quantile(x, [0.05, 0.5, 0.95])
    return f"{mid:+.2f} ({low:+.1f}, {high:+.1f})"


if __name__ == "__main__":
    main()
