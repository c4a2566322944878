"""Every stated plot of a run, in the order of the report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hyperval.report.plots import Plots
from hyperval.report.plots_budget import budget_plots
from hyperval.report.plots_covariance import eigenvalue_plots, sampled_eigenvalue_plots, tail_plots
from hyperval.report.plots_errors import abundance_plots, class_error_plots, score_plots, unmixing_plots
from hyperval.report.plots_reasons import reason_plots
from hyperval.report.plots_scores import (
    exceedance_plots,
    object_score_plots,
    roc_difference_plots,
    transform_plots,
)
from hyperval.report.run import EigenvalueSpectrum, TailCurve
from hyperval.report.sides import Sides
from hyperval.results import ResultTable


def every_plot(
    sides: Sides,
    table: ResultTable,
    eigenvalues: Mapping[tuple[str, str], EigenvalueSpectrum],
    tails: Mapping[str, TailCurve],
    margin: float | None,
) -> list[Plots]:
    """What the products, the rows and the spread of pixels of a run give, with its margin of P_D [1]."""
    return [
        *budget_plots(sides),
        *(sampled_eigenvalue_plots(eigenvalues) if eigenvalues else eigenvalue_plots(sides)),
        *tail_plots(tails),
        *class_error_plots(sides),
        *score_plots(sides),
        *object_score_plots(sides),
        *transform_plots(sides),
        *exceedance_plots(sides),
        *roc_difference_plots(sides, margin),
        *abundance_plots(sides),
        *unmixing_plots(sides, list(table.where(product="abundance"))),
        *reason_plots(table),
    ]


def equivalence_margin(provenance: Mapping[str, Any]) -> float | None:
    """The margin that the campaign of a run states, as its provenance records it."""
    campaign = (provenance.get("configuration") or {}).get("campaign") or {}
    margin = campaign.get("equivalence_margin")
    return float(margin) if isinstance(margin, int | float) else None
