"""Error of the mean of a region whose pixels resemble their neighbours."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import special

from hyperval.processing.intervals import Z95
from hyperval.processing.spatial_correlation import lag_correlation

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

COMPONENTS = 24  # leading ones whose correlation on the ground is measured one by one
_RING_NOISE = 2.0  # standard errors
MOST_TAKEN = 0.5  # of the correlation, by the region's own mean; more cannot be put back
MIXTURES = 4  # of all the others, which are measured together


@dataclass(frozen=True)
class Components:
    """Principal components of a region's pixels.

    Attributes
    ----------
    vectors, values : (B, K), (K,) the leading ones
    rest : (B, M) mixtures of all the others, each of variance 1; M = 0 where there are no others
    """

    vectors: Array
    values: Array
    rest: Array

    def scores(self, centred: Array) -> Array:
        """(K + M, ...) quantities of variance 1 of pixels (..., B) with their mean removed."""
        return np.moveaxis(centred @ np.hstack([self.vectors / np.sqrt(self.values), self.rest]), -1, 0)


def components(covariance: Array, rng: np.random.Generator, count: int = COMPONENTS) -> Components:
    """Components of a covariance (B, B); directions without variance are left out."""
    values, vectors = np.linalg.eigh(covariance)
    values, vectors = values[::-1], vectors[:, ::-1]
    some = values > 1e-12 * max(float(values[0]), 0.0)
    values, vectors = values[some], vectors[:, some]
    others = vectors[:, count:] / np.sqrt(values[count:])
    mix = rng.standard_normal((others.shape[1], MIXTURES))
    rest = others @ (mix / np.linalg.norm(mix, axis=0)) if others.shape[1] else np.zeros((covariance.shape[0], 0))
    return Components(vectors[:, :count], values[:count], rest)


def independent_pixels(
    windows: Iterable[tuple[Array, Mask]], shares: Array, n: int, reach: int
) -> tuple[Array, Array]:
    """(K,) independent pixels for the mean, and for the variance, of K quantities over a region of ``n`` pixels.

    n / sum_h rho(h) share(h), and the same with rho^2 (Cressie, Statistics for Spatial Data, 1993, 1.3).  The
    correlation is summed ring by ring outwards and stops at the first ring whose mean is not above two standard
    errors of uncorrelated pixels: beyond it there is noise (the initial positive sequence of Geyer, Stat. Sci. 7,
    473-483, 1992, is the same on a line).  The mean of a correlated region takes a part of its own variance away,
    1 of so many independent pixels: the number for the mean is less by it.  It takes the same part from the
    correlation at every lag, rho = (1 - q) rho_found + q with q = total/n, which is put back: with S the sum found
    and M the sum of shares, total = S + (total/n) (M - S).

    Parameters
    ----------
    windows : values (K, lines, samples) of mean 0 over the region, and the pixels that count
    shares : (2R + 1, 2R + 1) share of the region's pixels whose neighbour at each lag belongs to it
    reach : R [pixels]
    """
    correlation = lag_correlation(windows, reach)
    steps = np.arange(-reach, reach + 1)
    ring = np.rint(np.hypot(steps[:, None], steps[None, :])).astype(int).ravel()
    pairs, share = correlation.pairs.ravel(), shares.ravel()
    for_mean, for_variance = [], []
    for rho in correlation.value.reshape(correlation.value.shape[0], -1):
        total = squares = summed = 0.0
        for r in range(reach + 1):
            here = ring == r
            behind = max(float(pairs[here].sum()), 1e-12)
            mean = float(pairs[here] @ rho[here]) / behind
            if r > 0 and mean <= _RING_NOISE / np.sqrt(0.5 * behind):  # every pair of pixels stands there twice
                break
            total += mean * float(share[here].sum())
            squares += mean**2 * float(share[here].sum())
            summed += float(share[here].sum())
        total = max(total, 1.0)
        total /= 1.0 - min(max(summed - total, 0.0) / n, MOST_TAKEN)
        total = min(max(total, 1.0), 0.5 * n)
        # E[s^2] = sigma^2 (1 - total/n) n/(n - 1) of s^2 with divisor n - 1, var(mean) = sigma^2 total/n.
        for_mean.append(max((n / total - 1.0) * n / (n - 1.0), 1.0))
        for_variance.append(n / min(max(squares, 1.0), 0.5 * n))
    return np.array(for_mean), np.array(for_variance)


def small_sample_factor(independent: npt.ArrayLike) -> Array:
    """(t/1.96)^2, at least 1: widens the variance of a mean so that +-1.96 u is its 95 % interval [1].

    Few independent pixels know neither their spread nor their correlation well.  t is the 97.5 % point of Student's
    t with half of them, less 1, as degrees of freedom, 1 at least; that half is what simulated regions of 8 to 60
    pixels ask for (docs/statistics.md).  Source of the form: JCGM 100:2008 (GUM), G.3.
    """
    dof = np.maximum(0.5 * np.asarray(independent, dtype=float) - 1.0, 1.0)
    return np.asarray((special.stdtrit(dof, 0.975) / Z95) ** 2)


def mean_error_covariance(covariance: Array, components: Components, independent: Array) -> Array:
    """(B, B) error covariance of a mean: lambda_k / n_k along the leading components.

    The rest has the average 1/n_r of its mixtures; ``independent`` (K + M,) are those of :meth:`Components.scores`.
    D C D / n_r with D = 1 + sum_k (sqrt(n_r/n_k) - 1) v_k v_k^T, which stays a covariance where C is another one
    than that whose components they are.
    """
    k = components.values.size
    of_rest = 1.0 / float(np.mean(1.0 / independent[k:])) if independent.size > k else float(independent[k - 1])
    v = components.vectors
    scaled = v * (np.sqrt(of_rest / independent[:k]) - 1.0)
    once = covariance + scaled @ (v.T @ covariance)  # D C, by products of K columns
    return np.asarray((once + (once @ v) @ scaled.T) / of_rest)
