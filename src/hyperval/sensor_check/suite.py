"""The acceptance of a sensor file: CHECKS, a table of measured values with accepted ranges, and the loop over it."""

from __future__ import annotations

import math
import operator
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import constants

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms, atmospheric_terms
from hyperval.atmosphere.solar import extraterrestrial_irradiance
from hyperval.compare import regions
from hyperval.config import UNITS
from hyperval.data import Array, Mask
from hyperval.errors import HypervalError, UsageError
from hyperval.model import Origins, predict
from hyperval.model.radiance import mean_radiance
from hyperval.model.roc import detection_at
from hyperval.products import PredictedProducts, RocCurve
from hyperval.progress import track
from hyperval.results import Cause, Outcome, Result, ResultTable, Role
from hyperval.scenario import builtin_scenarios, load_scenario
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.specification import (
    Arm,
    PublishedSnr,
    ReferenceScene,
    Sensor,
    SensorChanges,
    SensorSpecification,
    changed_noise,
    load_sensor,
)
from hyperval.spectra.axis import CUT_SIGMA, SIGMA_PER_FWHM, SPECTRAL_REGIONS_NM, SpectralAxis, band_average
from hyperval.statistics_library import builtin_mean

METHOD = "sensor check"
Engine = Callable[[AtmosphericState], AtmosphericTerms]

DARK, MIDDLE, BRIGHT = 0.05, 0.25, 0.60
LEVELS = (DARK, MIDDLE, BRIGHT)
SUN_ZENITH_DEG = 45.0
FALSE_ALARM = 1e-3
_GRID_NM = np.arange(300.0, 2700.5, 1.0)
STEP = 1.25  # by which time, aperture and C_R are raised


_ENDINGS = UNITS | {"_radiance": "uW cm-2 sr-1 nm-1"}
_NO_NUMBERS = ("source", "schema_version", "notes", "title", "name")


@dataclass(frozen=True)
class SensorNumber:
    """A number of a sensor file: its dotted name, its value in words, its unit, and the source that the file states."""

    name: str
    value: str
    unit: str
    source: str

    @property
    def is_assumed(self) -> bool:
        """True when the source says that all or part of it is an assumption."""
        return "assumed" in self.source.lower()


def numbers(specification: SensorSpecification) -> list[SensorNumber]:
    """Every number of the file in the order of the file; those of a part have its source.

    >>> from hyperval.sensor.specification import load_sensor
    >>> lacking = (n for n in numbers(load_sensor("casi-1500").specification) if n.source.endswith("not state it"))
    >>> [n.name.removeprefix("VNIR.") for n in lacking]
    ['bands.spacing', 'throughput.obscuration', 'degradation', 'bit_error_rate', 'detector_gain']
    """
    used, stated = (specification.model_dump(mode="json", exclude_none=True, exclude_unset=u) for u in (False, True))
    return list(_numbers(used, stated, "", ""))


def _numbers(data: dict[str, Any], stated: dict[str, Any], prefix: str, source: str) -> Iterator[SensorNumber]:
    source = data.get("source", source)
    for name, value in data.items():
        if name in _NO_NUMBERS or name.endswith("_source"):
            continue
        if isinstance(value, dict):
            yield from _numbers(value, stated.get(name, {}), f"{prefix}{name}.", source)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for number, (item, entry) in enumerate(zip(value, stated.get(name, value), strict=True), 1):
                yield from _numbers(item, entry, f"{item.get('name', f'{prefix}{name}.{number}')}.", source)
        elif value not in ([], ""):
            place = f"{prefix}{name}".removesuffix(".value").removesuffix(".table")
            unit = next((unit for end, unit in _ENDINGS.items() if place.endswith(end)), "")
            origin = data.get(f"{name}_source", "not stated" if name == "bits" else source)
            origin = origin if name in stated else "assumed: the file does not state it"
            yield SensorNumber(place, _value_text(value), unit, origin)


def _value_text(value: Any) -> str:
    if isinstance(value, list) and len(value) > 8:
        return f"{len(value)} rows: {_value_text(value[0])} to {_value_text(value[-1])}"
    if isinstance(value, list):
        listed = ", ".join(map(_value_text, value))
        return listed if isinstance(value[0], list) else f"({listed})"
    return f"{value:g}" if isinstance(value, float) else str(value)


def movable_numbers(specification: SensorSpecification) -> dict[str, str]:
    """Names of the numbers that factors move (:class:`hyperval.sensor.Sensor`), and their sources."""
    numbers: dict[str, Any] = {f"{arm.name}.{key}": value for arm in specification.arms for key, value in arm}
    numbers |= {"bands.fwhm": specification.bands, "calibration_error_percent": specification.calibration_error_percent}
    return {n: v.source for n, v in numbers.items() if hasattr(v, "source") and getattr(v, "value", None) != 0.0}


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


def summary_regions(axis: SpectralAxis) -> dict[str, Mask]:
    """Masks (B,) of the good bands in the windows of each spectral region the sensor sees."""
    masks = {name: mask & axis.good for name, mask in regions(axis).items()}
    return {name: masks[name.lower()] for name in SPECTRAL_REGIONS_NM if masks[name.lower()].any()}


def neighbour_ratio(axis: SpectralAxis) -> Array:
    """Mean FWHM of two neighbouring bands over their spacing (B - 1,) [1]."""
    return np.asarray(0.5 * (axis.fwhm_nm[:-1] + axis.fwhm_nm[1:]) / np.diff(axis.centre_nm))


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


def electrons_from_energy(arm: Arm, axis: SpectralAxis) -> Array:
    """Electrons per unit of radiance (B,) by the energy that is collected over that of a photon, in SI units.

    1 uW cm-2 sr-1 nm-1 is 1e-2 W m-2 sr-1 nm-1; A Omega is in m2 sr.
    """
    w, throughput = axis.centre_nm, arm.throughput.value_cm2_sr * 1e-4
    collected_w = 1e-2 * throughput * axis.fwhm_nm * arm.optical_transmittance.at(w) * arm.degradation.at(w)
    photon_j = constants.h * constants.c / (w * 1e-9)
    return np.asarray(collected_w * arm.integration_time_s.at(w) * arm.quantum_efficiency.at(w) / photon_j)


class SnrPoint(NamedTuple):
    """A published ratio and the computed one [1] at its wavelength [nm] and radiance [uW cm-2 sr-1 nm-1].

    NaN where the sensor has no band within a width of that wavelength.
    """

    wavelength_nm: float
    published: float
    computed: float
    radiance: float
    item: PublishedSnr

    @property
    def judged(self) -> bool:
        """False where the publication does not say what its figure refers to."""
        return self.item.radiance is not None or self.item.scene is not None


class Sensitivity(NamedTuple):
    """What a number does when it is lowered and raised.

    Attributes
    ----------
    name, source : of the number
    snr : relative change of the SNR, lowered and raised: of the band it moves most [1]
    detection : change of P_D, lowered and raised [1]
    """

    name: str
    source: str
    snr: tuple[float, float]
    detection: tuple[float, float]


class Probe(NamedTuple):
    """The detection whose P_D is watched: the one of the scenarios nearest 0.5, which moves most."""

    scenario: str
    key: tuple[str, str, str]
    value: float


@dataclass
class SensorCheck:
    """What the suite found of one sensor; what its checks share is computed when it is first asked for.

    Attributes
    ----------
    sensor : what is checked
    vary : part by which each assumed number is lowered and raised [1]
    engine : stands in for the atmosphere engine
    table : one row for every check
    usable : False where bands or throughput are so wrong that nothing else is computed
    """

    sensor: Sensor
    vary: float = 0.2
    engine: Engine | None = None
    table: ResultTable = field(default_factory=ResultTable)
    usable: bool = True

    @property
    def axis(self) -> SpectralAxis:
        """The bands of the sensor."""
        return self.sensor.axis

    @cached_property
    def arms(self) -> list[tuple[Arm, SpectralAxis]]:
        """Each arm that sees a band, with its bands."""
        arms = self.sensor.specification.arms
        index = self.sensor.arm_index(self.axis.centre_nm) if arms else np.array([])
        return [(arm, self.axis.select(index == k)) for k, arm in enumerate(arms) if np.any(index == k)]

    def sunlit(self, reflectance: float) -> Array:
        """(B,) radiance of ground in the sun, without an atmosphere."""
        return sunlit_radiance(self.axis, reflectance)

    @cached_property
    def noise(self) -> NoiseModel:
        """The noise on these bands."""
        with np.errstate(all="ignore"):
            return self.sensor.noise()

    @cached_property
    def good(self) -> Mask:
        """(B,) good bands in the atmospheric windows; all good ones where none lies in a window."""
        inside = self.axis.clear
        return inside if inside.any() else self.axis.good

    @cached_property
    def points(self) -> list[SnrPoint]:
        """Published ratios, each with the computed one at the radiance that it refers to.

        Examples
        --------
        >>> from hyperval.sensor.specification import load_sensor
        >>> points = SensorCheck(load_sensor("landsat-7-etm")).points
        >>> [(f"{p.wavelength_nm:g} nm", round(p.computed / p.published, 2)) for p in points]
        [('483 nm', 0.83), ('560 nm', 1.06), ('662 nm', 1.17), ('835 nm', 1.03), ('1648 nm', 0.94), ('2206 nm', 1.03)]
        """
        axis, points = self.axis, []
        for item in self.sensor.specification.published_snr:
            level = self.sunlit(MIDDLE)  # where the publication does not say
            if item.radiance is not None:
                level = item.radiance.at(axis.centre_nm)
            elif item.scene is not None:
                level = scene_radiance(axis, item.scene, self.engine)
            snr = self.noise.snr(level, calibration=False)
            for wavelength, published in item.table:
                k = axis.nearest(wavelength)
                found = (math.nan, math.nan) if k is None else (float(snr[k]), float(level[k]))
                points.append(SnrPoint(wavelength, published, *found, item))
        return points

    @cached_property
    def runs(self) -> dict[str, PredictedProducts | HypervalError]:
        """Scenario -> products with this sensor, or why they could not be predicted."""
        done: dict[str, PredictedProducts | HypervalError] = {}
        for name in builtin_scenarios() if self.usable else ():
            try:
                done[name] = self._predicted(name, self.sensor)
            except HypervalError as error:
                done[name] = error
        return done

    def _predicted(self, scenario: str, sensor: Sensor) -> PredictedProducts:
        return predict(load_scenario(scenario), Origins(sensor=sensor, engine=self.engine))

    @property
    def predictions(self) -> dict[str, PredictedProducts]:
        """Scenario -> products with this sensor, of those that could be predicted."""
        return {name: run for name, run in self.runs.items() if isinstance(run, PredictedProducts)}

    @property
    def curves(self) -> Iterator[tuple[str, tuple[str, str, str], RocCurve]]:
        """Scenario, key and curve of every detection by pixel."""
        for name, prediction in self.predictions.items():
            for key, curve in prediction.roc.items():
                if key[2] == "pixel":
                    yield name, key, curve

    @cached_property
    def probe(self) -> Probe | None:
        """The subject and detector whose P_D lies nearest 0.5; None where nothing is detected."""
        probes = [Probe(name, key, float(detection_at(curve, FALSE_ALARM))) for name, key, curve in self.curves]
        return min(probes, key=lambda p: abs(p.value - 0.5), default=None)

    @cached_property
    def swings(self) -> list[Sensitivity]:
        """Each assumed number lowered and raised by the part ``vary``, largest change of the SNR first."""
        named, swings = movable_numbers(self.sensor.specification), []
        assumed = [(name, origin) for name, origin in named.items() if "assumed" in origin.lower()]
        for name, source in track(assumed, "assumed numbers"):
            changes = (self._changes({name: factor}) for factor in (1.0 - self.vary, 1.0 + self.vary))
            swings.append(Sensitivity(name, source, *zip(*changes, strict=True)))
        return sorted(swings, key=lambda s: -max(abs(v) for v in s.snr))

    def _changes(self, factors: Mapping[str, float]) -> tuple[float, float]:
        """Relative change of the SNR with C_R at ground of 0.25, in the good band of the windows it moves most; change
        of P_D.
        """
        other, level, detected = Sensor(self.sensor.specification, factors), self.sunlit(MIDDLE), 0.0
        change = (other.noise().snr(level) / self.noise.snr(level) - 1.0)[self.good]
        if self.probe is not None:
            curve = self._predicted(self.probe.scenario, other).roc[self.probe.key]
            detected = float(detection_at(curve, FALSE_ALARM)) - self.probe.value
        return float(change[np.argmax(np.abs(change))]), detected


class Finding(NamedTuple):
    """What a check measured.

    Attributes
    ----------
    value : judged against the range of the check
    subject : what it was measured of
    words : what the reason names
    outcome : where it does not follow from the range; ``NONE`` informs
    n : how many values stand behind it
    """

    value: float = math.nan
    subject: str = ""
    words: str = ""
    outcome: Outcome | None = None
    n: int | None = None


Values = Iterator[Finding]


@dataclass(frozen=True)
class Check:
    """One line of the acceptance, as checks.toml says what its entries are.

    ``measure`` : name of a function of this module that gives the values; ``of`` : its argument
    """

    stage: int
    product: str
    metric: str
    measure: str
    of: str = ""
    low: float = math.nan
    high: float = math.nan
    open: bool = False
    unit: str = "1"
    reason: str = "{}"
    absent: str = ""
    remarks: bool = False
    needed: bool = False
    usual: bool = False

    def outcome(self, value: float) -> Outcome:
        """Of a value against the range."""
        if math.isnan(self.low) and math.isnan(self.high):
            return Outcome.NONE
        below = operator.lt if self.open else operator.le
        inside = (math.isnan(self.low) or below(self.low, value)) and (math.isnan(self.high) or below(value, self.high))
        return Outcome.AGREES if inside else Outcome.DISAGREES

    def rows(self, check: SensorCheck) -> Iterator[Result]:
        """Its rows of one sensor."""
        measured = list(globals()[self.measure](check, *([self.of] if self.of else [])))
        for found in measured or ([Finding(outcome=Outcome.NONE)] if self.absent else []):
            outcome = self.outcome(found.value) if found.outcome is None else found.outcome
            informs, broken = outcome is Outcome.NONE, outcome is Outcome.ERROR
            if self.usual and outcome is Outcome.AGREES:
                continue
            role = Role.INFORM if informs or self.usual else Role.GATE
            reason = self.reason.format(found.words) if measured else self.absent
            if outcome is Outcome.AGREES and not self.remarks:
                reason = ""
            low, high = (math.nan, math.nan) if informs or broken else (self.low, self.high)
            yield Result(
                f"sensor {check.sensor.name}", self.product, found.subject, METHOD, self.metric, float(found.value),
                self.unit, n=found.n, limit_low=low, limit_high=high, role=role, outcome=outcome,
                cause=Cause.BROKEN if broken else Cause.NONE, reason=reason,
            )  # fmt: skip


def _checks() -> tuple[Check, ...]:
    """The lines of checks.toml, those of a quantity once for each."""
    data = tomllib.loads((resources.files(__package__) / "checks.toml").read_text("utf-8"))
    lines = [Check(**line) for line in data["check"]]
    for name, limits in data["quantities"].items():
        for entries in data["of_quantity"]:
            line = Check(**{"high": limits["high"] if entries["metric"] == "highest_*" else math.nan, **entries})
            more = {"metric": line.metric.replace("*", name), "reason": line.reason.replace("*", name), "of": name}
            lines.append(replace(line, **more, open=line.metric == "lowest_*" and not limits.get("zero")))
    return tuple(sorted(lines, key=lambda line: line.stage))


CHECKS = _checks()
# By how much a published ratio may be missed.
TOLERANCE = next(line.high for line in CHECKS if (line.measure, line.of) == ("published", "value")) - 1.0


def check_sensor(sensor: Sensor | str | Path, *, vary: float = 0.2, engine: Engine | None = None) -> SensorCheck:
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
    loaded = sensor if isinstance(sensor, Sensor) else load_sensor(sensor)
    check, failed = SensorCheck(loaded, vary, engine), 0
    for line in CHECKS:
        if not check.usable and line.stage > failed:
            break
        rows = list(line.rows(check))
        check.table.extend(rows)
        if line.needed and any(row.outcome is Outcome.DISAGREES for row in rows):
            check.usable, failed = False, line.stage
    if not check.usable:
        reason = "bands or throughput fail: nothing can be computed from them"
        for product in dict.fromkeys(line.product for line in CHECKS if line.stage > failed):
            row = Result(f"sensor {loaded.name}", product, "", METHOD, "sensor_check", role=Role.GATE)
            check.table.append(replace(row, outcome=Outcome.SKIPPED, cause=Cause.AFTER_FAILURE, reason=reason))
    return check


def _worst(axis: SpectralAxis, values: Array, subject: str = "", *, least: bool = False) -> Finding:
    """The greatest or least of values (B,), which names its band."""
    k = int(np.argmin(values) if least else np.argmax(values))
    return Finding(float(values[k]), subject, f"{axis.centre_nm[k]:g} nm")


def order(check: SensorCheck) -> Values:
    """Bands that do not follow each other; at least 1 where the bands make no axis."""
    try:
        _ = check.axis
    except UsageError as error:
        table = check.sensor.specification.bands.table or ()
        wrong = int(np.count_nonzero(np.diff([row[0] for row in table]) <= 0))
        yield Finding(max(wrong, 1), words="; ".join(filter(None, (error.what, error.mend))))
    else:
        yield Finding(0.0)


def without_width(check: SensorCheck) -> Values:
    """Bands without a width, where there are any."""
    narrow = sum(width <= 0 for _, width, _ in check.sensor.specification.bands.table or ())
    if narrow:
        yield Finding(narrow, words="band widths (FWHM) must be positive")


def band_count(check: SensorCheck) -> Values:
    """Number of bands."""
    yield Finding(len(check.axis), words=f"{check.axis.good.sum()} of them good")


def end(check: SensorCheck, side: str) -> Values:
    """Centre of the first or the last band."""
    yield Finding(check.axis.centre_nm[0 if side == "first" else -1])


def _contiguous(check: SensorCheck) -> Mask:
    """(B - 1,) neighbours that should touch: none of a multispectral sensor, and none across a stated gap."""
    bands, middle = check.sensor.specification.bands, 0.5 * (check.axis.centre_nm[:-1] + check.axis.centre_nm[1:])
    touch = np.full(middle.size, bands.spacing != "separate")
    for left_out in bands.gaps:
        touch &= ~((middle >= left_out.range_nm[0]) & (middle <= left_out.range_nm[1]))
    return touch


def spacing(check: SensorCheck) -> Values:
    """Median width over spacing of neighbours; of bands that stand apart it is not judged."""
    ratio, touch = neighbour_ratio(check.axis), _contiguous(check)
    if touch.any():
        words = "out of range: is sigma given for FWHM, half widths for full, or um for nm?"
        yield Finding(float(np.median(ratio[touch])), words=words)
    elif ratio.size:
        yield Finding(float(np.median(ratio)), words="the bands of this sensor stand apart", outcome=Outcome.NONE)


def gap(check: SensorCheck) -> Values:
    """Widest gap between the half-maximum points of neighbours that should touch, in their mean width."""
    touch = _contiguous(check)
    if touch.any():
        unseen = np.where(touch, 1.0 / neighbour_ratio(check.axis) - 1.0, -np.inf)
        k = int(np.argmax(unseen))
        yield Finding(unseen[k], words=f"{check.axis.centre_nm[k]:g} and {check.axis.centre_nm[k + 1]:g} nm")


def response(check: SensorCheck, moment: str) -> Values:
    """The worst integral, centre of mass or width of the responses as they are applied."""
    area, centroid, width = applied_moments(check.axis)
    fwhm = check.axis.fwhm_nm
    errors = {"integral": area - 1.0, "centroid": centroid / fwhm, "width": width / fwhm - 1.0}
    yield _worst(check.axis, np.abs(errors[moment]))


def outside_arms(check: SensorCheck) -> Values:
    """Bands that no arm sees."""
    axis, arms = check.axis, check.sensor.specification.arms
    if arms:
        low, high = np.array([arm.range_nm for arm in arms]).T[:, :, None]
        inside = (axis.centre_nm >= low - 0.5 * axis.fwhm_nm) & (axis.centre_nm <= high + 0.5 * axis.fwhm_nm)
        outside = axis.centre_nm[~inside.any(axis=0)]
        yield Finding(outside.size, words=", ".join(f"{w:g} nm" for w in outside[:5]))


def bands_of_two_arms(check: SensorCheck) -> Values:
    """Bands in the ranges of two arms.

    >>> file = load_sensor("hyperion").specification
    >>> arms = file.arms[0], file.arms[1].model_copy(update={"range_nm": (840.0, 2600.0)})
    >>> both = (SensorCheck(Sensor(file.model_copy(update={"arms": kept}))) for kept in (file.arms, arms))
    >>> [[(found.value, found.words) for found in bands_of_two_arms(check)] for check in both]
    [[], [(9, 'from 844 to 925.41 nm')]]
    """
    w, ranges = check.axis.centre_nm, [arm.range_nm for arm in check.sensor.specification.arms]
    shared = w[sum(((low <= w) & (w <= high)).astype(int) for low, high in ranges) > 1] if ranges else w[:0]
    if shared.size:
        yield Finding(shared.size, words=f"from {shared[0]:g} to {shared[-1]:g} nm")


def bands_of_arm(check: SensorCheck) -> Values:
    """Number of bands of each arm."""
    counts = {arm.name: len(axis) for arm, axis in check.arms}
    yield from (Finding(counts.get(arm.name, 0), arm.name) for arm in check.sensor.specification.arms)


def least(check: SensorCheck, quantity: str) -> Values:
    """Least value of a quantity of each arm over its bands."""
    for arm, axis in check.arms:
        yield _worst(axis, getattr(arm, quantity).at(axis.centre_nm), arm.name, least=True)


def greatest(check: SensorCheck, quantity: str) -> Values:
    """Greatest value of a quantity of each arm over its bands."""
    yield from (Finding(float(getattr(arm, quantity).at(axis.centre_nm).max()), arm.name) for arm, axis in check.arms)


def beyond_table(check: SensorCheck, quantity: str) -> Values:
    """Number of bands of each arm beyond the table of a quantity."""
    for arm, axis in check.arms:
        if (table := getattr(arm, quantity).table) is not None:
            (first, _), (last, _) = table[0], table[-1]
            w, width = axis.centre_nm, axis.fwhm_nm
            beyond = int(np.count_nonzero((w < first - width) | (w > last + width)))
            yield Finding(beyond, arm.name, f"{first:g} to {last:g} nm")


def electrons(check: SensorCheck) -> Values:
    """Least of electrons per radiance over bands."""
    g = check.noise.electrons_per_radiance
    yield Finding(float(np.min(g)), outcome=None if np.all(np.isfinite(g)) else Outcome.DISAGREES)


def energy_gain(check: SensorCheck) -> Values:
    """Electrons per radiance against energy over photon energy."""
    if check.arms:
        expected = np.concatenate([electrons_from_energy(arm, axis) for arm, axis in check.arms])
        in_rising_order = np.argsort(np.concatenate([axis.centre_nm for _, axis in check.arms]))
        yield _worst(check.axis, np.abs(check.noise.electrons_per_radiance / expected[in_rising_order] - 1.0))


def photon_transfer(check: SensorCheck) -> Values:
    """The gain that the noise at two radiances implies against the one that is applied."""
    noise, axis = check.noise, check.axis
    level, other = check.sunlit(DARK), check.sunlit(BRIGHT)
    rise = noise.variance(other, calibration=False) - noise.variance(level, calibration=False)
    with np.errstate(all="ignore"):  # the inverse slope of the variance
        off = (other - level) / rise * noise.readings / noise.electrons_per_radiance - 1.0
    # A measured fit with c != 0 is not linear in the radiance: it says nothing of the gain.
    linear = axis.good if noise.constant is None else axis.good & (noise.constant == 0.0)
    if linear.any():
        yield Finding(float(np.median(off[linear])), n=int(linear.sum()))


def median_snr(check: SensorCheck) -> Values:
    """Median SNR without C_R at the reference radiances, by region."""
    for level in LEVELS:
        snr = check.noise.snr(check.sunlit(level), calibration=False)
        for name, mask in summary_regions(check.axis).items():
            yield Finding(float(np.median(snr[mask])), f"reflectance {level:g}, {name}")


def lowest_snr(check: SensorCheck) -> Values:
    """Least SNR over bands."""
    snr = check.noise.snr(check.sunlit(MIDDLE))
    yield _worst(check.axis, np.where(check.good, snr, np.inf), f"reflectance {MIDDLE:g}", least=True)


def quantisation(check: SensorCheck) -> Values:
    """Noise of the digital word over all other."""
    if check.noise.constant is None:
        parts = check.noise.breakdown(check.sunlit(DARK))
        ratio = np.where(check.axis.good, np.sqrt(parts.quantisation / (parts.shot + parts.fixed)), 0.0)
        yield _worst(check.axis, ratio, f"reflectance {DARK:g}")


def calibration_end(check: SensorCheck, extreme: str) -> Values:
    """The least or greatest C_R; none where it is left out, as 0."""
    values = check.noise.calibration_percent
    if np.any(values > 0.0):
        yield _worst(check.axis, values, least=extreme == "lowest")


def fixed_noise_over(check: SensorCheck, reference: str) -> Values:
    """Fixed noise over rounding noise, at its least, or over full scale, at its greatest.

    >>> from hyperval.sensor.specification import load_sensor
    >>> file = load_sensor("casi-1500").specification
    >>> for electrons in (100.0, 0.04, 40_000.0):
    ...     noise = file.arms[0].fixed_noise_electrons.model_copy(update={"value": electrons})
    ...     arms = (file.arms[0].model_copy(update={"fixed_noise_electrons": noise}),)
    ...     check = SensorCheck(Sensor(file.model_copy(update={"arms": arms})))
    ...     print([r.metric for line in CHECKS if line.measure == "fixed_noise_over" for r in line.rows(check)])
    []
    ['lowest_fixed_noise_over_rounding']
    ['highest_fixed_noise_over_full_scale']
    """
    noise, step = check.noise, np.asarray(check.noise.lsb_electrons)
    if noise.constant is None and np.all(noise.fixed_noise > 0.0):
        scale = step / math.sqrt(12.0) if reference == "rounding" else step * 2.0 ** np.asarray(noise.bits, float)
        yield _worst(check.axis, noise.fixed_noise / scale, least=reference == "rounding")


def saturation(check: SensorCheck) -> Values:
    """Greatest part of full scale: of bright ground judged, of white ground shown."""
    for level, outcome in ((BRIGHT, None), (1.0, Outcome.NONE)) if check.noise.full_scale is not None else ():
        part = check.noise.full_scale_fraction(check.sunlit(level))
        part = np.where(check.axis.good, part, 0.0)
        worst = _worst(check.axis, part, f"reflectance {level:g}")
        words = f"{int(np.count_nonzero(part >= 1))} bands saturate, most at {worst.words}"
        yield worst._replace(words=words, outcome=outcome)


def growth(check: SensorCheck) -> Values:
    """Least relative growth of the SNR with radiance, with time, with aperture, and with a smaller C_R."""
    noise, spec, level = check.noise, check.sensor.specification, check.sunlit(MIDDLE)

    def snr_with(**changes: float) -> Array:
        return changed_noise(noise, SensorChanges.model_validate(changes)).snr(level)

    def snr_with_more(key: str) -> Array:
        if spec.measured_noise is not None:
            return snr_with(signal_factor=STEP)
        return Sensor(spec, {f"{arm.name}.{key}": STEP for arm in spec.arms}).noise().snr(level)

    base = noise.snr(level)
    with np.errstate(all="ignore"):  # between radiances from 1/1000 of the level to four times of it
        snr = np.stack([noise.snr(f * level, calibration=False) for f in np.geomspace(1e-3, 4.0, 25)])
        rises = {"radiance": np.min(np.diff(snr, axis=0) / snr[:-1], axis=0)}
    rises["integration time"] = snr_with_more("integration_time_s") / base - 1.0
    rises["aperture"] = snr_with_more("throughput") / base - 1.0
    worse = max(STEP * float(noise.calibration_percent.max()), 0.1)
    rises["less C_R"] = base / snr_with(calibration_error_percent=worse) - 1.0
    for name, values in rises.items():
        worst = _worst(check.axis, np.where(check.axis.good, values, np.inf), name, least=True)
        yield worst._replace(words=f"{name} at {worst.words}")


def published(check: SensorCheck, statement: str) -> Values:
    """Computed over published ratios, of values or of lower bounds; a file without any says so once."""
    if not check.points and statement == "value":
        yield Finding(words="the file holds no published ratio to compare with", outcome=Outcome.NONE)
    for point in (point for point in check.points if point.item.says == statement):
        subject, bound = f"{point.wavelength_nm:g} nm", "at least " if statement == "at least" else ""
        words = (
            f"computed {point.computed:.0f} at {point.radiance:.3g} uW cm-2 sr-1 nm-1, "
            f"published {bound}{point.published:g}: {point.item.source}"
        )
        outcome = None if point.judged else Outcome.NONE
        if math.isnan(point.computed):
            words, outcome = f"no band within a width of {subject}", Outcome.DISAGREES
        elif not point.judged:
            words += "; it does not say at which radiance, so ground of 0.25 under the sun at 45 deg is taken"
        yield Finding(point.computed / point.published, subject, words, outcome)


def scenario_runs(check: SensorCheck) -> Values:
    """Scenarios that could not be predicted."""
    for name, run in check.runs.items():
        if isinstance(run, HypervalError):
            yield Finding(words=f"{name}: {run}", outcome=Outcome.ERROR)


def not_positive(check: SensorCheck) -> Values:
    """Radiances and ratios of the scenarios that are not positive."""
    for name, products in check.predictions.items():
        good = products.axis.clear
        spectra = (e.mean[good] for group in (products.radiance, products.snr) for e in group.values())
        yield Finding(sum(int(np.count_nonzero(~(np.isfinite(mean) & (mean > 0)))) for mean in spectra), name)


def snr_over_cap(check: SensorCheck) -> Values:
    """The SNR of the scenarios over 100 / C_R, which it reaches but for rounding."""
    for name, products in check.predictions.items():
        c_r = check.sensor.noise(products.axis).calibration_percent / 100.0
        most = max(float(np.max(e.mean * c_r)) for s, e in products.snr.items() if s in products.radiance)
        yield Finding(most, name, outcome=Outcome.AGREES if most <= 1.0 + 1e-9 else Outcome.DISAGREES)


def panel_error(check: SensorCheck) -> Values:
    """Reflectance of the scenarios' panels after the empirical line against their own."""
    for name, products in check.predictions.items():
        good = products.axis.clear
        off = [
            (products.reflectance[panel.name].mean - builtin_mean(panel.spectrum.builtin, products.axis))[good]
            for panel in load_scenario(name).scene.panels
            if panel.spectrum.builtin is not None and panel.name in products.reflectance
        ]
        yield Finding(float(np.max(np.abs(off), initial=0.0)), name)


def scene_saturation(check: SensorCheck) -> Values:
    """Greatest part of full scale of the scenarios' surfaces, where it is known."""
    for name, products in check.predictions.items():
        parts = [float(np.max(np.where(products.axis.good, p, 0.0))) for p in products.full_scale.values()]
        if parts and np.all(np.isfinite(parts)):
            yield Finding(max(parts), name)


def roc_step(check: SensorCheck) -> Values:
    """Least step of every predicted ROC, which also stays between 0 and 1."""
    for name, (subject, detector, _), curve in check.curves:
        step = float(np.min(np.diff(curve.pd)))
        sound = step >= 0.0 and bool(np.all((curve.pd >= 0) & (curve.pd <= 1)))
        yield Finding(step, f"{name}, {subject} {detector}", outcome=Outcome.AGREES if sound else Outcome.DISAGREES)


def detection(check: SensorCheck) -> Values:
    """P_D of every target at the false-alarm probability that is watched."""
    for name, (subject, detector, _), curve in check.curves:
        yield Finding(float(detection_at(curve, FALSE_ALARM)), f"{name}, {subject} {detector}")


def swings(check: SensorCheck, output: str) -> Values:
    """The change of the SNR or of P_D when each assumed number is lowered and raised."""
    probe, words = check.probe if output == "detection" else None, ""
    if probe is not None:
        words = f"{probe.key[0]} by {probe.key[1]} at P_FA 0.001, where P_D is {probe.value:.3f}"
    for swing in check.swings if words or output == "snr" else ():
        for sign, change in zip("-+", getattr(swing, output), strict=True):
            yield Finding(change, f"{swing.name} {sign}{100 * check.vary:g} %", words or swing.source)
