"""Benchmark across campaigns: all detectors, each with its uncertainty, in one table."""

from .runs import LOG_AREA, MEASURES, BlockCounts, benchmark, counts_by_block, goodness, measured, rank_sets, ranked

__all__ = [
    "LOG_AREA", "MEASURES", "BlockCounts", "benchmark", "counts_by_block", "goodness", "measured", "rank_sets",
    "ranked",
]  # fmt: skip
