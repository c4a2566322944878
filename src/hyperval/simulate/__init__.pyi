"""Pixel-level scene generator: a simulated collection with its truth, sampled and not derived."""

from .collection import Detector, SimulationInputs, detector, field_axis, load_inputs, simulate, simulate_to_folder
from .ground import (
    Sampler,
    SurfaceRenderer,
    admixture_share,
    centred_fill,
    correlated_field,
    lay_out,
    pixel_weights,
    regions,
    side_for_fill,
    square_footprint,
)
from .schema import PaintedArea, SceneFile, load_scene

__all__ = [
    "Detector", "PaintedArea", "Sampler", "SceneFile", "SimulationInputs", "SurfaceRenderer", "admixture_share",
    "centred_fill", "correlated_field", "detector", "field_axis", "lay_out", "load_inputs", "load_scene",
    "pixel_weights", "regions", "side_for_fill", "simulate", "simulate_to_folder", "square_footprint",
]  # fmt: skip
