"""Interactive charts of a page: spectra by subject with their difference, and ROC curves.

Bokeh writes each as data in JSON; the page holds its script once, from the installed package, and needs no network.
Figures for print are drawn by ``figures_*``.

The interactive chart of many objects: a map of measured minus predicted score, and a histogram of both.

Stated plots as interactive charts: a subject at a time where there are several.

The interactive chart of detector scores: density of each population over the score, a tab for each detector.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.products import Products, RocCurve, ScoreDistribution, SpectralEstimate
from hyperval.report import style
from hyperval.report.charts_base import LABELS, Chart, ChartFill, Curves, Labels, chart_content, column_text
from hyperval.report.plots import Axis, Plots, SubjectView
from hyperval.report.run import ScoreMap, Sides, best_counted, difference, drawn_of
from hyperval.results import Outcome, Result
from hyperval.spectra.axis import SpectralAxis, in_window

Array = npt.NDArray[np.float64]
Column = npt.NDArray[np.float32]

_COVERAGE = 1.96  # normal quantile of a two-sided 95 % interval
SPECTRA = ("radiance", "toa_reflectance", "snr", "reflectance")
# Of a product: its axis, its title, and whether its difference is a ratio.
SPECTRA_WORDS = {
    "radiance": ("radiance [µW cm⁻² sr⁻¹ nm⁻¹]", "Radiance at the sensor", True),
    "reflectance": ("reflectance [1]", "Reflectance", False),
    "toa_reflectance": ("reflectance [1]", "Reflectance at the top of the atmosphere", True),
    "snr": ("signal-to-noise ratio [1]", "Signal-to-noise ratio", True),
}
MOST_SUBJECTS = 24
MOST_CURVES = 24
FIRST = "the first few"  # of the subjects of curves
_MOST_POINTS = 200


@dataclass(frozen=True)
class Spectra:
    """What the chart of spectra shows of one subject.

    Attributes
    ----------
    nm : band centres [nm], or the numbers of bands where it is ``numbered``
    bands : "predicted", "collected", "difference" -> value, and half-width of its 95 % interval
    ranges : limits of the plots
    """

    nm: Column
    numbered: bool
    bands: dict[str, tuple[Column, Column]]
    ranges: dict[str, tuple[float, float]]

    def without_difference(self) -> Spectra:
        """Both sides alone."""
        bands = {name: band for name, band in self.bands.items() if name != "difference"}
        ranges = {name: ends for name, ends in self.ranges.items() if name != "gap"}
        return Spectra(self.nm, self.numbered, bands, ranges)

    def packed(self, before: npt.NDArray[Any] | None = None) -> dict[str, Any]:
        """As the script reads it; wavelengths that are those of ``before`` are not repeated."""
        same = before is not None and np.array_equal(self.nm, before)
        bands = {name: [column_text(value), column_text(half)] for name, (value, half) in self.bands.items()}
        return {"columns": {} if same else {"nm": column_text(self.nm)}, "bands": bands, "ranges": self.ranges}


def draw_charts(sides: Sides, rows: Sequence[Result], labels: Labels = LABELS) -> list[Chart]:
    """Every chart that the products allow; subjects about which more is amiss in ``rows`` come first.

    ``labels`` : what the two sides are, where they are not a prediction and a collection
    """
    charts = [spectra_chart(sides, product, rows, labels) for product in SPECTRA]
    charts.append(roc_chart(sides, labels))
    return [chart for chart in charts if chart is not None]


def spectra_chart(sides: Sides, product: str, rows: Sequence[Result] = (), labels: Labels = LABELS) -> Chart | None:
    """Both sides of one subject at a time over wavelength, with the difference below; None without any."""
    label, title, ratio = SPECTRA_WORDS[product]
    predicted, collected, drawn, paired = drawn_of(sides, product)
    if not paired and None not in sides:
        return None
    shown = _worst_first(drawn, product, rows)[:MOST_SUBJECTS]
    if not shown:
        return None
    spectra = [subject_spectra(sides, predicted.get(name), collected.get(name), ratio=ratio) for name in shown]
    words = " and ".join(labels) if paired else labels[0] if sides[0] is not None else labels[1]
    identical = paired and not any(np.nan_to_num(own.bands["difference"][0]).any() for own in spectra)
    if identical:  # nothing to draw
        words += ", which are identical"
        spectra = [own.without_difference() for own in spectra]
    name, first = f"chart-{product}", spectra[0]
    over, grey = ("number of the band", "") if first.numbered else ("wavelength", " (grey: absorption)")
    below = ", the difference below" if "difference" in first.bands else ""
    return Chart(
        name,
        product,
        f"{title}: {words} {grey}{style.left_out([shown], drawn)}",
        f"{title} against {over}, a subject at a time: {labels[0]} (dashed) and {labels[1]} (solid) with 95 % "
        f"intervals{below}. Subjects: {', '.join(shown)}.",
        chart_content(
            chart_models("spectra", name, tuple(first.bands), first.numbered, label, ratio, labels),
            ChartFill(ranges={"nm": wavelength_ends(first.nm)}),
            [one.packed(first.nm if i else None) for i, one in enumerate(spectra)],
        ),
        tuple(shown),
    )


def roc_chart(sides: Sides, labels: Labels = LABELS) -> Chart | None:
    """P_D against P_FA, a tab for each detector and unit, a name in the legend for each subject."""
    predicted, measured, drawn, _ = drawn_of(sides, "roc")
    kinds = list(dict.fromkeys(key[1:] for key in drawn))
    if not kinds:
        return None
    tabs, shown, fill = [], [], ChartFill()
    for number, (detector, unit) in enumerate(kinds):
        keys = [key for key in drawn if key[1:] == (detector, unit)]
        keys = best_counted(keys, measured, MOST_CURVES // len(kinds) or 1)
        shown.append(keys)
        tabs.append((f"{detector}, by {unit}", _fill_curves(fill, number, keys, predicted, measured)))
    names = tuple(dict.fromkeys(key[0] for keys in shown for key in keys))
    second = "measured" if labels == LABELS else labels[1]
    words = f"{labels[0]} (dashed) and {second}" if measured or labels == LABELS else labels[0]
    return Chart(
        "chart-roc",
        "roc",
        f"ROC: {words}; a click on a name shows or hides it{style.left_out(shown, drawn)}",
        f"Probability of detection against probability of false alarm (logarithmic), {labels[0]} dashed and "
        f"{second}{' in steps' if second == 'measured' else ''}, with 95 % intervals, a tab for each detector. "
        f"Subjects: {', '.join(names)}.",
        chart_content(chart_models("curves", "chart-roc", tuple(tabs), labels), fill),
        (FIRST, *names) if len(names) > 1 else (),
    )


@lru_cache(maxsize=64)
def chart_models(kind: str, target: str, *arguments: Any) -> str:
    """The JSON of a chart's models, which hold no numbers of a run: built once for charts that look alike."""
    from hyperval.report.bokeh_models import models_json  # a second, of which a page without charts needs nothing

    return models_json(kind, target, *arguments)


def _worst_first(subjects: Sequence[str], product: str, rows: Sequence[Result]) -> list[str]:
    weight = {Outcome.DISAGREES: 3, Outcome.ERROR: 3, Outcome.UNDECIDED: 2, Outcome.AGREES: 1}
    worst: dict[str, int] = {}
    for row in rows:
        if row.planned and row.product == product:
            worst[row.subject] = max(worst.get(row.subject, 0), weight.get(row.outcome, 0))
    return sorted(subjects, key=lambda subject: -worst.get(subject, 0))


def subject_spectra(
    sides: Sides, predicted: SpectralEstimate | None, collected: SpectralEstimate | None, *, ratio: bool
) -> Spectra:
    """Means with their 95 % limits, and the difference (a ratio to the collected side, or not) with its own."""
    estimates = [
        (name, side.axis, estimate)
        for name, side, estimate in (("predicted", sides[0], predicted), ("collected", sides[1], collected))
        if side is not None and estimate is not None
    ]
    axis = estimates[0][1]
    w = axis.centre_nm
    keep = in_windows(axis)
    bands: dict[str, tuple[Array, Array]] = {}
    for name, own, estimate in estimates:
        if own.matches(axis):
            bands[name] = (estimate.mean, _COVERAGE * estimate.standard_uncertainty)
    if len(bands) == 2 and predicted is not None and collected is not None:
        value, u = difference(predicted, collected, ratio)
        bands["difference"] = (value, _COVERAGE * u)
    limits = {
        "level": style.robust_limits(
            [v for k, b in bands.items() if k != "difference" for v in _edges(b, keep)], zero=True
        ),
        "gap": style.robust_limits(_edges(bands["difference"], keep), zero=True, trim=3.0)
        if "difference" in bands
        else None,
    }
    ranges = {name: (float(pair[0]), float(pair[1])) for name, pair in limits.items() if pair is not None}
    columns = {name: (_column(value), _column(half)) for name, (value, half) in bands.items()}
    return Spectra(_column(w), axis.numbered, columns, ranges)


def wavelength_ends(nm: Array | Column) -> tuple[float, float]:
    """Ends of the axis of band centres; of a single band with room beside it."""
    return float(nm[0]), float(max(nm[-1], nm[0] + 1.0))


def in_windows(axis: SpectralAxis) -> npt.NDArray[np.bool_]:
    """Bands in the windows of the atmosphere; all, where none is."""
    keep = in_window(axis.centre_nm)
    return keep if keep.any() else np.ones(keep.shape, bool)


def _edges(band: tuple[Array, Array], keep: npt.NDArray[np.bool_]) -> list[Array]:
    value, half = band
    return [(value - half)[keep], (value + half)[keep]]


def _fill_curves(
    fill: ChartFill,
    tab: int,
    keys: Sequence[tuple[str, str, str]],
    predicted: Mapping[Any, RocCurve],
    measured: Mapping[Any, RocCurve],
) -> Curves:
    """Note the numbers of the curves of one detector and unit."""
    low = lowest_pfa([c[key] for c in (predicted, measured) for key in keys if key in c], measured)
    counted = [1.0 / c.n_background for c in measured.values() if c.n_background]
    fill.ranges[f"pfa-{tab}"] = low, 1.0
    if counted:
        fill.spans[f"counted-{tab}"] = min(counted)
    subjects = []
    for number, key in enumerate(keys):
        sides = tuple(side for side, own in enumerate((predicted, measured)) if key in own)
        for side in sides:
            fill.add(f"curve-{tab}-{number}-{side}", curve_data((predicted, measured)[side][key], low))
        subjects.append((key[0], sides))
    return Curves(tuple(subjects), bool(counted))


def lowest_pfa(curves: Sequence[RocCurve], measured: Mapping[Any, RocCurve]) -> float:
    """The least P_FA that curves are drawn at: two decades past what the background can resolve are enough."""
    lowest = min((float(c.pfa[c.pfa > 0].min()) for c in curves if (c.pfa > 0).any()), default=1e-3)
    return max(lowest, min((1.0 / c.n_background / 100.0 for c in measured.values() if c.n_background), default=0.0))


def curve_data(curve: RocCurve, low: float) -> dict[str, Column]:
    """At most a few hundred points of a curve, evenly spread over the logarithm of P_FA."""
    keep = np.flatnonzero(curve.pfa >= low)
    if keep.size > _MOST_POINTS:
        wanted = np.geomspace(curve.pfa[keep[0]], curve.pfa[keep[-1]], _MOST_POINTS)
        keep = np.unique(np.clip(np.searchsorted(curve.pfa, wanted), keep[0], keep[-1]))
    columns = {"pfa": curve.pfa, "pd": curve.pd, "low": curve.pd_lower, "high": curve.pd_upper}
    return {name: _column(values[keep]) for name, values in columns.items()}


def _column(values: Array) -> Column:
    return np.asarray(values, dtype=np.float32)


MANY_OBJECTS = 40  # of fewer, each has its place in a list
_BINS = 24
_MOST_TABS = 6


@dataclass(frozen=True)
class MapObjects:
    """The objects of one score map, with a prediction each.

    Attributes
    ----------
    names : of the objects (N)
    line, sample : (N,) centre of each [pixel]
    measured : (N,) greatest score over the pixels of each [1]
    predicted : (N,) median of its predicted scores [1]
    draws : for each object the number of its predicted scores in ``by_subject``
    by_subject : the predicted scores of each subject
    """

    names: tuple[str, ...]
    line: Array
    sample: Array
    measured: Array
    predicted: Array
    draws: npt.NDArray[np.intp]
    by_subject: tuple[Array, ...]

    def histogram(self) -> tuple[Array, Array, Array]:
        """Edges (K + 1,) [1], measured objects in each bin (K,) and how many the prediction expects there (K,).

        Scores beyond the edges count in the outermost bins, so that both sum to the number of objects.
        """
        ends = np.concatenate([self.measured, *(np.quantile(d, [0.005, 0.995]) for d in self.by_subject)])
        edges = np.linspace(ends.min(), max(ends.max(), ends.min() + 1e-9), _BINS + 1)
        expected = np.zeros(_BINS)
        for number, draws in enumerate(self.by_subject):
            share = np.histogram(np.clip(draws, edges[0], edges[-1]), edges)[0] / draws.size
            expected += np.count_nonzero(self.draws == number) * share
        return edges, np.histogram(self.measured, edges)[0].astype(float), expected


def map_objects(name: str, score_map: ScoreMap, sides: Sides) -> MapObjects | None:
    """The objects of a score map that have a measured and a predicted score; None for few."""
    if None in sides or len(score_map.outlines) <= MANY_OBJECTS:
        return None
    predicted, measured = (side.object_scores for side in sides if side is not None)
    names, values, draws = [], [], []
    by_subject: list[Array] = []
    for (subject, detector), scores in measured.items():
        law = predicted.get((subject, detector))
        if law is None or not name.endswith(f"-{detector}"):
            continue
        own = [i for i, one in enumerate(scores.names) if one in score_map.outlines and np.isfinite(scores.values[i])]
        if own:
            names += [scores.names[i] for i in own]
            values += [float(scores.values[i]) for i in own]
            draws += [len(by_subject)] * len(own)
            by_subject.append(np.ravel(law.values))
    if len(names) <= MANY_OBJECTS:
        return None
    centres = np.array([np.mean(np.nonzero(score_map.outlines[one]), axis=1) for one in names]) + 0.5
    medians, number = np.array([np.median(d) for d in by_subject]), np.array(draws)
    return MapObjects(
        tuple(names), centres[:, 0], centres[:, 1], np.array(values), medians[number], number, tuple(by_subject)
    )


def objects_chart(maps: Mapping[str, ScoreMap], sides: Sides) -> Chart | None:
    """A map of the objects of each score map and a histogram of their scores; None where they are few."""
    shown = {name: own for name, one in maps.items() if (own := map_objects(name, one, sides)) is not None}
    shown = dict(list(shown.items())[:_MOST_TABS])
    if not shown:
        return None
    fill, words = ChartFill(), []
    for tab, (name, own) in enumerate(shown.items()):
        difference = own.measured - own.predicted
        columns = {"sample": own.sample, "line": own.line, "measured": own.measured, "predicted": own.predicted}
        fill.add(f"objects-{tab}", columns | {"difference": difference})
        fill.texts[f"objects-{tab}"] = {"name": list(own.names)}
        edges, measured, expected = own.histogram()
        fill.add(f"bins-{tab}", {"left": edges[:-1], "right": edges[1:], "measured": measured, "predicted": expected})
        reach = float(np.max(np.abs(difference))) or 1.0
        fill.colours[f"difference-{tab}"] = -reach, reach
        margin = 0.02 * (edges[-1] - edges[0])
        fill.ranges[f"score-{tab}"] = float(edges[0] - margin), float(edges[-1] + margin)
        fill.ranges[f"count-{tab}"] = 0.0, 1.08 * float(max(measured.max(), expected.max()))
        words.append(
            f"{name}: {len(own.names)} objects, median measured {np.median(own.measured):.3g}, "
            f"predicted {np.median(own.predicted):.3g}"
        )
    return Chart(
        "chart-objects",
        "scores",
        "Score of each object, measured minus predicted median, at its place, and the scores of all: what is "
        "chosen in one stands out in the other",
        "Map of the objects coloured by measured minus predicted score, and a histogram of the measured scores "
        f"with what the prediction expects, a tab for each score map. {'; '.join(words)}.",
        chart_content(chart_models("objects", "chart-objects", tuple(shown)), fill),
    )


def chart_of(plots: Plots) -> Chart:
    """The chart of plots; its models are kept for plots that look alike."""
    name, views = f"chart-{plots.name}", list(plots.views.values())
    looks = [
        (_axis(view.x), tuple((_axis(p.y), tuple(m.look for m in p.marks), p.rules) for p in view.parts))
        for view in views
    ]
    models = chart_models("plots", name, *looks[0])
    fills = [_fill(view) for view in views]
    subjects = tuple(plots.views) if len(views) > 1 else ()
    rest = [fill.packed() for fill in fills] if subjects else ()
    content = chart_content(models, ChartFill() if subjects else fills[0], rest)
    title = plots.title + (f". {plots.legend[0].upper()}{plots.legend[1:]}" if plots.legend else "")
    return Chart(name, plots.section, title, plots.alt, content, subjects)


def _axis(axis: Axis) -> tuple[str, str, int]:
    return axis.label, axis.scale, len(axis.names)


def _fill(view: SubjectView) -> ChartFill:
    fill = ChartFill()
    fill.ranges["x"] = view.ends()
    for number, part in enumerate(view.parts):
        low, high = view.ends(part)
        fill.ranges[f"y-{number}"] = (high, low) if part.y.scale == "names" else (low, high)
        for which, axis in (("x", view.x), ("y", part.y)):
            if axis.scale == "names":
                fill.names[f"names-{which}-{number}"] = axis.names
        for at, mark in enumerate(part.marks):
            source = f"m-{number}-{at}"
            columns: dict[str, Any] = {k: np.atleast_1d(v) for k, v in mark.columns.items()}
            fill.add(source, columns)
            if mark.words:
                fill.texts[source] = {"words": list(mark.words)}
            if mark.kind == "cells":
                reach = mark.reach
                fill.colours[f"{source}-colours"] = -reach, reach
                fill.texts[source]["shade"] = mark.shades
    return fill


_MOST = 12  # populations of a detector
_SPAN = 5.0  # standard deviations about the mean, where the density is not stated
_DEEPEST = 1e-8  # part of the greatest density


def scores_chart(sides: Sequence[tuple[str, Products]]) -> Chart | None:
    """Densities of the detectors' scores; None without any.

    A density that the product does not state is that of the normal law with its moments.  Sides after the first are
    dashed.
    """
    detectors = list(dict.fromkeys(detector for _, side in sides for _, detector in side.scores))
    if not detectors:
        return None
    fill = ChartFill()
    tabs = tuple((detector, _fill_densities(fill, i, sides, detector)) for i, detector in enumerate(detectors))
    names = list(dict.fromkeys(subject for _, side in sides for subject, _ in side.scores))
    return Chart(
        "chart-scores",
        "scores",
        "Scores: probability density of each population and of the background; a click on a name shows or hides it",
        f"Probability density (logarithmic) of the detector's score, a tab for each detector. "
        f"Populations: {', '.join(names[:_MOST])}.",
        chart_content(chart_models("densities", "chart-scores", tabs), fill),
    )


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


def _fill_densities(
    fill: ChartFill, tab: int, sides: Sequence[tuple[str, Products]], detector: str
) -> tuple[tuple[str, int, str], ...]:
    """Note the numbers of one detector's curves; label and number of the side, and subject, of each."""
    curves = [
        (label, number, subject, *density_of(score))
        for number, (label, side) in enumerate(sides)
        for subject, score in [(s, v) for (s, d), v in side.scores.items() if d == detector and v.sd > 0][:_MOST]
    ]
    low = min((float(x[0]) for *_, x, _ in curves), default=0.0)
    high = max((float(x[-1]) for *_, x, _ in curves), default=1.0)
    top = max((float(np.nanmax(y)) for *_, y in curves), default=1.0)
    fill.ranges[f"score-{tab}"], fill.ranges[f"density-{tab}"] = (low, high), (top * _DEEPEST, 2.0 * top)
    for place, (*_, x, y) in enumerate(curves):
        fill.add(f"density-{tab}-{place}", {"score": x, "density": np.maximum(y, top * _DEEPEST / 10)})
    return tuple((label, number, subject) for label, number, subject, *_ in curves)
