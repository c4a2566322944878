"""Accepted numbers of campaigns and sensors, and whether the code still gives them."""

from .accepted import (
    DEFAULT_FOLDER,
    SENSORS,
    Accepted,
    Baseline,
    RunNumbers,
    accept,
    accepted_numbers,
    campaign_metrics,
    check,
    compare,
    joined_rows,
    load_baseline,
    sensor_metrics,
    today,
)

__all__ = [
    "DEFAULT_FOLDER", "SENSORS", "Accepted", "Baseline", "RunNumbers", "accept", "accepted_numbers", "campaign_metrics",
    "check", "compare", "joined_rows", "load_baseline", "sensor_metrics", "today",
]  # fmt: skip
