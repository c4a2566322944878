"""Direct normal irradiance of ASTM G173-03 (computed by its authors with SMARTS 2.9.2), as pvlib ships it."""

from __future__ import annotations

import numpy as np
import pytest
from pvlib import spectrum

from hyperval.atmosphere import AtmosphericState, atmospheric_terms
from hyperval.spectra import SpectralAxis, band_average
from hyperval.units import irradiance_to_internal

# The standard's conditions: US standard atmosphere, air mass 1.5, 1.416 cm of water, 0.3438 atm cm of ozone, rural
# aerosol of optical depth 0.084 at 500 nm (carried to 550 nm with the Angstrom exponent 1.14).
ZENITH_DEG = 48.236
STATE = AtmosphericState(
    model="us-standard-1962",
    water_vapour_g_cm2=1.416,
    ozone_atm_cm=0.3438,
    solar_spectrum="astm-g173",
    aerosol="rural",
    aot550=0.084 * (550 / 500) ** -1.14,
    sensor_altitude_km=100,
    solar_zenith_deg=ZENITH_DEG,
    solar_azimuth_deg=0,
    earth_sun_distance_au=1.0,
)
AXIS = SpectralAxis(np.arange(400.0, 2451.0, 10.0), 10.0)

# Windows of the standard [nm].
WINDOWS = {400: 500, 500: 680, 740: 750, 775: 800, 845: 885, 995: 1075, 1520: 1555, 1620: 1720, 2095: 2340}


@pytest.fixture(scope="module")
def ratio():
    """Ours over the standard's, in bands of 10 nm."""
    terms = atmospheric_terms(STATE, show_progress=False)
    direct = terms.ground_irradiance * (1.0 - terms.diffuse_fraction) / np.cos(np.radians(ZENITH_DEG))
    table = spectrum.get_reference_spectra(standard="ASTM G173-03")
    unit = irradiance_to_internal("W m-2 nm-1")
    standard = band_average(table.index.to_numpy(float), table["direct"].to_numpy(float) * unit, AXIS)
    return band_average(terms.wavelength_nm, direct, AXIS) / standard


def between(low: float, high: float) -> np.ndarray:
    return (AXIS.centre_nm >= low) & (AXIS.centre_nm <= high)


@pytest.mark.slow
@pytest.mark.parametrize("low", WINDOWS)
def test_windows_agree_to_two_percent(ratio, low):
    assert 0.98 <= np.median(ratio[between(low, WINDOWS[low])]) <= 1.02


@pytest.mark.slow
def test_water_bands_agree_too_though_the_ratio_came_from_another_program(ratio):
    # 6S alone is 1.31 and 1.13 here; carbon dioxide at 2 um remains, told in validation/atmosphere/README.md.
    for low, high in ((900, 990), (1105, 1150), (1300, 1340), (1480, 1510)):
        assert 0.98 < np.median(ratio[between(low, high)]) < 1.02
    assert 0.85 < np.median(ratio[between(2000, 2080)]) < 0.95
