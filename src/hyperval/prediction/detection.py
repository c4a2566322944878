"""Score statistics and ROC curves of every target population (3.21-3.33).

Everything here stands on the detector's bands: the view and the surfaces come cut to them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from hyperval.prediction.fills import fills_of_objects, moments
from hyperval.prediction.inputs import SurfaceStatistics, class_tail
from hyperval.prediction.view import View
from hyperval.processing.elm_model import retrieved_covariance, retrieved_reflectance
from hyperval.processing.features import (
    feature_covariance,
    features,
    minimum_noise_fraction,
    principal_components,
)
from hyperval.processing.filters import LINEAR_DETECTORS, LinearFilter, PositiveDefinite, design_filter
from hyperval.processing.roc_model import (
    ClassScore,
    TargetScore,
    detection_probability,
    greatest_class_false_alarm,
    object_detection_probability,
    score_density,
    score_mean,
    score_sd,
    target_density,
    threshold_at,
)
from hyperval.products import ExceedanceCurve, ObjectScores, RocCurve, ScoreDistribution, background_of
from hyperval.scenario import BackgroundClass, Features, Processing, Target
from hyperval.scene.fill import FillDistribution
from hyperval.scene.mixture import average_reflectance, mixture_covariance
from hyperval.scene.radiance import target_pixel_covariance, target_pixel_reflectance

Array = npt.NDArray[np.float64]
RocKey = tuple[str, str, str]

# Mean and variance of a score are at most quadratic in the fill, which a cubic spline carries exactly.
_FILL_NODES = np.linspace(0.0, 1.0, 9)
# Score distributions are tabulated on this many points, over this many standard deviations either way.
_GRID, _REACH = 201, 6.0


@dataclass(frozen=True)
class Background:
    """The classes as the detector sees them, after the empirical line: M means (F,), M covariances (F, F)."""

    classes: Sequence[BackgroundClass]
    surfaces: Mapping[str, SurfaceStatistics]
    view: View
    means: Sequence[Array]
    covariances: Sequence[Array]

    @property
    def fractions(self) -> Array:
        """(M,) area fractions."""
        return np.array([c.fraction for c in self.classes])

    def gain_of(self, name: str) -> float:
        """g_B of a class."""
        return next(c.gain for c in self.classes if c.name == name)

    def tail_of(self, c: BackgroundClass) -> float | None:
        """Degrees of freedom of a class; None = Gaussian."""
        return class_tail(c, self.surfaces[c.name])


def seen_background(
    view: View, classes: Sequence[BackgroundClass], surfaces: Mapping[str, SurfaceStatistics]
) -> Background:
    """Statistics of all classes after sensor and empirical line (3.11-3.21)."""
    line = view.line()
    means, covariances = [], []
    for c in classes:
        s = surfaces[c.name]
        level = view.level(s.mean)
        seen = view.seen(level, s.mean, s.covariance if c.gain == 1.0 else c.gain * s.covariance, c.gain)
        means.append(retrieved_reflectance(line, level))
        covariances.append(retrieved_covariance(line, seen))
    return Background(classes, surfaces, view, means, covariances)


@dataclass(frozen=True)
class FilterBase:
    """What filters are built on: the mixture background, in the features chosen (3.21-3.25).

    Attributes
    ----------
    mean, covariance : (F,), (F, F) of the mixture
    psi : (K, F) features, None for the bands themselves
    """

    mean: Array
    covariance: Array
    psi: Array | None

    @cached_property
    def factor(self) -> PositiveDefinite:
        """The covariance in the features, factorised once for all targets and detectors."""
        return PositiveDefinite(
            self.covariance if self.psi is None else feature_covariance(self.psi, self.covariance)
        )

    def of(self, spectrum: Array) -> Array:
        """A spectrum (F,) in the features (3.21)."""
        return spectrum if self.psi is None else features(self.psi, spectrum)

    def spread(self, covariance: Array) -> Array:
        """A covariance (F, F) in the features (3.21)."""
        return covariance if self.psi is None else feature_covariance(self.psi, covariance)

    def filter(self, detector: str, target: Array) -> LinearFilter:
        """The filter, as weights of the bands: w Psi of the filter in the features (3.21-3.25)."""
        found = design_filter(detector, self.of(target), self.of(self.mean), self.factor)
        return found if self.psi is None else replace(found, weights=found.weights @ self.psi)


def filter_base(
    background: Background,
    populations: Sequence[tuple[float, Array, Array]] = (),
    filter_classes: Sequence[str] = (),
    choice: Features | None = None,
) -> FilterBase:
    """Mixture statistics and features that the filters use (3.21-3.25).

    Parameters
    ----------
    populations : (part of the scene, mean (F,), covariance (F, F)) of target pixels, for statistics
        taken over the whole scene
    filter_classes : names of the classes whose mixture the filter is built on; empty: all
    choice : principal components or minimum noise fractions; None: bands
    """
    fractions, means, covariances = background.fractions, list(background.means), list(background.covariances)
    if filter_classes:
        chosen = [i for i, c in enumerate(background.classes) if c.name in filter_classes]
        fractions = fractions[chosen] / fractions[chosen].sum()
        means, covariances = [means[i] for i in chosen], [covariances[i] for i in chosen]
    if populations:
        part = np.array([p for p, _, _ in populations])
        fractions = np.concatenate([(1.0 - part.sum()) * fractions, part])
        means += [m for _, m, _ in populations]
        covariances += [c for _, _, c in populations]
    mean, covariance = average_reflectance(fractions, means), mixture_covariance(fractions, means, covariances)
    psi = None
    if choice is not None and choice.pca is not None:
        psi = principal_components(covariance, choice.pca)
    elif choice is not None and choice.mnf is not None:
        line = background.view.line()
        noise = background.view.noise_variance(line.offset + line.gain * mean) / line.gain**2
        psi = minimum_noise_fraction(covariance, noise, choice.mnf)
    return FilterBase(mean, covariance, psi)


def class_scores(background: Background, detector: LinearFilter) -> list[ClassScore]:
    """theta_m and sigma_m of every class (3.27, 3.29)."""
    return [
        ClassScore(
            c.fraction,
            score_mean(detector, background.means[i]),
            score_sd(detector, background.covariances[i]),
            background.tail_of(c),
        )
        for i, c in enumerate(background.classes)
    ]


@dataclass(frozen=True)
class TargetResponse:
    """Score mean and variance against the fill (3.26, 3.28), for one target and one filter."""

    mean: CubicSpline
    variance: CubicSpline

    def at(self, fill: npt.ArrayLike) -> tuple[Array, Array]:
        """Mean and standard deviation of the score at fills (...)."""
        f = np.asarray(fill, dtype=float)
        return np.asarray(self.mean(f)), np.sqrt(np.clip(self.variance(f), 0.0, None))


def target_response(
    background: Background,
    target: Target,
    detector: LinearFilter,
    spectrum_error: Array | None = None,
    shift: float = 0.0,
) -> TargetResponse:
    """Score statistics of a pixel of which the target fills f, for f from 0 to 1 (3.26, 3.28).

    Each fill has its own mean, noise and adjacency; Var(f) comes in by the average over the fill.
    ``spectrum_error`` (F, F) is the error covariance of the target's spectrum and ``shift`` by how many
    standard deviations of the score the true target departs from it.
    """
    view, line = background.view, background.view.line()
    own, host = background.surfaces[target.name], background.surfaces[target.host]
    lit = view.lit_surface(own.mean, own.covariance, target.illumination)
    host_gain = background.gain_of(target.host)
    f = _FILL_NODES
    level = view.level(target_pixel_reflectance(f, lit.mean, host.mean))  # (3.9), (3.10)
    w = detector.weights / line.gain  # weights per unit of the signal
    means = detector.score(retrieved_reflectance(line, level))  # (3.26)
    u = w * view.slope()
    if spectrum_error is not None:
        v = u * lit.factor
        means = means + shift * f * np.sqrt(float(v @ spectrum_error @ v))
    variance = f**2 * target.gain * float(u @ lit.covariance @ u)
    variance = variance + (1.0 - f) ** 2 * host_gain * float(u @ host.covariance @ u)
    weight = host_gain * view.adjacency_weight()
    if weight and view.terms is not None:
        v = w * view.adjacency_slope(target_pixel_reflectance(f, lit.under_sky, host.mean))
        variance = variance + weight * ((v @ view.average_covariance) * v).sum(axis=1)
    variance = variance + view.noise_variance(level) @ w**2  # (3.28)
    return TargetResponse(CubicSpline(f, means), CubicSpline(f, variance))


def seen_population(background: Background, target: Target, fill: FillDistribution) -> tuple[Array, Array]:
    """Mean (F,) and covariance (F, F) of target pixels as the detector sees them, by moments (3.12)."""
    view, line = background.view, background.view.line()
    own, host = background.surfaces[target.name], background.surfaces[target.host]
    lit = view.lit_surface(own.mean, own.covariance, target.illumination)
    host_gain = background.gain_of(target.host)
    covariance = target_pixel_covariance(
        fill.mean, fill.variance, lit.mean, lit.covariance, host.mean, host.covariance,
        target_gain=target.gain, host_gain=host_gain, formulation=view.formulation,
    )  # fmt: skip
    level = view.level(target_pixel_reflectance(fill.mean, lit.mean, host.mean))
    under_sky = target_pixel_reflectance(fill.mean, lit.under_sky, host.mean)
    seen = view.seen(level, under_sky, covariance, host_gain)
    return retrieved_reflectance(line, level), retrieved_covariance(line, seen)


@dataclass(frozen=True)
class Detection:
    """Scores and ROC curves of one evaluation, and what is to be said of them.

    ``pairs`` are evaluations with one input a standard uncertainty up and down, where that was asked for.
    """

    scores: dict[tuple[str, str], ScoreDistribution]
    roc: dict[RocKey, RocCurve]
    exceedance: dict[tuple[str, str], ExceedanceCurve] = field(default_factory=dict)
    object_scores: dict[tuple[str, str], ObjectScores] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    pairs: tuple[tuple[Detection, Detection], ...] = ()


@dataclass(frozen=True)
class Task:
    """What is looked for and how.

    Attributes
    ----------
    looked_for : target name -> (F,) reflectance that its filter looks for
    pfa : (K,) false-alarm probabilities
    processing : detectors, features, statistics of the filter
    spectrum_error : target name -> (F, F) error covariance of the target's spectrum
    object_curves : also the ROC curves of whole objects
    """

    targets: Sequence[Target]
    looked_for: Mapping[str, Array]
    processing: Processing
    pfa: Array
    spectrum_error: Mapping[str, Array]
    object_curves: bool = True


def filter_populations(background: Background, task: Task) -> list[tuple[float, Array, Array]]:
    """Target pixels (part of the scene, mean (F,), covariance (F, F)) that the filter's statistics hold, if any."""
    if task.processing.filter_statistics != "scene":
        return []
    thesis = background.view.formulation == "thesis"
    return [
        (p.scene_fraction, *seen_population(background, t, moments(p, thesis)))
        for t in task.targets
        for p in t.populations
        if p.scene_fraction > 0
    ]


def detect(background: Background, task: Task, shift: float = 0.0) -> Detection:
    """Scores and ROC curves of all target populations (3.22-3.33).

    ``shift``: by how many standard deviations the true target departs from its spectrum, the filter unchanged.
    """
    found = Detection({}, {})
    view, processing = background.view, task.processing
    thesis = view.formulation == "thesis"
    populations = filter_populations(background, task)
    base = filter_base(background, populations, processing.filter_classes, processing.features)
    notes: list[str] = []
    for target in task.targets:
        spectrum = retrieved_reflectance(view.library_line(), view.level(task.looked_for[target.name]))
        for name in processing.detectors:
            if name in LINEAR_DETECTORS:
                linear = base.filter(name, spectrum)
                _add_linear(found, background, target, name, linear, task, shift, thesis)
            else:
                from hyperval.prediction.ace import add_ace

                notes.append(add_ace(found, background, target, base, spectrum, task, shift, thesis))
    return replace(found, notes=tuple(notes))


def _add_linear(
    found: Detection,
    background: Background,
    target: Target,
    name: str,
    detector: LinearFilter,
    task: Task,
    shift: float,
    thesis: bool,
) -> None:
    classes = class_scores(background, detector)
    threshold = threshold_at(task.pfa, classes)
    response = target_response(background, target, detector, task.spectrum_error.get(target.name), shift)
    mixture = _mixture_score(classes)
    preset = greatest_class_false_alarm(threshold, classes)
    found.exceedance[target.name, name] = ExceedanceCurve(
        threshold[::-1], task.pfa[::-1], task.pfa[::-1], task.pfa[::-1]
    )
    for population in target.populations:
        fill = moments(population, thesis)
        means, sds = response.at(fill.values)
        score = TargetScore(means, sds, fill.weights)
        grid = np.linspace(score.mean - _REACH * score.sd, score.mean + _REACH * score.sd, _GRID)
        found.scores[population.name, name] = ScoreDistribution(
            score.mean, score.sd, None, grid, target_density(grid, score)
        )
        found.scores[background_of(population.name), name] = mixture
        pd = np.clip(detection_probability(threshold, score), 0.0, 1.0)
        found.roc[population.name, name, "pixel"] = RocCurve(
            task.pfa, pd, pd, pd, threshold, "pixel", preset_pfa=preset
        )
        if not task.object_curves:
            continue
        objects = np.array([[fill.mean]]) if thesis else fills_of_objects(population.fill)
        if objects.shape[1] > 1 or fill.values.size < objects.shape[0]:
            pd = object_detection_probability(threshold, *response.at(objects))
        found.roc[population.name, name, "object"] = RocCurve(
            task.pfa, pd, pd, pd, threshold, "object", preset_pfa=preset
        )


def _mixture_score(classes: Sequence[ClassScore]) -> ScoreDistribution:
    f = np.array([c.fraction for c in classes])
    m = np.array([c.mean for c in classes])
    s = np.array([c.sd for c in classes])
    mean = float(f @ m)
    sd = float(np.sqrt(f @ (s**2 + (m - mean) ** 2)))
    grid = np.linspace(mean - _REACH * sd, mean + _REACH * sd, _GRID)
    return ScoreDistribution(mean, sd, None, grid, score_density(grid, classes))
