"""Propagation of the budget by seeded Monte Carlo, beside the linearisation and compared with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.errors import UsageError
from hyperval.prediction.emulator import Emulator, emulator
from hyperval.prediction.input import Input, drawn_truths
from hyperval.prediction.propagation import (
    FALSE_ALARMS,
    SPECTRA,
    Agreement,
    Draws,
    Linear,
    agreement,
    draw_products,
    limits,
    linearise,
)
from hyperval.products import Prediction, RocCurve, SpectralEstimate
from hyperval.progress import track
from hyperval.scenario import Scenario
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Engine = Callable[[AtmosphericState], AtmosphericTerms]
Again = Callable[..., Iterator[Prediction]]  # of departed truths, under ``stand_in`` as the engine


@dataclass(frozen=True)
class Propagated:
    """Both ways of propagation.

    Attributes
    ----------
    linear, draws : the products each way
    agreements : for every product and subject; P_D at 1e-2 and 1e-3
    emulator : what stood for the engine; None without an atmosphere
    """

    linear: Linear
    draws: Draws
    agreements: tuple[Agreement, ...]
    emulator: Emulator | None


def propagate(
    scenario: Scenario,
    stated: Prediction,
    inputs: Sequence[Input],
    again: Again,
    *,
    samples: int,
    seed: int,
    engine: Engine | None = None,
    axis: SpectralAxis | None = None,
    show_progress: bool | None = None,
) -> Propagated:
    """Draw ``samples`` truths from the budget, linearise, and compare.

    Parameters
    ----------
    stated : the prediction without a departure
    again : predictions, without a budget, of departed truths under an engine
    engine, axis : of the atmosphere; bands on which its terms are interpolated, None for the engine's own sampling

    Raises
    ------
    UsageError : fewer than 40 draws, which have no 95 % interval.
    """
    if samples < 40:
        raise UsageError(f"{samples} draws have no 95 % interval", expected="40 or more")
    stand_in = emulator(scenario, inputs, engine, axis) if engine is not None and scenario.atmosphere else None

    predicted = partial(again, stand_in=stand_in)
    truths = track(drawn_truths(inputs, samples, seed), "draws of the budget", show=show_progress)
    draws, linear = draw_products(predicted(truths), seed), linearise(stated, inputs, predicted)
    rows = []
    for key, values in linear.stated.items():
        if key[0] != "P_D":
            rows.append(agreement(key, linear, draws))
            continue
        inside = [i for i, pd in enumerate(values) if np.isfinite(pd)]  # a curve may begin above
        rows += [agreement(key, linear, draws, i, FALSE_ALARMS[i]) for i in inside]
    return Propagated(linear, draws, tuple(rows), stand_in)


def with_intervals(stated: Prediction, propagation: Propagated, method: str) -> Prediction:
    """The prediction with intervals from the draws: of P_D where the two ways differ, or everywhere.

    With ``method`` "monte-carlo" all curves take the limits of the draws, and the errors of a spectrum are the
    linearised ones times the median over bands of drawn over linearised: the covariance of a few hundred draws, or
    their standard deviation band by band, is too noisy to be inverted in a test.
    With "both" a curve takes the limits of the draws where P_D at 1e-2 or 1e-3 disagrees.
    """
    differs = {a.key for a in propagation.agreements if a.key[0] == "P_D" and not a.agrees}
    roc = dict(stated.roc)
    for key, curve in stated.roc.items():
        name = ("P_D", *key)
        if method == "monte-carlo" or name in differs:
            roc[key] = _drawn_curve(curve, limits(propagation.draws.curves[key]))
    notes = [_words(propagation)]
    if method == "both" and differs:
        which = ", ".join(sorted({" ".join(k[1:]) for k in differs}))
        notes.append(
            f"P_D intervals from the draws, where linearisation differs by more than the tolerance: {which}"
        )
    spectra = {}
    for product in SPECTRA:
        estimates = getattr(stated, product)
        if method == "monte-carlo":
            estimates = {s: _drawn_estimate(e, propagation.draws.sd((product, s))) for s, e in estimates.items()}
        spectra[product] = estimates
    table = [{**asdict(a), "agrees": a.agrees} for a in propagation.agreements]
    record = {
        "method": method,
        "samples": propagation.draws.samples,
        "seed": propagation.draws.seed,
        "agreements": table,
    }
    return replace(
        stated,
        roc=roc,
        **spectra,
        notes=(*stated.notes, *notes),
        provenance={**stated.provenance, "propagation": record},
    )


def _drawn_curve(curve: RocCurve, interval: tuple[Array, Array]) -> RocCurve:
    low, high = interval
    return replace(curve, pd_lower=np.minimum(low, curve.pd), pd_upper=np.maximum(high, curve.pd))


def _drawn_estimate(estimate: SpectralEstimate, sd: Array) -> SpectralEstimate:
    linear = estimate.standard_uncertainty
    some = (linear > 0) & np.isfinite(sd)
    factor = float(np.median(sd[some] / linear[some])) if some.any() else 1.0
    budget = {k: v * factor for k, v in estimate.budget.items()}
    return replace(estimate, error_covariance=factor**2 * estimate.error_covariance, budget=budget)


def ratios(agreements: Sequence[Agreement]) -> Mapping[str, tuple[float, float, float]]:
    """Product -> (least, median, greatest) ratio of drawn to linearised standard uncertainty over its subjects."""
    out: dict[str, list[float]] = {}
    for a in agreements:
        label = a.key[0] if np.isnan(a.at) else f"{a.key[0]} at {a.at:.0e}"
        if np.isfinite(a.sd_ratio):
            out.setdefault(label, []).append(a.sd_ratio)
    return {k: (min(v), float(np.median(v)), max(v)) for k, v in out.items()}


def _words(propagation: Propagated) -> str:
    parts = [f"{k} {low:.2f}-{high:.2f}" for k, (low, _, high) in ratios(propagation.agreements).items()]
    text = f"{propagation.draws.samples} draws of the budget (seed {propagation.draws.seed}): "
    text += "standard uncertainty over the linearised one: " + ", ".join(parts)
    e = propagation.emulator
    if e is not None and e.axes:
        text += (
            f"; atmosphere interpolated between {e.runs} engine runs, radiance within {100 * e.error[0]:.2g} % "
            f"(median {100 * e.error[1]:.2g} %) with every input of it one standard uncertainty off"
        )
    return text
