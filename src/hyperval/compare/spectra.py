"""Two spectra: comparable bands, intervals, whether they agree within their uncertainties, drift over days.

All subjects of one sensor together: the difference d(s, q) = ln(predicted / measured) of subject s in a piece q of the
spectrum is x(q) + e(s, q).  x is what all share, of the sensor or of the model, and may be anything.  The errors e have
the covariance C of all stated sources at once: one of the model's inputs or of the calibration is the same draw for
every subject and piece, one of the atmosphere for every subject of a day, one of the field readings for every piece of
its own subject.  So an input that is off shows in all pieces together, and x is what it cannot explain.  In the
logarithm the size of a relative error does not depend on the difference itself, which would pull x down (Peelle's
puzzle; Chiba & Smith 1991, ANL/NDM-121).

Smooth sources leave next to nothing between neighbouring pieces, where real spectra differ by some tenths of a percent;
C alone would read inputs from these.  So each e has an error of its own besides, of the standard deviation t and the
correlation exp(-distance / length) over wavelength that the differences between subjects show: their posterior by the
restricted likelihood (Harville, J. Am. Stat. Assoc. 72, 320-338, 1977) with a half-Cauchy prior of t (Gelman, Bayesian
Anal. 1, 515-534, 2006), over which x is averaged.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property, lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from hyperval import pixels
from hyperval.compare.rows import Interval, row, said, skip_as, skip_rows
from hyperval.data import Array, Index, Mask
from hyperval.errors import refuse
from hyperval.metrics import Kind, metric_of
from hyperval.model.intervals import Z95, clopper_pearson, difference_ratio, difference_ratio_covariance
from hyperval.products import EstimatedPart, Products, SpectralEstimate
from hyperval.results import Cause, Effect, Outcome, Result, Role
from hyperval.spectra.axis import SPECTRAL_REGIONS_NM, SpectralAxis

_DRAWS = 1000
_SEED = 20180216


def comparable_bands(predicted: SpectralEstimate, collected: SpectralEstimate, axis: SpectralAxis) -> Mask:
    """(B,) True where the band is good and both sides have a value and an uncertainty."""
    usable = np.isfinite(predicted.mean) & np.isfinite(collected.mean)
    usable &= np.isfinite(np.diag(predicted.error_covariance)) & np.isfinite(np.diag(collected.error_covariance))
    return usable & axis.good


def regions(axis: SpectralAxis) -> Mapping[str, Mask]:
    """Bands of each summary: all windows, their part in VNIR, SWIR1 and SWIR2, and the absorption bands.

    Of bands by number none: 500 is no green light, nor is 1400 of water.

    >>> {len(of[of]) for of in regions(SpectralAxis(np.arange(1.0, 1500.0), 1.0)).values()}
    {0}
    """
    wavelength, window = axis.centre_nm, axis.in_windows
    ends = SPECTRAL_REGIONS_NM.items()
    parts = {name.lower(): window & (wavelength >= low) & (wavelength < high) for name, (low, high) in ends}
    dark = ~window & (wavelength >= 400.0) & (wavelength <= 2500.0) & (not axis.numbered)
    return {"windows": window, **parts, "absorption": dark}


def mean_half_width(covariance: Array) -> float:
    """Half of the 95 % interval of an unweighted mean over bands; NaN without any."""
    return Z95 * math.sqrt(max(float(np.sum(covariance)), 0.0)) / (len(covariance) or math.nan)


def summary_intervals(ratio: Array, covariance: Array) -> tuple[Interval, Interval, Interval]:
    """95 % intervals of the median ratio over bands, and of the median and the greatest |ratio|.

    Errors e of covariance C are drawn.  That of the median is normal, with the variance 1^T C 1/B^2 of the mean and by
    how much draws of the median of ratio - e vary more than their mean: errors common to the bands move both alike,
    those of single bands the median more, and the more so the further apart the ratios lie.

    Of a size the upper end is the 97.5 % point of the size of ratio - e; the lower end lies as far below the value,
    and no less than that of the size of e, but not below 0.  Errors alone make a size, so that a true one of 0 shows
    as more, the greatest of many bands most of all.  NaN where neither side states an error: an interval of no width
    would claim to know the value.

    Examples
    --------
    >>> import numpy as np
    >>> summary_intervals(np.array([0.1, -0.2, 0.3]), np.zeros((3, 3)))[0]
    (nan, nan)

    What is noise alone is not larger than 0.

    >>> noise = 0.06 * np.random.default_rng(7).standard_normal(112)
    >>> [round(low, 4) for low, _ in summary_intervals(noise, 0.06**2 * np.eye(112))[1:]]
    [0.0, 0.0]

    The median of ratios that lie far apart, each with an error of its own, is held in 95 % of 400 cases; by the error
    of their mean alone it was held in 39 %.

    >>> rng, true, error = np.random.default_rng(8), np.linspace(-0.02, 0.02, 42), 1e-3**2 * np.eye(42)
    >>> ends = [summary_intervals(true + 1e-3 * rng.standard_normal(42), error)[0] for _ in range(400)]
    >>> bool(0.92 < np.mean([low < 0.0 < high for low, high in ends]) < 0.99)
    True
    """
    if not np.any(covariance):
        return 3 * ((math.nan, math.nan),)
    values, vectors = np.linalg.eigh(covariance)
    # By the symmetric root: it stays where rounding turns eigenvectors of nearly equal values.
    normal = np.random.default_rng(_SEED).standard_normal((values.size, _DRAWS))
    drawn = (vectors * np.sqrt(np.clip(values, 0.0, None))) @ (vectors.T @ normal)
    centre, more = float(np.median(ratio)), np.median(ratio[:, None] - drawn, axis=0).var() - drawn.mean(axis=0).var()
    half = math.hypot(mean_half_width(covariance), Z95 * math.sqrt(max(more, 0.0)))
    value = _median_and_maximum(ratio[:, None])[:, 0]
    high, alone = (np.quantile(_median_and_maximum(x), 0.975, axis=1) for x in (drawn - ratio[:, None], drawn))
    high = np.maximum(high, value)
    (low, lowest), (high, highest) = np.maximum(value - np.maximum(high - value, alone), 0.0), high
    return (centre - half, centre + half), (float(low), float(high)), (float(lowest), float(highest))


def _median_and_maximum(x: Array) -> Array:
    """(2, D) median and greatest |x| over bands of (B, D); one sort costs a quarter of the selection of a median."""
    ordered, bands = np.sort(np.abs(x), axis=0), len(x)
    return np.stack([(ordered[(bands - 1) // 2] + ordered[bands // 2]) / 2.0, ordered[-1]])


FEWEST = 3


def drift(years: npt.ArrayLike, values: npt.ArrayLike) -> Effect:
    """Change in a year of values (n,) over times (n,) [years]: the least-squares slope with its 95 % interval.

    The interval is Student's, from the scatter about the line.  Errors that all days share, such as that of the
    calibration, cancel in it; those of single days show as scatter, whatever was stated of them.  Source: Draper &
    Smith, Applied Regression Analysis, 1998, 1.4.

    Raises
    ------
    UsageError : fewer than three days, or all at one time.

    Examples
    --------
    >>> found = drift([0.0, 1.0, 2.0], [0.0, 0.01, 0.02])
    >>> round(found.value, 6), round(found.upper - found.lower, 6)
    (0.01, 0.0)
    >>> drift([0.0, 1.0, 2.0], [0.25, 0.25, 0.25]).upper  # no scatter
    0.0
    """
    t, y = np.asarray(years, dtype=float), np.asarray(values, dtype=float)
    refuse(t.size < FEWEST or np.ptp(t) == 0.0, "compare.drift", days=t.size, fewest=FEWEST)
    fit = scipy.stats.linregress(t, y)
    half, slope = float(scipy.stats.t.ppf(0.975, t.size - 2) * np.nan_to_num(fit.stderr)), float(fit.slope)
    return Effect(slope, slope - half, slope + half)


# Directions whose variance, in the correlation matrix, is below this part of the greatest are rounding noise.
EIGENVALUE_CUT = 1e-9
# A full test is asked what it would have found at this level in both tails, with this probability.
POWER_LEVEL, POWER = 1e-3, 0.8
FAR = 1e3  # a statistic above this has left its noncentral law, whose series fails soon, for that of its root
# Fewer degrees of freedom of an estimated covariance for each direction say little of the least of them.
DOF_PER_DIRECTION = 3.0
DOF_ROUNDING = 1e-6  # of degrees of freedom
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
    def ratio(self) -> float:
        """The statistic over what it is expected to be where both sides agree: that of :func:`central_law`."""
        p, nu = self.dof, self.covariance_dof
        return self.value / p * (1.0 if math.isinf(nu) else (nu - p + 1.0) / nu)

    @property
    def p_value(self) -> float:
        """Upper tail probability; NaN without degrees of freedom."""
        p, nu = self.dof, self.covariance_dof
        return float(central_law(p, nu).sf(self.ratio)) if 0 < p < nu else math.nan

    @property
    def effect(self) -> Effect | None:
        """The difference over its stated uncertainty: the root of the statistic over what it is expected to be.

        Its interval is that of sqrt(1 + lambda / p), lambda the noncentrality behind the statistic; of one too small
        for any the upper end is that of a stated uncertainty that is too large.  None without degrees of freedom.

        Examples
        --------
        >>> found = ChiSquare(20.9, 11).effect
        >>> [round(x, 2) for x in (found.value, found.lower, found.upper, *found.accepted(0.001))]
        [1.38, 1.0, 1.94, 0.38, 1.74]
        """
        p, nu = self.dof, self.covariance_dof
        if not 0 < p < nu:
            return None
        least, ratio = float(central_law(p, nu).ppf(0.025)), self.ratio
        low, high = (math.sqrt(1.0 + noncentrality(ratio, p, nu, part) / p) for part in (0.975, 0.025))
        if ratio < least:
            high = math.sqrt(ratio / least)
        size, found = math.sqrt(ratio), math.sqrt(1.0 + rejected_noncentrality(p, nu) / p)
        return Effect(size, min(low, size), max(high, size), partial(accepted_sizes, p, nu), (math.nan, found))


@lru_cache(maxsize=256)  # scipy takes longer to make a law than to ask it
def central_law(dof: int, nu: float) -> Any:
    """Law of a chi-square or of Hotelling's statistic over what it is expected to be, where both sides agree."""
    return scipy.stats.chi2(dof, scale=1.0 / dof) if math.isinf(nu) else scipy.stats.f(dof, nu - dof + 1.0)


def accepted_sizes(dof: int, nu: float, level: float) -> tuple[float, float]:
    """Differences over stated uncertainty that chance alone stays between, both tails of the level together."""
    low, high = np.sqrt(central_law(dof, nu).ppf([level / 2.0, 1.0 - level / 2.0]))
    return float(low), float(high)


def noncentrality(ratio: float, dof: int, nu: float, part: float) -> float:
    """Noncentrality for which a statistic over ``dof`` lies below ``ratio`` with the probability ``part``; at least 0.

    The root of a large statistic is normal with a variance of 1, but for what the covariance's own error adds.

    >>> import warnings
    >>> with warnings.catch_warnings(action="error"):
    ...     round(noncentrality(278.3, 16, 862.1, 0.025))
    4949
    """
    total = ratio * dof
    spread = math.sqrt(1.0 + total / (2.0 * (nu - dof + 1.0)))

    def below(x: float) -> float:
        if math.isinf(nu):
            return float(scipy.stats.ncx2.cdf(total, dof, x)) - part
        return float(scipy.stats.ncf.cdf(ratio, dof, nu - dof + 1.0, x)) - part

    high = (math.sqrt(total) + 5.0 * spread) ** 2 + 10.0
    if total > FAR or not below(high) < 0.0:
        return max((math.sqrt(total) - spread * float(scipy.special.ndtri(part))) ** 2 - dof, 0.0)
    return 0.0 if below(1e-9) <= 0.0 else float(scipy.optimize.brentq(below, 1e-9, high, rtol=1e-6))


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

    def whiten(self, vector: npt.ArrayLike) -> Array:
        """(K, ...) of a vector (B,) or of vectors in columns; UsageError where a value is not finite."""
        x = np.asarray(vector, dtype=float)
        refuse(not np.all(np.isfinite(x)), "compare.finite")
        return np.asarray(self.transform @ x)


def chi_square_full(difference: npt.ArrayLike, tested: Whitening) -> ChiSquare:
    """r^T C^-1 r with the whole covariance of both sides.

    C is scaled to unit diagonal and eigen-decomposed; directions with less than ``EIGENVALUE_CUT`` of the
    greatest eigenvalue are left out, and the degrees of freedom are the directions kept.  Where parts of C were
    estimated from samples and there are fewer than three effective degrees of freedom for each direction
    (:func:`covariance_dof`), the smoothest directions are tested alone: as many cosines over the bands as the
    degrees of freedom allow, with the samples' own covariance.  They are chosen without the samples, so that
    Hotelling's law holds; a sample overstates the variance of its own leading directions, where it does not.

    ``tested`` : what :func:`whitening` makes of C, once for several tests
    """
    r = tested.whiten(difference)
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


def whitening(covariance: npt.ArrayLike, estimated: Sequence[EstimatedPart] = ()) -> Whitening:
    """Directions of :func:`chi_square_full` for a covariance (B, B) and the parts of it that were estimated.

    >>> of_two_pixels = np.outer([1.0, 0.0, 2.0], [1.0, 0.0, 2.0])  # which are alike in the second band
    >>> whitening(of_two_pixels, [EstimatedPart(of_two_pixels, 1.0)]).transform.round(6).tolist()
    [[0.5, 0.0, 0.25]]
    """
    stated = np.asarray(covariance, dtype=float)
    fixed = stated - sum((p.covariance for p in estimated), np.zeros_like(stated))
    parts = [(p, p.covariance if p.model is None else p.model) for p in estimated]
    kept, whiten = _unit_directions(fixed + sum((m for _, m in parts), np.zeros_like(stated)))
    nu = covariance_dof([(whiten.T @ m @ whiten, p.dof) for p, m in parts])
    if nu < DOF_PER_DIRECTION * whiten.shape[1]:
        samples = [(m, p.dof) if p.sample is None else (p.sample, p.sample_dof) for p, m in parts]
        bands = np.ix_(kept, kept)
        smooth, nu = _smooth_basis(fixed[bands], [(s[bands], v) for s, v in samples])
        whiten = np.zeros((kept.size, smooth.shape[1]))
        whiten[kept] = smooth
    else:
        nu = covariance_dof([_with_factors(p, m, whiten) for p, m in parts])
    return Whitening(whiten.T, nu)


def _with_factors(part: EstimatedPart, model: Array, whiten: Array) -> tuple[Array, float]:
    """A part in units of C, and the degrees of freedom of a Wishart matrix that scatters as much as r^T C^-1 r.

    Factors F scatter as tr(F^2) + tr(F)^2, they with bands D as 2 tr(F) tr(D), and each band's own variance, of
    which r^T C^-1 r holds D_b C^-1_bb, as 2 sum (D_b C^-1_bb)^2, all over the samples' degrees of freedom.
    """
    c = whiten.T @ model @ whiten
    if part.factors is None:
        return c, part.dof
    f, rest = whiten.T @ part.factors @ whiten, np.diag(model - part.factors) * np.sum(whiten**2, axis=1)
    scatter = np.sum(f * f.T) + np.trace(f) ** 2 + 2.0 * (np.trace(f) * np.trace(c - f) + np.sum(rest**2))
    return c, part.sample_dof * float((np.sum(c * c.T) + np.trace(c) ** 2) / scatter)


def _smooth_basis(fixed: Array, samples: Sequence[tuple[Array, float]]) -> tuple[Array, float]:
    """Cosines over the bands, each with half a wave more, as many as have three degrees of freedom each."""
    total = fixed + sum((s for s, _ in samples), np.zeros_like(fixed))
    scale = np.sqrt(np.diag(total))
    size = scale.size
    waves = np.cos(np.pi * (np.arange(size)[:, None] + 0.5) * np.arange(size) / size) / scale[:, None]
    within = waves.T @ total @ waves
    parts = [(waves.T @ s @ waves, v) for s, v in samples]
    kept = size
    while True:
        _, whiten = _unit_directions(within[:kept, :kept])
        whitened = [(whiten.T @ s[:kept, :kept] @ whiten, v) for s, v in parts]
        nu = covariance_dof(whitened)
        # Directions outside the span of a sample hold the fixed part alone, which is too small.
        nu = min([nu, *(v for s, v in whitened if v < kept and np.linalg.eigvalsh(s)[-1] > UNSEEN_PART)])
        if kept == 1 or (whiten.shape[1] == kept and nu >= DOF_PER_DIRECTION * kept - DOF_ROUNDING):
            return waves[:, :kept] @ whiten, nu
        kept = max(min(kept - 1, int((nu + DOF_ROUNDING) / DOF_PER_DIRECTION)), 1)


def chi_square_shape(difference: npt.ArrayLike, reference: npt.ArrayLike, tested: Whitening) -> ChiSquare:
    """What is left of the full chi-square when a multiple s of the reference spectrum may go (least squares).

    r^T C^-1 r - (s/sd)^2 with s = c^T C^-1 r/(c^T C^-1 c) and sd = (c^T C^-1 c)^-1/2, in the directions of
    :func:`chi_square_full`.
    """
    r, c, nu = tested.whiten(difference), tested.whiten(reference), tested.covariance_dof
    if (weight := float(c @ c)) <= 0.0:
        return ChiSquare(float(r @ r), int(r.size), nu)
    rest = r - float(c @ r) / weight * c
    return ChiSquare(float(rest @ rest), int(r.size) - 1, nu)


def detectable_tilts(reference: npt.ArrayLike, wavelength_nm: npt.ArrayLike, tested: Whitening) -> tuple[float, float]:
    """Tilts that the full test and the test of shape would reject with 80 % probability.

    A tilt of t multiplies the reference by 1 - t at one end of the bands and by 1 + t at the other.  The statistic
    of the full test is then noncentral chi-square with t^2 d^T C^-1 d, d the reference times the tilt of 1 (F where
    part of C was estimated, whose inverse is nu / (nu - p - 1) times as great on average); that of the shape has what
    of d is no multiple of the reference.  The level is 0.001 in both tails together.

    Examples
    --------
    >>> full, shape = detectable_tilts([1.0, 1.0], [400.0, 500.0], whitening(1e-4 * np.eye(2)))
    >>> round(full, 3), round(shape, 3)
    (0.033, 0.031)
    """
    c, w = np.asarray(reference, dtype=float), np.asarray(wavelength_nm, dtype=float)
    span = float(np.ptp(w))
    if span == 0.0:
        return math.nan, math.nan
    tilt = c * (2.0 * (w - w.min()) / span - 1.0)
    whole, level, nu = tested.whiten(tilt), tested.whiten(c), tested.covariance_dof
    rest = whole - level * float(level @ whole) / max(float(level @ level), 1e-300)
    kept = whole.size
    true = 1.0 if math.isinf(nu) else max(nu - kept - 1.0, 0.0) / nu
    return _detectable(true * float(whole @ whole), kept, nu), _detectable(true * float(rest @ rest), kept - 1, nu)


def _detectable(unit: float, dof: int, nu: float) -> float:
    """Size of a departure of noncentrality ``unit`` at size 1 that is rejected in 80 % of cases; NaN without."""
    return math.sqrt(rejected_noncentrality(dof, nu) / unit) if unit > 0.0 else math.nan


@lru_cache(maxsize=256)
def rejected_noncentrality(dof: int, nu: float) -> float:
    """Noncentrality that a test at the level of 0.001 in both tails rejects in 80 % of cases; NaN without any."""
    if dof <= 0 or nu <= dof:
        return math.nan
    return noncentrality(float(central_law(dof, nu).isf(POWER_LEVEL / 2.0)), dof, nu, 1.0 - POWER)


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


def _unit_directions(covariance: npt.ArrayLike) -> tuple[Mask, Array]:
    """Bands with a variance, and (B, K) directions of unit variance and no covariance in them, the least first.

    >>> rank_one = np.array([[4.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, -1e-17]])  # the last by rounding
    >>> _unit_directions(rank_one)[1].round(9).tolist()
    [[0.25], [0.5], [0.0]]
    """
    cov = np.asarray(covariance, dtype=float)
    sd = np.sqrt(np.clip(np.diag(cov), 0.0, None))
    refuse(not np.all(np.isfinite(cov)), "compare.finite")
    some = np.asarray(sd > 0)
    scaled = cov[np.ix_(some, some)] / np.outer(sd[some], sd[some])
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2.0)
    keep = values > EIGENVALUE_CUT * np.max(values, initial=0.0)
    directions = np.zeros((sd.size, int(keep.sum())))
    directions[some] = vectors[:, keep] / sd[some][:, None] / np.sqrt(values[keep])
    return some, directions


def wavelength_rows(predicted: SpectralEstimate, observed: SpectralEstimate, axis: SpectralAxis) -> Iterator[Result]:
    """Rows ``absorption_centre_difference@FEATURE`` [nm], predicted less measured, of what both sides show.

    Both centres come from the same bands in the same way, so that what a band set does to a centre falls out.  The
    interval holds the stated errors of both spectra within the absorption; where none is stated there is none.

    Examples
    --------
    >>> w = np.arange(700.0, 830.0, 2.5)
    >>> def side(centre_nm):
    ...     depth = 0.5 * np.exp(-0.5 * ((w - centre_nm) / 4.0) ** 2)
    ...     return SpectralEstimate(1.0 - depth, 1e-6 * np.eye(w.size))
    >>> axis = SpectralAxis(w, np.full(w.size, 5.0))
    >>> [(r.metric, round(r.value, 1)) for r in wavelength_rows(side(764.0), side(763.0), axis)]
    [('absorption_centre_difference@oxygen-763', 1.0)]
    """
    use = axis.good & np.isfinite(predicted.mean) & np.isfinite(observed.mean)
    i = np.flatnonzero(use)[np.argsort(axis.centre_nm[use], kind="stable")]
    w = axis.centre_nm[i]
    for feature in pixels.FEATURES:
        centres = [pixels.absorption_centre(w, side.mean[i], feature)[0] for side in (predicted, observed)]
        if not any(map(math.isnan, centres)):
            sd = [
                pixels.centre_uncertainty(w, side.mean[i], side.error_covariance[np.ix_(i, i)], feature, centre)
                for side, centre in zip((predicted, observed), centres, strict=True)
            ]
            half = Z95 * math.hypot(*sd) or math.nan
            yield row(f"absorption_centre_difference@{feature.key}", centres[0] - centres[1], half=half, n=observed.n)


def shifted_rows(predicted: Products, observed: Products) -> Iterator[Result]:
    """Row ``wavelength_shift@FEATURE`` [nm], a criterion that is not met, of every feature that is not in its place.

    Every number of a spectrum depends on its wavelengths, and a shift may bring model and data together.  The level
    of 5 % is shared among the features that the spectra show; where none is off by so much there is no row.  What
    rises elsewhere than plants by its own predicted reflectance, such as a dyed cloth, has no edge of theirs.

    Examples
    --------
    >>> from hyperval.products import ObservedProducts
    >>> w = np.arange(600.0, 900.0, 5.0)
    >>> def side(shift):
    ...     plant = SpectralEstimate(0.05 + 0.4 / (1.0 + np.exp((717.0 + shift - w) / 8.0)), np.eye(w.size))
    ...     return ObservedProducts(SpectralAxis(w, 5.0), reflectance={"grass": plant})
    >>> [(r.metric, round(r.value)) for shift in (0.0, 14.0) for r in shifted_rows(side(0.0), side(shift))]
    [('wavelength_shift@red-edge-of-plants', 14)]
    >>> list(shifted_rows(side(15.0), side(14.0)))
    []
    """
    spectra = dict(observed.radiance or observed.reflectance)
    for name, spectrum in predicted.reflectance.items() if not observed.radiance else ():
        edges = pixels.wavelength_shifts(spectrum.mean, predicted.axis, reflectance=True)
        if any(s.is_significant and s.feature == pixels.RED_EDGE.name for s in edges):
            spectra.pop(name, None)
    found = pixels.common_shifts((s.mean for s in spectra.values()), observed.axis, reflectance=not observed.radiance)
    for shift, count in found:
        half = float(scipy.special.ndtri(1.0 - 0.025 / len(found))) * shift.uncertainty_nm
        if abs(shift.nm) > half:
            name, ends = f"wavelength_shift@{shift.feature.replace(' ', '-')}", (shift.nm - half, shift.nm + half)
            yield row(
                name, shift.nm, ends, n=count, role=Role.GATE, outcome=Outcome.DISAGREES, limit_low=0.0, limit_high=0.0,
                about=Effect(shift.nm, *ends, lambda _: (0.0, 0.0)), reason="comparisons by wavelength are not valid",
            )  # fmt: skip


# Two measurements never meet to this part of their level.
ROUNDING = 1e-9
# Spectra of files and cubes have 24 bits: a smaller stated uncertainty is none.
NUMERICAL = 6e-8
# Of what a source states of its values: about 95 % of a normal law.
STATED_COVERAGE = 2.0


MIN_OF_NOISE = 0.9  # of the sensor's signal-to-noise ratio, which texture takes beyond what its estimate allows for


def snr_beside_texture(predicted: Products, subject: str) -> Array:
    """(B,) part of the sensor's SNR that its estimate from an image is expected to show: texture counts as noise there.

    Where its median is below ``MIN_OF_NOISE`` what is measured is not what is predicted.  1 where no spread is
    predicted, or too few bands tell.

    >>> axis, flat = SpectralAxis(np.arange(500.0, 900.0, 100.0), 10.0), np.full(4, 100.0)
    >>> class_, panel = (SpectralEstimate(flat, np.eye(4), c) for c in (26.0 * np.eye(4), None))
    >>> snr = {s: SpectralEstimate(flat, np.eye(4)) for s in ("field", "panel")}
    >>> products = Products(axis, radiance={"field": class_, "panel": panel}, snr=snr)
    >>> [snr_beside_texture(products, s).round(2).tolist() for s in ("field", "panel")]
    [[0.2, 0.2, 0.2, 0.2], [1.0, 1.0, 1.0, 1.0]]
    >>> dark = replace(class_, pixel_covariance=np.diag([26.0, 26.0, 26.0, np.nan]))  # a band that tells nothing
    >>> snr_beside_texture(replace(products, radiance={"field": dark}), "field").round(2).tolist()
    [0.2, 0.2, 0.2, 0.2]
    """
    radiance, noise, good = predicted.radiance.get(subject), predicted.snr.get(subject), predicted.axis.good
    if radiance is None or noise is None or radiance.pixel_covariance is None or good.sum() < 3:
        return np.ones(len(predicted.axis))
    part = np.minimum(pixels.snr_from_moments(radiance.mean, radiance.pixel_covariance, good) / noise.mean, 1.0)
    # Bands that tell nothing are as those that do.
    return np.where(np.isfinite(part), part, np.nanmedian(part) if np.isfinite(part).any() else 1.0)


def compare_spectra(
    predicted: SpectralEstimate, observed: SpectralEstimate, axis: SpectralAxis, product: str = "radiance"
) -> Iterator[Result]:
    """Rows of one spectrum.

    Per good band: ``difference_ratio`` with its 95 % interval, and ``z``.  Per region R of windows, vnir, swir1,
    swir2, absorption: ``median_difference_ratio_R`` (with interval), ``median_abs_difference_ratio_R`` and
    ``max_abs_difference_ratio_R``.  Over the windows: ``chi2_reduced_diagonal``, ``p_value_diagonal``,
    ``chi2_reduced_full``, ``p_value_full``, ``bias_ratio`` (mean difference ratio), ``chi2_reduced_shape``,
    ``p_value_shape``, ``fraction_inside_95`` (bands with |z| <= 1.96) and ``spectral_angle``; of radiance
    :func:`hyperval.compare.spectra.wavelength_rows` where both sides have the absorptions of the atmosphere.
    A region without a comparable band gives SKIPPED rows; one that the sensor does not see gives none.  A measured
    spectrum that is no evidence, since the prediction's own input made it, gives one SKIPPED row.  Where the source
    of the observation states more than its error in the comparison, besides ``fraction_inside_stated`` and
    ``fraction_inside_stated_windows``.
    """
    if observed.circular:
        yield from skip_rows(Cause.CIRCULAR, observed.circular)
        return
    usable, n = comparable_bands(predicted, observed, axis), observed.n
    ratio = difference_ratio(predicted.mean, observed.mean)
    covariance = difference_ratio_covariance(predicted, observed)
    half = Z95 * np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    half = np.where(half > 0.0, half, np.nan)  # no error is stated: no interval
    difference = predicted.mean - observed.mean
    z = z_scores(difference, predicted.error_covariance + observed.error_covariance)
    for b in np.flatnonzero(usable):
        nm, why = float(axis.centre_nm[b]), "" if np.isfinite(ratio[b]) else "observed value is not positive"
        yield row("difference_ratio", ratio[b], half=half[b], band_nm=nm, n=n, reason=why)
        if np.isfinite(z[b]):
            yield row("z", z[b], band_nm=nm, n=n)
    parts = regions(axis)
    window = usable & parts["windows"]
    for ending, bands in (("", usable), ("_windows", window)):
        if observed.stated is not None and bands.any():
            share = fraction_inside_stated(difference[bands], observed.stated[bands])
            yield row(f"fraction_inside_stated{ending}", share, n=int(bands.sum()))
    for name, region in parts.items():
        if region.any() or name == "windows":  # what the sensor does not see was not planned
            yield from _summary(name, ratio, covariance, usable & region)
    if window.any():
        yield from _consistency(predicted, observed, window, axis.centre_nm, ratio, covariance)
    else:
        yield from skip_as("no_bands.region", *_TESTS, "spectral_angle", region="windows")
    if product == "radiance":
        yield from wavelength_rows(predicted, observed, axis)


def fraction_inside_stated(difference: Array, stated: Array) -> float:
    """Share of bands whose difference (B,) is at most twice the standard uncertainty (B,) that a source states."""
    return float(np.mean(np.abs(difference) <= STATED_COVERAGE * stated))


def variance_shares(predicted: SpectralEstimate, measured: SpectralEstimate, bands: Mask) -> list[tuple[str, float]]:
    """Sources of both sides with their parts of the variance of the mean difference ratio, the largest first."""
    p, o = predicted.mean[bands], measured.mean[bands]
    found: dict[str, float] = {}
    for side, slope in ((predicted, 1.0 / o), (measured, p / o**2)):
        variance = float(slope @ side.error_covariance[np.ix_(bands, bands)] @ slope)
        by_source = {name: float(np.nansum((slope * u[bands]) ** 2)) for name, u in side.budget.items()}
        for name, errors in side.errors.items():
            by_source[name] = float(np.sum((np.nan_to_num(errors.rows[:, bands]) @ slope) ** 2))
        for name, part in by_source.items():
            found[name] = found.get(name, 0.0) + variance * part / max(sum(by_source.values()), 1e-300)
    total = sum(found.values())
    return sorted(((name, part / total) for name, part in found.items()), key=lambda item: -item[1])


MAX_WITHOUT_RATIO = 0.1  # of the bands of a region
_SUMMARIES = ("median_difference_ratio", "median_abs_difference_ratio", "max_abs_difference_ratio")


def _summary(name: str, ratio: Array, covariance: Array, bands: Mask) -> Iterator[Result]:
    """Rows of a region; none where more than a tenth of its bands have no ratio, as the model may be wrong there.

    >>> ratio, one = np.array([0.01, 0.0, 0.02, np.nan]), np.ones(4, dtype=bool)
    >>> [(r.value, r.reason[:6]) for r in _summary("windows", ratio, np.eye(4), one)][0]
    (nan, '1 of 4')
    """
    names, use = [f"{metric}_{name}" for metric in _SUMMARIES], bands & np.isfinite(ratio)
    lost = {"lost": int(np.sum(bands & ~use)), "count": int(bands.sum())}
    if lost["lost"] > MAX_WITHOUT_RATIO * lost["count"] or not use.any():
        yield from skip_as("no_bands.positive" if use.any() else "no_bands.region", *names, region=name, **lost)
        return
    why, r, spread = said("no_bands.positive", **lost) if lost["lost"] else "", ratio[use], covariance[np.ix_(use, use)]
    values, intervals = (np.median(r), np.median(np.abs(r)), np.max(np.abs(r))), summary_intervals(r, spread)
    for metric, value, interval in zip(names, values, intervals, strict=True):
        yield row(metric, value, interval, n=r.size, reason=why)


_TESTS = (
    "chi2_reduced_diagonal", "p_value_diagonal", "chi2_reduced_full", "p_value_full",
    "bias_ratio", "chi2_reduced_shape", "p_value_shape", "fraction_inside_95",
)  # fmt: skip


def _consistency(
    predicted: SpectralEstimate, observed: SpectralEstimate, window: Mask, centre_nm: Array, ratio: Array, errors: Array
) -> Iterator[Result]:  # fmt: skip
    """Rows over the windows: every test of the two spectra, and the angle between them.

    ``ratio``, ``errors`` : (B,) differences and their covariance
    """
    block, count = np.ix_(window, window), int(window.sum())
    p, o = predicted.mean[window], observed.mean[window]
    r, cov = p - o, (predicted.error_covariance + observed.error_covariance)[block]
    if not np.all(np.diag(cov) > (NUMERICAL * o) ** 2):
        yield from skip_as("no_uncertainty.bands", *_TESTS)
    elif np.max(np.abs(r)) <= ROUNDING * np.max(np.abs(o)):  # as of a panel on an empirical line of two panels
        yield from skip_as("circular.equal", *_TESTS)
    else:
        tested = whitening(cov, [e.of_each(lambda c: c[block]) for e in (*predicted.estimated, *observed.estimated)])
        tilts, full = detectable_tilts(o, centre_nm[window], tested), chi_square_full(r, tested)
        # A mixed pixel whose host varies by more than the signal of the target tests the host.
        largest = [(name, 100.0 * part) for name, part in variance_shares(predicted, observed, window) if part > 0.5]
        why = said("test", test=full, count=count, largest=largest).removesuffix("; ")
        yield from _test_rows("diagonal", chi_square_diagonal(r, cov))
        yield from _test_rows("full", full, tilts[0], why)
        # A mean weighted by the inverse covariance may lie outside all data where shapes differ (Chiba & Smith 1991).
        use = np.flatnonzero(window & np.isfinite(ratio))
        bias, half = float(ratio[use].sum()) / (use.size or math.nan), mean_half_width(errors[np.ix_(use, use)])
        yield row("bias_ratio", bias, half=half, n=use.size)
        yield from _test_rows("shape", chi_square_shape(r, o, tested), tilts[1])
        fraction, limits = share_inside(r, cov)
        yield row("fraction_inside_95", fraction, limits, n=count)
    yield row("spectral_angle", spectral_angle_degrees(p, o), n=count)


def _test_rows(name: str, test: ChiSquare, tilt: float = math.nan, why: str = "") -> Iterator[Result]:
    yield row(f"chi2_reduced_{name}", test.reduced, n=test.dof, reason=why)
    yield row(f"p_value_{name}", test.p_value, n=test.dof, detectable=tilt, reason=why, about=test.effect)


TOGETHER = ALL_SUBJECTS, UNSEEN_SUBJECTS = "all subjects", "unseen subjects"
REGIONS_NM = ((400, 450), (450, 700), (700, 1000), (1200, 1760), (2050, 2400))
# The bands between two of these have one gain of the sensor; every region is made of such pieces.
EDGES_NM = (
    400, 430, *range(450, 690, 30), *range(700, 1000, 30), *range(1000, 1701, 100), 1760, 2050, *range(2200, 2501, 100),
)  # fmt: skip
PIECES_NM = tuple(itertools.pairwise(EDGES_NM))
FIELD = "field spectrum"  # each subject's own draw
CALIBRATION, REST = "calibration", "noise and the rest"
UNSTATED = "differences that no source states"
_MIN_BANDS = 2
_MIN_CONTRAST = 0.05  # of the brightest: equally bright subjects do not separate gain and offset
# Standard deviations of what no source states, from what interpolation and rounding of the model leave; the median of
# its prior, as AVIRIS-NG's spectra differ from band to band.
UNSTATED_RATIOS, USUAL_RATIO = np.geomspace(1e-4, 0.1, 13), 0.01
UNSTATED_NM = (1.0, 30.0, 100.0, 300.0)  # how far they are correlated: not at all, to as far as field spectra
_MIN_LEFT = 0.1  # hardly anybody knows an input ten times better


class CommonDifference(NamedTuple):
    """What subjects have in common, with what no source states averaged over.

    Attributes
    ----------
    value, covariance : (k,), (k, k)
    weights : (k, N) that make the value of the differences
    errors : (N,) C^-1 times what is left of the differences: errors of one source are its covariance times these
    unstated : standard deviation of what no source states: median and 95 % limits
    """

    value: Array
    covariance: Array
    weights: Array
    errors: Array
    unstated: Array


@dataclass(frozen=True)
class JointDifference:
    """N differences ln(predicted / measured), each a mean over bands of one subject.

    Attributes
    ----------
    subject, piece : (N,) of which subject and which bands it is, as numbers
    difference : (N,)
    inverse_level : (N,) mean of 1 / predicted: the measured noise, which is in the difference, would bias an offset
    bands : (N,) how many there are
    sources : name -> (N, N) error covariance from one source, independent of the others
    """

    subject: Index
    piece: Index
    difference: Array
    inverse_level: Array
    bands: Array
    sources: Mapping[str, Array]

    @cached_property
    def covariance(self) -> Array:
        """(N, N) of all stated sources."""
        return np.asarray(sum(self.sources.values()))

    @cached_property
    def piece_indicator(self) -> Array:
        """(N, Q) 1 where a difference is of a piece, in the order of their numbers."""
        return np.asarray(self.piece[:, None] == np.unique(self.piece), dtype=float)

    def common_difference(self, columns: Array) -> CommonDifference:
        """Coefficients of ``columns`` (N, k) that all subjects share."""
        fits, middle = [], np.mean(PIECES_NM, axis=1)[self.piece]
        spacing = np.where(self.subject[:, None] == self.subject, np.abs(middle[:, None] - middle), np.inf)
        for unstated, length in itertools.product(UNSTATED_RATIOS, UNSTATED_NM):
            total = self.covariance + unstated**2 * np.exp(-spacing / length)
            solved = np.linalg.solve(total, np.column_stack([columns, self.difference]))
            information = columns.T @ solved[:, :-1]
            covariance = np.linalg.inv(information)
            weights = covariance @ solved[:, :-1].T
            value = weights @ self.difference
            errors = solved[:, -1] - solved[:, :-1] @ value
            size = np.linalg.slogdet(total)[1] + np.linalg.slogdet(information)[1]
            fits.append((value, covariance, weights, errors, -0.5 * (self.difference @ errors + size)))
        values, covariances, weights, errors, evidence = map(np.stack, zip(*fits, strict=True))
        # The prior of the logarithm; the standard deviations are evenly spaced in it.
        sizes = np.repeat(UNSTATED_RATIOS, len(UNSTATED_NM))
        share = scipy.special.softmax(evidence + np.log(sizes / (1.0 + (sizes / USUAL_RATIO) ** 2)))
        value = share @ values
        spread = np.tensordot(share, covariances, 1) + np.einsum("t,ti,tj->ij", share, values - value, values - value)
        limits = np.interp([0.5, 0.025, 0.975], np.cumsum(share) - 0.5 * share, sizes)
        return CommonDifference(value, spread, np.tensordot(share, weights, 1), share @ errors, limits)

    def budget(self, found: CommonDifference, combined: Array) -> dict[str, float]:
        """Standard uncertainty by source of a combination (k,) of what subjects have in common."""
        weights = combined @ found.weights
        parts = {name: float(weights @ c @ weights) for name, c in self.sources.items()}
        parts[UNSTATED] = float(combined @ found.covariance @ combined) - sum(parts.values())
        return {name: math.sqrt(max(part, 0.0)) for name, part in parts.items()}


def joint_difference(pairs: Mapping[str, tuple[SpectralEstimate, SpectralEstimate]], use: Mask) -> JointDifference:
    """Of spectra of both sides by subject, in the bands (S, Q, B) of every piece that each subject uses."""
    subject, piece = np.nonzero(use.any(axis=2))
    within, count = use[subject, piece], subject.size
    bands = within.sum(axis=1).astype(float)
    by_predicted, by_measured, of_sensor = np.zeros((3, *within.shape))
    difference, noise, relative = np.empty(count), np.zeros((count, count)), np.zeros(())
    for n, part in enumerate(within):
        p, m = list(pairs.values())[subject[n]]
        by_predicted[n, part], by_measured[n, part] = 1.0 / p.mean[part] / bands[n], 1.0 / m.mean[part] / bands[n]
        difference[n] = np.log(p.mean[part] / m.mean[part]).mean()
    directions: dict[tuple[str, str, int], Array] = {}  # source, draw and their number
    for i, (name, (p, m)) in enumerate(pairs.items()):
        entries, single = subject == i, np.nan_to_num(m.error_covariance)
        for source, errors in p.errors.items():
            key = source, name if source == FIELD else errors.draw, len(errors.rows)
            rows = directions.setdefault(key, np.zeros((len(errors.rows), count)))
            rows[:, entries] = np.nan_to_num(errors.rows) @ by_predicted[entries].T
        if m.calibration is not None:  # a relative error that all spectra of a sensor share
            level, common = np.where(m.mean > 0.0, m.mean, np.inf), np.nan_to_num(m.calibration)
            of_sensor[entries], relative = by_measured[entries] * np.nan_to_num(m.mean), common / np.outer(level, level)
            single = single - common
        noise[np.ix_(entries, entries)] = by_measured[entries] @ single @ by_measured[entries].T
    sources = {REST: noise}
    for (source, *_), rows in directions.items():
        sources[source] = sources.get(source, 0.0) + rows.T @ rows
    if of_sensor.any():
        sources[CALIBRATION] = of_sensor @ relative @ of_sensor.T
    return JointDifference(subject, piece, difference, by_predicted.sum(axis=1), bands, sources)


def joint_pieces(predicted: Products, observed: Products) -> JointDifference | None:
    """Differences of the radiance by subject and piece, where two subjects and more show it on both sides."""
    light, axis = observed.radiance, observed.axis
    mixed = {subject for subject, _ in predicted.scores}
    pairs = {s: (p, light[s]) for s, p in predicted.radiance.items() if s in light and s not in mixed and p.errors}
    pieces = [(axis.centre_nm >= low) & (axis.centre_nm < high) & axis.in_windows for low, high in PIECES_NM]
    good = [comparable_bands(p, m, axis) & (p.mean > 0) & (m.mean > 0) for p, m in pairs.values()]
    use = np.reshape(good, (-1, 1, len(axis))).astype(bool) & np.array(pieces)
    use &= np.count_nonzero(use, axis=2, keepdims=True) >= _MIN_BANDS
    use &= (np.count_nonzero(use.any(axis=2), axis=0) > 1)[:, None]
    return joint_difference(pairs, use) if use.any() else None


def _joint_regions(joint: JointDifference) -> Iterator[tuple[str, Array, Array]]:
    """Of each region its name, the combination of pieces (Q,) that is its mean, and those (S, N) of each subject."""
    ends = np.array(PIECES_NM)[joint.piece]
    for low, high in REGIONS_NM:
        bands = np.where((ends[:, 0] >= low) & (ends[:, 1] <= high), joint.bands, 0.0)
        if np.any(bands):
            each = bands * (joint.subject == np.unique(joint.subject[bands > 0.0])[:, None])
            pieces = bands @ joint.piece_indicator
            yield f"{low}-{high}", pieces / pieces.sum(), each / each.sum(axis=1, keepdims=True)


def _residual_chi_square(covariance: Array, difference: Array, column: Array) -> float:
    """Chi-square of the differences that remains after the best multiple of a column."""
    c = covariance + UNSTATED_RATIOS[0] ** 2 * np.eye(column.size)
    both = np.stack([column, difference])
    (of_column, mixed), (_, whole) = both @ np.linalg.solve(c, both.T)
    return float(whole - mixed**2 / of_column)


def subject_groups(observed: Products, fitted_on: Sequence[str]) -> dict[str, Products]:
    """What is compared jointly: everything; and what budget and settings were not ``fitted_on``, where they were."""
    unseen = {s: m for s, m in observed.radiance.items() if not any(fnmatchcase(s, name) for name in fitted_on)}
    return {ALL_SUBJECTS: observed} | ({UNSEEN_SUBJECTS: replace(observed, radiance=unseen)} if fitted_on else {})


def compare_jointly(predicted: Products, observed: Products) -> list[Result]:
    """Rows of each region: ``joint_difference_ratio@LOW-HIGH``; ``p_value_between``: whether the subjects differ.

    Of each piece of the spectrum ``sensor_gain`` where there is no offset, ``sensor_gain_beside_offset`` and
    ``sensor_offset`` where both are fitted; ``unstated_difference_ratio``: what subjects differ by from piece to piece
    beyond all stated errors.

    Examples
    --------
    >>> from hyperval.data import Errors
    >>> from hyperval.spectra.axis import SpectralAxis
    >>> axis, one = SpectralAxis([410.0, 420.0, 430.0], 10.0), np.ones(3)
    >>> errors = {"aerosol": Errors(0.03 * one[None])}
    >>> sites = {name: SpectralEstimate(1.1 * one, errors["aerosol"].covariance, errors=errors) for name in "ab"}
    >>> measured = {name: SpectralEstimate(one, 0.0001 * np.eye(3)) for name in "ab"}
    >>> level, between, *gains = compare_jointly(Products(axis, radiance=sites), Products(axis, radiance=measured))
    >>> level.metric, round(level.value, 6), round(level.upper - level.value, 3), round(between.value, 6)
    ('joint_difference_ratio@400-450', 0.1, 0.065, 1.0)
    """
    joint = joint_pieces(predicted, observed)
    if joint is None:
        return []
    found, rows = joint.common_difference(joint.piece_indicator), list[Result]()
    for label, pieces, mean in _joint_regions(joint):
        budget, d, n = joint.budget(found, pieces), mean @ joint.difference, len(mean)
        largest = {name: Z95 * x for name, x in sorted(budget.items(), key=lambda item: -item[1])[:3]}
        why = said("joint", least=np.expm1(d.min()), most=np.expm1(d.max()), largest=largest)
        value, half = float(pieces @ found.value), Z95 * math.hypot(*budget.values())
        number, *ends = np.expm1([value, value - half, value + half]).tolist()
        rows.append(row(f"joint_difference_ratio@{label}", number, ends, n=n, reason=why))
        levels = np.ones(n), mean @ joint.inverse_level
        gain, offset = (_residual_chi_square(mean @ joint.covariance @ mean.T, d, column) for column in levels)
        why = f"chi-square {gain:.3g} of {n - 1} as a gain, {offset:.3g} as an offset"
        rows.append(row(f"p_value_between@{label}", float(scipy.stats.chi2.sf(gain, n - 1)), n=n, reason=why))
    middle, *ends = found.unstated.tolist()
    rows.append(row("unstated_difference_ratio", middle, ends, n=joint.difference.size, reason=_pulls(joint, found)))
    return [*rows, *_sensor_rows(joint, found)]


def _pulls(joint: JointDifference, found: CommonDifference) -> str:
    """Departures of the inputs over their stated uncertainty, the greatest first."""
    sizes = {k: np.linalg.norm(c @ found.errors) / max(np.trace(c), 1e-300) ** 0.5 for k, c in joint.sources.items()}
    first = sorted(joint.sources.keys() - {CALIBRATION, REST}, key=lambda name: (-sizes[name], name))[:4]
    return "inputs in units of their stated uncertainty: " + ", ".join(f"{name} {sizes[name]:.1f}" for name in first)


def _sensor_rows(joint: JointDifference, found: CommonDifference) -> Iterator[Result]:
    """Gain of the sensor by pieces, and gain and offset together where subjects are not equally bright.

    The stated calibration uncertainty is not part of their errors: they estimate the calibration error itself.
    """
    count, numbers = joint.piece_indicator.sum(axis=0).astype(int), np.unique(joint.piece)
    common = np.exp(joint.difference @ joint.piece_indicator / count)
    by_level = joint.inverse_level[:, None] * joint.piece_indicator * common  # 1 / measured without its noise
    dark = np.where(by_level > 0.0, by_level, np.inf).min(axis=0)
    separable = np.flatnonzero(by_level.max(axis=0) * (1.0 - _MIN_CONTRAST) > dark).tolist()
    both = joint.common_difference(np.hstack([joint.piece_indicator, -by_level[:, separable]]))
    of_calibration = joint.sources.get(CALIBRATION, np.zeros(joint.covariance.shape))
    for name, fit, some in (("sensor_gain", found, range(count.size)), ("sensor_gain_beside_offset", both, separable)):
        halves = Z95 * np.sqrt(np.diag(fit.covariance - fit.weights @ of_calibration @ fit.weights.T))
        for k, q in enumerate(some):
            nm, n, (x, half) = sum(PIECES_NM[numbers[q]]) // 2, count[q], (fit.value[q], halves[q])
            yield row(f"{name}@{nm}", math.exp(-x), (math.exp(-x - half), math.exp(half - x)), n=int(n))
            if fit is both:
                yield row(f"sensor_offset@{nm}", fit.value[count.size + k], half=halves[count.size + k], n=int(n))


def would_decide(item: Result, predicted: Products, observed: Products, fitted_on: Sequence[str] = ()) -> str:
    """What would decide an inconclusive criterion, in words: how well which sources would have to be known, or how many
    more would have to be counted.  The value is taken to stay; of the interval the side counts where an end of the
    range lies, by the logarithm where that has the more even sides.  Of an area no more pixels can be had, and a number
    of bands or of pieces of a spectrum is none of independent samples.

    Examples
    --------
    >>> from hyperval.spectra.axis import SpectralAxis
    >>> nothing, limits = Products(SpectralAxis([410.0], 10.0)), {"limit_low": 0.5, "limit_high": 2.0}
    >>> alarms = Result("", "scores", "", "cem", "pfa_ratio@1e-2", 0.26, lower=0.105, upper=0.57, n=4773, **limits)
    >>> would_decide(alarms, nothing, nothing)
    '6878 pixels in place of 4773; or an interval 1.2 times narrower'
    >>> spread = replace(alarms, subject="all objects", metric="pit_spread_ratio", n=5)
    >>> would_decide(spread, nothing, nothing)
    '8 objects in place of 5; or an interval 1.2 times narrower'
    >>> halos = replace(spread, metric="pfa_ratio@1e-2", method="cem/object-by-pixel")
    >>> [would_decide(replace(halos, product=of), nothing, nothing)[:9] for of in ("roc", "covariance")]
    ['8 objects', '8 objects']
    >>> would_decide(replace(alarms, product="radiance", metric="unstated_difference_ratio"), nothing, nothing)
    'an interval 1.2 times narrower'
    >>> limits = {"limit_low": 0.75, "limit_high": 1.25}
    >>> area = Result("", "abundance", "", "", "area_ratio", 1.1032, lower=0.891, upper=1.3154, n=16, **limits)
    >>> would_decide(area, nothing, nothing), round((1.3154 - 1.1032) / (1.25 - 1.1032), 3)
    ('an interval 1.45 times narrower', 1.446)
    """
    times, metric = item.shortfall, metric_of(item.metric)
    if metric.kind is Kind.TEST:
        words = f"every stated uncertainty {times:.2g} times smaller, to detect {metric.departure or 'its alternative'}"
        return words if times > 1 else ""
    side = subject_groups(observed, fitted_on).get(item.subject)
    budget, subjects = _region_budget(item, predicted, side) if side else (_level_budget(item, predicted, observed), 1)
    ways: list[Callable[[float], float]] = [float, *([math.log] if item.lower > 0.0 else [])]

    def uneven(way: Callable[[float], float]) -> float:
        return abs(way(item.lower) + way(item.upper) - 2.0 * way(item.value)) / (way(item.upper) - way(item.lower))

    way = min(ways, key=uneven)
    low, value, high = way(item.lower), way(item.value), way(item.upper)
    ends = [way(end) for end in (item.limit_low, item.limit_high) if item.lower < end < item.upper]
    if not ends:
        return ""
    part = min((end - value) / ((high if end > value else low) - value) for end in ends)
    if part <= 0.0:
        return "another collection: the value is at the limit of its range"
    if not budget:
        counted = "objects" if "/object" in item.method or item.metric.startswith("pit_") else "pixels"
        narrows = item.n and item.product in ("scores", "roc", "covariance", "classification")
        more = f"{math.ceil((item.n or 0) / part**2)} {counted} in place of {item.n}; or " if narrows else ""
        return f"{more}an interval {1.0 / part:.3g} times narrower"
    same = [p for s, p in getattr(predicted, item.product).items() if side or s == item.subject]
    # Field spectra of several subjects have no one uncertainty.
    scales = {name: (e.size, e.unit) for p in same for name, e in p.errors.items() if not side or name != FIELD}
    return decisive_reductions(budget, part, scales, subjects)


def _region_budget(item: Result, predicted: Products, observed: Products) -> tuple[dict[str, float], int]:
    """Standard uncertainty by source of what subjects have in common in a region, and how many they are."""
    joint = joint_pieces(predicted, observed)
    for label, pieces, means in _joint_regions(joint) if joint else ():
        if joint and item.metric == f"joint_difference_ratio@{label}":
            return joint.budget(joint.common_difference(joint.piece_indicator), pieces), len(means)
    return {}, 1


def _level_budget(item: Result, predicted: Products, observed: Products) -> dict[str, float]:
    """The same of the level of one spectrum, all of them together 1; none of any other row."""
    p, m = (getattr(side, item.product, {}).get(item.subject) for side in (predicted, observed))
    if not isinstance(p, SpectralEstimate) or not isinstance(m, SpectralEstimate):
        return {}
    parts, use = regions(observed.axis), comparable_bands(p, m, observed.axis) & (m.mean > 0)
    use &= parts.get(item.metric.rpartition("_")[2], parts["windows"])
    return {name: math.sqrt(share) for name, share in variance_shares(p, m, use)} if use.any() else {}


def decisive_reductions(
    budget: Mapping[str, float], fraction: float, scales: Mapping[str, tuple[float, str]], subjects: int = 1
) -> str:
    """What reduces a half width to a ``fraction`` of it: each source alone, the fewest largest, more subjects.

    Parameters
    ----------
    budget : standard uncertainty by source
    scales : standard uncertainty of the inputs behind them, with units

    Examples
    --------
    >>> decisive_reductions({"aerosol": 0.03, "water": 0.01}, 0.5, {"aerosol": (0.02, ""), "water": (0.5, "g cm-2")})
    'aerosol known to 0.00816 (now 0.02)'
    >>> decisive_reductions({"aerosol": 0.03, "water": 0.03}, 0.5, {"aerosol": (0.02, ""), "water": (0.5, "g cm-2")})
    'aerosol known to 0.01 (now 0.02) and water known to 0.25 g cm-2 (now 0.5)'
    """
    total = sum(x**2 for x in budget.values())
    largest = sorted((name for name, x in budget.items() if x > 0.0), key=lambda name: -budget[name])

    def allowed_part(names: Sequence[str]) -> float:
        """The fraction of the uncertainty of these sources that may remain; 0 where no reduction suffices."""
        share = sum(budget[name] ** 2 for name in names)
        return math.sqrt(max(fraction**2 * total - (total - share), 0.0) / share)

    def sentence(names: Sequence[str]) -> str:
        sources = [(name, *scales.get(name, (math.nan, ""))) for name in names]
        return said("known", sources=sources, part=allowed_part(names))

    out = [sentence([name]) for name in largest if allowed_part([name]) > _MIN_LEFT][:3]
    pairs = [largest[:k] for k in range(2, len(largest) + 1) if allowed_part(largest[:k]) > _MIN_LEFT]
    out = out or [sentence(names) for names in pairs[:1]]
    single, goal = sum(budget.get(name, 0.0) ** 2 for name in (FIELD, REST, UNSTATED)), fraction**2 * total
    if subjects > 1 and goal > total - single:
        out.append(f"{math.ceil(subjects * single / (goal - (total - single)))} subjects in place of {subjects}")
    return " or ".join(out) or "more than this collection can provide: every source would need a smaller uncertainty"
