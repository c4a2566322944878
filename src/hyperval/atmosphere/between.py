"""Between states: the one place where anything of the atmosphere is interpolated.

Tables, studies, Monte Carlo and the transport of a coarse table differ in where their nodes stand and in how a
quantity runs along an input; what they have in common is here.  A :class:`Rule` says how it runs, on which scale of
the input and of the quantity it is nearly a polynomial:

    optical depth goes like 1/range, absorption like the root of the column (square-root regime of a band model),
    the way of the sun's light like the secant of its zenith angle; terms that are transmittances or have them as
    factors are taken as logarithms (Beer), the spherical albedo and the share of sky light as they are.

Linear rules and splines are linear in the values at the nodes, so that many states are one product of matrices:
``value(x) = sum_k w_k(x) value_k`` with weights that sum to 1.

Interpolated are the products that a table holds (:mod:`hyperval.atmosphere.table`), before any band is averaged:
altitudes by monotone cubic; angles by cubic spline; water logarithms of the transmittances, linear in the square root
of the column; ozone likewise, linear in the column; aerosol (a range as depth) along two optical depths, since the sun
comes through all of it, tau, and the view passes what lies below the sensor, d.  The rule of MODTRAN's profile
(:mod:`hyperval.atmosphere.state`) ties d to tau, and not as a straight line: under an aircraft d is nearly nothing up
to tau = 0.05 and grows with tau above it.  So

    ground G             straight in ln G over tau        (Beer's law for the way of the sun)
    direct A             straight in ln(A/G) over d       (Beer's law for the view)
    both, A + B          straight in (A + B)/G over d     (scattering moves light from A to B, loses little)
    path                 straight over d                  (single scattering; its limit is the Rayleigh path)
    S, gas, diffuse      straight over tau

At a sensor above the atmosphere d is tau.  What was measured with the embedded engine:
validation/atmosphere/README.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.state import fraction_below
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.data import Array
from hyperval.errors import refuse

Columns = Mapping[str, npt.NDArray[Any]]
# Terms that are no transmittances.
AS_THEY_ARE = ("spherical_albedo", "diffuse_fraction", "diffuse", "path_uncertainty")
_AT_MOST_ONE = ("gas_transmittance", "diffuse_fraction")
_LEAST = 1e-30  # below it a logarithm says nothing


def _secant(degrees: Array) -> Array:
    return np.asarray(1.0 / np.cos(np.deg2rad(degrees)))


@dataclass(frozen=True)
class Rule:
    """How a quantity runs along an input.

    Attributes
    ----------
    method : linear between the two nodes beside, a cubic spline (a parabola through three nodes), or monotone cubic
        (Fritsch & Carlson, SIAM J. Numer. Anal. 17, 1980)
    scale : of the input, monotone
    logarithm : whether the logarithm of the quantity is interpolated
    """

    method: Literal["linear", "cubic", "monotone"]
    scale: Callable[[Array], Array] = np.asarray
    logarithm: bool = False


# Scales of fields of the state on which they are cubic, and back again; any other field is its own scale.
_SCALES: dict[str, tuple[Callable[[Array], Array], Callable[[Array], Array]]] = {
    "meteorological_range_km": (np.reciprocal, np.reciprocal),
    "water_vapour_g_cm2": (np.sqrt, np.square),
    "sensor_altitude_km": (np.log, np.exp),
}


def smooth_rule(name: str) -> Rule:
    """The rule of a field of the state that is run at a few nodes, for terms on bands."""
    return Rule("cubic", _secant if name == "solar_zenith_deg" else _SCALES.get(name, (np.asarray, np.asarray))[0])


def interpolation_nodes(name: str, low: float, high: float, count: int) -> Array:
    """``count`` nodes from ``low`` to ``high``, evenly in the scale in which the input is interpolated.

    But for the sun: the secant runs away where it is low, and even angles leave fewer of them there.
    """
    scale, back = _SCALES.get(name, (np.asarray, np.asarray))
    nodes = np.array(back(np.linspace(scale(np.array(low)), scale(np.array(high)), count)))
    nodes[[0, -1]] = low, high
    return nodes


def node_weights(nodes: Array, x: npt.ArrayLike, rule: Rule) -> Array:
    """Weight (n, K) of each node (K,) at the points ``x`` (n,) by a rule that is linear in the values: not monotone.

    They sum to 1 at each point.  Beyond the nodes the outermost piece goes on.
    """
    scaled, points = rule.scale(np.asarray(nodes, float)), rule.scale(np.atleast_1d(np.asarray(x, float)))
    order = np.argsort(scaled)
    weights = np.zeros((points.size, scaled.size))
    if rule.method == "linear":
        i = np.clip(np.searchsorted(scaled[order], points) - 1, 0, scaled.size - 2)
        low, high = order[i], order[i + 1]
        w = (points - scaled[low]) / (scaled[high] - scaled[low])
        rows = np.arange(points.size)
        weights[rows, low], weights[rows, high] = 1.0 - w, w
    else:
        from scipy.interpolate import CubicSpline  # a quarter of a second, which terms of one state do not need

        weights[:, order] = CubicSpline(scaled[order], np.eye(scaled.size))(points)
    return weights


def along(nodes: Array, values: Array, x: float, rule: Rule) -> Array:
    """Values (K, ...) of one quantity at ``x`` along their first dimension."""
    ordinates = np.log(np.maximum(values, _LEAST)) if rule.logarithm else values
    if rule.method == "monotone":
        from scipy.interpolate import PchipInterpolator

        between = np.asarray(PchipInterpolator(rule.scale(nodes), ordinates, axis=0)(rule.scale(np.asarray(x))))
    else:
        between = np.tensordot(node_weights(nodes, x, rule)[0], ordinates, axes=1)
    return _lit(np.exp(between)) if rule.logarithm else between


def _lit(values: Array) -> Array:
    """0 where the logarithm was that of nothing."""
    return np.where(values > 2.0 * _LEAST, values, 0.0)


def inside(name: str, nodes: Array, x: npt.ArrayLike) -> Array:
    """The points (n,), moved onto the ends where they miss them by rounding.

    Raises
    ------
    UsageError : one of them lies outside: a table is never extrapolated.
    """
    points = np.asarray(x, dtype=float)
    low, high = float(np.min(nodes)), float(np.max(nodes))
    slack = 1e-6 * max(abs(high), 1e-6)
    within = np.all((points >= low - slack) & (points <= high + slack))
    span = f"{points.min():g}" if points.size == 1 else f"{points.min():g} to {points.max():g}"
    refuse(not within, "table.outside", name=name, span=span, low=low, high=high)
    return np.asarray(np.clip(points, low, high))


@dataclass(frozen=True)
class InterpolatedTerms:
    """Atmospheric terms on bands between runs of an engine.

    Attributes
    ----------
    axes : input -> nodes.  On a grid they are all combined, the last input fastest; on a star each input moves
        alone from its first node, and changes of several inputs add up
    values : term -> (runs, B), of transmittances the logarithm; on a star the run at all first nodes, then the other
        nodes input by input
    pattern : gives what is not interpolated
    star : whether the runs are a star, beyond whose nodes the outermost piece goes on; on a grid a state outside them
        is refused
    """

    axes: Mapping[str, Array]
    values: Mapping[str, Array]
    pattern: AtmosphericTerms
    star: bool = False

    def __call__(self, columns: Columns) -> AtmosphericTerms:
        """Terms (n, B) at the values (n,) of each input.

        Raises
        ------
        UsageError : a value outside the nodes of a grid.
        """
        parts = []
        for name, nodes in self.axes.items():
            x = np.atleast_1d(np.asarray(columns[name], dtype=float))
            x = x if self.star else inside(f"atmosphere.{name}", nodes, x)
            parts.append(node_weights(nodes, x, smooth_rule(name)))
        if self.star:  # the run at all first nodes has what the others leave of 1
            rest = [part[:, 1:] for part in parts]
            joint = np.column_stack([1.0 - np.sum([part.sum(axis=1) for part in rest], axis=0), *rest])
        else:
            joint = reduce(lambda a, b: (a[:, :, None] * b[:, None, :]).reshape(len(a), -1), parts)
        terms: dict[str, Any] = {name: joint @ values for name, values in self.values.items()}
        terms |= {name: _lit(np.exp(x)) for name, x in terms.items() if name not in AS_THEY_ARE}
        return replace(self.pattern, **terms | {n: np.minimum(terms[n], 1.0) for n in _AT_MOST_ONE if n in terms})


def interpolated_terms(
    axes: Mapping[str, Array], runs: Sequence[AtmosphericTerms], *, star: bool = False
) -> InterpolatedTerms:
    """Interpolation between ``runs`` of an engine at the nodes of a grid or a star (see :class:`InterpolatedTerms`)."""
    values = {name: np.stack([getattr(t, name) for t in runs]) for name in runs[0].spectra()}
    values |= {name: np.log(np.maximum(v, _LEAST)) for name, v in values.items() if name not in AS_THEY_ARE}
    return InterpolatedTerms(axes, values, runs[0], star)


_MIN_TERM = 1e-12  # of a term of which a logarithm or a ratio is taken [1]
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
    i, v, w = _place(nodes, aot550, ground_km, sensor_km)
    w = v if np.isnan(w) else w
    low, high = ({name: array[i + k] for name, array in values.items()} for k in (0, 1))
    between = {name: _straight(low[name], high[name], v) for name in values}
    between["path"] = _straight(low["path"], high["path"], w)
    lit = (low["ground"] > _MIN_TERM) & (high["ground"] > _MIN_TERM)
    lit &= (low["direct"] > _MIN_TERM) & (high["direct"] > _MIN_TERM)
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
    depths: shape and size were fitted to what the embedded engine shows between its nodes
    (validation/atmosphere/README.md).
    """
    i, _, w = _place(nodes, aot550, ground_km, sensor_km)
    ratio = float(nodes[i + 1] / max(nodes[i], 0.01))  # a depth below 0.01 counts as none
    shape = 2.0 * np.sqrt(np.clip(w * (1.0 - w), 0.0, None))
    return float(np.nan_to_num(shape) * PATH_ERROR * np.log(ratio) / np.log(AT_RATIO))


def _place(nodes: Array, aot550: float, ground_km: float, sensor_km: float) -> tuple[int, float, float]:
    """The node below, and the fractions of the way to the next over tau and over d: NaN where no haze lies below."""
    i = int(np.clip(np.searchsorted(nodes, aot550) - 1, 0, nodes.size - 2))
    low, depth, high = depth_below([nodes[i], aot550, nodes[i + 1]], ground_km, sensor_km)
    over_tau = float((aot550 - nodes[i]) / (nodes[i + 1] - nodes[i]))
    return i, over_tau, float((depth - low) / (high - low)) if high > low else np.nan


def _straight(a: Array, b: Array, w: float) -> Array:
    return np.asarray(a + w * (b - a))
