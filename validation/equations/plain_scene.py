"""A scene under one truth, by the equations one after the other: matrices written out, inverses as they are printed.

Nothing of the model is used.  What a pixel's reflectance does to its signal is a difference of signals.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from hyperval.atmosphere import AtmosphericTerms
from hyperval.sensor import NoiseModel
from hyperval.statistics_library import ClassStatistics

Moments = tuple[np.ndarray, np.ndarray]  # mean and covariance


def mixture(fractions: Iterable[float], classes: Sequence[Moments]) -> Moments:
    """Of all classes together."""
    shares = list(zip(fractions, classes, strict=True))
    mean = sum(f * m for f, (m, _) in shares)
    return mean, sum(f * (c + np.outer(m - mean, m - mean)) for f, (m, c) in shares)


@dataclass
class PlainScene:
    """Classes, a target on one of them, and two panels of the empirical line.

    Attributes
    ----------
    fractions : area of each class
    gains : factor on a class's covariance, 1 where it is not named
    kappa : 1 over the number of neighbours whose spread reaches a pixel
    beam, sky : shares of the light that fall on the target
    """

    terms: AtmosphericTerms
    noise: NoiseModel
    surfaces: Mapping[str, ClassStatistics]
    fractions: Mapping[str, float]
    target: str
    host: str
    gains: Mapping[str, float] = field(default_factory=dict)
    kappa: float = 0.0
    beam: float = 1.0
    sky: float = 1.0

    def __post_init__(self) -> None:
        classes = [(self.surfaces[n].mean, self.surfaces[n].covariance) for n in self.fractions]
        self.average, self.surroundings = mixture(self.fractions.values(), classes)  # (3.8)
        low, high = (self.level(np.full_like(self.average, rho)) for rho in (0.1, 0.6))
        self.k = (high - low) / 0.5
        self.b = low - 0.1 * self.k

    def level(self, rho: np.ndarray) -> np.ndarray:
        """Radiance of a pixel (3.7)."""
        t = self.terms
        return t.path_radiance + (t.direct * rho + t.adjacency * self.average) / (1 - t.spherical_albedo * self.average)

    def retrieved(self, rho: np.ndarray) -> np.ndarray:
        """Reflectance by the line through the two panels."""
        return (self.level(rho) - self.b) / self.k

    def slope_around(self, under: np.ndarray) -> np.ndarray:
        """What the surroundings' reflectance does to the signal (3.11)."""
        t, trapping = self.terms, 1 - self.terms.spherical_albedo * self.average
        return (t.direct * t.spherical_albedo * under + t.adjacency) / trapping**2

    def seen(self, rho: np.ndarray, under: np.ndarray, covariance: np.ndarray, gain: float) -> Moments:
        """Of retrieved pixels, from those of the ground."""
        d_a, d_b = np.diag(self.level(rho + 0.5) - self.level(rho - 0.5)), np.diag(self.slope_around(under))
        sigma = d_a @ covariance @ d_a + self.kappa * gain * d_b @ self.surroundings @ d_b  # (3.11)
        sigma = sigma + np.diag(self.noise.variance(self.level(rho)))  # (3.16)-(3.19)
        return self.retrieved(rho), np.diag(1 / self.k) @ sigma @ np.diag(1 / self.k)

    @cached_property
    def classes(self) -> dict[str, Moments]:
        """Of the pixels of each class."""
        found = {}
        for name in self.fractions:
            s, gain = self.surfaces[name], self.gains.get(name, 1.0)
            found[name] = self.seen(s.mean, s.mean, gain * s.covariance, gain)
        return found

    @cached_property
    def filter(self) -> Moments:
        """Weights of the matched filter, and the mean of the background that it is against."""
        mu, sigma = mixture(self.fractions.values(), list(self.classes.values()))
        d = self.retrieved(self.surfaces[self.target].mean) - mu  # (3.22)
        w = np.linalg.inv(sigma) @ d / (d @ np.linalg.inv(sigma) @ d)  # (3.23)-(3.25)
        return w, mu

    def scores(self, moments: Moments) -> tuple[float, float]:
        """Mean and variance of the score of pixels (3.26)-(3.29)."""
        w, mu = self.filter
        return float(w @ (moments[0] - mu)), float(w @ moments[1] @ w)

    def light(self) -> np.ndarray:
        """On the target, over that in the open."""
        back, q = self.terms.spherical_albedo * self.average, self.terms.diffuse_fraction
        q = np.zeros_like(back) if q is None else q
        return (1 - back) * ((1 - q) * self.beam + q * self.sky) + back * self.sky

    def within(self, fill: float, gain: float = 1.0) -> np.ndarray:
        """Covariance of the ground of target pixels of a fill (3.12)."""
        own, host = (self.surfaces[n].covariance for n in (self.target, self.host))
        lit = fill**2 * gain * own * np.outer(self.light(), self.light())
        return lit + (1 - fill) ** 2 * self.gains.get(self.host, 1.0) * host

    def pixel(self, fill: float, gain: float = 1.0) -> Moments:
        """Of target pixels of a fill."""
        own, host = (self.surfaces[n].mean for n in (self.target, self.host))
        rho, under = (fill * part * own + (1 - fill) * host for part in (self.light(), self.sky))  # (3.10)
        return self.seen(rho, under, self.within(fill, gain), self.gains.get(self.host, 1.0))
