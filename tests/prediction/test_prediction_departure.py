"""Truths in which something else stands at a path: each against what it must do, and together."""

from __future__ import annotations

import numpy as np
import pytest
from uncertain_scene import AXIS, ORIGINS, run, scenario

from hyperval.errors import UsageError
from hyperval.model import fill_distribution, read, together, value_at, with_mean
from hyperval.model.inputs import number_input
from hyperval.model.surfaces import in_bands
from hyperval.scenario import Fill
from hyperval.settings import with_settings
from hyperval.spectra import SpectralAxis

B = len(AXIS)
KEY = ("tenth", "cem", "pixel")
PLANK = "surfaces.plank.mean"


def mean(surface: str) -> np.ndarray:
    """Its reflectance as stated."""
    return value_at(read(scenario(), ORIGINS), f"surfaces.{surface}.mean")[0]


def test_nothing_moved_changes_nothing():
    base, same = run(scenario()), run(scenario(), truth={})
    for name in base.radiance:
        np.testing.assert_array_equal(base.radiance[name].mean, same.radiance[name].mean)
    np.testing.assert_array_equal(base.roc[KEY].pd, same.roc[KEY].pd)


def test_settings_are_those_of_the_dotted_path():
    a = run(scenario(), truth={"atmosphere.aot550": 0.3})
    b = run(with_settings(scenario(), {"atmosphere.aot550": 0.3}))
    np.testing.assert_array_equal(a.radiance["grass"].mean, b.radiance["grass"].mean)


def test_recorded_gain_and_offset_scale_radiance_and_noise_and_cancel_after_the_empirical_line():
    gain, offset = np.linspace(0.9, 1.1, B), 0.05
    base, off = run(scenario()), run(scenario(), truth={"sensor.gain": gain, "sensor.offset": offset})
    for name in ("grass", "panel", "tenth"):
        np.testing.assert_allclose(off.radiance[name].mean, gain * base.radiance[name].mean + offset, rtol=1e-12)
        np.testing.assert_allclose(
            off.radiance[name].pixel_covariance, np.outer(gain, gain) * base.radiance[name].pixel_covariance
        )
        np.testing.assert_allclose(off.reflectance[name].mean, base.reflectance[name].mean, rtol=1e-10)
    np.testing.assert_allclose(off.roc[KEY].pd, base.roc[KEY].pd, rtol=1e-9)
    # The signal-to-noise ratio of a recorded gain alone is that of the detector.
    gained = run(scenario(), truth={"sensor.gain": gain})
    np.testing.assert_allclose(gained.snr["panel"].mean, base.snr["panel"].mean, rtol=1e-12)
    np.testing.assert_allclose(gained.noise["panel"]["shot"], gain**2 * base.noise["panel"]["shot"], rtol=1e-12)


def test_path_ground_and_irradiance_split_the_radiance():
    s, a = scenario(), np.linspace(0.95, 1.05, B)
    base = run(s).radiance["panel"].mean
    path = run(s, truth={"light.path": a}).radiance["panel"].mean - base
    ground = run(s, truth={"light.ground": a}).radiance["panel"].mean - base
    both = run(s, truth={"light.irradiance": a}).radiance["panel"].mean - base
    np.testing.assert_allclose(both, (a - 1) * base, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(path + ground, both, rtol=1e-9, atol=1e-14)


def test_spectrum_departs_while_the_filter_looks_for_what_was_stated():
    added, stated = np.linspace(-0.03, 0.03, B), mean("plank")
    base, off = run(scenario()), run(scenario(), truth={PLANK: stated + added})
    np.testing.assert_allclose(off.reflectance["tenth"].mean - base.reflectance["tenth"].mean, 0.1 * added, atol=1e-12)
    # Filter, background and threshold stay; the score moves by the filter on the change, to first order in it.
    assert off.roc[KEY].threshold == pytest.approx(base.roc[KEY].threshold, rel=1e-12)
    half = run(scenario(), truth={PLANK: stated + 0.5 * added})
    moved = off.scores["tenth", "cem"].mean - base.scores["tenth", "cem"].mean
    assert moved == pytest.approx(2 * (half.scores["tenth", "cem"].mean - base.scores["tenth", "cem"].mean), rel=1e-6)
    assert abs(moved) > 1e-4


def test_statistics_of_a_class():
    base = run(scenario())
    off = run(scenario(), truth={"surfaces.grass.mean": mean("grass") + 0.01, "surfaces.grass.spread": 2.0**0.5})
    np.testing.assert_allclose(off.reflectance["grass"].mean, base.reflectance["grass"].mean + 0.01, atol=1e-12)
    # Twice the covariance on top of the same noise: more spread in every band, less than twice the variance.
    ratio = np.diag(off.reflectance["grass"].pixel_covariance) / np.diag(base.reflectance["grass"].pixel_covariance)
    assert np.all((ratio > 1.0) & (ratio <= 2.01))
    with pytest.raises(UsageError, match="no such surface"):
        run(scenario(), truth={"surfaces.gras.mean": 0.1})


def test_noise_and_signal_factors():
    base = run(scenario())
    loud = run(scenario(), truth={"sensor.noise": 2.0})
    np.testing.assert_allclose(loud.snr["panel"].mean, 0.5 * base.snr["panel"].mean, rtol=1e-12)
    bright = run(scenario(), truth={"sensor.electrons": 4.0})
    np.testing.assert_allclose(bright.noise["panel"]["shot"], base.noise["panel"]["shot"] / 4.0, rtol=1e-12)
    np.testing.assert_allclose(bright.noise["panel"]["fixed"], base.noise["panel"]["fixed"] / 16.0, rtol=1e-12)


def test_wavelength_shift_is_that_of_the_sensor_operation():
    a = run(scenario(), truth={"sensor.wavelength_shift_nm": 1.5})
    b = run(with_settings(scenario(), {"sensor_operation": {"wavelength_shift_nm": 1.5}}))
    np.testing.assert_allclose(a.radiance["grass"].mean, b.radiance["grass"].mean, rtol=1e-12)
    np.testing.assert_allclose(a.roc[KEY].pd, b.roc[KEY].pd, rtol=1e-9)


def test_fills():
    off = run(scenario(), truth={"fill.tenth": 0.15})
    there = run(scenario(**{"fixed: 0.1": "fixed: 0.15"}))
    np.testing.assert_allclose(off.roc[KEY].pd, there.roc[KEY].pd, rtol=1e-12)
    both = run(scenario(), truth={"fill.plank": np.array([0.13, 0.18]), "fill.tenth": 0.12})
    np.testing.assert_allclose(both.roc[KEY].pd, off.roc[KEY].pd, rtol=1e-9)
    with pytest.raises(UsageError, match=r"fill\.nineth"):
        run(scenario(), truth={"fill.nineth": 0.1})


def test_fill_from_geometry_moves_its_mean_by_area():
    fill = Fill.model_validate({"geometry": {"side_m": 0.3, "gsd_m": 1.0, "pixels": "best"}})
    before = fill_distribution(fill)
    after = fill_distribution(with_mean(fill, 0.01))
    assert after.mean - before.mean == pytest.approx(0.01, rel=0.1)  # the area is exact, the phase nearly


def test_a_spread_of_fill_stays_below_that_of_all_or_nothing():
    after = with_mean(Fill(mean=0.5, sd=0.3), -0.48)
    assert (after.mean, after.sd) == pytest.approx((0.02, 0.99 * np.sqrt(0.02 * 0.98)))


def test_changes_at_one_path_add_up_and_paths_to_one_number_compose():
    world = read(scenario(), ORIGINS)
    rows = np.array([np.linspace(0.01, 0.02, B)])
    grass = "surfaces.[grass].mean"
    one, other = (number_input(world, n, "surface", grass, 0.0, rows=k * rows) for n, k in (("a", 1.0), ("b", 2.0)))
    both = together([(one, one.moved(1.0)), (other, other.moved(-1.0))])
    np.testing.assert_allclose(both[grass], mean("grass") - rows[0])
    twice = run(scenario(), truth={"sensor.electrons": 1.5, "sensor_changes.signal_factor": 2.0})
    once = run(scenario(), truth={"sensor.electrons": 3.0})
    np.testing.assert_allclose(twice.noise["panel"]["shot"], once.noise["panel"]["shot"], rtol=1e-12)


def test_reflectance_domain_takes_a_recorded_gain_and_refuses_light():
    s = scenario("")
    base, off = run(s), run(s, truth={"sensor.gain": 1.1, "sensor.offset": 0.01})
    np.testing.assert_allclose(off.reflectance["grass"].mean, 1.1 * base.reflectance["grass"].mean + 0.01)
    with pytest.raises(UsageError, match="no atmosphere"):
        run(s, truth={"light.path": 1.1})


def test_a_library_at_the_labelled_bands_moves_with_a_shift_and_is_not_smoothed():
    w = np.arange(400.0, 1000.0, 5.0)
    axis = SpectralAxis(w, np.full(w.size, 6.0))
    values = 0.3 + 0.2 * np.exp(-(((w - 700.0) / 15.0) ** 2))
    for shift in (0.2, -1.0):
        true = SpectralAxis(w + shift, axis.fwhm_nm)
        exact = 0.3 + 0.2 * np.exp(-(((w + shift - 700.0) / 15.0) ** 2))
        np.testing.assert_allclose(in_bands(w, values, true, axis), exact, atol=3e-4)
        # Averaged over the bands a second time the peak would lose more than the shift moves it.
        assert np.nanmax(np.abs(in_bands(w, values, true) - exact)) > 3e-3
    holes = np.where(np.abs(w - 500) < 8, np.nan, values)
    assert np.array_equal(np.isnan(in_bands(w, holes, true, axis)), np.isnan(holes))
