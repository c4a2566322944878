"""Each broken assumption shows in the pixels, and closure shows none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kurtosis
from small_scene import area, small_scene

from hyperval.simulate import SurfaceRenderer, admixture_share, correlated_field, lay_out, pixel_weights

SIZE = 96
FIELD = {
    "lines": SIZE, "samples": SIZE, "targets": [], "regions": [],
    "layout": [area("grass", [0, SIZE], [0, SIZE]), area("asphalt", [0, SIZE], [80, SIZE])],
}  # fmt: skip


def rendered(classes, **broken) -> np.ndarray:
    scene = small_scene(**(FIELD | ({"mode": "broken", "broken": broken} if broken else {})))
    renderer = SurfaceRenderer(scene, lay_out(scene), classes)
    return np.stack([renderer.lit_reflectance(line) for line in range(scene.lines)])


def grass(cube: np.ndarray) -> np.ndarray:
    return cube[20:, :76].astype(float)


def neighbour_correlation(cube: np.ndarray, lag: int = 1) -> float:
    brightness = grass(cube).mean(axis=2)
    return float(np.corrcoef(brightness[:, :-lag].ravel(), brightness[:, lag:].ravel())[0, 1])


# Pixels in the grass: 76 x 76; 5 standard errors of a correlation, of a kurtosis.
CHANCE = 5 / np.sqrt(76 * 75)
KURTOSIS_CHANCE = 5 * np.sqrt(24 / 76**2)


def test_closure_has_neither_tails_nor_texture_nor_soft_edges(classes):
    cube = rendered(classes)
    assert abs(neighbour_correlation(cube)) < CHANCE
    assert abs(kurtosis(grass(cube).mean(axis=2), axis=None)) < KURTOSIS_CHANCE
    edge, inside = cube[:, 79].astype(float).mean(), grass(cube).mean()
    assert edge == pytest.approx(inside, abs=5 * grass(cube).mean(axis=2).std() / np.sqrt(SIZE))


def test_heavy_tails_raise_the_kurtosis_and_keep_the_spread(classes):
    plain, heavy = rendered(classes), rendered(classes, heavy_tails={"dof": 5.0})
    assert kurtosis(grass(heavy).mean(axis=2), axis=None) > 1.0 > KURTOSIS_CHANCE
    assert np.std(grass(heavy)) == pytest.approx(np.std(grass(plain)), rel=0.1)
    assert abs(neighbour_correlation(heavy)) < CHANCE
    far = rendered(classes, heavy_tails={"dof": 2.05})
    assert 0.0 <= far.min() < far.max() <= 1.0  # what no surface can reflect is cut off


def test_texture_correlates_neighbours_up_to_its_length(classes):
    cube = rendered(classes, texture={"relative_sd": 0.2, "correlation_pixels": 4.0})
    assert neighbour_correlation(cube) > 0.5
    assert neighbour_correlation(cube) > neighbour_correlation(cube, 4) > neighbour_correlation(cube, 12)
    white = cube[10:18, 30:38]
    assert np.allclose(white, rendered(classes)[10:18, 30:38], atol=1e-6)  # panels are kept out


def test_soft_edges_mix_the_classes_across_a_border(classes):
    cube = rendered(classes, soft_edges=True).astype(float)
    weights = pixel_weights(1.0)
    across = weights[weights.size // 2 + 1 :].sum()  # what a pixel beside a straight border sees of the other class
    for band in (0, 11):
        left, right = classes["grass"].mean[band], classes["asphalt"].mean[band]
        found = cube[20:, 79, band].mean()
        spread = cube[20:, 79, band].std() / np.sqrt(SIZE - 20)
        assert abs(found - ((1 - across) * left + across * right)) < 5 * spread
        assert abs(found - left) > 5 * spread


def test_shade_darkens_its_share_of_the_ground_but_no_panel(classes):
    shade = {"area_fraction": 0.2, "illumination": 0.4, "correlation_pixels": 8.0}
    plain, cube = rendered(classes), rendered(classes, shade=shade)
    ratio = np.median(cube / plain, axis=2)
    assert ratio.min() == pytest.approx(0.4, abs=1e-3)
    assert ratio.max() == pytest.approx(1.0, abs=1e-6)
    assert np.allclose(ratio[9:19, 29:39], 1.0)
    assert 0.1 < np.mean(ratio < 0.7) < 0.25


def test_an_admixture_moves_the_mean_towards_the_other_surface(classes):
    share = {"host": "grass", "surface": "soil", "mean": 0.3, "sd": 0.15, "correlation_pixels": 3.0}
    cube = rendered(classes, admixtures=[share])
    scene = small_scene(**(FIELD | {"mode": "broken", "broken": {"admixtures": [share]}}))
    field = admixture_share(scene, scene.broken.admixtures[0], 0)
    f = float(field[20:, :76].mean())
    expected = (1 - f) * classes["grass"].mean + f * classes["soil"].mean
    found = grass(cube).mean(axis=(0, 1))
    # The shares are known: what is left is the pixels' own spread. 6 standard errors over 12 bands.
    assert np.all(np.abs(found - expected) < 6 * grass(cube).std(axis=(0, 1)) / 76 + 1e-5)
    assert np.all(np.abs(found - classes["grass"].mean) > 1e-3)


@pytest.mark.parametrize("length", [4.0, 10.0])
def test_a_field_has_the_asked_correlation(length):
    field = correlated_field((600, 600), length, np.random.default_rng(8)).astype(float)
    assert field.mean() == pytest.approx(0.0, abs=1e-5)
    assert field.std() == pytest.approx(1.0, abs=1e-5)
    lag = int(length)
    found = np.mean(field[:, :-lag] * field[:, lag:])
    # About (600/length)^2 / 6 independent patches; 5 standard errors.
    assert found == pytest.approx(np.exp(-1.0), abs=5 / np.sqrt((600 / length) ** 2 / 6))


def test_admixture_shares_have_the_moments_asked_for():
    wish = {"host": "grass", "surface": "soil", "mean": 0.1, "sd": 0.07}
    ground = [{"surface": "grass", "lines": [0, 400], "samples": [0, 400]}]
    size = {"lines": 400, "samples": 400, "layout": ground}
    scene = small_scene(**(FIELD | size | {"mode": "broken", "broken": {"admixtures": [wish]}}))
    share = admixture_share(scene, scene.broken.admixtures[0], 0).astype(float)
    assert 0.0 <= share.min() < share.max() <= 1.0
    assert share.mean() == pytest.approx(0.1, abs=5 * 0.07 / 400)
    assert share.std() == pytest.approx(0.07, rel=0.02)
