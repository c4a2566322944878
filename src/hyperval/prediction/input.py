"""One uncertain input: a dotted path into scenario, sensor or state, what stands there, how far it may be off.

An input has K independent directions with factors of mean 0 and variance 1; its value follows from any set of
factors, and the truth from its value (:mod:`hyperval.prediction.input_paths`).  Budgets, Monte Carlo,
linearisation, attribution, what-ifs and planted errors are designs over inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from hyperval.prediction.departure import Departure, combined
from hyperval.prediction.forms import directions, form_in_words, number_directions, standardised, value_along
from hyperval.prediction.input_paths import Given, input_path
from hyperval.scenario_uncertainty import Distribution, SpectralForm, Spread
from hyperval.settings import path_parts

Array = npt.NDArray[np.float64]
Kind = Literal["atmosphere", "surface", "sensor", "scene", "engine", "sampling"]
Source = Literal["stated", "usual"]


@dataclass(frozen=True, eq=False)
class Input:
    """An uncertain input.

    Attributes
    ----------
    name : for users; one budget has each name once
    kind : what sort of input
    path : where it stands (:func:`hyperval.prediction.input_paths.input_path`)
    nominal : the value as stated: a number, or (n,) over wavelength or over the things that it moves
    rows : (K, n) change of the value per unit along each direction, the leading one first; one unit is one standard
        uncertainty
    to : value -> the truth there
    law : distribution of the factors; log-normal errors multiply the value
    correlation : how errors hang together over wavelength, in words
    source : whether the scenario states the uncertainty, or a usual one is taken
    draws : one draw from the distribution, where it is not that of independent factors
    """

    name: str
    kind: Kind
    path: str
    nominal: float | Array
    rows: Array
    to: Callable[[Array], Departure]
    law: Distribution = "normal"
    correlation: str = "one number"
    source: Source = "stated"
    draws: Callable[[np.random.Generator], Departure] | None = None

    @property
    def size(self) -> int:
        """Number of directions."""
        result: int = self.rows.shape[0]
        return result

    @property
    def distribution(self) -> str:
        """The law in words."""
        return self.law if self.draws is None else "inverse Wishart"

    @property
    def subject(self) -> str:
        """The surface whose mean it is; empty for anything else."""
        parts = path_parts(self.path)
        return parts[1] if parts[0] == "surfaces" and parts[2] == "mean" else ""

    def along(self, c: Array) -> Departure:
        """The truth at factors (K,) of the directions."""
        return self.to(value_along(self.nominal, self.rows, self.law, c))

    def direction(self, k: int, z: float) -> Departure:
        """The truth ``z`` units along direction ``k``, the rest as stated."""
        c = np.zeros(self.size)
        c[k] = z
        return self.along(c)

    def moved(self, z: float) -> Departure:
        """The truth ``z`` units along the leading direction."""
        return self.direction(0, z)

    def drawn(self, rng: np.random.Generator) -> Departure:
        """A truth drawn from the distribution of this input alone."""
        return self.along(standardised(self.law, rng, self.size)) if self.draws is None else self.draws(rng)


def number_input(
    given: Given, name: str, kind: Kind, path: str, spread: Spread | Array, *, source: Source = "stated",
    words: str = "one number",
) -> Input:  # fmt: skip
    """An input of one number, or of several that move together.

    ``spread`` : standard uncertainty of each; an array is that of a normal error.
    """
    at = input_path(given, path)
    law: Distribution = getattr(spread, "distribution", "normal")
    rows = number_directions(at.nominal, spread)
    return Input(name, kind, path, at.nominal, rows, at.to, law, words, source)


def spectral_input(given: Given, name: str, kind: Kind, path: str, sd: Array | float, form: SpectralForm) -> Input:
    """An input over wavelength with standard uncertainty ``sd`` (B,) and the correlation of ``form``."""
    at = input_path(given, path)
    rows = directions(np.broadcast_to(sd, len(given.axis)), form, given.axis, given.sensor)
    return Input(name, kind, path, at.nominal, rows, at.to, form.distribution, form_in_words(form))


@dataclass(frozen=True)
class Step:
    """One direction of one input, one unit up and down, everything else as stated."""

    item: Input
    direction: int

    @property
    def truths(self) -> tuple[Departure, Departure]:
        """Up, and down."""
        return self.item.direction(self.direction, 1.0), self.item.direction(self.direction, -1.0)


def one_at_a_time(inputs: Sequence[Input], most: int) -> list[Step]:
    """Every input by itself, along its ``most`` leading directions."""
    return [Step(item, k) for item in inputs for k in range(min(item.size, most))]


def drawn_truths(inputs: Sequence[Input], count: int, seed: int) -> list[Departure]:
    """Truths with every input drawn from its distribution, independently of the others."""
    rng = np.random.default_rng(seed)
    return [combined(*(item.drawn(rng) for item in inputs)) for _ in range(count)]
