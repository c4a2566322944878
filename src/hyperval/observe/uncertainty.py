"""What is known of the error of collected spectra, and what they say of their own wavelengths."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.collection import CalibrationUncertainty
from hyperval.prediction.inputs import correlation
from hyperval.processing.wavelength_check import Shift, wavelength_shifts
from hyperval.products import EstimatedPart, SpectralEstimate
from hyperval.sensor.specification import Sensor
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.readers import read_spectrum

Array = npt.NDArray[np.float64]


def calibration_covariance(
    radiance: npt.ArrayLike, axis: SpectralAxis, calibration: CalibrationUncertainty, resolve: Callable[[str], Path]
) -> Array:
    """Error covariance (B, B) of a radiance (B,) whose calibration is known to a relative uncertainty."""
    level = np.asarray(radiance, dtype=float)
    if calibration.relative is not None:
        relative = np.full(len(axis), calibration.relative)
    else:
        table = read_spectrum(resolve(str(calibration.file)), quantity="other", wavelength_unit="nm")
        # The table is smooth; a band of the axis outside it takes the value at its end.
        relative = np.interp(axis.centre_nm, table.wavelength_nm, table.values)
    sigma = relative * level
    by_band = calibration.file is not None and calibration.correlation_nm is None
    shape = np.eye(len(axis)) if by_band else correlation(axis, calibration.correlation_nm)
    covariance = np.outer(sigma, sigma) * shape
    if calibration.uncorrelated is not None:
        covariance[np.diag_indices(len(axis))] += (calibration.uncorrelated * level) ** 2
    return np.asarray(covariance)


def detector_covariance(radiance: npt.ArrayLike, axis: SpectralAxis, sensor: Sensor, pixels: int) -> Array:
    """Error covariance (B, B) of a mean radiance (B,) over so many pixels, by the sensor's noise without C_R."""
    level = np.clip(np.asarray(radiance, dtype=float), 0.0, None)
    return np.diag(sensor.noise(axis).variance(level, calibration=False) / pixels)


def rounding_variance(step: npt.ArrayLike, standard_deviation: npt.ArrayLike) -> Array:
    """Variance of the error that storing whole steps leaves in a mean over any number of pixels.

    Noise of a step smooths the rounding away, a panel without noise keeps all of it: normal values about x with
    standard deviation s are off by sum_k (-1)^k step/(pi k) sin(2 pi k x/step) exp(-2 pi^2 k^2 s^2/step^2) on
    average, whose mean square over x is step^2/(2 pi^2) sum_k exp(-4 pi^2 k^2 s^2/step^2)/k^2, step^2/12 without
    noise.  Source: Widrow, Kollar & Liu, IEEE Trans. Instrum. Meas. 45, 353-361, 1996.

    Parameters
    ----------
    step : of the stored values; standard_deviation : of the pixels, in the same unit
    """
    q, s = np.broadcast_arrays(np.asarray(step, dtype=float), np.asarray(standard_deviation, dtype=float))
    k = np.arange(1, 200)[:, None]
    with np.errstate(under="ignore"):
        terms = np.exp(-4.0 * np.pi**2 * k**2 * (s.ravel() / np.where(q.ravel() > 0.0, q.ravel(), 1.0)) ** 2) / k**2
    return np.asarray((q**2 / (2.0 * np.pi**2)) * terms.sum(axis=0).reshape(q.shape))


def spectral_estimate(
    mean: npt.ArrayLike,
    parts: Mapping[str, npt.NDArray[np.float64]],
    *,
    pixel_covariance: Array | None = None,
    n: int | None = None,
    estimated: Sequence[EstimatedPart] = (),
    circular: str = "",
) -> SpectralEstimate:
    """Estimate whose error covariance is the sum of independent ``parts`` (B, B), each named in the budget.

    ``estimated``: those of the parts that were estimated from samples; ``circular``: as in the estimate.
    """
    mean = np.asarray(mean, dtype=float)
    total = sum(parts.values(), np.zeros((mean.size, mean.size)))
    budget = {name: np.sqrt(np.clip(np.diag(part), 0.0, None)) for name, part in parts.items()}
    return SpectralEstimate(mean, total, pixel_covariance, n, budget, tuple(estimated), circular)


def collection_shifts(
    spectra: Iterable[npt.NDArray[np.float64]], axis: SpectralAxis, *, reflectance: bool
) -> list[tuple[Shift, int]]:
    """The median shift of every feature over spectra (B,) of one axis, and how many of them show it.

    The uncertainty is that of where the feature lies, which the spectra share: it is not divided by their number.
    Where it differs between spectra it is the median.
    """
    shifts: dict[str, list[Shift]] = {}
    for spectrum in spectra:
        for shift in wavelength_shifts(spectrum, axis, reflectance=reflectance):
            shifts.setdefault(shift.feature, []).append(shift)
    return [
        (
            Shift(name, *(float(np.median(x)) for x in ([s.nm for s in each], [s.uncertainty_nm for s in each]))),
            len(each),
        )
        for name, each in shifts.items()
    ]


def wavelength_notes(
    spectra: Iterable[npt.NDArray[np.float64]], axis: SpectralAxis, *, reflectance: bool
) -> list[str]:
    """The shifts in words, a warning for each that is certain."""
    shifts = collection_shifts(spectra, axis, reflectance=reflectance)
    if not shifts:
        feature = "an absorption of oxygen or water vapour"
        if reflectance:
            feature = "a red edge of plants or a rest of the oxygen band"
        return [f"the wavelengths could not be checked: no spectrum shows {feature}"]
    parts = [
        f"{s.feature} {s.nm:+.1f} nm (standard uncertainty {s.uncertainty_nm:.1f}, {n} spectra)" for s, n in shifts
    ]
    notes = ["wavelengths as labelled less those of known features: " + "; ".join(parts)]
    notes += [
        f"warning: the {s.feature} lies {abs(s.nm):.1f} nm (standard uncertainty {s.uncertainty_nm:.1f}) "
        f"{'above' if s.nm > 0 else 'below'} its place: the wavelengths of the collection seem to be shifted"
        for s, _ in shifts
        if s.certain
    ]
    return notes
