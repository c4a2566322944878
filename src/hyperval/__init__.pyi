"""hyperval: does the model of a hyperspectral imager agree with what it measured?"""

from . import (
    api,
    compare,
    config,
    datasets,
    metrics,
    report,
    results,
    run,
    sensor,
    sensor_check,
    simulate,
    storage,
    study,
)
from .api import open

__version__: str
__all__ = [
    "api", "compare", "config", "datasets", "metrics", "open", "report", "results", "run", "sensor", "sensor_check",
    "simulate", "storage", "study",
]  # fmt: skip
