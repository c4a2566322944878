"""What a collection opens to, and what cannot be observed."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import yaml
from affine import Affine
from rasterio.crs import CRS
from scipy import ndimage
from small_world import AXIS, LINES, PLANTED, SAMPLES, near_targets

from hyperval.collection import Classification, CollectionSection
from hyperval.errors import InputError, UsageError
from hyperval.imagery import write_cube
from hyperval.observe import open_place

# Opening a collection: regions and truth of every kind, what is left out, places, and the errors of each field.


def mask_file(world, name: str, classes: np.ndarray) -> str:
    write_cube(world.folder / name, classes[:, :, None].astype(float), data_type=1)
    return name


def planted() -> np.ndarray:
    out = np.zeros((LINES, SAMPLES), int)
    out[tuple(zip(*PLANTED, strict=True))] = 1
    return out


def drawn(world, *sources: dict, **more) -> None:
    world.collection["targets"] = {"regions": [{"material": "paint", **s} for s in sources], **more}
    world.detection["group"] = "{material}"


@pytest.mark.parametrize(("radius", "pixels"), [(0, 1), (1, 5), (2, 13)])
def test_targets_and_their_guard_are_left_out_of_the_scene(world, radius, pixels):
    world.collection["targets"]["guard_pixels"] = radius
    place = world.place()
    assert near_targets(radius).sum() == pixels * len(PLANTED)
    assert np.array_equal(place.near_targets, near_targets(radius))
    assert np.array_equal(place.pixels_of("scene"), ~near_targets(radius))
    assert place.pixels_of("image").all()


def test_a_mistake_moves_values_bands_targets_and_regions(world):
    world.regions(corner=[35, 5, 10, 20], b=[2, 30, 4, 4])
    seen = world.observe().place
    away = {"lines": 1, "samples": -2}
    mistakes = ({"gain": 0.1, "offset": 0.05}, away, away | {"regions": 1}, away | {"regions": 1, "still": ["b"]})
    wrong, beside, elsewhere, alone, other = map(seen.with_injected_error, (*mistakes, {"exchanged": ["corner", "b"]}))
    level = 0.05 * seen.statistics["scene"].mean.mean()
    assert wrong.cube.read(0, 3).values == pytest.approx(1.1 * seen.cube.read(0, 3).values + level)
    stretched = open_place(CollectionSection.model_validate(world.collection), world.resolve, {"nm": 2.0, "scale": 0.1})
    assert np.diff(stretched.cube.axis.centre_nm) == pytest.approx(1.1 * np.diff(seen.cube.axis.centre_nm))
    assert stretched.cube.axis.centre_nm.mean() == pytest.approx(seen.cube.axis.centre_nm.mean() + 2.0)
    assert np.array_equal(elsewhere.region("corner"), np.roll(seen.region("corner"), (1, -2), (0, 1)))
    for was, one, name in ((seen, beside, "corner"), (elsewhere, alone, "corner"), (seen, alone, "b")):
        assert np.array_equal(one.region(name), was.region(name))
    assert np.array_equal([other.region("b"), other.region("corner")], [seen.region("corner"), seen.region("b")])
    at = [place.targets[0].corner for place in (seen, alone, beside)]
    assert at == [at[0], at[0], tuple(np.add(at[0], (1, -2)))]
    assert np.array_equal(beside.near_targets, np.roll(seen.near_targets, (1, -2), (0, 1)))


def test_regions_are_left_out_where_named_and_keep_clear_of_targets(world):
    world.regions(corner=[35, 5, 10, 20], around=[8, 8, 4, 4])
    place = world.place()
    corner = np.zeros((LINES, SAMPLES), bool)
    corner[35:45, 5:25] = True
    assert np.array_equal(place.region("corner"), corner)
    assert [place.pixels_of(*names).sum() for names in (["around"], ["around", "corner"])] == [16 - 5, 11 + 200]
    world.collection["leave_out"] = ["corner"]
    assert np.array_equal(world.place().pixels_of("scene"), ~near_targets() & ~corner)
    world.collection["leave_out_guard_pixels"] = 1
    place, grown = world.place(), ndimage.binary_dilation(corner)
    assert np.array_equal(place.pixels_of("scene"), ~near_targets() & ~grown)
    assert np.array_equal(place.pixels_of("corner"), corner)  # has statistics of its own


def test_normalised_difference_equals_numpy(world):
    rule = {"high_nm": [780, 880], "low_nm": [650, 690], "above": 0.75, "below": 0.79}
    world.regions({"name": "green", "normalized_difference": rule})
    # The reader gives float32 here; pixels that lie on a limit to its precision may fall either way.
    high, low = (world.values[..., b].astype(np.float32).astype(float).mean(axis=-1) for b in ([4, 5], [2, 3]))
    index = (high - low) / (high + low)
    assert min(np.abs(index - limit).min() for limit in (0.75, 0.79)) > 1e-9
    mask = world.place().region("green")
    assert np.array_equal(mask, (index >= 0.75) & (index < 0.79))
    assert 0 < mask.sum() < mask.size


FIELD = {"name": "field", "rectangle": [35, 5, 10, 20]}


def test_halves_share_no_pixel_and_are_cut_across_the_longer_side(world):
    halves = [{"name": which, "half": {"of": "field", "which": which}} for which in ("first", "second")]
    world.regions(FIELD, *halves)
    place = world.place()
    first, second = place.region("first"), place.region("second")
    assert not (first & second).any()
    assert np.array_equal(first | second, place.region("field"))
    assert np.argwhere(first)[:, 1].max() == 14  # samples 5 to 24 are the longer side


def test_a_ring_is_what_lies_between_two_distances(world):
    """Against distances from every pixel of the region, one by one; lines 4 m apart, samples 1 m."""
    world.write(transform=Affine(1.0, 0, 500000.0, 0, -4.0, 4700000.0))
    near = {"name": "near", "ring": {"of": "field", "outer_pixels": 1.5}}
    world.regions(FIELD, {"name": "around", "ring": {"of": "field", "inner_m": 3.0, "outer_m": 11.0}}, near)
    place = world.place()
    inside, every = np.argwhere(place.region("field")), np.argwhere(np.ones((LINES, SAMPLES), bool))
    for name, pixel, inner, outer in (("around", (4.0, 1.0), 3.0, 11.0), ("near", (1.0, 1.0), 0.0, 1.5)):
        apart = (every[:, None] - inside[None]) * np.array(pixel)
        distance = np.sqrt((apart**2).sum(axis=-1).min(axis=1)).reshape(LINES, SAMPLES)
        assert np.array_equal(place.region(name), (distance > inner) & (distance <= outer))
    world.write(transform=None, crs=None)
    world.collection["targets"] = None
    with pytest.raises(UsageError, match=r"ground size of a pixel is not known(?s:.*)give inner_pixels"):
        world.place()


def test_a_file_gives_its_regions_or_one_of_them(world):
    source = world.squares("rois.geojson", a=(0, 0, 4), b=(10, 10, 2))
    world.regions(source)
    assert {n: int(m.sum()) for n, m in world.place().regions.items()} == {"a": 16, "b": 4}
    world.regions({**source, "name": "b"})
    assert list(world.place().regions) == ["b"]
    world.regions({**source, "name": "c"})
    with pytest.raises(InputError, match=r"rois\.geojson: no region 'c' among a, b"):
        world.place()


def test_notes_of_regions(world):
    """Pixels shared, holes, what leaves the image, targets inside, and the words of the header."""
    ring, hole = [[30, 5], [50, 5], [50, 15], [30, 15], [30, 5]], [[32, 7], [35, 7], [35, 9], [32, 9], [32, 7]]
    world.text("rois.geojson", f'{{"type":"Polygon","coordinates":[{ring},{hole}]}}')
    world.regions(
        {"file": "rois.geojson", "coordinates": "pixel", "name": "court"},
        **{"ground": [30, 15, 10, 10], "on target": [10, 10, 1, 1], "overlap": [39, 15, 10, 3]},
    )
    world.write(extra={"calculated co2 shift": "3.65"})
    place = world.place()
    touched = np.logical_or.reduce([t.mask for t in place.targets])
    ground = place.region("ground")
    inside, guarded = int((ground & touched).sum()), int((ground & place.near_targets).sum())
    assert 0 < inside < guarded < 100
    expected = (
        "the regions 'ground' and 'overlap' share 3 pixels",
        # 200 - 6 pixels in all, 100 - 6 inside.
        "warning: the region 'court' leaves the image: 51.5 % of its area is outside, 94 pixels are left",
        "the region 'court' has a hole of 6 pixels, which are not part of it",
        f"the region 'ground' holds {inside} pixels of targets and {guarded - inside} of their guard among 100: "
        "left out of its statistics",
        "warning: the region 'on target' holds 1 pixels of targets and 0 of their guard, which is all of it: they "
        "stay in its statistics",
    )
    assert set(expected) <= set(place.notes)
    assert not any("'overlap' holds" in note for note in place.notes)
    assert any("CO2 shift 3.65 nm found" in note for note in place.notes)


def test_targets_that_touch_the_same_pixel_are_counted(world):
    rows = "name,material,group,row0,col0,side_m\na,paint,x,10,10,1\nb,paint,x,10,10,1\n"
    world.text("targets.csv", rows)
    assert "1 pixels may hold parts of more than one target" in world.place().notes
    world.text("targets.csv", rows.replace("b,paint", "b,cloth"))
    assert "1 pixels may hold parts of more than one target: 1 of 'paint' and 'cloth'" in world.place().notes


def test_a_cube_without_a_map_takes_the_stated_pixel_size(world):
    placed = [t.mask.sum() for t in world.place().targets]
    degrees = Affine(2e-5, 0, -77.0, 0, -2e-5, 43.0)
    for transform, crs in ((None, None), (degrees, CRS.from_epsg(4326))):
        world.collection["targets"].pop("pixel_size_m", None)
        world.write(transform=transform, crs=crs)
        with pytest.raises(UsageError, match=r"ground size of a pixel is not known.*\n.*targets\.pixel_size_m"):
            world.place()
        world.collection["targets"]["pixel_size_m"] = 2.0
        opened = world.place()
        assert (opened.pixel_area_m2, [t.mask.sum() for t in opened.targets]) == (4.0, placed)
    world.write()
    with pytest.raises(UsageError, match=r"has a map position, and 'targets\.pixel_size_m' is stated"):
        world.place()


def test_a_map_in_feet_gives_targets_of_the_same_size(world):
    world.text("targets.csv", "material,row0,col0,side_m\npaint,10,10,7\n")  # 3.5 pixels
    in_metres = world.place()
    foot = 1200.0 / 3937.0  # [m] US survey foot
    world.write(transform=Affine(2.0 / foot, 0, 500000.0, 0, -2.0 / foot, 1000000.0), crs=CRS.from_epsg(2261))
    place = world.place()
    assert place.pixel_area_m2 == pytest.approx(4.0)
    assert np.array_equal(place.targets[0].mask, in_metres.targets[0].mask)
    assert place.targets[0].mask.sum() == 25


def test_a_mask_alone_finds_what_a_list_of_the_same_pixels_finds(world):
    world.detection["group"] = "{material}"
    listed = world.observe()
    drawn(world, {"file": mask_file(world, "mask.img", planted())})
    found = world.observe()
    assert [o.name for o in found.place.targets] == [f"mask {i}" for i in range(1, len(PLANTED) + 1)]
    for key in (("paint", "cem", "pixel"), ("paint", "cem", "object")):
        assert np.array_equal(found.observation.roc[key].pd, listed.observation.roc[key].pd)
    assert np.array_equal(found.place.pixels_of("scene"), listed.place.pixels_of("scene"))


def test_touching_pixels_are_one_object_unless_each_region_is_one(world):
    classes = np.zeros((LINES, SAMPLES), int)
    classes[5:7, 5:7] = classes[7, 7] = 1  # the last by its corner
    classes[20, 20] = classes[30, 30] = 2
    drawn(world, {"file": mask_file(world, "c.img", classes), "side_m": 2.0})
    assert [(o.name, int(o.part.sum())) for o in world.place().targets] == [("c-1", 5), ("c-2 1", 1), ("c-2 2", 1)]
    drawn(world, {"file": "c.img", "objects": "regions", "side_m": 2.0})
    one, two = world.place().targets
    assert (two.name, int(two.mask.sum()), two.area_m2, dict(two.attributes)) == (
        "c-2", 2, 4.0, {"material": "paint", "region": "c-2", "pixels": "2", "side_m": "2"}
    )  # fmt: skip
    assert one.window == (slice(5, 8), slice(5, 8))
    drawn(world, {"file": "c.img", "regions": ["*-2"]})
    assert [o.name for o in world.place().targets] == ["c-2 1", "c-2 2"]


def test_a_polygon_has_every_pixel_it_touches_and_one_that_is_cut_a_warning(world):
    # The second one holds no pixel's centre and lies on a corner of four pixels.
    drawn(world, world.squares("truth.geojson", large=(4, 6, 3), small=(19.9, 29.9, 0.2), cut=(-2, 6, 4)))
    place = world.place()
    large, small, cut = place.targets
    assert np.argwhere(small.mask).tolist() == [[29, 19], [29, 20], [30, 19], [30, 20]]
    assert large.mask[6:9, 4:7].all()
    assert np.isnan(small.side_m)
    assert small.centre_pixel is None
    assert cut.mask.sum() > 0
    warning = next(n for n in place.notes if n.startswith("warning") and "targets" in n)
    assert "the region 'cut' leaves the image: 50.0 % of its area is outside" in warning


def test_names_that_are_not_there_or_stand_twice_are_refused(world):
    file = mask_file(world, "mask.img", planted())
    drawn(world, {"file": file, "regions": ["plank*"]})
    with pytest.raises(UsageError, match=r"mask\.img: no region 'plank\*'"):
        world.place()
    drawn(world, {"file": file}, {"file": file, "material": "cloth"})
    assert {o.name for o in world.place().targets} >= {"mask 1", "cloth mask 1"}
    drawn(world, {"file": file}, {"file": file})
    with pytest.raises(UsageError, match="two targets are named 'mask 1'"):
        world.place()


def test_where_no_size_is_known_no_area_is_compared(world):
    drawn(world, {"file": mask_file(world, "mask.img", planted())})
    world.detection["areas"] = [{"target": "paint", "detector": "cem"}]
    found = world.observe()
    assert ("paint", "cem") in found.observation.abundance
    assert not found.detected.nominal_area_m2
    world.detection["unmixing"] = {"background": "corner", "targets": [{"target": "paint"}]}
    with pytest.raises(UsageError, match="does not state the size of the targets of 'paint'"):
        world.observe()
    del world.detection["unmixing"]
    drawn(world, {"file": "mask.img", "side_m": 2.0})
    assert world.observe().detected.nominal_area_m2 == {("paint", "cem"): 4.0}


def test_rasters_of_materials_and_sizes_are_truth_and_areas_need_a_ground_size(world):
    write_cube(world.folder / "cube.img", world.values, data_type=5, axis=AXIS)
    for name in ("sizes.img", "paint.img"):
        write_cube(world.folder / name, planted()[..., None], data_type=1)
    world.collection["targets"] = {
        "rasters": {"materials": {"paint": "paint.img"}, "size_classes": "sizes.img", "side_m": {1: 0.5}}
    }
    world.detection |= {"group": "{material} {side_m} m", "areas": [{"target": "paint", "detector": "cem"}]}
    with pytest.raises(UsageError, match="areas need the ground area of a pixel"):
        world.observe()
    world.detection["areas"] = []
    observation = world.observe().observation
    assert observation.scores["paint 0.5 m", "cem"].n == 5
    assert observation.roc["paint 0.5 m", "cem", "pixel"].background_area_km2 is None


def test_regions_that_overlap_are_classes_of_their_own(world):
    """Pixels of the same regions are of one class: of two rectangles that overlap, and the rest, four."""
    world.regions(one=[0, 0, 20, 20], two=[10, 10, 20, 20])
    place = world.place()
    one, two = (place.region(name) for name in ("one", "two"))
    found = {(bool(a), bool(b)): set(place.classes[(one == a) & (two == b)]) for a in (0, 1) for b in (0, 1)}
    assert all(len(numbers) == 1 for numbers in found.values())
    assert set.union(*found.values()) == {0, 1, 2, 3}


# What a collection states wrongly, or what its files lack, is refused in words: the cases of ``refusals.yaml``.


CASES = yaml.safe_load((Path(__file__).parent / "refusals.yaml").read_text("utf-8"))
ERRORS = {error.__name__: error for error in (InputError, UsageError, ValueError)}


def changed(settings: Any, change: Any) -> Any:
    """Settings of which some entries are others; an empty entry takes the place of what stood there."""
    if not (isinstance(settings, dict) and isinstance(change, dict) and change):
        return change
    return settings | {key: changed(settings.get(key), value) for key, value in change.items()}


TAKEN = yaml.safe_load(Path(__file__).with_name("taken.yaml").read_text())


@pytest.mark.parametrize(("fixture", "change"), [(name, case) for name, cases in TAKEN.items() for case in cases])
def test_what_no_shipped_campaign_has_is_taken(request, fixture, change):
    world = request.getfixturevalue(fixture)
    world.squares("drawn.geojson", p1=(4, 6, 3), p2=(20, 20, 2), other=(30, 30, 4))
    world.text("lawn.csv", "wavelength,first,second\n" + "".join(f"{1e-3 * w},1,2\n" for w in range(400, 1701)))
    if world.values.ndim == 3:
        image = xr.DataArray(world.values, dims=("line", "sample", "wavelength"), attrs={"units": "1"})
        waves = xr.DataArray(AXIS.centre_nm, dims="wavelength", attrs={"units": "nm"})
        xr.Dataset({"first": image, "second": image}, {"wavelength": waves}).to_netcdf(world.folder / "cube.nc")
        places = np.stack(np.indices((LINES, SAMPLES))[::-1] * 1e-5 + 42.0, axis=-1)
        write_cube(world.folder / "places.img", places, data_type=5)
    task = change.pop("classification", None)
    for part, entries in change.items():
        setattr(world, part, changed(getattr(world, part), entries))
    assert world.observe(classification=task and Classification.model_validate(task)).observation.axis


@pytest.mark.parametrize(
    ("fixture", "change", "error", "words"), [(name, *case) for name, cases in CASES.items() for case in cases]
)
def test_what_cannot_be_observed_is_refused_in_words(request, fixture, change, error, words):
    world = request.getfixturevalue(fixture)
    for name, content in change.pop("files", {}).items():
        world.resolve(name).unlink()
        if content is not None:
            world.text(name, content)
    for part, entries in change.items():
        setattr(world, part, changed(getattr(world, part), entries))
    with pytest.raises(ERRORS[error], match=words):
        world.observe()
