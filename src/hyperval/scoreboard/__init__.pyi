"""Benchmark across campaigns: all detectors, each with its uncertainty, in one table."""

from .ranks import LOG_AREA, MEASURES, BlockCounts, counts_by_block, goodness, measured, rank_sets, ranked
from .runs import benchmark

__all__ = [
    "LOG_AREA", "MEASURES", "BlockCounts", "benchmark", "counts_by_block", "goodness", "measured", "rank_sets",
    "ranked",
]  # fmt: skip
