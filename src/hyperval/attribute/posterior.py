"""Which causes explain residuals: the probability of each, of pairs, of none that was tried, of nothing to explain.

A cause is a set of independent directions, or a family of sizes between which the model is interpolated, or one of
several alternatives.  Its evidence is the likelihood averaged over the sizes that it may have, so that a cause that
could make any residual is believed less than one that could make few and made these.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy
from scipy import linalg, special

from hyperval.attribute.candidates import LIGHT, SINGLE_BANDS, Candidate
from hyperval.attribute.residuals import ENOUGH, Stack
from hyperval.data import Array, Index
from hyperval.errors import refusal, refuse
from hyperval.products import background_of
from hyperval.results import grouped

ALL = "all"
SHARED = ("sensor", "atmosphere")  # kinds that befall all that is measured
# A stated uncertainty is too wide where the data refute, at this level, all that is less than so many times so.
TOO_WIDE, TOO_WIDE_LEVEL = 1.5, 1e-3
COMMON, DIFFERENT = "what all subjects share", "what differs between subjects"
NOTHING, NONE = "nothing to explain", "none of these"
UNKNOWN = Candidate(NONE, "", "", False)  # what no candidate describes
# Before the data are seen: that nothing is wrong, that something is that no candidate describes; the rest is shared.
NOTHING_PRIOR, NONE_PRIOR = 0.5, 0.05
TYPICAL = 2.0  # units that an error has: half of all have less (Cauchy; a half-Cauchy spread of directions)
LIKELY = 0.8  # probability from which a cause can be called enough
CONFOUNDED_ODDS, CORRELATED = 10.0, 0.95  # odds within which causes are confounded; correlation of their effects
MAX_FIRST, MAX_CAUSES, MAX_PEAKS = 4, 3, 4
CLOSE, GOOD_PART = 30.0, 0.25  # ln of the odds of hypotheses that are named; part of what causes explain together
_FACTORS = np.geomspace(1.0, 1e3, 41)  # by which all uncertainties may be too small, where no candidate is right
REMAINDER = 0.05  # of a chi-square without noise that causes may leave
MAX_LEFT = 0.5  # of the chi-square of a change, or of what is beyond chance: what causes that are named may leave
_REACH = np.geomspace(1e-3, 1.0, 60)  # of a bound: where the likelihood of a size is asked at first
_ROUGH = 1e-11  # of the largest eigenvalue: what rounding leaves


class Whitened:
    """A residual in units of its stated uncertainty: C = L L^T, e = L^-1 r.

    Raises
    ------
    UsageError : values that are not finite, or a covariance that is not positive definite.

    Examples
    --------
    >>> Whitened([2.0, 1.0], np.eye(2)).chi_square
    5.0
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
        """L^-1 times columns (n,) or (n, k).

        >>> Whitened([2.0], np.eye(1)).whiten([np.nan])
        Traceback (most recent call last):
        ValueError: array must not contain infs or NaNs
        """
        x = np.asarray_chkfinite((np.asarray(columns, dtype=float).T / self._sd).T)
        return np.asarray(linalg.solve_triangular(self._lower, x, lower=True, check_finite=False))  # of the factor

    def unwhiten(self, x: Array) -> Array:
        """L x: what is whitened, back in its own units."""
        return np.asarray((self._lower @ x) * self._sd)

    @property
    def chi_square(self) -> float:
        """r^T C^-1 r."""
        return float(self.residual @ self.residual)


@dataclass(frozen=True, eq=False)
class Fit:
    """A cause and residuals e, whitened.

    Attributes
    ----------
    evidence : ln p(e | cause) - ln p(e | nothing)
    amplitudes : (k,) most likely sizes, in units; of alternatives the number of one
    shown : (n,) what it most likely makes of e
    made : the same, where its size is held
    freed, variances : (n, j) orthonormal directions along which more of it would be, and how much (j,)
    limited : whether it would have to go farther than it can
    factor2 : on all variances, where no candidate is meant
    """

    candidate: Candidate
    evidence: float
    amplitudes: Array
    shown: Array
    made: Array
    freed: Array
    variances: Array
    limited: bool = False
    factor2: float = 1.0

    @property
    def name(self) -> str:
        """Of the candidate."""
        return self.candidate.name

    @property
    def units(self) -> float:
        """Most likely change, with a sign where it has one direction."""
        return float(self.amplitudes[0] if self.amplitudes.size == 1 else np.linalg.norm(self.amplitudes))

    @property
    def description(self) -> str:
        """How far it would have to move."""
        return self.candidate.describe(self.amplitudes) + ", at its limit" * self.limited


@lru_cache(maxsize=256)
def _interpolation(sizes: tuple[float, ...]) -> scipy.interpolate.CubicSpline:
    """Weights of the values at some sizes in the value at another one."""
    order = np.argsort(sizes)
    return scipy.interpolate.CubicSpline(np.array(sizes)[order], np.eye(len(sizes))[order])


class Directions:
    """Independent directions (n, k) with one spread tau, whose prior is half-Cauchy: the evidence is ln of the average
    over tau of N(0, I + tau^2 G G^T) over N(0, I).

    Where no candidate is meant, all uncertainties may be too small besides: N(0, s^2 I + tau^2 G G^T).
    """

    def __init__(self, candidate: Candidate, columns: Array):
        self.candidate, self.columns = candidate, columns
        values, vectors = linalg.eigh(columns.T @ columns)
        keep = values > _ROUGH * max(float(values[-1]), 1e-300)
        self.values, self.vectors = values[keep], vectors[:, keep]
        self.max_units = candidate.max_units
        # Spreads tau (T,), factors (S,) on all variances, ln of their prior (S, T).
        spreads = np.geomspace(0.02, self.max_units, 41)
        self.tau: Array = np.append(0.0, spreads) if candidate is UNKNOWN else spreads
        self.scale2: Array = _FACTORS**2 if candidate is UNKNOWN else np.ones(1)
        weight = np.where(self.tau > 0.0, self.tau / (TYPICAL**2 + self.tau**2), 1.0)  # half-Cauchy, by ln tau
        self.prior = np.log(weight / weight.sum()) - 0.5 * np.log(self.scale2)[:, None]
        grown = self.scale2[:, None, None] + self.tau[:, None] ** 2 * self.values
        self._inverse, self._logs = 1.0 / grown, np.log(grown).sum(axis=2)

    def fit(self, e: Array) -> Fit:
        """Fit to residuals e (n,)."""
        dots = self.vectors.T @ (self.columns.T @ e)
        q2, total = dots**2 / self.values, float(e @ e)
        rest, unmoved = max(total - float(q2.sum()), 0.0), e.size - self.values.size
        logs = total - self._inverse @ q2 - self._logs
        logs -= (rest / self.scale2 + unmoved * np.log(self.scale2))[:, None]
        logs = 0.5 * logs + self.prior
        best_s, best = np.unravel_index(int(np.argmax(logs)), logs.shape)
        t2, s2 = float(self.tau[best] ** 2), float(self.scale2[best_s])
        z = self.vectors @ (t2 / (s2 + t2 * self.values) * dots)
        evidence = float(np.logaddexp.reduce(logs, axis=None))
        if self.candidate is not UNKNOWN and np.max(np.abs(z), initial=0.0) > self.max_units:
            made = self.columns @ np.clip(z, -self.max_units, self.max_units)
            return Fit(self.candidate, evidence, z, made, made, np.zeros((e.size, 0)), np.zeros(0), True)
        freed, variances = self.columns @ (self.vectors / np.sqrt(self.values)), t2 * self.values
        return Fit(self.candidate, evidence, z, self.columns @ z, np.zeros_like(e), freed, variances, False, s2)

    def draw(self, rng: np.random.Generator, length: float) -> Array:
        """A random effect of about this length, within its bounds."""
        z = rng.normal(size=self.columns.shape[1])
        made = self.columns @ z
        far = min(length / max(float(np.linalg.norm(made)), 1e-300), 0.9 * self.max_units / float(np.max(np.abs(z))))
        return np.asarray(far * made)


class SizeResponse:
    """Sizes at which the model was asked, and what lies between (cubic; straight beyond the last).

    ``columns`` : (n, m) change of the whitened prediction at each of the candidate's sizes

    >>> sizes = (-60.0, -30.0, 30.0, 60.0)
    >>> day = Candidate("date", "scene", "1 d", False, sizes=sizes)
    >>> def sun(z):  # nearly the same on both sides of a solstice
    ...     return 1e4 * (np.outer([1.0, 0.4], (np.asarray(z) - 11.0) ** 2 / 900.0 - 0.134) + np.outer([0, 1e-3], z))
    >>> round(build_effect(day, sun(sizes)).fit(sun([-32.0])[:, 0]).units, 2)
    -32.0
    """

    def __init__(self, candidate: Candidate, columns: Array):
        self.candidate, self.low, self.high = candidate, *candidate.size_limits
        self._interpolation = _interpolation((0.0, *candidate.sizes))
        self.columns = np.column_stack([np.zeros(len(columns)), columns])
        self.gram = self.columns.T @ self.columns

    def weights(self, a: Array, derivative: int = 0) -> Array:
        """(len(a), m) of the columns at sizes ``a``, or its derivative."""
        inside = np.clip(a, self._interpolation.x[0], self._interpolation.x[-1])
        slope = self._interpolation(inside, 1)
        return np.asarray(slope if derivative else self._interpolation(inside) + (a - inside)[:, None] * slope)

    def fit(self, e: Array) -> Fit:
        """Evidence by the trapezoid rule, on a grid that is refined where the likelihood has its mass."""
        dots = self.columns.T @ e

        def log_likelihood(a: Array) -> Array:
            w = self.weights(a)
            return np.asarray(w @ dots - 0.5 * np.sum(w @ self.gram * w, axis=1))

        a = np.concatenate([self.low * _REACH[::-1], [0.0], self.high * _REACH])
        values = log_likelihood(a)
        for _ in range(12):
            # The likelihood may have several peaks, such as on both sides of a solstice.
            beside = np.pad(values, 1, constant_values=-np.inf)
            peaks = np.flatnonzero((values >= beside[:-2]) & (values >= beside[2:]))
            peaks = peaks[np.argsort(-values[peaks], kind="stable")][:MAX_PEAKS]
            low, high = np.maximum(peaks - 1, 0), np.minimum(peaks + 1, a.size - 1)
            rough = values[peaks] - np.minimum(values[low], values[high]) >= 1.0
            if not rough.any():
                break
            more = np.linspace(a[low[rough]], a[high[rough]], 21)[1:-1].ravel()
            values, a = np.append(values, log_likelihood(more)), np.append(a, more)
            a, first = np.unique(a, return_index=True)
            values = values[first]
        best = int(np.argmax(values))
        whole = TYPICAL * (np.arctan(self.high / TYPICAL) - np.arctan(self.low / TYPICAL))
        prior = 1.0 / (whole * (1.0 + (a / TYPICAL) ** 2))
        evidence = values[best] + np.log(np.trapezoid(np.exp(values - values[best]) * prior, a))
        size = a[best : best + 1]
        tangent = self.columns @ self.weights(size, 1)[0]
        length = max(float(np.linalg.norm(tangent)), 1e-300)
        freed = tangent[:, None] / length, np.array([(length * max(abs(float(size[0])), 1e-3)) ** 2])
        limited = bool(size[0] < 0.98 * self.low or size[0] > 0.98 * self.high)
        made = self.columns @ self.weights(size)[0]
        return Fit(self.candidate, float(evidence), size, made, made, *freed, limited)

    def draw(self, rng: np.random.Generator, length: float) -> Array:
        """The effect at a size of either sign, of about this length, within its bounds."""
        w = self.weights((self.low, self.high)[rng.integers(2)] * np.geomspace(1e-4, 0.9, 400))
        far = np.sqrt(np.maximum(np.einsum("am,mn,an->a", w, self.gram, w), 0.0))
        return np.asarray(self.columns @ w[np.argmin(np.abs(far - length))])


class Alternatives:
    """One of several columns, each as likely as another before."""

    def __init__(self, candidate: Candidate, columns: Array):
        self.candidate, self.columns = candidate, columns
        self._half = 0.5 * np.sum(columns**2, axis=0)

    def fit(self, e: Array) -> Fit:
        """Fit to residuals e (n,)."""
        logs = self.columns.T @ e - self._half
        best = int(np.argmax(logs))
        evidence = float(np.logaddexp.reduce(logs) - np.log(logs.size))
        made = self.columns[:, best]
        return Fit(self.candidate, evidence, np.array([float(best)]), made, made, np.zeros((e.size, 0)), np.zeros(0))

    def draw(self, rng: np.random.Generator, length: float) -> Array:
        """The effect of one of them at random, whatever its length."""
        return np.asarray(self.columns[:, rng.integers(self.columns.shape[1])])


Effect = Directions | SizeResponse | Alternatives


def build_effect(candidate: Candidate, columns: Array) -> Effect:
    """The effect of a candidate on whitened residuals (n, k), by its kind."""
    kind: type[Effect] = Alternatives if candidate.labels else SizeResponse if candidate.sizes else Directions
    return kind(candidate, columns)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Causes that together made the residuals, the one that explains most first; none of them: nothing is wrong.

    Attributes
    ----------
    weight : ln of evidence and prior
    chi_squares : after each cause, the freed directions in the covariance
    """

    causes: tuple[Fit, ...]
    weight: float
    chi_squares: tuple[float, ...]

    @property
    def first_cause(self) -> str:
        """The cause that it names first."""
        return self.causes[0].name if self.causes else NOTHING


@dataclass(frozen=True, eq=False)
class Posterior:
    """All hypotheses for one group of residuals.

    Attributes
    ----------
    group : subject, or "all"
    chi_square, dof, p_value : under the stated uncertainties
    fits : each candidate alone, the likeliest first
    hypotheses : the likeliest first
    probability : name -> of its being the first cause; :data:`NONE` and :data:`NOTHING` among them
    confounded : causes that cannot be distinguished from the first
    parts : of all residuals, what spectra share and what they differ in: each a test of its own
    level : p-value below which the residuals are not explained; shared out among the groups of one attribution
    beside_noise : whether more than is named may hide in the noise of a scene made anew, so that no cause is enough
    remark : what is said before all where no number has changed

    Examples
    --------
    >>> Posterior("all", 2.1, 2, 0.35, (), (), {NOTHING: 0.9, NONE: 0.1}).conclusion
    'nothing to explain: reduced chi-square 1.05 of 2 residuals (p = 0.35)'
    >>> Posterior("all", 0.0, 2, 1.0, (), (), {NOTHING: 1.0}).conclusion
    'nothing to explain: reduced chi-square 0 of 2 residuals (p = 1)'
    """

    group: str
    chi_square: float
    dof: int
    p_value: float
    fits: tuple[Fit, ...]
    hypotheses: tuple[Hypothesis, ...]
    probability: Mapping[str, float]
    confounded: tuple[str, ...] = ()
    parts: tuple[Posterior, ...] = ()
    level: float = ENOUGH
    beside_noise: bool = False
    remark: str = ""

    @classmethod
    def for_zero_residuals(cls, dof: int) -> Posterior:
        """The posterior of residuals that are all 0."""
        return cls(ALL, 0.0, dof, 1.0, (), (Hypothesis((), 0.0, ()),), {NOTHING: 1.0, NONE: 0.0})

    @property
    def first_cause(self) -> str:
        """The likeliest first cause."""
        return max(self.probability, key=lambda name: self.probability[name])

    @property
    def best(self) -> Hypothesis:
        """The likeliest hypothesis that names it."""
        return next(h for h in self.hypotheses if h.first_cause == self.first_cause)

    @property
    def remaining_chi_square(self) -> float:
        """Chi-square after the causes that it names."""
        best = self.best
        named = [x for x, cause in zip(best.chi_squares, best.causes, strict=False) if cause.candidate is not UNKNOWN]
        return named[-1] if named else self.chi_square

    @property
    def remaining_p_value(self) -> float:
        """Probability of what is left after the causes of the best hypothesis, or of more."""
        return float(scipy.stats.chi2.sf(self.remaining_chi_square, self.dof))

    @property
    def is_sufficient(self) -> bool:
        """Whether the named causes explain the residuals: what is left passes, they are few, within their bounds, could
        not make anything, and the first or those that cannot be told from it are likely.

        >>> def said(r, *names):
        ...     causes = [Candidate(name, "sensor", "1 %", False) for name in names]
        ...     columns = {c: np.eye(8)[:, i : i + 1] for i, c in enumerate(causes)}
        ...     found = CausePrior(columns, 0.1 * np.eye(8)[:, 4:]).posterior("all", np.pad(r, (0, 8 - len(r))))
        ...     return len(found.best.causes), found.is_sufficient
        >>> said([30.0], "gain"), said([30.0], "single bands")
        ((1, True), (1, False))
        >>> one, named = np.eye(8)[:, :1], [Candidate(name, "sensor", "1 %", False) for name in "abc"]
        >>> three = [build_effect(candidate, one).fit(30.0 * one[:, 0]) for candidate in named]
        >>> hypotheses = [Hypothesis(tuple(three[:k]), 0.0, k * (0.1,)) for k in (1, 2, 3)]
        >>> found = [Posterior("all", 900.0, 8, 0.0, tuple(three), (h,), {"a": 1.0, NOTHING: 0.0}) for h in hypotheses]
        >>> [posterior.is_sufficient for posterior in found]
        [True, True, False]

        Of a change, a smooth piece beside another cause fits what that one left:

        >>> piece = replace(named[1], knots_nm=(400.0,), unbounded=True)
        >>> two = [replace(three[0], candidate=replace(named[0], unbounded=True)), replace(three[1], candidate=piece)]
        >>> h = Hypothesis(tuple(two), 0.0, (0.1, 0.1))
        >>> Posterior("all", 900.0, 8, 0.0, tuple(two), (h,), {"a": 1.0, NOTHING: 0.0}).is_sufficient
        False
        """
        causes, sure = self.best.causes, sum(self.probability.get(n, 0.0) for n in (self.first_cause, *self.confounded))
        named = [c.candidate for c in causes if c.candidate is not UNKNOWN and not c.limited]
        inside = 0 < len(named) == len(causes) < MAX_CAUSES and not any(c.fits_any_spectrum for c in named)
        if len(named) > 1 and named[0].unbounded:  # of a change, which has no noise, smooth pieces make the rest
            inside = inside and not any(c.knots_nm for c in named)
        return inside and self.remaining_p_value >= ENOUGH and sure >= LIKELY and not self.beside_noise

    @property
    def is_consistent(self) -> bool:
        """Whether the stated uncertainties explain the residuals and, where there are parts, each part of them."""
        return all(r.p_value >= self.level for r in (self, *self.parts))

    @property
    def overestimation(self) -> float:
        """How many times too wide the stated uncertainties are at least: c^2 r^T C^-1 r = chi2_n at the level."""
        return float(np.sqrt(scipy.stats.chi2.ppf(TOO_WIDE_LEVEL, self.dof) / self.chi_square))

    @property
    def is_too_wide(self) -> bool:
        """Whether the stated uncertainties are far wider than the residuals; where all are 0 both sides are one."""
        return self.is_consistent and self.chi_square > 0.0 and self.overestimation > TOO_WIDE

    @property
    def conclusion(self) -> str:
        """What a reader should take from it.

        Of spectra first, where causes suffice for these and not for SNR and scores, which follow from them; and no
        cause of less than half, where the rest has none.

        >>> one, sun = np.eye(8)[:, :1], Candidate("sun", "scene", "1 h", False, sizes=(-2.0, 2.0))
        >>> fit = build_effect(sun, np.outer(one, sun.sizes)).fit(1.5 * one[:, 0])
        >>> rest = replace(fit, candidate=UNKNOWN)
        >>> def posterior(group, whole, rests, *causes):
        ...     return Posterior(group, whole, 8, 1e-9, (fit,), (Hypothesis(causes, 0.0, rests),), {"sun": 1.0})
        >>> [posterior("all", 100.0, (rests, 8.0), fit, rest).conclusion[:24] for rests in (50.0, 70.0)]
        ['check the sun (+1.6 h ex', 'none of the causes tried']
        >>> shared = posterior("what all share", 90.0, (5.0,), fit)
        >>> everything = replace(posterior("all", 100.0, (70.0, 8.0), fit, rest), parts=(shared,))
        >>> everything.conclusion.partition("of 8 residuals, ")[2][:68]
        '0.625 after, of what all share; of everything: none of the causes tr'
        """
        before = f"reduced chi-square {self.chi_square / self.dof:.3g} of {self.dof} residuals"
        if self.is_too_wide and self.first_cause == NOTHING:
            return f"stated uncertainty at least {self.overestimation:.2g} times too wide: {before}"
        if self.is_consistent and self.first_cause == NOTHING:
            return f"nothing to explain: {before} (p = {self.p_value:.2g})"
        if not self.is_sufficient and (part := next((r for r in self.parts if r.is_sufficient), None)):
            return f"{part.conclusion}, of {part.group}; of everything: {replace(self, parts=()).conclusion}"
        if self.first_cause == NOTHING and self.p_value >= self.level:
            names = " and ".join(f"{r.group} (p = {r.p_value:.2g})" for r in self.parts if r.p_value < self.level)
            return f"consistent in total, not in parts: {before} (p = {self.p_value:.2g}); inconsistent: {names}"
        if self.first_cause == NOTHING:
            return f"no input explains the differences: {before} (p = {self.p_value:.2g})"
        little = self.remaining_chi_square - self.dof > MAX_LEFT * (self.chi_square - self.dof)
        if self.first_cause == NONE or (little and self.best.causes[-1].candidate is UNKNOWN):
            nearest = max((f for f in self.fits if not f.limited), key=lambda f: f.evidence, default=None)
            near = f" (the nearest: {nearest.name}, {nearest.description})" if nearest and nearest.evidence > 0 else ""
            return f"none of the causes tried{near}: {before}"
        return f"{self._cause_summary}: {before}, {self.remaining_chi_square / self.dof:.3g} after"

    @property
    def _cause_summary(self) -> str:
        """ "check the time of overflight (+1 h explains 94 % of the difference), then the sensor gain (x 1.02)"

        >>> one, gain = np.eye(8)[:, :1], Candidate("gain", "sensor", "1 %", False)
        >>> h = Hypothesis((build_effect(gain, one).fit(30.0 * one[:, 0]),), 0.0, (4.0,))
        >>> found = [Posterior("all", 1e3, 8, 0.0, (), (h,), {"gain": p, NOTHING: 1.0 - p}) for p in (1.0, 0.6)]
        >>> [posterior._cause_summary.partition("explains ")[2] for posterior in found]
        ['100 % of the difference); sufficient', 'over 99 % of the difference); possibly not sufficient']
        """
        first, *more = self.best.causes
        percent = max(100.0 - 100.0 * self.best.chi_squares[0] / self.chi_square, 0.0)
        part = "over 99" if percent >= 99.5 and not self.is_sufficient else f"{percent:.0f}"
        words = f"check the {first.name} ({first.description} explains {part} % of the difference"
        words += f"; not distinguished from {' and '.join(self.confounded[:3])})" if self.confounded else ")"
        words += "".join(f", then the {c.name} ({c.description})" for c in more if c.candidate is not UNKNOWN)
        if any(c.candidate is UNKNOWN for c in more):
            return f"{words}; not sufficient: the remainder has none of the causes tried"
        sure = "sufficient" if self.is_sufficient else "possibly not sufficient"
        return f"{words}; {'together ' if more else ''}{sure}"


class CausePrior:
    """What is known of candidates and of chance before residuals are seen; worlds may be drawn from it.

    Parameters
    ----------
    columns : candidate -> (n, k) whitened change of the prediction: for a unit of each direction, at each of the
        sizes, or by each alternative
    wide : (n, k) the same of what no candidate describes
    noisy : whether residuals hold chance, and misfits of their own; of a change without any, what explains but a part
        does not explain it

    Examples
    --------
    >>> water, gain = (Candidate(name, "input", "0.1", True) for name in ("water", "gain"))
    >>> prior = CausePrior({water: np.eye(3)[:, :1], gain: np.ones((3, 1))}, np.eye(3))
    >>> prior.posterior("all", np.array([9.0, 0.3, -0.2])).first_cause
    'water'
    >>> wide, change = np.eye(8), np.array([9.0, 4.0, -3.0, 0, 0, 0, 0, 0])
    >>> two = {water: wide[:, :1], gain: np.ones((8, 1))}
    >>> [CausePrior(two, wide, noisy=noisy).posterior("all", change).first_cause for noisy in (True, False)]
    ['water', 'none of these']

    What would have to go beyond its bounds is no reason, alone or after another.

    >>> one, smooth = np.eye(40), Candidate("smooth gain", "sensor", "3 %", False, knots_nm=(400.0,))
    >>> offset = Candidate("offset", "sensor", "1 %", False)
    >>> prior = CausePrior({offset: one[:, :1], smooth: one[:, 1:2]}, one[:, 4:])
    >>> changes = 10.0 * one[1], 30.0 * one[1], 30.0 * (one[0] + one[1])
    >>> [[cause.name for cause in prior.posterior("all", change).best.causes] for change in changes]
    [['smooth gain'], ['none of these'], ['offset', 'none of these']]

    Of a change, bands that are off by themselves are few; many are a pattern that no candidate has.

    >>> bands = Candidate("single bands", "sensor", "1 % in each band", False)
    >>> prior = CausePrior({bands: one}, one, noisy=False)
    >>> [prior.posterior("all", change).first_cause for change in (30.0 * one[1], np.full(40, 30.0))]
    ['single bands', 'none of these']

    The cause that makes most of it is named first.

    >>> tilt = Candidate("tilt", "sensor", "1 %", False)
    >>> two = CausePrior({offset: one[:, :1], tilt: one[:, 1:2]}, one[:, 4:], noisy=False)
    >>> found = two.posterior("all", 20.0 * one[0] + 99.0 * one[1]).hypotheses
    >>> sorted({tuple(f.name for f in h.causes) for h in found if len(h.causes) == 2})
    [('tilt', 'none of these'), ('tilt', 'offset')]

    And it alone where it suffices.

    >>> beside = {offset: one[:, :1] + 0.4 * one[:, 1:2], tilt: one[:, :1]}
    >>> tilted = CausePrior(beside, one[:, 4:], noisy=False).posterior("all", 99.0 * one[0] + 6.0 * one[1])
    >>> [cause.name for cause in tilted.best.causes]
    ['tilt']

    Nor is a cause named that makes less than half of a change.

    >>> half = {noisy: CausePrior({offset: one[:, :1]}, one[:, 4:], noisy=noisy) for noisy in (True, False)}
    >>> [half[noisy].posterior("all", 1.2 + 5.8 * one[0]).first_cause for noisy in half]
    ['offset', 'none of these']
    """

    def __init__(self, columns: Mapping[Candidate, Array], wide: Array, *, noisy: bool = True):
        self.columns, self.wide, self.noisy = columns, wide, noisy
        kinds = Counter(prior_group(c.name) for c in columns)
        share = (1.0 - NOTHING_PRIOR - NONE_PRIOR) / max(len(kinds), 1)
        self.prior = {c: np.log(share / kinds[prior_group(c.name)]) for c in columns} | {UNKNOWN: np.log(NONE_PRIOR)}
        self._effects = [build_effect(c, g) for c, g in columns.items()]
        self._together = np.column_stack([*columns.values(), wide])
        self._ends = np.cumsum([g.shape[1] for g in columns.values()])
        self._none = Directions(UNKNOWN, wide)

    def posterior(self, group: str, e: Array) -> Posterior:
        """Posterior of whitened residuals (n,)."""
        total = float(e @ e)
        singles = sorted((effect.fit(e) for effect in self._effects), key=self._sort_key)
        found = [Hypothesis((), float(np.log(NOTHING_PRIOR)), (total,))]
        found += [self._extend(None, fit, e, total) for fit in (*singles, self._none.fit(e))]
        # Chi-square that each leaves by itself, or nothing does; not of what could make anything, or no candidate.
        specific = [h for h in found[:-1] if not any(f.candidate.fits_any_spectrum for f in h.causes)]
        alone = {h.first_cause: h.chi_squares[0] for h in specific}
        beam = [h for h in sorted(found, key=lambda h: -h.weight) if h.causes and h.causes[-1].candidate is not UNKNOWN]
        beam = [h for h in beam[:MAX_FIRST] if h.weight > found[0].weight]
        for _ in range(MAX_CAUSES - 1):
            longer = [more for h in beam for more in self._extensions(h, e)]
            found += longer
            beam = [h for h in sorted(longer, key=lambda h: -h.weight)[:1] if h.causes[-1].candidate is not UNKNOWN]
        if not self.noisy:  # a cause of a change makes most of it
            part = [h.first_cause in (NOTHING, NONE) or h.chi_squares[-1] <= MAX_LEFT * total for h in found]
            found = [h if most else replace(h, weight=h.weight - total) for h, most in zip(found, part, strict=True)]
        found.sort(key=lambda h: -h.weight)
        found = [self._reorder(h, e, alone) if h.weight > found[0].weight - CLOSE else h for h in found]
        logs = np.array([h.weight for h in found])
        weights = np.exp(logs - np.logaddexp.reduce(logs))
        probability = dict.fromkeys((NOTHING, NONE, *(f.name for f in singles)), 0.0)
        for h, weight in zip(found, weights, strict=True):
            probability[h.first_cause] += float(weight)
        p_value = float(scipy.stats.chi2.sf(total, e.size))
        confounded = self._confounded(singles, probability, alone)
        return Posterior(group, total, e.size, p_value, tuple(singles), tuple(found), probability, confounded)

    def simulate(self, rng: np.random.Generator, times: int) -> Iterator[tuple[str, Posterior]]:
        """Worlds with one cause each, from half to five times what can just be seen, with what none describes, and with
        nothing.

        Yields
        ------
        What was put in, a candidate's kind, and what is said of it.
        """
        n = len(self.wide)
        of_kind: dict[str, list[Effect]] = grouped(self._effects, lambda effect: prior_group(effect.candidate.name))
        for _ in range(times):
            for kind in (*of_kind, NONE, NOTHING):
                size = 0.0 if kind == NOTHING else DETECTABLE_LENGTH * np.exp(rng.uniform(np.log(0.5), np.log(5.0)))
                rough = 0.1 * np.linalg.norm(self.wide) * rng.normal(size=n)
                made = self.wide @ rng.normal(size=self.wide.shape[1]) + rough
                made *= size / np.linalg.norm(made)
                if effects := of_kind.get(kind):
                    made = effects[rng.integers(len(effects))].draw(rng, size)
                if size == 0.0 or np.linalg.norm(made) >= 0.5 * DETECTABLE_LENGTH:
                    yield kind, self.posterior(ALL, made + rng.normal(size=n))

    def _sort_key(self, fit: Fit) -> tuple[bool, float, str]:
        """Of inputs that explain the same, rounding shall not say which comes first."""
        return fit.limited, -float(f"{fit.evidence + self.prior[fit.candidate]:.6g}"), fit.name

    def _extend(self, before: Hypothesis | None, fit: Fit, e: Array, total: float) -> Hypothesis:
        """One cause more, of residuals e that those before have been taken from; ``total`` is the chi-square of all."""
        prior = self.prior[fit.candidate]
        # Bands that are off by themselves are few, by their participation ratio: many are a pattern without a name.
        z2 = fit.amplitudes**2
        few = max(3.0, 0.1 * z2.size) * float(np.sum(z2**2))
        many = not self.noisy and fit.name == SINGLE_BANDS and float(np.sum(z2)) ** 2 > few
        if fit.limited or many:  # at its bound it is no reason
            prior = prior - float(e @ e)
        rest = _rewhiten(fit, e - fit.made)
        causes, weight, chi2 = (before.causes, before.weight, before.chi_squares) if before else ((), 0.0, ())
        if not self.noisy and fit.candidate is UNKNOWN and chi2 and chi2[-1] > REMAINDER * total:
            causes, chi2 = (), ()
        return Hypothesis((*causes, fit), weight + fit.evidence + float(prior), (*chi2, float(rest @ rest)))

    def _remove_causes(self, causes: Sequence[Fit], e: Array) -> tuple[Array, dict[Candidate, Array]]:
        """Residuals that some causes have been taken from, and what others and no candidate would do to them."""
        columns = self._together
        for fit in causes:
            e, columns = _rewhiten(fit, e - fit.made), _rewhiten(fit, columns)
        return e, dict(zip([*self.columns, UNKNOWN], np.split(columns, self._ends, axis=1), strict=True))

    def _extensions(self, h: Hypothesis, e: Array) -> Iterator[Hypothesis]:
        """The hypothesis with each further cause."""
        if special.chdtrc(e.size, h.chi_squares[-1]) <= SUFFICES:
            rest, columns = self._remove_causes(h.causes, e)
            for candidate, g in columns.items():
                if all(candidate is not f.candidate for f in h.causes):
                    yield self._extend(h, build_effect(candidate, g).fit(rest), rest, float(e @ e))

    def _reorder(self, h: Hypothesis, e: Array, alone: Mapping[str, float]) -> Hypothesis:
        """The same causes: what befalls all subjects before what befalls one, where it explains a good part; of a
        change, what leaves least ``alone``, and after it no more than is needed.

        What could make anything, or no candidate describes, comes last:

        >>> tilt, bands = (Candidate(name, "sensor", "1 %", False) for name in ("tilt", "single bands"))
        >>> prior = CausePrior({bands: np.eye(40), tilt: np.ones((40, 1))}, np.eye(40)[:, 4:], noisy=False)
        >>> [f.name for f in prior.posterior("all", 30.0 + 40.0 * np.eye(40)[3]).best.causes]
        ['tilt', 'single bands']
        """
        rank = [f.candidate.kind not in SHARED if self.noisy else alone.get(f.name, np.inf) for f in h.causes]
        order = [f for _, f in sorted(zip(rank, h.causes, strict=True), key=lambda pair: float(pair[0]))]
        if not order or order[0] is h.causes[0]:
            return h
        causes, chi2 = tuple[Fit, ...](), [float(e @ e)]
        for cause in order:
            if self.noisy or special.chdtrc(e.size, chi2[-1]) <= SUFFICES:
                rest, columns = self._remove_causes(causes, e)
                causes += (build_effect(cause.candidate, columns[cause.candidate]).fit(rest),)
                rest = _rewhiten(causes[-1], rest - causes[-1].made)
                chi2.append(float(rest @ rest))
        good = chi2[0] - chi2[1] > GOOD_PART * (chi2[0] - h.chi_squares[-1]) and not causes[0].limited
        return Hypothesis(causes, h.weight, tuple(chi2[1:])) if good else h

    def _confounded(
        self, singles: Sequence[Fit], probability: Mapping[str, float], alone: Mapping[str, float]
    ) -> tuple[str, ...]:
        """Candidates whose odds are near those of the first, or whose effects correlate with its effect.

        >>> a, b, c = (Candidate(name, "input", "1 %", False, sizes=(-20.0, 25.0)) for name in "abc")
        >>> columns = {one: np.outer(effect, one.sizes) for one, effect in ((a, np.ones(9)), (b, np.ones(9)))}
        >>> columns[c] = np.outer(np.arange(9.0), c.sizes)
        >>> found = CausePrior(columns, np.eye(9)).posterior("all", 3.0 + np.cos(np.arange(9.0)))
        >>> found.first_cause, found.confounded
        ('a', ('b',))

        A candidate that leaves nearly as little of a change by itself is confounded too.

        >>> wave = Candidate("wave", "input", "1 %", False)
        >>> nearly = {a: columns[a], wave: np.column_stack([np.ones(9), np.cos(np.arange(9.0))])}
        >>> change = 20.0 + 0.6 * np.cos(2.0 * np.arange(9.0))
        >>> [CausePrior(nearly, np.eye(9), noisy=noisy).posterior("all", change).confounded for noisy in (True, False)]
        [(), ('wave',)]
        """
        first = max(probability, key=lambda name: probability[name])
        if (best := next((f for f in singles if f.name == first), None)) is None:
            return ()
        near = {f.name for f in singles if probability[f.name] * CONFOUNDED_ODDS > probability[first]}
        for f in singles:
            one = f.amplitudes.size == best.amplitudes.size == 1 and f.evidence > 0.5 * best.evidence
            lengths = float(np.linalg.norm(f.shown) * np.linalg.norm(best.shown))
            if one and abs(float(f.shown @ best.shown)) > CORRELATED * lengths:
                near.add(f.name)
        if not self.noisy:  # a change has no noise: what explains it nearly as well by itself is as good a cause
            chi2 = {f.name: alone[f.name] for f in singles if f.name in alone and not f.limited}
            most = min(CONFOUNDED_ODDS * chi2.get(first, 0.0), REMAINDER * alone[NOTHING])
            near |= {name for name, rest in chi2.items() if rest <= most}
        return tuple(f.name for f in singles if f.name in near and f is not best)


DETECTABLE_LENGTH = 3.6  # length of a whitened effect that a directed test sees in 95 % of cases
SUFFICES = 0.3  # of a cause that leaves less than chance does, no second one is looked for


def prior_group(name: str) -> str:
    """Candidates of one kind share its prior; light and its paths are known better than a user's own work."""
    return "light" if name in LIGHT else name if name == NONE else name.partition(" of ")[0]


def _rewhiten(fit: Fit, x: Array) -> Array:
    """Columns (n,) or (n, k) in units of an uncertainty that holds the freed directions of a cause."""
    less = 1.0 - np.sqrt(fit.factor2 / (fit.factor2 + fit.variances))
    return np.asarray((x - fit.freed @ ((fit.freed.T @ x).T * less).T) / np.sqrt(fit.factor2))


class Residuals(NamedTuple):
    """Residuals (n,), observed minus predicted, with their covariance (n, n); what candidates, (n, k) each, and no
    candidate, (n, K), would do to them.
    """

    values: Array
    covariance: Array
    columns: Mapping[Candidate, Array]
    wide: Array

    def subset(self, entries: Index) -> Residuals:
        """The residuals of some entries, with the candidates that move these."""
        moved = {c: g[entries] for c, g in self.columns.items() if _is_moved(g[entries], g)}
        return Residuals(self.values[entries], self.covariance[np.ix_(entries, entries)], moved, self.wide[entries])

    def whitened(self, noisy: bool = True) -> tuple[CausePrior, Array]:
        """What is known of their causes, and themselves, in units of their uncertainty."""
        data = Whitened(self.values, self.covariance)
        columns = {c: data.whiten(g) for c, g in self.columns.items()}
        return CausePrior(columns, data.whiten(self.wide), noisy=noisy), data.residual

    def posterior(self, group: str, noisy: bool = True) -> Posterior:
        """Posterior of their causes."""
        prior, residual = self.whitened(noisy)
        return prior.posterior(group, residual)

    def posteriors(self, stack: Stack, each: Sequence[str]) -> list[Posterior]:
        """Of all residuals, of what spectra share or differ in, and of the subjects of ``each``.

        A gain that all subjects share is no reason for what differs between them:

        >>> from hyperval.attribute import ResidualBlock
        >>> level, noise = np.array([1.0, 2.0, 3.0, 1.5, 1.0, 0.5]), 0.01 * np.random.default_rng(1).normal(size=6)
        >>> measured, half = level + level * noise, (("lawn", slice(0, 3)), ("lot", slice(3, 6)))
        >>> blocks = [
        ...     ResidualBlock("radiance", n, "", measured[i], np.diag(1e-4 * level[i] ** 2), len, np.arange(3))
        ...     for n, i in half
        ... ]
        >>> stack, gain = Stack(tuple(blocks)), Candidate("gain", "sensor", "1 %", False, sizes=(-20.0, 25.0))
        >>> columns = {gain: np.outer(0.01 * level, gain.sizes)}
        >>> residuals = Residuals(level * noise, stack.covariance, columns, 0.1 * np.diag(level))
        >>> found = residuals.posteriors(stack, [])
        >>> [(posterior.group, [fit.name for fit in posterior.fits]) for posterior in found]
        [('all', ['gain']), ('what all subjects share', ['gain']), ('what differs between subjects', [])]
        """
        parts: list[Posterior] = []
        # Of the prediction: of what was measured, any factor below 1 on it would leave less of what differs.
        spectra, common = stack.common_bands(stack.observed - self.values)
        if common.size and len(spectra) > common.shape[1]:
            parts = [some.posterior(name) for name, some in common_and_individual(common, self.subset(spectra)).items()]
        out = [replace(self.posterior(ALL), parts=tuple(parts)), *parts]
        subjects = [s for s in dict.fromkeys(b.subject for b in stack.blocks) if any(fnmatchcase(s, p) for p in each)]
        named = stack.entry_labels("subject")  # with the background seen through its filter
        out += [self.subset(np.flatnonzero(np.isin(named, [s, background_of(s)]))).posterior(s) for s in subjects]
        return [replace(r, level=ENOUGH / len(out)) for r in out]


def common_and_individual(common: Array, residuals: Residuals) -> dict[str, Residuals]:
    """What is common to all subjects, and what differs between them: two independent parts of the residuals.

    The common part is the generalised least-squares estimate of one factor for each band; the other is what no such
    factor can make, N^T r with the columns of N orthogonal to ``common``.  The two do not correlate.

    Parameters
    ----------
    common : (m, K) what a unit of each band's factor does
    residuals : those of the spectra
    """
    basis, _ = linalg.qr(common)
    rest = basis[:, common.shape[1] :]
    weighted = linalg.solve(residuals.covariance, common, assume_a="pos")
    spread = linalg.inv(common.T @ weighted)
    spread = 0.5 * (spread + spread.T)
    estimate = spread @ weighted.T
    out = {}
    for name, m, c in ((COMMON, estimate, spread), (DIFFERENT, rest.T, rest.T @ residuals.covariance @ rest)):
        moved = {candidate: m @ g for candidate, g in residuals.columns.items()}
        kept = {k: g for k, g in moved.items() if _is_moved(g, residuals.columns[k])}
        out[name] = Residuals(m @ residuals.values, c, kept, m @ residuals.wide)
    return out


def _is_moved(part: Array, whole: Array) -> bool:
    """Whether a change in some residuals is more than rounding beside that in all of them."""
    return bool(np.max(np.abs(part), initial=0.0) > 1e-9 * np.max(np.abs(whole), initial=0.0))
