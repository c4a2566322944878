"""The first screen: product by subject, or product by campaign, each cell with its outcome."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from hyperval.products import background_of
from hyperval.report.verdict import outcome_words, worst
from hyperval.results import Outcome, Result

LETTERS = {
    Outcome.AGREES: "A", Outcome.DISAGREES: "D", Outcome.ERROR: "E", Outcome.UNDECIDED: "U", Outcome.SKIPPED: "S",
    Outcome.NONE: "",
}  # fmt: skip
_MOST_OPEN = 16  # lines before the rest is folded


@dataclass(frozen=True)
class Cell:
    """One cell: the worst outcome of its gates, or of what informs where nothing gates.

    Attributes
    ----------
    letter : capital where it decides, small where it informs, "A d" where what decides agrees and something else
        does not; empty where nothing was planned
    words : how many rows of each outcome
    link : where its evidence stands
    """

    outcome: Outcome
    letter: str
    words: str
    link: str


@dataclass(frozen=True)
class Matrix:
    """Lines of cells; ``open`` of them stand on the first screen."""

    columns: Sequence[str]
    lines: Sequence[tuple[str, str, Sequence[Cell]]]

    @property
    def shown(self) -> Sequence[tuple[str, str, Sequence[Cell]]]:
        """Lines of the first screen."""
        return self.lines[:_MOST_OPEN]

    @property
    def folded(self) -> Sequence[tuple[str, str, Sequence[Cell]]]:
        """The other lines."""
        return self.lines[_MOST_OPEN:]


def anchor(row: Result) -> str:
    """Where the evidence of a row stands on its page."""
    return re.sub(r"[^A-Za-z0-9]+", "-", f"e-{row.product}-{row.subject}").strip("-")


def matrix_of(
    rows: Iterable[Result],
    line_of: Callable[[Result], str],
    link_of: Callable[[str, Sequence[Result]], str],
    titles: dict[str, str],
) -> Matrix | None:
    """Planned rows in lines by ``line_of`` and columns by product; None without any.

    Lines that gate come first, the worst of them first, then those that inform.

    Parameters
    ----------
    link_of : (line, rows of the cell) -> where the cell links to; of a whole line (line, [])
    titles : product -> heading, in the order of the columns
    """
    planned = [row for row in rows if row.planned]
    if not planned:
        return None
    columns = [p for p in titles if any(row.product == p for row in planned)]
    columns += [p for p in dict.fromkeys(row.product for row in planned) if p not in titles]
    groups: dict[str, list[Result]] = {}
    for row in planned:
        groups.setdefault(line_of(row), []).append(row)

    def rank(item: tuple[str, list[Result]]) -> tuple[bool, int]:
        gates = [row for row in item[1] if row.gates]
        order = list(LETTERS).index(worst(gates or item[1]))
        return not gates, {1: 0, 2: 0, 3: 1, 4: 2, 0: 3}.get(order, 4)

    lines = []
    for name, own in sorted(groups.items(), key=rank):
        cells = []
        for product in columns:
            here = [row for row in own if row.product == product]
            cells.append(_cell(here, link_of(name, here)))
        lines.append((name, link_of(name, []), cells))
    return Matrix([titles.get(p, p) for p in columns], lines)


def _cell(rows: Sequence[Result], link: str) -> Cell:
    if not rows:
        return Cell(Outcome.NONE, "", "not planned", "")
    gates = [row for row in rows if row.gates or row.outcome is Outcome.ERROR]
    outcome = worst(gates or rows)
    letter = LETTERS[outcome] if gates else LETTERS[outcome].lower()
    parts = [f"decide: {outcome_words(gates)}"] if gates else []
    informing = [row for row in rows if not row.gates and row.outcome is not Outcome.ERROR]
    if gates and outcome is not Outcome.DISAGREES and worst(informing) is Outcome.DISAGREES:
        letter += f" {LETTERS[Outcome.DISAGREES].lower()}"  # what decides does not, something else does
    parts += [f"do not decide: {outcome_words(informing)}"] if informing else []
    return Cell(outcome, letter, "; ".join(parts), link)


def same_background_once(rows: Sequence[Result]) -> list[Result]:
    """Rows about the background seen by one filter, which every size of a target has, as one row for all of them.

    They are the same but for the subject; the first stands for all, and says how many are alike.
    """
    kinds: dict[str, list[Result]] = {}
    order: list[list[Result]] = []
    for row in rows:
        if not row.subject.endswith(background_of("")):
            order.append([row])
            continue
        alike = repr(replace(row, subject=""))
        if alike not in kinds:
            order.append(kinds.setdefault(alike, []))
        kinds[alike].append(row)
    return [
        one[0] if len(one) == 1 else replace(one[0], subject=f"{one[0].subject} and {len(one) - 1} alike")
        for one in order
    ]
