"""Truth that is drawn as regions: masks, polygons, single objects of a size that nobody states."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from small_world import LINES, PLANTED, SAMPLES

from hyperval.collection import CollectionSection
from hyperval.collection_files import TargetTruth
from hyperval.errors import UsageError
from hyperval.imagery import write_cube
from hyperval.observe import open_place


def opened(world):
    return open_place(CollectionSection.model_validate(world.collection), world.resolve, show_progress=False)


def mask_file(world, name: str, classes: np.ndarray) -> str:
    write_cube(world.folder / name, classes[:, :, None].astype(float), data_type=1)
    return name


def planted() -> np.ndarray:
    out = np.zeros((LINES, SAMPLES), int)
    for line, sample in PLANTED:
        out[line, sample] = 1
    return out


def drawn(world, *sources: dict, **more) -> None:
    world.collection["targets"] = {"regions": [{"material": "paint", **s} for s in sources], **more}
    world.detection["group"] = "{material}"


def polygons(world, shapes: dict[str, tuple[float, float, float]]) -> str:
    """Squares by name: (sample, line) of the corner and side, in pixels."""
    features = ",".join(
        f'{{"type":"Feature","properties":{{"name":"{n}"}},"geometry":{{"type":"Polygon","coordinates":'
        f"[[[{x},{y}],[{x + s},{y}],[{x + s},{y + s}],[{x},{y + s}],[{x},{y}]]]}}}}"
        for n, (x, y, s) in shapes.items()
    )
    return world.text("truth.geojson", f'{{"type":"FeatureCollection","features":[{features}]}}')


def test_a_mask_alone_is_truth_enough_and_finds_what_a_list_of_the_same_pixels_finds(world):
    world.detection["group"] = "{material}"
    listed = world.observe()
    drawn(world, {"file": mask_file(world, "mask.img", planted())})
    found = world.observe()
    assert [o.name for o in found.place.targets] == [f"mask {i}" for i in range(1, len(PLANTED) + 1)]
    for key in (("paint", "cem", "pixel"), ("paint", "cem", "object")):
        assert np.array_equal(found.observation.roc[key].pd, listed.observation.roc[key].pd)
    assert np.array_equal(found.place.background(["scene"]), listed.place.background(["scene"]))


def test_touching_pixels_are_one_object_unless_each_region_is_one(world):
    classes = np.zeros((LINES, SAMPLES), int)
    classes[5:7, 5:7] = 1
    classes[7, 7] = 1  # by its corner
    classes[20, 20], classes[30, 30] = 2, 2
    drawn(world, {"file": mask_file(world, "c.img", classes), "side_m": 2.0})
    assert [(o.name, int(o.part.sum())) for o in opened(world).targets] == [("c-1", 5), ("c-2 1", 1), ("c-2 2", 1)]
    drawn(world, {"file": "c.img", "objects": "regions", "side_m": 2.0})
    one, two = opened(world).targets
    assert (two.name, int(two.mask.sum()), two.area_m2, dict(two.attributes)) == (
        "c-2", 2, 4.0, {"material": "paint", "region": "c-2", "pixels": "2", "side_m": "2"}
    )  # fmt: skip
    assert one.window == (slice(5, 8), slice(5, 8))
    drawn(world, {"file": "c.img", "regions": ["*-2"]})
    assert [o.name for o in opened(world).targets] == ["c-2 1", "c-2 2"]


def test_a_polygon_smaller_than_a_pixel_has_every_pixel_it_touches(world):
    # The second one holds no pixel's centre and lies on a corner of four pixels.
    file = polygons(world, {"large": (4.0, 6.0, 3.0), "small": (19.9, 29.9, 0.2)})
    drawn(world, {"file": file, "coordinates": "pixel"})
    large, small = opened(world).targets
    assert np.argwhere(small.mask).tolist() == [[29, 19], [29, 20], [30, 19], [30, 20]]
    assert large.mask[6:9, 4:7].all()
    assert np.isnan(small.side_m)
    assert small.centre_pixel is None


def test_a_target_that_the_image_cuts_is_a_warning(world):
    drawn(world, {"file": polygons(world, {"cut": (-2.0, 6.0, 4.0)}), "coordinates": "pixel"})
    place = opened(world)
    assert place.targets[0].mask.sum() > 0
    warning = next(n for n in place.notes if n.startswith("warning") and "targets" in n)
    assert "the region 'cut' leaves the image: 50.0 % of its area is outside" in warning


def test_names_that_are_not_there_or_stand_twice_are_refused(world):
    file = mask_file(world, "mask.img", planted())
    drawn(world, {"file": file, "regions": ["plank*"]})
    with pytest.raises(UsageError, match=r"mask\.img: no region 'plank\*'"):
        opened(world)
    drawn(world, {"file": file}, {"file": file, "material": "cloth"})
    assert {o.name for o in opened(world).targets} >= {"mask 1", "cloth mask 1"}
    drawn(world, {"file": file}, {"file": file})
    with pytest.raises(UsageError, match="two targets are named 'mask 1'"):
        opened(world)


def test_where_no_size_is_known_no_area_is_compared(world):
    drawn(world, {"file": mask_file(world, "mask.img", planted())})
    world.detection["areas"] = [{"target": "paint", "detector": "cem"}]
    found = world.observe()
    assert ("paint", "cem") in found.observation.abundance
    assert not found.detected.nominal_area_m2
    world.detection["unmixing"] = {"background": "corner", "targets": [{"target": "paint"}]}
    with pytest.raises(UsageError, match="does not say how large the targets of 'paint' are"):
        world.observe()
    del world.detection["unmixing"]
    drawn(world, {"file": "mask.img", "side_m": 2.0})
    assert world.observe().detected.nominal_area_m2 == {("paint", "cem"): 4.0}


def test_pixel_size_serves_drawn_targets_too(world):
    world.write(transform=None, crs=None)
    drawn(world, {"file": mask_file(world, "mask.img", planted())}, pixel_size_m=2.0)
    assert opened(world).pixel_area_m2 == 4.0
    world.write(transform=Affine(2.0, 0, 500000.0, 0, -2.0, 4700000.0))
    with pytest.raises(UsageError, match=r"targets\.pixel_size_m"):
        opened(world)


def test_a_region_of_the_whole_image_has_the_statistics_of_the_scene(world):
    world.collection["regions"].append({"name": "everything", "whole_image": True})
    found = world.observe()
    pixels = world.values[~found.place.near_targets]
    assert found.place.region("everything").all()
    assert np.allclose(found.statistics["everything"].mean, pixels.mean(axis=0), rtol=1e-12)
    assert np.allclose(found.statistics["everything"].covariance, np.cov(pixels.T), rtol=1e-9)


@pytest.mark.parametrize(
    "given",
    [
        {"regions": [{"material": "a", "file": "f"}], "csv": "t.csv"},
        {"regions": []},
        {"regions": [{"material": "a", "file": "f"}], "pixels": "centre"},
    ],
)
def test_one_kind_of_truth(given):
    with pytest.raises(ValueError, match=r"exactly one of regions, rasters, csv|only a list \(csv\)"):
        TargetTruth.model_validate(given)
