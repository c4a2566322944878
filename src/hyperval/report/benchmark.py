"""``report.html`` of a benchmark: detectors with ranks, campaign by campaign.

Figures of a benchmark: metrics with intervals, ranks by subject.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap

from hyperval.report import style
from hyperval.report.figures import drawing_of
from hyperval.report.html import common_words, environment
from hyperval.report.plots import Axis, Part, Plots, SubjectView, measured_mark, rows_axis
from hyperval.report.style import Drawing, house_style
from hyperval.report.verdict import number_text
from hyperval.results import Outcome, Result, ResultTable

EVERY_OBJECT = "all objects"
_MOST_SUBJECTS = 30
_RANK_METRICS = ("log_auc@1e-3..1e-1", "auc")


def detector_plots(
    name: str, rows: Sequence[Result], groups: Sequence[tuple[str, ...]], measures: Mapping[str, str]
) -> Plots | None:
    """One plot for each metric on all objects: value, interval, rank with its set."""
    here = {(r.method, r.metric): r for r in rows if r.subject == EVERY_OBJECT and r.outcome is Outcome.NONE}
    detectors, captions = rows_axis([" = ".join(g) for g in groups]), []
    views: dict[str, SubjectView] = {}
    for metric in [m for m in measures if any(metric == m for _, metric in here)]:
        pairs = [[here.get((f"{g[0]}/object", f"{p}{metric}")) for p in ("", "rank_")] for g in groups]
        known = [(i, row, rank) for i, (row, rank) in enumerate(pairs) if row is not None and rank is not None]
        # Densities of false alarms are drawn on a logarithmic axis, where none stands at its left end.
        far = metric.startswith("far")
        positive = [v for _, row, _ in known for v in (row.value, row.upper) if math.isfinite(v) and v > 0]
        floor = 0.5 * min(positive, default=1.0) if far else -math.inf
        marks = []
        for first in (True, False):
            own = [(i, row, rank) for i, row, rank in known if (rank.lower <= 1) == first]
            values = np.array([(row.value, row.lower, row.upper, i) for i, row, _ in own], float).reshape(-1, 4).T
            columns = dict(zip(("x", "low", "high"), np.maximum(values[:3], floor), strict=True)) | {"y": values[3]}
            words = tuple(f"{rank.value:.0f} [{rank.lower:.0f}-{rank.upper:.0f}]" for *_, rank in own)
            beside = {"x": np.fmax(columns["x"], columns["high"]), "y": values[3]}
            label = "may be first" if first else "is not first"
            marks.append(measured_mark("dots", columns, label, marker="circle", hollow=not first, along="x"))
            marks.append(measured_mark("dots", beside, "", words=words, beside=True))
            captions += [
                f"{'/'.join(groups[i])} {metric} {row.value:.3g}, rank {w}"
                for (i, row, _), w in zip(own, words, strict=True)
            ]
        none = " (none: at the left end)" if far and any(row.value == 0.0 for _, row, _ in known) else ""
        views[measures[metric] + none] = SubjectView(
            Axis("value", "log" if far else "linear"), (Part(detectors, tuple(marks)),)
        )
    if not views or not groups:
        return None
    title = f"{name}: detectors on all objects with 95 % intervals; rank [95 % set]"
    alt = f"Metrics of each detector on all objects of {name}. {'; '.join(captions)}."
    return Plots(f"{name}-detectors", name, title, alt, views)


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
            plots = detector_plots(item.name, rows, groups, report.measures)
            out += [] if plots is None else [drawing_of(plots, simulated=item.simulated)]
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
