"""Looking for the reasons: every input moved, every what-if run, all of them ranked; the reasons as rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from hyperval.attribute.ranking import Candidate, Ranking, budget_covariance, rankings
from hyperval.attribute.residuals import ComparedQuantity, quantities, stacked
from hyperval.attribute.schema import AttributionOptions
from hyperval.attribute.whatif import ScenarioModel, Truths, run_what_ifs
from hyperval.compare.rows import Array, named, row
from hyperval.errors import UsageError
from hyperval.model import Truth, UncertainInput, together
from hyperval.products import Products
from hyperval.progress import track
from hyperval.results import Cause, Outcome, Result

ATMOSPHERE = "atmosphere"  # kind of the inputs that need a run of the engine for each value
MOST_TOGETHER = 6
# Directions of an input that move all that is compared at once: of a smooth error nearly all of its variance, of a
# rough one little.  The rest counts for each spectrum by itself (``stated_beyond``), and not for scores.
MOST_DIRECTIONS = 8
# Error of each band by itself, common to all subjects: what smooth inputs cannot explain.
SINGLE_BANDS = 0.01
_EVERYTHING = "every input"

Evaluate = Callable[[Sequence[Truths], str], list[tuple[Array, Array]]]
Ends = Mapping[Candidate, tuple[Array, Array]]  # numbers with an input one unit up and down


def sensitivity_indices(
    base: Array, ends: Sequence[tuple[Array, Array]], pairs: Mapping[tuple[int, int], Array]
) -> tuple[Array, Array]:
    """(k, Q) parts of each quantity's variance that each of k inputs brings alone, and with all its interactions.

    NaN for a quantity without variance.
    Inputs are standard normal, and the quantity is the polynomial of degree two through the values: of
    f0 + a z + b (z^2 - 1)/sqrt(2) + c z z' with orthonormal terms the variance is the sum of the squares of
    a = (f+ - f-)/2, b = (f+ + f- - 2 f0)/sqrt(2) and c = f++ - f+ - f'+ + f0.  Source: Sudret, Reliab. Eng. Syst.
    Saf. 93, 964-979, 2008; indices: Sobol 1993, Homma & Saltelli 1996.

    Parameters
    ----------
    base : (Q,) f0, the quantities with every input at its middle
    ends : for each input (Q,) f+ and f-, with it one standard deviation up and down
    pairs : (Q,) f++, with two inputs up at once; of a pair that is not there the interaction counts as none

    Examples
    --------
    >>> f = lambda z, w: np.array([3.0 * z + w**2 + 2.0 * z * w])
    >>> ends = [(f(1.0, 0.0), f(-1.0, 0.0)), (f(0.0, 1.0), f(0.0, -1.0))]
    >>> alone, every = sensitivity_indices(f(0.0, 0.0), ends, {(0, 1): f(1.0, 1.0)})
    >>> (15.0 * alone[:, 0]).round(9).tolist(), (15.0 * every[:, 0]).round(9).tolist()
    ([9.0, 2.0], [13.0, 6.0])
    """
    alone = np.array([0.25 * (up - down) ** 2 + 0.5 * (up + down - 2.0 * base) ** 2 for up, down in ends])
    total, variance = alone.copy(), alone.sum(axis=0)
    for (i, j), value in pairs.items():
        joint = (value - ends[i][0] - ends[j][0] + base) ** 2
        total[i], total[j], variance = total[i] + joint, total[j] + joint, variance + joint
    whole = np.where(variance > 1e-24 * (1.0 + base**2), variance, np.nan)
    return alone / whole, total / whole


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
) -> list[Result]:
    """Move every input, run every what-if, rank them all.

    Rows of the product attribution: for each group of residuals ``reduced_chi_square`` and ``p_value`` under the
    stated uncertainties, then for each input ``likelihood_gain`` (twice the log-likelihood gained when it may be less
    well known) and ``needed_uncertainty`` (in units of its stated one, or of a usual step); of a background its
    ``pfa_ratio``, and which experiment explains it if any.  sensitivity: for each number of the comparison the change
    per unit of each input, with the units that would close the gap, and its total share.  what-if:
    ``reduced_chi_square`` after the experiment, each summary gap after it, and ``pfa_ratio`` of every background.

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

    def evaluate(truths: Sequence[Truths], title: str) -> list[tuple[Array, Array]]:
        predictions = track(model.predict(model.scenarios, truths), title, len(truths), show=show_progress)
        return [(stack.predicted(p), np.array([q.read(p) for q in numbers])) for p in predictions]

    steps = [reason.at(d, z) for reason in reasons for d in range(reason.size) for z in (1.0, -1.0)]
    found = iter(evaluate(steps, "reasons: inputs"))
    columns: dict[Candidate, Array] = {}
    ends: dict[Candidate, tuple[Array, Array]] = {}
    for reason in reasons:
        pairs = [(next(found), next(found)) for _ in range(reason.size)]
        columns[reason.candidate] = np.stack([0.5 * (up - down) for (up, _), (down, _) in pairs], axis=1)
        ends[reason.candidate] = pairs[0][0][1], pairs[0][1][1]
    if options.unbudgeted and (bands := SINGLE_BANDS * stack.single_bands()).size:
        columns[Candidate("single bands", "sensor", f"{100 * SINGLE_BANDS:g} % in each band", False)] = bands
    predicted, values = stack.predicted(base), np.array([q.read(base) for q in numbers])
    budget = budget_covariance(columns, predicted.size)
    covariance = stack.covariance + budget
    if budgeted is not None:
        covariance += stack.stated_beyond(budgeted, budget)
    counted, shares = [r for r in reasons if r.candidate.budgeted], None
    if options.totals and counted and numbers:
        shares = _indices(counted, evaluate, values, ends)
    outcomes = run_what_ifs(model, stack, numbers, covariance, observed, options.what_ifs, base, show_progress)
    ranked = rankings(stack, stack.observed - predicted, covariance, columns, options.each)
    known = {r.candidate: side for r, *side in zip(counted, *shares, strict=True)} if shares else {}
    return [
        *(row for ranking in ranked for row in _ranking_rows(ranking)),
        *(row for q, number in enumerate(numbers) for row in _sensitivity_rows(number, q, values[q], ends, known)),
        *outcomes,
    ]


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


def _indices(reasons: Sequence[_Reason], evaluate: Evaluate, base: Array, ends: Ends) -> tuple[Array, Array]:
    """First and total sensitivities, each input along its leading direction.

    Only the inputs that move most are changed together; inputs of the atmosphere never are, as each pair would take
    a run of the engine.  The other interactions count as none.
    """
    sides = [ends[r.candidate] for r in reasons]
    moves = np.array([np.abs(up - down) for up, down in sides])
    share = np.max(moves / np.maximum(moves.max(axis=0), 1e-300), axis=1)
    leading = sorted(np.argsort(-share, kind="stable")[:MOST_TOGETHER].tolist())
    pairs = [
        (i, j)
        for i, j in combinations(leading, 2)
        if not reasons[i].candidate.kind == reasons[j].candidate.kind == ATMOSPHERE
    ]
    truths = [
        [together([(m, m.moved(1.0)) for m in both if m is not None])
         for both in zip(reasons[i].members, reasons[j].members, strict=True)]
        for i, j in pairs
    ]  # fmt: skip
    found = evaluate(truths, "reasons: pairs of inputs")
    return sensitivity_indices(base, sides, {pair: value for pair, (_, value) in zip(pairs, found, strict=True)})


def _ranking_rows(r: Ranking) -> Iterator[Result]:
    # The test of all products together concludes too, and informs.
    whole = row("reduced_chi_square", r.chi_square / r.dof, reason=r.conclusion, n=r.dof)
    if r.too_wide or not r.explained:
        whole = replace(whole, outcome=Outcome.DISAGREES, cause=Cause.TOO_WIDE if r.too_wide else Cause.NONE)
    tests = [whole, row("p_value", r.p_value, n=r.dof)]
    if r.together:
        why = "with " + " and ".join(x.candidate.name for x in r.together) + " freed"
        tests.append(row("p_value_explained", r.together[-1].p_value, reason=why, n=r.dof))
    yield from named(tests, "attribution", r.group, _EVERYTHING)
    for place, item in enumerate(r.ranked, start=1):
        why = f"rank {place}: {item.in_words}; leaves reduced chi-square {item.chi_square / r.dof:.3g}"
        unit = "stated uncertainty" if item.candidate.budgeted else f"step of {item.candidate.step}, none is stated"
        own = [
            row("likelihood_gain", item.gain, reason=why, n=r.dof),
            row("needed_uncertainty", item.needed, reason=f"in units of its {unit}"),
        ]
        yield from named(own, "attribution", r.group, item.candidate.name)


def _sensitivity_rows(
    quantity: ComparedQuantity,
    place: int,
    predicted: float,
    ends: Ends,
    shares: Mapping[Candidate, Sequence[Array]],
) -> Iterator[Result]:
    gap = quantity.observed - predicted
    for candidate, (up, down) in ends.items():
        change = 0.5 * float(up[place] - down[place])
        closes = round(gap / change, 12) if change else math.inf
        reason = f"gap {gap:.4g}"
        reason += f" closed by {closes:+.3g} units" if math.isfinite(closes) else ", not closed by this input"
        first, total = (float(x[place]) for x in shares.get(candidate, np.full((2, place + 1), math.nan)))
        if math.isfinite(total):  # no stated input moves some quantities
            reason += f"; share of the variance {first:.3g} alone, {total:.3g} in all"
        unit = "stated uncertainty" if candidate.budgeted else candidate.step
        method = f"{candidate.name} / {quantity.method}" if quantity.method else candidate.name
        found = row(f"{quantity.product}_{quantity.metric}_change", change, reason=f"per {unit}; {reason}")
        yield replace(found, product="sensitivity", subject=quantity.subject, method=method)
