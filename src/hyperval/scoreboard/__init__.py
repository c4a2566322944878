"""Benchmark across campaigns: detectors, engines and formulations, each with its uncertainty, in one table."""
