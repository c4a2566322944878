"""
What do heavy tails of the background cost?
===========================================

P_D of planks that fill 10 % of a pixel, as the tails of the asphalt get heavier.
"""

import matplotlib.pyplot as plt

from hyperval.api import load_scenario
from hyperval.model import predictions

scenario = load_scenario("yellow-planks-asphalt")
figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
dofs = (3.0, 5.0, 10.0, 100.0)
truths = [{"scene.classes.asphalt.tail_dof": dof} for dof in dofs]
for dof, prediction in zip(dofs, predictions(scenario, truths), strict=True):
    curve = prediction.roc[("yellow plank 0.1", "cem", "pixel")]
    axes.plot(curve.pfa, curve.pd, label=f"{dof:g} degrees of freedom")
axes.set(xlabel="P_FA", ylabel="P_D", xscale="log", xlim=(1e-6, 1), ylim=(0, 1))
axes.legend()
