"""ROC and AUC of 640,000 background scores and 80 targets, in one run; processor time, the least of seven.

python benchmarks/roc_speed.py

All is one sort.  On AMD's Zen 4 NumPy 2.4 sorts five times as fast by AVX2 (6 ms) as by AVX-512
(32 ms), and the limits are met there by it alone: NPY_DISABLE_CPU_FEATURES=X86_V4 python benchmarks/roc_speed.py
"""

from __future__ import annotations

import numpy as np
from predict_speed import best_of

from hyperval.pixels import area_variance, empirical_roc, rank_counts, roc_area

BACKGROUND, TARGETS = 640_000, 80
LIMITS_MS = {"counts among the targets": 10.0, "curve with intervals": 10.0, "AUC with DeLong": 50.0}


def main():
    rng = np.random.default_rng(0)
    background, target = rng.normal(size=BACKGROUND), rng.normal(2.0, 1.0, TARGETS)

    def auc_and_variance():
        again = rank_counts(target, background)
        return roc_area(again), area_variance(again)

    rows = {
        "sorting the background": lambda: np.sort(background),
        "counts among the targets": lambda: rank_counts(target, background),
        "curve with intervals": lambda: empirical_roc(target, background),
        "AUC with DeLong": auc_and_variance,
    }
    for name, work in rows.items():
        time_ms, limit = 1e3 * best_of(work, 7)[0], LIMITS_MS.get(name)
        verdict = "" if limit is None else f"  {'met' if time_ms <= limit else 'NOT MET'}: at most {limit:.0f} ms"
        print(f"{name:26s} {time_ms:8.1f} ms{verdict}")


if __name__ == "__main__":
    main()
