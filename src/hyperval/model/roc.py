"""The ROC of the model from score statistics, a row for each evaluation (3.29-3.33), and readings of curves.

One threshold x serves the whole image: P_D(x) = Phi((theta_T - x)/sigma_T) and
P_FA(x) = sum f_m Phi((theta_m - x)/sigma_m).  Where a class has tails or clusters, its law replaces Phi, in its own
pixels and in those that a target fills in part.  All is in logarithms, valid at P_FA = 1e-9.

A pixel that a target fills in part is f target + (1 - f) host + noise.  A t law of nu degrees of freedom is a normal
law whose variance is multiplied by (nu - 2) / w, w chi-square of nu.  Given w all parts are normal (3.12, 3.26-3.31):

    P(score > x) = E_w Phi((theta - x) / sqrt(N + H (nu - 2) / w)),  H = (1 - f)^2 sigma_host^2

N is the rest of the variance (3.28).  At f = 0 this is the law that the class has in (3.33), at f = 1 a normal one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import numpy.typing as npt
from scipy.special import gammainccinv, gammaincinv, gammaln, log_ndtr, ndtr, ndtri, ndtri_exp, stdtr, stdtrit

from hyperval.data import Array, Index, Mask
from hyperval.errors import refuse
from hyperval.model.stated import unique
from hyperval.products import RocCurve, ScoreDistribution

MIN_SD = 1e-12


def probit(p: npt.ArrayLike) -> Array:
    """Phi^-1 of probabilities, kept finite."""
    return np.asarray(ndtri(np.clip(p, 1e-300, 1.0 - 1e-16)))


_LOG_ROOT_2PI = 0.5 * np.log(2.0 * np.pi)
_STEPS = 80
_FAR = 1e7  # standard deviations: beyond it even a t law of two degrees of freedom has less than 1e-14
_CHUNK = 16_384  # numbers of one array in the search for thresholds: they fit in the processor's cache
# A third-order step from closer than this to the goal (in log P) ends within 1e-14 of it.
_LAST_STEP, _MIN_CURVED = 1e-5, 1e-4


@dataclass(frozen=True)
class ClassScores:
    """Scores of M classes in R evaluations.

    Attributes
    ----------
    fraction : (R, M) f_m
    mean, sd : (R, M) theta_m, sigma_m of (3.27), (3.29)
    dof : (R, M) degrees of freedom of the tail; infinity: Gaussian
    """

    fraction: Array
    mean: Array
    sd: Array
    dof: Array

    def rows(self, index: Index) -> ClassScores:
        """The evaluations that ``index`` names."""
        return ClassScores(self.fraction[index], self.mean[index], self.sd[index], self.dof[index])

    def select_laws(self, laws: Index) -> ClassScores:
        """The classes that ``laws`` names."""
        return ClassScores(*(a[:, laws] for a in (self.fraction, self.mean, self.sd, self.dof)))


def false_alarm_grid(lowest: float = 1e-9, per_decade: int = 20) -> Array:
    """(K,) increasing, log-spaced false-alarm probabilities from ``lowest`` to 0.999 for (3.33)."""
    decades = -np.log10(lowest)
    grid = np.logspace(-decades, 0.0, round(decades * per_decade) + 1)
    grid[-1] = 0.999
    return grid


Laws = tuple[Array, Array, Array, Array, Array]


def _law_terms(scores: ClassScores, times: int = 1) -> Laws:
    """log f_m, theta_m, scale, log density at the centre, and degrees of freedom, (M, n) each: each evaluation repeated
    so many times, classes first, so that sums over them run along the memory.

    For a class with nu degrees of freedom the tail is 1 - F_t,nu((x - theta_m) / (sigma_m sqrt((nu-2)/nu))).
    """
    fraction, mean, sd, nu = (np.ascontiguousarray(a.T) for a in vars(scores).values())
    scale, tailed = np.maximum(sd, MIN_SD), np.isfinite(nu)
    peak = np.full(nu.shape, -_LOG_ROOT_2PI)
    if tailed.any():
        dof = nu[tailed]
        scale[tailed] *= np.sqrt((dof - 2.0) / dof)
        peak[tailed] = gammaln(0.5 * (dof + 1)) - gammaln(0.5 * dof) - 0.5 * np.log(dof * np.pi)
    with np.errstate(divide="ignore"):
        laws = np.log(fraction), mean, scale, peak - np.log(scale), nu
    return laws if times == 1 else tuple(np.repeat(a, times, axis=1) for a in laws)  # type: ignore[return-value]


def _log_tails(threshold: Array, laws: Laws) -> tuple[Array, Array, Array]:
    """log P(score > x), log of the density, and the slope of that, (M, n) each, at x (n,)."""
    _, mean, scale, peak, nu = laws
    z, tailed = (mean - threshold) / scale, np.isfinite(nu)
    tail, density, slope = log_ndtr(z), peak - 0.5 * z**2, z / scale
    if tailed.any():
        t, nu = z[tailed], nu[tailed]
        with np.errstate(divide="ignore"):
            tail[tailed] = np.log(stdtr(nu, t))
        density[tailed] = peak[tailed] - 0.5 * (nu + 1) * np.log1p(t**2 / nu)
        slope[tailed] = (nu + 1) * t / (nu + t**2) / scale[tailed]
    return tail, density, slope


def _log_false_alarm(threshold: Array, laws: Laws) -> tuple[Array, Array, Array]:
    """log P_FA(x) = log sum f_m P(score of class m > x) (3.33) and its two first derivatives (n,) at x (n,)."""
    tail, density, log_slope = _log_tails(threshold, laws)
    tail += laws[0]
    greatest = tail.max(axis=0)
    total = greatest + np.log(np.exp(tail - greatest).sum(axis=0))  # (3.33)
    part = np.exp(density + laws[0] - total)
    slope = -part.sum(axis=0)
    return total, slope, -(part * log_slope).sum(axis=0) - slope**2


def log_false_alarm(threshold: Array, scores: ClassScores) -> tuple[Array, Array]:
    """log P_FA(x) = log sum f_m P(score of class m > x) (3.33, one threshold for the image), and its derivative.

    Parameters
    ----------
    threshold : (R,) x, one for each row [1]

    Returns
    -------
    (R,) natural logarithms, and (R,) their derivatives by x
    """
    return _log_false_alarm(threshold, _law_terms(scores))[:2]


def greatest_class_false_alarm(threshold: Array, scores: ClassScores) -> Array:
    """(R,) max_m P(score of class m > x): the preset of (3.30) whose least P_D (3.32) has threshold x (R,).

    At x = max_m x_m(P) the class with the longest tail gives P and all others less.  A curve drawn against P is (3.32)
    without (3.33), as if the worst class covered the image.
    """
    tail, _, _ = _log_tails(threshold, _law_terms(scores))
    return np.asarray(np.exp(np.where(scores.fraction.T > 0, tail, -np.inf).max(axis=0)))


def score_density(score: Array, scores: ClassScores) -> Array:
    """Density of the background's score at scores (R, K), sum f_m p_m(x) [per unit of score].

    The derivative of (3.33).
    """
    laws = _law_terms(scores, score.shape[1])
    _, density, _ = _log_tails(score.ravel(), laws)
    return np.asarray(np.exp(density + laws[0]).sum(axis=0).reshape(score.shape))


def thresholds_at(pfa: Array, scores: ClassScores) -> Array:
    """Thresholds (R, K) at which the background gives ``pfa`` (R, K) (inverse of 3.33).

    NaN for evaluations without scores, or with a probability outside 0-1.

    Raises
    ------
    UsageError : all area fractions are 0.
    """
    refuse(not np.any(scores.fraction > 0, axis=1).all(), "roc.fraction")
    finite = np.isfinite(scores.mean).all(axis=1) & np.isfinite(scores.sd).all(axis=1)
    rows, roots = np.flatnonzero(finite & np.all((pfa > 0) & (pfa <= 1), axis=1)), np.full(pfa.shape, np.nan)
    chunk = max(1, _CHUNK // max(1, pfa.shape[1] * scores.fraction.shape[1]))
    for start in range(0, rows.size, chunk):
        chunk_rows = rows[start : start + chunk]
        roots[chunk_rows] = _thresholds(np.log(pfa[chunk_rows]), scores.rows(chunk_rows))
    return roots


def _thresholds(log_pfa: Array, scores: ClassScores) -> Array:
    """Bracketed in closed form: at max_m x_m(P) no class exceeds P; at the largest x_m(P / f_m) one class gives P.
    Then by third-order (Halley) steps, and bisection where they leave the bracket.
    """
    used = scores.fraction.T[:, :, None] > 0
    with np.errstate(divide="ignore"):
        share = log_pfa - np.log(scores.fraction.T[:, :, None])
    classes = range(len(used))
    class_x = np.array([class_threshold(log_pfa, scores, m) for m in classes])
    single_x = np.array([class_threshold(np.minimum(share[m], -1e-300), scores, m) for m in classes])
    low, high = np.where(used, class_x, np.inf).min(axis=0), np.where(used, class_x, -np.inf).max(axis=0)
    low = np.minimum(np.maximum(low, np.where(used & (share < 0), single_x, -np.inf).max(axis=0)), high).ravel()
    high, target, laws = high.ravel(), log_pfa.ravel(), _law_terms(scores, log_pfa.shape[1])
    x, roots, active = low, low.copy(), np.arange(target.size)  # those not yet there
    for _ in range(_STEPS):
        value, slope, curvature = _log_false_alarm(x, laws)
        value -= target
        low, high = np.where(value > 0, x, low), np.where(value > 0, high, x)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = x - 2.0 * value * slope / (2.0 * slope**2 - value * curvature)
        bracketed = (step > low) & (step < high)  # False for NaN
        final = bracketed & (np.abs(value) < _LAST_STEP) & (np.abs(value * curvature) < _MIN_CURVED * slope**2)
        roots[active] = np.where(final, step, x)
        unfinished = ~final & (np.abs(value) > 1e-12) & (high - low > 1e-14 * np.maximum(1.0, np.abs(x)))
        if not unfinished.any():
            break
        x = np.where(bracketed, step, 0.5 * (low + high))[unfinished]
        active, low, high, target = active[unfinished], low[unfinished], high[unfinished], target[unfinished]
        laws = tuple(a[:, unfinished] for a in laws)  # type: ignore[assignment]
    return np.asarray(roots.reshape(log_pfa.shape))


def class_threshold(log_pfa: Array, scores: ClassScores, m: int) -> Array:
    """x_m = theta_m - sigma_m Phi^-1(P_FA) (R, K): threshold at which class m alone gives P_FA (R, K) (3.30).

    The printed form has the opposite sign of Phi^-1, which puts the threshold below the class mean for P_FA < 0.5.
    """
    mean, sd, nu = (a[:, m, None] for a in (scores.mean, scores.sd, scores.dof))
    # Most batches have the same probabilities in all rows: one quantile serves them.
    shared = bool(np.all(log_pfa == log_pfa[:1]))
    x: Array = mean - sd * ndtri_exp(log_pfa[:1] if shared else log_pfa)  # (3.30)
    t = np.isfinite(nu[:, 0])
    if t.any():
        quantile = stdtrit(nu[t], np.exp(log_pfa[:1] if shared else log_pfa[t]))
        x[t] = mean[t] - sd[t] * np.sqrt((nu[t] - 2.0) / nu[t]) * quantile
    return x


# The trapezoid rule in ln w converges as e^(-10 / step), the step in units of the exponent or of its standard
# deviation; beyond its ends lies the probability _BEYOND: P from 0.5 to 1e-8 is right to 1e-7.
_STEP, _STEP_OF_SD, _BEYOND = 0.4, 0.8, 1e-16
# More fills than nodes are interpolated between these: P_D within 0.1 %.
_NODES, _CHUNK_LAWS = 24, 100_000


def chi_square_mixing(dof: Array) -> tuple[Array, Array]:
    """(n, Q) values of (nu - 2) / w and their probabilities (3.31), w chi-square of ``dof`` (n,); 1: a normal law.

    >>> factor, probability = chi_square_mixing(np.array([5.0]))
    >>> round(float((factor * probability).sum()), 6)
    1.0
    """
    tailed = np.isfinite(dof)
    if not tailed.any():
        return np.ones((dof.size, 1)), np.ones((dof.size, 1))
    half = 0.5 * np.where(tailed, dof, 4.0)[:, None]
    low, high = (np.log(2.0 * end(half, _BEYOND)) for end in (gammaincinv, gammainccinv))
    steps = np.ceil((high - low) / np.minimum(_STEP, _STEP_OF_SD / np.sqrt(half)))
    part = np.minimum(np.arange(steps[tailed].max() + 1.0) / steps, 1.0)
    y = low + (high - low) * part
    weight = np.exp(half * (y - np.log(2.0)) - 0.5 * np.exp(y) - gammaln(half))
    weight[:, 1:][part[:, :-1] == 1.0] = 0.0  # each row has its own number of steps
    weight /= weight.sum(axis=1, keepdims=True)
    return np.where(tailed[:, None], 2.0 * (half - 1.0) * np.exp(-y), 1.0), weight


def host_part(total: Array, share: Array, law: Array, whole: Array) -> tuple[Array, Array]:
    """Variance of a score for one law of the host's pixels, and its part that has the tails of that law (3.28).

    Parameters
    ----------
    total : variance with the host's class as a whole (3.28)
    share : of the host, 1 - f
    law, whole : variances of a pixel of host alone, of that law and of the class (3.29)
    """
    total = np.maximum(total + share**2 * (law - whole), 0.0)
    return total, np.minimum(share**2 * law, total)


@dataclass(frozen=True)
class Host:
    """The class that fills the pixels beside the target, in n evaluations.

    Attributes
    ----------
    share : (n or 1, J) its part of the pixel, 1 - f
    mean, variance : (n,) score of its pixels alone (3.27, 3.29)
    laws : its C components; ``fraction`` (n, C) are their parts of the class
    """

    share: Array
    mean: Array
    variance: Array
    laws: ClassScores

    def rows(self, index: Index) -> Host:
        """The evaluations that ``index`` names."""
        share = self.share if self.share.shape[0] == 1 else self.share[index]
        return Host(share, self.mean[index], self.variance[index], self.laws.rows(index))

    @property
    def is_normal(self) -> Mask:
        """(n,) whether the class is one normal law."""
        one = self.laws.dof.shape[1] == 1
        return np.isinf(self.laws.dof[:, 0]) if one else np.zeros(self.mean.size, dtype=bool)

    def components(self, means: Array, sds: Array) -> Iterator[tuple[Array, ...]]:
        """Pixels of mean and standard deviation (n, J) by the law of their host: probability (n,), mean, normal and
        tailed variance (n, J), and degrees of freedom (n,).
        """
        for fraction, mean, sd, dof in zip(*(a.T for a in vars(self.laws).values()), strict=True):
            total, tailed = host_part(sds**2, self.share, sd[:, None] ** 2, self.variance[:, None])
            offset = self.share * (mean - self.mean)[:, None]
            yield fraction, means + offset, total - tailed, tailed, dof

    def exceedance(self, threshold: Array, means: Array, sds: Array, *, density: bool = False) -> Array:
        """(n, K, J) P(score > x) of pixels at x (n, K), or the density of their score there (3.31)."""
        result = np.zeros((*threshold.shape, means.shape[1]))
        for part, mean, normal, tailed, dof in self.components(means, sds):
            distance = mean[:, None, :] - threshold[:, :, None]
            for factor, probability in zip(*(a.T[:, :, None] for a in chi_square_mixing(dof)), strict=True):
                sd = np.sqrt(np.maximum(normal + tailed * factor, MIN_SD**2))[:, None, :]
                weight = (part[:, None] * probability)[:, :, None]
                z = distance / sd
                value = np.exp(-0.5 * z**2) / (np.sqrt(2.0 * np.pi) * sd) if density else ndtr(z)
                result += weight * value  # (3.31)
        return result

    def interpolated_exceedance(self, threshold: Array, means: Array, sds: Array) -> Callable[[slice], Array]:
        """The same for many fills, interpolated in probit between nodes: slice of thresholds -> (n, k, J).

        >>> share = np.append(np.linspace(0.011815697982720898, 0.9997432737033439, 2000), np.ones(5))
        >>> laws, means = ClassScores(*np.array([1.0, 0.0, 1.0, 5.0])[:, None, None]), np.ones((1, 2005))
        >>> host, means[:, 2000:] = Host(share[None], np.zeros(1), np.ones(1), laws), -np.inf  # no pixels
        >>> x, sds = np.array([[0.5, 2.0]]), np.ones((1, 2005))
        >>> read = host.interpolated_exceedance(x, means, sds)(slice(None))
        >>> bool(np.abs(read - host.exceedance(x, means, sds)).max() < 1e-3)
        True
        """
        from scipy.interpolate import PchipInterpolator, PPoly  # a quarter of a second, which single fills do not need

        first, group = unique([self.share], len(self.share))
        group, curves = np.broadcast_to(group, len(means)), []
        for number, share in enumerate(self.share[first]):
            rows = np.flatnonzero(group == number)
            order = np.argsort(share)
            order = order[~np.isneginf(means[rows][:, order]).any(axis=0)]
            low, high = share[order[[0, -1]]]
            spaced = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(np.linspace(0.0, np.pi, _NODES))
            chosen = order[np.searchsorted(share[order], spaced).clip(0, order.size - 1)]
            chosen = chosen[np.unique(share[chosen], return_index=True)[1]]
            subset, index = replace(self.rows(rows), share=share[None, chosen]), np.ix_(rows, chosen)
            p = subset.exceedance(threshold[rows], means[index], sds[index])
            z, nodes = np.nan_to_num(probit(p)), share[chosen]
            single = nodes.size == 1
            curve = PPoly([[z[:, :, 0]]], nodes[0] + [0.0, 1.0]) if single else PchipInterpolator(nodes, z, axis=2)
            curves.append((rows, share, curve.c, curve.x))

        def read(part: slice) -> Array:
            values = np.empty((means.shape[0], threshold[:, part].shape[1], means.shape[1]))
            for rows, share, coefficients, nodes in curves:
                values[rows] = ndtr(PPoly.construct_fast(coefficients[..., part], nodes, axis=2)(share))
            values[np.isnan(means[:, 0])] = np.nan
            values.transpose(0, 2, 1)[np.isneginf(means)] = 0.0
            return values

        return read


def _exceedance(threshold: Array, means: Array, sds: Array, host: Host | None) -> Iterator[tuple[slice, Array]]:
    """Slices of thresholds, and (n, k, J) P(score > x) there, of pixels (n, J) at x (n, K) (3.31)."""
    read = host.interpolated_exceedance(threshold, means, sds) if host is not None and means.shape[1] > _NODES else None
    chunk = max(1, _CHUNK_LAWS // means.size)
    for start in range(0, threshold.shape[1], chunk):
        part = slice(start, start + chunk)
        if read is not None:
            yield part, read(part)
        elif host is not None:
            yield part, host.exceedance(threshold[:, part], means, sds)
        else:
            z = (means[:, None] - threshold[:, part, None]) / np.maximum(sds, MIN_SD)[:, None]
            yield part, ndtr(z)  # (3.31)


_SAME = 1e-9  # relative: a point of the curve itself


def detection_at(curve: RocCurve, pfa: npt.ArrayLike, values: Array | None = None) -> Array:
    """P_D at false-alarm probabilities ``pfa`` (...,); NaN outside the curve (3.33) [1].

    At a point of the curve its value; between two points linear in the probit of P_D against that of P_FA, as
    curves of normal scores are.  Where one of them is 0 or 1, which has no probit, P_D is linear in log P_FA.

    Parameters
    ----------
    curve : with ``pfa`` in rising order
    values : (K,) in place of P_D, such as a limit of it [1]

    Examples
    --------
    >>> curve = RocCurve(ndtr([-3.0, -1.0]), ndtr([-1.0, 1.0]), np.zeros(2), np.ones(2), np.zeros(2))
    >>> round(float(detection_at(curve, float(ndtr(-2.0)))), 9)
    0.5
    """
    grid, x = np.asarray(curve.pfa, dtype=float), np.asarray(pfa, dtype=float)
    y = np.asarray(curve.pd if values is None else values, dtype=float)
    if not grid.size:
        return np.full(x.shape, np.nan)
    upper = np.minimum(np.clip(np.searchsorted(grid, x, side="left"), 1, None), grid.size - 1)
    lower = np.maximum(upper - 1, 0)

    def share(scale: Callable[[Array], Array]) -> Array:
        """Position of ``pfa`` between the two points on a scale, 0 to 1."""
        low = scale(grid[lower])
        return np.clip((scale(x) - low) / (scale(grid[upper]) - low), 0.0, 1.0)

    with np.errstate(divide="ignore", invalid="ignore"):
        low, high, weight = y[lower], y[upper], share(ndtri)
        probit_pd = ndtr((1.0 - weight) * ndtri(low) + weight * ndtri(high))
        log_pd = low + share(np.log) * (high - low)
    ends = np.stack([low, high, grid[lower], grid[upper]])
    pd = np.where(np.all((ends > 0.0) & (ends < 1.0), axis=0), probit_pd, log_pd)
    for index in (lower, upper):  # at points of the curve; of equal ones the last, with the greatest P_D
        pd = np.where(np.abs(grid[index] - x) <= _SAME * x, y[index], pd)
    covered = (x >= grid[0] * (1.0 - _SAME)) & (x <= grid[-1] * (1.0 + _SAME))
    return np.asarray(np.where(covered, pd, np.nan))


def log10_false_alarm_at(curve: RocCurve, pd: float, values: Array) -> float:
    """log10 P_FA at which ``values`` (K,), P_D or a limit of it, reach ``pd``, linear in probit; NaN outside."""
    x, y = probit([curve.pfa, np.maximum.accumulate(np.nan_to_num(values))])
    return float(np.log10(ndtr(np.interp(ndtri(pd), y, x, np.nan, np.nan))))


def detection_probability(
    threshold: Array, means: Array, sds: Array, weights: Array, host: Host | None = None
) -> Array:
    """P_D(x) = sum_k w_k [1 - prod_j (1 - Phi((theta_kj - x) / sigma_kj))] (3.31 with 1/sigma_T, exact over the fill).

    At least one of the J pixels of an object passes the threshold; they are independent given their fills.  Of single
    pixels it is sum_k w_k Phi((theta_k - x) / sigma_k).

    Parameters
    ----------
    threshold : (n, K) x
    means, sds : (n, P) score statistics at P fills, or (n, P, J) of the J pixels of an object at P places, a mean of
        minus infinity where it has fewer
    weights : (n, P) probabilities of these
    host : the class that fills the rest of the pixels, its share (n or 1, P J); None: one normal law

    Returns
    -------
    (n, K)
    """
    pd, shape = np.empty(threshold.shape), (len(means), means.shape[1], -1)
    for part, above in _exceedance(threshold, means.reshape(len(means), -1), sds.reshape(len(sds), -1), host):
        passed, *pixels = np.moveaxis(above.reshape(*above.shape[:2], *shape[1:]), 3, 0)  # (J, n, k, P)
        for pixel in pixels:
            passed = passed + pixel * (1.0 - passed)  # small probabilities keep their digits
        pd[:, part] = np.matmul(passed, weights[:, :, None])[:, :, 0]  # (3.31)
    return np.asarray(np.clip(pd, 0.0, 1.0))


@dataclass(frozen=True)
class RocArea:
    """Area over P_FA from ``low`` to ``high``, evenly in P_FA or, ``logarithmic``, in its logarithm."""

    low: float = 0.0
    high: float = 1.0
    logarithmic: bool = False

    def __post_init__(self) -> None:
        wrong = not 0.0 <= self.low < self.high <= 1.0 or (self.logarithmic and self.low <= 0.0)
        refuse(wrong, "roc.range", low=self.low, high=self.high)

    def weight(self, s: Array) -> Array:
        """g(s): the part of the range in which a target is declared that a share ``s`` of the background outscores."""
        x = np.clip(s, self.low, self.high)
        if self.logarithmic:
            return np.asarray(np.log(self.high / x) / np.log(self.high / self.low))
        return np.asarray((self.high - x) / (self.high - self.low))

    def integral(self, s: Array) -> Array:
        """Integral of g from 0 to s."""
        a, b = self.low, self.high
        x = np.clip(s, a, b)
        if self.logarithmic:
            partial = (x * (np.log(b / x) + 1.0) - a * (np.log(b / a) + 1.0)) / np.log(b / a)
        else:
            partial = (b * (x - a) - (x**2 - a**2) / 2.0) / (b - a)
        return np.asarray(np.minimum(s, a) + partial)

    def averaged(self, over: Array, tie: Array) -> Array:
        """Mean of g along a tie that goes from ``over`` to ``over + tie``."""
        no_tie = tie <= 0.0
        step = np.where(no_tie, 1.0, tie)
        mean = (self.integral(over + tie) - self.integral(over)) / step
        return np.clip(np.where(no_tie, self.weight(over), mean), 0.0, 1.0)  # against rounding


WHOLE = RocArea()


# The areas of the results table; each name states its range.
AREAS = {
    "auc": WHOLE,
    "partial_auc@0..1e-1": RocArea(0.0, 0.1),
    "log_auc@1e-3..1e-1": RocArea(1e-3, 0.1, logarithmic=True),
}


@dataclass(frozen=True)
class RocScores:
    """Score statistics for the ROC of n evaluations.

    Attributes
    ----------
    classes : of the distinct backgrounds;  which : (n,) number of that of each evaluation
    means, sds : (n, P) of the target pixels over their fills, or (n, P, J) of the J pixels of an object at P places
    weights : (n, P) probabilities of these
    host : the class that fills the rest of these pixels; None: one normal law in all evaluations
    """

    classes: ClassScores
    which: Index
    means: Array
    sds: Array
    weights: Array
    host: Host | None = None

    def rows(self, index: Index) -> RocScores:
        """The evaluations that ``index`` names."""
        host = None if self.host is None else self.host.rows(index)
        if host is not None and host.is_normal.all():
            host = None
        return RocScores(self.classes, self.which[index], self.means[index], self.sds[index], self.weights[index], host)

    def thresholds(self, pfa: Array) -> Array:
        """(n, K) thresholds at ``pfa`` (n, K) or (1, K)."""
        if pfa.shape[0] > 1:
            return thresholds_at(pfa, self.classes.rows(self.which))
        return thresholds_at(np.broadcast_to(pfa, (len(self.classes.mean), pfa.shape[1])), self.classes)[self.which]

    def detection_above(self, thresholds: Array) -> Array:
        """P_D (n, K) above ``thresholds`` (n, K) (3.31), once for evaluations with equal scores.

        >>> one, dof = np.ones((2, 1)), np.array([[np.inf], [4.0]])  # the host of the second has tails
        >>> classes = ClassScores(one, 0.0 * one, one, dof)
        >>> host = Host(0.5 * one, np.zeros(2), np.ones(2), classes)
        >>> RocScores(classes, np.arange(2), one, one, one, host).detection_above(4.0 * one).round(6).tolist()
        [[0.00135], [0.002176]]
        """
        first, group = unique([self.means, self.sds, self.weights, self.which, thresholds], self.which.size)
        pd, subset, x = np.empty((first.size, thresholds.shape[1])), self.rows(first), thresholds[first]
        normal = np.ones(first.size, dtype=bool) if subset.host is None else subset.host.is_normal
        for rows in filter(np.size, (np.flatnonzero(normal), np.flatnonzero(~normal))):
            scores = subset.rows(rows)
            pd[rows] = detection_probability(x[rows], scores.means, scores.sds, scores.weights, scores.host)
        return np.asarray(pd[group])

    def detection(self, pfa: Array) -> Array:
        """P_D (n, K) at ``pfa`` (n, K) or (1, K) (3.31, 3.33)."""
        return self.detection_above(self.thresholds(pfa))

    def target(self, at: Index, *, densities: bool) -> list[ScoreDistribution]:
        """Score distributions of the target pixels in some evaluations."""
        return score_distributions(self.moments[0][at], self.rows(at).target_density if densities else None)

    @cached_property
    def moments(self) -> Array:
        """(2, n, 2) mean and standard deviation of the scores of target pixels, and of the background."""
        c, moments = self.classes.rows(self.which), []
        for weights, means, sds in ((self.weights, self.means, self.sds), (c.fraction, c.mean, c.sd)):
            mean = (weights * means).sum(axis=1)
            moments.append([mean, np.sqrt((weights * (sds**2 + (means - mean[:, None]) ** 2)).sum(axis=1))])
        return np.swapaxes(moments, 1, 2)

    def background(self, at: Index, thresholds: Array, *, densities: bool) -> list[tuple[ScoreDistribution, Array]]:
        """Score distributions of the background in some evaluations, and the preset P_FA (K,) of (3.30) whose least P_D
        (3.32) has ``thresholds`` (n, K) of these.
        """
        which, first, group = np.unique(self.which[at], return_index=True, return_inverse=True)
        c, x = self.classes.rows(which), thresholds[first]
        density = partial(score_density, scores=c) if densities else None
        distributions = score_distributions(self.moments[1][at[first]], density)
        rows = self.classes.rows(np.repeat(which, x.shape[1]))
        preset = greatest_class_false_alarm(x.ravel(), rows).reshape(x.shape)
        return [(distributions[i], preset[i]) for i in group]

    def target_density(self, score: Array) -> Array:
        """Density of the target pixels' score at ``score`` (n, K), the derivative of (3.31) [per unit of score]."""
        if self.host is not None:
            density = self.host.exceedance(score, self.means, self.sds, density=True)
            return np.asarray(np.matmul(density, self.weights[:, :, None])[:, :, 0])
        return score_density(score, ClassScores(self.weights, self.means, self.sds, np.full(self.means.shape, np.inf)))

    def log10_false_alarm(self, pd: Array) -> Array:
        """log10 P_FA (n,) at which P_D is ``pd`` (n,), pixels (3.31 solved for the threshold)."""
        reach = _FAR * np.maximum(self.sds, MIN_SD)
        low, high = (self.means - reach).min(axis=1), (self.means + reach).max(axis=1)
        for _ in range(_STEPS):
            middle = 0.5 * (low + high)
            above = detection_probability(middle[:, None], self.means, self.sds, self.weights, self.host)[:, 0] > pd
            low, high = np.where(above, middle, low), np.where(above, high, middle)
        log_pfa, _ = log_false_alarm(0.5 * (low + high), self.classes.rows(self.which))
        return np.asarray(np.minimum(log_pfa / np.log(10.0), 0.0))

    def auc(self, area: RocArea = WHOLE) -> Array:
        """Area under the ROC (n,): the probability that a target pixel outscores a background pixel; or another."""
        pfa = false_alarm_grid(min(1e-9, area.low) if area.logarithmic else 1e-9)
        pd = self.detection(pfa[None])
        mean, finite = np.full(len(pd), np.nan), np.isfinite(pd).all(axis=1)
        mean[finite] = mean_detection(pfa, pd[finite], area)
        return mean


# Score distributions are tabulated on this many points, over this many standard deviations either way.
_GRID, _REACH = 201, 6.0


def score_distributions(moments: Array, density: Callable[[Array], Array] | None) -> list[ScoreDistribution]:
    """Score distributions by mean and standard deviation (n, 2) in n evaluations, with the density if given."""
    mean, sd = moments.T
    if density is None:
        return [ScoreDistribution(m, s) for m, s in zip(mean.tolist(), sd.tolist(), strict=True)]
    grid = np.linspace(mean - _REACH * sd, mean + _REACH * sd, _GRID, axis=-1)
    rows = zip(mean.tolist(), sd.tolist(), grid, density(grid), strict=True)
    return [ScoreDistribution(m, s, None, g, d) for m, s, g, d in rows]


_POINTS = 4001


_DECIMALS = 15  # of a P_D; the rest is rounding


def curve_area(curve: RocCurve, area: RocArea, values: Array | None = None) -> float:
    """Mean P_D of a curve over the range of ``area`` (:func:`mean_detection`); NaN where it does not reach the range.

    Parameters
    ----------
    values : (K,) in place of P_D, such as a limit of it
    """
    pfa, pd = curve.pfa, curve.pd if values is None else values
    valid = (pfa > 0) & np.isfinite(pd)
    pfa, pd = pfa[valid], pd[valid]
    if pfa.size < 2 or pfa[0] > max(area.low, 1e-2 * area.high):
        return float("nan")
    return float(mean_detection(pfa, pd, area))


def mean_detection(pfa: Array, pd: Array, area: RocArea) -> Array:
    """Mean (n,) of P_D (n, K) over the range of ``area``, of curves at false-alarm probabilities ``pfa`` (K,).

    P_D is interpolated over log P_FA by a monotone cubic.  Every ROC ends at (1, 1), where everything is declared;
    a curve that stops before is extended to that point.  Below its first point P_D is constant, which matters only
    where the range begins at 0.

    Examples
    --------
    >>> mean_detection(np.array([0.1, 1.0]), np.ones((2, 2)), RocArea(0.0, 0.5)).round(12).tolist()
    [1.0, 1.0]
    """
    if pfa[-1] < 1.0:
        pfa, pd = np.append(pfa, 1.0), np.concatenate([pd, np.ones((*pd.shape[:-1], 1))], axis=-1)
    from scipy.interpolate import PchipInterpolator  # a tenth of a second, which spectra alone do not need

    # Rounded, as a rise from 0 to 1e-300 has an inverse slope that overflows in the harmonic means of the cubic.
    curve_of = PchipInterpolator(np.log(pfa), np.round(pd.T, _DECIMALS))
    low = max(area.low, float(pfa[0]))
    u = np.linspace(np.log(low), np.log(area.high), _POINTS)
    # Over P_FA itself: the trapezoids of a P_D of 1 then add up to the range, and no area exceeds it.
    width = np.gradient(u if area.logarithmic else np.exp(u))
    width[[0, -1]] *= 0.5
    integral = width @ curve_of(u)
    if area.logarithmic:
        return np.asarray(integral / (u[-1] - u[0]))
    return np.asarray((integral + (low - area.low) * pd[..., 0]) / (area.high - area.low))
