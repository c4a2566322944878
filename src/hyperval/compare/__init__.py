"""One file per product: prediction against observation."""
