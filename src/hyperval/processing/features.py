"""Linear features of spectra (3.21): F = Psi X."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]


def principal_components(covariance: npt.ArrayLike, count: int) -> Array:
    """Psi (count, B) whose rows are the leading eigenvectors of a covariance (B, B), largest first (3.21).

    Raises
    ------
    UsageError : more components than bands, or none.
    """
    cov = np.asarray(covariance, dtype=float)
    if not 1 <= count <= cov.shape[0]:
        raise UsageError(
            f"{count} principal components of {cov.shape[0]} bands", expected="1 to the number of bands"
        )
    return _signed(np.linalg.eigh(cov)[1][:, ::-1][:, :count].T)


def minimum_noise_fraction(covariance: npt.ArrayLike, noise_variance: npt.ArrayLike, count: int) -> Array:
    """Psi (count, B) of minimum-noise-fraction components, largest signal-to-noise first (3.21).

    Rows e^T N^-1/2 with e the leading eigenvectors of N^-1/2 Sigma N^-1/2 and N = diag(noise): in these features
    the noise has unit covariance and Sigma is diagonal (Green et al. 1988; noise-adjusted principal components).

    Parameters
    ----------
    covariance : (B, B) of signal and noise together
    noise_variance : (B,)

    Raises
    ------
    UsageError : more components than bands, or a band without noise.
    """
    noise = np.asarray(noise_variance, dtype=float)
    if not np.all(noise > 0):
        raise UsageError(
            "minimum noise fractions need noise in every band; "
            f"{int(np.sum(~(noise > 0)))} of {noise.size} have none",
            mend="use pca, or a scenario with a sensor and an atmosphere",
        )
    scale = 1.0 / np.sqrt(noise)
    return np.asarray(
        principal_components(np.asarray(covariance, dtype=float) * scale[:, None] * scale, count) * scale
    )


def _signed(vectors: Array) -> Array:
    # The sign of an eigenvector is arbitrary: the largest entry is made positive, so that runs agree.
    largest = np.take_along_axis(vectors, np.abs(vectors).argmax(axis=1)[:, None], axis=1)
    return np.asarray(vectors * np.sign(largest))


def features(psi: npt.ArrayLike, spectra: npt.ArrayLike) -> Array:
    """F = Psi X of spectra (..., B) -> (..., F) (3.21)."""
    return np.asarray(np.asarray(spectra, dtype=float) @ np.asarray(psi, dtype=float).T)


def feature_covariance(psi: npt.ArrayLike, covariance: npt.ArrayLike) -> Array:
    """Psi Sigma Psi^T, (F, F) (3.21)."""
    p = np.asarray(psi, dtype=float)
    return np.asarray(p @ np.asarray(covariance, dtype=float) @ p.T)
