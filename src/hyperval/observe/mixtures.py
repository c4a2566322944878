"""The laws of a region's pixels, for classes that take them: clusters, and how well the pixels know them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.observe.pipeline import Observed
from hyperval.processing.alarm_blocks import block_side
from hyperval.processing.laws import ClassMixture, class_mixture, compact_parts, leading_tail_dof, moments_without_each
from hyperval.processing.sample import drawn_pixels
from hyperval.scenario import BackgroundClass, Scenario
from hyperval.scene.statistics import ClassStatistics, Components
from hyperval.spectra.axis import in_window

MOST_PIXELS = 20_000  # of a region, drawn at random
MOST_NUMBERS = 8_000_000  # pixels times bands that memory holds
_SEED = 41

Key = tuple[str, int | Literal["auto"], bool]


class RegionLaws:
    """Components of the regions of one collection, each fitted once, and what their pixels leave open."""

    def __init__(self, observed: Observed):
        self._observed = observed
        self._made: dict[Key, tuple[ClassMixture, Components | None] | None] = {}
        self._without: dict[tuple[str, Key | None, bool], list[ClassStatistics]] = {}

    def statistics(self, scenario: Scenario) -> Mapping[str, ClassStatistics]:
        """The collection's statistics with the components that the classes of a scenario ask for.

        Raises
        ------
        UsageError : too few pixels or blocks of the image; two classes that ask one region for different ones.
        """
        out = dict(self._observed.statistics)
        for region, (c, key) in self._keys(scenario).items():
            mixture = self._mixture(c.name, key)
            if mixture is not None:
                out[region] = replace(out[region], components=mixture[1])
        return out

    def left_out(self, scenario: Scenario) -> Iterator[tuple[str, list[ClassStatistics]]]:
        """(region, its statistics without each of its parts), for the regions that the classes take their law from.

        None of a region without pixels, or of fewer than two parts.
        """
        if self._observed.place is None:
            return
        for region, (c, key) in self._keys(scenario).items():
            tails = c.tail_dof == "measured"
            if (region, key, tails) not in self._without:
                self._without[region, key, tails] = list(self._parts(region, self._mixture(c.name, key), tails))
            if self._without[region, key, tails]:
                yield region, self._without[region, key, tails]

    def _parts(
        self, region: str, mixture: tuple[ClassMixture, Components | None] | None, tails: bool
    ) -> Iterator[ClassStatistics]:
        """The statistics of a region without each of its parts; ``tails``: with a tail of their own."""
        pixels, stated = region_pixels(self._observed, region), self._observed.statistics[region]
        part, lead = compact_parts(pixels.lines, pixels.samples), pixels.lead
        for number, (mean, covariance) in enumerate(moments_without_each(pixels.values, part)):
            tail, components = stated.tail_dof, None
            if tails and tail is not None:
                rest = pixels.values[part != number][:, lead]
                dof = leading_tail_dof(rest, mean[lead], covariance[np.ix_(lead, lead)])
                tail = None if np.isinf(dof) else dof
            if mixture is not None:
                components = mixture[0].components_without(pixels.values, part, number)
            yield replace(stated, mean=mean, covariance=covariance, tail_dof=tail, components=components)

    def _keys(self, scenario: Scenario) -> dict[str, tuple[BackgroundClass, Key | None]]:
        """Region -> the first class that takes its law from there, and the mixture that the classes ask for."""
        out: dict[str, tuple[BackgroundClass, Key | None]] = {}
        for c in scenario.scene.classes:
            region = _region(c)
            if region is None or region not in self._observed.statistics:
                continue
            key: Key | None = None
            if c.mixture is not None and c.has_mixture:
                key = (region, c.mixture, c.tail_dof is not None)
            first = out.setdefault(region, (c, key))[1]
            if key is not None and first is None:
                out[region] = (c, key)
            elif key is not None and first != key:
                raise UsageError(f"two classes ask for different components of region {region!r}")
        return out

    def _mixture(self, name: str, key: Key | None) -> tuple[ClassMixture, Components | None] | None:
        if key is None:
            return None
        if key not in self._made:
            region, count, tails = key
            try:
                pixels = region_pixels(self._observed, region)
                mixture = region_mixture(self._observed, region, count, tails=tails, pixels=pixels)
                self._made[key] = None if mixture is None else (mixture, mixture.components(pixels.values))
            except UsageError as error:
                where = f"mixture of class {name!r}, region {region!r}"
                raise UsageError(error.what, where=where, expected=error.expected, mend=error.mend) from error
        return self._made[key]


@dataclass(frozen=True, eq=False)
class RegionPixels:
    """Valid pixels of a region in reflectance, at most 20,000 of them drawn at random (seed fixed).

    Attributes
    ----------
    values : (n, B); 0 in a band without a gain, as in the statistics of the class
    lines, samples : (n,) where they are
    lead : good bands in the windows of the atmosphere
    """

    values: npt.NDArray[np.float64]
    lines: npt.NDArray[np.intp]
    samples: npt.NDArray[np.intp]
    lead: npt.NDArray[np.intp]


def region_pixels(observed: Observed, region: str) -> RegionPixels:
    """The pixels of a region that its laws are fitted to.

    Raises
    ------
    UsageError : the collection has no image.
    """
    place, elm = observed.place, observed.elm
    if place is None:
        raise UsageError("the collection has no image whose pixels could be fitted")
    axis = place.cube.axis
    most = max(min(MOST_PIXELS, MOST_NUMBERS // len(axis)), 2)
    lines, samples = drawn_pixels(place.pixels_of(region), most, np.random.default_rng(_SEED))
    pixels, valid = place.pixels_at(lines, samples, elm)
    known = np.isfinite(pixels[valid]).any(axis=0)
    pixels = np.where(known, pixels, 0.0)
    valid &= np.isfinite(pixels).all(axis=1)
    lead = np.flatnonzero(in_window(axis.centre_nm) & axis.good & known)
    return RegionPixels(pixels[valid], lines[valid], samples[valid], lead)


def region_mixture(
    observed: Observed, region: str, count: int | Literal["auto"], *, tails: bool, pixels: RegionPixels
) -> ClassMixture | None:
    """The mixture that the ``pixels`` of a region are; None where one law is all that they show.

    Blocks of the image for the choice of their number are those of false alarms: the region fills about 64 of them.

    Raises
    ------
    UsageError : too few pixels or blocks.
    """
    place = observed.place
    assert place is not None  # noqa: S101 - its pixels were read
    side = block_side(int(np.count_nonzero(place.pixels_of(region))))
    block = (pixels.lines // side) * (place.cube.shape[1] // side + 1) + pixels.samples // side
    return class_mixture(pixels.values, block, count, tails=tails, lead=pixels.lead, seed=_SEED)


def _region(c: BackgroundClass) -> str | None:
    """The region that the spread of a class comes from."""
    return c.spectrum.measured if c.covariance is None else c.covariance.measured
