"""Which input, less well known than stated, would best explain the residuals; and whether that is enough."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

import numpy as np
import numpy.typing as npt
from scipy import linalg

from hyperval.uncertainty.attribution.likelihood import Explanation, Whitened, explanation

Array = npt.NDArray[np.float64]

ENOUGH = 0.05  # p-value from which residuals count as explained
MOST_STEPS = 3
COMMON, DIFFERENT = "what all subjects share", "what differs between subjects"
MOST_UNITS = 10.0  # an input that would have to move farther is no reason
# Candidates whose gains differ by less cannot be told apart: the likelihoods differ by a factor of less than e.
ALIKE = 2.0


@dataclass(frozen=True)
class Candidate:
    """An input as a reason.

    Attributes
    ----------
    name, kind : for people
    step : one unit in words
    budgeted : its uncertainty is stated, and is in the covariance already
    """

    name: str
    kind: str
    step: str
    budgeted: bool


@dataclass(frozen=True)
class Ranked:
    """One candidate's account of a group of residuals.

    Attributes
    ----------
    gain : twice the log-likelihood gained by freeing it
    units : most likely change in units of its (stated or usual) uncertainty; with a sign where it has one direction
    needed : standard deviation in the same units at which the data are most likely; 1 when the stated one will do,
        0 when an unstated one need not move
    limited : whether it would have to move farther than it can
    chi_square, p_value : of the residuals with that uncertainty
    """

    candidate: Candidate
    gain: float
    units: float
    needed: float
    chi_square: float
    p_value: float
    amplitudes: tuple[float, ...] = field(default=(), repr=False)
    limited: bool = False


@dataclass(frozen=True)
class Ranking:
    """All candidates for one group of residuals, the best first.

    Attributes
    ----------
    group : subject, or "all"
    chi_square, dof, p_value : under the stated uncertainties
    ranked : by gain, the greatest first
    together : the best one, then the best of what it leaves, until that is enough
    """

    group: str
    chi_square: float
    dof: int
    p_value: float
    ranked: tuple[Ranked, ...]
    together: tuple[Ranked, ...]

    @property
    def conclusion(self) -> str:
        """What a reader should take from it."""
        before = f"reduced chi-square {self.chi_square / self.dof:.3g} of {self.dof} residuals"
        if self.p_value >= ENOUGH:
            return f"nothing to explain: {before} (p = {self.p_value:.2g})"
        if not self.together:
            return f"no input explains anything: {before} (p = {self.p_value:.2g})"
        best, last = self.together[0], self.together[-1]
        alike = [r.candidate.name for r in self.ranked[1:] if r.gain > best.gain - ALIKE]
        first = f"{best.candidate.name} ({in_words(best)}) explains most"
        if alike:
            first += f" (not told apart from {' and '.join(alike[:3])})"
        if best.p_value >= ENOUGH:
            return f"{first}, and is enough: {before}, {best.chi_square / self.dof:.3g} after"
        names = " and ".join(r.candidate.name for r in self.together)
        if last.p_value >= ENOUGH:
            return f"{first}; {names} together are enough: {before}, {last.chi_square / self.dof:.3g} after"
        return f"{first}, but none is enough: {before}, {last.chi_square / self.dof:.3g} after {names}"


def in_words(item: Ranked) -> str:
    """How far an input would have to move, in words."""
    what = "stated uncertainty" if item.candidate.budgeted else f"step of {item.candidate.step}"
    end = ", as far as it can" if item.limited else ""
    if len(item.amplitudes) == 1:
        return f"{item.units:+.2g} times its {what}{end}"
    return f"{item.needed:.2g} times its {what}{end}"


def ranking(
    group: str,
    residual: Array,
    covariance: Array,
    columns: Mapping[Candidate, Array],
) -> Ranking:
    """Rank the candidates.

    Parameters
    ----------
    residual : (n,) observed minus predicted
    covariance : (n, n) of it, with everything that is budgeted
    columns : candidate -> (n, k) change of the prediction per unit of each of its directions
    """
    data = Whitened(residual, covariance)
    ranked = _all(data, columns)
    together: list[Ranked] = []
    rest, widened, left = ranked, covariance, dict(columns)
    while rest and rest[0].gain > 0 and len(together) < MOST_STEPS:
        best = rest[0]
        together.append(best)
        if best.p_value >= ENOUGH:
            break
        g = left.pop(best.candidate)
        if best.limited:
            residual = residual - g @ np.array(best.amplitudes)
        else:
            widened = widened + (best.needed**2 - float(best.candidate.budgeted)) * g @ g.T
        rest = _all(Whitened(residual, widened), left)
    return Ranking(group, data.chi_square, data.dof, data.p_value, tuple(ranked), tuple(together))


def common_and_own(
    residual: Array, covariance: Array, common: Array, columns: Mapping[Candidate, Array]
) -> dict[str, tuple[Array, Array, dict[Candidate, Array]]]:
    """What is common to all subjects, and what differs between them: two independent parts of the residuals.

    The common part is the generalised least-squares estimate of one factor for each band; the other is what no such
    factor can make, N^T r with the columns of N orthogonal to ``common``.  The two do not correlate.

    Parameters
    ----------
    residual, covariance : (m,), (m, m) of the spectra
    common : (m, K) what a unit of each band's factor does

    Returns
    -------
    Group -> residuals, covariance and columns, as :func:`ranking` takes them.
    """
    whole, _ = linalg.qr(common)
    rest = whole[:, common.shape[1] :]
    weighted = linalg.solve(covariance, common, assume_a="pos")
    spread = linalg.inv(common.T @ weighted)
    spread = 0.5 * (spread + spread.T)
    estimate = spread @ weighted.T
    rankings = {}
    for name, m, c in ((COMMON, estimate, spread), (DIFFERENT, rest.T, rest.T @ covariance @ rest)):
        moved = {candidate: m @ g for candidate, g in columns.items()}
        least = {k: 1e-9 * float(np.max(np.abs(columns[k]), initial=0.0)) for k in moved}
        kept = {k: g for k, g in moved.items() if np.max(np.abs(g), initial=0.0) > least[k]}
        rankings[name] = (m @ residual, c, kept)
    return rankings


def _all(data: Whitened, columns: Mapping[Candidate, Array]) -> list[Ranked]:
    ranked = [_ranked(c, explanation(data, g, budgeted=c.budgeted, most=MOST_UNITS)) for c, g in columns.items()]
    return sorted(ranked, key=lambda r: (-r.gain, r.candidate.name))


def _ranked(candidate: Candidate, e: Explanation) -> Ranked:
    units = float(e.amplitudes[0]) if e.amplitudes.size == 1 else float(np.linalg.norm(e.amplitudes))
    needed = e.tau if e.limited else float(np.sqrt(e.tau**2 + float(candidate.budgeted)))
    amplitudes = tuple(float(x) for x in e.amplitudes)
    return Ranked(candidate, e.gain, units, needed, e.chi_square, e.p_value, amplitudes, e.limited)


def budget_covariance(columns: Mapping[Candidate, Array], size: int) -> Array:
    """(n, n) covariance of everything whose uncertainty is stated."""
    total = np.zeros((size, size))
    for candidate, g in columns.items():
        if candidate.budgeted:
            total += g @ g.T
    return total


def groups_of(subjects: Sequence[str], patterns: Sequence[str]) -> list[str]:
    """The subjects that patterns name, in the order of the subjects."""

    return [s for s in dict.fromkeys(subjects) if any(fnmatchcase(s, p) for p in patterns)]
