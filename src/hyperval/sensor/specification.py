"""The sensor file, in which every number stands with its source or with the word "assumed".

Besides, how a sensor is operated (frames, bins, where its bands truly stand), and changes of single numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from importlib import resources
from pathlib import Path, PurePath
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from hyperval.config import Model, OneOf, file_of, load_model, shipped, unknown
from hyperval.data import Array, Index
from hyperval.errors import UsageError, reader, refusal, refuse
from hyperval.sensor.noise import (
    NoiseModel,
    aperture_throughput,
    electrons_per_radiance,
    f_number_throughput,
    mtf_at_nyquist,
    psf_fwhm_from_mtf,
    with_signal,
)
from hyperval.spectra.axis import SIGMA_PER_FWHM, SpectralAxis

Source = Annotated[str, Field(min_length=3)]


class Quantity(OneOf):
    """A number, or a table over wavelength, with its source."""

    one_of = ("value", "table")
    value: float | None = None
    table: list[tuple[float, float]] | None = Field(None, description="[nm, value] pairs, wavelength increasing")
    source: Source
    refused: ClassVar = {
        "a table needs at least two rows in rising wavelength": lambda q: (
            q.table is not None and (len(q.table) < 2 or np.any(np.diff([w for w, _ in q.table]) <= 0))
        )
    }

    def at(self, wavelength_nm: Array) -> Array:
        """(B,) values: linear in wavelength, the end values beyond the table."""
        if self.table is None:
            return np.full(wavelength_nm.shape, self.value, dtype=float)
        w, v = np.array(self.table).T
        return np.asarray(np.interp(wavelength_nm, w, v))


class RegularBands(Model):
    """Evenly spaced bands."""

    first_nm: float = Field(gt=0)
    step_nm: float = Field(gt=0)
    count: int = Field(gt=0, le=5000)
    fwhm_nm: float = Field(gt=0)


class StatedGap(Model):
    """A part of the spectrum that the sensor leaves out on purpose."""

    range_nm: tuple[float, float] = Field(description="from the last band before it to the first after it [nm]")
    source: Source


class Bands(OneOf):
    """The band set: a table of [centre nm, FWHM nm, good 0/1], evenly spaced bands, or such bands part by part."""

    one_of = ("table", "regular", "parts")
    table: list[tuple[float, float, int]] | None = None
    regular: RegularBands | None = None
    parts: list[RegularBands] | None = Field(None, min_length=1, description="evenly spaced bands, by spectrometer")
    spacing: Literal["contiguous", "separate"] = Field(
        "contiguous", description="separate: a multispectral sensor, whose bands need not touch"
    )
    gaps: tuple[StatedGap, ...] = Field((), description="parts that are left out on purpose")
    source: Source

    @property
    def axis(self) -> SpectralAxis:
        """The bands as an axis (for 3.13)."""
        if self.table is not None:
            rows: Array = np.array(self.table, dtype=np.float64)
            return SpectralAxis(rows[:, 0], rows[:, 1], rows[:, 2] > 0)
        parts = self.parts or ([self.regular] if self.regular is not None else [])
        centres = [part.first_nm + part.step_nm * np.arange(part.count, dtype=np.float64) for part in parts]
        widths = np.repeat([part.fwhm_nm for part in parts], [part.count for part in parts])
        return SpectralAxis(np.concatenate(centres), widths)


_NEEDS = {  # of each convention of (3.14)
    "value": ("cm2_sr",),
    "square-ifov": ("aperture_m", "ifov_mrad"),
    "cone": ("aperture_m", "ifov_mrad"),
    "f-number": ("f_number", "pixel_pitch_um"),
    "slit": ("f_number", "slit_width_um", "slit_height_um"),
}


class Throughput(Model):
    """A Omega by one of the conventions of (3.14).

    value: ``cm2_sr``; square-ifov, cone: ``aperture_m``, ``ifov_mrad``, ``obscuration``;
    f-number: ``f_number``, ``pixel_pitch_um``; slit: ``f_number``, ``slit_width_um``, ``slit_height_um``.
    """

    convention: Literal["value", "square-ifov", "cone", "f-number", "slit"] = "square-ifov"
    cm2_sr: float | None = Field(None, gt=0)
    aperture_m: float | None = Field(None, gt=0)
    ifov_mrad: float | None = Field(None, gt=0)
    obscuration: float = Field(0.0, ge=0, lt=1)
    f_number: float | None = Field(None, gt=0)
    pixel_pitch_um: float | None = Field(None, gt=0)
    slit_width_um: float | None = Field(None, gt=0)
    slit_height_um: float | None = Field(None, gt=0)
    source: Source

    @model_validator(mode="after")
    def _complete(self) -> Self:
        lacking = [name for name in _NEEDS[self.convention] if getattr(self, name) is None]
        if lacking:
            raise ValueError(f"the convention {self.convention} needs {', '.join(lacking)}")
        return self

    @property
    def value_cm2_sr(self) -> float:
        """A Omega [cm2 sr] (3.14)."""
        first, *rest = (float(getattr(self, name)) for name in _NEEDS[self.convention])
        if not rest:
            return first
        if self.convention in ("f-number", "slit"):
            return f_number_throughput(first, rest[0] * rest[-1])  # a pixel is square
        return aperture_throughput(first, 1e-3 * rest[0], obscuration=self.obscuration, convention=self.convention)


class Blur(OneOf):
    """Point spread function in two directions, by widths or by MTF: pairs (along, across) the track."""

    one_of = ("fwhm_pixels", "mtf_at_nyquist")
    fwhm_pixels: tuple[float, float] | None = Field(None, description="Gaussian besides the aperture [pixels]")
    mtf_at_nyquist: tuple[float, float] | None = Field(None, description="of the pixel, aperture included [1]")
    source: Source
    refused: ClassVar = {
        "fwhm_pixels lies between 0 and 5": lambda b: not all(0 <= w <= 5 for w in b.fwhm_pixels or ()),
        "mtf_at_nyquist lies between 0.01 and 0.6366, which the aperture alone passes": lambda b: (
            not all(0.01 <= m <= 2 / np.pi for m in b.mtf_at_nyquist or ())
        ),
    }

    @property
    def fwhm(self) -> tuple[float, float]:
        """FWHM of the Gaussian (along, across) [pixels]."""
        if self.fwhm_pixels is not None:
            return self.fwhm_pixels
        along, across = psf_fwhm_from_mtf(np.array(self.mtf_at_nyquist, dtype=float))
        return float(along), float(across)


class SpectralShift(OneOf):
    """Where the bands of a range truly stand: true minus nominal centre, and the smile across the track."""

    together = ("smile_nm", "columns")
    range_nm: tuple[float, float] | None = Field(None, description="bands it holds for; None: all")
    shift_nm: float = Field(0.0, ge=-50, le=50, description="at the middle of the track [nm]")
    smile_nm: tuple[float, ...] = Field(
        (), max_length=8, description="c1, c2, ...: adds c1 x + c2 x^2 + ..., x from -1 to 1 across the track"
    )
    columns: int | None = Field(None, ge=2, description="samples across the track; with smile_nm")
    source: Source

    def at(self, column: float | None) -> float:
        """Shift [nm] at a sample, counted from 0; None is the middle of the track.

        Raises
        ------
        UsageError : the column lies outside the track.
        """
        if column is None or self.columns is None:
            return self.shift_nm
        x = 2.0 * column / (self.columns - 1) - 1.0
        if not -1.0 <= x <= 1.0:
            raise UsageError(f"sensor_operation.column: column {column:g} lies outside 0-{self.columns - 1}")
        return self.shift_nm + sum(c * x ** (k + 1) for k, c in enumerate(self.smile_nm))


Row = tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]]


class ReferenceScene(Model):
    """A uniform ground under a standard atmosphere: what a published figure refers to."""

    reflectance: float = Field(gt=0, le=1.2, description="of the ground, as far as the eye reaches [1]")
    solar_zenith_deg: float = Field(ge=0, lt=85)
    sensor_altitude_km: float = Field(ge=0, le=100_000, description="above sea level; 100 and more is space [km]")
    ground_altitude_km: float = Field(0.0, ge=0, le=5, description="above sea level [km]")
    meteorological_range_km: float = Field(23.0, ge=2, le=300, description="at the ground, rural aerosol [km]")
    model: str = Field("midlatitude-summer", description="standard atmosphere, as in a scenario")
    source: Source


class PublishedSnr(OneOf):
    """Signal-to-noise ratios that were published, with the radiance they refer to.

    At most one of ``radiance`` and ``scene``; with neither, the publication does not say what it refers to, and
    the figures are shown and not judged.
    """

    at_most_one_of = ("radiance", "scene")
    table: list[Row] = Field(min_length=1, description="rows [nm, SNR]")
    says: Literal["value", "at least"] = Field("value", description="a figure that is met, or a lower bound")
    radiance: Quantity | None = Field(None, description="reference radiance [uW cm-2 sr-1 nm-1]")
    scene: ReferenceScene | None = Field(None, description="the scene that gives the reference radiance")
    source: Source


class SensorChanges(Model):
    """What differs from the sensor file; each term is that of (3.13)-(3.19)."""

    calibration_error_percent: float | None = Field(None, ge=0, lt=100, description="C_R in every band [%]")
    signal_factor: float = Field(
        1.0, gt=0, le=1000, description="on the electrons per radiance: throughput, aperture, integration time"
    )
    fixed_noise_factor: float = Field(1.0, ge=0, le=1000, description="on the fixed noise electrons")
    bits: int | None = Field(None, ge=1, le=32, description="bits of a word, at the same full scale")


def changed_noise(noise: NoiseModel, changes: SensorChanges) -> NoiseModel:
    """The noise (3.13)-(3.19) of a sensor with other numbers.

    The light acts by :func:`with_signal`.
    A changed word length moves the step of quantisation at the same full scale.
    """
    other: dict[str, Any] = {"fixed_noise": noise.fixed_noise * changes.fixed_noise_factor}
    if changes.calibration_error_percent is not None:
        other["calibration_percent"] = np.full_like(noise.calibration_percent, changes.calibration_error_percent)
    if changes.bits is not None:
        step = 2.0 ** (np.asarray(noise.bits, dtype=float) - changes.bits)
        other |= {"lsb_electrons": noise.lsb_electrons * step, "bits": changes.bits}
    return replace(with_signal(noise, changes.signal_factor), **other)


Count = Annotated[int, Field(ge=1, le=10_000)]


class SensorOperation(Model):
    """Settings of one flight; the sensor file holds what belongs to the instrument."""

    frames_averaged: Count = Field(1, description="frames averaged into one line (co-adds)")
    averaged: Literal["before recording", "after recording"] = Field(
        "after recording", description="whether each frame is digitised and sent by itself"
    )
    spatial_binning: tuple[Count, Count] = Field(
        (1, 1), description="pixels averaged into one, (along, across); class statistics are those of the bin"
    )
    spectral_binning: Count = Field(1, description="neighbouring bands added into one, each read by itself")
    wavelength_shift_nm: float | dict[str, float] = Field(
        0.0, description="true minus nominal band centres [nm], for all bands or by arm"
    )
    column: float | None = Field(None, description="sample, from 0, at which the smile is taken; None: the middle")


def averaged_noise(noise: NoiseModel, operation: SensorOperation) -> NoiseModel:
    """The noise of co-added frames and spatial bins (3.15)-(3.19).

    Independent readings divide the variances of photons and detector by their number.  Frames averaged before
    recording share one digital word.  C_R belongs to a detector element, so that only bins across the track
    average it.
    """
    along, across = operation.spatial_binning
    bins, frames = along * across, operation.frames_averaged
    after = operation.averaged == "after recording"
    return replace(
        noise,
        readings=noise.readings * bins * frames,
        digital_readings=noise.digital_readings * bins * (frames if after else 1),
        calibration_readings=noise.calibration_readings * across,
    )


def binned_axis(axis: SpectralAxis, count: int) -> SpectralAxis:
    """The axis of sums of ``count`` neighbouring bands (dlambda of 3.13); bands left over at the end are dropped.

    The response of a sum has the mean of the centres and the variance of the parts plus that of their
    centres; the FWHM is that of the Gaussian of this variance.  A bin is good when all its bands are.
    """
    groups = _groups(axis.centre_nm, count)
    variance = (_groups(axis.fwhm_nm, count) * SIGMA_PER_FWHM) ** 2
    sigma = np.sqrt(variance.mean(axis=1) + groups.var(axis=1))
    good = _groups(axis.good, count).all(axis=1)
    return SpectralAxis(groups.mean(axis=1), sigma / SIGMA_PER_FWHM, np.asarray(good, dtype=bool))


def binned_noise(noise: NoiseModel, count: int) -> NoiseModel:
    """The noise of sums of ``count`` neighbouring bands (3.13)-(3.19).

    Electrons add up, and so do the variances of fixed noise, rounding and bit errors, each band being read by
    itself; C_R is independent between bands.  Measured noise is binned through its electrons; c adds in
    quadrature, exact where a and c do not change within a bin.
    """
    parts = _groups(noise.electrons_per_radiance, count)
    g = parts.sum(axis=1)  # (3.13)

    def root_sum(x: Array, weights: Array | float = 1.0) -> Array:
        return np.asarray(np.sqrt(((weights * _groups(x, count)) ** 2).sum(axis=1)))

    def first(x: Any) -> Any:
        return _groups(x, count)[:, 0] if np.ndim(x) else x

    constant = None
    if noise.constant is not None:
        sign = np.sign(_groups(noise.constant, count).sum(axis=1))
        constant = sign * root_sum(noise.constant * noise.electrons_per_radiance) / g
    return replace(
        noise,
        electrons_per_radiance=g,
        fixed_noise=root_sum(noise.fixed_noise),
        lsb_electrons=root_sum(noise.lsb_electrons),
        bits=first(noise.bits),
        bit_error_rate=first(noise.bit_error_rate),
        calibration_percent=root_sum(noise.calibration_percent, parts / g[:, None]),  # (3.17)
        constant=constant,
        full_scale=None if noise.full_scale is None else _groups(noise.full_scale, count).min(axis=1),
    )


def _groups(values: npt.ArrayLike, count: int) -> Array:
    x = np.asarray(values)
    whole = x.size // count * count
    return np.asarray(x[:whole].reshape(-1, count))


class Arm(OneOf):
    """One spectrometer: its range and everything of (3.13)-(3.19) that belongs to it."""

    one_of = ("full_well_electrons", "saturation_radiance")
    name: str
    range_nm: tuple[float, float]
    throughput: Throughput
    optical_transmittance: Quantity
    quantum_efficiency: Quantity
    degradation: Quantity = Quantity(value=1.0, table=None, source="assumed: no loss besides the optics")
    integration_time_s: Quantity
    fixed_noise_electrons: Quantity
    bits: int = Field(ge=1, le=32)
    bits_source: Source | None = Field(None, description="where the number of bits is from")
    full_well_electrons: Quantity | None = Field(None, description="electrons at full scale; LSB = this / 2^bits")
    saturation_radiance: Quantity | None = Field(None, description="radiance at full scale [uW cm-2 sr-1 nm-1]")
    bit_error_rate: Quantity = Field(
        Quantity(value=0.0, table=None, source="assumed: error-free recording"), description="of each bit (3.19)"
    )


_FACTORS_OF_GAIN = ("optical_transmittance", "quantum_efficiency", "integration_time_s", "degradation")  # (3.13)


class MeasuredNoise(Model):
    """NEdL = |a sqrt(b + L) + c| as tabulated for a sensor: rows [nm, a, b, c]."""

    table: list[tuple[float, float, float, float]] = Field(min_length=2)
    saturation_radiance: Quantity | None = Field(None, description="radiance at full scale [uW cm-2 sr-1 nm-1]")
    source: Source
    refused: ClassVar = {
        "a must be positive and b not negative": lambda m: any(a <= 0 or b < 0 for _, a, b, _ in m.table)
    }


class SensorSpecification(OneOf):
    """One sensor file."""

    one_of = ("arms", "measured_noise")
    schema_version: Literal[1] = Field(1, alias="schema")
    name: str
    title: str
    source: Source
    notes: tuple[str, ...] = ()
    bands: Bands
    arms: tuple[Arm, ...] = ()
    measured_noise: MeasuredNoise | None = None
    detector_gain: float = Field(1.0, ge=0, le=1000, description="g_d of (3.16)")
    psf: Blur | None = None
    spectral_calibration: tuple[SpectralShift, ...] = ()
    calibration_error_percent: Quantity
    published_snr: tuple[PublishedSnr, ...] = Field((), description="what `hyperval sensor check` compares with")


@dataclass(frozen=True)
class Sensor:
    """A sensor ready for use: its specification, and its noise on any band set.

    ``factors``: on numbers of the file by name, such as ``VNIR.throughput``, ``bands.fwhm``, each entry of a table.
    """

    specification: SensorSpecification
    factors: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Short name."""
        return self.specification.name

    @cached_property
    def axis(self) -> SpectralAxis:
        """The sensor's own bands."""
        axis = self.specification.bands.axis
        wider = self.factors.get("bands.fwhm", 1.0)
        return axis if wider == 1.0 else SpectralAxis(axis.centre_nm, wider * axis.fwhm_nm, axis.good)

    def true_axis(self, nominal: SpectralAxis, operation: SensorOperation | None = None) -> SpectralAxis:
        """The bands where they truly stand: nominal centres, the file's spectral calibration and the shift stated.

        Raises
        ------
        UsageError : a column outside the track, an arm that the sensor does not have, bands that change places.
        """
        shift, column = np.zeros_like(nominal.centre_nm), operation.column if operation else None
        for item in self.specification.spectral_calibration:
            low, high = item.range_nm or (0.0, np.inf)
            shift[(nominal.centre_nm >= low) & (nominal.centre_nm <= high)] += item.at(column)
        stated = operation.wavelength_shift_nm if operation else 0.0
        if isinstance(stated, dict):
            names = [arm.name for arm in self.specification.arms]
            if wrong := unknown(stated, names):
                raise refusal("sensor.shift", name=self.name, arm=wrong[0], known=wrong[1] or "none: give one number")
            by_arm = np.array([stated.get(name, 0.0) for name in names])
            shift += by_arm[self.arm_index(nominal.centre_nm)] if stated else 0.0
        else:
            shift += stated
        return SpectralAxis(nominal.centre_nm + shift, nominal.fwhm_nm, nominal.good) if np.any(shift) else nominal

    def noise(self, axis: SpectralAxis | None = None, operation: SensorOperation | None = None) -> NoiseModel:
        """The noise (3.13-3.20) on ``axis`` (default: the sensor's own bands), frames and pixels averaged.

        Tables are interpolated in wavelength; the electrons scale with the width of the bands of
        ``axis``, measured noise is taken to belong to the width it was measured with.

        Raises
        ------
        UsageError : a band lies outside all arms.
        """
        measured, bands = self.specification.measured_noise, self.axis if axis is None else axis
        nm = bands.centre_nm
        calibration = self._values("calibration_error_percent", nm)
        model = self._measured_noise(measured, nm, calibration) if measured else self._noise(bands, calibration)
        return model if operation is None else averaged_noise(model, operation)

    def operated_noise(
        self, axis: SpectralAxis | None, operation: SensorOperation | None, changes: SensorChanges | None,
        kept: dict[Any, Any],
    ) -> NoiseModel:  # fmt: skip
        """Noise as the sensor is run and changed (3.13-3.20), bands binned; ``kept``: that of each way to run it."""
        key = "noise", repr(operation)
        if key not in kept:
            bands = self.axis if axis is None else axis
            with np.errstate(all="ignore"):  # numbers of the file that `sensor check` judges
                kept[key] = self.noise(axis, operation)
                dead = bands.centre_nm[bands.good & ~(kept[key].snr(np.ones(len(bands))) > 0.0)]  # bad ones may be dark
            refuse(dead.size, "sensor.no_signal", name=self.name, nm=dead[:1])
        model: NoiseModel = kept[key] if changes is None else changed_noise(kept[key], changes)
        count = operation.spectral_binning if operation else 1
        return binned_noise(model, min(count, len(self.axis))) if count > 1 else model

    def notes(self, shift_nm: Array, changes: SensorChanges | None = None) -> list[str]:
        """Assumptions of the sensor file, what the scenario has changed in it, MTF at Nyquist, shift of the bands.

        >>> sensor = load_sensor("casi-1500")
        >>> stated = None, SensorChanges(calibration_error_percent=1.5)
        >>> notes = [note for changes in stated for note in sensor.notes(np.zeros(1), changes)]
        >>> [note.partition(": ")[2] for note in notes if "calibration_error" in note]
        ['calibration_error_percent (assumed: pixel-to-pixel part of the radiometric calibration)',
        'calibration_error_percent 1.5 (stated by the scenario)']
        """
        spec = self.specification
        changed = changes.model_dump(exclude_defaults=True) if changes else {}
        named = [(f"{arm.name}: {key}", value) for arm in spec.arms for key, value in arm]
        named.append(("calibration_error_percent", spec.calibration_error_percent))
        sources = [(name, getattr(value, "source", "")) for name, value in named if name not in changed]
        notes = [f"{name} ({source})" for name, source in sources if source.lower().startswith("assumed")]
        notes += [f"{name} {value:g} (stated by the scenario)" for name, value in changed.items()]
        if spec.psf is not None:
            along, across = mtf_at_nyquist(np.array(spec.psf.fwhm))
            notes.append(f"MTF at Nyquist {along:.3f} along, {across:.3f} across the track")
        if np.any(shift_nm):
            notes.append(f"bands stand {shift_nm.min():+.3g} to {shift_nm.max():+.3g} nm off their labels")
        return [f"sensor {self.name}: {text}" for text in notes]

    def _values(self, name: str, w: Array, arm: Arm | None = None) -> Array:
        """(B,) values of a quantity of the file or of an arm."""
        quantity = getattr(arm or self.specification, name)
        values = np.asarray(quantity.value_cm2_sr if isinstance(quantity, Throughput) else quantity.at(w))
        return values * self.factors.get(f"{arm.name}.{name}" if arm else name, 1.0)

    def _measured_noise(self, noise: MeasuredNoise, w: Array, calibration: Array) -> NoiseModel:
        nm, a, b, c = np.array(noise.table, dtype=float).T
        # a^2 and b vary like the inverse of efficiency, by orders of magnitude: interpolate logarithms.
        a, c = np.exp(np.interp(w, nm, np.log(a))), np.interp(w, nm, c)
        b = np.exp(np.interp(w, nm, np.log(np.maximum(b, 1e-12))))
        full = noise.saturation_radiance.at(w) if noise.saturation_radiance else None
        gain = self.specification.detector_gain
        return NoiseModel(1.0 / a**2, np.sqrt(b) / a, gain, np.zeros(w.size), 1, 0.0, calibration, c, full)

    def _noise(self, bands: SpectralAxis, calibration: Array) -> NoiseModel:
        spec, w, width, arms = self.specification, bands.centre_nm, bands.fwhm_nm, self.arm_index(bands.centre_nm)

        def by_arm(values: Callable[[Arm], Any]) -> npt.NDArray[Any]:
            """(B,) values of each band's own arm."""
            return np.stack([np.broadcast_to(values(arm), w.shape) for arm in spec.arms])[arms, np.arange(w.size)]

        def gain(arm: Arm) -> Array:
            optics = {key: self._values(key, w, arm) for key in _FACTORS_OF_GAIN}
            return electrons_per_radiance(w, width, throughput_cm2_sr=self._values("throughput", w, arm), **optics)

        g, bits = by_arm(gain), by_arm(lambda arm: arm.bits)
        rate = by_arm(lambda arm: self._values("bit_error_rate", w, arm))
        units: dict[str, Any] = {"full_well_electrons": 1.0, "saturation_radiance": g}
        stated = {arm.name: next(way for way in units if getattr(arm, way) is not None) for arm in spec.arms}
        full = by_arm(lambda arm: self._values(stated[arm.name], w, arm) * units[stated[arm.name]])
        return NoiseModel(
            g, by_arm(lambda arm: self._values("fixed_noise_electrons", w, arm)), spec.detector_gain, full * 0.5**bits,
            int(bits[0]) if np.all(bits == bits[0]) else bits,
            float(rate[0]) if np.all(rate == rate[0]) else rate,
            calibration, None, full / g,
        )  # fmt: skip

    def arm_index(self, wavelength_nm: Array) -> Index:
        """Number of the arm (B,) that sees each wavelength (B,); UsageError for one far outside all arms."""
        # An airborne cube's axis may reach a little beyond the nominal range: the nearest arm serves there.
        ranges = np.array([a.range_nm for a in self.specification.arms])
        gap = np.maximum(ranges[:, :1] - wavelength_nm, wavelength_nm - ranges[:, 1:]).clip(0.0)
        if np.any(far := gap.min(axis=0) > 50.0):
            within = ", ".join(f"{a.range_nm[0]:g}-{a.range_nm[1]:g} nm" for a in self.specification.arms)
            raise refusal("sensor.no_arm", name=self.name, nm=wavelength_nm[far][0], within=within)
        return np.asarray(gap.argmin(axis=0))


_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


def new_sensor_file(name: str, arms: Sequence[str] = ("VNIR",), then: str = "hyperval sensor check") -> str:
    """The text of a sensor file with everything still to be filled in.

    Parameters
    ----------
    name : short name of the sensor
    arms : names of its spectrometers, in rising wavelength
    then : the command that checks it

    Raises
    ------
    UsageError : a name that could not stand in a file name, no arm, or the same one twice.
    """
    from jinja2 import Template

    for text in (name, *arms):
        refuse(not _NAME.fullmatch(text), "sensor.name", text=text)
    refuse(not arms or len(set(arms)) != len(arms), "sensor.arms")
    template = (resources.files("hyperval.sensor") / "new_sensor.yaml.j2").read_text("utf-8")
    return str(Template(template, trim_blocks=True, keep_trailing_newline=True).render(name=name, arms=arms, then=then))


@lru_cache(maxsize=1)
def library_names() -> tuple[str, ...]:
    """Names of the sensors that ship with the project."""
    return tuple(shipped("hyperval.sensor", "library"))


@reader
def load_sensor(name_or_path: str | Path) -> Sensor:
    """A sensor of the library by name, or a sensor file by path.

    Raises
    ------
    UsageError : no such name, or an invalid file (every mistake with its line).
    InputError : no such file.
    """
    library = shipped("hyperval.sensor", "library")
    path = file_of(name_or_path, library, "sensor")
    return library_sensor(path.stem) if path in library.values() else Sensor(load_model(SensorSpecification, path))


def sensor_named(name: str, find: Callable[[str], Path]) -> Sensor:
    """The sensor that an entry of a file names: of the library, or in a file that ``find`` leads to.

    >>> asked = []
    >>> names = "enmap", "MINE.YAML", "data:mine"
    >>> [sensor_named(name, lambda name: asked.append(name) or "hymap").name for name in names], asked
    (['enmap', 'hymap', 'hymap'], ['MINE.YAML', 'data:mine'])
    """
    path = find(name) if PurePath(name).suffix or ":" in name else name
    return library_sensor(name) if name in library_names() else load_sensor(path)


@lru_cache(maxsize=16)
def library_sensor(name: str) -> Sensor:
    """A sensor of the library, read once."""
    return Sensor(load_model(SensorSpecification, shipped("hyperval.sensor", "library")[name]))
