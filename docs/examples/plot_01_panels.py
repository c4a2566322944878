"""
How bright is a grey panel at the sensor?
=========================================

The built-in scenario ``panels``: grey panels and a grass field under a clear sky, from an aircraft.
"""

import matplotlib.pyplot as plt

from hyperval.api import predict

prediction = predict("panels")
figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
prediction.plot.spectra(ax=axes)

# %%
# The same numbers as a table, radiance by band and subject.
prediction.to_xarray()["radiance"].to_pandas().T.head()
