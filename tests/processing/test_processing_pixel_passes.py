"""The passes over stored cubes: covariances and scores against plain NumPy, and what must not change them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hyperval.errors import UsageError
from hyperval.imagery import envi, open_cube
from hyperval.processing import MeasuredPanel, fit_elm
from hyperval.processing.detectors import pixel_detector, score_cube, whitener_of
from hyperval.processing.statistics import MAX_THREADS, _segments, darkest_values, region_statistics

LINES, SAMPLES, BANDS = 47, 23, 30
TYPES = {"u1": 1, "i2": 2, "i4": 3, "f4": 4, "f8": 5, "u2": 12}


def numbers(seed=0, low=500.0, spread=900.0, noise=6.0, lines=LINES):
    """A scene of four smooth spectra and noise, in whole numbers (lines, samples, bands)."""
    rng = np.random.default_rng(seed)
    at = np.linspace(0, 1, BANDS)
    spectra = np.stack([np.sin(np.pi * (k + 1) * at) ** 2 + 0.2 for k in range(4)])
    amounts = rng.gamma(2.0, 0.5, size=(lines * SAMPLES, 4))
    x = low + spread * amounts @ spectra + noise * rng.normal(size=(lines * SAMPLES, BANDS))
    return np.rint(x).reshape(lines, SAMPLES, BANDS)


def write(folder: Path, x, interleave="bil", dtype="<i2", extra="", name="cube"):
    order = {"bil": (0, 2, 1), "bip": (0, 1, 2), "bsq": (2, 0, 1)}[interleave]
    folder.mkdir(exist_ok=True, parents=True)
    path = folder / f"{name}.img"
    path.write_bytes(np.ascontiguousarray(x.transpose(order)).astype(dtype).tobytes())
    waves = ", ".join(str(400 + 10 * b) for b in range(x.shape[2]))
    path.with_suffix(".hdr").write_text(
        f"ENVI\nsamples = {x.shape[1]}\nlines = {x.shape[0]}\nbands = {x.shape[2]}\nheader offset = 0\n"
        f"data type = {TYPES[dtype[1:]]}\ninterleave = {interleave}\nbyte order = {int(dtype[0] == '>')}\n"
        f"wavelength units = Nanometers\nwavelength = {{{waves}}}\n{extra}"
    )
    return path


def opened(path, **options):
    options = {"quantity": "other", **options}
    return open_cube(path, check_values=False, **options)


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


def test_every_region_equals_numpy(tmp_path):
    x = numbers()
    cube, regions = opened(write(tmp_path, x)), masks()
    left_out = np.zeros((LINES, SAMPLES), bool)
    left_out[10:12] = True
    found = region_statistics(cube, regions, left_out, block_lines=4)
    for name, mask in {**regions, "scene": ~left_out}.items():
        expected = x[mask]
        assert found[name].n == len(expected)
        assert found[name].mean == pytest.approx(expected.mean(axis=0), rel=1e-13)
        assert relative(found[name].covariance, np.cov(expected.T)) < 1e-13


def test_more_regions_than_bits(tmp_path):
    x = numbers()
    rng = np.random.default_rng(2)
    regions = {f"r{i}": rng.random((LINES, SAMPLES)) < 0.5 for i in range(70)}
    found = region_statistics(opened(write(tmp_path, x)), regions)
    for name, mask in regions.items():
        assert relative(found[name].covariance, np.cov(x[mask].T)) < 1e-13


def test_statistics_are_the_same_to_the_bit_however_the_cube_is_stored_cut_or_shared_out(tmp_path):
    x, regions = numbers(), masks()
    reference = region_statistics(opened(write(tmp_path, x)), regions)
    for interleave in ("bil", "bip", "bsq"):
        for dtype in ("<i2", ">i2", "<i4", ">u2", "<f4", ">f8"):
            cube = opened(write(tmp_path / (interleave + dtype[1:] + str(dtype[0] == ">")), x, interleave, dtype))
            for step, threads in ((None, 1), (1, 2), (5, 1), (LINES, 3)):
                found = region_statistics(cube, regions, threads=threads, block_lines=step)
                for name, value in reference.items():
                    if dtype[1] == "f":  # means of batches are not whole numbers
                        assert relative(found[name].covariance, value.covariance) < 1e-12
                        assert found[name].mean == pytest.approx(value.mean, rel=1e-13)
                    else:
                        assert np.array_equal(found[name].covariance, value.covariance)
                        assert np.array_equal(found[name].mean, value.mean)


def test_bright_flat_scenes_keep_their_covariance(tmp_path):
    rng = np.random.default_rng(1)
    x = np.rint(30000 + rng.normal(size=(LINES, SAMPLES, BANDS)) * 4.0)
    x[20:] -= 25000  # a dark flat half: the estimate of the mean fits neither
    regions = {"bright": np.arange(LINES)[:, None] * np.ones(SAMPLES) < 20}
    found = region_statistics(opened(write(tmp_path, x)), regions)
    assert relative(found["bright"].covariance, np.cov(x[:20].reshape(-1, BANDS).T)) < 1e-10
    assert relative(found["scene"].covariance, np.cov(x.reshape(-1, BANDS).T)) < 1e-12


def test_gain_offset_and_order_of_bands(tmp_path):
    x = numbers()
    gains = ", ".join(f"{0.001 * (b + 1)}" for b in range(BANDS))
    offsets = ", ".join(f"{0.5 * b}" for b in range(BANDS))
    extra = f"data gain values = {{{gains}}}\ndata offset values = {{{offsets}}}\n"
    found = region_statistics(opened(write(tmp_path, x, extra=extra)))["scene"]
    values = x.reshape(-1, BANDS) * (0.001 * np.arange(1, BANDS + 1)) + 0.5 * np.arange(BANDS)
    assert found.mean == pytest.approx(values.mean(axis=0), rel=1e-12)
    assert relative(found.covariance, np.cov(values.T)) < 1e-12


def test_ignored_and_empty_pixels_never_reach_the_mean(tmp_path):
    x = numbers()
    x[0] = -9999  # no data at all
    x[1, :3, 7] = -9999  # one band only
    x[2, :5] = 0  # fill of a radiance cube
    x[3, :4, 0] = 0  # a true 0 in one band
    cube = opened(
        write(tmp_path, x, extra="data ignore value = -9999\n"), quantity="radiance",
        unit="uW cm-2 sr-1 nm-1", scale=0.01,
    )  # fmt: skip
    found = region_statistics(cube)["scene"]
    ok = ~((x == -9999).any(axis=-1) | (x == 0).all(axis=-1))
    assert (found.n, found.n_left_out) == (int(ok.sum()), SAMPLES + 3 + 5)
    assert found.mean == pytest.approx(0.01 * x[ok].mean(axis=0), rel=1e-12)


def test_regions_count_what_they_leave_out_each_for_itself(tmp_path):
    x = numbers()
    x[4, :6] = -9999
    masks = {"a": np.zeros((LINES, SAMPLES), bool), "b": np.zeros((LINES, SAMPLES), bool)}
    masks["a"][3:6, 2:9], masks["b"][4:, 5:] = True, True
    found = region_statistics(opened(write(tmp_path, x, extra="data ignore value = -9999\n")), masks)
    assert {k: (v.n, v.n_left_out) for k, v in found.items()} == {
        "scene": (LINES * SAMPLES - 6, 6), "a": (21 - 4, 4), "b": ((LINES - 4) * (SAMPLES - 5) - 1, 1)
    }  # fmt: skip


@pytest.mark.parametrize("gain", [0.5, -0.5])
def test_the_darkest_values_are_the_least_of_the_values_and_not_of_the_numbers(tmp_path, gain):
    x = numbers()
    x[0, 0] = -9999
    gains = ", ".join([str(gain)] * BANDS)
    cube = opened(write(tmp_path, x, extra=f"data ignore value = -9999\ndata gain values = {{{gains}}}\n"))
    values = gain * np.delete(x.reshape(-1, BANDS), 0, axis=0)
    assert np.array_equal(darkest_values(cube), values.min(axis=0))


def test_nan_is_left_out_and_counted(tmp_path):
    x = numbers()
    x[5, 3, 2], x[6, 3, 2] = np.nan, np.inf
    found = region_statistics(opened(write(tmp_path, x, dtype="<f4")))["scene"]
    assert (found.n, found.n_left_out) == (LINES * SAMPLES - 2, 2)
    assert np.isfinite(found.covariance).all()


def test_a_single_pixel_is_its_own_mean_without_a_spread(tmp_path):
    cube = opened(write(tmp_path, numbers()))
    for at in ((0, 4), (LINES - 1, 2)):
        mask = np.zeros((LINES, SAMPLES), bool)
        mask[at] = True
        found = region_statistics(cube, {"a": mask})["a"]
        assert found.n == 1
        assert found.mean == pytest.approx(cube.pixels(tuple(np.array([i]) for i in at))[0], rel=1e-12)
        assert not found.covariance.any()


def test_masks_that_do_not_fit_and_empty_regions_are_refused(tmp_path):
    cube = opened(write(tmp_path, numbers()))
    with pytest.raises(UsageError, match="'a' has shape"):
        region_statistics(cube, {"a": np.ones((LINES + 1, SAMPLES), bool)})
    with pytest.raises(UsageError, match="of int64"):
        region_statistics(cube, {"a": np.ones((LINES, SAMPLES), np.int64)})
    with pytest.raises(UsageError, match="'a' has no valid pixel"):
        region_statistics(cube, {"a": np.zeros((LINES, SAMPLES), bool)})
    with pytest.raises(UsageError, match="kept for the whole"):
        region_statistics(cube, {"scene": np.ones((LINES, SAMPLES), bool)})
    found = region_statistics(cube)["scene"]
    with pytest.raises(UsageError, match="fourth moment"):
        _ = found.shrinkage


@pytest.mark.parametrize(("lines", "block"), [(1, 8), (7, 8), (130, 8), (2000, 8), (2001, 3), (10900, 8)])
def test_segments_hold_every_line_once_and_are_alike(lines, block):
    segments = _segments(lines, block)
    firsts = [first for segment in segments for first in segment]
    assert firsts == list(range(0, lines, block))
    assert {segment.stop for segment in segments[:-1]} <= set(firsts)
    assert segments[-1].stop == lines
    sizes = [len(segment) for segment in segments]
    assert max(sizes) - min(sizes) <= 1
    assert len(segments) % MAX_THREADS == 0 or len(segments) == len(firsts)


@pytest.mark.parametrize("interleave", ["bil", "bip", "bsq"])
@pytest.mark.parametrize("centre", [-32000, -9000, 0, 9000, 32000])
def test_differences_that_need_more_than_16_bits_do_not_wrap(tmp_path, interleave, centre):
    """Numbers at both ends of their range, about a reference anywhere in it."""
    rng = np.random.default_rng(11)
    x = np.rint(centre + 300.0 * rng.standard_normal((40, SAMPLES, BANDS))).clip(-32768, 32767)
    ends = rng.choice([-32768.0, 32767.0], size=x.shape)
    x[25:] = np.where(rng.random(x[25:].shape) < 0.02, ends[25:], x[25:])
    found = region_statistics(opened(write(tmp_path, x, interleave)), block_lines=8)["scene"]
    flat = x.reshape(-1, BANDS)
    assert np.allclose(found.mean, flat.mean(axis=0), rtol=0, atol=1e-3)
    assert relative(found.covariance, np.cov(flat.T)) < 1e-12


def test_the_file_is_opened_once_for_a_pass(tmp_path, monkeypatch):
    cube = opened(write(tmp_path, numbers()))
    opens = []

    def counted(path, *rest, **options):
        opens.append(path)
        return open(path, *rest, **options)

    monkeypatch.setattr(envi, "open", counted, raising=False)
    region_statistics(cube, block_lines=2)
    assert opens == [cube.source_files[0]]


def test_equal_pixels_have_no_variance(tmp_path):
    x = numbers()
    x[3:5] = 0.1 + np.arange(BANDS) / 7.0
    regions = {}
    regions["panel"] = np.repeat((np.arange(LINES) == 3)[:, None] | (np.arange(LINES) == 4)[:, None], SAMPLES, axis=1)
    found = region_statistics(opened(write(tmp_path, x, dtype="<f8")), regions)["panel"]
    assert np.max(np.abs(found.covariance)) < 1e-28
    assert np.all(np.diag(found.covariance) >= 0)


def line_of(bands):
    def one(name, rho):
        rho = np.full(bands, rho)
        return MeasuredPanel(name, rho, np.zeros(bands), 2.0 + np.arange(1, bands + 1) * rho, np.zeros(bands), 9)

    return fit_elm([one("black", 0.05), one("white", 0.6)])


@pytest.mark.parametrize("interleave", ["bil", "bip", "bsq"])
def test_scores_equal_the_long_way_round(tmp_path, interleave):
    x = numbers()
    x[4, 4] = -9999
    x[5, 5, 29] = -9999  # in a band that no detector uses
    cube = opened(
        write(tmp_path, x, interleave, extra="data ignore value = -9999\n"),
        quantity="radiance", unit="uW cm-2 sr-1 nm-1", scale=0.002,
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
    detectors = {n: pixel_detector(n, target, mean, covariance, rho[:3, 0]) for n in names}
    whitener = whitener_of(mean, covariance)
    reference = None
    for step, threads in ((None, None), (1, 1), (7, 2)):
        found = score_cube(cube, detectors, elm, bands, whitener=whitener, threads=threads, block_lines=step)
        for name, detector in detectors.items():
            assert found[name].shape == (LINES, SAMPLES)
            assert np.isnan(found[name][4, 4])  # never a score of 0
            assert np.isfinite(found[name]).sum() == LINES * SAMPLES - 1
            expected = detector.score(rho[valid], whitener)
            assert found[name][valid] == pytest.approx(expected, rel=1e-9, abs=1e-9)
        if reference is not None:
            for name in names:
                assert found[name][valid] == pytest.approx(reference[name][valid], rel=1e-11, abs=1e-12)
        reference = found
    also = score_cube(cube, {"cem": detectors["cem"]}, elm, bands, needed=np.ones(BANDS, bool))["cem"]
    assert np.isnan(also[5, 5])


def test_scores_are_the_same_to_1e_12_however_the_cube_is_stored_cut_or_shared_out(tmp_path):
    x = numbers()
    flat = x.reshape(-1, BANDS)
    mean, covariance = flat.mean(axis=0), np.cov(flat.T)
    target = mean + np.linspace(0, 400, BANDS)
    detectors = {n: pixel_detector(n, target, mean, covariance, flat[:3]) for n in (
        "cem", "cem-correlation", "smf", "ace", "sam", "rx", "osp"
    )}  # fmt: skip
    whitener = whitener_of(mean, covariance)
    reference = None
    for interleave in ("bil", "bip", "bsq"):
        for dtype in ("<i2", ">i2", "<f8"):
            cube = opened(write(tmp_path, x, interleave, dtype))
            for step, threads in ((None, None), (1, 1), (7, 2)):
                found = score_cube(cube, detectors, whitener=whitener, threads=threads, block_lines=step)
                reference = reference or found
                for name, scores in found.items():
                    largest = np.max(np.abs(reference[name]))
                    assert np.max(np.abs(scores - reference[name])) <= 1e-12 * largest, (name, interleave, dtype)


def test_scoring_refuses_what_does_not_fit(tmp_path):
    cube, elm = opened(write(tmp_path, numbers())), line_of(BANDS)
    mean, covariance = np.arange(1.0, BANDS + 1), np.eye(BANDS)
    cem = pixel_detector("cem", mean + 1, mean, covariance)
    with pytest.raises(UsageError, match="no detector"):
        score_cube(cube, {})
    with pytest.raises(UsageError, match="made for 30 bands, 29"):
        score_cube(cube, {"a": cem}, elm, np.arange(BANDS) > 0)
    with pytest.raises(UsageError, match="line of 29 bands"):
        score_cube(cube, {"a": cem}, line_of(29))
    with pytest.raises(UsageError, match="whitener"):
        score_cube(cube, {"a": pixel_detector("rx", None, mean, covariance)})
    elm.gain[1] = np.nan
    with pytest.raises(UsageError, match="no gain in 1 of"):
        score_cube(cube, {"a": cem}, elm)


def outlying(x, part, size, seed=4):
    """The same scene with a part of its pixels far out, in a direction of their own."""
    rng = np.random.default_rng(seed)
    out = x.copy()
    there = rng.random(x.shape[:2]) < part
    out[there] += size * rng.standard_normal((int(there.sum()), x.shape[2]))
    return out


@pytest.mark.parametrize("scale", [1e-30, 1e-8, 1.0, 1e8, 1e30])
@pytest.mark.parametrize(("part", "size"), [(0.0, 0.0), (0.001, 1e4), (0.001, 1e7), (0.05, 1e5)])
def test_quiet_directions_stay_beside_outliers_whatever_the_unit(tmp_path, part, size, scale):
    # 0.1 % of the pixels 1e3 to 1e6 standard deviations out: sums in float32 lose what only noise fills.
    x = (outlying(numbers(lines=400), part, size) * scale).astype(np.float32)
    found = region_statistics(opened(write(tmp_path, x, dtype="<f4")))["scene"].covariance / scale / scale
    pixels = x.reshape(-1, BANDS).astype(np.longdouble) / scale
    centred = pixels - pixels.mean(axis=0)
    expected = (centred.T @ centred / (len(pixels) - 1)).astype(float)
    values, vectors = np.linalg.eigh(expected)
    white = (vectors / np.sqrt(values)).T
    assert np.linalg.eigvalsh(found)[0] > 0.0
    assert np.linalg.norm(white @ (found - expected) @ white.T, 2) < 20 * np.finfo(float).eps * values[-1] / values[0]


def test_a_scene_that_is_constant_nearly_everywhere_keeps_the_spread_of_the_rest(tmp_path):
    x = np.full((400, SAMPLES, BANDS), 700.0, np.float32)
    x[157:160] += np.random.default_rng(3).normal(0.0, 5.0, (3, SAMPLES, BANDS)).astype(np.float32)
    found = region_statistics(opened(write(tmp_path, x, dtype="<f4")), block_lines=4)["scene"]
    flat = x.reshape(-1, BANDS).astype(float)
    np.testing.assert_allclose(found.mean, flat.mean(axis=0), rtol=1e-12)
    assert relative(found.covariance, np.cov(flat.T)) < 1e-12
