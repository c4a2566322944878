"""Prediction against observation: spectra, covariances, detection; and what the rows conclude."""

from .covariance import (
    MAX_EIGENVALUES,
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
    compare_with_range,
    detectable_departures,
    detectable_share,
    judge_rows,
    mark_fitted,
    outcome_of,
    tail_probability,
)
from .products import SPREAD, compare_products, product_rows
from .rows import COMPARISON, difference_interval, named, row, short_label, skip_rows
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
    "COMPARISON", "EVERY_OBJECT", "MAX_EIGENVALUES", "SPREAD", "ChiSquare", "Gate", "Sampled", "alarm_rows",
    "chi_square_diagonal", "chi_square_full", "chi_square_shape", "comparable_bands", "compare_abundance",
    "compare_area_errors", "compare_classification", "compare_covariance", "compare_distribution",
    "compare_exceedance", "compare_jointly", "compare_object_scores", "compare_products", "compare_roc",
    "compare_scores", "compare_spectra", "compare_with_range", "covariance_dof", "detectable_departures",
    "detectable_share", "detectable_tilts", "difference_interval", "distance_from_uniform", "drift", "equivalence",
    "far_at_detection_rows", "in_central_95", "independent_pixels", "judge_rows", "judged_together", "mark_fitted",
    "named", "outcome_of", "probability_integral_transform", "product_rows", "regions", "row", "sampled",
    "share_inside", "short_label", "skip_rows", "spectral_angle_degrees", "summary_intervals", "tail_probability",
    "whitening", "would_decide", "z_scores",
]  # fmt: skip
