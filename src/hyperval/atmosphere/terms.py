"""What every atmosphere engine returns: the terms of equation 3.7.

Surfaces are Lambertian: their BRDF (3.1) is the reflectance factor over pi (3.2).  What the source writes apart, the
engine integrates: light of the sun that the surface reflects (3.3), skylight on the surface (3.4) and what it reflects
of that (3.5) are A and B, light scattered into the line of sight (3.6) is L_a.

Between states: the one place where anything of the atmosphere is interpolated.

Tables, studies, Monte Carlo and the transport of a coarse table differ in where their nodes stand and in how a
quantity runs along an input; what they have in common is here.  A :class:`Rule` says how it runs, on which scale of
the input and of the quantity it is nearly a polynomial:

    optical depth goes like 1/range, absorption like the root of the column (square-root regime of a band model),
    the way of the sun's light like the secant of its zenith angle; terms that are transmittances or have them as
    factors are taken as logarithms (Beer), the spherical albedo and the share of sky light as they are.

Linear rules and splines are linear in the values at the nodes, so that many states are one product of matrices:
``value(x) = sum_k w_k(x) value_k`` with weights that sum to 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import reduce
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.spectra.axis import SpectralAxis, band_average

Array = npt.NDArray[np.float64]

_NARROW = 0.5  # channels this much narrower than the bands, or more, can be averaged as samples
# What goes in proportion to the sunlight; the rest are parts of light, which it leaves as they are.
_OF_THE_SUN = (
    "path_radiance", "direct", "adjacency", "ground_irradiance", "path_uncertainty", "diffuser_radiance"
)  # fmt: skip
NOT_AVERAGED = ("wavelength_nm", "provenance", "fwhm_nm", "solar_lines")
_ALIKE = 1.35  # channels within this factor of a band's width stand for it


@dataclass(frozen=True)
class AtmosphericTerms:
    """Terms of L = path_radiance + (direct rho + adjacency rho_ave) / (1 - spherical_albedo rho_ave).

    All arrays have shape (n,), one value per wavelength.

    Attributes
    ----------
    wavelength_nm : sample or band-centre positions [nm]
    path_radiance : L_a, radiance over a black surface [uW cm-2 sr-1 nm-1]
    direct : A, radiance per unit reflectance of the viewed pixel [uW cm-2 sr-1 nm-1]
    adjacency : B, radiance per unit average reflectance scattered into the view [uW cm-2 sr-1 nm-1]
    spherical_albedo : S [1]
    ground_irradiance : global irradiance on a black ground [uW cm-2 nm-1]
    gas_transmittance : two-way (sun-ground-sensor) gas transmittance [1]; tells windows from absorption
    provenance : engine, version, solar spectrum, state
    fwhm_nm : widths of the channels over which the terms are averaged already [nm]; None: samples of a spectrum
    diffuse_fraction : part of ``ground_irradiance`` that comes from the sky [1]; None where the engine does not
        tell it from the sun's beam
    path_uncertainty : standard uncertainty of ``path_radiance`` by interpolation between the nodes of a table,
        common to neighbouring wavelengths [uW cm-2 sr-1 nm-1]; None where nothing was interpolated
    diffuser_radiance : mu0 E0 / pi, radiance of a white level diffuser outside the atmosphere, over which radiance
        is top-of-atmosphere reflectance [uW cm-2 sr-1 nm-1]; None where the engine does not give it
    solar_lines : finer wavelengths [nm], and there the sunlight over the straight line between its values at
        ``wavelength_nm`` [1]: the Fraunhofer lines that the terms' own sampling smooths; None: it smooths none
    """

    wavelength_nm: Array
    path_radiance: Array
    direct: Array
    adjacency: Array
    spherical_albedo: Array
    ground_irradiance: Array
    gas_transmittance: Array
    provenance: dict[str, Any] = field(default_factory=dict)
    fwhm_nm: Array | None = None
    diffuse_fraction: Array | None = None
    path_uncertainty: Array | None = None
    diffuser_radiance: Array | None = None
    solar_lines: tuple[Array, Array] | None = None

    def at_bands(self, axis: SpectralAxis) -> AtmosphericTerms:
        """The terms averaged over the band responses of ``axis``.

        Terms that are channel averages already are not averaged again: channels about as wide as the bands are
        interpolated to the band centres (unchanged where they are the same), much narrower ones serve as samples.

        Raises
        ------
        UsageError : the terms do not cover the bands, or their channels are too wide or of another width.
        """

        names = [f.name for f in fields(self) if f.name not in NOT_AVERAGED and getattr(self, f.name) is not None]
        stack = np.stack([getattr(self, name) for name in names])
        if self._are_channels_of(axis):
            bands = np.stack([np.interp(axis.centre_nm, self.wavelength_nm, row) for row in stack])
        else:
            bands = band_average(self.wavelength_nm, stack, axis)  # one set of weights for all terms
        averages = dict(zip(names, bands, strict=True))
        if self.solar_lines is not None:
            averages |= self._with_lines_of_the_sun(axis, [name for name in names if name in _OF_THE_SUN])
        return AtmosphericTerms(wavelength_nm=axis.centre_nm, **averages, provenance=self.provenance)

    def _with_lines_of_the_sun(self, axis: SpectralAxis, names: list[str]) -> dict[str, Array]:
        """Terms in proportion to the sunlight, averaged over bands with its lines where they are."""
        assert self.solar_lines is not None  # noqa: S101 - the caller's own check
        at, lines = self.solar_lines
        fine = lines * np.stack([np.interp(at, self.wavelength_nm, getattr(self, name)) for name in names])
        return dict(zip(names, band_average(at, fine, axis), strict=True))

    def _are_channels_of(self, axis: SpectralAxis) -> bool:
        """True when the terms are averages over channels like those of ``axis``, False when they are samples."""
        if self.fwhm_nm is None:
            return False
        ratio = np.interp(axis.centre_nm, self.wavelength_nm, self.fwhm_nm) / axis.fwhm_nm
        if np.all(ratio <= _NARROW):
            return False
        alike = (ratio >= 1.0 / _ALIKE) & (ratio <= _ALIKE)
        reach = 0.1 * axis.fwhm_nm
        inside = (axis.centre_nm >= self.wavelength_nm[0] - reach) & (axis.centre_nm <= self.wavelength_nm[-1] + reach)
        if not np.all(alike & inside):
            i = int(np.flatnonzero(~(alike & inside))[0])
            raise UsageError(
                f"the terms are averages over channels that do not suit the band at {axis.centre_nm[i]:g} nm "
                f"(FWHM {axis.fwhm_nm[i]:g} nm)",
                expected=f"channels between {self.wavelength_nm[0]:g} and {self.wavelength_nm[-1]:g} nm, "
                "as wide as the bands or at most half as wide",
                mend="run the engine for this sensor's channels, or give terms at full resolution",
            )
        return True


Columns = Mapping[str, npt.NDArray[Any]]
# Terms that are no transmittances.
AS_THEY_ARE = ("spherical_albedo", "diffuse_fraction", "diffuse", "path_uncertainty")
_AT_MOST_ONE = ("gas_transmittance", "diffuse_fraction")
_LEAST = 1e-30  # below it a logarithm says nothing


def _same(x: Array) -> Array:
    return x


def _reciprocal(x: Array) -> Array:
    return np.asarray(1.0 / x)


def _secant(degrees: Array) -> Array:
    return np.asarray(1.0 / np.cos(np.deg2rad(degrees)))


def _of_secant(secant: Array) -> Array:
    return np.asarray(np.rad2deg(np.arccos(1.0 / secant)))


@dataclass(frozen=True)
class Rule:
    """How a quantity runs along an input.

    Attributes
    ----------
    method : linear between the two nodes beside, a cubic spline (a parabola through three nodes), or monotone cubic
        (Fritsch & Carlson, SIAM J. Numer. Anal. 17, 1980)
    scale : of the input, monotone
    back : from the scale to the input
    logarithm : whether the logarithm of the quantity is interpolated
    """

    method: Literal["linear", "cubic", "monotone"]
    scale: Callable[[Array], Array] = _same
    back: Callable[[Array], Array] = _same
    logarithm: bool = False


# Cubic rules by field of the state, on its scale; any other field is its own scale.
_SCALES: dict[str, tuple[Callable[[Array], Array], Callable[[Array], Array]]] = {
    "meteorological_range_km": (_reciprocal, _reciprocal),
    "water_vapour_g_cm2": (np.sqrt, np.square),
    "sensor_altitude_km": (np.log, np.exp),
    "solar_zenith_deg": (_secant, _of_secant),
}


def smooth_rule(name: str) -> Rule:
    """The rule of a field of the state that is run at a few nodes, for terms on bands."""
    return Rule("cubic", *_SCALES.get(name, (_same, _same)))


def spaced(name: str, low: float, high: float, count: int) -> Array:
    """``count`` nodes from ``low`` to ``high``, evenly in the scale in which the input is interpolated."""
    if name == "solar_zenith_deg":  # the secant runs away at a low sun: even angles leave fewer of them there
        return np.linspace(low, high, count)
    rule = smooth_rule(name)
    ends = rule.scale(np.array([low, high]))
    nodes = np.asarray(rule.back(np.linspace(ends[0], ends[1], count)))
    nodes[[0, -1]] = low, high
    return nodes


def node_weights(nodes: Array, x: npt.ArrayLike, rule: Rule) -> Array:
    """Weight (n, K) of each node (K,) at the points ``x`` (n,) by a rule that is linear in the values.

    They sum to 1 at each point.  Beyond the nodes the outermost piece goes on.
    """
    at, points = rule.scale(np.asarray(nodes, float)), rule.scale(np.atleast_1d(np.asarray(x, float)))
    order = np.argsort(at)
    weights = np.zeros((points.size, at.size))
    if rule.method == "linear":
        i = np.clip(np.searchsorted(at[order], points) - 1, 0, at.size - 2)
        low, high = order[i], order[i + 1]
        w = (points - at[low]) / (at[high] - at[low])
        rows = np.arange(points.size)
        weights[rows, low], weights[rows, high] = 1.0 - w, w
    elif rule.method == "cubic":
        from scipy.interpolate import CubicSpline  # a quarter of a second, which terms of one state do not need

        weights[:, order] = CubicSpline(at[order], np.eye(at.size))(points)
    else:
        raise ValueError(f"a {rule.method} rule has no weights")
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
    if not np.all((points >= low - slack) & (points <= high + slack)):
        span = f"{points.min():g}" if points.size == 1 else f"{points.min():g} to {points.max():g}"
        raise UsageError(
            f"{name} {span} lies outside the table",
            expected=f"{low:g} to {high:g}",
            mend="change the state, or compute a larger table: a table is never extrapolated",
        )
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
    star : whether the runs are a star
    bounded : whether a state outside the nodes is refused
    """

    axes: Mapping[str, Array]
    values: Mapping[str, Array]
    pattern: AtmosphericTerms
    star: bool = False
    bounded: bool = True

    def __call__(self, columns: Columns) -> AtmosphericTerms:
        """Terms (n, B) at the values (n,) of each input.

        Raises
        ------
        UsageError : a value outside the nodes of a bounded table.
        """
        parts = []
        for name, nodes in self.axes.items():
            x = np.atleast_1d(np.asarray(columns[name], dtype=float))
            x = inside(f"atmosphere.{name}", nodes, x) if self.bounded else x
            parts.append(node_weights(nodes, x, smooth_rule(name)))
        joint = _star(parts) if self.star else reduce(_crossed, parts)
        terms: dict[str, Any] = {name: joint @ values for name, values in self.values.items()}
        terms |= {name: _lit(np.exp(x)) for name, x in terms.items() if name not in AS_THEY_ARE}
        return replace(self.pattern, **terms | {n: np.minimum(terms[n], 1.0) for n in _AT_MOST_ONE if n in terms})


def _crossed(a: Array, b: Array) -> Array:
    return (a[:, :, None] * b[:, None, :]).reshape(a.shape[0], -1)


def _star(parts: Sequence[Array]) -> Array:
    """Weights of the runs of a star: the middle has what the others leave of 1."""
    rest = [w[:, 1:] for w in parts]
    middle = 1.0 - np.sum([w.sum(axis=1) for w in rest], axis=0)
    return np.concatenate([middle[:, None], *rest], axis=1)


def interpolated_terms(
    axes: Mapping[str, Array], runs: Sequence[AtmosphericTerms], *, star: bool = False, bounded: bool = True
) -> InterpolatedTerms:
    """Interpolation between ``runs`` of an engine at the nodes of a grid or a star (see :class:`InterpolatedTerms`)."""
    values = stacked_values(runs)
    values |= {name: np.log(np.maximum(v, _LEAST)) for name, v in values.items() if name not in AS_THEY_ARE}
    return InterpolatedTerms(axes, values, runs[0], star, bounded)


def stacked_values(runs: Sequence[AtmosphericTerms]) -> dict[str, Array]:
    """Term -> (runs, B), for every term that the engine gives."""
    names = [f.name for f in fields(AtmosphericTerms) if f.name not in NOT_AVERAGED]
    return {n: np.stack([getattr(t, n) for t in runs]) for n in names if getattr(runs[0], n) is not None}
