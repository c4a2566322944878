"""Why model and data differ: which inputs explain it, and which errors a comparison would have shown."""

from .candidates import (
    Candidate,
    Family,
    NotInjectable,
    assumed_inputs,
    candidates,
    injected_errors,
    injected_prediction,
)
from .ranking import (
    COMMON,
    DIFFERENT,
    Whitened,
    budget_covariance,
    common_and_own,
    explanation,
    ranking,
    rankings,
)
from .reasons import ScenarioModel, Truths, alarm_ratios, attribute, changed_scenarios, reason_for, sensitivity_indices
from .residuals import ComparedQuantity, ResidualBlock, Stack, few_objects, quantities, sampled_covariance, stacked
from .schema import AttributionOptions, WhatIf

__all__ = [
    "COMMON", "DIFFERENT", "AttributionOptions", "Candidate", "ComparedQuantity", "Family", "NotInjectable",
    "ResidualBlock", "ScenarioModel", "Stack", "Truths", "WhatIf", "Whitened", "alarm_ratios", "assumed_inputs",
    "attribute", "budget_covariance", "candidates", "changed_scenarios", "common_and_own", "explanation",
    "few_objects", "injected_errors", "injected_prediction", "quantities", "ranking", "rankings", "reason_for",
    "sampled_covariance", "sensitivity_indices", "stacked",
]  # fmt: skip
