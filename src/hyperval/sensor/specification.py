"""Sensor files: every number stands with its source, or with the word "assumed"."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from hyperval.config import Model, load_model
from hyperval.errors import UsageError
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.response import aperture_throughput, electrons_per_radiance, f_number_throughput
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Source = Annotated[str, Field(min_length=3)]


class Quantity(Model):
    """A number, or a table over wavelength, with its source."""

    value: float | None = None
    table: list[tuple[float, float]] | None = Field(None, description="[nm, value] pairs, wavelength increasing")
    source: Source

    @model_validator(mode="after")
    def _one_of(self) -> Quantity:
        if (self.value is None) == (self.table is None):
            raise ValueError("give either value or table")
        if self.table is not None and (len(self.table) < 2 or np.any(np.diff([w for w, _ in self.table]) <= 0)):
            raise ValueError("a table needs at least two rows in rising wavelength")
        return self

    def at(self, wavelength_nm: Array) -> Array:
        """(B,) values: linear in wavelength, the end values beyond the table."""
        if self.table is None:
            return np.full(wavelength_nm.shape, self.value, dtype=float)
        w, v = np.array(self.table).T
        return np.interp(wavelength_nm, w, v)

    @property
    def assumed(self) -> bool:
        """True when the source says that the number is an assumption."""
        return self.source.lower().startswith("assumed")


class RegularBands(Model):
    """Evenly spaced bands."""

    first_nm: float = Field(gt=0)
    step_nm: float = Field(gt=0)
    count: int = Field(gt=0, le=5000)
    fwhm_nm: float = Field(gt=0)


class Bands(Model):
    """The band set: a table of [centre nm, FWHM nm, good 0/1] or evenly spaced bands."""

    table: list[tuple[float, float, int]] | None = None
    regular: RegularBands | None = None
    source: Source

    @model_validator(mode="after")
    def _one_of(self) -> Bands:
        if (self.table is None) == (self.regular is None):
            raise ValueError("give either table or regular")
        return self

    @property
    def axis(self) -> SpectralAxis:
        """The bands as an axis (for 3.13)."""
        if self.table is not None:
            rows: Array = np.array(self.table, dtype=np.float64)
            return SpectralAxis(rows[:, 0], rows[:, 1], rows[:, 2] > 0)
        assert self.regular is not None  # noqa: S101 - the validator has seen to it
        r = self.regular
        centre = r.first_nm + r.step_nm * np.arange(r.count, dtype=np.float64)
        return SpectralAxis(centre, np.full(r.count, r.fwhm_nm))


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
    def _complete(self) -> Throughput:
        needs = {
            "value": ("cm2_sr",),
            "square-ifov": ("aperture_m", "ifov_mrad"),
            "cone": ("aperture_m", "ifov_mrad"),
            "f-number": ("f_number", "pixel_pitch_um"),
            "slit": ("f_number", "slit_width_um", "slit_height_um"),
        }[self.convention]
        lacking = [name for name in needs if getattr(self, name) is None]
        if lacking:
            raise ValueError(f"the convention {self.convention} needs {', '.join(lacking)}")
        return self

    @property
    def value_cm2_sr(self) -> float:
        """A Omega [cm2 sr] (3.14)."""
        match self.convention:
            case "value":
                return float(self.cm2_sr or 0)
            case "f-number":
                return f_number_throughput(self.f_number or 0, (self.pixel_pitch_um or 0) ** 2)
            case "slit":
                return f_number_throughput(
                    self.f_number or 0, (self.slit_width_um or 0) * (self.slit_height_um or 0)
                )
        return aperture_throughput(
            self.aperture_m or 0,
            1e-3 * (self.ifov_mrad or 0),
            obscuration=self.obscuration,
            convention=self.convention,
        )


class Arm(Model):
    """One spectrometer: its range and everything of (3.13)-(3.19) that belongs to it."""

    name: str
    range_nm: tuple[float, float]
    throughput: Throughput
    optical_transmittance: Quantity
    quantum_efficiency: Quantity
    degradation: Quantity = Quantity(value=1.0, table=None, source="assumed: no loss besides the optics")
    integration_time_s: Quantity
    fixed_noise_electrons: Quantity
    bits: int = Field(ge=1, le=32)
    full_well_electrons: Quantity | None = Field(None, description="electrons at full scale; LSB = this / 2^bits")
    saturation_radiance: Quantity | None = Field(None, description="radiance at full scale [uW cm-2 sr-1 nm-1]")
    lsb_electrons: Quantity | None = None
    bit_error_rate: Quantity = Quantity(value=0.0, table=None, source="assumed: error-free recording")
    bit_error_per: Literal["bit", "word"] = "bit"

    @model_validator(mode="after")
    def _one_scale(self) -> Arm:
        given = [self.full_well_electrons, self.saturation_radiance, self.lsb_electrons]
        if sum(g is not None for g in given) != 1:
            raise ValueError("give one of full_well_electrons, saturation_radiance, lsb_electrons")
        return self


class MeasuredNoise(Model):
    """NEdL = |a sqrt(b + L) + c| as tabulated for a sensor: rows [nm, a, b, c]."""

    table: list[tuple[float, float, float, float]] = Field(min_length=2)
    source: Source

    @model_validator(mode="after")
    def _positive(self) -> MeasuredNoise:
        if any(a <= 0 or b < 0 for _, a, b, _ in self.table):
            raise ValueError("a must be positive and b not negative")
        return self


class SensorSpecification(Model):
    """One sensor file."""

    schema_version: Literal[1] = Field(1, alias="schema")
    name: str
    title: str
    source: Source
    notes: tuple[str, ...] = ()
    bands: Bands
    arms: tuple[Arm, ...] = ()
    measured_noise: MeasuredNoise | None = None
    detector_gain: float = Field(1.0, ge=0, description="g_d of (3.16)")
    calibration_error_percent: Quantity

    @model_validator(mode="after")
    def _one_noise(self) -> SensorSpecification:
        if bool(self.arms) == (self.measured_noise is not None):
            raise ValueError("give either arms or measured_noise")
        return self


@dataclass(frozen=True)
class Sensor:
    """A sensor ready for use: its specification, and its noise on any band set."""

    specification: SensorSpecification

    @property
    def name(self) -> str:
        """Short name."""
        return self.specification.name

    @cached_property
    def axis(self) -> SpectralAxis:
        """The sensor's own bands."""
        return self.specification.bands.axis

    def noise(self, axis: SpectralAxis | None = None) -> NoiseModel:
        """The noise (3.13-3.20) on ``axis`` (default: the sensor's own bands).

        Tables are interpolated in wavelength; the electrons scale with the width of the bands of
        ``axis``, measured noise is taken to belong to the width it was measured with.

        Raises
        ------
        UsageError : a band lies outside all arms.
        """
        spec, on = self.specification, axis or self.axis
        w = on.centre_nm
        calibration = spec.calibration_error_percent.at(w)
        if spec.measured_noise is not None:
            at, a, b, c = np.array(spec.measured_noise.table, dtype=float).T
            # a^2 and b vary like the inverse of efficiency, by orders of magnitude: interpolate logarithms.
            a, c = np.exp(np.interp(w, at, np.log(a))), np.interp(w, at, c)
            b = np.exp(np.interp(w, at, np.log(np.maximum(b, 1e-12))))
            measured = (a, b, c)
            return NoiseModel(
                1.0 / a**2, np.sqrt(b) / a, spec.detector_gain, np.zeros(w.size), 1, 0.0, "bit", calibration,
                measured, tuple(self._assumptions()),
            )  # fmt: skip
        g, fixed, lsb = np.full((3, w.size), np.nan)
        arms = [self._arm_of(x) for x in w]
        for arm in spec.arms:
            here = np.array([k is arm for k in arms])
            at = w[here]
            g[here] = electrons_per_radiance(
                at,
                on.fwhm_nm[here],
                throughput_cm2_sr=arm.throughput.value_cm2_sr,
                optical_transmittance=arm.optical_transmittance.at(at),
                quantum_efficiency=arm.quantum_efficiency.at(at),
                integration_time_s=arm.integration_time_s.at(at),
                degradation=arm.degradation.at(at),
            )
            fixed[here] = arm.fixed_noise_electrons.at(at)
            if arm.lsb_electrons is not None:
                lsb[here] = arm.lsb_electrons.at(at)
            elif arm.full_well_electrons is not None:
                lsb[here] = arm.full_well_electrons.at(at) / 2.0**arm.bits
            elif arm.saturation_radiance is not None:
                lsb[here] = arm.saturation_radiance.at(at) * g[here] / 2.0**arm.bits
        rates = {(arm.bits, float(arm.bit_error_rate.at(w[:1])[0]), arm.bit_error_per) for arm in spec.arms}
        if len(rates) > 1:
            raise UsageError(
                f"sensor {self.name!r}: the arms differ in bits or bit error rate, which is not supported"
            )
        bits, rate, per = rates.pop()
        return NoiseModel(
            g, fixed, spec.detector_gain, lsb, bits, rate, per, calibration, None, tuple(self._assumptions())
        )

    def _arm_of(self, wavelength_nm: float) -> Arm:
        # An airborne cube's axis may reach a little beyond the nominal range: the nearest arm serves there.
        def gap(arm: Arm) -> float:
            return max(arm.range_nm[0] - wavelength_nm, wavelength_nm - arm.range_nm[1], 0.0)

        arm = min(self.specification.arms, key=gap)
        if gap(arm) > 50.0:
            raise UsageError(
                f"sensor {self.name!r} has no arm at {wavelength_nm:g} nm",
                expected="bands within "
                + ", ".join(f"{a.range_nm[0]:g}-{a.range_nm[1]:g} nm" for a in self.specification.arms),
            )
        return arm

    def _assumptions(self) -> list[str]:
        found = []
        for arm in self.specification.arms:
            for name in type(arm).model_fields:
                value = getattr(arm, name)
                source = getattr(value, "source", "")
                if source.lower().startswith("assumed"):
                    found.append(f"{arm.name}: {name} ({source})")
        if self.specification.calibration_error_percent.assumed:
            found.append(f"calibration_error_percent ({self.specification.calibration_error_percent.source})")
        return found


def library_names() -> tuple[str, ...]:
    """Names of the sensors that ship with the project."""
    folder = resources.files("hyperval.sensor") / "library"
    return tuple(sorted(p.name.removesuffix(".yaml") for p in folder.iterdir() if p.name.endswith(".yaml")))


def load_sensor(name_or_path: str | Path) -> Sensor:
    """A sensor of the library by name, or a sensor file by path.

    Raises
    ------
    UsageError : no such name, or an invalid file (every mistake with its line).
    InputError : no such file.
    """
    text = str(name_or_path)
    if text in library_names():
        return _library_sensor(text)
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml") and not path.exists():
        raise UsageError(f"unknown sensor {text!r}", expected="a YAML file or one of " + ", ".join(library_names()))
    return Sensor(load_model(SensorSpecification, path))


@lru_cache(maxsize=16)
def _library_sensor(name: str) -> Sensor:
    with resources.as_file(resources.files("hyperval.sensor") / "library" / f"{name}.yaml") as path:
        return Sensor(load_model(SensorSpecification, path))
