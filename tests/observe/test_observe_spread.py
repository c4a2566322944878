"""Tails, classification and unmixing of a small collection with known truth."""

from __future__ import annotations

import numpy as np
import pytest
from small_world import BANDS, LINES, SAMPLES, TARGET, background_spread

from hyperval.collection import Classification, CollectionSection
from hyperval.errors import UsageError
from hyperval.observe import observe


def field(dof, seed=3, lines=60, samples=60):
    rng = np.random.default_rng(seed)
    z = rng.multivariate_normal(np.zeros(BANDS), background_spread(), (lines, samples))
    if np.isfinite(dof):
        z *= np.sqrt((dof - 2) / rng.chisquare(dof, (lines, samples)))[..., None]
    return 0.3 + z


@pytest.mark.parametrize("dof", [6.0, np.inf])
def test_tails_of_a_region(world, dof):
    world.write(field(dof))
    world.detection, world.collection["targets"] = None, None
    world.collection["regions"] = [{"name": "all", "rectangle": [0, 0, 60, 60]}]
    found = world.observe().observation.distribution["all"]
    # Seed fixed; the interval misses in one of twenty seeds.
    assert found.tail_lower <= dof <= found.tail_upper
    # In components chosen for the spread of these very pixels tails come out 3 % too heavy, give or take 3 %.
    assert 1 / found.leading_tail_dof == pytest.approx(1 / dof, abs=0.025)
    assert (found.normality_p_value < 1e-6) == np.isfinite(dof)
    assert found.dimension == BANDS
    assert found.effective_n == pytest.approx(np.full(found.effective_n.size, 3600.0), rel=0.05)
    assert np.all(np.diff(found.distance) >= 0)
    assert np.all(np.diff(found.exceedance) <= 0)


def test_pixels_that_are_drawn_together_count_once_for_the_limits_of_tails(world):
    # Each of 20 x 20 pixels of a t law stands 3 x 3 times: the limits are those of 400 pixels, not of 3,600.
    world.detection, world.collection["targets"] = None, None
    world.collection["regions"] = [{"name": "all", "rectangle": [0, 0, 60, 60]}]
    width = {}
    for name, values in (
        ("alone", field(6.0)), ("repeated", np.kron(field(6.0, lines=20, samples=20), np.ones((3, 3, 1))))
    ):  # fmt: skip
        world.write(values)
        found = world.observe().observation.distribution["all"]
        width[name] = 1 / found.tail_lower - 1 / found.tail_upper
    # sqrt(9) = 3 times wider; shape and size of the correlation are themselves found from the pixels.
    assert width["repeated"] / width["alone"] == pytest.approx(3.0, rel=0.35)


def test_pixels_without_correlation_are_all_independent_in_an_image_of_several_windows(world):
    # Windows that lie over each other counted their pairs of pixels twice and more: a seventh was lost here.
    world.detection, world.collection["targets"] = None, None
    world.write(field(np.inf, lines=110, samples=90))
    world.collection["regions"] = [{"name": "all", "rectangle": [0, 0, 110, 90]}]
    found = world.observe().observation.distribution["all"]
    assert found.effective_n == pytest.approx(np.full(found.effective_n.size, 9900.0), rel=0.03)


def test_small_regions_have_no_tails(world):
    world.collection["regions"] = [{"name": "few", "rectangle": [0, 0, 10, 10]}]
    assert world.observe().observation.distribution == {}


def classified(world, **settings):
    task = Classification.model_validate({"classes": ["dark", "bright"], "features": [{"name": "all"}]} | settings)
    collection = CollectionSection.model_validate(world.collection)
    found = observe(collection, None, world.resolve, classification=task, show_progress=False)
    return found.observation.classification


@pytest.fixture
def halves(world):
    """Two classes, one standard deviation of one band apart."""
    values = 0.3 + 0.01 * np.random.default_rng(4).standard_normal((LINES, SAMPLES, BANDS))
    values[:, SAMPLES // 2 :, 2] += 0.02
    world.write(values)
    world.detection, world.collection["targets"] = None, None
    world.collection["regions"] = [
        {"name": "dark", "rectangle": [0, 0, LINES, 20]}, {"name": "bright", "rectangle": [0, 20, LINES, 20]},
    ]  # fmt: skip
    return world


def test_classification_error_of_known_classes(halves):
    found = classified(halves, block_lines=2)["dark / bright", "all"]
    assert found.lower <= 0.158655 <= found.upper  # Phi(-1)
    assert 800 <= found.n <= 1200
    assert found.distance == pytest.approx(0.5, abs=0.15)
    blind = classified(halves, features=[{"name": "one", "bands_nm": [870]}])["dark / bright", "one"]
    assert blind.error == pytest.approx(0.5, abs=0.06)
    assert classified(halves, seed=1) != classified(halves)
    assert classified(halves) == classified(halves)


def test_classification_refuses_what_it_cannot_split(halves):
    with pytest.raises(UsageError, match="one block of 100 lines"):
        classified(halves, block_lines=100)
    with pytest.raises(UsageError, match="no region 'wood'"):
        classified(halves, classes=["dark", "wood"])


@pytest.fixture
def unmixing(world):
    """The five targets of the world, unmixed with the background around them."""
    world.collection["regions"] = [{"name": "ground", "rectangle": [0, 0, LINES, SAMPLES]}]
    world.detection["unmixing"] = {"targets": [{"target": "paint", "endmembers": "field"}], "background": "ground",
                                   "weights": ["equal", "background"], "ring_pixels": 5}  # fmt: skip
    return world


def test_areas_by_unmixing(unmixing):
    found = unmixing.observe()
    spectrum = unmixing.on_bands("library.csv", "paint")
    assert spectrum == pytest.approx(TARGET, abs=0.02)
    for method in ("fcls field", "fcls-weighted field"):
        for fill in (0.8, 0.3):
            area = found.observation.abundance[f"fill {fill:g}", method]
            assert area.nominal_m2 == pytest.approx(4.0 * fill)
            # 9 pixels touched, of which one holds the target: its area, and what noise leaves on the others.
            assert area.area_m2 == pytest.approx(4.0 * fill, abs=4 * area.standard_uncertainty + 0.35)
            assert area.standard_uncertainty > 0.0
    weighted = found.observation.abundance["fill 0.3", "fcls-weighted field"]
    assert weighted.standard_uncertainty < found.observation.abundance["fill 0.3", "fcls field"].standard_uncertainty


def test_unmixing_hands_the_prediction_what_it_needs(unmixing):
    unmixed = unmixing.observe().unmixed
    assert [s.subject for s in unmixed.subjects] == ["fill 0.8", "fill 0.3"]
    assert [s.objects for s in unmixed.subjects] == [2, 3]
    assert unmixed.covariances["fcls"] is None
    assert unmixed.covariances["fcls-weighted"].shape == (BANDS, BANDS)
    assert unmixed.pixel_area_m2 == 4.0


@pytest.mark.parametrize(
    ("change", "message"),
    [({"background": "moor"}, "no region 'moor'"), ({"targets": [{"target": "tar"}]}, "no detection target 'tar'")],
)
def test_names_of_unmixing(unmixing, change, message):
    unmixing.detection["unmixing"] |= change
    with pytest.raises(UsageError, match=message):
        unmixing.observe()
