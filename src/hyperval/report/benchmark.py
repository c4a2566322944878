"""``report.html`` of a benchmark: detectors with ranks, campaign by campaign.

Figures of a benchmark: metrics with intervals, ranks by subject.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hyperval.figures.spec import (
    Axis,
    ColourScale,
    Figure,
    Mark,
    Panels,
    Part,
    measured_mark,
    row_names,
    statement,
)
from hyperval.report.html import common_words, drawn_words, environment
from hyperval.report.verdict import number_text
from hyperval.results import Outcome, Result, ResultTable
from hyperval.run import Run

EVERY_OBJECT = "all objects"
_MOST_SUBJECTS = 30
_RANK_METRICS = ("log_auc@1e-3..1e-1", "auc")


def detector_figure(
    name: str, rows: Sequence[Result], groups: Sequence[tuple[str, ...]], measures: Mapping[str, str]
) -> Figure | None:
    """A view for each metric on all objects: value, interval, rank with its set."""
    here = {(r.method, r.metric): r for r in rows if r.subject == EVERY_OBJECT and r.outcome is Outcome.NONE}
    detectors, captions = row_names([" = ".join(g) for g in groups]), []
    views = []
    for metric in [m for m in measures if any(metric == m for _, metric in here)]:
        pairs = [[here.get((f"{g[0]}/object", f"{p}{metric}")) for p in ("", "rank_")] for g in groups]
        known = [(i, row, rank) for i, (row, rank) in enumerate(pairs) if row is not None and rank is not None]
        # Densities of false alarms are drawn on a logarithmic axis, where none stands at its left end.
        far = metric.startswith("far")
        positive = [v for _, row, _ in known for v in (row.value, row.upper) if math.isfinite(v) and v > 0]
        floor = 0.5 * min(positive, default=1.0) if far else -math.inf
        marks, notes = [], [""] * len(groups)
        for first in (True, False):
            own = [(i, row, rank) for i, row, rank in known if (rank.lower <= 1) == first]
            values = np.array([(row.value, row.lower, row.upper, i) for i, row, _ in own], float).reshape(-1, 4).T
            columns = dict(zip(("x", "low", "high"), np.maximum(values[:3], floor), strict=True)) | {"y": values[3]}
            label = "may be first" if first else "is not first"
            marks.append(measured_mark("dots", columns, label, marker="circle", hollow=not first, along="x"))
            for i, row, rank in own:
                notes[i] = f"{rank.value:.0f} [{rank.lower:.0f}-{rank.upper:.0f}]"
                captions.append(f"{'/'.join(groups[i])} {metric} {row.value:.3g}, rank {notes[i]}")
        none = " (none: at the left end)" if far and any(row.value == 0.0 for _, row, _ in known) else ""
        part = Part(replace(detectors, notes=tuple(notes)), tuple(marks))
        views.append(Panels(Axis("value", "log" if far else "linear"), (part,), measures[metric] + none))
    if not views or not groups:
        return None
    title = f"{name}: detectors on all objects with 95 % intervals; rank [95 % set]"
    alt = f"Metrics of each detector on all objects of {name}. {'; '.join(captions)}."
    return Figure(f"{name}-detectors", name, title, alt, tuple(views))


def rank_figure(
    name: str, rows: Sequence[Result], groups: Sequence[tuple[str, ...]], measures: Mapping[str, str]
) -> Figure | None:
    """Ranks by subject, as a map: dark where the detector leads, with the set of ranks that are not refuted."""
    metric = next((m for m in _RANK_METRICS if any(r.metric == f"rank_{m}" for r in rows)), None)
    here = {(r.subject, r.method): r for r in rows if r.metric == f"rank_{metric}" and r.outcome is Outcome.NONE}
    every = list(dict.fromkeys(s for s, _ in here))
    subjects = every[:_MOST_SUBJECTS]
    if metric is None or len(subjects) < 2 or not groups:
        return None
    cells, words, captions = [], [], []
    for i, subject in enumerate(subjects):
        for j, names in enumerate(groups):
            row = here.get((subject, f"{names[0]}/object"))
            if row is not None:
                cells.append((j - 0.5, j + 0.5, i - 0.5, i + 0.5, row.value))
                words.append(f"{row.value:.0f} [{row.lower:.0f}-{row.upper:.0f}]")
                captions.append(f"{subject}, {'/'.join(names)}: {words[-1]}")
    columns = dict(zip(("left", "right", "bottom", "top", "value"), np.array(cells, float).T, strict=True))
    scale = ColourScale("falling", 1.0, max(float(columns["value"].max()), 2.0))
    mark = Mark("cells", columns, words=tuple(words), beside="centre", scale=scale)
    more = "" if len(subjects) == len(every) else f"; {len(subjects)} of {len(every)} subjects"
    return Figure(
        f"{name}-ranks", name,
        f"{name}: rank [95 % set] by {measures[metric]}, subjects of two objects and more{more}",
        f"Rank of each detector by subject. {'; '.join(captions)}.",
        (Panels(row_names([" = ".join(g) for g in groups]), (Part(row_names(subjects), (mark,)),)),),
        head=f"{name}: rank of each detector by subject", width_in=2.6 + 1.35 * len(groups),
    )  # fmt: skip


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


def benchmark_figures(report: BenchmarkReport) -> list[Figure]:
    """The figures of the page."""
    out = []
    for item in report.campaigns:
        rows = list(report.table.where(campaign=item.name))
        groups = alike(rows, report.measures)
        out += [make(item.name, rows, groups, report.measures) for make in (detector_figure, rank_figure)]
    return [figure for figure in out if figure is not None]


def write_benchmark(folder: Path, report: BenchmarkReport, record: Mapping[str, Any]) -> None:
    """Write the folder of a benchmark."""
    from hyperval.figures.print import drawings_of

    simulated = {item.name: item.simulated for item in report.campaigns}
    figures = benchmark_figures(report)
    drawings = [one for figure in figures for one in drawings_of([figure], simulated=simulated[figure.section])]
    run = Run(report.table, record)
    run.write(folder, benchmark_page(report, figures), {one.file_name: one.content for one in drawings})


def alike(rows: Sequence[Result], measures: Mapping[str, str]) -> list[tuple[str, ...]]:
    """Detectors in groups that have the same value of every metric on all objects: they order the pixels alike."""
    groups: dict[tuple[float, ...], list[str]] = {}
    own = [r for r in rows if r.subject == EVERY_OBJECT and r.metric in measures and r.outcome is Outcome.NONE]
    for method in dict.fromkeys(r.method for r in own):
        key = tuple(r.value for r in own if r.method == method)
        groups.setdefault(key, []).append(method.removesuffix("/object"))
    return [tuple(names) for names in groups.values()]


def benchmark_page(report: BenchmarkReport, figures: Sequence[Figure]) -> str:
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
                "figures": [one for one in figures if one.section == item.name],
            }
        )
    return environment().get_template("benchmark.html.j2").render(
        entries=entries, skipped=skipped, count=len(report.table),
        all=len(report.campaigns), **drawn_words({one.name: statement(one) for one in figures}), **common_words(),
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
