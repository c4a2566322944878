"""Pixel-level scene generator: a simulated collection with its truth, sampled and not derived."""

from hyperval.simulate.collection import SimulatedCollection, simulate, simulate_to_folder
from hyperval.simulate.schema import SceneFile, load_scene

__all__ = ["SceneFile", "SimulatedCollection", "load_scene", "simulate", "simulate_to_folder"]
