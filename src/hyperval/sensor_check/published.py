"""Computed against published signal-to-noise ratios, each at the radiance that the publication refers to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hyperval.sensor.published import PublishedSnr
from hyperval.sensor.specification import Sensor
from hyperval.sensor_check.ledger import Ledger
from hyperval.sensor_check.reference import Engine, published_radiance
from hyperval.spectra.axis import SpectralAxis

PRODUCT = "published_snr"
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


def check_published(
    sensor: Sensor, axis: SpectralAxis, ledger: Ledger, engine: Engine | None = None
) -> list[SnrPoint]:
    """Compare every published ratio; the points for the figure.

    Examples
    --------
    >>> from hyperval.sensor.specification import load_sensor
    >>> ledger, sensor = Ledger("hymap"), load_sensor("hymap")
    >>> points = check_published(sensor, sensor.axis, ledger)
    >>> [(r.metric, round(r.value, 2)) for r in ledger.table]
    [('computed_over_published', 1.78), ('computed_over_published', 1.76), ('computed_over_published', 1.28),
    ('computed_over_published', 1.51), ('computed_over_published', 1.04)]
    """
    points: list[SnrPoint] = []
    for item in sensor.specification.published_snr:
        level = published_radiance(axis, item, engine)
        snr = sensor.noise().snr(level, calibration=False)
        for wavelength, published in item.table:
            at = int(np.argmin(np.abs(axis.centre_nm - wavelength)))
            subject = f"{wavelength:g} nm"
            if abs(axis.centre_nm[at] - wavelength) > axis.fwhm_nm[at]:
                ledger.gate(PRODUCT, "computed_over_published", np.nan, False, subject=subject,
                            reason=f"no band within a width of {wavelength:g} nm")  # fmt: skip
                continue
            points.append(SnrPoint(wavelength, published, float(snr[at]), float(level[at]), item))
    for point in points:
        _row(point, ledger)
    if not sensor.specification.published_snr:
        ledger.info(PRODUCT, "computed_over_published", reason="the file holds no published ratio to compare with")
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
        ledger.info(PRODUCT, metric, ratio, subject=subject, reason=words)
        return
    passes = ratio >= 1.0 if bound else abs(ratio - 1.0) <= TOLERANCE
    low, high = (1.0, np.nan) if bound else (1.0 - TOLERANCE, 1.0 + TOLERANCE)
    ledger.gate(
        PRODUCT, metric, ratio, passes, at_least=low, at_most=high, subject=subject, reason=words, remark=words
    )
