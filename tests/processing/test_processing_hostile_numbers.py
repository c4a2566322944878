"""Numbers that no instrument should give: what comes back is right, or one clear error; never a silent NaN."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperval.errors import HypervalError, UsageError
from hyperval.imagery import open_cube
from hyperval.model import cem_correlation_weights, clopper_pearson, matched_filter_weights, spectral_matched_filter
from hyperval.processing import MeasuredPanel, empirical_roc, fit_elm, pixel_detector, region_statistics, whitener_of
from hyperval.spectra.readers_record import Asked, Record, finished

LINES, SAMPLES, BANDS = 7, 6, 4
SCALES = st.integers(-30, 30).map(lambda k: 10.0**k)
FEW = settings(max_examples=40, derandomize=True)


def cube_file(folder: Path, values: np.ndarray) -> Path:
    """An ENVI cube of the values as they are, in their own byte order."""
    kind = {"f4": 4, "f8": 5, "i2": 2, "u2": 12, "i4": 3}[values.dtype.str[1:]]
    order = int(values.dtype.str[0] == ">")
    waves = ", ".join(str(450.0 + 50.0 * i) for i in range(values.shape[2]))
    (folder / "a.hdr").write_text(
        f"ENVI\nsamples = {values.shape[1]}\nlines = {values.shape[0]}\nbands = {values.shape[2]}\nheader offset = "
        f"0\nfile type = ENVI Standard\ndata type = {kind}\ninterleave = bip\nbyte order = {order}\n"
        f"wavelength units = nm\nwavelength = {{{waves}}}\n"
    )
    (folder / "a.img").write_bytes(values.tobytes())
    return folder / "a.img"


def statistics(folder: Path, values: np.ndarray):
    cube = open_cube(cube_file(folder, values), quantity="other", check_values=False)
    return region_statistics(cube)["scene"]


@pytest.mark.parametrize("dtype", [">f4", "<f4", ">f8", ">i2", "<u2", ">i4"])
@pytest.mark.parametrize("kind", ["plain", "constant", "one pixel far out", "two values", "huge offset", "duplicates"])
def test_moments_are_those_of_exact_sums_whatever_is_stored(kind, dtype, tmp_path):
    rng = np.random.default_rng(3)
    values = rng.normal(1000.0, 30.0, (LINES, SAMPLES, BANDS))
    if kind == "constant":
        values[:] = 1000.0
    elif kind == "one pixel far out":
        values[3, 2] = 30000.0
    elif kind == "two values":
        values = np.where(values > 1000.0, 2.0, 1.0)
    elif kind == "huge offset":
        values = 30000.0 + rng.normal(0.0, 2.0, values.shape)
    elif kind == "duplicates":
        values[..., 1] = values[..., 0]
    stored = values.round().astype(dtype) if "f" not in dtype else values.astype(dtype)
    found = statistics(tmp_path, stored)
    pixels = stored.reshape(-1, BANDS).astype(np.longdouble)
    mean = pixels.mean(axis=0)
    centred = pixels - mean
    covariance = (centred.T @ centred / (len(pixels) - 1)).astype(float)
    np.testing.assert_allclose(found.mean, mean.astype(float), rtol=1e-12)
    sd = np.sqrt(np.diag(covariance))
    # A sum in float64 forgets 1e-16 of its greatest term.
    assert np.all(np.abs(found.covariance - covariance) <= 1e-12 * np.outer(sd, sd) + 1e-300)
    assert np.linalg.eigvalsh(found.covariance)[0] >= -1e-12 * max(np.trace(found.covariance), 1e-300)


@FEW
@given(SCALES, st.sampled_from(["<f8", ">f8"]))
def test_moments_follow_the_scale_of_the_numbers(tmp_path_factory, scale, dtype):
    values = np.random.default_rng(4).normal(1.0, 0.03, (LINES, SAMPLES, BANDS))
    found = statistics(tmp_path_factory.mktemp("c"), (values * scale).astype(dtype))
    plain = np.cov(values.reshape(-1, BANDS), rowvar=False)
    np.testing.assert_allclose(found.covariance / scale / scale, plain, rtol=1e-9)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_pixels_that_are_not_finite_are_left_out_and_counted(bad, tmp_path):
    values = np.random.default_rng(5).normal(1.0, 0.1, (LINES, SAMPLES, BANDS)).astype("<f4")
    values[2, 3, 1] = values[5, 0, 3] = bad
    found = statistics(tmp_path, values)
    good = values.reshape(-1, BANDS)[np.isfinite(values).all(axis=2).ravel()]
    assert (found.n, found.n_left_out) == (LINES * SAMPLES - 2, 2)
    np.testing.assert_allclose(found.mean, good.mean(axis=0), rtol=1e-6)
    values[:] = bad
    with pytest.raises(HypervalError, match="pixel"):
        statistics(tmp_path, values)


def test_one_pixel_is_its_own_mean_and_spans_nothing(tmp_path):
    values = np.full((LINES, SAMPLES, BANDS), np.nan, ">f4")
    values[2, 3] = [1e-20, 2.0, 3e10, 4.0]
    found = statistics(tmp_path, values)
    assert (found.n, found.n_left_out) == (1, LINES * SAMPLES - 1)
    np.testing.assert_allclose(found.mean, values[2, 3].astype(float), rtol=1e-12)
    assert not found.covariance.any()
    with pytest.raises(UsageError):
        spectral_matched_filter(found.mean + 1.0, found.mean, found.covariance)


@FEW
@given(st.integers(0, 10_000), SCALES, st.sampled_from(["full", "singular", "nearly singular", "zero", "nan"]))
def test_a_filter_meets_its_two_conditions_or_is_refused(seed, scale, kind):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6))
    covariance = root @ root.T * scale**2
    if kind == "singular":
        covariance[:, 0] = covariance[0] = 0.0
    elif kind == "nearly singular":
        covariance = np.outer(root[0], root[0]) * scale**2 + 1e-13 * scale**2 * np.eye(6)
    elif kind == "zero":
        covariance[:] = 0.0
    elif kind == "nan":
        covariance[2, 2] = np.nan
    mean, target = scale * rng.uniform(1, 2, 6), scale * rng.uniform(3, 4, 6)
    for make in (matched_filter_weights, spectral_matched_filter, cem_correlation_weights):
        try:
            found = make(target, mean, covariance)
        except UsageError:
            assert kind != "full"
            continue
        assert kind not in ("zero", "nan", "singular") or make is cem_correlation_weights
        assert np.all(np.isfinite(found.weights))
        slack = 1e-12 * max(found.condition, 1.0) + 1e-9
        if make is matched_filter_weights:
            assert found.score(target) == pytest.approx(1.0, abs=slack)
            assert found.score(mean) == pytest.approx(0.0, abs=slack)
        elif make is cem_correlation_weights:
            assert found.score(target) == pytest.approx(1.0, abs=slack)
    with pytest.raises(UsageError):
        matched_filter_weights(mean, mean, root @ root.T * scale**2)


@FEW
@given(st.integers(0, 10_000), SCALES, st.sampled_from(["ace", "cem", "smf"]))
def test_scores_of_pixels_do_not_follow_the_unit(seed, scale, name):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(5, 5))
    covariance, mean, target = root @ root.T, rng.uniform(1, 2, 5), rng.uniform(3, 4, 5)
    pixels = rng.normal(1.5, 0.3, (20, 5))

    def scores(unit: float) -> np.ndarray:
        background = mean * unit, covariance * unit**2
        detector = pixel_detector(name, target * unit, *background)
        return detector.score(pixels * unit, whitener_of(*background))

    np.testing.assert_allclose(scores(scale), scores(1.0), rtol=1e-6, atol=1e-9)


HOSTILE = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False), st.sampled_from([0.0, -0.0, 1e308, -1e308, 5e-324]),
    st.integers(0, 3).map(float),
)  # fmt: skip


@FEW
@given(st.lists(HOSTILE, min_size=1, max_size=30), st.lists(HOSTILE, min_size=1, max_size=60))
def test_a_curve_of_any_finite_scores_rises_within_its_limits(targets, background):
    curve = empirical_roc(targets, background)
    for values in (curve.pd, curve.pd_lower, curve.pd_upper):
        assert np.all((values >= 0.0) & (values <= 1.0))
    assert np.all(np.diff(curve.pd) >= 0.0)
    assert np.all((curve.pd_lower <= curve.pd) & (curve.pd <= curve.pd_upper))
    assert (curve.n_target, curve.n_background) == (len(targets), len(background))


@pytest.mark.parametrize(
    ("targets", "background"),
    [([], [1.0]), ([1.0], []), ([np.nan], [1.0]), ([1.0], [np.nan, 2.0]), ([[1.0]], "a")],
)
def test_a_curve_of_no_scores_is_refused(targets, background):
    with pytest.raises((UsageError, ValueError)):
        empirical_roc(targets, background)


@FEW
@given(st.integers(0, 10**9), st.integers(1, 10**9))
def test_limits_of_a_share_hold_it_for_any_count(k, n):
    low, high = clopper_pearson(min(k, n), n)
    assert 0.0 <= low <= min(k, n) / n <= high <= 1.0


@FEW
@given(st.lists(st.floats(300.0, 2600.0), min_size=2, max_size=12), st.booleans())
def test_wavelengths_in_any_order_increase_or_are_refused(wavelengths, falling):
    waves = np.sort(wavelengths)[::-1] if falling else np.array(wavelengths)
    record = Record("a", waves, np.arange(waves.size) / 99.0, "a.txt", wavelength_unit="nm")
    try:
        found = finished(record, Asked("other"))
    except HypervalError:
        assert np.any(np.diff(waves) >= 0) or waves.size < 2 or np.unique(waves).size < waves.size
        return
    assert np.all(np.diff(found.wavelength_nm) > 0)
    assert set(found.wavelength_nm) <= set(waves)


def panel(name: str, reflectance: float, radiance: float, bands: int = 3) -> MeasuredPanel:
    full = np.full(bands, 1.0)
    return MeasuredPanel(name, reflectance * full, 1e-4 * full, radiance * full, (1e-3 * radiance) ** 2 * full, 9)


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1.0, 1e6, 1e30])
def test_a_line_follows_the_unit_of_radiance(scale):
    line = fit_elm([panel("dark", 0.1, 1.0 * scale), panel("bright", 0.6, 6.0 * scale)])
    np.testing.assert_allclose(line.gain / scale, 10.0, rtol=1e-9)
    np.testing.assert_allclose(line.offset / scale, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("panels", "saturation", "message"),
    [
        ([panel("a", 0.1, 1.0)], None, "panel"), ([panel("a", 0.5, 5.0), panel("b", 0.5, 5.0)], None, "differ by"),
        ([panel("a", 10.0, 1.0), panel("b", 60.0, 6.0)], None, "percent"),
        ([panel("a", 0.1, 1.0), panel("b", 0.6, 6.0)], 6.0, "saturat"),
    ],
)  # fmt: skip
def test_panels_that_fix_no_line_are_refused(panels, saturation, message):
    with pytest.raises(UsageError, match=message):
        fit_elm(panels, saturation=saturation)
