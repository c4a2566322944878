"""``products.nc`` read back: what figures are drawn from, without the run that wrote it.

Uncertainties come as variances of single bands, their covariance stays in the file; of object scores, which the
file holds as quantiles, come evenly spread values of the same law between the outermost of these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from hyperval.errors import InputError, reader
from hyperval.products import (
    SPECTRA,
    Abundance,
    ClassificationError,
    ExceedanceCurve,
    ObjectScores,
    Observation,
    PixelDistribution,
    Prediction,
    RocCurve,
    ScoreDistribution,
    SpectralEstimate,
)
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
_FROM = "_uncertainty_from_"
_LAW_VALUES = 1000  # that stand for a law of object scores
_WHOLE = ("dimension", "leading_dimension", "n", "samples")  # of a distribution of pixels
_CURVES = {"distance", "exceedance", "effective_n"}


@reader
def read_products(path: Path) -> tuple[Prediction | None, Observation | None]:
    """Both sides of a run; None for one that was not run.

    Raises
    ------
    InputError : no such file, or one that is not of this kind.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", where=str(path), expected="products.nc of a finished run")
    sides: list[Any] = []
    try:
        tree = xr.open_groups(path, engine="h5netcdf")
        for group, kind in (("/predicted", Prediction), ("/observed", Observation)):
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
                e["mean"], e["sd"], _count(e["n"]), greatest=_trimmed(e["greatest"])[0] if "greatest" in e else None
            ),
        )
    )
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
