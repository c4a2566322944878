"""``report.html`` of a benchmark: detectors with ranks, engines and formulations, campaign by campaign."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hyperval.report.figures_benchmark import agreement_figures, detector_figures, rank_figures
from hyperval.report.html import common_words, environment
from hyperval.report.style import Drawing, house_style
from hyperval.report.verdict import number_text
from hyperval.results import Outcome, Result, ResultTable

EVERY_OBJECT = "all objects"
EVERY_SUBJECT = "all subjects"


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
    measures, engines : name in the table -> title
    """

    table: ResultTable
    campaigns: Sequence[CampaignWords]
    measures: Mapping[str, str]
    engines: Mapping[str, str]


def draw_benchmark(report: BenchmarkReport) -> list[Drawing]:
    """The figures of the page."""
    out: list[Drawing] = []
    with house_style():
        for item in report.campaigns:
            rows = list(report.table.where(campaign=item.name))
            groups = alike(rows, report.measures)
            out += detector_figures(item.name, rows, groups, report.measures, simulated=item.simulated)
            out += rank_figures(item.name, rows, groups, report.measures, simulated=item.simulated)
            out += agreement_figures(item.name, rows, simulated=item.simulated)
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
                "variants": _variants(rows),
                "figures": [{"drawing": d, "source": d.source} for d in drawings if d.section == item.name],
            }
        )
    return environment().get_template("benchmark.html.j2").render(
        entries=entries, skipped=skipped, engines=report.engines, count=len(report.table),
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


_COLUMNS = {
    "radiance_median_abs_difference_ratio": "Median |difference ratio| of radiance, windows [%]",
    "radiance_median_abs_difference_ratio_change": "Change of it [%]",
    "radiance_chi2_reduced": "Reduced χ² of radiance",
    "reflectance_median_abs_difference_ratio": "Median |difference ratio| of reflectance, windows [%]",
    "reflectance_median_abs_difference_ratio_change": "Change of it [%]",
    "reflectance_chi2_reduced": "Reduced χ² of reflectance",
    "pd_inside_interval@1e-2": "P_D inside, P_FA 1e-2",
    "pd_inside_interval@1e-3": "P_D inside, P_FA 1e-3",
    "pd_mean_abs_difference@1e-2": "Mean |P_D difference|, P_FA 1e-2",
    "pd_mean_abs_difference@1e-3": "Mean |P_D difference|, P_FA 1e-3",
}


def _variants(rows: Sequence[Result]) -> dict[str, Any]:
    """Engines and formulations of a campaign, each with what its rows say; the campaign as it stands first."""
    whole = [r for r in rows if r.subject == EVERY_SUBJECT]
    there = {r.metric for r in whole}
    columns = [m for m in _COLUMNS if m in there]
    lines = []
    for label in dict.fromkeys(r.method for r in whole):
        own = {r.metric: r for r in whole if r.method == label}
        refused = own.get("agreement")
        cells = [(_number(own.get(m), _factor(m)), _span(own.get(m), _factor(m))) for m in columns]
        lines.append({"name": label, "reason": refused.reason if refused else "", "cells": cells})
    return {"columns": [_COLUMNS[m] for m in columns], "lines": lines}


def _factor(metric: str) -> float:
    return 100.0 if "ratio" in metric else 1.0


def _number(row: Result | None, factor: float = 1.0) -> str:
    if row is None or not math.isfinite(row.value):
        return "–"
    return number_text(factor * row.value, factor * (row.upper - row.lower) / 2)


def _span(row: Result | None, factor: float = 1.0) -> str:
    if row is None or not math.isfinite(row.lower):
        return ""
    spread = factor * (row.upper - row.lower) / 2  # two digits of it are all that value and ends are worth
    return f"{number_text(factor * row.lower, spread)} to {number_text(factor * row.upper, spread)}"
