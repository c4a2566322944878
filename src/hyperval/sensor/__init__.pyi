"""Sensor specification, response and noise (3.13-3.20)."""

from .noise import NoiseBreakdown, NoiseModel, RecordedNoise, recorded_noise, with_signal
from .response import (
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
    binned_axis,
    binned_noise,
    changed_noise,
    library_names,
    load_sensor,
    new_sensor_file,
)

__all__ = [
    "Arm", "Bands", "Blur", "NoiseBreakdown", "NoiseModel", "PublishedSnr", "Quantity", "RecordedNoise",
    "ReferenceScene", "Sensor", "SensorChanges", "SensorOperation", "SensorSpecification", "SpectralShift",
    "Throughput", "aperture_throughput", "binned_axis", "binned_noise", "changed_noise", "electrons_per_radiance",
    "f_number_throughput", "library_names", "load_sensor", "modulation_transfer", "mtf_at_nyquist", "new_sensor_file",
    "psf_fwhm_from_mtf", "recorded_noise", "solid_angle", "with_signal",
]  # fmt: skip
