"""
What does haze do to a bright and a dark surface?
=================================================

Radiance at the sensor over ground of 0.05 and of 0.5, as the aerosol optical depth rises.
"""

import matplotlib.pyplot as plt
import numpy as np

from hyperval.atmosphere import AtmosphericState, atmospheric_terms

depths = np.linspace(0.02, 0.6, 12)
radiance = {0.05: [], 0.5: []}
for depth in depths:
    state = AtmosphericState(
        engine="emulator", aot550=float(depth), sensor_altitude_km=3.0, solar_zenith_deg=35.0,
        solar_azimuth_deg=180.0, day_of_year=200,
    )  # fmt: skip
    terms = atmospheric_terms(state, show_progress=False)
    band = int(np.abs(terms.wavelength_nm - 450).argmin())
    for ground, values in radiance.items():
        light = ground * (terms.direct + terms.adjacency) / (1 - ground * terms.spherical_albedo)
        values.append((terms.path_radiance + light)[band])

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for ground, values in radiance.items():
    axes.plot(depths, np.array(values) / values[0], "o-", label=f"ground of {ground:g}")
axes.set(xlabel="aerosol optical depth at 550 nm", ylabel="radiance at 450 nm, relative to clear air")
axes.legend()
