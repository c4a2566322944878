"""Detection in ``products.nc``: ROC curves, areas, false alarms, scores of objects, exceedance, areas of targets.

Every entry of a dimension is named by coordinates (``roc_subject``, ``roc_detector``, ...).  Arrays of unequal
length are filled up with NaN.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hyperval.products import Products
from hyperval.report.labelled_arrays import LabelledArrays

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
