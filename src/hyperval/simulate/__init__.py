"""Pixel-level scene generator, independent of the analytical model."""
