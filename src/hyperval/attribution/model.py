"""The model of a campaign, ready to be asked again with something changed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hyperval.prediction.departure import Departure
from hyperval.products import Products
from hyperval.scenario import Scenario

Observe = Callable[[Mapping[str, Any]], Products]


@dataclass(frozen=True, eq=False)
class Model:
    """Scenarios with what predicts them.

    Attributes
    ----------
    scenarios : as they stand in the campaign
    predict : (scenarios, departures) -> their products merged as the campaign compares them
    observe : measures the collection again with changed settings; None where that cannot be done
    """

    scenarios: Sequence[Scenario]
    predict: Callable[[Sequence[Scenario], Sequence[Departure]], Products]
    observe: Observe | None = None

    def departed(self, departures: Sequence[Departure]) -> Products:
        """Products when the truth of each scenario departs by its departure."""
        return self.predict(self.scenarios, departures)

    def assuming(self, scenarios: Sequence[Scenario]) -> Products:
        """Products of other scenarios."""
        return self.predict(scenarios, [Departure() for _ in scenarios])
