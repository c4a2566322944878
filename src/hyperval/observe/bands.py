"""Which bands detectors use, by rules that are told."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.collection import Detection
from hyperval.errors import InputError, UsageError
from hyperval.processing.elm import EmpiricalLine
from hyperval.processing.sample import SampleStatistics
from hyperval.processing.snr import snr_from_moments
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.windows import in_window

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


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
