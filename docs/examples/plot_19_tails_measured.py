"""
Has a background heavy tails?
=============================

Squared Mahalanobis distances of 5,000 pixels of a t law, and the degrees of freedom that fit them best.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import chi2

from hyperval.pixels import fit_tail_dof

rng = np.random.default_rng(5)
dof, n, dimension = 6.0, 5000, 8
pixels = rng.normal(size=(n, dimension)) * np.sqrt((dof - 2) / rng.chisquare(dof, n))[:, None]
squared = (pixels**2).sum(axis=1)
fit = fit_tail_dof(squared, dimension)

figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
distance = np.sort(np.sqrt(squared))
label = f"measured: {fit.dof:.1f} ({fit.lower:.1f} to {fit.upper:.1f}) degrees of freedom"
axes.plot(distance, 1 - np.arange(n) / n, label=label)
axes.plot(distance, chi2.sf(distance**2, dimension), "--", label="normal law")
axes.set(xlabel="Mahalanobis distance", ylabel="share of pixels farther out", yscale="log", ylim=(1e-4, 1))
axes.legend()
