"""The acceptance suite: every check of a sensor file, in the order in which they build on each other.

The rows of one acceptance: gates, information, what was left out, and known discrepancies.

The numbers of a sensor file: each with its source, and the file with some of them scaled.

Checks of the noise: against reference radiances and published ratios, its terms, saturation, its behaviour.

Checks of bands (order, widths, gaps, responses as applied) and of what makes electrons of light.

The standard scenarios run through the forward model with the sensor that is checked.

How much each assumed number moves the SNR and the probability of detection.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import constants

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms, atmospheric_terms
from hyperval.atmosphere.solar import extraterrestrial_irradiance
from hyperval.errors import HypervalError, UsageError
from hyperval.predict import Origins, predict
from hyperval.processing.roc_model import detection_at
from hyperval.products import PredictedProducts
from hyperval.progress import track
from hyperval.results import Cause, Outcome, Result, ResultTable, Role
from hyperval.scenario import Scenario, builtin_scenarios, load_scenario
from hyperval.scene.builtin import builtin_mean
from hyperval.scene.radiance import mean_radiance
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.specification import (
    Arm,
    Bands,
    KnownDiscrepancy,
    PublishedSnr,
    Quantity,
    ReferenceScene,
    Sensor,
    SensorChanges,
    SensorSpecification,
    Throughput,
    changed_noise,
    load_sensor,
)
from hyperval.settings import with_settings
from hyperval.spectra.axis import CUT_SIGMA, SIGMA_PER_FWHM, SPECTRAL_REGIONS_NM, SpectralAxis, band_average, in_window

METHOD = "sensor check"


class Ledger:
    """Collects the rows of one sensor; a check that the file lists as a known discrepancy informs when it fails."""

    def __init__(self, sensor: str, known: Sequence[KnownDiscrepancy] = ()):
        self.table = ResultTable()
        self._campaign = f"sensor {sensor}"
        self._known = {item.check: item.reason for item in known}
        self._used: set[str] = set()

    def gate(
        self,
        product: str,
        metric: str,
        value: float,
        passes: bool,
        *,
        at_least: float = math.nan,
        at_most: float = math.nan,
        unit: str = "1",
        subject: str = "",
        n: int | None = None,
        reason: str = "",
        remark: str = "",
    ) -> bool:
        """One check; returns whether it passed.

        ``reason`` says what is wrong and is kept when it fails; ``remark`` stands in its place when it passes.
        """
        outcome, role = (Outcome.AGREES if passes else Outcome.DISAGREES), Role.GATE
        text = remark if passes else reason
        known = next((k for k in (f"{product}/{metric}/{subject}", f"{product}/{metric}") if k in self._known), None)
        if not passes and known is not None:
            self._used.add(known)
            role, text = Role.INFORM, f"as known: {self._known[known]} ({reason})"
        self.table.add(
            Result(
                self._campaign, product, subject, METHOD, metric, float(value), unit, n=n,
                limit_low=float(at_least), limit_high=float(at_most), role=role, outcome=outcome, reason=text,
            )
        )  # fmt: skip
        return passes

    def info(
        self,
        product: str,
        metric: str,
        value: float = math.nan,
        *,
        unit: str = "1",
        subject: str = "",
        reason: str = "",
    ) -> None:
        """A figure that decides nothing."""
        self.table.add(Result(self._campaign, product, subject, METHOD, metric, float(value), unit, reason=reason))

    def skipped(self, product: str, metric: str, reason: str) -> None:
        """A check that could not be made because another failed."""
        self._without_value(product, metric, Outcome.SKIPPED, Cause.AFTER_FAILURE, reason)

    def error(self, product: str, metric: str, reason: str) -> None:
        """A check that ended in an error."""
        self._without_value(product, metric, Outcome.ERROR, Cause.BROKEN, reason)

    def close(self) -> None:
        """A known discrepancy that no check shows any more fails: the file says something that is not so."""
        for check in self._known:
            if check not in self._used:
                self.gate(
                    "file", "known_discrepancy", 0.0, False, at_least=1.0, subject=check,
                    reason="stands in known_discrepancies, but no check of that name fails: take it out",
                )  # fmt: skip

    def failed(self) -> bool:
        """True when a check failed or ended in an error so far."""
        return any(row.gates and row.outcome in (Outcome.DISAGREES, Outcome.ERROR) for row in self.table)

    def _without_value(self, product: str, metric: str, outcome: Outcome, cause: Cause, reason: str) -> None:
        row = Result(self._campaign, product, "", METHOD, metric, role=Role.GATE)
        self.table.add(replace(row, outcome=outcome, cause=cause, reason=reason))


ARM_QUANTITIES = (
    "optical_transmittance", "quantum_efficiency", "degradation", "integration_time_s", "fixed_noise_electrons",
    "full_well_electrons", "saturation_radiance", "lsb_electrons", "bit_error_rate",
)  # fmt: skip


@dataclass(frozen=True)
class Number:
    """One number of the file: dotted name, its value in words, where it is from."""

    name: str
    value: str
    source: str
    varies: bool = True

    @property
    def assumed(self) -> bool:
        """True when the source says that all or part of it is an assumption."""
        return "assumed" in self.source.lower()


def numbers(spec: SensorSpecification) -> list[Number]:
    """Every number of the file in the order of the file; ``varies`` is False for those that cannot be scaled."""
    out = [Number("bands.fwhm", _bands_text(spec.bands), spec.bands.source)]
    for arm in spec.arms:
        out.append(Number(f"{arm.name}.throughput", _throughput_text(arm.throughput), arm.throughput.source))
        for name in ARM_QUANTITIES:
            quantity: Quantity | None = getattr(arm, name)
            if quantity is not None:
                text, source = _quantity_text(quantity), quantity.source
                out.append(Number(f"{arm.name}.{name}", text, source, varies=quantity.value != 0.0))
        bits = arm.bits_source or "not stated"
        out.append(Number(f"{arm.name}.bits", str(arm.bits), bits, varies=False))
    if spec.measured_noise is not None:
        rows = f"{len(spec.measured_noise.table)} rows of a, b, c"
        out.append(Number("measured_noise", rows, spec.measured_noise.source, varies=False))
        if spec.measured_noise.saturation_radiance is not None:
            full = spec.measured_noise.saturation_radiance
            out.append(Number("measured_noise.saturation_radiance", _quantity_text(full), full.source, varies=False))
    if spec.psf is not None:
        along, across = spec.psf.fwhm
        out.append(Number("psf", f"{along:.3g}, {across:.3g} pixels", spec.psf.source, varies=False))
    quantity = spec.calibration_error_percent
    out.append(
        Number("calibration_error_percent", _quantity_text(quantity), quantity.source, varies=quantity.value != 0.0)
    )
    return out


def scaled(spec: SensorSpecification, factors: Mapping[str, float]) -> SensorSpecification:
    """The file with some of its numbers, named as :func:`numbers` names them, multiplied.

    Raises
    ------
    UsageError : a name that the file does not have.
    """
    known = {n.name for n in numbers(spec) if n.varies}
    if unknown := sorted(set(factors) - known):
        raise UsageError(f"no number {unknown[0]!r}", expected="one of " + ", ".join(sorted(known)))
    changes: dict[str, Any] = {}
    for name, factor in factors.items():
        changes |= _moved(spec, name, factor)
    return with_settings(spec, changes) if changes else spec


def _moved(spec: SensorSpecification, name: str, factor: float) -> dict[str, Any]:
    """Dotted path -> value, of a number times a factor; each entry of a table is multiplied."""
    if name == "bands.fwhm":
        bands = spec.bands
        if bands.table is not None:
            return {"bands.table": [(w, factor * f, good) for w, f, good in bands.table]}
        if bands.parts is not None:
            return {f"bands.parts.{i}.fwhm_nm": factor * p.fwhm_nm for i, p in enumerate(bands.parts)}
        assert bands.regular is not None  # noqa: S101 - the validator has seen to it
        return {"bands.regular.fwhm_nm": factor * bands.regular.fwhm_nm}
    of_arm, _, key = name.rpartition(".")
    path = f"arms.[{of_arm}].{key}" if of_arm else key
    holder = next(a for a in spec.arms if a.name == of_arm) if of_arm else spec
    if key == "throughput":
        old: Throughput = getattr(holder, key)
        return {path: {"convention": "value", "cm2_sr": factor * old.value_cm2_sr, "source": old.source}}
    quantity: Quantity = getattr(holder, key)
    if quantity.table is None:
        return {path: {"value": factor * float(quantity.value or 0.0), "source": quantity.source}}
    return {path: {"table": [(w, factor * v) for w, v in quantity.table], "source": quantity.source}}


def _quantity_text(quantity: Quantity) -> str:
    if quantity.table is None:
        return f"{quantity.value:g}"
    values = [v for _, v in quantity.table]
    return f"{min(values):g} to {max(values):g} over {quantity.table[0][0]:g}-{quantity.table[-1][0]:g} nm"


def _throughput_text(throughput: Throughput) -> str:
    return f"{throughput.value_cm2_sr:.3g} cm2 sr ({throughput.convention})"


def _bands_text(bands: Bands) -> str:
    widths = bands.fwhms
    return f"{min(widths):.3g} to {max(widths):.3g} nm" if min(widths) != max(widths) else f"{widths[0]:g} nm"


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


def check_published(sensor: Sensor, axis: SpectralAxis, ledger: Ledger, engine: Engine | None = None) -> list[SnrPoint]:
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


NOISE = "noise"
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
    ledger.gate(NOISE, "sum_of_terms_error", off, off <= 1e-9, at_most=1e-9, reason="the terms do not add up")
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
        ledger.info(NOISE, metric, reason="the measured noise holds the quantisation: it is not stated apart")
        return
    parts = noise.breakdown(sunlit_radiance(axis, DARK))
    ratio = np.where(axis.good, np.sqrt(parts.quantisation / (parts.shot + parts.fixed)), 0.0)
    at = int(np.argmax(ratio))
    ledger.gate(
        NOISE, metric, float(ratio[at]), bool(ratio[at] < 1.0), at_most=1.0, subject=f"reflectance {DARK:g}",
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


RESPONSE = "response"
# A Gaussian of half the spacing leaves parts between bands unseen; sigma in place of FWHM divides by 2.35.
NARROWEST, WIDEST = 0.6, 2.0
# Between two bands at most this many FWHM lie outside both half-maximum points: a lacking band leaves about 1.
WIDEST_GAP = 0.75
RESPONSE_TOLERANCE = 1e-6
WIDTH_TOLERANCE = 0.01


def check_bands(sensor: Sensor, ledger: Ledger) -> SpectralAxis | None:
    """All checks of the bands; None where they are in no order that anything else could be checked in.

    Examples
    --------
    >>> from hyperval.sensor.specification import load_sensor
    >>> ledger = Ledger("enmap")
    >>> axis = check_bands(load_sensor("enmap"), ledger)
    >>> [(r.metric, round(r.value, 2)) for r in ledger.table if np.isfinite(r.value)]
    [('bands_out_of_order', 0.0), ('bands', 235.0), ('first_band', 420.0), ('last_band', 2448.5),
    ('fwhm_over_spacing_median', 1.25), ('widest_gap_fwhm', -0.03), ('integral_error', 0.0),
    ('centroid_error_fwhm', 0.0), ('width_error', 0.0)]
    """
    bands = sensor.specification.bands
    if bands.table is not None:
        rows = np.array(bands.table, dtype=float)
        wrong = int(np.count_nonzero(np.diff(rows[:, 0]) <= 0))
        narrow = int(np.count_nonzero(rows[:, 1] <= 0))
    else:
        wrong = narrow = 0
    try:
        axis = sensor.axis
    except UsageError as error:
        ledger.gate(RESPONSE, "bands_out_of_order", max(wrong, 1), False, at_most=0.0, reason=error.what)
        if narrow:
            ledger.gate(RESPONSE, "bands_without_width", narrow, False, at_most=0.0, reason=error.what)
        return None
    ledger.gate(RESPONSE, "bands_out_of_order", 0.0, True, at_most=0.0)
    _check_widths(sensor, axis, ledger)
    _check_response(axis, ledger)
    return axis


def neighbour_ratio(axis: SpectralAxis) -> Array:
    """Mean FWHM of two neighbouring bands over their spacing (B - 1,) [1]."""
    return np.asarray(0.5 * (axis.fwhm_nm[:-1] + axis.fwhm_nm[1:]) / np.diff(axis.centre_nm))


def unseen_widths(axis: SpectralAxis) -> Array:
    """What lies between the half-maximum points of neighbouring bands, in their mean FWHM (B - 1,) [1]."""
    return np.asarray(1.0 / neighbour_ratio(axis) - 1.0)


def applied_moments(axis: SpectralAxis) -> tuple[Array, Array, Array]:
    """Integral [1], centroid - centre [nm] and FWHM [nm] of each response as the resampling applies it, (B,) each.

    The second moment of a Gaussian cut at k sigma is sigma^2 (1 - 2 k phi(k) / (2 Phi(k) - 1)).

    Examples
    --------
    >>> axis = SpectralAxis(np.array([500.0, 510.0]), 10.0)
    >>> [[round(float(x), 2) for x in part] for part in applied_moments(axis)]
    [[1.0, 1.0], [0.0, 0.0], [10.0, 10.0]]
    """
    from scipy.stats import norm

    area, centroid, width = np.empty((3, len(axis)))
    for i, (centre, fwhm) in enumerate(zip(axis.centre_nm, axis.fwhm_nm, strict=True)):
        offset = np.linspace(-4.0 * fwhm, 4.0 * fwhm, 1601)
        one = SpectralAxis(np.array([centre]), np.array([fwhm]))
        stack = np.stack([np.ones_like(offset), offset, offset**2])
        area[i], centroid[i], second = band_average(centre + offset, stack, one)[:, 0]
        cut = 1.0 - 2.0 * CUT_SIGMA * norm.pdf(CUT_SIGMA) / (2.0 * norm.cdf(CUT_SIGMA) - 1.0)
        width[i] = np.sqrt((second - centroid[i] ** 2) / cut) / SIGMA_PER_FWHM
    return area, centroid, width


def _check_widths(sensor: Sensor, axis: SpectralAxis, ledger: Ledger) -> None:
    bands = sensor.specification.bands
    ledger.info(RESPONSE, "bands", len(axis), reason=f"{int(axis.good.sum())} of them good")
    ledger.info(RESPONSE, "first_band", axis.centre_nm[0], unit="nm")
    ledger.info(RESPONSE, "last_band", axis.centre_nm[-1], unit="nm")
    if len(axis) < 2:
        return
    middle = 0.5 * (axis.centre_nm[:-1] + axis.centre_nm[1:])
    counts = np.ones(middle.size, bool)
    for gap in bands.gaps:
        counts &= ~((middle >= gap.range_nm[0]) & (middle <= gap.range_nm[1]))
    if bands.spacing == "separate" or not counts.any():
        ledger.info(RESPONSE, "fwhm_over_spacing_median", float(np.median(neighbour_ratio(axis))),
                    reason="the bands of this sensor stand apart")  # fmt: skip
        return
    ratio = float(np.median(neighbour_ratio(axis)[counts]))
    ledger.gate(
        RESPONSE, "fwhm_over_spacing_median", ratio, NARROWEST <= ratio <= WIDEST,
        at_least=NARROWEST, at_most=WIDEST,
        reason=f"outside {NARROWEST:g} to {WIDEST:g}: is sigma given for FWHM, half widths for full, or nm for um?",
    )  # fmt: skip
    unseen = np.where(counts, unseen_widths(axis), -np.inf)
    at = int(np.argmax(unseen))
    ledger.gate(
        RESPONSE, "widest_gap_fwhm", float(unseen[at]), unseen[at] <= WIDEST_GAP, at_most=WIDEST_GAP,
        unit="FWHM",
        reason=f"between {axis.centre_nm[at]:g} and {axis.centre_nm[at + 1]:g} nm: a band lacks, or the gap is "
        "to be stated in bands: gaps",
    )  # fmt: skip


def _check_response(axis: SpectralAxis, ledger: Ledger) -> None:
    area, centroid, width = applied_moments(axis)
    for metric, values, limit, unit, words in (
        ("integral_error", np.abs(area - 1.0), RESPONSE_TOLERANCE, "1", "the responses are not normalised"),
        ("centroid_error_fwhm", np.abs(centroid) / axis.fwhm_nm, WIDTH_TOLERANCE, "FWHM", "responses are shifted"),
        ("width_error", np.abs(width / axis.fwhm_nm - 1.0), WIDTH_TOLERANCE, "1",
         "the width of a response is not the FWHM of its band (sigma taken for FWHM?)"),
    ):  # fmt: skip
        at = int(np.argmax(values))
        ledger.gate(
            RESPONSE, metric, float(values[at]), bool(values[at] <= limit), at_most=limit, unit=unit,
            reason=f"{words}; worst at {axis.centre_nm[at]:g} nm",
        )  # fmt: skip


GAIN_TOLERANCE = 0.005
# Quantity -> (largest plausible value, may it be zero)
_LIMITS = {
    "optical_transmittance": (1.0, False),
    "quantum_efficiency": (1.0, False),
    "degradation": (1.0, False),
    "integration_time_s": (100.0, False),
    "fixed_noise_electrons": (1e9, True),
}


def check_throughput(sensor: Sensor, axis: SpectralAxis, ledger: Ledger) -> bool:
    """All checks of the throughput; False where the noise cannot be evaluated.

    Examples
    --------
    >>> from hyperval.sensor.specification import load_sensor
    >>> ledger, sensor = Ledger("enmap"), load_sensor("enmap")
    >>> sound = check_throughput(sensor, sensor.axis, ledger)
    >>> sorted({r.metric for r in ledger.table if not r.metric.startswith(("lowest_", "highest_"))})
    ['bands_beyond_table_of_quantum_efficiency', 'bands_of_arm', 'bands_outside_arms',
    'gain_error_by_photon_energy', 'gain_error_by_photon_transfer']
    """
    spec = sensor.specification
    sound = True
    if spec.arms:
        outside = _outside_arms(sensor, axis)
        inside = ledger.gate(
            "throughput", "bands_outside_arms", outside.size, outside.size == 0, at_most=0.0,
            reason="bands beyond the range_nm of every arm: " + ", ".join(f"{w:g} nm" for w in outside[:5]),
        )  # fmt: skip
        if not inside:
            return False
        index = sensor.arm_index(axis.centre_nm)
        for k, arm in enumerate(spec.arms):
            sound &= _check_arm(arm, axis.select(index == k), ledger) if np.any(index == k) else _empty(arm, ledger)
    if not sound:
        return False
    with np.errstate(all="ignore"):
        noise = sensor.noise()
    g = noise.electrons_per_radiance
    lowest = float(np.min(g))
    positive = bool(np.all(np.isfinite(g)) and lowest > 0)
    ledger.gate(
        "throughput", "lowest_electrons_per_radiance", lowest, positive, at_least=0.0,
        unit="electrons per uW cm-2 sr-1 nm-1", reason="no light reaches the detector in some band",
    )  # fmt: skip
    if not positive:
        return False
    if spec.arms:
        _check_gain(sensor, axis, noise, ledger)
    _check_photon_transfer(axis, noise, ledger)
    return True


def electrons_from_energy(arm: Arm, axis: SpectralAxis) -> Array:
    """Electrons per unit of radiance (B,) by the energy that is collected over that of a photon, in SI units.

    1 uW cm-2 sr-1 nm-1 is 1e-2 W m-2 sr-1 nm-1; A Omega is in m2 sr.
    """
    w, throughput = axis.centre_nm, arm.throughput.value_cm2_sr * 1e-4
    collected_w = 1e-2 * throughput * axis.fwhm_nm * arm.optical_transmittance.at(w) * arm.degradation.at(w)
    photon_j = constants.h * constants.c / (w * 1e-9)
    return np.asarray(collected_w * arm.integration_time_s.at(w) * arm.quantum_efficiency.at(w) / photon_j)


def electrons_from_noise(noise: NoiseModel, level: Array, other: Array) -> Array:
    """Electrons per unit of radiance (B,) by photon transfer: the inverse slope of noise variance over radiance."""
    change = noise.variance(other, calibration=False) - noise.variance(level, calibration=False)
    return np.asarray((other - level) / change)


def _empty(arm: Arm, ledger: Ledger) -> bool:
    return ledger.gate("throughput", "bands_of_arm", 0.0, False, at_least=1.0, subject=arm.name, reason="holds no band")


def _check_arm(arm: Arm, axis: SpectralAxis, ledger: Ledger) -> bool:
    ledger.gate("throughput", "bands_of_arm", len(axis), True, at_least=1.0, subject=arm.name)
    sound = True
    w = axis.centre_nm
    for name, (most, zero) in _LIMITS.items():
        quantity: Quantity = getattr(arm, name)
        values = quantity.at(w)
        low, high = float(values.min()), float(values.max())
        positive = low > 0 or (zero and low == 0)
        sound &= ledger.gate(
            "throughput", f"lowest_{name}", low, positive, at_least=0.0, subject=arm.name,
            reason=f"{name} of arm {arm.name} is not positive at {w[int(np.argmin(values))]:g} nm",
        )  # fmt: skip
        ledger.gate(
            "throughput", f"highest_{name}", high, high <= most, at_most=most, subject=arm.name,
            reason=f"{name} of arm {arm.name} passes {most:g} (per cent in place of a fraction, ms in place of s?)",
        )  # fmt: skip
        if quantity.table is not None:
            ends = quantity.table[0][0], quantity.table[-1][0]
            beyond = int(np.count_nonzero((w < ends[0] - axis.fwhm_nm) | (w > ends[1] + axis.fwhm_nm)))
            ledger.gate(
                "throughput", f"bands_beyond_table_of_{name}", beyond, beyond == 0, at_most=0.0, subject=arm.name,
                reason=f"the table reaches from {ends[0]:g} to {ends[1]:g} nm and its end value is carried on",
            )  # fmt: skip
    return sound


def _outside_arms(sensor: Sensor, axis: SpectralAxis) -> Array:
    half = 0.5 * axis.fwhm_nm
    inside = np.zeros(len(axis), bool)
    for arm in sensor.specification.arms:
        inside |= (axis.centre_nm >= arm.range_nm[0] - half) & (axis.centre_nm <= arm.range_nm[1] + half)
    return axis.centre_nm[~inside]


def _check_gain(sensor: Sensor, axis: SpectralAxis, noise: NoiseModel, ledger: Ledger) -> None:
    index = sensor.arm_index(axis.centre_nm)
    expected = np.empty(len(axis))
    for k, arm in enumerate(sensor.specification.arms):
        expected[index == k] = electrons_from_energy(arm, axis.select(index == k))
    off = np.abs(noise.electrons_per_radiance / expected - 1.0)
    at = int(np.argmax(off))
    ledger.gate(
        "throughput", "gain_error_by_photon_energy", float(off[at]), bool(off[at] <= GAIN_TOLERANCE),
        at_most=GAIN_TOLERANCE,
        reason=f"electrons per radiance differ from energy over photon energy, most at {axis.centre_nm[at]:g} nm",
    )  # fmt: skip


def _check_photon_transfer(axis: SpectralAxis, noise: NoiseModel, ledger: Ledger) -> None:
    level, other = sunlit_radiance(axis, DARK), sunlit_radiance(axis, BRIGHT)
    with np.errstate(all="ignore"):
        off = electrons_from_noise(noise, level, other) * noise.readings / noise.electrons_per_radiance - 1.0
    # A measured fit with c != 0 is not linear in the radiance: it says nothing of the gain.
    linear = axis.good if noise.measured is None else axis.good & (noise.measured[2] == 0.0)
    if not linear.any():
        ledger.info(
            "throughput", "gain_error_by_photon_transfer", reason="no band has a fit that is linear in the signal"
        )
        return
    median = float(np.median(off[linear]))
    ledger.gate(
        "throughput", "gain_error_by_photon_transfer", median, abs(median) <= GAIN_TOLERANCE,
        at_least=-GAIN_TOLERANCE, at_most=GAIN_TOLERANCE,
        n=int(linear.sum()),
        reason="noise grows with the signal as if the gain were another: is detector_gain meant?",
    )  # fmt: skip


SCENARIO = "scenario"
FALSE_ALARM = 1e-3
# The model's empirical line inverts a linear equation: what is left is rounding.
REFLECTANCE_TOLERANCE = 1e-6


@lru_cache(maxsize=8)
def standard_scenario(name: str) -> Scenario:
    """A built-in scenario, read once."""
    return load_scenario(name)


def run_scenarios(sensor: Sensor, ledger: Ledger, engine: Engine | None = None) -> dict[str, PredictedProducts]:
    """Predict every built-in scenario with ``sensor`` and check what comes out."""
    done: dict[str, PredictedProducts] = {}
    for name in builtin_scenarios():
        scenario = standard_scenario(name)
        try:
            done[name] = predict(scenario, Origins(engine=engine, sensor=sensor, show_progress=False))
        except HypervalError as error:
            ledger.error(SCENARIO, "runs", f"{name}: {error}")
            continue
        _check(scenario, done[name], sensor, ledger)
    return done


def _check(scenario: Scenario, prediction: PredictedProducts, sensor: Sensor, ledger: Ledger) -> None:
    good = prediction.axis.good & in_window(prediction.axis.centre_nm)
    name = scenario.name
    wrong = sum(
        int(np.count_nonzero(~(np.isfinite(e.mean[good]) & (e.mean[good] > 0))))
        for group in (prediction.radiance, prediction.snr)
        for e in group.values()
    )
    ledger.gate(SCENARIO, "values_not_positive", wrong, wrong == 0, at_most=0.0, subject=name,
                reason="radiances or ratios that are not positive in the windows")  # fmt: skip
    c_r = sensor.noise(prediction.axis).calibration_percent / 100.0
    highest = max(float(np.max(e.mean * c_r)) for s, e in prediction.snr.items() if s in prediction.radiance)
    ledger.gate(SCENARIO, "highest_snr_over_cap_of_c_r", highest, highest <= 1.0 + 1e-9, at_most=1.0, subject=name,
                reason="the SNR passes 100 / C_R")  # fmt: skip
    error = _panel_error(scenario, prediction, good)
    ledger.gate(SCENARIO, "panel_reflectance_error", error, error <= REFLECTANCE_TOLERANCE,
                at_most=REFLECTANCE_TOLERANCE, subject=name,
                reason="the empirical line does not give back the panels")  # fmt: skip
    parts = [float(np.max(np.where(prediction.axis.good, p, 0.0))) for p in prediction.full_scale.values()]
    if parts and np.all(np.isfinite(parts)):
        most = max(parts)
        ledger.gate(SCENARIO, "highest_part_of_full_scale", most, most < 1.0, at_most=1.0, subject=name,
                    reason="a surface of the scene saturates")  # fmt: skip
    for (subject, detector, unit), curve in prediction.roc.items():
        if unit != "pixel":
            continue
        step = float(np.min(np.diff(curve.pd)))
        sound = step >= 0.0 and bool(np.all((curve.pd >= 0) & (curve.pd <= 1)))
        what = f"{name}, {subject} {detector}"
        ledger.gate(SCENARIO, "lowest_step_of_roc", step, sound, at_least=0.0, subject=what,
                    reason="the ROC falls or leaves 0 to 1")  # fmt: skip
        ledger.info(SCENARIO, f"pd_at_pfa_{FALSE_ALARM:g}", float(detection_at(curve, FALSE_ALARM)), subject=what)


def _panel_error(scenario: Scenario, products: PredictedProducts, good: npt.NDArray[np.bool_]) -> float:
    worst = 0.0
    for panel in scenario.scene.panels:
        if panel.spectrum.builtin is not None and panel.name in products.reflectance:
            truth = builtin_mean(panel.spectrum.builtin, products.axis)
            worst = max(worst, float(np.max(np.abs(products.reflectance[panel.name].mean - truth)[good], initial=0.0)))
    return worst


SENSITIVITY = "sensitivity"


@dataclass(frozen=True)
class Swing:
    """What a number does when it is lowered and raised.

    Attributes
    ----------
    number : of the file
    snr : relative change of the SNR, lowered and raised: of the band it moves most [1]
    detection : change of P_D, lowered and raised [1]
    """

    number: Number
    snr: tuple[float, float]
    detection: tuple[float, float]


@dataclass(frozen=True)
class Probe:
    """The detection whose P_D is watched: the one of the scenarios nearest 0.5, which moves most."""

    scenario: str
    key: tuple[str, str, str]
    value: float


def telling_probe(predictions: Mapping[str, PredictedProducts]) -> Probe | None:
    """The subject and detector whose P_D lies nearest 0.5; None where nothing is detected."""
    probes = [
        Probe(name, key, float(detection_at(curve, FALSE_ALARM)))
        for name, prediction in predictions.items()
        for key, curve in prediction.roc.items()
        if key[2] == "pixel"
    ]
    return min(probes, key=lambda p: abs(p.value - 0.5), default=None)


def sensitivities(
    sensor: Sensor,
    predictions: Mapping[str, PredictedProducts],
    ledger: Ledger,
    *,
    vary: float = 0.2,
    engine: Engine | None = None,
    show_progress: bool | None = None,
) -> tuple[list[Swing], Probe | None]:
    """Lower and raise each assumed number by the part ``vary``; the swings, largest of the SNR first."""
    assumed = [n for n in numbers(sensor.specification) if n.assumed and n.varies]
    probe = telling_probe(predictions)
    scenario = standard_scenario(probe.scenario) if probe is not None else None
    swings = []
    for number in track(assumed, "assumed numbers", show=show_progress):
        sides = []
        for factor in (1.0 - vary, 1.0 + vary):
            other = Sensor(scaled(sensor.specification, {number.name: factor}))
            sides.append((_snr_change(sensor, other), _detection_change(other, scenario, probe, engine)))
        (low, low_pd), (high, high_pd) = sides
        swings.append(Swing(number, (low, high), (low_pd, high_pd)))
    swings.sort(key=lambda s: -max(abs(v) for v in s.snr))
    for swing in swings:
        for sign, snr, detection in zip("-+", swing.snr, swing.detection, strict=True):
            subject = f"{swing.number.name} {sign}{100 * vary:g} %"
            ledger.info(SENSITIVITY, "relative_change_of_snr", snr, subject=subject, reason=swing.number.source)
            if probe is not None:
                words = f"{probe.key[0]} by {probe.key[1]} at P_FA 0.001, where P_D is {probe.value:.3f}"
                ledger.info(SENSITIVITY, "change_of_pd", detection, subject=subject, reason=words)
    return swings, probe


def _snr_change(sensor: Sensor, other: Sensor) -> float:
    """Relative change of the SNR with C_R at ground of 0.25, in the good band of the windows it moves most."""
    axis = sensor.axis
    use = axis.good & in_window(axis.centre_nm)
    use = use if use.any() else axis.good
    level = sunlit_radiance(axis, MIDDLE)
    change = (other.noise().snr(level) / sensor.noise().snr(level) - 1.0)[use]
    return float(change[int(np.argmax(np.abs(change)))])


def _detection_change(other: Sensor, scenario: Scenario | None, probe: Probe | None, engine: Engine | None) -> float:
    if probe is None or scenario is None:
        return 0.0
    prediction = predict(scenario, Origins(sensor=other, engine=engine, show_progress=False))
    return float(detection_at(prediction.roc[probe.key], FALSE_ALARM)) - probe.value


@dataclass(frozen=True)
class SensorCheck:
    """What the suite found of one sensor.

    Attributes
    ----------
    sensor, table : the sensor, and one row for every check
    points : published ratios with the computed ones
    predictions : scenario -> products with this sensor
    swings, probe, vary : effect of the assumed numbers, the detection watched, and the part they are varied by
    usable : False where bands or throughput are so wrong that nothing else was computed
    """

    sensor: Sensor
    table: ResultTable
    points: list[SnrPoint] = field(default_factory=list)
    predictions: Mapping[str, PredictedProducts] = field(default_factory=dict)
    swings: list[Swing] = field(default_factory=list)
    probe: Probe | None = None
    vary: float = 0.2
    usable: bool = True

    @property
    def exit_code(self) -> int:
        """Exit code of the contract."""
        return self.table.exit_code()


def check_sensor(
    sensor: Sensor | str | Path,
    *,
    vary: float = 0.2,
    engine: Engine | None = None,
    show_progress: bool | None = None,
) -> SensorCheck:
    """Run the acceptance suite on a sensor of the library, a sensor file, or a sensor.

    Parameters
    ----------
    sensor : name, path, or the sensor itself
    vary : part by which each assumed number is lowered and raised [1]
    engine : stands in for the atmosphere engine

    Raises
    ------
    UsageError : no such sensor, or a file that is not valid or still has values to be filled in.
    InputError : no such file.
    """
    spec = sensor if isinstance(sensor, Sensor) else load_sensor(sensor)
    ledger = Ledger(spec.name, spec.specification.known_discrepancies)
    axis = check_bands(spec, ledger)
    usable = axis is not None and check_throughput(spec, axis, ledger)
    if axis is None or not usable:
        if axis is None:
            ledger.skipped("throughput", "sensor_check", "the bands are in no order")
        for product in ("noise", "saturation", "monotone", "published_snr", "scenario", "sensitivity"):
            ledger.skipped(product, "sensor_check", "bands or throughput fail: nothing can be computed from them")
        return SensorCheck(spec, ledger.table, vary=vary, usable=False)
    check_noise(spec, axis, ledger)
    points = check_published(spec, axis, ledger, engine)
    predictions = run_scenarios(spec, ledger, engine)
    swings, probe = sensitivities(spec, predictions, ledger, vary=vary, engine=engine, show_progress=show_progress)
    ledger.close()
    return SensorCheck(spec, ledger.table, points, predictions, swings, probe, vary)
