"""Detectors, halo and in-scene compensation as a campaign asks for them."""

from __future__ import annotations

import numpy as np
import pytest
from small_world import BANDS, LINES, PLANTED, SAMPLES, TARGET

from hyperval.collection import Detection, EmpiricalLineSource
from hyperval.compare import product_rows
from hyperval.errors import UsageError
from hyperval.pixels import DETECTORS, footprint_maxima, pixel_detector, whitener_of


def test_every_detector_makes_its_maps_and_curves(world):
    world.detection |= {"detectors": list(DETECTORS), "background": ["image"], "undesired": ["corner"], "pools": []}
    seen = world.observe()
    target = world.on_bands("library.csv", "paint")
    pixels = world.values.reshape(-1, BANDS)
    mean, covariance = pixels.mean(axis=0), np.cov(pixels.T)
    corner = world.values[35:45, 5:25].reshape(-1, BANDS).mean(axis=0)
    whitener = whitener_of(mean, covariance)
    assert set(seen.detected.score_maps) == {"rx" if d == "rx" else f"paint-{d}" for d in DETECTORS}
    for name in DETECTORS:
        found = seen.detected.score_maps["rx" if name == "rx" else f"paint-{name}"]
        expected = pixel_detector(name, target, mean, covariance, corner[None]).score(world.values, whitener)
        assert found == pytest.approx(expected, rel=1e-8, abs=1e-9)
    units = {(detector, unit) for _, detector, unit in seen.observation.roc}
    assert units == {(d, u) for d in DETECTORS for u in ("pixel", "object")}


def test_a_halo_scores_background_and_objects_alike(world):
    world.detection["halo_pixels"] = 1
    seen = world.observe()
    scores = seen.detected.score_maps["paint-cem"]
    curve = seen.observation.roc["fill 0.8", "cem", "object"]
    guarded = seen.place.background(["scene"])
    tiles = footprint_maxima(scores, np.ones((3, 3), bool), ~guarded)[0]
    assert curve.n_target == 2
    assert curve.n_background == tiles.size  # two objects of one shape share their placements
    assert curve.background_area_km2 == pytest.approx(tiles.size * 9 * 4.0 / 1e6)
    # By pixel nothing changes.
    assert seen.observation.roc["fill 0.8", "cem", "pixel"].n_background == LINES * SAMPLES - 5 * len(PLANTED)
    best = max(scores[9:12, 9:12].max(), scores[9:12, 19:22].max())
    assert curve.pd[curve.threshold < best].max() == 1
    other = seen.observation.roc["fill 0.8", "cem", "object-by-pixel"]
    halos = np.zeros_like(guarded)
    for line, sample in ((10, 10), (10, 20)):
        halos[line - 1 : line + 2, sample - 1 : sample + 2] = True
    background = scores[guarded & ~halos]
    assert (other.n_target, other.n_background) == (2, background.size)
    at = np.flatnonzero(np.abs(other.pfa - 0.1) < 1e-9)[0]
    threshold = np.sort(background)[::-1][round(0.1 * background.size)]
    each = [scores[9:12, 9:12].max(), scores[9:12, 19:22].max()]
    assert other.pd[at] == np.mean(np.array(each) > threshold)
    both = [(i, j) for i, p in enumerate(curve.pfa) for j in np.flatnonzero(np.isclose(other.pfa, p, rtol=1e-9))]
    assert len(both) > 20
    assert all(other.pd[j] >= curve.pd[i] for i, j in both)  # a false alarm has fewer chances: it favours detection
    assert any("they favour detection" in note for note in seen.detected.notes)
    world.detection["halo_pixels"] = 24
    with pytest.raises(UsageError, match=r"'t0' with a halo of 24 pixels is larger"):
        world.observe()


def test_alarms_before_the_first_detection(world):
    """RIT's rule: the list of pixels by falling score, read until it meets a pixel of any object."""
    world.detection["first_detection"] = True
    world.values[45, 30:33] = world.values[10, 10]  # as full as the best ones, and not in the truth
    world.values[45, 35] = TARGET
    world.write()
    seen = world.observe()
    scores, guarded = seen.detected.score_maps["paint-cem"], seen.place.background(["scene"])
    curves = {s: curve for (s, _, unit), curve in seen.observation.roc.items() if unit == "object"}
    places: dict[str, list[tuple[int, int]]] = {}
    for place, fill in PLANTED.items():
        places.setdefault(f"fill {fill}", []).append(place)
    order = np.argsort(-scores, axis=None, kind="stable")
    for subject, pixels in places.items():
        counted = 0
        for line, sample in zip(*np.unravel_index(order, scores.shape), strict=True):
            if (line, sample) in pixels:
                break
            counted += bool(guarded[line, sample])
        assert curves[subject].alarms_before_first == counted
    assert curves["fill 0.8"].alarms_before_first >= 1  # the full one, and which of the others only noise decides
    assert curves["fill 0.3"].alarms_before_first == 4
    assert any("RIT's self-test" in note for note in seen.detected.notes)
    rows = product_rows(seen.observation, "observed")
    assert {r.subject: r.value for r in rows if r.metric == "alarms_before_first"} == {
        s: c.alarms_before_first for s, c in curves.items()
    }
    del world.detection["first_detection"]
    again = product_rows(world.observe().observation, "observed")
    assert not [r for r in again if r.metric == "alarms_before_first"]


def test_osp_and_its_regions_go_together(world):
    for change in ({"detectors": ["osp"]}, {"undesired": ["corner"]}):
        with pytest.raises(ValueError, match="go together"):
            Detection.model_validate(world.detection | change)
    world.detection |= {"detectors": ["osp"], "undesired": ["nowhere"]}
    with pytest.raises(UsageError, match="no region 'nowhere'"):
        world.observe()


def test_one_panel_with_the_darkest_pixel(make_radiance):
    made = make_radiance()
    panels = made.world.collection["empirical_line"]["panels"]
    white = [p for p in panels if p["region"] == "white"]
    dark = made.reflectance.reshape(-1, BANDS).min(axis=0)
    made.world.collection["empirical_line"] = {
        "panels": [{**white[0], "relative_uncertainty": 0.01}],
        "darkest_pixel": {"reflectance": 0.02, "uncertainty": 0.01, "radiance_noise": 0.01},
    }
    line = made.world.observe().elm
    assert line.names == ("white", "darkest pixel")
    assert line.reflectance(made.offset + made.gain * dark) == pytest.approx(np.full(BANDS, 0.02), abs=1e-9)


def test_a_line_through_the_origin(make_radiance):
    made = make_radiance()
    panels = made.world.collection["empirical_line"]["panels"]
    made.world.collection["empirical_line"] = {
        "panels": [p for p in panels if p["region"] == "white"], "intercept": False,
    }  # fmt: skip
    line = made.world.observe().elm
    assert not line.offset.any()
    assert np.all(line.gain > made.gain)  # the path radiance goes into the gain


@pytest.mark.parametrize("dark", [None, 0.0, 0.03])
def test_a_material_of_the_scene_as_colour_standard(make_radiance, dark):
    """One surface of known spectrum, not flat, that lies in the scene; alone, or with the darkest pixel."""
    made = make_radiance()
    colour = np.linspace(0.25, 0.65, BANDS)
    scene = made.reflectance.copy()
    scene[12:18, 30:36] = colour
    scene[44, 38] = np.linspace(0.01, 0.03, BANDS)  # the darkest pixel in every band
    made.world.write(made.offset + made.gain * scene)
    made.world.library("standards.csv", ("tarpaulin", colour), ("other", 0.5 * colour))
    known = made.world.on_bands("standards.csv", "tarpaulin")
    made.world.collection["regions"].append({"name": "tarpaulin", "rectangle": [12, 30, 6, 6]})
    line = {
        "panels": [
            {
                "region": "tarpaulin",
                "spectrum": made.world.source("standards.csv", "tarpaulin"),
                "relative_uncertainty": 0.02,
            }
        ],
        **({"intercept": False} if dark is None else {"darkest_pixel": {"reflectance": dark, "uncertainty": 0.01}}),
    }
    made.world.collection["empirical_line"] = line
    found = made.world.observe().elm
    radiance = made.offset + made.gain * scene
    standard, least = radiance[12, 30], radiance.min(axis=(0, 1))
    assert least == pytest.approx(radiance[44, 38])
    x = radiance[20:30, 5:9]
    expected = known * x / standard  # rho = rho_s L/L_s
    if dark is not None:  # rho = rho_d + (rho_s - rho_d)(L - L_d)/(L_s - L_d)
        expected = dark + (known - dark) * (x - least) / (standard - least)
    usable = found.usable
    assert usable.sum() >= BANDS - 1
    assert found.reflectance(x)[..., usable] == pytest.approx(expected[..., usable], rel=1e-6, abs=1e-9)
    # The standard itself comes out as it is known, whatever the assumption about the dark end.
    assert found.reflectance(standard)[usable] == pytest.approx(known[usable], rel=1e-9)
    if dark is None:
        assert np.all(found.reflectance(least) > scene[44, 38])  # the path radiance is taken for reflectance
    else:
        # The darkest pixel is not what it was taken for; the stated 0.01 covers an error of 0.03 at three sd.
        error = np.abs(found.reflectance(least) - scene[44, 38])[usable]
        rho, c = found.reflectance(least), found.covariance
        variance = rho**2 * c[:, 0, 0] + 2.0 * rho * c[:, 0, 1] + c[:, 1, 1]
        sd = np.sqrt(variance / found.gain**2)[usable]
        assert np.all(error <= 3.1 * sd)


def test_a_dark_colour_standard_is_refused(make_radiance):
    made = make_radiance()
    panels = made.world.collection["empirical_line"]["panels"]
    made.world.collection["empirical_line"] = {
        "panels": [p for p in panels if p["region"] == "black"], "darkest_pixel": {"reflectance": 0.0},
    }  # fmt: skip
    with pytest.raises(UsageError, match=r"differ by 0\.05 in reflectance"):
        made.world.observe()


def test_lines_that_nothing_fixes_are_refused():
    one = {"region": "white", "spectrum": {"constant": 0.5}}
    with pytest.raises(ValueError, match="needs two panels"):
        EmpiricalLineSource.model_validate({"panels": [one]})
    with pytest.raises(ValueError, match="intercept: false says is none"):
        EmpiricalLineSource.model_validate({"panels": [one], "intercept": False, "darkest_pixel": {}})


def test_a_local_window_moves_the_mean_with_the_pixel(world):
    world.detection |= {
        "detectors": ["cem", "ace", "rx"], "pools": [], "local_window": {"outer_pixels": 11, "inner_pixels": 3},
    }  # fmt: skip
    seen = world.observe()
    assert any("windows of 11 less 3 pixels; 0 pixels without" in note for note in seen.observation.notes)
    target = world.on_bands("library.csv", "paint")
    keep = seen.place.background(["scene"])
    covariance = np.cov(world.values[keep].T)
    line, sample = next(iter(PLANTED))
    ring = np.zeros((LINES, SAMPLES), bool)
    ring[line - 5 : line + 6, sample - 5 : sample + 6] = True
    ring[line - 1 : line + 2, sample - 1 : sample + 2] = False
    own = world.values[ring & keep].mean(axis=0)
    for name in ("cem", "ace", "rx"):
        expected = pixel_detector(name, target, own, covariance).score(
            world.values[line, sample], whitener_of(own, covariance)
        )
        found = seen.detected.score_maps["rx" if name == "rx" else f"paint-{name}"]
        assert found[line, sample] == pytest.approx(float(expected), rel=1e-8)


def test_a_local_window_that_makes_no_sense_is_refused(world):
    for outer, inner in ((10, 3), (5, 5), (9, 4)):
        with pytest.raises(ValueError, match="odd"):
            Detection.model_validate(world.detection | {"local_window": {"outer_pixels": outer, "inner_pixels": inner}})
    with pytest.raises(ValueError, match="no mean that could be local"):
        Detection.model_validate(
            world.detection | {"detectors": ["sam"], "local_window": {"outer_pixels": 9, "inner_pixels": 3}}
        )
