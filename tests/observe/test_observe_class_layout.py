"""Where the classes lie is no chance: intervals of P_FA are those of what scatters within a class."""

import numpy as np
import pytest
import rasterio
from affine import Affine
from small_world import BACKGROUND, TARGET, background_spread

SIDE, WORLDS = 120, 2
LINE = np.indices((SIDE, SIDE))[0]


@pytest.mark.parametrize("bright", [LINE < SIDE // 2, LINE // 10 % 2 == 0], ids=["halves", "stripes"])
def test_the_layout_of_classes_is_no_chance(world, bright):
    """Independent pixels of two classes, of which one has the alarms: sd of ln P_FA is sqrt((1 - 2 P)/(n P)).

    Stated over true, mean over two collections and P_FA of 0.1 and 0.01: 1.12 and 1.09 for halves and stripes, with
    standard deviations of 0.08 and 0.05 (200 other seeds each), so that a set lies outside 0.9 to 1.4 in less than
    one run in 1,000.  Where the classes are left out of account it is 15 and 4.
    """
    profile = {"driver": "GTiff", "height": SIDE, "width": SIDE, "count": 1, "dtype": "uint8",
               "transform": Affine(2.0, 0, 500000.0, 0, -2.0, 4700000.0), "crs": "EPSG:32618"}  # fmt: skip
    with rasterio.open(world.folder / "classes.tif", "w", **profile) as image:
        image.write(np.where(bright, 1, 2).astype(np.uint8), 1)
    world.collection["regions"] = [{"file": "classes.tif", "classes": {"bright": 1, "dark": 2}}]
    ratios = []
    for seed in range(WORLDS):
        rng = np.random.default_rng([27, seed])
        values = rng.multivariate_normal(BACKGROUND, background_spread(), (SIDE, SIDE))
        values += 0.3 * bright[..., None] * (TARGET - BACKGROUND)
        world.write(values)
        observed = world.observe().observation
        curve = observed.exceedance["paint", "cem"]
        for level in (1e-1, 1e-2):
            point = np.argmin(np.abs(np.log(curve.probability / level)))
            p = curve.probability[point]
            stated = np.log(curve.upper[point] / curve.lower[point]) / (2.0 * 1.96)
            ratios.append(stated / np.sqrt((1.0 - 2.0 * p) / (p * curve.n)))
    assert 0.9 < np.mean(ratios) < 1.4


def test_regions_that_overlap_are_classes_of_their_own(world):
    """Pixels of the same regions are of one class: of two rectangles that overlap, and the rest, four."""
    world.collection["regions"] = [
        {"name": "one", "rectangle": [0, 0, 20, 20]}, {"name": "two", "rectangle": [10, 10, 20, 20]},
    ]  # fmt: skip
    place = world.observe().place
    one, two = (place.region(name) for name in ("one", "two"))
    found = {(bool(a), bool(b)): set(place.classes[(one == a) & (two == b)]) for a in (0, 1) for b in (0, 1)}
    assert all(len(numbers) == 1 for numbers in found.values())
    assert set.union(*found.values()) == {0, 1, 2, 3}
