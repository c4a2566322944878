"""From the sources a scenario names to arrays on the axis.

Several field spectra of one surface: their mean, their spread, and how well they know the mean.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import special

from hyperval.data import ClassStatistics, Components, statistics_of
from hyperval.errors import UsageError
from hyperval.model.intervals import Z95
from hyperval.paths import MAX_MATCHES, matching
from hyperval.scenario import BackgroundClass, CovarianceSource, Replicates, SpectrumSource, Surface
from hyperval.spectra import FieldSpectrum, read_records
from hyperval.spectra.axis import SpectralAxis, band_average, band_weights
from hyperval.statistics_library import builtin_class

Array = npt.NDArray[np.float64]
Resolve = Callable[[str], Path]
SAME_BAND_NM = 0.05  # centres this close are the same band
# Below this many spectra for each band the sample covariance is shrunk (Ledoit & Wolf 2004), as for pixels.
FEW_PER_BAND = 3


@dataclass(frozen=True)
class SurfaceStatistics:
    """A surface on the axis; bands that its source does not cover are NaN in ``mean``.

    Attributes
    ----------
    mean : (B,) reflectance [1]
    covariance : (B, B), zero where nothing is known of the spread
    standard_deviation : (B,) that a spectrum's file carries, None without
    components : the clusters that the pixels of a class fall into, None where they are one law
    fine_texture : part of a target's covariance whose texture is finer than its part of a pixel, and averages out
        over it [1]
    sampled_deviation : (n,) wavelengths [nm] and the same standard deviations as the file has them
    n : samples behind it
    mean_error : (B, B) error covariance of the mean that replicate spectra give, None without
    """

    name: str
    mean: Array
    covariance: Array
    source: str
    tail_dof: float | None = None
    standard_deviation: Array | None = None
    n: int | None = None
    mean_error: Array | None = None
    sampled_deviation: tuple[Array, Array] | None = None
    components: Components | None = None
    fine_texture: float = 0.0


def replicate_statistics(
    source: Replicates, axis: SpectralAxis, resolve: Resolve, nominal: SpectralAxis | None = None
) -> SurfaceStatistics:
    """Mean, covariance and number of the spectra that ``source`` names, in the bands of ``axis``.

    ``nominal`` are the bands as they are labelled, where they are others (:func:`in_bands`).

    Raises
    ------
    InputError : missing or corrupt files.
    UsageError : fewer than two spectra, records that no file has, or spectra that share no band.
    """
    spectra, where = replicate_spectra(source, resolve), ", ".join(source.references)
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
    words = f"{sample.n} replicate spectra" + (f", covariance shrunk by {sample.shrinkage:.3g}" if few else "")
    return SurfaceStatistics("", mean, covariance, words, None, deviation, sample.n, error)


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


Read = dict[object, Any]  # spectra of files, by the file and how it is read


def class_tail(c: BackgroundClass, surface: SurfaceStatistics) -> float | None:
    """Degrees of freedom of a class; None = Gaussian.

    A tail that was fitted to a region of the collection counts where the class says ``tail_dof: measured``.
    """
    if c.tail_dof == "measured":
        return surface.tail_dof
    from_region = c.spectrum.measured if c.covariance is None else c.covariance.measured
    if c.tail_dof is None and from_region is not None:
        return None
    return c.tail_dof or surface.tail_dof


@dataclass(frozen=True)
class Sources:
    """Where spectra come from: the axis, statistics handed in, and how file names become paths.

    ``nominal`` are the bands as they are labelled, where they are not those of ``axis`` (a shifted spectrometer);
    what was measured stands on them.  ``read`` holds the spectra of files that were read before.
    """

    axis: SpectralAxis
    measured: Mapping[str, ClassStatistics]
    resolve: Resolve
    nominal: SpectralAxis | None = None
    read: Read = field(default_factory=dict, repr=False, compare=False)

    def surface(self, surface: Surface) -> SurfaceStatistics:
        """Mean and covariance of one surface of the scene (rho_m, Sigma_m of 3.8-3.12).

        Raises
        ------
        UsageError : unknown built-in, or a measured region that was not handed in.
        """
        base = self.spectrum(surface.spectrum, surface.name)
        if surface.covariance is None:
            if surface.spectrum.measured is not None:
                _refuse_single(base.n, surface.spectrum.measured, surface.name)
        else:
            # Tails are those of the pixels that the covariance is of; a stated spread has none of its own.
            base = self._spread(surface.covariance, base, surface.name)
        return replace(base, components=_components(surface, base.components))

    def spectrum(self, source: SpectrumSource, name: str) -> SurfaceStatistics:
        """The statistics that a spectrum source brings along."""
        bands = len(self.axis)
        if source.builtin is not None:
            made = builtin_class(source.builtin, self.axis)
            return SurfaceStatistics(name, made.mean, made.covariance, made.source)
        if source.constant is not None:
            flat = np.full(bands, source.constant)
            return SurfaceStatistics(name, flat, np.zeros((bands, bands)), "constant reflectance")
        if source.measured is not None or source.library is not None:
            if source.library is not None:
                known = self._library(source.library, source.record, name, "spectrum")
            else:
                known = self._measured(str(source.measured), name)
            return SurfaceStatistics(
                name, known.mean, known.covariance, known.source or source.library or "measured", known.tail_dof, None,
                known.n, components=known.components,
            )  # fmt: skip
        if source.replicates is not None:
            return replace(self._replicates(source.replicates, name), name=name)
        return self._from_file(source, name)

    def _replicates(self, source: Replicates, name: str) -> SurfaceStatistics:
        try:
            return replicate_statistics(source, self.axis, self.resolve, self.nominal)
        except UsageError as error:
            where = f"replicates of {name!r}: " + (error.where or "")
            raise UsageError(error.what, where=where, expected=error.expected, mend=error.mend) from error

    def _library(self, file: str, record: str | int | None, name: str, key: str) -> ClassStatistics:
        from hyperval.statistics_library import on_bands, read_statistics_library

        try:
            asked = (self.resolve(file), record)
            if asked not in self.read:
                self.read[asked] = read_statistics_library(asked[0], None if record is None else str(record))
            return on_bands(self.read[asked], self.axis)
        except UsageError as error:
            where = f"{key}.library of {name!r}: " + (error.where or file)
            raise UsageError(error.what, where=where, expected=error.expected, mend=error.mend) from error

    def _from_file(self, source: SpectrumSource, name: str) -> SurfaceStatistics:
        from hyperval.spectra import read_spectrum

        path = self.resolve(str(source.file))
        how = {k: getattr(source, k) for k in ("record", "wavelength_unit", "reflectance_unit")}
        key = (path, *how.values())
        if key not in self.read:
            self.read[key] = read_spectrum(path, **how)
        read = self.read[key]
        mean = in_bands(read.wavelength_nm, read.values, self.axis, self.nominal)
        if not np.any(np.isfinite(mean)):
            raise UsageError(
                f"the spectrum of {name!r} ({source.file}) covers none of the bands",
                expected=f"samples between {self.axis.centre_nm[0]:g} and {self.axis.centre_nm[-1]:g} nm",
            )
        spread, sampled = None, None
        if read.standard_deviation is not None:
            spread = in_bands(read.wavelength_nm, read.standard_deviation, self.axis, self.nominal)
            sampled = read.wavelength_nm, read.standard_deviation
        zero = np.zeros((len(self.axis), len(self.axis)))
        errors = None
        if read.errors is not None:  # as the file states them; an entry of the scenario's stands in their place
            errors = covariance_in_bands(read.wavelength_nm, read.errors.covariance(), self.axis)
        return SurfaceStatistics(name, mean, zero, str(source.file), None, spread, read.n, errors, sampled)

    def _measured(self, region: str, name: str) -> ClassStatistics:
        if region not in self.measured:
            raise UsageError(
                f"{name!r} takes the measured statistics of region {region!r}, which were not handed in",
                expected="one of " + ", ".join(self.measured)
                if self.measured
                else "a region of a collection in reflectance, or in radiance with an empirical_line",
                mend="run it from a campaign whose collection has that region "
                f"(such as collection.regions: [{{name: {region}, whole_image: true}}]), or name another spectrum",
            )
        estimate = self.measured[region]
        if not estimate.axis.matches(self.nominal or self.axis):
            raise UsageError(f"the statistics of region {region!r} do not stand on the bands of the prediction")
        return estimate

    def _spread(self, source: CovarianceSource, base: SurfaceStatistics, name: str) -> SurfaceStatistics:
        """The surface with another covariance, the tails and the components of the pixels that it is of."""
        if source.replicates is not None:
            return replace(base, covariance=self._replicates(source.replicates, name).covariance)
        if source.builtin is not None:
            pixels = builtin_class(source.builtin, self.axis)
        elif source.library is not None:
            pixels = self._library(source.library, source.record, name, "covariance")
        elif source.measured is not None:
            pixels = self._measured(source.measured, name)
            _refuse_single(pixels.n, source.measured, name)
        else:
            sd = (source.relative_sd or 0.0) * np.nan_to_num(base.mean)
            stated = np.outer(sd, sd) * correlation(self.axis, source.correlation_nm)
            return replace(base, covariance=stated + source.band_sd**2 * np.eye(sd.size))
        return replace(base, covariance=pixels.covariance, tail_dof=pixels.tail_dof, components=pixels.components)


def _components(surface: Surface, stored: Components | None) -> Components | None:
    """The components that a class asks for, of those that its source has."""
    if not isinstance(surface, BackgroundClass) or not surface.has_mixture:
        return None
    if surface.mixture == "auto":  # one law is an answer too
        return stored
    if stored is None or len(stored) != surface.mixture:
        raise UsageError(
            f"mixture of {surface.name!r}: {surface.mixture} components are asked for, its source has "
            f"{'none' if stored is None else len(stored)}",
            expected="a region of a campaign's collection, or a statistics library with so many components",
            mend="run it from a campaign, or write mixture: auto to take what is there",
        )
    return stored


def _refuse_single(n: int | None, region: str, name: str) -> None:
    if n is not None and n < 2:
        raise UsageError(
            f"the region {region!r} is a single pixel: the spread of {name!r} is not known from it",
            expected="a region of two pixels or more, or a covariance",
            mend="state covariance of the surface, such as covariance: {relative_sd: 0.05}, or enlarge the region",
        )


def correlation(axis: SpectralAxis, length_nm: float | None) -> Array:
    """(B, B) correlation exp(-(dl / length)^2 / 2) between bands; 1 everywhere when the length is None."""
    if length_nm is None:
        return np.ones((len(axis), len(axis)))
    gap = axis.centre_nm[:, None] - axis.centre_nm[None, :]
    return np.asarray(np.exp(-0.5 * (gap / length_nm) ** 2))


def cut(covariance: Array | None, bands: npt.NDArray[np.intp]) -> Array:
    """The rows and columns ``bands`` of a covariance; the matrix itself where they are all of it."""
    if covariance is None:
        raise ValueError("no covariance to cut")
    return covariance if bands.size == covariance.shape[0] else covariance[np.ix_(bands, bands)]


def without_gaps(values: Array) -> Array:
    """(B,) with NaN replaced by the nearest known values: for the scene average alone."""
    known = np.isfinite(values)
    if known.all():
        return values
    at = np.arange(values.size)
    return np.interp(at, at[known], values[known])
