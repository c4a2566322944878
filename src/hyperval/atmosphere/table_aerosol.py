"""Terms of a table between two amounts of aerosol.

What the haze does goes along two optical depths: the sun comes through all of it, tau, the view passes what lies
below the sensor, d.  The rule of MODTRAN's profile (:mod:`hyperval.atmosphere.visibility`) ties d to tau, and not
as a straight line: under an aircraft d is nearly nothing up to tau = 0.05 and grows with tau above it.  So

    ground G             straight in ln G over tau        (Beer's law for the way of the sun)
    direct A             straight in ln(A/G) over d       (Beer's law for the view)
    both, A + B          straight in (A + B)/G over d     (scattering moves light from A to B, loses little)
    path                 straight over d                  (single scattering; its limit is the Rayleigh path)
    S, gas, diffuse      straight over tau

At a sensor above the atmosphere d is tau.  docs/atmosphere.md has what was measured with the embedded engine.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.visibility import fraction_below

Array = npt.NDArray[np.float64]

_LEAST = 1e-12  # of a term of which a logarithm or a ratio is taken [1]
# rms error of the path [1] halfway between two nodes a factor of four apart; it grows with the logarithm of it.
PATH_ERROR, AT_RATIO = 0.02, 4.0


def depth_below(aot550: npt.ArrayLike, ground_km: float, sensor_km: float) -> Array:
    """Aerosol optical depth at 550 nm between ground and sensor, for depths of the whole atmosphere (k,)."""
    depths = np.asarray(aot550, dtype=float)
    shares = [fraction_below(float(t), ground_km, min(sensor_km, 100.0)) if t > 0 else 0.0 for t in depths.ravel()]
    return np.asarray(depths * np.reshape(shares, depths.shape))


def between_aerosols(
    nodes: Array, values: Mapping[str, Array], aot550: float, ground_km: float, sensor_km: float
) -> dict[str, Array]:
    """All quantities of a table (k, ...) at one aerosol depth between its nodes (k,), by the rules above.

    Where there is no light at the ground, direct and adjacency are straight over tau.
    """
    i = int(np.clip(np.searchsorted(nodes, aot550) - 1, 0, nodes.size - 2))
    tau = nodes[i : i + 2]
    below = depth_below([tau[0], aot550, tau[1]], ground_km, sensor_km)
    v = float((aot550 - tau[0]) / (tau[1] - tau[0]))
    w = float((below[1] - below[0]) / (below[2] - below[0])) if below[2] > below[0] else v
    low, high = ({name: array[i + k] for name, array in values.items()} for k in (0, 1))
    between = {name: _straight(low[name], high[name], v) for name in values}
    between["path"] = _straight(low["path"], high["path"], w)
    lit = (low["ground"] > _LEAST) & (high["ground"] > _LEAST)
    lit &= (low["direct"] > _LEAST) & (high["direct"] > _LEAST)
    g = [np.where(lit, part["ground"], 1.0) for part in (low, high)]
    a = [np.where(lit, part["direct"], 1.0) / x for part, x in zip((low, high), g, strict=True)]
    both = [(p["direct"] + p["adjacency"]) / x for p, x in zip((low, high), g, strict=True)]
    ground = np.exp(_straight(np.log(g[0]), np.log(g[1]), v))
    direct = ground * np.exp(_straight(np.log(a[0]), np.log(a[1]), w))
    adjacency = np.maximum(ground * _straight(both[0], both[1], w) - direct, 0.0)
    for name, value in (("ground", ground), ("direct", direct), ("adjacency", adjacency)):
        between[name] = np.where(lit, value, between[name])
    return between


def path_error(nodes: Array, aot550: float, ground_km: float, sensor_km: float) -> float:
    """Relative standard uncertainty of the path by this interpolation [1]; 0 at a node.

    2 sqrt(w (1 - w)) PATH_ERROR ln r / ln 4 with w the place between the nodes over d and r the ratio of their
    depths: shape and size were fitted to what the embedded engine shows between its nodes (docs/atmosphere.md).
    """
    i = int(np.clip(np.searchsorted(nodes, aot550) - 1, 0, nodes.size - 2))
    low, here, high = depth_below([nodes[i], aot550, nodes[i + 1]], ground_km, sensor_km)
    if not high > low:
        return 0.0
    w = float(np.clip((here - low) / (high - low), 0.0, 1.0))
    ratio = float(nodes[i + 1] / max(nodes[i], 0.01))  # less haze than 0.01 is none
    return float(2.0 * np.sqrt(w * (1.0 - w)) * PATH_ERROR * np.log(ratio) / np.log(AT_RATIO))


def _straight(a: Array, b: Array, w: float) -> Array:
    return np.asarray(a + w * (b - a))
