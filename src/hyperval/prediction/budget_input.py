"""One uncertain input: what it is called, how it moves, and draws of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.prediction.departure import Departure
from hyperval.prediction.forms import factor_at, form_in_words, standardised
from hyperval.prediction.inputs import SurfaceStatistics
from hyperval.scenario import Scenario
from hyperval.scenario_uncertainty import Distribution, SpectralForm, Spread
from hyperval.sensor.specification import Sensor
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Kind = Literal["atmosphere", "surface", "sensor", "scene", "engine", "sampling"]


@dataclass(frozen=True)
class BudgetInput:
    """An uncertain input with ``size`` independent directions.

    Attributes
    ----------
    name : for users; one budget has each name once
    kind : what sort of input
    along : (size,) factors of the directions -> the truth there; 1 is one standard uncertainty
    draws : one draw from the distribution
    distribution, correlation : in words
    size : number of directions, the leading one first
    settings : dotted paths of the scenario that it changes, where a path says it all
    subject : the surface whose field spectrum it is; empty for anything else
    """

    name: str
    kind: Kind
    along: Callable[[Array], Departure]
    draws: Callable[[np.random.Generator], Departure]
    distribution: str
    correlation: str
    size: int = 1
    settings: tuple[str, ...] = field(default=())
    subject: str = ""

    def moved(self, z: float) -> Departure:
        """The truth ``z`` standard uncertainties along the leading direction, the rest as stated."""
        return self.direction(0, z)

    def direction(self, k: int, z: float) -> Departure:
        """The truth ``z`` standard uncertainties along direction ``k``."""
        c = np.zeros(self.size)
        c[k] = z
        return self.along(c)

    def drawn(self, rng: np.random.Generator) -> Departure:
        """A truth drawn from the distribution of this input alone."""
        return self.draws(rng)


@dataclass(frozen=True)
class Given:
    """What inputs are made of.

    Attributes
    ----------
    axis : the bands of the products
    surfaces : as stated
    terms : gives the atmospheric terms as stated, on the bands
    """

    scenario: Scenario
    axis: SpectralAxis
    sensor: Sensor | None
    surfaces: Mapping[str, SurfaceStatistics]
    terms: Callable[[], AtmosphericTerms]


def scalar_input(
    name: str, kind: Kind, spread: Spread, at: Callable[[float], Departure], settings: tuple[str, ...] = ()
) -> BudgetInput:
    """An input of one number; ``at`` gives the truth at a number of standard uncertainties."""
    law: Distribution = getattr(spread, "distribution", "normal")
    return BudgetInput(
        name,
        kind,
        lambda c: at(float(c[0])),
        lambda rng: at(float(standardised(law, rng, 1)[0])),
        law,
        "one number",
        settings=settings,
    )


def spectral_input(
    name: str, kind: Kind, rows: Array, form: SpectralForm, at: Callable[[Array], Departure]
) -> BudgetInput:
    """An input over wavelength with directions ``rows`` (K, B); ``at`` takes the factors (K,)."""
    k = rows.shape[0]
    return BudgetInput(
        name,
        kind,
        at,
        lambda rng: at(standardised(form.distribution, rng, k)),
        form.distribution,
        form_in_words(form),
        k,
    )


def factor_input(
    name: str, kind: Kind, rows: Array, form: SpectralForm, at: Callable[[Array], Departure]
) -> BudgetInput:
    """An input that is a factor over wavelength; ``at`` takes the factor (B,)."""
    return spectral_input(name, kind, rows, form, lambda c: at(factor_at(rows, form.distribution, c)))
