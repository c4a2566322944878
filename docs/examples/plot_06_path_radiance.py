"""
How much of the light never touched the ground?
===============================================

Radiance over ground of 0.1, and the path radiance in it, seen from 1, 3 and 20 km.
"""

import matplotlib.pyplot as plt

from hyperval.atmosphere import AtmosphericState, atmospheric_terms

figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
for height in (1.0, 3.0, 20.0):
    state = AtmosphericState(
        engine="emulator", aot550=0.15, sensor_altitude_km=height, solar_zenith_deg=35.0, solar_azimuth_deg=180.0,
        day_of_year=200,
    )  # fmt: skip
    terms = atmospheric_terms(state, show_progress=False)
    total = terms.path_radiance + 0.1 * (terms.direct + terms.adjacency) / (1 - 0.1 * terms.spherical_albedo)
    axes.plot(terms.wavelength_nm, terms.path_radiance / total, label=f"sensor at {height:g} km")
axes.set(xlabel="wavelength [nm]", ylabel="path radiance over radiance", xlim=(400, 1300), ylim=(0, 1))
axes.legend()
