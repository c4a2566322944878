"""Moments of stored cubes and of samples against plain NumPy, and what must not change them."""

import numpy as np
import pytest
from stored_cubes import BANDS, LINES, SAMPLES, numbers, stored

from hyperval.data import statistics_of
from hyperval.errors import UsageError
from hyperval.pixels import Labels, darkest_values, drawn_pixels, nth_pixels, region_statistics


def whole(cube, mask=True, needed=True):
    labels = Labels.from_masks(cube.shape, {"scene": np.broadcast_to(mask, cube.shape)})
    return region_statistics(cube, labels, np.broadcast_to(needed, cube.bands))["scene"]


def relative(found, expected):
    sd = np.sqrt(np.diag(expected))
    return np.max(np.abs(found - expected) / np.outer(sd, sd))


def masks():
    rng = np.random.default_rng(9)
    out = {f"r{i}": np.zeros((LINES, SAMPLES), bool) for i in range(4)}
    out["r0"][3:9, 2:7] = True
    out["r1"][:, :8] = True
    out["r2"] = rng.random((LINES, SAMPLES)) < 0.4
    out["r3"] = out["r1"] & out["r2"]
    return out


def test_statistics_are_the_same_to_the_bit_however_the_cube_is_stored_cut_or_shared_out(tmp_path, monkeypatch):
    x, regions = numbers(), masks()
    labels = Labels.from_masks((LINES, SAMPLES), regions)
    reference = region_statistics(stored(tmp_path, x), labels, np.ones(BANDS, bool))
    for name, mask in regions.items():
        assert reference[name].mean == pytest.approx(x[mask].mean(axis=0), rel=1e-13)
        assert relative(reference[name].covariance, np.cov(x[mask].T)) < 1e-13
    for interleave in ("bil", "bip", "bsq"):
        for dtype in ("<i2", ">i2", "<i4", ">u2", "<f4", ">f8"):
            cube = stored(tmp_path / (interleave + dtype[1:] + str(dtype[0] == ">")), x, interleave, dtype)
            for step, threads in ((10**3, 1), (1, 2), (5, 1), (LINES, 3)):
                monkeypatch.setattr("hyperval.pixels.statistics.BLOCK_PIXELS", step * SAMPLES)
                monkeypatch.setattr("hyperval.pixels.statistics.available_cores", lambda n=threads: n)
                found = region_statistics(cube, labels, np.ones(BANDS, bool))
                for name, value in reference.items():
                    if dtype[1] == "f":  # means of batches are not whole numbers
                        assert relative(found[name].covariance, value.covariance) < 1e-12
                        assert found[name].mean == pytest.approx(value.mean, rel=1e-13)
                    else:
                        assert np.array_equal(found[name].covariance, value.covariance)
                        assert np.array_equal(found[name].mean, value.mean)


def test_ignored_and_empty_pixels_never_reach_the_mean(tmp_path):
    x = numbers()
    x[0] = -9999  # no data at all
    x[1, :3, 7] = -9999  # one band only
    x[2, :5] = 0  # fill of a radiance cube
    x[3, :4, 0] = 0  # a true 0 in one band
    cube = stored(
        tmp_path, x, extra="data ignore value = -9999\n", quantity="radiance", unit="uW cm-2 sr-1 nm-1", scale=0.01
    )
    found = whole(cube)
    ok = ~((x == -9999).any(axis=-1) | (x == 0).all(axis=-1))
    assert found.n == int(ok.sum())
    assert found.mean == pytest.approx(0.01 * x[ok].mean(axis=0), rel=1e-12)


@pytest.mark.parametrize("gain", [0.5, -0.5])
def test_the_darkest_values_are_the_least_of_the_values_and_not_of_the_numbers(tmp_path, gain):
    x = numbers()
    x[0, 0] = -9999
    gains = ", ".join([str(gain)] * BANDS)
    cube = stored(tmp_path, x, extra=f"data ignore value = -9999\ndata gain values = {{{gains}}}\n")
    values = gain * np.delete(x.reshape(-1, BANDS), 0, axis=0)
    assert np.array_equal(darkest_values(cube), values.min(axis=0))


def test_empty_regions_are_refused(tmp_path):
    cube = stored(tmp_path, numbers())
    with pytest.raises(UsageError, match="'scene' has no valid pixel"):
        whole(cube, np.zeros((LINES, SAMPLES), bool))
    with pytest.raises(UsageError, match="fourth moment"):
        _ = whole(cube).shrinkage


@pytest.mark.parametrize("shape", [(1, 1), (3, 8), (7, 13), (600, 25)])
def test_masks_come_back_whole_from_their_labels(shape):
    rng = np.random.default_rng(1)
    masks = {str(i): rng.random(shape) < 0.3 for i in range(9)}
    labels = Labels.from_masks(shape, masks).with_masks([("none", np.zeros(shape, bool))])
    assert list(labels) == [*masks, "none"]
    assert all(np.array_equal(labels[name], mask) for name, mask in masks.items())
    assert not labels["none"].any()
    # As many labels as there are different sets of regions, and each is some pixel's.
    sets = np.unique(np.stack([m.ravel() for m in masks.values()], axis=1), axis=0)
    assert np.array_equal(np.unique(labels.number), np.arange(len(sets)))


def test_numbers_of_pixels_are_those_of_nonzero():
    rng = np.random.default_rng(2)
    mask = rng.random((50, 31)) < 0.2
    lines, samples = np.nonzero(mask)
    some = rng.choice(lines.size, 40, replace=False)
    at = nth_pixels(mask, some)
    np.testing.assert_array_equal(at[0], lines[some])
    np.testing.assert_array_equal(at[1], samples[some])
    every = drawn_pixels(mask, 10_000, rng)
    np.testing.assert_array_equal(every, (lines, samples))
    assert len(set(zip(*(p.tolist() for p in drawn_pixels(mask, 40, rng)), strict=True))) == 40


def test_equal_to_numpy_and_exact_on_a_bright_flat_scene():
    x = np.random.default_rng(0).integers(-3, 4, size=(500, 6)).astype(float)
    found = statistics_of(x + 1e8)
    assert found.mean - 1e8 == pytest.approx(x.mean(axis=0), abs=1e-7)  # what 1e8 leaves of the digits
    assert found.covariance == pytest.approx(np.cov(x.T), rel=1e-12, abs=1e-12)
    assert found.n == 500
    for bad in (x[:1], x[0], np.full((4, 2), np.nan)):
        with pytest.raises(UsageError, match="two or more finite pixels"):
            statistics_of(bad)


def test_the_shrunk_covariance_of_few_pixels_is_positive():
    few = statistics_of(np.random.default_rng(2).normal(size=(5, 12)))
    assert np.linalg.eigvalsh(few.shrunk().covariance)[0] > 0


def peer(module):
    return pytest.importorskip(f"sklearn.{module}", reason="scikit-learn is not installed; pip install scikit-learn")


def test_shrinkage_of_ledoit_and_wolf():
    covariance = peer("covariance")
    rng = np.random.default_rng(1)
    for n, bands in ((12, 20), (60, 20), (4000, 5)):
        x = rng.normal(size=(n, bands)) @ rng.normal(size=(bands, bands)) + 7.0
        found, (matrix, intensity) = statistics_of(x), covariance.ledoit_wolf(x)
        assert found.shrinkage == pytest.approx(intensity, rel=1e-9)
        # Theirs has divisor n.
        assert found.shrunk().covariance * (n - 1) / n == pytest.approx(matrix, rel=1e-9, abs=1e-12)


KINDS = {
    "plain": lambda x: x,
    "constant": lambda x: np.full(x.shape, 1000.1),
    "two values": lambda x: np.where(x > 1000.0, 2.0, 1.0),
    "one pixel far out": lambda x: np.where(np.arange(x.size).reshape(x.shape) == 80, 30000.0, x),
    "huge offset": lambda x: 29000.0 + x / 15.0,
    "duplicates": lambda x: x[..., [0, 0, 2, 3]],
}


@pytest.mark.parametrize("dtype", [">f4", "<f4", ">f8", ">i2", "<u2", ">i4"])
@pytest.mark.parametrize("kind", KINDS)
def test_moments_are_those_of_exact_sums_whatever_is_stored(kind, dtype, tmp_path):
    values = KINDS[kind](np.random.default_rng(3).normal(1000.0, 30.0, (7, 6, 4)))
    kept = (values if "f" in dtype else values.round()).astype(dtype)
    found = whole(stored(tmp_path, kept, "bip", dtype))
    pixels = kept.reshape(-1, 4).astype(np.longdouble)
    centred = pixels - pixels.mean(axis=0)
    covariance = (centred.T @ centred / (len(pixels) - 1)).astype(float)
    np.testing.assert_allclose(found.mean, pixels.mean(axis=0).astype(float), rtol=1e-12)
    sd = np.sqrt(np.diag(covariance))
    # A sum in float64 forgets 1e-16 of its greatest term.
    assert np.all(np.abs(found.covariance - covariance) <= 1e-12 * np.outer(sd, sd) + 1e-24)
    assert np.linalg.eigvalsh(found.covariance)[0] >= -1e-12 * max(np.trace(found.covariance), 1e-10)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_pixels_that_are_not_finite_are_left_out_and_counted(bad, tmp_path):
    x = numbers().astype("<f4")
    x[2, 3, 1] = x[5, 0, 3] = bad
    cube = stored(tmp_path, x, dtype="<f4", extra="data ignore value = 7\n")
    found, by_good = whole(cube), whole(cube, needed=np.arange(BANDS) != 1)
    assert np.flatnonzero(np.isnan(by_good.mean)).tolist() == [1]  # the band is not needed: it alone has no mean
    assert (found.n, by_good.n) == (LINES * SAMPLES - 2, LINES * SAMPLES - 1)
    good = x[np.isfinite(x).all(axis=2)]
    np.testing.assert_allclose(found.mean, good.mean(axis=0, dtype=float), rtol=1e-12)
    x[:] = bad
    with pytest.raises(UsageError, match="'scene' has no valid pixel"):
        whole(stored(tmp_path, x, dtype="<f4"))
