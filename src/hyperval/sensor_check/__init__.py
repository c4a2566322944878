"""Acceptance of a sensor file: what `hyperval sensor check` and `hyperval sensor new` do."""
