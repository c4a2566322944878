"""One file per product: prediction against observation."""

from .outcomes import Gate, judged
from .products import compare_products

__all__ = ["Gate", "compare_products", "judged"]
