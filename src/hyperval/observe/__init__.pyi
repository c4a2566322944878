"""The empirical pipeline: from a collection to its products."""

from .pipeline import Observed, observe

__all__ = ["Observed", "observe"]
