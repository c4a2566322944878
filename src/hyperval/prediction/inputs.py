"""From the sources a scenario names to arrays on the axis."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.prediction.replicates import (
    ReplicateStatistics,
    covariance_in_bands,
    in_bands,
    replicate_statistics,
)
from hyperval.scenario import BackgroundClass, CovarianceSource, SpectrumSource, Surface
from hyperval.scenario_sources import Replicates
from hyperval.scene.builtin import builtin_class
from hyperval.scene.components import Components
from hyperval.scene.statistics import ClassStatistics
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Resolve = Callable[[str], Path]
Read = dict[object, Any]  # spectra of files, by the file and how it is read


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
        if source.measured is not None:
            known = self._measured(source.measured, name)
            return SurfaceStatistics(
                name, known.mean, known.covariance, known.source or "measured", known.tail_dof, None, known.n,
                components=known.components,
            )  # fmt: skip
        if source.constant is not None:
            flat = np.full(bands, source.constant)
            return SurfaceStatistics(name, flat, np.zeros((bands, bands)), "constant reflectance")
        if source.library is not None:
            record = self._library(source.library, source.record, name, "spectrum")
            return SurfaceStatistics(
                name,
                record.mean,
                record.covariance,
                record.source or source.library,
                record.tail_dof,
                None,
                record.n,
                components=record.components,
            )
        if source.replicates is not None:
            sample = self._replicates(source.replicates, name)
            return SurfaceStatistics(
                name, sample.mean, sample.covariance, sample.summary, None,
                sample.standard_deviation, sample.n, sample.mean_error,
            )  # fmt: skip
        return self._from_file(source, name)

    def _replicates(self, source: Replicates, name: str) -> ReplicateStatistics:
        try:
            return replicate_statistics(source, self.axis, self.resolve, self.nominal)
        except UsageError as error:
            where = f"replicates of {name!r}: " + (error.where or "")
            raise UsageError(error.what, where=where, expected=error.expected, mend=error.mend) from error

    def _library(self, file: str, record: str | int | None, name: str, key: str) -> ClassStatistics:
        from hyperval.statistics_library import on_bands, read_statistics_library

        try:
            records = read_statistics_library(self.resolve(file), None if record is None else str(record))
            return on_bands(records, self.axis)
        except UsageError as error:
            where = f"{key}.library of {name!r}: " + (error.where or file)
            raise UsageError(error.what, where=where, expected=error.expected, mend=error.mend) from error

    def _from_file(self, source: SpectrumSource, name: str) -> SurfaceStatistics:
        from hyperval.spectra.readers import read_spectrum

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
