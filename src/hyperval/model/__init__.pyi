"""The forward model: truths of a scenario, moved by paths, and what a sensor would see and detect of them."""

from .detection import Evaluation, evaluations
from .fills import fill_distribution, geometry_of, pixels_of_object
from .forward import predict, predictions
from .inputs import UncertainInput, drawn_truths, inputs_of, number_input, spectral_input, together
from .spectra import without_calibration_error
from .surfaces import Read, Sources, band_error_covariance, correlation
from .unmixing import UnmixedSubject, labelled, predicted_areas, predicted_classification
from .world import (
    PATHS,
    Origins,
    Stated,
    Truth,
    World,
    every_path,
    read,
    reads_again,
    settled,
    value_at,
    with_truths,
    with_values,
)

__all__ = [
    "PATHS", "Evaluation", "Origins", "Read", "Sources", "Stated", "Truth", "UncertainInput", "UnmixedSubject",
    "World", "band_error_covariance", "correlation", "drawn_truths", "evaluations", "every_path",
    "fill_distribution", "geometry_of", "inputs_of", "labelled", "number_input", "pixels_of_object", "predict",
    "predicted_areas", "predicted_classification", "predictions", "read", "reads_again", "settled", "spectral_input",
    "together", "value_at", "with_truths", "with_values", "without_calibration_error",
]  # fmt: skip
