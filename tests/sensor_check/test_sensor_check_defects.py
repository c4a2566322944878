"""Every check of the acceptance suite passes on a good sensor and fails on a broken one, naming what moved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sensor_data import SHEET, changed, good_sensor, measured_sensor, sensor_of

import hyperval.sensor_check.suite as suite
from hyperval.errors import UsageError
from hyperval.results import Outcome
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor_check import SensorCheck, check_sensor
from small_campaign import stand_in_atmosphere

Patch = pytest.MonkeyPatch
Q = {"source": SHEET}


def run(data: dict[str, Any]) -> SensorCheck:
    return check_sensor(sensor_of(data), engine=stand_in_atmosphere)


def failures(check: SensorCheck) -> set[str]:
    return {f"{r.product}/{r.metric}" for r in check.table if r.outcome in (Outcome.DISAGREES, Outcome.ERROR)}


def rows_of(table: list[list[float]]) -> dict[str, Any]:
    return {"table": table, **Q}


def good_rows() -> list[list[float]]:
    return [list(r) for r in good_sensor()["bands"]["table"]]


# --- defects of the file: entries that differ from those of the good sensor ------------------------------------


def swapped_bands() -> dict[str, Any]:
    rows = good_rows()
    rows[10], rows[11] = rows[11], rows[10]
    return changed(good_sensor(), bands=rows_of(rows))


def without_width() -> dict[str, Any]:
    rows = good_rows()
    rows[3][1] = 0.0
    return changed(good_sensor(), bands=rows_of(rows))


def sigma_for_fwhm() -> dict[str, Any]:
    return changed(good_sensor(), bands=rows_of([[c, f / 2.3548, g] for c, f, g in good_rows()]))


def fwhm_for_sigma() -> dict[str, Any]:
    return changed(good_sensor(), bands=rows_of([[c, f * 2.3548, g] for c, f, g in good_rows()]))


def lacking_band() -> dict[str, Any]:
    rows = good_rows()
    return changed(good_sensor(), bands=rows_of(rows[:20] + rows[21:]))


def quantity(name: str, value: float) -> Callable[[], dict[str, Any]]:
    return lambda: changed(good_sensor(), **{f"arm_{name}": {"value": value, **Q}})


def short_table() -> dict[str, Any]:
    return changed(good_sensor(), arm_quantum_efficiency={"table": [[425, 0.4], [800, 0.4]], **Q})


def empty_arm() -> dict[str, Any]:
    data = changed(good_sensor())
    data["arms"].append({**data["arms"][0], "name": "SWIR", "range_nm": [1000, 2500]})
    return data


def no_light() -> dict[str, Any]:
    return changed(good_sensor(), arm_throughput={"convention": "value", "cm2_sr": 1e-320, **Q})


STALE = {"check": "snr/lowest_snr", "reason": "it was too low once"}


def published(snr: float) -> dict[str, Any]:
    return {"table": [[550, snr]], "radiance": {"value": 10, **Q}, **Q}


def zero_crossing() -> dict[str, Any]:
    """Noise |a sqrt(b + L) + c| that vanishes at one radiance: beyond it the SNR falls."""
    data = measured_sensor()
    data["measured_noise"]["table"] = [[425.0, 0.01, 0.16, -0.02], [910.0, 0.01, 0.16, -0.02]]
    return data


FILE_DEFECTS: dict[str, tuple[Callable[[], dict[str, Any]], str]] = {
    "swapped bands": (swapped_bands, "response/bands_out_of_order"),
    "a band without width": (without_width, "response/bands_without_width"),
    "sigma for FWHM": (sigma_for_fwhm, "response/fwhm_over_spacing_median"),
    "FWHM times 2.35": (fwhm_for_sigma, "response/fwhm_over_spacing_median"),
    "a band lacks": (lacking_band, "response/widest_gap_fwhm"),
    "arm too short": (lambda: changed(good_sensor(), arm_range_nm=[425, 700]), "throughput/bands_outside_arms"),
    "arm without bands": (empty_arm, "throughput/bands_of_arm"),
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
    "table too short": (short_table, "throughput/bands_beyond_table_of_quantum_efficiency"),
    "throughput of nothing": (no_light, "throughput/lowest_electrons_per_radiance"),
    "noise gain off by 2 %": (
        lambda: changed(good_sensor(), detector_gain=1.02),
        "throughput/gain_error_by_photon_transfer",
    ),
    "too few bits": (lambda: changed(good_sensor(), arm_bits=6), "noise/quantisation_over_other_noise"),
    "noise above the signal": (quantity("fixed_noise_electrons", 1e6), "snr/lowest_snr"),
    "small well": (quantity("full_well_electrons", 1e5), "saturation/highest_part_of_full_scale"),
    "small well in the scenes": (quantity("full_well_electrons", 1e5), "scenario/highest_part_of_full_scale"),
    "SNR that falls with light": (zero_crossing, "monotone/lowest_relative_growth_of_snr"),
    "SNR not met": (
        lambda: changed(good_sensor(), published_snr=[published(400)]),
        "published_snr/computed_over_published",
    ),
    "stale discrepancy": (
        lambda: changed(good_sensor(), known_discrepancies=[STALE]),
        "file/known_discrepancy",
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def good() -> SensorCheck:
    return run(good_sensor())


def test_the_good_sensors_pass(good):
    assert failures(good) == set()
    assert good.exit_code == 0
    assert failures(run(measured_sensor())) == set()


@pytest.mark.parametrize("name", FILE_DEFECTS)
def test_a_defect_of_the_file_fails(name, good):
    make, expected = FILE_DEFECTS[name]
    check = run(make())
    assert expected in failures(check)
    assert check.exit_code == 1
    bad = next(r for r in check.table if f"{r.product}/{r.metric}" == expected and r.outcome is Outcome.DISAGREES)
    assert bad.reason


def test_negative_aperture_is_refused_when_the_file_is_read():
    with pytest.raises(ValueError, match="aperture_m"):
        sensor_of(changed(good_sensor(), arm_throughput={"aperture_m": -0.1, "ifov_mrad": 1.0, **Q}))


# --- defects of the program -----------------------------------------------------------------------------------


def gain_constant(patch: Patch) -> None:
    import hyperval.sensor.response as response

    patch.setattr(response, "ELECTRONS_PER_UNIT", 1.02 * response.ELECTRONS_PER_UNIT)


def sigma_in_resampling(patch: Patch) -> None:
    import hyperval.spectra.axis as response

    patch.setattr(response, "SIGMA_PER_FWHM", 1.0)


def resampling(change: Callable[[Any], Any]) -> Callable[[Patch], None]:
    """Changes the bands of several spectra at once, which the responses are tried with, and not those of the sun."""
    average = suite.band_average

    def changed_average(w: Any, y: Any, axis: Any) -> Any:
        return change(average(w, y, axis)) if np.ndim(y) > 1 else average(w, y, axis)

    return lambda patch: patch.setattr(suite, "band_average", changed_average)


def noise_sum(patch: Patch) -> None:
    variance = NoiseModel.variance
    patch.setattr(NoiseModel, "variance", lambda self, level, **k: 1.1 * variance(self, level, **k))


def deaf_to(name: str) -> Callable[[Patch], None]:
    """The noise does not react to a change of what makes it."""
    stand_ins = {"scaled": lambda spec, factors: spec, "changed_noise": lambda noise, changes: noise}
    return lambda patch: patch.setattr(suite, name, stand_ins[name])


def predicted(change: Callable[[Any], Any]) -> Callable[[Patch], None]:
    predict = suite.predict
    return lambda patch: patch.setattr(suite, "predict", lambda s, *a: change(predict(s, *a)))


def every(group: str, factor: float) -> Callable[[Any], Any]:
    def change(found: Any) -> Any:
        held = {k: replace(e, mean=factor * e.mean) for k, e in getattr(found, group).items()}
        return replace(found, **{group: held})

    return change


def falling_roc(found: Any) -> Any:
    return replace(found, roc={k: replace(c, pd=c.pd[::-1].copy()) for k, c in found.roc.items()})


def refused(found: Any) -> Any:
    raise UsageError("cannot be predicted")


SHIFT = np.array([[0.0], [0.5], [0.0]])  # of the first moment [nm]

PROGRAM_DEFECTS: dict[str, tuple[Callable[[Patch], None], str]] = {
    "gain off by 2 %": (gain_constant, "throughput/gain_error_by_photon_energy"),
    "sigma taken as FWHM in the resampling": (sigma_in_resampling, "response/width_error"),
    "responses not normalised": (resampling(lambda y: 1.01 * y), "response/integral_error"),
    "responses shifted": (
        resampling(lambda y: y + np.array([[0.0], [0.5], [0.0]])),
        "response/centroid_error_fwhm",
    ),
    "terms that do not add up": (noise_sum, "noise/sum_of_terms_error"),
    "deaf to time and aperture": (deaf_to("scaled"), "monotone/lowest_relative_growth_of_snr"),
    "deaf to C_R": (deaf_to("changed_noise"), "monotone/lowest_relative_growth_of_snr"),
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
    assert check.exit_code == 1


def test_every_gate_is_shown_to_fail(good):
    gates = {
        f"{r.product}/{r.metric}" for r in (*good.table, *run(measured_sensor()).table) if r.outcome is Outcome.AGREES
    }
    shown = {expected for _, expected in (*FILE_DEFECTS.values(), *PROGRAM_DEFECTS.values())}
    assert gates - shown == set()


def test_the_numbers_name_the_size_of_the_defect(monkeypatch):
    (row,) = run(changed(good_sensor(), detector_gain=1.02)).table.where(metric="gain_error_by_photon_transfer")
    assert row.value == pytest.approx(1.02**-2 - 1, rel=1e-6)  # noise variance grows as the square of the gain
    gain_constant(monkeypatch)
    (row,) = run(good_sensor()).table.where(metric="gain_error_by_photon_energy")
    assert row.value == pytest.approx(0.02, abs=1e-6)


def test_what_depends_on_a_failed_part_is_skipped():
    check = run(swapped_bands())
    skipped = {r.product for r in check.table if r.outcome is Outcome.SKIPPED}
    assert {"throughput", "noise", "scenario", "sensitivity"} <= skipped
    assert not check.usable
