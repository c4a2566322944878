"""Detection on pixels: scores equal plain NumPy; bands, groups, pools, halos, areas, unmixing, notes and errors."""

from dataclasses import replace

import numpy as np
import pytest
from small_world import (
    AXIS,
    BACKGROUND,
    BANDS,
    LINES,
    PLANTED,
    SAMPLES,
    TARGET,
    background_spread,
    matched_filter,
    moments,
    near_targets,
    target_rows,
)

from hyperval import pixels
from hyperval.data import statistics_of
from hyperval.errors import UsageError
from hyperval.imagery import write_cube
from hyperval.products import background_of

FILLS = {"fill 0.8": 0.8, "fill 0.3": 0.3}


def shown(*positions: tuple[int, int]) -> np.ndarray:
    """Mask of single pixels."""
    mask = np.zeros((LINES, SAMPLES), bool)
    mask[tuple(zip(*positions, strict=True))] = True
    return mask


@pytest.mark.parametrize(
    ("background", "inside"),
    [
        (["scene"], lambda v: v[~near_targets()]),
        (["image"], lambda v: v),
        (["corner"], lambda v: v[35:45, 5:25]),
        # A region over targets: neither they nor their guard ring are in the covariance.
        (["middle"], lambda v: v[5:35, 5:30][~near_targets()[5:35, 5:30]]),
    ],
    ids=["scene", "image", "region", "region over targets"],
)
def test_scores_equal_plain_numpy(world, background, inside):
    world.collection["regions"].append({"name": "middle", "rectangle": [5, 5, 30, 25]})
    world.detection |= {"background": background, "detectors": ["cem", "cem-correlation"]}
    target, (mean, covariance) = world.on_bands(), moments(inside(world.values))
    found = world.observe().detected.score_maps
    assert set(found) == {"paint-cem", "paint-cem-correlation"}
    expected = matched_filter(world.values, target, mean, covariance)
    assert found["paint-cem"] == pytest.approx(expected, rel=1e-9, abs=1e-12)
    inverse = np.linalg.inv(covariance + np.outer(mean, mean))
    expected = world.values @ inverse @ target / (target @ inverse @ target)
    assert found["paint-cem-correlation"] == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_radiance_without_a_line_has_no_reflectance_and_counts_with_one_do(panels):
    of_radiance, cube = panels.observe().observation.reflectance, panels.collection["cube"]
    panels.collection["cube"] = {"path": cube["path"], "quantity": "counts"}
    of_counts = panels.observe().observation
    assert of_counts.radiance == {}
    assert all(np.allclose(of_counts.reflectance[name].mean, one.mean) for name, one in of_radiance.items())
    panels.collection["cube"] = cube
    del panels.collection["empirical_line"]
    panels.detection = None
    seen = panels.observe()
    assert (seen.observation.reflectance, seen.statistics) == ({}, {})  # no reflectance, no statistics to hand on
    assert set(seen.observation.radiance) == {"corner", "white", "black"}


def test_every_detector_makes_its_maps_and_curves(world):
    world.detection |= {"detectors": list(pixels.DETECTORS), "background": ["image"], "undesired": ["corner"]}
    seen = world.observe()
    mean, covariance = moments(world.values)
    corner, whitener = moments(world.values[35:45, 5:25])[0], pixels.whitener_of(mean, covariance)
    assert set(seen.detected.score_maps) == {"rx" if d == "rx" else f"paint-{d}" for d in pixels.DETECTORS}
    for name in pixels.DETECTORS:
        found = seen.detected.score_maps["rx" if name == "rx" else f"paint-{name}"]
        detector = pixels.pixel_detector(name, world.on_bands(), mean, covariance, corner[None])
        assert found == pytest.approx(detector.score(world.values, whitener), rel=1e-8, abs=1e-9)
    units = {(detector, unit) for _, detector, unit in seen.observation.roc}
    assert units == {(d, u) for d in pixels.DETECTORS for u in ("pixel", "object")}


def test_a_local_window_moves_the_mean_with_the_pixel(world):
    world.detection |= {"detectors": ["cem", "ace", "rx"], "local_window": {"outer_pixels": 11, "inner_pixels": 3}}
    seen = world.observe()
    assert any("windows of 11 less 3 pixels; 0 pixels without" in note for note in seen.observation.notes)
    keep, target = seen.place.pixels_of("scene"), world.on_bands()
    detectors = {"paint-cem": ("cem", target), "paint-ace": ("ace", target), "rx": ("rx", None)}
    whitener = pixels.whitener_of(*moments(world.values[keep]))
    expected, _ = pixels.score_cube_locally(seen.place.cube, detectors, whitener, (11, 3), keep)
    for name, scores in expected.items():
        np.testing.assert_allclose(seen.detected.score_maps[name], scores, rtol=1e-9)


@pytest.mark.parametrize(("choice", "left_out"), [("all", []), ("good", [6]), ("windows", [6])])
def test_bands_of_the_detectors(world, choice, left_out):
    world.values[1, 7, 6] = np.nan  # where opening does not look: no pixel of detectors that use the band
    world.write(axis=type(AXIS)(AXIS.centre_nm, AXIS.fwhm_nm, np.arange(BANDS) != 6))
    world.detection["bands"] = choice
    seen = world.observe()
    assert np.flatnonzero(~seen.detected.bank.bands).tolist() == left_out
    assert f"detectors use {BANDS - len(left_out)} of {BANDS} bands" in seen.observation.notes


def test_bands_that_are_left_out_are_listed_with_the_rule(world):
    centre = np.array([500.0, 600, 700, 850, 1050, 1380, 1400, 1650])
    values = world.values.copy()
    values[..., 2] += np.random.default_rng(3).normal(0.0, 0.5 * values[..., 2].mean(), values.shape[:2])
    world.write(values, axis=type(AXIS)(centre, AXIS.fwhm_nm, ~np.isin(np.arange(BANDS), [1])))
    rows = [f"{w},{0.5 - w / 8000}" for w in range(450, 1601)]
    world.text("part.csv", "\n".join(["wavelength_nm,paint", *rows]) + "\n")
    world.detection |= {"bands": "windows", "least_snr": 4}
    world.detection["targets"][0]["spectrum"] = world.source("part.csv", "part")
    seen = world.observe().detected
    assert np.flatnonzero(seen.bank.bands).tolist() == [0, 3, 4]
    told = (
        "bands that the detectors do not use: 1 bad in the band list (600 nm); 2 in absorption bands "
        "(1380-1400 nm); 1 not in the target spectra (1650 nm); 1 with an SNR below 4 in the background (700 nm)"
    )
    assert told in seen.notes


def test_bands_by_number_give_the_scores_that_wavelengths_give(world, request):
    world.detection["detectors"] = ["matched-filter", "ace"]
    known = world.observe().detected.score_maps
    found = request.getfixturevalue("by_number").observe()
    for name, values in known.items():
        np.testing.assert_allclose(found.detected.score_maps[name], values, rtol=1e-9, atol=1e-12)
    assert found.observation.axis.centre_nm.tolist() == [1, 2, 3, 4, 5, 6, 7, 8]
    assert any("labelled nm are band numbers" in note for note in found.observation.notes)
    assert set(found.observation.distribution) == {"corner"}  # tails need no wavelengths
    world.detection["least_snr"] = 1e6
    with pytest.raises(UsageError, match=r"8 with an SNR below 1e\+06 in the background \(1-8\)"):
        world.observe()


def test_products_of_each_group(world):
    seen = world.observe()
    scores, observation = seen.detected.score_maps["paint-cem"], seen.observation
    noise = scores[~near_targets()]
    assert set(observation.roc) == {(s, "cem", u) for s in FILLS for u in ("pixel", "object")}
    for subject, fill in FILLS.items():
        own = shown(*(at for at, f in PLANTED.items() if f == fill))
        inside, found = scores[own], observation.scores[subject, "cem"]
        assert (found.mean, found.sd) == pytest.approx((inside.mean(), inside.std(ddof=1)), rel=1e-12)
        assert found.mean == pytest.approx(fill, abs=0.05)  # the background's own scatter is 0.01 to 0.02
        behind = observation.scores[background_of(subject), "cem"]
        assert (behind.mean, behind.sd) == pytest.approx((noise.mean(), noise.std(ddof=1)), abs=1e-12)
        curve = observation.roc[subject, "cem", "pixel"]
        assert (found.n, curve.n_target, curve.n_background) == (inside.size, inside.size, noise.size)
        assert np.array_equal(curve.pd, pixels.empirical_roc(inside, noise, curve.pfa).pd)
        assert curve.background_area_km2 == pytest.approx(noise.size * 4.0 / 1e6)
        spectrum = observation.reflectance[subject]
        assert (spectrum.n, spectrum.mean) == (inside.size, pytest.approx(world.values[own].mean(axis=0), rel=1e-12))
    world.detection["false_alarms"] = ["corner"]
    curve = world.observe().observation.roc["fill 0.3", "cem", "pixel"]
    assert (curve.n_background, curve.background_area_km2) == (200, pytest.approx(200 * 4.0 / 1e6))


def test_an_object_scores_its_best_pixel(world):
    # A side of 4 m is two pixels: the object touches 3 x 3 pixels around the centre of its middle pixel.
    world.text("targets.csv", target_rows(PLANTED, side_m=4.0))
    world.detection["group"] = "{name}"
    seen = world.observe()
    nine = seen.detected.score_maps["paint-cem"][9:12, 9:12]
    found, objects = seen.observation.scores["t0", "cem"], seen.observation.roc["t0", "cem", "object"]
    assert (found.n, found.mean) == (9, pytest.approx(nine.mean()))
    assert objects.n_target == 1
    # Detected exactly where the threshold lies below the best pixel.
    detected = (objects.threshold < nine.max()) | (objects.pfa >= 1.0)
    assert np.array_equal(objects.pd, detected.astype(float))
    world.collection["targets"]["pixels"] = "centre"
    assert world.observe().observation.scores["t0", "cem"].n == 1


def test_pools_count_the_targets_of_their_subjects(world):
    world.detection["pools"] = [{"name": "all", "subjects": list(FILLS)}]
    roc = world.observe().observation.roc
    few, many, pool = (roc[s, "cem", "pixel"] for s in (*FILLS, "all"))
    assert pool.n_target == 5
    assert pool.pd == pytest.approx((2 * few.pd + 3 * many.pd) / 5, abs=1e-12)


def test_a_halo_scores_background_and_objects_alike(world):
    world.detection["halo_pixels"] = 1
    seen = world.observe()
    scores, guarded = seen.detected.score_maps["paint-cem"], seen.place.pixels_of("scene")
    curve = seen.observation.roc["fill 0.8", "cem", "object"]
    tiles = pixels.footprint_tiles(scores, np.ones((3, 3), bool), ~guarded)[0].max(axis=1)
    # Two objects of one shape share their placements.
    assert (curve.n_target, curve.n_background) == (2, tiles.size)
    assert curve.background_area_km2 == pytest.approx(tiles.size * 9 * 4.0 / 1e6)
    # By pixel nothing changes.
    assert seen.observation.roc["fill 0.8", "cem", "pixel"].n_background == LINES * SAMPLES - 5 * len(PLANTED)
    each = np.array([scores[9:12, 9:12].max(), scores[9:12, 19:22].max()])
    assert curve.pd[curve.threshold < each.max()].max() == 1
    other = seen.observation.roc["fill 0.8", "cem", "object-by-pixel"]
    halos = np.zeros_like(guarded)
    halos[9:12, 9:12] = halos[9:12, 19:22] = True
    background = scores[guarded & ~halos]
    assert (other.n_target, other.n_background) == (2, background.size)
    at = np.flatnonzero(np.abs(other.pfa - 0.1) < 1e-9)[0]
    assert other.pd[at] == np.mean(each > np.sort(background)[::-1][round(0.1 * background.size)])
    both = [(i, j) for i, p in enumerate(curve.pfa) for j in np.flatnonzero(np.isclose(other.pfa, p, rtol=1e-9))]
    assert len(both) > 20
    assert all(other.pd[j] >= curve.pd[i] for i, j in both)  # a false alarm has fewer chances: it favours detection
    assert any("they favour detection" in note for note in seen.detected.notes)


def test_alarms_before_the_first_detection(world):
    """RIT's rule: the list of pixels by falling score, read until it meets a pixel of any object."""
    world.detection["first_detection"] = True
    world.values[45, 30:33] = world.values[10, 10]  # as full as the best ones, and not in the truth
    world.values[45, 35] = TARGET
    world.write()
    seen = world.observe()
    scores, guarded = seen.detected.score_maps["paint-cem"], seen.place.pixels_of("scene")
    order = np.argsort(-scores, axis=None, kind="stable")
    for subject, fill in FILLS.items():
        own = shown(*(at for at, f in PLANTED.items() if f == fill)).ravel()[order]
        alarms = seen.observation.roc[subject, "cem", "object"].alarms_before_first
        assert alarms == guarded.ravel()[order][: np.argmax(own)].sum() > 0
    assert any("RIT's self-test" in note for note in seen.detected.notes)


def test_areas_are_sums_of_scores_times_the_pixel_area(world):
    world.detection["areas"] = [{"target": "paint", "detector": "cem", "margin_pixels": 1}]
    seen = world.observe()
    scores, area = seen.detected.score_maps["paint-cem"], seen.observation.abundance["fill 0.8", "cem"]
    expected = np.mean([scores[i - 1 : i + 2, j - 1 : j + 2].sum() * 4.0 for (i, j), f in PLANTED.items() if f == 0.8])
    assert (area.n, area.area_m2) == (18, pytest.approx(expected, rel=1e-12))
    assert seen.detected.nominal_area_m2["fill 0.8", "cem"] == pytest.approx(3.2)
    # 9 independent pixels of background for each of 2 objects; their mean: sd sqrt(9/2) times 4 m2.  The spread
    # over about 180 placements is known to 5 %; 25 % is five times that.
    sd = scores[~near_targets()].std(ddof=1)
    assert area.standard_uncertainty == pytest.approx(sd * np.sqrt(9 / 2) * 4.0, rel=0.25)
    assert abs(area.area_m2 - 3.2) < 4.0 * area.standard_uncertainty
    # The margin leaves out the pixels of neighbours; an object with a pixel that holds no data is not measured.
    world.values[19, 19] = np.nan
    world.write()
    world.text("targets.csv", target_rows({(10, 10): 0.8, (10, 11): 0.3, (20, 20): 0.8}))
    seen = world.observe()
    scores, area = seen.detected.score_maps["paint-cem"], seen.observation.abundance["fill 0.8", "cem"]
    assert (area.n, area.area_m2) == (8, pytest.approx(4.0 * (scores[9:12, 9:12].sum() - scores[10, 11]), rel=1e-12))


def test_few_pixels_shrink_the_covariance_of_good_bands_and_say_so(world):
    good = np.arange(BANDS) != 3
    world.write(world.values * np.where(good, 1.0, 10.0), axis=replace(AXIS, good=good))
    world.collection["regions"].append({"name": "patch", "rectangle": [40, 30, 4, 5]})
    world.detection["background"] = ["patch"]
    seen = world.observe()
    inside = world.values[40:44, 30:35, good].reshape(20, -1)
    assert any(n.startswith("20 background pixels are few: covariance shrunk by ") for n in seen.observation.notes)
    shrunk, unbiased = statistics_of(inside).shrunk().covariance, moments(inside)[1]
    expected = matched_filter(world.values[..., good], world.on_bands()[good], inside.mean(axis=0), shrunk)
    assert seen.detected.score_maps["paint-cem"] == pytest.approx(expected, rel=1e-8, abs=1e-10)
    # The model's filter is made of the same covariance.
    assert seen.statistics["patch"].covariance[good][:, good] == pytest.approx(shrunk, rel=1e-9, abs=1e-12)
    world.detection["background"] = ["scene"]
    seen = world.observe()
    assert not any("shrunk" in n for n in seen.observation.notes)
    assert seen.statistics["patch"].covariance[good][:, good] == pytest.approx(unbiased, rel=1e-9, abs=1e-12)


def test_invalid_pixels_have_no_score_and_count_nowhere(world):
    values = world.values.copy()
    values[25, 25, 3] = np.nan
    values[20, 20, :] = np.nan  # a target pixel
    world.write(values)
    seen = world.observe()
    scores, observation = seen.detected.score_maps["paint-cem"], seen.observation
    assert np.argwhere(np.isnan(scores)).tolist() == [[20, 20], [25, 25]]
    curve, n = observation.roc["fill 0.3", "cem", "object"], (~near_targets()).sum() - 1
    counted = [observation.scores[name, "cem"].n for name in ("fill 0.3", background_of("fill 0.3"))]
    # The ground that was looked at is that of pixels with a score, of 2 m.
    assert [*counted, curve.n_target, curve.background_area_km2] == [2, n, 2, pytest.approx(4e-6 * n)]


def test_an_object_that_lacks_a_pixel_counts_as_none_and_is_named(world):
    """By its remaining eight pixels, of ground, one of 0.30 scored 0.004 beside a prediction made for all nine."""
    world.text("targets.csv", target_rows(PLANTED, side_m=4.0))
    world.detection |= {"pools": [{"name": "all", "subjects": list(FILLS)}], "detectors": ["cem", "ace"]}
    for at in ((20, 20), (10, 10), (10, 20)):  # one of three objects, and both
        world.values[at] = np.nan
    world.write()
    seen = world.observe()
    found, best = seen.observation, seen.detected.score_maps["paint-cem"][19:22, 9:12].max()
    assert found.object_scores["fill 0.3", "cem"].values[:2] == pytest.approx([best, np.nan], nan_ok=True)
    assert ("fill 0.8", "cem", "object") not in found.roc
    counted = ("fill 0.3", "object"), ("all", "object"), ("all", "pixel")
    assert [found.roc[name, "cem", unit].n_target for name, unit in counted] == [2, 2, 9 * 5 - 3]
    assert [note[-12:] for note in found.notes if "lack the score of a pixel" in note] == [": t0, t1, t3"]
    world.detection["halo_pixels"] = 1  # which nothing predicts
    world.write()
    assert world.observe().observation.roc["fill 0.3", "cem", "object"].n_target == 3


def test_two_spectra_of_one_material(world):
    world.detection["targets"].append({"name": "second", "material": "paint", "spectrum": {"constant": 0.5}})
    world.detection["group"] = "{target} {group}"
    for planted, means in ((PLANTED, 2), ({(10, 10): 0.8}, 0)):  # of one pixel the error of a mean is not known
        world.text("targets.csv", target_rows(planted))
        seen = world.observe().observation
        assert {s for s, _, _ in seen.roc} == {f"{t} fill {f}" for t in ("paint", "second") for f in planted.values()}
        assert sum(name.startswith("paint") for name in seen.reflectance) == means


def test_a_band_without_variance_is_left_out_or_named(world):
    world.values[:, :, (0, 7)], world.values[near_targets(), 7] = 0.25, 0.5  # the last in the background alone
    world.write()
    assert any("1 bands hold one number in all pixels seen, 0 none (the first: 1)" in n for n in world.place().notes)
    with pytest.raises(UsageError, match=r"1 of 7 bands have no variance \(first: band 8\)"):
        world.observe()


def test_mean_score_has_its_own_error_where_the_filter_is_made_of_the_pixels_it_scores(world):
    world.detection["detectors"] = ["cem-correlation"]
    same = world.observe().observation.scores[background_of("fill 0.8"), "cem-correlation"]
    assert 0.0 < same.mean_error < same.sd / same.n**0.5
    assert abs(same.mean_bias) < same.mean_error
    world.detection["background"] = ["corner"]
    other = world.observe().observation.scores[background_of("fill 0.8"), "cem-correlation"]
    assert np.isnan(other.mean_bias)
    assert other.mean_error > same.mean_error


@pytest.fixture
def unmixing(world):
    """The five targets of the world, unmixed with the background around them."""
    world.regions(ground=[0, 0, LINES, SAMPLES])
    world.detection["unmixing"] = {"targets": [{"target": "paint", "endmembers": "field"}], "background": "ground",
                                   "weights": ["equal", "background"], "ring_pixels": 5}  # fmt: skip
    return world


def test_areas_by_unmixing_add_up_and_their_background_lies_around_the_target(unmixing):
    found = unmixing.observe()
    together, unmixed = found.observation.abundance, found.unmixed
    assert [(s.subject, s.objects) for s in unmixed.subjects] == [("fill 0.8", 2), ("fill 0.3", 3)]
    assert (unmixed.noise["fcls"], unmixed.noise["fcls-weighted"].matrix.shape) == (None, (BANDS, BANDS))
    assert unmixed.pixel_area_m2 == 4.0
    weighted, equal = (together["fill 0.3", m].standard_uncertainty for m in ("fcls-weighted field", "fcls field"))
    assert weighted < equal
    unmixing.detection["group"] = "{name}"
    found = unmixing.observe()
    alone = found.observation.abundance
    lines, samples = np.indices((LINES, SAMPLES))
    for subject, (line, sample) in zip(found.unmixed.subjects, PLANTED, strict=True):
        around = (np.hypot(lines - line, samples - sample) <= 5.0) & ~near_targets()
        assert (alone[subject.subject, "fcls field"].n, subject.ring) == (1, around.sum())
    for subject, fill in FILLS.items():
        own = [alone[f"t{i}", "fcls field"] for i, f in enumerate(PLANTED.values()) if f == fill]
        group = together[subject, "fcls field"]
        assert group.nominal_m2 == pytest.approx(4.0 * fill)
        assert group.area_m2 == pytest.approx(4.0 * fill, abs=4 * group.standard_uncertainty + 0.35)
        assert group.area_m2 == pytest.approx(np.mean([a.area_m2 for a in own]), rel=1e-12)
        expected = np.sqrt(sum(a.standard_uncertainty**2 for a in own)) / len(own)
        assert group.standard_uncertainty == pytest.approx(expected, rel=1e-12)


def test_the_layout_of_classes_is_no_chance(world):
    """Independent pixels of two classes, of which one has the alarms: sd of ln P_FA is sqrt((1 - 2 P)/(n P)).

    Stated over true at P_FA of 0.1: 1.12 with a standard deviation of 0.11 over seeds; where the halves of the image
    are left out of account it is 15.
    """
    side = 120
    bright = np.indices((side, side))[0] < side // 2
    write_cube(world.folder / "classes.img", np.where(bright, 1, 2)[..., None], data_type=1)
    world.regions({"file": "classes.img", "classes": {"bright": 1, "dark": 2}})
    values = np.random.default_rng(27).multivariate_normal(BACKGROUND, background_spread(), (side, side))
    world.write(values + 0.3 * bright[..., None] * (TARGET - BACKGROUND))
    curve = world.observe().observation.exceedance["paint", "cem"]
    point = np.argmin(np.abs(np.log(curve.probability / 0.1)))
    p = curve.probability[point]
    stated = np.log(curve.upper[point] / curve.lower[point]) / (2.0 * 1.96)
    assert 0.8 < stated / np.sqrt((1.0 - 2.0 * p) / (p * curve.n)) < 1.6
