"""Several field spectra of one surface: their mean, their spread, and how well they know the mean."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy import special

from hyperval.errors import UsageError
from hyperval.file_names import MAX_MATCHES, matching
from hyperval.processing.intervals import Z95
from hyperval.processing.sample import statistics_of
from hyperval.scenario_sources import Replicates
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.readers import FieldSpectrum, read_records
from hyperval.spectra.response import band_average, band_weights

Array = npt.NDArray[np.float64]
Resolve = Callable[[str], Path]
SAME_BAND_NM = 0.05  # centres this close are the same band
# Below this many spectra for each band the sample covariance is shrunk (Ledoit & Wolf 2004), as for pixels.
FEW_PER_BAND = 3


@dataclass(frozen=True, eq=False)
class ReplicateStatistics:
    """What n spectra of one surface say of it, in the bands; NaN where one of them does not reach.

    Attributes
    ----------
    mean : (B,) reflectance [1]
    standard_deviation : (B,) from spectrum to spectrum, divisor n - 1
    covariance : (B, B) from spectrum to spectrum, shrunk where they are few; 0 where the mean is NaN
    mean_error : (B, B) error covariance of the mean, see :func:`mean_error_covariance`
    n : spectra
    shrinkage : part of the shrunk covariance that is not the sample's, 0 without
    names : of the spectra
    """

    mean: Array
    standard_deviation: Array
    covariance: Array
    mean_error: Array
    n: int
    shrinkage: float
    names: tuple[str, ...]

    @property
    def summary(self) -> str:
        """The numbers in words."""
        few = f", covariance shrunk by {self.shrinkage:.3g}" if self.shrinkage else ""
        return f"{self.n} replicate spectra{few}"


def replicate_statistics(
    source: Replicates, axis: SpectralAxis, resolve: Resolve, nominal: SpectralAxis | None = None
) -> ReplicateStatistics:
    """Mean, covariance and number of the spectra that ``source`` names, in the bands of ``axis``.

    ``nominal`` are the bands as they are labelled, where they are others (:func:`in_bands`).

    Raises
    ------
    InputError : missing or corrupt files.
    UsageError : fewer than two spectra, records that no file has, or spectra that share no band.
    """
    spectra = replicate_spectra(source, resolve)
    return statistics_in_bands(spectra, axis, ", ".join(source.references), nominal)


def statistics_in_bands(
    spectra: Sequence[FieldSpectrum], axis: SpectralAxis, where: str, nominal: SpectralAxis | None = None
) -> ReplicateStatistics:
    """Statistics of spectra, each averaged over the bands first."""
    if len(spectra) < 2:
        raise UsageError(
            "a single spectrum has no spread", where=where, expected="two or more replicates", mend="use file:"
        )
    values = np.array([in_bands(s.wavelength_nm, s.values, axis, nominal) for s in spectra])
    known = np.all(np.isfinite(values), axis=0)
    if not known.any():
        raise UsageError(
            "the replicates share none of the bands",
            where=where,
            expected=f"samples between {axis.centre_nm[0]:g} and {axis.centre_nm[-1]:g} nm",
        )
    sample = statistics_of(values[:, known])
    few = sample.n < FEW_PER_BAND * int(known.sum())
    at = np.ix_(known, known)
    mean, deviation = np.full(len(axis), np.nan), np.full(len(axis), np.nan)
    covariance, error = np.zeros((len(axis), len(axis))), np.zeros((len(axis), len(axis)))
    mean[known], deviation[known] = sample.mean, np.sqrt(np.diag(sample.covariance))
    covariance[at] = sample.shrunk_covariance if few else sample.covariance
    error[at] = mean_error_covariance(sample.covariance, sample.n)
    names = tuple(s.name for s in spectra)
    shrinkage = sample.shrinkage if few else 0.0
    return ReplicateStatistics(mean, deviation, covariance, error, sample.n, shrinkage, names)


def mean_error_covariance(covariance: Array, n: int) -> Array:
    """(t/1.96)^2 S/n with t the 97.5 % point of Student's t with n - 1 degrees of freedom [unit of S].

    Few spectra know their own spread badly; with this +-1.96 u is the 95 % interval of the mean.
    Source: JCGM 100:2008 (GUM), 4.2.3 and G.3.
    """
    wider = float(special.stdtrit(n - 1, 0.975)) / Z95
    return np.asarray(wider**2 * covariance / n)


def replicate_spectra(source: Replicates, resolve: Resolve) -> list[FieldSpectrum]:
    """The spectra that ``source`` names, file by file in the order of the list, by name within a pattern."""
    out: list[FieldSpectrum] = []
    for reference in source.references:
        path = resolve(reference)
        files = matching(path) or [path]  # a file that is missing is the reader's to report
        if len(files) > MAX_MATCHES:
            raise UsageError(f"more than {MAX_MATCHES} files match", where=reference)
        for file in files:
            out += read_records(
                file,
                records=source.records,
                wavelength_unit=source.wavelength_unit,
                reflectance_unit=source.reflectance_unit,
            )
    if source.records is not None:
        for wanted in source.records:
            if isinstance(wanted, str) and all(s.name != wanted for s in out):
                raise UsageError(f"no spectrum {wanted!r}", where=", ".join(source.references))
    return out


def in_bands(wavelength_nm: Array, values: Array, axis: SpectralAxis, nominal: SpectralAxis | None = None) -> Array:
    """(B,) values in the bands: as they stand where they are sampled at the bands' centres, else band averages.

    A library at the sensor's own bands, or at some of them, was convolved when it was made; a second time would
    smooth it and lose its first and last bands. NaN in bands that the samples do not cover. Where the samples
    stand at the bands as they are labelled (``nominal``) but those truly stand elsewhere, a cubic spline leads
    from one to the other.
    """
    if _are_centres(wavelength_nm, axis):
        return np.array(values, dtype=float)
    some = _some_centres(wavelength_nm, axis)
    if some is not None:
        out = np.full(len(axis), np.nan)
        out[some] = values
        return out
    known = np.isfinite(values)
    if known.sum() < 2:
        return np.full(len(axis), np.nan)
    if nominal is not None and _are_centres(wavelength_nm, nominal):
        from scipy.interpolate import CubicSpline  # 10 MB

        at = np.clip(axis.centre_nm, wavelength_nm[known][0], wavelength_nm[known][-1])
        moved = CubicSpline(wavelength_nm[known], values[known])(at)
        return np.where(known, moved, np.nan)
    return band_average(wavelength_nm[known], values[known], axis, outside="nan")


def covariance_in_bands(wavelength_nm: Array, covariance: Array, axis: SpectralAxis) -> Array:
    """(B, B) error covariance of band averages from that of samples (n, n); 0 in bands they do not cover."""
    if _are_centres(wavelength_nm, axis):
        return covariance
    from scipy import sparse  # a band has a part in few of the samples

    weights, short = band_weights(wavelength_nm, axis)
    few = sparse.csr_array(np.where(short[:, None], 0.0, weights))
    return np.asarray((few @ (few @ covariance).T).T)


def band_error_covariance(
    wavelength_nm: Array, standard_deviation: Array, correlation_nm: float, axis: SpectralAxis
) -> Array:
    """(B, B) covariance in the bands of an error of standard deviation (n,) and correlation length at its samples.

    Of C_kl = u_k u_l exp(-(dl / length)^2 / 2): errors that are each sample's own partly cancel within a band,
    which the band average of their standard deviation alone does not know.
    """
    u = np.nan_to_num(standard_deviation)
    covariance = (wavelength_nm[:, None] - wavelength_nm) / correlation_nm
    covariance *= -0.5 * covariance  # in place, as a spectrometer's samples are thousands
    np.maximum(covariance, -100.0, out=covariance)  # nothing is left there, and what float64 cannot hold is slow
    np.exp(covariance, out=covariance)
    covariance *= u
    covariance *= u[:, None]
    return covariance_in_bands(wavelength_nm, covariance, axis)


def _some_centres(wavelength_nm: Array, axis: SpectralAxis) -> npt.NDArray[np.intp] | None:
    """Bands at whose centres the samples stand, where each stands at one of its own; None otherwise."""
    if not 1 < wavelength_nm.size < len(axis):
        return None
    nearest = np.argmin(np.abs(wavelength_nm[:, None] - axis.centre_nm), axis=1)
    apart = np.abs(axis.centre_nm[nearest] - wavelength_nm)
    return nearest if np.all(apart <= SAME_BAND_NM) and np.unique(nearest).size == nearest.size else None


def _are_centres(wavelength_nm: Array, axis: SpectralAxis) -> bool:
    return wavelength_nm.size == len(axis) and bool(np.all(np.abs(wavelength_nm - axis.centre_nm) <= SAME_BAND_NM))
