"""The empirical pipeline: from a collection to its products."""

from .detect import map_name, scored_part, target_areas, target_groups
from .measure import Observed, RegionLaws, class_sets, observe, training_pixels
from .open import (
    IMAGE,
    SCENE,
    FinerGrid,
    Place,
    check_line_for_detection,
    image_targets,
    material_regions,
    open_place,
    open_source,
    read_band_table,
    registration_shifts,
    subject_fills,
    target_from_fills,
    window_fills,
)
from .sites import (
    calibration_covariance,
    detector_covariance,
    observe_radcalnet,
    path_estimate,
    rounding_variance,
    spectral_estimate,
    wavelength_notes,
)
from .write import NO_DATA, SCALE, write_reflectance

__all__ = [
    "IMAGE", "NO_DATA", "SCALE", "SCENE", "FinerGrid", "Observed", "Place", "RegionLaws", "calibration_covariance",
    "check_line_for_detection", "class_sets", "detector_covariance", "image_targets", "map_name", "material_regions",
    "observe", "observe_radcalnet", "open_place", "open_source", "path_estimate", "read_band_table",
    "registration_shifts", "rounding_variance", "scored_part", "spectral_estimate", "subject_fills", "target_areas",
    "target_from_fills", "target_groups", "training_pixels", "wavelength_notes", "window_fills", "write_reflectance",
]  # fmt: skip
