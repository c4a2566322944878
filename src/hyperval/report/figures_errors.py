"""Figures of what the spread of pixels does to a user: classes taken for each other, areas found by unmixing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator

from hyperval.products import Abundance, ClassificationError
from hyperval.report import style
from hyperval.report.panels import COVERAGE, GREY, mark_entries, name_rows, of_side
from hyperval.report.sides import Sides
from hyperval.report.style import COLLECTED, PREDICTED, Drawing
from hyperval.results import Result

_MOST_ROWS = 40
_BOUNDS = "#e4e4e4"


def class_error_figures(sides: Sides, *, simulated: bool) -> list[Drawing]:
    """Classification error of every set of classes and features, both sides, with the bounds from distances."""
    predicted, measured = (of_side(side, "classification") for side in sides)
    every = list(dict.fromkeys([*measured, *predicted]))
    keys = every[:_MOST_ROWS]
    if not keys:
        return []
    figure = style.new_figure(10.0, 1.6 + 0.42 * len(keys), "Error of a Gaussian classifier", simulated)
    axes = figure.add_subplot()
    floor = _error_floor([*predicted.values(), *measured.values()])
    for at, key in enumerate(keys):
        model = predicted.get(key)
        if model is not None and model.bound_upper > 0:
            low = max(model.bound_lower, floor)
            axes.barh(at, model.bound_upper - low, left=low, height=0.62, color=_BOUNDS, linewidth=0, zorder=1)
            if model.approximation >= floor:
                axes.plot([model.approximation] * 2, [at - 0.31, at + 0.31], color=GREY, linewidth=1.4, zorder=2)
    for errors, look, shift in ((predicted, PREDICTED, -0.14), (measured, COLLECTED, 0.14)):
        for at, key in enumerate(keys):
            if key in errors:
                _error_dot(axes, errors[key], at + shift, look, floor)
    axes.set_xscale("log")
    axes.set_xlim(floor / 1.4, 1.0)
    style.log_ticks(axes.xaxis)
    name_rows(axes, [f"{style.shortened(classes, 44)}, {features}" for classes, features in keys])
    axes.set_xlabel("probability of error [1] (bar: 95 % interval; arrow: down to none)")
    entries = [
        *mark_entries(),
        (Patch(color=_BOUNDS), "bounds from the predicted distance"),
        (Line2D([], [], color=GREY, marker="|", linestyle="", markersize=9), "estimate from it"),
    ]
    style.add_legend(figure, entries)
    words = "; ".join(
        f"{', '.join(key)}: "
        + ", ".join(
            _error_words(n, h[key]) for n, h in (("predicted", predicted), ("measured", measured)) if key in h
        )
        for key in keys
    )
    title = f"Error of a Gaussian maximum-likelihood classifier{style.left_out([keys], every)}"
    return [style.vector_drawing(figure, "class-error", "classification", title, f"{title}: {words}.")]


def unmixing_figures(sides: Sides, rows: Sequence[Result], *, simulated: bool) -> list[Drawing]:
    """Areas by unmixing against the nominal ones, and the root mean square error by size, by method."""
    predicted, measured = (
        {k: a for k, a in of_side(side, "abundance").items() if a.nominal_m2 is not None} for side in sides
    )
    methods = list(dict.fromkeys(method for _, method in measured))[:4]
    if not methods:
        return []
    figure = style.new_figure(10.0, 1.0 + 2.9 * len(methods), "Target areas by unmixing", simulated)
    words = []
    for at, method in enumerate(methods):
        left = figure.add_subplot(len(methods), 2, 2 * at + 1)
        right = figure.add_subplot(len(methods), 2, 2 * at + 2)
        left.set_title(style.plain(f"{method}: area of each target"), loc="left")
        right.set_title(style.plain(f"{method}: error by size"), loc="left")
        sizes = _area_panel(left, predicted, measured, method)
        words += _rmse_panel(right, rows, method, sizes)
        left.set_ylabel("estimated / nominal area [1]")
        right.set_ylabel("root mean square\nerror [m²]")
        if at == len(methods) - 1:
            left.set_xlabel("nominal area [m²]")
            right.set_xlabel("nominal area [m²]")
    style.add_legend(
        figure,
        [
            *mark_entries(),
            (style.interval_handle(PREDICTED.colour, COLLECTED.colour), "95 % interval"),
            (Line2D([], [], color=GREY, linewidth=0.9), "nominal area"),
        ],
    )
    alt = (
        "Left: area of each target by fully constrained unmixing over its nominal area, predicted and measured "
        "with 95 % intervals, against the nominal area. Right: root mean square error by nominal area. "
        f"{'; '.join(words)}."
    )
    title = "Target areas by unmixing against nominal areas, and their error by size"
    return [style.vector_drawing(figure, "unmixing-areas", "abundance", title, alt)]


def _error_floor(errors: Sequence[ClassificationError]) -> float:
    """Left end of the axis: below every error that was found, and not below a millionth."""
    values = [x for e in errors for x in (e.error, e.lower) if x > 0]
    return max(min([1e-2, *values]) / 2.0, 1e-6)


def _error_words(name: str, e: ClassificationError) -> str:
    return f"{name} {e.error:.2g} ({e.lower:.1g} to {e.upper:.1g})"


def _error_dot(axes: Axes, e: ClassificationError, at: float, look: style.Look, floor: float) -> None:
    low, high = max(e.lower, floor), max(e.upper, floor)
    axes.plot([low, high], [at, at], color=look.colour, linewidth=1.4, zorder=3)
    if e.lower < floor:
        axes.plot([low], [at], color=look.colour, marker="<", markersize=5, linestyle="", zorder=3)
    if e.error >= floor:
        axes.plot([e.error], [at], color=look.colour, marker=look.marker, markerfacecolor=look.face, markersize=5,
                  zorder=4)  # fmt: skip


def _area_panel(
    axes: Axes,
    predicted: Mapping[tuple[str, str], Abundance],
    measured: Mapping[tuple[str, str], Abundance],
    method: str,
) -> list[float]:
    """Ratios of area; the nominal areas that were drawn."""
    groups: dict[float, list[tuple[str, str]]] = {}
    for key, area in measured.items():
        if key[1] == method and area.nominal_m2:
            groups.setdefault(area.nominal_m2, []).append(key)
    axes.axhline(1.0, color=GREY, linewidth=0.9)
    for nominal, keys in groups.items():
        # Side by side within a quarter of a decade, in the order of the targets.
        steps = np.linspace(-0.13, 0.13, len(keys)) if len(keys) > 1 else np.zeros(1)
        for step, key in zip(steps, keys, strict=True):
            for areas, look, shift in ((predicted, PREDICTED, -0.012), (measured, COLLECTED, 0.012)):
                if key not in areas:
                    continue
                a = areas[key]
                axes.errorbar(
                    [nominal * 10 ** (step + shift)], [a.area_m2 / nominal],
                    yerr=[np.nan_to_num(COVERAGE * a.standard_uncertainty / nominal)],
                    fmt=look.marker, color=look.colour, markerfacecolor=look.face, markersize=4, linewidth=1.0,
                )  # fmt: skip
    axes.set_ylim(-0.6, 4.2)
    _size_axis(axes, list(groups))
    return list(groups)


def _rmse_panel(axes: Axes, rows: Sequence[Result], method: str, sizes: Sequence[float]) -> list[str]:
    words = []
    for side, look in (("predicted", PREDICTED), ("observed", COLLECTED)):
        own = [r for r in rows if r.method == method and r.metric == f"area_rmse_{side}"]
        points = sorted((_size_of(r.subject), r.value, r.lower, r.upper) for r in own)
        if not points:
            continue
        x, y, low, high = (np.array(c) for c in zip(*points, strict=True))
        if np.isfinite(low).any():
            axes.fill_between(x, low, high, color=look.colour, alpha=0.2, linewidth=0)
        axes.plot(x, y, color=look.colour, linestyle=look.line, marker=look.marker, markerfacecolor=look.face)
        name = "predicted" if side == "predicted" else "measured"
        words.append(f"{method}, {name}: " + ", ".join(f"{v:.2g} m² at {a:g} m²" for a, v, _, _ in points))
    axes.plot(sorted(sizes), sorted(sizes), color=GREY, linewidth=0.9)
    axes.set_yscale("log")
    style.log_ticks(axes.yaxis)
    _size_axis(axes, sizes)
    return words


def _size_axis(axes: Axes, sizes: Sequence[float]) -> None:
    axes.set_xscale("log")
    ordered = sorted(sizes)
    axes.xaxis.set_major_locator(FixedLocator(ordered))
    axes.xaxis.set_major_formatter(FixedFormatter([f"{s:.3g}" for s in ordered]))
    axes.xaxis.set_minor_locator(NullLocator())
    if ordered:
        axes.set_xlim(ordered[0] / 1.8, ordered[-1] * 1.8)


def _size_of(subject: str) -> float:
    """The area in "all targets of 9 m2"."""
    return float(subject.removesuffix(" m2").rpartition(" ")[2])
