"""``report.html`` of a benchmark: detectors with ranks, campaign by campaign.

Figures of a benchmark: metrics with intervals, ranks by subject.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap

from hyperval.report import style
from hyperval.report.html import common_words, environment
from hyperval.report.style import COLLECTED, Drawing, house_style
from hyperval.report.verdict import number_text
from hyperval.results import Outcome, Result, ResultTable

EVERY_OBJECT = "all objects"
_MOST_SUBJECTS = 30
_RANK_METRICS = ("log_auc@1e-3..1e-1", "auc")


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
            _whisker(axes, row, i, solid=rank.lower <= 1)
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


def _whisker(axes: Axes, row: Result, at: int, *, solid: bool) -> None:
    colour = COLLECTED.colour
    if math.isfinite(row.lower):
        axes.plot([row.lower, row.upper], [at, at], color=colour, linewidth=3.0, alpha=0.35)
    axes.plot(
        row.value, at, "o", color=colour, markersize=5, markerfacecolor=colour if solid else "white",
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


@dataclass(frozen=True)
class CampaignWords:
    """What the page says of a campaign besides its rows."""

    name: str
    title: str
    simulated: bool
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class BenchmarkReport:
    """Everything the page shows.

    Attributes
    ----------
    measures : name in the table -> title
    """

    table: ResultTable
    campaigns: Sequence[CampaignWords]
    measures: Mapping[str, str]


def draw_benchmark(report: BenchmarkReport) -> list[Drawing]:
    """The figures of the page."""
    out: list[Drawing] = []
    with house_style():
        for item in report.campaigns:
            rows = list(report.table.where(campaign=item.name))
            groups = alike(rows, report.measures)
            out += detector_figures(item.name, rows, groups, report.measures, simulated=item.simulated)
            out += rank_figures(item.name, rows, groups, report.measures, simulated=item.simulated)
    return out


def alike(rows: Sequence[Result], measures: Mapping[str, str]) -> list[tuple[str, ...]]:
    """Detectors in groups that have the same value of every metric on all objects: they order the pixels alike."""
    groups: dict[tuple[float, ...], list[str]] = {}
    own = [r for r in rows if r.subject == EVERY_OBJECT and r.metric in measures and r.outcome is Outcome.NONE]
    for method in dict.fromkeys(r.method for r in own):
        key = tuple(r.value for r in own if r.method == method)
        groups.setdefault(key, []).append(method.removesuffix("/object"))
    return [tuple(names) for names in groups.values()]


def benchmark_page(report: BenchmarkReport, drawings: Sequence[Drawing]) -> str:
    """The page."""
    skipped = [r for r in report.table if r.outcome in (Outcome.SKIPPED, Outcome.ERROR)]
    entries = []
    for item in report.campaigns:
        rows = list(report.table.where(campaign=item.name))
        if not any(r.outcome is Outcome.NONE for r in rows):
            continue  # named under what was not run
        groups = alike(rows, report.measures)
        entries.append(
            {
                "words": item,
                "leads": leads(rows, groups, report.measures),
                "measures": [t for m, t in report.measures.items() if _has(rows, m)],
                "detectors": [_detector(rows, names, report.measures) for names in groups],
                "figures": [{"drawing": d, "source": d.source} for d in drawings if d.section == item.name],
            }
        )
    return environment().get_template("benchmark.html.j2").render(
        entries=entries, skipped=skipped, count=len(report.table),
        all=len(report.campaigns), **common_words(),
    )  # fmt: skip


def leads(rows: Sequence[Result], groups: Sequence[tuple[str, ...]], measures: Mapping[str, str]) -> list[str]:
    """Who is first by each metric on all objects, and who cannot be told from the first."""
    out = []
    for metric, title in measures.items():
        ranks = {r.method: r for r in rows if r.subject == EVERY_OBJECT and r.metric == f"rank_{metric}"}
        ranks = {k: r for k, r in ranks.items() if r.outcome is Outcome.NONE}
        if not ranks:
            continue
        first = [" = ".join(g) for g in groups if f"{g[0]}/object" in ranks and ranks[f"{g[0]}/object"].value == 1]
        near = [
            " = ".join(g)
            for g in groups
            if (r := ranks.get(f"{g[0]}/object")) is not None and r.value > 1 and r.lower <= 1
        ]
        words = f"; not told from it: {', '.join(near)}" if near else "; all others are told from it"
        out.append(f"{title}: {' and '.join(first)}{words if len(groups) > len(first) else ''}")
    return out


def _has(rows: Sequence[Result], metric: str) -> bool:
    return any(r.metric == metric and r.subject == EVERY_OBJECT for r in rows)


def _detector(rows: Sequence[Result], names: tuple[str, ...], measures: Mapping[str, str]) -> dict[str, Any]:
    own = {r.metric: r for r in rows if r.subject == EVERY_OBJECT and r.method == f"{names[0]}/object"}
    cells = []
    for metric in measures:
        if not _has(rows, metric):
            continue
        value, rank, first = (own.get(f"{p}{metric}") for p in ("", "rank_", "first_"))
        cells.append(
            {
                "value": _number(value), "interval": _span(value),
                "rank": f"{rank.value:.0f} [{rank.lower:.0f} to {rank.upper:.0f}]" if rank else "–",
                "first": f"{100 * first.value:.0f} %" if first else "–",
            }
        )  # fmt: skip
    return {"name": " = ".join(names), "cells": cells}


def _number(row: Result | None) -> str:
    if row is None or not math.isfinite(row.value):
        return "–"
    return number_text(row.value, (row.upper - row.lower) / 2)


def _span(row: Result | None) -> str:
    if row is None or not math.isfinite(row.lower):
        return ""
    spread = (row.upper - row.lower) / 2  # two digits of it are all that value and ends are worth
    return f"{number_text(row.lower, spread)} to {number_text(row.upper, spread)}"
