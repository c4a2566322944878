"""``products.nc``: both sides' spectra, covariances, scores and ROC curves as NetCDF-4.

Groups ``predicted`` and ``observed``; absent sides have no group.  Spectra and curves are float64;
covariances are float32 (24 bits of mantissa) and compressed, because they are most of the file.
The covariance between bands of an SNR is left out: its standard uncertainty is there.
Two writes of the same products give the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import hyperval
from hyperval.products import Products, SpectralEstimate
from hyperval.units import RADIANCE_UNIT

_SPECTRA = (  # name, long name, unit, unit of a covariance, covariances written
    ("radiance", "spectral radiance at the sensor", RADIANCE_UNIT, "uW2 cm-4 sr-2 nm-2", True),
    ("reflectance", "surface reflectance", "1", "1", True),
    ("snr", "signal-to-noise ratio", "1", "1", False),
)
_TAILS = (
    "tail_dof", "tail_lower", "tail_upper", "normality_p_value",
    "leading_tail_dof", "leading_lower", "leading_upper", "dimension", "leading_dimension", "n",
)  # fmt: skip
_CLASS_ERROR = (
    "error", "lower", "upper", "n", "effective_n", "distance", "approximation", "bound_lower", "bound_upper",
)  # fmt: skip
_PACKED = {"zlib": True, "complevel": 4, "shuffle": True, "dtype": "float32"}


def write_products(path: Path, sides: Mapping[str, Products | None], *, title: str, simulated: bool) -> None:
    """Write the given sides (group name -> products) to a new NetCDF file at ``path``."""
    attributes = {
        "Conventions": "CF-1.11",
        "title": title,
        "source": f"hyperval {hyperval.__version__}",
        "simulated": "yes" if simulated else "no",
    }
    xr.Dataset(attrs=attributes).to_netcdf(path, mode="w", engine="h5netcdf")
    for group, products in sides.items():
        if products is None:
            continue
        data = dataset(products)
        encoding = {name: dict(_PACKED) for name in data.data_vars if str(name).endswith("_covariance")}
        data.to_netcdf(path, mode="a", group=group, engine="h5netcdf", encoding=encoding)


def dataset(products: Products) -> xr.Dataset:
    """One side as a dataset: dims band, band_2, <product>_subject, roc_curve, roc_point, ..."""
    axis = products.axis
    data = xr.Dataset(
        coords={
            "wavelength": ("band", axis.centre_nm, {"units": "nm", "standard_name": "radiation_wavelength"}),
            "wavelength_2": ("band_2", axis.centre_nm, {"units": "nm", "long_name": "wavelength, second index"}),
        }
    )
    data["fwhm"] = ("band", axis.fwhm_nm, {"units": "nm", "long_name": "full width at half maximum"})
    data["good_band"] = ("band", axis.good.astype(np.int8), {"units": "1", "long_name": "1 where usable"})
    for name, long_name, unit, squared, with_covariance in _SPECTRA:
        estimates: Mapping[str, SpectralEstimate] = getattr(products, name)
        if estimates:
            _add_spectra(data, name, long_name, unit, squared, estimates, with_covariance)
    _add_curves(data, products)
    _add_scalars(data, "score", products.scores, {"mean": "1", "sd": "1", "n": "1"})
    areas = {"area_m2": "m2", "standard_uncertainty": "m2", "nominal_m2": "m2", "n": "1"}
    _add_scalars(data, "abundance", products.abundance, areas)
    tails = {(subject, "pixels"): held for subject, held in products.distribution.items()}
    _add_scalars(data, "distribution", tails, dict.fromkeys(_TAILS, "1"))
    _add_scalars(data, "classification", products.classification, dict.fromkeys(_CLASS_ERROR, "1"))
    return data


def _add_spectra(
    data: xr.Dataset,
    name: str,
    long_name: str,
    unit: str,
    squared: str,
    estimates: Mapping[str, SpectralEstimate],
    with_covariance: bool,
) -> None:
    subject = f"{name}_subject"
    data.coords[subject] = (subject, _names(estimates), {"long_name": f"subjects of {name}"})
    each = list(estimates.values())

    def add(suffix: str, dims: tuple[str, ...], values: Any, units: str, text: str) -> None:
        data[f"{name}{suffix}"] = ((subject, *dims), values, {"units": units, "long_name": text})

    add("", ("band",), np.stack([e.mean for e in each]), unit, long_name)
    u = np.stack([e.standard_uncertainty for e in each])
    add("_standard_uncertainty", ("band",), u, unit, f"standard uncertainty of {name}")
    add("_n", (), _counts([e.n for e in each]), "1", "samples behind the mean; NaN when it has none")
    for source in sorted({source for e in each for source in e.budget}):
        empty = np.full(len(data["band"]), np.nan)
        part = np.stack([np.asarray(e.budget.get(source, empty), dtype=float) for e in each])
        add(
            f"_uncertainty_from_{_identifier(source)}", ("band",), part, unit, f"standard uncertainty from {source}"
        )
    if with_covariance:
        square = ("band", "band_2")
        error = np.stack([np.asarray(e.error_covariance, dtype=np.float32) for e in each])
        add("_error_covariance", square, error, squared, f"covariance of the error of {name}")
        if any(e.pixel_covariance is not None for e in each):
            nothing = np.full(error.shape[1:], np.nan, dtype=np.float32)
            spread = [nothing if (c := e.pixel_covariance) is None else c.astype(np.float32) for e in each]
            add("_pixel_covariance", square, np.stack(spread), squared, f"covariance of {name} from pixel to pixel")


def _add_curves(data: xr.Dataset, products: Products) -> None:
    if not products.roc:
        return
    curves = list(products.roc.values())
    for part, label in enumerate(("subject", "detector", "unit")):
        names = np.array([key[part] for key in products.roc], dtype=object)
        data.coords[f"roc_{label}"] = ("roc_curve", names)
    longest = max(len(curve.pfa) for curve in curves)
    for name, text in (
        ("pfa", "probability of false alarm"),
        ("pd", "probability of detection"),
        ("pd_lower", "lower 95 % limit of the probability of detection"),
        ("pd_upper", "upper 95 % limit of the probability of detection"),
        ("threshold", "detector score at the point"),
    ):
        values = np.full((len(curves), longest), np.nan)
        for row, curve in zip(values, curves, strict=True):
            row[: len(curve.pfa)] = getattr(curve, name)
        data[f"roc_{name}"] = (("roc_curve", "roc_point"), values, {"units": "1", "long_name": text})
    for name, unit in (("n_target", "1"), ("n_background", "1"), ("background_area_km2", "km2")):
        values = _counts([getattr(curve, name) for curve in curves])
        data[f"roc_{name}"] = ("roc_curve", values, {"units": unit, "long_name": name.replace("_", " ")})


def _add_scalars(data: xr.Dataset, name: str, held: Mapping[tuple[str, str], Any], units: dict[str, str]) -> None:
    if not held:
        return
    dim = f"{name}_entry"
    for part, label in enumerate(("subject", "detector")):
        data.coords[f"{name}_{label}"] = (dim, np.array([key[part] for key in held], dtype=object))
    for attribute, unit in units.items():
        values = _counts([getattr(item, attribute) for item in held.values()])
        data[f"{name}_{attribute}"] = (dim, values, {"units": unit, "long_name": attribute.replace("_", " ")})


def _counts(values: Sequence[float | int | None]) -> Any:
    return np.array([np.nan if value is None else value for value in values], dtype=float)


def _names(held: Mapping[str, Any]) -> Any:
    return np.array(list(held), dtype=object)


def _identifier(text: str) -> str:
    keep: Callable[[str], str] = lambda c: c if c.isascii() and c.isalnum() else "_"  # noqa: E731
    return "".join(keep(c) for c in text)
