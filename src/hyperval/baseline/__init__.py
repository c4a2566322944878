"""Accepted numbers of campaigns and sensors, and whether the code still gives them."""

from hyperval.baseline.check import accept, check

__all__ = ["accept", "check"]
