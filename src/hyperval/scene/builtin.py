"""Surfaces that ship with the project: smooth parametric curves and a few modes of variation.

They are our own curves, drawn to have the well known features of each material at plausible
depths; they are no measurement.  A class is its mean curve and smooth modes (brightness, slope,
and what the material adds, such as chlorophyll or water) with a standard deviation each, plus a
small independent spread per band that keeps the covariance of full rank.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.scene.statistics import ClassStatistics
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Curve = Callable[[Array], Array]
RANGE_NM = (340.0, 2600.0)


@dataclass(frozen=True)
class BuiltinSurface:
    """Mean curve, modes and band spread of a surface; all take wavelength (B,) [nm] and give (B,)."""

    mean: Curve
    modes: Mapping[str, Curve]
    band_spread: float
    words: str


def _bump(w: Array, centre: float | Array, sd: float) -> Array:
    return np.asarray(np.exp(-0.5 * ((w - centre) / sd) ** 2))


def _rise(w: Array, centre: float, width: float) -> Array:
    return np.asarray(1.0 / (1.0 + np.exp(-(w - centre) / width)))


def _leaf_water(w: Array) -> Array:
    """Absorbance of leaf water, relative: dips at 970, 1200, 1450 and 1940 nm and beyond 2300 nm."""
    return (
        0.05 * _bump(w, 970, 22) + 0.17 * _bump(w, 1195, 45) + 1.05 * _bump(w, 1450, 55)
        + 1.75 * _bump(w, 1940, 70) + 0.45 * _rise(w, 1350, 60) + 0.35 * _rise(w, 1880, 60)
        + 1.0 * _rise(w, 2420, 60)
    )  # fmt: skip


def _chlorophyll(w: Array) -> Array:
    """Absorbance of leaf pigments, relative: blue and red bands with the green window between them."""
    return 2.0 * _rise(-w, -505, 14) + 1.75 * _bump(w, 670, 28) + 0.75 * _bump(w, 610, 35) + 0.95 * _bump(w, 555, 70)


def _grass(w: Array) -> Array:
    plateau = 0.50 - 0.03 * _rise(-w, -760, 30)
    return np.asarray(plateau * np.exp(-_chlorophyll(w) - 0.55 * _leaf_water(w)))


def _asphalt(w: Array) -> Array:
    return np.asarray(0.075 + 0.095 * (1 - np.exp(-(w - 340) / 650)) - 0.008 * _bump(w, 2310, 25))


def _soil(w: Array) -> Array:
    continuum = 0.06 + 0.33 * (1 - np.exp(-(w - 340) / 480))
    dips = 0.12 * _bump(w, 480, 40) + 0.05 * _bump(w, 880, 60) + 0.10 * _bump(w, 1415, 25)
    dips = dips + 0.24 * _bump(w, 1920, 35) + 0.12 * _bump(w, 2205, 22) + 0.20 * _rise(w, 2400, 60)
    return np.asarray(continuum * (1 - dips))


def _painted_wood(w: Array) -> Array:
    """Relative dips of binder and wood in the short-wave infrared."""
    dips = 0.05 * _bump(w, 1200, 25) + 0.10 * _bump(w, 1445, 40) + 0.16 * _bump(w, 1725, 25)
    return dips + 0.22 * _bump(w, 1935, 45) + 0.15 * _bump(w, 2140, 50) + 0.30 * _bump(w, 2310, 40)


def _yellow(w: Array) -> Array:
    level = 0.06 + 0.56 * _rise(w, 515, 12) + 0.05 * _rise(w, 800, 60) - 0.30 * _rise(w, 1750, 260)
    return np.asarray(level * (1 - _painted_wood(w)))


def _green(w: Array) -> Array:
    level = 0.045 + 0.075 * _bump(w, 530, 32) + 0.36 * _rise(w, 735, 20) - 0.17 * _rise(w, 1600, 220)
    return np.asarray(level * (1 - _painted_wood(w)))


def _tilt(w: Array) -> Array:
    return np.asarray((w - 1200.0) / 1000.0)


def _scaled(curve: Curve, by: Curve | float, sd: float) -> Curve:
    """A mode: ``sd`` times the mean curve times ``by``."""
    return lambda w: sd * curve(w) * (by(w) if callable(by) else by)


def _mottle(curve: Callable[[Array], Array], sd: float, width_nm: float) -> dict[str, Callable[[Array], Array]]:
    """Modes of everything unnamed that varies on the ground: relative spread ``sd`` at every wavelength,
    correlated over about ``width_nm``.  Without it a handful of smooth modes would leave a background so
    simple that one part in a thousand of a foreign material is found in it.
    """
    centres = np.arange(RANGE_NM[0], RANGE_NM[1] + width_nm, width_nm)

    def mode(centre: float) -> Callable[[Array], Array]:
        def value(w: Array) -> Array:
            total = np.sqrt(np.sum(_bump(w[:, None], centres, width_nm) ** 2, axis=1))
            return np.asarray(sd * curve(w) * _bump(w, centre, width_nm) / total)

        return value

    return {f"mottle {centre:.0f} nm": mode(float(centre)) for centre in centres}


def _painted(curve: Curve, words: str) -> BuiltinSurface:
    return BuiltinSurface(
        curve,
        {
            "brightness": _scaled(curve, 1.0, 0.07),
            "slope": _scaled(curve, _tilt, 0.03),
            "wear": lambda w: 0.012 * (0.25 + 0.3 * (1 - np.exp(-(w - 340) / 500)) - curve(w)),
        },
        0.003,
        words,
    )


def _panel(level: float, slope: float) -> BuiltinSurface:
    def curve(w: Array) -> Array:
        return np.asarray(level * (1 - slope * (w - 400) / 2100 - 0.05 * _rise(-w, -385, 12)))

    return BuiltinSurface(
        curve,
        {"brightness": _scaled(curve, 1.0, 0.012), "slope": _scaled(curve, _tilt, 0.006)},
        # A painted sheet has no structure of single bands; more than this would pass for sensor noise in its SNR.
        5e-4 * level,
        f"a grey panel of reflectance {level:g}",
    )


_SURFACES: dict[str, BuiltinSurface] = {
    "grass": BuiltinSurface(
        _grass,
        {
            "brightness": _scaled(_grass, 1.0, 0.12),
            "slope": _scaled(_grass, _tilt, 0.04),
            "chlorophyll": _scaled(_grass, _chlorophyll, -0.13),
            "water": _scaled(_grass, _leaf_water, -0.07),
            "bare ground": lambda w: 0.05 * (_soil(w) - _grass(w)),
            **_mottle(_grass, 0.06, 40.0),
        },
        0.003,
        "green vegetation",
    ),
    "asphalt": BuiltinSurface(
        _asphalt,
        {
            "brightness": _scaled(_asphalt, 1.0, 0.10),
            "slope": _scaled(_asphalt, _tilt, 0.05),
            "dust": lambda w: 0.03 * (_soil(w) - _asphalt(w)),
            **_mottle(_asphalt, 0.10, 25.0),
        },
        0.002,
        "worn asphalt",
    ),
    "soil": BuiltinSurface(
        _soil,
        {
            "brightness": _scaled(_soil, 1.0, 0.13),
            "slope": _scaled(_soil, _tilt, 0.05),
            "moisture": _scaled(_soil, lambda w: 0.3 * _rise(w, 1300, 300) + _bump(w, 1920, 60), -0.10),
        },
        0.003,
        "bare soil",
    ),
    "yellow-paint-plank": _painted(_yellow, "wood painted yellow"),
    "green-paint-plank": _painted(_green, "wood painted green"),
    "white-panel": _panel(0.62, 0.08),
    "black-panel": _panel(0.05, 0.02),
}
_GREY = re.compile(r"^grey-panel-(\d{1,2})$")

BUILTIN_NAMES = (*_SURFACES, "grey-panel-NN")


def builtin_class(name: str, axis: SpectralAxis) -> ClassStatistics:
    """Reflectance statistics of a built-in surface on ``axis`` (rho_m and Sigma_m of 3.8-3.12).

    ``grey-panel-NN`` is a panel of NN per cent.

    Raises
    ------
    UsageError : unknown name, or bands outside 340-2600 nm.
    """
    return _evaluated(name, axis.centre_nm.tobytes(), axis.fwhm_nm.tobytes(), axis.good.tobytes())


def builtin_mean(name: str, axis: SpectralAxis) -> Array:
    """(B,) mean reflectance of a built-in surface (rho_m of 3.8) without the covariance, large on a fine axis.

    Raises
    ------
    UsageError : as by :func:`builtin_class`.
    """
    return _surface(name, axis).mean(axis.centre_nm)


def _surface(name: str, axis: SpectralAxis) -> BuiltinSurface:
    grey = _GREY.match(name)
    if grey is None and name not in _SURFACES:
        raise UsageError(f"unknown built-in surface {name!r}", expected="one of " + ", ".join(BUILTIN_NAMES))
    w = axis.centre_nm
    if w[0] < RANGE_NM[0] or w[-1] > RANGE_NM[1]:
        raise UsageError(f"built-in surfaces cover {RANGE_NM[0]:g}-{RANGE_NM[1]:g} nm, the bands {w[0]:g}-{w[-1]:g} nm")
    return _panel(int(grey.group(1)) / 100.0, 0.04) if grey else _SURFACES[name]


@lru_cache(maxsize=64)
def _evaluated(name: str, centre: bytes, fwhm: bytes, good: bytes) -> ClassStatistics:
    axis = SpectralAxis(np.frombuffer(centre), np.frombuffer(fwhm), np.frombuffer(good, bool))
    surface, w = _surface(name, axis), axis.centre_nm
    modes = np.stack([mode(w) for mode in surface.modes.values()])
    covariance = modes.T @ modes + surface.band_spread**2 * np.eye(len(axis))
    return ClassStatistics(
        name,
        axis,
        surface.mean(w),
        covariance,
        source=f"built-in parametric curve of {surface.words}; a definition of this project, not a measurement",
    )
