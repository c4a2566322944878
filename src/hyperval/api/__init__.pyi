from .objects import (
    Collection,
    Metrics,
    Observation,
    Prediction,
    Results,
    Study,
    Validation,
    check,
    compare,
    explain,
    load_campaign,
    load_scenario,
    metrics,
    observe,
    open,
    predict,
    simulate,
    study,
    validate,
)

__all__ = [
    "Collection", "Metrics", "Observation", "Prediction", "Results", "Study", "Validation", "check", "compare",
    "explain", "load_campaign", "load_scenario", "metrics", "observe", "open", "predict", "simulate", "study",
    "validate",
]  # fmt: skip
