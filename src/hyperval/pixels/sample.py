"""What a sample of pixels says of its population: mean, covariance, rank, shrinkage.

How many independent pixels a region is worth: neighbours on the ground resemble each other.

Error of the mean of a region whose pixels resemble their neighbours.

Covariance of pixels that are fewer than their bands.

A sample covariance of n pixels has no variance at all in B - n + 1 directions.  An error taken from it is nought
there, and a test that divides by it finds a difference in every spectrum.  What so few pixels do tell is the
variance of each band and the few common factors that stand out of chance; the rest is taken as independent from
band to band, as the noise of a sensor is.

The noise in the covariance of a class: how much of it, beside the texture, the pixels show.

How far a covariance measured on n pixels departs from the true one: eigenvalues, distance, subspaces.

Sample eigenvalues are biased (the great ones too great, the small ones too small) where n is not far above the
number of bands.  A prediction is therefore not compared with a measured eigenvalue itself, but with what n pixels
drawn from the predicted covariance would show.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import fft, special

from hyperval.errors import UsageError
from hyperval.executors import single_blas_thread
from hyperval.model.intervals import Z95

Array = npt.NDArray[np.float64]
SCENE = "scene"


Mask = npt.NDArray[np.bool_]
Index = npt.NDArray[np.intp]

# A correlation within so many standard errors of 0 counts as none: their squares would add up over many lags.
_SIGNIFICANT = 3.5


@dataclass(frozen=True)
class LagCorrelation:
    """Correlation of pixels against their distance.

    Attributes
    ----------
    value : (K, 2R + 1, 2R + 1) correlation of K quantities at lags of -R to R lines and samples
    pairs : (2R + 1, 2R + 1) pairs of pixels behind it
    """

    value: Array
    pairs: Array

    def significant(self) -> Array:
        """The correlation with 0 where it is not told from none: within 3.5 / sqrt(pairs)."""
        with np.errstate(divide="ignore"):
            noise = _SIGNIFICANT / np.sqrt(self.pairs)
        return np.where(np.abs(self.value) > noise, self.value, 0.0)


def lag_correlation(windows: Iterable[tuple[Array, Mask]], reach: int) -> LagCorrelation:
    """Correlation by lag of centred quantities, pooled over windows of an image.

    Parameters
    ----------
    windows : values (K, lines, samples), of mean 0 over the region, with the mask of the pixels that count
    reach : greatest lag R [pixels]
    """
    power: dict[tuple[int, ...], Array | float] = {}
    for values, mask in windows:
        # The mask is correlated with the rest: it counts the pairs.
        quantities = np.concatenate([np.where(mask, values, 0.0), mask[None].astype(float)])
        # So many zeros behind the window that no lag meets its other end.
        size = tuple(fft.next_fast_len(n + reach, real=True) for n in mask.shape)
        spectrum = fft.fft(fft.rfft(quantities, size[1]), size[0], axis=-2)
        power[size] = power.get(size, 0.0) + (spectrum.real**2 + spectrum.imag**2)
    lags = np.ix_(*2 * [np.arange(-reach, reach + 1)])
    summed = sum(fft.irfft2(p, size)[:, lags[0], lags[1]] for size, p in power.items())
    total, counted = np.asarray(summed)[:-1], np.round(np.asarray(summed)[-1])
    with np.errstate(divide="ignore", invalid="ignore"):
        covariance = np.where(counted > 0, total / counted, 0.0)
        value = covariance / covariance[:, reach, reach][:, None, None]
    return LagCorrelation(np.nan_to_num(value), counted)


def neighbour_shares(mask: Mask, reach: int, rng: np.random.Generator, most: int = 2000) -> Array:
    """(2R + 1, 2R + 1) share of the pixels of a region whose neighbour at each lag belongs to it as well."""
    lines, samples = drawn_pixels(mask, most, rng)
    counted = np.zeros((2 * reach + 1, 2 * reach + 1))
    for line, sample in zip(lines.tolist(), samples.tolist(), strict=True):
        top, left = max(line - reach, 0), max(sample - reach, 0)
        near = mask[top : line + reach + 1, left : sample + reach + 1]
        at = top - line + reach, left - sample + reach
        counted[at[0] : at[0] + near.shape[0], at[1] : at[1] + near.shape[1]] += near
    return counted / max(lines.size, 1)


def drawn_pixels(mask: Mask, most: int, rng: np.random.Generator) -> tuple[Index, Index]:
    """Lines and samples of the pixels of a mask, of ``most`` drawn at random where there are more.

    Line by line: the places of all pixels of a large image would take 16 bytes for each.
    """
    until = np.cumsum(np.count_nonzero(mask, axis=1))
    count = int(until[-1]) if until.size else 0
    return nth_pixels(mask, rng.choice(count, most, replace=False) if count > most else np.arange(count), until)


def nth_pixels(mask: Mask, numbers: Index, until: Index | None = None) -> tuple[Index, Index]:
    """Lines and samples of the pixels of a mask that bear these numbers, counted line by line from 0.

    ``until`` : pixels of the mask up to the end of each line, where they are counted already
    """
    until = np.cumsum(np.count_nonzero(mask, axis=1)) if until is None else until
    lines = np.searchsorted(until, numbers, side="right")
    samples = np.empty(lines.size, np.intp)
    order = np.argsort(lines, kind="stable")
    for some in np.split(order, np.flatnonzero(np.diff(lines[order])) + 1) if lines.size else ():
        line = int(lines[some[0]])
        before = int(until[line - 1]) if line else 0
        samples[some] = np.flatnonzero(mask[line])[numbers[some] - before]
    return lines, samples


def independent_values(n: int, correlation: Array, shares: Array) -> Array:
    """(K,) n / sum_h rho(h) share(h): independent values that give the mean of n the same variance; 1 to n.

    With rho^2 in place of the ``correlation`` rho (K, 2R + 1, 2R + 1), those for the variance of normal values, as
    cov(x^2, y^2) = 2 rho^2 sigma^4 takes the place of cov(x, y) = rho sigma^2.  Source: Cressie, Statistics for
    Spatial Data, 1993, section 1.3.
    """
    return np.asarray(np.clip(n / np.maximum(np.sum(correlation * shares, axis=(1, 2)), 1.0), 1.0, n))


COMPONENTS = 24  # leading ones whose correlation on the ground is measured one by one
_RING_NOISE = 2.0  # standard errors
MOST_TAKEN = 0.5  # of the correlation, by the region's own mean; more cannot be put back
MIXTURES = 4  # of all the others, which are measured together


@dataclass(frozen=True)
class PrincipalComponents:
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


def components(covariance: Array, rng: np.random.Generator, count: int = COMPONENTS) -> PrincipalComponents:
    """Components of a covariance (B, B); directions without variance are left out."""
    values, vectors = np.linalg.eigh(covariance)
    values, vectors = values[::-1], vectors[:, ::-1]
    some = values > 1e-12 * max(float(values[0]), 0.0)
    values, vectors = values[some], vectors[:, some]
    others = vectors[:, count:] / np.sqrt(values[count:])
    mix = rng.standard_normal((others.shape[1], MIXTURES))
    rest = others @ (mix / np.linalg.norm(mix, axis=0)) if others.shape[1] else np.zeros((covariance.shape[0], 0))
    return PrincipalComponents(vectors[:, :count], values[:count], rest)


def independent_pixels(windows: Iterable[tuple[Array, Mask]], shares: Array, n: int, reach: int) -> tuple[Array, Array]:
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


def mean_error_covariance(covariance: Array, components: PrincipalComponents, independent: Array) -> Array:
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


# With fewer the variance of a single band is hardly known, however many bands there are.
FEWEST_DOF = 10


def factor_covariance(covariance: npt.ArrayLike, n: int) -> tuple[Array, float]:
    """Covariance (B, B) of few factors and independent bands, and the degrees of freedom that it is known by.

    In units of the bands' standard deviations, eigenvectors of the sample covariance count as factors as long as
    their eigenvalue is above the edge of pure noise of the same total, s^2 (1 + sqrt(B/m))^2 with m = n - 1 less
    the factors already found and s^2 the rest of the trace over B.  Source: Marchenko & Pastur, Math. USSR Sb. 1,
    457-483, 1967, as a rule for the number of factors Johnstone, Ann. Stat. 29, 295-327, 2001.

    Of the factors F a Wishart matrix of n - 1 degrees of freedom is assumed, of the bands D independent variances:
    the sum of the variances of all elements is {tr(F^2) + tr(F)^2 + 2 tr(D^2)}/(n - 1), and the degrees of freedom
    are those of a Wishart matrix with the same.  They are n - 1 where that is below ten.

    Parameters
    ----------
    covariance : (B, B) unbiased sample covariance with positive diagonal
    n : pixels behind it, two or more

    Raises
    ------
    UsageError : fewer than two pixels, or a band without variance.
    """
    s = np.asarray(covariance, dtype=float)
    variance = np.diag(s)
    if n < 2 or not np.all(variance > 0):
        raise UsageError(f"a covariance of {n} pixels or with a band without variance has no factors")
    sd, m, bands = np.sqrt(variance), n - 1, s.shape[0]
    values, vectors = np.linalg.eigh(s / np.outer(sd, sd))
    values, vectors = np.clip(values[::-1], 0.0, None), vectors[:, ::-1]
    count = 0
    while count < m - 1:
        edge = values[count:].sum() / bands * (1.0 + np.sqrt(bands / (m - count))) ** 2
        if values[count] <= edge:
            break
        count += 1
    factors = (vectors[:, :count] * values[:count]) @ vectors[:, :count].T
    # Each factor fitted takes its part of the bands' own variance along.
    own = np.clip(1.0 - np.diag(factors), 0.0, None) * (m / (m - count))
    out = factors + np.diag(own)
    scatter = np.sum(factors**2) + np.trace(factors) ** 2 + 2.0 * np.sum(own**2)
    dof = m * (np.sum(out**2) + np.trace(out) ** 2) / scatter if m >= FEWEST_DOF else m
    return out * np.outer(sd, sd), float(dof)


# A texture of less than this part of the noise's variance has no factor of its own.
_LEAST_TEXTURE = 1e-6


@dataclass(frozen=True)
class NoisePart:
    """Factor on the stated variance of the noise that the pixels show, and its standard uncertainty [1]."""

    factor: float
    uncertainty: float


def noise_part(
    measured: npt.ArrayLike,
    expected: npt.ArrayLike,
    noise: npt.ArrayLike,
    dof: float,
    kurtosis: float = 0.0,
    *,
    calibration: npt.ArrayLike = 0.0,
    samples: int = 2,
) -> NoisePart:
    """Factor a on the noise in S = a N + g T, by quadratic estimation of variance components.

    With W = Sigma^-1, Sigma = N + T, the two traces tr(W N W S) and tr(W T W S) are equated to what they are
    expected to be (MINQUE: Rao, J. Multivariate Anal. 1, 257-275, 1971).  That is right on average whatever a and g
    are, and for normal pixels and a = g = 1 no estimate that is linear in S has less variance.  The texture's
    factor is free, so that an error in the spread of the class is not taken for one of the noise.

    Parameters
    ----------
    measured : (B, B) S, sample covariance
    expected : (B, B) Sigma, of the model, noise included
    noise : (B,) variances that N has on its diagonal
    dof : degrees of freedom behind S
    kurtosis : kappa of the pixels' law (:func:`hyperval.pixels.sample.kurtosis_parameter`)
    calibration : (B,) part of the noise that the detector elements' own errors of calibration make: all pixels of a
        column share them, so that it is known by as many as there are columns
    samples : columns of the image

    Examples
    --------
    >>> noise, texture = np.array([1.0, 2.0, 1.0]), np.full((3, 3), 4.0)
    >>> found = noise_part(1.21 * np.diag(noise) + 0.9 * texture, np.diag(noise) + texture, noise, 1000.0)
    >>> round(found.factor, 12), round(found.uncertainty, 3)
    (1.21, 0.038)
    """
    s, sigma, n = (np.asarray(x, dtype=float) for x in (measured, expected, noise))
    texture = sigma - np.diag(n)
    parts = [np.diag(n), texture] if np.trace(texture) > _LEAST_TEXTURE * n.sum() else [np.diag(n)]
    w = np.linalg.pinv(sigma, hermitian=True)
    seen = [w @ part @ w for part in parts]
    expectation = np.array([[np.sum(m * part) for part in parts] for m in seen])
    inverse = np.linalg.pinv(expectation)
    factors = inverse @ [np.sum(m * s) for m in seen]
    shown = sum(max(float(f), 0.0) * part for f, part in zip(factors, parts, strict=True))
    through = [m @ shown for m in seen]
    # Muirhead 1982, 1.6: cov(S_ij, S_kl) of an elliptical law.
    traces = np.array([np.trace(x) for x in through])
    covariance = 2.0 * (1.0 + kurtosis) * np.array([[np.sum(x * y.T) for y in through] for x in through])
    covariance = (covariance + kurtosis * np.outer(traces, traces)) / dof
    variance = (inverse @ covariance @ inverse.T)[0, 0]
    by_band = np.einsum("i,ibb->b", inverse[0], np.array(seen))
    columns = 2.0 / (samples - 1.0) * np.sum((by_band * calibration) ** 2)
    return NoisePart(float(factors[0]), float(np.sqrt(variance + columns)))


# With m draws the r-th least and r-th greatest, r = 0.025 (m + 1), bound a further draw with probability 0.95,
# exactly.
DRAWS = 119
_RANK = 3
# Directions with less than this part of the greatest eigenvalue are rounding error.
SMALLEST_PART = 1e-12
# Fewer independent pixels for each direction than this: the determinant of the sample says little.
PIXELS_PER_DIRECTION = 3.0


@dataclass(frozen=True)
class EigenDirections:
    """Eigenvectors (B, P) and eigenvalues (P,) of a covariance, largest first, without those that are rounding."""

    vectors: Array
    values: Array

    @classmethod
    def of(cls, covariance: npt.ArrayLike) -> EigenDirections:
        """Of a symmetric (B, B); UsageError where it has no variance."""
        values, vectors = np.linalg.eigh(np.asarray(covariance, dtype=float))
        values, vectors = values[::-1], vectors[:, ::-1]
        keep = values > SMALLEST_PART * max(float(values[0]), 0.0)
        if not keep.any():
            raise UsageError("a covariance without variance has no eigenvalues to compare")
        return cls(np.ascontiguousarray(vectors[:, keep]), values[keep])

    def of_other(self, covariance: npt.ArrayLike) -> Array:
        """Another covariance (B, B) in these directions, scaled to the identity where it is the same: (P, P)."""
        scaled = self.vectors / np.sqrt(self.values)
        return np.asarray(scaled.T @ np.asarray(covariance, dtype=float) @ scaled)


@dataclass(frozen=True)
class Statistics:
    """What is compared of a covariance S with the predicted one, Sigma.

    Attributes
    ----------
    eigenvalues : (K,) leading eigenvalues of S
    total : trace of S
    distance : Bhattacharyya distance of two normal laws of equal mean with Sigma and S; NaN where S is of less
        than full rank
    overlap : (k, k) scalar products of the first predicted eigenvectors with those of S
    """

    eigenvalues: Array
    total: float
    distance: float
    overlap: Array


def statistics_of_covariance(
    directions: EigenDirections, whitened: Array, count: int, most: int, *, full_rank: bool = True
) -> Statistics:
    """The statistics of S, given as W = D^-1/2 V^T S V D^-1/2 (P, P) in the predicted ``directions``.

    ``count`` leading eigenvalues, and the overlap of the first ``most`` eigenvectors.
    """
    root = np.sqrt(directions.values)
    covariance = whitened * root[:, None] * root
    values, vectors = (x[..., ::-1] for x in np.linalg.eigh(covariance))
    distance = covariance_distance(whitened) if full_rank else float("nan")
    return Statistics(values[:count], float(np.trace(covariance)), distance, vectors[:most, :most])


def statistics_of_factor(
    directions: EigenDirections, factor: Array, count: int, most: int, *, full_rank: bool = True
) -> Statistics:
    """:func:`statistics_of_covariance` of W = F F^T with F (P, m).

    Of fewer pixels m than directions P, the m eigenvalues are those of the Gram matrix (m, m) of the scaled factor.
    """
    size, pixels = factor.shape
    if not max(count, most) <= pixels < size:
        return statistics_of_covariance(directions, factor @ factor.T, count, most, full_rank=full_rank)
    scaled = np.sqrt(directions.values)[:, None] * factor
    values, turned = (x[..., ::-1] for x in np.linalg.eigh(scaled.T @ scaled))
    overlap = scaled[:most] @ turned[:, :most] / np.sqrt(values[:most])
    distance = float("inf" if full_rank else "nan")
    return Statistics(values[:count], float(np.vdot(scaled, scaled)), distance, overlap)


def covariance_distance(whitened: npt.ArrayLike) -> float:
    """Covariance part of the Bhattacharyya distance from W = Sigma^-1/2 S Sigma^-1/2 (P, P).

    (1/2) ln(|(Sigma + S)/2| / sqrt(|Sigma| |S|)) = (1/2) sum ln((1 + w)/(2 sqrt(w))), w the eigenvalues of W
    (Fukunaga 1990, section 3.4).  The determinants are those of Cholesky factors.
    """
    w = np.asarray(whitened, dtype=float)
    try:
        both, alone = (np.diag(np.linalg.cholesky(m)) for m in (np.eye(len(w)) + w, w))
    except np.linalg.LinAlgError:
        return float("inf")
    return float(np.sum(np.log(both) - 0.5 * np.log(alone)) - 0.5 * len(w) * np.log(2.0))


def principal_angles_deg(overlap: npt.ArrayLike, spaces: tuple[int, ...]) -> Array:
    """(..., S) largest principal angle [deg] between the spaces of the first k of two orthonormal bases, by k.

    Its cosine is the least singular value of the bases' overlap A^T B, here (..., K, K) (Bjorck & Golub 1973).
    """
    m = np.asarray(overlap, dtype=float)
    least = [np.linalg.svd(m[..., :k, :k], compute_uv=False)[..., -1] for k in spaces]
    return np.degrees(np.arccos(np.minimum(np.reshape(least, (len(spaces), *m.shape[:-2])), 1.0))).T


def kurtosis_parameter(tail_dof: float) -> float:
    """kappa of an elliptical law: 2/(nu - 4) of a multivariate t, 0 of the normal; inf up to nu = 4.

    Source: Muirhead, Aspects of Multivariate Statistical Theory, 1982, section 1.6.
    """
    if np.isinf(tail_dof):
        return 0.0
    return 2.0 / (tail_dof - 4.0) if tail_dof > 4.0 else float("inf")


def drawn_factor(size: int, independent: npt.ArrayLike, rng: np.random.Generator, kurtosis: float = 0.0) -> Array:
    """F (P, m) of a sample covariance F F^T whose true covariance is the identity, m <= P.

    Of more pixels than directions it is Bartlett's decomposition of Wishart's law, else the pixels themselves.

    Parameters
    ----------
    size : P
    independent : degrees of freedom behind the variance of each direction: one number, or (P,)
    kurtosis : kappa of the pixels' law.  To second moments a sample covariance of an elliptical law is a normal one
        of n/(1 + kappa) pixels times a common factor of variance kappa/n, which gives an eigenvalue the relative
        variance (2 + 3 kappa)/n (Waternaux 1976).
    """
    n = np.broadcast_to(np.asarray(independent, dtype=float), (size,)) / (1.0 + kurtosis)
    least = float(n.min())
    common = 1.0
    if kurtosis > 0:
        common = float(np.exp(rng.normal(0.0, np.sqrt(kurtosis / (least * (1.0 + kurtosis))))))
    if least <= size:
        pixels = rng.standard_normal((max(round(least), 1), size))
        return np.asarray(np.sqrt(common / pixels.shape[0]) * pixels.T)
    # Fewest first: what two directions share is limited by the one with fewer independent pixels.
    order = np.argsort(n, kind="stable")
    lower = np.tril(rng.standard_normal((size, size)), -1)
    lower[np.diag_indices(size)] = np.sqrt(rng.chisquare(n[order] - np.arange(size)))
    lower /= np.sqrt(n[order])[:, None]
    drawn = np.empty((size, size))
    drawn[order] = lower
    return np.asarray(np.sqrt(common) * drawn)


@dataclass(frozen=True)
class SamplingBand:
    """Statistics of covariances drawn from the predicted one; rows are draws."""

    eigenvalues: Array
    total: Array
    distance: Array
    angles_deg: Array

    @staticmethod
    def limits(drawn: Array) -> tuple[Array, Array]:
        """Least and greatest value that a further draw keeps to with probability 0.95."""
        ordered = np.sort(drawn, axis=0)
        return ordered[_RANK - 1], ordered[-_RANK]


def sampling_band(
    directions: EigenDirections,
    independent: npt.ArrayLike,
    count: int,
    spaces: tuple[int, ...],
    rng: np.random.Generator,
    *,
    kurtosis: float = 0.0,
    draws: int = DRAWS,
) -> SamplingBand:
    """What samples of the predicted covariance show by chance alone.

    Parameters
    ----------
    independent : degrees of freedom, one number or (P,) by direction
    count : leading eigenvalues K
    spaces : the k of the principal angles
    """
    size = directions.values.size
    full, most = full_rank(independent, size), max(spaces, default=0)
    with single_blas_thread():
        sampled = [
            statistics_of_factor(
                directions, drawn_factor(size, independent, rng, kurtosis), count, most, full_rank=full
            )
            for _ in range(draws)
        ]
    return SamplingBand(
        np.stack([f.eigenvalues for f in sampled]),
        np.array([f.total for f in sampled]),
        np.array([f.distance for f in sampled]),
        principal_angles_deg(np.stack([f.overlap for f in sampled]), spaces),
    )


def full_rank(independent: npt.ArrayLike, size: int) -> bool:
    """Whether the sample is large enough for its determinant to be compared."""
    return bool(np.min(independent) >= PIXELS_PER_DIRECTION * size)
