"""
How many targets does a P_D need?
=================================

Width of the 95 % interval (mid-P) of a detection probability, by the number of targets.
"""

import matplotlib.pyplot as plt
import numpy as np

from hyperval.model.intervals import mid_p_limits

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
counts = np.array([10, 20, 40, 80, 160, 320, 640])
for share in (0.5, 0.9):
    ends = [mid_p_limits(round(share * n), n) for n in counts]
    axes.plot(counts, [float(high - low) for low, high in ends], "o-", label=f"{share:.0%} found")
axes.set(xlabel="targets", ylabel="width of the interval of P_D", xscale="log", ylim=(0, 0.8))
axes.legend()
