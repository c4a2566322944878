"""What a prediction says of its sensor, and of what was not stated, in words."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.profiles import OZONE_G_CM2_PER_ATM_CM, column_g_cm2, standard_profile
from hyperval.atmosphere.state import AtmosphericState
from hyperval.prediction.setup import Instrument
from hyperval.scenario_uncertainty import Uncertainty
from hyperval.sensor.mtf import mtf_at_nyquist
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]


def unstated_notes(state: AtmosphericState | None, uncertainty: Uncertainty) -> list[str]:
    """Gas columns that come from the standard atmosphere, and a scenario that states no uncertainty at all."""
    notes = []
    if state is not None and state.engine == "sixs":
        profile, ground = standard_profile(state.model), state.ground_altitude_km
        words = f"that of the standard atmosphere {state.model} is taken"
        if state.water_vapour_g_cm2 is None:
            water = column_g_cm2(profile, profile.water_g_m3, ground)
            notes.append(f"water vapour is not stated: {words}, {water:.2f} g cm-2")
        if state.ozone_atm_cm is None:
            ozone = column_g_cm2(profile, profile.ozone_g_m3, ground) / OZONE_G_CM2_PER_ATM_CM
            notes.append(f"ozone is not stated: {words}, {ozone:.3f} atm cm")
    if uncertainty == Uncertainty():
        notes.append("the scenario states no uncertainty: intervals and tests hold little but the collection's own")
    return notes


def sensor_notes(used: Instrument) -> list[str]:
    """Assumptions of the sensor file, MTF at Nyquist, shift of the bands."""
    sensor = used.sensor
    if sensor is None or used.noise is None:
        return []
    notes = [f"sensor {sensor.name}: {text}" for text in used.noise.assumed]
    if sensor.specification.psf is not None:
        along, across = mtf_at_nyquist(np.array(sensor.specification.psf.fwhm))
        notes.append(f"sensor {sensor.name}: MTF at Nyquist {along:.3f} along, {across:.3f} across the track")
    if used.true_axis is not used.axis:
        shift = used.true_axis.centre_nm - used.axis.centre_nm
        notes.append(
            f"sensor {sensor.name}: bands stand {shift.min():+.3g} to {shift.max():+.3g} nm off their labels"
        )
    return notes


def saturation_notes(full_scale: Mapping[str, Array], axis: SpectralAxis) -> list[str]:
    """One note for each subject whose mean radiance passes full scale."""
    notes = []
    for subject, part in full_scale.items():
        over = part > 1.0
        if over.any():
            at = int(np.nanargmax(part))
            notes.append(
                f"SATURATION: {subject} passes full scale in {int(over.sum())} bands, "
                f"at most {part[at]:.2f} of it at {axis.centre_nm[at]:g} nm"
            )
    return notes
