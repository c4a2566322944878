"""Checks of the noise: against reference radiances and published ratios, its terms, saturation, its behaviour."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms, atmospheric_terms
from hyperval.atmosphere.solar import extraterrestrial_irradiance
from hyperval.scene.radiance import mean_radiance
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.operation import SensorChanges, changed_noise
from hyperval.sensor.published import PublishedSnr, ReferenceScene
from hyperval.sensor.specification import Sensor
from hyperval.sensor_check.ledger import Ledger
from hyperval.sensor_check.numbers import scaled
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.response import band_average
from hyperval.spectra.windows import SPECTRAL_REGIONS_NM, in_window

Array = npt.NDArray[np.float64]
Engine = Callable[[AtmosphericState], AtmosphericTerms]

DARK, MIDDLE, BRIGHT = 0.05, 0.25, 0.60
LEVELS = (DARK, MIDDLE, BRIGHT)
SUN_ZENITH_DEG = 45.0
_GRID_NM = np.arange(300.0, 2700.5, 1.0)


def sunlit_radiance(axis: SpectralAxis, reflectance: float) -> Array:
    """rho E0 cos(45 deg) / pi (B,) [uW cm-2 sr-1 nm-1]: a diffuse ground in the sun, no atmosphere.

    E0 is the extraterrestrial irradiance of TSIS-1 at 1 au, averaged over each band.
    """
    irradiance = band_average(_GRID_NM, extraterrestrial_irradiance("tsis-1", _GRID_NM), axis)
    return np.asarray(reflectance * irradiance * np.cos(np.radians(SUN_ZENITH_DEG)) / np.pi)


def scene_radiance(axis: SpectralAxis, scene: ReferenceScene, engine: Engine | None = None) -> Array:
    """Radiance (B,) [uW cm-2 sr-1 nm-1] of a uniform ground: the average reflectance of (3.7) is its own."""
    fixed = {"aerosol": "rural", "solar_azimuth_deg": 180.0, "earth_sun_distance_au": 1.0}
    stated = scene.model_dump(include=set(AtmosphericState.model_fields))
    terms = (engine or atmospheric_terms)(AtmosphericState.model_validate(stated | fixed)).at_bands(axis)
    return mean_radiance(terms, scene.reflectance, scene.reflectance)


def published_radiance(axis: SpectralAxis, item: PublishedSnr, engine: Engine | None = None) -> Array:
    """Radiance (B,) that a published ratio refers to; that of ground of 0.25 where it does not say."""
    if item.radiance is not None:
        return item.radiance.at(axis.centre_nm)
    if item.scene is not None:
        return scene_radiance(axis, item.scene, engine)
    return sunlit_radiance(axis, MIDDLE)


# Set before any sensor was compared: the published and the flown ratios of one instrument differ by this much.
TOLERANCE = 0.20


@dataclass(frozen=True)
class SnrPoint:
    """A published ratio and the computed one [1] at its wavelength [nm] and radiance [uW cm-2 sr-1 nm-1]."""

    wavelength_nm: float
    published: float
    computed: float
    radiance: float
    item: PublishedSnr

    @property
    def judged(self) -> bool:
        """False where the publication does not say what its figure refers to."""
        return self.item.radiance is not None or self.item.scene is not None


def check_published(
    sensor: Sensor, axis: SpectralAxis, ledger: Ledger, engine: Engine | None = None
) -> list[SnrPoint]:
    """Compare every published ratio; the points for the figure.

    Examples
    --------
    >>> from hyperval.sensor.specification import load_sensor
    >>> ledger, sensor = Ledger("landsat-7-etm"), load_sensor("landsat-7-etm")
    >>> points = check_published(sensor, sensor.axis, ledger)
    >>> [(r.subject, round(r.value, 2)) for r in ledger.table]
    [('483 nm', 0.83), ('560 nm', 1.06), ('662 nm', 1.17), ('835 nm', 1.03), ('1648 nm', 0.94), ('2206 nm', 1.03)]
    """
    points: list[SnrPoint] = []
    for item in sensor.specification.published_snr:
        level = published_radiance(axis, item, engine)
        snr = sensor.noise().snr(level, calibration=False)
        for wavelength, published in item.table:
            at = int(np.argmin(np.abs(axis.centre_nm - wavelength)))
            subject = f"{wavelength:g} nm"
            if abs(axis.centre_nm[at] - wavelength) > axis.fwhm_nm[at]:
                ledger.gate("published_snr", "computed_over_published", np.nan, False, subject=subject,
                            reason=f"no band within a width of {wavelength:g} nm")  # fmt: skip
                continue
            points.append(SnrPoint(wavelength, published, float(snr[at]), float(level[at]), item))
    for point in points:
        _row(point, ledger)
    if not sensor.specification.published_snr:
        ledger.info(
            "published_snr", "computed_over_published", reason="the file holds no published ratio to compare with"
        )
    return points


def _row(point: SnrPoint, ledger: Ledger) -> None:
    ratio, bound = point.computed / point.published, point.item.says == "at least"
    words = (
        f"computed {point.computed:.0f} at {point.radiance:.3g} uW cm-2 sr-1 nm-1, "
        f"published {'at least ' if bound else ''}{point.published:g}: {point.item.source}"
    )
    metric, subject = "computed_over_published", f"{point.wavelength_nm:g} nm"
    if not point.judged:
        words += "; it does not say at which radiance, so ground of 0.25 under the sun at 45 deg is taken"
        ledger.info("published_snr", metric, ratio, subject=subject, reason=words)
        return
    passes = ratio >= 1.0 if bound else abs(ratio - 1.0) <= TOLERANCE
    low, high = (1.0, np.nan) if bound else (1.0 - TOLERANCE, 1.0 + TOLERANCE)
    ledger.gate("published_snr", metric, ratio, passes, at_least=low, at_most=high, subject=subject,
                reason=words, remark=words)  # fmt: skip


PRODUCT = "noise"
STEP = 1.25  # by which time, aperture and C_R are raised


def check_noise(sensor: Sensor, axis: SpectralAxis, ledger: Ledger) -> None:
    """Sum of the terms, SNR at the reference radiances, quantisation, saturation, monotone behaviour.

    Examples
    --------
    >>> from hyperval.sensor.specification import load_sensor
    >>> ledger, sensor = Ledger("enmap"), load_sensor("enmap")
    >>> check_noise(sensor, sensor.axis, ledger)
    >>> sorted({r.metric for r in ledger.table if not r.metric.startswith(("lowest_", "highest_"))})
    ['median_snr', 'quantisation_over_other_noise', 'sum_of_terms_error']
    """
    noise = sensor.noise()
    middle = sunlit_radiance(axis, MIDDLE)
    parts = noise.breakdown(middle)
    off = float(np.max(np.abs(parts.total / noise.variance(middle) - 1.0)))
    ledger.gate(PRODUCT, "sum_of_terms_error", off, off <= 1e-9, at_most=1e-9, reason="the terms do not add up")
    _snr_rows(axis, noise, ledger)
    _check_quantisation(axis, noise, ledger)
    _check_saturation(axis, noise, ledger)
    _check_monotone(sensor, axis, noise, ledger)


def summary_regions(axis: SpectralAxis) -> dict[str, npt.NDArray[np.bool_]]:
    """Masks (B,) of the good bands in the windows of each spectral region the sensor sees."""
    keep = axis.good & in_window(axis.centre_nm)
    masks = {
        name: keep & (axis.centre_nm >= low) & (axis.centre_nm < high)
        for name, (low, high) in SPECTRAL_REGIONS_NM.items()
    }
    return {name: mask for name, mask in masks.items() if mask.any()}


def _snr_rows(axis: SpectralAxis, noise: NoiseModel, ledger: Ledger) -> None:
    for level in LEVELS:
        snr = noise.snr(sunlit_radiance(axis, level), calibration=False)
        for name, mask in summary_regions(axis).items():
            ledger.info(
                "snr", "median_snr", float(np.median(snr[mask])), subject=f"reflectance {level:g}, {name}",
                reason="sun at 45 deg, no atmosphere, without C_R",
            )  # fmt: skip
    good = axis.good & in_window(axis.centre_nm) if np.any(axis.good & in_window(axis.centre_nm)) else axis.good
    snr = np.where(good, noise.snr(sunlit_radiance(axis, MIDDLE)), np.inf)
    at = int(np.argmin(snr))
    ledger.gate(
        "snr", "lowest_snr", float(snr[at]), bool(snr[at] > 1.0), at_least=1.0, subject=f"reflectance {MIDDLE:g}",
        reason=f"noise passes the signal at {axis.centre_nm[at]:g} nm",
    )  # fmt: skip


def _check_quantisation(axis: SpectralAxis, noise: NoiseModel, ledger: Ledger) -> None:
    metric = "quantisation_over_other_noise"
    if noise.measured is not None:
        ledger.info(PRODUCT, metric, reason="the measured noise holds the quantisation: it is not stated apart")
        return
    parts = noise.breakdown(sunlit_radiance(axis, DARK))
    ratio = np.where(axis.good, np.sqrt(parts.quantisation / (parts.shot + parts.fixed)), 0.0)
    at = int(np.argmax(ratio))
    ledger.gate(
        PRODUCT, metric, float(ratio[at]), bool(ratio[at] < 1.0), at_most=1.0, subject=f"reflectance {DARK:g}",
        reason=f"the step of the digital word passes the noise at {axis.centre_nm[at]:g} nm: too few bits",
    )  # fmt: skip


def _check_saturation(axis: SpectralAxis, noise: NoiseModel, ledger: Ledger) -> None:
    metric = "highest_part_of_full_scale"
    if noise.full_scale is None:
        ledger.info("saturation", metric, reason="the file does not say where full scale is")
        return
    for level, gates in ((BRIGHT, True), (1.0, False)):
        part = np.where(axis.good, noise.full_scale_fraction(sunlit_radiance(axis, level)), 0.0)
        at, subject = int(np.argmax(part)), f"reflectance {level:g}"
        words = f"{int(np.count_nonzero(part >= 1))} bands saturate, most at {axis.centre_nm[at]:g} nm"
        if gates:
            ledger.gate(
                "saturation", metric, float(part[at]), bool(part[at] < 1.0), at_most=1.0, subject=subject,
                reason=words,
            )  # fmt: skip
        else:
            ledger.info("saturation", metric, float(part[at]), subject=subject, reason=words)


def _check_monotone(sensor: Sensor, axis: SpectralAxis, noise: NoiseModel, ledger: Ledger) -> None:
    level = sunlit_radiance(axis, MIDDLE)

    def snr_of(factors: dict[str, float], changes: SensorChanges) -> Array:
        if sensor.specification.measured_noise is not None:
            return changed_noise(noise, changes).snr(level)
        return Sensor(scaled(sensor.specification, factors)).noise().snr(level)

    base = noise.snr(level)
    arms = [arm.name for arm in sensor.specification.arms]
    more_light = SensorChanges.model_validate({"signal_factor": STEP})
    times = snr_of({f"{name}.integration_time_s": STEP for name in arms}, more_light)
    apertures = snr_of({f"{name}.throughput": STEP for name in arms}, more_light)
    worse = changed_noise(
        noise,
        SensorChanges.model_validate(
            {"calibration_error_percent": max(STEP * float(noise.calibration_percent.max()), 0.1)}
        ),
    ).snr(level)
    rises: dict[str, Callable[[], Array]] = {
        "radiance": lambda: _growth_with_radiance(noise, level),
        "integration time": lambda: times / base - 1.0,
        "aperture": lambda: apertures / base - 1.0,
        "less C_R": lambda: base / worse - 1.0,
    }
    for name, growth in rises.items():
        values = np.where(axis.good, growth(), np.inf)
        at = int(np.argmin(values))
        ledger.gate(
            "monotone", "lowest_relative_growth_of_snr", float(values[at]), bool(values[at] > 0.0), at_least=0.0,
            subject=name, reason=f"the SNR does not rise with {name} at {axis.centre_nm[at]:g} nm",
        )  # fmt: skip


def _growth_with_radiance(noise: NoiseModel, level: Array) -> Array:
    """Smallest relative step (B,) of the SNR between radiances from 1/1000 of the level to four times of it."""
    factors = np.geomspace(1e-3, 4.0, 25)
    with np.errstate(all="ignore"):
        snr = np.stack([noise.snr(f * level, calibration=False) for f in factors])
        return np.asarray(np.min(np.diff(snr, axis=0) / snr[:-1], axis=0))
