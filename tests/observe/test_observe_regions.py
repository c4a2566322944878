"""Opening a collection: regions of every kind, what is left out, and the errors of each field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_world import LINES, PLANTED, SAMPLES

from hyperval.campaign import job_of
from hyperval.collection import CollectionSection
from hyperval.errors import InputError, UsageError
from hyperval.observe import open_place


def opened(world):
    return open_place(CollectionSection.model_validate(world.collection), world.resolve, show_progress=False)


def test_a_rectangle_has_the_stated_size(world):
    mask = opened(world).region("corner")
    expected = np.zeros((LINES, SAMPLES), bool)
    expected[35:45, 5:25] = True
    assert np.array_equal(mask, expected)


def test_targets_and_their_guard_ring_are_left_out_of_the_scene(world):
    place = opened(world)
    expected = np.zeros((LINES, SAMPLES), bool)
    for line, sample in PLANTED:
        # Radius 1: the pixel and its four neighbours by edge.
        for dl, ds in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
            expected[line + dl, sample + ds] = True
    assert np.array_equal(place.near_targets, expected)
    assert np.array_equal(~place.background(["scene"]), expected)
    assert np.array_equal(place.background(["scene"]), ~expected)


@pytest.mark.parametrize(("radius", "pixels"), [(0, 1), (1, 5), (2, 13)])
def test_guard_radius(world, radius, pixels):
    world.collection["targets"]["guard_pixels"] = radius
    assert opened(world).near_targets.sum() == pixels * len(PLANTED)


def test_named_regions_are_left_out_of_the_scene(world):
    world.collection["leave_out"] = ["corner"]
    place = opened(world)
    assert np.sum(~place.background(["scene"])) == 5 * len(PLANTED) + 200
    assert place.near_targets.sum() == 5 * len(PLANTED)
    assert not (place.background(["scene"]) & place.region("corner")).any()


def test_background_of_regions_keeps_clear_of_targets(world):
    world.collection["regions"].append({"name": "around", "rectangle": [8, 8, 4, 4]})
    place = opened(world)
    assert place.background(["around"]).sum() == 16 - 5
    both = place.background(["around", "corner"])
    assert both.sum() == 11 + 200
    assert place.background(["image"]).all()


def test_normalised_difference_equals_numpy(world):
    rule = {"high_nm": [780, 880], "low_nm": [650, 690], "above": 0.75, "below": 0.79}
    world.collection["regions"].append({"name": "green", "normalized_difference": rule})
    # The reader gives float32 here; pixels that lie on a limit to its precision may fall either way.
    high = world.values[..., [4, 5]].astype(np.float32).astype(float).mean(axis=-1)
    low = world.values[..., [2, 3]].astype(np.float32).astype(float).mean(axis=-1)
    index = (high - low) / (high + low)
    assert np.abs(index - 0.75).min() > 1e-9
    assert np.abs(index - 0.79).min() > 1e-9
    mask = opened(world).region("green")
    assert np.array_equal(mask, (index >= 0.75) & (index < 0.79))
    assert 0 < mask.sum() < mask.size


def test_regions_that_share_pixels_are_noted(world):
    world.collection["regions"].append({"name": "overlap", "rectangle": [40, 5, 10, 3]})
    assert "the regions 'corner' and 'overlap' share 15 pixels" in opened(world).notes


def test_a_region_file_gives_its_names_or_one_of_them(world):
    square = [[0, 0], [4, 0], [4, 3], [0, 3], [0, 0]]
    other = [[10, 10], [12, 10], [12, 12], [10, 12], [10, 10]]
    features = ",".join(
        f'{{"type":"Feature","properties":{{"name":"{n}"}},"geometry":{{"type":"Polygon","coordinates":[{c}]}}}}'
        for n, c in (("a", square), ("b", other))
    )
    world.text("rois.geojson", f'{{"type":"FeatureCollection","features":[{features}]}}')
    source = {"file": "rois.geojson", "coordinates": "pixel"}
    world.collection["regions"] = [source]
    assert {n: int(m.sum()) for n, m in opened(world).regions.items()} == {"a": 12, "b": 4}
    world.collection["regions"] = [{**source, "name": "b"}]
    assert list(opened(world).regions) == ["b"]
    world.collection["regions"] = [{**source, "name": "c"}]
    with pytest.raises(InputError, match=r"rois\.geojson: no region 'c' among a, b"):
        opened(world)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"regions": [{"name": "far", "rectangle": [45, 0, 6, 5]}]}, InputError,
         "'far'.*lines 45-50.*not in the image"),
        ({"regions": [{"name": "none", "rectangle": [0, 0, 0, 5]}]}, InputError, "'none'.*not in the image"),
        ({"regions": [{"name": "a", "rectangle": [0, 0, 2, 2]}] * 2}, UsageError, "two regions are named 'a'"),
        ({"leave_out": ["nowhere"]}, UsageError, "leave_out names 'nowhere'"),
        ({"regions": [{"name": "nd", "normalized_difference": {"high_nm": [2000, 2100], "low_nm": [650, 690]}}]},
         UsageError, "no usable band between 2000 and 2100 nm"),
        ({"regions": [{"name": "nd", "normalized_difference": {"high_nm": [780, 880], "low_nm": [650, 690],
                                                               "above": 0.999}}]},
         InputError, "'nd' holds no pixel"),
        ({"regions": [{"file": "no.geojson", "coordinates": "pixel"}]}, InputError, "no such"),
        ({"targets": {"csv": "no.csv"}}, InputError, "no such target list"),
        ({"cube": {"path": "no.img", "quantity": "reflectance"}}, InputError, "no such"),
    ],
)  # fmt: skip
def test_each_field_has_its_error(world, change, error, message):
    world.collection |= change
    with pytest.raises(error, match=message):
        opened(world)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cube": None}, "give exactly one of cube, spectra"),
        ({"spectra": [{"subject": "a", "path": "a.txt"}]}, "give exactly one of cube, spectra"),
        ({"regions": [{"name": "a"}]}, "give exactly one of file, rectangle"),
        ({"regions": [{"rectangle": [0, 0, 1, 1]}]}, "needs a name"),
        ({"targets": {}}, "give exactly one of regions, rasters, csv"),
        ({"empirical_line": {"panels": []}}, "at least 1 item"),
        ({"calibration": {}}, "give exactly one of relative, file"),
    ],
)
def test_settings_that_contradict_themselves_are_refused(world, change, message):
    with pytest.raises(ValueError, match=message):
        CollectionSection.model_validate(world.collection | change)


def test_targets_inside_a_region_are_counted_and_said_to_be_left_out(world):
    # Target (30, 20) with its guard: 9 pixels; the region holds two lines of three of them.
    world.collection["regions"] = [
        {"name": "ground", "rectangle": [30, 15, 10, 10]},
        {"name": "on target", "rectangle": [10, 10, 1, 1]},
        {"name": "clear", "rectangle": [40, 30, 5, 5]},
    ]
    place = opened(world)
    touched = np.logical_or.reduce([t.mask for t in place.targets])
    ground = place.region("ground")
    inside, guarded = int((ground & touched).sum()), int((ground & place.near_targets).sum())
    assert 0 < inside < guarded < 100
    said = [n for n in place.notes if "targets" in n]
    assert said == [
        f"the region 'ground' holds {inside} pixels of targets and {guarded - inside} of their guard among 100: "
        "left out of its statistics",
        "warning: the region 'on target' holds 1 pixels of targets and 0 of their guard, which is all of it: they "
        "stay in its statistics",
    ]


def test_targets_that_touch_the_same_pixel_are_counted(world):
    rows = "name,material,group,row0,col0,side_m\na,paint,x,10,10,1\nb,paint,x,10,10,1\n"
    world.text("targets.csv", rows)
    assert "1 pixels may hold parts of more than one target" in opened(world).notes
    world.text("targets.csv", rows.replace("b,paint", "b,cloth"))
    assert "1 pixels may hold parts of more than one target: 1 of 'paint' and 'cloth'" in opened(world).notes


def test_drawn_regions_tell_of_what_leaves_the_image_and_of_holes(world):
    ring, hole = [[30, 5], [50, 5], [50, 15], [30, 15], [30, 5]], [[32, 7], [35, 7], [35, 9], [32, 9], [32, 7]]
    world.text("rois.geojson", f'{{"type":"Polygon","coordinates":[{ring},{hole}]}}')
    world.collection["regions"].append({"file": "rois.geojson", "coordinates": "pixel", "name": "court"})
    notes = opened(world).notes
    # 200 - 6 pixels in all, 100 - 6 inside.
    assert "warning: the region 'court' leaves the image: 51.5 % of its area is outside, 94 pixels are left" in notes
    assert "the region 'court' has a hole of 6 pixels, which are not part of it" in notes


@pytest.mark.data
def test_hysu_materials_overlap(data_dir):
    """The masks of neighbouring materials share pixels; the note says which."""

    root = Path(str(data_dir("hysu/README.md"))).parents[1]
    campaign = job_of(Path(__file__).resolve().parents[2] / "campaigns" / "hysu-2018" / "campaign.yaml").campaign
    place = open_place(campaign.collection, lambda r: root / r.removeprefix("data:"), show_progress=False)
    (said,) = [n for n in place.notes if "more than one target" in n]
    masks = {t.material: np.zeros(place.cube.shape, bool) for t in place.targets}
    for target in place.targets:
        masks[target.material] |= target.mask
    assert f"{np.sum(masks['red_fabric'] & masks['green_fabric'])} of 'red_fabric' and 'green_fabric'" in said
    assert np.sum(masks["red_fabric"] & masks["green_fabric"]) > 0


def test_what_the_header_says_of_the_flight_is_noted(world):
    world.write(extra={"calculated co2 shift": "3.65", "fps": "67.00"})
    notes = " ".join(opened(world).notes)
    assert "CO2 shift 3.65 nm found" in notes
    assert "fps 67.00" in notes


def test_a_cube_without_a_map_takes_the_stated_pixel_size(world):
    placed = opened(world)
    world.write(transform=None, crs=None)
    with pytest.raises(UsageError, match=r"ground size of a pixel is not known.*\n.*targets\.pixel_size_m"):
        opened(world)
    world.collection["targets"]["pixel_size_m"] = 2.0
    place = opened(world)
    assert place.pixel_area_m2 == 4.0
    assert [t.mask.sum() for t in place.targets] == [t.mask.sum() for t in placed.targets]


def test_a_pixel_size_beside_a_map_is_refused(world):
    world.collection["targets"]["pixel_size_m"] = 2.0
    with pytest.raises(UsageError, match="has a map position"):
        opened(world)


def test_a_lookup_table_places_regions_and_targets_of_a_raw_line(world):
    """A line flown southwards: its first line lies in the south, so the table turns the lines round."""
    from affine import Affine
    from rasterio.crs import CRS

    from hyperval.imagery import write_cube

    line, sample = np.indices((LINES, SAMPLES))
    table = np.stack([sample + 1, LINES - line], axis=-1)
    grid = Affine(2.0, 0, 500000.0, 0, -2.0, 4700000.0)
    write_cube(world.folder / "glt.dat", table, data_type=3, transform=grid, crs=CRS.from_epsg(32618))
    ring = [[500010, 4699940], [500050, 4699940], [500050, 4699920], [500010, 4699920], [500010, 4699940]]
    world.text("rois.geojson", f'{{"type":"Polygon","coordinates":[{ring}]}}')
    world.text("targets.csv", "material,easting,northing,side_m\npaint,500021,4699979,0.5\n")
    world.collection |= {
        "cube": {"path": "cube.img", "quantity": "reflectance", "glt": "glt.dat"},
        "regions": [{"name": "court", "file": "rois.geojson", "coordinates": "map"}],
    }
    with pytest.raises(UsageError, match=r"has a map position, and 'cube\.glt' is stated"):
        opened(world)
    world.write(transform=None, crs=None)
    place = opened(world)
    expected = np.zeros((LINES, SAMPLES), bool)
    expected[30:40, 5:25] = True  # on the grid, counted from the north
    assert np.array_equal(place.region("court"), expected[::-1])
    assert place.targets[0].centre_pixel == (LINES - 1 - 10, 10)
    assert place.pixel_area_m2 == pytest.approx(4.0)
    assert "places on the map are found by the lookup table glt.dat, pixels of 4 m2" in place.notes
    assert {p.name for p in place.source_files} == {"cube.img", "cube.hdr", "glt.dat", "glt.hdr"}
    world.collection["targets"]["pixel_size_m"] = 2.0
    with pytest.raises(UsageError, match="has a map position"):
        opened(world)


def test_a_map_in_feet_gives_targets_of_the_same_size(world):
    from affine import Affine
    from rasterio.crs import CRS

    world.text("targets.csv", "material,row0,col0,side_m\npaint,10,10,7\n")  # 3.5 pixels
    in_metres = opened(world)
    foot = 1200.0 / 3937.0  # [m] US survey foot
    grid = Affine(2.0 / foot, 0, 500000.0, 0, -2.0 / foot, 1000000.0)
    world.write(transform=grid, crs=CRS.from_epsg(2261))
    place = opened(world)
    assert place.pixel_area_m2 == pytest.approx(4.0)
    assert np.array_equal(place.targets[0].mask, in_metres.targets[0].mask)
    assert place.targets[0].mask.sum() == 25


def test_a_map_in_degrees_takes_the_stated_pixel_size(world):
    from affine import Affine
    from rasterio.crs import CRS

    placed = opened(world)
    world.write(transform=Affine(2e-5, 0, -77.0, 0, -2e-5, 43.0), crs=CRS.from_epsg(4326))
    with pytest.raises(UsageError, match=r"degrees have no ground size.*\n.*targets\.pixel_size_m"):
        opened(world)
    world.collection["targets"]["pixel_size_m"] = 2.0
    place = opened(world)
    assert place.pixel_area_m2 == 4.0
    assert [t.mask.sum() for t in place.targets] == [t.mask.sum() for t in placed.targets]


def test_a_file_of_regions_of_the_whole_site_serves_a_line_that_holds_some(world):
    import json

    def square(x: float, y: float) -> dict:
        ring = [[x, y], [x + 4, y], [x + 4, y + 4], [x, y + 4], [x, y]]
        return {"type": "Polygon", "coordinates": [ring]}

    features = [
        {"type": "Feature", "properties": {"name": name}, "geometry": square(*at)}
        for name, at in {"court": (10, 20), "far": (1000, 20), "plank 1": (30, 10), "plank 2": (900, 10)}.items()
    ]
    world.text("site.geojson", json.dumps({"type": "FeatureCollection", "features": features}))
    site = {"file": "site.geojson", "coordinates": "pixel"}
    world.collection |= {
        "regions": [{"name": "court", **site}],
        "targets": {"regions": [{"material": "paint", "regions": ["plank 1"], **site}]},
    }
    place = opened(world)
    assert place.region("court").sum() == 16
    assert [t.name for t in place.targets] == ["plank 1"]
    for wanted in ("far", None):
        world.collection["regions"] = [{"name": wanted, **site}]
        with pytest.raises(InputError, match="leaves the image"):
            opened(world)
