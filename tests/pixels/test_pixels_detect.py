"""Detectors and classifiers on spectra and on stored cubes: SPy, closed forms, brute force, and what is refused."""

import numpy as np
import pytest
import spectral
from scipy import special, stats
from stored_cubes import BANDS, LINES, SAMPLES, numbers, stored

from hyperval import model, pixels
from hyperval.errors import UsageError
from hyperval.imagery import TargetObject
from hyperval.products import ClassificationError

# Detectors on spectra and on stored cubes: SPy, closed forms and brute force, and what is refused.


B = 12


@pytest.fixture
def scene():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(500, B)) @ rng.normal(size=(B, B)) + 10
    target = 1.2 * x[0] + rng.normal(size=B)
    return x, target, x.mean(axis=0), np.cov(x.T)


def score(name, scene, undesired=None):
    x, target, mean, covariance = scene
    detector = pixels.pixel_detector(name, target, mean, covariance, undesired)
    return detector.score(x, pixels.whitener_of(mean, covariance))


def close(found, expected):
    return np.max(np.abs(found - expected)) <= 1e-9 * np.max(np.abs(expected))


def test_equal_to_spy(scene):
    x, target, mean, covariance = scene
    image, background = x.reshape(50, 10, B), spectral.GaussianStats(mean, covariance)
    assert close(score("cem", scene), spectral.matched_filter(image, target, background).ravel())
    assert close(score("ace", scene), spectral.ace(image, target, background=background).ravel())
    assert close(score("rx", scene), spectral.rx(image, background=background).ravel())
    assert close(score("sam", scene), -spectral.spectral_angles(image, target[None]).ravel())


def test_equal_to_their_definitions(scene):
    # The formulas of the other public package (its float32 outputs and removed NumPy names left out).
    x, target, mean, covariance = scene
    inverse, d, z = np.linalg.inv(covariance), target - mean, x - mean
    assert close(score("matched-filter", scene), z @ inverse @ d / (d @ inverse @ d))
    assert score("smf", scene).std(ddof=1) == pytest.approx(1)  # over the sample that gave the covariance
    r = x.T @ x / len(x)
    n = len(x)
    own = pixels.pixel_detector("cem-correlation", target, mean, covariance * (n - 1) / n).score(x)
    assert close(own, x @ np.linalg.inv(r) @ target / (target @ np.linalg.inv(r) @ target))
    u = x[5:8]
    p = np.eye(B) - u.T @ np.linalg.pinv(u.T)
    assert close(score("osp", scene, u), x @ p @ target / (target @ p @ target))


def test_a_nan_pixel_is_nan_and_a_zero_pixel_has_no_angle(scene):
    _, target, mean, covariance = scene
    whitener = pixels.whitener_of(mean, covariance)
    bad = np.where(np.arange(B) == 3, np.nan, 5.0)
    for name in pixels.DETECTORS:
        detector = pixels.pixel_detector(name, target, mean, covariance, np.ones((1, B)))
        assert np.isnan(detector.score(bad, whitener)), name
    assert np.isnan(pixels.pixel_detector("sam", target, mean, covariance).score(np.zeros(B)))
    assert np.isnan(pixels.pixel_detector("ace", target, mean, covariance).score(mean, whitener))


def line_of(bands):
    def one(name, rho):
        rho = np.full(bands, rho)
        return pixels.MeasuredPanel(name, rho, np.zeros(bands), 2.0 + np.arange(1, bands + 1) * rho, np.zeros(bands), 9)

    return pixels.fit_elm([one("black", 0.05), one("white", 0.6)])


@pytest.mark.parametrize("interleave", ["bil", "bip", "bsq"])
def test_scores_equal_the_long_way_round(tmp_path, monkeypatch, interleave):
    x = numbers()
    x[4, 4] = -9999
    x[5, 5, 29] = -9999  # in a band that no detector uses
    cube = stored(
        tmp_path, x, interleave, extra="data ignore value = -9999\n", quantity="radiance",
        unit="uW cm-2 sr-1 nm-1", scale=0.002,
    )  # fmt: skip
    elm = line_of(BANDS)
    bands = np.ones(BANDS, bool)
    bands[[3, 4, 11, 29]] = False
    valid = np.ones((LINES, SAMPLES), bool)
    valid[4, 4] = False
    rho = elm.reflectance(0.002 * x)[..., bands]
    mean, covariance = rho[valid].mean(axis=0), np.cov(rho[valid].T)
    target = mean * 1.3 + np.linspace(0, 0.2, mean.size)
    names = ("cem", "cem-correlation", "smf", "ace", "sam", "rx", "osp")
    detectors = {n: pixels.pixel_detector(n, target, mean, covariance, rho[:3, 0]) for n in names}
    whitener = pixels.whitener_of(mean, covariance)
    for step, threads in ((10**3, 2), (1, 1), (7, 2)):
        monkeypatch.setattr("hyperval.pixels.statistics.BLOCK_PIXELS", step * SAMPLES)
        monkeypatch.setattr("hyperval.pixels.statistics.available_cores", lambda n=threads: n)
        found = pixels.score_cube(cube, detectors, elm, bands, whitener=whitener)
        for name, detector in detectors.items():
            assert found[name].shape == (LINES, SAMPLES)
            assert np.isnan(found[name][4, 4])  # never a score of 0
            assert np.isfinite(found[name]).sum() == LINES * SAMPLES - 1
            assert found[name][valid] == pytest.approx(detector.score(rho[valid], whitener), rel=1e-9, abs=1e-9)
    also = pixels.score_cube(cube, {"cem": detectors["cem"]}, elm, bands, needed=np.ones(BANDS, bool))["cem"]
    assert np.isnan(also[5, 5])


def test_scoring_refuses_what_does_not_fit(tmp_path):
    cube, elm = stored(tmp_path, numbers()), line_of(BANDS)
    mean, covariance = np.arange(1.0, BANDS + 1), np.eye(BANDS)
    cem = pixels.pixel_detector("cem", mean + 1, mean, covariance)
    with pytest.raises(UsageError, match="made for 30 bands, 29"):
        pixels.score_cube(cube, {"a": cem}, elm, np.arange(BANDS) > 0)
    with pytest.raises(UsageError, match="whitener"):
        pixels.score_cube(cube, {"a": pixels.pixel_detector("rx", None, mean, covariance)})
    elm.gain[1] = np.nan
    with pytest.raises(UsageError, match="no gain in 1 of"):
        pixels.score_cube(cube, {"a": cem}, elm)


@pytest.fixture(scope="module")
def drifting(tmp_path_factory):
    """A cube over a background that drifts, an unused band, a pixel without data; spectra, pixels with data, target."""
    rng, bands = np.random.default_rng(0), 7
    x = 0.1 + np.linspace(0, 0.2, LINES)[:, None, None] * np.linspace(1, 2, bands)
    x = x + 0.02 * rng.normal(size=(LINES, SAMPLES, bands)) @ rng.normal(size=(bands, bands))
    x[5, 7] = -9999.0
    cube = stored(tmp_path_factory.mktemp("c"), x, dtype="<f8", extra="data ignore value = -9999\n")
    valid, used = x[..., 0] != -9999.0, np.arange(bands) != 3
    x = x[..., used]
    return cube, used, x, valid, x[valid].mean(axis=0), np.cov(x[valid].T)


@pytest.mark.parametrize("window", [(9, 3), (5, 1), (101, 5)])
@pytest.mark.parametrize("threads", [1, 2])
def test_every_detector_equals_its_definition_with_the_mean_of_its_own_window(drifting, monkeypatch, window, threads):
    cube, used, x, valid, mean, covariance = drifting
    counted = valid.copy()
    counted[20:23, 10:14] = False
    target = mean + np.linspace(0.05, 0.3, mean.size)
    names = {name: (name, None if name == "rx" else target) for name in pixels.LOCAL_DETECTORS}
    if threads == 2:
        monkeypatch.setattr(pixels.detect, "_STRIP_VALUES", 0)  # strips that end within the image
    whitener = pixels.whitener_of(mean, covariance)
    monkeypatch.setattr("hyperval.pixels.statistics.available_cores", lambda: threads)
    found, _ = pixels.score_cube_locally(cube, names, whitener, window, counted, None, used)
    for line, sample in ((0, 0), (5, 8), (18, 14), (21, 12), (46, 22), (30, 0), (8, 19), (9, 20)):
        ring = np.zeros_like(counted)
        for side, value in ((window[0], True), (window[1], False)):
            h = side // 2
            ring[max(line - h, 0) : line + h + 1, max(sample - h, 0) : sample + h + 1] = value
        near = x[ring & counted]
        own = near.mean(axis=0) if len(near) >= 10 else mean
        for name in pixels.LOCAL_DETECTORS:
            detector = pixels.pixel_detector(name, names[name][1], own, covariance)
            expected = detector.score(x[line, sample], pixels.whitener_of(own, covariance))
            assert found[name][line, sample] == pytest.approx(float(expected), rel=1e-9, abs=1e-10), name
    assert all(np.array_equal(np.isfinite(m), valid) for m in found.values())


@pytest.mark.parametrize("halo", [0, 1, 4])
def test_an_object_in_its_window_scores_as_in_the_whole_image(halo):
    scores = np.random.default_rng(0).normal(size=(9, 12))
    for line, sample, part in ((0, 0, [[1, 0], [1, 1]]), (7, 9, [[0, 1, 1], [1, 0, 0]]), (4, 5, [[1]])):
        part = np.array(part, bool)
        mask = np.zeros(scores.shape, bool)
        mask[line : line + part.shape[0], sample : sample + part.shape[1]] = part
        placed = TargetObject("window", "", 1.0, 1.0, scores.shape, (line, sample), part)
        brute = scores[pixels.mask_with_halo(mask, halo)]
        assert pixels.object_scores(scores, [placed], halo) == {"window": brute.max()}


def test_footprint_tiles_by_hand_and_without_the_excluded():
    scores = np.arange(24.0).reshape(4, 6)
    assert sorted(pixels.footprint_tiles(scores, np.ones((2, 3), bool))[0].max(axis=1)) == [8.0, 11.0, 20.0, 23.0]
    cross = np.array([[True, False], [False, False]])
    assert sorted(pixels.footprint_tiles(scores, cross)[0].ravel()) == [0, 2, 4, 12, 14, 16]
    exclude = np.zeros((4, 6), bool)
    exclude[0, 0] = True
    under, lines, samples = pixels.footprint_tiles(scores, np.ones((2, 3), bool), exclude)
    maxima = under.max(axis=1)
    assert sorted(maxima) == [11.0, 20.0, 23.0]
    assert all(scores[a : a + 2, b : b + 3].max() == m for m, a, b in zip(maxima, lines, samples, strict=True))
    sums = pixels.footprint_tiles(scores, np.array([[True, True], [True, False]]), exclude)[0].sum(axis=1)
    assert sums.tolist() == [scores[r, c] + scores[r, c + 1] + scores[r + 1, c] for r in (0, 2) for c in (0, 2, 4)][1:]
    assert pixels.footprint_tiles(np.full((4, 4), np.nan), np.ones((2, 2), bool))[0].size == 0
    with pytest.raises(UsageError, match="does not fit"):
        pixels.footprint_tiles(scores, np.ones((5, 5), bool))


# Gaussian classification: closed forms, bounds, errors of pixels, and pixels that err together.


def law(mean, spread=1.0, dof=np.inf):
    return model.ClassLaw(np.asarray(mean, dtype=float), spread * np.eye(len(mean)), dof)


def test_equal_covariances_have_the_closed_form():
    # Two classes 2.5 standard deviations apart: error Phi(-1.25), which the estimate is for equal covariances.
    found = model.predicted_error([law([0.0, 0.0]), law([2.5, 0.0])], np.random.default_rng(1), 40_000)
    exact = special.ndtr(-1.25)
    assert found.approximation == pytest.approx(exact, rel=1e-12)
    assert found.distance == pytest.approx(2.5**2 / 8)
    # 80,000 pixels: four standard deviations.
    assert found.error == pytest.approx(exact, abs=4 * np.sqrt(exact / 80_000))
    assert found.lower < found.error < found.upper


def test_classifier_is_quadratic_discriminant_analysis():
    # Against the log density itself.
    laws = [law([0.0, 1.0], 2.0), law([1.0, 0.0], 0.5)]
    x = np.random.default_rng(6).normal(size=(200, 2))
    density = [stats.multivariate_normal.logpdf(x, one.mean, one.covariance) for one in laws]
    assert np.array_equal(model.gaussian_classes(laws, x), np.argmax(density, axis=0))


def test_pixels_that_err_together_count_once():
    # Blocks share their pixel: 25 pixels of each block are one. The interval must be that of the blocks.
    laws, rng = [law([0.0]), law([2.0])], np.random.default_rng(8)
    exact, inside, effective = special.ndtr(-1.0), 0, []
    for _ in range(150):
        x = [np.repeat(one.draw(60, rng), 25, axis=0) for one in laws]
        found = model.measured_error(laws, x, [np.repeat(np.arange(60), 25)] * 2)
        inside += found.lower <= exact <= found.upper
        effective.append(found.effective_n)
    # The spread between blocks is itself estimated, from 60 of each class: a little below 95 %.
    assert inside >= 130
    assert np.median(effective) == pytest.approx(120, rel=0.15)


def test_no_error_at_all_gives_the_one_sided_limit():
    laws = [law([0.0]), law([50.0])]
    x = [one.draw(100, np.random.default_rng(9)) for one in laws]
    found = model.measured_error(laws, x, [np.arange(100)] * 2)
    assert (found.error, found.lower, found.n) == (0.0, 0.0, 200)
    assert found.upper == pytest.approx(1 - 0.025 ** (1 / 200))


def test_features():
    centre = np.array([450.0, 550.0, 650.0, 800.0])
    usable = np.array([True, True, False, True])
    assert model.feature_bands(centre, usable, []).tolist() == [0, 1, 3]
    assert model.feature_bands(centre, usable, [640.0, 790.0]).tolist() == [1, 3]
    with pytest.raises(UsageError, match="share the band at 550 nm"):
        model.feature_bands(centre, usable, [560.0, 600.0])
    laws = [law([0.0, 0.0, 0.0], 0.01), law([3.0, 4.0, 0.0], 0.01)]
    assert model.class_features(laws, None) == pytest.approx(np.eye(3))
    # The classes differ along (3, 4, 0): that is the first component.
    assert model.class_features(laws, 1) == pytest.approx(np.array([[0.6, 0.8, 0.0]]), abs=1e-9)


def test_pixels_of_a_t_law_have_the_covariance_that_is_stated():
    # 200,000 pixels of 8 degrees of freedom: a variance is known to 0.5 %.
    covariance = np.array([[2.0, 0.6], [0.6, 1.0]])
    x = model.ClassLaw(np.zeros(2), covariance, 8.0).draw(200_000, np.random.default_rng(10))
    assert np.cov(x.T) == pytest.approx(covariance, rel=0.025)


def test_distances_of_three_classes_take_the_nearest_pair():
    laws = [model.ClassLaw(np.array([at]), np.eye(1)) for at in (0.0, 1.0, 4.0)]
    found = model.with_distances(ClassificationError(0.2, 0.1, 0.3, 100), laws)
    distance = [d**2 / 8 for d in (1.0, 4.0, 3.0)]
    assert found.distance == pytest.approx(min(distance))
    pair = [0.5 - 0.5 * np.sqrt(1 - np.exp(-2 * d)) for d in distance]
    assert found.bound_lower == pytest.approx(2 / 3 * max(pair))
    assert found.bound_upper == pytest.approx(min(sum(np.exp(-d) for d in distance) / 3, 2 / 3))
    assert found.approximation == pytest.approx(sum(2 / 3 * stats.norm.cdf(-d / 2) for d in (1.0, 4.0, 3.0)))
