"""Figures, HTML, CSV, JSON, JUnit and NetCDF: views of one results table."""
