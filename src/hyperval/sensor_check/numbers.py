"""The numbers of a sensor file: each with its source, and the file with some of them scaled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hyperval.errors import UsageError
from hyperval.sensor.quantities import Bands, Quantity, Throughput
from hyperval.sensor.specification import Arm, SensorSpecification

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
    update: dict[str, object] = {"arms": tuple(_scaled_arm(arm, factors) for arm in spec.arms)}
    if (factor := factors.get("calibration_error_percent")) is not None:
        update["calibration_error_percent"] = _scaled_quantity(spec.calibration_error_percent, factor)
    if (factor := factors.get("bands.fwhm")) is not None:
        update["bands"] = _scaled_bands(spec.bands, factor)
    return spec.model_copy(update=update)


def _scaled_arm(arm: Arm, factors: Mapping[str, float]) -> Arm:
    update: dict[str, object] = {}
    if (factor := factors.get(f"{arm.name}.throughput")) is not None:
        value = factor * arm.throughput.value_cm2_sr
        update["throughput"] = Throughput.model_validate(
            {"convention": "value", "cm2_sr": value, "source": arm.throughput.source}
        )
    for name in ARM_QUANTITIES:
        if (factor := factors.get(f"{arm.name}.{name}")) is not None:
            update[name] = _scaled_quantity(getattr(arm, name), factor)
    return arm.model_copy(update=update)


def _scaled_quantity(quantity: Quantity, factor: float) -> Quantity:
    if quantity.table is None:
        return quantity.model_copy(update={"value": factor * float(quantity.value or 0.0)})
    return quantity.model_copy(update={"table": [(w, factor * v) for w, v in quantity.table]})


def _scaled_bands(bands: Bands, factor: float) -> Bands:
    if bands.table is not None:
        return bands.model_copy(update={"table": [(w, factor * f, good) for w, f, good in bands.table]})
    if bands.parts is not None:
        parts = [p.model_copy(update={"fwhm_nm": factor * p.fwhm_nm}) for p in bands.parts]
        return bands.model_copy(update={"parts": parts})
    assert bands.regular is not None  # noqa: S101 - the validator has seen to it
    part = bands.regular.model_copy(update={"fwhm_nm": factor * bands.regular.fwhm_nm})
    return bands.model_copy(update={"regular": part})


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
