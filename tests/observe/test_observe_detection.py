"""Detection on pixels: scores equal plain NumPy; groups, pools, areas, backgrounds, notes and errors."""

from __future__ import annotations

import numpy as np
import pytest
from small_world import AXIS, BANDS, LINES, PLANTED, SAMPLES, target_rows

from hyperval.collection import Detection
from hyperval.data import SampleStatistics
from hyperval.errors import InputError, UsageError
from hyperval.imagery import write_cube
from hyperval.observe import usable_bands
from hyperval.pixels import empirical_roc
from hyperval.products import background_of
from hyperval.spectra import SpectralAxis


def matched_filter(pixels, target, mean, covariance):
    """Plain NumPy: (x - m) C^-1 (t - m) / ((t - m) C^-1 (t - m))."""
    d = target - mean
    weights = np.linalg.inv(covariance) @ d
    return (pixels - mean) @ weights / (d @ weights)


def moments(pixels):
    return pixels.mean(axis=0), np.cov(pixels, rowvar=False)


def near_targets():
    mask = np.zeros((LINES, SAMPLES), bool)
    for line, sample in PLANTED:
        for dl, ds in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
            mask[line + dl, sample + ds] = True
    return mask


@pytest.mark.parametrize(
    ("background", "pixels"),
    [
        (["scene"], lambda v: v[~near_targets()]),
        (["image"], lambda v: v.reshape(-1, BANDS)),
        (["corner"], lambda v: v[35:45, 5:25].reshape(-1, BANDS)),
        # A region over targets: neither they nor their guard ring are in the covariance.
        (["middle"], lambda v: v[5:35, 5:30][~near_targets()[5:35, 5:30]]),
    ],
    ids=["scene", "image", "region", "region over targets"],
)
def test_scores_equal_plain_numpy(world, background, pixels):
    world.collection["regions"].append({"name": "middle", "rectangle": [5, 5, 30, 25]})
    world.detection["background"] = background
    target = world.on_bands("library.csv", "paint")
    expected = matched_filter(world.values, target, *moments(pixels(world.values)))
    found = world.observe().detected.score_maps["paint-cem"]
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_targets_stay_out_of_the_covariance_or_the_filter_suppresses_them(world):
    # The trap: 5 % of the pixels are targets, and the spectrum looked for is off by 4 %, up and down by band.
    flat, level, sd = np.full(BANDS, 0.212), np.full(BANDS, 0.364), 0.01
    values = flat + sd * np.random.default_rng(11).standard_normal((LINES, SAMPLES, BANDS))
    planted = {(line, sample): 1.0 for line in range(2, LINES, 5) for sample in range(1, SAMPLES, 4)}
    share = len(planted) / (LINES * SAMPLES)
    assert share == 0.05
    at = tuple(np.array(list(planted)).T)
    values[at] += level - flat
    world.write(values)
    off = level * (1 + 0.04 * (-1.0) ** np.arange(BANDS))
    world.library("library.csv", ("paint", off), ("ground", flat))
    off = world.on_bands("library.csv", "paint")
    world.text("targets.csv", target_rows(planted))
    own = np.zeros((LINES, SAMPLES), bool)
    own[at] = True

    def separation(background):
        world.detection["background"] = background
        scores = world.observe().detected.score_maps["paint-cem"]
        return (scores[own].mean() - scores[~own].mean()) / scores[~own].std(ddof=1)

    # In units of the noise, d to the target and e the error of its spectrum: without targets in the covariance the
    # filter is d + e - (mean), with them d is weighed down by 1 + a (1 - a) d.(d + e).
    d, e = (level - flat) / sd, (off - level) / sd
    clean = d @ (d + e) / np.linalg.norm(d + e)
    assert clean == pytest.approx(43, rel=0.02)
    assert separation(["scene"]) == pytest.approx(clean, rel=0.05)
    mixed = share * (1 - share)
    moved = d * (1 - share) + e  # from the mean of all pixels
    weights = moved - d * mixed * (d @ moved) / (1 + mixed * (d @ d))
    spoilt = d @ weights / np.linalg.norm(weights)
    assert spoilt == pytest.approx(5, rel=0.1)
    assert separation(["image"]) == pytest.approx(spoilt, rel=0.1)


def test_correlation_filter_equals_plain_numpy(world):
    world.detection["detectors"] = ["cem", "cem-correlation"]
    target = world.on_bands("library.csv", "paint")
    mean, covariance = moments(world.values[~near_targets()])
    inverse = np.linalg.inv(covariance + np.outer(mean, mean))
    expected = world.values @ inverse @ target / (target @ inverse @ target)
    maps = world.observe().detected.score_maps
    assert set(maps) == {"paint-cem", "paint-cem-correlation"}
    assert maps["paint-cem-correlation"] == pytest.approx(expected, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(("choice", "used"), [("all", [0, 1, 2, 3, 4, 5, 6, 7]), ("good", [0, 1, 2, 3, 4, 5, 7]),
                                              ("windows", [0, 1, 2, 3, 4, 5, 7])])  # fmt: skip
def test_bands_of_the_detectors(world, choice, used):
    bad = np.arange(BANDS) != 6
    world.write(axis=type(AXIS)(AXIS.centre_nm, AXIS.fwhm_nm, bad))
    world.detection["bands"] = choice
    seen = world.observe()
    assert np.flatnonzero(seen.detected.bank.bands).tolist() == used
    assert f"detectors use {len(used)} of {BANDS} bands" in seen.observation.notes
    target = world.on_bands("library.csv", "paint")
    mean, covariance = moments(world.values[~near_targets()])
    expected = matched_filter(world.values[..., used], target[used], mean[used], covariance[np.ix_(used, used)])
    assert seen.detected.score_maps["paint-cem"] == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_bands_that_the_target_spectrum_lacks_are_not_used(world):
    rows = [f"{w},{0.5 - w / 8000}" for w in range(500, 1101)]
    world.text("part.csv", "\n".join(["wavelength_nm,paint", *rows]) + "\n")
    world.detection["targets"][0]["spectrum"] = world.source("part.csv", "part")
    assert world.observe().detected.bank.bands.tolist() == [False] + [True] * 6 + [False]


def asked(**changes):
    target = {"name": "paint", "material": "paint", "spectrum": {"constant": 0.5}}
    return Detection.model_validate({"background": ["grass"], "targets": [target], "detectors": ["cem"], **changes})


def test_bands_that_are_left_out_are_listed_with_the_rule():
    axis = SpectralAxis(
        np.array([500.0, 600, 700, 1380, 1400, 1650]), 10.0, np.array([True, False, False, True, True, True])
    )
    spectrum = np.array([0.1, 0.1, np.nan, 0.1, 0.1, np.nan])
    background = SampleStatistics(np.ones(6), np.eye(6), 100, 0, 0.0)
    used, (told,) = usable_bands(asked(bands="windows"), axis, [spectrum, np.ones(6)], None, background)
    assert used.tolist() == [True, False, False, False, False, False]
    assert told == (
        "bands that the detectors do not use: 2 bad in the band list (600-700 nm); "
        "2 in absorption bands (1380-1400 nm); 1 not in the target spectra (1650 nm)"
    )
    assert usable_bands(asked(bands="all"), axis, [np.ones(6)], None, background)[1] == []


def test_noisy_bands_are_left_out_on_request():
    """A background of one varying brightness and noise of stated size in each band."""
    axis = SpectralAxis(np.linspace(500.0, 900.0, 9), 10.0, np.ones(9, bool))
    noise = np.full(9, 0.1)
    noise[[2, 6, 7]] = 2.0, 0.5, 0.5
    mean = np.full(9, 10.0)
    background = SampleStatistics(mean, 4.0 * np.ones((9, 9)) + np.diag(noise**2), 100_000, 0, 0.0)
    used, (told,) = usable_bands(asked(least_snr=30), axis, [np.ones(9)], None, background)
    assert used.tolist() == [True, True, False, True, True, True, False, False, True]
    assert "3 with an SNR below 30 in the background (600, 800-850 nm)" in told
    # The noisiest has 10 / 2 = 5; beside quiet neighbours it is told as 5 sqrt(1.5) = 6.1.
    for least, dropped in ((6.0, []), (6.3, [2])):
        used, _ = usable_bands(asked(least_snr=least), axis, [np.ones(9)], None, background)
        assert np.flatnonzero(~used).tolist() == dropped
    with pytest.raises(UsageError, match=r"no band is left .* SNR below 1000"):
        usable_bands(asked(least_snr=1000), axis, [np.ones(9)], None, background)


def test_a_campaign_leaves_its_noisy_band_out(world):
    values = world.values.copy()
    values[..., 4] += np.random.default_rng(3).normal(0.0, 0.5 * values[..., 4].mean(), values.shape[:2])
    world.write(values=values)
    world.detection["least_snr"] = 4
    seen = world.observe().detected
    assert np.flatnonzero(~seen.bank.bands).tolist() == [4]
    assert any("with an SNR below 4 in the background" in note for note in seen.notes)


def test_no_band_left_is_an_error(world):
    world.write(axis=type(AXIS)(np.linspace(1350.0, 1480.0, BANDS), AXIS.fwhm_nm))
    world.detection["targets"][0]["spectrum"] = {"constant": 0.5}
    world.detection["bands"] = "windows"
    with pytest.raises(UsageError, match="no band is left for the detectors"):
        world.observe()


def test_products_of_each_group(world):
    seen = world.observe()
    scores = seen.detected.score_maps["paint-cem"]
    noise = scores[~near_targets()]
    observation = seen.observation
    assert set(observation.roc) == {(s, "cem", u) for s in ("fill 0.8", "fill 0.3") for u in ("pixel", "object")}
    for subject, fill in (("fill 0.8", 0.8), ("fill 0.3", 0.3)):
        pixels = np.array([scores[at] for at, f in PLANTED.items() if f == fill])
        assert observation.scores[subject, "cem"].mean == pytest.approx(pixels.mean(), rel=1e-12)
        assert observation.scores[subject, "cem"].sd == pytest.approx(pixels.std(ddof=1), rel=1e-12)
        assert observation.scores[subject, "cem"].n == pixels.size
        behind = observation.scores[background_of(subject), "cem"]
        assert (behind.mean, behind.sd) == pytest.approx((noise.mean(), noise.std(ddof=1)), abs=1e-12)
        curve = observation.roc[subject, "cem", "pixel"]
        assert (curve.n_target, curve.n_background) == (pixels.size, noise.size)
        direct = empirical_roc(pixels, noise, curve.pfa)
        assert np.array_equal(curve.pd, direct.pd)
        assert curve.background_area_km2 == pytest.approx(noise.size * 4.0 / 1e6)
    # The fill is the expected score; the background's own scatter is 0.01 to 0.02.
    assert observation.scores["fill 0.8", "cem"].mean == pytest.approx(0.8, abs=0.05)
    assert observation.scores["fill 0.3", "cem"].mean == pytest.approx(0.3, abs=0.05)


def test_mean_spectra_of_target_pixels_are_products(world):
    reflectance = world.observe().observation.reflectance
    pixels = np.array([world.values[at] for at, f in PLANTED.items() if f == 0.3])
    assert reflectance["fill 0.3"].mean == pytest.approx(pixels.mean(axis=0), rel=1e-12)
    assert reflectance["fill 0.3"].n == 3


def test_an_object_scores_its_best_pixel(world):
    # A side of 4 m is two pixels: the object touches 3 x 3 pixels around the centre of its middle pixel.
    rows = target_rows(PLANTED).replace(",0.5,", ",4.0,")
    world.text("targets.csv", rows)
    world.detection["group"] = "{name}"
    seen = world.observe()
    scores = seen.detected.score_maps["paint-cem"]
    nine = scores[9:12, 9:12]
    assert seen.observation.scores["t0", "cem"].n == 9
    assert seen.observation.scores["t0", "cem"].mean == pytest.approx(nine.mean())
    objects = seen.observation.roc["t0", "cem", "object"]
    assert objects.n_target == 1
    assert set(np.unique(objects.pd)) <= {0.0, 1.0}
    # Detected exactly where the threshold lies below the best pixel.
    assert np.array_equal(objects.pd == 1.0, (objects.threshold < nine.max()) | (objects.pfa >= 1.0))
    world.collection["targets"]["pixels"] = "centre"
    assert world.observe().observation.scores["t0", "cem"].n == 1


def test_false_alarms_are_counted_where_stated(world):
    world.detection["false_alarms"] = ["corner"]
    curve = world.observe().observation.roc["fill 0.3", "cem", "pixel"]
    assert curve.n_background == 200
    assert curve.background_area_km2 == pytest.approx(200 * 4.0 / 1e6)


def test_pools_count_the_targets_of_their_subjects(world):
    world.detection["pools"] = [{"name": "all", "subjects": ["fill 0.8", "fill 0.3"]}]
    roc = world.observe().observation.roc
    pool = roc["all", "cem", "pixel"]
    assert pool.n_target == 5
    parts = [roc[s, "cem", "pixel"] for s in ("fill 0.8", "fill 0.3")]
    assert pool.pd == pytest.approx((2 * parts[0].pd + 3 * parts[1].pd) / 5, abs=1e-12)


def test_areas_are_sums_of_scores_times_the_pixel_area(world):
    world.detection["areas"] = [{"target": "paint", "detector": "cem", "margin_pixels": 1}]
    seen = world.observe()
    scores = seen.detected.score_maps["paint-cem"]
    expected = np.mean([scores[i - 1 : i + 2, j - 1 : j + 2].sum() * 4.0 for (i, j), f in PLANTED.items() if f == 0.8])
    area = seen.observation.abundance["fill 0.8", "cem"]
    assert area.area_m2 == pytest.approx(expected, rel=1e-12)
    assert area.n == 18
    assert seen.detected.nominal_area_m2["fill 0.8", "cem"] == pytest.approx(3.2)
    # 9 independent pixels of background for each of 2 objects; their mean: sd sqrt(9/2) times 4 m2.  The spread
    # over about 180 placements is known to 5 %; 25 % is five times that.
    sd = scores[~near_targets()].std(ddof=1)
    assert area.standard_uncertainty == pytest.approx(sd * np.sqrt(9 / 2) * 4.0, rel=0.25)
    assert abs(area.area_m2 - 3.2) < 4.0 * area.standard_uncertainty


def test_the_margin_of_an_area_leaves_out_the_pixels_of_its_neighbours(world):
    world.text("targets.csv", target_rows({(10, 10): 0.8, (10, 11): 0.3}))
    world.detection["areas"] = [{"target": "paint", "detector": "cem", "margin_pixels": 1}]
    seen = world.observe()
    scores = seen.detected.score_maps["paint-cem"]
    area = seen.observation.abundance["fill 0.8", "cem"]
    assert area.n == 8
    assert area.area_m2 == pytest.approx(4.0 * (scores[9:12, 9:12].sum() - scores[10, 11]), rel=1e-12)


def test_the_error_of_an_area_knows_nothing_of_the_targets(world):
    # With every pixel behind the filter the targets must still not count as noise of the sum.
    world.detection |= {
        "background": ["image"], "areas": [{"target": "paint", "detector": "cem", "margin_pixels": 0}],
    }  # fmt: skip
    seen = world.observe()
    scores = seen.detected.score_maps["paint-cem"]
    sd = scores[~near_targets()].std(ddof=1)
    # Every pixel is a placement: the same number without sampling error.
    assert seen.observation.abundance["fill 0.3", "cem"].standard_uncertainty == pytest.approx(
        sd / np.sqrt(3) * 4.0, rel=1e-9
    )


def test_few_pixels_shrink_the_covariance_and_say_so(world):
    world.collection["regions"].append({"name": "patch", "rectangle": [40, 30, 4, 5]})
    world.detection["background"] = ["patch"]
    seen = world.observe()
    pixels = world.values[40:44, 30:35].reshape(-1, BANDS)
    (note,) = [n for n in seen.observation.notes if "shrunk" in n]
    assert note.startswith("20 background pixels are few: covariance shrunk by ")
    # Ledoit and Wolf (2004), written out.
    z = pixels - pixels.mean(axis=0)
    s = z.T @ z / len(z)
    mu = np.trace(s) / BANDS
    d2 = ((s - mu * np.eye(BANDS)) ** 2).sum()
    b2 = min(d2, sum(((np.outer(x, x) - s) ** 2).sum() for x in z) / len(z) ** 2)
    unbiased = s * len(z) / (len(z) - 1)
    shrunk = (1 - b2 / d2) * unbiased + b2 / d2 * np.trace(unbiased) / BANDS * np.eye(BANDS)
    target = world.on_bands("library.csv", "paint")
    expected = matched_filter(world.values, target, pixels.mean(axis=0), shrunk)
    assert seen.detected.score_maps["paint-cem"] == pytest.approx(expected, rel=1e-8, abs=1e-10)
    # The model's filter is made of the same covariance.
    assert seen.statistics["patch"].covariance == pytest.approx(shrunk, rel=1e-9, abs=1e-12)
    world.detection["background"] = ["scene"]
    seen = world.observe()
    assert not any("shrunk" in n for n in seen.observation.notes)
    assert seen.statistics["patch"].covariance == pytest.approx(unbiased, rel=1e-9, abs=1e-12)


def test_invalid_pixels_have_no_score_and_count_nowhere(world):
    values = world.values.copy()
    values[25, 25, 3] = np.nan
    values[20, 20, :] = np.nan  # a target pixel
    world.write(values)
    seen = world.observe()
    scores = seen.detected.score_maps["paint-cem"]
    assert np.flatnonzero(np.isnan(scores.ravel())).tolist() == [20 * SAMPLES + 20, 25 * SAMPLES + 25]
    assert seen.observation.scores["fill 0.3", "cem"].n == 2
    assert seen.observation.roc["fill 0.3", "cem", "object"].n_target == 2
    assert seen.observation.scores[background_of("fill 0.3"), "cem"].n == (~near_targets()).sum() - 1


def test_two_spectra_of_one_material(world):
    other = {"name": "second", "material": "paint", "spectrum": {"constant": 0.5}}
    world.detection["targets"].append(other)
    with pytest.raises(UsageError, match=r"two targets give the subject 'fill 0\.8'") as caught:
        world.observe()
    assert "{target}" in str(caught.value)
    world.detection["group"] = "{target} {group}"
    subjects = {s for s, _, _ in world.observe().observation.roc}
    assert subjects == {f"{t} fill {f}" for t in ("paint", "second") for f in ("0.8", "0.3")}


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"group": "{size}"}, UsageError, r"detection.group '\{size\}' does not fit the truth.*"),
        ({"group": "{0}"}, UsageError, "does not fit the truth: no '0'"),
        ({"group": "{name.__class__}"}, UsageError, "does not fit the truth"),
        ({"group": "{name:>999999999999}"}, UsageError, "does not fit the truth"),  # not a terabyte of blanks
        ({"background": ["nowhere"]}, UsageError, "no region 'nowhere'"),
        ({"false_alarms": ["nowhere"]}, UsageError, "no region 'nowhere'"),
        ({"pools": [{"name": "all", "subjects": ["fill 0.8", "fill 0.9"]}]}, UsageError,
         "pool 'all': no curve of fill 0.9"),
        ({"pools": [{"name": "fill 0.8", "subjects": ["fill 0.8", "fill 0.3"]}]}, UsageError,
         "bears the name of a subject"),
        ({"areas": [{"target": "paint", "detector": "cem-correlation"}]}, UsageError,
         "no score map of target 'paint'"),
        ({"areas": [{"target": "pain", "detector": "cem"}]}, UsageError, "no score map of target 'pain'"),
        ({"targets": [{"name": "a", "material": "metal", "spectrum": {"constant": 0.3}}]}, UsageError,
         "no object of material 'metal'"),
        ({"targets": [{"name": "a", "material": "paint", "spectrum": {"file": "no.csv"}}]}, InputError, "no such"),
        ({"targets": [{"name": "a", "material": "paint", "spectrum": {"measured": "corner"}}]}, UsageError,
         "measured statistics of region 'corner', which were not handed in"),
        ({"targets": [{"name": "a", "material": "paint", "spectrum": {"builtin": "gras"}}]}, UsageError,
         "unknown built-in surface 'gras'"),
    ],
)  # fmt: skip
def test_each_field_of_the_detection_has_its_error(world, change, error, message):
    world.detection |= change
    with pytest.raises(error, match=message):
        world.observe()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"detectors": ["amf"]}, "unknown detector 'amf'; one of "),
        ({"detectors": []}, "at least 1 item"),
        ({"targets": []}, "without targets the detectors can only be rx"),
        ({"targets": [{"name": "a", "material": "paint", "spectrum": {"constant": 0.3}}] * 2},
         "two detection targets are named 'a'"),
        ({"pools": [{"name": "all", "subjects": ["fill 0.8"]}]}, "at least 2 items"),
        ({"bands": "some"}, "Input should be 'all', 'good' or 'windows'"),
    ],
)  # fmt: skip
def test_settings_of_the_detection_that_mean_nothing_are_refused(world, change, message):
    with pytest.raises(ValueError, match=message):
        Detection.model_validate(world.detection | change)


def test_no_target_in_the_truth_and_no_truth(world):
    del world.collection["targets"]
    with pytest.raises(UsageError, match="the truth has no object of material 'paint'"):
        world.observe()


def test_areas_need_a_ground_size(world):
    write_cube(world.folder / "cube.img", world.values, data_type=5, axis=AXIS)
    world.collection["targets"] = None
    world.detection["areas"] = [{"target": "paint", "detector": "cem"}]
    sizes = np.zeros((LINES, SAMPLES, 1), np.uint8)
    mask = np.zeros((LINES, SAMPLES, 1), np.uint8)
    for at in PLANTED:
        sizes[at], mask[at] = 1, 1
    write_cube(world.folder / "sizes.img", sizes, data_type=1, file_type="ENVI Standard")
    write_cube(world.folder / "paint.img", mask, data_type=1, file_type="ENVI Standard")
    world.collection["targets"] = {
        "rasters": {"materials": {"paint": "paint.img"}, "size_classes": "sizes.img", "side_m": {1: 0.5}}
    }
    world.detection["group"] = "{material} {side_m} m"
    with pytest.raises(UsageError, match="areas need the ground area of a pixel"):
        world.observe()
    world.detection["areas"] = []
    observation = world.observe().observation
    assert observation.scores["paint 0.5 m", "cem"].n == 5
    assert observation.roc["paint 0.5 m", "cem", "pixel"].background_area_km2 is None


def test_a_band_without_variance_is_named(world):
    values = world.values.copy()
    values[:, :, 7] = 0.25
    world.write(values)
    with pytest.raises(UsageError, match=r"1 of 8 bands have no variance \(first: band 8\)"):
        world.observe()


def without_wavelengths(world, spectrum):
    """The same cube, its header without wavelengths, and the target as one value a band."""
    header = world.folder / "cube.hdr"
    lines, inside = [], False
    for line in header.read_text().splitlines():
        if line.lower().startswith(("wavelength", "fwhm")):
            inside = "{" in line and "}" not in line
        elif inside:
            inside = "}" not in line
        else:
            lines.append(line)
    header.write_text("\n".join(lines) + "\n")
    rows = [f"{i + 1} {value:.15g}" for i, value in enumerate(spectrum)]
    world.text("paint.txt", "# band, reflectance\n" + "\n".join(rows) + "\n")
    world.collection["cube"]["by_number"] = True
    world.detection["targets"][0]["spectrum"] = {"file": "paint.txt"}


def test_bands_by_number_give_the_scores_that_wavelengths_give(world):
    world.detection["detectors"] = ["matched-filter", "ace"]
    spectrum = world.on_bands("library.csv", "paint")
    known = world.observe()
    without_wavelengths(world, spectrum)
    by_number = world.observe()
    for name, values in known.detected.score_maps.items():
        np.testing.assert_allclose(by_number.detected.score_maps[name], values, rtol=1e-9, atol=1e-12)
    assert by_number.observation.axis.centre_nm.tolist() == [1, 2, 3, 4, 5, 6, 7, 8]
    assert any("it is the number of a band" in note for note in by_number.observation.notes)
    assert not by_number.observation.distribution


def test_bands_by_number_refuse_what_goes_by_wavelength(world):
    spectrum = world.on_bands("library.csv", "paint")
    without_wavelengths(world, spectrum[:-1])
    with pytest.raises(InputError, match="7 values for 8 bands"):
        world.observe()
    world.text("paint.txt", "0.1\nnone\n")
    with pytest.raises(InputError, match=r"(?s)not a row of numbers.*a heading begins with #"):
        world.observe()
    world.detection["targets"][0]["spectrum"] = {"constant": 0.3}
    with pytest.raises(UsageError, match="goes by wavelength, the bands of the cube by number"):
        world.observe()
    del world.collection["cube"]["by_number"]
    with pytest.raises(InputError, match="lists no wavelengths"):
        world.observe()


def test_mean_score_has_its_own_error_where_the_filter_is_made_of_the_pixels_it_scores(world):
    world.detection["detectors"] = ["cem-correlation"]
    same = world.observe().observation.scores[background_of("fill 0.8"), "cem-correlation"]
    assert 0.0 < same.mean_error < same.sd / same.n**0.5
    assert abs(same.mean_bias) < same.mean_error
    world.detection["background"] = ["corner"]
    assert np.isnan(world.observe().observation.scores[background_of("fill 0.8"), "cem-correlation"].mean_error)
