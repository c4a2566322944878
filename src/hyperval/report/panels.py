"""What figures of both sides share: grids of panels, rows that are named, legends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hyperval.report import style
from hyperval.report.style import COLLECTED, PREDICTED, Look

COVERAGE = 1.96  # normal quantile of a two-sided 95 % interval
GREY = "#444444"
Entries = list[tuple[Any, str]]


def small_multiples(
    title: str,
    count: int,
    labels: tuple[str, ...],
    simulated: bool,
    *,
    row_in: float,
    more_in: float = 1.0,
    columns: int = 0,
) -> tuple[Figure, list[list[Axes]]]:
    """A figure with ``count`` panels, named at the left and at the foot alone.

    Parameters
    ----------
    labels : of x, of y, and of y of the lower part where a panel has two
    row_in, more_in : height of a row, and of everything else [in]
    columns : as suits the count where it is 0

    Returns
    -------
    The figure, and the parts of each panel from above.
    """
    columns = columns or style.column_count(count)
    rows, parts = math.ceil(count / columns), len(labels) - 1
    figure = style.new_figure(10.0, more_in + row_in * rows, title, simulated)
    grid = figure.add_gridspec(parts * rows, columns, height_ratios=[2, 1] * rows if parts == 2 else None)
    panels = []
    for at in range(count):
        row, column = divmod(at, columns)
        panel = [figure.add_subplot(grid[parts * row, column])]
        if parts == 2:
            panel.append(figure.add_subplot(grid[2 * row + 1, column], sharex=panel[0]))
            panel[0].tick_params(labelbottom=False)
        if column == 0:
            for axes, label in zip(panel, labels[1:], strict=True):
                axes.set_ylabel(label)
        if at + columns >= count:
            panel[-1].set_xlabel(labels[0])
        panels.append(panel)
    return figure, panels


def name_rows(axes: Axes, names: Sequence[str], low: float = 0.5, high: float = 0.5) -> None:
    """Names of the rows of a panel from above, with so much room past the last and before the first."""
    axes.set_yticks(range(len(names)), [style.plain(name) for name in names])
    axes.set_ylim(len(names) - low, -high)
    axes.grid(visible=False, axis="y")


def line_entries(predicted: Any, measured: Any, name: str = "measured") -> Entries:
    """Legend entries of the sides that are there, lines alone."""
    looks = _looks(predicted, measured, name)
    return [(Line2D([], [], color=look.colour, linestyle=look.line), words) for look, words in looks]


def interval_entry(predicted: Any, measured: Any) -> tuple[Any, str]:
    """The legend entry of the intervals of the sides that are there."""
    return style.interval_handle(*(look.colour for look, _ in _looks(predicted, measured, ""))), "95 % interval"


def _looks(predicted: Any, measured: Any, name: str) -> list[tuple[Look, str]]:
    return [(look, words) for side, look, words in
            ((predicted, PREDICTED, "predicted"), (measured, COLLECTED, name)) if side]  # fmt: skip
