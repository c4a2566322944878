"""Sensor specification, response and noise (3.13-3.20)."""
