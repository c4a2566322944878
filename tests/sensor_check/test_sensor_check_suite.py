"""Every check of the acceptance suite passes on a good sensor and fails on a broken one, naming what moved."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sensor_data import Q, changed, good_sensor, measured_sensor, sensor_of
from solver_nodes import run_solver_at

from hyperval.errors import UsageError
from hyperval.model import predict
from hyperval.results import Outcome
from hyperval.sensor import ReferenceScene, Sensor, load_sensor
from hyperval.sensor_check import SensorCheck, check_sensor, movable_numbers, scene_radiance, sunlit_radiance
from hyperval.spectra import SpectralAxis, band_average
from small_campaign import stand_in_atmosphere

Patch = pytest.MonkeyPatch


def run(data: dict[str, Any]) -> SensorCheck:
    return check_sensor(sensor_of(data), engine=stand_in_atmosphere)


def failures(check: SensorCheck) -> set[str]:
    return {f"{r.product}/{r.metric}" for r in check.table if r.outcome in (Outcome.DISAGREES, Outcome.ERROR)}


# --- defects of the file: entries that differ from those of the good sensor ------------------------------------


def bands(change: Callable[[list[list[float]]], list[list[float]]]) -> dict[str, Any]:
    return {"bands": {"table": change(good_sensor()["bands"]["table"]), **Q}}


def widths(factor: float) -> dict[str, Any]:
    return bands(lambda rows: [[c, factor * f, g] for c, f, g in rows])


def quantity(name: str, value: float) -> dict[str, Any]:
    return {f"arm_{name}": {"value": value, **Q}}


def published(snr: float, at: float = 550, says: str = "value", **reference: Any) -> dict[str, Any]:
    entry = {"table": [[at, snr]], "says": says, **(reference or {"radiance": {"value": 10, **Q}}), **Q}
    return {"published_snr": [entry]}


SWAPPED = bands(lambda rows: [*rows[:10], rows[11], rows[10], *rows[12:]])
NO_LIGHT = {"arm_throughput": {"convention": "value", "cm2_sr": 1e-320, **Q}}
SHORT_TABLE = {"arm_quantum_efficiency": {"table": [[425, 0.4], [800, 0.4]], **Q}}
EMPTY_ARM = {**good_sensor()["arms"][0], "name": "SWIR", "range_nm": [1000, 2500]}
# Noise |a sqrt(b + L) + c| that vanishes at one radiance: beyond it the SNR falls.
ZERO_CROSSING = {"arms": [], "published_snr": [], "measured_noise": measured_sensor(c=-0.02)["measured_noise"]}

# Entries of the file that are others, and the check that fails.
FILE_DEFECTS: dict[str, tuple[dict[str, Any], str]] = {
    "swapped bands": (SWAPPED, "response/bands_out_of_order"),
    "a band without width": (bands(lambda rows: [[*rows[0][:1], 0.0, 1], *rows[1:]]), "response/bands_without_width"),
    "sigma for FWHM": (widths(1 / 2.3548), "response/fwhm_over_spacing_median"),
    "FWHM times 2.35": (widths(2.3548), "response/fwhm_over_spacing_median"),
    "a band lacks": (bands(lambda rows: rows[:20] + rows[21:]), "response/widest_gap_fwhm"),
    "arm too short": ({"arm_range_nm": [425, 700]}, "throughput/bands_outside_arms"),
    "arm without bands": ({"arms": [good_sensor()["arms"][0], EMPTY_ARM]}, "throughput/bands_of_arm"),
    "negative transmittance": (quantity("optical_transmittance", -0.5), "throughput/lowest_optical_transmittance"),
    "transmittance in %": (quantity("optical_transmittance", 50), "throughput/highest_optical_transmittance"),
    "negative efficiency": (quantity("quantum_efficiency", -0.1), "throughput/lowest_quantum_efficiency"),
    "efficiency in %": (quantity("quantum_efficiency", 40), "throughput/highest_quantum_efficiency"),
    "no light left": (quantity("degradation", 0.0), "throughput/lowest_degradation"),
    "light gained": (quantity("degradation", 1.2), "throughput/highest_degradation"),
    "negative time": (quantity("integration_time_s", -0.004), "throughput/lowest_integration_time_s"),
    "time in us": (quantity("integration_time_s", 4000.0), "throughput/highest_integration_time_s"),
    "negative noise": (quantity("fixed_noise_electrons", -40), "throughput/lowest_fixed_noise_electrons"),
    "absurd noise": (quantity("fixed_noise_electrons", 1e10), "throughput/highest_fixed_noise_electrons"),
    "table too short": (SHORT_TABLE, "throughput/bands_beyond_table_of_quantum_efficiency"),
    "throughput of nothing": (NO_LIGHT, "throughput/lowest_electrons_per_radiance"),
    "noise gain off by 2 %": ({"detector_gain": 1.02}, "throughput/gain_error_by_photon_transfer"),
    "too few bits": ({"arm_bits": 6}, "noise/quantisation_over_other_noise"),
    "noise above the signal": (quantity("fixed_noise_electrons", 1e6), "snr/lowest_snr"),
    "small well": (quantity("full_well_electrons", 1e5), "saturation/highest_part_of_full_scale"),
    "small well in the scenes": (quantity("full_well_electrons", 1e5), "scenario/highest_part_of_full_scale"),
    "SNR that falls with light": (ZERO_CROSSING, "monotone/lowest_relative_growth_of_snr"),
    "SNR not met": (published(400), "published_snr/computed_over_published"),
}  # fmt: skip


@pytest.fixture(scope="module")
def good() -> SensorCheck:
    return run(good_sensor())


def test_the_good_sensors_pass(good):
    assert failures(good) == set()
    assert good.table.exit_code() == 0
    assert failures(run(measured_sensor())) == set()


@pytest.mark.parametrize("name", FILE_DEFECTS)
def test_a_defect_of_the_file_fails(name):
    entries, expected = FILE_DEFECTS[name]
    check = run(changed(good_sensor(), **entries))
    assert expected in failures(check)
    assert check.table.exit_code() == 1
    bad = next(r for r in check.table if f"{r.product}/{r.metric}" == expected and r.outcome is Outcome.DISAGREES)
    assert bad.reason


# --- defects of the program -----------------------------------------------------------------------------------


SUITE = "hyperval.sensor_check.suite"


def gain_constant(patch: Patch) -> None:
    patch.setattr("hyperval.sensor.noise.ELECTRONS_PER_UNIT", 1.02 * 5.034116567e15)


def sigma_in_resampling(patch: Patch) -> None:
    patch.setattr("hyperval.spectra.axis.SIGMA_PER_FWHM", 1.0)


def resampling(change: Callable[[Any], Any]) -> Callable[[Patch], None]:
    """Changes the bands of several spectra at once, which the responses are tried with, and not those of the sun."""

    def changed_average(w: Any, y: Any, axis: Any) -> Any:
        return change(band_average(w, y, axis)) if np.ndim(y) > 1 else band_average(w, y, axis)

    return lambda patch: patch.setattr(f"{SUITE}.band_average", changed_average)


def deaf_to_factors(patch: Patch) -> None:
    """The noise does not react to a change of the numbers that make it."""
    noise = Sensor.noise
    patch.setattr(Sensor, "noise", lambda self, *a: noise(replace(self, factors={}), *a))


def deaf_to_changes(patch: Patch) -> None:
    patch.setattr(f"{SUITE}.changed_noise", lambda noise, changes: noise)


def predicted(change: Callable[[Any], Any]) -> Callable[[Patch], None]:
    return lambda patch: patch.setattr(f"{SUITE}.predict", lambda s, *a: change(predict(s, *a)))


def every(group: str, factor: float) -> Callable[[Any], Any]:
    def change(found: Any) -> Any:
        held = {k: replace(e, mean=factor * e.mean) for k, e in getattr(found, group).items()}
        return replace(found, **{group: held})

    return change


def falling_roc(found: Any) -> Any:
    return replace(found, roc={k: replace(c, pd=c.pd[::-1].copy()) for k, c in found.roc.items()})


def refused(found: Any) -> Any:
    raise UsageError("cannot be predicted")


PROGRAM_DEFECTS: dict[str, tuple[Callable[[Patch], None], str]] = {
    "gain off by 2 %": (gain_constant, "throughput/gain_error_by_photon_energy"),
    "sigma taken as FWHM in the resampling": (sigma_in_resampling, "response/width_error"),
    "responses not normalised": (resampling(lambda y: 1.01 * y), "response/integral_error"),
    "responses shifted": (resampling(lambda y: y + np.array([[0.0], [0.5], [0.0]])), "response/centroid_error_fwhm"),
    "deaf to time and aperture": (deaf_to_factors, "monotone/lowest_relative_growth_of_snr"),
    "deaf to C_R": (deaf_to_changes, "monotone/lowest_relative_growth_of_snr"),
    "sign of the radiance": (predicted(every("radiance", -1.0)), "scenario/values_not_positive"),
    "SNR above its cap": (predicted(every("snr", 5.0)), "scenario/highest_snr_over_cap_of_c_r"),
    "empirical line off by 1 %": (predicted(every("reflectance", 1.01)), "scenario/panel_reflectance_error"),
    "falling ROC": (predicted(falling_roc), "scenario/lowest_step_of_roc"),
    "a scenario that cannot be run": (predicted(refused), "scenario/runs"),
}


@pytest.mark.parametrize("name", PROGRAM_DEFECTS)
def test_a_defect_of_the_program_fails(name, monkeypatch):
    inject, expected = PROGRAM_DEFECTS[name]
    inject(monkeypatch)
    check = run(good_sensor())
    assert expected in failures(check)
    assert check.table.exit_code() == 1


def test_every_gate_is_shown_to_fail(good):
    every = (*good.table, *run(measured_sensor()).table)
    gates = {f"{r.product}/{r.metric}" for r in every if r.outcome is Outcome.AGREES}
    shown = {expected for _, expected in (*FILE_DEFECTS.values(), *PROGRAM_DEFECTS.values())}
    assert gates - shown == set()


def test_the_numbers_name_the_size_of_the_defect(monkeypatch):
    (row,) = run(changed(good_sensor(), detector_gain=1.02)).table.where(metric="gain_error_by_photon_transfer")
    assert row.value == pytest.approx(1.02**-2 - 1, rel=1e-6)  # noise variance grows as the square of the gain
    gain_constant(monkeypatch)
    (row,) = run(good_sensor()).table.where(metric="gain_error_by_photon_energy")
    assert row.value == pytest.approx(0.02, abs=1e-6)


def test_what_depends_on_a_failed_part_is_skipped():
    check = run(changed(good_sensor(), **SWAPPED))
    skipped = {r.product for r in check.table if r.outcome is Outcome.SKIPPED}
    assert {"throughput", "noise", "scenario", "sensitivity"} <= skipped
    assert not check.usable


def test_sunlit_ground_against_published_irradiance():
    # 0.25 E0 cos 45 / pi with E0 read off published solar tables [uW cm-2 sr-1 nm-1].
    axis = SpectralAxis(np.array([550.0, 850, 1650, 2200]), np.full(4, 10.0))
    assert sunlit_radiance(axis, 0.25) == pytest.approx([10.64, 5.43, 1.28, 0.466], rel=0.05)


def test_scene_radiance_is_that_of_a_uniform_ground():
    scene = ReferenceScene(reflectance=0.4, solar_zenith_deg=30, sensor_altitude_km=1.0, source="for tests")
    axis = SpectralAxis(np.array([550.0, 860.0]), np.array([10.0, 10.0]))
    found = scene_radiance(axis, scene, stand_in_atmosphere)
    w = axis.centre_nm
    haze, blue = 0.2 * (w / 550) ** -1.3, (w / 550) ** -4
    sun = 60 * np.exp(-(((w - 480) / 500) ** 2)) + 1
    direct = sun * np.exp(-0.5 * haze - 0.05 * blue) / np.pi
    both = direct * (1 + 0.1 * haze + 0.05 * blue)
    albedo = 0.06 * blue + 0.15 * haze
    # Averaging a smooth curve over 10 nm moves it by less than 1e-3.
    assert found == pytest.approx(0.8 * blue + 0.5 * haze + both * 0.4 / (1 - 0.4 * albedo), rel=1e-3)


def test_published_ratio_by_hand():
    g = sensor_of(good_sensor()).noise().electrons_per_radiance[15]  # 550 nm
    expected = 10 * g / np.sqrt(10 * g + 1600 + (350000 / 4096) ** 2 / 12)
    (point,) = run(good_sensor()).points
    assert point.computed == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("entry", "status"),
    [
        (published(300), Outcome.AGREES),
        (published(240), Outcome.DISAGREES),  # 28 % above a value
        (published(240, says="at least"), Outcome.AGREES),
        (published(315, says="at least"), Outcome.DISAGREES),
        (published(5000, radiance=None), Outcome.NONE),  # no radiance stated: not judged
        (published(300, at=1500), Outcome.DISAGREES),  # no such band
    ],
)
def test_how_published_ratios_are_judged(entry, status):
    table = run(changed(good_sensor(), **entry)).table
    assert [r.outcome for r in table.where(metric="computed_over_published")] == [status]


def test_snr_moves_with_the_root_of_the_throughput_where_photons_rule():
    quiet = {
        "arm_throughput": {"convention": "value", "cm2_sr": 3.9e-7, "source": "assumed: for tests"},
        **quantity("fixed_noise_electrons", 0),
        "arm_bits": 32,
        "calibration_error_percent": {"value": 0.0, **Q},
    }
    check = check_sensor(sensor_of(changed(good_sensor(), **quiet)), vary=0.2, engine=stand_in_atmosphere)
    (swing,) = check.swings
    assert swing.name == "VNIR.throughput"
    assert swing.snr == pytest.approx((np.sqrt(0.8) - 1, np.sqrt(1.2) - 1), rel=1e-6)
    assert swing.detection[0] < 0 < swing.detection[1]  # less light, fewer detections


def test_factors_reach_every_kind_of_number():
    """Each moves what it stands for in the noise, by itself."""
    spec = sensor_of(good_sensor()).specification

    def made(factors: dict[str, float]) -> tuple[Any, ...]:
        other = Sensor(spec, factors)
        n = other.noise()
        return n.electrons_per_radiance, other.axis.fwhm_nm, n.fixed_noise, n.lsb_electrons, n.calibration_percent

    for name in movable_numbers(spec):
        own = {"bands.fwhm": {0, 1}, "VNIR.fixed_noise_electrons": {2}, "VNIR.full_well_electrons": {3},
               "calibration_error_percent": {4}}.get(name, {0})  # fmt: skip
        both = zip(made({}), made({name: 1.5}), strict=True)
        assert own == {k for k, (old, new) in enumerate(both) if np.allclose(new, 1.5 * old, rtol=1e-12)}, name


def test_measured_noise_without_full_scale_says_so():
    data = measured_sensor()
    del data["measured_noise"]["saturation_radiance"]
    (row,) = run(data).table.where(product="saturation")
    assert row.outcome is Outcome.NONE
    assert "does not say" in row.reason


def test_bands_part_by_part_and_stated_gaps():
    parts = [{"first_nm": first, "step_nm": 8, "count": n, "fwhm_nm": 9} for first, n in ((430, 30), (740, 20))]
    assert failures(run(changed(good_sensor(), bands={"parts": parts, **Q}))) == {"response/widest_gap_fwhm"}
    gaps = [{"range_nm": [662, 740], **Q}]
    assert run(changed(good_sensor(), bands={"parts": parts, "gaps": gaps, **Q})).table.exit_code() == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["enmap", "hymap", "hyperion"])
def test_published_ratios_of_the_library_in_their_own_scene(name, tmp_path, monkeypatch):
    monkeypatch.setenv("HYPERVAL_CACHE", str(tmp_path))
    # Half of the engine's nodes: bands between them move by less than 1 %, of the 20 % that are judged.
    run_solver_at(monkeypatch, 350.0, 412.5, 470.0, 550.0, 670.0, 860.0, 1240.0, 1650.0, 2250.0, 2600.0)
    points = SensorCheck(load_sensor(name)).points
    assert {point.judged for point in points} == {True}
    for p in points:
        assert p.computed >= p.published if p.item.says == "at least" else abs(p.computed / p.published - 1) <= 0.2
