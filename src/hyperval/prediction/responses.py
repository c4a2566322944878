"""Scores of target pixels against the fill, in many settings (3.9, 3.10, 3.26, 3.28)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from hyperval.prediction.background import Seen, Settings
from hyperval.prediction.filters import Filters, Population
from hyperval.processing.elm_model import TwoPanelLine, retrieved_reflectance
from hyperval.scene.fill import FillDistribution
from hyperval.scene.radiance import target_pixel_covariance, target_pixel_reflectance

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
# Mean and variance of a score are at most quadratic in the fill, which a cubic spline carries exactly.
FILL_NODES = np.linspace(0.0, 1.0, 9)


@cache
def _spline() -> CubicSpline:
    from scipy.interpolate import CubicSpline  # a quarter of a second, which spectra alone do not need

    return CubicSpline(FILL_NODES, np.eye(FILL_NODES.size))


@dataclass(frozen=True)
class Responses:
    """Score moments against the fill, for R settings of light, sensor and ground.

    Attributes
    ----------
    means : (R, 9) at FILL_NODES (3.26)
    own, host : (R,) score variance of a pixel full of target without its gain, and of host with it
    rest : (R, 9) surroundings and noise (3.28)
    error : (R,) standard deviation of the score of a full pixel by the error of the target's spectrum
    fine : (R,) part of ``own`` whose texture is finer than the target's part of a pixel
    """

    means: Array
    own: Array
    host: Array
    rest: Array
    error: Array
    fine: Array

    @staticmethod
    def weights(fills: Array) -> Array:
        """(..., 9) weights of the values at FILL_NODES in the value at fills (...)."""
        return np.asarray(_spline()(fills))

    def variances(self, target_gain: Array, rows: Index) -> Array:
        """(n, 9) at FILL_NODES, of n evaluations of given rows (3.28)."""
        f = FILL_NODES
        square = f**2 + self.fine[rows, None] * (f - f**2)
        own = square * (target_gain * self.own[rows])[:, None] + (1.0 - f) ** 2 * self.host[rows, None]
        return np.asarray(own + self.rest[rows])  # (3.28)

    def at(self, fills: Array, target_gain: Array, rows: Index, shift: Array | float = 0.0) -> tuple[Array, Array]:
        """Means and standard deviations (n, K) at fills (n, K) or (1, K), for n evaluations of given rows.

        ``shift`` (n,) : by how many standard deviations of the score the true target departs from its spectrum
        """
        variance, weights = self.variances(target_gain, rows), self.weights(fills)  # (n, 9), (n or 1, K, 9)
        means = (weights * self.means[rows][:, None, :]).sum(axis=2)
        means = means + (np.asarray(shift) * self.error[rows])[:, None] * fills
        return means, np.sqrt(np.clip((weights * variance[:, None, :]).sum(axis=2), 0.0, None))


@dataclass(frozen=True)
class Material:
    """A target, its host and its light.

    Attributes
    ----------
    name, host : of the target, number of its host's class
    beam, sky : (U,) parts of the light in the open that reach it
    error : (F, F) error covariance of its spectrum; None where nothing is stated
    """

    name: str
    host: int
    beam: Array
    sky: Array
    error: Array | None = None


def lit_surface(at: Settings, material: Material) -> tuple[Array, Array, Array | float]:
    """A target under its own light, as a surface in the open would have to be to look like it (ground term of 3.7).

    Returns
    -------
    (U or 1, 1, F) mean of that surface, (U or 1, 1, F) reflectance times sky view, what the light from the
    surroundings meets (D_B of 3.11), and (U, 1, F) light over that in the open, 1 without shade
    """
    own = at.means([material.name])
    factor = at.view.light(material.beam[:, None, None], material.sky[:, None, None])
    if np.ndim(factor) == 0:
        return own, own, factor
    return own * factor, own * material.sky[:, None, None], factor


def responses(at: Settings, seen: Seen, filters: Filters, material: Material) -> Responses:
    """Score statistics of pixels of which the target fills f, at FILL_NODES (3.26, 3.28).

    Each fill has its own mean, noise and adjacency; Var(f) comes in by the average over the fill.
    """
    view, number = at.view, material.host
    lit, under_sky, factor = lit_surface(at, material)
    host = at.class_means()[:, number : number + 1]
    level = at.levels(target_pixel_reflectance(FILL_NODES, lit, host))  # (3.9), (3.10)
    line = TwoPanelLine(seen.gain, seen.offset)
    w = filters.weights
    means = np.einsum("uf,ukf->uk", w, retrieved_reflectance(line, level)) - filters.offset[:, None]  # (3.26)
    through = (w * seen.slope)[:, None, :]
    lit_through = through * factor
    rest = np.einsum("ukf,uf->uk", view.noise_variance(level) / seen.gain**2, w**2)  # noise of (3.28)
    # D_B is linear in the reflectance, so that its part of the variance is a square in the fill.
    shape = (len(at), 1, w.shape[1])
    ends = np.concatenate([np.broadcast_to(host, shape), np.broadcast_to(under_sky, shape)], axis=1)
    v = w[:, None, :] * view.adjacency_slope(ends) / seen.gain
    v = v * np.sqrt(at.gains[:, number, None, None] * view.adjacency_weight())
    parts = at.surroundings(np.concatenate([v, v[:, :1] + v[:, 1:]], axis=1))
    zero, one, both = parts[:, :1], parts[:, 1:2], parts[:, 2:]
    g = FILL_NODES
    rest = rest + (1.0 - g) ** 2 * zero + g**2 * one + g * (1.0 - g) * (both - zero - one)
    error = np.zeros(len(at))
    if material.error is not None:
        error = np.sqrt(np.einsum("ukf,ukf->u", lit_through @ material.error, lit_through))
    own = at.spread(lit_through, lambda x: x.surfaces[material.name].covariance)[:, 0]
    behind = at.spread(through, lambda x: x.covariances[number])[:, 0]
    fine = np.array([g.surfaces[material.name].fine_texture for g in at.grounds])[at.which]
    return Responses(means, own, at.gains[:, number] * behind, rest, error, fine)


def target_population(
    at: Settings, seen: Seen, u: int, material: Material, fill: FillDistribution, target_gain: float
) -> Population:
    """Target pixels of setting ``u`` by the moments of their fill, as a class of part 0 of the scene (3.12)."""
    one = at.rows(np.array([u]))
    row, number = one.view, material.host
    here = Material(material.name, number, material.beam[u : u + 1], material.sky[u : u + 1])
    mean, sky, light = lit_surface(one, here)
    lit, under = mean[0, 0], sky[0, 0]
    ground = one.grounds[one.which[0]]
    own, host = ground.surfaces[material.name].covariance, ground.means[number]
    if np.ndim(light):
        factor = np.asarray(light)[0, 0]
        own = own * factor[:, None] * factor
    gain = float(one.gains[0, number])
    covariance = target_pixel_covariance(
        fill.mean, fill.variance, lit, own, host, ground.covariances[number],
        target_gain=target_gain, host_gain=gain,
        fine_texture=ground.surfaces[material.name].fine_texture, formulation=row.formulation,
    )  # fmt: skip
    level = one.levels(target_pixel_reflectance(fill.mean, lit, host)[None])[0, 0]
    under_sky = target_pixel_reflectance(fill.mean, under, host)
    k, offset = seen.gain[u, 0], seen.offset[u, 0]
    weight = np.sqrt(gain * np.asarray(row.adjacency_weight()).reshape(-1)[0])
    around = row.adjacency_slope(under_sky[None, None])[0, 0] / k * weight
    noise = row.noise_variance(level[None, None])[0, 0] / k**2
    return Population(0.0, covariance, around, (level - offset) / k, noise)
