"""Masks at one bit a pixel, and pixels of a mask by their number."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.processing.region_statistics import MaskBits, PackedMasks
from hyperval.processing.sample import drawn_pixels, neighbour_shares, nth_pixels


@pytest.mark.parametrize("shape", [(1, 1), (3, 8), (7, 13), (40, 257)])
def test_packed_masks_come_back_whole_and_by_lines(shape: tuple[int, int]):
    mask = np.random.default_rng(1).random(shape) < 0.3
    bits = MaskBits.of(mask)
    np.testing.assert_array_equal(bits[:], mask)
    np.testing.assert_array_equal(bits[1:3], mask[1:3])
    assert bits.bits.nbytes == shape[0] * -(-shape[1] // 8)
    masks = PackedMasks({"a": mask, "b": ~mask}.items())
    masks.add("b", mask)
    assert list(masks) == ["a", "b"]
    assert all(np.array_equal(masks[name], mask) for name in masks)


def test_numbers_of_pixels_are_those_of_nonzero():
    rng = np.random.default_rng(2)
    mask = rng.random((50, 31)) < 0.2
    lines, samples = np.nonzero(mask)
    some = rng.choice(lines.size, 40, replace=False)
    at = nth_pixels(mask, some)
    np.testing.assert_array_equal(at[0], lines[some])
    np.testing.assert_array_equal(at[1], samples[some])
    every = drawn_pixels(mask, 10_000, rng)
    np.testing.assert_array_equal(every, (lines, samples))
    assert len(set(zip(*(p.tolist() for p in drawn_pixels(mask, 40, rng)), strict=True))) == 40


def test_neighbour_shares_by_counting_shifted_masks():
    mask = np.random.default_rng(3).random((9, 12)) < 0.4
    shares = neighbour_shares(mask, 3, np.random.default_rng(0))
    padded = np.pad(mask, 3)
    for i, down in enumerate(range(-3, 4)):
        for j, right in enumerate(range(-3, 4)):
            moved = padded[3 + down : 12 + down, 3 + right : 15 + right]
            assert shares[i, j] == pytest.approx((mask & moved).sum() / mask.sum(), abs=1e-15)
