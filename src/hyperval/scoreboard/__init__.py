"""Benchmark across campaigns: all detectors, each with its uncertainty, in one table."""
