"""Filters of many truths: what one leaves in memory does not reach the next; matrices without an inverse."""

import numpy as np
import pytest

from hyperval.data import ClassStatistics
from hyperval.model import Evaluation, Origins, World, read, with_values
from hyperval.scenario import Scenario
from hyperval.spectra import SpectralAxis

B, CLASSES, DETECTORS = 5, ("soil", "grass"), ("cem", "cem-correlation", "smf")
AXIS = SpectralAxis(np.linspace(450.0, 850.0, B), np.full(B, 10.0))
MEANS = {"soil": np.linspace(0.1, 0.3, B), "grass": np.linspace(0.05, 0.5, B) ** 2, "paint": np.linspace(0.6, 0.4, B)}


def spread(seed: int = 0) -> np.ndarray:
    a = np.random.default_rng(seed).normal(0.0, 0.02, (B, 3 * B))
    return a @ a.T


def world(fractions: np.ndarray, covariance: np.ndarray, means: dict[str, np.ndarray] = MEANS) -> World:
    """Truths of area fractions (U, 2) in the reflectance domain."""
    measured = {n: ClassStatistics(n, AXIS, m, (1 + i) * covariance, 99) for i, (n, m) in enumerate(means.items())}
    scenario = Scenario.model_validate({
        "name": "s",
        "scene": {
            "classes": [{"name": n, "fraction": 0.5, "spectrum": {"measured": n}} for n in CLASSES],
            "targets": [{"name": "paint", "host": "soil", "spectrum": {"measured": "paint"}, "fill": {"fixed": 0.1}}],
        },
        "processing": {"detectors": list(DETECTORS), "elm": "none"},
    })  # fmt: skip
    moved = {f"scene.classes.{n}.fraction": fractions[:, m] for m, n in enumerate(CLASSES)}
    return with_values(read(scenario, Origins(AXIS, measured)), moved)


def test_a_background_without_an_inverse_is_refused_and_the_next_one_is_right():
    copied = spread()
    copied[1], copied[:, 1] = copied[0], copied[:, 0]
    copied[1, 1] = copied[0, 0]
    same = {n: np.where(np.arange(B) == 1, m[0], m) for n, m in MEANS.items()}
    fractions = np.array([[0.7, 0.3]])
    alone = Evaluation(world(fractions, spread())).filters["paint", "cem"][0].weights
    singular = Evaluation(world(fractions, copied, same))
    assert np.isnan(singular.filters["paint", "cem"][0].weights).all()
    assert "rank 4 of 5 bands" in str(singular.problems[0])
    again = Evaluation(world(fractions, spread()))
    np.testing.assert_array_equal(again.filters["paint", "cem"][0].weights, alone)
    mean = fractions[0] @ [MEANS[n] for n in CLASSES]
    assert alone[0] @ (MEANS["paint"] - mean) == pytest.approx(1.0, rel=1e-9)
