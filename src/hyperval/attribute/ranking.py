"""Which inputs explain residuals: the likelihood gained by freeing each, and their order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

import numpy as np
import numpy.typing as npt
import scipy
from scipy import linalg

from hyperval.attribute.candidates import Candidate
from hyperval.attribute.residuals import ENOUGH, Stack
from hyperval.compare.rows import Array
from hyperval.errors import refusal, refuse

ALL = "all"
# A stated uncertainty is too wide where the data refute, at this level, all that is less than so many times so.
TOO_WIDE, TOO_WIDE_LEVEL = 1.5, 1e-3
MOST_STEPS = 3
COMMON, DIFFERENT = "what all subjects share", "what differs between subjects"
MOST_UNITS = 10.0  # an input that would have to move farther is no reason
# Candidates whose gains differ by less cannot be told apart: the likelihoods differ by a factor of less than e.
ALIKE = 2.0


@dataclass(frozen=True, eq=False)
class Explanation:
    """What freeing one input does to a group of residuals.

    Attributes
    ----------
    gain : twice the log-likelihood gained; 0 when freeing it does not help
    tau : added standard deviation of each direction, in units of its (stated or usual) uncertainty
    amplitudes : (k,) most likely size of each direction
    chi_square, dof : of the residual under the widened covariance
    limited : whether it would have to move farther than it can; then it is moved as far as it can, and the
        covariance stays
    """

    candidate: Candidate
    gain: float
    tau: float
    amplitudes: Array
    chi_square: float
    dof: int
    limited: bool = False

    @property
    def p_value(self) -> float:
        """Probability of a residual at least this large with the widened covariance."""
        return float(scipy.stats.chi2.sf(self.chi_square, self.dof))

    @property
    def units(self) -> float:
        """Most likely change, with a sign where it has one direction."""
        return float(self.amplitudes[0] if self.amplitudes.size == 1 else np.linalg.norm(self.amplitudes))

    @property
    def needed(self) -> float:
        """Standard deviation at which the data are most likely: 1 when the stated one will do, 0 of an unstated one."""
        return self.tau if self.limited else float(np.sqrt(self.tau**2 + float(self.candidate.budgeted)))

    @property
    def in_words(self) -> str:
        """How far the input would have to move."""
        size = f"{self.units:+.2g}" if self.amplitudes.size == 1 else f"{self.needed:.2g}"
        return f"{size} times its {self.candidate.unit}{', as far as it can' if self.limited else ''}"


@dataclass(frozen=True)
class Ranking:
    """All candidates for one group of residuals, the best first.

    Attributes
    ----------
    group : subject, or "all"
    chi_square, dof, p_value : under the stated uncertainties
    ranked : by gain, the greatest first
    together : the best one, then the best of what it leaves, until that is enough
    parts : of all residuals, what spectra share and what they differ in: each a test of its own
    level : p-value below which the residuals are not explained; shared out among the groups of one attribution
    """

    group: str
    chi_square: float
    dof: int
    p_value: float
    ranked: tuple[Explanation, ...]
    together: tuple[Explanation, ...]
    parts: tuple[Ranking, ...] = ()
    level: float = ENOUGH

    @property
    def explained(self) -> bool:
        """Whether the stated uncertainties explain the residuals and, where there are parts, each part of them."""
        return all(r.p_value >= self.level for r in (self, *self.parts))

    @property
    def times_too_wide(self) -> float:
        """How many times too wide the stated uncertainties are at least: c^2 r^T C^-1 r = chi2_n at the level."""
        return float(np.sqrt(scipy.stats.chi2.ppf(TOO_WIDE_LEVEL, self.dof) / max(self.chi_square, 1e-300)))

    @property
    def too_wide(self) -> bool:
        """Whether the stated uncertainties are far wider than the residuals."""
        return self.explained and self.times_too_wide > TOO_WIDE

    @property
    def conclusion(self) -> str:
        """What a reader should take from it."""
        before = f"reduced chi-square {self.chi_square / self.dof:.3g} of {self.dof} residuals"
        if self.too_wide:
            return f"stated uncertainty at least {self.times_too_wide:.2g} times too wide: {before}"
        if self.explained:
            return f"nothing to explain: {before} (p = {self.p_value:.2g})"
        if self.p_value >= self.level:
            names = " and ".join(f"{r.group} (p = {r.p_value:.2g})" for r in self.parts if r.p_value < self.level)
            return f"the sum hides what its parts show: {before} (p = {self.p_value:.2g}), but not explained: {names}"
        if not self.together:
            return f"no input explains anything: {before} (p = {self.p_value:.2g})"
        best, last = self.together[0], self.together[-1]
        alike = [r.candidate.name for r in self.ranked[1:] if r.gain > best.gain - ALIKE]
        first = f"{best.candidate.name} ({best.in_words}) explains most"
        if alike:
            first += f" (not told apart from {' and '.join(alike[:3])})"
        if best.p_value >= ENOUGH:
            return f"{first}, and is enough: {before}, {best.chi_square / self.dof:.3g} after"
        names = " and ".join(r.candidate.name for r in self.together)
        if last.p_value >= ENOUGH:
            return f"{first}; {names} together are enough: {before}, {last.chi_square / self.dof:.3g} after"
        return f"{first}, but none is enough: {before}, {last.chi_square / self.dof:.3g} after {names}"


def rankings(
    stack: Stack, residual: Array, covariance: Array, columns: Mapping[Candidate, Array], each: Sequence[str]
) -> list[Ranking]:
    """The candidates ranked by all residuals, by what spectra share or differ in, and by subjects of ``each``."""

    def part(of: npt.NDArray[np.intp]) -> tuple[Array, Array, dict[Candidate, Array]]:
        return residual[of], covariance[np.ix_(of, of)], {c: g[of] for c, g in columns.items() if _moves(g[of], g)}

    parts: list[Ranking] = []
    spectra, common = stack.common_bands()
    if common.size and len(spectra) > common.shape[1]:
        r, c, moved = part(spectra)
        parts = [ranking(group, *data) for group, data in common_and_own(r, c, common, moved).items()]
    out = [replace(ranking(ALL, residual, covariance, columns), parts=tuple(parts)), *parts]
    subjects = [s for s in dict.fromkeys(b.subject for b in stack.blocks) if any(fnmatchcase(s, p) for p in each)]
    out += [ranking(subject, *part(stack.indices_of(subject))) for subject in subjects]
    return [replace(r, level=ENOUGH / len(out)) for r in out]


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
    together: list[Explanation] = []
    rest, widened, left = ranked, covariance, dict(columns)
    while rest and rest[0].gain > 0 and len(together) < MOST_STEPS:
        best = rest[0]
        together.append(best)
        if best.p_value >= ENOUGH:
            break
        g = left.pop(best.candidate)
        if best.limited:
            residual = residual - g @ best.amplitudes
        else:
            widened = widened + best.tau**2 * g @ g.T
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
        kept = {k: g for k, g in moved.items() if _moves(g, columns[k])}
        rankings[name] = (m @ residual, c, kept)
    return rankings


def _moves(part: Array, whole: Array) -> bool:
    """Whether a change in some residuals is more than rounding beside that in all of them."""
    return bool(np.max(np.abs(part), initial=0.0) > 1e-9 * np.max(np.abs(whole), initial=0.0))


def _all(data: Whitened, columns: Mapping[Candidate, Array]) -> list[Explanation]:
    found = [explanation(data, g, candidate, MOST_UNITS) for candidate, g in columns.items()]
    # One that would have to move farther than it can is no first reason.  Of inputs that explain the same, rounding
    # shall not say which comes first.
    return sorted(found, key=lambda r: (r.limited, -float(f"{r.gain:.6g}"), r.candidate.name))


def budget_covariance(columns: Mapping[Candidate, Array], size: int) -> Array:
    """(n, n) covariance of everything whose uncertainty is stated."""
    return sum((g @ g.T for candidate, g in columns.items() if candidate.budgeted), np.zeros((size, size)))


_GRID = np.geomspace(1e-4, 1e8, 97)


class Whitened:
    """A residual in units of its stated uncertainty: C = L L^T, e = L^-1 r.

    Raises
    ------
    UsageError : values that are not finite, or a covariance that is not positive definite.

    Examples
    --------
    >>> data = Whitened([2.0, 1.0], np.eye(2))
    >>> data.chi_square / data.dof, round(data.p_value, 3)
    (2.5, 0.082)
    """

    def __init__(self, residual: npt.ArrayLike, covariance: npt.ArrayLike):
        r, c = np.asarray(residual, dtype=float), np.asarray(covariance, dtype=float)
        refuse(r.size == 0 or not (np.isfinite(r).all() and np.isfinite(c).all()), "attribution.finite")
        self._sd = np.sqrt(np.diag(c))
        refuse(not np.all(self._sd > 0), "attribution.uncertainty")
        try:
            self._lower = linalg.cholesky(c / np.outer(self._sd, self._sd), lower=True)
        except linalg.LinAlgError as error:
            raise refusal("attribution.definite") from error
        self.residual = self.whiten(r)

    def whiten(self, columns: npt.ArrayLike) -> Array:
        """L^-1 times columns (n,) or (n, k)."""
        x = (np.asarray(columns, dtype=float).T / self._sd).T
        return np.asarray(linalg.solve_triangular(self._lower, x, lower=True))

    @property
    def chi_square(self) -> float:
        """r^T C^-1 r."""
        return float(self.residual @ self.residual)

    @property
    def dof(self) -> int:
        """Number of residuals."""
        return int(self.residual.size)

    @property
    def p_value(self) -> float:
        """Probability of a residual at least this large when the stated uncertainties hold."""
        return float(scipy.stats.chi2.sf(self.chi_square, self.dof))


def explanation(data: Whitened, columns: npt.ArrayLike, candidate: Candidate, most: float = np.inf) -> Explanation:
    """Free one input and see what it gains.

    Parameters
    ----------
    columns : (n, k) change of the compared quantities (prediction) per standard uncertainty
    candidate : whose columns they are; where it is budgeted C holds them already, and tau comes on top of 1
    most : greatest tau, and greatest amplitude of any direction; an input that would have to move farther than it
        can is no reason

    Examples
    --------
    >>> gain = Candidate("gain", "sensor", "1 %", budgeted=False)
    >>> why = explanation(Whitened([3.0, 0.1], np.eye(2)), [[1.0], [0.0]], gain)
    >>> round(why.gain, 2), round(why.tau, 2), round(why.chi_square, 2), round(why.p_value, 2)
    (5.8, 2.83, 1.01, 0.6)
    """
    w = data.whiten(columns)
    u, s, vt = linalg.svd(w, full_matrices=False)
    keep = s > 1e-12 * max(float(s[0]), 1e-300)
    if not np.any(s > 0):
        return Explanation(candidate, 0.0, 0.0, np.zeros(w.shape[1]), data.chi_square, data.dof)
    u, s, vt = u[:, keep], s[keep], vt[keep]
    q = u.T @ data.residual

    t2 = _best_tau_squared(s, q, most**2)
    shrink = 1.0 / (1.0 + t2 * s**2)
    z = (t2 + float(candidate.budgeted)) * (vt.T @ (s * shrink * q))  # best linear unbiased prediction of z
    if np.max(np.abs(z)) > most:  # it goes as far as it can, and the rest stays
        z = np.clip(z, -most, most)
        left = data.residual - w @ z
        chi = float(left @ left)
        gain = data.chi_square - chi - float(np.sum(np.log1p(t2 * s**2)))
        return Explanation(candidate, max(gain, 0.0), most, z, chi, data.dof, True)
    gain = float(_gain(t2, s, q))
    chi = data.chi_square - float(np.sum((1.0 - shrink) * q**2))
    return Explanation(candidate, max(gain, 0.0), float(np.sqrt(t2)), z, chi, data.dof)


def _gain(t2: float, s: Array, q: Array) -> float:
    """2 ln L(tau) - 2 ln L(0): what the quadratic form falls by, less the logarithm of the determinant."""
    x = t2 * s**2
    return float(np.sum(x / (1.0 + x) * q**2 - np.log1p(x)))


def _best_tau_squared(s: Array, q: Array, most: float) -> float:
    if s.size == 1:  # d/dt2 = 0 at 1 + t2 s^2 = q^2
        return min(max(float(q[0] ** 2) - 1.0, 0.0) / float(s[0] ** 2), most)
    grid = np.minimum(_GRID / float(s[0] ** 2), most)
    values = np.array([_gain(t, s, q) for t in grid])
    best = int(np.argmax(values))
    if values[best] <= 0.0:
        return 0.0
    low, high = np.log(grid[max(best - 1, 0)]), np.log(grid[min(best + 1, grid.size - 1)])
    if not high > low:
        return float(grid[best])
    optimum = scipy.optimize.minimize_scalar(lambda t: -_gain(np.exp(t), s, q), bounds=(low, high), method="bounded")
    return float(np.exp(optimum.x))
