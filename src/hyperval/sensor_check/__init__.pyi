"""Acceptance of a sensor file, and its datasheet."""

from .page import check_to_folder, write_check
from .suite import (
    SensorCheck,
    SensorNumber,
    applied_moments,
    check_sensor,
    electrons_from_energy,
    movable_numbers,
    neighbour_ratio,
    numbers,
    scene_radiance,
    sunlit_radiance,
)

__all__ = [
    "SensorCheck", "SensorNumber", "applied_moments", "check_sensor", "check_to_folder", "electrons_from_energy",
    "movable_numbers", "neighbour_ratio", "numbers", "scene_radiance", "sunlit_radiance", "write_check",
]  # fmt: skip
