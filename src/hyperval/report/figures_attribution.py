"""Figures of the reasons: which input explains the residuals, sensitivities, what-ifs before and after."""

from __future__ import annotations

import math
from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.colors import TwoSlopeNorm
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from hyperval.report import style
from hyperval.report.style import Drawing
from hyperval.results import Result, ResultTable

_MOST_INPUTS = 14
_MOST_GROUPS = 26
_MOST_QUANTITIES = 26
_CLOSER, _FARTHER = "<", ">"  # told apart without colour
_STATED, _UNSTATED = "#0072B2", "#E69F00"
_ALL = "all"
_LONGEST = 40  # characters of an input's name
# Twice a log-likelihood of 10.8 has one chance in a thousand by luck, for one direction.
_TELLING = 10.8


def attribution_figures(table: ResultTable, *, simulated: bool) -> list[Drawing]:
    """Bars of all residuals together, a matrix of single subjects, effects of inputs, what-ifs."""
    drawings = []
    gains = [r for r in table.where(product="attribution") if r.metric == "likelihood_gain"]
    whole = sorted((r for r in gains if r.subject == _ALL), key=lambda r: -r.value)
    if whole:
        drawings.append(_bars(whole[:_MOST_INPUTS], table, simulated))
    single = [r for r in gains if r.subject != _ALL]
    if single:
        drawings += [d for d in (_by_subject(single, simulated),) if d is not None]
    moves = [r for r in table.where(product="sensitivity") if r.metric.endswith("_change")]
    if moves:
        drawings.append(_effects(moves, simulated))
    outcomes = [r for r in table.where(product="what-if") if r.metric == "reduced_chi_square"]
    if outcomes:
        drawings.append(_what_ifs(outcomes, simulated))
    return drawings


def _bars(rows: Sequence[Result], table: ResultTable, simulated: bool) -> Drawing:
    title = "Which input, were it less well known, would explain the differences"
    figure = style.new_figure(10.0, 1.3 + 0.32 * len(rows), title, simulated)
    axes = figure.add_subplot()
    stated = _stated(table)
    names = [r.method for r in rows]
    colours = [_STATED if n in stated else _UNSTATED for n in names]
    at = np.arange(len(rows))[::-1]
    values = np.array([max(r.value, 0.1) for r in rows])
    axes.barh(at, values, color=colours, height=0.7)
    for y, r in zip(at, rows, strict=True):
        if r.value < 1.0:
            continue  # it explains nothing, however far it moves
        words = r.reason.partition("; ")[0].partition(": ")[2]
        axes.annotate(
            style.plain(words).replace("-", "−"), (max(r.value, 0.1), y), xytext=(4, 0), textcoords="offset points",
            va="center", fontsize=7.5, bbox={"facecolor": "white", "linewidth": 0, "pad": 0.8},
        )  # fmt: skip
    axes.set_yticks(at, [style.plain(style.shortened(n, 40)) for n in names])
    axes.set_xscale("log")
    axes.set_xlim(0.1, max(float(values.max()) * 30.0, 30.0))
    style.log_ticks(axes.xaxis)
    axes.axvline(_TELLING, color="#333333", linestyle=":", linewidth=1.0)
    axes.set_xlabel("likelihood gained, 2 Δ ln L [1]; dotted: one chance in a thousand by luck")
    axes.grid(visible=False, axis="y")
    style.add_legend(
        figure, [(Patch(color=_STATED), "uncertainty stated"), (Patch(color=_UNSTATED), "none stated: usual step")]
    )
    best = rows[0]
    alt = f"Bars of the likelihood gained by freeing each input, all residuals together: {best.method} gains most"
    alt += f" ({best.value:.3g}); then " + ", ".join(f"{r.method} ({r.value:.3g})" for r in rows[1:4]) + "."
    legend = "a number in brackets is one of several independent shapes of an error" if _numbered(names) else ""
    return style.vector_drawing(figure, "attribution-inputs", "attribution", title, alt, legend)


def _by_subject(rows: Sequence[Result], simulated: bool) -> Drawing | None:
    """A matrix of subjects by inputs: the area of a dot is the part of the greatest gain of its row."""
    title = "The same for each subject by itself"
    by = {(r.subject, r.method): r.value for r in rows}
    # A gain below 1 explains nothing; subjects without any greater one have nothing to explain.
    telling = {r.subject for r in rows if r.value >= 1.0}
    every = [s for s in dict.fromkeys(r.subject for r in rows) if s in telling]
    if not every:
        return None
    subjects = every[:_MOST_GROUPS]
    best: dict[str, float] = {}
    for r in rows:
        best[r.method] = max(best.get(r.method, 0.0), r.value)
    inputs = sorted((n for n in best if best[n] > 0.0), key=lambda n: -best[n])[:_MOST_INPUTS] or list(best)[:1]
    figure = style.new_figure(10.0, 2.6 + 0.25 * len(subjects), title, simulated)
    axes = figure.add_subplot()
    for i, subject in enumerate(subjects):
        top = max((by.get((subject, n), 0.0) for n in inputs), default=0.0)
        for j, name in enumerate(inputs):
            gain = by.get((subject, name), 0.0)
            if gain > 0.0 and top > 0.0:
                first = gain >= 0.999 * top
                axes.scatter(j, i, s=120.0 * gain / top, color="#C2410C" if first else "#8aa4b8", linewidths=0)
                if first:
                    axes.annotate(_short(gain), (j, i), xytext=(9, 0), textcoords="offset points", fontsize=7,
                                  va="center")  # fmt: skip
    axes.set_xticks(
        range(len(inputs)), [style.plain(style.shortened(n, _LONGEST)) for n in inputs], rotation=35, ha="right"
    )
    axes.set_yticks(range(len(subjects)), [style.plain(style.shortened(s, 30)) for s in subjects])
    axes.set_xlim(-0.6, len(inputs) - 0.1)
    axes.set_ylim(len(subjects) - 0.4, -0.6)
    tops = {s: max(inputs, key=lambda n: by.get((s, n), 0.0)) for s in subjects}
    alt = "For each subject the input that gains most: " + "; ".join(f"{s}: {n}" for s, n in tops.items()) + "."
    legend = "red: the greatest gain of a row, with its size 2 Δ ln L; grey: others as parts of it"
    quiet = len({r.subject for r in rows}) - len(every)
    if quiet:
        legend += f"; {quiet} subjects have nothing to explain"
    if len(every) > len(subjects):
        legend += f"; {len(subjects)} of {len(every)} are drawn, all are in results.csv"
    return style.vector_drawing(figure, "attribution-subjects", "attribution", title, alt, legend)


def _effects(rows: Sequence[Result], simulated: bool) -> Drawing:
    """Change of each number of the comparison per unit of each input, as a matrix of colours."""
    title = "What one unit of each input moves"

    def label(r: Result) -> str:
        what = r.metric.removesuffix("_change").replace("roc_pd@", "P_D ").removesuffix("_ratio_windows")
        way = r.method.partition(" / ")[2].removesuffix("/pixel")
        return f"{r.subject}, {what}" + (f" {way}" if way else "")

    every = list(dict.fromkeys(label(r) for r in rows))
    gaps = {label(r): _gap(r) for r in rows}
    shown = sorted(every, key=lambda q: -gaps[q])[:_MOST_QUANTITIES]
    by = {(label(r), r.method.partition(" / ")[0]): r.value for r in rows}
    names = list(dict.fromkeys(r.method.partition(" / ")[0] for r in rows))
    names = sorted(names, key=lambda n: -max(abs(by.get((q, n), 0.0)) for q in shown))[:_MOST_INPUTS]
    values = np.array([[by.get((q, n), math.nan) for n in names] for q in shown])
    size = max(float(np.nanpercentile(np.abs(values), 97)), 1e-6)
    figure = style.new_figure(10.0, 2.8 + 0.25 * len(shown), title, simulated)
    axes = figure.add_subplot()
    axes.grid(visible=False)
    image = axes.imshow(
        values, cmap=matplotlib.colormaps["PuOr"], norm=TwoSlopeNorm(0.0, -size, size), aspect="auto"
    )
    for (i, j), value in np.ndenumerate(values):
        if np.isfinite(value) and abs(value) >= 0.0005:
            shade = "white" if abs(value) > 0.65 * size else "black"
            words = f"{value:+.2g}" if abs(value) >= 0.001 else f"{value:+.1g}"
            axes.text(j, i, words, ha="center", va="center", fontsize=6.5, color=shade)
    axes.set_xticks(
        range(len(names)), [style.plain(style.shortened(n, _LONGEST)) for n in names], rotation=35, ha="right"
    )
    axes.set_yticks(
        range(len(shown)),
        [style.plain(style.shortened(f"{q} (gap {gaps[q]:.2g})", 56)) for q in shown],
        fontsize=7.5,
    )
    figure.colorbar(image, ax=axes, label="change per unit [1]", shrink=0.8, extend="both")
    largest = max(((abs(v), q, n) for (q, n), v in by.items() if q in shown), default=(0.0, "", ""))
    alt = f"Change of {len(shown)} numbers of the comparison per unit of {len(names)} inputs; the largest, "
    alt += f"{largest[0]:.2g}, is that of {largest[1]} by {largest[2]}."
    legend = "one unit: the stated standard uncertainty of an input, or a usual step where none is stated; "
    legend += "gap: predicted less measured; spectra as a part of the collected mean, P_D as it stands; "
    legend += "the largest gaps are shown"
    return style.vector_drawing(figure, "attribution-effects", "sensitivity", title, alt, legend)


def _what_ifs(rows: Sequence[Result], simulated: bool) -> Drawing:
    title = "What-ifs: the gap before and after"
    figure = style.new_figure(10.0, 1.3 + 0.4 * len(rows), title, simulated)
    axes = figure.add_subplot()
    words = []
    for y, r in enumerate(reversed(rows)):
        before = _leading_number(r.reason)
        better = r.value < before
        axes.plot([before, r.value], [y, y], color="#17643a" if better else "#9b1c1c", linewidth=2.0)
        axes.plot(before, y, "o", color="white", markeredgecolor="#333333")
        axes.plot(r.value, y, _CLOSER if better else _FARTHER, color="#17643a" if better else "#9b1c1c")
        words.append(f"{r.method} from {before:.3g} to {r.value:.3g}")
        axes.annotate(
            f"{r.value:.3g}", (r.value, y), xytext=(0, 6), textcoords="offset points", fontsize=7.5, ha="center"
        )
    axes.set_yticks(range(len(rows)), [style.plain(style.shortened(r.method, 44)) for r in reversed(rows)])
    axes.set_ylim(-0.6, len(rows) - 0.4)
    both = [v for r in rows for v in (r.value, _leading_number(r.reason)) if v > 0]
    if both and max(both) > 20.0 * min(both):
        axes.set_xscale("log")
        style.log_ticks(axes.xaxis)
    axes.margins(x=0.12)
    axes.set_xlabel("reduced chi-square of all residuals [1]; 1 is what the uncertainties allow")
    axes.axvline(1.0, color="#333333", linestyle=":", linewidth=1.0)
    style.add_legend(
        figure,
        [
            (Line2D([], [], marker="o", color="white", markeredgecolor="#333333"), "as the campaign has it"),
            (Line2D([], [], marker=_CLOSER, color="#17643a"), "after, closer"),
            (Line2D([], [], marker=_FARTHER, color="#9b1c1c"), "after, farther"),
        ],
    )
    alt = "Reduced chi-square of all residuals before and after each what-if: " + "; ".join(reversed(words)) + "."
    return style.vector_drawing(figure, "what-ifs", "what-if", title, alt)


def _short(gain: float) -> str:
    """Two digits, without a power of ten."""
    return f"{gain:.0f}" if gain >= 10.0 else f"{gain:.2g}"


def _numbered(names: Sequence[str]) -> bool:
    return any(name.endswith(")") and name.rpartition("(")[2][:-1].isdigit() for name in names)


def _stated(table: ResultTable) -> set[str]:
    rows = [r for r in table.where(product="attribution") if r.metric == "needed_uncertainty"]
    return {r.method for r in rows if "none is stated" not in r.reason}


def _leading_number(text: str) -> float:
    try:
        return float(text.split()[0].rstrip(",;"))
    except (IndexError, ValueError):
        return math.nan


def _gap(row: Result) -> float:
    """The gap that the row's reason tells, as a size."""
    return abs(_leading_number(row.reason.partition("gap ")[2]))
