"""Schema, plan, run, gate and provenance of a campaign."""
