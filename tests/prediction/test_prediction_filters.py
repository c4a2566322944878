"""Filters of many settings: what one leaves in memory does not reach the next; matrices without an inverse."""

import numpy as np
import pytest

from hyperval.errors import UsageError
from hyperval.prediction.background import Settings, View, ground_of, seen_classes
from hyperval.prediction.filters import Designer
from hyperval.prediction.inputs import SurfaceStatistics
from hyperval.scenario import Processing

B, CLASSES = 5, ["soil", "grass"]


def surfaces(spread: np.ndarray) -> dict[str, SurfaceStatistics]:
    means = {"soil": np.linspace(0.1, 0.3, B), "grass": np.linspace(0.05, 0.5, B) ** 2}
    return {n: SurfaceStatistics(n, m, (1 + i) * spread, "made") for i, (n, m) in enumerate(means.items())}


def spread(seed: int = 0) -> np.ndarray:
    a = np.random.default_rng(seed).normal(0.0, 0.02, (B, 3 * B))
    return a @ a.T


def reflectance_domain(fractions: np.ndarray, of: dict[str, SurfaceStatistics]) -> Settings:
    u = len(fractions)
    first = ground_of(of, CLASSES, fractions[0])
    grounds = (first, *(ground_of(of, CLASSES, f) for f in fractions[1:]))
    view = View(None, np.array([g.average for g in grounds])[:, None, :], None, 0.1, "corrected", None)
    return Settings(view, fractions, np.ones((u, 2)), grounds, np.arange(u)).at(np.arange(B), CLASSES)


def test_filters_do_not_depend_on_the_settings_before():
    fractions = np.array([[0.7, 0.3], [0.7, 0.3], [0.2, 0.8], [1.0, 0.0]])
    wanted = np.broadcast_to(np.linspace(0.6, 0.4, B), (4, B))
    detectors = ("cem", "cem-correlation", "smf")

    def weights(rows: list[int]) -> list[np.ndarray]:
        at = reflectance_domain(fractions[rows], surfaces(spread()))
        pairs = [(d, wanted[rows]) for d in detectors]
        filters, problems = Designer(Processing(), CLASSES, B).design(at, seen_classes(at), pairs)
        assert not problems
        return [f.weights for f in filters]

    together, backwards = weights([0, 1, 2, 3]), weights([3, 2, 1, 0])
    for d in range(len(detectors)):
        np.testing.assert_array_equal(together[d], backwards[d][::-1])
        for u in range(4):
            np.testing.assert_array_equal(together[d][u], weights([u])[d][0])


def test_variances_of_the_surroundings_are_the_diagonal():
    ground = reflectance_domain(np.array([[0.7, 0.3]]), surfaces(spread())).grounds[0]
    assert ground.variances() == pytest.approx(np.diag(ground.covariance), rel=1e-13)


def test_a_background_without_an_inverse_is_refused_and_the_next_one_is_right():
    copied = spread()
    copied[1], copied[:, 1] = copied[0], copied[:, 0]
    copied[1, 1] = copied[0, 0]
    singular = surfaces(copied)
    for s in singular.values():
        s.mean[1] = s.mean[0]
    wanted = np.linspace(0.6, 0.4, B)[None]
    designer = Designer(Processing(), CLASSES, B)

    def design(of: dict[str, SurfaceStatistics]):
        at = reflectance_domain(np.array([[0.7, 0.3]]), of)
        return designer.design(at, seen_classes(at), [("cem", wanted)])

    alone = design(surfaces(spread()))[0][0].weights
    filters, problems = design(singular)
    assert isinstance(problems[0], UsageError)
    assert "rank 4 of 5 bands" in str(problems[0])
    assert np.isnan(filters[0].weights).all()
    again, problems = design(surfaces(spread()))
    assert not problems
    np.testing.assert_array_equal(again[0].weights, alone)
