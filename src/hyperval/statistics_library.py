"""Statistics libraries: mean, covariance, n and source of surface classes in one NetCDF-4 file; the built-in surfaces.

Variables: ``wavelength`` and ``fwhm`` (band) [nm], ``class_name`` (class), ``mean`` (class, band) [1],
``covariance`` (class, band, band_2) [1], ``n`` (class; 0 = a definition, no samples), ``source`` (class),
``tail_dof`` (class; NaN = Gaussian).  Classes that are mixtures have ``component_weight`` (class, component; 0
beyond their own number), ``component_offset`` (class, component, band) [1], ``component_covariance`` (class,
component, band, band_2) [1] and ``component_dof`` (class; NaN = normal laws).  docs/formats.md has an example.

A built-in surface (``surfaces.toml``) is a mean curve and smooth modes (brightness, slope, and what the material adds,
such as chlorophyll or water) with a standard deviation each.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.data import MAX_COMPONENTS, Array, Components, check_covariances, statistics_of
from hyperval.errors import reader, refuse, told_of
from hyperval.hdf5 import opened_netcdf
from hyperval.paths import checked_file
from hyperval.spectra.axis import SpectralAxis
from hyperval.storage import whole_file

MAX_BYTES = 512 << 20
_MOST = {"band": 5000, "class": 1000, "component": MAX_COMPONENTS}
_AXES = {
    "wavelength": "band", "fwhm": "band", "good_band": "band", "class_name": "class", "mean": "class band",
    "covariance": "class band band_2", "n": "class", "source": "class", "tail_dof": "class",
    "component_weight": "class component", "component_offset": "class component band",
    "component_covariance": "class component band band_2", "component_dof": "class",
}  # fmt: skip
_PARTS = {"component_weight": "weights", "component_offset": "offsets", "component_covariance": "covariances"}
_MAY_LACK = ("good_band", "tail_dof", "component_dof", *_PARTS)


@dataclass(frozen=True)
class ClassStatistics:
    """Mean and covariance of one surface class, in reflectance or in radiance.

    Attributes
    ----------
    name : class name
    axis : the bands
    mean : (B,) mean
    covariance : (B, B) pixel-to-pixel covariance, symmetric, positive semi-definite
    n : number of samples behind it, None when it is a definition rather than an estimate
    source : where the numbers come from, in words
    tail_dof : degrees of freedom of a multivariate t (nu > 2), None for Gaussian
    tail_scale : factor on the covariance of that t, which was fitted together with them
    components : the clusters that the pixels fall into, None where they are one
    """

    name: str
    axis: SpectralAxis
    mean: Array
    covariance: Array
    n: int | None = None
    source: str = ""
    tail_dof: float | None = None
    components: Components | None = None
    tail_scale: float = 1.0

    def __post_init__(self) -> None:
        mean = np.asarray(self.mean, dtype=float)
        cov = np.asarray(self.covariance, dtype=float)
        bands = len(self.axis)
        unlike = mean.shape != (bands,) or cov.shape != (bands, bands)
        refuse(unlike, "class.shapes", name=self.name, mean=mean.shape, covariance=cov.shape, bands=bands)
        refuse(not (np.all(np.isfinite(mean)) and np.all(np.isfinite(cov))), "class.finite", name=self.name)
        check_covariances(cov, f"class {self.name!r}: the covariance")
        refuse(not (self.tail_dof is None or self.tail_dof > 2), "class.tail", name=self.name, dof=self.tail_dof)
        unlike = self.components is not None and self.components.offsets.shape[1] != bands
        refuse(unlike, "class.components", name=self.name, bands=bands)
        vars(self).update(mean=mean, covariance=cov)


def statistics_of_samples(
    name: str, axis: SpectralAxis, samples: npt.ArrayLike, source: str = "samples"
) -> ClassStatistics:
    """Mean and sample covariance of spectra (N, B) on ``axis`` (rho_m, Sigma_m of 3.8-3.12).

    Raises
    ------
    UsageError : fewer than two samples, another number of bands, or NaN.
    """
    sample = statistics_of(samples)
    return ClassStatistics(name, axis, sample.mean, sample.covariance, sample.n, source)


def write_statistics_library(path: Path, classes: Sequence[ClassStatistics]) -> None:
    """Write classes that share their bands to a new file, whole or not at all.

    Raises
    ------
    UsageError : no class, a name that stands twice, or different bands.
    """
    names = [c.name for c in classes]
    refuse(not classes or len(set(names)) < len(names), "classes.names", path)
    axis = classes[0].axis
    refuse(not all(c.axis.matches(axis, 1e-6) for c in classes), "classes.bands", path)
    import xarray as xr  # 80 MB with pandas, which most runs do not need

    values: dict[str, npt.ArrayLike] = {
        "fwhm": axis.fwhm_nm, "good_band": axis.good.astype(np.int8), "mean": [c.mean for c in classes],
        "covariance": [c.covariance for c in classes], "n": np.array([c.n or 0 for c in classes], dtype=np.int64),
        "tail_dof": [np.nan if c.tail_dof is None else c.tail_dof for c in classes],
        "source": np.array([c.source for c in classes], dtype=object), "class_name": np.array(names, dtype=object),
    }  # fmt: skip
    mixtures = [c.components for c in classes]
    if most := max(0 if parts is None else len(parts) for parts in mixtures):
        for name, part in _PARTS.items():
            shape = (len(classes), most, *[len(axis)] * (_AXES[name].count("band")))
            values[name] = padded = np.zeros(shape)  # by components without weight to the same number
            for i, parts in enumerate(mixtures):
                if parts is not None:
                    padded[i, : len(parts)] = getattr(parts, part)
        values["component_dof"] = [np.nan if m is None or np.isinf(m.dof) else m.dof for m in mixtures]
    units = {"fwhm": {"units": "nm"}, "source": {}, "class_name": {}}
    data = xr.Dataset(
        {name: (_AXES[name].split(), np.asarray(v), units.get(name, {"units": "1"})) for name, v in values.items()},
        coords={"wavelength": ("band", axis.centre_nm, {"units": "nm"})},
        attrs={"title": "hyperval statistics library", "format_version": 1},
    )
    with whole_file(Path(path)) as temporary:
        data.to_netcdf(temporary, engine="h5netcdf")


@reader
def read_statistics_library(path: Path, record: str | None = None) -> ClassStatistics:
    """One class of a library; ``record`` may be left out when there is only one.

    Sizes are checked before numbers are read.

    Raises
    ------
    InputError : no such file, not a library, sizes that contradict each other or go beyond the limits.
    UsageError : no such record, or statistics that are none: a covariance that is not symmetric or not positive
        semi-definite, values that are not finite.
    """
    path = checked_file(path, what="statistics library", most=MAX_BYTES)
    with opened_netcdf(path, "statistics library", _AXES, _MOST, _MAY_LACK) as data:
        names = [str(n) for n in data["class_name"].values]
        refuse(record is None and len(names) > 1, "classes.several", path, names=", ".join(names))
        record_name = names[0] if record is None else record
        refuse(record_name not in names, "classes.none", path, name=record_name, names=", ".join(names))
        number = names.index(record_name)
        one = data.isel({"class": number})
        good = one["good_band"].values > 0 if "good_band" in one else np.ones(0, bool)
        tail, components = float(one["tail_dof"]) if "tail_dof" in one else np.nan, None
        with told_of(str(path)):
            if "component_weight" in one and (used := one["component_weight"].values != 0).any():
                weight, offset, covariance = (one[name].values[used] for name in _PARTS)
                dof = float(one["component_dof"])
                components = Components(weight, offset, covariance, np.inf if np.isnan(dof) else dof)
            return ClassStatistics(
                names[number], SpectralAxis(one["wavelength"].values, one["fwhm"].values, good),
                np.asarray(one["mean"].values, dtype=float), np.asarray(one["covariance"].values, dtype=float),
                int(one["n"]) or None, str(one["source"].values), None if np.isnan(tail) else tail, components,
            )  # fmt: skip


def on_bands(statistics: ClassStatistics, axis: SpectralAxis, edge_nm: float = 10.0) -> ClassStatistics:
    """The statistics on other bands: W mean and W Sigma W^T, with W linear interpolation between band centres.

    Bands wider than those of the library keep too much of the spread of single bands.

    Raises
    ------
    UsageError : the library does not cover the bands (to ``edge_nm`` beyond its first and last centre).
    """
    if statistics.axis.matches(axis):
        return statistics
    nm, centre_nm = statistics.axis.centre_nm, axis.centre_nm
    short = (centre_nm < nm[0] - edge_nm) | (centre_nm > nm[-1] + edge_nm)
    ends = {"low": nm[0], "high": nm[-1], "count": int(short.sum()), "first": centre_nm[int(np.argmax(short))]}
    refuse(nm.size < 2 or short.any(), "class.bands", name=statistics.name, **ends)
    weights = np.stack([np.interp(centre_nm, nm, one) for one in np.eye(nm.size)], axis=1)
    covariance = weights @ statistics.covariance @ weights.T
    mean, covariance, components = weights @ statistics.mean, 0.5 * (covariance + covariance.T), statistics.components
    components = components and components.through(weights)
    return replace(statistics, axis=axis, mean=mean, covariance=covariance, components=components)


RANGE_NM = (340.0, 2600.0)
_TABLE: dict[str, dict[str, Any]] = tomllib.loads((Path(__file__).with_name("surfaces.toml")).read_text("utf-8"))
_CURVES, _SURFACES, _PANELS = (_TABLE[name] for name in ("curves", "surfaces", "panels"))
_GREY = re.compile(r"^grey-panel-(\d{1,2})$")

BUILTIN_NAMES = (*_SURFACES, *_PANELS["level"], "grey-panel-NN")


def _bump(w: Array, centre: float | Array, sd: float) -> Array:
    return np.asarray(np.exp(-0.5 * ((w - centre) / sd) ** 2))


def _rise(w: Array, centre: float, width: float) -> Array:
    return np.asarray(1.0 / (1.0 + np.exp(-(w - centre) / width)))


_SHAPES: dict[str, Callable[..., Array]] = {
    "level": np.ones_like,
    "bump": _bump,
    "rise": _rise,
    "fall": lambda w, centre, width: _rise(-w, -centre, width),
    "growth": lambda w, width: 1 - np.exp(-(w - 340) / width),
    "tilt": lambda w: (w - 1200.0) / 1000.0,
}


def _curve(terms: str | list[list[Any]], w: Array) -> Array:
    """(B,) the sum of the terms of a curve, or of the curve of that name, at ``w`` (B,) [nm]."""
    listed = _CURVES[terms] if isinstance(terms, str) else terms
    return sum((height * _SHAPES[shape](w, *where) for height, shape, *where in listed), np.zeros_like(w))


def _level(name: str) -> float | None:
    """Reflectance of a panel; None for another surface."""
    grey = _GREY.match(name)
    return int(grey[1]) / 100.0 if grey else _PANELS["level"].get(name)


def _mean(name: str, w: Array) -> Array:
    """(B,) mean reflectance of a surface."""
    if (level := _level(name)) is not None:
        slope = _PANELS["slope"].get(name, _PANELS["slope"]["grey"])
        return np.asarray(level * (1 - slope * (w - 400) / 2100 - 0.05 * _rise(-w, -385, 12)))
    surface = _SURFACES[name]
    depth = sum((factor * _curve(curve, w) for factor, curve in surface.get("absorbance", ())), np.zeros_like(w))
    return np.asarray(_curve(surface["level"], w) * np.exp(-depth) * (1 - _curve(surface.get("dips", []), w)))


def _modes(surface: dict[str, Any], mean: Array, w: Array) -> Iterator[Array]:
    """(B,) each mode of the variation of a surface with its standard deviation."""
    for mode in surface["modes"]:
        if "times" in mode:
            yield mode["sd"] * mean * _curve(mode["times"], w)
        else:
            other = mode["towards"]
            yield mode["sd"] * ((_mean(other, w) if other in _SURFACES else _curve(other, w)) - mean)
    if "mottle" in surface:
        sd, width = surface["mottle"]
        centres = np.arange(RANGE_NM[0], RANGE_NM[1] + width, width)
        total = np.sqrt(np.sum(_bump(w[:, None], centres, width) ** 2, axis=1))
        yield from (sd * mean * _bump(w, float(centre), width) / total for centre in centres)


def builtin_class(name: str, axis: SpectralAxis) -> ClassStatistics:
    """Reflectance statistics of a built-in surface on ``axis`` (rho_m and Sigma_m of 3.8-3.12).

    ``grey-panel-NN`` is a panel of NN per cent.  The curve is taken at the bands' centres; its average over a Gaussian
    band of 10 nm differs by at most 2.2 % (grass at 680 nm, yellow paint at 490 nm), of 5 nm by a quarter of that.

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
    unknown = _level(name) is None and name not in _SURFACES
    refuse(unknown, "class.unknown", name=name, known=", ".join(BUILTIN_NAMES))
    w, (low, high) = axis.centre_nm, RANGE_NM
    refuse(w[0] < low or w[-1] > high, "class.range", low=low, high=high, first=w[0], last=w[-1])
    return _mean(name, w)


@lru_cache(maxsize=64)
def _evaluated(name: str, centre: bytes, fwhm: bytes, good: bytes) -> ClassStatistics:
    axis = SpectralAxis(np.frombuffer(centre), np.frombuffer(fwhm), np.frombuffer(good, bool))
    mean, surface, level = builtin_mean(name, axis), _SURFACES.get(name, _PANELS), _level(name)
    words, spread = surface.get("words", f"a grey panel of reflectance {level or 0.0:g}"), surface["band_spread"]
    spread *= 1.0 if level is None else level
    modes = np.stack(list(_modes(surface, mean, axis.centre_nm)))
    covariance = modes.T @ modes + spread**2 * np.eye(len(axis))
    source = f"built-in parametric curve of {words}; a definition of this project, not a measurement"
    return ClassStatistics(name, axis, mean, covariance, source=source)
