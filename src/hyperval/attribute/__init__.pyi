"""Why model and data differ: which inputs explain it, and which errors a comparison would have shown."""

from .injected import InjectedError, NotInjectable, injected_errors, injected_prediction
from .ranking import (
    COMMON,
    DIFFERENT,
    Candidate,
    Whitened,
    assumed_inputs,
    budget_covariance,
    common_and_own,
    explanation,
    ranking,
    rankings,
)
from .residuals import ComparedQuantity, ResidualBlock, Stack, few_objects, quantities, sampled_covariance, stacked
from .run import attribute, sensitivity_indices
from .schema import AttributionOptions, WhatIf
from .whatif import ScenarioModel, Truths, alarm_ratios, changed_scenarios, gaps_of, reason_for

__all__ = [
    "COMMON", "DIFFERENT", "AttributionOptions", "Candidate", "ComparedQuantity", "InjectedError",
    "NotInjectable", "ResidualBlock", "ScenarioModel", "Stack", "Truths", "WhatIf", "Whitened", "alarm_ratios",
    "assumed_inputs", "attribute", "budget_covariance", "changed_scenarios", "common_and_own", "explanation",
    "few_objects", "gaps_of", "injected_errors", "injected_prediction", "quantities", "ranking", "rankings",
    "reason_for", "sampled_covariance", "sensitivity_indices", "stacked",
]  # fmt: skip
