"""Why model and data differ: which inputs explain it, and which errors a comparison would have shown."""

from .candidates import (
    Candidate,
    NotInjectable,
    Perturbation,
    errors_of_file,
    every_input,
    exchanged_pairs,
    further_candidates,
    injected_errors,
    injected_prediction,
    rarer_candidates,
    substitutions,
)
from .posterior import (
    COMMON,
    DIFFERENT,
    NONE,
    NOTHING,
    CausePrior,
    Posterior,
    Residuals,
    Whitened,
    common_and_individual,
    prior_group,
)
from .reasons import (
    CauseEffects,
    ScenarioModel,
    Truths,
    alarm_ratios,
    attribute,
    changed_scenarios,
    collect_effects,
    explain_ratio,
    scale_warnings,
    variance_shares,
)
from .residuals import ResidualBlock, Stack, few_objects, quantities, sampled_covariance, stack_of
from .schema import AttributionOptions, WhatIf

__all__ = [
    "COMMON", "DIFFERENT", "NONE", "NOTHING", "AttributionOptions", "Candidate", "CauseEffects", "CausePrior",
    "NotInjectable", "Perturbation", "Posterior", "ResidualBlock", "Residuals", "ScenarioModel", "Stack", "Truths",
    "WhatIf", "Whitened", "alarm_ratios", "attribute", "changed_scenarios", "collect_effects", "common_and_individual",
    "errors_of_file", "every_input", "exchanged_pairs", "explain_ratio", "few_objects", "further_candidates",
    "injected_errors", "injected_prediction", "prior_group", "quantities", "rarer_candidates", "sampled_covariance",
    "scale_warnings", "stack_of", "substitutions", "variance_shares",
]  # fmt: skip
