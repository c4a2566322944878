"""Signal-to-noise ratio of a homogeneous region of an image."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperval.data import Array, Index, Mask
from hyperval.errors import refuse
from hyperval.products import SpectralEstimate

_CHUNK = 2048  # pixels whose distances from their mean are in memory at once


def snr_decorrelated(pixels: Array, mean_error: Array | None = None, good: Mask | None = None) -> SpectralEstimate:
    """Mean over the noise that neighbouring bands do not explain.

    Texture is common to neighbouring bands and noise is not.  Each good band is regressed on the good bands below and
    above (at the ends, on the two next), x_b = c_0 + c^T x_n + e.  This is the spectral part of Roger & Arnold,
    Int. J. Remote Sens. 17, 1951-1962, 1996.  The residual is not yet the noise of the band, s_b^2:

    - it carries the neighbours' noise, which with the band's own, if noise changes little from band to band, makes
      (1 + c^T c) s_b^2;
    - it carries the texture that noisy neighbours cannot explain, (1 - c^T h)^2 t_b^2, where h = mean_n/mean_b as
      texture is brightness, and t_b^2 is the covariance of pairs of the bands up to two away, over the product of
      their h.  Where texture equals noise it is 11 % of s_b^2; it is never more than an eighth, and s_b^4/(4 t_b^2)
      where there is much texture, so that what goes beyond twice that is cut off;
    - errors of c, of covariance var e S^-1/(n - 3) with the neighbours' covariance S, raise both squares by chance;
      the expectation is taken off;
    - the median of a variance estimate is that of chi-square, (1 - 2/(9 (n - 3)))^3 of its mean (Wilson & Hilferty,
      Proc. Natl. Acad. Sci. 17, 684-688, 1931), by which it is divided.

    Medians of 36 pixels and more are right to 1 % where texture is brightness, of 16 to 2 %.

    Parameters
    ----------
    pixels : (n, B) of one region, n >= 5, finite in the good bands, which are three or more
    mean_error : (B, B) error covariance of their mean, of which texture on the ground is the greater part where it is
        correlated; None: that of n pixels of noise alone
    good : (B,) the others have no SNR and are no band's neighbours; None: all

    Examples
    --------
    >>> pixels = 100.0 + np.random.default_rng(1).standard_normal((400, 3))
    >>> [round(float(snr_decorrelated(pixels, error).budget["mean"][1]), 2) for error in (None, np.full((3, 3), 0.09))]
    [0.05, 0.31]
    >>> good, spoilt = np.arange(4) != 1, np.insert(pixels, 1, np.nan, axis=1)
    >>> bool(np.array_equal(snr_decorrelated(spoilt, good=good).mean[good], snr_decorrelated(pixels).mean))
    True
    """
    x = np.asarray(pixels, dtype=float)
    refuse(x.ndim != 2 or len(x) < 5, "snr.few", shape=x.shape)
    n, bands = x.shape
    used = np.flatnonzero(np.ones(bands) if good is None else good)
    refuse(not np.isfinite(x).all(axis=0)[used].all(), "snr.finite")
    refuse(used.size < 3, "snr.bands", bands=used.size)
    mean = x.mean(axis=0)
    parts = (x[start : start + _CHUNK] - mean for start in range(0, n, _CHUNK))  # a copy of all takes 16 MB
    variance, relative_variance, correlation = _noise_variance(sum(z.T @ z for z in parts) / (n - 3), mean, n - 3, used)
    sd = np.sqrt(variance) / (1.0 - 2.0 / (9.0 * (n - 3))) ** 1.5
    with np.errstate(divide="ignore", invalid="ignore"):
        snr = np.where(sd > 0, mean / sd, np.nan)
        # First order: var(mean/s) = var(mean)/s^2, 1/n of noise, + snr^2 times a quarter of the relative variance of
        # s^2; the two parts are independent for normal noise.
        noise_part = np.abs(snr) * np.sqrt(relative_variance) / 2.0
        mean_part = np.eye(bands) / n if mean_error is None else np.asarray(mean_error, dtype=float) / np.outer(sd, sd)
    mean_part = np.where(np.isfinite(mean_part), mean_part, 0.0)
    covariance = np.outer(np.nan_to_num(noise_part), np.nan_to_num(noise_part)) * correlation
    budget = {"mean": np.sqrt(np.diag(mean_part)), "noise estimate": noise_part}
    return SpectralEstimate(snr, covariance + mean_part, None, n, budget)


def snr_from_moments(mean: npt.ArrayLike, covariance: npt.ArrayLike, good: npt.ArrayLike) -> Array:
    """SNR (B,) of :func:`snr_decorrelated` from the mean (B,) and covariance (B, B) of many pixels.

    A band that is much noisier than its neighbours is given up to root 1.5 times its SNR; one that does not vary
    has none (NaN).
    """
    average = np.asarray(mean, dtype=float)
    variance = _noise_variance(np.asarray(covariance, dtype=float), average, np.inf, np.flatnonzero(good))[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(variance > 0, average / np.sqrt(variance), np.nan)


def _noise_variance(covariance: Array, mean: Array, dof: float, used: Index) -> tuple[Array, Array, Array]:
    """(B,) variance of the noise of the ``used`` bands, its relative variance, (B, B) correlation of their errors.

    As in :func:`snr_decorrelated`.
    """
    (noise, error, unexplained), residuals = np.zeros((3, mean.size)), np.eye(mean.size)
    neighbours = used[[[1, 2], *([i - 1, i + 1] for i in range(1, used.size - 1)), [used.size - 3, used.size - 2]]]
    pairs = covariance[neighbours[:, :, None], neighbours[:, None, :]]
    for b, pair, inverse in zip(used.tolist(), neighbours, np.linalg.pinv(pairs, hermitian=True), strict=True):
        c = inverse @ covariance[pair, b]
        residual = max(covariance[b, b] - c @ covariance[pair, b], 0.0)
        if residual == 0.0:
            continue
        slopes = residual * inverse / dof  # covariance of the errors of c
        chance = np.trace(slopes)
        squares = 1.0 + max(c @ c - chance, -0.5)
        brightness = mean / mean[b] if mean[b] else np.ones_like(mean)
        h = brightness[pair]
        texture, texture_error = _texture_variance(covariance, brightness, b, dof, used)
        unexplained_share = 1.0 - c @ h
        leakage = (unexplained_share**2 - h @ slopes @ h) * texture
        if texture > 0:
            bound = residual**2 / (2.0 * texture)
            leakage = min(max(leakage, -bound), bound)
        noise[b] = max(residual - leakage, 0.0) / squares
        residuals[b, pair] = -c
        unexplained[b] = np.sign(unexplained_share) * np.sqrt(max(leakage, 0.0))
        # First order in residual, texture and c; second where the first vanishes, as it does without texture.
        gradient = 2.0 * (texture * unexplained_share * h - noise[b] * c)
        squared_error = (
            2.0 / dof * (residual + noise[b] * chance) ** 2
            + texture_error * (unexplained_share**4 + 4.0 * unexplained_share**2 * (h @ slopes @ h))
            + gradient @ slopes @ gradient
            + 2.0 * noise[b] ** 2 * np.trace(slopes @ slopes)
        )
        if noise[b] > 0.0:  # else the band has no SNR
            error[b] = squared_error / (squares * noise[b]) ** 2
    # Residuals of neighbouring bands share noise, all share texture; variances correlate by the square of it.
    shared = residuals * noise @ residuals.T + np.outer(unexplained, unexplained)
    size = np.sqrt(np.maximum(np.diag(shared), np.finfo(float).tiny))
    correlation = (shared / np.outer(size, size)) ** 2
    np.fill_diagonal(correlation, 1.0)
    return noise, error, correlation


def _texture_variance(covariance: Array, brightness: Array, b: int, dof: float, used: Index) -> tuple[float, float]:
    """Variance of the texture of band b from pairs of the used bands up to two away, without b; its variance."""
    window = used[(np.abs(np.arange(used.size) - np.searchsorted(used, b)) <= 2) & (used != b)]
    if np.any(brightness[window] == 0.0):
        return 0.0, 0.0
    relative = covariance[np.ix_(window, window)] / np.outer(brightness[window], brightness[window])
    i, j = np.triu_indices(len(window), 1)
    # Isserlis: cov(S_ij, S_kl) = (S_ik S_jl + S_il S_jk)/dof.
    pairs = relative[np.ix_(i, i)] * relative[np.ix_(j, j)] + relative[np.ix_(i, j)] * relative[np.ix_(j, i)]
    return float(relative[i, j].mean()), float(pairs.mean() / dof)
