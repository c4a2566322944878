"""
Which is harder: green planks on grass or yellow ones on asphalt?
=================================================================

Both scenarios at one probability of false alarm: P_D over the part of the pixel that the plank fills.
"""

import matplotlib.pyplot as plt

from hyperval.api import predict

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for name in ("yellow-planks-asphalt", "green-planks-grass"):
    prediction = predict(name)
    names = prediction.roc["subject"].unique()
    points = sorted((float(subject.split()[-1]), prediction.pd(subject, pfa=1e-3).value) for subject in names)
    axes.plot(*zip(*points, strict=True), "o-", label=name)
axes.set(xlabel="part of the pixel that is filled", ylabel="P_D at P_FA 1e-3", ylim=(0, 1))
axes.legend()
