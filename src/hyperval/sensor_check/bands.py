"""Checks of bands (order, widths, gaps, responses as applied) and of what makes electrons of light."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import constants

from hyperval.errors import UsageError
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.quantities import Quantity
from hyperval.sensor.specification import Arm, Sensor
from hyperval.sensor_check.ledger import Ledger
from hyperval.sensor_check.noise import BRIGHT, DARK, sunlit_radiance
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.response import CUT_SIGMA, SIGMA_PER_FWHM, band_average

Array = npt.NDArray[np.float64]

PRODUCT = "response"
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
        ledger.gate(PRODUCT, "bands_out_of_order", max(wrong, 1), False, at_most=0.0, reason=error.what)
        if narrow:
            ledger.gate(PRODUCT, "bands_without_width", narrow, False, at_most=0.0, reason=error.what)
        return None
    ledger.gate(PRODUCT, "bands_out_of_order", 0.0, True, at_most=0.0)
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
    ledger.info(PRODUCT, "bands", len(axis), reason=f"{int(axis.good.sum())} of them good")
    ledger.info(PRODUCT, "first_band", axis.centre_nm[0], unit="nm")
    ledger.info(PRODUCT, "last_band", axis.centre_nm[-1], unit="nm")
    if len(axis) < 2:
        return
    middle = 0.5 * (axis.centre_nm[:-1] + axis.centre_nm[1:])
    counts = np.ones(middle.size, bool)
    for gap in bands.gaps:
        counts &= ~((middle >= gap.range_nm[0]) & (middle <= gap.range_nm[1]))
    if bands.spacing == "separate" or not counts.any():
        ledger.info(PRODUCT, "fwhm_over_spacing_median", float(np.median(neighbour_ratio(axis))),
                    reason="the bands of this sensor stand apart")  # fmt: skip
        return
    ratio = float(np.median(neighbour_ratio(axis)[counts]))
    ledger.gate(
        PRODUCT, "fwhm_over_spacing_median", ratio, NARROWEST <= ratio <= WIDEST,
        at_least=NARROWEST, at_most=WIDEST,
        reason=f"outside {NARROWEST:g} to {WIDEST:g}: is sigma given for FWHM, half widths for full, or nm for um?",
    )  # fmt: skip
    unseen = np.where(counts, unseen_widths(axis), -np.inf)
    at = int(np.argmax(unseen))
    ledger.gate(
        PRODUCT, "widest_gap_fwhm", float(unseen[at]), unseen[at] <= WIDEST_GAP, at_most=WIDEST_GAP,
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
            PRODUCT, metric, float(values[at]), bool(values[at] <= limit), at_most=limit, unit=unit,
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
    return ledger.gate(
        "throughput", "bands_of_arm", 0.0, False, at_least=1.0, subject=arm.name, reason="holds no band"
    )


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
