"""``products.nc``: everything that both sides hold, as NetCDF-4: spectra, covariances, noise, tails, detection.

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

import hyperval
from hyperval.products import Prediction, Products, SpectralEstimate
from hyperval.report.labelled_arrays import LabelledArrays, write_groups
from hyperval.report.netcdf_detection import add_detection, add_entries, ragged
from hyperval.units import RADIANCE_UNIT

_SPECTRA = (  # name, long name, unit, unit of a covariance, covariances written
    ("radiance", "spectral radiance at the sensor", RADIANCE_UNIT, "uW2 cm-4 sr-2 nm-2", True),
    ("reflectance", "surface reflectance", "1", "1", True),
    ("snr", "signal-to-noise ratio", "1", "1", False),
    ("toa_reflectance", "reflectance at the top of the atmosphere", "1", "1", True),
)
_TAILS = (
    ("tail_dof", "degrees of freedom of the multivariate t law of the pixels; inf for the normal law"),
    ("tail_lower", "lower 95 % limit of tail_dof"),
    ("tail_upper", "upper 95 % limit of tail_dof"),
    ("normality_p_value", "p-value of the likelihood ratio of the normal law and the t law"),
    ("leading_tail_dof", "degrees of freedom in the leading components"),
    ("leading_lower", "lower 95 % limit of leading_tail_dof"),
    ("leading_upper", "upper 95 % limit of leading_tail_dof"),
    ("dimension", "bands in which distances were taken"),
    ("leading_dimension", "number of leading components"),
    ("n", "pixels of the sample; NaN for a definition"),
    ("samples", "columns of the image that they lie in; NaN for a definition"),
)
_TAIL_CURVES = (
    ("distance", "distribution_point", "squared Mahalanobis distance in the leading components"),
    ("exceedance", "distribution_point", "share of pixels beyond the distance"),
    ("effective_n", "distribution_component", "independent pixels behind the variance along a leading component"),
)
_CLASS_ERROR = (
    ("error", "probability of a wrong class, classes equally likely"),
    ("lower", "lower 95 % limit of the probability"),
    ("upper", "upper 95 % limit of the probability"),
    ("n", "pixels classified; NaN for a prediction"),
    ("effective_n", "pixels that count as independent; NaN for a prediction"),
    ("distance", "least Bhattacharyya distance of two of the classes"),
    ("approximation", "probability estimated from the distances"),
    ("bound_lower", "lower limit of the least error of normal classes with these distances"),
    ("bound_upper", "upper limit of the least error of normal classes with these distances"),
)


def write_products(path: Path, sides: Mapping[str, Products | None], *, title: str, simulated: bool) -> None:
    """Write the given sides (group name -> products) to a new NetCDF file at ``path``."""
    attributes = {
        "Conventions": "CF-1.11",
        "title": title,
        "source": f"hyperval {hyperval.__version__}",
        "simulated": "yes" if simulated else "no",
    }
    groups = {group: labelled_arrays(products) for group, products in sides.items() if products is not None}
    write_groups(path, groups, attributes)


def labelled_arrays(products: Products) -> LabelledArrays:
    """One side as arrays: axes band, band_2, <product>_subject, roc_curve, roc_point, ..."""
    axis = products.axis
    data = LabelledArrays(
        coords={
            "wavelength": ("band", axis.centre_nm, {"units": "nm", "standard_name": "radiation_wavelength"}),
            "wavelength_2": ("band_2", axis.centre_nm, {"units": "nm", "long_name": "wavelength, second index"}),
        }
    )
    if axis.numbered:
        for name in ("wavelength", "wavelength_2"):
            dimension, numbers, _ = data.coords[name]
            data.coords[name] = (dimension, numbers, {"units": "1", "long_name": "number of the band"})
    data["fwhm"] = ("band", axis.fwhm_nm, {"units": "nm", "long_name": "full width at half maximum"})
    data["good_band"] = (
        "band", axis.good.astype(np.int8),
        {"units": "1", "long_name": "whether the band is used", "flag_values": np.array([0, 1], dtype=np.int8),
         "flag_meanings": "not_used used"},
    )  # fmt: skip
    for name, long_name, unit, squared, with_covariance in _SPECTRA:
        estimates: Mapping[str, SpectralEstimate] = getattr(products, name)
        if estimates:
            _add_spectra(data, name, long_name, unit, squared, estimates, with_covariance)
    if isinstance(products, Prediction):
        _add_noise(data, products)
    add_detection(data, products)
    _add_tails(data, products)
    errors = [(name, "1", text) for name, text in _CLASS_ERROR]
    add_entries(data, "classification", products.classification, errors, ("classes", "features"))
    return data


def _add_spectra(
    data: LabelledArrays,
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
        empty = np.full(len(each[0].mean), np.nan)
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


def _add_noise(data: LabelledArrays, prediction: Prediction) -> None:
    """Variance by source of noise, and the part of full scale, by subject."""
    if prediction.noise:
        noise = prediction.noise
        data.coords["noise_subject"] = ("noise_subject", _names(noise), {"long_name": "subjects of noise"})
        for source in sorted({source for parts in noise.values() for source in parts}):
            empty = np.full(len(prediction.axis), np.nan)
            values = np.stack([np.asarray(parts.get(source, empty), dtype=float) for parts in noise.values()])
            text = f"variance of a pixel's radiance from {source.replace('_', ' ')}"
            data[f"noise_variance_{_identifier(source)}"] = (
                ("noise_subject", "band"), values, {"units": _SPECTRA[0][3], "long_name": text})  # fmt: skip
    if prediction.full_scale:
        scale = prediction.full_scale
        data.coords["full_scale_subject"] = (
            "full_scale_subject", _names(scale), {"long_name": "subjects of full_scale"})  # fmt: skip
        data["full_scale"] = (
            ("full_scale_subject", "band"), np.stack([np.asarray(v, dtype=float) for v in scale.values()]),
            {"units": "1", "long_name": "mean radiance as a part of full scale"},
        )  # fmt: skip


def _add_tails(data: LabelledArrays, products: Products) -> None:
    """How the pixels of each class are distributed about their mean."""
    distributions = {(subject,): distribution for subject, distribution in products.distribution.items()}
    add_entries(data, "distribution", distributions, [(name, "1", text) for name, text in _TAILS], ("subject",))
    for name, dim, text in _TAIL_CURVES:
        values = [getattr(distribution, name) for distribution in distributions.values()]
        if any(value is not None for value in values):
            data[f"distribution_{name}"] = (
                ("distribution_entry", dim), ragged(values), {"units": "1", "long_name": text})  # fmt: skip


def _counts(values: Sequence[float | int | None]) -> Any:
    return np.array([np.nan if value is None else value for value in values], dtype=float)


def _names(mapping: Mapping[str, Any]) -> Any:
    return np.array(list(mapping), dtype=object)


def _identifier(text: str) -> str:
    keep: Callable[[str], str] = lambda c: c if c.isascii() and c.isalnum() else "_"  # noqa: E731
    return "".join(keep(c) for c in text)
