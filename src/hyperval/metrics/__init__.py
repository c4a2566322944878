"""The table of metrics: comparisons, gates, baselines, reports, benchmark and documentation read it."""

from hyperval.metrics.metric import Evidence, Kind, Metric
from hyperval.metrics.table import base_name, explained, foreign, metric_of, plain_words, product_words, table

__all__ = [
    "Evidence",
    "Kind",
    "Metric",
    "base_name",
    "explained",
    "foreign",
    "metric_of",
    "plain_words",
    "product_words",
    "table",
]
