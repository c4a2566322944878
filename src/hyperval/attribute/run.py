"""Looking for the reasons: every input moved, every what-if run, all of them ranked; the reasons as rows.

How much of a quantity's variance each input brings, alone and together with the others: inputs are standard normal;
the quantity is taken as a polynomial of degree two through a few evaluations, whose squared Hermite coefficients are
the shares of the variance.  Source: Sudret, Reliab. Eng. Syst. Saf. 93, 964-979, 2008; indices: Sobol 1993, Homma &
Saltelli 1996.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperval.attribute.ranking import Candidate, Ranking, budget_covariance, closing_change, rankings
from hyperval.attribute.residuals import ComparedQuantity, quantities, stacked
from hyperval.attribute.schema import AttributionOptions
from hyperval.attribute.whatif import ScenarioModel, Truths, run_what_ifs
from hyperval.compare.rows import Array, RowMaker
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


class Indices(NamedTuple):
    """Variance-based sensitivity of Q quantities to k inputs.

    Attributes
    ----------
    first : (Q, k) part of the variance that an input brings alone
    total : (Q, k) the same with all its interactions
    """

    first: Array
    total: Array


def quadratic_design(inputs: int) -> Array:
    """Points that a polynomial of degree two needs: the middle, each input at -1 and 1, each pair at (1, 1).

    Returns (n, inputs) with n = (k + 1)(k + 2)/2.
    """
    unit = np.eye(inputs)
    pairs = [unit[i] + unit[j] for i, j in combinations(range(inputs), 2)]
    return np.concatenate([np.zeros((1, inputs)), unit, -unit, *([np.array(pairs)] if pairs else [])])


def sensitivity_indices(design: npt.ArrayLike, values: npt.ArrayLike) -> Indices:
    """Indices of quantities (n, Q) evaluated at the points (n, k) of a design.

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
    return Indices((alone @ shares).T, (joint @ shares).T)


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
        predictions = track(model.products_of(truths), title, len(truths), show=show_progress)
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
    known = {r.candidate: (shares.first[:, k], shares.total[:, k]) for k, r in enumerate(counted)} if shares else {}
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


def _indices(reasons: Sequence[_Reason], evaluate: Evaluate, base: Array, ends: Ends) -> Indices:
    """First and total sensitivities, each input along its leading direction.

    Only the inputs that move most are changed together; inputs of the atmosphere never are, as each pair would take
    a run of the engine.  The other interactions count as none.
    """
    sides = [ends[r.candidate] for r in reasons]
    moves = np.array([np.abs(up - down) for up, down in sides])
    share = np.max(moves / np.maximum(moves.max(axis=0), 1e-300), axis=1)
    leading = set(np.argsort(-share, kind="stable")[:MOST_TOGETHER])
    values = [base, *(up for up, _ in sides), *(down for _, down in sides)]
    joint: dict[int, list[Truth]] = {}
    for i, j in combinations(range(len(reasons)), 2):
        a, b = reasons[i], reasons[j]
        if {i, j} <= leading and not a.candidate.kind == b.candidate.kind == ATMOSPHERE:
            members = zip(a.members, b.members, strict=True)
            joint[len(values)] = [together([(m, m.moved(1.0)) for m in pair if m is not None]) for pair in members]
        values.append(sides[i][0] + sides[j][0] - base)
    for place, (_, value) in zip(joint, evaluate(list(joint.values()), "reasons: pairs of inputs"), strict=True):
        values[place] = value
    return sensitivity_indices(quadratic_design(len(reasons)), np.array(values))


def _ranking_rows(r: Ranking) -> Iterator[Result]:
    make = RowMaker("attribution", r.group, _EVERYTHING)
    # The test of all products together concludes too, and informs.
    whole = make.row("reduced_chi_square", r.chi_square / r.dof, reason=r.conclusion, n=r.dof)
    if r.too_wide or not r.explained:
        whole = replace(whole, outcome=Outcome.DISAGREES, cause=Cause.TOO_WIDE if r.too_wide else Cause.NONE)
    yield whole
    yield make.row("p_value", r.p_value, n=r.dof)
    if r.together:
        why = "with " + " and ".join(x.candidate.name for x in r.together) + " freed"
        yield make.row("p_value_explained", r.together[-1].p_value, reason=why, n=r.dof)
    for place, item in enumerate(r.ranked, start=1):
        make, step = RowMaker("attribution", r.group, item.candidate.name), item.candidate.step
        why = f"rank {place}: {item.in_words}; leaves reduced chi-square {item.chi_square / r.dof:.3g}"
        yield make.row("likelihood_gain", item.gain, reason=why, n=r.dof)
        unit = "stated uncertainty" if item.candidate.budgeted else f"step of {step}, none is stated"
        yield make.row("needed_uncertainty", item.needed, reason=f"in units of its {unit}")


def _sensitivity_rows(
    quantity: ComparedQuantity,
    place: int,
    predicted: float,
    ends: Ends,
    shares: Mapping[Candidate, tuple[Array, Array]],
) -> Iterator[Result]:
    gap = quantity.observed - predicted
    for candidate, (up, down) in ends.items():
        change = 0.5 * float(up[place] - down[place])
        closes = closing_change(gap, change)
        reason = f"gap {gap:.4g}"
        reason += f" closed by {closes:+.3g} units" if math.isfinite(closes) else ", not closed by this input"
        first, total = (float(x[place]) for x in shares.get(candidate, np.full((2, place + 1), math.nan)))
        if math.isfinite(total):  # no stated input moves some quantities
            reason += f"; share of the variance {first:.3g} alone, {total:.3g} in all"
        unit = "stated uncertainty" if candidate.budgeted else candidate.step
        method = f"{candidate.name} / {quantity.method}" if quantity.method else candidate.name
        make = RowMaker("sensitivity", quantity.subject, method)
        yield make.row(f"{quantity.product}_{quantity.metric}_change", change, reason=f"per {unit}; {reason}")
