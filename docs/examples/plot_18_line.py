"""
Does the empirical line give the reflectance back?
==================================================

Reflectance of the subjects of the built-in scenario after two panels, as the model predicts it.
"""

import matplotlib.pyplot as plt

from hyperval.api import predict

prediction = predict("yellow-planks-asphalt")
figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
prediction.plot.spectra("reflectance", ax=axes)
