"""
How certain is a measured ROC curve?
====================================

80 targets on 20,000 background pixels: the measured curve with its 95 % limits, and the true one.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import norm

from hyperval.pixels import empirical_roc

rng = np.random.default_rng(1)
curve = empirical_roc(rng.normal(3, 1, 80), rng.normal(0, 1, 20_000))
figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
axes.plot(curve.pfa, curve.pd, label="measured")
axes.fill_between(curve.pfa, curve.pd_lower, curve.pd_upper, alpha=0.25, label="95 % limits")
pfa = np.logspace(-4, 0, 100)
axes.plot(pfa, norm.sf(norm.isf(pfa) - 3), "--", label="truth")
axes.set(xlabel="P_FA", ylabel="P_D", xscale="log", xlim=(1e-4, 1), ylim=(0, 1))
axes.legend()
