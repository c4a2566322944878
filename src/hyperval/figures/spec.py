"""A figure, stated once: axes with units, marks with intervals.

``charts.js`` draws it in a page from :func:`figure_json`, :mod:`hyperval.figures.print` on paper.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from hyperval.data import Array
from hyperval.errors import package_table
from hyperval.spectra.axis import ABSORPTION_BANDS_NM

# Predicted and measured differ in colour (Okabe and Ito's palette, distinct under the common colour deficiencies), in
# line style and in marker, so that a grey print still tells them apart.
PREDICTED, MEASURED, DIFFERENCE, GREY = "#0072B2", "#C2410C", "#5B3A8C", "#5f646b"
SOURCES = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#777777")
CURVES = ("#0072B2", "#C2410C", "#009E73", "#B4548F", "#5B3A8C", "#B58900")
LOOKS = package_table("figures/looks.yaml")
VIRIDIS = LOOKS["viridis"]
MAX_PANELS = 12
WAVELENGTH = "wavelength [nm]"  # over which the absorption of gases is shaded
Dash = Literal["solid", "dashed", "dotted", "dashdot"]
Way = Literal["x", "y"]
Kind = Literal["svg", "pdf", "png"]
Rules = tuple[tuple[Way, float], ...]
_TONES = 33  # of a scale in a page
_REACH: dict[Way, set[str]] = {"x": {"x", "left", "right"}, "y": {"y", "bottom", "top"}}


@dataclass(frozen=True)
class Axis:
    """One axis.

    Attributes
    ----------
    label : what it is called, with the unit in brackets where it has one
    scale : "log", or "names" where the places 0, 1, ... have names (along y from above)
    names, notes : these; what stands at the other end of each row
    ends : where it starts and ends; None: as the numbers need
    """

    label: str = ""
    scale: Literal["linear", "log", "names"] = "linear"
    names: tuple[str, ...] = ()
    ends: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()

    @classmethod
    def named(cls, names: Sequence[str], length: int = 44) -> Axis:
        """An axis of named rows."""
        return cls("", "names", tuple(shorten(name, length) for name in names))

    @property
    def description(self) -> str:
        """Label and scale in words."""
        return self.label + " (logarithmic)" * (self.scale == "log")

    @property
    def absorption(self) -> list[tuple[float, float]]:
        """Where gases absorb [nm], which is shaded over wavelengths; nowhere on another axis."""
        return [band[:2] for band in ABSORPTION_BANDS_NM if self.label == WAVELENGTH]


@dataclass(frozen=True)
class ColourScale:
    """What the column ``value`` of a mark is as a colour: "signed" about 0, or from light to dark or the reverse."""

    kind: Literal["signed", "rising", "falling"]
    low: float
    high: float
    label: str = ""

    @property
    def palette(self) -> list[str]:
        """Its colours, those of low values first."""
        return list(LOOKS["palettes"][self.kind])


@dataclass(frozen=True)
class Mark:
    """Something drawn.

    Attributes
    ----------
    kind : "line" and "steps" (columns x, y), "area" (x, low, high), "dots" (x, y, maybe size [px]), "bars" and
        "cells" (left, right, bottom, top); the columns low and high, or half on either side of y, are the interval of
        a line along y, of dots along ``along``; the column value is told by the colours of ``scale``
    columns : these, arrays of one length
    label : its name in the legend
    colour, dash, marker : how it is drawn
    hollow : whether the marker has the paper's colour inside
    words, beside : what is said of each point, and at which of its sides it stands; else it is told where the
        pointer rests
    linked : whether points that are chosen here stand out in other marks that are linked
    """

    kind: Literal["line", "steps", "area", "dots", "bars", "cells"]
    columns: Mapping[str, Any]
    label: str = ""
    colour: str = GREY
    dash: Dash = "solid"
    marker: str = ""
    hollow: bool = False
    along: Way = "y"
    words: tuple[str, ...] = ()
    beside: Literal["", "left", "right", "centre"] = ""
    alpha: float = 0.2
    scale: ColourScale | None = None
    linked: bool = False

    @property
    def numbers(self) -> dict[str, Array]:
        """The columns, with low and high where half is given; without both where no uncertainty is stated.

        >>> x = np.array([1.0, 2.0])
        >>> [list(Mark("line", {"x": x, "y": x, "half": half}).numbers) for half in (x, 0.0 * x)]
        [['x', 'y', 'low', 'high'], ['x', 'y']]
        """
        out = {name: np.atleast_1d(np.asarray(values, float)) for name, values in self.columns.items()}
        if "half" in out:
            half = out.pop("half")
            out |= {"low": out["y"] - half, "high": out["y"] + half}
        if self.kind != "area" and "low" in out and not np.any(out["low"] < out["high"]):
            del out["low"], out["high"]
        return out

    def describe_at(self, place: float) -> str:
        """The point nearest to x = ``place``, with its interval, in words."""
        numbers = self.numbers
        i = int(np.argmin(abs(numbers["x"] - place)))
        ends = f" ({numbers['low'][i]:.3g} to {numbers['high'][i]:.3g})" if "low" in numbers else ""
        return f"{self.label}: {numbers['y'][i]:.3g}{ends} at {numbers['x'][i]:.3g}"

    def split(self, kinds: Sequence[Any], looks: Mapping[Any, Mapping[str, Any]]) -> list[Mark]:
        """One mark for each kind of points, each with its own look."""
        marks = []
        for kind, look in looks.items():
            members = [i for i, one in enumerate(kinds) if one == kind]
            if members:
                columns = {name: np.asarray(values)[members] for name, values in self.columns.items()}
                words = tuple(self.words[i] for i in members if self.words)
                marks.append(replace(self, columns=columns, words=words, **look))
        return marks

    @property
    def text_colours(self) -> list[str]:
        """Colours of the words in cells, legible on these."""
        scale = self.scale or ColourScale("rising", 0.0, 1.0)
        part = (np.asarray(self.columns["value"], float) - scale.low) / (scale.high - scale.low)
        dark = {"signed": abs(part - 0.5) > 0.3, "rising": part < 0.45, "falling": part < 0.35}[scale.kind]
        return ["white" if one else "black" for one in np.atleast_1d(dark)]


@dataclass(frozen=True)
class Part:
    """One plot of those that stand above each other.

    Attributes
    ----------
    y : its axis
    marks : what it holds
    rules : (axis, place) of dotted lines across it
    x : its own axis, where it does not share that of the others
    """

    y: Axis
    marks: tuple[Mark, ...]
    rules: Rules = ()
    x: Axis | None = None


@dataclass(frozen=True)
class Panels:
    """The plots of one subject, of one of several tabs where the figure has these.

    Attributes
    ----------
    note : what it rests on
    words : its numbers, for those who cannot see it; without any, what is said of the points of its marks
    reference : x at which the text states the values of its lines
    """

    x: Axis
    parts: tuple[Part, ...]
    subject: str = ""
    tab: str = ""
    note: str = ""
    words: str = ""
    reference: float | None = None

    @property
    def name(self) -> str:
        """Subject and tab."""
        return ", ".join(filter(None, (self.subject, self.tab)))

    @property
    def marks(self) -> list[Mark]:
        """The marks of all its plots."""
        return [mark for part in self.parts for mark in part.marks]

    @property
    def has_interval(self) -> bool:
        """Whether a line has its interval about it."""
        return any(mark.kind in ("line", "steps") and "low" in mark.numbers for mark in self.marks)

    @property
    def description(self) -> str:
        """Name and numbers in words."""
        numbers = [mark.describe_at(self.reference) for mark in self.marks if mark.label and self.reference is not None]
        points = [": ".join(filter(None, (m.label, "; ".join(m.words)))) for m in self.marks if any(m.words)]
        texts = list(filter(None, [*numbers, self.words])) or points
        return ": ".join(filter(None, (self.name, "; ".join(texts))))

    def limits(self, way: Way, part: Part) -> tuple[float, float]:
        """Ends of an axis of a part: as stated, or with a margin about all along it and the rules that lie near."""
        axis = part.y if way == "y" else part.x or self.x
        if axis.scale == "names":
            return -0.6, len(axis.names) - 0.4
        if axis.ends is not None:
            return axis.ends
        parts = self.parts if way == "x" and part.x is None else (part,)
        reach = {along: _REACH[way] | ({"low", "high"} if way == along else set()) for along in _REACH}
        columns = (v for p in parts for m in p.marks for name, v in m.numbers.items() if name in reach[m.along])
        values = np.concatenate([np.empty(0), *columns])
        values = values[np.isfinite(values) & ((values > 0.0) | (axis.scale != "log"))]
        if not values.size:
            return (0.1, 1.0) if axis.scale == "log" else (0.0, 1.0)
        low, high = float(values.min()), float(values.max())
        places = [place for p in parts for along, place in p.rules if along == way]
        if axis.scale == "log":
            near = [place for place in places if low**2 / high <= place <= high**2 / low]
            return min([low, *near]) / 1.4, max([high, *near]) * 1.4
        near = [place for place in places if 2.0 * low - high <= place <= 2.0 * high - low]
        low, high = min([low, *near]), max([high, *near])
        room = 0.12 if way == "x" and any(m.beside in ("left", "right") for p in parts for m in p.marks) else 0.05
        margin = room * (high - low) or 0.05 * abs(high) or 1.0
        return low - margin, high + margin


@dataclass(frozen=True)
class Figure:
    """A figure: the plots of each subject.

    Attributes
    ----------
    name : of its file, and of its place in a page
    section : the product it belongs to
    title : caption
    views : one for each subject; one that needs no name has none
    legend : what a sign stands for, for the caption
    head : what stands above it on paper; the title where this is empty
    legend_title : what the names in the legend are values of
    together : whether subjects may be drawn over each other ("offered"), or are at first ("first")
    width_in : on paper [in]
    """

    name: str
    section: str
    title: str
    views: tuple[Panels, ...] = ()
    legend: str = ""
    head: str = ""
    legend_title: str = ""
    together: Literal["", "offered", "first"] = ""
    width_in: float = 10.0

    @property
    def pages(self) -> list[tuple[Panels, ...]]:
        """Views of each page on paper."""
        return [self.views[i : i + MAX_PANELS] for i in range(0, len(self.views), MAX_PANELS)]

    @property
    def alt(self) -> str:
        """Text for those who cannot see it: title, axes, what is shown, and each view in words."""
        shared = [part for part in self.views[0].parts if part.x is None]
        axes = [" over ".join(filter(None, (part.y.description, self.views[0].x.description))) for part in shared]
        names = dict.fromkeys(mark.label for view in self.views for mark in view.marks)
        texts = ["; ".join(filter(None, each)) for each in (axes, names, (view.description for view in self.views))]
        parts = [f"{what}{words}" for what, words in zip(("Axes: ", "Shown: ", ""), texts, strict=True) if words]
        return f"{'. '.join([self.title, *parts])}."

    @property
    def caption(self) -> str:
        """Title, legend, and what is shaded where neither they nor a label says it."""
        said = " ".join((self.title, self.legend, *(mark.label for view in self.views for mark in view.marks)))
        interval = "95 %" not in said and any(view.has_interval for view in self.views)
        gases = any(view.x.absorption for view in self.views)
        keys = self.legend, "shaded: 95 % interval" * interval, "grey: absorption bands" * gases
        legend = "; ".join(filter(None, keys))
        return self.title + (f". {legend[0].upper()}{legend[1:]}" if legend else "")


@dataclass(frozen=True)
class Drawing:
    """A finished figure as a file.

    Attributes
    ----------
    name : file name without its ending
    section, title, alt, legend : as of a :class:`Figure`
    content, kind : the bytes of the file and their format
    width_px : width at which the text of a PNG has the size of the page's [CSS pixels]; None for SVG
    """

    name: str
    section: str
    title: str
    alt: str
    content: bytes
    kind: Kind
    width_px: int | None = None
    legend: str = ""

    @property
    def file_name(self) -> str:
        """Name of the file in ``figures/``."""
        return f"{self.name}.{self.kind}"


def to_base64(content: bytes) -> str:
    """Bytes as text."""
    return base64.b64encode(content).decode("ascii")


def figure_json(figure: Figure) -> str:
    """The figure as JSON, which the script of a page draws; nothing in it ends the element that holds it.

    Columns are little-endian float32 in base64, each once; what is empty is left out.
    """
    columns: dict[str, int] = {}

    def place(values: Any) -> int:
        text = to_base64(np.atleast_1d(np.asarray(values, "<f4")).tobytes())
        return columns.setdefault(text, len(columns))

    def fields(what: Any, **more: Any) -> dict[str, Any]:
        return {name: value for name, value in {**vars(what), **more}.items() if value}

    def axis(item: Axis, ends: tuple[float, float]) -> dict[str, Any]:
        return fields(item, ends=ends, absorption=bool(item.absorption))

    def mark(item: Mark) -> dict[str, Any]:
        more: dict[str, Any] = {"columns": {name: place(values) for name, values in item.columns.items()}}
        if item.scale is not None:
            more["scale"] = {**vars(item.scale), "palette": palette_colours(item.scale.palette, _TONES)}
            more["shades"] = item.text_colours if item.beside == "centre" else None
        return fields(item, **more)

    views = [
        {"subject": view.subject, "tab": view.tab, "parts": [
            {"x": axis(part.x or view.x, view.limits("x", part)), "y": axis(part.y, view.limits("y", part)),
             "own": part.x is not None, "rules": part.rules, "marks": [mark(one) for one in part.marks]}
            for part in view.parts
        ], "note": ": ".join(filter(None, (view.subject * (len(figure.views) == 1), view.note)))}
        for view in figure.views
    ]  # fmt: skip
    data: dict[str, Any] = {"views": views, "columns": list(columns)}
    data |= {key: getattr(figure, key) for key in ("name", "section", "together", "legend_title")}
    if bands := next((view.x.absorption for view in figure.views if view.x.absorption), None):
        data["absorption"] = bands
    return json.dumps(data, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")


def to_columns(rows: Sequence[Sequence[float]], names: Sequence[str] = ("x", "y", "low", "high")) -> dict[str, Array]:
    """Rows of numbers as columns."""
    return dict(zip(names, np.array(rows, float).reshape(-1, len(names)).T, strict=True))


def predicted_mark(kind: Any, columns: Mapping[str, Any], label: str = "predicted", **more: Any) -> Mark:
    """A mark in the look of the predicted side."""
    return Mark(kind, columns, label, PREDICTED, "dashed", **({"hollow": True} | more))


def measured_mark(kind: Any, columns: Mapping[str, Any], label: str = "measured", **more: Any) -> Mark:
    """A mark in the look of the measured side."""
    return Mark(kind, columns, label, MEASURED, **more)


def single_panel(
    x: Axis, y: Axis, marks: Iterable[Mark], subject: str = "", words: str = "", *, rules: Rules = (), **more: Any
) -> Panels:
    """A view of one plot."""
    return Panels(x, (Part(y, tuple(marks), rules),), subject, words=words, **more)


def palette_colours(palette: Sequence[str], count: int) -> list[str]:
    """Colours at even steps along a palette, interpolated between its own.

    Examples
    --------
    >>> palette_colours(("#000000", "#ffffff"), 3)
    ['#000000', '#808080', '#ffffff']
    """
    colours = np.array([[int(tone[k : k + 2], 16) for k in (1, 3, 5)] for tone in palette], float)
    parts = np.linspace(0.0, len(palette) - 1.0, count)
    mixed = np.stack([np.interp(parts, np.arange(len(palette)), colours[:, i]) for i in range(3)], axis=-1)
    return [f"#{red:02x}{green:02x}{blue:02x}" for red, green, blue in mixed.round().astype(int)]


def shorten(text: str, length: int = 34) -> str:
    """Text for a narrow place, its middle left out when it is too long."""
    if len(text) <= length:
        return text
    head = (length - 1) * 2 // 3
    return f"{text[:head]}…{text[len(text) - (length - 1 - head) :]}"


def omissions(shown: int, every: int, where: str = "products.nc") -> str:
    """Note of a caption on what the figure leaves out; empty when it shows everything."""
    return "" if shown == every else f"; {shown} of {every} shown, all in {where}"


def robust_limits(values: Sequence[Any], trim: float = 0.5) -> tuple[float, float] | None:
    """Limits that hold all but ``trim`` per cent of the values at either end, and 0; None without any."""
    stack = np.concatenate([np.empty(0), *map(np.ravel, values)])
    stack = stack[np.isfinite(stack)]
    if stack.size == 0:
        return None
    low, high = (float(x) for x in np.percentile(stack, [trim, 100.0 - trim]))
    low, high = min(low, 0.0), max(high, 0.0)
    margin = 0.08 * (high - low) or 1.0
    return low - margin * (low < 0.0), high + margin


def compose(kind: str, views: Sequence[Panels], more: str = "", *, name: str = "", **values: Any) -> Figure:
    """A figure in the words of its kind, which ``words.yaml`` has; values fill them, ``more`` ends its caption.

    >>> compose("class-error", [], "; 3 of 4 shown", floor=0.01).legend
    'bar: 95 % interval; an error below 1e-02 is drawn there'
    """
    words = {key: text.format(**values) for key, text in package_table("figures/words.yaml")[kind].items()}
    words["title"] += more
    return Figure(name or kind, views=tuple(views), **words)


def figure_of_views(kind: str, items: Sequence[Any], view: Callable[[Any], Panels], **values: Any) -> Figure | None:
    """A figure with a view for each of the first items; None without any."""
    made = tuple(map(view, items[:MAX_PANELS]))
    return compose(kind, made, omissions(len(made), len(items)), **values) if made else None


def row_figure(
    kind: str, x: Axis, y: Axis, marks: Sequence[Mark], words: str = "", more: str = "", rules: Sequence[float] = (),
    **values: Any,
) -> Figure:  # fmt: skip
    """A figure of one plot, whose rows have names; ``rules``: places of dotted lines along x."""
    view = single_panel(x, y, marks, words=words, rules=tuple(("x", place) for place in rules))
    return compose(kind, [view], more, **values)
