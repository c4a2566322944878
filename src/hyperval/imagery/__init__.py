"""Cubes, regions of interest and truth."""
