"""One uncertain input: a dotted path into scenario, sensor or state, what stands there, how far it may be off.

An input has K independent directions with factors of mean 0 and variance 1; its value follows from any set of
factors, and the truth from its value (:mod:`hyperval.prediction.departure`).  Budgets, Monte Carlo,
linearisation, attribution, what-ifs and planted errors are designs over inputs.

Errors over wavelength: directions of a correlation form, draws, and the errors of field spectra.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.prediction.departure import Departure, Given, combined, input_path
from hyperval.prediction.inputs import SurfaceStatistics, correlation
from hyperval.scenario import SpectralForm, SpectrumUncertainty
from hyperval.sensor.specification import Sensor
from hyperval.settings import path_parts
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]

# Directions that hold less than this part of the variance, all together, are left out.
_LEFT_OUT = 1e-6


def directions(sd: Array, form: SpectralForm, axis: SpectralAxis, sensor: Sensor | None = None) -> Array:
    """(K, B) independent directions of an error with standard deviation ``sd`` (B,), the greatest first.

    The error is the sum of the rows, each with a factor of mean 0 and variance 1: its covariance is D^T D.
    """
    u = np.nan_to_num(np.asarray(sd, dtype=float))
    if form.correlation_nm is not None:
        return covariance_directions(form_covariance(u, form, axis))
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
    rest = 1.0 - np.cumsum(values) / values.sum()
    keep = int(np.searchsorted(-rest, -_LEFT_OUT)) + 1
    rows = (np.sqrt(values[:keep]) * vectors[:, :keep]).T
    return np.asarray(rows * np.where(rows.sum(axis=1) < 0, -1.0, 1.0)[:, None])


def form_covariance(sd: Array, form: SpectralForm, axis: SpectralAxis, sensor: Sensor | None = None) -> Array:
    """(B, B) covariance of an error with standard deviation ``sd`` (B,)."""
    u = np.asarray(sd, dtype=float)
    if form.correlation is None:
        return np.asarray(np.outer(u, u) * correlation(axis, form.correlation_nm))
    rows = directions(u, form, axis, sensor)
    return rows.T @ rows


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


def _arms(axis: SpectralAxis, sensor: Sensor | None) -> list[npt.NDArray[np.bool_]]:
    w, groups = axis.centre_nm, []
    arms = sensor.specification.arms if sensor is not None else ()
    if not arms:
        raise UsageError("uncertainty: correlation: arms needs a sensor with arms", mend="use correlation_nm")
    taken = np.zeros(w.shape, bool)
    for low, high in (arm.range_nm for arm in arms):
        groups.append((w >= low) & (w <= high) & ~taken)
        taken |= groups[-1]
    return [*groups, ~taken] if not taken.all() else groups  # bands beside all arms share one error


def spectrum_error_covariance(
    item: SpectrumUncertainty, surface: SurfaceStatistics, axis: SpectralAxis, sensor: Sensor | None = None
) -> Array:
    """Error covariance (B, B) of the field spectrum of one subject [1].

    Raises
    ------
    UsageError : as :func:`spectrum_error_sd`, or arms without a sensor.
    """
    return form_covariance(spectrum_error_sd(item, surface, axis), item, axis, sensor)


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


Kind = Literal["atmosphere", "surface", "sensor", "scene", "engine", "sampling"]
Source = Literal["stated", "usual"]


@dataclass(frozen=True, eq=False)
class UncertainInput:
    """An uncertain input.

    Attributes
    ----------
    name : for users; one budget has each name once
    kind : what sort of input
    path : where it stands (:func:`hyperval.prediction.departure.input_path`)
    nominal : the value as stated: a number, or (n,) over wavelength or over the things that it moves
    rows : (K, n) change of the value per unit along each direction, the leading one first; one unit is one standard
        uncertainty
    to : value -> the truth there
    correlation : how errors hang together over wavelength, in words
    source : whether the scenario states the uncertainty, or a usual one is taken
    draws : one draw from the distribution, where it is not that of independent normal factors
    """

    name: str
    kind: Kind
    path: str
    nominal: float | Array
    rows: Array
    to: Callable[[Array], Departure]
    correlation: str = "one number"
    source: Source = "stated"
    draws: Callable[[np.random.Generator], Departure] | None = None

    @property
    def size(self) -> int:
        """Number of directions."""
        result: int = self.rows.shape[0]
        return result

    @property
    def subject(self) -> str:
        """The surface whose mean it is; empty for anything else."""
        parts = path_parts(self.path)
        return parts[1] if parts[0] == "surfaces" and parts[2] == "mean" else ""

    def along(self, c: Array) -> Departure:
        """The truth at factors (K,) of the directions."""
        return self.to(np.asarray(self.nominal + c @ self.rows))

    def direction(self, k: int, z: float) -> Departure:
        """The truth ``z`` units along direction ``k``, the rest as stated."""
        c = np.zeros(self.size)
        c[k] = z
        return self.along(c)

    def moved(self, z: float) -> Departure:
        """The truth ``z`` units along the leading direction."""
        return self.direction(0, z)

    def drawn(self, rng: np.random.Generator) -> Departure:
        """A truth drawn from the distribution of this input alone."""
        return self.along(rng.standard_normal(self.size)) if self.draws is None else self.draws(rng)


def number_input(
    given: Given, name: str, kind: Kind, path: str, spread: float | Array, *, source: Source = "stated",
    words: str = "one number",
) -> UncertainInput:  # fmt: skip
    """An input of one number, or of several that move together.

    ``spread`` : standard uncertainty of each.
    """
    at = input_path(given, path)
    rows = np.broadcast_to(spread, np.shape(np.atleast_1d(at.nominal)))[None, :]
    return UncertainInput(name, kind, path, at.nominal, rows, at.to, words, source)


def spectral_input(
    given: Given, name: str, kind: Kind, path: str, sd: Array | float, form: SpectralForm
) -> UncertainInput:
    """An input over wavelength with standard uncertainty ``sd`` (B,) and the correlation of ``form``."""
    at = input_path(given, path)
    rows = directions(np.broadcast_to(sd, len(given.axis)), form, given.axis, given.sensor)
    return UncertainInput(name, kind, path, at.nominal, rows, at.to, form_in_words(form))


@dataclass(frozen=True)
class Step:
    """One direction of one input, one unit up and down, everything else as stated."""

    item: UncertainInput
    direction: int

    @property
    def truths(self) -> tuple[Departure, Departure]:
        """Up, and down."""
        return self.item.direction(self.direction, 1.0), self.item.direction(self.direction, -1.0)


def one_at_a_time(inputs: Sequence[UncertainInput]) -> list[Step]:
    """Every input by itself, along each of its directions."""
    return [Step(item, k) for item in inputs for k in range(item.size)]


def drawn_truths(inputs: Sequence[UncertainInput], count: int, seed: int) -> list[Departure]:
    """Truths with every input drawn from its distribution, independently of the others."""
    rng = np.random.default_rng(seed)
    return [combined(*(item.drawn(rng) for item in inputs)) for _ in range(count)]
