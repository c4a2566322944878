"""Benchmark across campaigns: all detectors, each with its uncertainty, in one table."""

from .runs import (
    LOG_AREA,
    MEASURES,
    BlockCounts,
    benchmark,
    counts_by_block,
    draw_metric,
    goodness,
    rank_detectors,
    rank_sets,
)

__all__ = [
    "LOG_AREA", "MEASURES", "BlockCounts", "benchmark", "counts_by_block", "draw_metric", "goodness", "rank_detectors",
    "rank_sets",
]  # fmt: skip
