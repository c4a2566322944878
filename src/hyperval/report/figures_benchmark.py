"""Figures of a benchmark: metrics with intervals, ranks by subject, agreement of the variants."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap

from hyperval.report import style
from hyperval.report.style import COLLECTED, PREDICTED, Drawing
from hyperval.results import Outcome, Result

EVERY_OBJECT = "all objects"
EVERY_SUBJECT = "all subjects"
_MOST_SUBJECTS = 30
_RANK_METRICS = ("log_auc@1e-3..1e-1", "auc")
_FIRST = "radiance_median_abs_difference_ratio"
_AGREEMENT = {
    _FIRST: ("median |difference ratio|\nof radiance [%]", 100.0),
    "reflectance_median_abs_difference_ratio": ("median |difference ratio|\nof reflectance [%]", 100.0),
    "radiance_chi2_reduced": ("reduced χ² of radiance\n(1 where the budget holds)", 1.0),
    "pd_inside_interval@1e-2": ("share of curves with P_D\ninside at 1e-2 [1]", 1.0),
    "pd_mean_abs_difference@1e-2": ("mean |P_D difference|\nat 1e-2 [1]", 1.0),
}


def detector_figures(
    name: str,
    rows: Sequence[Result],
    groups: Sequence[tuple[str, ...]],
    measures: Mapping[str, str],
    *,
    simulated: bool,
) -> list[Drawing]:
    """One panel for each metric on all objects: value, interval, rank with its set."""
    here = {(r.method, r.metric): r for r in rows if r.subject == EVERY_OBJECT and r.outcome is Outcome.NONE}
    shown = [m for m in measures if any(metric == m for _, metric in here)]
    if not shown or not groups:
        return []
    figure = style.new_figure(12.0, 1.5 + 0.34 * len(groups), f"{name}: detectors on all objects", simulated)
    panels = figure.subplots(1, len(shown), squeeze=False)[0]
    captions = []
    for k, (axes, metric) in enumerate(zip(panels, shown, strict=True)):
        for i, names in enumerate(groups):
            row, rank = (here.get((f"{names[0]}/object", f"{p}{metric}")) for p in ("", "rank_"))
            if row is None or rank is None:
                continue
            _whisker(axes, row, i, 1.0, solid=rank.lower <= 1)
            words = f"{rank.value:.0f} [{rank.lower:.0f}-{rank.upper:.0f}]"
            axes.annotate(
                words, (1.0, i), xycoords=("axes fraction", "data"), xytext=(3, 0), textcoords="offset points",
                va="center", fontsize=7.5, color="#444444",
            )  # fmt: skip
            captions.append(f"{'/'.join(names)} {metric} {row.value:.3g}, rank {words}")
        _rows_of(axes, [" = ".join(g) for g in groups] if k == 0 else [""] * len(groups))
        axes.set_xlabel("\n".join(style.plain(part) for part in measures[metric].split(", ", 1)), fontsize=8.0)
        if metric.startswith("far"):
            axes.set_xscale("symlog", linthresh=_least_positive([here[k] for k in here if k[1] == metric]))
            axes.set_xlim(left=0.0)
        axes.tick_params(axis="x", labelsize=7.5)
    title = f"{name}: detectors on all objects with 95 % intervals; rank [95 % set], filled where it may be first"
    alt = f"Metrics of each detector on all objects of {name}. {'; '.join(captions)}."
    return [style.vector_drawing(figure, f"{name}-detectors", name, title, alt)]


def rank_figures(
    name: str,
    rows: Sequence[Result],
    groups: Sequence[tuple[str, ...]],
    measures: Mapping[str, str],
    *,
    simulated: bool,
) -> list[Drawing]:
    """Ranks by subject, as a map: dark where the detector leads, with the set of ranks that are not refuted."""
    metric = next((m for m in _RANK_METRICS if any(r.metric == f"rank_{m}" for r in rows)), None)
    if metric is None:
        return []
    here = {(r.subject, r.method): r for r in rows if r.metric == f"rank_{metric}" and r.outcome is Outcome.NONE}
    every = list(dict.fromkeys(s for s, _ in here))
    subjects = every[:_MOST_SUBJECTS]
    if len(subjects) < 2 or not groups:
        return []
    worst = max(r.value for r in here.values())
    grid = np.full((len(subjects), len(groups)), np.nan)
    figure = style.new_figure(
        2.6 + 1.35 * len(groups), 1.3 + 0.27 * len(subjects), f"{name}: rank of each detector by subject", simulated
    )
    axes = figure.add_subplot()
    captions = []
    for i, subject in enumerate(subjects):
        for j, names in enumerate(groups):
            row = here.get((subject, f"{names[0]}/object"))
            if row is None:
                continue
            grid[i, j] = row.value
            words = f"{row.value:.0f} [{row.lower:.0f}-{row.upper:.0f}]"
            shade = "white" if row.value <= worst / 3 else "black"
            axes.text(j, i, words, ha="center", va="center", fontsize=7.5, color=shade)
            captions.append(f"{subject}, {'/'.join(names)}: {words}")
    shades = ListedColormap([(s, s + 0.04, s + 0.09) for s in np.linspace(0.2, 0.9, 16)])
    axes.imshow(grid, cmap=shades, vmin=1, vmax=worst, aspect="auto")
    axes.set_xticks(range(len(groups)), [style.plain("\n= ".join(g)) for g in groups], fontsize=7.5)
    axes.set_yticks(range(len(subjects)), [style.plain(style.shortened(s)) for s in subjects], fontsize=8.0)
    axes.grid(visible=False)
    more = "" if len(subjects) == len(every) else f"; {len(subjects)} of {len(every)} subjects"
    title = f"{name}: rank [95 % set] by {measures[metric]}, subjects of two objects and more{more}"
    alt = f"Rank of each detector by subject. {'; '.join(captions)}."
    return [style.vector_drawing(figure, f"{name}-ranks", name, title, alt)]


def agreement_figures(name: str, rows: Sequence[Result], *, simulated: bool) -> list[Drawing]:
    """Engines and formulations: one panel for each figure of agreement."""
    here = {(r.method, r.metric): r for r in rows if r.subject == EVERY_SUBJECT and r.outcome is Outcome.NONE}
    there = {metric for _, metric in here}
    shown = [m for m in _AGREEMENT if m in there and not (m.startswith("reflectance") and _FIRST in there)]
    labels = list(dict.fromkeys(label for label, metric in here if metric in shown))
    if not shown:
        return []
    figure = style.new_figure(
        3.4 + 2.2 * len(shown), 1.5 + 0.34 * len(labels), f"{name}: engines and formulations", simulated
    )
    words = []
    for k, (axes, metric) in enumerate(zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True)):
        title, factor = _AGREEMENT[metric]
        for i, label in enumerate(labels):
            row = here.get((label, metric))
            if row is not None:
                _whisker(axes, row, i, factor, solid=True, colour=PREDICTED.colour)
                words.append(f"{label} {metric} {row.value:.3g}")
        _rows_of(axes, labels if k == 0 else [""] * len(labels))
        axes.set_xlabel(title, fontsize=8.0)
        axes.set_xlim(0.0, 1.05 * axes.get_xlim()[1])  # a dot on the border would be cut in half
    title = f"{name}: how well engines and formulations predict, with 95 % intervals"
    return [style.vector_drawing(figure, f"{name}-variants", name, title, f"{title}. {'; '.join(words)}.")]


def _whisker(
    axes: Axes, row: Result, at: int, factor: float, *, solid: bool, colour: str = COLLECTED.colour
) -> None:
    if math.isfinite(row.lower):
        axes.plot([factor * row.lower, factor * row.upper], [at, at], color=colour, linewidth=3.0, alpha=0.35)
    axes.plot(
        factor * row.value, at, "o", color=colour, markersize=5, markerfacecolor=colour if solid else "white",
        markeredgewidth=1.2,
    )  # fmt: skip


def _rows_of(axes: Axes, labels: Sequence[str]) -> None:
    axes.set_yticks(
        range(len(labels)), [style.plain(style.shortened(x, 44)) if x else "" for x in labels], fontsize=8.0
    )
    axes.set_ylim(len(labels) - 0.5, -0.5)


def _least_positive(rows: Sequence[Result]) -> float:
    values = [v for r in rows for v in (r.value, r.upper) if math.isfinite(v) and v > 0]
    return min(values, default=1.0)
