"""What every interactive chart of a page is made of: its models, the numbers that fill them, its JSON.

The page has the script that draws them once, from the installed package, without a network.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy.typing as npt

CURVE_COLOURS = ("#0072B2", "#C2410C", "#009E73", "#B4548F", "#5B3A8C", "#B58900")
FIRST_CURVES = 3  # that are seen before a name in the legend is clicked
Labels = tuple[str, str]
LABELS: Labels = ("predicted", "collected")


@dataclass(frozen=True)
class Chart:
    """An interactive chart as the page holds it.

    Attributes
    ----------
    name, section, title, alt : as of a :class:`Drawing`
    content : JSON that the script draws
    subjects : those that a reader may choose among, the one that is shown at first before the others; maybe none
    """

    name: str
    section: str
    title: str
    alt: str
    content: str
    subjects: tuple[str, ...] = ()

    @property
    def summary(self) -> str:
        """The first words of its caption, for the line that unfolds it."""
        return self.title.partition(". ")[0]


def column_text(values: npt.NDArray[Any]) -> str:
    """Little-endian float32 as base64."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")


@dataclass
class ChartFill:
    """What the script sets in the models of a chart, which are drawn without numbers, by their names.

    Attributes
    ----------
    sources : of a source of columns: column -> its place in ``arrays``, which holds each array once
    ranges : start and end of a range
    spans : place of a line
    colours : ends of a scale of colours
    texts : of a source of columns: column -> its texts
    names : of the places 0, 1, ... of an axis
    """

    sources: dict[str, dict[str, int]] = field(default_factory=dict)
    ranges: dict[str, tuple[float, float]] = field(default_factory=dict)
    spans: dict[str, float] = field(default_factory=dict)
    arrays: dict[str, int] = field(default_factory=dict)
    colours: dict[str, tuple[float, float]] = field(default_factory=dict)
    texts: dict[str, dict[str, list[str]]] = field(default_factory=dict)
    names: dict[str, tuple[str, ...]] = field(default_factory=dict)

    def add(self, source: str, columns: Mapping[str, npt.NDArray[Any]]) -> None:
        """Columns of a source."""
        self.sources[source] = {
            name: self.arrays.setdefault(column_text(values), len(self.arrays)) for name, values in columns.items()
        }

    def packed(self) -> dict[str, Any]:
        """As the script reads it."""
        return {
            "sources": self.sources,
            "ranges": self.ranges,
            "spans": self.spans,
            "arrays": list(self.arrays),
            "colours": self.colours,
            "texts": self.texts,
            "names": self.names,
        }


def chart_content(models: str, fill: ChartFill, subjects: Sequence[Mapping[str, Any]] = ()) -> str:
    """The JSON of a chart: its models, and what the script fills them with."""
    rest = json.dumps({"fill": fill.packed(), "subjects": subjects}, separators=(",", ":"), ensure_ascii=False)
    # "<" cannot end the script that holds it.
    return f'{{"item":{models},{rest[1:]}'.replace("<", "\\u003c")


@dataclass(frozen=True)
class Curves:
    """What one tab of curves is built of.

    Attributes
    ----------
    subjects : each with the sides that it has a curve of, 0 the first, 1 the second
    is_counted : whether pixels of a collection bound P_FA from below
    """

    subjects: tuple[tuple[str, tuple[int, ...]], ...]
    is_counted: bool
