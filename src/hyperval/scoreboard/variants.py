"""Engines and formulations on one collection: each predicted once, how well it agrees, how two differ."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from hyperval.campaign.collected import Collected
from hyperval.campaign.predicted_side import merged, without_circles
from hyperval.compare.roc import compare_roc
from hyperval.compare.rows import RowMaker
from hyperval.compare.spectral import compare_spectra
from hyperval.errors import HypervalError
from hyperval.predict import predict
from hyperval.processing.intervals import clopper_pearson
from hyperval.products import Observation, Prediction
from hyperval.progress import track
from hyperval.results import Cause, Outcome, Result
from hyperval.scenario import Scenario
from hyperval.scoreboard.engines import ENGINES, NotApplicable, Served
from hyperval.settings import with_settings
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
    return _bootstrap([s.chi2_reduced for s in spectra.values()], np.median, draws, rng)


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
    return _bootstrap(gaps, np.mean, draws, rng)


def _bootstrap(
    given: Sequence[float], middle: Callable[..., Any], draws: int, rng: np.random.Generator
) -> tuple[float, Span, int]:
    """A mean or median of the finite values, the percentiles of draws of them, and how many there are."""
    values = np.asarray(given, dtype=float)
    values = values[np.isfinite(values)]
    if values.size == 0:
        return math.nan, _NAN, 0
    value = float(middle(values))
    if values.size == 1:
        return value, _NAN, 1
    drawn = middle(values[rng.integers(values.size, size=(draws, values.size))], axis=1)
    return value, interval(drawn, value), int(values.size)


FORMULATIONS: tuple[str, ...] = get_args(Scenario.model_fields["formulation"].annotation)
DRAWS = 1000
EVERY_SUBJECT = "all subjects"
PRODUCT = "benchmark"
_PFA = (1e-2, 1e-3)


@dataclass(frozen=True)
class Variant:
    """One row of the page: an engine with a formulation.

    Attributes
    ----------
    served : one for each scenario; empty where it does not apply
    reason : why not
    own : whether it is the campaign as it stands
    """

    engine: str
    formulation: str
    served: tuple[Served, ...] = ()
    reason: str = ""
    own: bool = False

    @property
    def label(self) -> str:
        """How the table calls it."""
        return f"{self.engine}, {self.formulation}"


def variants_of(collection: Collected) -> list[Variant]:
    """Every engine under the campaign's formulation, and every formulation with its engine."""
    scenarios = collection.scenarios
    engine = "+".join(sorted({s.atmosphere.engine for s in scenarios if s.atmosphere})) or "no atmosphere"
    formulation = "+".join(sorted({s.formulation for s in scenarios}))
    out = [Variant(engine, formulation, tuple(Served(s) for s in scenarios), own=True)]
    for name, entry in ENGINES.items():
        if name == engine:
            continue
        try:
            served = tuple(entry.serve(s, collection.resolver(s)) for s in scenarios)
            out.append(Variant(name, formulation, served))
        except NotApplicable as no:
            out.append(Variant(name, formulation, reason=str(no)))
    for name in FORMULATIONS:
        if name != formulation:
            moved = tuple(Served(with_settings(s, {"formulation": name})) for s in scenarios)
            out.append(Variant(engine, name, moved))
    return out


def variant_rows(
    collection: Collected, *, seed: int, show_progress: bool | None = None
) -> tuple[list[Result], list[Prediction]]:
    """Rows of every variant, and the predictions behind them for the provenance."""
    agreements: list[tuple[Variant, Agreement | None]] = []
    predictions: list[Prediction] = []
    for variant in track(variants_of(collection), "variants", show=show_progress):
        if variant.reason:
            agreements.append((variant, None))
            continue
        try:
            sides = [
                _predicted(one, scenario, collection)
                for one, scenario in zip(variant.served, collection.scenarios, strict=True)
            ]
        except HypervalError as error:
            if variant.own:
                raise
            agreements.append((Variant(variant.engine, variant.formulation, reason=str(error)), None))
            continue
        predictions += sides
        whole = without_circles(merged(sides), [s.scenario for s in variant.served], collection.observed.place)
        agreements.append((variant, agreement_of(_compared(whole, collection.observed.observation, variant.label))))
    base = next(x for v, x in agreements if v.own)
    assert base is not None  # noqa: S101 - what the campaign itself says was predicted or has raised
    rows: list[Result] = []
    for variant, score in agreements:
        rows += _rows(variant, score, base, seed)
    return rows, predictions


def _predicted(one: Served, scenario: Scenario, collection: Collected) -> Prediction:
    origins = replace(collection.origins(scenario, False), engine=one.terms_of)
    return predict(one.scenario, origins)


def _compared(predicted: Prediction, observed: Observation, label: str) -> list[Result]:
    """Rows of spectra and curves that both sides hold: what the scores are made of."""
    rows: list[Result] = []
    for product in ("radiance", "reflectance"):
        left, right = getattr(predicted, product), getattr(observed, product)
        for subject in (s for s in right if s in left):
            rows += compare_spectra(
                left[subject], right[subject], product=product, subject=subject, method=label,
                axis=observed.axis,
            )  # fmt: skip
    for key in (k for k in observed.roc if k in predicted.roc and k[2] == "pixel"):
        rows += compare_roc(predicted.roc[key], observed.roc[key], subject=key[0], method=label, pfa=_PFA)
    return rows


def _rows(variant: Variant, score: Agreement | None, base: Agreement, seed: int) -> list[Result]:
    make = RowMaker(PRODUCT, EVERY_SUBJECT, variant.label)
    if score is None:
        return [make.skipped(Cause.REFUSED, variant.reason, "agreement")]
    words = "; ".join(dict.fromkeys(s.note for s in variant.served if s.note))
    rows: list[Result] = []
    for quantity, spectra in score.spectra.items():
        rows += _spectral_rows(make, quantity, spectra, seed, words)
        if not variant.own:
            rows += _change_rows(make, quantity, spectra, base.spectra.get(quantity, {}), seed)
    for level in LEVELS:
        share, span, n = inside_share(score.inside[level])
        if n:
            why = "curves by pixel of the campaign's own detectors; the interval takes them for independent"
            rows.append(make.row(f"pd_inside_interval@{level}", share, interval=span, n=n, reason=why))
        gap, span, n = mean_gap(score.differences[level], draws=DRAWS, rng=np.random.default_rng(seed))
        if n:
            why = "mean over curves by pixel; interval by drawing curves anew"
            rows.append(make.row(f"pd_mean_abs_difference@{level}", gap, interval=span, n=n, reason=why))
    return rows or [
        make.skipped(Cause.NO_PREDICTION, "the campaign compares no spectrum in a window and no curve", "agreement")
    ]


def _spectral_rows(
    make: RowMaker, quantity: str, spectra: Mapping[str, Spectral], seed: int, words: str
) -> list[Result]:
    """``radiance_median_abs_difference_ratio`` and the like: all subjects, each subject, and the chi-square."""
    metric = f"{quantity}_median_abs_difference_ratio"
    why = "windows; median over subjects of the median over bands; interval by drawing subjects and blocks of "
    why += f"{BLOCK_NM:g} nm anew" + (f"; {words}" if words else "")
    value, span = _median(spectra, seed)
    rows = [make.row(metric, value, interval=span, n=len(spectra), reason=why)]
    for name, one in spectra.items():
        value, span = _median({name: one}, seed)
        rows.append(replace(make, subject=name).row(metric, value, interval=span, n=one.ratio.size))
    chi2, span, n = median_chi2(spectra, draws=DRAWS, rng=np.random.default_rng(seed))
    if n:
        why = "full covariance; median over subjects, interval by drawing subjects anew; 1 where the budget holds"
        rows.append(make.row(f"{quantity}_chi2_reduced", chi2, interval=span, n=n, reason=why))
    return rows


def _median(spectra: Mapping[str, Spectral], seed: int) -> tuple[float, Span]:
    value = median_abs(spectra)
    drawn = median_abs_draws([spectra], draws=DRAWS, rng=np.random.default_rng(seed))[0]
    return value, interval(drawn, value)


def _change_rows(
    make: RowMaker, quantity: str, spectra: Mapping[str, Spectral], base: Mapping[str, Spectral], seed: int
) -> list[Result]:
    """The median less that of the campaign as it stands, on the subjects and bands that both have."""
    common = [n for n, s in base.items() if n in spectra and np.array_equal(s.band_nm, spectra[n].band_nm)]
    if not common:
        return []
    pair = [{n: side[n] for n in common} for side in (spectra, base)]
    drawn = median_abs_draws(pair, draws=DRAWS, rng=np.random.default_rng(seed))
    change = median_abs(pair[0]) - median_abs(pair[1])
    why = "less the same of the campaign as it stands, in the same draws; below 0 it predicts better"
    span = interval(drawn[0] - drawn[1], change)
    metric = f"{quantity}_median_abs_difference_ratio_change"
    return [make.row(metric, change, interval=span, n=len(common), reason=why)]
