"""What-ifs: named experiments, each a run with something changed, and what each does to the false alarms."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import stats

from hyperval.compare.rows import scientific
from hyperval.errors import UsageError
from hyperval.prediction.departure import Departure
from hyperval.processing.exceedance import LEAST_EXPECTED_ALARMS, false_alarm_ratio
from hyperval.products import Products, background_of
from hyperval.progress import track
from hyperval.scenario import Scenario
from hyperval.settings import with_settings
from hyperval.uncertainty.attribution.ranking import Whitened
from hyperval.uncertainty.attribution.residuals import Quantity, Stack, stacked
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


LEVELS = (1e-2, 1e-3)
FACTOR = 2.0  # a ratio within it is good


@dataclass(frozen=True)
class AlarmRatio:
    """P_FA predicted over measured at the threshold that was measured to give ``level``.

    Attributes
    ----------
    subject, detector, metric : as the rows of the comparison have them
    value : the ratio [1]
    lower, upper : its interval [1]
    """

    subject: str
    detector: str
    metric: str
    value: float
    lower: float
    upper: float

    @property
    def off(self) -> float:
        """|ln ratio|: by how much it is wrong, either way."""
        return abs(math.log(self.value)) if self.value > 0.0 else math.inf

    @property
    def good(self) -> bool:
        """Within a factor of two."""
        return self.off <= math.log(FACTOR)


def alarm_ratios(predicted: Products, observed: Products) -> dict[tuple[str, str, str], AlarmRatio]:
    """By (background, detector, metric), at P_FA 1e-2 and 1e-3 where ten alarms are expected."""
    ratios = {}
    for (name, detector), measured in observed.exceedance.items():
        model = predicted.exceedance.get((name, detector))
        for level in LEVELS if model is not None and (measured.n or 0) > 0 else ():
            if level * (measured.n or 0) >= LEAST_EXPECTED_ALARMS and model is not None:
                key = (background_of(name), detector, f"pfa_ratio@{scientific(level)}")
                ratio = false_alarm_ratio(model, measured, level)
                ratios[key] = AlarmRatio(*key, ratio.value, ratio.lower, ratio.upper)
    return ratios


def reason_for(before: AlarmRatio, tried: Iterable[tuple[str, AlarmRatio]]) -> str:
    """In words, which experiment explains a ratio that is off by more than a factor of two, or that none does.

    Examples
    --------
    >>> r = [AlarmRatio("b", "cem", "m", v, v / 2, v * 2) for v in (6.0, 1.5, 4.0)]
    >>> reason_for(r[0], [("local", r[1]), ("tails", r[2])])
    "off by a factor of 6; 'local' leaves 1.5: it would explain it"
    >>> reason_for(r[1], [("tails", r[2])])
    'within a factor of two'
    """
    if before.good:
        return "within a factor of two"
    size = f"off by a factor of {math.exp(before.off):.2g}"
    if before.lower <= FACTOR and before.upper >= 1.0 / FACTOR:
        size += ", within what its interval allows"
    best = min(tried, key=lambda item: item[1].off, default=None)
    if best is None or best[1].off >= before.off:
        return f"{size}; no what-if brings it nearer"
    end = "it would explain it" if best[1].good else "the nearest, and not enough"
    return f"{size}; {best[0]!r} leaves {best[1].value:.2g}: {end}"
