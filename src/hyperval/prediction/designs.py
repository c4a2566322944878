"""Designs over inputs: which truths are evaluated, and what their products say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hyperval.prediction.departure import Departure, combined
from hyperval.prediction.input import Input


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
