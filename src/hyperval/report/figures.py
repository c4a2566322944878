"""Every figure of a finished run for print: what its page has as charts.

What figures of both sides share: grids of panels, rows that are named, legends.

Figures of spectra: radiance, reflectance and SNR over wavelength.

Figures of ROC curves.

Stated plots drawn by matplotlib, for print: a panel for each subject.

Figures of a finished run, drawn again for print from ``products.nc``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from hyperval.errors import UsageError
from hyperval.processing.roc_model import detection_at
from hyperval.products import SPECTRA, ObservedProducts, PredictedProducts, RocCurve
from hyperval.report import style
from hyperval.report.charts import (
    SPECTRA_WORDS,
    Spectra,
    curve_data,
    in_windows,
    lowest_pfa,
    subject_spectra,
    wavelength_ends,
)
from hyperval.report.plots import GREY, Axis, Mark, Part, Plots, SubjectView, measured_mark, predicted_mark
from hyperval.report.plots_run import equivalence_margin, every_plot
from hyperval.report.run import EigenvalueSpectrum, Sides, TailCurve, best_counted, both_first, drawn_of
from hyperval.report.style import Drawing, Print, house_style
from hyperval.results import ResultTable
from hyperval.run import Run, is_run, is_simulated, read_pair
from hyperval.storage import whole_folder

Entries = list[tuple[Any, str]]


def small_multiples(
    title: str,
    count: int,
    labels: tuple[str, ...],
    simulated: bool,
    *,
    row_in: float,
) -> tuple[Figure, list[list[Axes]]]:
    """A figure with ``count`` panels, named at the left and at the foot alone.

    Parameters
    ----------
    labels : of x, of y, and of y of the lower part where a panel has two
    row_in : height of a row [in]

    Returns
    -------
    The figure, and the parts of each panel from above.
    """
    columns = style.column_count(count)
    rows, parts = math.ceil(count / columns), len(labels) - 1
    figure = style.new_figure(10.0, 1.0 + row_in * rows, title, simulated)
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


def spectra_plots(sides: Sides, product: str) -> list[Plots]:
    """Both sides over wavelength with their difference below, a subject each; ``product`` names a field of Products."""
    label, title, ratio = SPECTRA_WORDS[product]
    predicted, measured, drawn, paired = drawn_of(sides, product)
    if not paired and None not in sides:
        return []  # a comparison that has none of this product
    pages, plots, every = style.pages(drawn), [], both_first(predicted, measured)
    axis = next(side.axis for side in sides if side is not None)
    x = Axis(style.band_label(axis), ends=wavelength_ends(axis.centre_nm))
    for number, subjects in enumerate(pages, start=1):
        own = {s: subject_spectra(sides, predicted.get(s), measured.get(s), ratio=ratio) for s in subjects}
        gaps = {s: one.bands["difference"][0][in_windows(axis)] for s, one in own.items() if "difference" in one.bands}
        medians = [
            f"{s} {np.nanmedian(np.abs(gap)):{'.2%' if ratio else '.4f'}}"
            for s, gap in gaps.items()
            if np.isfinite(gap).any()
        ]
        alt = f"{title} against {x.label} for {', '.join(subjects)}: predicted (dashed) and measured (solid) with 95 % "
        alt += "intervals."
        if medians:
            alt += f" Below each, predicted minus measured{' over measured' if ratio else ''}."
            alt += f" Median absolute difference in the windows: {'; '.join(medians)}."
        plots.append(Plots(
            f"{product}-pair" if len(pages) == 1 else f"{product}-pair-{number}", product,
            f"{title}: predicted and measured{style.left_out(pages, every)}", alt,
            {subject: _spectra_view(x, label, spectra, ratio) for subject, spectra in own.items()},
        ))  # fmt: skip
    return plots


def _spectra_view(x: Axis, label: str, spectra: Spectra, ratio: bool) -> SubjectView:
    def line(name: str) -> dict[str, Any]:
        value, half = spectra.bands[name]
        return {"x": spectra.nm, "y": value, "low": value - half, "high": value + half}

    marks = {"collected": measured_mark, "predicted": predicted_mark}  # dashes on top, so that neither hides the other
    level = tuple(make("line", line(name)) for name, make in marks.items() if name in spectra.bands)
    parts = [Part(Axis(label, ends=spectra.ranges.get("level")), level)]
    if "difference" in spectra.bands:
        gap = Mark("line", line("difference"), "difference", style.DIFFERENCE_COLOUR)
        below = Axis(f"difference{' ratio' if ratio else ''}", ends=spectra.ranges.get("gap"))
        parts.append(Part(below, (gap,), (("y", 0.0),)))
    return SubjectView(x, tuple(parts))


def roc_plots(sides: Sides) -> list[Plots]:
    """P_D against P_FA on a logarithmic axis, a plot for each subject, detector and unit."""
    predicted, measured, drawn, _ = drawn_of(sides, "roc")
    every = both_first(predicted, measured)
    dotted = " (dotted: 1 / background pixels)" if any(c.n_background for c in measured.values()) else ""
    pages, plots = style.pages(best_counted(drawn, measured, 2 * style.MAX_PANELS)), []
    for number, keys in enumerate(pages, start=1):
        low = lowest_pfa([curves[key] for curves in (predicted, measured) for key in keys if key in curves], measured)
        views = {_roc_title(k, measured.get(k)): _roc_view(predicted.get(k), measured.get(k), low) for k in keys}
        words = " ".join(_roc_words(key, predicted.get(key), measured.get(key)) for key in keys)
        plots.append(Plots(
            "roc" if len(pages) == 1 else f"roc-{number}", "roc",
            f"ROC: predicted and measured{dotted}{style.left_out(pages, every)}",
            "Probability of detection against probability of false alarm (logarithmic), predicted (dashed) and "
            f"measured (steps), with 95 % intervals. {words}",
            views,
        ))  # fmt: skip
    return plots


def _roc_view(predicted: RocCurve | None, measured: RocCurve | None, low: float) -> SubjectView:
    marks = [
        make(kind, {{"pfa": "x", "pd": "y"}.get(name, name): values for name, values in curve_data(curve, low).items()})
        for make, kind, curve in ((predicted_mark, "line", predicted), (measured_mark, "steps", measured))
        if curve is not None
    ]
    counted = measured.n_background if measured is not None else None
    part = Part(Axis("P_D", ends=(-0.02, 1.04)), tuple(marks), (("x", 1.0 / counted),) if counted else ())
    return SubjectView(Axis("P_FA per pixel", "log", ends=(low, 1.0)), (part,))


def _roc_title(key: tuple[str, str, str], curve: RocCurve | None) -> str:
    """Names of a curve, and below them what it rests on."""
    parts = []
    if curve is not None and curve.n_target is not None:
        parts.append(f"{curve.n_target:,} {curve.unit}{'s' if curve.n_target != 1 else ''}")
    if curve is not None and curve.n_background is not None:
        parts.append(f"{curve.n_background:,} background px")
    below = "not measured" if curve is None else ", ".join(p.replace(",", "\u202f") for p in parts) or "counts unknown"
    return f"{key[0]}, {key[1]}, by {key[2]}\n{below}"


def _roc_words(key: tuple[str, str, str], predicted: RocCurve | None, measured: RocCurve | None) -> str:
    words = []
    for name, curve in (("predicted", predicted), ("measured", measured)):
        if curve is not None and curve.pfa.size:
            at = float(np.clip(1e-3, curve.pfa[0], curve.pfa[-1]))
            pd, low, high = (detection_at(curve, at, y) for y in (curve.pd, curve.pd_lower, curve.pd_upper))
            words.append(f"{name} P_D {pd:.2f} ({low:.2f} to {high:.2f}) at P_FA {at:.1e}")
    return f"{', '.join(key)}: {'; '.join(words) or 'no points'}."


_LINES: dict[str, Any] = {"solid": "-", "dashed": "--", "dotted": ":", "dashdot": "-."}
_MARKERS = {"circle": "o", "square": "s", "tick": "|", "left": "<", "right": ">", "": ""}
_ROW_IN = 0.3  # [in] of a named row


def drawing_of(plots: Plots, *, simulated: bool) -> Drawing:
    """The figure of plots, of at most so many subjects as have room."""
    views = dict(list(plots.views.items())[: style.MAX_PANELS])
    first = next(iter(views.values()))
    rows = len(first.parts[0].y.names)
    row_in = (
        (0.5 + _ROW_IN * rows + (1.0 if first.x.scale == "names" else 0.0)) if rows else 1.3 + 1.2 * len(first.parts)
    )
    labels = (first.x.label, *(part.y.label.replace(" [", "\n[") for part in first.parts))
    figure, panels = small_multiples(plots.title, len(views), labels, simulated, row_in=row_in)
    for (subject, view), panel in zip(views.items(), panels, strict=True):
        if subject:
            name = "\n".join(style.plain(style.shortened(line, 44)) for line in subject.splitlines())
            panel[0].set_title(name, loc="left")
        for axes, part in zip(panel, view.parts, strict=True):
            _draw(figure, axes, view, part)
    entries: Entries = []
    for mark in plots.marks():
        if mark.label and mark.label not in (words for _, words in entries):
            entries.append((_handle(mark), mark.label))
    if any(mark.kind in ("line", "steps") and "low" in mark.columns for mark in plots.marks()):
        entries.append((Patch(color=GREY, alpha=0.3, linewidth=0), "95 % interval"))
    if first.x.label == style.WAVELENGTH_LABEL:
        entries.append((Patch(color=style.ABSORPTION_COLOUR), "absorption band"))
    if entries:
        style.add_legend(figure, entries, columns=4)
    title = plots.title + style.left_out([list(views)], list(plots.views))
    return style.vector_drawing(figure, plots.name, plots.section, title, plots.alt, plots.legend)


def _draw(figure: Any, axes: Axes, view: SubjectView, part: Part) -> None:
    for which, axis, ends in (("x", view.x, view.ends()), ("y", part.y, view.ends(part))):
        _scale(axes, which, axis, ends)
    if view.x.label == style.WAVELENGTH_LABEL:
        style.shade_absorption(axes, *view.ends())
    for mark in part.marks:
        _mark(figure, axes, mark)
    for which, place in part.rules:
        (axes.axvline if which == "x" else axes.axhline)(place, color=GREY, linewidth=0.9, linestyle=":")


def _scale(axes: Axes, which: str, axis: Axis, ends: tuple[float, float]) -> None:
    if axis.scale == "names" and which == "y":
        axes.set_yticks(range(len(axis.names)), [style.plain(name) for name in axis.names])
        axes.set_ylim(len(axis.names) - 0.5, -0.5)
        axes.grid(visible=False, axis="y")
        return
    if axis.scale == "names":
        axes.set_xticks(range(len(axis.names)), [style.plain(n) for n in axis.names], rotation=35, ha="right")
        axes.grid(visible=False, axis="x")
    if axis.scale == "log":
        (axes.set_xscale if which == "x" else axes.set_yscale)("log")
        style.log_ticks(axes.xaxis if which == "x" else axes.yaxis)
    elif which == "x" and not axis.names:
        axes.xaxis.set_major_locator(MaxNLocator(5))
    (axes.set_xlim if which == "x" else axes.set_ylim)(*ends)


def _mark(figure: Any, axes: Axes, mark: Mark) -> None:
    columns: dict[str, Any] = {name: np.atleast_1d(np.asarray(v, float)) for name, v in mark.columns.items()}
    low, high, x, y = (columns.get(name, np.empty(0)) for name in ("low", "high", "x", "y"))
    interval, colour = "low" in columns, mark.colour
    steps: Any = {"step": "post"} if mark.kind == "steps" else {}
    if mark.kind in ("line", "steps", "area") and interval:
        axes.fill_between(x, low, high, color=colour, alpha=mark.alpha, linewidth=0, **steps)
    elif interval:
        (axes.hlines if mark.along == "x" else axes.vlines)(
            y if mark.along == "x" else x, low, high, color=colour, linewidth=1.3
        )
    if mark.kind in ("line", "steps"):
        axes.plot(x, y, color=colour, linestyle=_LINES[mark.dash], linewidth=1.2,
                  drawstyle="steps-post" if steps else "default")  # fmt: skip
    if mark.marker:
        face = "none" if mark.hollow else colour
        size = columns.get("size", np.full(x.shape, 9.0 if mark.marker == "tick" else 5.0))
        fill: Any = {"facecolors": face, "edgecolors": colour} if mark.marker != "tick" else {"color": colour}
        axes.scatter(x, y, s=np.square(size), marker=_MARKERS[mark.marker], zorder=3, **fill)
    if mark.kind == "bars":
        left, bottom = columns["left"], columns["bottom"]
        axes.bar(left, columns["top"] - bottom, columns["right"] - left, bottom, align="edge", color=colour,
                 alpha=mark.alpha, linewidth=0)  # fmt: skip
        x, y = columns["right"], 0.5 * (bottom + columns["top"])
    if mark.kind == "cells":
        _cells(figure, axes, columns, mark.reach)
    if mark.beside:
        centred = mark.kind == "cells"
        look: Any = {"xytext": (0, 0), "ha": "center"} if centred else {"xytext": (9 if "size" in columns else 5, 0)}
        shades = mark.shades if centred else ["black"] * len(mark.words)
        for a, b, words, shade in zip(x, y, mark.words, shades, strict=True):
            text = style.plain(words)
            axes.annotate(text, (a, b), textcoords="offset points", va="center", fontsize=7.0, color=shade, **look)


def _cells(figure: Any, axes: Axes, columns: dict[str, Any], size: float) -> None:
    x, y, value = columns["x"].astype(int), columns["y"].astype(int), columns["value"]
    grid = np.full((y.max() + 1, x.max() + 1), np.nan)
    grid[y, x] = value
    norm = TwoSlopeNorm(0.0, -size, size)
    image = axes.imshow(grid, cmap=matplotlib.colormaps["PuOr"], norm=norm, aspect="auto")
    axes.grid(visible=False)
    figure.colorbar(image, ax=axes, label="change per unit [1]", shrink=0.8, extend="both")


def _handle(mark: Mark) -> Any:
    if mark.kind in ("bars", "area"):
        return Patch(color=mark.colour, alpha=mark.alpha)
    line: Any = _LINES[mark.dash] if mark.kind in ("line", "steps") else ""
    return Line2D([], [], color=mark.colour, linestyle=line, marker=_MARKERS[mark.marker] or None, markersize=5,
                  markerfacecolor="none" if mark.hollow else mark.colour)  # fmt: skip


Spread = tuple[Mapping[tuple[str, str], EigenvalueSpectrum], Mapping[str, TailCurve]]
Curves = Callable[[PredictedProducts, ObservedProducts], Spread]


def figures_to_folder(run: Path, output: Path, print_as: Print, curves: Curves | None = None) -> int:
    """Draw what the products of ``run`` allow into a new folder, with the spread of its pixels by ``curves``.

    Raises
    ------
    InputError : no products.nc, or a damaged one.
    UsageError : products of which nothing can be drawn.
    """
    drawings = drawings_of(run, print_as, curves)
    if not drawings:
        raise UsageError("there is nothing to draw", where=str(run), expected="spectra or ROC curves in products.nc")
    with whole_folder(output) as folder:
        for drawing in drawings:
            (folder / drawing.file_name).write_bytes(drawing.content)
    return 0


def drawings_of(run: Path, print_as: Print, curves: Curves | None = None) -> list[Drawing]:
    """The figures of the products of a folder, and of the reasons that its table holds."""
    sides, simulated = read_pair(run), is_simulated(run)
    known = Run.open(run) if is_run(run) else Run(ResultTable())
    table, margin = known.table, equivalence_margin(known.provenance) if known.provenance else None
    predicted, observed = sides
    spread = curves(predicted, observed) if curves and predicted and observed else ({}, {})
    spectra = [plots for product in SPECTRA for plots in spectra_plots(sides, product)]
    plots = [*spectra, *roc_plots(sides), *every_plot(sides, table, *spread, margin)]
    with house_style(print_as):
        drawings = [drawing_of(one, simulated=simulated) for one in plots]
    return [replace(drawing, kind=print_as.format) for drawing in drawings]
