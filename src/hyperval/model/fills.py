"""Fills of target populations from what a scenario says of them (f of 3.10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.scenario import Fill, Geometry
from hyperval.scene.fill import (
    FillDistribution,
    TargetGeometry,
    beta_fill,
    fixed_fill,
    object_fills,
    ranked_pixel_fill,
    touched_counts,
    touched_pixel_fill,
)

Array = npt.NDArray[np.float64]


def fill_distribution(fill: Fill) -> FillDistribution:
    """Fill fractions of the pixels of one population (f of 3.10)."""
    if fill.fixed is not None:
        return fixed_fill(fill.fixed)
    if fill.geometry is not None:
        return _of_geometry(geometry_of(fill), 0 if fill.geometry.pixels == "touched" else fill.geometry.n or 1)
    if fill.listed is not None:
        values = np.concatenate([np.asarray(row, float) for row in fill.listed])
        return FillDistribution(values, np.full(values.size, 1.0 / values.size)).binned()
    if fill.truth is not None:
        raise UsageError(
            "the fills are those of a collection's truth",
            expected="a campaign whose targets come from a finer image or from abundances",
            mend="run it within that campaign, or state fill.mean and fill.sd",
        )
    return beta_fill(fill.mean or 0.0, fill.sd or 0.0)


@lru_cache(maxsize=256)
def _of_geometry(geometry: TargetGeometry, n: int) -> FillDistribution:
    """For one geometry, however often it is asked for; not to be written to.  ``n`` = 0: all pixels it touches."""
    fill = (ranked_pixel_fill(geometry, n) if n else touched_pixel_fill(geometry)).binned()
    for part in (fill.values, fill.weights):
        part.setflags(write=False)
    return fill


def fills_of_objects(fill: Fill, wider: float = 0.0) -> Array:
    """(K, n) fills of the pixels of one object (f of 3.10); one pixel unless the geometry says more.

    ``wider`` : added to the width of the blur [pixels]
    """
    if fill.geometry is not None:
        return object_fills(geometry_of(fill, wider), pixels_of_object(fill))
    if fill.listed is not None:
        size = pixels_of_object(fill)
        rows = [sorted(row, reverse=True) + [0.0] * (size - len(row)) for row in fill.listed]
        return np.array(rows)
    return fill_distribution(fill).values[:, None]


def pixels_of_object(fill: Fill) -> int:
    """Pixels of one object: its fullest, as many as it may touch where those that it touches count."""
    if fill.listed is not None:
        return max(len(row) for row in fill.listed)
    if fill.geometry is None:
        return 1
    return int(touched_counts(geometry_of(fill)).max()) if fill.geometry.pixels == "touched" else fill.geometry.n or 1


def geometry_of(fill: Fill, wider: float = 0.0) -> TargetGeometry:
    """The geometry of a fill that has one, its blur ``wider`` by so much, but not below 0 [pixels]."""
    g = fill.geometry
    assert g is not None  # noqa: S101 - all callers have asked
    blur = g.psf_fwhm_pixels or 0.0
    if wider:
        along, across = blur if isinstance(blur, tuple) else (blur, blur)
        blur = max(along + wider, 0.0), max(across + wider, 0.0)
    return TargetGeometry(
        g.side_m or g.length_m or 0.0,
        g.side_m or g.width_m or 0.0,
        g.gsd_m,
        None if g.heading_deg == "random" else float(g.heading_deg),
        blur,
        g.phase,
    )


def moments(fill: Fill, thesis: bool) -> FillDistribution:
    """The fill of a population; the printed form knows its mean alone."""
    distribution = fill_distribution(fill)
    return fixed_fill(distribution.mean) if thesis else distribution


@dataclass(frozen=True)
class Fills:
    """Fills of the pixels of one population in n evaluations, or in all of them.

    Attributes
    ----------
    values, weights : (n or 1, K) fills and their probabilities
    shape : (places, pixels) of objects, whose pixels lie along K without weights; None where a pixel is an object
    """

    values: Array
    weights: Array
    shape: tuple[int, int] | None = None


def pixel_fills(fill: Fill, thesis: bool) -> Fills:
    """Fills of the pixels of a population."""
    distribution = moments(fill, thesis)
    return Fills(distribution.values[None], distribution.weights[None])


def whole_object_fills(fill: Fill, thesis: bool) -> Fills:
    """Fills of the pixels of its objects, one after the other; those of its pixels where an object is one pixel."""
    alone = pixel_fills(fill, thesis)
    places = np.array([[float(alone.weights[0] @ alone.values[0])]]) if thesis else fills_of_objects(fill)
    if places.shape[1] == 1 and alone.values.size >= places.shape[0]:
        return alone
    return Fills(places.reshape(1, -1), np.zeros((1, places.size)), (places.shape[0], places.shape[1]))


def stacked_fills(each: Sequence[Fills], which: npt.NDArray[np.intp]) -> Fills:
    """The fills of several evaluations, of which (n,) ``which`` names those of each.

    Raises
    ------
    UsageError : objects of different numbers of pixels.
    """
    if len(each) == 1:
        return each[0]
    if any(e.shape != each[0].shape for e in each):
        raise UsageError("the number of pixels of an object moves", mend="study one number at a time")
    width = max(e.values.size for e in each)
    values, weights = (
        np.array([np.pad(getattr(e, n)[0], (0, width - e.values.size)) for e in each]) for n in ("values", "weights")
    )
    return Fills(values[which], weights[which], each[0].shape)


def with_mean(fill: Fill, offset: float) -> Fill:
    """The fill with another mean, at most 1 and at least 0.

    Where the geometry gives the fill, the sides of the target are scaled by the root of new over old mean: its
    area changes, its place among the pixels does not.
    """
    if offset == 0.0:
        return fill
    if fill.fixed is not None:
        return fill.model_copy(update={"fixed": float(np.clip(fill.fixed + offset, 0.0, 1.0))})
    if fill.listed is not None:
        mean = fill_distribution(fill).mean
        factor = max(mean + offset, 1e-6) / max(mean, 1e-6)
        return fill.model_copy(update={"listed": [[min(factor * f, 1.0) for f in row] for row in fill.listed]})
    if fill.geometry is None:
        mean = float(np.clip((fill.mean or 0.0) + offset, 1e-6, 1.0 - 1e-6))
        # A beta distribution of this mean has a variance below mean (1 - mean).
        sd = min(fill.sd or 0.0, 0.99 * float(np.sqrt(mean * (1.0 - mean))))
        return fill.model_copy(update={"mean": mean, "sd": sd})
    mean = fill_distribution(fill).mean
    scale = float(np.sqrt(max(mean + offset, 1e-4) / mean))
    g = fill.geometry
    sides = {n: scale * v for n in ("side_m", "length_m", "width_m") if (v := getattr(g, n)) is not None}
    return fill.model_copy(update={"geometry": Geometry.model_validate(g.model_dump() | sides)})
