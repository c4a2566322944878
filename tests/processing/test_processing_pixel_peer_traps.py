"""What other readers and detectors get wrong on the same files, and that it does not happen here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import spectral

from hyperval.imagery import open_cube
from hyperval.model import clopper_pearson
from hyperval.processing import region_statistics

LINES, SAMPLES, BANDS = 12, 9, 6


def write(folder: Path, x, interleave="bil", extra=""):
    path = folder / "cube.img"
    x.transpose(0, 2, 1).astype("<i2").tofile(path)
    waves = ", ".join(str(400 + 100 * b) for b in range(BANDS))
    path.with_suffix(".hdr").write_text(
        f"ENVI\nsamples = {SAMPLES}\nlines = {LINES}\nbands = {BANDS}\nheader offset = 0\ndata type = 2\n"
        f"interleave = {interleave}\nbyte order = 0\nwavelength units = nm\nwavelength = {{{waves}}}\n{extra}"
    )
    return path


@pytest.fixture
def stored():
    return np.random.default_rng(0).integers(500, 9000, size=(LINES, SAMPLES, BANDS)).astype(float)


@pytest.mark.parametrize("word", ["Bil", "BIL", "bil ; by line"])
def test_an_interleave_in_other_letters_or_with_a_comment_is_not_taken_for_bsq(tmp_path, stored, word):
    cube = open_cube(write(tmp_path, stored, word), quantity="other")
    assert np.array_equal(cube.read(0, LINES).values, stored)


def test_the_scale_factor_is_applied_once_and_everywhere(tmp_path, stored):
    path = write(tmp_path, stored, extra="reflectance scale factor = 10000\n")
    cube = open_cube(path, quantity="reflectance")
    expected = stored / 10000
    assert cube.read(0, LINES).values == pytest.approx(expected, rel=1e-14)
    assert cube.pixels(np.ones((LINES, SAMPLES), bool)) == pytest.approx(expected.reshape(-1, BANDS), rel=1e-14)
    assert region_statistics(cube)["scene"].mean == pytest.approx(expected.mean(axis=(0, 1)), rel=1e-13)
    peer = spectral.open_image(str(path.with_suffix(".hdr")))
    # The trap: loaded and mapped values of the same file differ by the factor.
    assert float(peer.open_memmap().max()) > 1000 * float(np.asarray(peer.load()).max())


def test_the_ignore_value_is_not_averaged_into_the_mean(tmp_path, stored):
    stored[:3] = -9999
    path = write(tmp_path, stored, extra="data ignore value = -9999\n")
    expected = stored[3:].mean(axis=(0, 1))
    assert region_statistics(open_cube(path, quantity="other"))["scene"].mean == pytest.approx(expected, rel=1e-13)
    peer = spectral.calc_stats(spectral.open_image(str(path.with_suffix(".hdr"))).load())
    assert np.all(peer.mean < 0.5 * expected)


def test_a_mean_of_many_bright_pixels_keeps_its_digits(tmp_path):
    # Summed one by one in float32, a mean of many bright pixels stalls; here it is exact to 1e-13.
    rng = np.random.default_rng(1)
    x = rng.integers(30_000, 32_000, size=(LINES, SAMPLES, BANDS)).astype(float)
    found = region_statistics(open_cube(write(tmp_path, x), quantity="other"))["scene"].mean
    assert found == pytest.approx(x.mean(axis=(0, 1)), rel=1e-14)


def test_a_running_float32_sum_is_off_by_a_quarter_of_a_per_cent_and_ours_is_not(tmp_path):
    # 640,000 pixels around 9,100: the sum passes 2^32, where float32 counts in steps of 512, always rounded alike.
    x = np.random.default_rng(0).integers(9000, 9200, size=(800, 800, 1)).astype("<i2")
    exact = int(x.astype(np.int64).sum()) / x.size
    naive = float(np.add.accumulate(x.ravel().astype(np.float32), dtype=np.float32)[-1]) / x.size
    assert abs(naive / exact - 1) > 0.0025
    path = tmp_path / "bright.img"
    x.transpose(0, 2, 1).tofile(path)
    path.with_suffix(".hdr").write_text(
        "ENVI\nsamples = 800\nlines = 800\nbands = 1\nheader offset = 0\ndata type = 2\ninterleave = bil\n"
        "byte order = 0\nwavelength units = nm\nwavelength = {550}\nfwhm = {5}\n"
    )
    cube = open_cube(path, quantity="other")
    assert region_statistics(cube)["scene"].mean[0] == exact  # to the last bit


def test_the_exact_interval_covers_where_the_normal_one_does_not():
    # 20 targets, true P_D 0.97; both intervals in closed form over every outcome, no draws.
    n, p = 20, 0.97
    from scipy.stats import binom

    k = np.arange(n + 1)
    weight = binom.pmf(k, n, p)
    share = k / n
    half = 1.96 * np.sqrt(share * (1 - share) / n)
    low, high = clopper_pearson(k, n)
    wald = float(weight @ ((share - half <= p) & (p <= share + half)))
    exact = float(weight @ ((low <= p) & (p <= high)))
    assert wald < 0.46
    assert exact >= 0.95
