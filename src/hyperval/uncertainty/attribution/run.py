"""Looking for the reasons: every input moved, every what-if run, all of them ranked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.prediction.departure import Departure, combined
from hyperval.prediction.input import Input
from hyperval.products import Products
from hyperval.progress import track
from hyperval.uncertainty.attribution.ranking import Candidate, Ranking, budget_covariance, rankings
from hyperval.uncertainty.attribution.residuals import Quantity, Stack, quantities, stacked
from hyperval.uncertainty.attribution.schema import AttributionOptions
from hyperval.uncertainty.attribution.sensitivity import Indices, quadratic_design, sensitivity_indices
from hyperval.uncertainty.attribution.what_ifs import Model, Outcome, Truth, run_what_ifs

Array = npt.NDArray[np.float64]

ATMOSPHERE = "atmosphere"  # kind of the inputs that need a run of the engine for each value
_CHECKS = 4
MOST_TOGETHER = 6
# Directions of an input with a correlation length that are looked at: they hold nearly all of its variance.
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
    quantities: tuple[Quantity, ...]
    predicted: Array
    changes: Array
    indices: Indices | None
    stated: tuple[Candidate, ...]
    what_ifs: tuple[Outcome, ...]


@dataclass(frozen=True, eq=False)
class _Reason:
    """A candidate with the input that it is in each scenario, None where it is none there."""

    candidate: Candidate
    members: tuple[Input | None, ...]

    @property
    def size(self) -> int:
        return min(max(m.size for m in self.members if m is not None), MOST_DIRECTIONS)

    def at(self, direction: int, units: float) -> list[Departure]:
        return [
            Departure() if m is None or direction >= m.size else m.direction(direction, units) for m in self.members
        ]


def attribute(
    model: Model,
    observed: Products,
    stated: Sequence[Sequence[Input]],
    assumed: Sequence[Sequence[Input]],
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
    budgeted : the prediction with its error covariances; what they hold beyond the inputs' directions counts as
        independent in each band

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
        covariance += np.diag(np.clip(stack.predicted_variance(budgeted) - np.diag(budget), 0.0, None))
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

    def __init__(self, model: Model, stack: Stack, numbers: Sequence[Quantity]):
        self._model, self._stack, self._numbers = model, stack, numbers

    def __call__(self, truths: Sequence[Truth], title: str, show: bool | None) -> list[tuple[Array, Array]]:
        predictions = track(self._model.products_of(truths), title, len(truths), show=show)
        return [(self._stack.predicted(p), np.array([q.read(p) for q in self._numbers])) for p in predictions]


def _reasons(stated: Sequence[Sequence[Input]], assumed: Sequence[Sequence[Input]]) -> list[_Reason]:
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
    joint: dict[int, list[Departure]] = {}
    for i, j in combinations(range(len(reasons)), 2):
        a, b = reasons[i], reasons[j]
        if {i, j} <= leading and not a.candidate.kind == b.candidate.kind == ATMOSPHERE:
            together = _together([a, b], [1.0, 1.0])
            if together is not None:
                joint[len(values)] = together
        values.append(single[a.candidate, 1] + single[b.candidate, 1] - base)
    rng = np.random.default_rng(0)
    points, checks = [], []
    for _ in range(_CHECKS):
        z = rng.choice([-1.0, 1.0], size=len(reasons))
        engine = [i for i, r in enumerate(reasons) if r.candidate.kind == ATMOSPHERE]
        z[engine[1:]] = 0.0
        together = _together(reasons, z)
        if together is not None:
            points.append(z)
            checks.append(together)
    values_of = [q for _, q in evaluate([*joint.values(), *checks], "reasons: pairs of inputs", show_progress)]
    for place, value in zip(joint, values_of, strict=False):
        values[place] = value
    there = values_of[len(joint) :]
    return sensitivity_indices(design, np.array(values), (np.array(points), np.array(there)) if points else None)


def _together(reasons: Sequence[_Reason], units: Sequence[float] | Array) -> list[Departure] | None:
    """Several inputs at once; None where two of them set the same entry."""
    moved = [r.at(0, z) for r, z in zip(reasons, units, strict=True) if z]
    try:
        return [combined(*parts) for parts in zip(*moved, strict=True)]
    except UsageError:
        return None
