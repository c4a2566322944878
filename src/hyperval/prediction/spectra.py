"""Radiance, SNR, noise and reflectance of every subject (3.7-3.20, and the empirical line)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import numpy.typing as npt

from hyperval.prediction.background import Ground, View
from hyperval.prediction.cases import Case, Setup, settings_of
from hyperval.prediction.departure import fill_distribution
from hyperval.prediction.inputs import SurfaceStatistics
from hyperval.prediction.object_scores import HOST, PLACE, Shares, host_covariance, mixed, place_covariance, shares_of
from hyperval.prediction.uncertainty import Steps, combined, interpolation_errors, known, spectral_errors
from hyperval.processing.elm import retrieved_covariance, retrieved_reflectance
from hyperval.products import SpectralEstimate
from hyperval.scenario import EngineUncertainty, Target, TargetSubject
from hyperval.scene.radiance import target_pixel_covariance, target_pixel_reflectance, toa_reflectance

Array = npt.NDArray[np.float64]
_STEP = 1e-4  # of reflectance [1], for derivatives by a spectrum: their error goes by its square
_NO_SLOPE = 1e-9  # relative to a slope of 1: what rounding leaves where nothing follows


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

    ``others`` are error covariances (B, B) of its reflectance by source, those of surfaces' spectra apart.
    """

    name: str
    rho: Array
    under_sky: Array
    covariance: Array
    gain: float
    pure: bool  # a class, panel or site; target pixels have no SNR of their own
    others: Mapping[str, Array] = field(default_factory=dict)


def spectral_products(
    case: Case,
    ground: Ground,
    view: View,
    steps: Steps,
    errors: Sequence[MeanError],
    engine: EngineUncertainty | None,
) -> SpectralProducts:
    """All spectra of a case with their errors.

    Parameters
    ----------
    ground, view : of the case, its arrays (B,)
    steps : the light and sensor one standard uncertainty up and down
    errors : of the spectra of surfaces
    engine : what is stated of the error of the atmosphere engine
    """
    out, setup = SpectralProducts(), case.setup
    axis, subjects, moved = setup.used.axis, _subjects(setup, view), _moved(case, errors)
    # One piece of memory for all: new pages for each matrix take longer than the numbers in it.
    *room, scratch = np.empty((1 + 2 * len(subjects), len(axis), len(axis)))
    for number, subject in enumerate(subjects):
        of_radiance, of_reflectance = room[2 * number : 2 * number + 2]
        level, around = view.level(subject.rho), ground.covariance
        seen = view.seen(level, subject.under_sky, subject.covariance, around, subject.gain, of_radiance, scratch)
        if view.terms is not None:
            changes = steps.changes(lambda v, rho=subject.rho: v.level(rho))  # type: ignore[misc]
            shapes = spectral_errors(view, subject.rho, axis, engine, setup.used.sensor)
            shapes |= _of_spectra(moved, subject.name, lambda v, rho: v.level(rho))
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
            shapes = _through(view, subject.others)
            if view.terms is not None:
                shapes = {source: retrieved_covariance(line, c) for source, c in shapes.items()}
            shapes |= _of_spectra(
                moved, subject.name, lambda v, rho: retrieved_reflectance(v.library_line(), v.level(rho))
            )
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


@dataclass(frozen=True)
class MeanError:
    """Error covariance (B, B) of the mean reflectance of a surface, under the name of its source in budgets."""

    source: str
    surface: str
    covariance: Array


@dataclass(frozen=True)
class _MovedSpectrum:
    """An error of a spectrum, and views and reflectances of the subjects with that spectrum higher and lower."""

    error: MeanError
    ends: tuple[tuple[View, Mapping[str, tuple[Array, Array]]], ...]


def _moved(case: Case, errors: Sequence[MeanError]) -> list[_MovedSpectrum]:
    """Spectra that are in error, moved up and down with what follows them: surroundings, light, darkest pixel."""
    if not errors:
        return []
    setup, names = case.setup, list(dict.fromkeys(e.surface for e in errors))

    def with_mean(name: str, step: float) -> Case:
        surface = setup.surfaces[name]
        surfaces = {**setup.surfaces, name: replace(surface, mean=surface.mean + step)}
        return replace(case, setup=replace(setup, surfaces=surfaces))

    cases = [with_mean(name, step) for name in names for step in (_STEP, -_STEP)]
    views = settings_of(cases).view
    ends = [(row, _reflectances(c.setup, row)) for c, row in ((c, views.row(i)) for i, c in enumerate(cases))]
    return [_MovedSpectrum(e, tuple(ends[2 * names.index(e.surface) :][:2])) for e in errors]


def _of_spectra(moved: Sequence[_MovedSpectrum], subject: str, of: Callable[[View, Array], Array]) -> dict[str, Array]:
    """Errors (B, B) of what ``of`` makes of a subject, by those of spectra; each band follows its own alone."""
    out: dict[str, Array] = {}
    for m in moved:
        up, down = (of(view, rho[subject][0]) for view, rho in m.ends)
        slope = (up - down) / (2.0 * _STEP)
        if np.nanmax(np.abs(slope), initial=0.0) > _NO_SLOPE:
            error = m.error.covariance * np.outer(slope, slope)
            out[m.error.source] = out[m.error.source] + error if m.error.source in out else error
    return out


def _reflectances(setup: Setup, view: View) -> dict[str, tuple[Array, Array]]:
    """Subject -> (B,) what it reflects, as a surface in the open would have to, and what meets light of the
    surroundings (3.10).
    """
    scene, surfaces = setup.scenario.scene, setup.surfaces
    out = {s.name: 2 * (surfaces[s.name].mean,) for s in (*scene.classes, *scene.panels, *scene.sites)}
    lit = {t.name: _lit(t, surfaces[t.name], view) for t in scene.targets}
    for t in scene.targets:
        host = surfaces[t.host].mean
        for population in t.populations:
            shares = _shares(setup, t, population)
            if shares is None:
                fill = fill_distribution(population.fill).mean
                one, other = (
                    target_pixel_reflectance(fill, x, host) for x in (lit[t.name].mean, lit[t.name].under_sky)
                )
            else:
                one = mixed(shares, {n: x.mean for n, x in lit.items()}, host)
                other = mixed(shares, {n: x.under_sky for n, x in lit.items()}, host)
            out[population.name] = one, other
    return out


def _shares(setup: Setup, t: Target, population: TargetSubject) -> Shares | None:
    """Shares of an object at its place; None where there is no place, or the printed form."""
    scenario, key = setup.scenario, ("shares", population.name)
    if scenario.formulation == "thesis":
        return None
    if key not in setup.room:
        position, targets = scenario.uncertainty.position_m, scenario.scene.targets
        setup.room[key] = shares_of(t, population, targets, position, scenario.processing.seed)
    shares: Shares | None = setup.room[key]
    return shares


def _subjects(setup: Setup, view: View) -> list[_Subject]:
    scene, surfaces, subjects = setup.scenario.scene, setup.surfaces, []
    reflectances = _reflectances(setup, view)
    for c in scene.classes:
        s = surfaces[c.name]
        covariance = s.covariance if c.gain == 1.0 else c.gain * s.covariance
        subjects.append(_Subject(c.name, s.mean, s.mean, covariance, c.gain, True))
    for surface in (*scene.panels, *scene.sites):
        s = surfaces[surface.name]
        subjects.append(_Subject(surface.name, s.mean, s.mean, s.covariance, 1.0, True))
    for t in scene.targets:
        for population in t.populations:
            subjects.append(_mixed(setup, view, t, population, *reflectances[population.name]))
    return subjects


@dataclass(frozen=True)
class _Lit:
    """A target under its own light, as a surface in the open would have to be to look like it (ground term of 3.7).

    ``under_sky`` : reflectance times sky view, what the light from the surroundings meets (D_B of 3.11); ``shade``
    (B,) or 1 is its light over that in the open
    """

    mean: Array
    shade: Array | float
    under_sky: Array


def _lit(t: Target, own: SurfaceStatistics, view: View) -> _Lit:
    light = t.illumination
    factor = view.light(light.beam, light.sky_view) if light else 1.0
    if light is None or np.ndim(factor) == 0:
        return _Lit(own.mean, 1.0, own.mean)
    return _Lit(own.mean * factor, factor, own.mean * light.sky_view)


def _mixed(setup: Setup, view: View, t: Target, population: TargetSubject, rho: Array, under_sky: Array) -> _Subject:
    """Target pixels of one population (3.10, 3.12); of one object at its place with what lies beside it."""
    scene, surfaces, host = setup.scenario.scene, setup.surfaces, setup.surfaces[t.host]
    lit = {o.name: _lit(o, surfaces[o.name], view) for o in scene.targets}
    own, shade = surfaces[t.name], lit[t.name].shade
    gain = next(c.gain for c in scene.classes if c.name == t.host)
    fill = fill_distribution(population.fill)
    covariance = target_pixel_covariance(
        fill.mean, fill.variance, lit[t.name].mean,
        own.covariance if np.ndim(shade) == 0 else own.covariance * np.outer(shade, shade),
        host.mean, host.covariance, target_gain=t.gain, host_gain=gain, fine_texture=own.fine_texture,
        formulation=setup.scenario.formulation,
    )  # fmt: skip
    others = {}
    if (shares := _shares(setup, t, population)) is not None:
        others = {
            PLACE: place_covariance(shares, {n: x.mean for n, x in lit.items()}, host.mean),
            HOST: host_covariance(shares, host.covariance, gain),
        }
    return _Subject(population.name, rho, under_sky, covariance, gain, False, others)
