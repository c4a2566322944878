"""The model of a campaign, ready to be asked again with something changed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hyperval.prediction.departure import Departure
from hyperval.products import Products
from hyperval.scenario import Scenario

Observe = Callable[[Mapping[str, Any]], Products]
Truth = Sequence[Departure]  # one departure for each scenario


@dataclass(frozen=True, eq=False)
class Model:
    """Scenarios with what predicts them.

    Attributes
    ----------
    scenarios : as they stand in the campaign
    predict : (scenarios, truths) -> for each truth their products, merged as the campaign compares them
    observe : measures the collection again with changed settings; None where that cannot be done
    """

    scenarios: Sequence[Scenario]
    predict: Callable[[Sequence[Scenario], Sequence[Truth]], Iterator[Products]]
    observe: Observe | None = None

    def products_of(self, truths: Sequence[Truth]) -> Iterator[Products]:
        """Products of the scenarios as they stand when the truth is another one."""
        return self.predict(self.scenarios, truths)

    def assuming(self, scenarios: Sequence[Scenario]) -> Products:
        """Products of other scenarios."""
        return next(self.predict(scenarios, [[Departure() for _ in scenarios]]))
