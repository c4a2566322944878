"""Designs over inputs: which one explains a difference, and which error a comparison would have shown."""
