"""
Which sensor has the best signal-to-noise ratio?
================================================

Sensors of the library at the same radiance, that of sunlit ground of 0.25 without an atmosphere.
"""

import matplotlib.pyplot as plt

from hyperval.sensor import load_sensor
from hyperval.sensor_check.suite import sunlit_radiance

figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
for name in ("aviris-ng", "emit", "enmap", "prisma", "hyspex-vnir-1600"):
    sensor = load_sensor(name)
    snr = sensor.noise().snr(sunlit_radiance(sensor.axis, 0.25))
    axes.plot(sensor.axis.centre_nm, snr, label=name)
axes.set(xlabel="wavelength [nm]", ylabel="signal-to-noise ratio", xlim=(400, 2500))
axes.legend()
