"""What is to be said of a prediction: what is assumed, and where an engine or a sensor reaches its end."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.physics import GREATEST_AIR_ATM, GREATEST_WATER_G_CM2, ways
from hyperval.atmosphere.solar import SPECTRA, source_samples
from hyperval.atmosphere.state import OZONE_G_CM2_PER_ATM_CM, AtmosphericState, column_g_cm2, standard_profile
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.model.world import Stated
from hyperval.scenario import Uncertainty
from hyperval.sensor.response import mtf_at_nyquist
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


def engine_notes(state: AtmosphericState | None, terms: AtmosphericTerms | None) -> list[str]:
    """A stated sun that a table replaces, bands beyond its spectrum, amounts beyond those of the engine's gases."""
    if state is None or terms is None:
        return []
    notes = []
    sun = terms.provenance.get("solar_spectrum")
    if sun in SPECTRA:
        first, last = source_samples(sun)[0][[0, -1]]
        beyond = terms.wavelength_nm[(terms.wavelength_nm < first) | (terms.wavelength_nm > last)]
        if beyond.size:
            notes.append(
                f"the solar spectrum {sun} covers {first:g}-{last:g} nm: in {beyond.size} of "
                f"{terms.wavelength_nm.size} bands, beyond it, the sunlight has the shape of astm-g173"
            )
    if sun == "of the table" and "solar_spectrum" in state.model_fields_set:
        notes.append(
            f"the table brings a solar spectrum of its own: solar_spectrum {state.solar_spectrum}, "
            "which the scenario states, is not used"
        )
    if terms.provenance.get("engine_ratio"):
        _, way = ways(state)
        for amount, greatest, words in (
            (way.air_atm, GREATEST_AIR_ATM, "atm of air"),
            (way.water_g_cm2, GREATEST_WATER_G_CM2, "g cm-2 of water vapour"),
        ):
            if amount > greatest:
                notes.append(
                    f"the light goes through {amount:.2g} {words}: the engine's gases were compared with MODTRAN 6 "
                    f"up to {greatest:g}"
                )
    return notes


def sensor_notes(used: Stated) -> list[str]:
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
        notes.append(f"sensor {sensor.name}: bands stand {shift.min():+.3g} to {shift.max():+.3g} nm off their labels")
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


def provenance_of(stated: Stated, terms: AtmosphericTerms | None) -> dict[str, object]:
    """Where the numbers of a prediction come from."""
    scenario, sensor = stated.scenario, stated.sensor
    record: dict[str, object] = {
        "scenario": scenario.name,
        "formulation": scenario.formulation,
        "atmosphere": terms.provenance if terms else None,
        "sensor": {"name": sensor.name, "source": sensor.specification.source} if sensor else None,
        "spectra": {name: s.source for name, s in stated.surfaces.items()},
    }
    if scenario.atmosphere is not None and scenario.atmosphere.time_utc is not None:
        record["time_utc"] = scenario.atmosphere.time_utc
    if scenario.sensor_operation is not None:
        record["sensor_operation"] = scenario.sensor_operation.model_dump(mode="json")
    if scenario.sensor_changes is not None:
        record["sensor_changes"] = scenario.sensor_changes.model_dump(mode="json")
    return record
