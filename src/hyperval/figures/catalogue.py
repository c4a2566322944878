"""Figures of a run: spectra, their uncertainty and spread, detection, areas, and the reasons; all in order."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import betaincinv

from hyperval.compare import MAX_EIGENVALUES, SPREAD, Sampled, in_central_95, probability_integral_transform, sampled
from hyperval.data import Array, Mask
from hyperval.figures.rows import short_text
from hyperval.figures.spec import (
    CURVES,
    DIFFERENCE,
    LOOKS,
    MAX_PANELS,
    SOURCES,
    WAVELENGTH,
    Axis,
    ColourScale,
    Figure,
    Mark,
    Panels,
    Part,
    Rules,
    compose,
    figure_of_views,
    measured_mark,
    omissions,
    predicted_mark,
    robust_limits,
    row_figure,
    single_panel,
    to_columns,
)
from hyperval.metrics import product_words
from hyperval.model import Z95, clopper_pearson, detection_at, difference_ratio
from hyperval.pixels import distance_exceedance
from hyperval.products import ClassificationError, Products, RocCurve, ScoreDistribution, SpectralEstimate
from hyperval.results import WORST_FIRST, Cause, Result, ResultTable, grouped
from hyperval.run import ScoreMap
from hyperval.spectra.axis import SpectralAxis

Sides = tuple[Products | None, Products | None]
SIDES = ("predicted", "measured")
Entry = tuple[float, float, float, str]  # a value of a side with the limits of its interval, and what is said of it
# Of a product: its axis, its title, and whether its difference is a ratio.
SPECTRA: Mapping[str, tuple[str, str, bool]] = LOOKS["spectra"]
MAX_SUBJECTS = 24  # and curves
_MAX_ROWS = 40
_MAX_SOURCES = 7


def side_products(sides: Sides, product: str) -> list[Mapping[Any, Any]]:
    """A product of each side, empty where the side is absent."""
    return [{} if side is None else getattr(side, product) for side in sides]


def shared_first(predicted: Mapping[Any, Any], measured: Mapping[Any, Any]) -> list[Any]:
    """Keys of either side: those of both sides before those of one."""
    return list(dict.fromkeys([*(key for key in predicted if key in measured), *predicted, *measured]))


def drawn_products(sides: Sides, product: str) -> tuple[list[Mapping[Any, Any]], list[Any], bool]:
    """A product of each side, the keys to draw, and whether both sides hold these.

    Where anything can be compared, what only one side holds is left to products.nc.
    """
    both = side_products(sides, product)
    pairs = [key for key in both[0] if key in both[1]]
    return both, pairs or shared_first(*both), bool(pairs)


def window_bands(axis: SpectralAxis) -> Mask:
    """Bands that are summarised: the good ones in the windows of the atmosphere; all, where none is.

    Examples
    --------
    >>> window_bands(SpectralAxis([500.0, 600.0, 940.0], 10.0, np.array([True, False, True])))
    array([ True, False, False])
    """
    keep = axis.clear
    return keep if keep.any() else np.ones(keep.shape, bool)


def count_text(n: int) -> str:
    """A whole number with its thousands separated."""
    return f"{n:,}".replace(",", "\u202f")


def dot_rows(
    kind: str, keys: Sequence[Any], both: Sequence[Mapping[Any, Entry]], x: Axis, *, under: Sequence[Mark] = (),
    **values: Any,
) -> Figure | None:  # fmt: skip
    """A figure with a row for each of the first keys: dots of the sides that have it, slightly offset."""
    shown = keys[:_MAX_ROWS]
    if not shown:
        return None
    marks, styles = list(under), ((predicted_mark, "circle", -0.14), (measured_mark, "square", 0.14))
    names = [", ".join(key) for key in shown]
    for side, (make, marker, shift) in zip(both, styles, strict=True):
        entries = [(i, side[key]) for i, key in enumerate(shown) if key in side]
        if entries:
            columns = to_columns([(i + shift, *entry[:3]) for i, entry in entries], ("y", "x", "low", "high"))
            words = tuple(f"{names[i]}: {entry[3]}" for i, entry in entries)
            marks.append(make("dots", columns, marker=marker, words=words, along="x"))
    return row_figure(kind, x, Axis.named(names), marks, more=omissions(len(shown), len(keys)), **values)


def wavelength_axis(axis: SpectralAxis) -> Axis:
    """The axis of a figure over bands, which may go by their number; of a single band with room beside it."""
    w = axis.centre_nm
    ends = float(w[0]), float(max(w[-1], w[0] + 1.0))
    return Axis("number of the band" if axis.numbered else WAVELENGTH, ends=ends)


def spectra_labels(sides: Iterable[Products | None], product: str) -> tuple[str, str, bool]:
    """Axis and title of the spectra of a product, and whether their difference is a ratio; counts are named so."""
    counted = any(side and side.provenance.get("quantity") == "counts" for side in sides)
    return ("counts", "Counts", False) if counted else SPECTRA[product]


def spectra_figure(
    sides: Sides, product: str, rows: Sequence[Result] = (), names: tuple[str, str] = SIDES
) -> Figure | None:
    """Both sides over wavelength with their difference below, a subject each; None where there is nothing to show.

    Parameters
    ----------
    product : a key of SPECTRA
    rows : subjects about which more is amiss in these come first
    names : what the two sides are, where they are no prediction and collection
    """
    both, drawn, paired = drawn_products(sides, product)
    if not drawn or (not paired and None not in sides):
        return None  # a comparison that has none of this product
    ranks = [(WORST_FIRST.index(row.outcome), row.subject) for row in rows if row.planned and row.product == product]
    worst = {subject: rank for rank, subject in sorted(ranks, reverse=True)}
    shown = sorted(drawn, key=lambda subject: worst.get(subject, len(WORST_FIRST)))[:MAX_SUBJECTS]
    axis = next(side.axis for side, each in zip(sides, both, strict=True) if side and shown[0] in each)
    # Sides on other bands are not drawn over each other.
    aligned = [each if side and side.axis.matches(axis) else {} for side, each in zip(sides, both, strict=True)]
    pairs = [(aligned[0][s].mean, aligned[1][s].mean) for s in shown if all(s in each for each in aligned)]
    identical = bool(pairs) and all(np.array_equal(p, m, equal_nan=True) for p, m in pairs)
    about = spectra_labels(sides, product)
    views = tuple(_spectra_view(axis, s, [each.get(s) for each in aligned], about, not identical, names) for s in shown)
    title = f"{about[1]}: {_present(both, names)}" + ", which are identical" * identical
    return Figure(product, product, title + omissions(len(shown), len({*both[0], *both[1]})), views, together="offered")


def _spectra_view(
    axis: SpectralAxis, subject: str, both: Sequence[SpectralEstimate | None], about: tuple[str, str, bool],
    differ: bool, names: tuple[str, str],
) -> Panels:  # fmt: skip
    """Both sides, and below them their difference, with its standard uncertainty as of independent sides."""
    (label, _, ratio), keep, words = about, window_bands(axis), ""
    estimates = [(e.mean, e.standard_uncertainty) for e in both if e is not None]

    def part(label: str, marks: Sequence[Mark], trim: float, rules: Rules = ()) -> Part:
        values = [mark.numbers.get(end, mark.numbers["y"])[keep] for mark in marks for end in ("low", "high")]
        ends = robust_limits(values, trim)
        return Part(Axis(label, ends=ends), tuple(marks), rules)

    # Dashes on top, so that neither hides the other.
    marks = [
        make("line", {"x": axis.centre_nm, "y": e.mean, "half": Z95 * e.standard_uncertainty}, name, linked=True)
        for e, make, name in ((both[1], measured_mark, names[1]), (both[0], predicted_mark, names[0])) if e is not None
    ]  # fmt: skip
    parts = [part(label, marks, 0.5)]
    if differ and len(estimates) == 2:
        (p, up), (m, um) = estimates
        gap = difference_ratio(p, m) if ratio else p - m
        u = np.hypot(up, (gap + 1.0) * um) / m if ratio else np.hypot(up, um)
        below = f"{names[0]} / {names[1]} − 1" if ratio else f"{names[0]} − {names[1]}"
        columns = {"x": axis.centre_nm, "y": gap, "half": Z95 * u}
        parts.append(part(below, [Mark("line", columns, "", DIFFERENCE, linked=True)], 3.0, (("y", 0.0),)))
        if np.isfinite(gap[keep]).any():
            where, median = " in the windows" * (not axis.numbered), np.nanmedian(np.abs(gap[keep]))
            words = f"median absolute difference{where} {median:{'.2%' if ratio else '.4f'}}"
    return Panels(wavelength_axis(axis), tuple(parts), subject, words=words)


def budget_figure(sides: Sides) -> Figure | None:
    """Relative uncertainty of the radiance by source, stacked to the total; a view for each subject and side."""
    estimates, drawn, _ = drawn_products(sides, "radiance")
    panels: dict[str, tuple[SpectralAxis, SpectralEstimate]] = {
        f"{subject} ({name})": (side.axis, of_side[subject])
        for subject in drawn
        for name, side, of_side in zip(SIDES, sides, estimates, strict=True)
        if side and subject in of_side and of_side[subject].budget
    }
    sources = _ranked_sources([estimate for _, estimate in list(panels.values())[:MAX_PANELS]])
    return figure_of_views("radiance-budget", list(panels), lambda name: _budget_view(*panels[name], sources, name))


def _budget_view(axis: SpectralAxis, estimate: SpectralEstimate, sources: Sequence[str], subject: str) -> Panels:
    w = axis.centre_nm
    parts = np.zeros((len(sources), w.size))  # variance by source; the last may be everything without its own place
    for source, u in estimate.budget.items():
        parts[sources.index(source) if source in sources else -1] += np.square(np.asarray(u, float))
    # Variances add, uncertainties do not: each source takes its share of the variance in the height.
    total, heights = parts.sum(axis=0), np.zeros_like(parts)
    lit = (np.abs(estimate.mean) > 0.0) & (total > 0.0)  # a dead band has no part of its radiance
    heights[:, lit] = 100.0 / np.abs(estimate.mean[lit]) * parts[:, lit] / np.sqrt(total[lit])
    edges = np.concatenate([np.zeros((1, w.size)), np.cumsum(heights, axis=0)])
    marks = [
        Mark("area", {"x": w, "low": low, "high": high}, source, colour, alpha=1.0)
        for low, high, source, colour in zip(edges[:-1], edges[1:], sources, SOURCES, strict=False)
    ]
    y = Axis("standard uncertainty [% of radiance]", ends=robust_limits([edges[-1][window_bands(axis)]]))
    return single_panel(wavelength_axis(axis), y, marks, subject)


def _ranked_sources(estimates: Sequence[SpectralEstimate]) -> list[str]:
    """Sources by their largest median share of the variance, the small ones taken together.

    >>> dead = SpectralEstimate(np.zeros(2), np.eye(2), budget={"noise": np.ones(2), "gain": np.ones(2)})
    >>> lit = SpectralEstimate(np.array([0.0, 4.0]), np.eye(2), budget={"noise": np.ones(2), "gain": np.full(2, 2.0)})
    >>> _ranked_sources([dead]), _ranked_sources([dead, lit])
    (['gain', 'noise'], ['gain', 'noise'])
    >>> view = _budget_view(SpectralAxis([500.0, 600.0], 5.0), lit, ["gain"], "lawn")
    >>> [mark.columns["high"].round(1).tolist() for mark in view.parts[0].marks]
    [[0.0, 55.9]]
    """
    weight: dict[str, float] = {}
    for estimate in estimates:
        lit = np.abs(estimate.mean) > 0.0
        parts = {s: np.square(np.asarray(u)[lit] / estimate.mean[lit]) for s, u in estimate.budget.items()}
        squares = {s: float(np.nanmedian(part)) if lit.any() else 0.0 for s, part in parts.items()}
        total = sum(squares.values()) or 1.0
        weight |= {source: max(weight.get(source, 0.0), square / total) for source, square in squares.items()}
    ranked = sorted(weight, key=lambda s: (-weight[s], s))
    return ranked if len(ranked) <= _MAX_SOURCES else [*ranked[: _MAX_SOURCES - 1], "other sources"]


_MAX_SPREADS = 6  # subjects in each quantity; those with the most pixels
_EIGENVALUE = "number of the eigenvalue"
_EIGENVALUES = {"radiance": "eigenvalue [(µW cm⁻² sr⁻¹ nm⁻¹)²]", "reflectance": "eigenvalue"}


def eigenvalue_figure(sides: Sides, quantity: str) -> Figure | None:
    """Eigenvalues of both sides; below each, predicted over measured with the band that chance alone gives."""
    predicted, observed = sides
    if predicted is None or observed is None:
        return None
    both = side_products(sides, quantity)
    counts = [(s, e.n) for s, e in both[1].items() if s in both[0] and e.n and e.pixel_covariance is not None]
    most = sorted(counts, key=lambda one: -one[1])[:_MAX_SPREADS]
    found = {s: sampled(predicted, observed, s, quantity, MAX_EIGENVALUES) for s, _ in most}
    spreads = {s: one for s, one in found.items() if isinstance(one, Sampled)}

    def view(subject: str) -> Panels:
        spread = spreads[subject]
        measured, (mean, low, high) = spread.measured.eigenvalues, spread.eigenvalues
        number = np.arange(1.0, measured.size + 1)
        expected = {"y": mean, "low": low, "high": high}
        above = (
            predicted_mark("line", {"x": number, **expected}, "predicted, mean and 95 % of samples", marker="circle"),
            measured_mark("line", {"x": number, "y": measured}, marker="square"),
        )
        ratio = {"x": number, **{name: values / measured for name, values in expected.items()}}
        below = Part(Axis("predicted / measured"), (Mark("line", ratio, colour=DIFFERENCE),), (("y", 1.0),))
        words = f"{np.sum((measured >= low) & (measured <= high))} of {measured.size} measured inside"
        x, name = Axis(_EIGENVALUE, ends=(0.0, measured.size + 1.0)), f"{subject} (n = {count_text(spread.n)})"
        return Panels(x, (Part(Axis(_EIGENVALUES[quantity], "log"), above), below), name, words=words, reference=1.0)

    return figure_of_views("eigenvalues", list(spreads), view, name=f"{quantity}-eigenvalues", quantity=quantity)


def tail_figure(sides: Sides) -> Figure | None:
    """Share of pixels beyond a Mahalanobis distance: measured, as predicted, normal, and the t that fits best.

    Examples
    --------
    >>> from hyperval.products import PixelDistribution
    >>> about = {"distance": np.array([2.0]), "exceedance": np.array([0.1]), "leading_dimension": 2, "n": 100}
    >>> law = PixelDistribution(leading_tail_dof=np.inf, leading_scale=0.5, **about)  # distances by twice the variance
    >>> view = tail_figure((None, Products(SpectralAxis([500.0], 10.0), distribution={"grass": law}))).views[0]
    >>> {mark.label: round(float(mark.numbers["y"][0]), 3) for mark in view.marks[1:]}
    {'normal law': 0.368, 'fitted t': 0.135}
    """
    predicted, measured = side_products(sides, "distribution")

    def view(subject: str) -> Panels:
        law, stated = measured[subject], predicted.get(subject)
        n, dimension, distance = law.n or 1, law.leading_dimension, np.sqrt(law.distance)
        low, high = clopper_pearson(law.exceedance * n, np.full(distance.size, n))
        columns = {"x": distance, "y": law.exceedance, "low": low, "high": high}

        def curve(dof: float, scale: float = 1.0) -> dict[str, Array]:
            return {"x": distance, "y": distance_exceedance(law.distance / scale, dimension, dof)}

        marks = [measured_mark("line", columns, "measured, with its 95 % interval")]
        marks += [] if stated is None else [predicted_mark("line", curve(stated.tail_dof), "predicted law")]
        marks.append(Mark("line", curve(math.inf), "normal law", dash="dotted"))
        marks.append(Mark("line", curve(law.leading_tail_dof, law.leading_scale), "fitted t", DIFFERENCE, "dashdot"))
        prediction = "" if stated is None else f", {_dof_text(stated.tail_dof)} predicted"
        x = Axis("Mahalanobis distance", ends=(0.0, float(distance[-1]) * 1.03))
        y = Axis("share of pixels farther out", "log", ends=(0.3 / n, 1.5))
        name = f"{subject}: {dimension} components, n = {count_text(n)}"
        return single_panel(x, y, marks, name, f"{_dof_text(law.leading_tail_dof)} measured{prediction}")

    subjects = [s for s, law in measured.items() if law.distance is not None and law.leading_dimension is not None]
    return figure_of_views("pixel-tails", subjects, view)


def _dof_text(dof: float) -> str:
    return "normal" if math.isinf(dof) else f"{dof:.3g} degrees of freedom"


def class_error_figure(sides: Sides) -> Figure | None:
    """Classification error of every set of classes and features, both sides, with the bounds from distances."""
    both = side_products(sides, "classification")
    keys = list(dict.fromkeys([*both[1], *both[0]]))
    # Left end of the axis: below every error that was measured or predicted, and not below a millionth.
    least = min([1e-2, *(x for of_side in both for e in of_side.values() for x in (e.error, e.lower) if x > 0)])
    floor, under = max(least / 2.0, 1e-6), []
    bounded = {i: both[0][k] for i, k in enumerate(keys[:_MAX_ROWS]) if k in both[0] and both[0][k].bound_upper > 0}
    if bounded:
        numbers = np.array([(e.bound_lower, e.bound_upper, e.approximation) for e in bounded.values()])
        (low, high, estimate), place = np.maximum(numbers, floor).T, np.array(list(bounded), float)
        bars = {"left": low, "right": high, "bottom": place - 0.31, "top": place + 0.31}
        under.append(Mark("bars", bars, "bounds from the predicted distance"))
        under.append(Mark("dots", {"x": estimate, "y": place}, "estimate from it", marker="tick", along="x"))

    def entry(e: ClassificationError) -> Entry:
        value, low, high = (max(x, floor) for x in (e.error, e.lower, e.upper))
        return value, low, high, f"{e.error:.2g} ({e.lower:.2g} to {e.upper:.2g})"

    entries = [{key: entry(e) for key, e in of_side.items()} for of_side in both]
    x = Axis("probability of error", "log", ends=(floor / 1.4, 1.0))
    return dot_rows("class-error", keys, entries, x, under=under, floor=floor)


_MAX_POINTS = 200
_MAX_POPULATIONS = 12
_SPAN = 5.0  # standard deviations about the mean, where a density is not stated
_DEEPEST = 1e-8  # part of the greatest density
_BINS = 24
_PFA = "P_FA per background sample"
Key = tuple[str, str, str]


def roc_figure(sides: Sides, names: tuple[str, str] = SIDES) -> Figure | None:
    """P_D against P_FA on a logarithmic axis, a view for each subject, a tab for each detector and unit.

    Examples
    --------
    Of objects that are scored within a halo the background is counted by places.

    >>> pfa = np.array([0.1, 1.0])
    >>> curve = RocCurve(pfa, pfa, pfa, pfa, -pfa, n_target=3, n_background=10, unit="object")
    >>> made = roc_figure((None, Products(SpectralAxis([500.0], 10.0), roc={("lawn", "cem", "object"): curve})))
    >>> made.title, made.views[0].x.label, made.views[0].note
    ('ROC: measured (dotted: 1 / background samples)', 'P_FA per background sample', '3 objects, 10 background samples')
    """
    both, drawn, _ = drawn_products(sides, "roc")
    measured: Mapping[Key, RocCurve] = both[1]
    kinds = grouped(drawn, lambda key: key[1:])  # detector and unit
    # Two decades past what the background can resolve are enough.
    least = min((0.01 / c.n_background for c in measured.values() if c.n_background), default=0.0)
    views = []
    for curves in kinds.values():
        # Of too many those with the most targets, pools of targets among them.
        most = sorted(curves, key=lambda key: -(getattr(measured.get(key), "n_target", -1) or 0))
        chosen = most[: MAX_SUBJECTS // len(kinds) or 1]
        keys = [key for key in curves if key in chosen]
        lowest = min((float(c[k].pfa[c[k].pfa > 0].min()) for c in both for k in keys if k in c), default=1e-3)
        views += [_roc_view(key, [curves.get(key) for curves in both], max(lowest, least), names) for key in keys]
    if not views:
        return None
    title = f"ROC: {_present(both, names)}".replace(" and ", " (dashed) and ")
    title += " (dotted: 1 / background samples)" if any(curve.n_background for curve in measured.values()) else ""
    title += omissions(len(views), len({*both[0], *measured}))
    return Figure("roc", "roc", title, tuple(views), together="first")


def _roc_view(key: Key, curves: Sequence[RocCurve | None], low: float, names: tuple[str, str]) -> Panels:
    predicted, measured = curves
    marks = [] if predicted is None else [predicted_mark("line", _roc_columns(predicted, low), names[0])]
    note, background = "", None
    if measured is not None:
        # Steps are counted pixels; the second of two predictions is as smooth as the first.
        kind = "steps" if names[1] == SIDES[1] else "line"
        marks.append(measured_mark(kind, _roc_columns(measured, low), names[1]))
        background, n = measured.n_background, measured.n_target
        counted = (n, measured.unit + "s" * (n != 1)), (background, "background samples")
        note = ", ".join(f"{count_text(number)} {what}" for number, what in counted if number is not None)
    part = Part(Axis("P_D", ends=(-0.02, 1.04)), tuple(marks), (("x", 1.0 / background),) if background else ())
    x, tab = Axis(_PFA, "log", ends=(low, 1.0)), f"{key[1]}, by {key[2]}"
    return Panels(x, (part,), key[0], tab, note, reference=1e-3)


def _roc_columns(curve: RocCurve, low: float) -> dict[str, Array]:
    """At most a few hundred points of a curve, whose P_FA are evenly spread over the logarithm."""
    columns = {"x": curve.pfa, "y": curve.pd, "low": curve.pd_lower, "high": curve.pd_upper}
    return _thin({name: values[curve.pfa >= low] for name, values in columns.items()})


def roc_difference_figure(sides: Sides, margin: float | None) -> Figure | None:
    """Predicted minus measured P_D against P_FA with its 95 % interval, for the curves with the most targets."""
    predicted, measured = side_products(sides, "roc")
    rules: Rules = (("y", 0.0),) if margin is None else (("y", 0.0), ("y", -margin), ("y", margin))

    def view(key: Key) -> Panels:
        both = predicted[key], measured[key]
        low = max(both[0].pfa[0], both[1].pfa[both[1].pfa > 0].min(), 3.0 / (both[1].n_background or 3e9))
        pfa = np.geomspace(low, min(curve.pfa[-1] for curve in both), 120)
        detected = [[detection_at(c, pfa, values) for values in (c.pd, c.pd_lower, c.pd_upper)] for c in both]
        (p, p_low, p_high), (m, m_low, m_high) = detected
        d, below, above = p - m, np.hypot(p - p_low, m_high - m), np.hypot(p_high - p, m - m_low)
        columns = {"x": pfa, "y": d, "low": d - below, "high": d + above}
        line = Mark("line", columns, "predicted minus measured, 95 % interval", DIFFERENCE)
        x, y = Axis(_PFA, "log", ends=tuple(pfa[[0, -1]])), Axis("difference of P_D", ends=(-1.05, 1.05))
        return single_panel(x, y, [line], f"{key[0]}, {key[1]}, by {key[2]}", reference=1e-2, rules=rules)

    # Objects are independent and pixels of one object are not: curves by object first, where there are several.
    counts = {key: measured[key].n_target or 0 for key in predicted if key in measured}
    keys = sorted(counts, key=lambda key: (key[2] != "object" or counts[key] < 2, -counts[key]))
    dotted = "" if margin is None else f"dotted: equivalence margin {margin:g}"
    return figure_of_views("roc-difference", keys, view, dotted=dotted)


def exceedance_figure(sides: Sides) -> Figure | None:
    """Share of background pixels above a score, predicted and measured, on a logarithmic axis."""
    predicted, measured = side_products(sides, "exceedance")

    def view(key: tuple[str, str]) -> Panels:
        law, found, floor, span, rule = predicted[key], measured.get(key), 1e-6, None, None
        columns = {"x": law.threshold, "y": law.probability, "low": law.lower, "high": law.upper}
        marks = [predicted_mark("line", _thin(columns))]
        if found is not None:
            keep = found.probability > 0
            x, p = found.threshold[keep], found.probability[keep]
            low, high = np.nan_to_num(found.lower[keep], nan=1e-9), np.nan_to_num(found.upper[keep], nan=1.0)
            columns = {"x": x, "y": p, "low": np.maximum(low, 1e-9), "high": high}
            marks.insert(0, measured_mark("line", _thin(columns)))
            floor, span = 0.3 * float(p.min()), (1.05 * x[0] - 0.05 * x[-1], 1.35 * x[-1] - 0.35 * x[0])
            rule = x[np.argmin(np.abs(np.log(p) - math.log(1e-2)))]
        y = Axis("fraction of the background above", "log", ends=(floor, 1.0))
        return single_panel(Axis("score", ends=span), y, marks, ", ".join(key), reference=rule)

    keys = sorted(predicted, key=lambda key: key not in measured)
    intervals = "measured with its 95 % interval, by blocks of the image; predicted with that of its fitted law"
    return figure_of_views("exceedance", keys, view, intervals=intervals if measured else "")


def _thin(columns: dict[str, Any]) -> dict[str, Any]:
    """A curve of at most so many points, its ends among them."""
    size = columns["x"].size
    keep = np.unique(np.linspace(0, size - 1, min(size, _MAX_POINTS)).round().astype(int))
    return {name: values[keep] for name, values in columns.items()}


def score_figure(sides: Sides) -> Figure | None:
    """Mean and 95 % range of each population's score."""
    both = [{key: _entry(s.mean, s.sd, s.n) for key, s in side.items()} for side in side_products(sides, "scores")]
    return dot_rows("scores", shared_first(*both), both, Axis("score"), rules=(0.0, 1.0), sides=_present(both))


def abundance_figure(sides: Sides) -> Figure | None:
    """Area of each target from its abundance, where no nominal area is known."""
    both = [
        {k: _entry(a.area_m2, a.standard_uncertainty, a.n, " m²") for k, a in of_side.items() if a.nominal_m2 is None}
        for of_side in side_products(sides, "abundance")
    ]
    areas = np.array([area for of_side in both for area, *_ in list(of_side.values())[:_MAX_ROWS]])
    areas = areas[np.isfinite(areas)]
    scattered = areas.size > 0 and areas.min() > 0 and areas.max() > 30 * areas.min()
    x = Axis("area [m²]", "log", ends=(areas.min() / 4, areas.max() * 2.5)) if scattered else Axis("area [m²]")
    return dot_rows("abundance", shared_first(*both), both, x, rules=() if scattered else (0.0,), sides=_present(both))


def _entry(value: float, spread: float, n: int | None, unit: str = "") -> Entry:
    """A value with 1.96 times its spread to either side."""
    half, count = Z95 * spread, f", n = {count_text(n)}" if n else ""
    reach = float(np.nan_to_num(half))
    return value, value - reach, value + reach, f"{value:.3g} ± {half:.2g}{unit}{count}"


def _present(both: Sequence[Mapping[Any, Any]], names: tuple[str, str] = SIDES) -> str:
    """The names of the sides that have data."""
    return " and ".join(word for word, of_side in zip(names, both, strict=True) if of_side)


def unmixing_figure(sides: Sides, rows: Sequence[Result]) -> Figure | None:
    """Areas by unmixing against the nominal ones, and the root mean square error by size, by method."""
    both = [{k: a for k, a in of_side.items() if a.nominal_m2} for of_side in side_products(sides, "abundance")]

    def view(method: str) -> Panels:
        sized = grouped((key for key in both[1] if key[1] == method), lambda key: both[1][key].nominal_m2)
        # Targets of one area stand beside each other, within a quarter of a decade.
        sizes, words, place = np.array(sorted(sized)), [], dict[Any, float]()
        for area, keys in sized.items():
            place |= zip(keys, area * 10.0 ** np.linspace(-0.13, 0.13, len(keys) + 2)[1:-1], strict=True)
        above, below = list[Mark](), list[Mark]()
        styles = ((predicted_mark, "circle", "predicted", 0.97), (measured_mark, "square", "observed", 1.03))
        for of_side, (make, marker, name, shift) in zip(both, styles, strict=True):
            each = {key: of_side[key] for key in place if key in of_side}
            values = [(place[key], a.nominal_m2, a.area_m2, a.standard_uncertainty) for key, a in each.items()]
            rank, nominal, area, u = np.array(values).reshape(-1, 4).T
            columns = {"x": rank * shift, "y": area / nominal, "half": np.nan_to_num(Z95 * u / nominal)}
            labels = tuple(f"{key[0]}, {a.nominal_m2:g} m²" for key, a in each.items())
            above.append(make("dots", columns, marker=marker, words=labels))
            points = sorted((float(r.subject.removesuffix(" m2").rpartition(" ")[2]), r.value, r.lower, r.upper)
                            for r in rows if (r.method, r.metric) == (method, f"area_rmse_{name}"))  # fmt: skip
            below.append(make("line", to_columns(points), "", marker=marker))
            text = ", ".join(f"{value:.2g} m² at {size:g} m²" for size, value, *_ in points)
            words += [f"{name.replace('observed', 'measured')}: {text}"] if text else []
        ratio = Axis("estimated / nominal area", ends=(-0.6, 4.2))
        below.append(Mark("line", {"x": sizes, "y": sizes}, "as large as the target"))
        parts = Part(ratio, tuple(above), (("y", 1.0),)), Part(Axis("rms error [m²]", "log"), tuple(below))
        x = Axis("nominal area [m²]", "log", ends=(sizes[0] / 1.8, sizes[-1] * 1.8))
        return Panels(x, parts, method, words="; ".join(words))

    return figure_of_views("unmixing-areas", list(dict.fromkeys(m for _, m in both[1])), view)


def object_score_figure(sides: Sides) -> Figure | None:
    """Single objects: predicted median and 95 % interval of the score, and what was measured, a row each."""
    predicted, measured, outside = dict[Any, Entry](), dict[Any, Entry](), 0
    for key, draws, scores in _objects(sides):
        if len(scores) == 1:
            (low, middle, high), (_, score) = np.quantile(draws, [0.025, 0.5, 0.975]), scores[0]
            interval = f" ({low:.3g} to {high:.3g})" if low < high else ""
            predicted[key] = middle, low, high, f"{middle:.3g}{interval}"
            measured[key] = score, score, score, f"{score:.3g}"
            outside += not low <= score <= high
    about: dict[str, Any] = {"rules": (0.0,), "outside": outside, "count": len(predicted)}
    x = Axis("greatest score of the object")
    return dot_rows("object-scores", list(predicted), [predicted, measured], x, **about)


def transform_figure(sides: Sides) -> Figure | None:
    """Probability integral transforms of all objects in order, with a band, by detector."""
    objects = _objects(sides)

    def view(detector: str) -> Panels:
        pairs = [(draws, [score for _, score in scores]) for (_, name), draws, scores in objects if name == detector]
        u = np.sort(np.concatenate([probability_integral_transform(scores, draws) for draws, scores in pairs]))
        n, rank = u.size, np.arange(1, u.size + 1)
        expected = (rank - 0.5) / n
        low, high = (betaincinv(rank, n + 1 - rank, q) for q in (0.025, 0.975))
        marks = (
            predicted_mark("area", {"x": expected, "low": low, "high": high}, "95 % of independent objects"),
            Mark("line", {"x": [0.0, 1.0], "y": [0.0, 1.0]}, "uniform", dash="dotted"),
            measured_mark("line", {"x": expected, "y": u}, "objects, in order"),
        )
        x, y = (Axis(label, ends=(0.0, 1.0)) for label in ("uniform quantile", "probability integral transform"))
        return single_panel(x, y, marks, detector, f"{n} objects, {np.mean(in_central_95(u)):.0%} in the central 95 %")

    return figure_of_views("object-transforms", list(dict.fromkeys(detector for (_, detector), *_ in objects)), view)


def _objects(sides: Sides) -> list[tuple[tuple[str, str], Array, list[tuple[str, float]]]]:
    """(subject, detector), predicted draws, and name and measured score of each object of what both sides hold."""
    predicted, measured = side_products(sides, "object_scores")
    both = ((key, zip(measured[key].names, measured[key].values, strict=True)) for key in predicted if key in measured)
    finite = ((key, [(name, float(score)) for name, score in each if np.isfinite(score)]) for key, each in both)
    return [(key, predicted[key].values.ravel(), scores) for key, scores in finite if scores]


def many_objects_figure(maps: Mapping[str, ScoreMap], sides: Sides) -> Figure | None:
    """The objects of each score map at their places, coloured by measured minus predicted score, above the histogram
    of their scores; None where they are few.
    """
    found = {name: drawn for name, one in maps.items() if (drawn := _map_objects(name, one, sides)) is not None}
    return figure_of_views("objects", list(found), found.__getitem__)


def _map_objects(name: str, score_map: ScoreMap, sides: Sides) -> Panels | None:
    found, laws = list[tuple[str, float]](), list[tuple[int, Array]]()
    for (_, detector), draws, scores in _objects(sides):
        outlined = [one for one in scores if one[0] in score_map.outlines and name.endswith(f"-{detector}")]
        found += outlined
        laws += [(len(outlined), draws)] if outlined else []
    if min(len(found), len(score_map.outlines)) <= _MAX_ROWS:  # each has its place in a list
        return None
    names, measured = zip(*found, strict=True)
    median = np.repeat([np.median(draws) for _, draws in laws], [count for count, _ in laws])
    lines, samples = (float(n) for n in np.shape(score_map.values))
    places = [np.mean(divmod(np.flatnonzero(score_map.outlines[one]), samples), axis=1) for one in names]
    (line, sample), value = np.transpose(places) + 0.5, np.array(measured) - median
    reach = float(np.max(np.abs(value))) or 1.0
    labels = tuple(f"{one}: measured {m:.3g}, predicted median {p:.3g}"
                 for one, m, p in zip(names, measured, median, strict=True))  # fmt: skip
    scale = ColourScale("signed", -reach, reach, "measured − predicted")
    columns = {"x": sample, "y": line, "value": value}
    dots = Mark("dots", columns, marker="circle", words=labels, scale=scale, linked=True)
    parts = Part(Axis("line [pixel]", ends=(lines, 0.0)), (dots,)), _score_histogram(measured, laws, labels)
    words = f"{len(names)} objects, median measured {np.median(measured):.3g}, predicted {np.median(median):.3g}"
    return Panels(Axis("sample [pixel]", ends=(0.0, samples)), parts, name, words=words)


def _score_histogram(measured: Sequence[float], laws: Sequence[tuple[int, Array]], labels: tuple[str, ...]) -> Part:
    """Histogram of measured scores and of those that the prediction expects.

    Scores beyond the edges count in the outermost bins, so that both sum to the number of objects.
    """
    ends = np.concatenate([measured, *(np.quantile(draws, [0.005, 0.995]) for _, draws in laws)])
    edges = np.linspace(ends.min(), max(ends.max(), ends.min() + 1e-9), _BINS + 1)
    expected = sum(n * np.histogram(np.clip(d, edges[0], edges[-1]), edges)[0] / d.size for n, d in laws)
    counts = np.histogram(measured, edges)[0].astype(float)
    top, margin = 1.08 * float(max(counts.max(), np.max(expected))), 0.02 * (edges[-1] - edges[0])
    bins = {"left": edges[:-1], "right": edges[1:], "bottom": np.zeros(_BINS), "top": counts}
    dots = {"x": np.array(measured), "y": np.zeros(len(measured))}
    marks = (
        measured_mark("bars", bins, alpha=0.35),
        predicted_mark("steps", {"x": edges, "y": np.append(expected, np.ravel(expected)[-1])}),
        measured_mark("dots", dots, "", marker="circle", words=labels, linked=True),
    )
    x = Axis("greatest score over the object's pixels", ends=(float(edges[0] - margin), float(edges[-1] + margin)))
    return Part(Axis("number of objects", ends=(0.0, top)), marks, x=x)


def densities_figure(sides: Sequence[tuple[str, Products]]) -> Figure | None:
    """Densities of the detectors' scores, a view for each; None without any.

    A density that the product does not state is that of the normal law with its moments.  Sides after the first are
    dashed.
    """

    def view(detector: str) -> Panels:
        curves = []
        for number, (label, side) in enumerate(sides):
            drawn = [(subject, one) for (subject, name), one in side.scores.items() if name == detector and one.sd > 0]
            curves += [(label, number, subject, *score_density(one)) for subject, one in drawn[:_MAX_POPULATIONS]]
        subjects = list(dict.fromkeys(subject for _, _, subject, *_ in curves))
        top = max((float(np.nanmax(y)) for *_, y in curves), default=1.0)
        marks = tuple(
            Mark("line", {"x": x, "y": np.maximum(y, top * _DEEPEST / 10)},
                 f"{subject}, {label}" if len(sides) > 1 else subject,
                 CURVES[subjects.index(subject) % len(CURVES)], "dashed" if number else "solid")
            for label, number, subject, x, y in curves
        )  # fmt: skip
        y = Axis("density", "log", ends=(top * _DEEPEST, 2.0 * top))
        return single_panel(Axis(f"score of {detector}"), y, marks, detector)

    detectors = list(dict.fromkeys(detector for _, side in sides for _, detector in side.scores))
    return figure_of_views("densities", detectors, view)


def score_density(score: ScoreDistribution) -> tuple[Array, Array]:
    """Scores (G,) [1] and the probability density (G,) at each [per unit of score].

    Examples
    --------
    >>> score, density = score_density(ScoreDistribution(0.5, 0.1))
    >>> round(float(np.trapezoid(density, score)), 5)
    1.0
    """
    if score.grid is not None and score.density is not None:
        return score.grid, score.density
    z = np.linspace(-_SPAN, _SPAN, 201)
    return score.mean + score.sd * z, np.exp(-0.5 * z**2) / (score.sd * np.sqrt(2.0 * np.pi))


_MAX_INPUTS = 14
_MAX_QUANTITIES = 26
_LONGEST = 34  # characters of an input's name
# Twice a log-likelihood of 10.8 has one chance in a thousand by luck, for one direction.
_TELLING = 10.8


def attribution_figures(table: ResultTable) -> list[Figure | None]:
    """Bars of all residuals together, a matrix of single subjects, effects of inputs, what-ifs."""
    gains = table.where(product="attribution", metric="likelihood_gain")
    common = sorted(gains.where(subject="all"), key=lambda r: -r.value)
    moved = ResultTable(r for r in table if math.isfinite(r.before))  # older tables say it in words alone
    tests, moves = moved.where(metric="reduced_chi_square"), moved.where(product="sensitivity")
    residuals = sorted(tests.where(product="attribution"), key=lambda r: -r.before)[:_MAX_QUANTITIES]
    outcomes = tests.where(product="what-if")
    return [
        _chi_square_figure("residuals", residuals, [r.subject for r in residuals]),
        _input_figure(common[:_MAX_INPUTS], table) if common and common[0].value >= 1.0 else None,
        _gain_figure(table),
        _subject_matrix([r for r in gains if r.subject != "all"]),
        _effect_matrix(moves) if moves else None,
        _chi_square_figure("what-ifs", outcomes, [r.method for r in outcomes]),
    ]


def _input_figure(rows: Sequence[Result], table: ResultTable) -> Figure:
    needed = table.where(product="attribution", metric="needed_uncertainty")
    stated, names = {r.method for r in needed if r.cause is not Cause.NO_UNCERTAINTY}, [r.method for r in rows]
    best, place, ends = rows[0], np.arange(float(len(rows))), np.array([max(r.value, 0.1) for r in rows])
    columns = {"left": np.full(place.size, 0.1), "right": ends, "bottom": place - 0.35, "top": place + 0.35}
    # An input that explains nothing has nothing to say, however far it moves.
    words = [r.reason.partition("; ")[0].partition(": ")[2] if r.value >= 1.0 else "" for r in rows]
    bars = Mark("bars", columns, words=tuple(text.replace("-", "−") for text in words), beside="right", alpha=0.85)
    marks = bars.split([name in stated for name in names], LOOKS["stated"])
    caption = ", ".join(f"{r.method} ({r.value:.3g})" for r in rows[:4])
    is_numbered = any(name.endswith(")") and name.rpartition("(")[2][:-1].isdigit() for name in names)
    numbered = "; a number in brackets: one of several independent shapes of an error" * is_numbered
    x = Axis("improvement of the fit to the differences", "log", ends=(0.1, max(best.value * 100.0, 30.0)))
    y = Axis.named(names, _LONGEST)
    return row_figure("attribution-inputs", x, y, marks, caption, rules=(_TELLING,), numbered=numbered)


def _gain_figure(table: ResultTable) -> Figure | None:
    """The gain of the sensor that would explain the radiance of all subjects, over wavelength."""

    def marks(name: str, label: str, **look: Any) -> list[Mark]:
        rows = [r for r in table.where(product="radiance") if r.metric.startswith(f"{name}@")]
        columns = to_columns([(float(r.metric.partition("@")[2]), r.value, r.lower, r.upper) for r in rows])
        return [Mark("dots", columns, f"{label}, 95 % interval", marker="circle", **look)] if rows else []

    gains = marks("sensor_gain", "gain without an offset", colour=DIFFERENCE)
    gains += marks("sensor_gain_beside_offset", "gain beside the offset below", hollow=True)
    if not gains:
        return None
    nm, gain, low, high = gains[0].columns.values()
    far = int(np.argmax(np.abs(gain - 1.0)))
    words = f"gain farthest from 1: {gain[far]:.2f} ({low[far]:.2f} to {high[far]:.2f}) at {nm[far]:.0f} nm"
    parts = [Part(Axis("measured / predicted radiance"), tuple(gains), (("y", 1.0),))]
    for mark in marks("sensor_offset", "offset beside that gain", hollow=True):
        parts.append(Part(Axis("offset [µW cm⁻² sr⁻¹ nm⁻¹]"), (mark,), (("y", 0.0),)))
    return compose("sensor-gain", [Panels(Axis(WAVELENGTH), tuple(parts), words=words)])


def _subject_matrix(rows: Sequence[Result]) -> Figure | None:
    """A matrix of subjects by inputs: the area of a dot is its gain relative to the greatest of its row."""
    gain_of = {(r.subject, r.method): r.value for r in rows}
    # A gain below 1 explains nothing: subjects without a greater one are left out.
    telling = list(dict.fromkeys(r.subject for r in rows if r.value >= 1.0))
    if not telling:
        return None
    subjects = telling[:_MAX_QUANTITIES]
    best = {n: max(r.value for r in rows if r.method == n) for n in dict.fromkeys(r.method for r in rows)}
    # The best input of a subject has its column, however small its gain elsewhere.
    top = {s: max(best, key=lambda n: gain_of.get((s, n), 0.0)) for s in subjects}
    inputs = sorted((n for n in best if best[n] > 0.0), key=lambda n: (n not in top.values(), -best[n]))[:_MAX_INPUTS]
    gains = np.array([[gain_of.get((s, n), 0.0) for n in inputs] for s in subjects])
    part = gains / np.array([[gain_of[s, n]] for s, n in top.items()])
    cells = np.nonzero(gains > 0.0)
    columns = {"x": cells[1].astype(float), "y": cells[0].astype(float), "size": 14.0 * np.sqrt(part[cells])}
    words = tuple(f"{gain:.0f}" if gain >= 10.0 else f"{gain:.2g}" for gain in gains[cells])
    marks = Mark("dots", columns, marker="circle", words=words).split(part[cells] >= 0.999, LOOKS["greatest"])
    quiet = len({r.subject for r in rows}) - len(telling)
    more = f"; {quiet} subjects have nothing to explain" if quiet else ""
    more += omissions(len(subjects), len(telling), "results.csv")
    names = Axis.named(inputs, _LONGEST), Axis.named(subjects, _LONGEST)
    summary = f"input of the greatest gain: {'; '.join(f'{s}: {n}' for s, n in top.items())}"
    return row_figure("attribution-subjects", *names, marks, summary, quiet=more)


def _effect_matrix(rows: Sequence[Result]) -> Figure:
    """Change of each number of the comparison per unit of each input, as a matrix of colours."""

    def label(r: Result) -> str:
        what = product_words(r.metric.removesuffix("_change").removesuffix("_ratio_windows"))
        way = r.method.partition(" / ")[2].removesuffix("/pixel")
        return ", ".join(filter(None, (r.subject, what.replace("roc_pd@", "P_D at P_FA "), way)))

    gaps = {label(r): r.before for r in rows}
    shown = sorted(gaps, key=lambda q: -abs(gaps[q]))[:_MAX_QUANTITIES]
    change = {(label(r), r.method.partition(" / ")[0]): r.value for r in rows}
    names = sorted(dict.fromkeys(n for _, n in change), key=lambda n: -max(abs(change.get((q, n), 0.0)) for q in shown))
    names = names[:_MAX_INPUTS]
    y, x = (place.ravel().astype(float) for place in np.mgrid[: len(shown), : len(names)])
    values = 100.0 * np.array([change.get((q, n), math.nan) for q in shown for n in names])
    words = tuple(short_text(v, "+") if abs(v) >= 0.05 else "" for v in values)
    # The colour scale ends at the 97th percentile: an outlier would leave little of it for the others.
    finite = np.abs(values[np.isfinite(values)])
    most = max(float(np.percentile(finite, 97)) if finite.size else 0.0, 1e-6)
    columns = {"left": x - 0.5, "right": x + 0.5, "bottom": y - 0.5, "top": y + 0.5, "value": values}
    cells = Mark("cells", columns, words=words, beside="centre", scale=ColourScale("signed", -most, most, "change [%]"))
    largest = max(((abs(v), q, n) for (q, n), v in change.items() if q in shown), default=(0.0, "", ""))
    text = f"the largest, {short_text(100.0 * largest[0])} %, is that of {largest[1]} by {largest[2]}"
    named_gaps = Axis.named([f"{q} (gap {short_text(100.0 * gaps[q], '+')} %)" for q in shown], 64)
    return row_figure("attribution-effects", Axis.named(names, _LONGEST), named_gaps, [cells], text)


def _chi_square_figure(kind: str, rows: Sequence[Result], names: list[str]) -> Figure | None:
    """Reduced chi-square of each row, and what it was before.

    >>> names = [f"roc of green-fill-0.100 background cem{more}" for more in ("", "-correlation")]
    >>> one = Result("attribution", "", "", "", "reduced_chi_square", 2.0, before=3.0)
    >>> _chi_square_figure("what-ifs", [one, one], names).views[0].parts[0].y.names[1]
    'roc of green-fill-0.100 background cem-correlation'
    """
    if not rows:
        return None
    (before, after), place = np.array([(r.before, r.value) for r in rows]).T, np.arange(float(len(rows)))
    start = Mark("dots", {"x": before, "y": place}, "as in the campaign", marker="circle", hollow=True)
    columns = {"x": after, "y": place, "low": np.minimum(before, after), "high": np.maximum(before, after)}
    end = Mark("dots", columns, along="x", words=tuple(f"{v:.3g}" if v < 1e3 else count_text(round(v)) for v in after))
    marks = [start, *end.split(after < before, LOOKS["closer"])]
    both = [v for v in (*before, *after) if v > 0]
    scattered = bool(both) and max(both) > 20.0 * min(both)
    x = Axis("reduced chi-square", "log" if scattered else "linear")
    words = "; ".join(f"{one} from {b:.3g} to {r.value:.3g}" for one, r, b in zip(names, rows, before, strict=True))
    return row_figure(kind, x, Axis.named(names, 64), marks, words, rules=(1.0,), method=rows[0].method)


def first_figures(sides: Sides, table: ResultTable | None = None, names: tuple[str, str] = SIDES) -> list[Figure]:
    """Spectra and ROC curves; subjects about which more is amiss in ``table`` come first.

    ``names`` : what the two sides are, where they are no prediction and collection
    """
    spectra = (spectra_figure(sides, product, table or (), names) for product in SPECTRA)
    return list(filter(None, [*spectra, roc_figure(sides, names)]))


def further_figures(sides: Sides, table: ResultTable, margin: float | None) -> list[Figure]:
    """What else the products and the rows of a run give, with its margin of P_D."""
    return list(filter(None, [
        budget_figure(sides), *(eigenvalue_figure(sides, quantity) for quantity in SPREAD), tail_figure(sides),
        class_error_figure(sides), score_figure(sides), object_score_figure(sides), transform_figure(sides),
        exceedance_figure(sides), roc_difference_figure(sides, margin), abundance_figure(sides),
        unmixing_figure(sides, list(table.where(product="abundance"))), *attribution_figures(table),
    ]))  # fmt: skip
