"""The numbers of one sensor that a baseline keeps: signal, noise, and what the standard scenarios make of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np
import numpy.typing as npt

from hyperval.baseline.metrics import Measured
from hyperval.baseline.schema import key_of
from hyperval.errors import HypervalError
from hyperval.predict import Origins, predict
from hyperval.processing.roc_reading import detection_at
from hyperval.results import Outcome
from hyperval.scenario import builtin_scenarios, load_scenario
from hyperval.sensor.noise import NoiseBreakdown, NoiseModel
from hyperval.sensor.specification import Sensor
from hyperval.sensor_check.noise import LEVELS, MIDDLE, Engine, summary_regions, sunlit_radiance
from hyperval.sensor_check.scenarios import FALSE_ALARM
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
METHOD = "sensor"
# Lines of the sun (CH, Mg, H alpha) and of oxygen: a response of another width sees them deeper or less deep.
LINES_NM = (430.0, 517.0, 656.0, 762.0)
# Errors of transmission are zero in most sensor files; this rate shows what they would do.
BIT_ERROR_RATE = 1e-9


def sensor_metrics(sensor: Sensor, engine: Engine | None = None) -> dict[str, Measured]:
    """Every number of a sensor, sorted by name.

    Median SNR (without C_R) at the reference radiances, G, each noise term as a radiance, by spectral region; the
    reference radiance in bands at lines; P_D at P_FA 1e-3 and the radiance of the white panel at the oxygen band in
    the standard scenarios.

    Parameters
    ----------
    engine : stands in for the atmosphere engine
    """
    axis, noise = sensor.axis, sensor.noise()
    metrics = dict(_bands(axis)) | dict(_noise(axis, noise)) | dict(_scenarios(sensor, engine))
    return dict(sorted(metrics.items()))


def _item(product: str, subject: str, metric: str, value: float, unit: str = "1") -> tuple[str, Measured]:
    return key_of(product, subject, METHOD, metric), Measured(float(value), unit=unit)


def _bands(axis: SpectralAxis) -> Iterator[tuple[str, Measured]]:
    yield _item("bands", "all", "band_count", len(axis))
    yield _item("bands", "good", "band_count", int(axis.good.sum()))
    level = sunlit_radiance(axis, MIDDLE)
    for line in LINES_NM:
        at = _band_at(axis, line)
        if at is not None:
            yield _item("bands", f"{line:g} nm", "reference_radiance", level[at], "uW cm-2 sr-1 nm-1")


def _band_at(axis: SpectralAxis, wavelength_nm: float) -> int | None:
    """The band nearest a wavelength, None where it is further off than its width."""
    at = int(np.argmin(np.abs(axis.centre_nm - wavelength_nm)))
    return at if abs(axis.centre_nm[at] - wavelength_nm) <= axis.fwhm_nm[at] else None


def _noise(axis: SpectralAxis, noise: NoiseModel) -> Iterator[tuple[str, Measured]]:
    for region, here in summary_regions(axis).items():
        gain = np.median(noise.electrons_per_radiance[here])  # (3.13)
        yield _item("noise", region, "median_electrons_per_radiance", gain, "electrons per uW cm-2 sr-1 nm-1")
        for level in LEVELS:
            snr = noise.snr(sunlit_radiance(axis, level), calibration=False)[here]  # (3.20)
            yield _item("snr", f"reflectance {level:g}, {region}", "median_snr", np.median(snr))
        parts = noise.breakdown(sunlit_radiance(axis, MIDDLE))
        for term in _terms(parts):
            value = np.median(np.sqrt(np.abs(getattr(parts, term)[here])))
            yield _item("noise", region, f"median_noise_{term}", value, "uW cm-2 sr-1 nm-1")
        if noise.measured is None:
            wrong = replace(noise, bit_error_rate=BIT_ERROR_RATE, bit_error_per="bit")
            variance = wrong.breakdown(sunlit_radiance(axis, MIDDLE)).bit_errors  # (3.19)
            value = np.median(np.sqrt(variance[here]))
            metric = f"median_bit_error_noise_at_rate_{BIT_ERROR_RATE:g}"
            yield _item("noise", region, metric, value, "uW cm-2 sr-1 nm-1")


def _terms(parts: NoiseBreakdown) -> list[str]:
    """The terms of (3.15)-(3.19) that the sensor has; the others are zero, or what rounding leaves."""
    floor = 1e-9 * parts.total
    return [f.name for f in fields(parts) if np.any(np.abs(getattr(parts, f.name)) > floor)]


def _scenarios(sensor: Sensor, engine: Engine | None) -> Iterator[tuple[str, Measured]]:
    oxygen = _band_at(sensor.axis, LINES_NM[-1])
    for name in builtin_scenarios():
        try:
            prediction = predict(load_scenario(name), Origins(sensor=sensor, engine=engine, show_progress=False))
        except HypervalError as error:
            key = key_of("scenario", name, METHOD, "runs")
            yield key, Measured(np.nan, outcome=Outcome.SKIPPED, reason=str(error))
            continue
        for (subject, detector, unit), curve in prediction.roc.items():
            if unit == "pixel":
                pd = float(detection_at(curve, FALSE_ALARM))
                yield _item("scenario", f"{name}, {subject}, {detector}", f"pd_at_pfa_{FALSE_ALARM:g}", pd)
        white = prediction.radiance.get("white panel")
        if white is not None and oxygen is not None:
            subject = f"{name}, {LINES_NM[-1]:g} nm"
            yield _item("scenario", subject, "white_panel_radiance", white.mean[oxygen], "uW cm-2 sr-1 nm-1")
