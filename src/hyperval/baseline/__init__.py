"""Accepted numbers of campaigns and sensors, and whether the code still gives them."""

from hyperval.baseline.accept import accept
from hyperval.baseline.check import check

__all__ = ["accept", "check"]
