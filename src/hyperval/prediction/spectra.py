"""Radiance, SNR, noise and reflectance of every subject (3.7-3.20, and the empirical line)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

import numpy as np
import numpy.typing as npt

from hyperval.prediction.fills import fill_distribution
from hyperval.prediction.inputs import SurfaceStatistics
from hyperval.prediction.placed_target import (
    HOST,
    PLACE,
    Shares,
    host_covariance,
    mixed,
    place_covariance,
    shares_of,
    spectra_covariance,
)
from hyperval.prediction.uncertainty import Perturbation, combined, interpolation_errors, spectral_errors
from hyperval.prediction.view import View
from hyperval.processing.elm_model import retrieved_covariance, retrieved_reflectance
from hyperval.products import SpectralEstimate
from hyperval.scenario import Scenario
from hyperval.scene.radiance import target_pixel_covariance, target_pixel_reflectance
from hyperval.sensor.specification import Sensor
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]


def without_calibration_error(subject: str) -> str:
    """Name under which ``snr`` holds a subject with C_R left out of (3.20)."""
    return f"{subject} (no calibration error)"


@dataclass
class SpectralProducts:
    """The spectral products while they are filled; the names are those of ``Prediction``."""

    radiance: dict[str, SpectralEstimate] = field(default_factory=dict)
    snr: dict[str, SpectralEstimate] = field(default_factory=dict)
    reflectance: dict[str, SpectralEstimate] = field(default_factory=dict)
    noise: dict[str, Mapping[str, Array]] = field(default_factory=dict)
    full_scale: dict[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class _Subject:
    """What is seen of one subject: what it reflects, what meets light of the surroundings, its spread.

    ``error`` is that of its field spectra, ``others`` are error covariances (B, B) of its reflectance by source.
    """

    name: str
    rho: Array
    under_sky: Array
    covariance: Array
    gain: float
    error: Array | None
    pure: bool  # a class, panel or site; target pixels have no SNR of their own
    others: Mapping[str, Array] = field(default_factory=dict)


def spectral_products(
    scenario: Scenario,
    axis: SpectralAxis,
    surfaces: Mapping[str, SurfaceStatistics],
    view: View,
    steps: list[Perturbation],
    errors: Mapping[str, Array],
    sensor: Sensor | None = None,
) -> SpectralProducts:
    """All spectra of a scenario with their errors.

    Parameters
    ----------
    steps : views with one input changed
    errors : subject -> (B, B) error covariance of its field spectrum
    """
    out = SpectralProducts()
    # What the empirical line is off by belongs to collected reflectance, not to the predicted one.
    lines = [(s, s.plus.library_line(), s.minus.library_line()) for s in steps]
    for subject in _subjects(scenario, surfaces, view, errors):
        level = view.level(subject.rho)
        seen = view.seen(level, subject.under_sky, subject.covariance, subject.gain)
        if view.terms is not None:
            changes = [(s.source, 0.5 * (s.plus.level(subject.rho) - s.minus.level(subject.rho))) for s in steps]
            shapes = spectral_errors(view, subject.rho, axis, scenario.uncertainty.engine, subject.error, sensor)
            shapes |= _through(view, subject.others) | interpolation_errors(view, axis)
            total, budget = combined(changes, shapes, len(axis))
            out.radiance[subject.name] = SpectralEstimate(level, total, _known(seen), None, budget)
            _add_noise(out, subject, level, view, steps, shapes)
        if view.terms is None or view.elm is not None:
            line = view.line()
            changes = [
                (
                    s.source,
                    0.5
                    * (
                        retrieved_reflectance(up, s.plus.level(subject.rho))
                        - retrieved_reflectance(down, s.minus.level(subject.rho))
                    ),
                )
                for s, up, down in lines
            ]
            shapes = spectral_errors(view, subject.rho, axis, None, subject.error) | _through(view, subject.others)
            shapes = {source: retrieved_covariance(line, c) for source, c in shapes.items()}
            total, budget = combined(changes, shapes, len(axis))
            pixel = _known(seen if view.terms is None else retrieved_covariance(line, seen))
            mean = retrieved_reflectance(line, level)
            out.reflectance[subject.name] = SpectralEstimate(mean, total, pixel, None, budget)
    return out


def _add_noise(
    out: SpectralProducts,
    subject: _Subject,
    level: Array,
    view: View,
    steps: list[Perturbation],
    shapes: Mapping[str, Array],
) -> None:
    """Noise by source, and the SNR with its errors; ``shapes`` are error covariances (B, B) of the level."""
    noise = view.noise
    if noise is None:
        return
    if noise.full_scale is not None:
        out.full_scale[subject.name] = noise.full_scale_fraction(level)
    if not subject.pure:
        return

    def snr_of(seen: View, calibration: bool) -> Array:
        return (seen.noise or noise).snr(seen.level(subject.rho), calibration=calibration)

    terms = noise.breakdown(level)
    out.noise[subject.name] = asdict(terms)
    for name, with_c in ((subject.name, True), (without_calibration_error(subject.name), False)):
        moves = [(s.source, 0.5 * (snr_of(s.plus, with_c) - snr_of(s.minus, with_c))) for s in steps]
        # d SNR / d L, for errors of the level that have a shape over wavelength.
        h = 1e-3 * np.abs(level) + 1e-12
        slope = (noise.snr(level + h, calibration=with_c) - noise.snr(level - h, calibration=with_c)) / (2.0 * h)
        total, budget = combined(moves, {k: c * np.outer(slope, slope) for k, c in shapes.items()}, level.size)
        out.snr[name] = SpectralEstimate(noise.snr(level, calibration=with_c), total, None, None, budget)


def _through(view: View, errors: Mapping[str, Array]) -> dict[str, Array]:
    """Errors of a reflectance as errors of the level, through D_A (3.11)."""
    return {source: c * np.outer(view.slope(), view.slope()) for source, c in errors.items()}


def _subjects(
    scenario: Scenario, surfaces: Mapping[str, SurfaceStatistics], view: View, errors: Mapping[str, Array]
) -> list[_Subject]:
    scene, found = scenario.scene, []
    for c in scene.classes:
        s = surfaces[c.name]
        covariance = s.covariance if c.gain == 1.0 else c.gain * s.covariance
        found.append(_Subject(c.name, s.mean, s.mean, covariance, c.gain, errors.get(c.name), True))
    for surface in (*scene.panels, *scene.sites):
        s = surfaces[surface.name]
        found.append(_Subject(surface.name, s.mean, s.mean, s.covariance, 1.0, errors.get(surface.name), True))
    for t in scene.targets:
        own, host = surfaces[t.name], surfaces[t.host]
        lit = view.lit_surface(own.mean, own.covariance, t.illumination)
        gain = next(c.gain for c in scene.classes if c.name == t.host)
        for population in t.populations:
            fill = fill_distribution(population.fill)
            covariance = target_pixel_covariance(
                fill.mean, fill.variance, lit.mean, lit.covariance, host.mean, host.covariance,
                target_gain=t.gain, host_gain=gain, formulation=scenario.formulation,
            )  # fmt: skip
            shares = None
            if scenario.formulation != "thesis":
                position = scenario.uncertainty.position_m
                shares = shares_of(t, population, scene.targets, position, scenario.processing.seed)
            if shares is not None:
                found.append(_placed(population.name, shares, scenario, surfaces, view, errors, t.host, covariance))
                continue
            parts = []
            if t.name in errors:
                shade = np.broadcast_to(lit.factor, own.mean.shape)
                parts.append(fill.mean**2 * errors[t.name] * np.outer(shade, shade))
            if t.host in errors and fill.mean < 1.0:
                parts.append((1.0 - fill.mean) ** 2 * errors[t.host])  # the rest of the pixel
            error = np.sum(parts, axis=0) if parts else None
            rho = target_pixel_reflectance(fill.mean, lit.mean, host.mean)
            under_sky = target_pixel_reflectance(fill.mean, lit.under_sky, host.mean)
            found.append(_Subject(population.name, rho, under_sky, covariance, gain, error, False))
    return found


def _placed(
    name: str,
    shares: Shares,
    scenario: Scenario,
    surfaces: Mapping[str, SurfaceStatistics],
    view: View,
    errors: Mapping[str, Array],
    host: str,
    covariance: Array,
) -> _Subject:
    """One object at its place, with what lies beside it."""
    full, under_sky, own = {}, {}, {}
    for t in scenario.scene.targets:
        if t.name in shares.names:
            s = surfaces[t.name]
            lit = view.lit_surface(s.mean, s.covariance, t.illumination)
            full[t.name], under_sky[t.name] = lit.mean, lit.under_sky
            if t.name in errors:
                shade = np.broadcast_to(lit.factor, s.mean.shape)
                own[t.name] = errors[t.name] * np.outer(shade, shade)
    ground, gain = surfaces[host], next(c.gain for c in scenario.scene.classes if c.name == host)
    spectra = spectra_covariance(shares, own, ground.mean.size)
    if host in errors:
        spectra = spectra + shares.rest**2 * errors[host]
    return _Subject(
        name,
        mixed(shares, full, ground.mean),
        mixed(shares, under_sky, ground.mean),
        covariance,
        gain,
        spectra,
        False,
        {
            PLACE: place_covariance(shares, full, ground.mean),
            HOST: host_covariance(shares, ground.covariance, gain),
        },
    )


def _known(covariance: Array) -> Array:
    """The matrix with 0 where nothing is known; unchanged, and not copied, where all is."""
    return covariance if np.isfinite(np.sum(covariance)) else np.nan_to_num(covariance)
