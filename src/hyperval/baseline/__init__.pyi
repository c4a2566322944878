"""Accepted numbers of campaigns and sensors, and whether the code still gives them."""

from .accepted import (
    DEFAULT_FOLDER,
    SENSORS,
    Accepted,
    Baseline,
    RunNumbers,
    accept,
    accepted_of,
    campaign_metrics,
    check,
    compare,
    load_baseline,
    rows_of,
    sensor_metrics,
    today,
)

__all__ = [
    "DEFAULT_FOLDER", "SENSORS", "Accepted", "Baseline", "RunNumbers", "accept", "accepted_of", "campaign_metrics",
    "check", "compare", "load_baseline", "rows_of", "sensor_metrics", "today",
]  # fmt: skip
