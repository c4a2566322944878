"""Drawn reflectance against the statistics it is drawn from; each broken assumption shows, and closure shows none."""

import numpy as np
import pytest
from scipy.stats import chi2, kurtosis
from small_scene import CLASSES, SCENE, area, planks, small_scene

from hyperval.simulate import Sampler, SurfaceRenderer, admixture_share, correlated_field, lay_out, pixel_weights
from hyperval.statistics_library import ClassStatistics

# Each statistical test of whitened values fails by chance with this probability per assertion.
ALPHA = 1e-5
GRASS = CLASSES["grass"]


def renderer_of(scene, classes=CLASSES) -> SurfaceRenderer:
    return SurfaceRenderer(scene, lay_out(scene), classes)


def whitened(values: np.ndarray, statistics: ClassStatistics) -> np.ndarray:
    lower = np.linalg.cholesky(statistics.covariance)
    return np.linalg.solve(lower, (values.astype(float) - statistics.mean).T).T


def assert_drawn_from(values: np.ndarray, statistics: ClassStatistics) -> None:
    """Mean and covariance of the sample against the definition, in whitened coordinates."""
    z = whitened(values, statistics)
    n, bands = z.shape
    assert n * np.sum(z.mean(axis=0) ** 2) < chi2.isf(ALPHA, bands)
    assert chi2.isf(1 - ALPHA, n * bands) < np.sum(z**2) < chi2.isf(ALPHA, n * bands)
    # Products of different whitened bands are uncorrelated with mean 0 and variance 1.
    products = (z.T @ z)[np.triu_indices(bands, 1)]
    assert np.sum(products**2) / n < chi2.isf(ALPHA, products.size) * 1.05  # 5 %: products have heavier tails


def test_pixels_and_planks_have_the_statistics_of_their_class():
    renderer = renderer_of(small_scene(targets=[], panels=[]))
    for name, lines in (("grass", range(30)), ("asphalt", range(30, 60))):
        drawn = np.concatenate([renderer.reflectance(line) for line in lines])
        assert_drawn_from(drawn, CLASSES[name])
        with pytest.raises(AssertionError):
            assert_drawn_from(drawn * np.float32(1.03), CLASSES[name])
    group = planks(count=400, area={"lines": [5, 155], "samples": [5, 395]})
    ground = {"lines": 400, "samples": 400, "layout": [area("asphalt", [0, 400], [0, 400])]}
    spectra = renderer_of(small_scene(**ground, panels=[], regions=[], targets=[group])).target_spectra
    assert spectra.shape[0] == 400
    assert_drawn_from(spectra, CLASSES["yellow-paint-plank"])


def test_a_covariance_of_rank_one_is_drawn():
    mode = np.linspace(0.01, 0.03, 12)
    line = ClassStatistics("line", GRASS.axis, np.full(12, 0.3), np.outer(mode, mode))
    values = Sampler(line).draw(2000, np.random.default_rng(2)).astype(float) - 0.3
    score = values @ mode / (mode @ mode)
    assert np.max(np.abs(values - score[:, None] * mode)) < 2e-6
    assert np.sum(score**2) == pytest.approx(2000, abs=5 * np.sqrt(2 * 2000))  # 5 sigma of chi-square


def test_a_multivariate_t_keeps_the_covariance_and_gains_tails():
    z = whitened(Sampler(GRASS, dof=12.0).draw(200_000, np.random.default_rng(5)), GRASS)
    # The kurtosis of a t with 12 degrees of freedom is 3 + 6/8; standard errors at n = 2e5 and 12 bands,
    # from the eighth moment: 0.04 per band; 6 of them.
    assert np.var(z, axis=0).mean() == pytest.approx(1.0, abs=0.02)
    assert kurtosis(z, axis=0).mean() == pytest.approx(0.75, abs=0.24)


def test_a_plank_pixel_is_the_mixture_of_its_plank_and_its_host():
    still = {name: ClassStatistics(name, c.axis, c.mean, 1e-16 * np.eye(len(c.axis))) for name, c in CLASSES.items()}
    renderer = renderer_of(SCENE, still)
    host, target = still["asphalt"].mean, still["yellow-paint-plank"].mean
    fill = renderer.ground.fill.astype(float)[:, :, None]
    for line in range(35, 52):
        mixed = fill[line] * target + (1 - fill[line]) * host
        assert np.max(np.abs(renderer.reflectance(line) - mixed)) < 1e-6
    assert np.count_nonzero(fill[35:52]) == np.count_nonzero(fill) > 0


def test_a_line_is_the_same_however_often_it_is_drawn_and_others_are_independent():
    def line_of(seed, line, before=()):
        ground = [area("grass", [0, 60], [0, 1000])]
        renderer = renderer_of(small_scene(seed=seed, samples=1000, targets=[], panels=[], layout=ground, regions=[]))
        return [renderer.reflectance(k) for k in (*before, line)][-1]

    first = line_of(1, 0)
    assert np.array_equal(first, line_of(1, 0, before=(3, 0)))
    for other in (line_of(1, 1), line_of(2, 0)):
        # 5 sigma of a correlation of 12,000 pairs.
        pair = [whitened(values, GRASS).ravel() for values in (first, other)]
        assert abs(np.corrcoef(pair)[0, 1]) < 5 / np.sqrt(12_000)


SIZE = 96
FIELD = {
    "lines": SIZE, "samples": SIZE, "targets": [], "regions": [],
    "layout": [area("grass", [0, SIZE], [0, SIZE]), area("asphalt", [0, SIZE], [80, SIZE])],
}  # fmt: skip


def broken_scene(**broken):
    return small_scene(**(FIELD | ({"mode": "broken", "broken": broken} if broken else {})))


def rendered(**broken) -> np.ndarray:
    renderer = renderer_of(broken_scene(**broken))
    return np.stack([renderer.reflectance(line) for line in range(SIZE)]).astype(float)


PLAIN = rendered()


def grass(cube: np.ndarray) -> np.ndarray:
    return cube[20:, :76]


def neighbour_correlation(cube: np.ndarray, lag: int = 1) -> float:
    brightness = grass(cube).mean(axis=2)
    return float(np.corrcoef(brightness[:, :-lag].ravel(), brightness[:, lag:].ravel())[0, 1])


# Pixels in the grass: 76 x 76; 5 standard errors of a correlation, of a kurtosis.
CHANCE = 5 / np.sqrt(76 * 75)
KURTOSIS_CHANCE = 5 * np.sqrt(24 / 76**2)


def test_closure_has_neither_tails_nor_texture_nor_soft_edges():
    assert abs(neighbour_correlation(PLAIN)) < CHANCE
    assert abs(kurtosis(grass(PLAIN).mean(axis=2), axis=None)) < KURTOSIS_CHANCE
    spread = grass(PLAIN).mean(axis=2).std() / np.sqrt(SIZE)
    assert PLAIN[:, 79].mean() == pytest.approx(grass(PLAIN).mean(), abs=5 * spread)


def test_heavy_tails_raise_the_kurtosis_and_keep_the_spread():
    heavy = rendered(heavy_tails={"dof": 5.0})
    assert kurtosis(grass(heavy).mean(axis=2), axis=None) > 1.0 > KURTOSIS_CHANCE
    assert np.std(grass(heavy)) == pytest.approx(np.std(grass(PLAIN)), rel=0.1)
    assert abs(neighbour_correlation(heavy)) < CHANCE
    far = rendered(heavy_tails={"dof": 2.05})
    assert 0.0 <= far.min() < far.max() <= 1.0  # what no surface can reflect is cut off


def test_texture_correlates_neighbours_up_to_its_length():
    cube = rendered(texture={"relative_sd": 0.2, "correlation_pixels": 4.0})
    assert neighbour_correlation(cube) > 0.5
    assert neighbour_correlation(cube) > neighbour_correlation(cube, 4) > neighbour_correlation(cube, 12)
    assert np.allclose(cube[10:18, 30:38], PLAIN[10:18, 30:38], atol=1e-6)  # panels are kept out


def test_soft_edges_mix_the_classes_across_a_border():
    edge = rendered(soft_edges=True)[20:, 79]
    weights = pixel_weights(1.0)
    across = weights[weights.size // 2 + 1 :].sum()  # what a pixel beside a straight border sees of the other class
    spread = edge.std(axis=0) / np.sqrt(SIZE - 20)
    expected = (1 - across) * GRASS.mean + across * CLASSES["asphalt"].mean
    assert np.all(np.abs(edge.mean(axis=0) - expected) < 5 * spread)
    assert np.all(np.abs(edge.mean(axis=0) - GRASS.mean) > 5 * spread)


def test_shade_darkens_its_share_of_the_ground_but_no_panel():
    cube = rendered(shade={"area_fraction": 0.2, "illumination": 0.4, "correlation_pixels": 8.0})
    ratio = np.median(cube / PLAIN, axis=2)
    assert ratio.min() == pytest.approx(0.4, abs=1e-3)
    assert ratio.max() == pytest.approx(1.0, abs=1e-6)
    assert np.allclose(ratio[9:19, 29:39], 1.0)
    assert 0.1 < np.mean(ratio < 0.7) < 0.25


def test_an_admixture_has_the_moments_asked_for_and_moves_the_mean_towards_the_other_surface():
    wish = {"host": "grass", "surface": "soil", "mean": 0.3, "sd": 0.15, "correlation_pixels": 0.0}
    scene = broken_scene(admixtures=[wish])
    share = admixture_share(scene, scene.broken.admixtures[0], 0).astype(float)
    assert 0.0 <= share.min() < share.max() <= 1.0
    assert share.mean() == pytest.approx(0.3, abs=5 * 0.15 / SIZE)
    assert share.std() == pytest.approx(0.15, rel=5 / np.sqrt(2 * SIZE**2))
    found, f = grass(rendered(admixtures=[wish])), float(share[20:, :76].mean())
    expected = (1 - f) * GRASS.mean + f * CLASSES["soil"].mean
    # The shares are known: what is left is the pixels' own spread. 6 standard errors over 12 bands.
    assert np.all(np.abs(found.mean(axis=(0, 1)) - expected) < 6 * found.std(axis=(0, 1)) / 76 + 1e-5)
    assert np.all(np.abs(found.mean(axis=(0, 1)) - GRASS.mean) > 1e-3)


@pytest.mark.parametrize("length", [4.0, 10.0])
def test_a_field_has_the_asked_correlation(length):
    field = correlated_field((600, 600), length, np.random.default_rng(8)).astype(float)
    assert field.mean() == pytest.approx(0.0, abs=1e-5)
    assert field.std() == pytest.approx(1.0, abs=1e-5)
    lag = int(length)
    found = np.mean(field[:, :-lag] * field[:, lag:])
    # About (600/length)^2 / 6 independent patches; 5 standard errors.
    assert found == pytest.approx(np.exp(-1.0), abs=5 / np.sqrt((600 / length) ** 2 / 6))
