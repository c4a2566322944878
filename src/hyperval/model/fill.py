"""Fill fractions of target pixels from the geometry of target and pixel (f of 3.10 and 3.12).

The response of a pixel to the ground is its square aperture convolved with a Gaussian; the fill of
a pixel is the integral of that response over the target.  Since the responses of all pixels add up
to 1 everywhere, the sum of the fills times GSD^2 is the area of the target.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy
from scipy.linalg import eigh_tridiagonal
from scipy.special import ndtr

from hyperval.data import Array, Index, Mask
from hyperval.errors import UsageError, refuse
from hyperval.scenario import Fill, Geometry
from hyperval.spectra.axis import SIGMA_PER_FWHM

# Positions sampled: a Fibonacci lattice, whose 377 points integrate fills a hundred times better than a
# square grid of as many.
PHASES, _LATTICE = 377, 233
MAX_PIXELS_ACROSS = 64
Blur = float | tuple[float, float] | None  # FWHM in both directions, or (along, across) = (y, x) [pixels]
_FACTORS = np.log(2.0) * np.arange(-6.0, 40.0, 0.25)  # logarithms of those on sides, or on listed fills
_MEANS = (0.3, 0.6, 0.9, 0.999)  # greatest means of their tables; beyond the last a fill is full
_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True)
class FillDistribution:
    """A discrete distribution of the fill fraction f, or n of them.

    Attributes
    ----------
    values : (K,) fill fractions [1]; of n evaluations (n, K), common to all (1, K); NaN behind the last pixel of an
        object that has fewer
    weights : likewise, probabilities, sum 1; of objects those of their places
    shape : (places, pixels) of objects, whose pixels lie along K; None where a pixel is an object
    """

    values: Array
    weights: Array
    shape: tuple[int, int] | None = None

    @property
    def mean(self) -> float:
        """E[f], of one evaluation."""
        return float(self.weights.ravel() @ self.values.ravel())

    @property
    def variance(self) -> float:
        """Var f, of one evaluation."""
        return float(self.weights.ravel() @ (self.values.ravel() - self.mean) ** 2)

    def binned(self, bins: int = 48) -> FillDistribution:
        """The same distribution on at most ``bins`` values: bin means, so that E[f] is kept exactly.

        >>> fill = FillDistribution(np.random.default_rng(1).random(2000), np.full(2000, 1 / 2000))
        >>> binned = fill.binned(48)
        >>> binned.values.size, round(abs(binned.mean - fill.mean), 12)
        (48, 0.0)
        >>> lost = (1 / 48) ** 2 / 12  # within a bin of width h the variance is h^2 / 12
        >>> bool(abs(fill.variance - binned.variance - lost) < 0.2 * lost)
        True
        """
        low, high = float(self.values.min()), float(self.values.max())
        if self.values.size <= bins or high - low < 1e-12:
            return self
        index = np.minimum(((self.values - low) / (high - low) * bins).astype(int), bins - 1)
        weight = np.bincount(index, self.weights, bins).astype(float)
        total = np.bincount(index, self.weights * self.values, bins).astype(float)
        used = weight > 0
        return FillDistribution(total[used] / weight[used], weight[used])


def fixed_fill(value: float) -> FillDistribution:
    """Every pixel has the same fill, as (3.12) is printed."""
    return FillDistribution(np.array([value]), np.ones(1))


def beta_fill(mean: float, sd: float, nodes: int = 48) -> FillDistribution:
    """Fill f of (3.10) with given moments: a beta distribution on 0-1, at the ``nodes`` of its Gauss quadrature.

    They meet the mean and sd exactly, and integrate every polynomial in f up to degree 2 ``nodes`` - 1.  They are
    the eigenvalues of the tridiagonal matrix of the recurrence of Jacobi polynomials (Golub and Welsch 1969).

    Raises UsageError when no distribution on 0-1 has these moments.

    Examples
    --------
    >>> fill = beta_fill(0.01, 0.09)  # most are empty, some full
    >>> round(fill.mean, 12), round(float(fill.variance) ** 0.5, 12)
    (0.01, 0.09)
    """
    if sd == 0:
        return fixed_fill(mean)
    refuse(not (0 < mean < 1 and sd**2 < mean * (1 - mean)), "fill.moments", mean=mean, sd=sd)
    total = mean * (1 - mean) / sd**2 - 1  # parameters a + b of the distribution
    a, b = mean * total, (1 - mean) * total
    n = np.arange(1.0, nodes)
    t = 2 * n + total - 2
    ratio = np.append(1.0, (n[1:] + total - 2) / (t[1:] - 1))  # of the first it is 0 / 0 where the total is 1
    diagonal = np.append(mean, 0.5 + 0.5 * (a - b) * (total - 2) / (t * (t + 2)))
    off_diagonal = np.sqrt(n * (n + a - 1) * (n + b - 1) * ratio / (t**2 * (t + 1)))
    values, vectors = eigh_tridiagonal(diagonal, off_diagonal)
    return FillDistribution(np.clip(values, 0.0, 1.0), vectors[0] ** 2)


def touched_counts(geometry: Geometry) -> Index:
    """(K,) number of pixels that the target's outline meets (f of 3.10), for K equally likely positions."""
    return np.asarray(_fills_and_touched(_shape_key(geometry))[1].sum(axis=(1, 2)))


def object_fills(geometry: Geometry, n: int) -> Array:
    """(K, n) fills of the ``n`` fullest pixels, in falling order, for K equally likely positions (f of 3.10).

    Where the pixels that the outline meets count, NaN follows the last of these.

    >>> geometry = Geometry(side_m=0.25, gsd_m=1.0, psf_fwhm_pixels=1.0, pixels="touched")
    >>> sorted(set(np.isfinite(object_fills(geometry, 4)).sum(axis=1).tolist()))
    [1, 2, 4]
    """
    fills, touched = _fills_and_touched(_shape_key(geometry))
    if geometry.pixels == "touched":
        fills = np.where(touched, fills, np.nan)
    fills = -np.sort(-fills.reshape(len(fills), -1), axis=1)
    if n > fills.shape[1]:
        fills = np.pad(fills, ((0, 0), (0, n - fills.shape[1])))
    return fills[:, :n]


def lattice_positions(count: int) -> Array:
    """(count, 2) places on the pixel grid to average f of (3.10) over, (x, y) from a pixel's centre [pixels]."""
    i = np.arange(count)
    return np.asarray(np.stack([(i + 0.5) / PHASES, (i * _LATTICE + 0.5) / PHASES], axis=1) % 1.0 - 0.5)


def _shape_key(geometry: Geometry, **changes: str) -> Geometry:
    """The geometry without its choice of pixels, as a key: fills do not depend on that."""
    return geometry.model_copy(update={"pixels": "best", "n": None, **changes})


@lru_cache(maxsize=256)
def _fills_and_touched(geometry: Geometry) -> tuple[npt.NDArray[Any], ...]:
    """(K, P, P) fills of the pixels around the target at each sampled position, and the mask of those it touches."""
    random = geometry.phase == "random"
    any_heading = geometry.heading_deg == "random"
    i = np.arange(count := PHASES if random or any_heading else 1)
    offset = lattice_positions(count) if random else np.zeros((count, 2))
    angles = 180.0 * ((0.5 + i * np.sqrt(2.0)) % 1.0)
    heading = angles if any_heading else np.full(count, geometry.heading_deg, dtype=float)
    fills = pixel_fills(geometry, offset, heading)
    return fills, _touched_pixels(geometry, offset, heading, fills.shape[1])


def _touched_pixels(geometry: Geometry, offset: Array, heading_deg: Array, size: int) -> Mask:
    """(K, P, P) True for pixels whose square and the target overlap: no separating axis of either."""
    a, b = (0.5 * side for side in geometry.sides_pixels)
    pixels = np.arange(size, dtype=float) - size // 2
    x = (pixels[None, None, :] - offset[:, 0, None, None]) + np.zeros((1, size, 1))
    y = pixels[None, :, None] - offset[:, 1, None, None]
    c, d = (f(np.deg2rad(heading_deg))[:, None, None] for f in (np.cos, np.sin))
    reach = 0.5 * (np.abs(c) + np.abs(d))
    overlap = (np.abs(x) < 0.5 + a * np.abs(d) + b * np.abs(c)) & (np.abs(y) < 0.5 + a * np.abs(c) + b * np.abs(d))
    return np.asarray(overlap & (np.abs(x * d + y * c) < a + reach) & (np.abs(x * c - y * d) < b + reach))


def pixel_fills(geometry: Geometry, offset: npt.ArrayLike, heading_deg: npt.ArrayLike) -> Array:
    """Fill of every pixel around a target at given positions (f of 3.10) [1].

    The integral over one direction is closed (error functions); over the other it is Gauss-Legendre
    quadrature between the corners of the target and the edges of the pixels.

    Parameters
    ----------
    geometry : target and pixel
    offset : (K, 2) centre of the target from the centre of the middle pixel [pixels]
    heading_deg : (K,) direction of the length, from increasing lines to increasing samples

    Returns
    -------
    (K, P, P) fills of the pixels, the middle pixel at [P // 2, P // 2]; axis 1 runs along the columns
    (heading 0), axis 2 across.
    """
    shift = np.asarray(offset, dtype=float)
    length, width = geometry.sides_pixels
    refuse(max(length, width) > MAX_PIXELS_ACROSS, "fill.large", most=MAX_PIXELS_ACROSS)
    blur = geometry.psf_fwhm_pixels
    s_y, s_x = (SIGMA_PER_FWHM * fwhm for fwhm in (blur if isinstance(blur, tuple) else (blur or 0.0,) * 2))
    sharpest = min(s_y, s_x)  # decides how finely the integrand is cut
    half = int(np.ceil(0.5 * np.hypot(length, width) + 0.5 + 5.0 * max(s_y, s_x))) + 1
    borders = np.arange(-half - 0.5, half + 1.0)  # each pixel ends where the next begins
    c, d = (f(np.deg2rad(heading_deg)) for f in (np.cos, np.sin))
    # Corners of the target along y fix where the chord length has kinks.
    corner = np.stack([0.5 * (i * length * c + j * width * d) for i in (-1, 1) for j in (-1, 1)], axis=1)
    low, high = corner.min(axis=1), corner.max(axis=1)
    edges = borders[None, :] - shift[:, 1:2]
    no_cut = (edges <= low[:, None]) | (edges >= high[:, None])  # they cut nothing: behind all that do
    breaks = np.sort(np.concatenate([corner, np.where(no_cut, high[:, None], edges)], axis=1), axis=1)
    breaks = breaks[:, : 1 + int(np.max(np.sum(breaks < high[:, None], axis=1), initial=1))]
    parts = max(2, int(np.ceil(1.0 / max(sharpest, 0.1)))) if sharpest > 0 else 8
    steps = np.arange(parts) / parts
    span = np.diff(breaks, axis=1)
    start = (breaks[:, :-1, None] + span[:, :, None] * steps).reshape(len(shift), -1)
    size = np.repeat(span / parts, parts, axis=1)
    y = (start[:, :, None] + 0.5 * size[:, :, None] * (1.0 + _NODES)).reshape(len(shift), -1)
    dy = (0.5 * size[:, :, None] * _NODE_WEIGHTS).reshape(len(shift), -1)
    start_x, end_x = _chord(y, c[:, None], d[:, None], length, width)
    x0 = shift[:, 0][:, None, None]
    across = _differences(_ramp(end_x[:, :, None] + x0 - borders, s_x) - _ramp(start_x[:, :, None] + x0 - borders, s_x))
    along = _differences(_step((y + shift[:, 1:2])[:, :, None] - borders, s_y)) * dy[:, :, None]
    return np.asarray(np.clip(np.matmul(along.transpose(0, 2, 1), across), 0.0, 1.0))  # rounding alone leaves 0-1


def aperture_weights(edges: npt.ArrayLike, first: int, count: int, psf_fwhm_pixels: float) -> Array:
    """(count, n) part of the response of each pixel in each cell, along one direction (f of 3.10).

    Parameters
    ----------
    edges : (n + 1,) ends of the cells in pixels, increasing
    first, count : pixels; pixel i reaches from i to i + 1
    psf_fwhm_pixels : FWHM of the Gaussian besides the aperture [pixels]
    """
    borders = first + np.arange(count + 1)
    ramps = _ramp(np.asarray(edges, dtype=float)[:, None] - borders, psf_fwhm_pixels * SIGMA_PER_FWHM)
    return np.diff(_differences(ramps), axis=0).T


def _chord(y: Array, c: Array, d: Array, length: float, width: float) -> tuple[Array, Array]:
    """Ends in x of the target's chord at height y: the cut of two strips |x d + y c| <= l/2, |x c - y d| <= w/2."""
    ends = []
    for slope, shift, side in ((d, y * c, length), (c, -y * d, width)):
        slope = np.where(np.abs(slope) < 1e-12, 1e-12, slope)
        a, b = (-0.5 * side - shift) / slope, (0.5 * side - shift) / slope
        ends.append((np.minimum(a, b), np.maximum(a, b)))
    low = np.maximum(ends[0][0], ends[1][0])
    return low, np.maximum(low, np.minimum(ends[0][1], ends[1][1]))


def _differences(at_borders: Array) -> Array:
    """(..., P) difference between the near and the far border of each pixel, from values at borders (..., P + 1).

    The response of a pixel is a unit box convolved with a Gaussian: that of one border less that of the other.
    """
    return at_borders[..., :-1] - at_borders[..., 1:]


def _step(z: Array, s: float) -> Array:
    """A step convolved with a Gaussian of sigma ``s`` [pixels]."""
    return np.asarray(ndtr(z / s) if s > 1e-9 else (z >= 0.0).astype(float))


def _ramp(z: Array, s: float) -> Array:
    """Integral of :func:`_step` from minus infinity to ``z``: z Phi(z/s) + s phi(z/s)."""
    if s <= 1e-9:  # [pixels], which blurs nothing
        return np.asarray(np.maximum(z, 0.0))
    u = z / s
    return np.asarray(s * (u * ndtr(u) + np.exp(-0.5 * u**2) / np.sqrt(2.0 * np.pi)))


# Steps of the table of fills in a pixel. Cubic interpolation between them is good to 5e-5 with a blur of half a
# pixel, and to 2e-2 at the corners of a target without any blur.
_STEPS = 8


def shared_pixel_fills(
    target: Geometry, n: int, neighbours: Sequence[tuple[Geometry, Array]], shifts: Array | None = None
) -> tuple[Array, Array]:
    """Fills of the ``n`` fullest pixels of a target, by itself and by each of its neighbours (f of 3.10).

    The place on the pixel grid is random (or centred, as in ``target``), and neighbours move with the target.  Where
    targets overlap by errors of their places, the fills of a pixel are scaled to sum to 1.

    Parameters
    ----------
    target : with a stated heading
    neighbours : other targets, each with its centre (2,) from the target's (lines, samples) [pixels]
    shifts : (K, J, 2) departures of the neighbours' places at each position (lines, samples) [pixels]

    Returns
    -------
    (K, n) fills by the target in falling order, NaN behind the last pixel of an object that meets fewer, (K, n, J)
    those by the J neighbours in the same pixels.

    >>> own = Geometry(side_m=0.25, gsd_m=1.0, psf_fwhm_pixels=1.0, pixels="touched")
    >>> np.allclose(shared_pixel_fills(own, 4, [])[0], object_fills(own, 4), atol=1e-3, equal_nan=True)
    True
    >>> fills, others = shared_pixel_fills(own, 4, [(own, np.zeros(2))])  # a neighbour at the same place
    >>> np.array_equal(fills, others[..., 0], equal_nan=True)
    True

    Raises
    ------
    UsageError : a random heading, with which the places of neighbours are not known.
    """
    for geometry in (target, *(geometry for geometry, _ in neighbours)):
        refuse(geometry.heading_deg == "random", "fill.heading")
    fills, chosen = _fullest(target, n)
    shared = np.zeros((*fills.shape, len(neighbours)))
    for j, (geometry, offset) in enumerate(neighbours):
        displacement = np.asarray(offset) + (0.0 if shifts is None else shifts[:, j, None, :])
        shared[..., j] = _interpolated_fills(_fill_table(_shape_key(geometry, phase="random")), chosen - displacement)
    total = np.maximum(fills + shared.sum(axis=2), 1.0)  # NaN of both where there is no pixel
    return fills / total, shared / total[..., None]


@lru_cache(maxsize=64)
def _fullest(geo: Geometry, n: int) -> tuple[Array, ...]:
    """(K, n) fills of the fullest pixels of a target, and their positions (K, n, 2) from its centre."""
    place = np.zeros((1, 2)) if geo.phase == "centred" else lattice_positions(PHASES)[:, ::-1]  # (K, 2) lines, samples
    table = _fill_table(_shape_key(geo, phase="random"))
    half = (table.shape[0] // _STEPS - 1) // 2
    grid = np.stack(np.meshgrid(*2 * (np.arange(-half, half + 1.0),), indexing="ij"), axis=-1).reshape(-1, 2)
    at_pixels = grid[None] - place[:, None]  # (K, P, 2) pixel's centre from the target's
    fills = _interpolated_fills(table, at_pixels)
    if geo.pixels == "touched":
        heading = np.full(len(place), geo.heading_deg, dtype=float)
        fills[~_touched_pixels(geo, place[:, ::-1], heading, 2 * half + 1).reshape(fills.shape)] = np.nan
    if n > fills.shape[1]:
        fills = np.pad(fills, ((0, 0), (0, n - fills.shape[1])))
        at_pixels = np.pad(at_pixels, ((0, 0), (0, n - at_pixels.shape[1]), (0, 0)), constant_values=1e6)
    order = np.argsort(-fills, axis=1, kind="stable")[:, :n]
    return np.take_along_axis(fills, order, 1), np.take_along_axis(at_pixels, order[..., None], 1)


@lru_cache(maxsize=64)
def _fill_table(geometry: Geometry) -> Array:
    """(M, M) cubic spline of a pixel's fill against its centre from the target's (lines, samples)."""
    from scipy.ndimage import spline_filter  # a tenth of a second with what it loads

    step = (np.arange(_STEPS) + 0.5) / _STEPS - 0.5
    offset = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    fills = pixel_fills(geometry, offset, np.full(len(offset), geometry.heading_deg, dtype=float))
    across = fills.shape[1]
    # A centre at step i puts pixel p at p - step_i: rising with p, falling with i.
    fills = fills.reshape(_STEPS, _STEPS, across, across)[::-1, ::-1]
    values = fills.transpose(2, 0, 3, 1).reshape(across * _STEPS, across * _STEPS)
    return np.asarray(spline_filter(values, order=3, mode="constant"))


def _interpolated_fills(table: Array, distances: Array) -> Array:
    """Fills at distances ``distances`` (..., 2) from the target's centre (lines, samples) [pixels]; 0 beyond it."""
    from scipy.ndimage import map_coordinates

    index = distances * _STEPS + 0.5 * (table.shape[0] - 1)
    fill = map_coordinates(table, np.moveaxis(index, -1, 0), order=3, mode="constant", prefilter=False)
    return np.asarray(np.clip(fill, 0.0, 1.0))


def fill_distribution(fill: Fill) -> FillDistribution:
    """Fill fractions of the pixels of one population (f of 3.10).

    Where the geometry says that all pixels count which the outline meets, as a truth by outlines has them, they are
    those that hold a corner alone, nearly empty, and the full ones.
    """
    if fill.fixed is not None:
        return fixed_fill(fill.fixed)
    if fill.geometry is not None or fill.listed is not None:
        return _pixel_fill_distribution(fill)
    refuse(fill.truth is not None, "fill.truth")
    return beta_fill(fill.mean or 0.0, fill.sd or 0.0)


@lru_cache(maxsize=256)
def _pixel_fill_distribution(fill: Fill) -> FillDistribution:
    """Over the pixels of its objects, each counted alike."""
    fills = fills_of_objects(fill)
    fills = fills[np.isfinite(fills)]
    return FillDistribution(fills, np.full(fills.size, 1.0 / fills.size)).binned()


def fills_of_objects(fill: Fill, n: int | None = None) -> Array:
    """(K, n) fills of the pixels of one object (f of 3.10), NaN behind those of one that has fewer.

    ``n`` : default: as many as it may have
    """
    if fill.geometry is not None:
        return object_fills(fill.geometry, n or object_pixel_count(fill))
    if fill.listed is not None:
        size = object_pixel_count(fill)
        return np.array([sorted(row, reverse=True) + [np.nan] * (size - len(row)) for row in fill.listed])
    return fill_distribution(fill).values[:, None]


def object_pixel_count(fill: Fill) -> int:
    """Pixels of one object: its fullest, as many as it may touch where those that it touches count."""
    if fill.listed is not None:
        return max(len(row) for row in fill.listed)
    if fill.geometry is None:
        return 1
    return int(touched_counts(fill.geometry).max()) if fill.geometry.pixels == "touched" else fill.geometry.n or 1


def population_fill(fill: Fill, thesis: bool) -> FillDistribution:
    """The fill of a population; the printed form has its mean alone."""
    distribution = fill_distribution(fill)
    return fixed_fill(distribution.mean) if thesis else distribution


def fills_of_population(fill: Fill, thesis: bool) -> FillDistribution:
    """Fills of the pixels of a population."""
    distribution = population_fill(fill, thesis)
    return FillDistribution(distribution.values[None], distribution.weights[None])


def whole_object_fills(fill: Fill, thesis: bool) -> FillDistribution:
    """Fills of the pixels of a population's objects, one after the other; of its pixels where these are objects."""
    pixel_fill = fills_of_population(fill, thesis)
    places = np.array([[pixel_fill.mean]]) if thesis else fills_of_objects(fill)
    if places.shape[1] == 1 and pixel_fill.values.size >= places.shape[0]:
        return pixel_fill
    weights = np.full((1, len(places)), 1.0 / len(places))
    return FillDistribution(places.reshape(1, -1), weights, (places.shape[0], places.shape[1]))


def stacked_fills(fills: Sequence[FillDistribution], which: Index) -> FillDistribution:
    """The fills of n evaluations, ``which`` (n,) being the number of those of each.

    Raises
    ------
    UsageError : objects of different numbers of pixels.
    """
    if len(fills) == 1:
        return fills[0]
    refuse(any(e.shape != fills[0].shape for e in fills), "fill.objects")
    width = max(e.values.size for e in fills)
    values, weights = (
        np.array([np.pad(getattr(e, n)[0], (0, width - e.values.size)) for e in fills]) for n in ("values", "weights")
    )
    return FillDistribution(values[which], weights[which], fills[0].shape)


def fill_with_mean(fill: Fill, offset: float) -> Fill:
    """The fill with another mean, at most 1 and at least 0.

    Where the geometry gives the fill, the sides of the target are scaled, about its place on the pixel grid.  Listed
    fills are scaled, and at most 1.

    >>> square = {"side_m": 1.0, "gsd_m": 1.0, "psf_fwhm_pixels": 1.0}
    >>> ways = {"geometry": {**square, "pixels": "touched"}}, {"geometry": {**square, "pixels": "ranked", "n": 2}}, {
    ...     "listed": [[0.9, 0.7, 0.2], [1.0, 0.3]]}
    >>> for fill in map(Fill.model_validate, ways):
    ...     mean = fill_distribution(fill).mean
    ...     print([round(fill_distribution(fill_with_mean(fill, x)).mean - mean, 2) for x in (-0.1, 0.05, 0.2)])
    [-0.1, 0.05, 0.2]
    [-0.1, 0.05, 0.2]
    [-0.1, 0.05, 0.2]

    For large changes too:

    >>> ways = {"geometry": {"side_m": 0.05, "gsd_m": 1.0, "pixels": "ranked", "n": 1}}, {"listed": [[0.02, 0.01]]}
    >>> for fill in map(Fill.model_validate, ways):
    ...     mean = fill_distribution(fill).mean
    ...     print([round(fill_distribution(fill_with_mean(fill, x - mean)).mean, 6) for x in (1e-6, 0.0015, 0.4)])
    [1e-06, 0.0015, 0.4]
    [1e-06, 0.0015, 0.4]
    """
    mean_before = fill_distribution(fill).mean
    if offset == 0.0 or (fill.fixed is None and (mean_before == 0.0 or (mean_before > _MEANS[-1] and offset > 0.0))):
        return fill
    if fill.fixed is not None:
        return fill.model_copy(update={"fixed": float(np.clip(fill.fixed + offset, 0.0, 1.0))})
    if fill.geometry is None and fill.listed is None:
        mean = float(np.clip((fill.mean or 0.0) + offset, 1e-6, 1.0 - 1e-6))
        # A beta distribution of this mean has a variance below mean (1 - mean).
        sd = min(fill.sd or 0.0, 0.99 * float(np.sqrt(mean * (1.0 - mean))))
        return fill.model_copy(update={"mean": mean, "sd": sd})
    if fill.listed is not None and offset < 0.0:
        return _scaled_fill(fill, np.log(max(mean_before + offset, 1e-12) / mean_before))
    sizes = _size_over_mean(fill, next((mean for mean in _MEANS if mean_before + offset <= mean), _MEANS[-1]))
    log_mean = min(np.log(max(mean_before + offset, 1e-12)), sizes.x[-1])
    within_table = max(log_mean, sizes.x[0])  # below goes the area
    size, slope = sizes(within_table) + 0.5 * (log_mean - within_table), sizes(within_table, 1)
    for _ in range(2):
        size -= slope * (np.log(fill_distribution(_scaled_fill(fill, size)).mean) - log_mean)
    return _scaled_fill(fill, size)


def _scaled_fill(fill: Fill, size: float) -> Fill:
    """A fill by geometry whose sides, or a listed one whose values, are exp(size) times as large."""
    factor = float(np.exp(size))
    if (g := fill.geometry) is None:
        listed = tuple(tuple(min(factor * f, 1.0) for f in row) for row in fill.listed or ())
        return fill.model_copy(update={"listed": listed})
    sides = {n: factor * v for n in ("side_m", "length_m", "width_m") if (v := getattr(g, n)) is not None}
    return fill.model_copy(update={"geometry": Geometry.model_validate(g.model_dump() | sides)})


@lru_cache(maxsize=64)
def _size_over_mean(fill: Fill, limit: float) -> Any:
    """Logarithm of the factor that gives a fill a mean, over the logarithm of that mean, up to ``limit``."""
    points = list[tuple[float, float]]()
    with suppress(UsageError):  # a target of more pixels than are taken
        for size in _FACTORS:
            mean = float(np.log(fill_distribution(_scaled_fill(fill, size)).mean))
            points += [(mean, size)] if not points or mean > points[-1][0] + 1e-9 else []
            if mean > np.log(limit):
                break
    return scipy.interpolate.PchipInterpolator(*np.transpose(points))
