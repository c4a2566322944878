"""How many independent pixels a region is worth: neighbours on the ground resemble each other."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import fft

Array = npt.NDArray[np.float64]
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


def independent_for_mean(n: int, correlation: Array, shares: Array) -> float:
    """n / sum_h rho(h) share(h): independent values that give the mean of n the same variance; 1 to n.

    Source: Cressie, Statistics for Spatial Data, 1993, section 1.3.
    """
    return float(np.clip(n / max(float(np.sum(correlation * shares)), 1.0), 1.0, n))


def independent_for_variance(n: int, correlation: Array, shares: Array) -> float:
    """n / sum_h rho(h)^2 share(h): the same for the variance of normal values; 1 to n.

    cov(x^2, y^2) = 2 rho^2 sigma^4 of two normal values takes the place of cov(x, y) = rho sigma^2.
    """
    return float(np.clip(n / max(float(np.sum(correlation**2 * shares)), 1.0), 1.0, n))
