"""Halves of a region, covariances across them, and fractions that are counted."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from small_world import AXIS, BANDS

from hyperval.campaign import with_measured_fractions, without_circles
from hyperval.errors import InputError, UsageError
from hyperval.imagery import Region, half_region, pixel_sides_m, ring_region
from hyperval.products import PredictedProducts, SpectralEstimate
from hyperval.scenario import Scenario

FIELD = {"name": "field", "rectangle": [35, 5, 10, 20]}
HALVES = [
    {"name": "left", "half": {"of": "field", "which": "first"}},
    {"name": "right", "half": {"of": "field", "which": "second"}},
]


def test_halves_share_no_pixel_and_are_cut_across_the_longer_side(world):
    world.collection["regions"] = [FIELD, *HALVES]
    world.detection = None
    place = world.observe().place
    left, right = place.region("left"), place.region("right")
    assert not (left & right).any()
    assert np.array_equal(left | right, place.region("field"))
    assert np.argwhere(left)[:, 1].max() == 14  # samples 5 to 24 are the longer side
    assert left.sum() == right.sum() == 100
    long = np.zeros((9, 3), bool)
    long[:, :2] = True
    first = half_region("a", Region("whole", long, "here"), first=True)
    assert np.argwhere(first.mask)[:, 0].tolist() == [0, 0, 1, 1, 2, 2, 3, 3]
    single = np.zeros((3, 3), bool)
    single[1, 1] = True
    with pytest.raises(InputError, match="too small to be halved"):
        half_region("a", Region("dot", single, "here"), first=True)


def test_a_half_of_what_does_not_stand_above_is_refused(world):
    world.collection["regions"] = [*HALVES, FIELD]
    world.detection = None
    with pytest.raises(UsageError, match=r"'left' is half of 'field', which is no region above it"):
        world.observe()


def test_a_ring_is_what_lies_between_two_distances(world):
    """Against distances from every pixel of the region, one by one."""
    ring = {"name": "around", "ring": {"of": "field", "inner_m": 3.0, "outer_m": 11.0}}
    cells = {"name": "near", "ring": {"of": "field", "outer_pixels": 1.5}}
    world.collection["regions"] = [FIELD, ring, cells]
    world.detection = None
    place = world.observe().place
    side = place.pixel_area_m2**0.5
    inside = np.argwhere(place.region("field"))
    every = np.argwhere(np.ones(place.cube.shape, bool))
    distance = np.sqrt(((every[:, None] - inside[None]) ** 2).sum(axis=-1).min(axis=1)).reshape(place.cube.shape)
    assert np.array_equal(place.region("around"), (distance * side > 3.0) & (distance * side <= 11.0))
    assert np.array_equal(place.region("near"), (distance > 0.0) & (distance <= 1.5))
    assert place.region("around").sum() > 100


def test_pixels_that_are_not_square_have_two_sides():
    """The transform gives the shape, the area the size: lines 4 m apart, samples 1 m, turned by 30 degrees."""
    turned = Affine.rotation(30.0) @ Affine.scale(0.5, -2.0)
    assert np.allclose(pixel_sides_m(turned, 4.0), (4.0, 1.0))
    assert pixel_sides_m(None, 9.0) == (3.0, 3.0)
    dot = np.zeros((9, 9), bool)
    dot[4, 4] = True
    mask = ring_region("r", Region("dot", dot, "here"), 0.0, 4.0, (4.0, 1.0)).mask
    assert mask[:, 4].tolist() == [False] * 3 + [True, False, True] + [False] * 3
    assert mask[4].tolist() == [True] * 4 + [False] + [True] * 4


@pytest.mark.parametrize(
    ("ring", "match"),
    [
        ({"of": "meadow", "outer_m": 9.0}, "'around' is a ring around 'meadow', which is no region above it"),
        ({"of": "field", "inner_pixels": 500.0, "outer_pixels": 501.0}, "no pixel of the image lies in the ring"),
        ({"of": "field", "inner_m": 9.0, "outer_m": 9.0}, "must exceed the inner one, 9"),
        ({"of": "field", "inner_pixels": 2.0, "outer_m": 9.0}, "one unit"),
        ({"of": "field"}, "exactly one of outer_m, outer_pixels"),
    ],
)
def test_a_ring_that_cannot_be_is_refused(world, ring, match):
    world.collection["regions"] = [FIELD, {"name": "around", "ring": ring}]
    world.detection = None
    with pytest.raises((UsageError, InputError, ValueError), match=match):
        world.observe()


def scenario(classes: list[dict], **scene: object) -> Scenario:
    return Scenario.model_validate({"name": "s", "scene": {"classes": classes, **scene}, "schema": 1})


def test_a_covariance_of_other_pixels_is_evidence_and_of_its_own_is_not(world):
    world.collection["regions"] = [FIELD, *HALVES]
    world.detection = None
    place = world.observe().place

    def surface(name: str, region: str) -> dict:
        return {"name": name, "spectrum": {"constant": 0.2}, "covariance": {"measured": region}}

    given = scenario(
        [surface("field", "left") | {"fraction": 1.0}], sites=[surface("right", "left"), surface("left", "left")]
    )
    spectra = {n: SpectralEstimate(np.ones(BANDS), np.eye(BANDS), np.eye(BANDS)) for n in ("field", "right", "left")}
    prediction = PredictedProducts(AXIS, reflectance=spectra)
    kept = without_circles(prediction, [given], place).reflectance
    assert {name for name, s in kept.items() if s.pixel_covariance is not None} == {"right"}
    # Where the pixels are not known, every measured covariance counts as the subject's own.
    blind = without_circles(prediction, [given]).reflectance
    assert all(s.pixel_covariance is None for s in blind.values())


def test_fractions_are_those_of_the_pixels_that_count(world):
    corner = {"name": "corner", "rectangle": [5, 5, 10, 20]}  # holds two targets and their guard of one pixel
    world.collection["regions"] = [FIELD, corner]
    place = world.observe().place
    classes = [
        {"name": "field", "fraction": 0.5, "spectrum": {"constant": 0.2}},
        {"name": "elsewhere", "fraction": 0.5, "spectrum": {"measured": "corner"}},
    ]
    stated = scenario(classes)
    assert with_measured_fractions(stated, place) is stated
    counted = with_measured_fractions(scenario(classes, fractions="measured"), place)
    pixels = np.array([200, 200 - 2 * 5])  # a guard of one pixel is a cross
    assert [c.fraction for c in counted.scene.classes] == pytest.approx(list(pixels / pixels.sum()), rel=1e-12)
    classes[0]["name"] = "nowhere"
    with pytest.raises(UsageError, match="class 'nowhere' has no region"):
        with_measured_fractions(scenario(classes, fractions="measured"), place)
    with pytest.raises(UsageError, match="the campaign has no image"):
        with_measured_fractions(scenario(classes, fractions="measured"), None)
