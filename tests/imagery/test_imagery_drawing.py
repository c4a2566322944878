"""Drawings that leave the image are cut off and counted; holes are found."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from hyperval.errors import InputError
from hyperval.imagery import holes, read_regions

SHAPE = (10, 12)
BORDER = 20  # pixels around the image in the larger one that the cut is compared with


def geojson(tmp_path: Path, *rings) -> Path:
    features = [
        {
            "type": "Feature",
            "properties": {"name": f"r{i}"},
            "geometry": {"type": "Polygon", "coordinates": [[*ring, ring[0]]]},
        }
        for i, ring in enumerate(rings)
    ]
    path = tmp_path / "r.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


@pytest.mark.parametrize("shift", [(20.0, 0.0), (0.0, -30.0), (3e5, 4.7e6), (1e300, 0.0)])
def test_nothing_left_inside_is_an_error(tmp_path, shift):
    ring = [(8 + shift[0], 2 + shift[1]), (16 + 2 * shift[0], 2 + shift[1]), (16 + shift[0], 6 + shift[1])]
    with pytest.raises(InputError, match=r"r0.*leaves the image: samples .*\n.*expected: samples 0 to 12") as caught:
        read_regions(geojson(tmp_path, ring), SHAPE, coordinates="pixel")
    assert "pixel, map or longitude/latitude" in str(caught.value)


def test_holes_are_those_of_another_package():
    rng = np.random.default_rng(4)
    for _ in range(40):
        mask = rng.random((15, 20)) < 0.7
        empty = ndimage.binary_fill_holes(mask) & ~mask  # holes of 4 neighbours
        assert holes(mask) == (ndimage.label(empty)[1], int(empty.sum()))
    assert holes(np.zeros((3, 3), bool)) == (0, 0)
    assert holes(np.ones((3, 3), bool)) == (0, 0)
