"""Radiance, SNR, noise and reflectance of every subject (3.7-3.20, and the empirical line)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

import numpy as np
import numpy.typing as npt

from hyperval.prediction.background import Ground
from hyperval.prediction.cases import Case
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
from hyperval.prediction.setup import Setup
from hyperval.prediction.uncertainty import Steps, combined, interpolation_errors, known, spectral_errors
from hyperval.prediction.view import View
from hyperval.processing.elm_model import retrieved_covariance, retrieved_reflectance
from hyperval.products import SpectralEstimate
from hyperval.scenario import Target, TargetSubject
from hyperval.scenario_uncertainty import EngineUncertainty
from hyperval.scene.radiance import target_pixel_covariance, target_pixel_reflectance, toa_reflectance

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
    toa_reflectance: dict[str, SpectralEstimate] = field(default_factory=dict)


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
    case: Case,
    ground: Ground,
    view: View,
    steps: Steps,
    errors: Mapping[str, Array],
    engine: EngineUncertainty | None,
) -> SpectralProducts:
    """All spectra of a case with their errors.

    Parameters
    ----------
    ground, view : of the case, its arrays (B,)
    steps : the light and sensor one standard uncertainty up and down
    errors : subject -> (B, B) error covariance of its field spectrum
    engine : what is stated of the error of the atmosphere engine
    """
    out, setup = SpectralProducts(), case.setup
    axis, subjects = setup.used.axis, _subjects(setup, view, errors)
    # One piece of memory for all: new pages for each matrix take longer than the numbers in it.
    *room, scratch = np.empty((1 + 2 * len(subjects), len(axis), len(axis)))
    for number, subject in enumerate(subjects):
        of_radiance, of_reflectance = room[2 * number : 2 * number + 2]
        level, around = view.level(subject.rho), ground.covariance
        seen = view.seen(level, subject.under_sky, subject.covariance, around, subject.gain, of_radiance, scratch)
        if view.terms is not None:
            changes = steps.changes(lambda v, rho=subject.rho: v.level(rho))  # type: ignore[misc]
            shapes = spectral_errors(view, subject.rho, axis, engine, subject.error, setup.used.sensor)
            shapes |= _through(view, subject.others) | interpolation_errors(view, axis)
            total, budget = combined(changes, shapes, len(axis))
            out.radiance[subject.name] = SpectralEstimate(level, total, known(seen), None, budget)
            _add_noise(out, subject, level, view, steps, shapes)
            if setup.scenario.is_of_space:
                _add_toa_reflectance(out, subject, view, steps, shapes)
        if view.terms is None or view.elm is not None:
            line = view.line()
            # What the empirical line is off by belongs to collected reflectance, not to the predicted one.
            changes = steps.changes(
                lambda v, rho=subject.rho: retrieved_reflectance(v.library_line(), v.level(rho))  # type: ignore[misc]
            )
            shapes = spectral_errors(view, subject.rho, axis, None, subject.error) | _through(view, subject.others)
            if view.terms is not None:
                shapes = {source: retrieved_covariance(line, c) for source, c in shapes.items()}
            total, budget = combined(changes, shapes, len(axis))
            pixel = known(seen if view.terms is None else retrieved_covariance(line, seen, of_reflectance))
            mean = retrieved_reflectance(line, level)
            out.reflectance[subject.name] = SpectralEstimate(mean, total, pixel, None, budget)
    return out


def _add_toa_reflectance(
    out: SpectralProducts, subject: _Subject, view: View, steps: Steps, shapes: Mapping[str, Array]
) -> None:
    """pi L / (mu0 E0) with its errors, where the engine says what E0 is; the level of the sunlight cancels."""

    def reflected(v: View) -> Array:
        assert v.terms is not None  # noqa: S101 - the caller's own check
        assert v.terms.diffuser_radiance is not None  # noqa: S101 - of the same engine
        return toa_reflectance(v.level(subject.rho), v.terms.diffuser_radiance)

    if view.terms is None or view.terms.diffuser_radiance is None:
        return
    white = view.terms.diffuser_radiance
    relative = {source: c / np.outer(white, white) for source, c in shapes.items()}
    total, budget = combined(steps.changes(reflected), relative, white.size)
    out.toa_reflectance[subject.name] = SpectralEstimate(reflected(view), total, None, None, budget)


def _add_noise(
    out: SpectralProducts,
    subject: _Subject,
    level: Array,
    view: View,
    steps: Steps,
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

    terms = noise.breakdown(level)
    out.noise[subject.name] = asdict(terms)
    for name, with_c in ((subject.name, True), (without_calibration_error(subject.name), False)):
        moves = steps.changes(
            lambda v, c=with_c: (v.noise or noise).snr(v.level(subject.rho), calibration=c)  # type: ignore[misc]
        )
        # d SNR / d L, for errors of the level that have a shape over wavelength.
        h = 1e-3 * np.abs(level) + 1e-12
        slope = (noise.snr(level + h, calibration=with_c) - noise.snr(level - h, calibration=with_c)) / (2.0 * h)
        total, budget = combined(moves, {k: c * np.outer(slope, slope) for k, c in shapes.items()}, level.size)
        out.snr[name] = SpectralEstimate(noise.snr(level, calibration=with_c), total, None, None, budget)


def _through(view: View, errors: Mapping[str, Array]) -> dict[str, Array]:
    """Errors of a reflectance as errors of the level, through D_A (3.11)."""
    return {source: view.through(c) for source, c in errors.items()}


def _subjects(setup: Setup, view: View, errors: Mapping[str, Array]) -> list[_Subject]:
    scenario, surfaces, subjects = setup.scenario, setup.surfaces, []
    scene = scenario.scene
    for c in scene.classes:
        s = surfaces[c.name]
        covariance = s.covariance if c.gain == 1.0 else c.gain * s.covariance
        subjects.append(_Subject(c.name, s.mean, s.mean, covariance, c.gain, errors.get(c.name), True))
    for surface in (*scene.panels, *scene.sites):
        s = surfaces[surface.name]
        subjects.append(_Subject(surface.name, s.mean, s.mean, s.covariance, 1.0, errors.get(surface.name), True))
    for t in scene.targets:
        subjects += [_mixed(setup, view, errors, t, population) for population in t.populations]
    return subjects


@dataclass(frozen=True)
class _Lit:
    """A target under its own light, as a surface in the open would have to be to look like it (ground term of 3.7).

    ``under_sky`` : reflectance times sky view, what the light from the surroundings meets (D_B of 3.11); ``error``
    of its field spectrum, None without
    """

    mean: Array
    covariance: Array
    under_sky: Array
    error: Array | None


def _lit(t: Target, own: SurfaceStatistics, view: View, error: Array | None) -> _Lit:
    light = t.illumination
    factor = view.light(light.beam, light.sky_view) if light else 1.0
    if np.ndim(factor) == 0:
        return _Lit(own.mean, own.covariance, own.mean, error)
    shade = np.outer(factor, factor)
    sky = light.sky_view if light else 1.0
    return _Lit(own.mean * factor, own.covariance * shade, own.mean * sky, None if error is None else error * shade)


def _mixed(setup: Setup, view: View, errors: Mapping[str, Array], t: Target, population: TargetSubject) -> _Subject:
    """Target pixels of one population (3.10, 3.12)."""
    scenario, surfaces = setup.scenario, setup.surfaces
    scene, host = scenario.scene, surfaces[t.host]
    lit = _lit(t, surfaces[t.name], view, errors.get(t.name))
    gain = next(c.gain for c in scene.classes if c.name == t.host)
    fill = fill_distribution(population.fill)
    covariance = target_pixel_covariance(
        fill.mean, fill.variance, lit.mean, lit.covariance, host.mean, host.covariance,
        target_gain=t.gain, host_gain=gain, fine_texture=surfaces[t.name].fine_texture,
        formulation=scenario.formulation,
    )  # fmt: skip
    if scenario.formulation != "thesis":
        position, key = scenario.uncertainty.position_m, ("shares", population.name)
        if key not in setup.room:
            setup.room[key] = shares_of(t, population, scene.targets, position, scenario.processing.seed)
        shares = setup.room[key]
        if shares is not None:
            return _placed(population.name, shares, setup, view, errors, t.host, covariance)
    parts = [] if lit.error is None else [fill.mean**2 * lit.error]
    if t.host in errors and fill.mean < 1.0:
        parts.append((1.0 - fill.mean) ** 2 * errors[t.host])  # the rest of the pixel
    error = np.sum(parts, axis=0) if parts else None
    rho = target_pixel_reflectance(fill.mean, lit.mean, host.mean)
    under_sky = target_pixel_reflectance(fill.mean, lit.under_sky, host.mean)
    return _Subject(population.name, rho, under_sky, covariance, gain, error, False)


def _placed(
    name: str, shares: Shares, setup: Setup, view: View, errors: Mapping[str, Array], host: str, covariance: Array
) -> _Subject:
    """One object at its place, with what lies beside it."""
    scene, surfaces = setup.scenario.scene, setup.surfaces
    lit = {
        t.name: _lit(t, surfaces[t.name], view, errors.get(t.name)) for t in scene.targets if t.name in shares.names
    }
    full, under_sky = {n: x.mean for n, x in lit.items()}, {n: x.under_sky for n, x in lit.items()}
    own = {n: x.error for n, x in lit.items() if x.error is not None}
    ground, gain = surfaces[host], next(c.gain for c in scene.classes if c.name == host)
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
