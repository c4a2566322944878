"""Fills of the pixels of one target with other targets beside it (f of 3.10, for several materials at once)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from hyperval.errors import UsageError
from hyperval.scene.fill import PHASES, TargetGeometry, lattice_positions, pixel_fills

Array = npt.NDArray[np.float64]

# Steps of the table of fills in a pixel. Cubic interpolation between them is good to 5e-5 with a blur of half a
# pixel, and to 2e-2 at the corners of a target without any blur.
_STEPS = 8


@dataclass(frozen=True)
class Neighbour:
    """Another target: its geometry, and its centre from the object's own (lines, samples) [pixels]."""

    geometry: TargetGeometry
    offset: tuple[float, float]


def shared_pixel_fills(
    own: TargetGeometry, n: int, neighbours: Sequence[Neighbour], shifts: Array | None = None
) -> tuple[Array, Array]:
    """Fills of the ``n`` fullest pixels of a target, by itself and by each of its neighbours (f of 3.10).

    The place on the pixel grid is random (or centred, as ``own`` says), and neighbours move with the target.  Where
    places that are known roughly let targets overlap, the fills of such a pixel are scaled to sum to 1.

    Parameters
    ----------
    own : with a stated heading
    shifts : (K, J, 2) departures of the neighbours' places at each position (lines, samples) [pixels]

    Returns
    -------
    (K, n) own fills in falling order, (K, n, J) those of the J neighbours in the same pixels.

    Raises
    ------
    UsageError : a random heading: what lies beside a target that may lie any way is not known.
    """
    for geometry in (own, *(x.geometry for x in neighbours)):
        if geometry.heading_deg is None:
            raise UsageError(
                "a target with a position lies any way", mend="state heading_deg, or leave position_m out"
            )
    if shifts is None:
        return _kept(own, n, tuple(neighbours))
    return _shared_pixel_fills(own, n, neighbours, shifts)


@lru_cache(maxsize=128)
def _kept(own: TargetGeometry, n: int, neighbours: tuple[Neighbour, ...]) -> tuple[Array, Array]:
    """For one arrangement, however often it is asked for; not to be written to."""
    fill = _shared_pixel_fills(own, n, neighbours, None)
    for part in fill:
        part.setflags(write=False)
    return fill


def _shared_pixel_fills(
    own: TargetGeometry, n: int, neighbours: Sequence[Neighbour], shifts: Array | None
) -> tuple[Array, Array]:
    centred = own.phase == "centred"
    place = np.zeros((1, 2)) if centred else lattice_positions(PHASES)[:, ::-1]  # (K, 2) lines, samples
    table = _fill_table(replace(own, phase="random"))
    half = (table.shape[0] // _STEPS - 1) // 2
    grid = np.stack(np.meshgrid(*2 * (np.arange(-half, half + 1.0),), indexing="ij"), axis=-1).reshape(-1, 2)
    at_pixels = grid[None] - place[:, None]  # (K, P, 2) pixel's centre from the target's
    fills = _looked_up(table, at_pixels)
    if n > fills.shape[1]:
        fills = np.pad(fills, ((0, 0), (0, n - fills.shape[1])))
        at_pixels = np.pad(at_pixels, ((0, 0), (0, n - at_pixels.shape[1]), (0, 0)), constant_values=1e6)
    order = np.argsort(-fills, axis=1, kind="stable")[:, :n]
    fills = np.take_along_axis(fills, order, axis=1)
    chosen = np.take_along_axis(at_pixels, order[..., None], axis=1)
    others = np.zeros((*fills.shape, len(neighbours)))
    for j, x in enumerate(neighbours):
        away = np.asarray(x.offset) + (0.0 if shifts is None else shifts[:, j, None, :])
        others[..., j] = _looked_up(_fill_table(replace(x.geometry, phase="random")), chosen - away)
    over = np.maximum(fills + others.sum(axis=2), 1.0)
    return fills / over, others / over[..., None]


@lru_cache(maxsize=64)
def _fill_table(geometry: TargetGeometry) -> Array:
    """(M, M) fill of a pixel by the target, against the pixel's centre from the target's (lines, samples)."""
    step = (np.arange(_STEPS) + 0.5) / _STEPS - 0.5
    x, y = np.meshgrid(step, step)
    offset = np.stack([x.ravel(), y.ravel()], axis=1)
    fills = pixel_fills(geometry, offset, np.full(len(offset), geometry.heading_deg))
    across = fills.shape[1]
    # A centre at step i puts pixel p at p - step_i: rising with p, falling with i.
    fills = fills.reshape(_STEPS, _STEPS, across, across)[::-1, ::-1]
    table = fills.transpose(2, 0, 3, 1).reshape(across * _STEPS, across * _STEPS)
    table.setflags(write=False)
    return table


def _looked_up(table: Array, away: Array) -> Array:
    """Fills at distances ``away`` (..., 2) from the target's centre (lines, samples) [pixels]; 0 beyond it."""
    index = away * _STEPS + 0.5 * (table.shape[0] - 1)
    fill = map_coordinates(table, np.moveaxis(index, -1, 0), order=3, mode="constant", cval=0.0)
    return np.asarray(np.clip(fill, 0.0, 1.0))
