"""The uncertain inputs of a scenario: a dotted path, what stands there, and how far it may be off.

An input has K independent directions with factors of mean 0 and variance 1; what stands at its path follows from any
set of factors (:data:`hyperval.model.world.PATHS`).  Budgets, draws, attribution and what-ifs are designs over inputs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from hyperval.data import Array, Mask
from hyperval.errors import UsageError
from hyperval.model.stated import SurfaceStatistics, Truth, correlation
from hyperval.model.world import NEUTRAL, SHIFT, World, find, value_at
from hyperval.scenario import SpectralForm, SpectrumUncertainty
from hyperval.sensor.specification import Sensor
from hyperval.settings import path_parts
from hyperval.spectra.axis import SpectralAxis

# Directions that hold less than this part of the variance, all together, are left out: where whole curves follow each,
# and where a spectrum's covariance is inverted in a test, which sees what is small.
_LEFT_OUT, _NOTHING = 1e-6, 1e-14


def directions(sd: Array, form: SpectralForm, axis: SpectralAxis, sensor: Sensor | None = None) -> Array:
    """(K, B) independent directions of an error with standard deviation ``sd`` (B,), the greatest first.

    The error is the sum of the rows, each with a factor of mean 0 and variance 1: its covariance is D^T D.
    """
    u = np.nan_to_num(np.asarray(sd, dtype=float))
    if form.correlation_nm is not None:
        return covariance_directions(np.outer(u, u) * correlation(axis, form.correlation_nm))
    if form.correlation == "random":
        return np.asarray(np.diag(u)[u > 0])
    if form.correlation == "arms":
        rows = np.array([np.where(arm, u, 0.0) for arm in _arms(axis, sensor)])
        rows = rows[np.any(rows > 0, axis=1)]
        return np.asarray(rows[np.argsort(-(rows**2).sum(axis=1), kind="stable")])
    return np.asarray(u[None, :])


def covariance_directions(covariance: Array) -> Array:
    """(K, B) rows sqrt(lambda) v of a covariance (B, B), the greatest first, each with a positive sum."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    values, vectors = np.clip(values[::-1], 0.0, None), vectors[:, ::-1]
    if values[0] <= 0.0:
        return np.zeros((0, covariance.shape[0]))
    keep = leading(values, _NOTHING)
    rows = (np.sqrt(values[:keep]) * vectors[:, :keep]).T
    return np.asarray(rows * np.where(rows.sum(axis=1) < 0, -1.0, 1.0)[:, None])


def leading(variances: Array, left_out: float) -> int:
    """How many of some falling variances leave out no more than a part of their sum."""
    rest = 1.0 - np.cumsum(variances) / variances.sum()
    return int(np.searchsorted(-rest, -left_out)) + 1


def form_in_words(form: SpectralForm) -> str:
    """The correlation form for people."""
    if form.correlation_nm is not None:
        return f"correlation length {form.correlation_nm:.4g} nm"
    return {
        None: "systematic: one error for all bands",
        "systematic": "systematic: one error for all bands",
        "random": "random by band",
        "arms": "one error for each arm of the sensor",
    }[form.correlation]


def _arms(axis: SpectralAxis, sensor: Sensor | None) -> list[Mask]:
    w, groups = axis.centre_nm, []
    arms = sensor.specification.arms if sensor is not None else ()
    if not arms:
        raise UsageError("uncertainty: correlation: arms needs a sensor with arms", mend="use correlation_nm")
    taken = np.zeros(w.shape, bool)
    for low, high in (arm.range_nm for arm in arms):
        groups.append((w >= low) & (w <= high) & ~taken)
        taken |= groups[-1]
    return [*groups, ~taken] if not taken.all() else groups  # bands beside all arms share one error


def spectrum_error_sd(item: SpectrumUncertainty, surface: SurfaceStatistics, axis: SpectralAxis) -> Array:
    """Standard uncertainty (B,) of the field spectrum of one subject [1].

    Raises
    ------
    UsageError : the file carries no standard deviation, or no n for a standard error.
    """
    if item.from_file:
        if surface.standard_deviation is None:
            raise UsageError(f"uncertainty of {item.subject!r}: its spectrum's file carries no standard deviation")
        sd = np.nan_to_num(surface.standard_deviation)
        if item.divisor == "standard_error":
            if not surface.n:
                raise UsageError(
                    f"uncertainty of {item.subject!r}: the file does not say how many spectra it averages",
                    mend="use divisor: spread",
                )
            sd = sd / np.sqrt(surface.n)
    else:
        sd = (
            np.full(len(axis), item.absolute) if item.absolute else (item.relative or 0.0) * np.nan_to_num(surface.mean)
        )
    return np.asarray(sd)


Kind = Literal["atmosphere", "surface", "sensor", "scene", "engine"]


Source = Literal["stated", "usual"]
_UNITS = {"_g_cm2": "g cm-2", "_atm_cm": "atm cm", "_km": "km", "_deg": "degrees"}  # by the end of a path


@dataclass(frozen=True, eq=False)
class UncertainInput:
    """An uncertain input.

    Attributes
    ----------
    name : for users; one budget has each name once
    kind : what sort of input
    path : where it stands (:data:`hyperval.model.world.PATHS`)
    nominal : (n,) what stands there: a number, or numbers over wavelength or over the things that it moves
    rows : (K, n) change of it per unit along each direction, the leading one first; one unit is one standard
        uncertainty
    low, high : where it is stopped
    correlation : how errors hang together over wavelength, in words
    source : whether the scenario states the uncertainty, or a usual one is taken
    """

    name: str
    kind: Kind
    path: str
    nominal: Array
    rows: Array
    low: float | Array = -np.inf
    high: float | Array = np.inf
    correlation: str = "one number"
    source: Source = "stated"

    @cached_property
    def size(self) -> int:
        """Number of directions whose effects are followed one by one; the rest hold a millionth of the variance."""
        variances = (self.rows**2).sum(axis=1)
        falling = np.all(np.diff(variances) <= 1e-12 * variances[:1]) and np.any(variances)
        return min(leading(variances, _LEFT_OUT), len(self.rows)) if falling else len(self.rows)

    @property
    def subject(self) -> str:
        """The surface whose mean it is; empty for anything else."""
        parts = path_parts(self.path)
        return parts[1] if parts[0] == "surfaces" and parts[2] == "mean" else ""

    @property
    def scale(self) -> tuple[float, str]:
        """Standard uncertainty and its unit: per cent of what stands there where that is a spectrum or a factor."""
        sd = np.sqrt((self.rows**2).sum(axis=0))
        if self.path.startswith("atmosphere."):
            unit = next((words for end, words in _UNITS.items() if self.path.endswith(end)), "")
            return float(sd[0]), unit
        with np.errstate(divide="ignore", invalid="ignore"):
            return float(np.nanmedian(100.0 * sd / np.abs(self.nominal))), "%"

    @property
    def of_light(self) -> bool:
        """Whether it moves light, sensor or empirical line, and no surface, fill or band."""
        return path_parts(self.path)[0] in ("atmosphere", "light", "sensor", "line") and self.path != SHIFT

    def along(self, c: Array) -> dict[str, Any]:
        """The truth at factors (K,) of the directions."""
        return {self.path: np.clip(self.nominal + c @ self.rows[: len(c)], self.low, self.high)}

    def direction(self, k: int, z: float) -> dict[str, Any]:
        """The truth ``z`` units along direction ``k``, the rest as stated."""
        return self.along(z * np.eye(len(self.rows))[k])

    def moved(self, z: float) -> dict[str, Any]:
        """The truth ``z`` units along the leading direction."""
        return self.direction(0, z)

    def drawn(self, rng: np.random.Generator) -> Truth:
        """A truth drawn from the distribution of this input alone."""
        return self.along(rng.standard_normal(self.size))


def together(moves: Iterable[tuple[UncertainInput, Truth]]) -> dict[str, Any]:
    """The truth in which several inputs are moved at once: changes of what stands at one path add up."""
    out: dict[str, Any] = {}
    for item, truth in moves:
        for path, value in truth.items():
            out[path] = out[path] + value - item.nominal if path in out else value
    return out


def drawn_truths(inputs: Sequence[UncertainInput], count: int, seed: int) -> list[dict[str, Any]]:
    """Truths with every input drawn from its distribution, independently of the others."""
    rng = np.random.default_rng(seed)
    return [together((item, item.drawn(rng)) for item in inputs) for _ in range(count)]


def number_input(
    world: World, name: str, kind: Kind, path: str, spread: float | Array, *, source: Source = "stated",
    words: str = "one number", rows: Array | None = None,
) -> UncertainInput:  # fmt: skip
    """An input of one number, or of several that move together.

    ``spread`` : standard uncertainty of each;  ``rows`` : (K, n) directions in its place
    """
    entry = find(world.stated, path)
    nominal = np.asarray(value_at(world, path)[0], dtype=float).reshape(-1)
    if rows is None:
        rows = np.broadcast_to(spread, nominal.shape)[None, :]
    if NEUTRAL.get(entry.field) == 1.0:  # errors of a factor are parts of it
        rows = rows * (nominal if nominal.size in (1, rows.shape[1]) else nominal[0])
    low: float | Array = entry.low
    high, state = entry.high, world.stated.scenario.atmosphere
    if entry.field == "mean":
        low = np.minimum(nominal, 0.0)  # no reflectance below 0
    elif path == "atmosphere.sensor_altitude_km" and state is not None:
        low = state.ground_altitude_km + 0.01
    elif path == "atmosphere.ground_altitude_km" and state is not None:
        high = min(high, state.sensor_altitude_km - 0.01)
    return UncertainInput(name, kind, path, nominal, np.asarray(rows), low, high, words, source)


def spectral_input(
    world: World, name: str, kind: Kind, path: str, sd: Array | float, form: SpectralForm
) -> UncertainInput:
    """An input over wavelength with standard uncertainty ``sd`` (B,) and the correlation of ``form``."""
    axis = world.stated.axis
    rows = directions(np.broadcast_to(sd, len(axis)), form, axis, world.stated.sensor)
    return number_input(world, name, kind, path, 0.0, words=form_in_words(form), rows=rows)


TABLE, INTERPOLATION_NM = "interpolation of the table", 300.0  # source in the budget; its correlation length
ENGINE, ENGINE_LINES, ENGINE_PATH = (
    "radiative-transfer engine", "engine's fine structure", "engine's path radiance"
)  # fmt: skip
AEROSOL, WATER, SURROUNDINGS, BLUR = (
    "aerosol optical depth", "water vapour", "surroundings", "blur (PSF width)"
)  # fmt: skip
# Numbers: name for users, kind, path, field of ``uncertainty``.
_NUMBERS: tuple[tuple[str, Kind, str, str], ...] = (
    (AEROSOL, "atmosphere", "atmosphere.aot550", "aot550"),
    ("meteorological range", "atmosphere", "atmosphere.meteorological_range_km", "meteorological_range_km"),
    ("Angstrom exponent", "atmosphere", "atmosphere.angstrom_exponent", "angstrom_exponent"),
    ("share of aerosol below the sensor", "atmosphere", "atmosphere.aerosol_share_below", "aerosol_share_below"),
    (WATER, "atmosphere", "atmosphere.water_vapour_g_cm2", "water_vapour_g_cm2"),
    ("ozone", "atmosphere", "atmosphere.ozone_atm_cm", "ozone_atm_cm"),
    ("solar zenith angle", "atmosphere", "atmosphere.solar_zenith_deg", "solar_zenith_deg"),
    ("solar azimuth", "atmosphere", "atmosphere.solar_azimuth_deg", "solar_azimuth_deg"),
    ("view zenith angle", "atmosphere", "atmosphere.view_zenith_deg", "view_zenith_deg"),
    ("view azimuth", "atmosphere", "atmosphere.view_azimuth_deg", "view_azimuth_deg"),
    ("sensor altitude", "atmosphere", "atmosphere.sensor_altitude_km", "sensor_altitude_km"),
    ("ground height", "atmosphere", "atmosphere.ground_altitude_km", "ground_altitude_km"),
    ("solar irradiance", "atmosphere", "light.irradiance", "solar_irradiance_relative"),
    (SURROUNDINGS, "scene", "light.surroundings", "adjacency_reflectance_relative"),
)


# Over wavelength, of the sensor: name, path, field of ``uncertainty``, whether it needs light.
_SENSOR: tuple[tuple[str, str, str, bool], ...] = (
    ("sensor gain", "sensor.gain", "sensor_gain", False),
    ("sensor offset", "sensor.offset", "sensor_offset", False),
    ("noise", "sensor.noise", "noise", True),
    ("electrons per radiance", "sensor.electrons", "electrons", True),
    ("wavelength shift", "sensor.wavelength_shift_nm", "wavelength_shift", False),
    ("reflectance of the dark panel", "line.dark", "elm_panels", False),
    ("reflectance of the bright panel", "line.bright", "elm_panels", False),
)


def inputs_of(world: World, *, shapes: bool = True) -> list[UncertainInput]:
    """The uncertain inputs in the order in which budgets list them: light, surfaces, sensor.

    ``shapes=False`` leaves out the errors of engine and field spectra, whose covariances a prediction uses as they
    stand.

    Raises
    ------
    UsageError : an uncertainty of what the scenario does not have.
    """
    return [*_of_light(world, shapes), *_of_scene(world, shapes), *_of_sensor(world)]


def field_spectrum_of(subject: str) -> str:
    """Name of the input that is the error of a subject's field spectrum."""
    return f"field spectrum of {subject}"


def spectrum_inputs(world: World) -> list[UncertainInput]:
    """Errors of field spectra, as stated or as replicate spectra say of their own mean."""
    inputs: list[UncertainInput] = []
    number: dict[str, int] = {}
    for item in world.stated.scenario.uncertainty.field_spectra:
        subject = item.subject
        number[subject] = number.get(subject, 0) + 1
        name = field_spectrum_of(subject) + ("" if number[subject] == 1 else f" ({number[subject]})")
        surface = replace(world.stated.surfaces[subject], mean=world.mean[0, world.surface(subject)])
        sd = spectrum_error_sd(item, surface, world.stated.axis)
        inputs.append(spectral_input(world, name, "surface", f"surfaces.[{subject}].mean", sd, item))
    for subject, surface in world.stated.surfaces.items():
        if subject not in number and surface.mean_error is not None:
            rows = covariance_directions(np.nan_to_num(surface.mean_error))
            words, path = "as between replicate spectra", f"surfaces.[{subject}].mean"
            inputs.append(number_input(world, field_spectrum_of(subject), "surface", path, 0.0, words=words, rows=rows))
    return inputs


def spectrum_errors(world: World) -> dict[str, Array]:
    """Subject -> (K, B) directions of the error of its field spectrum.

    What replicate spectra say of their own mean stands where the scenario does not say it of the subject; several
    entries of one subject are independent.
    """
    rows: dict[str, list[Array]] = {}
    for item in spectrum_inputs(world):
        rows.setdefault(item.subject, []).append(item.rows)
    return {subject: np.concatenate(each) for subject, each in rows.items()}


def _of_light(world: World, shapes: bool) -> list[UncertainInput]:
    """Atmosphere, sun and view; the engine's errors on the ground-reflected radiance and on the path."""
    u = world.stated.scenario.uncertainty
    if world.stated.scenario.atmosphere is None:
        return []
    inputs = [
        number_input(world, name, kind, path, spread)
        for name, kind, path, field in _NUMBERS
        if (spread := getattr(u, field)) is not None
    ]
    if u.engine is None or not shapes:
        return inputs
    haze = u.engine.per_aerosol_depth
    if haze > 0:
        haze *= world.stated.scenario.atmosphere.aerosol_optical_depth
    for name, part, more in ((ENGINE, u.engine, haze), (ENGINE_LINES, u.engine.fine_structure, 0.0)):
        if part is None or not (part.relative + more > 0 or part.per_optical_depth > 0):
            continue
        sd = np.full(len(world.stated.axis), part.relative + more)
        if part.per_optical_depth > 0:  # greater where gases absorb
            gas = world.stated.atmosphere({}, 1).gas_transmittance[0, 0]
            sd = sd - part.per_optical_depth * np.log(np.clip(gas, 1e-6, 1.0))
        inputs.append(spectral_input(world, name, "engine", "light.ground", sd, part))
    if u.engine.path_relative > 0:
        inputs.append(spectral_input(world, ENGINE_PATH, "engine", "light.path", u.engine.path_relative, u.engine))
    return inputs


def _of_scene(world: World, shapes: bool) -> list[UncertainInput]:
    """Surfaces, then fills and fractions."""
    u = world.stated.scenario.uncertainty
    inputs = spectrum_inputs(world) if shapes else []
    for item in u.fills:
        inputs.append(number_input(world, f"fill of {item.subject}", "scene", f"fill.[{item.subject}]", item.absolute))
    for item in u.fractions:
        name = f"area fraction of {item.subject}"
        inputs.append(number_input(world, name, "scene", f"fraction.[{item.subject}]", item.absolute))
    return inputs


def _of_sensor(world: World) -> list[UncertainInput]:
    """Gain, offset, noise, electrons, places of the bands, panels of the line, blur; the image's compensation."""
    u, light = world.stated.scenario.uncertainty, world.stated.scenario.atmosphere is not None
    inputs = []
    for name, path, field, needs_light in _SENSOR:
        form = getattr(u, field)
        if form is not None and (light or not needs_light):
            sd = form.relative if hasattr(form, "relative") else form.absolute
            inputs.append(spectral_input(world, name, "sensor", path, sd, form))
    widths = [p.fill.geometry for t in world.stated.scenario.scene.targets for p in t.populations]
    if u.psf_fwhm_pixels is not None and any(g is not None for g in widths):
        inputs.append(number_input(world, BLUR, "sensor", "blur", u.psf_fwhm_pixels))
    stated = u.collected_reflectance
    if stated is not None and not light:  # what the image's reflectance is off by
        form = SpectralForm(correlation_nm=stated.correlation_nm)
        for name, path, sd in (
            ("compensation (gain)", "sensor.gain", stated.relative),
            ("compensation (offset)", "sensor.offset", stated.absolute),
        ):
            if sd > 0:
                inputs.append(spectral_input(world, name, "sensor", path, sd, form))
    return inputs


def interpolation_input(world: World) -> list[UncertainInput]:
    """Error of the path radiance by interpolation between the nodes of a table; none without one.

    Its size is :func:`hyperval.atmosphere.between.path_error`; it is smooth over wavelength.
    """
    if world.stated.scenario.atmosphere is None:
        return []
    sigma = world.stated.atmosphere({}, 1).path_uncertainty
    if sigma is None or not np.any(sigma):
        return []
    form = SpectralForm(correlation_nm=INTERPOLATION_NM)
    return [spectral_input(world, TABLE, "engine", "light.path_error", sigma[0, 0], form)]
