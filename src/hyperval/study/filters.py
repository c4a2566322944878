"""Filters of many settings (3.21-3.25) and the scores of the classes (3.27, 3.29).

For each setting the background's covariance is put together in the form that one factorisation needs, in memory
that is used again; everything that goes through matrices that settings share goes through them together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dpocon, dpotrf, dpotrs

from hyperval.prediction.inputs import cut
from hyperval.processing.filters import MAX_CONDITION
from hyperval.study.prepared import Bands, Prepared
from hyperval.study.views import Views, line_of

Array = npt.NDArray[np.float64]
# Below this ratio of the factor's diagonal, squared, a matrix can not be near the limit of the condition number in
# practice; above it the condition number is estimated as `predict` does.
_SUSPECT = 1e8
_BLOCK = 90  # columns
_CHECKED_BEFORE = "the background matrix is singular to working precision"


@dataclass(frozen=True)
class SeenClasses:
    """The background after the empirical line, on the detector's bands, in U settings.

    Attributes
    ----------
    gain, offset : (U, 1, F) of the empirical line
    slope : (U, F) D_A / k of (3.11)
    around : (U, M, F) D_B / k times the root of g_m kappa, of (3.11)
    means : (U, M, F) retrieved reflectances
    noise : (U, M, F) noise variances of the retrieved reflectances
    mean : (U, F) of the mixture
    """

    gain: Array
    offset: Array
    slope: Array
    around: Array
    means: Array
    noise: Array
    mean: Array


def seen_classes(at: Views, class_means: Array) -> SeenClasses:
    """What the detector sees of the classes (3.7-3.21); ``at`` and ``class_means`` (M, F) on its bands."""
    view = at.view
    gain, offset = line_of(at)
    level = at.levels(class_means)
    means = (level - offset) / gain
    shape = (len(at), class_means.shape[1])
    slope = np.broadcast_to(view.slope() / gain, (shape[0], 1, shape[1]))[:, 0]
    weight = at.gains[:, :, None] * view.adjacency_weight()
    around = view.adjacency_slope(np.broadcast_to(class_means, level.shape)) / gain * np.sqrt(weight)
    noise = view.noise_variance(level) / gain**2
    mean = np.einsum("um,umf->uf", at.fractions, means)  # (3.8) of what is seen
    return SeenClasses(gain, offset, np.ascontiguousarray(slope), around, means, noise, mean)


@dataclass(frozen=True)
class Filters:
    """Linear detectors of U settings: score = weights . x - offset.

    ``weights`` (U, F), ``offset`` (U,); NaN where there is none, and then ``problems`` says why.
    """

    weights: Array
    offset: Array


class Designer:
    """Filters of the settings for targets and detectors, the matrices of each setting factorised once.

    Parameters
    ----------
    prepared, bands : the scenario and the bands of its detectors
    """

    def __init__(self, prepared: Prepared, bands: Bands):
        self.bands = bands
        self.covariances = np.array([cut(c, bands) for c in prepared.class_covariances])
        self._matrix = np.zeros((bands.size, bands.size), order="F")
        self._mixed: tuple[bytes, Array] | None = None

    def design(
        self, at: Views, seen: SeenClasses, wanted: list[tuple[str, Array]]
    ) -> tuple[list[Filters], list[str]]:
        """Filters for pairs of detector and spectrum as seen (U, F); and the problem of each setting, or ""."""
        count, size = len(at), self.bands.size
        found = [Filters(np.full((count, size), np.nan), np.full(count, np.nan)) for _ in wanted]
        problems = [""] * count
        averages = [cut(s.covariance, self.bands) for s in at.surroundings]
        plain = [i for i, (d, _) in enumerate(wanted) if d != "cem-correlation"]
        correlation = [i for i, (d, _) in enumerate(wanted) if d == "cem-correlation"]
        for u in range(count):
            for members, second in ((plain, False), (correlation, True)):
                if not members or problems[u]:
                    continue
                factor, scale, problems[u] = self._factor(at, seen, u, averages[at.which[u]], second)
                if factor is None:
                    continue
                centre = np.zeros(size) if second else seen.mean[u]
                right = np.stack([wanted[i][1][u] - centre for i in members], axis=1)
                solved, _ = dpotrs(factor, right * scale[:, None], lower=1)
                solved *= scale[:, None]
                for i, d, x in zip(members, right.T, solved.T, strict=True):
                    energy = float(d @ x)
                    if not energy > 0:
                        problems[u] = "the target spectrum equals the background mean"
                        continue
                    # (3.23)-(3.25); "smf" is the same filter in standard deviations of the background.
                    w = x / (np.sqrt(energy) if wanted[i][0] == "smf" else energy)
                    found[i].weights[u] = w
                    found[i].offset[u] = 0.0 if second else w @ seen.mean[u]
        return found, problems

    def _mixture(self, weights: Array) -> Array:
        """Sum over classes of f_m g_m Sigma_m; kept while the weights stay."""
        key = weights.tobytes()
        if self._mixed is None or self._mixed[0] != key:
            stack = self.covariances.reshape(weights.size, -1)
            total = (weights @ stack).reshape(self.covariances.shape[1:])
            self._mixed = key, total
        return self._mixed[1]

    def _factor(
        self, at: Views, seen: SeenClasses, u: int, average: Array, correlation: bool
    ) -> tuple[Array | None, Array, str]:
        """Cholesky factor of the background matrix at unit diagonal, its scale, and what is wrong with it.

        Sum f_m [D_A g_m Sigma_m D_A + kappa g_m D_B Sigma_ave D_B + N_m + (mu_m - mu)(mu_m - mu)^T] with everything
        divided by the gains of the empirical line (3.11, 3.16-3.21): the first part is one matrix under (a a^T),
        the second Sigma_ave under the sum of (e_m e_m^T), element by element.
        """
        fraction = at.fractions[u]
        mixed = self._mixture(fraction * at.gains[u])
        root = np.sqrt(fraction)[:, None]
        around = root * seen.around[u]
        between = root * (seen.means[u] - seen.mean[u])
        if correlation:
            between = np.vstack([between, seen.mean[u]])
        noise = fraction @ seen.noise[u]
        diagonal = seen.slope[u] ** 2 * mixed.diagonal() + (around**2).sum(axis=0) * average.diagonal()
        diagonal = diagonal + (between**2).sum(axis=0) + noise
        if not np.all(diagonal > 0) or not np.all(np.isfinite(diagonal)):
            return None, diagonal, f"{_CHECKED_BEFORE}: a band has no variance, or one that is not a number"
        scale = 1.0 / np.sqrt(diagonal)
        parts = seen.slope[u] * scale, around * scale, between * scale
        factor, info = dpotrf(self._lower(*parts, mixed, average), lower=1, overwrite_a=1, clean=0)
        if info:
            return None, scale, f"{_CHECKED_BEFORE}: it has no Cholesky factor"
        pivots = factor.diagonal()
        if (pivots.max() / pivots.min()) ** 2 > _SUSPECT:
            factor = factor.copy(order="F")
            lower = np.tril(self._lower(*parts, mixed, average))
            norm = np.abs(lower + lower.T - np.eye(lower.shape[0])).sum(axis=0).max()
            reciprocal, _ = dpocon(factor, norm, uplo="L")
            if not reciprocal * MAX_CONDITION >= 1.0:
                return None, scale, f"{_CHECKED_BEFORE}: condition number {1.0 / max(reciprocal, 1e-300):.3g}"
        return factor, scale, ""

    def _lower(self, a: Array, e: Array, d: Array, mixed: Array, average: Array) -> Array:
        """Lower triangle of (a a^T) mixed + (e^T e) average + d^T d with ones on its diagonal, in blocks that stay
        in the processor's cache; above the blocks' diagonal the memory holds anything.
        """
        matrix, size = self._matrix, a.size
        for start in range(0, size, _BLOCK):
            rows, columns = slice(start, size), slice(start, min(start + _BLOCK, size))
            # Symmetric matrices in C order: the block of columns is taken as rows, so that memory runs along.
            part = np.multiply(a[columns, None], a[rows])
            part *= mixed[columns, rows]
            around = e[:, columns].T @ e[:, rows]
            around *= average[columns, rows]
            part += around
            part += d[:, columns].T @ d[:, rows]
            matrix.T[columns, rows] = part
        matrix.T.flat[:: size + 1] = 1.0
        return matrix

    def class_scores(self, at: Views, seen: SeenClasses, filters: Filters) -> tuple[Array, Array]:
        """theta_m and sigma_m (U, M) (3.27, 3.29)."""
        w = filters.weights
        means = np.einsum("uf,umf->um", w, seen.means) - filters.offset[:, None]
        variances = np.einsum("uf,umf->um", w**2, seen.noise)
        through = w * seen.slope
        for m, covariance in enumerate(self.covariances):
            variances[:, m] += at.gains[:, m] * np.einsum("uf,uf->u", through @ covariance, through)
        variances += self.around(at, w[:, None, :] * seen.around)
        return means, np.sqrt(np.maximum(variances, 0.0))

    def around(self, at: Views, vectors: Array) -> Array:
        """v Sigma_ave v^T (U, K) of vectors (U, K, F), each setting with its own surroundings (3.11)."""
        found = np.zeros(vectors.shape[:2])
        if not vectors.any():
            return found
        for number, surroundings in enumerate(at.surroundings):
            rows = np.flatnonzero(at.which == number)
            if rows.size:
                v = vectors[rows]
                product = v.reshape(-1, v.shape[2]) @ cut(surroundings.covariance, self.bands)
                found[rows] = np.einsum("ukf,ukf->uk", product.reshape(v.shape), v)
        return found
