"""What a figure of lines, dots, bars or cells shows, stated once: a chart of a page, a figure in print."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from hyperval.report.style import COLLECTED, PREDICTED, shortened

Array = npt.NDArray[np.float64]
COVERAGE = 1.96  # normal quantile of a two-sided 95 % interval
GREY = "#7a7f87"  # legible on white and on dark paper
Dash = Literal["solid", "dashed", "dotted", "dashdot"]
_ACROSS = {"x": ("x", "left", "right"), "y": ("y", "low", "high", "bottom", "top")}


@dataclass(frozen=True)
class Axis:
    """One axis of a plot.

    Attributes
    ----------
    label : what it is called, with the unit
    scale : "log", or "names" where the places 0, 1, ... have names (along y from above)
    names : these
    ends : where it starts and ends; None: as the numbers need
    """

    label: str
    scale: Literal["linear", "log", "names"] = "linear"
    names: tuple[str, ...] = ()
    ends: tuple[float, float] | None = None


@dataclass(frozen=True)
class Mark:
    """One series of a plot.

    Attributes
    ----------
    kind : "line" and "steps" (columns x, y), "area" (x, low, high), "dots" (x, y, maybe size [px]), "bars" (left,
        right, bottom, top), "cells" (x, y, value, which colours it); the columns low and high are the interval of a
        line along y, of dots along ``along``
    columns : these, arrays of one length
    label : its name in the legend
    colour, dash, marker : how it is drawn: a circle, square, tick, or a triangle that points left or right
    hollow : whether the marker has the paper's colour inside
    along : "x" or "y"
    words : what is said of each point
    beside : whether these words stand beside the points
    """

    kind: Literal["line", "steps", "area", "dots", "bars", "cells"]
    columns: Mapping[str, Any]
    label: str = ""
    colour: str = GREY
    dash: Dash = "solid"
    marker: str = ""
    hollow: bool = False
    along: Literal["x", "y"] = "y"
    words: tuple[str, ...] = ()
    beside: bool = False
    alpha: float = 0.2

    @property
    def look(self) -> tuple[Any, ...]:
        """What is drawn, without its numbers."""
        return (
            self.kind, tuple(self.columns), self.label, self.colour, self.dash, self.marker, self.hollow,
            self.along, bool(self.words), self.beside, self.alpha,
        )  # fmt: skip

    @property
    def reach(self) -> float:
        """The value of cells at which their colours end, on either side of 0."""
        values = np.abs(self.columns["value"])
        return max(float(np.nanpercentile(values, 97)) if np.isfinite(values).any() else 0.0, 1e-6)

    @property
    def shades(self) -> list[str]:
        """Colours of the words in cells, legible on these."""
        return ["white" if abs(value) > 0.6 * self.reach else "black" for value in self.columns["value"]]


@dataclass(frozen=True)
class Part:
    """One plot of those that stand above each other over the same x.

    Attributes
    ----------
    y : its axis
    marks : what it holds
    rules : (axis, place) of dotted lines across it
    """

    y: Axis
    marks: tuple[Mark, ...]
    rules: tuple[tuple[Literal["x", "y"], float], ...] = ()


@dataclass(frozen=True)
class SubjectView:
    """The plots of one subject."""

    x: Axis
    parts: tuple[Part, ...]

    def ends(self, part: Part | None = None) -> tuple[float, float]:
        """Ends of the axis of y of a part, or of x: as stated, or with a margin about everything drawn."""
        axis, which = (self.x, "x") if part is None else (part.y, "y")
        if axis.scale == "names":
            return -0.6, len(axis.names) - 0.4
        if axis.ends is not None:
            return axis.ends
        parts = self.parts if part is None else (part,)
        columns = [v for one in parts for mark in one.marks for v in _extent(mark, which)]
        every = np.concatenate([np.empty(0), *(np.ravel(np.asarray(v, float)) for v in columns)])
        every = every[np.isfinite(every) & ((every > 0.0) | (axis.scale != "log"))]
        if not every.size:
            return (0.1, 1.0) if axis.scale == "log" else (0.0, 1.0)
        low, high = float(every.min()), float(every.max())
        if axis.scale == "log":
            return low / 1.4, high * 1.4
        margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
        return low - margin, high + margin


@dataclass(frozen=True)
class Plots:
    """A figure: the plots of each subject, all alike but for their numbers.

    Attributes
    ----------
    name, section, title, alt, legend : as of a :class:`Drawing`
    views : subject -> its plots; one plot that needs no name goes by ""
    """

    name: str
    section: str
    title: str
    alt: str
    views: Mapping[str, SubjectView] = field(default_factory=dict)
    legend: str = ""

    def marks(self) -> Iterator[Mark]:
        """Every mark of every view."""
        for view in self.views.values():
            for part in view.parts:
                yield from part.marks


def rows_axis(names: list[str], length: int = 44) -> Axis:
    """An axis of named rows."""
    return Axis("", "names", tuple(shortened(name, length) for name in names))


def predicted_mark(kind: Any, columns: Mapping[str, Any], label: str = "predicted", **more: Any) -> Mark:
    """A mark in the look of the predicted side."""
    return Mark(kind, columns, label, PREDICTED.colour, "dashed", **({"hollow": True} | more))


def measured_mark(kind: Any, columns: Mapping[str, Any], label: str = "measured", **more: Any) -> Mark:
    """A mark in the look of the collected side."""
    return Mark(kind, columns, label, COLLECTED.colour, **more)


def both_sides(predicted: Any, measured: Any, make: Any) -> tuple[Mark, ...]:
    """Dots of the sides that have any: ``make`` gives columns and words of one side, moved by a part of a row."""
    marks = []
    for own, mark, marker, shift in (
        (predicted, predicted_mark, "circle", -0.14), (measured, measured_mark, "square", 0.14)
    ):  # fmt: skip
        if own:
            columns, words = make(own, shift)
            marks.append(mark("dots", columns, marker=marker, along="x", words=tuple(words)))
    return tuple(marks)


def _extent(mark: Mark, which: str) -> list[Any]:
    """The columns of a mark that reach along an axis."""
    names = set(_ACROSS[which])
    if mark.kind == "dots" and mark.along == "x":  # whose interval lies along x
        names = names | {"low", "high"} if which == "x" else names - {"low", "high"}
    return [values for name, values in mark.columns.items() if name in names]
