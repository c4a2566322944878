"""Pixel-level scene generator: a simulated collection with its truth, sampled and not derived."""
