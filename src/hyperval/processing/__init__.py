"""ELM, features, detectors and ROC, for statistics and for pixels (3.21-3.33)."""
