"""Every figure of a finished run for print: what its page has as charts.

What figures of both sides share: grids of panels, rows that are named, legends.

Figures of spectra: radiance, reflectance and SNR over wavelength.

Figures of ROC curves.

Stated plots drawn by matplotlib, for print: a panel for each subject.

Figures of a finished run, drawn again for print from ``products.nc``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from hyperval.errors import UsageError
from hyperval.processing.roc_model import detection_at
from hyperval.products import SPECTRA, ObservedProducts, PredictedProducts, RocCurve, SpectralEstimate
from hyperval.report import style
from hyperval.report.netcdf import read_products
from hyperval.report.plots import GREY, Axis, Mark, Part, Plots, SubjectView
from hyperval.report.plots_run import equivalence_margin, every_plot
from hyperval.report.run import EigenvalueSpectrum, Sides, TailCurve, best_counted, both_first, difference, of_side
from hyperval.report.stored import read_results
from hyperval.report.style import COLLECTED, PREDICTED, Drawing, Look, Print, house_style
from hyperval.results import ResultTable
from hyperval.spectra.axis import in_window
from hyperval.storage import whole_folder

if TYPE_CHECKING:
    pass

COVERAGE = 1.96  # normal quantile of a two-sided 95 % interval
TEXT_GREY = "#444444"
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


Array = npt.NDArray[np.float64]


def pair_figures(sides: Sides, product: str, *, simulated: bool) -> list[Drawing]:
    """Overlay of both sides with, below each, their difference; ``product`` names a field of Products."""
    label, title, ratio = {
        "radiance": (style.RADIANCE_LABEL, "Radiance at the sensor", True),
        "reflectance": ("reflectance [1]", "Reflectance", False),
        "toa_reflectance": ("reflectance [1]", "Reflectance at the top of the atmosphere", True),
        "snr": ("signal-to-noise\nratio [1]", "Signal-to-noise ratio", True),
    }[product]
    predicted, collected = of_side(sides[0], product), of_side(sides[1], product)
    drawings = []
    every = both_first(predicted, collected)
    # Where anything can be compared, what only one side holds is left to products.nc.
    pairs = [subject for subject in every if subject in predicted and subject in collected]
    if not pairs and None not in sides:
        return []  # a comparison that has none of this product
    paired = bool(pairs)
    pages = style.pages(pairs or every)
    for number, subjects in enumerate(pages, start=1):
        axis = next(side.axis for side in sides if side is not None)
        below_label = "difference\nratio [1]" if ratio else "difference\n[1]"
        labels = (style.band_label(axis), label, *((below_label,) if paired else ()))
        figure, panels = small_multiples(
            title, len(subjects), labels, simulated, row_in=3.1 if paired else 2.3, more_in=0.9
        )
        medians = []
        for subject, (top, *below) in zip(subjects, panels, strict=True):
            top.set_title(style.plain(style.shortened(subject, 44)), loc="left")
            _overlay(top, sides, predicted.get(subject), collected.get(subject))
            if below:
                median = _difference(below[0], sides, predicted.get(subject), collected.get(subject), ratio)
                if median is not None:
                    medians.append(f"{subject} {median:.2%}" if ratio else f"{subject} {median:.4f}")
        figure.align_ylabels()
        style.add_legend(figure, _legend(predicted, collected, difference=paired, absorption=not axis.numbered))
        alt = (
            f"{title} against {style.band_label(axis)} for {', '.join(subjects)}: predicted (dashed) and "
            "collected (solid) with 95 % intervals"
            + (f"; below each, predicted minus collected{' over collected' if ratio else ''}." if paired else ".")
        )
        if medians:
            alt += f" Median absolute difference in the windows: {'; '.join(medians)}."
        name = f"{product}-pair" if len(pages) == 1 else f"{product}-pair-{number}"
        caption = f"{title}: predicted and collected{style.left_out(pages, every)}"
        drawings.append(style.vector_drawing(figure, name, product, caption, alt))
    return drawings


def _overlay(axes: Axes, sides: Sides, predicted: SpectralEstimate | None, collected: SpectralEstimate | None) -> None:
    inside: list[Array] = []
    w = np.empty(0)
    for side, estimate, look in ((sides[0], predicted, PREDICTED), (sides[1], collected, COLLECTED)):
        if side is None or estimate is None:
            continue
        w = side.axis.centre_nm
        half = COVERAGE * estimate.standard_uncertainty
        axes.fill_between(w, estimate.mean - half, estimate.mean + half, color=look.colour, alpha=0.2, linewidth=0)
        # Dashes on top of the solid line, so that neither hides the other where they agree.
        axes.plot(w, estimate.mean, color=look.colour, linestyle=look.line, zorder=3 if look is PREDICTED else 2)
        keep = _keep(w)
        inside += [estimate.mean[keep], (estimate.mean - half)[keep], (estimate.mean + half)[keep]]
    _wavelength_axis(axes, w, style.robust_limits(inside, zero=True))


def _difference(
    axes: Axes,
    sides: Sides,
    predicted: SpectralEstimate | None,
    collected: SpectralEstimate | None,
    ratio: bool,
) -> float | None:
    """Draw the difference; its median absolute value in the windows, None when there is none."""
    axes.axhline(0.0, color="#444444", linewidth=0.8)
    if predicted is None or collected is None or sides[0] is None or sides[1] is None:
        return None
    w = sides[0].axis.centre_nm
    if not sides[0].axis.matches(sides[1].axis):
        axes.text(0.5, 0.6, "the two sides have different bands", ha="center", transform=axes.transAxes)
        return None
    value, u = difference(predicted, collected, ratio)
    half = COVERAGE * u
    axes.fill_between(w, value - half, value + half, color=style.DIFFERENCE_COLOUR, alpha=0.25, linewidth=0)
    axes.plot(w, value, color=style.DIFFERENCE_COLOUR, linewidth=1.2)
    keep = _keep(w)
    _wavelength_axis(
        axes, w, style.robust_limits([value[keep], (value - half)[keep], (value + half)[keep]], zero=True, trim=3.0)
    )
    inside = np.abs(value[keep])
    inside = inside[np.isfinite(inside)]
    return float(np.median(inside)) if inside.size else None


def _wavelength_axis(axes: Axes, w: Array, limits: tuple[float, float] | None) -> None:
    if w.size:
        low, high = float(w[0]), float(w[-1])
        style.shade_absorption(axes, low, high)
        axes.set_xlim(low, high if high > low else low + 1.0)
    if limits is not None:
        axes.set_ylim(*limits)


def _keep(w: Array) -> npt.NDArray[np.bool_]:
    keep = in_window(w)
    return keep if keep.any() else np.ones(w.shape, bool)


def _legend(
    predicted: Mapping[Any, Any], collected: Mapping[Any, Any], *, difference: bool, absorption: bool
) -> Entries:
    entries = line_entries(predicted, collected, "collected")
    patches, words = interval_entry(predicted, collected)
    if difference:
        entries.append((Line2D([], [], color=style.DIFFERENCE_COLOUR), "difference"))
        patches += style.interval_handle(style.DIFFERENCE_COLOUR)
    entries.append((patches, words))
    if absorption:
        entries.append((Patch(color=style.ABSORPTION_COLOUR), "absorption band"))
    return entries


_MOST_ROWS = 30
_LOWEST_PFA = 1e-9
_MOST_CURVES = 2 * style.MAX_PANELS
_Key = tuple[str, str]
_Estimates = Mapping[Any, Any]
_Dot = tuple[float, float]


def roc_figures(sides: Sides, *, simulated: bool) -> list[Drawing]:
    """P_D against P_FA on a logarithmic axis, a panel for each subject, detector and unit."""
    predicted, measured = of_side(sides[0], "roc"), of_side(sides[1], "roc")
    every = both_first(predicted, measured)
    # Where anything can be compared, what only one side holds is left to products.nc.
    pairs = [key for key in every if key in predicted and key in measured]
    pages = style.pages(best_counted(pairs or every, measured, _MOST_CURVES))
    drawings = []
    for number, keys in enumerate(pages, start=1):
        labels = ("$P_{FA}$ per pixel [1]", "$P_D$ [1]")
        figure, panels = small_multiples("Detection against false alarms", len(keys), labels, simulated, row_in=2.7)
        words = []
        low = _lowest_pfa([h[k] for h in (predicted, measured) for k in keys if k in h])
        for key, (axes,) in zip(keys, panels, strict=True):
            _roc_panel(axes, predicted.get(key), measured.get(key), low)
            axes.set_title(style.plain(_roc_title(key)) + "\n" + _counted(measured.get(key)), loc="left", fontsize=8.5)
            words.append(_roc_words(key, predicted.get(key), measured.get(key)))
        style.add_legend(figure, _roc_legend(predicted, measured))
        name = "roc" if len(pages) == 1 else f"roc-{number}"
        alt = (
            "Probability of detection against probability of false alarm (logarithmic), predicted (dashed) and "
            f"measured (steps), with 95 % intervals. {' '.join(words)}"
        )
        title = f"ROC: predicted and measured{style.left_out(pages, every)}"
        drawings.append(style.vector_drawing(figure, name, "roc", title, alt))
    return drawings


def _roc_panel(axes: Axes, predicted: RocCurve | None, measured: RocCurve | None, low: float) -> None:
    if predicted is not None:
        keep = predicted.pfa > 0
        x = predicted.pfa[keep]
        axes.fill_between(
            x, predicted.pd_lower[keep], predicted.pd_upper[keep], color=PREDICTED.colour, alpha=0.2, linewidth=0
        )
        axes.plot(x, predicted.pd[keep], color=PREDICTED.colour, linestyle=PREDICTED.line)
    if measured is not None:
        keep = measured.pfa > 0
        x = measured.pfa[keep]
        axes.fill_between(
            x, measured.pd_lower[keep], measured.pd_upper[keep],
            step="post", color=COLLECTED.colour, alpha=0.2, linewidth=0,
        )  # fmt: skip
        axes.plot(x, measured.pd[keep], color=COLLECTED.colour, linestyle=COLLECTED.line, drawstyle="steps-post")
        if measured.n_background:
            axes.axvline(1.0 / measured.n_background, color=TEXT_GREY, linewidth=1.0, linestyle=":")
    axes.set_xscale("log")
    axes.set_xlim(low, 1.0)
    axes.set_ylim(-0.02, 1.04)
    style.log_ticks(axes.xaxis)


def _lowest_pfa(curves: list[RocCurve]) -> float:
    """A decade below which no panel of the figure has anything to show."""
    lowest = [float(c.pfa[c.pfa > 0].min()) for c in curves if (c.pfa > 0).any()]
    limits = [0.3 / c.n_background for c in curves if c.n_background]
    # Where something was measured, two decades past what the background can resolve is enough.
    floor = min(limits) / 100 if limits else _LOWEST_PFA
    return max(min([*lowest, *limits], default=1e-3), floor, _LOWEST_PFA)


def _counted(curve: RocCurve | None) -> str:
    """What a measured curve rests on, in a line; empty for no curve."""
    if curve is None:
        return "not measured"
    parts = []
    if curve.n_target is not None:
        parts.append(f"{curve.n_target:,} {curve.unit}{'s' if curve.n_target != 1 else ''}")
    if curve.n_background is not None:
        parts.append(f"{curve.n_background:,} background px")
    return ", ".join(part.replace(",", "\u202f") for part in parts) or "counts unknown"


def _roc_title(key: tuple[str, str, str]) -> str:
    subject, detector, unit = key
    return f"{style.shortened(subject, 24)}, {style.shortened(detector, 12)}, by {unit}"


def _roc_words(key: tuple[str, str, str], predicted: RocCurve | None, measured: RocCurve | None) -> str:
    words = []
    for name, curve in (("predicted", predicted), ("measured", measured)):
        if curve is not None and curve.pfa.size:
            at = float(np.clip(1e-3, curve.pfa[0], curve.pfa[-1]))
            pd, low, high = (detection_at(curve, at, y) for y in (curve.pd, curve.pd_lower, curve.pd_upper))
            words.append(f"{name} P_D {pd:.2f} ({low:.2f} to {high:.2f}) at P_FA {at:.1e}")
    return f"{', '.join(key)}: {'; '.join(words) or 'no points'}."


def _roc_legend(predicted: Mapping[Any, Any], measured: Mapping[Any, RocCurve]) -> Entries:
    entries = [*line_entries(predicted, measured), interval_entry(predicted, measured)]
    if any(curve.n_background for curve in measured.values()):
        entries.append((Line2D([], [], color=TEXT_GREY, linestyle=":"), "resolution: 1 / background pixels"))
    return entries


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
            panel[0].set_title(style.plain(style.shortened(subject, 44)), loc="left")
        for axes, part in zip(panel, view.parts, strict=True):
            _draw(figure, axes, view, part)
    entries: Entries = []
    for mark in plots.marks():
        if mark.label and mark.label not in (words for _, words in entries):
            entries.append((_handle(mark), mark.label))
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
        name_rows(axes, axis.names)
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


def print_figures(sides: Sides, plots: Sequence[Plots], *, simulated: bool, print_as: Print) -> list[Drawing]:
    """Spectra and ROC curves, and every stated plot."""
    with house_style(print_as):
        drawings: list[Drawing] = []
        for product in SPECTRA:
            drawings += pair_figures(sides, product, simulated=simulated)
        drawings += roc_figures(sides, simulated=simulated)
        drawings += [drawing_of(one, simulated=simulated) for one in plots]
    return [replace(drawing, kind=print_as.format) for drawing in drawings]


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
    import xarray as xr

    path, rows, record = (Path(run) / name for name in ("products.nc", "results.json", "provenance.json"))
    sides = read_products(path)
    with xr.open_dataset(path, engine="h5netcdf") as head:
        simulated = head.attrs.get("simulated") == "yes"
    table = read_results(rows) if rows.is_file() else ResultTable()
    margin = equivalence_margin(json.loads(record.read_bytes())) if record.is_file() else None
    predicted, observed = sides
    spread = curves(predicted, observed) if curves and predicted and observed else ({}, {})
    plots = every_plot(sides, table, *spread, margin)
    return print_figures(sides, plots, simulated=simulated, print_as=print_as)
