"""Departures of the truth from the scenario: each against what it must do, and together."""

from __future__ import annotations

import numpy as np
import pytest
from uncertain_scene import AXIS, run, scenario

from hyperval.errors import UsageError
from hyperval.prediction.departure import (
    Departure,
    StatisticsDeparture,
    combined,
    departs,
    fill_distribution,
    true_fill,
)
from hyperval.prediction.inputs import in_bands
from hyperval.scenario import Fill
from hyperval.settings import with_settings
from hyperval.spectra.axis import SpectralAxis

B = len(AXIS)
KEY = ("tenth", "cem", "pixel")


def test_no_departure_changes_nothing():
    base, same = run(scenario()), run(scenario(), departure=Departure())
    for name in base.radiance:
        np.testing.assert_array_equal(base.radiance[name].mean, same.radiance[name].mean)
    np.testing.assert_array_equal(base.roc[KEY].pd, same.roc[KEY].pd)
    assert not departs(Departure())
    assert departs(Departure(path=1.1))


def test_settings_are_those_of_the_dotted_path():
    a = run(scenario(), departure=Departure(settings={"atmosphere.aot550": 0.3}))
    b = run(with_settings(scenario(), {"atmosphere.aot550": 0.3}))
    np.testing.assert_array_equal(a.radiance["grass"].mean, b.radiance["grass"].mean)


def test_recorded_gain_and_offset_scale_radiance_and_noise_and_cancel_after_the_empirical_line():
    gain, offset = np.linspace(0.9, 1.1, B), 0.05
    base, off = run(scenario()), run(scenario(), departure=Departure(recorded_gain=gain, recorded_offset=offset))
    for name in ("grass", "panel", "tenth"):
        np.testing.assert_allclose(off.radiance[name].mean, gain * base.radiance[name].mean + offset, rtol=1e-12)
        np.testing.assert_allclose(
            off.radiance[name].pixel_covariance, np.outer(gain, gain) * base.radiance[name].pixel_covariance
        )
        np.testing.assert_allclose(off.reflectance[name].mean, base.reflectance[name].mean, rtol=1e-10)
    np.testing.assert_allclose(off.roc[KEY].pd, base.roc[KEY].pd, rtol=1e-9)
    # The signal-to-noise ratio of a recorded gain alone is that of the detector.
    gained = run(scenario(), departure=Departure(recorded_gain=gain))
    np.testing.assert_allclose(gained.snr["panel"].mean, base.snr["panel"].mean, rtol=1e-12)
    np.testing.assert_allclose(gained.noise["panel"]["shot"], gain**2 * base.noise["panel"]["shot"], rtol=1e-12)


def test_path_ground_and_irradiance_split_the_radiance():
    s, a = scenario(), np.linspace(0.95, 1.05, B)
    base = run(s).radiance["panel"].mean
    path = run(s, departure=Departure(path=a)).radiance["panel"].mean - base
    ground = run(s, departure=Departure(ground=a)).radiance["panel"].mean - base
    both = run(s, departure=Departure(irradiance=a)).radiance["panel"].mean - base
    np.testing.assert_allclose(both, (a - 1) * base, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(path + ground, both, rtol=1e-9, atol=1e-14)


def test_spectrum_departs_while_the_filter_looks_for_what_was_stated():
    added = np.linspace(-0.03, 0.03, B)
    base, off = run(scenario()), run(scenario(), departure=Departure(spectra={"plank": added}))
    np.testing.assert_allclose(off.reflectance["tenth"].mean - base.reflectance["tenth"].mean, 0.1 * added, atol=1e-12)
    # Filter, background and threshold stay; the score moves by the filter on the change, to first order in it.
    assert off.roc[KEY].threshold == pytest.approx(base.roc[KEY].threshold, rel=1e-12)
    half = run(scenario(), departure=Departure(spectra={"plank": 0.5 * added}))
    moved = off.scores["tenth", "cem"].mean - base.scores["tenth", "cem"].mean
    assert moved == pytest.approx(2 * (half.scores["tenth", "cem"].mean - base.scores["tenth", "cem"].mean), rel=1e-6)
    assert abs(moved) > 1e-4


def test_statistics_of_a_class():
    base = run(scenario())
    off = run(scenario(), departure=Departure(statistics={"grass": StatisticsDeparture(0.01, 2.0)}))
    np.testing.assert_allclose(off.reflectance["grass"].mean, base.reflectance["grass"].mean + 0.01, atol=1e-12)
    # Twice the covariance on top of the same noise: more spread in every band, less than twice the variance.
    ratio = np.diag(off.reflectance["grass"].pixel_covariance) / np.diag(base.reflectance["grass"].pixel_covariance)
    assert np.all((ratio > 1.0) & (ratio <= 2.01))
    with pytest.raises(UsageError, match="no such surface"):
        run(scenario(), departure=Departure(spectra={"gras": 0.1}))


def test_noise_and_signal_factors():
    base = run(scenario())
    loud = run(scenario(), departure=Departure(noise_factor=2.0))
    np.testing.assert_allclose(loud.snr["panel"].mean, 0.5 * base.snr["panel"].mean, rtol=1e-12)
    bright = run(scenario(), departure=Departure(signal_factor=4.0))
    np.testing.assert_allclose(bright.noise["panel"]["shot"], base.noise["panel"]["shot"] / 4.0, rtol=1e-12)
    np.testing.assert_allclose(bright.noise["panel"]["fixed"], base.noise["panel"]["fixed"] / 16.0, rtol=1e-12)


def test_wavelength_shift_is_that_of_the_sensor_operation():
    a = run(scenario(), departure=Departure(wavelength_shift_nm=1.5))
    b = run(with_settings(scenario(), {"sensor_operation": {"wavelength_shift_nm": 1.5}}))
    np.testing.assert_allclose(a.radiance["grass"].mean, b.radiance["grass"].mean, rtol=1e-12)
    np.testing.assert_allclose(a.roc[KEY].pd, b.roc[KEY].pd, rtol=1e-9)


def test_fills():
    off = run(scenario(), departure=Departure(fill={"tenth": 0.05}))
    there = run(scenario(**{"fixed: 0.1": "fixed: 0.15"}))
    np.testing.assert_allclose(off.roc[KEY].pd, there.roc[KEY].pd, rtol=1e-12)
    both = run(scenario(), departure=Departure(fill={"plank": 0.03, "tenth": 0.02}))
    np.testing.assert_allclose(both.roc[KEY].pd, off.roc[KEY].pd, rtol=1e-9)
    with pytest.raises(UsageError, match="no target 'nineth'"):
        run(scenario(), departure=Departure(fill={"nineth": 0.1}))


def test_fill_from_geometry_moves_its_mean_by_area():
    fill = Fill.model_validate({"geometry": {"side_m": 0.3, "gsd_m": 1.0, "pixels": "best"}})
    before = fill_distribution(fill)
    after = fill_distribution(true_fill(fill, 0.01))
    assert after.mean - before.mean == pytest.approx(0.01, rel=0.1)  # the area is exact, the phase nearly


def test_a_spread_of_fill_stays_below_that_of_all_or_nothing():
    after = true_fill(Fill(mean=0.5, sd=0.3), -0.48)
    assert (after.mean, after.sd) == pytest.approx((0.02, 0.99 * np.sqrt(0.02 * 0.98)))


def test_combined_adds_and_multiplies():
    a = Departure(settings={"atmosphere.aot550": 0.3}, spectra={"grass": 0.01}, path=1.1, wavelength_shift_nm=0.2)
    b = Departure(spectra={"grass": 0.02}, fill={"tenth": 0.01}, path=1.2, wavelength_shift_nm=0.1, recorded_gain=0.9)
    both = combined(a, b, Departure(fill={"tenth": 0.02}))
    assert both.path == pytest.approx(1.32)
    assert both.spectra["grass"] == pytest.approx(0.03)
    assert both.fill["tenth"] == pytest.approx(0.03)
    assert both.wavelength_shift_nm == pytest.approx(0.3)
    assert (both.recorded_gain, dict(both.settings)) == (0.9, {"atmosphere.aot550": 0.3})
    with pytest.raises(UsageError, match="different values"):
        combined(a, Departure(settings={"atmosphere.aot550": 0.1}))
    one = Departure(statistics={"grass": StatisticsDeparture(covariance=np.eye(B))})
    with pytest.raises(UsageError, match="a covariance to 'grass'"):
        combined(one, one)


def test_reflectance_domain_takes_a_recorded_gain_and_refuses_light():
    s = scenario("")
    base, off = run(s), run(s, departure=Departure(recorded_gain=1.1, recorded_offset=0.01))
    np.testing.assert_allclose(off.reflectance["grass"].mean, 1.1 * base.reflectance["grass"].mean + 0.01)
    with pytest.raises(UsageError, match="no atmosphere"):
        run(s, departure=Departure(path=1.1))


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
