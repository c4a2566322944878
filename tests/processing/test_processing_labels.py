"""Masks as one label image, and pixels of a mask by their number."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.processing import Labels, drawn_pixels, neighbour_shares, nth_pixels


@pytest.mark.parametrize("shape", [(1, 1), (3, 8), (7, 13), (600, 25)])
def test_masks_come_back_whole_from_their_labels(shape: tuple[int, int]):
    rng = np.random.default_rng(1)
    masks = {str(i): rng.random(shape) < 0.3 for i in range(9)}
    labels = Labels.of(shape, masks).with_masks([("none", np.zeros(shape, bool))])
    assert list(labels) == [*masks, "none"]
    assert all(np.array_equal(labels[name], mask) for name, mask in masks.items())
    assert not labels["none"].any()
    # As many labels as there are different sets of regions, and each is some pixel's.
    sets = np.unique(np.stack([m.ravel() for m in masks.values()], axis=1), axis=0)
    assert np.array_equal(np.unique(labels.number), np.arange(len(sets)))


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
