"""One file per product: prediction against observation."""

from hyperval.compare.gates import Gate, apply_gates
from hyperval.compare.products import compare_products

__all__ = ["Gate", "apply_gates", "compare_products"]
