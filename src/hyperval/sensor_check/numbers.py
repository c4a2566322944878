"""The numbers of a sensor file: each with its source, and the file with some of them scaled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hyperval.errors import UsageError
from hyperval.sensor.quantities import Bands, Quantity, Throughput
from hyperval.sensor.specification import SensorSpecification
from hyperval.settings import with_settings

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
            out.append(
                Number("measured_noise.saturation_radiance", _quantity_text(full), full.source, varies=False)
            )
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
