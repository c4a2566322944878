"""One file per product: prediction against observation."""

from .gates import Gate
from .outcomes import judged
from .products import compare_products

__all__ = ["Gate", "compare_products", "judged"]
