"""Clusters of a region's pixels: as they were drawn, once for each question, and what cannot be fitted."""

from __future__ import annotations

import numpy as np
import pytest
from small_world import BANDS, background_spread

from hyperval.errors import UsageError
from hyperval.scenario import Scenario

AWAY = np.linspace(0.05, -0.08, BANDS)


def clustered(seed=3):
    """60 x 60 pixels, a fifth of them in patches of 3 x 3 whose mean lies off by ``AWAY``."""
    rng = np.random.default_rng(seed)
    patch = np.kron(rng.random((20, 20)) < 0.2, np.ones((3, 3), bool))
    z = rng.multivariate_normal(np.zeros(BANDS), background_spread(), (60, 60))
    return 0.3 + z + patch[..., None] * AWAY, patch


@pytest.fixture
def observed(world):
    values, _ = clustered()
    world.write(values)
    world.detection, world.collection["targets"] = None, None
    world.collection["regions"] = [
        {"name": "all", "rectangle": [0, 0, 60, 60]}, {"name": "corner", "rectangle": [0, 0, 3, 3]}
    ]  # fmt: skip
    return world.observe()


def scenario(*mixtures):
    classes = [
        {"name": f"class {i}", "fraction": 1.0 / len(mixtures), "spectrum": {"measured": "all"}, "mixture": m}
        for i, m in enumerate(mixtures)
    ]
    return Scenario.model_validate({"schema": 1, "name": "a", "scene": {"classes": classes}})


def test_clusters_of_a_region(observed):
    # 720 and 2,880 pixels: means are known to 4 % of a standard deviation, and drawn as such; five of these.
    _, patch = clustered()
    parts = observed.laws().statistics(scenario("auto"))["all"].components
    assert len(parts) == 2
    order = np.argsort(parts.weights)
    assert parts.weights[order] == pytest.approx([patch.mean(), 1.0 - patch.mean()], abs=0.01)
    sd = np.sqrt(np.diag(background_spread()))
    assert np.all(np.abs(parts.offsets[order[0]] - parts.offsets[order[1]] - AWAY) < 0.2 * sd)


def test_pixels_without_data_have_no_part_in_the_clusters_of_their_region(observed, world):
    values, _ = clustered()
    values[2:4, 50] = 0.0
    world.write(values)
    parts = world.observe().laws().statistics(scenario("auto"))["all"].components
    before = observed.laws().statistics(scenario("auto"))["all"].components
    assert parts.weights == pytest.approx(before.weights, abs=0.01)
    assert np.abs(parts.offsets - before.offsets).max() < 0.01


def test_what_a_scenario_asks_for_is_fitted_once(observed):
    regions = observed.laws()
    first = regions.statistics(scenario(2))["all"].components
    assert len(first) == 2
    assert regions.statistics(scenario(2))["all"].components is first
    assert regions.statistics(scenario(1))["all"].components is None
    assert "components" not in str(observed.statistics["all"].source)
    with pytest.raises(UsageError, match="different components of region 'all'"):
        regions.statistics(scenario(2, 3))


def test_too_few_pixels_are_refused_by_name(observed):
    one = (
        scenario(8)
        .scene.classes[0]
        .model_copy(
            update={"spectrum": scenario(8).scene.classes[0].spectrum.model_copy(update={"measured": "corner"})}
        )
    )
    of = scenario(8)
    of.scene.classes[:] = [one]
    with pytest.raises(UsageError, match="8 components of 9 pixels") as caught:
        observed.laws().statistics(of)
    assert "region 'corner'" in str(caught.value)


def test_statistics_without_each_part_of_a_region(observed):
    """Sixteen parts of 225 pixels; what is left out and what is left make the whole; small regions have none."""
    regions = observed.laws()
    ((name, without),) = regions.left_out(scenario(2))
    assert (name, len(without)) == ("all", 16)
    assert without is next(iter(regions.left_out(scenario(2))))[1]
    stated = observed.statistics["all"]
    assert np.mean([s.mean for s in without], axis=0) == pytest.approx(stated.mean, rel=1e-9)
    assert max(np.abs(s.mean - stated.mean).max() for s in without) > 1e-4
    for s in without:
        assert len(s.components) == 2
        assert s.components.covariance == pytest.approx(s.covariance, abs=0.1 * np.abs(s.covariance).max())
