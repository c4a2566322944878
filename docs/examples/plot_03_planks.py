"""
How small a plank can be found?
===============================

Yellow planks on asphalt that fill 2, 5 and 10 % of a pixel: probability of detection against that of a false alarm.
"""

import matplotlib.pyplot as plt

from hyperval.api import predict

figure, axes = plt.subplots(figsize=(7, 5), layout="constrained")
curves = predict("yellow-planks-asphalt").roc.query("detector == 'cem' and unit == 'pixel'")
for subject, curve in curves.groupby("subject"):
    axes.plot(curve["pfa"], curve["pd"], label=subject)
axes.set(xlabel="P_FA", ylabel="P_D", xscale="log", xlim=(1e-6, 1), ylim=(0, 1))
axes.legend()
