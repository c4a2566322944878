"""From reflectance statistics to radiance statistics at the sensor (3.7-3.12).

Every function takes ``formulation``: "corrected" (default) or "thesis", the form as printed.

===================  =========================================  ==============================
quantity             corrected                                  thesis
===================  =========================================  ==============================
ground term (3.7)    A rho_m / (1 - S rho_ave)                  A rho_m / (1 - S rho_m)
slope D_A (3.11)     A / (1 - S rho_ave)                        A / (1 - S), an albedo-1 run
slope D_B (3.11)     (A S rho_m + B) / (1 - S rho_ave)^2        B / (1 - S)
kappa (3.11)         1 / N_eff                                  1
fill (3.12)          E[f^2], E[(1-f)^2], Var f                  f^2, (1-f)^2, 0
===================  =========================================  ==============================

Scene averages over the background classes (3.8).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]


def average_reflectance(fractions: npt.ArrayLike, means: npt.ArrayLike) -> Array:
    """Area-average reflectance rho_ave = sum f_m rho_m (3.8).

    Parameters
    ----------
    fractions : (M,) area fractions, sum 1
    means : (M, B) class means [1]

    Raises
    ------
    UsageError : negative fractions, or fractions that do not sum to 1.
    """
    f = _fractions(fractions)
    return np.asarray(f @ np.asarray(means, dtype=float))  # (3.8)


def mixture_covariance(
    fractions: npt.ArrayLike, means: npt.ArrayLike, covariances: Sequence[npt.ArrayLike] | Array
) -> Array:
    """Covariance of a pixel drawn from the whole scene, Sigma_ave of (3.11).

    sum f_m [Sigma_m + (rho_m - rho_ave)(rho_m - rho_ave)^T]: within-class and between-class spread.

    Parameters
    ----------
    fractions : (M,) area fractions, sum 1
    means : (M, B)
    covariances : M arrays (B, B)
    """
    f = _fractions(fractions)
    mu = np.asarray(means, dtype=float)
    d = mu - average_reflectance(f, mu)
    result = (d * f[:, None]).T @ d
    for part, covariance in zip(f, covariances, strict=True):
        result += part * np.asarray(covariance, dtype=float)
    return np.asarray(result)  # Sigma_ave of (3.11)


def _fractions(fractions: npt.ArrayLike) -> Array:
    f = np.asarray(fractions, dtype=float)
    if f.ndim != 1 or f.size == 0 or np.any(f < 0) or abs(float(f.sum()) - 1.0) > 1e-6:
        raise UsageError(
            f"the area fractions {np.array2string(f, precision=4)} are not a partition of the scene",
            expected="non-negative numbers that sum to 1",
        )
    return f


Formulation = Literal["corrected", "thesis"]


def mean_radiance(
    terms: AtmosphericTerms,
    reflectance: npt.ArrayLike,
    average_reflectance: npt.ArrayLike,
    formulation: Formulation = "corrected",
) -> Array:
    """Mean radiance of a class at the sensor (3.7) [uW cm-2 sr-1 nm-1].

    L = L_a + (A rho + B rho_ave) / (1 - S rho_ave).  The printed form runs the engine with the class
    all over the ground, so that its ground term trains light between class and sky: A rho / (1 - S rho).

    Parameters
    ----------
    terms : (B,) each
    reflectance : (..., B) of the viewed pixel [1]
    average_reflectance : (B,) of its surroundings [1]
    """
    rho, rho_ave = np.asarray(reflectance, dtype=float), np.asarray(average_reflectance, dtype=float)
    trapping = 1.0 - terms.spherical_albedo * rho_ave
    path = terms.path_radiance + terms.adjacency * rho_ave / trapping  # L_P of (3.7)
    own = trapping if formulation == "corrected" else 1.0 - terms.spherical_albedo * rho
    return np.asarray(path + terms.direct * rho / own)  # (3.7)


def toa_reflectance(radiance: npt.ArrayLike, diffuser_radiance: npt.ArrayLike) -> Array:
    """(..., B) reflectance at the top of the atmosphere of a radiance (3.7), pi L d^2 / (mu0 E0) [1].

    Parameters
    ----------
    radiance : (..., B) L above the atmosphere
    diffuser_radiance : (B,) mu0 E0 / (pi d^2), what a white level diffuser would have there, in the same unit

    Source: Nicodemus et al., NBS Monograph 160, 1977 (reflectance factor of a Lambertian diffuser).

    Examples
    --------
    >>> toa_reflectance([2.0, 1.0], [10.0, 4.0]).tolist()
    [0.2, 0.25]
    """
    return np.asarray(np.asarray(radiance, dtype=float) / np.asarray(diffuser_radiance, dtype=float))


def target_pixel_reflectance(fill: npt.ArrayLike, target: npt.ArrayLike, host: npt.ArrayLike) -> Array:
    """Reflectance of a pixel of which the target fills the part ``fill`` (3.10) [1].

    Parameters
    ----------
    fill : scalar or (...,) fill fraction f [1]
    target, host : (B,) reflectance of target and of the class around it

    Returns
    -------
    (..., B), to be put into :func:`mean_radiance` for (3.9).
    """
    f = np.asarray(fill, dtype=float)[..., None]
    return np.asarray(f * np.asarray(target, dtype=float) + (1.0 - f) * np.asarray(host, dtype=float))  # (3.10)


def illumination_factor(
    terms: AtmosphericTerms, average_reflectance: npt.ArrayLike, beam: float | Array, sky_view: float | Array
) -> Array:
    """Light on a shaded surface as a part of that on open ground (on the ground term of 3.7), (B,) [1].

    phi = (1 - S rho_ave) [(1 - q) beam + q sky_view] + S rho_ave sky_view, with q the part of the light on a black
    ground that comes from the sky.  Light that went up from the ground and came back is sky light too, so that
    the ground term is A rho [(1 - q) beam + q sky_view + sky_view S rho_ave / (1 - S rho_ave)].  What hides
    the sky is taken as black.  The printed form knows no shade: there the factor goes on the reflectance.

    Parameters
    ----------
    beam : part of the sun's beam that reaches the surface: 1 open, 0 in full shade
    sky_view : part of the sky's light that reaches it, 0-1

    Raises
    ------
    UsageError : the atmosphere does not tell sky light from the sun's beam.
    """
    if terms.diffuse_fraction is None:
        raise UsageError(
            "the atmosphere does not say how much of the light on the ground comes from the sky",
            mend="use the engine sixs, or leave out illumination",
        )
    q, back = terms.diffuse_fraction, terms.spherical_albedo * np.asarray(average_reflectance, dtype=float)
    return np.asarray((1.0 - back) * ((1.0 - q) * beam + q * sky_view) + back * sky_view)


def direct_slope(
    terms: AtmosphericTerms, average_reflectance: npt.ArrayLike, formulation: Formulation = "corrected"
) -> Array:
    """D_A of (3.11): change of radiance per change of the pixel's own reflectance, (B,)."""
    albedo = np.asarray(average_reflectance, dtype=float) if formulation == "corrected" else 1.0
    return np.asarray(terms.direct / (1.0 - terms.spherical_albedo * albedo))


def adjacency_slope(
    terms: AtmosphericTerms,
    reflectance: npt.ArrayLike,
    average_reflectance: npt.ArrayLike,
    formulation: Formulation = "corrected",
) -> Array:
    """D_B of (3.11): change of radiance per change of the surroundings' reflectance, (..., B).

    The derivative of (3.7) by rho_ave is (A S rho + B) / (1 - S rho_ave)^2.
    """
    rho, s = np.asarray(reflectance, dtype=float), terms.spherical_albedo
    if formulation == "thesis":
        return np.asarray(terms.adjacency / (1.0 - s) + np.zeros_like(rho))
    trapping = 1.0 - s * np.asarray(average_reflectance, dtype=float)
    return np.asarray((terms.direct * s * rho + terms.adjacency) / trapping**2)


def radiance_covariance(
    terms: AtmosphericTerms,
    reflectance: npt.ArrayLike,
    covariance: npt.ArrayLike,
    average_reflectance: npt.ArrayLike,
    average_covariance: npt.ArrayLike,
    *,
    adjacency_gain: float = 1.0,
    kappa: float = 0.0,
    formulation: Formulation = "corrected",
    out: Array | None = None,
    scratch: Array | None = None,
) -> Array:
    """Pixel-to-pixel covariance of radiance before the sensor (3.11), also (3.12) with the target pixel's.

    Sigma_L = D_A Sigma D_A + kappa D_B g_B Sigma_ave D_B.  ``covariance`` already holds its own gain
    (:func:`target_pixel_covariance`, or g_B Sigma_m for a background class).

    Parameters
    ----------
    terms : (B,) each
    reflectance, covariance : (B,), (B, B) of the pixel; the reflectance enters D_B alone
    average_reflectance, average_covariance : (B,), (B, B) of the scene
    adjacency_gain : g_B on the adjacency term
    kappa : 1/N_eff, the variance of the neighbourhood average as a part of that of one pixel; the
        printed form has 1, whatever is given here
    out, scratch : (B, B) memory for the result and to work in; None: fresh memory

    Returns
    -------
    (B, B) [(uW cm-2 sr-1 nm-1)^2]
    """
    d_a = direct_slope(terms, average_reflectance, formulation)
    d_b = adjacency_slope(terms, reflectance, average_reflectance, formulation)
    weight = adjacency_gain * (kappa if formulation == "corrected" else 1.0)
    result: Array = np.multiply(np.asarray(covariance, dtype=float), d_a[:, None], out=out)
    result *= d_a
    if weight:
        around = np.multiply(np.asarray(average_covariance, dtype=float), (weight * d_b)[:, None], out=scratch)
        around *= d_b
        result += around
    return result  # (3.11)


def target_pixel_covariance(
    fill_mean: float,
    fill_variance: float,
    target: npt.ArrayLike,
    target_covariance: npt.ArrayLike,
    host: npt.ArrayLike,
    host_covariance: npt.ArrayLike,
    *,
    target_gain: float = 1.0,
    host_gain: float = 1.0,
    fine_texture: float = 0.0,
    formulation: Formulation = "corrected",
) -> Array:
    """Reflectance covariance of pixels partly filled by the target (3.12, extended to random fill).

    E[f^2] g_T Sigma_T + E[(1-f)^2] g_B Sigma_b + Var(f) (rho_T - rho_b)(rho_T - rho_b)^T; the printed
    form is the case Var(f) = 0.  The square of f is that of a target that varies from pixel to pixel as a whole.
    Texture finer than its part of a pixel averages out over it, to Sigma_T/f: such goes by E[f].

    Parameters
    ----------
    fill_mean, fill_variance : moments of the fill fraction f [1]
    target, host : (B,) means;  target_covariance, host_covariance : (B, B)
    target_gain, host_gain : g_T, g_B
    fine_texture : part of Sigma_T that is of such texture

    Returns
    -------
    (B, B)
    """
    variance = fill_variance if formulation == "corrected" else 0.0
    f2 = fill_mean**2 + variance  # E[f^2]
    f2 += fine_texture * (fill_mean - f2)
    g2 = (1.0 - fill_mean) ** 2 + variance  # E[(1-f)^2]
    result = (f2 * target_gain) * np.asarray(target_covariance, dtype=float)
    result += (g2 * host_gain) * np.asarray(host_covariance, dtype=float)
    d = np.asarray(target, dtype=float) - np.asarray(host, dtype=float)
    if variance or not np.all(np.isfinite(d)):  # a band without a mean has no covariance either
        result += np.outer(variance * d, d)
    return np.asarray(result)  # (3.12)
