"""
How does an interval decide?
============================

Met, inconclusive and not met: four differences of radiance against an accepted range of 5 %.
"""

import matplotlib.pyplot as plt

from hyperval.compare.judge import outcome_of
from hyperval.results import Result

words = {"agrees": "met", "disagrees": "not met", "undecided": "inconclusive"}
figure, axes = plt.subplots(figsize=(8, 3), layout="constrained")
axes.axvspan(-5, 5, color="#d8eaf5", label="accepted range")
for place, (value, half) in enumerate(((1, 2), (1, 7), (4, 2), (9, 2))):
    ends = {"lower": (value - half) / 100, "upper": (value + half) / 100}
    row = Result("example", "radiance", "lawn", "6s", "median_difference_ratio_vnir", value / 100, **ends)
    outcome = words[outcome_of(row, -0.05, 0.05)[0].value]
    axes.errorbar(value, place, xerr=half, fmt="o", color="#1f6f9f")
    axes.annotate(outcome, (12, place), va="center")
axes.set(xlabel="difference of radiance [%], with 95 % interval", xlim=(-10, 16), yticks=[])
axes.legend(loc="lower left")
