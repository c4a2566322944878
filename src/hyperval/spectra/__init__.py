"""Spectral axis, band responses, windows, and readers of field spectra and libraries."""
