"""Small helpers of the figures, each against a plain statement of what it must do."""

import numpy as np
import pytest

from hyperval.figures.pictures import Window, block_maximum, outline_segments, shown_window
from hyperval.figures.print import plain
from hyperval.figures.spec import shortened


def test_outline_is_the_edge_between_pixels():
    mask = np.zeros((4, 5), bool)
    mask[0:2, 3:5] = True  # touches two borders
    segments = {tuple(map(tuple, s)) for s in outline_segments(mask)}
    assert len(segments) == 8  # perimeter of a 2 by 2 block
    assert ((3.0, 0.0), (3.0, 1.0)) in segments
    assert ((3.0, 2.0), (4.0, 2.0)) in segments
    assert outline_segments(np.zeros((3, 3), bool)).shape == (0, 2, 2)


@pytest.mark.parametrize("shape", [(10, 10), (23, 7), (7, 23)])
def test_block_maximum_keeps_every_peak(shape):
    values = np.random.default_rng(2).standard_normal(shape)
    values[3, 4] = 99.0
    values[5:7, 0:4] = np.nan
    reduced, block = block_maximum(values, 8)
    assert max(reduced.shape) <= 8
    assert reduced[3 // block, 4 // block] == 99.0
    assert np.nanmax(reduced) == np.nanmax(values)
    same, one = block_maximum(values, 100)
    assert one == 1
    assert same is values


def test_text_is_taken_as_it_stands():
    assert plain("a $x$\n b") == r"a \$x\$ b"
    assert plain("_hidden") == " _hidden"
    assert shortened("a" * 50, 11) == "aaaaaa…aaaa"
    assert shortened("short", 11) == "short"


def test_a_long_strip_is_cut_to_its_regions():
    mask = np.zeros((1000, 100), bool)
    mask[500:520, 40:50] = True
    assert shown_window(mask.shape, {"a": mask}) == Window(490, 530, 0, 100)
    assert shown_window(mask.T.shape, {"a": mask.T}) == Window(0, 100, 490, 530)
    assert shown_window(mask.shape, {}) == Window(0, 1000, 0, 100)
    assert shown_window((300, 200), {"a": mask[:300]}) == Window(0, 300, 0, 200)
