"""Checks of the bands: order, widths against spacing, gaps, and the response as it is applied."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.sensor.specification import Sensor
from hyperval.sensor_check.ledger import Ledger
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
        unit="FWHM", band_nm=np.nan,
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
