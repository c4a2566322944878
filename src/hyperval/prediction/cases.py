"""Truths of a scenario as rows of a batch: what is there to be seen, and through what."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval import datasets
from hyperval.atmosphere import AtmosphericState, AtmosphericTerms, atmospheric_terms
from hyperval.prediction.background import Ground, Settings, ground_of, with_class_levels
from hyperval.prediction.batch import Batch, Points
from hyperval.prediction.departure import (
    Departure,
    keeps_surfaces,
    true_axis,
    true_noise,
    true_scenario,
    true_surfaces,
    true_terms,
)
from hyperval.prediction.fills import Fills, object_fills_of, pixel_fills, stacked_fills
from hyperval.prediction.inputs import Read, Resolve, class_tail
from hyperval.prediction.setup import Setup, instrument, setup_of, with_sensor_blur
from hyperval.prediction.view import View, stacked, stacked_noise
from hyperval.scenario import Scenario
from hyperval.scene.statistics import ClassStatistics
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.specification import Sensor
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Engine = Callable[[AtmosphericState], AtmosphericTerms]
_KEPT: OrderedDict[tuple[object, ...], AtmosphericTerms] = OrderedDict()
_MOST = 32
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
    retrieval : (B,) gain and offset of what the empirical line gives; None: the reflectance itself
    """

    setup: Setup
    terms: AtmosphericTerms | None
    noise: NoiseModel | None
    surroundings: float | Array = 1.0
    retrieval: tuple[Array, Array] | None = None


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
    gain, offset = np.asarray(d.retrieval_gain, dtype=float), np.asarray(d.retrieval_offset, dtype=float)
    retrieval = case.retrieval
    if np.any(gain != 1.0) or np.any(offset != 0.0):
        g, o = np.broadcast_to(gain, (bands,)), np.broadcast_to(offset, (bands,))
        if retrieval is not None:  # off already: one after the other
            g, o = g * retrieval[0], g * retrieval[1] + o
        retrieval = g, o
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
    average = np.array(
        [c.setup.average(each[w].average) * c.surroundings for w, c in zip(which, cases, strict=True)]
    )[:, None, :]
    terms = [c.terms for c in cases if c.terms is not None]
    noises = [c.noise for c in cases if c.noise is not None]
    retrieval = None
    if any(c.retrieval is not None for c in cases):
        plain = np.ones(bands), np.zeros(bands)
        pairs = [c.retrieval or plain for c in cases]
        retrieval = np.array([p[0] for p in pairs])[:, None, :], np.array([p[1] for p in pairs])[:, None, :]
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
    law_dof, first = None, cases[0].setup
    if any(first.surfaces[name].components is not None for name in first.classes):
        law_dof = np.array([_law_tails(x, row) for x, row in zip(cases, dof, strict=True)])[setting]

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
        law_dof,
    )


def _law_tails(case: Case, dof: Array) -> list[float]:
    """Degrees of freedom of the laws of all classes: a component has its own where the class states no number."""
    out: list[float] = []
    for c, tail in zip(case.setup.scenario.scene.classes, dof.tolist(), strict=True):
        parts = case.setup.surfaces[c.name].components
        if parts is None:
            out.append(tail)
        else:
            out += [tail if isinstance(c.tail_dof, float) else parts.dof] * len(parts)
    return out


def batch_of(
    cases: Sequence[Case], errors: Mapping[str, Array] | None = None, shifts: Sequence[float] = ()
) -> Batch:
    """Evaluations of cases that share names, processing and what is looked for.

    After them come, for each of ``shifts``, the first case with all targets so many standard deviations of the
    score off their spectra, by the ``errors`` of those.
    """
    first = cases[0].setup
    setting = np.concatenate([np.arange(len(cases)), np.zeros(len(shifts), int)])
    shift = np.concatenate([np.zeros(len(cases)), shifts])
    points = points_of(cases, setting, shift)
    return Batch(first.scenario, first.used.axis, first.signatures, settings_of(cases), points, errors)
