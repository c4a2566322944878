"""How well one variant of the model predicts one campaign, and how two variants differ on the same bands."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from hyperval.processing.intervals import clopper_pearson
from hyperval.results import Outcome, Result
from hyperval.spectra.windows import in_window

Array = npt.NDArray[np.float64]
Span = tuple[float, float]

LEVELS = ("1e-2", "1e-3")
BLOCK_NM = 100.0  # bands that are drawn together: their errors are alike
_NAN: Span = (math.nan, math.nan)


@dataclass(frozen=True)
class Spectral:
    """Difference ratios of one subject in the windows.

    Attributes
    ----------
    band_nm, ratio : (b,) band centres [nm] and predicted over collected less 1
    chi2_reduced : of the full-covariance test; NaN where it could not be made
    """

    band_nm: Array
    ratio: Array
    chi2_reduced: float = math.nan

    @property
    def blocks(self) -> list[npt.NDArray[np.intp]]:
        """Indices of the bands of each block of :data:`BLOCK_NM`."""
        cell = (self.band_nm // BLOCK_NM).astype(int)
        return [np.flatnonzero(cell == c) for c in np.unique(cell)]


@dataclass(frozen=True)
class Agreement:
    """One variant on one campaign.

    Attributes
    ----------
    spectra : quantity -> subject -> :class:`Spectral`
    inside : level of P_FA -> 1 or 0 for each curve that has a verdict
    differences : level -> |P_D predicted - measured| of each curve
    """

    spectra: Mapping[str, Mapping[str, Spectral]] = field(default_factory=dict)
    inside: Mapping[str, Sequence[float]] = field(default_factory=dict)
    differences: Mapping[str, Sequence[float]] = field(default_factory=dict)


def agreement_of(rows: Sequence[Result]) -> Agreement:
    """What the rows of a comparison say, gathered."""
    spectra: dict[str, dict[str, Spectral]] = {}
    for quantity in ("radiance", "reflectance"):
        by_subject: dict[str, list[Result]] = {}
        for row in rows:
            if row.product == quantity:
                by_subject.setdefault(row.subject, []).append(row)
        for subject, own in by_subject.items():
            spectral = _spectral(own)
            if spectral is not None:
                spectra.setdefault(quantity, {})[subject] = spectral
    curves = [r for r in rows if r.product == "roc" and r.outcome is not Outcome.SKIPPED and math.isfinite(r.value)]

    def values(metric: str) -> dict[str, list[float]]:
        return {x: [r.value for r in curves if r.metric == f"{metric}@{x}"] for x in LEVELS}

    gaps = {x: [abs(v) for v in spectral] for x, spectral in values("pd_difference").items()}
    return Agreement(spectra, values("pd_inside_interval"), gaps)


def _spectral(rows: Sequence[Result]) -> Spectral | None:
    at = [r for r in rows if r.metric == "difference_ratio" and math.isfinite(r.value) and in_window(r.band_nm)]
    if not at:
        return None
    chi2 = next((r.value for r in rows if r.metric == "chi2_reduced_full"), math.nan)
    return Spectral(np.array([r.band_nm for r in at]), np.array([r.value for r in at]), chi2)


def median_abs(spectra: Mapping[str, Spectral]) -> float:
    """Median |difference ratio| over the bands in windows of all subjects, each subject counted alike.

    Examples
    --------
    >>> median_abs({"lawn": Spectral(np.array([500.0, 600.0]), np.array([-0.1, 0.3]))})
    0.2
    """
    return float(np.median([float(np.median(np.abs(s.ratio))) for s in spectra.values()]))


def median_abs_draws(variants: Sequence[Mapping[str, Spectral]], *, draws: int, rng: np.random.Generator) -> Array:
    """(V, draws) :func:`median_abs` of variants in the same resamples of subjects and blocks of bands.

    Subjects are drawn anew, then blocks of 100 nm within each: bands near each other err alike.  The spread says
    how far the figure hangs on which subjects and bands were looked at.
    """
    names = [n for n in variants[0] if all(n in v for v in variants)]
    out = np.empty((len(variants), draws))
    blocks = {n: variants[0][n].blocks for n in names}
    for i in range(draws):
        parts = []
        for k in rng.integers(len(names), size=len(names)):
            own = blocks[names[k]]
            bands = np.concatenate([own[j] for j in rng.integers(len(own), size=len(own))])
            parts.append([float(np.median(np.abs(v[names[k]].ratio[bands]))) for v in variants])
        out[:, i] = np.median(np.array(parts), axis=0)
    return out


def interval(draws: Array, value: float) -> Span:
    """95 % percentiles of the draws, the value itself inside."""
    low, high = (float(x) for x in np.quantile(draws, [0.025, 0.975]))
    return min(low, value), max(high, value)


def median_chi2(
    spectra: Mapping[str, Spectral], *, draws: int, rng: np.random.Generator
) -> tuple[float, Span, int]:
    """Median over subjects of the reduced chi-square, with the percentiles of a bootstrap over them.

    The median, as one subject whose budget leaves out a direction may give a thousand times the others'.

    Examples
    --------
    >>> spectra = {"lawn": Spectral(np.array([500.0]), np.array([0.1]), 1.4)}
    >>> median_chi2(spectra, draws=100, rng=np.random.default_rng(0))[0]
    1.4
    """
    values = np.array([s.chi2_reduced for s in spectra.values() if math.isfinite(s.chi2_reduced)])
    if values.size == 0:
        return math.nan, _NAN, 0
    middle = float(np.median(values))
    if values.size == 1:
        return middle, _NAN, 1
    drawn = np.median(values[rng.integers(values.size, size=(draws, values.size))], axis=1)
    return middle, interval(drawn, middle), int(values.size)


def inside_share(inside: Sequence[float]) -> tuple[float, Span, int]:
    """Share of curves with the predicted P_D inside the interval, with its Clopper-Pearson interval."""
    n = len(inside)
    if n == 0:
        return math.nan, _NAN, 0
    low, high = clopper_pearson(int(sum(inside)), n)
    return sum(inside) / n, (float(low), float(high)), n


def mean_gap(gaps: Sequence[float], *, draws: int, rng: np.random.Generator) -> tuple[float, Span, int]:
    """Mean |P_D difference| over curves, with the percentiles of a bootstrap over them.

    Examples
    --------
    >>> mean_gap([0.1, 0.3], draws=100, rng=np.random.default_rng(0))[0]
    0.2
    """
    values = np.asarray(gaps, dtype=float)
    if values.size == 0:
        return math.nan, _NAN, 0
    mean = float(values.mean())
    if values.size == 1:
        return mean, _NAN, 1
    drawn = values[rng.integers(values.size, size=(draws, values.size))].mean(axis=1)
    return mean, interval(drawn, mean), int(values.size)
