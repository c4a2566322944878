"""Why model and data differ: which inputs explain it, and which errors a comparison would have shown."""

from .candidates import (
    Candidate,
    Family,
    NotInjectable,
    errors_of_file,
    every_input,
    exchanged_pairs,
    further_candidates,
    injected_errors,
    injected_prediction,
    others_in_place,
    rarer_candidates,
)
from .posterior import (
    COMMON,
    DIFFERENT,
    NONE,
    NOTHING,
    Posterior,
    Reasoner,
    Residuals,
    Whitened,
    common_and_individual,
    kind_of,
)
from .reasons import (
    Causes,
    ScenarioModel,
    Truths,
    alarm_ratios,
    attribute,
    causes_of,
    changed_scenarios,
    reason_for,
    scale_warnings,
    shares_of_variance,
)
from .residuals import ResidualBlock, Stack, few_objects, quantities, sampled_covariance, stack_of
from .schema import AttributionOptions, WhatIf

__all__ = [
    "COMMON", "DIFFERENT", "NONE", "NOTHING", "AttributionOptions", "Candidate", "Causes",
    "Family", "NotInjectable", "Posterior", "Reasoner", "ResidualBlock", "Residuals", "ScenarioModel", "Stack",
    "Truths", "WhatIf", "Whitened", "alarm_ratios", "attribute", "causes_of",
    "changed_scenarios", "common_and_individual", "errors_of_file", "every_input", "exchanged_pairs", "few_objects",
    "further_candidates", "injected_errors", "injected_prediction", "kind_of", "others_in_place", "quantities",
    "rarer_candidates", "reason_for", "sampled_covariance", "scale_warnings", "shares_of_variance", "stack_of",
]  # fmt: skip
