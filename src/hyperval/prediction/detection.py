"""Score statistics and ROC curves of every target population (3.21-3.33)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from hyperval.prediction.inputs import SurfaceStatistics
from hyperval.prediction.view import View
from hyperval.processing.filters import LinearFilter, design_filter
from hyperval.processing.roc_model import (
    ClassScore,
    TargetScore,
    detection_probability,
    object_detection_probability,
    score_mean,
    score_sd,
    threshold_at,
)
from hyperval.products import RocCurve, ScoreDistribution, background_of
from hyperval.scenario import BackgroundClass, Fill, Target, TargetSubject
from hyperval.scene.fill import (
    FillDistribution,
    TargetGeometry,
    beta_fill,
    fixed_fill,
    object_fills,
    ranked_pixel_fill,
)
from hyperval.scene.mixture import average_reflectance, mixture_covariance
from hyperval.scene.radiance import target_pixel_covariance, target_pixel_reflectance

Array = npt.NDArray[np.float64]
RocKey = tuple[str, str, str]

# Mean and variance of a score are at most quadratic in the fill, which a cubic spline carries exactly.
_FILL_NODES = np.linspace(0.0, 1.0, 9)


def fill_distribution(fill: Fill) -> FillDistribution:
    """Fill fractions of the pixels of one population (f of 3.10)."""
    if fill.fixed is not None:
        return fixed_fill(fill.fixed)
    if fill.geometry is not None:
        return ranked_pixel_fill(_geometry(fill), fill.geometry.n or 1).binned()
    return beta_fill(fill.mean or 0.0, fill.sd or 0.0)


def fills_of_objects(fill: Fill) -> Array:
    """(K, n) fills of the pixels of one object (f of 3.10); one pixel unless the geometry says more."""
    if fill.geometry is not None:
        return object_fills(_geometry(fill), fill.geometry.n or 1)
    return fill_distribution(fill).values[:, None]


def _geometry(fill: Fill) -> TargetGeometry:
    g = fill.geometry
    assert g is not None  # noqa: S101 - both callers have asked
    return TargetGeometry(
        g.side_m or g.length_m or 0.0,
        g.side_m or g.width_m or 0.0,
        g.gsd_m,
        None if g.heading_deg == "random" else float(g.heading_deg),
        g.psf_fwhm_pixels,
        g.phase,
    )


@dataclass(frozen=True)
class Background:
    """The classes as the detector sees them, on its bands: means (M, F), covariances (M, F, F)."""

    classes: Sequence[BackgroundClass]
    surfaces: Mapping[str, SurfaceStatistics]
    view: View
    bands: npt.NDArray[np.intp]
    gain: Array
    offset: Array
    means: Array
    covariances: Array

    @property
    def fractions(self) -> Array:
        """(M,) area fractions."""
        return np.array([c.fraction for c in self.classes])


def seen_background(
    view: View,
    classes: Sequence[BackgroundClass],
    surfaces: Mapping[str, SurfaceStatistics],
    bands: npt.NDArray[np.intp],
) -> Background:
    """Statistics of all classes after sensor and empirical line, on the detector's bands (3.11-3.21)."""
    line = view.line()
    k, b = line.gain[bands], line.offset[bands]
    means, covariances = [], []
    for c in classes:
        s = surfaces[c.name]
        level = view.level(s.mean)
        covariance = view.covariance(s.mean, c.gain * s.covariance, c.gain)[np.ix_(bands, bands)]
        covariance = covariance + np.diag(view.noise_variance(level)[bands])  # (3.16)-(3.19)
        means.append((level[bands] - b) / k)
        covariances.append(covariance / np.outer(k, k))
    return Background(classes, surfaces, view, bands, k, b, np.array(means), np.array(covariances))


def detector_filter(
    background: Background,
    detector: str,
    looked_for: Array,
    populations: Sequence[tuple[float, Array, Array]] = (),
    filter_classes: Sequence[str] = (),
) -> LinearFilter:
    """The filter over the mixture background (3.22-3.25).

    Parameters
    ----------
    looked_for : (B,) reflectance of the target that the detector looks for
    populations : (part of the scene, mean (F,), covariance (F, F)) of target pixels, for statistics
        taken over the whole scene
    filter_classes : names of the classes whose mixture the filter is built on; empty: all
    """
    fractions, means, covariances = background.fractions, background.means, background.covariances
    if filter_classes:
        chosen = np.array([c.name in filter_classes for c in background.classes])
        fractions = fractions[chosen] / fractions[chosen].sum()
        means, covariances = means[chosen], covariances[chosen]
    if populations:
        part = np.array([p for p, _, _ in populations])
        fractions = np.concatenate([(1.0 - part.sum()) * fractions, part])
        means = np.concatenate([means, [m for _, m, _ in populations]])
        covariances = np.concatenate([covariances, [c for _, _, c in populations]])
    target = (background.view.level(looked_for)[background.bands] - background.offset) / background.gain
    return design_filter(
        detector,
        target,
        average_reflectance(fractions, means),
        mixture_covariance(fractions, means, covariances),
    )


def class_scores(background: Background, detector: LinearFilter) -> list[ClassScore]:
    """theta_m and sigma_m of every class (3.27, 3.29)."""
    return [
        ClassScore(
            c.fraction,
            score_mean(detector, background.means[i]),
            score_sd(detector, background.covariances[i]),
            c.tail_dof or background.surfaces[c.name].tail_dof,
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
    ``spectrum_error`` (B, B) is the error covariance of the target's spectrum and ``shift`` by how many
    standard deviations of the score the true target departs from it.
    """
    view, bands = background.view, background.bands
    own, host = background.surfaces[target.name], background.surfaces[target.host]
    host_gain = next(c.gain for c in background.classes if c.name == target.host)
    f = _FILL_NODES
    rho = target_pixel_reflectance(f, own.mean, host.mean)  # (3.10)
    level = view.level(rho)  # (3.9)
    w = np.zeros(own.mean.size)
    w[bands] = detector.weights / background.gain  # weights per unit of the signal
    means = detector.score((level[:, bands] - background.offset) / background.gain)  # (3.26)
    u = w[bands] * view.slope()[bands]
    inner = np.ix_(bands, bands)
    if spectrum_error is not None:
        means = means + shift * f * np.sqrt(float(u @ spectrum_error[inner] @ u))
    variance = f**2 * target.gain * float(u @ own.covariance[inner] @ u)
    variance = variance + (1.0 - f) ** 2 * host_gain * float(u @ host.covariance[inner] @ u)
    weight = host_gain * view.adjacency_weight()
    if weight and view.terms is not None:
        v = w[bands] * view.adjacency_slope(rho)[:, bands]
        variance = variance + weight * np.einsum("ki,ij,kj->k", v, view.average_covariance[inner], v, optimize=True)
    variance = variance + view.noise_variance(level)[:, bands] @ w[bands] ** 2  # (3.28)
    return TargetResponse(CubicSpline(f, means), CubicSpline(f, variance))


def seen_population(background: Background, target: Target, fill: FillDistribution) -> tuple[Array, Array]:
    """Mean (F,) and covariance (F, F) of target pixels on the detector's bands, by moments (3.12)."""
    view, bands = background.view, background.bands
    own, host = background.surfaces[target.name], background.surfaces[target.host]
    host_gain = next(c.gain for c in background.classes if c.name == target.host)
    rho = target_pixel_reflectance(fill.mean, own.mean, host.mean)
    covariance = target_pixel_covariance(
        fill.mean, fill.variance, own.mean, own.covariance, host.mean, host.covariance,
        target_gain=target.gain, host_gain=host_gain, formulation=view.formulation,
    )  # fmt: skip
    level = view.level(rho)
    seen = view.covariance(rho, covariance, host_gain)[np.ix_(bands, bands)]
    seen = (seen + np.diag(view.noise_variance(level)[bands])) / np.outer(background.gain, background.gain)
    return (level[bands] - background.offset) / background.gain, seen


@dataclass(frozen=True)
class Detection:
    """Scores and ROC curves of one evaluation."""

    scores: dict[tuple[str, str], ScoreDistribution]
    roc: dict[RocKey, RocCurve]


def detect(
    background: Background,
    targets: Sequence[Target],
    looked_for: Mapping[str, Array],
    detectors: Sequence[str],
    pfa: Array,
    *,
    whole_scene: bool = False,
    filter_classes: Sequence[str] = (),
    spectrum_error: Mapping[str, Array] | None = None,
    shift: float = 0.0,
) -> Detection:
    """Scores and ROC curves of all target populations (3.22-3.33).

    Parameters
    ----------
    looked_for : target name -> (B,) reflectance that its filter looks for
    pfa : (K,) false-alarm probabilities
    whole_scene : take the filter's statistics over background and target pixels
    filter_classes : classes whose mixture the filter is built on; empty: all
    spectrum_error, shift : target name -> (B, B) error covariance of the target's spectrum, and by how many
        standard deviations the true target departs from it, the filter unchanged
    """
    scores: dict[tuple[str, str], ScoreDistribution] = {}
    roc: dict[RocKey, RocCurve] = {}
    thesis = background.view.formulation == "thesis"
    populations = []
    if whole_scene:
        populations = [
            (p.scene_fraction, *seen_population(background, t, _moments(p, thesis)))
            for t in targets
            for p in t.populations
            if p.scene_fraction > 0
        ]
    for target in targets:
        for name in detectors:
            detector = detector_filter(background, name, looked_for[target.name], populations, filter_classes)
            classes = class_scores(background, detector)
            threshold = threshold_at(pfa, classes)
            error = spectrum_error.get(target.name) if spectrum_error else None
            response = target_response(background, target, detector, error, shift)
            mixture = _mixture_score(classes)
            for population in target.populations:
                fill = _moments(population, thesis)
                means, sds = response.at(fill.values)
                score = TargetScore(means, sds, fill.weights)
                scores[population.name, name] = ScoreDistribution(score.mean, score.sd)
                scores[background_of(population.name), name] = mixture
                pd = np.clip(detection_probability(threshold, score), 0.0, 1.0)
                roc[population.name, name, "pixel"] = RocCurve(pfa, pd, pd, pd, threshold, "pixel")
                objects = np.array([[fill.mean]]) if thesis else fills_of_objects(population.fill)
                if objects.shape[1] > 1 or fill.values.size < objects.shape[0]:
                    pd = object_detection_probability(threshold, *response.at(objects))
                roc[population.name, name, "object"] = RocCurve(pfa, pd, pd, pd, threshold, "object")
    return Detection(scores, roc)


def _moments(population: TargetSubject, thesis: bool) -> FillDistribution:
    """The fill of a population; the printed form knows its mean alone."""
    fill = fill_distribution(population.fill)
    return fixed_fill(fill.mean) if thesis else fill


def _mixture_score(classes: Sequence[ClassScore]) -> ScoreDistribution:
    f = np.array([c.fraction for c in classes])
    m = np.array([c.mean for c in classes])
    s = np.array([c.sd for c in classes])
    mean = float(f @ m)
    return ScoreDistribution(mean, float(np.sqrt(f @ (s**2 + (m - mean) ** 2))))
