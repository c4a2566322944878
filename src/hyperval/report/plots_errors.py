"""Plots of what the spread of pixels does to a user: classes taken for each other, areas of targets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from hyperval.products import ClassificationError
from hyperval.report.plots import (
    COVERAGE,
    GREY,
    Axis,
    Mark,
    Part,
    Plots,
    View,
    both_sides,
    measured_mark,
    predicted_mark,
    rows_axis,
)
from hyperval.report.sides import Sides, both_first, of_side
from hyperval.report.style import left_out
from hyperval.results import Result

_MOST_ROWS = 40
_Key = tuple[str, str]


def class_error_plots(sides: Sides) -> list[Plots]:
    """Classification error of every set of classes and features, both sides, with the bounds from distances."""
    predicted, measured = (of_side(side, "classification") for side in sides)
    every = list(dict.fromkeys([*measured, *predicted]))
    keys = every[:_MOST_ROWS]
    if not keys:
        return []
    floor = _error_floor([*predicted.values(), *measured.values()])
    bounded = [
        (at, predicted[key]) for at, key in enumerate(keys) if key in predicted and predicted[key].bound_upper > 0
    ]
    marks = []
    if bounded:
        at = np.array([i for i, _ in bounded], float)
        low, high, middle = (
            np.maximum([getattr(e, name) for _, e in bounded], floor)
            for name in ("bound_lower", "bound_upper", "approximation")
        )
        columns = {"left": low, "right": high, "bottom": at - 0.31, "top": at + 0.31, "y": at}
        marks = [
            Mark("bars", columns, "bounds from the predicted distance"),
            Mark("dots", {"x": middle, "y": at}, "estimate from it", marker="tick"),
        ]

    def dots(own: Mapping[_Key, ClassificationError], shift: float) -> tuple[dict[str, Any], list[str]]:
        some = [(i + shift, own[key], key) for i, key in enumerate(keys) if key in own]
        columns = {name: np.maximum([getattr(e, error) for _, e, _ in some], floor)
                   for name, error in (("x", "error"), ("low", "lower"), ("high", "upper"))}  # fmt: skip
        return {"y": np.array([i for i, *_ in some]), **columns}, [
            f"{', '.join(k)}: {_error_words(e)}" for _, e, k in some
        ]

    title = f"Error of a Gaussian maximum-likelihood classifier{left_out([keys], every)}"
    words = _in_words(keys, predicted, measured, _error_words)
    x = Axis("probability of error [1]", "log", ends=(floor / 1.4, 1.0))
    rows = rows_axis([", ".join(key) for key in keys])
    view = View(x, (Part(rows, (*marks, *both_sides(predicted, measured, dots))),))
    legend = f"bar: 95 % interval; an error below {floor:.0e} is drawn there"
    return [Plots("class-error", "classification", title, f"{title}: {words}.", {"": view}, legend)]


def unmixing_plots(sides: Sides, rows: Sequence[Result]) -> list[Plots]:
    """Areas by unmixing against the nominal ones, and the root mean square error by size, by method."""
    predicted, measured = ({k: a for k, a in of_side(side, "abundance").items() if a.nominal_m2} for side in sides)
    methods = list(dict.fromkeys(method for _, method in measured))[:4]
    views, words = {}, []
    for method in methods:
        groups: dict[float, list[_Key]] = {}
        for key, area in measured.items():
            if key[1] == method:
                groups.setdefault(area.nominal_m2, []).append(key)
        # Side by side within a quarter of a decade, in the order of the targets.
        place: dict[_Key, float] = {}
        for nominal, keys in groups.items():
            steps = np.linspace(-0.13, 0.13, len(keys)) if len(keys) > 1 else np.zeros(1)
            place |= {key: nominal * 10**step for key, step in zip(keys, steps, strict=True)}
        areas, errors = [], []
        for side, own, mark, marker, shift in (
            ("predicted", predicted, predicted_mark, "circle", 0.97),
            ("measured", measured, measured_mark, "square", 1.03),
        ):  # fmt: skip
            each = [(key, own[key]) for key in place if key in own]
            ratio = np.array([a.area_m2 / a.nominal_m2 for _, a in each])
            half = np.nan_to_num([COVERAGE * a.standard_uncertainty / a.nominal_m2 for _, a in each])
            columns = {
                "x": np.array([place[key] * shift for key, _ in each]),
                "y": ratio,
                "low": ratio - half,
                "high": ratio + half,
            }
            areas.append(
                mark(
                    "dots", columns, marker=marker, words=tuple(f"{key[0]}, {a.nominal_m2:g} m²" for key, a in each)
                )
            )
            metric = f"area_rmse_{'observed' if side == 'measured' else side}"
            points = sorted((_size_of(r.subject), r.value, r.lower, r.upper)
                            for r in rows if r.method == method and r.metric == metric)  # fmt: skip
            columns = dict(zip(("x", "y", "low", "high"), np.array(points).reshape(-1, 4).T, strict=True))
            errors.append(mark("line", columns, "", marker=marker))
            if points:
                words.append(f"{method}, {side}: " + ", ".join(f"{v:.2g} m² at {a:g} m²" for a, v, *_ in points))
        sizes = np.array(sorted(groups))
        errors.append(Mark("line", {"x": sizes, "y": sizes}, "as large as the target", GREY))
        x = Axis("nominal area [m²]", "log", ends=(sizes[0] / 1.8, sizes[-1] * 1.8))
        ratio_axis = Axis("estimated / nominal area [1]", ends=(-0.6, 4.2))
        views[method] = View(x, (
            Part(ratio_axis, tuple(areas), (("y", 1.0),)),
            Part(Axis("rms error [m²]", "log"), tuple(errors)),
        ))  # fmt: skip
    if not views:
        return []
    return [Plots(
        "unmixing-areas", "abundance", "Target areas by unmixing against nominal areas, and their error by size",
        "Area of each target by fully constrained unmixing over its nominal area, predicted and measured with 95 % "
        f"intervals, against the nominal area; below, root mean square error by nominal area. {'; '.join(words)}.",
        views,
    )]  # fmt: skip


def abundance_plots(sides: Sides) -> list[Plots]:
    """Area of each target from its abundance, predicted and measured."""
    # Areas that both sides estimate against a nominal one have a plot of their own.
    predicted, measured = (
        {k: a for k, a in of_side(side, "abundance").items() if a.nominal_m2 is None} for side in sides
    )
    every = both_first(predicted, measured)
    areas = np.array([own[k].area_m2 for own in (predicted, measured) for k in every[:_MOST_ROWS] if k in own])
    areas = areas[np.isfinite(areas)]
    scattered = areas.size > 0 and areas.min() > 0 and areas.max() > 30 * areas.min()
    x = Axis("area [m²]", "log", ends=(areas.min() / 4, areas.max() * 2.5)) if scattered else Axis("area [m²]")
    return row_plots(
        "abundance", "abundance", "Target area from the sum of abundances", (predicted, measured), x,
        lambda area: (area.area_m2, COVERAGE * area.standard_uncertainty), "m²",
        () if scattered else (0.0,), "bar: 95 % interval",
    )  # fmt: skip


def score_plots(sides: Sides) -> list[Plots]:
    """Mean and 95 % range of each population's score."""
    predicted, measured = (of_side(side, "scores") for side in sides)
    return row_plots(
        "scores", "scores", "Score distributions", (predicted, measured),
        Axis("score [1]"), lambda score: (score.mean, COVERAGE * score.sd),
        "", (0.0, 1.0), "dot: mean; bar: mean ± 1.96 standard deviations",
    )  # fmt: skip


def row_plots(
    name: str, section: str, title: str, both: tuple[Mapping[Any, Any], Mapping[Any, Any]], x: Axis,
    dot: Callable[[Any], tuple[float, float]], unit: str, rules: tuple[float, ...], legend: str = "",
) -> list[Plots]:  # fmt: skip
    """A row for each key of either side: its value and the half-width of its interval."""
    every = both_first(*both)
    keys = every[:_MOST_ROWS]
    if not keys:
        return []

    def words(entry: Any) -> str:
        value, half = dot(entry)
        count = f", n = {entry.n:,}".replace(",", "\u202f").replace("\u202f n", ", n") if entry.n else ""
        return f"{value:.3g} ± {half:.2g} {unit}".rstrip() + count

    def dots(own: Mapping[Any, Any], shift: float) -> tuple[dict[str, Any], list[str]]:
        some = [(i + shift, key) for i, key in enumerate(keys) if key in own]
        value, half = np.array([dot(own[key]) for _, key in some]).reshape(-1, 2).T
        half = np.nan_to_num(half)
        columns = {"x": value, "y": np.array([i for i, _ in some]), "low": value - half, "high": value + half}
        return columns, [f"{', '.join(key)}: {words(own[key])}" for _, key in some]

    sides = " and ".join(word for word, own in zip(("predicted", "measured"), both, strict=True) if own)
    marks = both_sides(*both, dots)
    view = View(x, (Part(rows_axis([", ".join(key) for key in keys]), marks, tuple(("x", at) for at in rules)),))
    caption = f"{title}: {sides}{left_out([keys], every)}"
    return [Plots(name, section, caption, f"{title}. {_in_words(keys, *both, words)}.", {"": view}, legend)]


def _in_words(keys: Sequence[Any], predicted: Any, measured: Any, text: Callable[[Any], str]) -> str:
    sides = (("predicted", predicted), ("measured", measured))
    return "; ".join(
        f"{', '.join(key)}: " + ", ".join(f"{name} {text(side[key])}" for name, side in sides if key in side)
        for key in keys
    )


def _error_floor(errors: Sequence[ClassificationError]) -> float:
    """Left end of the axis: below every error that was measured or predicted, and not below a millionth."""
    values = [x for e in errors for x in (e.error, e.lower) if x > 0]
    return max(min([1e-2, *values]) / 2.0, 1e-6)


def _error_words(e: ClassificationError) -> str:
    return f"{e.error:.2g} ({e.lower:.1g} to {e.upper:.1g})"


def _size_of(subject: str) -> float:
    """The area in "all targets of 9 m2"."""
    return float(subject.removesuffix(" m2").rpartition(" ")[2])
