"""Named experiments: the comparison repeated with something assumed otherwise, the gap before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy import stats

from hyperval.errors import UsageError
from hyperval.products import Products
from hyperval.progress import track
from hyperval.scenario import Scenario
from hyperval.settings import with_settings
from hyperval.uncertainty.attribution.false_alarms import AlarmRatio, alarm_ratios
from hyperval.uncertainty.attribution.likelihood import Whitened
from hyperval.uncertainty.attribution.model import Model
from hyperval.uncertainty.attribution.quantities import Quantity
from hyperval.uncertainty.attribution.residuals import Stack, stacked
from hyperval.uncertainty.attribution.schema import WhatIf

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Outcome:
    """What one experiment did.

    Attributes
    ----------
    name, question : as the campaign has it
    before, after : chi-square of the residuals over their number, under the same covariance
    dof : number of residuals
    p_value : of the residuals after
    gaps : name of a gap -> (before, after)
    alarms : predicted over measured false alarms (before, after), filter by filter
    """

    name: str
    question: str
    before: float
    after: float
    dof: int
    p_value: float
    gaps: Mapping[str, tuple[float, float]]
    alarms: Sequence[tuple[AlarmRatio, AlarmRatio]] = field(default_factory=tuple)

    @property
    def gain(self) -> float:
        """Fall of the chi-square: twice the log-likelihood gained under the same covariance."""
        return (self.before - self.after) * self.dof


def run_what_ifs(
    model: Model,
    stack: Stack,
    numbers: Sequence[Quantity],
    covariance: Array,
    observed: Products,
    what_ifs: Sequence[WhatIf],
    base: Products,
    show_progress: bool | None = None,
) -> list[Outcome]:
    """Run every experiment of a campaign, the one that closes most of the gap first.

    ``base`` : products of the scenarios as they stand.

    Raises
    ------
    UsageError : an experiment that fits no scenario, or wants a collection measured again that cannot be.
    """
    out = []
    for item in track(what_ifs, "reasons: what-ifs", show=show_progress):
        scenarios = changed_scenarios(model.scenarios, item)
        seen = observed
        if item.observe:
            if model.observe is None:
                raise UsageError(f"what-if {item.name!r}: this collection cannot be measured again")
            seen = model.observe(item.observe)
        predicted = model.assuming(scenarios)
        after, cov_after, numbers_after = stack, covariance, list(numbers)
        if item.observe:
            again = stacked(predicted, seen)
            if [b.observed.shape for b in again.blocks] != [b.observed.shape for b in stack.blocks]:
                raise UsageError(
                    f"what-if {item.name!r} compares other things than the campaign does",
                    mend="change what is measured, not which subjects there are",
                )
            after, cov_after = again, covariance - stack.covariance + again.covariance
            numbers_after = _renewed(numbers, seen)
        first = Whitened(stack.observed - stack.predicted(base), covariance)
        second = Whitened(after.observed - after.predicted(predicted), cov_after)
        gaps = {
            name: (value, gaps_of(numbers_after, predicted)[name]) for name, value in gaps_of(numbers, base).items()
        }
        ratios, there = alarm_ratios(base, observed), alarm_ratios(predicted, seen)
        out.append(
            Outcome(
                item.name,
                item.question,
                first.chi_square / first.dof,
                second.chi_square / second.dof,
                first.dof,
                float(stats.chi2.sf(second.chi_square, second.dof)),
                gaps,
                tuple((ratio, there[key]) for key, ratio in ratios.items() if key in there),
            )
        )
    return sorted(out, key=lambda o: o.after)


def changed_scenarios(scenarios: Sequence[Scenario], item: WhatIf) -> list[Scenario]:
    """The scenarios with an experiment's settings; one whose names do not fit stays as it is.

    Raises
    ------
    UsageError : the settings fit none of them.
    """
    out, errors = [], []
    for scenario in scenarios:
        try:
            out.append(with_settings(scenario, item.scenario) if item.scenario else scenario)
        except UsageError as error:
            errors.append(error)
            out.append(scenario)
    if errors and len(errors) == len(scenarios):
        raise UsageError(f"what-if {item.name!r} fits no scenario: {errors[0].what}")
    return out


def gaps_of(numbers: Sequence[Quantity], predicted: Products) -> dict[str, float]:
    """Summary gaps: median relative difference of spectra, mean difference of P_D."""
    parts: dict[str, list[float]] = {}
    for q in numbers:
        value = q.read(predicted)
        if not (np.isfinite(value) and np.isfinite(q.observed)):
            continue
        if q.product == "roc":
            parts.setdefault(f"mean |{q.metric} difference|", []).append(abs(value - q.observed))
        elif q.observed:
            parts.setdefault(f"median |{q.product} difference ratio|", []).append(abs(value / q.observed - 1.0))
    return {
        name: float(np.median(values) if name.startswith("median") else np.mean(values))
        for name, values in parts.items()
    }


def _renewed(numbers: Sequence[Quantity], observed: Products) -> list[Quantity]:
    return [
        Quantity(q.product, q.subject, q.method, q.metric, q.read(observed), q.read)
        for q in numbers
        if _there(q, observed)
    ]


def _there(q: Quantity, observed: Products) -> bool:
    try:
        q.read(observed)
    except KeyError:
        return False
    return True
