"""The verdict in words, and numbers as a reader wants them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence

from hyperval.report.tables import status_counts
from hyperval.results import Result, Status

# How a row that informs, and does not gate, says that it found a disagreement: its reason begins so ...
_DISAGREES = ("disagree", "differ", "inconsistent", "outside")
# ... or tells what a gate would have made of it.
_WOULD_NOT = ("would not pass", "would be an error")
_MOST_NAMED = 6
_P_VALUES = ("p_value", "p_value_full", "p_value_diagonal", "p_value_shape", "p_value_explained")
# A full test of spectra that nothing was planned for: rejected beyond doubt, whatever else passed.
_FULL_TEST, _REJECTED = "p_value_full", 1e-3
_LONGEST_NAME = 70


def verdict(rows: Iterable[Result]) -> tuple[str, str]:
    """A tone (agree, mixed, disagree, undecided) and a few sentences.

    "Agrees" needs at least one PASS and neither FAIL nor ERROR, and no informing row that found a
    disagreement (``informs_of_disagreement``): those do not fail the campaign, but make the tone mixed.
    """
    rows = list(rows)
    count = status_counts(rows)
    telling = [row for row in rows if informs_of_disagreement(row)]
    failed = [row for row in rows if row.status is Status.FAIL]
    broken = [row for row in rows if row.status is Status.ERROR]
    decided = count["PASS"] + count["FAIL"]
    if failed:
        tone = "disagree"
        words = (
            f"Does not agree: {count['FAIL']} of {_things(decided, 'gating comparison')} failed ({_named(failed)})."
        )
        if count["PASS"]:
            words += f" {count['PASS']} passed."
    elif decided and not broken and telling:
        tone = "mixed"
        words = f"Passes its gates ({_passed(decided)}), but not everything agrees."
    elif decided and not broken:
        tone = "agree"
        where = "where it was checked" if count["SKIPPED"] else "within the stated limits"
        words = f"Agrees {where}: {_passed(decided)}."
    elif decided:
        tone = "undecided"
        words = f"Not decided: {count['PASS']} passed, but not every planned comparison could be made."
    elif telling and not count["SKIPPED"] and not broken:
        tone = "undecided"
        words = "Nothing was checked by a gate: every comparison of this campaign only informs."
    else:
        tone = "undecided"
        words = "Nothing was checked: no gating comparison was decided."
    if broken:
        words += f" {_things(count['ERROR'], 'comparison')} ended in an error ({_named(broken)})."
    if count["SKIPPED"]:
        skipped = [row for row in rows if row.status is Status.SKIPPED]
        words += f" {_things(count['SKIPPED'], 'planned comparison')} skipped ({_named(skipped)})."
    if telling:
        words += f" Without gating, {_things(len(telling), 'comparison')} found a disagreement ({_named(telling)})."
    return tone, words


def informs_of_disagreement(row: Result) -> bool:
    """True for an INFO row whose reason says that the two sides do not agree.

    It begins with "disagrees", "differs", "inconsistent" or "outside", or says that the row "would not pass".
    A full test of two spectra (``p_value_full``) below 1e-3 says so without words.
    """
    rejected = row.metric == _FULL_TEST and row.value < _REJECTED
    return row.status is Status.INFO and (rejected or _says_so(row))


def is_planned(row: Result) -> bool:
    """True for an INFO row that a campaign asked for, with what it would have to meet.

    Which rows are planned does not follow from their values: accepted numbers are kept of these.
    """
    told = row.status is Status.INFO and _says_so(row)
    return math.isfinite(row.threshold) or "informs only" in row.reason or told


def _says_so(row: Result) -> bool:
    """True where the reason says that the two sides do not agree."""
    reason = row.reason.lower()
    return reason.startswith(_DISAGREES) or any(w in reason for w in _WOULD_NOT)


def status_words(rows: Iterable[Result]) -> str:
    """Number of rows by status: "3 passed, 1 failed, 2 skipped, 40 inform"."""
    count = status_counts(rows)
    names = {"PASS": "passed", "FAIL": "failed", "ERROR": "in error", "SKIPPED": "skipped", "INFO": "inform"}
    return ", ".join(f"{count[key]} {name}" for key, name in names.items() if count[key]) or "no rows"


def is_per_band(row: Result) -> bool:
    """True for a row about one band."""
    return math.isfinite(row.band_nm)


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
    if row.metric.partition("@")[0].endswith(_P_VALUES) and math.isfinite(row.value):
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


def threshold_text(row: Result) -> str:
    """The threshold of a row with the side on which a value passes, empty when it has none."""
    return "" if math.isnan(row.threshold) else f"{_side(row)}{number_text(row.threshold)}"


def _side(row: Result) -> str:
    """ "≥ " or "≤ ", as the reason says or as value and status tell; empty where neither does."""
    for words, sign in (("at least", "≥ "), ("at most", "≤ ")):
        if words in row.reason:
            return sign
    fails = row.status is Status.FAIL or "would not pass" in row.reason
    passes = row.status is Status.PASS or "would pass" in row.reason
    if fails == passes or math.isnan(row.value) or row.value == row.threshold:
        return ""
    return "≥ " if (row.value > row.threshold) == passes else "≤ "


def _half_width(row: Result) -> float:
    return (row.upper - row.lower) / 2


def _named(rows: Sequence[Result]) -> str:
    several = len({row.campaign for row in rows}) > 1
    parts = ((row.campaign if several else "", row.product, row.subject, row.method) for row in rows)
    texts = (" ".join(part for part in each if part) for each in parts)
    names = list(dict.fromkeys(t if len(t) <= _LONGEST_NAME else f"{t[: _LONGEST_NAME - 1]}…" for t in texts))
    if len(names) <= _MOST_NAMED:
        return "; ".join(names)
    kinds = Counter(row.campaign if several else row.product for row in rows)
    return ", ".join(f"{count} of {kind}" for kind, count in kinds.most_common())


def _things(count: int, thing: str) -> str:
    return f"{count} {thing}{'' if count == 1 else 's'}"


def _passed(decided: int) -> str:
    return "the one gating comparison passed" if decided == 1 else f"all {decided} gating comparisons passed"
