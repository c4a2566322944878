"""How well a region's pixels know the law of its scores: a jackknife over parts of the image.

Neighbouring pixels resemble each other, so that parts are left out and no pixels (Künsch, Ann. Stat. 17,
1217-1241, 1989).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
from scipy import special

from hyperval.processing.covariance_sampling import Directions
from hyperval.processing.intervals import Z95
from hyperval.processing.tails import dof_of_distances, leading_count, squared_mahalanobis

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

_HALVINGS = 4  # 16 parts
_FEWEST = 8  # pixels of a part


def compact_parts(lines: npt.ArrayLike, samples: npt.ArrayLike) -> Index:
    """(n,) number of the part that each pixel lies in: 16 parts of as many pixels, halved along their longer side.

    Fewer parts where they would have fewer than 8 pixels.

    Examples
    --------
    >>> lines, samples = np.indices((4, 16)).reshape(2, -1)
    >>> compact_parts(lines, samples).reshape(4, 16)[::2, ::2].tolist()
    [[0, 0, 2, 2, 4, 4, 6, 6], [1, 1, 3, 3, 5, 5, 7, 7]]
    """
    places = np.stack([np.asarray(lines), np.asarray(samples)])
    n = places.shape[1]
    part = np.zeros(n, np.intp)
    for _ in range(min(_HALVINGS, int(np.log2(max(n / _FEWEST, 1.0))))):
        half = np.zeros(n, np.intp)
        for number in range(int(part.max()) + 1):
            own = np.flatnonzero(part == number)
            longer = int(np.argmax(np.ptp(places[:, own], axis=1)))
            order = own[np.lexsort((places[1 - longer, own], places[longer, own]))]
            half[order[order.size // 2 :]] = 1
        part = 2 * part + half
    return part


def jackknife_directions(values: npt.ArrayLike) -> Array:
    """(G, ...) independent directions of error of a statistic, from its values (G, ...) with each part left out.

    Their squares add up to the jackknife's variance (G - 1)/G sum (v_g - v)^2 (Miller, Biometrika 61, 1-15, 1974),
    widened by (t/1.96)^2 with G - 1 degrees of freedom, so that +-1.96 u is the 95 % interval (JCGM 100:2008, G.3).

    Examples
    --------
    >>> x = np.random.default_rng(0).normal(size=400)
    >>> means = [np.delete(x.reshape(16, 25), g, axis=0).mean() for g in range(16)]
    >>> u = np.sqrt((jackknife_directions(means) ** 2).sum())
    >>> bool(0.7 < u / (x.std() / 20) < 1.5)
    True
    """
    v = np.asarray(values, dtype=float)
    parts = v.shape[0]
    widening = special.stdtrit(parts - 1.0, 0.975) / Z95
    return np.asarray(widening * np.sqrt((parts - 1.0) / parts) * (v - v.mean(axis=0)))


def moments_without_each(pixels: Array, part: Index) -> Iterator[tuple[Array, Array]]:
    """Mean (B,) and covariance (B, B) of the pixels (n, B) without each of their parts; none of a single part."""
    centre = pixels.mean(axis=0)
    away = [pixels[part == g] - centre for g in range(int(part.max(initial=0)) + 1)]
    products = [x.T @ x for x in away]
    sums, whole = [x.sum(axis=0) for x in away], np.sum(products, axis=0)
    for x, product, own in zip(away, products, sums, strict=True) if len(away) > 1 else ():
        n = pixels.shape[0] - x.shape[0]
        mean = -own / n  # what is left out and what is left sum to nought
        yield centre + mean, (whole - product - n * np.outer(mean, mean)) / max(n - 1, 1)


def leading_tail_dof(pixels: Array, mean: Array, covariance: Array) -> float:
    """Degrees of freedom of the t that pixels (n, B) follow in the leading components of their covariance."""
    directions = Directions.of(covariance)
    count = leading_count(directions.values, float(np.trace(covariance)))
    distances = squared_mahalanobis(pixels, mean, directions.vectors[:, :count], directions.values[:count])
    return dof_of_distances(distances, count, estimated_on=pixels.shape[0])
