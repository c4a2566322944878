"""Detection: ROC curves and their differences, scores of populations and of single objects, areas of targets."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import betaincinv

from hyperval.figures.sides import Array, ScoreMap, Sides, both_first, drawn_of, of_side
from hyperval.figures.spec import (
    COVERAGE,
    CURVES,
    DIFFERENCE,
    GREY,
    MAX_PANELS,
    MEASURED,
    PREDICTED,
    SIDES,
    Axis,
    ColourScale,
    Figure,
    Mark,
    Panels,
    Part,
    Rules,
    count_text,
    in_words,
    left_out,
    measured_mark,
    predicted_mark,
    row_marks,
    row_names,
)
from hyperval.model.roc import detection_at
from hyperval.products import ExceedanceCurve, ObjectScores, Products, RocCurve, ScoreDistribution
from hyperval.results import Result

MOST_CURVES = 24
MANY_OBJECTS = 40  # of fewer, each has its place in a list
_MOST_ROWS = 40
_MOST_POINTS = 200
_MOST_POPULATIONS = 12
_SPAN = 5.0  # standard deviations about the mean, where a density is not stated
_DEEPEST = 1e-8  # part of the greatest density
_BINS = 24
_MOST_MAPS = 6
_PFA = "P_FA per pixel"
Key = tuple[str, str, str]


def roc_figure(sides: Sides, names: tuple[str, str] = SIDES) -> Figure | None:
    """P_D against P_FA on a logarithmic axis, a view for each subject, a tab for each detector and unit."""
    predicted, measured, drawn, _ = drawn_of(sides, "roc")
    kinds = list(dict.fromkeys(key[1:] for key in drawn))
    if not kinds:
        return None
    views, words = [], []
    for detector, unit in kinds:
        keys = [key for key in drawn if key[1:] == (detector, unit)]
        keys = best_counted(keys, measured, MOST_CURVES // len(kinds) or 1)
        low = _lowest_pfa([c[key] for c in (predicted, measured) for key in keys if key in c], measured)
        for key in keys:
            views.append(_roc_view(key, predicted.get(key), measured.get(key), low, names))
            words.append(_roc_words(key, predicted.get(key), measured.get(key), names))
    counted = any(curve.n_background for curve in measured.values())
    second = f" (dashed) and {names[1]}" if measured else ""
    head = f"ROC: {names[0]}{second}{' (dotted: 1 / background pixels)' if counted else ''}"
    return Figure(
        "roc", "roc", head + left_out(len(views), len({*predicted, *measured})),
        f"Probability of detection against probability of false alarm (logarithmic), {names[0]} (dashed) and "
        f"{names[1]}, with 95 % intervals. {' '.join(words)}",
        tuple(views), head=head, together="first",
    )  # fmt: skip


def best_counted(keys: list[Any], measured: Mapping[Any, RocCurve], most: int) -> list[Any]:
    """``keys``, of too many those ``most`` with the most targets (pools of targets among them)."""
    if len(keys) <= most:
        return keys

    def count(key: Any) -> int:
        return (measured[key].n_target or 0) if key in measured else -1

    chosen = set(sorted(keys, key=lambda key: -count(key))[:most])
    return [key for key in keys if key in chosen]


def _roc_view(
    key: Key, predicted: RocCurve | None, measured: RocCurve | None, low: float, names: tuple[str, str]
) -> Panels:
    # Steps are counted pixels; the second of two predictions is as smooth as the first.
    kind = "steps" if names[1] == SIDES[1] else "line"
    marks = [
        make(own_kind, _curve_columns(curve, low), name)
        for make, own_kind, curve, name in (
            (predicted_mark, "line", predicted, names[0]), (measured_mark, kind, measured, names[1])
        )
        if curve is not None
    ]  # fmt: skip
    note = []
    if measured is not None and measured.n_target is not None:
        note.append(f"{count_text(measured.n_target)} {measured.unit}{'s' if measured.n_target != 1 else ''}")
    if measured is not None and measured.n_background is not None:
        note.append(f"{count_text(measured.n_background)} background px")
    rules: Rules = (("x", 1.0 / measured.n_background),) if measured and measured.n_background else ()
    part = Part(Axis("P_D", ends=(-0.02, 1.04)), tuple(marks), rules)
    return Panels(Axis(_PFA, "log", ends=(low, 1.0)), (part,), key[0], f"{key[1]}, by {key[2]}", ", ".join(note))


def _roc_words(key: Key, predicted: RocCurve | None, measured: RocCurve | None, names: tuple[str, str]) -> str:
    words = []
    for name, curve in zip(names, (predicted, measured), strict=True):
        if curve is not None and curve.pfa.size:
            at = float(np.clip(1e-3, curve.pfa[0], curve.pfa[-1]))
            pd, low, high = (detection_at(curve, at, y) for y in (curve.pd, curve.pd_lower, curve.pd_upper))
            words.append(f"{name} P_D {pd:.2f} ({low:.2f} to {high:.2f}) at P_FA {at:.1e}")
    return f"{', '.join(key)}: {'; '.join(words) or 'no points'}."


def _lowest_pfa(curves: Sequence[RocCurve], measured: Mapping[Any, RocCurve]) -> float:
    """The least P_FA that curves are drawn at: two decades past what the background can resolve are enough."""
    lowest = min((float(c.pfa[c.pfa > 0].min()) for c in curves if (c.pfa > 0).any()), default=1e-3)
    return max(lowest, min((1.0 / c.n_background / 100.0 for c in measured.values() if c.n_background), default=0.0))


def _curve_columns(curve: RocCurve, low: float) -> dict[str, Array]:
    """At most a few hundred points of a curve, evenly spread over the logarithm of P_FA."""
    keep = np.flatnonzero(curve.pfa >= low)
    if keep.size > _MOST_POINTS:
        wanted = np.geomspace(curve.pfa[keep[0]], curve.pfa[keep[-1]], _MOST_POINTS)
        keep = np.unique(np.clip(np.searchsorted(curve.pfa, wanted), keep[0], keep[-1]))
    columns = {"x": curve.pfa, "y": curve.pd, "low": curve.pd_lower, "high": curve.pd_upper}
    return {name: values[keep] for name, values in columns.items()}


def roc_difference_figure(sides: Sides, margin: float | None) -> Figure | None:
    """Predicted minus measured P_D against P_FA with its 95 % interval, for the curves with the most targets."""
    predicted, measured = (of_side(side, "roc") for side in sides)
    every = [key for key in both_first(predicted, measured) if key in predicted and key in measured]
    # Objects are independent and pixels of one object are not: curves by object first, where there are several.
    every.sort(
        key=lambda key: (key[2] != "object" or (measured[key].n_target or 0) < 2, -(measured[key].n_target or 0))
    )
    views, words = [], []
    for key in every[:MAX_PANELS]:
        view, text = _difference(f"{key[0]}, {key[1]}, by {key[2]}", predicted[key], measured[key], margin)
        views.append(view)
        words.append(f"{', '.join(key)}: {text}.")
    if not views:
        return None
    return Figure(
        "roc-difference", "roc", f"ROC: predicted minus measured P_D{left_out(len(views), len(every))}",
        f"Predicted minus measured probability of detection. {' '.join(words)}", tuple(views),
        "" if margin is None else f"dotted: equivalence margin {margin:g}",
    )  # fmt: skip


def _difference(name: str, predicted: RocCurve, measured: RocCurve, margin: float | None) -> tuple[Panels, str]:
    low = max(float(predicted.pfa[0]), float(measured.pfa[measured.pfa > 0].min()), 1e-9)
    if measured.n_background:
        low = max(low, 3.0 / measured.n_background)
    x = np.geomspace(low, min(float(predicted.pfa[-1]), float(measured.pfa[-1])), 120)
    (p, p_low, p_high), (o, o_low, o_high) = (
        [detection_at(c, np.clip(x, c.pfa[0], c.pfa[-1]), y) for y in (c.pd, c.pd_lower, c.pd_upper)]
        for c in (predicted, measured)
    )
    difference = p - o
    below = difference - np.hypot(p - p_low, o_high - o)
    above = difference + np.hypot(p_high - p, o - o_low)
    at = int(np.argmin(np.abs(np.log(x) - math.log(1e-2))))
    words = f"{difference[at]:+.2f} ({below[at]:+.2f} to {above[at]:+.2f}) at P_FA {x[at]:.1e}"
    columns = {"x": x, "y": difference, "low": below, "high": above}
    line = Mark("line", columns, "predicted minus measured, 95 % interval", DIFFERENCE)
    rules: Rules = tuple(("y", place) for place in ((0.0,) if margin is None else (0.0, -margin, margin)))
    part = Part(Axis("difference of P_D", ends=(-1.05, 1.05)), (line,), rules)
    return Panels(Axis(_PFA, "log", ends=(float(x[0]), float(x[-1]))), (part,), name), words


def exceedance_figure(sides: Sides) -> Figure | None:
    """Share of background pixels above a score, predicted and measured, on a logarithmic axis."""
    predicted, measured = (of_side(side, "exceedance") for side in sides)
    every = [key for key in both_first(predicted, measured) if key in predicted]
    views, words = [], []
    for key in every[:MAX_PANELS]:
        view, text = _tail(", ".join(key), predicted[key], measured.get(key))
        views.append(view)
        words.append(f"{' '.join(key)}: {text}")
    if not views:
        return None
    legend = "measured with its 95 % interval, by blocks of the image; predicted with that of its fitted law"
    return Figure(
        "exceedance", "scores",
        f"False-alarm probability against the threshold{left_out(len(views), len(every), 'results.csv')}",
        f"Part of the background above each score, predicted (dashed) and measured. {' '.join(words)}",
        tuple(views), legend if measured else "",
    )  # fmt: skip


def _tail(name: str, predicted: ExceedanceCurve, measured: ExceedanceCurve | None) -> tuple[Panels, str]:
    floor, words, span, marks = 1e-6, "", None, []
    if measured is not None:
        keep = measured.probability > 0
        x, p = measured.threshold[keep], measured.probability[keep]
        low, high = np.nan_to_num(measured.lower[keep], nan=1e-9), np.nan_to_num(measured.upper[keep], nan=1.0)
        marks.append(measured_mark("line", _thinned({"x": x, "y": p, "low": np.maximum(low, 1e-9), "high": high})))
        floor = 0.3 * float(p.min())
        span = x[0] - 0.05 * (x[-1] - x[0]), x[-1] + 0.35 * (x[-1] - x[0])
        at = int(np.argmin(np.abs(np.log(p) - math.log(1e-2))))
        model = float(np.exp(np.interp(x[at], predicted.threshold, np.log(predicted.probability))))
        words = f"at score {x[at]:.3g} measured {p[at]:.2g}, predicted {model:.2g}."
    law = {"x": predicted.threshold, "y": predicted.probability, "low": predicted.lower, "high": predicted.upper}
    marks.append(predicted_mark("line", _thinned(law)))
    y = Axis("part of the background above", "log", ends=(floor, 1.0))
    return Panels(Axis("score", ends=span), (Part(y, tuple(marks)),), name), words


def _thinned(columns: dict[str, Any]) -> dict[str, Any]:
    """A curve of at most so many points, its ends among them."""
    size = columns["x"].size
    keep = np.unique(np.linspace(0, size - 1, _MOST_POINTS).round().astype(int)) if size > _MOST_POINTS else slice(None)
    return {name: values[keep] for name, values in columns.items()}


def score_figure(sides: Sides) -> Figure | None:
    """Mean and 95 % range of each population's score."""
    return _rows_figure(
        "scores", "scores", "Score distributions", sides, [of_side(side, "scores") for side in sides], Axis("score"),
        lambda score: (score.mean, COVERAGE * score.sd), "", (0.0, 1.0),
        "dot: mean; bar: mean ± 1.96 standard deviations",
    )  # fmt: skip


def abundance_figure(sides: Sides) -> Figure | None:
    """Area of each target from its abundance, where no nominal area is known."""
    both = [{k: a for k, a in of_side(side, "abundance").items() if a.nominal_m2 is None} for side in sides]
    areas = np.array([a.area_m2 for own in both for a in list(own.values())[:_MOST_ROWS]])
    areas = areas[np.isfinite(areas)]
    scattered = areas.size > 0 and areas.min() > 0 and areas.max() > 30 * areas.min()
    x = Axis("area [m²]", "log", ends=(areas.min() / 4, areas.max() * 2.5)) if scattered else Axis("area [m²]")
    return _rows_figure(
        "abundance", "abundance", "Target area from the sum of abundances", sides, both, x,
        lambda area: (area.area_m2, COVERAGE * area.standard_uncertainty), "m²",
        () if scattered else (0.0,), "bar: 95 % interval",
    )  # fmt: skip


def _rows_figure(
    name: str, section: str, title: str, sides: Sides, both: Sequence[Mapping[Any, Any]], x: Axis,
    dot: Callable[[Any], tuple[float, float]], unit: str, rules: tuple[float, ...], legend: str,
) -> Figure | None:  # fmt: skip
    """A row for each key of either side: its value and the half-width of its interval."""
    every = both_first(*both)
    keys = every[:_MOST_ROWS]
    if not keys:
        return None

    def words(entry: Any) -> str:
        value, half = dot(entry)
        return f"{value:.3g} ± {half:.2g} {unit}".rstrip() + (f", n = {count_text(entry.n)}" if entry.n else "")

    def columns(own: Mapping[Any, Any]) -> dict[str, Any]:
        value, half = np.array([dot(own[key]) for key in keys if key in own]).reshape(-1, 2).T
        return {"x": value, "low": value - np.nan_to_num(half), "high": value + np.nan_to_num(half)}

    marks = row_marks(keys, both, columns, words)
    names = " and ".join(word for word, own in zip(SIDES, both, strict=True) if own)
    view = Panels(x, (Part(row_names([", ".join(key) for key in keys]), marks, tuple(("x", at) for at in rules)),))
    caption = f"{title}: {names}{left_out(len(keys), len(every))}"
    return Figure(name, section, caption, f"{title}. {in_words(keys, both, words)}.", (view,), legend)


def unmixing_figure(sides: Sides, rows: Sequence[Result]) -> Figure | None:
    """Areas by unmixing against the nominal ones, and the root mean square error by size, by method."""
    predicted, measured = ({k: a for k, a in of_side(side, "abundance").items() if a.nominal_m2} for side in sides)
    views, words = [], []
    for method in list(dict.fromkeys(method for _, method in measured))[:4]:
        groups: dict[float, list[tuple[str, str]]] = {}
        for key, area in measured.items():
            if key[1] == method:
                groups.setdefault(area.nominal_m2, []).append(key)
        # Side by side within a quarter of a decade, in the order of the targets.
        place: dict[tuple[str, str], float] = {}
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
            columns = {"x": np.array([place[key] * shift for key, _ in each]), "y": ratio, "half": half}
            said = tuple(f"{key[0]}, {a.nominal_m2:g} m²" for key, a in each)
            areas.append(mark("dots", columns, marker=marker, words=said))
            metric = f"area_rmse_{'observed' if side == 'measured' else side}"
            points = sorted((_size_of(r.subject), r.value, r.lower, r.upper)
                            for r in rows if r.method == method and r.metric == metric)  # fmt: skip
            columns = dict(zip(("x", "y", "low", "high"), np.array(points).reshape(-1, 4).T, strict=True))
            errors.append(mark("line", columns, "", marker=marker))
            if points:
                words.append(f"{method}, {side}: " + ", ".join(f"{v:.2g} m² at {a:g} m²" for a, v, *_ in points))
        sizes = np.array(sorted(groups))
        errors.append(Mark("line", {"x": sizes, "y": sizes}, "as large as the target", GREY))
        views.append(Panels(Axis("nominal area [m²]", "log", ends=(sizes[0] / 1.8, sizes[-1] * 1.8)), (
            Part(Axis("estimated / nominal area", ends=(-0.6, 4.2)), tuple(areas), (("y", 1.0),)),
            Part(Axis("rms error [m²]", "log"), tuple(errors)),
        ), method))  # fmt: skip
    if not views:
        return None
    return Figure(
        "unmixing-areas", "abundance", "Target areas by unmixing against nominal areas, and their error by size",
        "Area of each target by fully constrained unmixing over its nominal area, predicted and measured with 95 % "
        f"intervals, against the nominal area; below, root mean square error by nominal area. {'; '.join(words)}.",
        tuple(views),
    )  # fmt: skip


def _size_of(subject: str) -> float:
    """The area in "all targets of 9 m2"."""
    return float(subject.removesuffix(" m2").rpartition(" ")[2])


def object_score_figure(sides: Sides) -> Figure | None:
    """Single objects: predicted 95 % interval of the score and what was measured, a row each."""
    pairs = [(key, p, float(m[0])) for key, p, m in _objects(sides) if m.size == 1]
    shown = pairs[:_MOST_ROWS]
    if not shown:
        return None
    names = [", ".join(key) for key, *_ in shown]
    at, measured = np.arange(float(len(shown))), np.array([m for *_, m in shown])
    low, middle, high = np.array([np.quantile(draws, [0.025, 0.5, 0.975]) for _, draws, _ in shown]).T
    inside = (low <= measured) & (measured <= high)
    words = [
        f"{name.replace(',', '')}: {m:.3g}, predicted {a:.3g} to {b:.3g}{'' if within else ', outside'}"
        for name, m, a, b, within in zip(names, measured, low, high, inside, strict=True)
    ]
    interval = {"left": low, "right": high, "bottom": at - 0.2, "top": at + 0.2}
    marks = [
        Mark("bars", interval, "predicted 95 %", PREDICTED, alpha=0.3, words=tuple(words)),
        Mark("dots", {"x": middle, "y": at}, "predicted median", PREDICTED, marker="tick", along="x"),
    ]
    for own, label in ((inside, "measured"), (~inside, "measured, outside")):
        if own.any():
            said = tuple(text for text, one in zip(words, own, strict=True) if one)
            columns = {"x": measured[own], "y": at[own]}
            marks.append(measured_mark("dots", columns, label, marker="square", hollow=own is not inside, words=said))
    view = Panels(Axis("greatest score of the object"), (Part(row_names(names), tuple(marks), (("x", 0.0),)),))
    title = "Score of each object: predicted interval and measured value"
    title += left_out(len(shown), len(pairs), "results.csv")
    alt = f"Measured score of each object beside its predicted 95 % interval. {'; '.join(words)}."
    return Figure("object-scores", "scores", title, alt, (view,))


def transform_figure(sides: Sides) -> Figure | None:
    """Probability integral transforms of all objects: in order, with a band, and as a histogram, by detector."""
    by_detector: dict[str, list[Array]] = {}
    for (_, detector), draws, measured in _objects(sides):
        below = np.searchsorted(np.sort(draws), measured)
        by_detector.setdefault(detector, []).append(np.asarray((below + 0.5) / (draws.size + 1.0), float))
    views, words = [], []
    for detector, parts in by_detector.items():
        u = np.sort(np.concatenate(parts))
        inside = float(np.mean((u >= 0.025) & (u <= 0.975)))
        words.append(f"{detector}: {u.size} objects, {inside:.0%} in the central 95 %")
        x = Axis("probability of a lower score", ends=(0.0, 1.0))
        views.append(Panels(x, (_ordered(u), _histogram(u)), detector))
    if not views:
        return None
    return Figure(
        "object-transforms", "scores",
        "Predicted probability of a lower score than measured, all objects: uniform where predictions are right",
        "Probability integral transforms of the objects' scores in order against the uniform distribution with its "
        "95 % band for independent objects, and their histogram with that of a uniform sample. Objects share "
        f"errors of the inputs, which the band leaves out. {'; '.join(words)}.", tuple(views),
    )  # fmt: skip


def _ordered(u: Array) -> Part:
    n = u.size
    rank = np.arange(1, n + 1)
    at = (rank - 0.5) / n
    low, high = (betaincinv(rank, n + 1 - rank, q) for q in (0.025, 0.975))
    band = Mark("area", {"x": at, "low": low, "high": high}, "95 % of independent objects", PREDICTED)
    uniform = Mark("line", {"x": [0.0, 1.0], "y": [0.0, 1.0]}, "uniform", GREY, "dotted")
    objects = measured_mark("line", {"x": at, "y": u}, "objects, in order")
    return Part(Axis("transform value", ends=(0.0, 1.0)), (band, uniform, objects))


def _histogram(u: Array) -> Part:
    bins = 10 if u.size >= 50 else 5
    counts, edges = np.histogram(u, bins, (0.0, 1.0))
    expected = u.size / bins
    half = COVERAGE * math.sqrt(expected * (1.0 - 1.0 / bins))
    ends = np.array([0.0, 1.0])
    band = {"x": ends, "low": np.full(2, max(expected - half, 0.0)), "high": np.full(2, expected + half)}
    bars = {"left": edges[:-1], "right": edges[1:], "bottom": np.zeros(bins), "top": counts}
    marks = (
        Mark("bars", bars, colour=MEASURED, words=tuple(f"{n} objects" for n in counts)),
        Mark("area", band, colour=PREDICTED),
        Mark("line", {"x": ends, "y": np.full(2, expected)}, colour=GREY, dash="dotted"),
    )
    return Part(Axis("objects", ends=(0.0, max(float(counts.max()), expected + half) * 1.1)), marks)


def _objects(sides: Sides) -> list[tuple[tuple[str, str], Array, Array]]:
    """(subject, detector), predicted draws and measured scores of what both sides hold."""
    predicted, measured = (of_side(side, "object_scores") for side in sides)
    out = []
    for key, scores in predicted.items():
        if key in measured:
            values = measured[key].values[np.isfinite(measured[key].values)]
            if values.size:
                out.append((key, scores.values.ravel(), values))
    return out


def many_objects_figure(maps: Mapping[str, ScoreMap], sides: Sides) -> Figure | None:
    """The objects of each score map at their places, coloured by measured minus predicted score, above the histogram
    of their scores; None where they are few.
    """
    views: list[Panels] = []
    words: list[str] = []
    for name, score_map in maps.items():
        found = _map_objects(name, score_map, sides)
        if found is not None and len(views) < _MOST_MAPS:
            view, text = found
            views.append(view)
            words.append(text)
    if not views:
        return None
    return Figure(
        "objects", "scores",
        "Score of each object, measured minus predicted median, at its place, and the scores of all: what is "
        "chosen in one stands out in the other",
        "Map of the objects coloured by measured minus predicted score, and a histogram of the measured scores "
        f"with what the prediction expects, a view for each score map. {'; '.join(words)}.", tuple(views),
    )  # fmt: skip


def _map_objects(name: str, score_map: ScoreMap, sides: Sides) -> tuple[Panels, str] | None:
    if None in sides or len(score_map.outlines) <= MANY_OBJECTS:
        return None
    predicted: Mapping[Any, ObjectScores] = of_side(sides[0], "object_scores")
    names, measured, median = [], [], []
    laws: list[tuple[int, Array]] = []
    for (subject, detector), scores in of_side(sides[1], "object_scores").items():
        law = predicted.get((subject, detector))
        if law is None or not name.endswith(f"-{detector}"):
            continue
        own = [i for i, one in enumerate(scores.names) if one in score_map.outlines and np.isfinite(scores.values[i])]
        if own:
            laws.append((len(own), np.ravel(law.values)))
            names += [scores.names[i] for i in own]
            measured += [float(scores.values[i]) for i in own]
            median += [float(np.median(laws[-1][1]))] * len(own)
    if len(names) <= MANY_OBJECTS:
        return None
    line, sample = np.array([np.mean(np.nonzero(score_map.outlines[one]), axis=1) for one in names]).T + 0.5
    value = np.array(measured) - np.array(median)
    reach = float(np.max(np.abs(value))) or 1.0
    said = tuple(f"{one}: measured {m:.3g}, predicted median {p:.3g}"
                 for one, m, p in zip(names, measured, median, strict=True))  # fmt: skip
    columns = {"x": sample, "y": line, "value": value}
    scale = ColourScale("signed", -reach, reach, "measured − predicted")
    dots = Mark("dots", columns, marker="circle", words=said, scale=scale, linked=True)
    lines, samples = (float(n) for n in np.shape(score_map.values))
    place = Part(Axis("line [pixel]", ends=(lines, 0.0)), (dots,))
    return Panels(Axis("sample [pixel]", ends=(0.0, samples)), (place, _scores_of_all(measured, laws, said)), name), (
        f"{name}: {len(names)} objects, median measured {np.median(measured):.3g}, predicted {np.median(median):.3g}"
    )


def _scores_of_all(measured: Sequence[float], laws: Sequence[tuple[int, Array]], said: tuple[str, ...]) -> Part:
    """Histogram of measured scores and of those that the prediction expects.

    Scores beyond the edges count in the outermost bins, so that both sum to the number of objects.
    """
    ends = np.concatenate([measured, *(np.quantile(draws, [0.005, 0.995]) for _, draws in laws)])
    edges = np.linspace(ends.min(), max(ends.max(), ends.min() + 1e-9), _BINS + 1)
    expected = np.zeros(_BINS)
    for objects, draws in laws:
        expected += objects * np.histogram(np.clip(draws, edges[0], edges[-1]), edges)[0] / draws.size
    counts = np.histogram(measured, edges)[0].astype(float)
    top, margin = 1.08 * float(max(counts.max(), expected.max())), 0.02 * (edges[-1] - edges[0])
    bins = {"left": edges[:-1], "right": edges[1:], "bottom": np.zeros(_BINS)}
    steps = {"x": edges, "y": np.append(expected, expected[-1])}
    dots = {"x": np.array(measured), "y": np.zeros(len(measured))}
    return Part(
        Axis("number of objects", ends=(0.0, top)),
        (
            measured_mark("bars", bins | {"top": counts}, alpha=0.35),
            predicted_mark("steps", steps),
            measured_mark("dots", dots, "", marker="circle", words=said, linked=True),
        ),
        x=Axis("greatest score over the object's pixels", ends=(float(edges[0] - margin), float(edges[-1] + margin))),
    )


def densities_figure(sides: Sequence[tuple[str, Products]]) -> Figure | None:
    """Densities of the detectors' scores, a view for each; None without any.

    A density that the product does not state is that of the normal law with its moments.  Sides after the first are
    dashed.
    """
    detectors = list(dict.fromkeys(detector for _, side in sides for _, detector in side.scores))
    names = list(dict.fromkeys(subject for _, side in sides for subject, _ in side.scores))
    if not detectors:
        return None
    return Figure(
        "densities", "scores",
        "Scores: probability density of each population and of the background",
        "Probability density (logarithmic) of the detector's score, a view for each detector. "
        f"Populations: {', '.join(names[:_MOST_POPULATIONS])}.",
        tuple(_densities(sides, detector) for detector in detectors),
    )  # fmt: skip


def _densities(sides: Sequence[tuple[str, Products]], detector: str) -> Panels:
    curves = [
        (label, number, subject, *density_of(score))
        for number, (label, side) in enumerate(sides)
        for subject, score in [(s, v) for (s, d), v in side.scores.items() if d == detector and v.sd > 0][
            :_MOST_POPULATIONS
        ]
    ]
    subjects = list(dict.fromkeys(subject for _, _, subject, *_ in curves))
    top = max((float(np.nanmax(y)) for *_, y in curves), default=1.0)
    marks = []
    for label, number, subject, x, y in curves:
        columns = {"x": x, "y": np.maximum(y, top * _DEEPEST / 10)}
        name = f"{subject}, {label}" if len(sides) > 1 else subject
        colour = CURVES[subjects.index(subject) % len(CURVES)]
        marks.append(Mark("line", columns, name, colour, "dashed" if number else "solid"))
    part = Part(Axis("density", "log", ends=(top * _DEEPEST, 2.0 * top)), tuple(marks))
    return Panels(Axis(f"score of {detector}"), (part,), detector)


def density_of(score: ScoreDistribution) -> tuple[Array, Array]:
    """Scores (G,) [1] and the probability density (G,) at each [per unit of score].

    Examples
    --------
    >>> score, density = density_of(ScoreDistribution(0.5, 0.1))
    >>> round(float(np.trapezoid(density, score)), 5)
    1.0
    """
    if score.grid is not None and score.density is not None:
        return score.grid, score.density
    z = np.linspace(-_SPAN, _SPAN, 201)
    return score.mean + score.sd * z, np.exp(-0.5 * z**2) / (score.sd * np.sqrt(2.0 * np.pi))
