"""The filters of a collection: each detector and target on the background's statistics, in the bands they use."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.collection import Detection
from hyperval.errors import InputError, UsageError
from hyperval.executors import single_blas_thread
from hyperval.observe.place import Place
from hyperval.processing.detectors import ANOMALY_DETECTORS, WITHOUT_COVARIANCE, pixel_detector, whitener_of
from hyperval.processing.elm import EmpiricalLine
from hyperval.processing.filters import PositiveDefinite
from hyperval.processing.pixel_scores import PixelDetector, Whitener
from hyperval.processing.sample import SampleStatistics, statistics_of
from hyperval.processing.snr import snr_from_moments
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.windows import in_window

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

BACKGROUND = "detector background"
# Below this many pixels for each band a sample covariance is shrunk (Ledoit & Wolf 2004).
FEW_PIXELS_PER_BAND = 3


@dataclass(frozen=True, eq=False)
class FilterBank:
    """What scores the pixels.

    Attributes
    ----------
    detectors : by the names of the score maps
    forms : the same by the detector's name and the target's spectrum (F,), None for anomalies
    bands : (B,) those that the filters use, F of them
    whitener : of the background, where a detector needs it
    shrinkage : of the background's covariance, 0 where there were pixels enough
    """

    detectors: Mapping[str, PixelDetector]
    forms: Mapping[str, tuple[str, Array | None]]
    bands: Mask
    whitener: Whitener | None
    shrinkage: float
    notes: tuple[str, ...]


def map_name(target: str, detector: str) -> str:
    """Name of the score map of a target; anomalies have one map for all targets."""
    return detector if detector in ANOMALY_DETECTORS else f"{target}-{detector}"


def filter_bank(
    place: Place,
    detection: Detection,
    measured: Mapping[str, SampleStatistics],
    elm: EmpiricalLine | None,
    spectra: Mapping[str, Array],
) -> FilterBank:
    """Every detector for every target.

    Parameters
    ----------
    measured : statistics of the regions and of :data:`BACKGROUND` in the cube's values
    spectra : (B,) reflectance by target

    Raises
    ------
    UsageError : names that no region has, a singular background, no band left.
    """
    background, shrinkage = measured[BACKGROUND], 0.0
    bands, left_out = usable_bands(detection, place.cube.axis, list(spectra.values()), elm, background)
    notes = [f"detectors use {int(bands.sum())} of {len(place.cube.axis)} bands", *left_out]
    if background.n < FEW_PIXELS_PER_BAND * int(bands.sum()):
        # Few, so they fit in memory; the pass has not summed the fourth moment.
        few = statistics_of(_complete(place.cube.pixels(place.background(detection.background))))
        background, shrinkage = replace(background, covariance=few.shrunk_covariance), few.shrinkage
        notes.append(f"{background.n} background pixels are few: covariance shrunk by {shrinkage:.3g}")
    mean, covariance = in_reflectance(background, elm)
    for name in detection.undesired:
        place.region(name)  # refuses a name that no region has
    undesired = np.array([in_reflectance(measured[name], elm)[0][bands] for name in detection.undesired])
    detectors: dict[str, PixelDetector] = {}
    forms: dict[str, tuple[str, Array | None]] = {}
    whitener = None
    with single_blas_thread():  # small matrices: more threads only wait for each other
        inverted = None
        if not set(detection.detectors) <= set(WITHOUT_COVARIANCE):
            inverted = PositiveDefinite(covariance[np.ix_(bands, bands)])
            notes.append(f"condition number of the background matrix at unit diagonal: {inverted.condition:.3g}")
        for target in detection.targets:
            spectrum = spectra[target.name][bands]
            for name in detection.detectors:
                key = map_name(target.name, name)
                if key not in detectors:
                    forms[key] = name, None if name in ANOMALY_DETECTORS else spectrum
                    detectors[key] = pixel_detector(name, spectrum, mean[bands], inverted, undesired)
        for name in detection.detectors if not detection.targets else ():  # anomalies, which need no target
            forms[name] = name, None
            detectors[name] = pixel_detector(name, None, mean[bands], inverted, undesired)
        by_distance = any(d.quadratic == "distance" for d in detectors.values())
        if inverted is not None and (detection.local_window or by_distance):
            whitener = whitener_of(mean[bands], inverted)
    return FilterBank(detectors, forms, bands, whitener, shrinkage, tuple(notes))


def in_reflectance(statistics: SampleStatistics, elm: EmpiricalLine | None) -> tuple[Array, Array]:
    """Mean (B,) and covariance (B, B) after the empirical line; as they stand without one."""
    if elm is None:
        return statistics.mean, statistics.covariance
    return elm.reflectance(statistics.mean), statistics.covariance / np.outer(elm.gain, elm.gain)


def _complete(pixels: Array) -> Array:
    """The pixels (n, B) that are finite in every band, as the statistics of regions take them."""
    return pixels[np.isfinite(pixels).all(axis=1)]


def spectrum_by_number(path: Path, count: int) -> Array:
    """(B,) values of a text file with one row for each of ``count`` bands; the last number of a row counts.

    Raises
    ------
    InputError : a row without a number, or another number of rows.
    """
    values = []
    for number, line in enumerate(path.read_text("utf-8", errors="replace").splitlines(), start=1):
        words = line.split("#")[0].replace(",", " ").replace(";", " ").split()
        try:
            values += [float(words[-1])] if words else []
        except ValueError as error:
            raise InputError(
                "not a row of numbers", where=f"{path}:{number}", expected="a number; a heading begins with #"
            ) from error
    if len(values) != count or not np.all(np.isfinite(values)):
        raise InputError(f"{len(values)} values for {count} bands", where=str(path), expected="one row a band")
    return np.array(values)


def usable_bands(
    detection: Detection,
    axis: SpectralAxis,
    spectra: Sequence[Array],
    elm: EmpiricalLine | None,
    background: SampleStatistics,
) -> tuple[Mask, list[str]]:
    """Bands (B,) that detectors use, and the others with the first rule that leaves them out, in words.

    Parameters
    ----------
    spectra : (B,) of the targets, NaN where they are not known
    background : in the cube's own values; its noise tells the SNR of a band

    Raises
    ------
    UsageError : no band is left.
    """
    left, parts = np.ones(len(axis), bool), []
    for reason, keep in _rules(detection, axis, spectra, elm):
        parts += _words(left & ~keep, axis, reason)
        left &= keep
    if detection.least_snr is not None and np.count_nonzero(left) >= 3:
        at = np.flatnonzero(left)
        snr = snr_from_moments(background.mean[at], background.covariance[np.ix_(at, at)])
        noisy = np.zeros_like(left)
        noisy[at] = ~(snr >= detection.least_snr)
        parts += _words(noisy, axis, f"with an SNR below {detection.least_snr:g} in the background")
        left &= ~noisy
    if not left.any():
        raise UsageError(
            f"no band is left for the detectors: {'; '.join(parts)}",
            mend="look at the bad-band list, the target spectra and detection.least_snr",
        )
    return left, [f"bands that the detectors do not use: {'; '.join(parts)}"] if parts else []


def _rules(
    detection: Detection, axis: SpectralAxis, spectra: Sequence[Array], elm: EmpiricalLine | None
) -> Iterator[tuple[str, Mask]]:
    """Why bands may be left out, and which (B,) each rule keeps."""
    if detection.bands in ("good", "windows"):
        yield "bad in the band list", axis.good
    if detection.bands == "windows":
        yield "in absorption bands", np.asarray(in_window(axis.centre_nm))
    if len(spectra):
        yield "not in the target spectra", np.asarray(np.isfinite(spectra).all(axis=0))
    if elm is not None:
        yield "without a gain of the empirical line", elm.usable


def _words(lost: Mask, axis: SpectralAxis, reason: str) -> list[str]:
    at = np.flatnonzero(lost)
    if not at.size:
        return []
    runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
    ends = [sorted({f"{axis.centre_nm[r[0]]:.4g}", f"{axis.centre_nm[r[-1]]:.4g}"}, key=float) for r in runs]
    return [f"{at.size} {reason} ({', '.join('-'.join(e) for e in ends)} nm)"]
