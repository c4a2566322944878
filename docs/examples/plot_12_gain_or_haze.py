"""
Do a gain error and haze look alike?
====================================

Radiance of a panel with 4 % more gain, and with 30 % more path radiance, over what the scenario says.
"""

import matplotlib.pyplot as plt

from hyperval.api import load_scenario
from hyperval.model import predict, predictions

scenario = load_scenario("panels")
stated = predict(scenario)
subject = next(iter(stated.radiance))
truths = {"gain 4 % up": {"sensor.gain": 1.04}, "path radiance 30 % up": {"light.path": 1.3}}

figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
for (name, _), moved in zip(truths.items(), predictions(scenario, truths.values()), strict=True):
    axes.plot(stated.axis.centre_nm, moved.radiance[subject].mean / stated.radiance[subject].mean - 1, label=name)
axes.set(xlabel="wavelength [nm]", ylabel=f"change of the radiance of {subject}", xlim=(400, 1300))
axes.legend()
