"""The clusters of a region's pixels, for classes that are mixtures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from hyperval.errors import UsageError
from hyperval.observe.pipeline import Observed
from hyperval.processing.alarm_blocks import block_side
from hyperval.processing.component_moments import class_components
from hyperval.processing.spatial_correlation import drawn_pixels
from hyperval.scenario import BackgroundClass, Scenario
from hyperval.scene.components import Components
from hyperval.scene.statistics import ClassStatistics
from hyperval.spectra.windows import in_window

MOST_PIXELS = 20_000  # of a region, drawn at random
MOST_NUMBERS = 8_000_000  # pixels times bands that memory holds
_SEED = 41

Key = tuple[str, int | Literal["auto"], bool]


class RegionMixtures:
    """Components of the regions of one collection, each fitted once."""

    def __init__(self, observed: Observed):
        self._observed = observed
        self._made: dict[Key, Components | None] = {}

    def statistics(self, scenario: Scenario) -> Mapping[str, ClassStatistics]:
        """The collection's statistics with the components that the classes of a scenario ask for.

        Raises
        ------
        UsageError : too few pixels or blocks of the image; two classes that ask one region for different ones.
        """
        out = dict(self._observed.statistics)
        wanted: dict[str, Key] = {}
        for c in scenario.scene.classes:
            region = _region(c)
            if c.mixture is None or not c.has_mixture or region not in out:
                continue
            key = (region, c.mixture, c.tail_dof is not None)
            if wanted.setdefault(region, key) != key:
                raise UsageError(f"two classes ask for different components of region {region!r}")
            out[region] = replace(out[region], components=self._components(c.name, key))
        return out

    def _components(self, name: str, key: Key) -> Components | None:
        if key not in self._made:
            region, count, tails = key
            try:
                self._made[key] = region_components(self._observed, region, count, tails=tails)
            except UsageError as error:
                where = f"mixture of class {name!r}, region {region!r}"
                raise UsageError(error.what, where=where, expected=error.expected, mend=error.mend) from error
        return self._made[key]


def region_components(
    observed: Observed, region: str, count: int | Literal["auto"], *, tails: bool
) -> Components | None:
    """Components of the pixels of a region in reflectance, at most 20,000 of them drawn at random (seed fixed).

    Blocks of the image for the choice of their number are those of false alarms: the region fills about 64 of them.

    Raises
    ------
    UsageError : too few pixels or blocks.
    """
    place, elm = observed.place, observed.elm
    if place is None:
        raise UsageError("the collection has no image whose pixels could be fitted")
    axis = place.cube.axis
    rng = np.random.default_rng(_SEED)
    most = max(min(MOST_PIXELS, MOST_NUMBERS // len(axis)), 2)
    lines, samples = drawn_pixels(place.pixels_of(region), most, rng)
    pixels = place.cube.spectra((lines, samples))
    if elm is not None:
        pixels = elm.reflectance(pixels)
    known = np.isfinite(pixels).any(axis=0)
    pixels = np.where(known, pixels, 0.0)  # a band without a gain, as in the statistics of the class
    valid = np.isfinite(pixels).all(axis=1)
    side = block_side(int(np.count_nonzero(place.pixels_of(region))))
    block = (lines // side) * (place.cube.shape[1] // side + 1) + samples // side
    lead = np.flatnonzero(in_window(axis.centre_nm) & axis.good & known)
    return class_components(pixels[valid], block[valid], count, tails=tails, lead=lead, seed=_SEED)


def _region(c: BackgroundClass) -> str | None:
    """The region that the spread of a class comes from."""
    return c.spectrum.measured if c.covariance is None else c.covariance.measured
