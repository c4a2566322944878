"""Prediction against observation: spectra, covariances, detection; and what the rows conclude."""

from .covariance import (
    MOST_EIGENVALUES,
    Sampled,
    compare_covariance,
    compare_distribution,
    independent_pixels,
    sampled,
)
from .detection import (
    EVERY_OBJECT,
    alarm_rows,
    compare_abundance,
    compare_area_errors,
    compare_classification,
    compare_exceedance,
    compare_object_scores,
    compare_roc,
    compare_scores,
    distance_from_uniform,
    equivalence,
    far_at_detection_rows,
    in_central_95,
    judged_together,
    probability_integral_transform,
)
from .judge import (
    Gate,
    against_range,
    detectable_share,
    detectable_sides,
    judged,
    marked_as_fitted,
    outcome_of,
    tail_probability,
)
from .products import SPREAD, compare_products, product_rows
from .rows import COMPARISON, difference_interval, named, row, scientific, skipped
from .spectra import (
    ChiSquare,
    chi_square_diagonal,
    chi_square_full,
    chi_square_shape,
    comparable_bands,
    compare_jointly,
    compare_spectra,
    covariance_dof,
    detectable_tilts,
    drift,
    regions,
    share_inside,
    spectral_angle_degrees,
    summary_intervals,
    whitening,
    would_decide,
    z_scores,
)

__all__ = [
    "COMPARISON", "EVERY_OBJECT", "MOST_EIGENVALUES", "SPREAD", "ChiSquare", "Gate", "Sampled", "against_range",
    "alarm_rows", "chi_square_diagonal", "chi_square_full", "chi_square_shape", "comparable_bands",
    "compare_abundance", "compare_area_errors", "compare_classification", "compare_covariance", "compare_distribution",
    "compare_exceedance", "compare_jointly", "compare_object_scores", "compare_products", "compare_roc",
    "compare_scores", "compare_spectra", "covariance_dof", "detectable_share", "detectable_sides", "detectable_tilts",
    "difference_interval", "distance_from_uniform", "drift", "equivalence", "far_at_detection_rows", "in_central_95",
    "independent_pixels", "judged", "judged_together", "marked_as_fitted", "named", "outcome_of",
    "probability_integral_transform", "product_rows", "regions", "row", "sampled", "scientific", "share_inside",
    "skipped", "spectral_angle_degrees", "summary_intervals", "tail_probability", "whitening", "would_decide",
    "z_scores",
]  # fmt: skip
