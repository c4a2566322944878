"""Accepted numbers of campaigns and sensors, and whether the code still gives them."""

from .accepted import (
    DEFAULT_FOLDER,
    SENSORS,
    Accepted,
    Baseline,
    accepted_of,
    campaign_metrics,
    key_of,
    load_baseline,
    sensor_metrics,
    split_key,
)
from .against import Checked, accept, check, compare

__all__ = [
    "DEFAULT_FOLDER", "SENSORS", "Accepted", "Baseline", "Checked", "accept", "accepted_of", "campaign_metrics",
    "check", "compare", "key_of", "load_baseline", "sensor_metrics", "split_key",
]  # fmt: skip
