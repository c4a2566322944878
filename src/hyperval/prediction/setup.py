"""A scenario with everything read that its evaluation needs, what is refused, and what is said of it in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import PurePath
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.engine_ratio import GREATEST_AIR_ATM, GREATEST_WATER_G_CM2, ways
from hyperval.atmosphere.profiles import OZONE_G_CM2_PER_ATM_CM, column_g_cm2, standard_profile
from hyperval.atmosphere.solar import SPECTRA, source_samples
from hyperval.atmosphere.state import AtmosphericState
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.errors import InputError, UsageError
from hyperval.prediction.inputs import Read, Resolve, Sources, SurfaceStatistics, without_gaps
from hyperval.scenario import Fill, Scenario, Target
from hyperval.scenario_uncertainty import Uncertainty
from hyperval.scene.statistics import ClassStatistics
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.operation import binned_axis, binned_noise, changed_noise
from hyperval.sensor.response import mtf_at_nyquist
from hyperval.sensor.specification import Sensor, library_names, load_sensor
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Instrument:
    """Sensor, bands and noise of one prediction.

    Attributes
    ----------
    axis : the bands of all products, as they are labelled
    true_axis : where they truly stand; the same object where nothing is shifted
    noise : on ``axis``; None without a sensor
    """

    sensor: Sensor | None
    axis: SpectralAxis
    true_axis: SpectralAxis
    noise: NoiseModel | None


def _sensor(name: str, find: Resolve) -> Sensor:
    """A sensor of the library, or of a file beside the scenario."""
    if name in library_names():
        return load_sensor(name)
    try:
        path = find(name)
    except InputError:
        if PurePath(name).suffix or ":" in name:  # meant as a file
            raise
        raise UsageError(
            f"unknown sensor {name!r}", expected="a sensor file or one of " + ", ".join(library_names())
        ) from None
    return load_sensor(path)


def instrument(
    scenario: Scenario,
    axis: SpectralAxis | None,
    measured_axis: SpectralAxis | None,
    find: Resolve,
    given: Sensor | None = None,
) -> Instrument:
    """The sensor a scenario names, or the one given in its place, on the bands asked for or its own (3.13-3.20).

    Raises
    ------
    UsageError : no bands, or bins of bands that are handed in.
    """
    operation = scenario.sensor_operation
    sensor = given
    if sensor is None and scenario.sensor is not None:
        sensor = _sensor(scenario.sensor, find)
    on = axis or (sensor.axis if sensor else None) or measured_axis
    if on is None:
        raise UsageError(
            "the scenario has no bands",
            mend="name a sensor (sensor:), or run it from a campaign, whose image has bands (hyperval validate)",
        )
    if sensor is None:
        return Instrument(None, on, on, None)
    noise = sensor.noise(on, operation)
    if scenario.sensor_changes is not None:
        noise = changed_noise(noise, scenario.sensor_changes)
    true = sensor.true_axis(on, operation)
    count = operation.spectral_binning if operation else 1
    if count > 1:
        if axis is not None:
            raise UsageError(
                "sensor_operation.spectral_binning: the bands of a collection are what they are",
                mend="leave spectral_binning out: a binned cube has binned bands already",
            )
        if count > len(on):
            raise UsageError(f"sensor_operation.spectral_binning: bins of {count} of {len(on)} bands")
        shifted = true is not on
        on, noise = binned_axis(on, count), binned_noise(noise, count)
        true = binned_axis(true, count) if shifted else on
    return Instrument(sensor, on, true, noise)


def with_sensor_blur(scenario: Scenario, sensor: Sensor | None) -> Scenario:
    """The scenario with the sensor's point spread function where a geometry states none."""
    if sensor is None or sensor.specification.psf is None or not scenario.scene.targets:
        return scenario
    blur = sensor.specification.psf.fwhm

    def with_blur(fill: Fill | None) -> Fill | None:
        if fill is None or fill.geometry is None or fill.geometry.psf_fwhm_pixels is not None:
            return fill
        return fill.model_copy(update={"geometry": fill.geometry.model_copy(update={"psf_fwhm_pixels": blur})})

    def target(t: Target) -> Target:
        subjects = [s.model_copy(update={"fill": with_blur(s.fill)}) for s in t.subjects]
        return t.model_copy(update={"fill": with_blur(t.fill), "subjects": subjects})

    scene = scenario.scene.model_copy(update={"targets": [target(t) for t in scenario.scene.targets]})
    return scenario.model_copy(update={"scene": scene})


def refuse_gaps(scenario: Scenario, surfaces: Mapping[str, SurfaceStatistics], axis: SpectralAxis) -> None:
    """Refuse a spectrum that does not cover the band set: usable bands beyond one of its ends.

    Bands on the bad-band list may lack, and one band at each end; so may bands within
    the spectrum that its file marks as unknown.

    Raises
    ------
    UsageError : with the field of the scenario.
    """
    scene = scenario.scene
    for key, group in (
        ("classes", scene.classes), ("panels", scene.panels), ("sites", scene.sites), ("targets", scene.targets)
    ):  # fmt: skip
        for i, surface in enumerate(group):
            if surface.spectrum.measured is not None or surface.spectrum.gaps == "allowed":
                continue
            known = np.flatnonzero(np.isfinite(surfaces[surface.name].mean))
            beyond = axis.good.copy()
            # One band at each end may lack: its centre is covered where its response reaches a little further.
            beyond[max(known[0] - 1, 0) : known[-1] + 2] = False
            if beyond.any():
                w = axis.centre_nm[beyond]
                raise UsageError(
                    f"scene.{key}.{i}.spectrum of {surface.name!r} does not cover {int(beyond.sum())} usable bands "
                    f"(first {w[0]:g} nm, last {w[-1]:g} nm)",
                    expected=f"a spectrum over {axis.centre_nm[0]:g}-{axis.centre_nm[-1]:g} nm",
                    mend="give a longer spectrum, mark those bands bad, or allow it: spectrum: {gaps: allowed}",
                )


@dataclass(frozen=True, eq=False)
class Setup:
    """A scenario on its bands, all spectra read.

    Attributes
    ----------
    scenario : with the sensor's blur where it states none
    used : sensor, bands and noise
    surfaces : name -> statistics of every class, panel, site and target, where the bands truly stand
    signatures : target -> (B,) reflectance that its filter looks for, where the bands are labelled
    surroundings : (B,) their reflectance where the scenario states it; None: the average of the classes
    room : what follows from the scene alone, shared with setups of the same scene
    """

    scenario: Scenario
    used: Instrument
    surfaces: Mapping[str, SurfaceStatistics]
    signatures: Mapping[str, Array]
    surroundings: Array | None = None
    room: dict[Any, Any] = field(default_factory=dict)

    def average(self, of_classes: Array) -> Array:
        """(B,) rho_ave of (3.7): the stated surroundings, or the average of the classes (3.8)."""
        return of_classes if self.surroundings is None else self.surroundings

    @property
    def classes(self) -> list[str]:
        """Names of the M background classes."""
        return [c.name for c in self.scenario.scene.classes]


def setup_of(
    scenario: Scenario, used: Instrument, measured: Mapping[str, ClassStatistics], find: Resolve,
    read: Read | None = None,
) -> Setup:  # fmt: skip
    """Read every spectrum that a scenario names, but those of files that ``read`` holds already.

    Raises
    ------
    UsageError, InputError : a spectrum that is missing, corrupt, or does not cover the bands.
    """
    sources = Sources(used.true_axis, measured, find, used.axis, {} if read is None else read)
    surfaces, signatures = surfaces_of(scenario, sources, replace(sources, axis=used.axis, nominal=None))
    around, stated = scenario.scene.adjacency.spectrum, None
    if around is not None:
        stated = without_gaps(sources.spectrum(around, "surroundings").mean)
    return Setup(scenario, used, surfaces, signatures, stated)


def surfaces_of(
    scenario: Scenario, sources: Sources, labelled: Sources
) -> tuple[dict[str, SurfaceStatistics], dict[str, Array]]:
    """Statistics where the bands truly stand; what detectors look for where they are labelled."""
    scene = scenario.scene
    surfaces = {s.name: sources.surface(s) for s in (*scene.classes, *scene.panels, *scene.sites, *scene.targets)}
    refuse_gaps(scenario, surfaces, sources.axis)
    signatures = {}
    for t in scene.targets:
        if t.filter_spectrum is not None:
            signatures[t.name] = labelled.spectrum(t.filter_spectrum, t.name).mean
        elif sources.axis is labelled.axis:
            signatures[t.name] = surfaces[t.name].mean
        else:
            signatures[t.name] = labelled.spectrum(t.spectrum, t.name).mean
    return surfaces, signatures


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
