"""Fills of pixels that several targets share."""

import numpy as np
import pytest

from hyperval.errors import UsageError
from hyperval.model import Neighbour, TargetGeometry, object_fills, pixel_fills, shared_pixel_fills


def geometry(length=1.0, width=1.4, heading=12.0, blur=1.0, phase="random"):
    return TargetGeometry(length, width, 0.7, heading, blur, phase)


@pytest.mark.parametrize("blur", [0.5, 1.0, (1.0, 0.6)])
@pytest.mark.parametrize("heading", [0.0, 12.0, 80.0])
def test_alone_it_is_the_fill_of_the_object(blur, heading):
    own, others = shared_pixel_fills(geometry(heading=heading, blur=blur), 6, [])
    assert own == pytest.approx(object_fills(geometry(heading=heading, blur=blur), 6), abs=2e-4)
    assert others.shape == (377, 6, 0)


def test_halves_side_by_side_are_the_whole():
    # 1 m x 2 m aligned with the lines, cut in two along the samples: in each pixel the halves add up.
    half, whole = geometry(1.0, 1.0, 0.0), geometry(1.0, 2.0, 0.0)
    own, others = shared_pixel_fills(half, 60, [Neighbour(half, (0.0, 1.0 / 0.7))])
    far, _ = shared_pixel_fills(half, 60, [Neighbour(half, (0.0, 30.0))])
    middle, _ = shared_pixel_fills(geometry(1.0, 1.0, 0.0, phase="centred"), 1, [])
    assert own == pytest.approx(far, abs=1e-12)
    assert (own + others[..., 0]).sum(axis=1) == pytest.approx(np.full(377, 2.0 / 0.49), rel=0.02)
    # The pixel between the two, where the whole has its centre.
    at = pixel_fills(whole, [[0.0, 0.0]], [0.0])[0]
    centre = at[at.shape[0] // 2, at.shape[1] // 2]
    left, right = shared_pixel_fills(geometry(1.0, 1.0, 0.0, phase="centred"), 200, [Neighbour(half, (0.0, 1.0 / 0.7))])
    assert middle[0, 0] == pytest.approx(left[0, 0])
    # Sampled at whole pixels from one half's centre: compare with the whole moved by half of its side.
    moved = pixel_fills(whole, [[0.5 / 0.7, 0.0]], [0.0])[0]
    assert np.sort((left + right[..., 0])[0])[-9:] == pytest.approx(np.sort(moved.ravel())[-9:], abs=2e-4)
    assert centre > 0.5


def test_the_neighbour_lies_where_it_is_said_to():
    """Lines first: a neighbour below fills pixels below, by another route at one stated place."""
    own = geometry(1.0, 1.0, 20.0, phase="centred")
    offset = (2.2, -0.7)
    fills, others = shared_pixel_fills(own, 25, [Neighbour(own, offset)])
    mine = pixel_fills(own, [[0.0, 0.0]], [20.0])[0]
    beside = pixel_fills(own, [[offset[1] % 1.0 - 1.0, offset[0] % 1.0]], [20.0])[0]  # (x, y) within a pixel
    # Its grid is moved by whole pixels: two lines down, no sample (the -0.7 is already within a pixel's reach).
    shift = int(np.floor(offset[0])), int(np.floor(offset[1])) + 1
    half = mine.shape[0] // 2
    for rank in np.argsort(-mine.ravel(), kind="stable")[:6]:
        line, sample = np.unravel_index(rank, mine.shape)
        at = line - half - shift[0] + beside.shape[0] // 2, sample - half - shift[1] + beside.shape[1] // 2
        k = int(np.argmin(np.abs(fills[0] - mine[line, sample]) + np.abs(others[0, :, 0] - beside[at])))
        assert fills[0, k] == pytest.approx(mine[line, sample], abs=2e-4)
        assert others[0, k, 0] == pytest.approx(beside[at], abs=2e-4)


def test_places_known_roughly_never_fill_a_pixel_twice():
    rng = np.random.default_rng(1)
    square = geometry(2.0, 2.0, 0.0)
    own, others = shared_pixel_fills(square, 16, [Neighbour(square, (0.0, 2.2))], rng.normal(0.0, 0.5, (377, 1, 2)))
    assert np.all(own + others.sum(axis=2) <= 1.0 + 1e-12)


def test_a_random_heading_with_neighbours_is_refused():
    with pytest.raises(UsageError, match="lies any way"):
        shared_pixel_fills(geometry(heading=None), 4, [])
