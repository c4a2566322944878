"""The reasons as rows of the results table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from hyperval.compare.rows import RowMaker
from hyperval.results import Outcome, Result
from hyperval.uncertainty.attribution.ranking import ENOUGH, Ranking, closing_change, in_words
from hyperval.uncertainty.attribution.run import Attribution
from hyperval.uncertainty.attribution.what_ifs import AlarmRatio, reason_for
from hyperval.uncertainty.attribution.what_ifs import Outcome as Experiment

_EVERYTHING = "every input"


def attribution_rows(attribution: Attribution) -> list[Result]:
    """Rows of the products ``attribution``, ``sensitivity`` and ``what-if``.

    attribution: for each group of residuals ``reduced_chi_square`` and ``p_value`` under the stated uncertainties,
    then for each input ``likelihood_gain`` (twice the log-likelihood gained when it may be less well known) and
    ``needed_uncertainty`` (in units of its stated one, or of a usual step).  sensitivity: for each number of the
    comparison the change per unit of each input, with the units that would close the gap, and its total share.
    what-if: ``reduced_chi_square`` after the experiment, each summary gap after it, and ``pfa_ratio`` of every
    background.  attribution of a background: its ``pfa_ratio``, and which experiment explains it if any.
    """
    rows = [row for r in attribution.rankings for row in _ranking_rows(r)]
    rows += _sensitivity_rows(attribution)
    rows += [row for o in attribution.what_ifs for row in _outcome_rows(o)]
    return rows + _alarm_rows(attribution.what_ifs)


def _alarm_rows(outcomes: Sequence[Experiment]) -> list[Result]:
    """Every ratio of false alarms with its reason, then the ratio after each experiment."""
    before: dict[tuple[str, str, str], AlarmRatio] = {}
    tried: dict[tuple[str, str, str], list[tuple[str, AlarmRatio]]] = {}
    for o in outcomes:
        for first, after in o.alarms:
            key = (first.subject, first.detector, first.metric)
            before[key] = first
            tried.setdefault(key, []).append((o.name, after))

    def row(product: str, method: str, r: AlarmRatio, reason: str) -> Result:
        return RowMaker(product, r.subject, method).row(
            r.metric, r.value, interval=(r.lower, r.upper), reason=reason
        )

    rows = [row("attribution", r.detector, r, reason_for(r, tried[key])) for key, r in before.items()]
    for key, first in before.items():
        for name, after in tried[key]:
            words = f"{first.value:.3g} before ({first.lower:.2g} to {first.upper:.2g})"
            rows.append(row("what-if", f"{name} / {first.detector}", after, words))
    return rows


def _ranking_rows(r: Ranking) -> list[Result]:
    def row(method: str, metric: str, value: float, reason: str = "", n: int | None = None) -> Result:
        return RowMaker("attribution", r.group, method).row(metric, value, n=n, reason=reason)

    # The test of all products together concludes too, and informs.
    whole = row(_EVERYTHING, "reduced_chi_square", r.chi_square / r.dof, r.conclusion, r.dof)
    rows = [
        replace(whole, outcome=Outcome.DISAGREES) if r.p_value < ENOUGH else whole,
        row(_EVERYTHING, "p_value", r.p_value, n=r.dof),
    ]
    if r.together:
        rows.append(
            row(_EVERYTHING, "p_value_explained", r.together[-1].p_value,
                "with " + " and ".join(x.candidate.name for x in r.together) + " freed", r.dof)
        )  # fmt: skip
    for place, item in enumerate(r.ranked, start=1):
        reason = f"rank {place}: {in_words(item)}; leaves reduced chi-square {item.chi_square / r.dof:.3g}"
        rows.append(row(item.candidate.name, "likelihood_gain", item.gain, reason, r.dof))
        unit = "stated uncertainty" if item.candidate.budgeted else f"step of {item.candidate.step}, none is stated"
        rows.append(row(item.candidate.name, "needed_uncertainty", item.needed, f"in units of its {unit}"))
    return rows


def _sensitivity_rows(attribution: Attribution) -> list[Result]:
    rows = []
    place = {c: i for i, c in enumerate(attribution.stated)}
    for q, quantity in enumerate(attribution.quantities):
        gap = quantity.observed - attribution.predicted[q]
        for c, candidate in enumerate(attribution.candidates):
            change = float(attribution.changes[q, c])
            closes = closing_change(gap, change)
            reason = f"gap {gap:.4g}" + (
                f" closed by {closes:+.3g} units" if math.isfinite(closes) else ", not closed by this input"
            )
            if attribution.indices is not None and candidate in place:
                total = float(attribution.indices.total[q, place[candidate]])
                first = float(attribution.indices.first[q, place[candidate]])
                if math.isfinite(total):  # no stated input moves some quantities
                    reason += f"; share of the variance {first:.3g} alone, {total:.3g} in all"
            unit = "stated uncertainty" if candidate.budgeted else candidate.step
            method = f"{candidate.name} / {quantity.method}" if quantity.method else candidate.name
            metric = f"{quantity.product}_{quantity.metric}_change"
            make = RowMaker("sensitivity", quantity.subject, method)
            rows.append(make.row(metric, change, reason=f"per {unit}; {reason}"))
    return rows


def _outcome_rows(o: Experiment) -> list[Result]:
    make = RowMaker("what-if", "all", o.name)
    rows = [
        make.row("reduced_chi_square", o.after, n=o.dof, reason=f"{o.before:.4g} before; {o.question}"),
        make.row("likelihood_gain", o.gain, n=o.dof, reason=f"p = {o.p_value:.2g} after"),
    ]
    for name, (before, after) in o.gaps.items():
        words = name.replace("|", "").replace("@", " at ").split()
        rows.append(make.row("_".join(words), after, n=o.dof, reason=f"{before:.4g} before"))
    return rows
