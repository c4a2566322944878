"""
Which is harder: green planks on grass or yellow ones on asphalt?
=================================================================

Both scenarios at one probability of false alarm: P_D over the part of the pixel that the plank fills.
"""

import matplotlib.pyplot as plt
import numpy as np

from hyperval.api import predict

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for name in ("yellow-planks-asphalt", "green-planks-grass"):
    curves = predict(name).roc
    points = sorted(
        (float(subject.split()[-1]), float(np.interp(1e-3, curve.pfa, curve.pd)))
        for (subject, detector, unit), curve in curves.items()
        if detector == "cem" and unit == "pixel"
    )
    axes.plot(*zip(*points, strict=True), "o-", label=name)
axes.set(xlabel="part of the pixel that is filled", ylabel="P_D at P_FA 1e-3", ylim=(0, 1))
axes.legend()
