"""Fills of target populations from what a scenario says of them (f of 3.10)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from hyperval.scenario import Fill, TargetSubject
from hyperval.scene.fill import (
    FillDistribution,
    TargetGeometry,
    beta_fill,
    fixed_fill,
    object_fills,
    ranked_pixel_fill,
)

Array = npt.NDArray[np.float64]


def fill_distribution(fill: Fill) -> FillDistribution:
    """Fill fractions of the pixels of one population (f of 3.10)."""
    if fill.fixed is not None:
        return fixed_fill(fill.fixed)
    if fill.geometry is not None:
        return _of_geometry(geometry_of(fill), fill.geometry.n or 1)
    return beta_fill(fill.mean or 0.0, fill.sd or 0.0)


@lru_cache(maxsize=256)
def _of_geometry(geometry: TargetGeometry, n: int) -> FillDistribution:
    """For one geometry, however often it is asked for; not to be written to."""
    found = ranked_pixel_fill(geometry, n).binned()
    for part in (found.values, found.weights):
        part.setflags(write=False)
    return found


def fills_of_objects(fill: Fill, wider: float = 0.0) -> Array:
    """(K, n) fills of the pixels of one object (f of 3.10); one pixel unless the geometry says more.

    ``wider`` : added to the width of the blur [pixels]
    """
    if fill.geometry is not None:
        return object_fills(geometry_of(fill, wider), fill.geometry.n or 1)
    return fill_distribution(fill).values[:, None]


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


def moments(population: TargetSubject, thesis: bool) -> FillDistribution:
    """The fill of a population; the printed form knows its mean alone."""
    fill = fill_distribution(population.fill)
    return fixed_fill(fill.mean) if thesis else fill
