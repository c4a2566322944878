"""
How does a wavelength shift show?
=================================

All bands 0.5 nm further into the red: the edges of absorption bands give it away.
"""

import matplotlib.pyplot as plt

from hyperval.api import load_scenario
from hyperval.model import predict, predictions

scenario = load_scenario("panels")
stated = predict(scenario)
(shifted,) = predictions(scenario, [{"sensor.wavelength_shift_nm": 0.5}])
subject = next(iter(stated.radiance))

figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
axes.plot(stated.axis.centre_nm, shifted.radiance[subject].mean / stated.radiance[subject].mean - 1)
axes.set(xlabel="wavelength [nm]", ylabel="change of the radiance", xlim=(400, 1300), ylim=(-0.1, 0.1))
axes.axvline(762, color="0.6", linestyle="dotted")
axes.annotate("oxygen A", (765, 0.08))
