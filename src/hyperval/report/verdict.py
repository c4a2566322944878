"""The verdict in words, and numbers as a reader wants them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from hyperval.figures.rows import decimals, effect_text, find_criteria, outcome_words, row_label, short_text, sort_rows
from hyperval.metrics import Evidence, Kind, metric_of, plain_words, product_words
from hyperval.results import EVERY, WORST_FIRST, Cause, Outcome, Result

_MAX_NAMED = 9
_MAX_KINDS = 5
_LONGEST_NAME = 70
_MAX_STEPS = 3
SINCE = "since the accepted run"  # group of the attribution
_KINDS = {
    Evidence.MODEL: ("acceptance criterion", "acceptance criteria"),
    Evidence.PIPELINE: ("check of the pipeline", "checks of the pipeline"),
    None: ("informational comparison", "informational comparisons"),
}
# What the criterion that stands first is.
_AHEAD = {Outcome.DISAGREES: "Worst", Outcome.UNDECIDED: "Least certain", Outcome.AGREES: "Closest to its limit"}


# What to do about criteria that were not evaluated.
_UNMADE = {
    Outcome.ERROR: "Mend what ended in an error: its message stands under Not compared.",
    Outcome.SKIPPED: "Get what is missing for the criteria that were not run: it stands under Not compared.",
}


class FirstScreen(NamedTuple):
    """What a page, a line of an index and the terminal say of a run.

    Attributes
    ----------
    outcome, head, lead : status in one word and in a sentence or two
    words : all of it in sentences: criteria that the model moves apart from checks of the pipeline, each by what it
        is about; informational comparisons that are not met are named too, and turn nothing; where criteria are met
        and a full test or the attribution rejects, which to believe
    asides : what else a reader has to know before the figures
    products : what each is called, number of criteria by outcome, the same in words
    worst, ahead : the criterion that stands first, and why; None without any
    reason : what explains the differences best, and how sure that is; empty where nothing was asked
    steps : what to do next
    """

    outcome: Outcome
    head: str
    lead: str
    words: str
    asides: list[str]
    products: list[tuple[str, list[tuple[Outcome, int]], str]]
    worst: Result | None
    ahead: str
    reason: str
    steps: list[str]


def status(gates: Sequence[Result]) -> tuple[Outcome, str, str]:
    """The outcome of criteria and errors together, its word, and the sentence that begins with it."""
    overall, made = worst_outcome(gates), {row.outcome for row in gates}
    if Outcome.DISAGREES in made:
        return Outcome.DISAGREES, "Not met", "Not met."
    if overall is Outcome.ERROR:  # after an error nothing is known
        return overall, "Error", f"Ended in an error{': no acceptance criterion was evaluated' * (len(made) == 1)}."
    if not gates:
        return Outcome.NONE, "No acceptance criteria", "This campaign has no acceptance criteria."
    if made == {Outcome.SKIPPED}:
        return Outcome.SKIPPED, "Not run", "Not run: no acceptance criterion was evaluated."
    if not any(row.outcome is Outcome.AGREES and row.evidence is Evidence.MODEL for row in gates):
        reason = ": no criterion of the model was decided" if Outcome.AGREES in made else ""
        return Outcome.UNDECIDED, "Inconclusive", f"Inconclusive{reason}."
    return (overall, "Met", "Met.") if overall is Outcome.AGREES else (Outcome.UNDECIDED, "Met in part", "Met in part.")


def first_screen(rows: Sequence[Result], power: str = "") -> FirstScreen:
    """What is said of the rows of a run; ``power`` : what its criteria could have found, in words.

    >>> broken = Result("", "radiance", "lawn", "", "bias_ratio", outcome=Outcome.ERROR)
    >>> first_screen([broken]).head, first_screen([broken]).lead
    ('Error', 'Nothing here can pass or fail. 1 informational comparison ended in an error.')

    What can never be met is counted alike in the sentence and beside it, checks of the pipeline apart.

    >>> from dataclasses import replace
    >>> from hyperval.results import Role
    >>> wide = replace(broken, role=Role.GATE, outcome=Outcome.UNDECIDED, cause=Cause.NEVER)
    >>> screen = first_screen([replace(wide, evidence=evidence) for evidence in Evidence])
    >>> ["1 of the inconclusive ones can never be met" in text for text in (screen.words, screen.asides[0])]
    [True, True]
    """
    gates = [row for row in rows if row.gates]
    model = [row for row in gates if row.evidence is Evidence.MODEL]
    are_told = (Outcome.ERROR, Outcome.DISAGREES, Outcome.UNDECIDED)
    informing = [row for row in rows if not row.gates and row.outcome in are_told]
    shown = sort_rows(find_criteria(rows))
    shown = [row for row in shown if row.outcome is not Outcome.SKIPPED] or shown
    first = next((row for row in shown if row.outcome is not Outcome.ERROR), None)  # which has no size
    outcome, head, opening = status([row for row in rows if row.gates or row.outcome is Outcome.ERROR])
    asides = [power, _never_met_text(model), _conflict_text(rows), _unseen_text(model)]
    products = []
    for kind in dict.fromkeys(row.product for row in shown if row.gates):
        some = [row for row in model if row.product == kind]
        counts = Counter(row.outcome for row in some)
        products.append((product_words(kind), [(o, counts[o]) for o in WORST_FIRST if counts[o]], outcome_words(some)))
    reason, ahead = _reason(rows, first.subject if first else "all"), _AHEAD.get(first.outcome, "") if first else ""
    counted = _count_text(gates, Evidence.MODEL), _count_text(gates, Evidence.PIPELINE), _count_text(informing, None)
    words = opening, *counted[:2], _never_met_text(model), counted[2], _conflict_text(rows)
    return FirstScreen(
        outcome, head, _lead(gates, informing, ahead, first), " ".join(filter(None, words)), list(filter(None, asides)),
        products, first, ahead, reason, _steps(rows, shown, reason),
    )  # fmt: skip


def _lead(gates: Sequence[Result], informing: Sequence[Result], ahead: str, first: Result | None) -> str:
    """ "2 acceptance criteria are not met, 5 are inconclusive, 10 are met. Worst: ..." """
    if not gates:
        return f"Nothing here can pass or fail. {_count_text(informing, None, named=False)}".strip()
    parts = [_count_text(gates, kind, named=False) for kind in Evidence]
    if first is not None and first.gates and ahead:
        parts.append(f"{ahead}: {product_words(first.product)}, {row_label(first)}, {effect_text(first)}.")
    return " ".join(filter(None, parts))


def _reason(rows: Sequence[Result], subject: str) -> str:
    """What explains the differences: what the attribution concludes of all residuals, or else of one subject."""
    concludes = "attribution", "reduced_chi_square", "every input"
    reasons = {row.subject: row.reason for row in rows if (row.product, row.metric, row.method) == concludes}
    words, since = reasons.get("all") or reasons.get(subject, ""), reasons.get(SINCE, "")
    if since.startswith(("check", "none")):
        words = f"{since}, since the accepted run"
    elif since and words.startswith(("check", "none")):
        words += ", as in the accepted run"
    return f"{words[:1].upper()}{words[1:]}." if words else ""


def _steps(rows: Sequence[Result], shown: Sequence[Result], reason: str) -> list[str]:
    """What to do, at most three lines.

    >>> from hyperval.results import Role
    >>> failed = Result("twin", "radiance", "lawn", "", "bias_ratio", role=Role.GATE, outcome=Outcome.DISAGREES)
    >>> _steps([failed], [failed], "Check the time of overflight (+1 h explains 99 % ...), since the accepted run.")
    ['Check the time of overflight: correct it, or accept the new numbers, with its reason.']
    >>> _steps([failed], [failed], "")
    ['Look at what is not met by subject and band, below; attribution: {} in the campaign tries causes.']
    >>> _steps([failed], [failed], "Nothing to explain: reduced chi-square 1.05 of 90 residuals (p = 0.35).")
    ['Look at what is not met by subject and band, below; what the attribution sees agrees.']
    >>> broken = Result("twin", "radiance", "lawn", "", "bias_ratio", role=Role.GATE, outcome=Outcome.ERROR)
    >>> _steps([broken], [broken], "")
    ['Mend what ended in an error: its message stands under Not compared.']
    """
    steps = []
    criteria = [row for row in shown if row.gates]
    if any(row.outcome is Outcome.DISAGREES for row in criteria) and reason.startswith("Check"):
        is_new = reason.endswith("since the accepted run.")
        mend = "correct it, or accept the new numbers" if is_new else "measure again, or state a larger uncertainty"
        steps.append(f"{reason.partition(' (')[0]}: {mend}, with its reason.")
    elif reason.startswith("None"):
        steps.append("Look beyond the causes that were tried.")
    elif any(row.outcome is Outcome.DISAGREES for row in criteria):
        why = {"": "; attribution: {} in the campaign tries causes", "Nothing": "; what the attribution sees agrees"}
        steps.append(f"Look at what is not met by subject and band, below{why.get(reason.partition(' ')[0], '')}.")
    unsure = [
        row for row in criteria if row.outcome is Outcome.UNDECIDED
        and all(map(math.isfinite, (row.effect_lower, row.effect_upper, row.accepted_low, row.accepted_high)))
    ]  # fmt: skip
    if unsure:
        row = max(unsure, key=lambda one: one.effect_upper - one.effect_lower)
        accepted = f"{short_text(row.accepted_low)} to {short_text(row.accepted_high)}"
        steps.append(
            f"Narrow the intervals of what is inconclusive: {product_words(row.product)} of {row_label(row)} "
            f"is {effect_text(row)}, and {accepted} is accepted ({row.effect_unit})."
        )
    not_made = {row.outcome for row in rows if row.gates or row.outcome is Outcome.ERROR}
    steps += [step for outcome, step in _UNMADE.items() if outcome in not_made]
    if any(map(informs_of_disagreement, rows)):
        steps.append("Look at the informational comparisons that are not met: they do not change the status.")
    if not criteria and any(row.planned for row in rows):
        steps.append("State acceptance criteria, if this campaign is to pass or fail.")
    return steps[:_MAX_STEPS] or ["Nothing: keep these numbers as accepted."]


def _unseen_text(gates: Sequence[Result]) -> str:
    """ "Budget and settings were fitted on lawn, turf; unseen: none yet." """
    by_kind = {kind: [row for row in gates if row.subjects_seen == kind] for kind in ("fitted", "unseen")}
    if not any(by_kind.values()):
        return ""
    names = list(dict.fromkeys(row.subject for row in by_kind["fitted"] if row.subject not in EVERY))
    names[_MAX_NAMED:] = [f"{len(names) - _MAX_NAMED} more"] if len(names) > _MAX_NAMED else []
    unseen = f"{outcome_words(by_kind['unseen'])} ({_names(by_kind['unseen'])})" if by_kind["unseen"] else "none yet"
    return f"Budget and settings were fitted on {', '.join(names) or 'others'}; unseen: {unseen}."


def _never_met_text(gates: Sequence[Result]) -> str:
    """ "15 of the inconclusive criteria can never be met: what is known is 1.1 to 4.2 times too uncertain." """
    if not (never := [row for row in gates if row.never_met]):
        return ""
    words = f"{len(never)} of the inconclusive {'criteria' if len(never) > 1 else 'ones'} can never be met"
    times = sorted(x for row in never if math.isfinite(x := row.shortfall))
    texts = (f"{x:.2g}" if x >= 1.05 else f"{max(x, 1.01):.2f}" for x in times[:1] + times[-1:])
    ends = " to ".join(dict.fromkeys(texts))
    return f"{words}: what is known is {ends} times too uncertain." if ends else f"{words}."


def _conflict_text(rows: Sequence[Result]) -> str:
    """What criteria that are met mean beside tests of the stated uncertainty that are not.

    >>> failed = {"outcome": Outcome.DISAGREES}
    >>> wide = Result("", "radiance", "lawn", "", "p_value_full", 0.9999, cause=Cause.TOO_WIDE, **failed)
    >>> off = Result("", "radiance", "lawn", "", "bias_ratio", 0.06, **failed)
    >>> [_conflict_text(rows)[:15] for rows in ([wide], [wide, off])]
    ['Budget too wide', '']
    >>> from hyperval.results import Role
    >>> met = Result("", "radiance", "lot", "", "bias_ratio", 0.0, role=Role.GATE, outcome=Outcome.AGREES)
    >>> noise = Result("", "snr", "panel", "", "p_value_full", 1e-9, effect=2.9, **failed)
    >>> _conflict_text([wide, met, noise])[:113]
    'The stated uncertainty is too small (differences reach 2.9 times it; signal-to-noise ratio within its budget: pan'
    """
    tests = [row for row in rows if row.outcome is Outcome.DISAGREES and tests_the_uncertainty(row)]
    met = [row for row in rows if row.gates and row.evidence is Evidence.MODEL and row.outcome is Outcome.AGREES]
    failed = (row for row in rows if row.outcome is Outcome.DISAGREES and not tests_the_uncertainty(row))
    others = {(row.product, row.subject) for row in failed}
    wide = [row for row in tests if row.cause is Cause.TOO_WIDE and (row.product, row.subject) not in others]
    narrow = [row for row in tests if row.cause is not Cause.TOO_WIDE]
    words = []
    if met and narrow:
        sizes = (math.sqrt(row.value) if row.product == "attribution" else row.effect for row in narrow)
        times = max(filter(math.isfinite, sizes), default=math.nan)
        far = f"differences reach {number_text(times, times)} times it" if times > 1 else "full tests reject it"
        far += f"; {_names(narrow)}" * bool(wide)  # too small for one subject, too wide for another
        words.append(f"The stated uncertainty is too small ({far}): do not take it for the error of the model.")
        if any(not tests_the_uncertainty(row) for row in met):
            words.append("The criteria that are met say how large the differences are, not that they are explained.")
        if any(tests_the_uncertainty(row) for row in met):
            words.append("A test of one subject that is met does not contradict that: it has less power.")
    if wide:
        words.append(
            f"Budget too wide: the stated uncertainty is far larger than the differences ({_names(wide)}); a test "
            "that is met there says little, and inconclusive criteria may be decided by a budget that fits."
        )
    return " ".join(words)


def tests_the_uncertainty(row: Result) -> bool:
    """Whether a row asks if the stated uncertainty explains a difference, and not how large the difference is."""
    return row.product == "attribution" or metric_of(row.metric).two_sided


def _count_text(rows: Sequence[Result], kind: Evidence | None, *, named: bool = True) -> str:
    """ "1 acceptance criterion is not met (mean level of the radiance: lawn), 12 are met (12 of radiance)." """
    parts: list[str] = []
    for outcome in WORST_FIRST:
        counted = [row for row in rows if kind in (None, row.evidence) and row.outcome is outcome]
        if counted:
            noun = f" {_KINDS[kind][len(counted) != 1]}" if not parts else ""
            names = f" ({_names(counted)})" if named else ""
            parts.append(f"{len(counted)}{noun} {outcome.of_one if len(counted) == 1 else outcome.of_several}{names}")
    return f"{', '.join(parts)}." if parts else ""


def worst_outcome(rows: Iterable[Result]) -> Outcome:
    """The outcome that counts for several rows together; ``none`` without any."""
    return min((row.outcome for row in rows), key=WORST_FIRST.index, default=Outcome.NONE)


def is_failed_gate(row: Result) -> bool:
    """True for a gate that disagrees, and for any error."""
    return row.outcome is Outcome.ERROR or (row.gates and row.outcome is Outcome.DISAGREES)


def informs_of_disagreement(row: Result) -> bool:
    """True for a row that informs, and found a disagreement."""
    return not row.gates and row.outcome is Outcome.DISAGREES


def accepted_text(rows: Iterable[Result]) -> str:
    """How many numbers are as they were accepted, and how many are not; nothing of what the model agrees with."""
    counts = Counter(row.outcome for row in rows)
    wrong, total = counts[Outcome.DISAGREES], counts[Outcome.DISAGREES] + counts[Outcome.AGREES]
    if total == 0:
        return "No number was checked."
    return f"{wrong} of {total} numbers are not as accepted." if wrong else f"{total} numbers as accepted."


def last_line(rows: Iterable[Result]) -> str:
    """The last line of the console: criteria by outcome, those that are inconclusive among them."""
    gates = [row for row in rows if row.gates]
    return f"acceptance criteria: {outcome_words(gates)}" if gates else "acceptance criteria: none"


def number_text(value: float, spread: float = math.nan, limits: Sequence[float] = ()) -> str:
    """``value`` with two digits of its ``spread``, or with four significant digits without one; see :func:`decimals`.

    >>> number_text(0.2031, 0.15), number_text(0.2031, 0.15, (-0.2, 0.2))
    ('0.20', '0.203')
    """
    if not math.isfinite(value):
        return "–" if math.isnan(value) else short_text(value)
    if value != 0 and not 1e-4 <= abs(value) < 1e6:
        text = f"{value:.3g}"
    elif 0 < spread < math.inf:
        text = f"{value:z.{decimals(value, min(max(1 - math.floor(math.log10(spread)), 0), 6), limits)}f}"
    else:
        text = f"{value:z.4g}" if abs(value) < 1000 else f"{value:.0f}"
    return text.replace("-", "−")


def value_text(row: Result) -> str:
    """The value of a row with its unit; of a p-value two digits, and never nothing at all."""
    if metric_of(row.metric).kind is Kind.TEST and math.isfinite(row.value):
        if row.value < 1e-300:  # which the computer cannot tell from 0
            return "< 1e−300"
        return "> 0.999" if row.value > 0.999 else f"{row.value:.2g}".replace("-", "−")
    text = number_text(row.value, (row.upper - row.lower) / 2, (row.limit_low, row.limit_high))
    return text if row.unit in ("1", "") or math.isnan(row.value) else f"{text} {row.unit}"


def interval_text(row: Result) -> str:
    """The interval of a row, empty when it has none."""
    if math.isnan(row.lower) and math.isnan(row.upper):
        return ""
    about = (row.upper - row.lower) / 2, (row.limit_low, row.limit_high)
    return f"{number_text(row.lower, *about)} to {number_text(row.upper, *about)}"


def limits_text(row: Result) -> str:
    """The accepted range of a row, empty when it has none."""
    low, high = ("" if math.isnan(end) else number_text(end) for end in (row.limit_low, row.limit_high))
    return f"{low} to {high}" if low and high else f"≥ {low}" if low else f"≤ {high}" if high else ""


def _names(rows: Sequence[Result]) -> str:
    """What rows are about and their subjects, "shape of the radiance: lawn, turf"; many are counted."""
    several = len({row.campaign for row in rows}) > 1
    groups: dict[str, dict[str, None]] = {}
    for row in rows:
        what = f"{row.campaign}: " * several + plain_words(row.metric, row.product)
        name = row.subject if len(row.subject) <= _LONGEST_NAME else f"{row.subject[: _LONGEST_NAME - 1]}…"
        groups.setdefault(what, {})[name] = None
    if sum(map(len, groups.values())) <= _MAX_NAMED:
        return "; ".join(f"{what}: {', '.join(names)}" for what, names in groups.items())
    if len(groups) <= _MAX_KINDS:
        return "; ".join(f"{what}: {len(names)}" for what, names in groups.items())
    kinds = Counter(row.campaign if several else product_words(row.product) for row in rows)
    if several and len(kinds) > _MAX_NAMED:  # the matrix below names them
        return f"{len(kinds)} campaigns"
    return ", ".join(f"{count} of {kind}" for kind, count in kinds.most_common())
