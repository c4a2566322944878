"""The verdict in words, and numbers as a reader wants them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence

from hyperval.metrics import Evidence, Kind, metric_of, plain_words, product_words
from hyperval.results import WORST_FIRST, Cause, Outcome, Result

_MOST_NAMED = 9
_MOST_KINDS = 5
_LONGEST_NAME = 70
_KINDS = {
    Evidence.MODEL: ("acceptance criterion", "acceptance criteria"),
    Evidence.PIPELINE: ("check of the pipeline", "checks of the pipeline"),
}
# (outcome, of one, of several)
_VERBS = (
    (Outcome.DISAGREES, "is not met", "are not met"),
    (Outcome.ERROR, "ended in an error", "ended in an error"),
    (Outcome.UNDECIDED, "is inconclusive", "are inconclusive"),
    (Outcome.SKIPPED, "was not run", "were not run"),
    (Outcome.AGREES, "is met", "are met"),
)
OUTCOMES = {
    Outcome.AGREES: "met", Outcome.DISAGREES: "not met", Outcome.ERROR: "error", Outcome.UNDECIDED: "inconclusive",
    Outcome.SKIPPED: "not run", Outcome.NONE: "without a range",
}  # fmt: skip


def verdict(rows: Iterable[Result]) -> tuple[Outcome, str]:
    """What the criteria conclude together, and a few sentences: what is met, what is not, what is inconclusive.

    Criteria that the model moves are counted apart from checks of the pipeline.  Informational comparisons that are
    not met are named too, and "Met." needs that there is none.  Where criteria are met and a full test or the
    attribution rejects, a sentence says which to believe.
    """
    rows = list(rows)
    gates = [row for row in rows if row.gates or row.outcome is Outcome.ERROR]
    telling = [row for row in rows if disagrees_without_gating(row)]
    overall = worst(gates)
    model = [row for row in gates if row.evidence is Evidence.MODEL]
    decided = any(row.outcome in (Outcome.AGREES, Outcome.DISAGREES) for row in gates)
    if overall in (Outcome.ERROR, Outcome.DISAGREES):
        words = ["Not met."]
    elif not gates:
        words = ["This campaign has no acceptance criteria."]
        overall = Outcome.UNDECIDED if telling else Outcome.NONE
    elif all(row.outcome is Outcome.SKIPPED for row in gates):
        words, overall = ["Not run: no acceptance criterion was evaluated."], Outcome.SKIPPED
    elif not decided:
        words = ["Inconclusive."]
        overall = Outcome.UNDECIDED
    elif not any(row.outcome is Outcome.AGREES for row in model):
        words, overall = ["Inconclusive: no criterion of the model was decided."], Outcome.UNDECIDED
    elif overall is Outcome.AGREES:
        words, overall = (["Met, with reservations."], Outcome.UNDECIDED) if telling else (["Met."], overall)
    else:
        words, overall = ["Met in part."], Outcome.UNDECIDED
    words += [_counted([row for row in gates if row.evidence is kind], kind) for kind in _KINDS]
    words.append(_never_met(gates))
    if telling:
        noun = "comparison is" if len(telling) == 1 else "comparisons are"
        words.append(f"Besides, {len(telling)} informational {noun} not met ({_named(telling)}).")
    words.append(_which_to_believe(rows))
    unsure = sum(not row.gates and row.outcome is Outcome.UNDECIDED for row in rows)
    if unsure:
        words.append(f"{unsure} informational comparison{' is' if unsure == 1 else 's are'} inconclusive.")
    return overall, " ".join(part for part in words if part)


def _never_met(gates: Sequence[Result]) -> str:
    """ "15 of the inconclusive criteria can never be met: what is known is 1.1 to 4.2 times too uncertain." """
    never = [row for row in gates if row.never_met]
    if not never:
        return ""
    words = f"{len(never)} of the inconclusive {'criteria' if len(never) > 1 else 'ones'} can never be met"
    times = sorted(x for row in never if math.isfinite(x := row.shortfall))
    return f"{words}: what is known is {times[0]:.2g} to {times[-1]:.2g} times too uncertain." if times else f"{words}."


def _which_to_believe(rows: Sequence[Result]) -> str:
    """What a user should take from criteria that are met beside tests of the stated uncertainty that are not."""
    tests = [row for row in rows if row.outcome is Outcome.DISAGREES and tests_the_uncertainty(row)]
    met = [row for row in rows if row.gates and row.evidence is Evidence.MODEL and row.outcome is Outcome.AGREES]
    wide = [row for row in tests if row.cause is Cause.TOO_WIDE]
    narrow = [row for row in tests if row.cause is not Cause.TOO_WIDE]
    words = []
    if met and narrow:
        times = math.sqrt(_most_reduced(narrow, rows))
        far = f"differences reach {number_text(times, times)} times it" if times > 1 else "full tests reject it"
        words.append(f"The stated uncertainty is too small ({far}): do not take it for the error of the model.")
        if any(not tests_the_uncertainty(row) for row in met):
            words.append("The criteria that are met say how large the differences are, not that they are explained.")
        if any(tests_the_uncertainty(row) for row in met):
            words.append("A test of one subject that is met has too little power to contradict them.")
    if wide:
        words.append(
            f"Budget too wide: the stated uncertainty is far larger than the differences ({_named(wide)}); a test "
            "that is met there says little, and inconclusive criteria may be decided by a budget that fits."
        )
    return " ".join(words)


def tests_the_uncertainty(row: Result) -> bool:
    """Whether a row asks if the stated uncertainty explains a difference, and not how large the difference is."""
    return row.product == "attribution" or metric_of(row.metric).two_sided


def _most_reduced(tests: Sequence[Result], rows: Sequence[Result]) -> float:
    """The greatest reduced chi-square behind tests of the stated uncertainty; NaN where none has one."""
    behind = {
        (row.campaign, row.product, row.subject, row.method, row.metric.replace("p_value", "chi2_reduced"))
        for row in tests
    }
    values = [row.value for row in tests if row.metric == "reduced_chi_square"]
    values += [
        row.value
        for row in rows
        if row.metric.startswith("chi2_reduced")
        and (row.campaign, row.product, row.subject, row.method, row.metric) in behind
    ]
    return max((value for value in values if math.isfinite(value)), default=math.nan)


def _counted(gates: Sequence[Result], kind: Evidence) -> str:
    """ "1 acceptance criterion is not met (mean level of the radiance: lawn), 12 are met (12 of radiance)." """
    parts: list[str] = []
    for outcome, one, several in _VERBS:
        own = [row for row in gates if row.outcome is outcome]
        if own:
            noun = f" {_KINDS[kind][len(own) != 1]}" if not parts else ""
            parts.append(f"{len(own)}{noun} {one if len(own) == 1 else several} ({_named(own)})")
    return f"{', '.join(parts)}." if parts else ""


def worst(rows: Iterable[Result]) -> Outcome:
    """The outcome that counts for several rows together; ``none`` without any."""
    return min((row.outcome for row in rows), key=WORST_FIRST.index, default=Outcome.NONE)


def gate_fails(row: Result) -> bool:
    """True for a gate that disagrees, and for any error."""
    return row.outcome is Outcome.ERROR or (row.gates and row.outcome is Outcome.DISAGREES)


def disagrees_without_gating(row: Result) -> bool:
    """True for a row that informs, and found a disagreement."""
    return not row.gates and row.outcome is Outcome.DISAGREES


def outcome_words(rows: Iterable[Result]) -> str:
    """Number of rows by outcome: "3 met, 1 not met, 40 without a range"."""
    count = Counter(row.outcome for row in rows)
    return ", ".join(f"{count[key]} {name}" for key, name in OUTCOMES.items() if count[key]) or "no rows"


def accepted_words(rows: Iterable[Result]) -> str:
    """How many numbers are as they were accepted, and how many are not; nothing of what the model agrees with."""
    outcomes = [row.outcome for row in rows]
    wrong, right = outcomes.count(Outcome.DISAGREES), outcomes.count(Outcome.AGREES)
    total = wrong + right
    if total == 0:
        return "No number was checked."
    return f"{wrong} of {total} numbers are not as accepted." if wrong else f"{total} numbers as accepted."


def last_line(rows: Iterable[Result]) -> str:
    """The last line of the console: criteria by outcome, those that are inconclusive among them."""
    gates = [row for row in rows if row.gates]
    return f"acceptance criteria: {outcome_words(gates)}" if gates else "acceptance criteria: none"


def number_text(value: float, spread: float = math.nan) -> str:
    """``value`` with two digits of its ``spread``, or with four significant digits without one."""
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    magnitude = abs(value)
    if value != 0 and not 1e-4 <= magnitude < 1e6:
        return f"{value:.3g}".replace("-", "−")
    if math.isfinite(spread) and spread > 0:
        decimals = min(max(1 - math.floor(math.log10(spread)), 0), 6)
    elif float(value).is_integer():
        decimals = 0
    else:
        decimals = min(max(3 - math.floor(math.log10(magnitude)), 0), 7)
    text = f"{value:.{decimals}f}"
    if "." in text and not (math.isfinite(spread) and spread > 0):
        text = text.rstrip("0").removesuffix(".")
    if float(text) == 0.0:
        text = text.removeprefix("-")
    return text.replace("-", "−")


def value_text(row: Result) -> str:
    """The value of a row with its unit; of a p-value two digits, and never nothing at all."""
    if metric_of(row.metric).kind is Kind.TEST and math.isfinite(row.value):
        return _p_value_text(row.value)
    text = number_text(row.value, _half_width(row))
    return text if row.unit in ("1", "") or math.isnan(row.value) else f"{text} {row.unit}"


def _p_value_text(value: float) -> str:
    """A probability to two digits: no test knows more; one that the computer cannot tell from 0 is not 0."""
    if value < 1e-300:
        return "< 1e−300"
    return "> 0.999" if value > 0.999 else f"{value:.2g}".replace("-", "−")


def interval_text(row: Result) -> str:
    """The interval of a row, empty when it has none."""
    if math.isnan(row.lower) and math.isnan(row.upper):
        return ""
    spread = _half_width(row)
    return f"{number_text(row.lower, spread)} to {number_text(row.upper, spread)}"


def limits_text(row: Result) -> str:
    """The accepted range of a row, empty when it has none."""
    low, high = row.limit_low, row.limit_high
    if math.isnan(low) and math.isnan(high):
        return ""
    if math.isnan(low):
        return f"≤ {number_text(high)}"
    return f"≥ {number_text(low)}" if math.isnan(high) else f"{number_text(low)} to {number_text(high)}"


def _half_width(row: Result) -> float:
    return (row.upper - row.lower) / 2


def _named(rows: Sequence[Result]) -> str:
    """What rows are about and their subjects, "shape of the radiance: lawn, turf"; many are counted."""
    several = len({row.campaign for row in rows}) > 1
    groups: dict[str, dict[str, None]] = {}
    for row in rows:
        what = f"{row.campaign}: " * several + plain_words(row.metric, row.product)
        name = row.subject if len(row.subject) <= _LONGEST_NAME else f"{row.subject[: _LONGEST_NAME - 1]}…"
        groups.setdefault(what, {})[name] = None
    if sum(map(len, groups.values())) <= _MOST_NAMED:
        return "; ".join(f"{what}: {', '.join(names)}" for what, names in groups.items())
    if len(groups) <= _MOST_KINDS:
        return "; ".join(f"{what}: {len(names)}" for what, names in groups.items())
    kinds = Counter(row.campaign if several else product_words(row.product) for row in rows)
    if several and len(kinds) > _MOST_NAMED:  # the matrix below names them
        return f"{len(kinds)} campaigns"
    return ", ".join(f"{count} of {kind}" for kind, count in kinds.most_common())
