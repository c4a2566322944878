"""What-ifs: named experiments, each a run with something changed, and what each does to the false alarms."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from hyperval.attribute.ranking import Whitened
from hyperval.attribute.residuals import POINTS, ComparedQuantity, Stack, stacked
from hyperval.attribute.schema import WhatIf
from hyperval.compare.detection import compare_exceedance
from hyperval.compare.rows import Array, named, row, scientific
from hyperval.errors import UsageError
from hyperval.model import Truth
from hyperval.products import Products, background_of
from hyperval.progress import track
from hyperval.results import Outcome, Result
from hyperval.scenario import Scenario
from hyperval.settings import with_settings

Observe = Callable[[Mapping[str, Any]], Products]
Truths = Sequence[Truth]  # what is moved in each scenario
Key = tuple[str, str, str]  # background, detector, metric
FACTOR = 2.0  # a ratio of false alarms within it is good


@dataclass(frozen=True, eq=False)
class ScenarioModel:
    """Scenarios with what predicts them.

    Attributes
    ----------
    scenarios : as they stand in the campaign
    predict : (scenarios, truths) -> for each truth their products, merged as the campaign compares them
    observe : measures the collection again with changed settings; None where that cannot be done
    """

    scenarios: Sequence[Scenario]
    predict: Callable[[Sequence[Scenario], Sequence[Truths]], Iterator[Products]]
    observe: Observe | None = None

    def assuming(self, scenarios: Sequence[Scenario]) -> Products:
        """Products of other scenarios."""
        return next(self.predict(scenarios, [[{} for _ in scenarios]]))


class WhatIfOutcome(NamedTuple):
    """What one experiment leaves: residuals over their uncertainty, summary gaps by name, ratios of false alarms."""

    item: WhatIf
    residuals: Whitened
    gaps: Mapping[str, float]
    alarms: Mapping[Key, Result]

    @property
    def reduced(self) -> float:
        """Reduced chi-square."""
        return self.residuals.chi_square / self.residuals.dof

    def rows(self, before: WhatIfOutcome) -> Iterator[Result]:
        """``reduced_chi_square`` after it, ``likelihood_gain`` and each gap after it.

        The gain is the fall of the chi-square: twice the log-likelihood gained under the same covariance.
        """
        n = before.residuals.dof
        yield row("reduced_chi_square", self.reduced, n=n, reason=f"{before.reduced:.4g} before; {self.item.question}")
        why = f"p = {self.residuals.p_value:.2g} after"
        yield row("likelihood_gain", (before.reduced - self.reduced) * n, n=n, reason=why)
        for name, gap in before.gaps.items():
            words = name.replace("|", "").replace("@", " at ").split()
            yield row("_".join(words), self.gaps[name], n=n, reason=f"{gap:.4g} before")


def run_what_ifs(
    model: ScenarioModel,
    stack: Stack,
    numbers: Sequence[ComparedQuantity],
    covariance: Array,
    observed: Products,
    what_ifs: Sequence[WhatIf],
    base: Products,
    show_progress: bool | None = None,
) -> list[Result]:
    """Rows of every experiment of a campaign, the one that closes most of the gap first; then those of false alarms.

    ``base`` : products of the scenarios as they stand.

    Raises
    ------
    UsageError : an experiment that fits no scenario, or wants a collection measured again that cannot be.
    """
    if not what_ifs:
        return []

    def left(item: WhatIf, predicted: Products, seen: Products) -> WhatIfOutcome:
        after, spread, known = stack, covariance, numbers
        if seen is not observed:
            after = stacked(predicted, seen)
            if [b.observed.shape for b in after.blocks] != [b.observed.shape for b in stack.blocks]:
                raise UsageError(
                    f"what-if {item.name!r} compares other things than the campaign does",
                    mend="change what is measured, not which subjects there are",
                )
            spread, known = covariance - stack.covariance + after.covariance, _renewed(numbers, seen)
        residuals = Whitened(after.observed - after.predicted(predicted), spread)
        return WhatIfOutcome(item, residuals, gaps_of(known, predicted), alarm_ratios(predicted, seen))

    before, outcomes = left(what_ifs[0], base, observed), []
    for item in track(what_ifs, "reasons: what-ifs", show=show_progress):
        scenarios, seen = changed_scenarios(model.scenarios, item), observed
        if item.observe:
            if model.observe is None:
                raise UsageError(f"what-if {item.name!r}: this collection cannot be measured again")
            seen = model.observe(item.observe)
        outcomes.append(left(item, model.assuming(scenarios), seen))
    outcomes.sort(key=lambda o: o.reduced)
    rows = [one for o in outcomes for one in named(o.rows(before), "what-if", "all", o.item.name)]
    return [*rows, *_alarm_rows(before.alarms, outcomes)]


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


def gaps_of(numbers: Sequence[ComparedQuantity], predicted: Products) -> dict[str, float]:
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


def _renewed(numbers: Sequence[ComparedQuantity], observed: Products) -> list[ComparedQuantity]:
    out = []
    for q in numbers:
        with suppress(KeyError):  # what is measured no more
            out.append(replace(q, observed=q.read(observed)))
    return out


def alarm_ratios(predicted: Products, observed: Products) -> dict[Key, Result]:
    """Rows of P_FA predicted over measured by (background, detector, metric), at 1e-2 and 1e-3 where both have it."""
    wanted = {f"pfa_ratio@{scientific(level)}" for level in POINTS}
    return {
        (background_of(name), detector, one.metric): one
        for (name, detector), measured in observed.exceedance.items()
        if (model := predicted.exceedance.get((name, detector))) is not None
        for one in compare_exceedance(model, measured)
        if one.metric in wanted and one.outcome is Outcome.NONE
    }


def _off(ratio: Result) -> float:
    """|ln ratio|: by how much it is wrong, either way."""
    return abs(math.log(ratio.value)) if ratio.value > 0.0 else math.inf


def reason_for(before: Result, tried: Iterable[tuple[str, Result]]) -> str:
    """In words, which experiment explains a ratio that is off by more than a factor of two, or that none does.

    Examples
    --------
    >>> r = [row("pfa_ratio@1e-2", v, (v / 2, v * 2)) for v in (6.0, 1.5, 4.0)]
    >>> reason_for(r[0], [("local", r[1]), ("tails", r[2])])
    "off by a factor of 6; 'local' leaves 1.5: it would explain it"
    >>> reason_for(r[1], [("tails", r[2])])
    'within a factor of two'
    """
    if _off(before) <= math.log(FACTOR):
        return "within a factor of two"
    size = f"off by a factor of {math.exp(_off(before)):.2g}"
    if before.lower <= FACTOR and before.upper >= 1.0 / FACTOR:
        size += ", within what its interval allows"
    name, best = min(tried, key=lambda item: _off(item[1]), default=("", before))
    if _off(best) >= _off(before):
        return f"{size}; no what-if brings it nearer"
    end = "it would explain it" if _off(best) <= math.log(FACTOR) else "the nearest, and not enough"
    return f"{size}; {name!r} leaves {best.value:.2g}: {end}"


def _alarm_rows(before: Mapping[Key, Result], outcomes: Sequence[WhatIfOutcome]) -> Iterator[Result]:
    """Every ratio of false alarms with its reason, then the ratio after each experiment."""
    tried = {key: [(o.item.name, o.alarms[key]) for o in outcomes if key in o.alarms] for key in before}
    tried = {key: each for key, each in tried.items() if each}
    for key, each in tried.items():
        yield _ratio_row(key, "attribution", before[key], reason_for(before[key], each))
    for key, each in tried.items():
        words = f"{before[key].value:.3g} before ({before[key].lower:.2g} to {before[key].upper:.2g})"
        for name, after in each:
            yield _ratio_row(key, "what-if", after, words, f"{name} / ")


def _ratio_row(key: Key, product: str, ratio: Result, reason: str, prefix: str = "") -> Result:
    subject, detector, _ = key
    return replace(ratio, product=product, subject=subject, method=f"{prefix}{detector}", n=None, reason=reason)
