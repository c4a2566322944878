"""Streaming statistics against one-shot sums, and score maps against the long way round."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperval.errors import UsageError
from hyperval.processing.elm import PanelMeasurement, fit_elm
from hyperval.processing.scoring import folded_filter, score_blocks
from hyperval.processing.streaming import accumulate_statistics, statistics_of
from hyperval.spectra.axis import SpectralAxis


@dataclass
class Block:
    first_line: int
    values: np.ndarray
    valid: np.ndarray


@dataclass
class Filter:
    weights: np.ndarray
    offset: float

    def score(self, x):
        return x @ self.weights - self.offset


def blocks_of(cube, valid=None, sizes=(3,)):
    valid = np.ones(cube.shape[:2], bool) if valid is None else valid
    line, i = 0, 0
    while line < cube.shape[0]:
        step = sizes[i % len(sizes)]
        yield Block(line, cube[line : line + step], valid[line : line + step])
        line, i = line + step, i + 1


def scene(seed=0, lines=20, samples=15, bands=6, level=1000.0):
    rng = np.random.default_rng(seed)
    mixing = rng.normal(size=(bands, bands))
    return level + rng.normal(size=(lines, samples, bands)) @ mixing


def test_equal_to_numpy_per_region_and_scene():
    cube = scene()
    mask = np.zeros((20, 15), bool)
    mask[4:13, 2:9] = True
    found = accumulate_statistics(blocks_of(cube), {"grass": mask})
    for name, pixels in (("scene", cube.reshape(-1, 6)), ("grass", cube[mask])):
        assert found[name].n == len(pixels)
        assert found[name].mean == pytest.approx(pixels.mean(axis=0), rel=1e-14)
        assert found[name].covariance == pytest.approx(np.cov(pixels.T), rel=1e-10)


@given(st.lists(st.integers(1, 20), min_size=1, max_size=6), st.sampled_from([0.0, 1.0, 1e6]))
@settings(max_examples=40, deadline=None)
def test_the_cut_into_blocks_does_not_matter(sizes, level):
    cube = scene(level=level)
    whole = accumulate_statistics(blocks_of(cube, sizes=(20,)))["scene"]
    cut = accumulate_statistics(blocks_of(cube, sizes=sizes))["scene"]
    scale = np.sqrt(np.outer(np.diag(whole.covariance), np.diag(whole.covariance)))
    assert np.max(np.abs(cut.mean - whole.mean)) <= 1e-12 * max(level, 1.0)
    assert np.max(np.abs(cut.covariance - whole.covariance) / scale) <= 1e-12
    assert cut.fourth == pytest.approx(whole.fourth, rel=1e-10)


def test_exact_on_a_bright_flat_scene():
    # Integers around 1e8 with a spread of 1: sums of squares lose every digit, centred sums lose none.
    rng = np.random.default_rng(1)
    small = rng.integers(-2, 3, size=(40, 30, 4)).astype(float)
    found = accumulate_statistics(blocks_of(small + 1e8, sizes=(7,)))["scene"]
    assert found.covariance == pytest.approx(np.cov(small.reshape(-1, 4).T), rel=1e-9, abs=1e-9)


def test_invalid_and_nan_pixels_are_left_out_and_counted():
    cube = scene()
    valid = np.ones((20, 15), bool)
    valid[0] = False
    cube[0] = -9999.0
    cube[1, :4, 2] = np.nan
    found = accumulate_statistics(blocks_of(cube, valid))["scene"]
    assert (found.n, found.n_left_out) == (300 - 15 - 4, 19)
    kept = cube[1:].reshape(-1, 6)
    assert found.mean == pytest.approx(kept[np.isfinite(kept).all(axis=1)].mean(axis=0), rel=1e-13)
    # The NaN lies in band 2: without that band the pixels count.
    part = accumulate_statistics(blocks_of(cube, valid), bands=np.array([0, 1, 3]))["scene"]
    assert (part.n, part.n_left_out, part.mean.shape) == (285, 15, (3,))


def test_targets_are_left_out_of_the_scene_or_of_a_region():
    cube = scene()
    target = np.zeros((20, 15), bool)
    target[5, 5] = True
    cube[5, 5] = 1e6
    everything = np.ones((20, 15), bool)
    found = accumulate_statistics(
        blocks_of(cube), {"target": np.roll(target, 1) | target, "all": everything}, target
    )
    assert found["scene"].n == 299
    assert found["target"].n == 2
    assert found["all"].n == 300
    by_name = accumulate_statistics(blocks_of(cube), {"all": everything}, {"all": target})
    assert by_name["all"].mean == pytest.approx(found["scene"].mean, rel=1e-14)
    assert by_name["scene"].n == 300
    with pytest.raises(UsageError, match="unknown regions: nowhere"):
        accumulate_statistics(blocks_of(cube), None, {"nowhere": target})


def test_masks_that_do_not_fit_and_empty_regions_are_refused():
    cube = scene()
    with pytest.raises(UsageError, match="'a' has shape"):
        accumulate_statistics(blocks_of(cube), {"a": np.ones((20, 14), bool)})
    with pytest.raises(UsageError, match="'a' has 21 lines, the cube 20"):
        accumulate_statistics(blocks_of(cube), {"a": np.ones((21, 15), bool)})
    with pytest.raises(UsageError, match="'a' has 0 valid pixels"):
        accumulate_statistics(blocks_of(cube), {"a": np.zeros((20, 15), bool)})
    with pytest.raises(UsageError, match="kept for the whole"):
        accumulate_statistics(blocks_of(cube), {"scene": np.ones((20, 15), bool)})
    with pytest.raises(UsageError, match="0 valid pixels"):
        accumulate_statistics([])


def test_rank_and_condition_are_told():
    rng = np.random.default_rng(2)
    few = statistics_of(rng.normal(size=(5, 12)))
    assert few.rank == 4
    assert not few.full_rank_possible
    assert few.condition_number > 1e14
    line = few.as_class("few", SpectralAxis(np.arange(12) + 400.0, 1.0), shrink=True, source="test")
    assert "rank at most 4" in line.source
    assert np.linalg.eigvalsh(line.covariance)[0] > 0
    many = statistics_of(rng.normal(size=(4000, 3)) * [1.0, 2.0, 10.0])
    assert many.condition_number == pytest.approx(100, rel=0.15)
    assert many.rank == 3


def test_shrinkage_equals_the_definition_and_survives_streaming():
    rng = np.random.default_rng(3)
    x = rng.normal(size=(60, 10)) * np.linspace(1, 3, 10) + 50.0
    z = x - x.mean(axis=0)
    s = z.T @ z / 60
    mu = np.trace(s) / 10
    d2 = np.sum((s - mu * np.eye(10)) ** 2)
    b2 = min(d2, sum(np.sum((np.outer(v, v) - s) ** 2) for v in z) / 60**2)
    assert statistics_of(x).shrinkage == pytest.approx(b2 / d2, rel=1e-10)
    streamed = accumulate_statistics(blocks_of(x.reshape(12, 5, 10), sizes=(5, 1)))["scene"]
    assert streamed.shrinkage == pytest.approx(b2 / d2, rel=1e-9)


def test_shrinkage_is_near_the_best_possible():
    # Monte Carlo: the mean squared error of the shrunk covariance against every fixed intensity. 300 draws of
    # n = 40, B = 20; the loss of not knowing the best intensity is stated as vanishing, here below 5 %.
    rng = np.random.default_rng(4)
    truth = np.diag(np.linspace(0.5, 2.0, 20))
    grid = np.linspace(0, 1, 21)
    ours, plain, fixed = 0.0, 0.0, np.zeros(21)
    for _ in range(300):
        found = statistics_of(rng.normal(size=(40, 20)) @ np.sqrt(truth))
        s = found.covariance
        target = np.trace(s) / 20 * np.eye(20)
        ours += np.sum((found.shrunk_covariance - truth) ** 2)
        plain += np.sum((s - truth) ** 2)
        fixed += [np.sum(((1 - a) * s + a * target - truth) ** 2) for a in grid]
    assert ours < 1.05 * fixed.min()
    assert ours < 0.5 * plain


def test_many_pixels_are_hardly_shrunk():
    rng = np.random.default_rng(5)
    assert statistics_of(rng.normal(size=(20000, 4)) * [1, 2, 3, 4]).shrinkage < 0.01


def line_of(bands):
    def one(name, rho):
        rho = np.full(bands, rho)
        return PanelMeasurement(name, rho, np.zeros(bands), 2.0 + np.arange(1, bands + 1) * rho, np.zeros(bands), 9)

    return fit_elm([one("black", 0.05), one("white", 0.6)])


def test_folded_score_is_the_score_of_the_reflectance():
    rng = np.random.default_rng(6)
    cube, elm = scene(level=3.0), line_of(6)
    filters = {"a": Filter(rng.normal(size=4), 0.3), "b": Filter(rng.normal(size=4), -2.0)}
    bands = np.array([0, 2, 3, 5])
    found = score_blocks(blocks_of(cube, sizes=(4, 1)), filters, elm, bands)
    reflectance = elm.reflectance(cube)[..., bands]
    for name, linear in filters.items():
        assert found[name].shape == (20, 15)
        assert found[name] == pytest.approx(linear.score(reflectance), rel=1e-12, abs=1e-11)


def test_scores_without_a_line_and_in_any_block_order():
    cube = scene(level=0.0)
    linear = {"a": Filter(np.ones(6), 1.0)}
    found = score_blocks(reversed(list(blocks_of(cube))), linear)["a"]
    assert found == pytest.approx(cube.sum(axis=-1) - 1.0, abs=1e-12)


def test_invalid_pixels_score_nan_never_zero():
    cube = scene()
    valid = np.ones((20, 15), bool)
    valid[2, 3] = False
    cube[4, 4, 1] = np.nan
    cube[5, 5, 1] = np.inf
    found = score_blocks(blocks_of(cube, valid), {"a": Filter(np.ones(6), 0.0)})["a"]
    assert np.isnan(found[[2, 4, 5], [3, 4, 5]]).all()
    assert np.isfinite(found).sum() == 297
    other = score_blocks(blocks_of(cube, valid), {"a": Filter(np.ones(5), 0.0)}, bands=np.array([0, 2, 3, 4, 5]))[
        "a"
    ]
    assert np.isfinite(other).sum() == 299


def test_scoring_refuses_what_does_not_fit():
    cube, elm = scene(), line_of(6)
    with pytest.raises(UsageError, match="no filter"):
        score_blocks(blocks_of(cube), {})
    with pytest.raises(UsageError, match="filters of 4 bands for blocks of 6"):
        score_blocks(blocks_of(cube), {"a": Filter(np.ones(4), 0.0)})
    with pytest.raises(UsageError, match="4 bands for an empirical line of 6"):
        score_blocks(blocks_of(cube), {"a": Filter(np.ones(4), 0.0)}, elm)
    with pytest.raises(UsageError, match="different numbers"):
        score_blocks(blocks_of(cube), {"a": Filter(np.ones(4), 0.0), "b": Filter(np.ones(6), 0.0)})
    with pytest.raises(UsageError, match="leave or repeat lines"):
        score_blocks([b for b in blocks_of(cube) if b.first_line != 3], {"a": Filter(np.ones(6), 0.0)})
    with pytest.raises(UsageError, match="came twice"):
        score_blocks([*blocks_of(cube), *blocks_of(cube)], {"a": Filter(np.ones(6), 0.0)})
    with pytest.raises(UsageError, match="no lines"):
        score_blocks([], {"a": Filter(np.ones(6), 0.0)})
    elm.gain[1] = np.nan
    with pytest.raises(UsageError, match="no gain in 1 of"):
        folded_filter(Filter(np.ones(6), 0.0), elm)
