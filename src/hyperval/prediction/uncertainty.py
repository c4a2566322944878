"""Uncertainty of the prediction by linearisation: each input up and down, the rest held.

The uncertain inputs of a prediction, as its scenario states them (``uncertainty:``).

Errors of the background's laws where they were fitted to pixels of an image, by leaving out its parts.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from hyperval.atmosphere import AtmosphericTerms
from hyperval.errors import UsageError
from hyperval.prediction.background import View, seen_classes
from hyperval.prediction.batch import Batch
from hyperval.prediction.cases import Case, Origins, Setup, points_of, settings_of, stepped
from hyperval.prediction.departure import Departure, Given, StatisticsDeparture, input_path, keeps_surfaces
from hyperval.prediction.filters import law_scores
from hyperval.prediction.input import (
    Kind,
    UncertainInput,
    covariance_directions,
    form_covariance,
    number_input,
    spectral_input,
    spectrum_error_sd,
)
from hyperval.processing.filters import LINEAR_DETECTORS
from hyperval.processing.intervals import Z95
from hyperval.processing.laws import jackknife_directions
from hyperval.processing.roc_model import ClassScores, false_alarm_grid, log_false_alarm
from hyperval.products import ExceedanceCurve, PredictedProducts, RocCurve, SpectralEstimate
from hyperval.scenario import EngineUncertainty, SampledStatistics, Scenario, SpectralForm
from hyperval.sensor.specification import Sensor
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]

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


def inputs_of(given: Given, *, shapes: bool = True) -> list[UncertainInput]:
    """The uncertain inputs in the order in which budgets list them: light, surfaces, sensor.

    ``shapes=False`` leaves out the errors of engine and field spectra, whose covariances a prediction uses as they
    stand.

    Raises
    ------
    UsageError : an uncertainty of what the scenario does not have.
    """
    return [*_of_light(given, shapes), *_of_scene(given, shapes), *_of_sensor(given)]


def given_of(scenario: Scenario, origins: Origins | None = None) -> Given:
    """What the inputs of a scenario are made of.

    The engine is run only where the error of the engine depends on the absorption of gases.
    """
    source = origins or Origins()
    setup = source.setup(scenario, Departure())

    def terms() -> AtmosphericTerms:
        state = setup.scenario.atmosphere
        assert state is not None  # noqa: S101 - asked for by inputs of the light alone
        return source.terms(setup, state)

    return given_with(setup, terms)


def given_with(setup: Setup, terms: Callable[[], AtmosphericTerms]) -> Given:
    """What the inputs of a scenario that was read are made of."""
    return Given(setup.scenario, setup.used.axis, setup.used.sensor, setup.surfaces, terms)


def gas_depth(gas_transmittance: Array) -> Array:
    """-ln T_gas, at most that of a transmittance of 1e-6 [1]."""
    return np.asarray(-np.log(np.clip(gas_transmittance, 1e-6, 1.0)))


def field_spectrum_of(subject: str) -> str:
    """Name of the input that is the error of a subject's field spectrum."""
    return f"field spectrum of {subject}"


def spectrum_inputs(given: Given) -> list[UncertainInput]:
    """Errors of field spectra, as stated or as replicate spectra say of their own mean."""
    inputs: list[UncertainInput] = []
    number: dict[str, int] = {}
    for item in given.scenario.uncertainty.field_spectra:
        subject = item.subject
        number[subject] = number.get(subject, 0) + 1
        name = field_spectrum_of(subject) + ("" if number[subject] == 1 else f" ({number[subject]})")
        sd = spectrum_error_sd(item, given.surfaces[subject], given.axis)
        inputs.append(spectral_input(given, name, "surface", f"surfaces.[{subject}].mean", sd, item))
    for subject, surface in given.surfaces.items():
        if subject not in number and surface.mean_error is not None:
            rows = covariance_directions(np.nan_to_num(surface.mean_error))
            words = "as between replicate spectra"
            inputs.append(_mean_input(given, field_spectrum_of(subject), "surface", subject, rows, words))
    return inputs


def _mean_input(given: Given, name: str, kind: Kind, subject: str, rows: Array, words: str) -> UncertainInput:
    path = f"surfaces.[{subject}].mean"
    at = input_path(given, path)
    return UncertainInput(name, kind, path, at.nominal, rows, at.to, correlation=words)


def _of_light(given: Given, shapes: bool) -> list[UncertainInput]:
    """Atmosphere, sun and view; the engine's errors on the ground-reflected radiance and on the path."""
    u = given.scenario.uncertainty
    if given.scenario.atmosphere is None:
        return []
    inputs = [
        number_input(given, name, kind, path, spread)
        for name, kind, path, field in _NUMBERS
        if (spread := getattr(u, field)) is not None
    ]
    if u.engine is None or not shapes:
        return inputs
    for name, part in ((ENGINE, u.engine), (ENGINE_LINES, u.engine.fine_structure)):
        if part is None or not (part.relative > 0 or part.per_optical_depth > 0):
            continue
        sd = np.full(len(given.axis), part.relative)
        if part.per_optical_depth > 0:  # greater where gases absorb
            sd = sd + part.per_optical_depth * gas_depth(given.terms().gas_transmittance)
        inputs.append(spectral_input(given, name, "engine", "light.ground", sd, part))
    if u.engine.path_relative > 0:
        inputs.append(spectral_input(given, ENGINE_PATH, "engine", "light.path", u.engine.path_relative, u.engine))
    return inputs


def _of_scene(given: Given, shapes: bool) -> list[UncertainInput]:
    """Surfaces, then fills and fractions, then what sampling leaves open."""
    u = given.scenario.uncertainty
    inputs = spectrum_inputs(given) if shapes else []
    for item in u.fills:
        inputs.append(number_input(given, f"fill of {item.subject}", "scene", f"fill.[{item.subject}]", item.absolute))
    for item in u.fractions:
        name = f"area fraction of {item.subject}"
        inputs.append(number_input(given, name, "scene", f"fraction.[{item.subject}]", item.absolute))
    for sampled in u.sampled_statistics:
        inputs += _sampled(sampled, given)
    return inputs


def _of_sensor(given: Given) -> list[UncertainInput]:
    """Gain, offset, noise, electrons, places of the bands, panels of the line, blur; the image's compensation."""
    u, light = given.scenario.uncertainty, given.scenario.atmosphere is not None
    inputs = []
    for name, path, field, needs_light in _SENSOR:
        form = getattr(u, field)
        if form is not None and (light or not needs_light):
            sd = form.relative if hasattr(form, "relative") else form.absolute
            inputs.append(spectral_input(given, name, "sensor", path, sd, form))
    widths = [p.fill.geometry for t in given.scenario.scene.targets for p in t.populations]
    if u.psf_fwhm_pixels is not None and any(g is not None for g in widths):
        inputs.append(number_input(given, BLUR, "sensor", "blur", u.psf_fwhm_pixels))
    stated = u.collected_reflectance
    if stated is not None and not light:  # what the image's reflectance is off by
        form = SpectralForm(correlation_nm=stated.correlation_nm)
        for name, path, sd in (
            ("compensation (gain)", "sensor.gain", stated.relative),
            ("compensation (offset)", "sensor.offset", stated.absolute),
        ):
            if sd > 0:
                inputs.append(spectral_input(given, name, "sensor", path, sd, form))
    return inputs


def _sampled(item: SampledStatistics, given: Given) -> list[UncertainInput]:
    """Mean and covariance that were estimated from n independent normal samples.

    The mean is normal with covariance S / n.  The truth behind S is an inverse Wishart draw,
    Sigma^-1 ~ W(S^-1 / (n - 1), nu).  With nu = n - B the separation d^T Sigma^-1 d of a matched filter is
    distributed as its pivot says, (n - 1) d^T Sigma^-1 d / d^T S^-1 d ~ chi-square(n - B) (Muirhead, Aspects of
    Multivariate Statistical Theory, 1982, theorem 3.2.12).  Below n = 2 B + 2 the covariance moves by one factor.
    """
    subject, surface = item.subject, given.surfaces[item.subject]
    n = item.effective_n or surface.n
    if n is None:
        raise UsageError(
            f"uncertainty: sampled_statistics of {subject!r}: its source does not say how many samples",
            mend="give effective_n",
        )
    inputs = []
    covariance, words = surface.covariance, f"sampling of {n:.4g} independent samples"
    if item.mean:
        rows = covariance_directions(covariance / n)
        if rows.shape[0]:
            inputs.append(_mean_input(given, f"sampled mean of {subject}", "sampling", subject, rows, words))
    # The variance of any one score: s^2 of n - 1 degrees of freedom; the logarithm of its root is the value.
    path = f"surfaces.[{subject}].spread"
    at = input_path(given, path)
    spread = UncertainInput(
        f"sampled covariance of {subject}", "sampling", path, 0.0,
        np.array([[np.sqrt(0.5 / (n - 1.0))]]), lambda log_factor: at.to(np.exp(log_factor)), words,
        draws=lambda rng: Departure(statistics={subject: drawn_covariance(covariance, n, rng)}),
    )  # fmt: skip
    return [*inputs, spread]


def drawn_covariance(covariance: Array, n: float, rng: np.random.Generator) -> StatisticsDeparture:
    """A truth behind a covariance (B, B) that was estimated from ``n`` samples (see :func:`_sampled`)."""
    live = np.diag(covariance) > 0
    bands = int(live.sum())
    nu = round(n - bands)
    if nu < bands + 2:
        return StatisticsDeparture(factor=float((n - 1.0) / rng.chisquare(n - 1.0)))
    sd = np.sqrt(np.diag(covariance)[live])
    root = np.linalg.cholesky(covariance[np.ix_(live, live)] / np.outer(sd, sd) + 1e-12 * np.eye(bands))
    # Bartlett: A A^T ~ W(I, nu) with A lower triangular; Sigma = (n - 1) R A^-T A^-1 R^T has the law asked for.
    a = np.tril(rng.standard_normal((bands, bands)), -1)
    a[np.diag_indices(bands)] = np.sqrt(rng.chisquare(nu - np.arange(bands)))
    half = np.linalg.solve(a, (sd[:, None] * root).T).T  # R A^-T up to the order of factors
    out = np.zeros_like(covariance)
    out[np.ix_(live, live)] = (n - 1.0) * half @ half.T
    return StatisticsDeparture(covariance=out)


RocKey = tuple[str, str, str]
Change = tuple[Array, Array]  # by one standard uncertainty up, and down
TABLE, INTERPOLATION_NM = "interpolation of the table", 300.0  # source in the budget; its correlation length
_CURVES = 2048  # drawn for the limits of a ROC curve
DRAWN_SHIFT = 1.0  # standard deviations: beyond, even parts of directions moved alone do not add up to that of all
_SHIFT = 0.3  # of a standard deviation: 95 % intervals that are off by it hold 94 %, and ever fewer beyond
_SEEN = 1e-6  # of a probit: below it a change is rounding
_INNER = 3.0  # probits of P_D between which it is looked for


@dataclass(frozen=True, eq=False)
class Steps:
    """The light and sensor one standard uncertainty up and down, along each direction of each input.

    Attributes
    ----------
    sources : of K directions the input
    plus, minus : K cases each
    view : of all 2K, up first; None where there is none
    """

    sources: tuple[str, ...] = ()
    plus: tuple[Case, ...] = ()
    minus: tuple[Case, ...] = ()
    view: View | None = None

    def changes(self, of: Callable[[View], Array]) -> list[tuple[str, Array]]:
        """(source, (B,) change by one standard uncertainty) of what a view gives, for each direction."""
        if self.view is None:
            return []
        values = np.broadcast_to(of(self.view), (2 * len(self.sources), 1, self.view.average.shape[-1]))[:, 0]
        half = len(self.sources)
        return list(zip(self.sources, 0.5 * (values[:half] - values[half:]), strict=True))


def steps_of(case: Case, origins: Origins, truth: Departure, inputs: Sequence[UncertainInput]) -> Steps:
    """Cases for every input of light and sensor, one standard uncertainty up and down (3.7).

    An input that would leave its range is stopped at the end of it.  Inputs over wavelength have one pair for each
    direction.  What changes surfaces, fills or bands is no part of it: that needs predictions of its own
    (:func:`moved_predictions`).

    Parameters
    ----------
    truth : how the case departs already
    """
    if case.terms is None:
        return Steps()
    of = [(item, k) for item in inputs if keeps_surfaces(item.moved(1.0)) for k in range(item.size)]
    if not of:
        return Steps()
    plus, minus = (tuple(stepped(case, origins, truth, item.direction(k, z)) for item, k in of) for z in (1.0, -1.0))
    view = settings_of([*plus, *minus]).view
    return Steps(tuple(item.name for item, _ in of), plus, minus, view)


@dataclass(frozen=True)
class Moved:
    """Two predictions with one direction of an input one standard uncertainty up and down."""

    source: str
    plus: PredictedProducts
    minus: PredictedProducts


def moved_predictions(
    inputs: Sequence[UncertainInput], again: Callable[[Sequence[Departure]], Iterable[PredictedProducts]]
) -> list[Moved]:
    """Predictions for every input that changes surfaces, fills or bands; ``again`` predicts departed truths."""
    of = [(i, k) for i in inputs if not keeps_surfaces(i.moved(1.0)) for k in range(i.size)]
    predictions = iter(again([item.direction(k, z) for item, k in of for z in (1.0, -1.0)]))
    return [Moved(item.name, next(predictions), next(predictions)) for item, _ in of]


def with_moves(estimates: dict[str, SpectralEstimate], product: str, moves: Sequence[Moved]) -> None:
    """Add what the moves say to the errors and budgets of one spectral product, in place."""
    for name, estimate in estimates.items() if moves else ():
        changes = [
            (m.source, 0.5 * (getattr(m.plus, product)[name].mean - getattr(m.minus, product)[name].mean))
            for m in moves
        ]
        total, budget = combined(changes, {}, estimate.mean.size)
        estimates[name] = replace(
            estimate, error_covariance=estimate.error_covariance + total, budget={**estimate.budget, **budget}
        )


def spectral_errors(
    view: View,
    reflectance: Array,
    axis: SpectralAxis,
    engine: EngineUncertainty | None,
    sensor: Sensor | None = None,
) -> dict[str, Array]:
    """Error covariances (B, B) of the mean signal by the engine."""
    errors: dict[str, Array] = {}
    if engine is not None and view.terms is not None:
        ground = view.level(reflectance) - view.terms.path_radiance
        u = (engine.relative + engine.per_optical_depth * gas_depth(view.terms.gas_transmittance)) * ground
        errors[ENGINE] = form_covariance(u, engine, axis, sensor)
        if engine.fine_structure is not None:
            fine = engine.fine_structure
            u = (fine.relative + fine.per_optical_depth * gas_depth(view.terms.gas_transmittance)) * ground
            errors[ENGINE_LINES] = form_covariance(u, fine, axis, sensor)
        if engine.path_relative:
            u = engine.path_relative * view.terms.path_radiance
            errors[ENGINE_PATH] = form_covariance(u, engine, axis, sensor)
    return errors


def interpolation_errors(view: View, axis: SpectralAxis) -> dict[str, Array]:
    """Error covariance (B, B) of the path radiance by interpolation between the nodes of a table; none without one.

    Its size is :func:`hyperval.atmosphere.table.path_error`; it is smooth over wavelength.
    """
    sigma = None if view.terms is None else view.terms.path_uncertainty
    if sigma is None or not np.any(sigma):
        return {}
    form = SpectralForm(correlation_nm=INTERPOLATION_NM)
    return {TABLE: form_covariance(sigma, form, axis)}


def combined(
    changes: Sequence[tuple[str, Array]], covariances: Mapping[str, Array], bands: int
) -> tuple[Array, dict[str, Array]]:
    """Error covariance (B, B) and budget from independent sources.

    Parameters
    ----------
    changes : sources with their (B,) changes per standard uncertainty, fully correlated between bands; a source of
        several directions stands once for each
    covariances : source -> (B, B)
    """
    budget: dict[str, Array] = {}
    if not changes and not covariances:
        return _nothing(bands), budget
    total = np.zeros((bands, bands))
    if changes:
        rows = np.nan_to_num(np.stack([change for _, change in changes]))
        total += rows.T @ rows
        for source, d in zip((name for name, _ in changes), rows, strict=True):
            budget[source] = np.hypot(budget[source], d) if source in budget else np.abs(d)
    for source, covariance in covariances.items():
        c = known(covariance)
        total += c
        budget[source] = np.sqrt(np.diag(c))
    return total, budget


def known(covariance: Array) -> Array:
    """The matrix with 0 where nothing is known; unchanged, and not copied, where all is."""
    return covariance if np.isfinite(np.sum(covariance)) else np.nan_to_num(covariance)


@lru_cache(maxsize=8)
def _nothing(bands: int) -> Array:
    """Zeros (B, B) that all estimates without an error share; not to be written to."""
    zero = np.zeros((bands, bands))
    zero.setflags(write=False)
    return zero


def with_bands(roc: Mapping[RocKey, RocCurve], changes: Mapping[RocKey, Sequence[Change]]) -> dict[RocKey, RocCurve]:
    """The curves with 95 % intervals of P_D from drawn curves.

    Each draw moves a whole curve along all directions of all inputs at once: by as many times the change that one
    standard uncertainty up or down makes of it, in probit.  A ROC curve rises with P_FA; a draw that does not,
    being extrapolated, is put in rising order, which brings it nearer to any curve that rises (Chernozhukov,
    Fernandez-Val & Galichon, Biometrika 96, 559, 2009), and so are the limits.

    Parameters
    ----------
    changes : key -> for each direction the changes (K,) of probit P_D by one standard uncertainty up and down
    """
    return {key: _with_limits(curve, changes.get(key, ())) for key, curve in roc.items()}


def mean_shifts(roc: Mapping[RocKey, RocCurve], changes: Mapping[RocKey, Sequence[Change]]) -> dict[RocKey, float]:
    """How far both signs of the errors move a curve the same way, in standard deviations of its probit, at most.

    Half the sum of the changes up and down, over all directions, is by how much the mean of draws would be off the
    stated curve if the directions did not hold each other back; it says how far one evaluation up and down of each
    can be trusted.
    """
    shifts = {}
    for key, pairs in changes.items():
        up, down = (np.array([pair[i] for pair in pairs]) for i in (0, 1))
        inner = np.abs(probit(roc[key].pd)) < _INNER
        sd = np.sqrt(((0.5 * (up - down)) ** 2).sum(axis=0))[inner] if pairs else np.zeros(0)
        if np.any(sd > _SEEN):
            shift = np.abs(0.5 * (up + down).sum(axis=0))[inner]
            shifts[key] = float(np.max(shift[sd > _SEEN] / sd[sd > _SEEN]))
    return shifts


def shift_notes(shifts: Mapping[RocKey, float], drawn: Collection[RocKey], samples: int) -> list[str]:
    """Words for intervals that shifts of the mean make rough, and for those that are drawn for it."""
    named = {key: f"{' '.join(key)} ({shift:.2g})" for key, shift in shifts.items() if shift > _SHIFT}
    rough = [name for key, name in named.items() if key not in drawn]
    notes = []
    if drawn:
        notes.append(
            f"P_D intervals from {samples} draws of the budget, as errors shift the mean by more than its standard "
            f"deviation, or would if each came alone: {', '.join(named[key] for key in drawn)}"
        )
    if rough:
        notes.append(
            "the errors shift the mean of P_D (in standard deviations of its probit, at most), which its interval "
            f"holds roughly: {', '.join(rough)}; draw the budget for more: uncertainty: {{method: both}}"
        )
    return notes


def _with_limits(curve: RocCurve, changes: Sequence[Change]) -> RocCurve:
    if not any(np.any(part) for pair in changes for part in pair):
        return curve
    up, down = (np.array([pair[i] for pair in changes]) for i in (0, 1))
    c = _normal_draws(len(changes))
    z, even = probit(curve.pd), 0.5 * (up - down)
    drawn = np.sort(z + np.maximum(c, 0.0) @ up + np.maximum(-c, 0.0) @ down, axis=1)
    # The even part has its limits in closed form: the draws say by how much the whole differs from it.
    half, plain = Z95 * np.sqrt((even**2).sum(axis=0)), z + c @ even
    (low, high), (even_low, even_high) = (np.quantile(x, [0.025, 0.975], axis=0) for x in (drawn, plain))
    low, high = (ndtr(np.sort(x)) for x in (low - even_low + z - half, high - even_high + z + half))
    return replace(curve, pd_lower=np.minimum(low, curve.pd), pd_upper=np.maximum(high, curve.pd))


@lru_cache(maxsize=8)
def _normal_draws(directions: int) -> Array:
    """(N, directions) standard normal numbers, evenly spread (Sobol, scrambled), the same for all curves."""
    from scipy.stats import qmc  # a quarter of a second with what it loads, which a certain scenario does not need

    draws = np.asarray(ndtri(qmc.Sobol(directions, seed=12).random(_CURVES)))
    draws.setflags(write=False)
    return draws


def probit(p: Array) -> Array:
    """Phi^-1 of probabilities, kept finite."""
    return np.asarray(ndtri(np.clip(p, 1e-300, 1.0 - 1e-16)))


Filter = tuple[str, str]


def setups_without(scenario: Scenario, origins: Origins, truth: Departure) -> Iterable[Sequence[Setup]]:
    """For each region whose law is known from its pixels, the scenario as it truly is without each part of them."""
    if origins.left_out is None or not scenario.scene.targets or not _linear(scenario):
        return
    # A part may leave a mixture with fewer components than the class asks for.
    classes = [c.model_copy(update={"mixture": "auto"}) if c.has_mixture else c for c in scenario.scene.classes]
    free = scenario.model_copy(update={"scene": scenario.scene.model_copy(update={"classes": classes})})
    for region, without in origins.left_out():
        measured = origins.measured or {}
        yield [replace(origins, measured={**measured, region: part}).setup(free, truth) for part in without]


def law_directions(batch: Batch, case: Case, setups: Iterable[Sequence[Setup]]) -> dict[Filter, Array]:
    """(target, linear detector) -> (D, K) changes of ln P_FA (3.33) at the thresholds of its curve.

    One for each part of each region, independent of each other; the square root of the sum of their squares is the
    standard error that the pixels leave.  The filters stay: they look at both sides through the same weights.

    Parameters
    ----------
    case : the first of the batch
    """
    grid = batch.scenario.processing.false_alarm_grid
    pfa = false_alarm_grid(grid.lowest, grid.per_decade)
    names = [(t, d) for t in batch.targets for d in _linear(batch.scenario)]
    thresholds = {(t.name, d): batch.scores(t.populations[0].name, d).thresholds(pfa[None])[0] for t, d in names}
    directions: dict[Filter, list[Array]] = {key: [] for key in thresholds}
    for region in setups:
        values: dict[Filter, list[Array]] = {key: [] for key in thresholds}
        for setup in region:
            laws = _law_scores(batch, replace(case, setup=setup))
            for key, x in thresholds.items():
                rows = laws[key].rows(np.zeros(x.size, int))
                values[key].append(log_false_alarm(x, rows)[0])
        for key, each in values.items():
            directions[key].append(jackknife_directions(each))
    return {key: np.concatenate(parts) for key, parts in directions.items() if parts}


def _law_scores(batch: Batch, case: Case) -> dict[Filter, ClassScores]:
    """Scores of the background's laws of another case by the filters of the first evaluation of a batch."""
    settings = settings_of([case])
    group = next(g for g in batch.groups if 0 in g.numbers)
    own = np.flatnonzero(group.numbers == 0)
    at = settings.at(group.bands, batch.needed)
    seen = seen_classes(at)
    dof = points_of([case], np.zeros(1, int)).law_dof
    return {
        key: ClassScores(settings.law_fractions(), *law_scores(at, seen, filters.rows(own)), dof)
        for key, (filters, _, _) in group.filters.items()
    }


def with_law_errors(
    exceedance: Mapping[Filter, ExceedanceCurve], directions: Mapping[Filter, Array]
) -> dict[Filter, ExceedanceCurve]:
    """The predicted curves, with 95 % limits where the law was fitted to pixels."""
    curves = dict(exceedance)
    for key, of_curve in directions.items():
        half, p = Z95 * np.sqrt((of_curve**2).sum(axis=0))[::-1], curves[key].probability
        curves[key] = replace(curves[key], lower=p * np.exp(-half), upper=np.minimum(p * np.exp(half), 1.0))
    return curves


def with_law_limits(curve: RocCurve, alarms: ExceedanceCurve) -> RocCurve:
    """The curve with the limits of P_FA at its thresholds taken into those of P_D.

    Where the background has more alarms than the law says, the threshold of a P_FA lies higher and P_D lower: the
    limits are the curve drawn against those of P_FA, in quadrature with the curve's own, in probit.
    """
    z, low, high = (probit(pd) for pd in (curve.pd, curve.pd_lower, curve.pd_upper))
    # Limits of P_FA rise with it; far out, where the law says little, they need not.
    less = np.maximum.accumulate(np.log(alarms.lower[::-1]))
    more = np.minimum.accumulate(np.log(alarms.upper))[::-1]
    at = np.log(curve.pfa)
    up = z + np.hypot(high - z, np.maximum(_read(at, less, z) - z, 0.0))
    down = z - np.hypot(z - low, np.maximum(z - _read(at, more, z), 0.0))
    return replace(curve, pd_lower=ndtr(np.maximum.accumulate(down)), pd_upper=ndtr(np.maximum.accumulate(up)))


def _read(at: Array, x: Array, z: Array) -> Array:
    """A curve z over x, both rising, at places ``at``; beyond its ends with the slope over ``at`` there."""
    below, above = (z[1] - z[0]) / (at[1] - at[0]), (z[-1] - z[-2]) / (at[-1] - at[-2])
    inside = np.interp(at, x, z)
    return np.asarray(inside + below * np.minimum(at - x[0], 0.0) + above * np.maximum(at - x[-1], 0.0))


def _linear(scenario: Scenario) -> list[str]:
    return [d for d in scenario.processing.detectors if d in LINEAR_DETECTORS]
