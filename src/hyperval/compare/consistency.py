"""Do two spectra agree within their uncertainties?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import optimize, stats

from hyperval.errors import UsageError
from hyperval.processing.intervals import Z95, clopper_pearson
from hyperval.products import EstimatedPart

Array = npt.NDArray[np.float64]
Estimated = Sequence[EstimatedPart]

# Directions whose variance, in the correlation matrix, is below this part of the greatest are rounding noise.
EIGENVALUE_CUT = 1e-9
# A full test is asked what it would have found at this level in both tails, with this probability.
POWER_LEVEL, POWER = 1e-3, 0.8
# Fewer degrees of freedom of an estimated covariance for each direction say little of the least of them.
DOF_PER_DIRECTION = 3.0
ROUNDING = 1e-6  # of degrees of freedom
# Samples fewer than directions may hold this part of the variance in some direction without being seen in others.
UNSEEN_PART = 0.2


@dataclass(frozen=True)
class ChiSquare:
    """A chi-square statistic with its degrees of freedom; ``p_value`` = P(at least this large | consistent).

    ``covariance_dof`` nu: degrees of freedom behind the covariance; below infinity the statistic is Hotelling's
    T^2, and T^2 (nu - p + 1) / (nu p) follows F(p, nu - p + 1).
    """

    value: float
    dof: int
    covariance_dof: float = math.inf

    @property
    def reduced(self) -> float:
        """Value over degrees of freedom; NaN without any."""
        return self.value / self.dof if self.dof > 0 else float("nan")

    @property
    def p_value(self) -> float:
        """Upper tail probability; NaN without degrees of freedom."""
        p, nu = self.dof, self.covariance_dof
        if p <= 0 or nu <= p:
            return float("nan")
        if math.isinf(nu):
            return float(stats.chi2.sf(self.value, p))
        return float(stats.f.sf(self.value * (nu - p + 1.0) / (nu * p), p, nu - p + 1.0))


def z_scores(difference: npt.ArrayLike, covariance: npt.ArrayLike) -> Array:
    """(B,) difference over its standard uncertainty, sqrt(u_p^2 + u_c^2); NaN where that is 0.

    Examples
    --------
    >>> z_scores([0.2, 0.0], [[0.01, 0], [0, 0.01]]).round(6).tolist()
    [2.0, 0.0]
    """
    d = np.asarray(difference, dtype=float)
    variance = np.diag(np.asarray(covariance, dtype=float))
    return np.where(variance > 0, d, np.nan) / np.sqrt(np.where(variance > 0, variance, 1.0))


def share_inside(difference: npt.ArrayLike, covariance: npt.ArrayLike) -> tuple[float, tuple[float, float]]:
    """Share of bands with |z| <= 1.96 and its 95 % interval, bands whose errors hang together counted as fewer.

    Clopper and Pearson's limits for B^2 / sum rho^2 bands, rho being the correlation of the errors: whether two
    bands lie inside hangs together by its square and higher powers, so that this counts too few, not too many.

    Examples
    --------
    >>> share, (low, high) = share_inside([0.1, 0.1, 0.1, 0.3], 0.01 * np.eye(4))
    >>> share, round(low, 3), round(high, 3)
    (0.75, 0.194, 0.994)
    """
    c = np.asarray(covariance, dtype=float)
    sd = np.sqrt(np.diag(c))
    bands = float(sd.size**2 / np.sum((c / np.outer(sd, sd)) ** 2))
    inside = float(np.mean(np.abs(z_scores(difference, c)) <= Z95))
    low, high = clopper_pearson(inside * bands, bands)
    return inside, (float(low), float(high))


def chi_square_diagonal(difference: npt.ArrayLike, covariance: npt.ArrayLike) -> ChiSquare:
    """Sum of squared z: blind to errors that are common to bands, so it accepts too much."""
    z = z_scores(difference, covariance)
    z = z[np.isfinite(z)]
    return ChiSquare(float(np.sum(z**2)), int(z.size))


@dataclass(frozen=True)
class Whitening:
    """The directions in which a covariance of B bands is tested; :func:`chi_square_full` says which.

    Attributes
    ----------
    transform : (K, B), to a vector in units of its standard deviation in each direction
    covariance_dof : degrees of freedom behind the covariance in them
    """

    transform: Array
    covariance_dof: float

    def of(self, vector: npt.ArrayLike) -> Array:
        """(K, ...) of a vector (B,) or of vectors in columns; UsageError where a value is not finite."""
        x = np.asarray(vector, dtype=float)
        if not np.all(np.isfinite(x)):
            raise UsageError("a consistency test got NaN or infinity", mend="leave bands without a value out")
        return np.asarray(self.transform @ x)


Covariance = npt.ArrayLike | Whitening


def chi_square_full(difference: npt.ArrayLike, covariance: Covariance, estimated: Estimated = ()) -> ChiSquare:
    """r^T C^-1 r with the whole covariance of both sides.

    C is scaled to unit diagonal and eigen-decomposed; directions with less than ``EIGENVALUE_CUT`` of the
    greatest eigenvalue are left out, and the degrees of freedom are the directions kept.  Where parts of C were
    estimated from samples and there are fewer than three effective degrees of freedom for each direction
    (:func:`covariance_dof`), the smoothest directions are tested alone: as many cosines over the bands as the
    degrees of freedom allow, with the samples' own covariance.  They are chosen without the samples, so that
    Hotelling's law holds; a sample overstates the variance of its own leading directions, where it does not.

    Parameters
    ----------
    covariance : C (B, B), or what :func:`whitening` makes of it, once for several tests
    estimated : parts of the covariance that were estimated
    """
    tested = _whitening_of(covariance, estimated)
    r = tested.of(difference)
    return ChiSquare(float(r @ r), int(r.size), tested.covariance_dof)


def covariance_dof(parts: Sequence[tuple[Array, float]]) -> float:
    """Effective degrees of freedom of a covariance C = I of which ``parts`` (p, p) were estimated.

    nu = p (1 + p) / sum {tr(C_i^2) + tr(C_i)^2} / nu_i, the rest of C being known.  Source: Nel & van der Merwe,
    Commun. Stat. Theory Methods 15, 3719-3735, 1986, in the invariant form of Krishnamoorthy & Yu, Stat. Probab.
    Lett. 66, 161-169, 2004.
    """
    if not parts or parts[0][0].size == 0:
        return math.inf
    p = parts[0][0].shape[0]
    total = sum((np.sum(c * c.T) + np.trace(c) ** 2) / nu for c, nu in parts)
    return float(p * (1.0 + p) / total) if total > 0.0 else math.inf


def _whitening_of(covariance: Covariance, estimated: Estimated) -> Whitening:
    return covariance if isinstance(covariance, Whitening) else whitening(covariance, estimated)


def whitening(covariance: npt.ArrayLike, estimated: Estimated = ()) -> Whitening:
    """Directions of :func:`chi_square_full` for a covariance (B, B) and the parts of it that were estimated."""
    stated = np.asarray(covariance, dtype=float)
    models = [(p.covariance if p.model is None else p.model, p.dof) for p in estimated]
    widened = sum((p.covariance for p in estimated), np.zeros_like(stated))
    known = stated - widened
    some, whiten = _unit_directions(known + sum((m for m, _ in models), np.zeros_like(stated)))
    bands = np.ix_(some, some)
    nu = covariance_dof([(whiten.T @ m[bands] @ whiten, v) for m, v in models])
    if nu < DOF_PER_DIRECTION * whiten.shape[1]:
        samples = [
            (m, v) if p.sample is None else (p.sample, p.sample_dof)
            for p, (m, v) in zip(estimated, models, strict=True)
        ]
        whiten, nu = _smooth(known[bands], [(s[bands], v) for s, v in samples])
    transform = np.zeros((whiten.shape[1], some.size))
    transform[:, some] = whiten.T
    return Whitening(transform, nu)


def _smooth(known: Array, samples: Sequence[tuple[Array, float]]) -> tuple[Array, float]:
    """Cosines over the bands, half a wave more in each, with three degrees of freedom for each."""
    total = known + sum((s for s, _ in samples), np.zeros_like(known))
    scale = np.sqrt(np.diag(total))
    size = scale.size
    waves = np.cos(np.pi * (np.arange(size)[:, None] + 0.5) * np.arange(size) / size) / scale[:, None]
    within = waves.T @ total @ waves
    parts = [(waves.T @ s @ waves, v) for s, v in samples]
    kept = size
    while True:
        _, whiten = _unit_directions(within[:kept, :kept])
        here = [(whiten.T @ s[:kept, :kept] @ whiten, v) for s, v in parts]
        nu = covariance_dof(here)
        # Directions that no sample reaches have the known part alone: too little where samples count.
        nu = min([nu, *(v for s, v in here if v < kept and np.linalg.eigvalsh(s)[-1] > UNSEEN_PART)])
        if kept == 1 or (whiten.shape[1] == kept and nu >= DOF_PER_DIRECTION * kept - ROUNDING):
            return waves[:, :kept] @ whiten, nu
        kept = max(min(kept - 1, int((nu + ROUNDING) / DOF_PER_DIRECTION)), 1)


def chi_square_shape(
    difference: npt.ArrayLike, reference: npt.ArrayLike, covariance: Covariance, estimated: Estimated = ()
) -> ChiSquare:
    """What is left of the full chi-square when a multiple s of the reference spectrum may go (least squares).

    r^T C^-1 r - (s/sd)^2 with s = c^T C^-1 r/(c^T C^-1 c) and sd = (c^T C^-1 c)^-1/2, in the directions of
    :func:`chi_square_full`.
    """
    tested = _whitening_of(covariance, estimated)
    r, c, nu = tested.of(difference), tested.of(reference), tested.covariance_dof
    weight = float(c @ c)
    if weight <= 0.0:
        return ChiSquare(float(r @ r), int(r.size), nu)
    rest = r - float(c @ r) / weight * c
    return ChiSquare(float(rest @ rest), int(r.size) - 1, nu)


def detectable_tilts(
    reference: npt.ArrayLike, wavelength_nm: npt.ArrayLike, covariance: Covariance, estimated: Estimated = ()
) -> tuple[float, float]:
    """Tilts that the full test and the test of shape would reject with 80 % probability.

    A tilt of t multiplies the reference by 1 - t at one end of the bands and by 1 + t at the other.  The statistic
    of the full test is then noncentral chi-square with t^2 d^T C^-1 d, d the reference times the tilt of 1 (F where
    part of C was estimated); that of the shape has what of d is no multiple of the reference.  The level is 0.001
    in both tails together.

    Examples
    --------
    >>> full, shape = detectable_tilts([1.0, 1.0], [400.0, 500.0], [[1e-4, 0.0], [0.0, 1e-4]])
    >>> round(full, 3), round(shape, 3)
    (0.033, 0.031)
    """
    c, w = np.asarray(reference, dtype=float), np.asarray(wavelength_nm, dtype=float)
    span = float(np.ptp(w))
    if span == 0.0:
        return math.nan, math.nan
    tilt = c * (2.0 * (w - w.min()) / span - 1.0)
    tested = _whitening_of(covariance, estimated)
    whole, level, nu = tested.of(tilt), tested.of(c), tested.covariance_dof
    rest = whole - level * float(level @ whole) / max(float(level @ level), 1e-300)
    kept = whole.size
    return _detectable(float(whole @ whole), kept, nu), _detectable(float(rest @ rest), kept - 1, nu)


def _detectable(unit: float, dof: int, nu: float) -> float:
    """Size of a departure of noncentrality ``unit`` at size 1 that is rejected in 80 % of cases; NaN without."""
    if dof <= 0 or nu <= dof or not unit > 0.0:
        return math.nan
    if math.isinf(nu):
        limit = float(stats.chi2.isf(POWER_LEVEL / 2.0, dof))

        def power(x: float) -> float:
            return float(stats.ncx2.sf(limit, dof, x))
    else:
        limit = float(stats.f.isf(POWER_LEVEL / 2.0, dof, nu - dof + 1.0))

        def power(x: float) -> float:
            return float(stats.ncf.sf(limit, dof, nu - dof + 1.0, x))

    high = 10.0
    while power(high) < POWER:
        high *= 4.0
        if high > 1e9:
            return math.nan
    return math.sqrt(float(optimize.brentq(lambda x: power(x) - POWER, 1e-9, high, rtol=1e-6)) / unit)


def spectral_angle_degrees(a: npt.ArrayLike, b: npt.ArrayLike) -> float:
    """Angle between two spectra [degrees], exact for small angles: 2 atan2(|u - v|, |u + v|) of unit vectors.

    Source of the measure: Kruse et al., Remote Sens. Environ. 44, 145-163, 1993; of the form: Kahan 2006.

    Examples
    --------
    >>> round(spectral_angle_degrees([1, 0], [1, 1]), 6)
    45.0
    """
    u, v = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    lengths = float(np.linalg.norm(u)), float(np.linalg.norm(v))
    if min(lengths) == 0.0:
        return float("nan")
    u, v = u / lengths[0], v / lengths[1]
    return float(np.degrees(2.0 * np.arctan2(np.linalg.norm(u - v), np.linalg.norm(u + v))))


def _unit_directions(covariance: npt.ArrayLike) -> tuple[npt.NDArray[np.bool_], Array]:
    """Bands with a variance, and (bands, K) directions of unit variance and no covariance, the least first."""
    cov = np.asarray(covariance, dtype=float)
    sd = np.sqrt(np.diag(cov))
    if not np.all(np.isfinite(cov)):
        raise UsageError("a consistency test got NaN or infinity", mend="leave bands without a value out")
    some = np.asarray(sd > 0)
    if not np.any(some):
        return some, np.zeros((0, 0))
    scaled = cov[np.ix_(some, some)] / np.outer(sd[some], sd[some])
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2.0)
    keep = values > EIGENVALUE_CUT * values[-1]
    return some, vectors[:, keep] / sd[some][:, None] / np.sqrt(values[keep])
