"""
Which detector finds more?
==========================

Matched filter, ACE and spectral angle on the same simulated pixels, targets of a tenth of a pixel.
"""

import matplotlib.pyplot as plt
import numpy as np

from hyperval.pixels import empirical_roc, pixel_detector, whitener_of

rng = np.random.default_rng(3)
bands = np.arange(20)
covariance = 4e-4 * np.exp(-np.abs(bands[:, None] - bands) / 6) + 1e-6 * np.eye(20)
mean, target = 0.2 + 0.005 * bands, 0.35 + 0.1 * np.sin(bands / 3)
background = rng.multivariate_normal(mean, covariance, 20_000)
mixed = 0.9 * rng.multivariate_normal(mean, covariance, 200) + 0.1 * target

whitener = whitener_of(mean, covariance)

figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
for name in ("cem", "ace", "sam"):
    detector = pixel_detector(name, target, mean, covariance)
    curve = empirical_roc(detector.score(mixed, whitener), detector.score(background, whitener))
    axes.plot(curve.pfa, curve.pd, label=name)
axes.set(xlabel="P_FA", ylabel="P_D", xscale="log", xlim=(1e-4, 1), ylim=(0, 1))
axes.legend()
