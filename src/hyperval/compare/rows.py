"""Making rows of the results table.

The bands of two spectra that can be compared, and intervals of differences and their summaries.

Change of a number over time, from one value a day.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import scipy

from hyperval.errors import UsageError
from hyperval.metrics import Evidence
from hyperval.processing.intervals import Z95
from hyperval.products import SpectralEstimate
from hyperval.results import Cause, Outcome, Result
from hyperval.spectra.axis import SPECTRAL_REGIONS_NM, SpectralAxis, in_window

# The metric of a row that stands for a whole comparison which could not be made.
COMPARISON = "comparison"

T = TypeVar("T")


@dataclass(frozen=True)
class RowMaker:
    """Fills in what the rows of one comparison share; their campaign is named when all of them are there."""

    product: str
    subject: str
    method: str

    def row(
        self,
        metric: str,
        value: float,
        *,
        interval: tuple[float, float] | None = None,
        half: float = math.nan,
        unit: str = "1",
        band_nm: float = math.nan,
        n: int | None = None,
        detectable: float = math.nan,
        evidence: Evidence | None = None,
        reason: str = "",
    ) -> Result:
        """A row without an outcome; what is planned gives it one later.  ``half``: half of its interval's width."""
        low, high = interval or (value - half, value + half)
        return Result(
            "", self.product, self.subject, self.method, metric, float(value), unit, float(band_nm),
            float(low), float(high), n, evidence=evidence, detectable=float(detectable),
            reason=reason,
        )  # fmt: skip

    def skipped(self, cause: Cause, reason: str, metric: str = COMPARISON) -> Result:
        """A planned row that has no value, with the cause and words."""
        return Result(
            "", self.product, self.subject, self.method, metric, outcome=Outcome.SKIPPED, cause=cause,
            reason=reason,
        )  # fmt: skip

    def compared(self, predicted: T | None, observed: T | None, rows: Callable[[T, T], list[Result]]) -> list[Result]:
        """The rows, or one skipped row that says which side has no such product."""
        if predicted is not None and observed is not None:
            return rows(predicted, observed)
        missing = [name for name, side in (("prediction", predicted), ("observation", observed)) if side is None]
        cause = Cause.NO_PREDICTION if predicted is None else Cause.NO_OBSERVATION
        return [self.skipped(cause, f"no {self.product} of {self.subject} in the {' and in the '.join(missing)}")]


def scientific(value: float) -> str:
    """A short label of a probability: 0.01 is 1e-2.

    Examples
    --------
    >>> scientific(0.01), scientific(2.5e-4)
    ('1e-2', '2.5e-4')
    """
    exponent = math.floor(math.log10(value) + 1e-9)
    return f"{value / 10.0**exponent:.3g}e{exponent}"


Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
_DRAWS = 1000
_SEED = 20180216


def comparable_bands(predicted: SpectralEstimate, collected: SpectralEstimate, axis: SpectralAxis) -> Mask:
    """(B,) True where the band is good and both sides have a value and an uncertainty."""
    for name, side in (("predicted", predicted), ("observed", collected)):
        if side.mean.shape != (len(axis),) or side.error_covariance.shape != (len(axis), len(axis)):
            raise UsageError(
                f"the {name} spectrum has shape {side.mean.shape} with a covariance {side.error_covariance.shape}",
                expected=f"the {len(axis)} bands of the axis on both sides",
            )
    usable = np.isfinite(predicted.mean) & np.isfinite(collected.mean)
    usable &= np.isfinite(np.diag(predicted.error_covariance)) & np.isfinite(np.diag(collected.error_covariance))
    return usable & axis.good


def regions(axis: SpectralAxis) -> Mapping[str, Mask]:
    """Bands of each summary: all windows, their part in VNIR, SWIR1 and SWIR2, and the absorption bands."""
    wavelength = axis.centre_nm
    window = in_window(wavelength)
    parts = {"windows": window}
    for name, (low, high) in SPECTRAL_REGIONS_NM.items():
        parts[name.lower()] = window & (wavelength >= low) & (wavelength < high)
    parts["absorption"] = ~window & (wavelength >= 400.0) & (wavelength <= 2500.0)
    return parts


def difference_interval(
    a: float, a_interval: tuple[float, float], b: float, b_interval: tuple[float, float]
) -> tuple[float, float]:
    """Interval of a - b from the separate intervals of two independent estimates.

    L = a - b - sqrt((a - l_a)^2 + (u_b - b)^2), U = a - b + sqrt((u_a - a)^2 + (b - l_b)^2).
    Source: Newcombe, Stat. Med. 17, 873-890, 1998, method 10; Zou & Donner, Stat. Med. 27, 1693-1702, 2008.

    Examples
    --------
    >>> low, high = difference_interval(0.8, (0.7, 0.9), 0.5, (0.5, 0.5))
    >>> round(low, 6), round(high, 6)
    (0.2, 0.4)
    """
    low = a - b - math.hypot(a - a_interval[0], b_interval[1] - b)
    high = a - b + math.hypot(a_interval[1] - a, b - b_interval[0])
    return low, high


def median_interval(ratio: Array, covariance: Array) -> tuple[float, float]:
    """95 % interval of the median over bands of a signed ratio.

    The error of the median is taken as that of the mean over the same bands, 1^T C 1/B^2: errors common
    to the bands, which are what is left after averaging, move both alike.  NaN where neither side states an error:
    an interval of no width would claim to know the value.
    """
    if not np.any(covariance):
        return math.nan, math.nan
    centre = float(np.median(ratio))
    half = Z95 * float(np.sqrt(max(float(np.mean(covariance)), 0.0)))
    return centre - half, centre + half


def size_intervals(ratio: Array, covariance: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    """95 % intervals of the median and of the greatest |ratio| over bands.

    Errors e of covariance C are drawn and the size taken of ratio - e: its 97.5 % point is the upper end, and the
    lower end lies as far below the value, not below 0.  Errors alone make a size, so that the draws themselves
    would put the lower end above it.  NaN where neither side states an error.

    Examples
    --------
    >>> import numpy as np
    >>> size_intervals(np.array([0.1, -0.2, 0.3]), np.zeros((3, 3)))[0]
    (nan, nan)
    """
    if not np.any(covariance):
        return (math.nan, math.nan), (math.nan, math.nan)
    values, vectors = np.linalg.eigh(covariance)
    drawn = (vectors * np.sqrt(np.clip(values, 0.0, None))) @ _standard_normal(values.size)
    drawn -= ratio[:, None]
    # One sort costs a quarter of the selection of a median.
    ordered = np.sort(np.abs(drawn, out=drawn), axis=0)
    middle = (ordered[(values.size - 1) // 2] + ordered[values.size // 2]) / 2.0
    out = []
    for value, sizes in (
        (float(np.median(np.abs(ratio))), middle),
        (float(np.max(np.abs(ratio))), ordered[-1]),
    ):
        half = max(float(np.quantile(sizes, 0.975)) - value, 0.0)
        out.append((max(value - half, 0.0), value + half))
    return out[0], out[1]


@lru_cache(maxsize=8)
def _standard_normal(bands: int) -> Array:
    """(bands, draws), which every spectrum of the same bands shares."""
    drawn = np.random.default_rng(_SEED).standard_normal((bands, _DRAWS))
    drawn.flags.writeable = False
    return drawn


FEWEST = 3


@dataclass(frozen=True)
class Drift:
    """Change in a year.

    Attributes
    ----------
    per_year, lower, upper : least-squares slope and its 95 % interval [unit of the values per year]
    scatter : standard deviation of the days about the line
    n : days
    """

    per_year: float
    lower: float
    upper: float
    scatter: float
    n: int

    def outcome(self, low: float, high: float) -> Outcome:
        """The interval against an accepted range."""
        if low <= self.lower and self.upper <= high:
            return Outcome.AGREES
        return Outcome.DISAGREES if self.upper < low or self.lower > high else Outcome.UNDECIDED


def drift(years: npt.ArrayLike, values: npt.ArrayLike) -> Drift:
    """Slope of values (n,) over times (n,) [years] with Student's interval from their scatter about the line.

    Errors that all days share, such as that of the calibration, cancel in it; those of single days show as scatter,
    whatever was stated of them.  Source: Draper & Smith, Applied Regression Analysis, 1998, 1.4.

    Raises
    ------
    UsageError : fewer than three days, or all at one time.

    Examples
    --------
    >>> found = drift([0.0, 1.0, 2.0], [0.0, 0.01, 0.02])
    >>> round(found.per_year, 6), round(found.upper - found.lower, 6)
    (0.01, 0.0)
    """
    t, y = np.asarray(years, dtype=float), np.asarray(values, dtype=float)
    if t.size < FEWEST or np.ptp(t) == 0.0:
        raise UsageError(f"a drift of {t.size} days", expected=f"{FEWEST} days or more, at different times")
    centred = t - t.mean()
    slope = float(centred @ y / (centred @ centred))
    residual = y - y.mean() - slope * centred
    scatter = math.sqrt(float(residual @ residual) / (t.size - 2))
    half = float(scipy.stats.t.ppf(0.975, t.size - 2)) * scatter / math.sqrt(float(centred @ centred))
    return Drift(slope, slope - half, slope + half, scatter, int(t.size))
