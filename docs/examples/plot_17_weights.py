"""
Which bands does the matched filter use?
========================================

Its weights look where target and background differ, and away from what varies in the background.
"""

import matplotlib.pyplot as plt
import numpy as np

from hyperval.api import predict
from hyperval.model import matched_filter_weights

prediction = predict("yellow-planks-asphalt")
background = prediction.reflectance["asphalt"]
target = prediction.reflectance["yellow plank 0.1"].mean
good = np.isfinite(target) & (prediction.axis.centre_nm < 1000)
covariance = background.pixel_covariance
weights = matched_filter_weights(target[good], background.mean[good], covariance[np.ix_(good, good)]).weights

figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
axes.plot(prediction.axis.centre_nm[good], weights)
axes.axhline(0, color="0.6", linewidth=0.8)
axes.set(xlabel="wavelength [nm]", ylabel="weight per unit of reflectance")
