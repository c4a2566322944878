"""The uncertain inputs of a scenario: a dotted path, its stated value, and the error of that.

An input has K independent directions with factors of mean 0 and variance 1, which give the value at its path
(:data:`hyperval.model.world.PATHS`).  Budgets, draws, attribution and what-ifs are designs over inputs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from hyperval.data import Array, Mask
from hyperval.errors import needed, refuse
from hyperval.model.stated import SurfaceStatistics, Truth, band_correlation, band_error_covariance, error_of_mean
from hyperval.model.world import NEUTRAL, NOT_WITHOUT_LIGHT, PATHS, SHIFT, World, find_path, matches_path, value_at
from hyperval.scenario import SpectralForm, SpectrumUncertainty
from hyperval.sensor.specification import Sensor
from hyperval.settings import path_parts
from hyperval.spectra.axis import SpectralAxis

# Part of the variance in the directions left out, all together: where curves are computed for each direction, and
# where a spectrum's covariance is inverted in a test, which is sensitive to small ones.
_TRUNCATED, _NEGLIGIBLE = 1e-6, 1e-14


def error_rows(sd: Array, form: SpectralForm, axis: SpectralAxis, sensor: Sensor | None = None) -> Array:
    """(K, B) independent directions of an error with standard deviation ``sd`` (B,), the greatest first.

    The error is the sum of the rows, each with a factor of mean 0 and variance 1: its covariance is D^T D.
    """
    u = np.nan_to_num(np.asarray(sd, dtype=float))
    if form.correlation_nm is not None:
        return covariance_directions(np.outer(u, u) * band_correlation(axis, form.correlation_nm))
    if form.correlation == "random":
        return np.asarray(np.diag(u)[u > 0])
    if form.correlation == "arms":
        rows = np.where(_arm_bands(axis, sensor), u, 0.0)
        rows = rows[np.any(rows > 0, axis=1)]
        return np.asarray(rows[np.argsort(-(rows**2).sum(axis=1), kind="stable")])
    return np.asarray(u[None, :])


def covariance_directions(covariance: Array) -> Array:
    """(K, B) rows sqrt(lambda) v of a covariance (B, B), the greatest first, each with a positive sum."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    values, vectors = np.clip(values[::-1], 0.0, None), vectors[:, ::-1]
    if values[0] <= 0.0:
        return np.zeros((0, covariance.shape[0]))
    keep = leading_count(values, _NEGLIGIBLE)
    rows = (np.sqrt(values[:keep]) * vectors[:, :keep]).T
    return np.asarray(rows * np.where(rows.sum(axis=1) < 0, -1.0, 1.0)[:, None])


def leading_count(variances: Array, left_out: float) -> int:
    """Number of leading variances (falling) that leave out no more than a part of their sum."""
    remainder = 1.0 - np.cumsum(variances) / variances.sum()
    return int(np.searchsorted(-remainder, -left_out)) + 1


def correlation_words(form: SpectralForm) -> str:
    """The correlation form in words."""
    if form.correlation_nm is not None:
        return f"correlation length {form.correlation_nm:.4g} nm"
    words = {"random": "random by band", "arms": "one error for each arm of the sensor"}
    return words.get(form.correlation or "", "systematic: one error for all bands")


def _arm_bands(axis: SpectralAxis, sensor: Sensor | None) -> Mask:
    """(K, B) bands of each arm that are in no earlier one; bands outside all arms share one error."""
    w, arms = axis.centre_nm, sensor.specification.arms if sensor is not None else ()
    refuse(not arms, "uncertainty.arms")
    in_arm = np.array([*((w >= low) & (w <= high) for low, high in (arm.range_nm for arm in arms)), w > -np.inf])
    return np.asarray(in_arm & (np.cumsum(in_arm, axis=0) == 1))


def spectrum_error_rows(item: SpectrumUncertainty, surface: SurfaceStatistics, sensor: Sensor | None = None) -> Array:
    """(K, B) directions of the error of the field spectrum of one subject [1].

    Raises
    ------
    UsageError : the file carries no standard deviation, or no n for a standard error.

    Examples
    --------
    The error of the mean of three readings has Student's factor, with any correlation between bands.

    >>> from hyperval.spectra import SpectralAxis
    >>> axis, sampled = SpectralAxis([500.0, 510.0], 5.0), (np.arange(490.0, 521.0), np.full(31, 0.01))
    >>> about = {"standard_deviation": np.full(2, 0.01), "sampled_deviation": sampled}
    >>> lawn = SurfaceStatistics("lawn", axis, np.ones(2), np.zeros((2, 2)), 3, **about)
    >>> own = SpectrumUncertainty(subject="lawn", from_file=True, divisor="standard_error")
    >>> rows = [spectrum_error_rows(own.model_copy(update={"correlation_nm": nm}), lawn) for nm in (None, 1e5)]
    >>> [np.sqrt(np.sum(r**2, axis=0)).round(6).tolist() for r in rows], round(2.195 * 0.01 / 3**0.5, 6)
    ([[0.012674, 0.012674], [0.012674, 0.012674]], 0.012673)
    """
    if not item.from_file:
        sd = (item.absolute or 0.0) + (item.relative or 0.0) * np.nan_to_num(surface.mean)
        return error_rows(sd, item, surface.axis, sensor)
    deviation, axis = needed(surface.sampled_deviation, "uncertainty.deviation", subject=item.subject), surface.axis
    n = (surface.n or 0) if item.divisor == "standard_error" else 1
    refuse(not n, "uncertainty.count", subject=item.subject)
    if item.correlation_nm is not None:
        return covariance_directions(error_of_mean(band_error_covariance(*deviation, item.correlation_nm, axis), n))
    sd = np.asarray(surface.standard_deviation) * np.sqrt(error_of_mean(np.ones(1), n))
    return error_rows(sd, item, axis, sensor)


Kind = Literal["atmosphere", "surface", "sensor", "scene", "engine"]


@dataclass(frozen=True, eq=False)
class UncertainInput:
    """An uncertain input.

    Attributes
    ----------
    name : for users; one budget has each name once
    kind : what sort of input
    path : of its value (:data:`hyperval.model.world.PATHS`)
    nominal : (n,) stated value: a number, or numbers over wavelength or over items
    rows : (K, n) change of it per unit along each direction, the leading one first; one unit is one standard
        uncertainty
    low, high : limits of the value
    correlation : of errors over wavelength, in words
    """

    name: str
    kind: Kind
    path: str
    nominal: Array
    rows: Array
    low: float | Array = -np.inf
    high: float | Array = np.inf
    correlation: str = "one number"

    @cached_property
    def size(self) -> int:
        """Number of directions whose effects are computed one by one; the rest hold a millionth of the variance."""
        variances = (self.rows**2).sum(axis=1)
        falling = np.all(np.diff(variances) <= 1e-12 * variances[:1]) and np.any(variances)
        return min(leading_count(variances, _TRUNCATED), len(self.rows)) if falling else len(self.rows)

    @property
    def subject(self) -> str:
        """The surface whose mean it is; empty for anything else."""
        parts = path_parts(self.path)
        return parts[1] if parts[0] == "surfaces" and parts[2] == "mean" else ""

    @property
    def scale(self) -> tuple[float, str]:
        """Standard uncertainty and its unit: per cent of the value for a spectrum or a factor.

        >>> UncertainInput("offset", "sensor", "sensor.offset", np.zeros(2), np.full((1, 2), 0.02)).scale
        (0.02, 'uW cm-2 sr-1 nm-1')
        >>> UncertainInput("share", "scene", "fraction.[soil]", np.zeros(1), np.full((1, 1), 0.02)).scale
        (0.02, '')
        """
        sd = np.sqrt((self.rows**2).sum(axis=0))
        if self.path.startswith("atmosphere.") or not np.any(self.nominal):
            return float(np.median(sd)), PATHS.get(self.path, PATHS["**"]).unit.removeprefix("1")
        with np.errstate(divide="ignore", invalid="ignore"):
            return float(np.nanmedian(100.0 * sd / np.abs(self.nominal))), "%"

    @property
    def is_light(self) -> bool:
        """Whether it moves light, sensor or empirical line, and no surface, fill or band."""
        return path_parts(self.path)[0] in ("atmosphere", "light", "sensor", "line") and self.path != SHIFT

    def perturbation(self, c: Array) -> dict[str, Any]:
        """The truth at factors (K,) of the directions."""
        return {self.path: np.clip(self.nominal + c @ self.rows[: len(c)], self.low, self.high)}

    def perturbation_along(self, k: int, z: float) -> dict[str, Any]:
        """The truth ``z`` units along direction ``k``, the rest as stated."""
        return self.perturbation(z * np.eye(len(self.rows))[k])


def add_perturbations(moves: Iterable[tuple[UncertainInput, Truth]]) -> dict[str, Any]:
    """The truth in which several inputs are moved at once: changes at one path add up."""
    moved: dict[str, Any] = {}
    for item, truth in moves:
        for path, value in truth.items():
            moved[path] = moved[path] + value - item.nominal if path in moved else value
    return moved


def draw_truths(inputs: Sequence[UncertainInput], count: int, seed: int) -> list[dict[str, Any]]:
    """Truths with every input drawn from its distribution, independently of the others."""
    rng = np.random.default_rng(seed)
    return [add_perturbations((i, i.perturbation(rng.standard_normal(i.size))) for i in inputs) for _ in range(count)]


def number_input(
    world: World, name: str, kind: Kind, path: str, spread: float | Array, *,
    words: str = "one number", rows: Array | None = None,
) -> UncertainInput:  # fmt: skip
    """An input of one number, or of several that move together.

    ``spread`` : standard uncertainty of each;  ``rows`` : (K, n) directions in its place
    """
    entry = find_path(world.stated, path)
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
    return UncertainInput(name, kind, path, nominal, np.asarray(rows), low, high, words)


def spectral_input(
    world: World, name: str, kind: Kind, path: str, sd: Array | float, form: SpectralForm
) -> UncertainInput:
    """An input over wavelength with standard uncertainty ``sd`` (B,) and the correlation of ``form``."""
    axis = world.stated.axis
    rows = error_rows(np.broadcast_to(sd, len(axis)), form, axis, world.stated.sensor)
    return number_input(world, name, kind, path, 0.0, words=correlation_words(form), rows=rows)


TABLE, INTERPOLATION_NM = "interpolation of the table", 300.0  # source in the budget; its correlation length
ENGINE, ENGINE_LINES, ENGINE_PATH = (
    "radiative-transfer engine", "engine's fine structure", "engine's path radiance"
)  # fmt: skip


def uncertain_inputs(world: World) -> list[UncertainInput]:
    """The uncertain inputs in the order in which budgets list them: light, surfaces, sensor.

    Raises
    ------
    UsageError : an uncertainty of a quantity that the scenario does not have.
    """
    stated = list(_stated_inputs(world))
    light, sensor = ([i for i in stated if (i.kind == "sensor") is of_sensor] for of_sensor in (False, True))
    return [*light, *_rt_inputs(world), *spectrum_inputs(world), *_scene_inputs(world), *sensor, *_image_inputs(world)]


def _stated_inputs(world: World) -> Iterator[UncertainInput]:
    """Inputs with an uncertainty stated in the scenario, as named by :data:`hyperval.model.PATHS`."""
    scenario = world.stated.scenario
    for path, entry in PATHS.items():
        form = getattr(scenario.uncertainty, entry.stated) if entry.stated else None
        if form is None or (scenario.atmosphere is None and any(matches_path(p, path) for p in NOT_WITHOUT_LIGHT)):
            continue
        if isinstance(form, SpectralForm):
            sd = form.relative if hasattr(form, "relative") else getattr(form, "absolute", 0.0)
            yield spectral_input(world, entry.name, "sensor", path, sd, form)
        else:
            kind: Kind = "scene" if entry.field == "surroundings" else "atmosphere"
            yield number_input(world, entry.name, kind, path, form)


def field_spectrum_of(subject: str) -> str:
    """Name of the input that is the error of a subject's field spectrum."""
    return f"field spectrum of {subject}"


def spectrum_inputs(world: World) -> Iterator[UncertainInput]:
    """Errors of field spectra, as stated, or of the mean of replicate spectra.

    By subject, independent of the order in the file, as draws depend on the order of inputs.

    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import predict
    >>> unlit = load_scenario("green-planks-grass").model_copy(update={"atmosphere": None})
    >>> listed = [{"subject": "grass", "relative": 0.05, "correlation_nm": 60}, {"subject": "grass", "relative": 0.1},
    ...           {"subject": "soil", "relative": 0.1, "correlation_nm": 60}]
    >>> curves = [predict(unlit.with_values({"uncertainty.field_spectra": each})).roc["green plank 0.4", "cem", "pixel"]
    ...           for each in (listed, listed[::-1])]
    >>> np.array_equal(*(curve.pd_lower for curve in curves)), np.array_equal(*(curve.pd_upper for curve in curves))
    (True, True)
    """
    number: dict[str, int] = {}
    for item in sorted(world.stated.scenario.uncertainty.field_spectra, key=lambda one: (one.subject, repr(one))):
        subject = item.subject
        number[subject] = number.get(subject, 0) + 1
        name = field_spectrum_of(subject) + ("" if number[subject] == 1 else f" ({number[subject]})")
        surface = replace(world.stated.surfaces[subject], mean=world.mean[0, world.surface_number(subject)])
        rows, path = spectrum_error_rows(item, surface, world.stated.sensor), f"surfaces.[{subject}].mean"
        yield number_input(world, name, "surface", path, 0.0, words=correlation_words(item), rows=rows)
    for subject, surface in world.stated.surfaces.items():
        if subject not in number and surface.mean_error is not None:
            rows = covariance_directions(np.nan_to_num(surface.mean_error))
            words, path = "as between replicate spectra", f"surfaces.[{subject}].mean"
            yield number_input(world, field_spectrum_of(subject), "surface", path, 0.0, words=words, rows=rows)


def spectrum_errors(inputs: Iterable[UncertainInput]) -> dict[str, Array]:
    """Subject -> (K, B) directions of the error of its field spectrum, from the inputs of that kind.

    Several inputs of one subject are independent.
    """
    rows: dict[str, list[Array]] = {}
    for item in (item for item in inputs if item.kind == "surface"):
        rows.setdefault(item.subject, []).append(item.rows)
    return {subject: np.concatenate(blocks) for subject, blocks in rows.items()}


def _rt_inputs(world: World) -> Iterator[UncertainInput]:
    """The engine's errors on the ground-reflected radiance and on the path."""
    atmosphere, u = world.stated.scenario.atmosphere, world.stated.scenario.uncertainty.engine
    if atmosphere is None or u is None:
        return
    haze = u.per_aerosol_depth
    if haze > 0:
        haze *= atmosphere.aerosol_optical_depth
    for name, part, extra in ((ENGINE, u, haze), (ENGINE_LINES, u.fine_structure, 0.0)):
        if part is None or not (part.relative + extra > 0 or part.per_optical_depth > 0):
            continue
        sd = np.full(len(world.stated.axis), part.relative + extra)
        if part.per_optical_depth > 0:  # greater where gases absorb
            gas = world.stated.atmosphere({}, 1).gas_transmittance[0, 0]
            sd = sd - part.per_optical_depth * np.log(np.clip(gas, 1e-6, 1.0))
        yield spectral_input(world, name, "engine", "light.ground", sd, part)
    if u.path_relative > 0:
        yield spectral_input(world, ENGINE_PATH, "engine", "light.path", u.path_relative, u)


def _scene_inputs(world: World) -> Iterator[UncertainInput]:
    """Fills and fractions.

    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import read_world
    >>> listed = [{"subject": name, "absolute": 0.01} for name in ("soil", "grass")]
    >>> world = read_world(load_scenario("green-planks-grass").with_values({"uncertainty.fractions": listed}))
    >>> [each.name for each in _scene_inputs(world)]
    ['area fraction of grass', 'area fraction of soil']
    """
    u = world.stated.scenario.uncertainty
    for words, path, items in (("fill", "fill", u.fills), ("area fraction", "fraction", u.fractions)):
        for item in sorted(items, key=lambda one: one.subject):  # in whatever order a file lists them
            yield number_input(world, f"{words} of {item.subject}", "scene", f"{path}.[{item.subject}]", item.absolute)


def _image_inputs(world: World) -> Iterator[UncertainInput]:
    """Blur, and the error of the atmospheric compensation of an image in reflectance.

    It is common to all field spectra compared with the image, and cancels in spectra measured on the image.

    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import Origins, predict, read_world
    >>> stated = {"uncertainty.collected_reflectance": {"relative": 0.04, "absolute": 0.003}}
    >>> scenario = load_scenario("green-planks-grass").model_copy(update={"atmosphere": None}).with_values(stated)
    >>> made = predict(scenario)
    >>> [bool(np.allclose(made.reflectance[name].budget["compensation (gain)"], 0.04 * made.reflectance[name].mean))
    ...  for name in ("grass", "green plank 0.4")]
    [True, True]
    >>> grass = made.reflectance["grass"]
    >>> [(round(of.size, 9), of.unit) for of in grass.errors.values()]
    [(4.0, '%'), (0.003, '')]
    >>> [set(of.ravel().round(9).tolist()) for of in (grass.budget["compensation (offset)"], grass.spread_errors[0])]
    [{0.003}, {0.04}]

    It changes the contrast of targets to ground measured on the image: P_D has the error by both propagations.

    >>> ground = {name: read_world(scenario).stated.surfaces[name] for name in ("asphalt", "grass", "soil")}
    >>> seen = {f"scene.classes.{n}.spectrum": {"measured": n} for n in ground} | {"uncertainty.samples": 40}
    >>> ways = [predict(scenario.with_values({**seen, "uncertainty.method": method}), Origins(measured=ground))
    ...         for method in ("linear", "monte-carlo")]
    >>> curves = [way.roc["green plank 0.2", "cem", "pixel"] for way in ways]
    >>> [[round(float(limit[140]), 1) for limit in (curve.pd_lower, curve.pd_upper)] for curve in curves]
    [[0.5, 0.7], [0.5, 0.7]]
    >>> ways[0].reflectance["grass"].budget
    {}
    """
    scenario = world.stated.scenario
    u, fills = scenario.uncertainty, [p.fill for t in scenario.scene.targets for p in t.populations]
    if u.psf_fwhm_pixels is not None and any(fill.geometry is not None for fill in fills):
        yield number_input(world, "blur (PSF width)", "sensor", "blur", u.psf_fwhm_pixels)
    stated = u.collected_reflectance
    if stated is not None and scenario.atmosphere is None:
        form = SpectralForm(correlation_nm=stated.correlation_nm)
        for part, sd in (("gain", stated.relative), ("offset", stated.absolute)):
            if sd > 0:
                yield spectral_input(world, f"compensation ({part})", "sensor", f"sensor.{part}", sd, form)


def inputs_of_spectra(world: World) -> Iterator[UncertainInput]:
    """Inputs in the budgets of mean spectra alone.

    The error of interpolating path radiance between the nodes of a table is
    :func:`hyperval.atmosphere.between.path_error`, smooth over wavelength.
    """
    sigma = world.stated.atmosphere({}, 1).path_uncertainty
    if sigma is not None and np.any(sigma):
        form = SpectralForm(correlation_nm=INTERPOLATION_NM)
        yield spectral_input(world, TABLE, "engine", "light.path_error", sigma[0, 0], form)
