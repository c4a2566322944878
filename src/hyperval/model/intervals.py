"""Intervals of proportions, difference ratios with their errors, and the sampling of a covariance by few pixels.

Proportions are detections out of targets, and false alarms out of background pixels.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import special

from hyperval.data import Array, Mask
from hyperval.errors import refuse
from hyperval.products import SpectralEstimate

Z95 = 1.959963984540054  # normal quantile of a two-sided 95 % interval
_TAIL = 0.025  # probability beyond either limit
_MISSED = 1000.0


def _beta_quantile(a: Array, b: Array, probability: float | Array) -> Array:
    """Quantile of the beta law of ``a`` and ``b`` (greater than 0, broadcast) at the cumulative ``probability``.

    SciPy's inverse fails where an argument is 1000 and the other is large, by a factor of two at worst: the next
    number is used in its place.
    """
    a, b = (np.where(x == _MISSED, np.nextafter(_MISSED, np.inf), x) for x in (a, b))
    return np.asarray(special.betaincinv(a, b, probability))


def clopper_pearson(count: npt.ArrayLike, total: npt.ArrayLike, level: float = 0.95) -> tuple[Array, Array]:
    """Exact interval of a binomial proportion.

    The lower limit solves P(X >= count | p) = a, the upper P(X <= count | p) = a, with a = (1 - level)/2.
    Coverage is at least ``level`` for every p.  Source: Clopper & Pearson, Biometrika 26, 404-413, 1934.

    Parameters
    ----------
    count, total : number of successes and of trials, broadcast against each other; clustered ones both divided by the
        design effect, and then no whole numbers

    Returns
    -------
    lower, upper : arrays of the broadcast shape [1]

    Raises
    ------
    UsageError : no trials, more successes than trials, or a level outside (0, 1).

    Examples
    --------
    >>> low, high = clopper_pearson(15, 20)
    >>> print(f"{low:.3f} {high:.3f}")
    0.509 0.913
    >>> bool(clopper_pearson(0, 12203, 0.9)[1] < 2.5e-4)  # no event: one-sided 95 %, 1 - 0.05^(1/total)
    True
    """
    k, n = np.broadcast_arrays(np.asarray(count, dtype=float), np.asarray(total, dtype=float))
    _check_counts(k, n)
    refuse(not 0.0 < level < 1.0, "interval.level", level=level)
    tail = (1.0 - level) / 2.0
    # The binomial tail sums are incomplete beta functions; the end counts have their limit at 0 or 1.
    lower = np.where(k > 0, _beta_quantile(np.where(k > 0, k, 1.0), n - k + 1.0, tail), 0.0)
    upper = np.where(k < n, _beta_quantile(k + 1.0, np.where(k < n, n - k, 1.0), 1.0 - tail), 1.0)
    return lower, upper


def jeffreys_limits(count: npt.ArrayLike, total: npt.ArrayLike) -> tuple[Array, Array]:
    """95 % limits of a proportion by Jeffreys' prior: quantiles of the beta law of count + 1/2 and total - count + 1/2.

    Counts may be fractions, as those of clusters are.  Coverage is 95 % on average over proportions, and oscillates
    about it with the discreteness of counts, where Clopper and Pearson's is never below.  A count of 0 has the lower
    limit 0, one of the total the upper limit 1.  Source: Brown, Cai & DasGupta, Stat. Sci. 16, 101, 2001.

    Examples
    --------
    >>> low, high = jeffreys_limits(15, 20)
    >>> print(f"{low:.3f} {high:.3f}")
    0.536 0.898
    """
    k, n = np.broadcast_arrays(np.asarray(count, dtype=float), np.asarray(total, dtype=float))
    failures = np.maximum(n - k, 0.0)
    lower = np.where(k > 0.0, _beta_quantile(k + 0.5, failures + 0.5, _TAIL), 0.0)
    upper = np.where(failures > 0.0, _beta_quantile(k + 0.5, failures + 0.5, 1.0 - _TAIL), 1.0)
    return lower, upper


def beyond_jeffreys_limits(
    count: npt.ArrayLike, total: npt.ArrayLike, proportion: npt.ArrayLike
) -> tuple[Mask, Mask]:  # fmt: skip
    """Whether a proportion lies below, and whether above, the :func:`jeffreys_limits`.

    By the cumulative beta law at the proportion, which is much faster than its quantiles.
    """
    k, n, p = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in (count, total, proportion)))
    failures = np.maximum(n - k, 0.0)
    part = special.betainc(k + 0.5, failures + 0.5, p)
    return (k > 0.0) & (part < _TAIL), (failures > 0.0) & (part > 1.0 - _TAIL)


def mid_p_limits(count: npt.ArrayLike, total: npt.ArrayLike) -> tuple[Array, Array]:
    """Mid-P 95 % limits of a proportion: tails count half of the observed number's probability.

    With g(p) = P(X > count | p) + P(X = count | p)/2, which rises with p, the lower limit solves g = a and the
    upper one g = 1 - a, a = 0.025.  :func:`clopper_pearson` counts all of it, on both sides, so that its coverage is
    at least the level for every p, and above it on average.  Coverage at 95 % of these is at least 0.92 for proportions
    from 0.02 to 0.96, whatever the total, and on average 0.98 (of 5) to 0.95 (of 80 and more).  Source: Lancaster,
    J. Am. Stat. Assoc. 56, 223-234, 1961; Berry & Armitage, The Statistician 44, 417-423, 1995.

    Examples
    --------
    >>> low, high = mid_p_limits(15, 20)
    >>> print(f"{low:.3f} {high:.3f}")
    0.530 0.902
    """
    k, n = np.broadcast_arrays(np.asarray(count, dtype=float), np.asarray(total, dtype=float))
    _check_counts(k, n)
    tails = np.reshape([_TAIL, 1.0 - _TAIL], (2,) + (1,) * k.ndim)
    p = _beta_quantile(k + 0.5, n - k + 0.5, tails)
    for _ in range(6):  # by Newton: Jeffreys' limits lie so near that the last step is below 1e-15
        # P(X >= k) and P(X > k), incomplete beta functions, 1 and 0 at the end counts.
        at_least = np.where(k > 0, special.betainc(np.maximum(k, 1.0), n - k + 1.0, p), 1.0)
        above = np.where(k < n, special.betainc(k + 1.0, np.maximum(n - k, 1.0), p), 0.0)
        slope = 0.5 * (at_least - above) * (k / p + (n - k) / (1.0 - p))
        p = np.clip(p - (0.5 * (at_least + above) - tails) / slope, 0.5 * p, 0.5 * (1.0 + p))
    return np.where(k > 0, p[0], 0.0), np.where(k < n, p[1], 1.0)


def bounded_mean_limits(values: npt.ArrayLike, level: float = 0.95) -> tuple[float, float]:
    """Distribution-free limits of the mean of a population within [0, 1], from a sample (m,) of it.

    Upper limit u_0 + sum_j (u_j - u_(j-1)) v_(j), with v_(1) >= v_(2) >= ... the values and u_j the upper limit of
    Clopper & Pearson for j of m; the lower one by 1 - v.  With values of 0 and 1 alone it is theirs.  Source:
    Stringer, Proc. Bus. Econ. Stat. Sect. ASA, 405-411, 1963; Bickel, Int. Stat. Rev. 60, 197-209, 1992.

    Examples
    --------
    >>> low, high = bounded_mean_limits([1.0] * 15 + [0.0] * 5)
    >>> print(f"{low:.3f} {high:.3f}")
    0.509 0.913
    """
    v = np.sort(np.asarray(values, dtype=float).ravel())
    refuse(v.size == 0 or not (v[0] >= 0.0 and v[-1] <= 1.0), "interval.bounded")
    upper = clopper_pearson(np.arange(v.size + 1), v.size, level)[1]
    steps = np.diff(upper)
    return float(1.0 - upper[0] - steps @ (1.0 - v)), float(upper[0] + steps @ v[::-1])


def _check_counts(k: Array, n: Array) -> None:
    refuse(not (np.all(np.isfinite(k)) and np.all(np.isfinite(n)) and np.all(n >= 1)), "interval.trials")
    refuse(np.any(k < 0) or np.any(k > n), "interval.count")


def difference_ratio(predicted: npt.ArrayLike, collected: npt.ArrayLike) -> Array:
    """(B,) (predicted - measured)/measured; NaN where ``collected`` is not positive.

    Examples
    --------
    >>> difference_ratio([1.1, 2.0], [1.0, 2.0]).round(3).tolist()
    [0.1, 0.0]
    """
    p, c = np.asarray(predicted, dtype=float), np.asarray(collected, dtype=float)
    return np.where(c > 0, p - c, np.nan) / np.where(c > 0, c, 1.0)


def difference_ratio_covariance(predicted: SpectralEstimate, collected: SpectralEstimate) -> Array:
    """(B, B) error covariance of the difference ratio, to first order.

    With r = p/c - 1, dr = dp/c - p dc/c^2, so C_r = D_1 C_p D_1 + D_2 C_c D_2 with D_1 = diag(1/c) and
    D_2 = diag(p/c^2); the two sides are independent.  Source: law of propagation, JCGM 100:2008, 5.2.
    """
    c = np.where(collected.mean > 0, collected.mean, np.nan)
    one, two = 1.0 / c, predicted.mean / c**2
    return predicted.error_covariance * np.outer(one, one) + collected.error_covariance * np.outer(two, two)


def student_factor(dof: npt.ArrayLike) -> Array:
    """t/1.96 [1], t the 97.5 % point of Student's t: makes +-1.96 u the 95 % interval of a u from few samples.

    Source: JCGM 100:2008 (GUM), 4.2.3 and G.3.

    >>> student_factor([2, 9, 1e9]).round(3)
    array([2.195, 1.154, 1.   ])
    """
    return np.asarray(special.stdtrit(dof, 0.975) / Z95)


def jackknife_directions(values: npt.ArrayLike) -> Array:
    """(G, ...) independent directions of error of a statistic, from its jackknife replicates (G, ...).

    Their squares add up to the jackknife's variance (G - 1)/G sum (v_g - v)^2 (Miller, Biometrika 61, 1-15, 1974),
    widened by (t/1.96)^2 with G - 1 degrees of freedom, so that +-1.96 u is the 95 % interval (JCGM 100:2008, G.3).

    Examples
    --------
    >>> x = np.random.default_rng(0).normal(size=400)
    >>> means = [np.delete(x.reshape(16, 25), g, axis=0).mean() for g in range(16)]
    >>> u = np.sqrt((jackknife_directions(means) ** 2).sum())
    >>> bool(0.7 < u / (x.std() / 20) < 1.5)
    True
    """
    v = np.asarray(values, dtype=float)
    parts = v.shape[0]
    return np.asarray(student_factor(parts - 1.0) * np.sqrt((parts - 1.0) / parts) * (v - v.mean(axis=0)))


def drawn_factors(draws: int, independent: Array, rng: np.random.Generator, kurtosis: float = 0.0) -> Array:
    """F (draws, P, m) of sample covariances F F^T whose true covariance is the identity, m <= P.

    Of more pixels than directions it is Bartlett's decomposition of Wishart's law, else the pixels themselves.  Each
    draw takes its random numbers after those of the one before: none depends on how many are drawn at once.

    Parameters
    ----------
    independent : (P,) degrees of freedom behind the variance of each direction
    kurtosis : kappa of the pixels' law.  To second moments a sample covariance of an elliptical law is a normal one
        of n/(1 + kappa) pixels times a common factor of variance kappa/n, which gives an eigenvalue the relative
        variance (2 + 3 kappa)/n (Waternaux 1976).

    >>> n = np.array([30.0, 60.0, 6.0])
    >>> one, many = (drawn_factors(draws, n, np.random.default_rng(1)) for draws in (1, 8000))
    >>> variances = np.sum(many**2, axis=2)  # 1 on average, to sqrt(2/n)
    >>> bool(np.array_equal(one[0], many[0])), variances.mean(axis=0).round(1), (variances.var(axis=0) * n).round(1)
    (True, array([1., 1., 1.]), array([2., 2., 2.]))
    >>> tailed = drawn_factors(8000, 100.0 * n, np.random.default_rng(1), 0.5)
    >>> round(600.0 * float(np.sum(tailed[:, 2] ** 2, axis=1).var()), 1)  # 2 + 3 kappa
    3.5
    """
    n, size = independent / (1.0 + kurtosis), independent.size
    least = float(n.min())
    # Fewest first: the covariance of two directions is limited by the one with fewer independent pixels.
    order, is_wishart = np.argsort(n, kind="stable"), least > size
    normal, logarithms = np.empty((draws, size if is_wishart else max(round(least), 1), size)), np.zeros(draws)
    for k in range(draws):
        if kurtosis > 0:
            logarithms[k] = rng.normal(0.0, np.sqrt(kurtosis / (least * (1.0 + kurtosis))))
        rng.standard_normal(out=normal[k])
        if is_wishart:
            np.fill_diagonal(normal[k], np.sqrt(rng.chisquare(n[order] - np.arange(size))))
    common = np.exp(logarithms)[:, None, None]
    if is_wishart:
        return np.asarray(np.sqrt(common) * (np.tril(normal) / np.sqrt(n[order])[:, None])[:, np.argsort(order)])
    return np.multiply(np.sqrt(common / normal.shape[1]), np.swapaxes(normal, 1, 2), order="C")
