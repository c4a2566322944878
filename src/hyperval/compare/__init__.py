"""One file per product: prediction against observation."""

from hyperval.compare.gates import Gate
from hyperval.compare.outcomes import judged
from hyperval.compare.products import compare_products

__all__ = ["Gate", "compare_products", "judged"]
