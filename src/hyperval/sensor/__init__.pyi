"""Sensor specification, response and noise (3.13-3.20)."""

from .noise import (
    NoiseBreakdown,
    NoiseModel,
    RecordedNoise,
    bit_error_variance,
    calibration_variance,
    detector_radiance_variance,
    detector_variance,
    measured_noise_variance,
    quantisation_variance,
    recorded_noise,
    shot_variance,
    signal_to_noise,
    with_signal,
)
from .response import (
    ELECTRONS_PER_UNIT,
    aperture_throughput,
    electrons_per_radiance,
    f_number_throughput,
    modulation_transfer,
    mtf_at_nyquist,
    psf_fwhm_from_mtf,
    solid_angle,
)
from .specification import (
    Arm,
    Bands,
    Blur,
    PublishedSnr,
    Quantity,
    ReferenceScene,
    Sensor,
    SensorChanges,
    SensorOperation,
    SensorSpecification,
    SpectralShift,
    Throughput,
    averaged_noise,
    binned_axis,
    binned_noise,
    changed_noise,
    library_names,
    load_sensor,
    new_sensor_file,
)

__all__ = [
    "ELECTRONS_PER_UNIT", "Arm", "Bands", "Blur", "NoiseBreakdown", "NoiseModel", "PublishedSnr", "Quantity",
    "RecordedNoise", "ReferenceScene", "Sensor", "SensorChanges", "SensorOperation", "SensorSpecification",
    "SpectralShift", "Throughput", "aperture_throughput", "averaged_noise", "binned_axis", "binned_noise",
    "bit_error_variance", "calibration_variance", "changed_noise", "detector_radiance_variance",
    "detector_variance", "electrons_per_radiance", "f_number_throughput", "library_names", "load_sensor",
    "measured_noise_variance", "modulation_transfer", "mtf_at_nyquist", "new_sensor_file", "psf_fwhm_from_mtf",
    "quantisation_variance", "recorded_noise", "shot_variance", "signal_to_noise", "solid_angle", "with_signal",
]  # fmt: skip
