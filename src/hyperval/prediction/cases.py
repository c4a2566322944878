"""Truths of a scenario as rows of a batch: what is there to be seen, and through what.

A scenario with everything read that its evaluation needs, what is refused, and what is said of it in words.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval import datasets
from hyperval.atmosphere import atmospheric_terms
from hyperval.atmosphere.physics import GREATEST_AIR_ATM, GREATEST_WATER_G_CM2, ways
from hyperval.atmosphere.solar import SPECTRA, source_samples
from hyperval.atmosphere.state import OZONE_G_CM2_PER_ATM_CM, AtmosphericState, column_g_cm2, standard_profile
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.errors import InputError, UsageError
from hyperval.prediction.background import Ground, Settings, View, ground_of, stacked, stacked_noise, with_class_levels
from hyperval.prediction.batch import Batch, Points
from hyperval.prediction.departure import (
    Departure,
    Fills,
    keeps_surfaces,
    object_fills_of,
    pixel_fills,
    stacked_fills,
    true_axis,
    true_noise,
    true_scenario,
    true_surfaces,
    true_terms,
)
from hyperval.prediction.inputs import Read, Resolve, Sources, SurfaceStatistics, class_tail, without_gaps
from hyperval.scenario import Fill, Scenario, Target, Uncertainty
from hyperval.scene.statistics import ClassStatistics
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.response import mtf_at_nyquist
from hyperval.sensor.specification import Sensor, binned_axis, binned_noise, changed_noise, library_names, load_sensor
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


Engine = Callable[[AtmosphericState], AtmosphericTerms]
_KEPT: OrderedDict[tuple[object, ...], AtmosphericTerms] = OrderedDict()
_MOST = 32
_NOT_OFF = np.array([[1.0], [1.0], [1.0], [0.0]])  # panels, gain and offset of a line that gives the reflectance
# What decides which files an engine finds.
_ENVIRONMENT = (
    "HYPERVAL_CACHE", "HYPERVAL_DATA", "HYPERVAL_MODTRAN", "HYPERVAL_MODTRAN_VERSION", "HYPERVAL_MODTRAN_DATA"
)  # fmt: skip


def terms_in_memory(
    engine: Callable[..., AtmosphericTerms],
    state: AtmosphericState,
    axis: SpectralAxis,
    *,
    cache_dir: Path | None,
    show_progress: bool | None,
) -> AtmosphericTerms:
    """The terms of ``engine`` at the bands of ``axis``; the latest 32 are kept in memory.

    Engines are deterministic: the same engine, state, place of its files and bands give the same terms.
    """
    key = (
        engine, state, cache_dir, *(os.environ.get(name) for name in _ENVIRONMENT),
        axis.centre_nm.tobytes(), axis.fwhm_nm.tobytes(),
    )  # fmt: skip
    terms = _KEPT.get(key)
    if terms is None:
        terms = engine(state, cache_dir=cache_dir, show_progress=show_progress).at_bands(axis)
        _KEPT[key] = terms
        if len(_KEPT) > _MOST:
            _KEPT.popitem(last=False)
    _KEPT.move_to_end(key)
    return terms


@dataclass(frozen=True)
class Origins:
    """Where the numbers of a scenario come from, besides what it says itself.

    Attributes
    ----------
    axis : bands of all products; None: the sensor's own, or those of the measured statistics
    measured : region -> reflectance statistics on ``axis``, for surfaces with ``measured:``
    resolve : turns a file reference of the scenario into a path; None: relative to the scenario's file, or
        ``data:`` for a registered data set
    cache_dir, show_progress : of the atmosphere engine
    engine : stands in for the atmosphere engine
    sensor : stands in for the sensor that the scenario names
    left_out : (region, its measured statistics without each of the parts of the image that it lies in), of the
        regions whose law is known from their pixels alone
    read : spectra of the scenario's files, once they were read
    """

    axis: SpectralAxis | None = None
    measured: Mapping[str, ClassStatistics] | None = None
    resolve: Resolve | None = None
    cache_dir: Path | None = None
    show_progress: bool | None = None
    engine: Engine | None = None
    sensor: Sensor | None = None
    left_out: Callable[[], Iterable[tuple[str, Sequence[ClassStatistics]]]] | None = None
    read: Read = field(default_factory=dict, repr=False, compare=False)

    def find(self, scenario: Scenario) -> Resolve:
        """Turns the file references of a scenario into paths."""
        return self.resolve or (lambda reference: datasets.resolve(reference, scenario.folder))

    def setup(self, scenario: Scenario, truth: Departure) -> Setup:
        """The scenario as it truly is, all spectra read (3.7-3.20).

        Raises
        ------
        UsageError, InputError : a scenario that contradicts itself, a file that is missing or corrupt.
        """
        find, measured = self.find(scenario), self.measured or {}
        there = true_scenario(scenario, truth)
        used = instrument(there, self.axis, next((s.axis for s in measured.values()), None), find, self.sensor)
        used = replace(used, true_axis=true_axis(used.true_axis, truth))
        setup = setup_of(with_sensor_blur(there, used.sensor), used, measured, find, self.read)
        return replace(setup, surfaces=true_surfaces(setup.scenario, setup.surfaces, truth))

    def terms(self, setup: Setup, state: AtmosphericState) -> AtmosphericTerms:
        """Terms of a state of the atmosphere on the true bands.

        Raises
        ------
        EngineError : the atmosphere engine failed.
        """
        true = setup.used.true_axis
        if self.engine is not None:
            return self.engine(state).at_bands(true)
        if state.engine == "table":  # a file of the scenario, read again when it changes
            return atmospheric_terms(state, resolve=self.find(setup.scenario)).at_bands(true)
        call = atmospheric_terms
        return terms_in_memory(call, state, true, cache_dir=self.cache_dir, show_progress=self.show_progress)

    def whole_terms(self, scenario: Scenario, state: AtmosphericState) -> AtmosphericTerms:
        """The same on the engine's own sampling."""
        if self.engine is not None:
            return self.engine(state)
        if state.engine == "table":
            return atmospheric_terms(state, resolve=self.find(scenario))
        return atmospheric_terms(state, cache_dir=self.cache_dir, show_progress=self.show_progress)


@dataclass(frozen=True, eq=False)
class Case:
    """One truth.

    Attributes
    ----------
    setup : the scenario as it truly is
    terms, noise : of what is recorded, on the bands; None in the reflectance domain
    surroundings : factor on their reflectance
    retrieval : (4, B) factors on the true reflectance of the dark and the bright panel of the empirical line, gain
        and offset of what it gives; None: nothing is off
    """

    setup: Setup
    terms: AtmosphericTerms | None
    noise: NoiseModel | None
    surroundings: float | Array = 1.0
    retrieval: Array | None = None


def case_of(scenario: Scenario, origins: Origins, truth: Departure, like: Case | None = None) -> Case:
    """The case of a truth.

    ``like`` : of the scenario as stated, whose spectra and terms serve where the truth leaves them alone
    """
    if like is None or _reads_anew(truth):
        setup = origins.setup(scenario, truth)
        state = setup.scenario.atmosphere
        terms = origins.terms(setup, state) if state is not None else None
    else:
        before, there = like.setup, true_scenario(scenario, truth)
        there = before.scenario if there is scenario else with_sensor_blur(there, before.used.sensor)
        alone = keeps_surfaces(truth) and like.terms is not None
        surfaces = before.surfaces if alone else true_surfaces(there, before.surfaces, truth)
        room = before.room if there.scene is before.scenario.scene else {}
        setup = replace(before, scenario=there, surfaces=surfaces, room=room)
        state, terms = there.atmosphere, like.terms
        if state is not None and state != before.scenario.atmosphere:
            terms = origins.terms(setup, state)
    return moved(Case(setup, terms, setup.used.noise if state is not None else None), truth)


def stepped(case: Case, origins: Origins, truth: Departure, d: Departure) -> Case:
    """A case whose light and sensor depart further, by ``d``; ``truth`` is how it departs already."""
    terms = case.terms
    if terms is not None and (d.settings or d.solar_zenith_deg or d.solar_azimuth_deg):
        state = true_scenario(case.setup.scenario, d).atmosphere
        assert state is not None  # noqa: S101 - there is light
        terms = true_terms(origins.terms(case.setup, state), truth)
    return moved(replace(case, terms=terms), d)


def _reads_anew(truth: Departure) -> bool:
    """Whether spectra have to be read again: other bands, or another scenario."""
    shifted = np.any(np.asarray(truth.wavelength_shift_nm) != 0.0)
    return bool(shifted) or not all(path.startswith("atmosphere.") for path in truth.settings)


def moved(case: Case, d: Departure) -> Case:
    """A case whose light, sensor and empirical line depart; its surfaces and state stay."""
    bands = len(case.setup.used.axis)
    off = np.array(
        [np.broadcast_to(x, (bands,)) for x in (d.dark_panel, d.bright_panel, d.retrieval_gain, d.retrieval_offset)]
    )
    retrieval = case.retrieval
    if np.any(off != _NOT_OFF):
        if retrieval is not None:  # off already: one after the other
            dark, bright, gain, offset = retrieval
            off = np.array([dark * off[0], bright * off[1], gain * off[2], off[2] * offset + off[3]])
        retrieval = off
    return replace(
        case,
        terms=None if case.terms is None else true_terms(case.terms, d),
        noise=true_noise(case.noise, d),
        surroundings=np.asarray(case.surroundings) * d.surroundings,
        retrieval=retrieval,
    )


def settings_of(cases: Sequence[Case]) -> Settings:
    """Cases of one scenario as settings of a batch."""
    first = cases[0].setup
    bands, scenario = len(first.used.axis), first.scenario
    scenes = [c.setup.scenario.scene for c in cases]
    fractions = np.array([[c.fraction for c in s.classes] for s in scenes])
    grounds: dict[tuple[int, bytes], Ground] = {}
    keys = [(id(c.setup.surfaces), f.tobytes()) for c, f in zip(cases, fractions, strict=True)]
    for key, case, f in zip(keys, cases, fractions, strict=True):
        if key not in grounds:
            like = [g for (_, other), g in grounds.items() if other == key[1]]
            grounds[key] = ground_of(case.setup.surfaces, case.setup.classes, f, like)
    order = {key: i for i, key in enumerate(grounds)}
    which, each = np.array([order[key] for key in keys]), list(grounds.values())
    average = np.array([c.setup.average(each[w].average) * c.surroundings for w, c in zip(which, cases, strict=True)])[
        :, None, :
    ]
    terms = [c.terms for c in cases if c.terms is not None]
    noises = [c.noise for c in cases if c.noise is not None]
    retrieval = None
    if any(c.retrieval is not None for c in cases):
        plain = np.broadcast_to(_NOT_OFF, (4, bands))
        off = np.array([plain if c.retrieval is None else c.retrieval for c in cases])
        retrieval = tuple(off.swapaxes(0, 1)[:, :, None, :])
    elm = scenario.processing.elm
    view = View(
        stacked(terms, bands) if terms else None,
        average,
        stacked_noise(noises, bands) if noises else None,
        np.array([s.adjacency.kappa for s in scenes])[:, None, None],
        scenario.formulation,
        None if elm == "none" else elm,
        retrieval=retrieval,
    )
    gains = np.array([[c.gain for c in s.classes] for s in scenes])
    return with_class_levels(Settings(view, fractions, gains, tuple(each), which))


def points_of(cases: Sequence[Case], setting: npt.NDArray[np.intp], shift: Array | float = 0.0) -> Points:
    """What the evaluations have besides light, sensor and ground; ``setting`` (n,) is the number of their case."""
    scenarios = [c.setup.scenario for c in cases]

    def of_targets(value: Callable[[Any], float]) -> Array:
        each = np.array([[value(t) for t in s.scene.targets] for s in scenarios]).reshape(len(cases), -1)
        return each[setting]

    tails = [[class_tail(c, x.setup.surfaces[c.name]) for c in x.setup.scenario.scene.classes] for x in cases]
    dof = np.array([[np.inf if t is None else float(t) for t in row] for row in tails])
    laws, first = None, cases[0].setup
    if any(first.surfaces[name].components is not None for name in first.classes):
        owner, _ = _laws_of(cases[0])
        laws = np.array(owner), np.array([_laws_of(x)[1] for x in cases])[setting]

    def fills(target: int, population: int, objects: bool) -> Fills | None:
        subjects = [s.scene.targets[target].populations[population] for s in scenarios]
        different: list[Any] = []
        numbers = []
        for subject in subjects:
            at = next((i for i, d in enumerate(different) if d is subject or d == subject), None)
            if at is None:
                at = len(different)
                different.append(subject)
            numbers.append(at)
        thesis, make = scenarios[0].formulation == "thesis", object_fills_of if objects else pixel_fills
        return stacked_fills([make(d, thesis) for d in different], np.array(numbers)[setting])

    return Points(
        setting,
        dof[setting],
        of_targets(lambda t: t.gain),
        of_targets(lambda t: t.illumination.beam if t.illumination else 1.0),
        of_targets(lambda t: t.illumination.sky_view if t.illumination else 1.0),
        fills,
        shift,
        laws,
    )


def _laws_of(case: Case) -> tuple[list[int], list[float]]:
    """Class and own degrees of freedom of each law: a component has them where its class states no number."""
    owner: list[int] = []
    own: list[float] = []
    for number, c in enumerate(case.setup.scenario.scene.classes):
        parts = case.setup.surfaces[c.name].components
        count = 1 if parts is None else len(parts)
        owner += [number] * count
        own += [np.nan if parts is None or isinstance(c.tail_dof, float) else parts.dof] * count
    return owner, own


def batch_of(cases: Sequence[Case], errors: Mapping[str, Array] | None = None, shifts: Sequence[float] = ()) -> Batch:
    """Evaluations of cases that share names, processing and what is looked for.

    After them come, for each of ``shifts``, the first case with all targets so many standard deviations of the
    score off their spectra, by the ``errors`` of those.
    """
    first = cases[0].setup
    setting = np.concatenate([np.arange(len(cases)), np.zeros(len(shifts), int)])
    shift = np.concatenate([np.zeros(len(cases)), shifts])
    points = points_of(cases, setting, shift)
    return Batch(first.scenario, first.used.axis, first.signatures, settings_of(cases), points, errors)
