"""The empirical pipeline: from a collection to its products."""

from .detection import (
    anomaly_note,
    target_areas,
    usable_bands,
)
from .pipeline import (
    Observed,
    observe,
)
from .place import (
    Place,
    open_place,
)
from .reflectance_cube import (
    NO_DATA,
    SCALE,
    quantised,
    write_reflectance,
)
from .site_spectra import (
    calibration_covariance,
    detector_covariance,
    empirical_line,
    observe_radcalnet,
    path_estimate,
    read_band_table,
    rounding_variance,
    spectral_estimate,
    wavelength_notes,
)
from .spread import (
    RegionLaws,
)
from .truth_images import (
    FinerGrid,
    abundance_targets,
    fills_of,
    material_regions,
    object_of_fills,
    registration_shifts,
    window_fills,
)

__all__ = [
    "NO_DATA",
    "SCALE",
    "FinerGrid",
    "Observed",
    "Place",
    "RegionLaws",
    "abundance_targets",
    "anomaly_note",
    "calibration_covariance",
    "detector_covariance",
    "empirical_line",
    "fills_of",
    "material_regions",
    "object_of_fills",
    "observe",
    "observe_radcalnet",
    "open_place",
    "path_estimate",
    "quantised",
    "read_band_table",
    "registration_shifts",
    "rounding_variance",
    "spectral_estimate",
    "target_areas",
    "usable_bands",
    "wavelength_notes",
    "window_fills",
    "write_reflectance",
]
