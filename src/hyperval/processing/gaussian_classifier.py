"""Gaussian maximum-likelihood classification: of pixels, and its error as statistics alone predict it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.classification import bhattacharyya_distance, classification_error
from hyperval.processing.filters import PositiveDefinite
from hyperval.processing.intervals import clopper_pearson
from hyperval.products import ClassificationError

Array = npt.NDArray[np.float64]
Labels = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class ClassLaw:
    """Mean (F,) and covariance (F, F) of one class, with the degrees of freedom of its tails (inf: normal)."""

    mean: Array
    covariance: Array
    tail_dof: float = np.inf

    def project(self, psi: Array) -> ClassLaw:
        """The law of the features psi x (3.21); a linear map keeps a t what it is."""
        return ClassLaw(psi @ self.mean, psi @ self.covariance @ psi.T, self.tail_dof)

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """(n, F) pixels."""
        return self.pixels(self.standard_draw(n, rng))

    def standard_draw(self, n: int, rng: np.random.Generator) -> Array:
        """(n, F) pixels of the law of the same tails with mean 0 and covariance I."""
        z = rng.standard_normal((n, self.mean.size))
        if np.isfinite(self.tail_dof):  # a normal over sqrt(chi2/nu), scaled to the same covariance
            z *= np.sqrt((self.tail_dof - 2.0) / rng.chisquare(self.tail_dof, n))[:, None]
        return z

    def pixels(self, standard: Array) -> Array:
        """(n, F) pixels of :meth:`standard_draw`."""
        return np.asarray(self.mean + standard @ np.linalg.cholesky(self.covariance).T)


class GaussianClassifier:
    """Assigns a pixel to the class of greatest normal likelihood, all classes equally likely beforehand.

    ln f = -1/2 (x - m)^T C^-1 (x - m) - 1/2 ln |C| (Fukunaga 1990, section 4.1).

    Raises
    ------
    UsageError : a covariance that cannot be inverted.
    """

    def __init__(self, laws: Sequence[ClassLaw]):
        self._laws = [(law.mean, PositiveDefinite(law.covariance)) for law in laws]
        self._offsets = [-0.5 * float(np.linalg.slogdet(law.covariance)[1]) for law in laws]

    def classify(self, pixels: npt.ArrayLike) -> Labels:
        """Index (n,) of the class of each pixel (n, F)."""
        x = np.asarray(pixels, dtype=float)
        likelihoods = [
            offset - 0.5 * np.sum(factor.whiten((x - mean).T) ** 2, axis=0)
            for (mean, factor), offset in zip(self._laws, self._offsets, strict=True)
        ]
        return np.asarray(np.argmax(likelihoods, axis=0))


def predicted_error(laws: Sequence[ClassLaw], rng: np.random.Generator, draws: int = 20_000) -> ClassificationError:
    """Error of the classifier that knows the laws, on pixels drawn from them; with distance, estimate and bounds.

    The interval is that of the draws.
    """
    classifier = GaussianClassifier(laws)
    wrong = sum(int(np.count_nonzero(classifier.classify(law.draw(draws, rng)) != i)) for i, law in enumerate(laws))
    n = draws * len(laws)
    lower, upper = clopper_pearson(wrong, n)
    return with_distances(ClassificationError(wrong / n, float(lower), float(upper), n), laws)


def measured_error(
    laws: Sequence[ClassLaw], pixels: Sequence[Array], blocks: Sequence[Labels]
) -> ClassificationError:
    """Error of the classifier trained on ``laws`` on pixels that had no part in them.

    Neighbours err together, so the binomial interval is that of as many independent pixels as give the spread of
    the error from block to block (Kish 1965, section 5.4); without any error all pixels count.

    Parameters
    ----------
    pixels : by class, (n, F)
    blocks : by class, (n,) the block of the image that each pixel lies in
    """
    classifier = GaussianClassifier(laws)
    errors, variances, n = [], [], 0
    for i, (x, block) in enumerate(zip(pixels, blocks, strict=True)):
        wrong = classifier.classify(x) != i
        rate = float(np.mean(wrong))
        _, index = np.unique(block, return_inverse=True)
        excess = np.bincount(index, wrong) - rate * np.bincount(index)
        count = excess.size
        correction = count / (count - 1.0) if count > 1 else 1.0
        between = correction * float(excess @ excess) / wrong.size**2
        errors.append(rate)
        variances.append(max(between, rate * (1.0 - rate) / wrong.size))
        n += int(wrong.size)
    error = float(np.mean(errors))
    variance = float(np.sum(variances)) / len(errors) ** 2
    effective = float(n)
    if variance > 0 and 0 < error < 1:
        effective = float(np.clip(error * (1.0 - error) / variance, 1.0, n))
    lower, upper = clopper_pearson(error * effective, effective)
    return with_distances(ClassificationError(error, float(lower), float(upper), n, effective), laws)


def with_distances(error: ClassificationError, laws: Sequence[ClassLaw]) -> ClassificationError:
    """The same with the least distance of two classes, and estimate and bounds of the best error from distances.

    Of M equally likely classes a pair makes up 2/M: the estimate is the sum of (2/M) Phi(-sqrt(2 B)) over pairs
    (Whitsitt & Landgrebe 1977; Kerekes & Landgrebe 1989), the upper bound that of (1/M) exp(-B), the lower bound
    the greatest single one. The bounds hold for normal classes.
    """
    if len(laws) < 2:
        raise UsageError("classification needs two classes")
    pairs = [bhattacharyya_distance(a.mean, a.covariance, b.mean, b.covariance) for a, b in combinations(laws, 2)]
    part = 2.0 / len(laws)
    each = [classification_error(distance) for distance in pairs]
    return ClassificationError(
        error.error,
        error.lower,
        error.upper,
        error.n,
        error.effective_n,
        min(pairs),
        part * sum(estimate for estimate, _, _ in each),
        part * max(low for _, low, _ in each),
        min(part * sum(high for _, _, high in each), 1.0 - 1.0 / len(laws)),
    )
