"""
Where are the atmospheric windows?
==================================

Two-way transmittance of the gases, for a dry and a moist atmosphere; shaded where comparisons leave bands out.
"""

import matplotlib.pyplot as plt

from hyperval.atmosphere import AtmosphericState, atmospheric_terms
from hyperval.spectra import in_window

figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
for water in (0.5, 3.0):
    state = AtmosphericState(
        engine="emulator", aot550=0.1, water_vapour_g_cm2=water, sensor_altitude_km=3.0, solar_zenith_deg=35.0,
        solar_azimuth_deg=180.0, day_of_year=200,
    )  # fmt: skip
    terms = atmospheric_terms(state, show_progress=False)
    axes.plot(terms.wavelength_nm, terms.gas_transmittance, label=f"water vapour {water:g} g cm-2", linewidth=0.8)
outside = ~in_window(terms.wavelength_nm)
axes.fill_between(terms.wavelength_nm, 0, 1, where=outside, color="0.9", zorder=0)
axes.set(xlabel="wavelength [nm]", ylabel="transmittance of the gases", xlim=(400, 2500), ylim=(0, 1))
axes.legend()
