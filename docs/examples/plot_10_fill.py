"""
What part of a pixel does a small target fill?
==============================================

A square target anywhere on the pixel grid: fill fraction of its fullest pixel, with and without a PSF.
"""

import matplotlib.pyplot as plt
import numpy as np

from hyperval.model import ranked_pixel_fill
from hyperval.scenario import Geometry

sides = np.linspace(0.2, 3.0, 15)
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for psf in (0.0, 1.0, 1.5):
    fills = [ranked_pixel_fill(Geometry(side_m=s, gsd_m=1.0, psf_fwhm_pixels=psf), 1) for s in sides]
    means = [float(f.values @ f.weights) for f in fills]
    axes.plot(sides, means, "o-", label=f"PSF {psf:g} pixels")
axes.set(xlabel="side of the target [pixels]", ylabel="fill fraction of its fullest pixel", ylim=(0, 1))
axes.legend()
