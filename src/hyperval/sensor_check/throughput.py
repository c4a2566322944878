"""Checks of what makes electrons of light: signs, ranges, tables, and the gain by two other routes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import constants

from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.quantities import Quantity
from hyperval.sensor.specification import Arm, Sensor
from hyperval.sensor_check.ledger import Ledger
from hyperval.sensor_check.reference import BRIGHT, DARK, sunlit_radiance
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]

PRODUCT = "throughput"
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
            PRODUCT, "bands_outside_arms", outside.size, outside.size == 0, at_most=0.0,
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
        PRODUCT, "lowest_electrons_per_radiance", lowest, positive, at_least=0.0,
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
    return ledger.gate(PRODUCT, "bands_of_arm", 0.0, False, at_least=1.0, subject=arm.name, reason="holds no band")


def _check_arm(arm: Arm, axis: SpectralAxis, ledger: Ledger) -> bool:
    ledger.gate(PRODUCT, "bands_of_arm", len(axis), True, at_least=1.0, subject=arm.name)
    sound = True
    w = axis.centre_nm
    for name, (most, zero) in _LIMITS.items():
        quantity: Quantity = getattr(arm, name)
        values = quantity.at(w)
        low, high = float(values.min()), float(values.max())
        positive = low > 0 or (zero and low == 0)
        sound &= ledger.gate(
            PRODUCT, f"lowest_{name}", low, positive, at_least=0.0, subject=arm.name,
            reason=f"{name} of arm {arm.name} is not positive at {w[int(np.argmin(values))]:g} nm",
        )  # fmt: skip
        ledger.gate(
            PRODUCT, f"highest_{name}", high, high <= most, at_most=most, subject=arm.name,
            reason=f"{name} of arm {arm.name} passes {most:g} (per cent in place of a fraction, ms in place of s?)",
        )  # fmt: skip
        if quantity.table is not None:
            ends = quantity.table[0][0], quantity.table[-1][0]
            beyond = int(np.count_nonzero((w < ends[0] - axis.fwhm_nm) | (w > ends[1] + axis.fwhm_nm)))
            ledger.gate(
                PRODUCT, f"bands_beyond_table_of_{name}", beyond, beyond == 0, at_most=0.0, subject=arm.name,
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
        PRODUCT, "gain_error_by_photon_energy", float(off[at]), bool(off[at] <= GAIN_TOLERANCE),
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
            PRODUCT, "gain_error_by_photon_transfer", reason="no band has a fit that is linear in the signal"
        )
        return
    median = float(np.median(off[linear]))
    ledger.gate(
        PRODUCT, "gain_error_by_photon_transfer", median, abs(median) <= GAIN_TOLERANCE,
        at_least=-GAIN_TOLERANCE, at_most=GAIN_TOLERANCE,
        n=int(linear.sum()),
        reason="noise grows with the signal as if the gain were another: is detector_gain meant?",
    )  # fmt: skip
