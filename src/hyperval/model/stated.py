"""A scenario and its files as arrays on the bands: read once, shared by all truths.

Spectra and their spread from the sources that the scenario names; the sensor and its noise (3.13-3.20); the
atmosphere at the bands in any of its states (3.7).  Several field spectra of one surface give their mean, their spread,
and the error of the mean.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
import scipy  # its parts are loaded where they are first named

from hyperval import datasets
from hyperval.atmosphere import AtmosphericState, atmospheric_terms
from hyperval.atmosphere.between import InterpolatedTerms, interpolated_terms
from hyperval.atmosphere.physics import MAX_AIR_ATM, MAX_WATER_G_CM2, amounts
from hyperval.atmosphere.solar import SPECTRA, source_samples
from hyperval.atmosphere.state import MAX_SOLAR_ZENITH_DEG, gas_columns, standard_profile
from hyperval.atmosphere.terms import NOT_AVERAGED, AtmosphericTerms
from hyperval.data import Array, Components, Index, statistics_of
from hyperval.errors import UsageError, needed, one_of, refuse, told_of
from hyperval.model.intervals import student_factor
from hyperval.paths import MAX_MATCHES, Resolve, matching
from hyperval.progress import track
from hyperval.scenario import (
    BackgroundClass,
    CovarianceSource,
    Replicates,
    Scenario,
    SpectrumSource,
    Surface,
    Target,
    TargetSubject,
)
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.specification import Sensor, binned_axis, sensor_named
from hyperval.settings import with_settings
from hyperval.spectra import FieldSpectrum, read_records, read_spectrum
from hyperval.spectra.axis import SpectralAxis, band_average, band_weights
from hyperval.statistics_library import ClassStatistics, builtin_class, on_bands, read_statistics_library

Values = npt.NDArray[Any]
Truth = Mapping[str, Any]  # dotted path -> value, of one truth; others are as stated
Engine = Callable[[AtmosphericState], AtmosphericTerms]
Read = dict[object, Any]  # spectra of files, by the file and how it is read
Made = TypeVar("Made")

SAME_BAND_NM = 0.05  # centres this close are the same band
# Below this many spectra for each band the sample covariance is shrunk (Ledoit & Wolf 2004), as for pixels.
FEW_PER_BAND = 3
MAX_UNCOVERED = 0.1  # of the usable bands; a spectrum that lacks more is taken for a mistake
_SUN, _VIEW = ("solar_zenith_deg", "solar_azimuth_deg"), ("view_zenith_deg", "view_azimuth_deg")
MAX_RUNS = 400  # of the engine, at about four seconds each where nothing is cached
# Variables that select the files of an engine.
_ENVIRONMENT = (
    "HYPERVAL_CACHE", "HYPERVAL_DATA", "HYPERVAL_MODTRAN", "HYPERVAL_MODTRAN_VERSION", "HYPERVAL_MODTRAN_DATA"
)  # fmt: skip


class Cached:
    """An object that caches results derived from it."""

    cache: dict[Any, Any]

    def cached(self, key: Any, make: Callable[[], Made]) -> Made:
        """The result of ``make``, computed at the first use of ``key``."""
        if key not in self.cache:
            self.cache[key] = make()
        made: Made = self.cache[key]
        return made


@dataclass(frozen=True)
class SurfaceStatistics(ClassStatistics):
    """A surface of the scene; bands that its source does not cover are NaN in ``mean``.

    Attributes
    ----------
    standard_deviation : (B,) that a spectrum's file carries, None without
    sampled_deviation : (n,) wavelengths [nm] and the same standard deviations as the file has them
    mean_error : (B, B) error covariance of the mean that replicate spectra give, None without
    """

    standard_deviation: Array | None = None
    sampled_deviation: tuple[Array, Array] | None = None
    mean_error: Array | None = None

    def __post_init__(self) -> None:
        """Its parts are already checked."""


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
    spectra, references = replicate_spectra(source, resolve), ", ".join(source.references)
    refuse(len(spectra) < 2, "replicates.single", references)
    values = np.array([in_bands(s.wavelength_nm, s.values, axis, nominal) for s in spectra])
    valid = np.all(np.isfinite(values), axis=0)
    refuse(not valid.any(), "replicates.bands", references, low=axis.centre_nm[0], high=axis.centre_nm[-1])
    sample, mean, deviation = statistics_of(values[:, valid]), *np.full((2, len(axis)), np.nan)
    mean[valid], deviation[valid] = sample.mean, np.sqrt(np.diag(sample.covariance))
    covariance, error, block = *np.zeros((2, len(axis), len(axis))), np.ix_(valid, valid)
    few = sample.n < FEW_PER_BAND * int(valid.sum())
    covariance[block] = sample.shrunk().covariance if few else sample.covariance
    error[block] = error_of_mean(sample.covariance, sample.n)
    words = f"{sample.n} replicate spectra" + (f", covariance shrunk by {sample.shrinkage:.3g}" if few else "")
    sampled = axis.centre_nm, deviation
    return SurfaceStatistics(
        "", axis, mean, covariance, sample.n, words, standard_deviation=deviation, sampled_deviation=sampled,
        mean_error=error,
    )  # fmt: skip


def error_of_mean(covariance: Array, n: int) -> Array:
    """(t/1.96)^2 S/n with n - 1 degrees of freedom [unit of S], as few spectra estimate their spread badly.

    S itself for a single one, whose difference from others is its error (:func:`student_factor`).
    """
    return np.asarray(student_factor(n - 1) ** 2 * covariance / n) if n > 1 else covariance


def replicate_spectra(source: Replicates, resolve: Resolve) -> list[FieldSpectrum]:
    """The spectra that ``source`` names, file by file in the order of the list, by name within a pattern."""
    spectra: list[FieldSpectrum] = []
    options = {k: getattr(source, k) for k in ("records", "wavelength_unit", "reflectance_unit")}
    for reference in source.references:
        path = resolve(reference)
        files = matching(path) or [path]  # a file that is missing is the reader's to report
        refuse(len(files) > MAX_MATCHES, "spectra.matches", reference, most=MAX_MATCHES)
        for file in files:
            spectra += read_records(file, **options)
    names = {s.name for s in spectra}
    for wanted in source.records or ():
        if isinstance(wanted, str) and wanted not in names:
            raise UsageError(f"no spectrum {wanted!r}", where=", ".join(source.references))
    return spectra


def sampled_bands(wavelength_nm: Array, axis: SpectralAxis) -> Index | None:
    """Bands whose centres the samples are at, where each is at another one; None otherwise."""
    if wavelength_nm.size != len(axis) and not 1 < wavelength_nm.size < len(axis):
        return None
    nearest = np.argmin(np.abs(wavelength_nm[:, None] - axis.centre_nm), axis=1)
    distance_nm = np.abs(axis.centre_nm[nearest] - wavelength_nm)
    return nearest if np.all(distance_nm <= SAME_BAND_NM) and np.unique(nearest).size == nearest.size else None


def in_bands(wavelength_nm: Array, values: Array, axis: SpectralAxis, nominal: SpectralAxis | None = None) -> Array:
    """(B,) values in the bands: unchanged where they are sampled at the bands' centres, else band averages.

    A library at the sensor's own bands, or at some of them, was convolved when it was made; a second time would
    smooth it and lose its first and last bands. NaN in bands that the samples do not cover. Where the samples are at
    the labelled bands (``nominal``) and the true bands are elsewhere, a cubic spline interpolates between them.

    >>> axis = SpectralAxis(np.arange(400.0, 460.0, 10.0), 10.0)
    >>> nm, values = np.array([400.0, 410.01, 430.0, 450.0]), np.array([0.4, 0.41, 0.43, 0.45])
    >>> in_bands(nm, values, axis)
    array([0.4 , 0.41,  nan, 0.43,  nan, 0.45])
    >>> in_bands(nm, values, SpectralAxis(axis.centre_nm + 1.0, 10.0), axis).round(3)
    array([0.401, 0.411,   nan, 0.431,   nan, 0.45 ])
    """
    means = np.full(len(axis), np.nan)
    if (sampled := sampled_bands(wavelength_nm, axis)) is not None:
        means[sampled] = values
        return means
    valid = np.isfinite(values)
    if valid.sum() < 2:
        return means
    if nominal is not None and (sampled := sampled_bands(wavelength_nm, nominal)) is not None:
        nm = np.clip(axis.centre_nm[sampled], wavelength_nm[valid][0], wavelength_nm[valid][-1])
        means[sampled] = np.where(valid, scipy.interpolate.CubicSpline(wavelength_nm[valid], values[valid])(nm), np.nan)
        return means
    return band_average(wavelength_nm[valid], values[valid], axis, outside="nan")


def covariance_in_bands(nm: Array, covariance: Array, axis: SpectralAxis) -> Array:
    """(B, B) error covariance of the result of :func:`in_bands` from that of samples (n, n); 0 in bands without one.

    >>> axis = SpectralAxis(np.arange(400.0, 460.0, 10.0), 10.0)
    >>> np.diag(covariance_in_bands(np.array([400.0, 410.0, 430.0, 450.0]), np.eye(4), axis))
    array([1., 1., 0., 1., 0., 1.])
    """
    bands = sampled_bands(nm, axis)
    weights, gap = band_weights(nm, axis) if bands is None else (np.eye(len(axis))[:, bands], np.zeros(len(axis), bool))
    sparse = scipy.sparse.csr_array(np.where(gap[:, None], 0.0, weights))  # a band covers few of the samples
    return np.asarray((sparse @ (sparse @ covariance).T).T)


def band_error_covariance(
    wavelength_nm: Array, standard_deviation: Array, correlation_nm: float | None, axis: SpectralAxis
) -> Array:
    """(B, B) covariance in the bands of an error of standard deviation (n,) and correlation length at its samples.

    Of C_kl = u_k u_l exp(-(dl / length)^2 / 2): independent errors of samples partly cancel within a band, unlike in
    the band average of their standard deviation.  None: one error for all.
    """
    u, gap = np.nan_to_num(standard_deviation), (wavelength_nm[:, None] - wavelength_nm) / (correlation_nm or np.inf)
    covariance = np.outer(u, u) * np.exp(np.maximum(-0.5 * gap**2, -100.0))  # below it the correlation is 0
    return covariance_in_bands(wavelength_nm, covariance, axis)


@dataclass(frozen=True)
class Sources(Cached):
    """Sources of spectra: the axis, measured statistics, and the function from file names to paths.

    ``nominal`` are the labelled bands, where they are not those of ``axis`` (a shifted spectrometer); measurements are
    on them.  ``cache`` holds the spectra of files that were read before.

    A library at the labelled bands moves with them, its standard deviation too:

    >>> from tempfile import NamedTemporaryFile
    >>> labels = SpectralAxis(np.array([500.0, 510.0, 520.0]), 5.0)
    >>> sources = Sources(SpectralAxis(labels.centre_nm + 0.2, 5.0), {}, Path, labels)
    >>> with NamedTemporaryFile("w", suffix=".csv") as file:
    ...     print("wavelength_nm,lawn,lawn sd\\n500,0.3,0.01\\n510,0.3,0.01\\n520,0.3,0.01", file=file, flush=True)
    ...     sources.spectrum(SpectrumSource(file=file.name), "lawn").sampled_deviation
    (array([500.2, 510.2, 520.2]), array([0.01, 0.01, 0.01]))
    """

    axis: SpectralAxis
    measured: Mapping[str, ClassStatistics]
    resolve: Resolve
    nominal: SpectralAxis | None = None
    cache: Read = field(default_factory=dict, repr=False, compare=False)

    def surface(self, surface: Surface) -> SurfaceStatistics:
        """Mean and covariance of one surface of the scene (rho_m, Sigma_m of 3.8-3.12).

        Raises
        ------
        UsageError : unknown built-in, or a measured region that was not handed in.
        """
        name, source = surface.name, surface.covariance
        base = self.spectrum(surface.spectrum, name)
        if source is not None and source.relative_sd is not None:
            sd = source.relative_sd * np.nan_to_num(base.mean)
            stated = np.outer(sd, sd) * band_correlation(self.axis, source.correlation_nm)
            base = replace(base, covariance=stated + source.band_sd**2 * np.eye(sd.size))
        else:
            pixels = base if source is None else self.spectrum(source, name)
            region = (source or surface.spectrum).measured
            single = region is not None and pixels.n is not None and pixels.n < 2
            refuse(single, "surface.single", region=region, name=name)
            # Tails are those of the pixels of the covariance; replicate spectra have none.
            tails = base if source is not None and source.replicates is not None else pixels
            base = replace(
                base, covariance=pixels.covariance, tail_dof=tails.tail_dof, tail_scale=tails.tail_scale,
                components=tails.components,
            )  # fmt: skip
        return replace(base, components=_class_components(surface, base.components))

    def spectrum(self, source: SpectrumSource | CovarianceSource, name: str) -> SurfaceStatistics:
        """The statistics of a source."""
        axis, kind = self.axis, "covariance" if isinstance(source, CovarianceSource) else "spectrum"
        if source.replicates is not None:
            with told_of(f"replicates of {name!r}", ", ".join(source.replicates.references)):
                return replace(replicate_statistics(source.replicates, axis, self.resolve, self.nominal), name=name)
        if source.builtin is not None:
            stored = builtin_class(source.builtin, axis)
        elif source.library is not None:
            with told_of(f"{kind}.library of {name!r}", source.library):
                record = None if source.record is None else str(source.record)
                stored = on_bands(self._contents(read_statistics_library, source.library, record=record), axis)
        elif source.measured is not None:
            stored = self._measured_statistics(source.measured, name)
        else:
            assert isinstance(source, SpectrumSource)  # noqa: S101 - a stated spread is the surface's to take
            return self._from_file(source, name)
        named = {"name": name, "source": stored.source or source.library or "measured"}
        return SurfaceStatistics(**vars(stored) | named)

    def _contents(self, reader: Callable[..., Made], reference: str, **how: Any) -> Made:
        """The contents of a file, read at the first use."""
        path = self.resolve(reference)
        return self.cached((path, *how.values()), lambda: reader(path, **how))

    def _from_file(self, source: SpectrumSource, name: str) -> SurfaceStatistics:
        axis, zero, errors = self.axis, np.zeros((len(self.axis), len(self.axis))), dict[str, Any]()
        if source.constant is not None:
            flat = np.full(len(axis), source.constant)
            return SurfaceStatistics(name, axis, flat, zero, source="constant reflectance")
        options = {k: getattr(source, k) for k in ("record", "wavelength_unit", "reflectance_unit")}
        spectrum = self._contents(read_spectrum, str(source.file), **options)
        w, sd = spectrum.wavelength_nm, spectrum.standard_deviation
        mean = in_bands(w, spectrum.values, axis, self.nominal)
        refuse(np.isnan(mean).all(), "surface.bands", name=name, file=source.file, ends=axis.centre_nm[[0, -1]])
        labelled = None if self.nominal is None else sampled_bands(w, self.nominal)
        sample_nm = w if labelled is None else axis.centre_nm[labelled]  # samples at labels move with the bands
        if sd is not None:
            errors = {"standard_deviation": in_bands(w, sd, axis, self.nominal), "sampled_deviation": (sample_nm, sd)}
        if spectrum.errors is not None:  # unless the scenario states its own
            errors["mean_error"] = covariance_in_bands(sample_nm, spectrum.errors.covariance(), axis)
        return SurfaceStatistics(name, axis, mean, zero, spectrum.n, str(source.file), **errors)

    def _measured_statistics(self, region: str, name: str) -> ClassStatistics:
        names = one_of(self.measured, "a region of a collection in reflectance, or in radiance with an empirical_line")
        refuse(region not in self.measured, "surface.measured", name=name, region=region, known=names)
        estimate = self.measured[region]
        refuse(not estimate.axis.matches(self.nominal or self.axis), "surface.axis", region=region)
        return estimate


def _class_components(surface: Surface, stored: Components | None) -> Components | None:
    """The components of a class, of those of its source."""
    if not isinstance(surface, BackgroundClass) or surface.mixture in (None, 1):
        return None
    if surface.mixture == "auto":  # which may choose one law
        return stored
    count = "none" if stored is None else len(stored)
    refuse(count != surface.mixture, "surface.mixture", name=surface.name, asked=surface.mixture, there=count)
    return stored


def band_correlation(axis: SpectralAxis, length_nm: float | None) -> Array:
    """(B, B) correlation exp(-(dl / length)^2 / 2) between bands; 1 everywhere when the length is None."""
    gap = axis.centre_nm[:, None] - axis.centre_nm[None, :]
    return np.asarray(np.exp(-0.5 * (gap / (length_nm or np.inf)) ** 2))


def fill_gaps(values: Array) -> Array:
    """(B,) with NaN replaced by the nearest known values: for the scene average alone."""
    valid, index = np.isfinite(values), np.arange(values.size)
    return np.interp(index, index[valid], values[valid])


def uncovered_bands(scenario: Scenario, surfaces: Mapping[str, SurfaceStatistics], axis: SpectralAxis) -> Iterator[str]:
    """Notes on spectra that do not cover all usable bands: these bands are left out.

    One band at each end may lack, and bands within the spectrum that its file marks as unknown.

    Raises
    ------
    UsageError : a spectrum that lacks more than a tenth of the usable bands, with the field of the scenario.
    """
    for key in ("classes", "panels", "sites", "targets"):
        for i, surface in enumerate(getattr(scenario.scene, key)):
            valid, uncovered = np.flatnonzero(np.isfinite(surfaces[surface.name].mean)), axis.good.copy()
            # One band at each end may lack: the spectrum may cover its centre and not its whole response.
            uncovered[max(valid.min(initial=uncovered.size) - 1, 0) : valid.max(initial=-2) + 2] = False
            if surface.spectrum.measured is not None or surface.spectrum.gaps == "allowed" or not uncovered.any():
                continue
            w = axis.centre_nm[uncovered]
            bands = f"{w.size} usable band{'s' * (w.size > 1)} (first {w[0]:g} nm, last {w[-1]:g} nm)"
            facts = {"at": f"scene.{key}.{i}.spectrum", "low": axis.centre_nm[0], "high": axis.centre_nm[-1]}
            refuse(w.size > MAX_UNCOVERED * axis.good.sum(), "surface.cover", name=surface.name, bands=bands, **facts)
            yield f"the spectrum of {surface.name!r} does not reach {bands}, left out"


def with_sensor_blur(scenario: Scenario, sensor: Sensor | None) -> Scenario:
    """The scenario with the sensor's point spread function where a geometry states none."""
    psf, widths = sensor and sensor.specification.psf, {}
    for t, target in enumerate(scenario.scene.targets if psf else ()):
        for k, population in enumerate(target.populations):
            geometry = population.fill.geometry
            if psf and geometry is not None and geometry.psf_fwhm_pixels is None:
                prefix = f"subjects.{k}." if target.subjects else ""
                widths[f"scene.targets.{t}.{prefix}fill.geometry.psf_fwhm_pixels"] = psf.fwhm
    return with_settings(scenario, widths) if widths else scenario


@dataclass(frozen=True)
class Origins:
    """Inputs of a scenario besides its own entries.

    Attributes
    ----------
    axis : bands of all products; None: the sensor's own, or those of the measured statistics
    measured : region -> reflectance statistics on ``axis``, for surfaces with ``measured:``
    resolve : turns a file reference of the scenario into a path; None: relative to the scenario's file, or
        ``data:`` for a registered data set
    cache_dir : of the atmosphere engine
    engine : in place of the atmosphere engine
    emulated_steps : whether steps from the stated atmosphere may be computed by the emulator of its engine
    sensor : in place of the sensor that the scenario names
    left_out : (region, its measured statistics without each part of the image), of the regions whose law is fitted to
        their pixels
    read : cache of spectra of the scenario's files
    """

    axis: SpectralAxis | None = None
    measured: Mapping[str, ClassStatistics] | None = None
    resolve: Resolve | None = None
    cache_dir: Path | None = None
    engine: Engine | None = None
    emulated_steps: bool = False
    sensor: Sensor | None = None
    left_out: Callable[[], Iterable[tuple[str, Sequence[ClassStatistics]]]] | None = None
    read: Read = field(default_factory=dict, repr=False, compare=False)

    def resolver(self, scenario: Scenario) -> Resolve:
        """Turns the file references of a scenario into paths."""
        return self.resolve or (lambda reference: datasets.resolve(reference, scenario.folder))


def state_entries(state: AtmosphericState, changes: Truth) -> dict[str, Any]:
    """Changes of a state, with the entries that must change along with them.

    A sun computed from place and time is then stated by its angles; sun or sensor beyond the zenith has the opposite
    azimuth:

    >>> from hyperval.scenario import load_scenario
    >>> state_entries(load_scenario("panels").atmosphere, {"view_zenith_deg": -5.0})
    {'view_zenith_deg': 5.0, 'view_azimuth_deg': 180.0}
    """
    entries = dict(changes)
    if "aot550" in entries:
        entries.setdefault("meteorological_range_km", None)
    for names in (_SUN, _VIEW):
        if entries.keys() & names:
            zenith, azimuth = (entries.get(name, state_value(state, name)) for name in names)
            half_turn, limit = 180.0 * (zenith < 0.0), MAX_SOLAR_ZENITH_DEG - 0.1
            entries |= dict(zip(names, (min(abs(zenith), limit), (azimuth + half_turn) % 360.0), strict=True))
    if entries.keys() & _SUN and state.time_utc is not None:
        entries["earth_sun_distance_au"] = state.distance_au
        entries |= dict.fromkeys(("latitude_deg", "longitude_deg", "time_utc"))
    return entries


def state_value(state: AtmosphericState, name: str) -> float:
    """The number that a state has for a field, also where it is derived from others.

    Raises
    ------
    UsageError : the state leaves it to the engine.
    """
    if name in _SUN:
        return float(state.sun[_SUN.index(name)])
    value = state.aerosol_optical_depth if name == "aot550" else getattr(state, name)
    return float(needed(value, "uncertainty.state", name=name))


def scalar(value: Any) -> Any:
    """A value as a Python scalar: an int where it is whole."""
    value = value.item() if hasattr(value, "item") else value
    return int(value) if isinstance(value, float) and value.is_integer() else value


def unique(columns: Iterable[Values], n: int) -> tuple[Index, Index]:
    """First of the n rows of each distinct combination of the columns, and the number (n,) of that of each row."""
    which = np.zeros(n, dtype=int)
    for column in columns:
        if which.max(initial=0) + 1 < n:  # else no further column tells more of them apart
            names = np.unique([repr(v) for v in column], return_inverse=True)[1] if column.dtype == object else column
            keys = [row.tobytes() for row in np.column_stack([which, np.reshape(names, (n, -1))])]
            order = {key: i for i, key in enumerate(dict.fromkeys(keys))}
            which = np.array([order[key] for key in keys])
    return np.unique(which, return_index=True)[1], which


@lru_cache(maxsize=32)
def _terms_in_memory(
    engine: Callable[..., AtmosphericTerms], state: AtmosphericState, centre_nm: bytes, fwhm_nm: bytes,
    environment: tuple[str | None, ...], cache_dir: Path | None, base: AtmosphericState | None,
) -> AtmosphericTerms:  # fmt: skip
    """Terms at bands, cached, as engines are deterministic functions of state, files and bands."""
    axis = SpectralAxis(np.frombuffer(centre_nm), np.frombuffer(fwhm_nm))
    return _with_notes(engine(state, cache_dir=cache_dir, near=base).at_bands(axis), state)


def _with_notes(terms: AtmosphericTerms, state: AtmosphericState) -> AtmosphericTerms:
    return replace(terms, notes=(*unstated_notes(state), *engine_notes(state, terms)))


@dataclass(eq=False)
class Atmosphere(Cached):
    """The atmosphere over a scenario, at its bands: terms of (3.7) in any of its states.

    Attributes
    ----------
    nodes : entry -> nodes between which terms are interpolated; empty: a run of the engine for each state
    star : each entry moves alone from its first node, beyond its nodes too, and changes add up; else all combinations
        are run
    cache : terms by the entries that differ from the stated state
    """

    scenario: Scenario
    origins: Origins
    axis: SpectralAxis
    nodes: Mapping[str, Sequence[float]] = field(default_factory=dict)
    star: bool = False
    cache: dict[Any, Any] = field(default_factory=dict)
    _between: InterpolatedTerms | None = None

    def run(self, changes: Truth) -> AtmosphericTerms:
        """The engine's terms at the bands with some entries of the state changed; run once for each state."""
        return self.cached(repr(sorted(changes.items())), lambda: self._run(changes))

    def _run(self, changes: Truth) -> AtmosphericTerms:
        state, source = self.scenario.atmosphere, self.origins
        assert state is not None  # noqa: S101 - there is light
        state = with_settings(state, state_entries(state, changes)) if changes else state
        if source.engine is not None or state.engine == "table":  # a file of the scenario, read when it changes
            engine = source.engine or partial(atmospheric_terms, resolve=source.resolver(self.scenario))
            return _with_notes(engine(state).at_bands(self.axis), state)
        bands = self.axis.centre_nm.tobytes(), self.axis.fwhm_nm.tobytes()
        base = self.scenario.atmosphere if source.emulated_steps else None
        options = tuple(map(os.environ.get, _ENVIRONMENT)), source.cache_dir, base
        return _terms_in_memory(atmospheric_terms, state, *bands, *options)

    def prepare(self, states: Sequence[Truth]) -> None:
        """Run the engine, before truths go to other processes: in some states, or at all combinations of the nodes.

        Raises
        ------
        UsageError : too many nodes or states, fewer than two nodes of an entry, or one that is no valid state.
        """
        if self.scenario.atmosphere is None:
            return
        grid = {n: np.asarray(v, dtype=float) for n, v in self.nodes.items()}
        for name, values in grid.items():
            wrong = not self.star and (values.size < 2 or np.any(np.diff(values) <= 0))
            refuse(wrong, "engine.nodes", name=name, values=values.tolist())
        what = "nodes" if grid else "states"
        if self.star:
            states = [{}, *({name: x} for name, values in grid.items() for x in values[1:].tolist())]
        elif grid:
            states = [dict(zip(grid, row, strict=True)) for row in product(*(v.tolist() for v in grid.values()))]
        refuse(len(states) > MAX_RUNS, "engine.runs", count=len(states), what=what, most=MAX_RUNS)
        runs = [self.run(row) for row in track(states, f"atmosphere, {what}", len(states))]
        self._between = interpolated_terms(grid, runs, star=self.star) if grid else None

    def __call__(self, moved: Mapping[str, Values], size: int) -> AtmosphericTerms:
        """Terms (U or 1, 1, B) where entries (U or 1,) of the state are moved; None leaves one as it is.

        Without an atmosphere reflectance is recorded: A = 1, L_a = B = S = 0.

        Raises
        ------
        UsageError : a state outside the nodes; a table is never extrapolated.
        """
        state = self.scenario.atmosphere
        if state is None:
            zero = np.zeros((1, 1, len(self.axis)))
            return AtmosphericTerms(self.axis.centre_nm, zero, zero + 1.0, zero, zero, zero, zero + 1.0)
        if self.nodes and moved:
            if self._between is None:
                self.prepare(())
            assert self._between is not None  # noqa: S101 - there are nodes
            columns = {}
            for name in self.nodes:
                column = np.broadcast_to(moved.get(f"atmosphere.{name}", np.array([np.nan])), (size,)).astype(float)
                columns[name] = np.where(np.isnan(column), state_value(state, name), column)
            terms = self._between(columns)
            return replace(terms, **{n: getattr(terms, n)[:, None, :] for n in self._between.values})
        first, which = unique((np.broadcast_to(v, (size,)) for v in moved.values()), size)
        names = [path.partition(".")[2] for path in moved]
        rows = [[v[u if len(v) > 1 else 0] for v in moved.values()] for u in first]
        runs = [self.run({n: scalar(v) for n, v in zip(names, row, strict=True) if v is not None}) for row in rows]
        index: Any = which if len(runs) > 1 else slice(None)
        spectra = [n for n, v in vars(runs[0]).items() if n not in NOT_AVERAGED and v is not None]
        return replace(runs[0], **{n: np.stack([getattr(t, n) for t in runs])[:, None, :][index] for n in spectra})


def unstated_notes(state: AtmosphericState) -> Iterator[str]:
    """Gas columns that come from the standard atmosphere."""
    if state.engine != "sixs":
        return
    water, ozone = gas_columns(standard_profile(state.model), state.ground_altitude_km)
    words = f"that of the standard atmosphere {state.model} is used"
    if state.water_vapour_g_cm2 is None:
        yield f"water vapour is not stated: {words}, {water:.2f} g cm-2"
    if state.ozone_atm_cm is None:
        yield f"ozone is not stated: {words}, {ozone:.3f} atm cm"


def engine_notes(state: AtmosphericState, terms: AtmosphericTerms) -> list[str]:
    """A stated sun that a table replaces, bands beyond its spectrum, amounts beyond those of the engine's gases."""
    notes, sun, w = [], terms.provenance.get("solar_spectrum"), terms.wavelength_nm
    if sun in SPECTRA:
        first, last = source_samples(sun)[0][[0, -1]]
        if count := np.count_nonzero((w < first) | (w > last)):
            notes.append(
                f"the solar spectrum {sun} covers {first:g}-{last:g} nm: in {count} of {w.size} bands, beyond it, the "
                "sunlight has the shape of astm-g173"
            )
    if sun == "of the table" and "solar_spectrum" in state.model_fields_set:
        notes.append(
            f"the table contains its own solar spectrum: solar_spectrum {state.solar_spectrum}, "
            "which the scenario states, is not used"
        )
    if terms.provenance.get("engine_ratio"):
        limits = (MAX_AIR_ATM, "atm of air"), (MAX_WATER_G_CM2, "g cm-2 of water vapour")
        notes += [
            f"the light path crosses {amount:.2g} {unit}: the engine's gases were compared with MODTRAN 6 up to "
            f"{greatest:g}"
            for amount, (greatest, unit) in zip(amounts(state)[1][:, 0], limits, strict=False) if amount > greatest
        ]  # fmt: skip
    return notes


class Law(NamedTuple):
    """A class of the background, or one component of it.

    Attributes
    ----------
    owner : number of the class
    weight : part of the class
    offset : (B,) of its mean from that of the class
    covariance : (B, B)
    dof : degrees of freedom of a component; None: those of the class
    """

    owner: int
    weight: float
    offset: Array
    covariance: Array
    dof: float | None


@dataclass(eq=False)
class Stated(Cached):
    """A scenario and its files on its bands: read once, shared by all truths.

    Attributes
    ----------
    scenario : with the sensor's blur where it states none
    sensor : None where it has none
    axis, true_axis : labelled and true bands; the same without a shift
    noise : (3.13)-(3.20) as stated; None without a sensor
    surfaces : name -> statistics of every class, panel, site and target, in the true bands
    signatures : target -> (B,) reflectance that its filter looks for, in the labelled bands
    surroundings : (B,) their reflectance where the scenario states it; None: the average of the classes
    notes : on the sensor, and on bands that spectra do not cover
    before, nominal : the scenario that values of paths refer to, where this one was read again; None: this one
    cache : results derived from it alone
    shift_nm, width : of the true bands, besides those of the scenario
    names : class, surface or target -> names of all items that the star of a path may name
    populations : number of the target, number in it, and population of target pixels
    mean : (S, B) mean reflectance of the surfaces
    columns : field of the world -> (1, items) as stated
    of_pixels : (S,) surfaces whose covariance is of pixels of the image, which hold the sensor's noise already
    laws : distributions of the classes: one each, or the components of a mixture
    linear_detectors : detectors with a score linear in the pixel
    """

    scenario: Scenario
    origins: Origins
    sensor: Sensor | None
    axis: SpectralAxis
    true_axis: SpectralAxis
    noise: NoiseModel | None
    surfaces: Mapping[str, SurfaceStatistics]
    signatures: Mapping[str, Array]
    surroundings: Array | None
    atmosphere: Atmosphere
    notes: Sequence[str] = ()
    reread_from: Stated | None = None
    cache: dict[Any, Any] = field(default_factory=dict)
    shift_nm: float | Array = 0.0
    width: float = 1.0

    def __post_init__(self) -> None:
        scene, self.nominal = self.scenario.scene, self.reread_from or self
        self.targets: list[Target] = scene.targets
        self.classes = [c.name for c in scene.classes]
        self.names = {"class": self.classes, "surface": list(self.surfaces), "target": [t.name for t in scene.targets]}
        self.mean = np.array([s.mean for s in self.surfaces.values()])
        listed = *scene.classes, *scene.panels, *scene.sites, *scene.targets
        self.of_pixels = np.array([_region_of(s) is not None for s in listed], dtype=bool)
        columns: dict[str, list[float]] = {
            "fraction": [c.fraction for c in scene.classes],
            "class_gain": [c.gain for c in scene.classes],
            "tail": [class_tail(c, self.surfaces[c.name]) for c in scene.classes],
            "neighbours": [scene.adjacency.effective_neighbours or np.inf],
            "target_gain": [t.gain for t in scene.targets],
            "beam": [t.illumination.beam if t.illumination else 1.0 for t in scene.targets],
            "sky_view": [t.illumination.sky_view if t.illumination else 1.0 for t in scene.targets],
            "spread": [1.0] * len(self.surfaces),
            "fine_texture": [0.0] * len(self.surfaces),
        }
        self.columns = {name: np.array([values], dtype=float) for name, values in columns.items()}
        self.laws = [law for m, c in enumerate(scene.classes) for law in _laws(m, c, self.surfaces[c.name])]
        self.populations: list[tuple[int, int, TargetSubject]] = [
            (t, k, p) for t, target in enumerate(scene.targets) for k, p in enumerate(target.populations)
        ]
        self.linear_detectors, self.is_of_space = self.scenario.processing.linear_detectors, self.scenario.is_of_space

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "cache": {}}


def _region_of(surface: Surface) -> str | None:
    """The region of the collection that the covariance of a surface is measured on."""
    return surface.spectrum.measured if surface.covariance is None else surface.covariance.measured


def class_tail(c: BackgroundClass, surface: SurfaceStatistics) -> float:
    """Degrees of freedom of a class; infinity: Gaussian.

    A tail fitted to a region of the collection is used where the class has ``tail_dof: measured``.  It is that of the
    pixels of the covariance; where that is stated, or of field spectra, of the pixels of the mean.
    """
    source = c.covariance
    tail_source = source if source is not None and (source.measured or source.library or source.builtin) else c.spectrum
    if c.tail_dof is None and tail_source.measured is not None:
        return np.inf
    return (c.tail_dof if isinstance(c.tail_dof, float) else surface.tail_dof) or np.inf


def unmeasured_tails(classes: Iterable[BackgroundClass], surfaces: Mapping[str, SurfaceStatistics]) -> Iterator[str]:
    """Warnings of classes with tails as measured, without a measurement.

    >>> from hyperval.api import load_scenario, predict
    >>> plain = load_scenario("yellow-planks-asphalt")
    >>> predict(plain.with_values({"scene.classes.asphalt.tail_dof": "measured"})).notes[-3]
    "warning: tail_dof: measured of 'asphalt', whose spectrum and covariance are of no region of an image: it is normal"
    """
    for c in classes:
        is_known = _region_of(c) is not None or surfaces[c.name].tail_dof is not None or surfaces[c.name].components
        if c.tail_dof == "measured" and not is_known:
            reason = "whose spectrum and covariance are of no region of an image"
            yield f"warning: tail_dof: measured of {c.name!r}, {reason}: it is normal"


def _laws(number: int, c: BackgroundClass, surface: SurfaceStatistics) -> list[Law]:
    """The distribution of a class's pixels: one law, or the components of a mixture."""
    parts = surface.components
    if parts is None:
        scale = surface.tail_scale if c.tail_dof == "measured" else 1.0
        return [Law(number, 1.0, np.zeros(len(surface.axis)), scale * surface.covariance, None)]
    dof = None if isinstance(c.tail_dof, float) else parts.dof
    laws = zip(parts.weights.tolist(), parts.offsets, parts.covariances, strict=True)
    return [Law(number, w, offset, covariance, dof) for w, offset, covariance in laws]


def read_files(
    scenario: Scenario, source: Origins, shift_nm: float | Array = 0.0, width: float = 1.0,
    nodes: Mapping[str, Sequence[float]] | None = None, star: bool = False,
) -> Stated:  # fmt: skip
    """Read a scenario and all its files (3.7-3.20).

    Parameters
    ----------
    shift_nm, width : added to the true band centres, factor on the true widths; the labels stay
    nodes, star : of the atmosphere, as :class:`Atmosphere` has them

    Raises
    ------
    UsageError, InputError : a scenario that contradicts itself, a file that is missing or corrupt.
    """
    find, measured, operation = source.resolver(scenario), source.measured or {}, scenario.sensor_operation
    sensor = source.sensor or (sensor_named(scenario.sensor, find) if scenario.sensor else None)
    axes = [source.axis, sensor.axis if sensor else None, *(s.axis for s in measured.values())]
    axis = needed(next((a for a in axes if a is not None), None), "scenario.bands")
    true, noise, cache = axis, None, dict[Any, Any]()
    count = operation.spectral_binning if operation else 1
    refuse(count > 1 and source.axis is not None, "scenario.binned")
    if sensor is not None:
        noise = sensor.operated_noise(axis, operation, scenario.sensor_changes, cache)
        true = sensor.true_axis(axis, operation)
        if count > 1:
            refuse(count > len(axis), "scenario.bins", count=count, bands=len(axis))
            true, axis = binned_axis(true, count), binned_axis(axis, count)
    if np.any(shift_nm) or width != 1.0:
        true = SpectralAxis(true.centre_nm + shift_nm, width * true.fwhm_nm, true.good)
    notes = sensor.notes(true.centre_nm - axis.centre_nm, scenario.sensor_changes) if sensor and noise else []
    scenario = with_sensor_blur(scenario, sensor)
    scene, sources = scenario.scene, Sources(true, measured, find, axis, source.read)
    surfaces = {s.name: sources.surface(s) for s in (*scene.classes, *scene.panels, *scene.sites, *scene.targets)}
    notes += uncovered_bands(scenario, surfaces, true)
    notes += unmeasured_tails(scene.classes, surfaces)
    labelled, neighbourhood = replace(sources, axis=axis, nominal=None), scene.adjacency.spectrum
    signatures = {t.name: labelled.spectrum(t.filter_spectrum or t.spectrum, t.name).mean for t in scene.targets}
    surroundings = None if neighbourhood is None else fill_gaps(sources.spectrum(neighbourhood, "surroundings").mean)
    return Stated(
        scenario, source, sensor, axis, true, noise, surfaces, signatures, surroundings,
        Atmosphere(scenario, source, true, nodes or {}, star), notes, cache=cache, shift_nm=shift_nm, width=width,
    )  # fmt: skip
