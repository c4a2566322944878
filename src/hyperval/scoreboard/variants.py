"""Variants of the model on one collection: engines and formulations, each predicted once and scored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from hyperval.campaign.merge import merged, without_circles
from hyperval.campaign.one import Collected
from hyperval.compare.roc import compare_roc
from hyperval.compare.rows import RowMaker
from hyperval.compare.spectral import compare_spectra
from hyperval.errors import HypervalError
from hyperval.predict import predict
from hyperval.products import Observation, Prediction
from hyperval.progress import track
from hyperval.results import Cause, Result
from hyperval.scenario import Scenario
from hyperval.scoreboard import agreement as a
from hyperval.scoreboard.engines import ENGINES, NotApplicable, Served
from hyperval.settings import with_settings

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
    campaign: str, collection: Collected, *, seed: int, show_progress: bool | None = None
) -> tuple[list[Result], list[Prediction]]:
    """Rows of every variant, and the predictions behind them for the provenance."""
    agreements: list[tuple[Variant, a.Agreement | None]] = []
    predictions: list[Prediction] = []
    for variant in track(variants_of(collection), f"{campaign}: variants", show=show_progress):
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
        whole = without_circles(merged(sides), [s.scenario for s in variant.served])
        agreements.append(
            (variant, a.agreement_of(_compared(whole, collection.observed.observation, campaign, variant.label)))
        )
    base = next(x for v, x in agreements if v.own)
    assert base is not None  # noqa: S101 - what the campaign itself says was predicted or has raised
    rows: list[Result] = []
    for variant, score in agreements:
        rows += _rows(campaign, variant, score, base, seed)
    return rows, predictions


def _predicted(one: Served, scenario: Scenario, collection: Collected) -> Prediction:
    origins = replace(collection.origins(scenario, False), engine=one.terms_of)
    return predict(one.scenario, origins)


def _compared(predicted: Prediction, observed: Observation, campaign: str, label: str) -> list[Result]:
    """Rows of spectra and curves that both sides hold: what the scores are made of."""
    rows: list[Result] = []
    for product in ("radiance", "reflectance"):
        left, right = getattr(predicted, product), getattr(observed, product)
        for subject in (s for s in right if s in left):
            rows += compare_spectra(
                left[subject], right[subject], campaign=campaign, product=product, subject=subject, method=label,
                axis=observed.axis,
            )  # fmt: skip
    for key in (k for k in observed.roc if k in predicted.roc and k[2] == "pixel"):
        rows += compare_roc(
            predicted.roc[key], observed.roc[key], campaign=campaign, subject=key[0], method=label, pfa=_PFA
        )
    return rows


def _rows(campaign: str, variant: Variant, score: a.Agreement | None, base: a.Agreement, seed: int) -> list[Result]:
    make = RowMaker(campaign, PRODUCT, EVERY_SUBJECT, variant.label)
    if score is None:
        return [make.skipped(Cause.REFUSED, variant.reason, "agreement")]
    words = "; ".join(dict.fromkeys(s.note for s in variant.served if s.note))
    rows: list[Result] = []
    for quantity, spectra in score.spectra.items():
        rows += _spectral_rows(make, quantity, spectra, seed, words)
        if not variant.own:
            rows += _change_rows(make, quantity, spectra, base.spectra.get(quantity, {}), seed)
    for level in a.LEVELS:
        share, span, n = a.inside_share(score.inside[level])
        if n:
            why = "curves by pixel of the campaign's own detectors; the interval takes them for independent"
            rows.append(make.row(f"pd_inside_interval@{level}", share, interval=span, n=n, reason=why))
        gap, span, n = a.mean_gap(score.differences[level], draws=DRAWS, rng=np.random.default_rng(seed))
        if n:
            why = "mean over curves by pixel; interval by drawing curves anew"
            rows.append(make.row(f"pd_mean_abs_difference@{level}", gap, interval=span, n=n, reason=why))
    return rows or [
        make.skipped(Cause.NO_PREDICTION, "the campaign compares no spectrum in a window and no curve", "agreement")
    ]


def _spectral_rows(
    make: RowMaker, quantity: str, spectra: Mapping[str, a.Spectral], seed: int, words: str
) -> list[Result]:
    """``radiance_median_abs_difference_ratio`` and the like: all subjects, each subject, and the chi-square."""
    metric = f"{quantity}_median_abs_difference_ratio"
    why = "windows; median over subjects of the median over bands; interval by drawing subjects and blocks of "
    why += f"{a.BLOCK_NM:g} nm anew" + (f"; {words}" if words else "")
    value, span = _median(spectra, seed)
    rows = [make.row(metric, value, interval=span, n=len(spectra), reason=why)]
    for name, one in spectra.items():
        value, span = _median({name: one}, seed)
        rows.append(replace(make, subject=name).row(metric, value, interval=span, n=one.ratio.size))
    chi2, span, n = a.median_chi2(spectra, draws=DRAWS, rng=np.random.default_rng(seed))
    if n:
        why = "full covariance; median over subjects, interval by drawing subjects anew; 1 where the budget holds"
        rows.append(make.row(f"{quantity}_chi2_reduced", chi2, interval=span, n=n, reason=why))
    return rows


def _median(spectra: Mapping[str, a.Spectral], seed: int) -> tuple[float, a.Span]:
    value = a.median_abs(spectra)
    drawn = a.median_abs_draws([spectra], draws=DRAWS, rng=np.random.default_rng(seed))[0]
    return value, a.interval(drawn, value)


def _change_rows(
    make: RowMaker, quantity: str, spectra: Mapping[str, a.Spectral], base: Mapping[str, a.Spectral], seed: int
) -> list[Result]:
    """The median less that of the campaign as it stands, on the subjects and bands that both have."""
    common = [n for n, s in base.items() if n in spectra and np.array_equal(s.band_nm, spectra[n].band_nm)]
    if not common:
        return []
    pair = [{n: side[n] for n in common} for side in (spectra, base)]
    drawn = a.median_abs_draws(pair, draws=DRAWS, rng=np.random.default_rng(seed))
    change = a.median_abs(pair[0]) - a.median_abs(pair[1])
    why = "less the same of the campaign as it stands, in the same draws; below 0 it predicts better"
    span = a.interval(drawn[0] - drawn[1], change)
    metric = f"{quantity}_median_abs_difference_ratio_change"
    return [make.row(metric, change, interval=span, n=len(common), reason=why)]
