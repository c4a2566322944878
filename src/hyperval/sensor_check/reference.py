"""Reference radiances: sunlit ground, the scenes of publications; and published ratios against computed ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms, atmospheric_terms
from hyperval.atmosphere.solar import extraterrestrial_irradiance
from hyperval.sensor.published import PublishedSnr, ReferenceScene
from hyperval.sensor.specification import Sensor
from hyperval.sensor_check.ledger import Ledger
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.response import band_average

Array = npt.NDArray[np.float64]
Engine = Callable[[AtmosphericState], AtmosphericTerms]

DARK, MIDDLE, BRIGHT = 0.05, 0.25, 0.60
LEVELS = (DARK, MIDDLE, BRIGHT)
SUN_ZENITH_DEG = 45.0
_GRID_NM = np.arange(300.0, 2700.5, 1.0)


def sunlit_radiance(axis: SpectralAxis, reflectance: float) -> Array:
    """rho E0 cos(45 deg) / pi (B,) [uW cm-2 sr-1 nm-1]: a diffuse ground in the sun, no atmosphere.

    E0 is the extraterrestrial irradiance of ASTM G173 at 1 au, averaged over each band.
    """
    irradiance = band_average(_GRID_NM, extraterrestrial_irradiance("astm-g173", _GRID_NM), axis)
    return np.asarray(reflectance * irradiance * np.cos(np.radians(SUN_ZENITH_DEG)) / np.pi)


def scene_radiance(axis: SpectralAxis, scene: ReferenceScene, engine: Engine | None = None) -> Array:
    """Radiance (B,) [uW cm-2 sr-1 nm-1] of a uniform ground: L_a + (A + B) rho / (1 - S rho) (3.7)."""
    state = AtmosphericState.model_validate(
        {
            "model": scene.model,
            "aerosol": "rural",
            "meteorological_range_km": scene.meteorological_range_km,
            "ground_altitude_km": scene.ground_altitude_km,
            "sensor_altitude_km": scene.sensor_altitude_km,
            "solar_zenith_deg": scene.solar_zenith_deg,
            "solar_azimuth_deg": 180.0,
            "earth_sun_distance_au": 1.0,
        }
    )
    terms = (engine or atmospheric_terms)(state).at_bands(axis)
    rho = scene.reflectance
    return np.asarray(
        terms.path_radiance + (terms.direct + terms.adjacency) * rho / (1.0 - terms.spherical_albedo * rho)
    )


def published_radiance(axis: SpectralAxis, item: PublishedSnr, engine: Engine | None = None) -> Array:
    """Radiance (B,) that a published ratio refers to; that of ground of 0.25 where it does not say."""
    if item.radiance is not None:
        return item.radiance.at(axis.centre_nm)
    if item.scene is not None:
        return scene_radiance(axis, item.scene, engine)
    return sunlit_radiance(axis, MIDDLE)


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
