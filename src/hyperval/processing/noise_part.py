"""The noise in the covariance of a class: how much of it, beside the texture, the pixels show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
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
    kurtosis : kappa of the pixels' law (:func:`hyperval.processing.covariance_sampling.kurtosis_parameter`)
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
