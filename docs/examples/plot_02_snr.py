"""
What is the signal-to-noise ratio over grass?
=============================================

Noise from photons, the detector, quantisation and calibration, band by band.
"""

import matplotlib.pyplot as plt

from hyperval.api import predict

prediction = predict("panels")
wavelength = prediction.axis.centre_nm

figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
axes.plot(wavelength, prediction.snr["grass"].mean)
axes.set(xlabel="wavelength [nm]", ylabel="signal-to-noise ratio")

# %%
# Where the noise comes from: variances add.
figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
for source, variance in prediction.noise["grass"].items():
    axes.plot(wavelength, variance, label=source)
axes.set(xlabel="wavelength [nm]", ylabel="variance of a pixel's radiance", yscale="log")
axes.legend()
