"""From a scenario to its products by statistics alone: the forward model (3.7-3.33)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval import datasets
from hyperval.atmosphere import AtmosphericState, AtmosphericTerms, atmospheric_terms
from hyperval.errors import UsageError
from hyperval.prediction.detection import Detection, detect, fill_distribution, seen_background
from hyperval.prediction.inputs import Resolve, Sources, SurfaceStatistics, filled
from hyperval.prediction.uncertainty import (
    Perturbation,
    combined,
    perturbations,
    spectral_errors,
    spectrum_error_covariance,
    with_bands,
)
from hyperval.prediction.view import View
from hyperval.processing.elm_model import retrieved_covariance, retrieved_reflectance
from hyperval.processing.roc_model import false_alarm_grid
from hyperval.products import Prediction, SpectralEstimate
from hyperval.scenario import Scenario
from hyperval.scene.mixture import average_reflectance, mixture_covariance
from hyperval.scene.radiance import target_pixel_covariance, target_pixel_reflectance
from hyperval.scene.statistics import ClassStatistics
from hyperval.sensor.noise import NoiseModel, add_noise
from hyperval.sensor.specification import library_names, load_sensor
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.windows import in_window

Array = npt.NDArray[np.float64]
Engine = Callable[[AtmosphericState], AtmosphericTerms]


def without_calibration_error(subject: str) -> str:
    """Name under which ``snr`` holds a subject with C_R left out of (3.20)."""
    return f"{subject} (no calibration error)"


@dataclass
class _Spectra:
    """The spectral products while they are filled."""

    radiance: dict[str, SpectralEstimate] = field(default_factory=dict)
    snr: dict[str, SpectralEstimate] = field(default_factory=dict)
    reflectance: dict[str, SpectralEstimate] = field(default_factory=dict)


def predict(
    scenario: Scenario,
    *,
    axis: SpectralAxis | None = None,
    measured: Mapping[str, ClassStatistics] | None = None,
    resolve: Resolve | None = None,
    cache_dir: Path | None = None,
    show_progress: bool | None = None,
    engine: Engine | None = None,
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

    Returns
    -------
    Prediction.  Subjects of ``radiance`` and ``reflectance`` are classes, panels, sites and target
    populations; ``snr`` holds each class, panel and site twice, with C_R and under
    :func:`without_calibration_error`.  In the reflectance domain there is no radiance and no SNR.

    Raises
    ------
    UsageError : a scenario that contradicts itself, or a covariance that cannot be inverted.
    InputError : a file that is missing or corrupt.
    EngineError : the atmosphere engine failed.
    """
    find = resolve or (lambda reference: datasets.resolve(reference, scenario.folder))
    given = measured or {}
    sensor = None
    if scenario.sensor is not None:
        sensor = load_sensor(scenario.sensor if scenario.sensor in library_names() else find(scenario.sensor))
    on = axis or (sensor.axis if sensor else None) or next((s.axis for s in given.values()), None)
    if on is None:
        raise UsageError("the scenario has no bands", mend="name a sensor, or hand in an axis")
    surfaces, looked_for = _surfaces(scenario, Sources(on, given, find))

    def terms_of(state: AtmosphericState) -> AtmosphericTerms:
        if engine is not None:
            return engine(state).at_bands(on)
        return atmospheric_terms(state, cache_dir=cache_dir, show_progress=show_progress).at_bands(on)

    view = _base_view(scenario, surfaces, terms_of, sensor.noise(on) if sensor and scenario.atmosphere else None)
    steps = perturbations(view, scenario, terms_of)
    errors = {
        item.subject: spectrum_error_covariance(item, surfaces[item.subject], on)
        for item in scenario.uncertainty.field_spectra
    }
    spectra = _spectra(scenario, on, surfaces, view, steps, errors)
    notes = [f"formulation: {scenario.formulation}"]
    detection = _detection(scenario, on, surfaces, looked_for, view, steps, errors, notes)
    if view.noise is not None:
        notes += [f"sensor {sensor.name if sensor else ''}: {text}" for text in view.noise.assumed]
    provenance = {
        "scenario": scenario.name,
        "formulation": scenario.formulation,
        "atmosphere": view.terms.provenance if view.terms else None,
        "sensor": {"name": sensor.name, "source": sensor.specification.source} if sensor else None,
        "spectra": {name: s.source for name, s in surfaces.items()},
    }
    return Prediction(
        on,
        spectra.radiance,
        spectra.snr,
        spectra.reflectance,
        detection.scores,
        detection.roc,
        notes=tuple(notes),
        provenance=provenance,
    )


def _surfaces(scenario: Scenario, sources: Sources) -> tuple[dict[str, SurfaceStatistics], dict[str, Array]]:
    scene = scenario.scene
    surfaces = {s.name: sources.surface(s) for s in (*scene.classes, *scene.panels, *scene.sites, *scene.targets)}
    looked_for = {
        t.name: sources.spectrum(t.filter_spectrum, t.name).mean if t.filter_spectrum else surfaces[t.name].mean
        for t in scene.targets
    }
    return surfaces, looked_for


def _base_view(
    scenario: Scenario, surfaces: Mapping[str, SurfaceStatistics], terms_of: Engine, noise: NoiseModel | None
) -> View:
    classes = scenario.scene.classes
    fractions = np.array([c.fraction for c in classes])
    means = np.array([filled(surfaces[c.name].mean) for c in classes])
    covariances = np.array([surfaces[c.name].covariance for c in classes])
    return View(
        terms_of(scenario.atmosphere) if scenario.atmosphere else None,
        average_reflectance(fractions, means),  # (3.8)
        mixture_covariance(fractions, means, covariances),
        noise,
        scenario.scene.adjacency.kappa,
        scenario.formulation,
        None if scenario.processing.elm == "none" else scenario.processing.elm.reflectances,
    )


def _spectra(
    scenario: Scenario,
    axis: SpectralAxis,
    surfaces: Mapping[str, SurfaceStatistics],
    view: View,
    steps: list[Perturbation],
    errors: Mapping[str, Array],
) -> _Spectra:
    out, scene, bands = _Spectra(), scenario.scene, len(axis)
    line = view.line()
    lines = [(s, s.plus.line(), s.minus.line()) for s in steps]
    retrieves = view.terms is None or view.panels is not None

    def add(name: str, rho: Array, covariance: Array, gain: float, error: Array | None, snr: bool) -> None:
        level = view.level(rho)
        seen = np.nan_to_num(add_noise(view.covariance(rho, covariance, gain), view.noise_variance(level)))
        if view.terms is not None:
            changes = {s.source: 0.5 * (s.plus.level(rho) - s.minus.level(rho)) for s in steps}
            shapes = spectral_errors(view, rho, axis, scenario.uncertainty.engine, error)
            total, budget = combined(changes, shapes, bands)
            out.radiance[name] = SpectralEstimate(level, total, seen, None, budget)
            if snr and view.noise is not None:
                for key, with_c in ((name, True), (without_calibration_error(name), False)):
                    noise = view.noise
                    moves = {
                        s.source: 0.5
                        * (
                            noise.snr(s.plus.level(rho), calibration=with_c)
                            - noise.snr(s.minus.level(rho), calibration=with_c)
                        )
                        for s in steps
                    }
                    total, budget = combined(moves, {}, bands)
                    out.snr[key] = SpectralEstimate(noise.snr(level, calibration=with_c), total, None, None, budget)
        if retrieves:
            changes = {
                s.source: 0.5
                * (retrieved_reflectance(up, s.plus.level(rho)) - retrieved_reflectance(down, s.minus.level(rho)))
                for s, up, down in lines
            }
            shapes = spectral_errors(view, rho, axis, None, error)
            shapes = {source: retrieved_covariance(line, c) for source, c in shapes.items()}
            total, budget = combined(changes, shapes, bands)
            pixel = np.nan_to_num(retrieved_covariance(line, seen))
            out.reflectance[name] = SpectralEstimate(retrieved_reflectance(line, level), total, pixel, None, budget)

    for c in scene.classes:
        s = surfaces[c.name]
        add(c.name, s.mean, c.gain * s.covariance, c.gain, errors.get(c.name), True)
    for surface in (*scene.panels, *scene.sites):
        s = surfaces[surface.name]
        add(surface.name, s.mean, s.covariance, 1.0, errors.get(surface.name), True)
    for t in scene.targets:
        own, host = surfaces[t.name], surfaces[t.host]
        gain = next(c.gain for c in scene.classes if c.name == t.host)
        for population in t.populations:
            fill = fill_distribution(population.fill)
            covariance = target_pixel_covariance(
                fill.mean, fill.variance, own.mean, own.covariance, host.mean, host.covariance,
                target_gain=t.gain, host_gain=gain, formulation=scenario.formulation,
            )  # fmt: skip
            error = fill.mean**2 * errors[t.name] if t.name in errors else None
            rho = target_pixel_reflectance(fill.mean, own.mean, host.mean)
            add(population.name, rho, covariance, gain, error, False)
    return out


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
    notes: list[str],
) -> Detection:
    scene, processing = scenario.scene, scenario.processing
    if not scene.targets or not processing.detectors:
        return Detection({}, {})
    usable = view.lit()
    for name in [c.name for c in scene.classes] + [t.name for t in scene.targets]:
        usable &= np.isfinite(surfaces[name].mean)
    for spectrum in looked_for.values():
        usable &= np.isfinite(spectrum)
    bands = detection_bands(scenario, axis, usable)
    notes.append(f"detectors use {bands.size} of {len(axis)} bands")
    pfa = false_alarm_grid(processing.false_alarm_grid.lowest, processing.false_alarm_grid.per_decade)
    whole = processing.filter_statistics == "scene"

    def run(with_view: View, shift: float = 0.0) -> Detection:
        background = seen_background(with_view, scene.classes, surfaces, bands)
        return detect(
            background, scene.targets, looked_for, processing.detectors, pfa,
            whole_scene=whole, filter_classes=processing.filter_classes, spectrum_error=errors, shift=shift,
        )  # fmt: skip

    base = run(view)
    pairs = [(run(s.plus), run(s.minus)) for s in steps]
    if any(t.name in errors for t in scene.targets):
        pairs.append((run(view, 1.0), run(view, -1.0)))
    return Detection(base.scores, with_bands(base.roc, pairs))
