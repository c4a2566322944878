"""From a scenario to its products by statistics alone: the forward model (3.7-3.33)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from hyperval import datasets
from hyperval.atmosphere import AtmosphericState, AtmosphericTerms, atmospheric_terms
from hyperval.errors import UsageError
from hyperval.prediction.budget import inputs_of, spectrum_inputs
from hyperval.prediction.departure import (
    Departure,
    combined,
    departed_axis,
    departed_noise,
    departed_scenario,
    departed_surfaces,
    departed_terms,
    with_retrieval,
)
from hyperval.prediction.detection import Background, Detection, Task, detect, seen_background
from hyperval.prediction.field_spectra import spectrum_error_covariance
from hyperval.prediction.input import Input
from hyperval.prediction.input_paths import Given
from hyperval.prediction.inputs import Resolve, Sources, SurfaceStatistics, class_tail, cut, filled
from hyperval.prediction.notes import saturation_notes, sensor_notes, unstated_notes
from hyperval.prediction.object_scores import predicted_object_scores
from hyperval.prediction.setup import Instrument, instrument, refuse_gaps, with_sensor_blur
from hyperval.prediction.spectra import SpectralProducts, spectral_products, without_calibration_error
from hyperval.prediction.terms import remembered
from hyperval.prediction.uncertainty import (
    MOST_DIRECTIONS,
    Perturbation,
    moved_predictions,
    perturbations,
    with_bands,
    with_moves,
)
from hyperval.prediction.view import ClassLevels, View
from hyperval.processing.roc_model import false_alarm_grid
from hyperval.products import PixelDistribution, Prediction
from hyperval.scenario import DarkestPixel, Scenario
from hyperval.scenario_uncertainty import Uncertainty
from hyperval.scene.mixture import average_reflectance, mixture_covariance
from hyperval.scene.statistics import ClassStatistics
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.specification import Sensor
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.windows import in_window

__all__ = ["detection_bands", "predict", "predictions", "surfaces_of", "without_calibration_error"]

Array = npt.NDArray[np.float64]
Engine = Callable[[AtmosphericState], AtmosphericTerms]


def predict(
    scenario: Scenario,
    *,
    axis: SpectralAxis | None = None,
    measured: Mapping[str, ClassStatistics] | None = None,
    resolve: Resolve | None = None,
    cache_dir: Path | None = None,
    show_progress: bool | None = None,
    engine: Engine | None = None,
    departure: Departure | None = None,
    sensor: Sensor | None = None,
    objects: bool | int = False,
    object_curves: bool = True,
) -> Prediction:
    """Predict radiance, SNR, reflectance, detector scores and ROC of a scenario (3.7-3.33).

    Parameters
    ----------
    scenario : what to predict
    axis : bands of all products; default: the sensor's own, or those of the measured statistics
    measured : region -> reflectance statistics on ``axis``, for surfaces with ``measured:``
    resolve : turns a file reference of the scenario into a path; default: relative to the scenario's
        file, or ``data:`` for a registered data set
    cache_dir, show_progress : of the atmosphere engine
    engine : stands in for the atmosphere engine
    sensor : stands in for the sensor that the scenario names
    departure : how the truth departs from the scenario; None: not at all
    objects : also draw the scores of whole objects, which takes a few seconds where there are many; a number is
        that of draws where no input is uncertain
    object_curves : also the ROC curves of whole objects, half of the time where there are many targets

    Returns
    -------
    Prediction.  Subjects of ``radiance`` and ``reflectance`` are classes, panels, sites and target
    populations; ``snr`` holds each class, panel and site twice, with C_R and under
    :func:`without_calibration_error`.  In the reflectance domain there is no radiance and no SNR.
    A shifted spectrometer is labelled by its nominal bands.

    Raises
    ------
    UsageError : a scenario that contradicts itself, or a covariance that cannot be inverted.
    InputError : a file that is missing or corrupt.
    EngineError : the atmosphere engine failed.
    """
    find = resolve or (lambda reference: datasets.resolve(reference, scenario.folder))
    given = measured or {}
    truth, asked = departure or Departure(), scenario
    scenario = departed_scenario(scenario, truth)
    used = instrument(scenario, axis, next((s.axis for s in given.values()), None), find, sensor)
    scenario = with_sensor_blur(scenario, used.sensor)
    used = replace(used, true_axis=departed_axis(used.true_axis, truth), noise=departed_noise(used.noise, truth))
    on, true = used.axis, used.true_axis
    surfaces, looked_for = surfaces_of(scenario, Sources(true, given, find, on), Sources(on, given, find))
    surfaces = departed_surfaces(scenario, surfaces, truth)

    def terms_of(state: AtmosphericState) -> AtmosphericTerms:
        terms = engine_terms(state)
        return terms if departure is None else departed_terms(terms, departure)

    def engine_terms(state: AtmosphericState) -> AtmosphericTerms:
        if engine is not None:
            return engine(state).at_bands(true)
        if state.engine == "table":  # a file of the scenario, read again when it changes
            return atmospheric_terms(state, resolve=find).at_bands(true)
        call = atmospheric_terms
        return remembered(call, state, true, cache_dir=cache_dir, show_progress=show_progress)

    view = _base_view(scenario, surfaces, terms_of, used.noise if scenario.atmosphere else None)
    if departure is not None and np.any(np.asarray(departure.surroundings) != 1.0):
        view = replace(view, average=view.average * departure.surroundings)
    given_here = Given(scenario, on, used.sensor, surfaces, lambda: cast(AtmosphericTerms, view.terms))
    inputs = inputs_of(given_here, shapes=False)
    steps = perturbations(view, scenario, terms_of, inputs)
    # What replicate spectra say of their own mean, where the scenario does not say it of the subject.
    stated = {item.subject for item in scenario.uncertainty.field_spectra}
    errors: dict[str, Array] = {
        name: s.mean_error for name, s in surfaces.items() if s.mean_error is not None and name not in stated
    }
    for item in scenario.uncertainty.field_spectra:  # entries of one subject are independent
        one = spectrum_error_covariance(item, surfaces[item.subject], on, used.sensor)
        errors[item.subject] = errors[item.subject] + one if item.subject in errors else one
    spectra = spectral_products(scenario, on, surfaces, view, steps, errors, used.sensor)

    def again(d: Departure, stand_in: Engine | None = None) -> Prediction:
        return predict(
            asked.model_copy(update={"uncertainty": Uncertainty()}), axis=axis, measured=measured, resolve=find,
            cache_dir=cache_dir, show_progress=show_progress, engine=stand_in or engine, sensor=sensor,
            departure=combined(truth, d),
        )  # fmt: skip

    moves = moved_predictions(inputs, again)
    notes = [f"formulation: {scenario.formulation}", *unstated_notes(scenario.atmosphere, scenario.uncertainty)]
    detection = _detection(
        scenario, on, surfaces, looked_for, with_retrieval(view, truth), steps, errors, spectra, notes, objects,
        object_curves,
    )  # fmt: skip
    pairs: list[tuple[Detection | Prediction, Detection | Prediction]] = [*detection.pairs]
    pairs += [(m.plus, m.minus) for m in moves]
    if detection.roc:  # spectra of classes move the background; those of targets are in the pairs already
        classes = {c.name for c in scenario.scene.classes}
        of_classes = [i for i in spectrum_inputs(given_here) if i.subject in classes]
        pairs += [(m.plus, m.minus) for m in moved_predictions(of_classes, again, most=8)]
    detection = replace(detection, roc=with_bands(detection.roc, pairs))
    for product in ("radiance", "snr", "reflectance"):
        with_moves(getattr(spectra, product), product, moves)
    notes += detection.notes
    if view.noise is not None:
        notes += sensor_notes(used)
        notes += saturation_notes(spectra.full_scale, on)
    found = Prediction(
        on,
        spectra.radiance,
        spectra.snr,
        spectra.reflectance,
        detection.scores,
        detection.roc,
        object_scores=detection.object_scores,
        exceedance=detection.exceedance,
        distribution={
            c.name: PixelDistribution(class_tail(c, surfaces[c.name]) or math.inf) for c in scenario.scene.classes
        },
        notes=tuple(notes),
        provenance=_provenance(scenario, used, view, surfaces),
        noise=spectra.noise,
        full_scale=spectra.full_scale,
    )

    if scenario.uncertainty.method == "linear" or departure is not None:
        return found

    def whole(state: AtmosphericState) -> AtmosphericTerms:
        if engine is not None:
            return engine(state)
        if state.engine == "table":
            return atmospheric_terms(state, resolve=find)
        return atmospheric_terms(state, cache_dir=cache_dir, show_progress=show_progress)

    return _propagated(scenario, found, inputs_of(given_here), again, whole, true, show_progress)


def predictions(scenario: Scenario, truths: Iterable[Departure], **options: Any) -> Iterator[Prediction]:
    """Predictions of truths that depart from a scenario, in their order, each without a budget of its own.

    ``options`` are those of :func:`predict`: axis, measured, resolve, engine, sensor, cache_dir, show_progress,
    objects, object_curves.  What the truths have in common is worked out once.
    """
    bare = scenario.model_copy(update={"uncertainty": Uncertainty()})
    for truth in truths:
        yield predict(bare, departure=truth, **options)


def _propagated(
    scenario: Scenario,
    stated: Prediction,
    inputs: list[Input],
    again: Callable[[Departure, Engine | None], Prediction],
    engine: Engine,
    axis: SpectralAxis,
    show_progress: bool | None,
) -> Prediction:
    """The prediction with its budget drawn; unchanged where nothing is uncertain."""
    from hyperval.prediction.monte_carlo import propagate, with_intervals

    if not inputs:
        return stated
    shifts = any(np.any(np.asarray(i.moved(1.0).wavelength_shift_nm) != 0.0) for i in inputs)
    u = scenario.uncertainty
    found = propagate(
        scenario, stated, inputs, again, samples=u.samples, seed=u.seed, engine=engine,
        axis=None if shifts else axis, show_progress=show_progress,
    )  # fmt: skip
    return with_intervals(stated, found, u.method)


def _provenance(
    scenario: Scenario, used: Instrument, view: View, surfaces: Mapping[str, SurfaceStatistics]
) -> dict[str, object]:
    sensor = used.sensor
    found: dict[str, object] = {
        "scenario": scenario.name,
        "formulation": scenario.formulation,
        "atmosphere": view.terms.provenance if view.terms else None,
        "sensor": {"name": sensor.name, "source": sensor.specification.source} if sensor else None,
        "spectra": {name: s.source for name, s in surfaces.items()},
    }
    if scenario.sensor_operation is not None:
        found["sensor_operation"] = scenario.sensor_operation.model_dump(mode="json")
    if scenario.sensor_changes is not None:
        found["sensor_changes"] = scenario.sensor_changes.model_dump(mode="json")
    return found


def surfaces_of(
    scenario: Scenario, sources: Sources, labelled: Sources
) -> tuple[dict[str, SurfaceStatistics], dict[str, Array]]:
    """Statistics where the bands truly stand; what detectors look for where they are labelled."""
    scene = scenario.scene
    surfaces = {s.name: sources.surface(s) for s in (*scene.classes, *scene.panels, *scene.sites, *scene.targets)}
    refuse_gaps(scenario, surfaces, sources.axis)
    looked_for = {}
    for t in scene.targets:
        if t.filter_spectrum is not None:
            looked_for[t.name] = labelled.spectrum(t.filter_spectrum, t.name).mean
        elif sources.axis is labelled.axis:
            looked_for[t.name] = surfaces[t.name].mean
        else:
            looked_for[t.name] = labelled.spectrum(t.spectrum, t.name).mean
    return surfaces, looked_for


def _base_view(
    scenario: Scenario, surfaces: Mapping[str, SurfaceStatistics], terms_of: Engine, noise: NoiseModel | None
) -> View:
    classes = scenario.scene.classes
    fractions = np.array([c.fraction for c in classes])
    means = np.array([filled(surfaces[c.name].mean) for c in classes])
    covariances = [surfaces[c.name].covariance for c in classes]
    elm, levels = scenario.processing.elm, None
    if isinstance(elm, DarkestPixel):
        gains = np.array([c.gain for c in classes])
        levels = ClassLevels(fractions, gains, means, np.array([np.diag(c) for c in covariances]))
    return View(
        terms_of(scenario.atmosphere) if scenario.atmosphere else None,
        average_reflectance(fractions, means),  # (3.8)
        mixture_covariance(fractions, means, covariances),
        noise,
        scenario.scene.adjacency.kappa,
        scenario.formulation,
        None if elm == "none" else elm,
        levels,
    )


def detection_bands(scenario: Scenario, axis: SpectralAxis, usable: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """Indices of the bands that the detectors use (Psi of unit rows, 3.21).

    ``usable`` (B,) is False where a spectrum or the light is lacking.  Raises UsageError when none is left.
    """
    choice = scenario.processing.bands
    keep = usable.copy()
    if choice.drop_bad:
        keep &= axis.good
    if choice.windows_only:
        keep &= in_window(axis.centre_nm)
    if choice.ranges:
        keep &= np.any([(axis.centre_nm >= a) & (axis.centre_nm <= b) for a, b in choice.ranges], axis=0)
    for name, listed in (("channels", choice.channels), ("bad_channels", choice.bad_channels)):
        if listed and max(listed) >= keep.size:
            raise UsageError(
                f"processing.bands.{name}: band {max(listed)} of {keep.size}",
                expected=f"numbers from 0 to {keep.size - 1}",
            )
        if listed:
            here = np.isin(np.arange(keep.size), listed)
            keep &= here if name == "channels" else ~here
    if not keep.any():
        raise UsageError("no band is left for detection", mend="widen processing: bands")
    return np.flatnonzero(keep)


def _detection(
    scenario: Scenario,
    axis: SpectralAxis,
    surfaces: Mapping[str, SurfaceStatistics],
    looked_for: Mapping[str, Array],
    view: View,
    steps: list[Perturbation],
    errors: Mapping[str, Array],
    spectra: SpectralProducts,
    notes: list[str],
    objects: bool | int,
    object_curves: bool,
) -> Detection:
    scene, processing = scenario.scene, scenario.processing
    if not scene.targets or not processing.detectors:
        return Detection({}, {})
    used = [c.name for c in scene.classes] + [t.name for t in scene.targets]
    usable = view.lit()
    for name in used:
        usable &= np.isfinite(surfaces[name].mean)
    for spectrum in looked_for.values():
        usable &= np.isfinite(spectrum)
    bands = detection_bands(scenario, axis, usable)
    notes.append(f"detectors use {bands.size} of {len(axis)} bands")
    on_bands = {
        name: replace(
            surfaces[name], mean=surfaces[name].mean[bands], covariance=cut(surfaces[name].covariance, bands)
        )
        for name in used
    }
    task = Task(
        scene.targets,
        {name: spectrum[bands] for name, spectrum in looked_for.items()},
        processing,
        false_alarm_grid(processing.false_alarm_grid.lowest, processing.false_alarm_grid.per_decade),
        {t.name: cut(errors[t.name], bands) for t in scene.targets if t.name in errors},
        object_curves,
    )

    def run(with_view: View, shift: float = 0.0) -> Detection:
        return detect(seen_background(with_view.at(bands), scene.classes, on_bands), task, shift)

    # The spectral products hold the classes as the detector sees them already.
    seen = spectra.reflectance or spectra.radiance
    here = view.at(bands)
    classes = [seen[c.name] for c in scene.classes]
    spread = [cut(c.pixel_covariance, bands) for c in classes]
    background = Background(scene.classes, on_bands, here, [c.mean[bands] for c in classes], spread)
    if view.retrieval is not None:  # a line that is off changes what the detectors see of the classes
        background = seen_background(here, scene.classes, on_bands)
    base = detect(background, task)
    leading = [s for s in steps if s.number < MOST_DIRECTIONS]  # the rest of an input moves a score little
    if objects:

        def moved(with_view: View) -> Background:
            return seen_background(with_view.at(bands), scene.classes, on_bands)

        views = [(moved(s.plus), moved(s.minus)) for s in leading]
        draws = None if objects is True else objects
        drawn = predicted_object_scores(background, task, scenario.uncertainty, axis.select(bands), views, draws)
        base = replace(base, object_scores=drawn)
    pairs = [(run(s.plus), run(s.minus)) for s in leading]
    if task.spectrum_error:
        pairs.append((run(view, 1.0), run(view, -1.0)))
    return replace(base, pairs=tuple(pairs))
