"""Uncertainty of the prediction by linearisation: each input up and down, the rest held."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from hyperval.atmosphere import AtmosphericState
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.prediction.budget import ENGINE, ENGINE_LINES, ENGINE_PATH, gas_depth
from hyperval.prediction.departure import (
    Departure,
    departed_noise,
    departed_scenario,
    departed_terms,
    keeps_surfaces,
    with_retrieval,
)
from hyperval.prediction.detection import Detection, RocKey
from hyperval.prediction.forms import form_covariance
from hyperval.prediction.input import Input
from hyperval.prediction.view import View
from hyperval.products import Prediction, RocCurve, SpectralEstimate
from hyperval.scenario import Scenario
from hyperval.scenario_uncertainty import EngineUncertainty, SpectralForm
from hyperval.sensor.specification import Sensor
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Z95 = 1.959963984540054
TABLE, INTERPOLATION_NM = "interpolation of the table", 300.0  # source in the budget; its correlation length
MOST_DIRECTIONS = 24  # of one input over wavelength; the rest of a short correlation length moves little


@dataclass(frozen=True)
class Perturbation:
    """One direction of an input one standard uncertainty up and down; the leading direction has the number 0."""

    source: str
    plus: View
    minus: View
    number: int = 0


def perturbations(
    view: View,
    scenario: Scenario,
    terms_of: Callable[[AtmosphericState], AtmosphericTerms],
    inputs: Sequence[Input],
) -> list[Perturbation]:
    """Views of the scene for every input of light and sensor, one standard uncertainty up and down (3.7).

    ``terms_of`` gives the terms of a state on the bands.  An input that would leave its range is stopped at the end
    of it.  Inputs over wavelength have one pair for each direction.  What changes surfaces, fills or bands is no
    part of it: that needs another prediction (:func:`moved_predictions`).
    """
    found: list[Perturbation] = []
    if view.terms is None:
        return found

    def moved(d: Departure) -> View:
        terms = view.terms
        if d.settings or d.solar_zenith_deg or d.solar_azimuth_deg:
            state = departed_scenario(scenario, d).atmosphere
            terms = terms_of(state) if state is not None else terms
        assert terms is not None  # noqa: S101 - the view has light
        return replace(
            with_retrieval(view, d),
            terms=departed_terms(terms, d),
            average=view.average * d.surroundings,
            noise=departed_noise(view.noise, d),
        )

    for item in inputs:
        if not keeps_surfaces(item.moved(1.0)):
            continue
        for k in range(item.size):
            pair = moved(item.direction(k, 1.0)), moved(item.direction(k, -1.0))
            found.append(Perturbation(item.name, *pair, k))
    return found


@dataclass(frozen=True)
class Moved:
    """Two predictions with one direction of an input one standard uncertainty up and down."""

    source: str
    plus: Prediction
    minus: Prediction


def moved_predictions(
    inputs: Sequence[Input], again: Callable[[Departure], Prediction], most: int = MOST_DIRECTIONS
) -> list[Moved]:
    """Predictions for every input that changes surfaces, fills or bands; ``again`` predicts a departed truth."""
    found = []
    for item in inputs:
        if not keeps_surfaces(item.moved(1.0)):
            for k in range(min(item.size, most)):
                pair = again(item.direction(k, 1.0)), again(item.direction(k, -1.0))
                found.append(Moved(item.name, *pair))
    return found


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
        errors["field spectrum"] = spectrum * np.outer(view.slope(), view.slope())
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
        c = np.nan_to_num(covariance)
        total += c
        budget[source] = np.sqrt(np.diag(c))
    return total, budget


@lru_cache(maxsize=8)
def _nothing(bands: int) -> Array:
    """Zeros (B, B) that all estimates without an error share; not to be written to."""
    zero = np.zeros((bands, bands))
    zero.setflags(write=False)
    return zero


def with_bands(
    roc: Mapping[RocKey, RocCurve], pairs: Sequence[tuple[Detection | Prediction, Detection | Prediction]]
) -> dict[RocKey, RocCurve]:
    """The curves with 95 % intervals of P_D from pairs of perturbed evaluations, combined in probit."""
    result = dict(roc)
    if not pairs:
        return result
    for key, curve in roc.items():
        spread = np.zeros(curve.pd.size)
        for plus, minus in pairs:
            spread += (0.5 * (_probit(plus.roc[key].pd) - _probit(minus.roc[key].pd))) ** 2
        z, half = _probit(curve.pd), Z95 * np.sqrt(spread)
        lower, upper = np.minimum(ndtr(z - half), curve.pd), np.maximum(ndtr(z + half), curve.pd)
        result[key] = replace(curve, pd_lower=lower, pd_upper=upper)
    return result


def _probit(p: Array) -> Array:
    return np.asarray(ndtri(np.clip(p, 1e-300, 1.0 - 1e-16)))
