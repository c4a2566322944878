"""Looking for the reasons: every input moved, every what-if run, all of them ranked.

How much of a quantity's variance each input brings, alone and together with the others.

Inputs are standard normal; the quantity is taken as a polynomial of degree two through a few evaluations, whose
squared Hermite coefficients are the shares of the variance.  Source: Sudret, Reliab. Eng. Syst. Saf. 93,
964-979, 2008; indices: Sobol 1993, Homma & Saltelli 1996.

What-ifs: named experiments, each a run with something changed, and what each does to the false alarms.

The reasons as rows of the results table.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from hyperval.compare.spectra import RowMaker, scientific
from hyperval.errors import UsageError
from hyperval.model import Truth, UncertainInput, together
from hyperval.pixels import LEAST_EXPECTED_ALARMS, false_alarm_ratio
from hyperval.products import Products, background_of
from hyperval.progress import track
from hyperval.results import Cause, Outcome, Result
from hyperval.scenario import Scenario
from hyperval.settings import with_settings
from hyperval.uncertainty.attribution.ranking import (
    Candidate,
    Ranking,
    Whitened,
    budget_covariance,
    closing_change,
    in_words,
    rankings,
)
from hyperval.uncertainty.attribution.residuals import ComparedQuantity, Stack, quantities, stacked
from hyperval.uncertainty.attribution.schema import AttributionOptions, WhatIf

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Indices:
    """Variance-based sensitivity of Q quantities to k inputs.

    Attributes
    ----------
    first : (Q, k) part of the variance that an input brings alone
    total : (Q, k) the same with all its interactions
    standard_deviation : (Q,) of each quantity under the inputs' distributions
    misfit : (Q,) root mean square error at points that were not used, over the standard deviation; NaN without such
    """

    first: Array
    total: Array
    standard_deviation: Array
    misfit: Array


def quadratic_design(inputs: int) -> Array:
    """Points that a polynomial of degree two needs: the middle, each input at -1 and 1, each pair at (1, 1).

    Returns (n, inputs) with n = (k + 1)(k + 2)/2.
    """
    unit = np.eye(inputs)
    pairs = [unit[i] + unit[j] for i, j in combinations(range(inputs), 2)]
    return np.concatenate([np.zeros((1, inputs)), unit, -unit, *([np.array(pairs)] if pairs else [])])


def sensitivity_indices(
    design: npt.ArrayLike,
    values: npt.ArrayLike,
    check: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
) -> Indices:
    """Indices of quantities (n, Q) evaluated at the points (n, k) of a design.

    Parameters
    ----------
    check : further points (m, k) and the values there (m, Q), to see what the polynomial misses

    Raises
    ------
    UsageError : fewer points than the polynomial has terms.

    A quantity without variance has NaN.
    """
    z, y = np.asarray(design, dtype=float), np.asarray(values, dtype=float)
    y = y[:, None] if y.ndim == 1 else y
    basis, members = _hermite(z)
    if len(basis) < basis.shape[1]:
        raise UsageError(f"{len(basis)} evaluations for {z.shape[1]} inputs", expected=f"{basis.shape[1]} and more")
    coefficients, *_ = np.linalg.lstsq(basis, y, rcond=None)
    squares = coefficients[1:] ** 2  # orthonormal: they sum to the variance
    variance = squares.sum(axis=0)
    moves = variance > 1e-24 * (1.0 + coefficients[0] ** 2)
    shares = np.where(moves, squares / np.where(moves, variance, 1.0), np.nan)
    alone = np.array([[m == (i,) for m in members] for i in range(z.shape[1])], dtype=float)
    joint = np.array([[i in m for m in members] for i in range(z.shape[1])], dtype=float)
    sd = np.sqrt(variance)
    misfit = np.full(y.shape[1], np.nan)
    if check is not None:
        there = np.asarray(check[1], dtype=float)
        off = (there[:, None] if there.ndim == 1 else there) - _hermite(np.asarray(check[0], float))[0] @ coefficients
        misfit = np.where(moves, np.sqrt(np.mean(off**2, axis=0)) / np.where(moves, sd, 1.0), np.nan)
    return Indices((alone @ shares).T, (joint @ shares).T, sd, misfit)


def _hermite(z: Array) -> tuple[Array, list[tuple[int, ...]]]:
    """Orthonormal Hermite polynomials to degree two (n, P), and which inputs each one but the first holds."""
    k = z.shape[1]
    columns: list[Array] = [np.ones(len(z))]
    members: list[tuple[int, ...]] = []
    for i in range(k):
        columns += [z[:, i], (z[:, i] ** 2 - 1.0) / np.sqrt(2.0)]
        members += [(i,), (i,)]
    for i, j in combinations(range(k), 2):
        columns.append(z[:, i] * z[:, j])
        members.append((i, j))
    return np.stack(columns, axis=1), members


@dataclass(frozen=True)
class WhatIfOutcome:
    """What one experiment did.

    Attributes
    ----------
    name, question : as the campaign has it
    before, after : chi-square of the residuals over their number, under the same covariance
    dof : number of residuals
    p_value : of the residuals after
    gaps : name of a gap -> (before, after)
    alarms : predicted over measured false alarms (before, after), filter by filter
    """

    name: str
    question: str
    before: float
    after: float
    dof: int
    p_value: float
    gaps: Mapping[str, tuple[float, float]]
    alarms: Sequence[tuple[AlarmRatio, AlarmRatio]] = field(default_factory=tuple)

    @property
    def gain(self) -> float:
        """Fall of the chi-square: twice the log-likelihood gained under the same covariance."""
        return (self.before - self.after) * self.dof


def run_what_ifs(
    model: ScenarioModel,
    stack: Stack,
    numbers: Sequence[ComparedQuantity],
    covariance: Array,
    observed: Products,
    what_ifs: Sequence[WhatIf],
    base: Products,
    show_progress: bool | None = None,
) -> list[WhatIfOutcome]:
    """Run every experiment of a campaign, the one that closes most of the gap first.

    ``base`` : products of the scenarios as they stand.

    Raises
    ------
    UsageError : an experiment that fits no scenario, or wants a collection measured again that cannot be.
    """
    out = []
    for item in track(what_ifs, "reasons: what-ifs", show=show_progress):
        scenarios = changed_scenarios(model.scenarios, item)
        seen = observed
        if item.observe:
            if model.observe is None:
                raise UsageError(f"what-if {item.name!r}: this collection cannot be measured again")
            seen = model.observe(item.observe)
        predicted = model.assuming(scenarios)
        after, cov_after, numbers_after = stack, covariance, list(numbers)
        if item.observe:
            again = stacked(predicted, seen)
            if [b.observed.shape for b in again.blocks] != [b.observed.shape for b in stack.blocks]:
                raise UsageError(
                    f"what-if {item.name!r} compares other things than the campaign does",
                    mend="change what is measured, not which subjects there are",
                )
            after, cov_after = again, covariance - stack.covariance + again.covariance
            numbers_after = _renewed(numbers, seen)
        first = Whitened(stack.observed - stack.predicted(base), covariance)
        second = Whitened(after.observed - after.predicted(predicted), cov_after)
        gaps = {
            name: (value, gaps_of(numbers_after, predicted)[name]) for name, value in gaps_of(numbers, base).items()
        }
        ratios, there = alarm_ratios(base, observed), alarm_ratios(predicted, seen)
        out.append(
            WhatIfOutcome(
                item.name,
                item.question,
                first.chi_square / first.dof,
                second.chi_square / second.dof,
                first.dof,
                float(scipy.stats.chi2.sf(second.chi_square, second.dof)),
                gaps,
                tuple((ratio, there[key]) for key, ratio in ratios.items() if key in there),
            )
        )
    return sorted(out, key=lambda o: o.after)


def changed_scenarios(scenarios: Sequence[Scenario], item: WhatIf) -> list[Scenario]:
    """The scenarios with an experiment's settings; one whose names do not fit stays as it is.

    Raises
    ------
    UsageError : the settings fit none of them.
    """
    out, errors = [], []
    for scenario in scenarios:
        try:
            out.append(with_settings(scenario, item.scenario) if item.scenario else scenario)
        except UsageError as error:
            errors.append(error)
            out.append(scenario)
    if errors and len(errors) == len(scenarios):
        raise UsageError(f"what-if {item.name!r} fits no scenario: {errors[0].what}")
    return out


def gaps_of(numbers: Sequence[ComparedQuantity], predicted: Products) -> dict[str, float]:
    """Summary gaps: median relative difference of spectra, mean difference of P_D."""
    parts: dict[str, list[float]] = {}
    for q in numbers:
        value = q.read(predicted)
        if not (np.isfinite(value) and np.isfinite(q.observed)):
            continue
        if q.product == "roc":
            parts.setdefault(f"mean |{q.metric} difference|", []).append(abs(value - q.observed))
        elif q.observed:
            parts.setdefault(f"median |{q.product} difference ratio|", []).append(abs(value / q.observed - 1.0))
    return {
        name: float(np.median(values) if name.startswith("median") else np.mean(values))
        for name, values in parts.items()
    }


def _renewed(numbers: Sequence[ComparedQuantity], observed: Products) -> list[ComparedQuantity]:
    out = []
    for q in numbers:
        with suppress(KeyError):  # what is measured no more
            out.append(replace(q, observed=q.read(observed)))
    return out


Observe = Callable[[Mapping[str, Any]], Products]
Truths = Sequence[Truth]  # what is moved in each scenario


@dataclass(frozen=True, eq=False)
class ScenarioModel:
    """Scenarios with what predicts them.

    Attributes
    ----------
    scenarios : as they stand in the campaign
    predict : (scenarios, truths) -> for each truth their products, merged as the campaign compares them
    observe : measures the collection again with changed settings; None where that cannot be done
    """

    scenarios: Sequence[Scenario]
    predict: Callable[[Sequence[Scenario], Sequence[Truths]], Iterator[Products]]
    observe: Observe | None = None

    def products_of(self, truths: Sequence[Truths]) -> Iterator[Products]:
        """Products of the scenarios as they stand when the truth is another one."""
        return self.predict(self.scenarios, truths)

    def assuming(self, scenarios: Sequence[Scenario]) -> Products:
        """Products of other scenarios."""
        return next(self.predict(scenarios, [[{} for _ in scenarios]]))


LEVELS = (1e-2, 1e-3)
FACTOR = 2.0  # a ratio within it is good


@dataclass(frozen=True)
class AlarmRatio:
    """P_FA predicted over measured at the threshold that was measured to give ``level``.

    Attributes
    ----------
    subject, detector, metric : as the rows of the comparison have them
    value : the ratio [1]
    lower, upper : its interval [1]
    """

    subject: str
    detector: str
    metric: str
    value: float
    lower: float
    upper: float

    @property
    def off(self) -> float:
        """|ln ratio|: by how much it is wrong, either way."""
        return abs(math.log(self.value)) if self.value > 0.0 else math.inf

    @property
    def good(self) -> bool:
        """Within a factor of two."""
        return self.off <= math.log(FACTOR)


def alarm_ratios(predicted: Products, observed: Products) -> dict[tuple[str, str, str], AlarmRatio]:
    """By (background, detector, metric), at P_FA 1e-2 and 1e-3 where ten alarms are expected."""
    ratios = {}
    for (name, detector), measured in observed.exceedance.items():
        model = predicted.exceedance.get((name, detector))
        for level in LEVELS if model is not None and (measured.n or 0) > 0 else ():
            if level * (measured.n or 0) >= LEAST_EXPECTED_ALARMS and model is not None:
                key = (background_of(name), detector, f"pfa_ratio@{scientific(level)}")
                ratio = false_alarm_ratio(model, measured, level)
                ratios[key] = AlarmRatio(*key, ratio.value, ratio.lower, ratio.upper)
    return ratios


def reason_for(before: AlarmRatio, tried: Iterable[tuple[str, AlarmRatio]]) -> str:
    """In words, which experiment explains a ratio that is off by more than a factor of two, or that none does.

    Examples
    --------
    >>> r = [AlarmRatio("b", "cem", "m", v, v / 2, v * 2) for v in (6.0, 1.5, 4.0)]
    >>> reason_for(r[0], [("local", r[1]), ("tails", r[2])])
    "off by a factor of 6; 'local' leaves 1.5: it would explain it"
    >>> reason_for(r[1], [("tails", r[2])])
    'within a factor of two'
    """
    if before.good:
        return "within a factor of two"
    size = f"off by a factor of {math.exp(before.off):.2g}"
    if before.lower <= FACTOR and before.upper >= 1.0 / FACTOR:
        size += ", within what its interval allows"
    best = min(tried, key=lambda item: item[1].off, default=None)
    if best is None or best[1].off >= before.off:
        return f"{size}; no what-if brings it nearer"
    end = "it would explain it" if best[1].good else "the nearest, and not enough"
    return f"{size}; {best[0]!r} leaves {best[1].value:.2g}: {end}"


ATMOSPHERE = "atmosphere"  # kind of the inputs that need a run of the engine for each value
_CHECKS = 4
MOST_TOGETHER = 6
# Directions of an input that move all that is compared at once: of a smooth error nearly all of its variance, of a
# rough one little.  The rest counts for each spectrum by itself (``stated_beyond``), and not for scores.
MOST_DIRECTIONS = 8
# Error of each band by itself, common to all subjects: what smooth inputs cannot explain.
SINGLE_BANDS = 0.01


@dataclass(frozen=True, eq=False)
class Attribution:
    """Why the two sides differ.

    Attributes
    ----------
    candidates : inputs, in the order of the columns below
    rankings : of all residuals together, then of single subjects
    quantities : single numbers of both sides
    predicted : (Q,) their values by the model
    changes : (Q, k) change of each per unit of each input
    indices : first and total sensitivities to the inputs whose uncertainty is stated, None where not asked for
    stated : which candidates ``indices`` counts
    what_ifs : outcomes of the named experiments
    """

    candidates: tuple[Candidate, ...]
    rankings: tuple[Ranking, ...]
    quantities: tuple[ComparedQuantity, ...]
    predicted: Array
    changes: Array
    indices: Indices | None
    stated: tuple[Candidate, ...]
    what_ifs: tuple[WhatIfOutcome, ...]


@dataclass(frozen=True, eq=False)
class _Reason:
    """A candidate with the input that it is in each scenario, None where it is none there."""

    candidate: Candidate
    members: tuple[UncertainInput | None, ...]

    @property
    def size(self) -> int:
        return min(max(m.size for m in self.members if m is not None), MOST_DIRECTIONS)

    def at(self, direction: int, units: float) -> list[Truth]:
        return [{} if m is None or direction >= m.size else m.direction(direction, units) for m in self.members]


def attribute(
    model: ScenarioModel,
    observed: Products,
    stated: Sequence[Sequence[UncertainInput]],
    assumed: Sequence[Sequence[UncertainInput]],
    options: AttributionOptions,
    *,
    budgeted: Products | None = None,
    show_progress: bool | None = None,
) -> Attribution:
    """Move every input, run every what-if, rank them all.

    Parameters
    ----------
    stated, assumed : inputs of each scenario, those with a stated uncertainty and the others; one that is stated
        in any scenario is left out of the others
    budgeted : the prediction with its error covariances; what they hold beyond the inputs' directions is added to
        each spectrum

    Raises
    ------
    UsageError : nothing that both sides hold, or a what-if that fits no scenario.
    """
    base = model.assuming(model.scenarios)
    stack = stacked(base, observed)
    if not stack.blocks:
        raise UsageError("attribution: prediction and collection hold nothing in common")
    numbers = quantities(base, observed)
    reasons = _reasons(stated, assumed if options.unbudgeted else [() for _ in stated])
    evaluate = _Evaluation(model, stack, numbers)
    columns: dict[Candidate, Array] = {}
    changes = np.zeros((len(numbers), len(reasons)))
    single: dict[tuple[Candidate, int], Array] = {}
    steps = [(i, d) for i, reason in enumerate(reasons) for d in range(reason.size)]
    ends = evaluate([reasons[i].at(d, z) for i, d in steps for z in (1.0, -1.0)], "reasons: inputs", show_progress)
    for i, reason in enumerate(reasons):
        pairs = [(ends[2 * k], ends[2 * k + 1]) for k, (owner, _) in enumerate(steps) if owner == i]
        columns[reason.candidate] = np.stack([0.5 * (up - down) for (up, _), (down, _) in pairs], axis=1)
        (_, up_q), (_, down_q) = pairs[0]
        changes[:, i] = 0.5 * (up_q - down_q)
        single[reason.candidate, 1], single[reason.candidate, -1] = up_q, down_q
    if options.unbudgeted and (bands := SINGLE_BANDS * stack.single_bands()).size:
        columns[Candidate("single bands", "sensor", f"{100 * SINGLE_BANDS:g} % in each band", False)] = bands
    predicted, values = stack.predicted(base), np.array([q.read(base) for q in numbers])
    budget = budget_covariance(columns, predicted.size)
    covariance = stack.covariance + budget
    if budgeted is not None:
        covariance += stack.stated_beyond(budgeted, budget)
    residual = stack.observed - predicted
    indices, counted = None, [r for r in reasons if r.candidate.budgeted]
    if options.totals and counted and numbers:
        indices = _indices(counted, evaluate, values, single, show_progress)
    outcomes = run_what_ifs(model, stack, numbers, covariance, observed, options.what_ifs, base, show_progress)
    return Attribution(
        tuple(r.candidate for r in reasons),
        tuple(rankings(stack, residual, covariance, columns, options.each)),
        tuple(numbers),
        values,
        changes,
        indices,
        tuple(r.candidate for r in counted),
        tuple(outcomes),
    )


class _Evaluation:
    """All residual quantities and all single numbers of predictions of other truths."""

    def __init__(self, model: ScenarioModel, stack: Stack, numbers: Sequence[ComparedQuantity]):
        self._model, self._stack, self._numbers = model, stack, numbers

    def __call__(self, truths: Sequence[Truths], title: str, show: bool | None) -> list[tuple[Array, Array]]:
        predictions = track(self._model.products_of(truths), title, len(truths), show=show)
        return [(self._stack.predicted(p), np.array([q.read(p) for q in self._numbers])) for p in predictions]


def _reasons(stated: Sequence[Sequence[UncertainInput]], assumed: Sequence[Sequence[UncertainInput]]) -> list[_Reason]:
    """Inputs of all scenarios by name: what bears one name moves in all of them at once."""
    out: list[_Reason] = []
    known: set[str] = set()
    for budgeted, groups in ((True, stated), (False, assumed)):
        for name in dict.fromkeys(i.name for group in groups for i in group):
            if name in known:
                continue
            known.add(name)
            members = tuple(next((i for i in group if i.name == name), None) for group in groups)
            first = next(m for m in members if m is not None)
            out.append(_Reason(Candidate(name, first.kind, first.correlation, budgeted), members))
    return out


def _indices(
    reasons: Sequence[_Reason],
    evaluate: _Evaluation,
    base: Array,
    single: Mapping[tuple[Candidate, int], Array],
    show_progress: bool | None,
) -> Indices:
    """First and total sensitivities, each input along its leading direction.

    Only the inputs that move most are changed together; inputs of the atmosphere never are, as each pair would take
    a run of the engine.  The other interactions count as none.
    """
    moves = np.array([np.abs(single[r.candidate, 1] - single[r.candidate, -1]) for r in reasons])
    share = np.max(moves / np.maximum(moves.max(axis=0), 1e-300), axis=1)
    leading = set(np.argsort(-share, kind="stable")[:MOST_TOGETHER])
    design = quadratic_design(len(reasons))
    values = [base, *(single[r.candidate, 1] for r in reasons), *(single[r.candidate, -1] for r in reasons)]
    joint: dict[int, list[Truth]] = {}
    for i, j in combinations(range(len(reasons)), 2):
        a, b = reasons[i], reasons[j]
        if {i, j} <= leading and not a.candidate.kind == b.candidate.kind == ATMOSPHERE:
            joint[len(values)] = _at_once([a, b], [1.0, 1.0])
        values.append(single[a.candidate, 1] + single[b.candidate, 1] - base)
    rng = np.random.default_rng(0)
    points, checks = [], []
    for _ in range(_CHECKS):
        z = rng.choice([-1.0, 1.0], size=len(reasons))
        engine = [i for i, r in enumerate(reasons) if r.candidate.kind == ATMOSPHERE]
        z[engine[1:]] = 0.0
        points.append(z)
        checks.append(_at_once(reasons, z))
    values_of = [q for _, q in evaluate([*joint.values(), *checks], "reasons: pairs of inputs", show_progress)]
    for place, value in zip(joint, values_of, strict=False):
        values[place] = value
    there = values_of[len(joint) :]
    return sensitivity_indices(design, np.array(values), (np.array(points), np.array(there)) if points else None)


def _at_once(reasons: Sequence[_Reason], units: Sequence[float] | Array) -> list[Truth]:
    """Several inputs at once, each along its leading direction."""
    out: list[Truth] = []
    for members in zip(*(r.members for r in reasons), strict=True):
        moves = [(m, m.moved(z)) for m, z in zip(members, units, strict=True) if m is not None and z]
        out.append(together(moves))
    return out


_EVERYTHING = "every input"


def attribution_rows(attribution: Attribution) -> list[Result]:
    """Rows of the products ``attribution``, ``sensitivity`` and ``what-if``.

    attribution: for each group of residuals ``reduced_chi_square`` and ``p_value`` under the stated uncertainties,
    then for each input ``likelihood_gain`` (twice the log-likelihood gained when it may be less well known) and
    ``needed_uncertainty`` (in units of its stated one, or of a usual step).  sensitivity: for each number of the
    comparison the change per unit of each input, with the units that would close the gap, and its total share.
    what-if: ``reduced_chi_square`` after the experiment, each summary gap after it, and ``pfa_ratio`` of every
    background.  attribution of a background: its ``pfa_ratio``, and which experiment explains it if any.
    """
    rows = [row for r in attribution.rankings for row in _ranking_rows(r)]
    rows += _sensitivity_rows(attribution)
    rows += [row for o in attribution.what_ifs for row in _outcome_rows(o)]
    return rows + _alarm_rows(attribution.what_ifs)


def _alarm_rows(outcomes: Sequence[WhatIfOutcome]) -> list[Result]:
    """Every ratio of false alarms with its reason, then the ratio after each experiment."""
    before: dict[tuple[str, str, str], AlarmRatio] = {}
    tried: dict[tuple[str, str, str], list[tuple[str, AlarmRatio]]] = {}
    for o in outcomes:
        for first, after in o.alarms:
            key = (first.subject, first.detector, first.metric)
            before[key] = first
            tried.setdefault(key, []).append((o.name, after))

    def row(product: str, method: str, r: AlarmRatio, reason: str) -> Result:
        return RowMaker(product, r.subject, method).row(r.metric, r.value, interval=(r.lower, r.upper), reason=reason)

    rows = [row("attribution", r.detector, r, reason_for(r, tried[key])) for key, r in before.items()]
    for key, first in before.items():
        for name, after in tried[key]:
            words = f"{first.value:.3g} before ({first.lower:.2g} to {first.upper:.2g})"
            rows.append(row("what-if", f"{name} / {first.detector}", after, words))
    return rows


def _ranking_rows(r: Ranking) -> list[Result]:
    def row(method: str, metric: str, value: float, reason: str = "", n: int | None = None) -> Result:
        return RowMaker("attribution", r.group, method).row(metric, value, n=n, reason=reason)

    # The test of all products together concludes too, and informs.
    whole = row(_EVERYTHING, "reduced_chi_square", r.chi_square / r.dof, r.conclusion, r.dof)
    if r.too_wide or not r.explained:
        whole = replace(whole, outcome=Outcome.DISAGREES, cause=Cause.TOO_WIDE if r.too_wide else Cause.NONE)
    rows = [whole, row(_EVERYTHING, "p_value", r.p_value, n=r.dof)]
    if r.together:
        rows.append(
            row(_EVERYTHING, "p_value_explained", r.together[-1].p_value,
                "with " + " and ".join(x.candidate.name for x in r.together) + " freed", r.dof)
        )  # fmt: skip
    for place, item in enumerate(r.ranked, start=1):
        reason = f"rank {place}: {in_words(item)}; leaves reduced chi-square {item.chi_square / r.dof:.3g}"
        rows.append(row(item.candidate.name, "likelihood_gain", item.gain, reason, r.dof))
        unit = "stated uncertainty" if item.candidate.budgeted else f"step of {item.candidate.step}, none is stated"
        rows.append(row(item.candidate.name, "needed_uncertainty", item.needed, f"in units of its {unit}"))
    return rows


def _sensitivity_rows(attribution: Attribution) -> list[Result]:
    rows = []
    place = {c: i for i, c in enumerate(attribution.stated)}
    for q, quantity in enumerate(attribution.quantities):
        gap = quantity.observed - attribution.predicted[q]
        for c, candidate in enumerate(attribution.candidates):
            change = float(attribution.changes[q, c])
            closes = closing_change(gap, change)
            reason = f"gap {gap:.4g}" + (
                f" closed by {closes:+.3g} units" if math.isfinite(closes) else ", not closed by this input"
            )
            if attribution.indices is not None and candidate in place:
                total = float(attribution.indices.total[q, place[candidate]])
                first = float(attribution.indices.first[q, place[candidate]])
                if math.isfinite(total):  # no stated input moves some quantities
                    reason += f"; share of the variance {first:.3g} alone, {total:.3g} in all"
            unit = "stated uncertainty" if candidate.budgeted else candidate.step
            method = f"{candidate.name} / {quantity.method}" if quantity.method else candidate.name
            metric = f"{quantity.product}_{quantity.metric}_change"
            make = RowMaker("sensitivity", quantity.subject, method)
            rows.append(make.row(metric, change, reason=f"per {unit}; {reason}"))
    return rows


def _outcome_rows(o: WhatIfOutcome) -> list[Result]:
    make = RowMaker("what-if", "all", o.name)
    rows = [
        make.row("reduced_chi_square", o.after, n=o.dof, reason=f"{o.before:.4g} before; {o.question}"),
        make.row("likelihood_gain", o.gain, n=o.dof, reason=f"p = {o.p_value:.2g} after"),
    ]
    for name, (before, after) in o.gaps.items():
        words = name.replace("|", "").replace("@", " at ").split()
        rows.append(make.row("_".join(words), after, n=o.dof, reason=f"{before:.4g} before"))
    return rows
