"""Uncertainty of the prediction by linearisation: each input up and down, the rest held."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from hyperval.prediction.budget import ENGINE, ENGINE_LINES, ENGINE_PATH, gas_depth
from hyperval.prediction.cases import Case, Origins, settings_of, stepped
from hyperval.prediction.departure import Departure, keeps_surfaces
from hyperval.prediction.forms import form_covariance
from hyperval.prediction.input import Input
from hyperval.prediction.view import View
from hyperval.processing.intervals import Z95
from hyperval.products import Prediction, RocCurve, SpectralEstimate
from hyperval.scenario_uncertainty import EngineUncertainty, SpectralForm
from hyperval.sensor.specification import Sensor
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
RocKey = tuple[str, str, str]
Change = tuple[Array, Array]  # by one standard uncertainty up, and down
TABLE, INTERPOLATION_NM = "interpolation of the table", 300.0  # source in the budget; its correlation length
_CURVES = 2048  # drawn for the limits of a ROC curve
MOST_DIRECTIONS = 24  # of one input over wavelength; the rest of a short correlation length moves little


@dataclass(frozen=True, eq=False)
class Steps:
    """The light and sensor one standard uncertainty up and down, along each direction of each input.

    Attributes
    ----------
    sources, numbers : of K directions the input and the number among its own; the leading direction has 0
    plus, minus : K cases each
    view : of all 2K, up first; None where there is none
    """

    sources: tuple[str, ...] = ()
    numbers: tuple[int, ...] = ()
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

    @property
    def leading(self) -> list[int]:
        """Directions that move a score; the rest of an input moves it little."""
        return [i for i, number in enumerate(self.numbers) if number < MOST_DIRECTIONS]


def steps_of(case: Case, origins: Origins, truth: Departure, inputs: Sequence[Input]) -> Steps:
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
    plus, minus = (
        tuple(stepped(case, origins, truth, item.direction(k, z)) for item, k in of) for z in (1.0, -1.0)
    )
    view = settings_of([*plus, *minus]).view
    return Steps(tuple(item.name for item, _ in of), tuple(k for _, k in of), plus, minus, view)


@dataclass(frozen=True)
class Moved:
    """Two predictions with one direction of an input one standard uncertainty up and down."""

    source: str
    plus: Prediction
    minus: Prediction


def moved_predictions(
    inputs: Sequence[Input], again: Callable[[Sequence[Departure]], Iterable[Prediction]],
    most: int = MOST_DIRECTIONS,
) -> list[Moved]:  # fmt: skip
    """Predictions for every input that changes surfaces, fills or bands; ``again`` predicts departed truths."""
    of = [(i, k) for i in inputs if not keeps_surfaces(i.moved(1.0)) for k in range(min(i.size, most))]
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
    spectrum: Array | None,
    sensor: Sensor | None = None,
) -> dict[str, Array]:
    """Error covariances (B, B) of the mean signal by sources that have a shape over wavelength.

    Parameters
    ----------
    spectrum : (B, B) error covariance of the subject's reflectance, taken through D_A (3.11)
    """
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
    if spectrum is not None:
        errors["field spectrum"] = view.through(spectrum)
    return errors


def interpolation_errors(view: View, axis: SpectralAxis) -> dict[str, Array]:
    """Error covariance (B, B) of the path radiance by interpolation between the nodes of a table; none without one.

    Its size is :func:`hyperval.atmosphere.table_aerosol.path_error`; it is smooth over wavelength.
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


def with_bands(
    roc: Mapping[RocKey, RocCurve], changes: Mapping[RocKey, Sequence[Change]]
) -> dict[RocKey, RocCurve]:
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
