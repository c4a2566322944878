"""
What part of a pixel does a small target fill?
==============================================

A square target anywhere on the pixel grid: fill fraction of its fullest pixel, with and without a PSF.
"""

import matplotlib.pyplot as plt
import numpy as np

from hyperval.model import fill_distribution
from hyperval.scenario import Fill

sides = np.linspace(0.2, 3.0, 15)
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for psf in (0.0, 1.0, 1.5):
    fills = [Fill(geometry={"side_m": s, "gsd_m": 1.0, "psf_fwhm_pixels": psf}) for s in sides]
    means = [fill_distribution(fill).mean for fill in fills]
    axes.plot(sides, means, "o-", label=f"PSF {psf:g} pixels")
axes.set(xlabel="side of the target [pixels]", ylabel="fill fraction of its fullest pixel", ylim=(0, 1))
axes.legend()
