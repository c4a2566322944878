"""Mean and covariance of regions of a cube in one pass over its blocks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.scene.statistics import ClassStatistics
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
SCENE = "scene"


class BlockLike(Protocol):
    """Some lines of a cube: ``values`` (lines, samples, B) and ``valid`` (lines, samples) from ``first_line``."""

    @property
    def first_line(self) -> int:
        """0-based line of the cube at which the block starts."""

    @property
    def values(self) -> npt.NDArray[Any]:
        """(lines, samples, B)."""

    @property
    def valid(self) -> npt.NDArray[np.bool_]:
        """(lines, samples)."""


@dataclass(frozen=True)
class SampleStatistics:
    """What a sample of pixels says of its population.

    Attributes
    ----------
    mean : (B,)
    covariance : (B, B) unbiased, divisor n - 1
    n : pixels used
    n_left_out : pixels of the region left out as invalid or not finite
    fourth : sum over pixels of |x - mean|^4, for the shrinkage intensity; NaN where it was not summed
    """

    mean: Array
    covariance: Array
    n: int
    n_left_out: int = 0
    fourth: float = 0.0

    @property
    def full_rank_possible(self) -> bool:
        """False when there are too few pixels (n <= B) for an invertible covariance."""
        return self.n > self.mean.size

    @property
    def condition_number(self) -> float:
        """Ratio of the greatest to the least eigenvalue; inf when singular."""
        values = np.linalg.eigvalsh(self.covariance)
        return float(values[-1] / values[0]) if values[0] > values[-1] * np.finfo(float).tiny else float("inf")

    @property
    def rank(self) -> int:
        """Number of eigenvalues above rounding error."""
        values = np.linalg.eigvalsh(self.covariance)
        return int(np.sum(values > max(values[-1], 0.0) * values.size * np.finfo(float).eps))

    @property
    def shrinkage(self) -> float:
        """Ledoit-Wolf intensity in [0, 1]: the part of the target mu I in the shrunk covariance.

        b^2/d^2 with S the covariance of divisor n, mu = tr S/B, d^2 = |S - mu I|^2 and
        b^2 = min(d^2, sum_k |x_k x_k^T - S|^2 / n^2), the sum being sum |x_k|^4 - n |S|^2.
        Source: Ledoit & Wolf, J. Multivariate Anal. 88, 365-411, 2004, section 3.
        """
        if np.isnan(self.fourth):
            raise UsageError("the fourth moment was not summed", mend="take statistics_of the pixels themselves")
        s = self.covariance * ((self.n - 1) / self.n)
        mu = np.trace(s) / s.shape[0]
        d2 = float(np.sum((s - mu * np.eye(s.shape[0])) ** 2))
        if d2 <= 0.0:
            return 1.0
        b2 = max(0.0, (self.fourth - self.n * float(np.sum(s**2))) / self.n**2)
        return min(1.0, b2 / d2)

    @property
    def shrunk_covariance(self) -> Array:
        """(B, B) well-conditioned covariance: (1 - a) S + a (tr S/B) I with a = :attr:`shrinkage`."""
        a, s = self.shrinkage, self.covariance
        return (1.0 - a) * s + a * np.trace(s) / s.shape[0] * np.eye(s.shape[0])

    def as_class(self, name: str, axis: SpectralAxis, *, shrink: bool = False, source: str = "") -> ClassStatistics:
        """The same numbers as a surface class, with the shrunk covariance on request."""
        covariance = self.shrunk_covariance if shrink else self.covariance
        if not self.full_rank_possible:
            note = f"{self.n} pixels for {self.mean.size} bands: rank at most {self.n - 1}"
            note += f", shrunk by {self.shrinkage:.3g}" if shrink else ""
            source = f"{source}; {note}" if source else note
        return ClassStatistics(name, axis, self.mean, covariance, self.n, source)


@dataclass
class _Moments:
    """Moments of a growing sample about its own mean; merging needs no common reference point.

    ``second`` = sum z z^T, ``third`` = sum |z|^2 z, ``fourth`` = sum |z|^4, with z = x - mean.
    """

    n: int
    mean: Array
    second: Array
    third: Array
    fourth: float
    left_out: int = field(default=0)

    @classmethod
    def of(cls, pixels: Array) -> _Moments:
        mean = pixels.mean(axis=0)
        z = pixels - mean
        q = np.einsum("ij,ij->i", z, z)
        return cls(len(z), mean, z.T @ z, q @ z, float(q @ q))

    def about(self, point: Array) -> tuple[Array, Array, float]:
        """The moments about another point (y = z + e, e = mean - point, sum z = 0)."""
        e = self.mean - point
        e2 = float(e @ e)
        trace = float(np.trace(self.second))
        se = self.second @ e
        second = self.second + self.n * np.outer(e, e)
        third = self.third + e * trace + 2.0 * se + self.n * e2 * e
        fourth = self.fourth + 4.0 * float(e @ se) + self.n * e2**2 + 4.0 * float(e @ self.third) + 2.0 * e2 * trace
        return second, third, fourth

    def merge(self, other: _Moments) -> _Moments:
        """Moments of both samples together (Chan, Golub & LeVeque 1983 for the second)."""
        n = self.n + other.n
        mean = self.mean + (other.mean - self.mean) * (other.n / n)
        (s2, s3, s4), (o2, o3, o4) = self.about(mean), other.about(mean)
        return _Moments(n, mean, s2 + o2, s3 + o3, s4 + o4, self.left_out)

    def statistics(self, shift: Array) -> SampleStatistics:
        covariance = self.second / (self.n - 1)
        return SampleStatistics(
            self.mean + shift, (covariance + covariance.T) / 2.0, self.n, self.left_out, max(self.fourth, 0.0)
        )


def statistics_of(pixels: npt.ArrayLike, *, left_out: int = 0) -> SampleStatistics:
    """Statistics of pixels (n, B) that are at hand at once; n >= 2, all finite."""
    x = np.asarray(pixels, dtype=float)
    if x.ndim != 2 or x.shape[0] < 2 or not np.all(np.isfinite(x)):
        raise UsageError(f"statistics need two or more finite pixels (n, B), got an array of {x.shape}")
    moments = _Moments.of(x - x[0])
    moments.left_out = left_out
    return moments.statistics(x[0])


def accumulate_statistics(
    blocks: Iterable[BlockLike],
    masks: Mapping[str, npt.NDArray[np.bool_]] | None = None,
    exclude: npt.NDArray[np.bool_] | Mapping[str, npt.NDArray[np.bool_]] | None = None,
    bands: npt.NDArray[Any] | None = None,
) -> dict[str, SampleStatistics]:
    """Mean and covariance of every region and of the whole scene, in one pass.

    Pixels are taken relative to the first one of their region, which keeps every digit on bright flat scenes;
    each block is centred on its own mean, summed in float64 and merged.  The result does not depend on how
    the cube is cut into blocks, to 1e-12 of a standard deviation.

    Parameters
    ----------
    blocks : blocks of the cube, each line once
    masks : (lines, samples) True on the pixels of each region; the name "scene" is kept for the whole
    exclude : (lines, samples) True on pixels left out of the scene (targets with their guard ring), or such
        masks by region name
    bands : mask or indices of the bands to use; all by default.  A pixel is left out, and counted, when it is
        marked invalid or is not finite in one of these bands

    Raises
    ------
    UsageError : a mask that does not fit the cube, or a region with fewer than two valid pixels.
    """
    wanted: dict[str, npt.NDArray[np.bool_] | None] = {SCENE: None}
    if masks and SCENE in masks:
        raise UsageError(f"the region name {SCENE!r} is kept for the whole image")
    wanted.update({name: np.asarray(mask, dtype=bool) for name, mask in (masks or {}).items()})
    without: dict[str, npt.NDArray[np.bool_]] = {}
    if isinstance(exclude, Mapping):
        without = {name: np.asarray(mask, dtype=bool) for name, mask in exclude.items()}
        if unknown := set(without) - set(wanted):
            raise UsageError(f"pixels to leave out of unknown regions: {', '.join(sorted(unknown))}")
    elif exclude is not None:
        without = {SCENE: np.asarray(exclude, dtype=bool)}
    found: dict[str, _Moments] = {}
    shift: dict[str, Array] = {}
    left_out = dict.fromkeys(wanted, 0)
    lines_seen = 0
    for block in blocks:
        cube = block.values
        lines, samples = cube.shape[:2]
        rows = slice(block.first_line, block.first_line + lines)
        lines_seen = max(lines_seen, rows.stop)
        pixels = np.asarray(cube if bands is None else cube[..., bands], dtype=float).reshape(lines * samples, -1)
        usable = np.asarray(block.valid, dtype=bool).ravel() & np.isfinite(pixels).all(axis=1)
        for name, mask in wanted.items():
            inside = np.ones(lines * samples, bool) if mask is None else _rows(mask, rows, samples, name)
            if name in without:
                inside = inside & ~_rows(without[name], rows, samples, name)
            used = inside & usable
            left_out[name] += int(np.count_nonzero(inside) - np.count_nonzero(used))
            if not used.any():
                continue
            chosen = pixels if used.all() else pixels[used]
            part = _Moments.of(chosen - shift.setdefault(name, chosen[0].copy()))
            found[name] = found[name].merge(part) if name in found else part
    for name, mask in (*wanted.items(), *without.items()):
        if mask is not None and mask.shape[0] != lines_seen:
            raise UsageError(f"the mask of {name!r} has {mask.shape[0]} lines, the cube {lines_seen}")
    for name in wanted:
        n = found[name].n if name in found else 0
        if n < 2:
            raise UsageError(
                f"region {name!r} has {n} valid pixels ({left_out[name]} left out as invalid)",
                expected="two or more",
            )
        found[name].left_out = left_out[name]
    return {name: found[name].statistics(shift[name]) for name in wanted}


def _rows(mask: npt.NDArray[np.bool_], rows: slice, samples: int, name: str) -> npt.NDArray[np.bool_]:
    part = mask[rows]
    if part.shape != (rows.stop - rows.start, samples):
        raise UsageError(
            f"the mask of {name!r} has shape {mask.shape}",
            expected=f"{samples} samples and at least {rows.stop} lines",
        )
    return part.ravel()
