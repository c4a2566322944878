"""Components of a class in all bands, from a mixture fitted in its few leading components."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from hyperval.processing.mixture_fit import MixtureFit, chosen_count, chosen_dof, fit_again, fit_mixture
from hyperval.scene.components import Components

Array = npt.NDArray[np.float64]

COUNTS = (1, 2, 3, 4, 6, 8, 12, 16)
DIMENSIONS = 6  # leading components of the class; clusters differ in what varies most
# Fewer pixels than that have no clusters that another sample would show again.
FEWEST_PIXELS = 200
# The number of clusters is chosen on so many pixels, thinned evenly.
MOST_CHOOSING = 5000
_LEAST_VARIANCE = 1e-10  # of the greatest: below it a component is rounding


@dataclass(frozen=True, eq=False)
class ClassMixture:
    """The mixture that the pixels of a class are, in the leading components that it was fitted in.

    Attributes
    ----------
    mean : (B,) of the pixels
    lead : bands of the leading components
    directions : (bands of ``lead``, P) that make a pixel's departure from the mean its standardised values
    fit : in those
    """

    mean: Array
    lead: npt.NDArray[np.intp]
    directions: Array
    fit: MixtureFit

    def components(self, pixels: Array) -> Components | None:
        """The laws in all bands, by the share that each pixel (n, B) has in each; None where one is left."""
        return self._moments(pixels, self._standardised(pixels), self.fit)

    def components_without(self, pixels: Array, part: npt.NDArray[np.intp], number: int) -> Components | None:
        """The same without the pixels of one part of the image, the fit made again from where it stands."""
        rest = pixels[part != number]
        values = self._standardised(rest)
        return self._moments(rest, values, fit_again(values, self.fit))

    def _standardised(self, pixels: Array) -> Array:
        return np.asarray((pixels - self.mean)[:, self.lead] @ self.directions)

    def _moments(self, pixels: Array, values: Array, fit: MixtureFit) -> Components | None:
        centred = pixels - pixels.mean(axis=0)
        probability, weight = fit.shares(values)
        size = probability.sum(axis=1)
        kept = size > 1.0  # a law of less than one pixel has no covariance, and no alarms
        if np.count_nonzero(kept) < 2:
            return None
        probability, weight, size = probability[kept], weight[kept], size[kept]
        both = probability * weight
        offsets = (both @ centred) / both.sum(axis=1)[:, None]
        # The scale of a t law is the weighted scatter over the unweighted number; n/(n - 1) as for the class.
        n = pixels.shape[0]
        inflation = (1.0 if np.isinf(fit.dof) else fit.dof / (fit.dof - 2.0)) * n / max(n - 1, 1)
        covariances = np.empty((size.size, pixels.shape[1], pixels.shape[1]))
        for k in range(size.size):
            away = centred - offsets[k]
            covariances[k] = inflation * (away * both[k, :, None]).T @ away / size[k]
        shrunk = shrunk_covariances(covariances, size)
        return Components(size / size.sum(), offsets, 0.5 * (shrunk + shrunk.transpose(0, 2, 1)), fit.dof)


def class_mixture(
    pixels: npt.ArrayLike,
    block: npt.ArrayLike,
    count: int | Literal["auto"],
    *,
    tails: bool,
    lead: npt.NDArray[np.intp] | None = None,
    seed: int = 0,
    counts: Sequence[int] = COUNTS,
) -> ClassMixture | None:
    """The mixture that pixels (n, B) of a class are; None where one law is all that they show.

    The laws are fitted in the leading components of the class, where clusters differ; the moments of all bands
    follow from the share that each pixel has in each law, shrunk by :func:`shrunk_covariances`.

    Parameters
    ----------
    block : (n,) number of the block of the image that each pixel lies in, for the choice of the number
    count : K, or "auto" for the number that predicts left-out blocks best
    tails : t laws in place of normal ones, whose degrees of freedom are fitted; of the number that was chosen by
        blocks, by blocks too: tails are what a sample has too few pixels of
    lead : bands in which the leading components are taken; None: all

    Raises
    ------
    UsageError : too few pixels or blocks.
    """
    x = np.asarray(pixels, dtype=float)
    rng = np.random.default_rng(seed)
    mean = x.mean(axis=0)
    lead = np.arange(x.shape[1]) if lead is None else lead
    used = (x - mean)[:, lead]
    values, vectors = np.linalg.eigh(used.T @ used / max(x.shape[0] - 1, 1))
    values, vectors = values[::-1], vectors[:, ::-1]
    keep = min(DIMENSIONS, int(np.count_nonzero(values > _LEAST_VARIANCE * values[0])))
    if keep == 0 or (count == "auto" and x.shape[0] < FEWEST_PIXELS):
        return None
    # The sign of an eigenvector is nobody's choice; the starts of the fit shall not depend on it.
    vectors = vectors[:, :keep]
    vectors = vectors * np.sign(vectors[np.argmax(np.abs(vectors), axis=0), np.arange(keep)])
    directions = vectors / np.sqrt(values[:keep])
    leading = used @ directions
    dof: float | None = None if tails else np.inf
    thin = slice(None, None, -(-x.shape[0] // MOST_CHOOSING))
    some, where = leading[thin], np.asarray(block)[thin]
    number = count if count != "auto" else chosen_count(some, where, counts, rng, dof=dof)[0]
    if number == 1:
        return None
    if tails and count == "auto":
        dof = chosen_dof(some, where, number, rng)
    return ClassMixture(mean, lead, directions, fit_mixture(leading, number, rng, dof=dof))


def shrunk_covariances(covariances: Array, pixels: Array) -> Array:
    """Covariances (K, B, B) shrunk towards their pooled one, by how much they differ from it beyond chance.

    In a direction of the pooled covariance the variance of one component over the pooled one scatters by 2/n_k
    where all are alike.  What it scatters by beyond that, t^2, on average over directions and components, is how
    much they truly differ; the best linear guess between its own variance and the pooled one gives the latter the
    weight (2/n_k)/(2/n_k + t^2) (empirical Bayes; Efron & Morris, J. Am. Stat. Assoc. 68, 117-130, 1973).

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> alike = np.array([np.cov(rng.standard_normal((20, 4)).T) for _ in range(50)])
    >>> shrunk = shrunk_covariances(alike, np.full(50, 20.0))
    >>> bool(np.abs(shrunk - np.eye(4)).mean() < 0.5 * np.abs(alike - np.eye(4)).mean())
    True
    """
    share = pixels / pixels.sum()
    pooled = np.tensordot(share, covariances, 1)
    values, vectors = np.linalg.eigh(pooled)
    used = values > _LEAST_VARIANCE * values[-1]
    own = np.einsum("bp,kbc,cp->kp", vectors[:, used], covariances, vectors[:, used], optimize=True) / values[used]
    chance = 2.0 / pixels
    excess = max(float(share @ (np.mean((own - 1.0) ** 2, axis=1) - chance)), 0.0)
    part = (chance / (chance + excess))[:, None, None]
    return np.asarray((1.0 - part) * covariances + part * pooled)
