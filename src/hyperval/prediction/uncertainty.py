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
from hyperval.atmosphere.visibility import aot550_from_range
from hyperval.errors import UsageError
from hyperval.prediction.detection import Detection, RocKey
from hyperval.prediction.inputs import SurfaceStatistics, correlation
from hyperval.prediction.view import View
from hyperval.products import RocCurve
from hyperval.scenario import Scenario
from hyperval.scenario_uncertainty import EngineUncertainty, SpectrumUncertainty
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Z95 = 1.959963984540054


@dataclass(frozen=True)
class Perturbation:
    """One scalar input one standard uncertainty up and down."""

    source: str
    plus: View
    minus: View


def perturbations(
    view: View, scenario: Scenario, terms_of: Callable[[AtmosphericState], AtmosphericTerms]
) -> list[Perturbation]:
    """Views of the scene for every scalar input with an uncertainty (linearisation of 3.7).

    ``terms_of`` gives the terms of a state on the bands.  An input that would leave its range is
    stopped at the end of it.
    """
    found: list[Perturbation] = []
    u, state, terms = scenario.uncertainty, scenario.atmosphere, view.terms
    if state is None or terms is None:
        return found
    steps = (
        ("aerosol optical depth", "aot550", u.aot550),
        ("water vapour", "water_vapour_g_cm2", u.water_vapour_g_cm2),
        ("ozone", "ozone_atm_cm", u.ozone_atm_cm),
    )
    for source, name, step in steps:
        if step is not None:
            up, down = _shifted(state, name, step), _shifted(state, name, -step)
            found.append(
                Perturbation(source, replace(view, terms=terms_of(up)), replace(view, terms=terms_of(down)))
            )
    if u.solar_irradiance_relative is not None:
        x = u.solar_irradiance_relative
        found.append(Perturbation("solar irradiance", _brighter(view, terms, 1 + x), _brighter(view, terms, 1 - x)))
    if u.adjacency_reflectance_relative is not None:
        x = u.adjacency_reflectance_relative
        up_view = replace(view, average=view.average * (1 + x))
        found.append(Perturbation("surroundings", up_view, replace(view, average=view.average * (1 - x))))
    return found


def spectral_errors(
    view: View, reflectance: Array, axis: SpectralAxis, engine: EngineUncertainty | None, spectrum: Array | None
) -> dict[str, Array]:
    """Error covariances (B, B) of the mean signal by sources that have a shape over wavelength.

    Parameters
    ----------
    spectrum : (B, B) error covariance of the subject's reflectance, taken through D_A (3.11)
    """
    errors: dict[str, Array] = {}
    if engine is not None and view.terms is not None:
        shape = correlation(axis, engine.correlation_nm)
        depth = -np.log(np.clip(view.terms.gas_transmittance, 1e-6, 1.0))
        ground = view.level(reflectance) - view.terms.path_radiance
        u = (engine.relative + engine.per_optical_depth * depth) * ground
        errors["radiative-transfer engine"] = np.outer(u, u) * shape
        if engine.path_relative:
            u = engine.path_relative * view.terms.path_radiance
            errors["engine's path radiance"] = np.outer(u, u) * shape
    if spectrum is not None:
        errors["field spectrum"] = spectrum * np.outer(view.slope(), view.slope())
    return errors


def combined(
    changes: Mapping[str, Array], covariances: Mapping[str, Array], bands: int
) -> tuple[Array, dict[str, Array]]:
    """Error covariance (B, B) and budget from independent sources.

    Parameters
    ----------
    changes : source -> (B,) change per standard uncertainty, fully correlated between bands
    covariances : source -> (B, B)
    """
    budget: dict[str, Array] = {}
    if not changes and not covariances:
        return _nothing(bands), budget
    total = np.zeros((bands, bands))
    for source, change in changes.items():
        d = np.nan_to_num(change)
        total += np.outer(d, d)
        budget[source] = np.abs(d)
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


def spectrum_error_covariance(item: SpectrumUncertainty, surface: SurfaceStatistics, axis: SpectralAxis) -> Array:
    """Error covariance (B, B) of the field spectrum of one subject [1].

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
            np.full(len(axis), item.absolute)
            if item.absolute
            else (item.relative or 0.0) * np.nan_to_num(surface.mean)
        )
    return np.asarray(np.outer(sd, sd) * correlation(axis, item.correlation_nm))


def with_bands(
    roc: Mapping[RocKey, RocCurve], pairs: Sequence[tuple[Detection, Detection]]
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


def _brighter(view: View, terms: AtmosphericTerms, factor: float) -> View:
    bright = replace(
        terms,
        path_radiance=terms.path_radiance * factor,
        direct=terms.direct * factor,
        adjacency=terms.adjacency * factor,
        ground_irradiance=terms.ground_irradiance * factor,
    )
    return replace(view, terms=bright)


def _shifted(state: AtmosphericState, name: str, step: float) -> AtmosphericState:
    data = state.model_dump()
    if name == "aot550" and state.meteorological_range_km is not None:
        data["aot550"] = aot550_from_range(state.meteorological_range_km, state.ground_altitude_km)
        data["meteorological_range_km"] = None
    if data[name] is None:
        raise UsageError(f"uncertainty: {name} is given, but the atmosphere's {name} is not", mend=f"state {name}")
    lowest, highest = {"aot550": (0.0, 5.0), "water_vapour_g_cm2": (0.01, 10.0), "ozone_atm_cm": (0.01, 1.0)}[name]
    data[name] = float(np.clip(data[name] + step, lowest, highest))
    return AtmosphericState.model_validate(data)
