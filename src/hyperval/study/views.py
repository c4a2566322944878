"""How the sensor sees the scene in many settings at once: the formulas of one view on arrays (U, 1, B)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.prediction.view import View
from hyperval.scenario import ElmPanels
from hyperval.sensor.noise import NoiseModel
from hyperval.study.prepared import Bands, Prepared, Surroundings, banded

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Views:
    """U settings of atmosphere, sensor and background.

    Attributes
    ----------
    view : whose terms, average and noise have the shape (U, 1, B), or one that goes with it
    fractions, gains : (U, M) f_m, g_m
    surroundings : the different ones;  which (U,) of them each setting has
    """

    view: View
    fractions: Array
    gains: Array
    surroundings: tuple[Surroundings, ...]
    which: Index

    def __len__(self) -> int:
        return self.which.size

    def levels(self, reflectances: Array) -> Array:
        """Mean signal (U, S, B) of S reflectances (S, B) (3.7)."""
        return np.broadcast_to(self.view.level(reflectances), (len(self), *reflectances.shape))

    def lit(self) -> npt.NDArray[np.bool_]:
        """(U, B) True where light of the ground reaches the sensor; the rule of one view."""
        if self.view.terms is None:
            return np.ones((len(self), self.view.average.shape[-1]), bool)
        direct = np.broadcast_to(self.view.terms.direct, self.view.average.shape)[:, 0]
        return np.asarray(direct > 1e-9 * direct.max(axis=1, keepdims=True))

    def rows(self, index: Index) -> Views:
        """The settings that ``index`` names."""
        size, view = len(self), self.view

        def cut(x: Array) -> Array:
            return x[index] if x.ndim == 3 and x.shape[0] == size else x

        return replace(
            self,
            view=replace(
                view,
                terms=None if view.terms is None else _each(view.terms, cut),
                average=cut(view.average),
                noise=None if view.noise is None else _each(view.noise, cut),
                kappa=cut(view.kappa) if isinstance(view.kappa, np.ndarray) else view.kappa,
            ),
            fractions=self.fractions[index],
            gains=self.gains[index],
            which=self.which[index],
        )  # fmt: skip

    def at(self, bands: Bands) -> Views:
        """The settings on some bands alone; the surroundings' covariances are cut by who needs them."""
        view = self.view
        return replace(
            self,
            view=replace(
                view,
                terms=None if view.terms is None else banded(view.terms, bands),
                average=view.average[..., bands],
                noise=None if view.noise is None else banded_noise(view.noise, bands),
            ),
        )


def views(
    prepared: Prepared,
    terms: AtmosphericTerms | None,
    noise: NoiseModel | None,
    fractions: Array,
    gains: Array,
    kappa: Array,
) -> Views:
    """Settings of a prepared scenario.

    Parameters
    ----------
    terms : (U, 1, B) or (1, 1, B) each; None in the reflectance domain
    noise : of (U, 1, B), or of one setting (B,)
    fractions, gains : (U, M);  kappa : (U,) 1/N_eff

    Raises
    ------
    UsageError : fractions that do not sum to 1.
    """
    scenario = prepared.scenario
    different, which = np.unique(fractions, axis=0, return_inverse=True)
    around = tuple(prepared.surroundings(f) for f in different)
    which = which.reshape(-1)
    average = np.array([s.average for s in around])[which][:, None, :]
    elm = scenario.processing.elm
    view = View(
        terms,
        average,
        np.empty((0, 0)),
        noise,
        kappa[:, None, None],  # type: ignore[arg-type]
        scenario.formulation,
        elm if isinstance(elm, ElmPanels) else None,
    )
    return Views(view, fractions, gains, around, which)


def line_of(at: Views) -> tuple[Array, Array]:
    """Gain and offset (U, 1, F) of the empirical line on lit bands (before 3.21); 1 and 0 without one."""
    view, shape = at.view, at.view.average.shape
    if view.terms is None or not isinstance(view.elm, ElmPanels):
        return np.ones(shape), np.zeros(shape)
    low, high = view.elm.reflectances
    dark, bright = (view.level(np.full(shape[-1], r)) for r in (low, high))
    gain = (bright - dark) / (high - low)
    return gain, dark - low * gain


def banded_noise(noise: NoiseModel, bands: Bands) -> NoiseModel:
    """The noise of some bands; numbers that serve all bands stay."""
    return banded(noise, bands)


def _each(value: Any, change: Any) -> Any:
    from dataclasses import fields

    found = {}
    for f in fields(value):
        item = getattr(value, f.name)
        if isinstance(item, tuple) and item and isinstance(item[0], np.ndarray):
            found[f.name] = tuple(change(x) for x in item)
        elif isinstance(item, np.ndarray):
            found[f.name] = change(item)
    return replace(value, **found)
