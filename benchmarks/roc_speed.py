"""ROC, bootstrap and AUC of 640,000 background scores and 80 targets, in one run.

python benchmarks/roc_speed.py
"""

from __future__ import annotations

import time

import numpy as np

from hyperval.processing.auc import auc_with_interval
from hyperval.processing.rank_counts import bootstrap_pd, roc_corners
from hyperval.processing.roc import empirical_roc, roc_points

BACKGROUND, TARGETS, DRAWS = 640_000, 80, 1000
LIMITS_MS = {
    "exact curve, corners": 10.0, "curve with intervals": 10.0, f"{DRAWS} bootstrap curves": 100.0,
    "AUC with DeLong": 50.0,
}  # fmt: skip


def milliseconds(work, rounds=7):
    best = np.inf
    for _ in range(rounds):
        start = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - start)
    return 1e3 * best


def main():
    rng = np.random.default_rng(0)
    background, target = rng.normal(size=BACKGROUND), rng.normal(2.0, 1.0, TARGETS)
    grid = np.logspace(-5, 0, 101)
    rows = {
        "sorting the background": lambda: np.sort(background),
        "exact curve, corners": lambda: roc_corners(target, background),
        "exact curve, every point": lambda: roc_points(target, background),
        "curve with intervals": lambda: empirical_roc(target, background),
        f"{DRAWS} bootstrap curves": lambda: bootstrap_pd(target, background, grid, DRAWS, rng),
        "AUC with DeLong": lambda: auc_with_interval(target, background),
    }
    for name, work in rows.items():
        found, limit = milliseconds(work), LIMITS_MS.get(name)
        verdict = "" if limit is None else f"  {'met' if found <= limit else 'NOT MET'}: at most {limit:.0f} ms"
        print(f"{name:26s} {found:8.1f} ms{verdict}")


if __name__ == "__main__":
    main()
