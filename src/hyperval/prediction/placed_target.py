"""Mean spectrum of the pixels of one object: what lies beside it, and what its place leaves open (f of 3.10).

A subject with a place is one object among others.  Its n pixels hold shares f_j of its own surface and of those
beside it, and of its host the rest.  Over places on the pixel grid (and the stated error of positions) the shares
have a mean and a covariance: the mean gives the mean spectrum, the covariance an error of it.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.prediction.fills import geometry_of, pixels_of_object
from hyperval.prediction.object_scores import neighbours_of, placed_beside
from hyperval.scenario import Target, TargetSubject
from hyperval.scene.fill import PHASES, shared_pixel_fills

Array = npt.NDArray[np.float64]

# Names of the sources in the budget.
PLACE = "place of the targets on the pixel grid"
HOST = "background at the target's place"


@dataclass(frozen=True, eq=False)
class Shares:
    """Shares of an object's pixels, all of them together.

    Attributes
    ----------
    names : (J,) targets whose surfaces they are, the object's own first; a material may stand there more than once
    mean : (J,) expected shares
    covariance : (J, J) over places on the pixel grid and the errors of positions
    """

    names: tuple[str, ...]
    mean: Array
    covariance: Array

    @property
    def rest(self) -> float:
        """Share of the host."""
        return float(1.0 - self.mean.sum())


def shares_of(
    target: Target, population: TargetSubject, targets: Sequence[Target], position_m: float | None, seed: int
) -> Shares | None:
    """Shares of one object's pixels; None where the scenario does not say where the object lies.

    Parameters
    ----------
    position_m : standard uncertainty of the places of neighbours in line and sample [m], None: known
    """
    geometry = population.fill.geometry
    if geometry is None or population.position_m is None:
        return None
    beside = neighbours_of(target, population, targets)
    placed = [placed_beside(population, subject) for _, subject in beside]
    shifts = None
    if position_m is not None and placed:
        rng = np.random.default_rng([seed, 13, zlib.crc32(population.name.encode())])
        count = 1 if geometry.phase == "centred" else PHASES
        shifts = rng.normal(0.0, position_m / geometry.gsd_m, (count, len(placed), 2))
    own, others = shared_pixel_fills(
        geometry_of(population.fill), pixels_of_object(population.fill), placed, shifts
    )
    each = np.concatenate([own.mean(axis=1)[:, None], others.mean(axis=1)], axis=1)  # (K, J)
    mean = each.mean(axis=0)
    away = each - mean
    return Shares((target.name, *(t.name for t, _ in beside)), mean, away.T @ away / len(each))


def mixed(shares: Shares, full: Mapping[str, Array], host: Array) -> Array:
    """(B,) mean reflectance: sum_j f_j rho_j + (1 - sum_j f_j) rho_host (3.10 for several surfaces)."""
    contrast = np.array([full[name] - host for name in shares.names])
    return np.asarray(host + shares.mean @ contrast)


def place_covariance(shares: Shares, full: Mapping[str, Array], host: Array) -> Array:
    """(B, B) error of that mean by the shares: D^T cov(f) D with the contrasts D (J, B) to the host."""
    contrast = np.array([full[name] - host for name in shares.names])
    return np.asarray(contrast.T @ shares.covariance @ contrast)


def spectra_covariance(shares: Shares, errors: Mapping[str, Array], bands: int) -> Array:
    """(B, B) error of that mean by the spectra of the surfaces: (sum of f_j of one material)^2 times its own."""
    total: dict[str, float] = {}
    for name, share in zip(shares.names, shares.mean, strict=True):
        total[name] = total.get(name, 0.0) + float(share)
    out = np.zeros((bands, bands))
    for name, share in total.items():
        if name in errors:
            out += share**2 * errors[name]
    return out


def host_covariance(shares: Shares, host: Array, gain: float) -> Array:
    """(B, B) error of that mean by the ground that happens to lie there: (1 - sum f_j)^2 of the host's own spread.

    The pixels of one object are near each other, so the host in them counts as one draw of its class and not as n:
    an upper limit.  It overstates what is independent from pixel to pixel, noise above all.
    """
    return np.asarray(shares.rest**2 * gain * host)
