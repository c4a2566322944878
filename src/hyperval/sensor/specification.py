"""Sensor files: every number stands with its source, or with the word "assumed"."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import resources
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from hyperval.config import Model, load_model
from hyperval.errors import UsageError, reader
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.operation import SensorOperation, averaged_noise
from hyperval.sensor.published import KnownDiscrepancy, PublishedSnr
from hyperval.sensor.quantities import Bands, Blur, Quantity, Source, SpectralShift, Throughput
from hyperval.sensor.response import electrons_per_radiance
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]


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
    bits_source: Source | None = Field(None, description="where the number of bits is from")
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
    saturation_radiance: Quantity | None = Field(None, description="radiance at full scale [uW cm-2 sr-1 nm-1]")
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
    psf: Blur | None = None
    spectral_calibration: tuple[SpectralShift, ...] = ()
    calibration_error_percent: Quantity
    published_snr: tuple[PublishedSnr, ...] = Field((), description="what `hyperval sensor check` compares with")
    known_discrepancies: tuple[KnownDiscrepancy, ...] = ()

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

    def true_axis(self, nominal: SpectralAxis, operation: SensorOperation | None = None) -> SpectralAxis:
        """The bands where they truly stand: nominal centres, the file's spectral calibration and the shift stated.

        Raises
        ------
        UsageError : a column outside the track, an arm that the sensor does not have, bands that change places.
        """
        op = operation or SensorOperation()
        shift = np.zeros(len(nominal))
        for item in self.specification.spectral_calibration:
            low, high = item.range_nm or (0.0, np.inf)
            try:
                shift[(nominal.centre_nm >= low) & (nominal.centre_nm <= high)] += item.at(op.column)
            except ValueError as error:
                raise UsageError(f"sensor_operation.column: {error}") from error
        if isinstance(op.wavelength_shift_nm, dict):
            names = [a.name for a in self.specification.arms]
            for name, value in op.wavelength_shift_nm.items():
                if name not in names:
                    raise UsageError(
                        f"sensor_operation.wavelength_shift_nm: sensor {self.name!r} has no arm {name!r}",
                        expected="one of " + (", ".join(names) or "none: give one number"),
                    )
                shift[self.arm_index(nominal.centre_nm) == names.index(name)] += value
        else:
            shift += op.wavelength_shift_nm
        if not np.any(shift):
            return nominal
        return SpectralAxis(nominal.centre_nm + shift, nominal.fwhm_nm, nominal.good)

    def noise(self, axis: SpectralAxis | None = None, operation: SensorOperation | None = None) -> NoiseModel:
        """The noise (3.13-3.20) on ``axis`` (default: the sensor's own bands), frames and pixels averaged.

        Tables are interpolated in wavelength; the electrons scale with the width of the bands of
        ``axis``, measured noise is taken to belong to the width it was measured with.

        Raises
        ------
        UsageError : a band lies outside all arms.
        """
        spec, on = self.specification, axis or self.axis
        w = on.centre_nm
        calibration = spec.calibration_error_percent.at(w)
        model = self._measured_noise(w, calibration) if spec.measured_noise else self._noise(on, calibration)
        return model if operation is None else averaged_noise(model, operation)

    def _measured_noise(self, w: Array, calibration: Array) -> NoiseModel:
        given = self.specification.measured_noise
        assert given is not None  # noqa: S101 - the caller has asked
        at, a, b, c = np.array(given.table, dtype=float).T
        # a^2 and b vary like the inverse of efficiency, by orders of magnitude: interpolate logarithms.
        a, c = np.exp(np.interp(w, at, np.log(a))), np.interp(w, at, c)
        b = np.exp(np.interp(w, at, np.log(np.maximum(b, 1e-12))))
        full = given.saturation_radiance.at(w) if given.saturation_radiance else None
        return NoiseModel(
            1.0 / a**2, np.sqrt(b) / a, self.specification.detector_gain, np.zeros(w.size), 1, 0.0, "bit",
            calibration, (a, b, c), tuple(self._assumptions()), full,
        )  # fmt: skip

    def _noise(self, on: SpectralAxis, calibration: Array) -> NoiseModel:
        spec, w = self.specification, on.centre_nm
        g, fixed, lsb, rate = np.full((4, w.size), np.nan)
        bits = np.zeros(w.size, dtype=int)
        arms = self.arm_index(w)
        # Arms that count errors by word are brought to errors by bit when others count by bit.
        same = len({arm.bit_error_per for arm in spec.arms}) == 1
        for k, arm in enumerate(spec.arms):
            here = arms == k
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
            bits[here] = arm.bits
            spread = 1 if same or arm.bit_error_per == "bit" else arm.bits
            rate[here] = arm.bit_error_rate.at(at) / spread
        return NoiseModel(
            g, fixed, spec.detector_gain, lsb,
            int(bits[0]) if np.all(bits == bits[0]) else bits,
            float(rate[0]) if np.all(rate == rate[0]) else rate,
            spec.arms[0].bit_error_per if same else "bit",
            calibration, None, tuple(self._assumptions()), lsb * 2.0**bits / g,
        )  # fmt: skip

    def arm_index(self, wavelength_nm: Array) -> npt.NDArray[np.intp]:
        """Number of the arm (B,) that sees each wavelength (B,); UsageError for one far outside all arms."""
        # An airborne cube's axis may reach a little beyond the nominal range: the nearest arm serves there.
        ranges = np.array([a.range_nm for a in self.specification.arms])
        gap = np.maximum(ranges[:, :1] - wavelength_nm, wavelength_nm - ranges[:, 1:]).clip(0.0)
        if np.any(far := gap.min(axis=0) > 50.0):
            raise UsageError(
                f"sensor {self.name!r} has no arm at {wavelength_nm[far][0]:g} nm",
                expected="bands within "
                + ", ".join(f"{a.range_nm[0]:g}-{a.range_nm[1]:g} nm" for a in self.specification.arms),
            )
        return np.asarray(gap.argmin(axis=0))

    def _assumptions(self) -> list[str]:
        assumptions = []
        for arm in self.specification.arms:
            for name in type(arm).model_fields:
                value = getattr(arm, name)
                source = getattr(value, "source", "")
                if source.lower().startswith("assumed"):
                    assumptions.append(f"{arm.name}: {name} ({source})")
        if self.specification.calibration_error_percent.assumed:
            assumptions.append(f"calibration_error_percent ({self.specification.calibration_error_percent.source})")
        return assumptions


def library_names() -> tuple[str, ...]:
    """Names of the sensors that ship with the project."""
    folder = resources.files("hyperval.sensor") / "library"
    return tuple(sorted(p.name.removesuffix(".yaml") for p in folder.iterdir() if p.name.endswith(".yaml")))


@reader
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
