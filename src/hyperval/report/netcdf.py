"""``products.nc``: everything that both sides hold, as NetCDF-4: spectra, covariances, noise, tails, detection.

Groups ``predicted`` and ``observed``; absent sides have no group.  Spectra and curves are float64;
covariances are float32 (24 bits of mantissa) and compressed, because they are most of the file.
The covariance between bands of an SNR is left out: its standard uncertainty is there.
Two writes of the same products give the same bytes.

Arrays with the names of their axes: a group of NetCDF as it is put together, and as it is written.

xarray and pandas, which it brings, take 80 MB; a group is written without them, and becomes a dataset of xarray
where one is asked for.

Detection in ``products.nc``: ROC curves, areas, false alarms, scores of objects, exceedance, areas of targets.

Every entry of a dimension is named by coordinates (``roc_subject``, ``roc_detector``, ...).  Arrays of unequal
length are filled up with NaN.

``products.nc`` read back: what figures are drawn from, without the run that wrote it.

Uncertainties come as variances of single bands, their covariance stays in the file; of object scores, which the
file holds as quantiles, come evenly spread values of the same law between the outermost of these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5netcdf
import h5py
import numpy as np
import numpy.typing as npt

import hyperval
from hyperval.errors import InputError, reader
from hyperval.products import (
    SPECTRA,
    Abundance,
    ClassificationError,
    ExceedanceCurve,
    ObjectScores,
    ObservedProducts,
    PixelDistribution,
    PredictedProducts,
    Products,
    RocCurve,
    ScoreDistribution,
    SpectralEstimate,
)
from hyperval.spectra.axis import SpectralAxis
from hyperval.units import RADIANCE_UNIT

if TYPE_CHECKING:
    import xarray as xr


Entry = tuple[str | tuple[str, ...], Any, Mapping[str, Any]]


@dataclass
class LabelledArrays:
    """Axes, values and attributes by name.

    Attributes
    ----------
    coords : what names the places along an axis
    arrays : everything else
    """

    coords: dict[str, Entry] = field(default_factory=dict)
    arrays: dict[str, Entry] = field(default_factory=dict)

    def __setitem__(self, name: str, entry: Entry) -> None:
        self.arrays[name] = entry

    def to_xarray(self) -> xr.Dataset:
        """As a dataset of xarray."""
        import xarray as xr

        return xr.Dataset(self.arrays, self.coords)


def write_groups(path: Path, groups: Mapping[str, LabelledArrays], attributes: Mapping[str, str]) -> None:
    """Write groups and the attributes of the whole to a new NetCDF-4 file; covariances are packed as float32."""
    with h5netcdf.File(path, "w") as file:
        file.attrs.update(attributes)
        for name, content in groups.items():
            _write(file.create_group(name), content)


def _write(group: Any, content: LabelledArrays) -> None:
    placed: set[str] = set()
    for name, (dims, values, attributes) in (content.coords | content.arrays).items():
        axes = (dims,) if isinstance(dims, str) else tuple(dims)
        array = np.asarray(values)
        for axis, size in zip(axes, array.shape, strict=True):
            if axis not in group.dimensions:
                group.dimensions[axis] = size
        options: dict[str, Any] = {}
        if array.dtype.kind == "O":
            options["dtype"] = h5py.string_dtype()
        elif array.dtype.kind == "f" and name not in content.coords:
            options["fillvalue"] = np.float32(np.nan) if _packed(name) else np.nan
        if _packed(name):
            array = array.astype(np.float32)
            options |= {"compression": "gzip", "compression_opts": 4, "shuffle": True}
        variable = group.create_variable(name, axes, data=array, **{"dtype": array.dtype, **options})
        variable.attrs.update(attributes)
        if name in content.arrays:
            beside = [c for c in content.coords if c not in axes and {*_axes(content.coords[c])} <= {*axes}]
            placed |= {*beside, *axes}
            if beside:
                variable.attrs["coordinates"] = " ".join(beside)
    left = [name for name in content.coords if name not in placed]
    if left:
        group.attrs["coordinates"] = " ".join(left)


def _axes(entry: Entry) -> tuple[str, ...]:
    return (entry[0],) if isinstance(entry[0], str) else tuple(entry[0])


def _packed(name: str) -> bool:
    return name.endswith("_covariance")


# A predicted object score is a law; its quantiles say what its draws do.
OBJECT_QUANTILES = (0.001, 0.005, 0.01, 0.025, 0.05, *np.round(np.arange(0.1, 0.95, 0.1), 1).tolist(),
                    0.95, 0.975, 0.99, 0.995, 0.999)  # fmt: skip

_PART = {
    "subject": "what is looked for or seen",
    "detector": "detector",
    "unit": "what is counted: pixels or objects",
    "classes": "classes told apart",
    "features": "features of the classifier",
}
_ROC = (
    ("pfa", "probability of false alarm"),
    ("pd", "probability of detection"),
    ("pd_lower", "lower 95 % limit of the probability of detection"),
    ("pd_upper", "upper 95 % limit of the probability of detection"),
    ("threshold", "detector score at the point"),
    ("preset_pfa", "greatest false-alarm probability of any one background class at the threshold"),
    ("alarms", "background samples above the threshold"),
)
_ROC_COUNTS = (
    ("n_target", "1", "targets counted: pixels or objects"),
    ("n_background", "1", "background pixels"),
    ("background_area_km2", "km2", "ground area of the background pixels"),
)
_FIRST = ("alarms_before_first", "1", "background pixels declared before the first pixel of any target")
_ALARMS = (
    ("pd", "probability of detection that is reached"),
    ("threshold", "highest detector score at which it is reached"),
    ("alarms", "background samples declared at the threshold"),
    ("pfa", "probability of false alarm"),
    ("pfa_lower", "lower 95 % limit, background and targets both sampled"),
    ("pfa_upper", "upper 95 % limit, background and targets both sampled"),
    ("fixed_lower", "lower 95 % limit at this threshold as it stands"),
    ("fixed_upper", "upper 95 % limit at this threshold as it stands"),
)
_SCORE = (
    ("mean", "1", "mean detector score"),
    ("sd", "1", "standard deviation of the detector score"),
    ("n", "1", "pixels behind the moments; NaN for a prediction"),
    ("mean_error", "1", "standard error of the mean score; NaN where the filter was made of other pixels"),
    ("mean_bias", "1", "expected mean score less that of endless pixels; NaN where the filter was made of others"),
)
_ABUNDANCE = (
    ("area_m2", "m2", "area of the target from its scores or fractions"),
    ("standard_uncertainty", "m2", "standard uncertainty of the area"),
    ("nominal_m2", "m2", "area that the truth states"),
    ("n", "1", "pixels summed"),
)


def add_detection(data: LabelledArrays, products: Products) -> None:
    """Everything about scores, detection and false alarms of one side."""
    _add_roc(data, products)
    entries = [(key, range_, area) for key, c in products.roc.items() for range_, area in c.areas.items()]
    if entries:
        dim = _name_entries(data, "roc_area", [k for k, _, _ in entries], ("subject", "detector", "unit"))
        ranges = _text([range_ for _, range_, _ in entries])
        data.coords["roc_area_range"] = (dim, ranges, {"long_name": "which area, and its range of P_FA"})
        _add_each(data, "roc_area", dim, [a for _, _, a in entries], (
            ("value", "1", "mean probability of detection over the range of P_FA"),
            ("lower", "1", "lower 95 % limit of the mean probability of detection"),
            ("upper", "1", "upper 95 % limit of the mean probability of detection"),
        ))  # fmt: skip
    alarms = [(key, at) for key, curve in products.roc.items() for at in curve.at_detection]
    if alarms:
        dim = _name_entries(data, "roc_alarm", [k for k, _ in alarms], ("subject", "detector", "unit"))
        _add_each(data, "roc_alarm", dim, [at for _, at in alarms], [(name, "1", text) for name, text in _ALARMS])
    _add_scores(data, products)
    _add_object_scores(data, products)
    _add_exceedance(data, products)
    add_entries(data, "abundance", products.abundance, _ABUNDANCE)


def add_entries(
    data: LabelledArrays,
    name: str,
    entries: Mapping[Any, Any],
    attributes: Sequence[tuple[str, str, str]],
    parts: Sequence[str] = ("subject", "detector"),
) -> None:
    """Numbers of each of ``held`` along ``<name>_entry``.

    Parameters
    ----------
    held : by keys that are tuples of ``parts``
    attributes : (name, unit, long name) of each number
    """
    if entries:
        _add_each(data, name, _name_entries(data, name, list(entries), parts), list(entries.values()), attributes)


def ragged(rows: Sequence[Any], length: int = 0) -> Any:
    """(rows, longest or ``length``) the arrays below each other, NaN where one is None or has ended."""
    arrays = [np.empty(0) if row is None else np.asarray(row, dtype=float).ravel() for row in rows]
    out = np.full((len(arrays), max([length, *(a.size for a in arrays)])), np.nan)
    for line, array in zip(out, arrays, strict=True):
        line[: array.size] = array
    return out


def _add_roc(data: LabelledArrays, products: Products) -> None:
    if not products.roc:
        return
    curves = list(products.roc.values())
    dim = _name_entries(data, "roc", list(products.roc), ("subject", "detector", "unit"), "roc_curve")
    points = max(curve.pfa.size for curve in curves)
    for name, text in _ROC:
        values = [getattr(curve, name) for curve in curves]
        if any(v is not None for v in values):
            data[f"roc_{name}"] = ((dim, "roc_point"), ragged(values, points), {"units": "1", "long_name": text})
    counted = any(curve.alarms_before_first is not None for curve in curves)
    _add_each(data, "roc", dim, curves, (*_ROC_COUNTS, _FIRST) if counted else _ROC_COUNTS)


def _add_scores(data: LabelledArrays, products: Products) -> None:
    add_entries(data, "score", products.scores, _SCORE)
    scores = list(products.scores.values())
    if any(score.grid is not None for score in scores):
        for name, text in (("grid", "detector score"), ("density", "probability density per unit of score")):
            values = ragged([getattr(score, name) for score in scores])
            data[f"score_{name}"] = (("score_entry", "score_point"), values, {"units": "1", "long_name": text})
    if any(score.greatest is not None for score in scores):
        values = ragged([score.greatest for score in scores])
        text = "greatest scores of measured pixels, falling"
        data["score_greatest"] = (("score_entry", "score_rank"), values, {"units": "1", "long_name": text})


def _add_object_scores(data: LabelledArrays, products: Products) -> None:
    """Measured: one score for each object; predicted: quantiles of the law of an object's score."""
    measured = {key: scores for key, scores in products.object_scores.items() if np.ndim(scores.values) == 1}
    predicted = {key: scores for key, scores in products.object_scores.items() if np.ndim(scores.values) == 2}
    text = "greatest score over the pixels of an object"
    if measured:
        each = [(key, scores.names[i] if i < len(scores.names) else "", float(value))
                for key, scores in measured.items() for i, value in enumerate(scores.values)]  # fmt: skip
        dim = _name_entries(data, "object_score", [key for key, _, _ in each], ("subject", "detector"))
        data.coords["object_score_name"] = (dim, _text([n for _, n, _ in each]), {"long_name": "object"})
        data["object_score"] = (dim, np.array([v for *_, v in each]), {"units": "1", "long_name": text})
    if predicted:
        dim = _name_entries(data, "object_score_law", list(predicted), ("subject", "detector"))
        lower = "object_score_probability"
        attributes = {"units": "1", "long_name": "probability of a lower score"}
        data.coords[lower] = (lower, np.array(OBJECT_QUANTILES), attributes)
        values = np.stack([np.quantile(scores.values, OBJECT_QUANTILES) for scores in predicted.values()])
        attributes = {"units": "1", "long_name": f"quantile of the {text}"}
        data["object_score_quantile"] = ((dim, lower), values, attributes)


def _add_exceedance(data: LabelledArrays, products: Products) -> None:
    if not products.exceedance:
        return
    dim = _name_entries(data, "exceedance", list(products.exceedance), ("subject", "detector"))
    curves = list(products.exceedance.values())
    half = ("half_image", "factor by which one half of the image misses the share of the other")
    for name, text in (
        *((half,) if all(c.half_image is not None for c in curves) else ()),
        ("threshold", "detector score"),
        ("probability", "part of the background above the score"),
        ("lower", "lower 95 % limit of the part of the background above the score"),
        ("upper", "upper 95 % limit of the part of the background above the score"),
    ):
        values = ragged([getattr(curve, name) for curve in curves])
        data[f"exceedance_{name}"] = ((dim, "exceedance_point"), values, {"units": "1", "long_name": text})
    _add_each(data, "exceedance", dim, curves, [("n", "1", "background pixels; NaN for a prediction")])


def _name_entries(
    data: LabelledArrays, name: str, keys: Sequence[Any], parts: Sequence[str], dim: str | None = None
) -> str:
    dim = dim or f"{name}_entry"
    for i, part in enumerate(parts):
        data.coords[f"{name}_{part}"] = (dim, _text([key[i] for key in keys]), {"long_name": _PART[part]})
    return dim


def _add_each(
    data: LabelledArrays, name: str, dim: str, items: Sequence[Any], attributes: Sequence[tuple[str, str, str]]
) -> None:
    for attribute, unit, text in attributes:
        values = [getattr(item, attribute) for item in items]
        numbers = np.array([np.nan if value is None else value for value in values], dtype=float)
        data[f"{name}_{attribute}"] = (dim, numbers, {"units": unit, "long_name": text})


def _text(names: Sequence[str]) -> Any:
    return np.array([str(name) for name in names], dtype=object)


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
    if isinstance(products, PredictedProducts):
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
        add(f"_uncertainty_from_{_identifier(source)}", ("band",), part, unit, f"standard uncertainty from {source}")
    if with_covariance:
        square = ("band", "band_2")
        error = np.stack([np.asarray(e.error_covariance, dtype=np.float32) for e in each])
        add("_error_covariance", square, error, squared, f"covariance of the error of {name}")
        if any(e.pixel_covariance is not None for e in each):
            nothing = np.full(error.shape[1:], np.nan, dtype=np.float32)
            spread = [nothing if (c := e.pixel_covariance) is None else c.astype(np.float32) for e in each]
            add("_pixel_covariance", square, np.stack(spread), squared, f"covariance of {name} from pixel to pixel")


def _add_noise(data: LabelledArrays, prediction: PredictedProducts) -> None:
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


Array = npt.NDArray[np.float64]
_FROM = "_uncertainty_from_"
_LAW_VALUES = 1000  # that stand for a law of object scores
_WHOLE = ("dimension", "leading_dimension", "n", "samples")  # of a distribution of pixels
_CURVES = {"distance", "exceedance", "effective_n"}


@reader
def read_products(path: Path) -> tuple[PredictedProducts | None, ObservedProducts | None]:
    """Both sides of a run; None for one that was not run.

    Raises
    ------
    InputError : no such file, or one that is not of this kind.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", where=str(path), expected="products.nc of a finished run")
    import xarray as xr

    sides: list[Any] = []
    try:
        tree = xr.open_groups(path, engine="h5netcdf")
        for group, kind in (("/predicted", PredictedProducts), ("/observed", ObservedProducts)):
            sides.append(kind(**_content(tree[group])) if group in tree else None)
        for data in tree.values():
            data.close()
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"cannot be read: {error}", where=str(path), expected="products.nc of a run") from error
    return sides[0], sides[1]


def _content(data: xr.Dataset) -> dict[str, Any]:
    axis = SpectralAxis(
        data["wavelength"].to_numpy(), data["fwhm"].to_numpy(), data["good_band"].to_numpy().astype(bool)
    )
    content: dict[str, Any] = {name: dict(_spectra(data, name)) for name in SPECTRA}
    content["roc"] = dict(_entries(data, "roc", ("subject", "detector", "unit"), _roc))
    content["scores"] = dict(
        _entries(
            data,
            "score",
            ("subject", "detector"),
            lambda e: ScoreDistribution(
                e["mean"], e["sd"], _count(e["n"]), None, None, _trimmed(e["greatest"])[0] if "greatest" in e else None,
                e.get("mean_error", np.nan), e.get("mean_bias", np.nan),
            ),
        )
    )  # fmt: skip
    content["object_scores"] = _object_scores(data)
    content["abundance"] = dict(
        _entries(data, "abundance", ("subject", "detector"), lambda e: Abundance(
            e["area_m2"], e["standard_uncertainty"], _count(e["n"]), _known(e["nominal_m2"])))
    )  # fmt: skip
    content["exceedance"] = dict(
        _entries(data, "exceedance", ("subject", "detector"), _exceedance)
    )  # fmt: skip
    content["classification"] = dict(
        _entries(data, "classification", ("classes", "features"), lambda e: ClassificationError(
            **{k: v for k, v in e.items() if k not in ("n", "effective_n", "key")},
            n=_count(e["n"]), effective_n=_known(e["effective_n"])))
    )  # fmt: skip
    content["distribution"] = {
        subject: law for (subject,), law in _entries(data, "distribution", ("subject",), _distribution)
    }
    return {"axis": axis, **content}


def _distribution(entry: Mapping[str, Any]) -> PixelDistribution:
    own: dict[str, Any] = {name: value for name, value in entry.items() if name != "key"}
    own |= {name: _count(entry[name]) for name in _WHOLE}
    for name in own.keys() & _CURVES:
        (values,) = _trimmed(entry[name])
        own[name] = values if values.size else None
    return PixelDistribution(**own)


def _spectra(data: xr.Dataset, name: str) -> Iterator[tuple[str, SpectralEstimate]]:
    if name not in data:
        return
    sources = {str(v).partition(_FROM)[2]: data[v] for v in data.data_vars if str(v).startswith(f"{name}{_FROM}")}
    pixel = data.get(f"{name}_pixel_covariance")
    for i, subject in enumerate(data[f"{name}_subject"].to_numpy()):
        spread = None if pixel is None else pixel[i].to_numpy().astype(float)
        budget = {source.replace("_", " "): v[i].to_numpy() for source, v in sources.items()}
        yield (
            str(subject),
            SpectralEstimate(
                data[name][i].to_numpy(),
                np.diag(data[f"{name}_standard_uncertainty"][i].to_numpy() ** 2),
                None if spread is None or np.isnan(spread).all() else spread,
                _count(float(data[f"{name}_n"][i])),
                {source: np.nan_to_num(u) for source, u in budget.items() if not np.isnan(u).all()},
            ),
        )


def _entries(
    data: xr.Dataset, name: str, parts: tuple[str, ...], make: Callable[[Mapping[str, Any]], Any]
) -> Iterator[tuple[Any, Any]]:
    """(key, entry) of each entry along the dimension of its names."""
    first = f"{name}_{parts[0]}"
    if first not in data.coords:
        return
    (dim,) = data[first].dims
    columns = {
        str(v).removeprefix(f"{name}_"): data[v].to_numpy() for v in data.data_vars if data[v].dims[:1] == (dim,)
    }
    names = [data[f"{name}_{part}"].to_numpy() for part in parts]
    for i in range(data.sizes[dim]):
        entry = {k: v[i] if v.ndim > 1 else float(v[i]) for k, v in columns.items()}
        yield tuple(str(values[i]) for values in names), make({**entry, "key": tuple(str(v[i]) for v in names)})


def _object_scores(data: xr.Dataset) -> dict[tuple[str, str], ObjectScores]:
    """Scores of the measured objects, or the law of those of a predicted one."""
    if "object_score_quantile" in data:
        at = (np.arange(_LAW_VALUES) + 0.5) / _LAW_VALUES
        known = data["object_score_probability"].to_numpy()
        laws = (data[f"object_score_law_{part}"].to_numpy() for part in ("subject", "detector"))
        return {
            (str(subject), str(detector)): ObjectScores(np.interp(at, known, quantiles)[None])
            for subject, detector, quantiles in zip(*laws, data["object_score_quantile"].to_numpy(), strict=True)
        }
    if "object_score" not in data:
        return {}
    names = (data[f"object_score_{part}"].to_numpy() for part in ("subject", "detector", "name"))
    out: dict[tuple[str, str], list[tuple[str, float]]] = {}
    for subject, detector, name, value in zip(*names, data["object_score"].to_numpy(), strict=True):
        out.setdefault((str(subject), str(detector)), []).append((str(name), float(value)))
    return {key: ObjectScores(np.array([v for _, v in own]), tuple(n for n, _ in own)) for key, own in out.items()}


def _roc(entry: Mapping[str, Any]) -> RocCurve:
    names = ("pfa", "pd", "pd_lower", "pd_upper", "threshold")
    pfa, pd, lower, upper, threshold = _trimmed(*(entry[k] for k in names))
    return RocCurve(
        pfa, pd, lower, upper, threshold, "pixel" if entry["key"][2] == "pixel" else "object",
        _count(entry["n_target"]), _count(entry["n_background"]), _known(entry["background_area_km2"]),
    )  # fmt: skip


def _exceedance(entry: Mapping[str, Any]) -> ExceedanceCurve:
    threshold, probability, lower, upper, *half = _trimmed(
        *(entry[k] for k in ("threshold", "probability", "lower", "upper", "half_image") if k in entry)
    )
    return ExceedanceCurve(threshold, probability, lower, upper, _count(entry["n"]), half[0] if half else None)


def _trimmed(*arrays: Array) -> tuple[Array, ...]:
    """Arrays without what fills them up to the longest of their kind."""
    size = int(np.flatnonzero(~np.isnan(arrays[0]))[-1]) + 1 if (~np.isnan(arrays[0])).any() else 0
    return tuple(values[:size] for values in arrays)


def _count(value: float) -> int | None:
    return None if np.isnan(value) else round(value)


def _known(value: float) -> float | None:
    return None if np.isnan(value) else float(value)
