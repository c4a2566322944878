"""Every stated plot of a run, in the order of the report.

The uncertainty budget of the radiance: total by source, a plot for each subject and side.

Plots of how pixels spread about the mean of their class: eigenvalues and tails.

Plots of what the spread of pixels does to a user: classes taken for each other, areas of targets.

Plots of the reasons: which input explains the residuals, sensitivities, what-ifs before and after.

Plots of verdicts on detection: objects and background against their predicted scores, P_D differences.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import betaincinv

from hyperval.processing.roc_model import detection_at
from hyperval.products import ClassificationError, ExceedanceCurve, Products, RocCurve, SpectralEstimate
from hyperval.report import style
from hyperval.report.plots import (
    COVERAGE,
    GREY,
    Axis,
    Mark,
    Part,
    Plots,
    SubjectView,
    both_sides,
    measured_mark,
    predicted_mark,
    rows_axis,
)
from hyperval.report.run import MOST_EIGENVALUES, EigenvalueSpectrum, Sides, TailCurve, both_first, eigenvalues, of_side
from hyperval.report.style import COLLECTED, DIFFERENCE_COLOUR, MAX_PANELS, PREDICTED, left_out
from hyperval.results import Result, ResultTable
from hyperval.spectra.axis import in_window

Array = npt.NDArray[np.float64]
_MOST_SOURCES = 7


def budget_plots(sides: Sides) -> list[Plots]:
    """Relative uncertainty of the radiance by source, stacked to the total."""
    estimates = [of_side(side, "radiance") for side in sides]
    every = both_first(*estimates)
    panels: dict[str, tuple[Products, SpectralEstimate]] = {}
    for subject in [s for s in every if all(s in side for side in estimates)] or every:
        for name, side in (("predicted", sides[0]), ("collected", sides[1])):
            if side is not None and subject in side.radiance and side.radiance[subject].budget:
                panels[f"{subject} ({name})"] = side, side.radiance[subject]
    if not panels:
        return []
    shown = dict(list(panels.items())[: style.MAX_PANELS])
    sources = _ranked_sources([estimate for _, estimate in shown.values()])
    label = style.band_label(next(iter(shown.values()))[0].axis)
    title = "Uncertainty budget of the radiance (height: total; colour: share of the variance)"
    return [Plots(
        "radiance-budget", "radiance", title + style.left_out([list(shown)], list(panels)),
        "Relative standard uncertainty of the radiance against wavelength, stacked by source in proportion to its "
        f"share of the variance. Sources, largest first: {', '.join(sources)}. Panels: {', '.join(shown)}.",
        {name: _stack(side, estimate, sources, label) for name, (side, estimate) in shown.items()},
    )]  # fmt: skip


def _stack(side: Products, estimate: SpectralEstimate, sources: Sequence[str], label: str) -> SubjectView:
    w, parts = side.axis.centre_nm, _variance_parts(estimate, sources)
    with np.errstate(invalid="ignore", divide="ignore"):
        total = np.sqrt(parts.sum(axis=0))
        # Variances add, uncertainties do not: each source takes its share of the variance in the height.
        heights = np.nan_to_num(100.0 * total / np.abs(estimate.mean) * parts / parts.sum(axis=0))
    edges = np.concatenate([np.zeros((1, w.size)), np.cumsum(heights, axis=0)])
    marks = tuple(
        Mark("area", {"x": w, "low": low, "high": high}, source, colour, alpha=1.0)
        for low, high, source, colour in zip(edges[:-1], edges[1:], sources, style.SOURCE_COLOURS, strict=False)
    )
    keep = in_window(w) if in_window(w).any() else np.ones(w.shape, bool)
    limits = style.robust_limits([edges[-1][keep]], zero=True)
    x = Axis(label, ends=(float(w[0]), float(max(w[-1], w[0] + 1.0))))
    return SubjectView(x, (Part(Axis("standard uncertainty [% of radiance]", ends=limits), marks),))


def _variance_parts(estimate: SpectralEstimate, sources: Sequence[str]) -> Array:
    """(S, B) variance by source; the last is everything that has no place of its own."""
    parts = [np.asarray(estimate.budget.get(s, np.zeros(estimate.mean.shape)), dtype=float) ** 2 for s in sources]
    if sources[-1] == "other sources":
        named = set(sources[:-1])
        rest = [np.asarray(u, dtype=float) ** 2 for s, u in estimate.budget.items() if s not in named]
        parts[-1] = np.sum(rest, axis=0) if rest else parts[-1]
    return np.stack(parts)


def _ranked_sources(estimates: Sequence[SpectralEstimate]) -> list[str]:
    """Sources by their largest median share of the variance, the small ones taken together."""
    weight: dict[str, float] = {}
    for estimate in estimates:
        squares = {s: float(np.nanmedian(np.square(u) / np.square(estimate.mean))) for s, u in estimate.budget.items()}
        total = sum(squares.values()) or 1.0
        for source, square in squares.items():
            weight[source] = max(weight.get(source, 0.0), square / total)
    ranked = sorted(weight, key=lambda s: (-weight[s], s))
    if len(ranked) > _MOST_SOURCES:
        ranked = [*ranked[: _MOST_SOURCES - 1], "other sources"]
    return ranked


_UNITS = {"radiance": "(µW cm⁻² sr⁻¹ nm⁻¹)²", "reflectance": "1"}


def sampled_eigenvalue_plots(spectra: Mapping[tuple[str, str], EigenvalueSpectrum]) -> list[Plots]:
    """Eigenvalues of both sides; below each, predicted over measured with the band that chance alone gives."""
    made = []
    for quantity, unit in _UNITS.items():
        own = {subject: s for (subject, q), s in spectra.items() if q == quantity}
        words, views = [], {}
        for subject, s in own.items():
            inside = int(np.sum((s.measured >= s.lower) & (s.measured <= s.upper)))
            words.append(
                f"{subject}: first eigenvalue predicted {s.expected[0]:.3g}, measured {s.measured[0]:.3g}; "
                f"{inside} of {s.measured.size} inside"
            )
            views[f"{subject} (n = {_count(s.n)})"] = _eigenvalues(s, unit)
        if views:
            made.append(Plots(
                f"{quantity}-eigenvalues", "covariance",
                f"Eigenvalues of the {quantity} covariance (band: 95 % of samples of as many independent "
                "pixels drawn from the prediction)",
                f"Leading eigenvalues of the pixel-to-pixel covariance of the {quantity}, logarithmic, predicted "
                "(hollow circles, with the 95 % band of samples of as many pixels) and measured (squares); below, "
                f"predicted over measured with that band. {'. '.join(words)}.", views,
            ))  # fmt: skip
    return made


def eigenvalue_plots(sides: Sides) -> list[Plots]:
    """Eigenvalues of the pixel covariance of the radiance of both sides, where no band of chance is known."""
    spectra = [{k: e for k, e in of_side(side, "radiance").items() if e.pixel_covariance is not None} for side in sides]
    every = both_first(*spectra)
    pairs = [subject for subject in every if all(subject in own for own in spectra)]
    views, words = {}, []
    for subject in (every if None in sides else pairs)[:MAX_PANELS]:
        marks, firsts = [], []
        for own, mark, marker in zip(spectra, (predicted_mark, measured_mark), ("circle", "square"), strict=True):
            if subject in own:
                n, values = own[subject].n, eigenvalues(own[subject])
                # Large-sample variance of an eigenvalue of a normal sample covariance: 2 lambda^2 / (n - 1).
                factor = math.exp(COVERAGE * math.sqrt(2.0 / (n - 1))) if n is not None and n > 1 else 1.0
                columns = {"x": np.arange(1.0, values.size + 1), "y": values}
                marks.append(mark("line", columns | {"low": values / factor, "high": values * factor}, marker=marker))
                firsts.append(f"{values[0]:.3g}" if values.size else "none")
        x = Axis("number of the eigenvalue [1]", ends=(0.0, MOST_EIGENVALUES + 1.0))
        views[subject] = SubjectView(x, (Part(Axis(f"eigenvalue [{_UNITS['radiance']}]", "log"), tuple(marks)),))
        words.append(f"{subject} {' and '.join(firsts)}")
    if not views:
        return []
    return [Plots(
        "radiance-eigenvalues", "covariance",
        "Eigenvalues of the pixel covariance (band: 95 % sampling interval, pixels taken as independent)"
        + left_out([list(views)], pairs or every),
        f"The largest {MOST_EIGENVALUES} eigenvalues of the pixel-to-pixel covariance of the radiance, on a "
        f"logarithmic scale. Largest: {'; '.join(words)}.", views,
    )]  # fmt: skip


def tail_plots(tails: Mapping[str, TailCurve]) -> list[Plots]:
    """Share of pixels beyond a Mahalanobis distance: measured, as predicted, normal, and the t that fits best."""
    views, words = {}, []
    for subject, t in list(tails.items())[:MAX_PANELS]:
        views[f"{subject}: {t.dimension} components, n = {_count(t.n)}"] = _tails(t)
        predicted = "" if t.predicted_dof is None else f", {_dof(t.predicted_dof)} predicted"
        words.append(f"{subject}: {_dof(t.fitted_dof)} measured{predicted}")
    if not views:
        return []
    return [Plots(
        "pixel-tails", "covariance",
        "Tails of the pixels in the leading components (interval: binomial, pixels taken as independent)",
        "Share of a class's pixels beyond a Mahalanobis distance in the leading components, logarithmic: measured "
        f"with its 95 % interval, under the predicted law, the normal law, and the fitted t. {'; '.join(words)}.",
        views,
    )]  # fmt: skip


def _eigenvalues(s: EigenvalueSpectrum, unit: str) -> SubjectView:
    number = np.arange(1.0, s.measured.size + 1)
    expected = {"x": number, "y": s.expected, "low": s.lower, "high": s.upper}
    above = (
        predicted_mark("line", expected, "predicted, mean and 95 % of samples", marker="circle"),
        measured_mark("line", {"x": number, "y": s.measured}, marker="square"),
    )
    ratio = {
        "x": number,
        **{k: v / s.measured for k, v in zip(("y", "low", "high"), list(expected.values())[1:], strict=True)},
    }
    below = Mark("line", ratio, colour=DIFFERENCE_COLOUR)
    return SubjectView(
        Axis("number of the eigenvalue [1]", ends=(0.0, number[-1] + 1.0)),
        (
            Part(Axis(f"eigenvalue [{unit}]", "log"), above),
            Part(Axis("predicted / measured [1]"), (below,), (("y", 1.0),)),
        ),
    )


def _tails(t: TailCurve) -> SubjectView:
    measured = {"x": t.distance, "y": t.measured, "low": t.lower, "high": t.upper}
    predicted = np.full(t.distance.size, np.nan) if t.predicted is None else t.predicted
    marks = (
        measured_mark("line", measured, "measured, with its 95 % interval"),
        predicted_mark("line", {"x": t.distance, "y": predicted}, "predicted law"),
        Mark("line", {"x": t.distance, "y": t.normal}, "normal law", GREY, "dotted"),
        Mark("line", {"x": t.distance, "y": t.fitted}, "fitted t", DIFFERENCE_COLOUR, "dashdot"),
    )
    x = Axis("Mahalanobis distance [1]", ends=(0.0, float(t.distance[-1]) * 1.03))
    return SubjectView(x, (Part(Axis("share of pixels farther out [1]", "log", ends=(0.3 / t.n, 1.5)), marks),))


def _count(n: int) -> str:
    return f"{n:,}".replace(",", "\u202f")


def _dof(dof: float) -> str:
    return "normal" if math.isinf(dof) else f"{dof:.3g} degrees of freedom"


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
    view = SubjectView(x, (Part(rows, (*marks, *both_sides(predicted, measured, dots))),))
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
                mark("dots", columns, marker=marker, words=tuple(f"{key[0]}, {a.nominal_m2:g} m²" for key, a in each))
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
        views[method] = SubjectView(x, (
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
    view = SubjectView(x, (Part(rows_axis([", ".join(key) for key in keys]), marks, tuple(("x", at) for at in rules)),))
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


_MOST_INPUTS = 14
_MOST_GROUPS = 26
_MOST_QUANTITIES = 26
_STATED, _UNSTATED = "#0072B2", "#E69F00"
_BEST, _OTHER = "#C2410C", "#8aa4b8"
_BETTER, _WORSE = "#2e8b57", "#c0392b"
_ALL = "all"
_LONGEST = 34  # characters of an input's name
# Twice a log-likelihood of 10.8 has one chance in a thousand by luck, for one direction.
_TELLING = 10.8


def reason_plots(table: ResultTable) -> list[Plots]:
    """Bars of all residuals together, a matrix of single subjects, effects of inputs, what-ifs."""
    gains = [r for r in table.where(product="attribution") if r.metric == "likelihood_gain"]
    whole = sorted((r for r in gains if r.subject == _ALL), key=lambda r: -r.value)
    single = [r for r in gains if r.subject != _ALL]
    moves = [r for r in table.where(product="sensitivity") if r.metric.endswith("_change")]
    outcomes = [r for r in table.where(product="what-if") if r.metric == "reduced_chi_square"]
    made = (
        _inputs(whole[:_MOST_INPUTS], table) if whole else None,
        _by_subject(single) if single else None,
        _effects(moves) if moves else None,
        _what_ifs(outcomes) if outcomes else None,
    )
    return [plots for plots in made if plots is not None]


def _inputs(rows: Sequence[Result], table: ResultTable) -> Plots:
    stated, names = _stated(table), [r.method for r in rows]
    marks = []
    for colour, label, own in (
        (_STATED, "uncertainty stated", [i for i, name in enumerate(names) if name in stated]),
        (_UNSTATED, "none stated: usual step", [i for i, name in enumerate(names) if name not in stated]),
    ):
        if own:
            at, ends = np.array(own, float), np.array([max(rows[i].value, 0.1) for i in own])
            columns = {"left": np.full(at.size, 0.1), "right": ends, "bottom": at - 0.35, "top": at + 0.35, "y": at}
            # An input that explains nothing has nothing to say, however far it moves.
            words = [rows[i].reason.partition("; ")[0].partition(": ")[2] if rows[i].value >= 1.0 else "" for i in own]
            words = [text.replace("-", "−") for text in words]
            marks.append(Mark("bars", columns, label, colour, words=tuple(words), beside=True, alpha=0.85))
    best = rows[0]
    alt = f"Bars of the likelihood gained by freeing each input, all residuals together: {best.method} gains most"
    alt += f" ({best.value:.3g}); then " + ", ".join(f"{r.method} ({r.value:.3g})" for r in rows[1:4]) + "."
    legend = "dotted: one chance in a thousand by luck"
    legend += "; a number in brackets is one of several independent shapes of an error" if _numbered(names) else ""
    x = Axis("likelihood gained, 2 Δ ln L [1]", "log", ends=(0.1, max(max(r.value for r in rows) * 30.0, 30.0)))
    return Plots(
        "attribution-inputs",
        "attribution",
        "Which input, were it less well known, would explain the differences",
        alt,
        {"": SubjectView(x, (Part(rows_axis(names, _LONGEST), tuple(marks), (("x", _TELLING),)),))},
        legend,
    )


def _by_subject(rows: Sequence[Result]) -> Plots | None:
    """A matrix of subjects by inputs: the area of a dot is the part of the greatest gain of its row."""
    by = {(r.subject, r.method): r.value for r in rows}
    # A gain below 1 explains nothing; subjects without any greater one have nothing to explain.
    telling = {r.subject for r in rows if r.value >= 1.0}
    every = [s for s in dict.fromkeys(r.subject for r in rows) if s in telling]
    if not every:
        return None
    subjects = every[:_MOST_GROUPS]
    best: dict[str, float] = {}
    for r in rows:
        best[r.method] = max(best.get(r.method, 0.0), r.value)
    inputs = sorted((n for n in best if best[n] > 0.0), key=lambda n: -best[n])[:_MOST_INPUTS] or list(best)[:1]
    dots: dict[bool, list[tuple[float, float, float, str]]] = {False: [], True: []}
    for i, subject in enumerate(subjects):
        top = max((by.get((subject, n), 0.0) for n in inputs), default=0.0)
        for j, name in enumerate(inputs):
            gain = by.get((subject, name), 0.0)
            if gain > 0.0 and top > 0.0:
                size = 14.0 * math.sqrt(gain / top)
                dots[gain >= 0.999 * top].append((j, i, size, _short(gain)))
    marks = []
    for first, label, colour in (
        (False, "part of it", _OTHER),
        (True, "greatest gain of a subject, 2 Δ ln L", _BEST),
    ):
        if dots[first]:
            x, y, sizes, words = zip(*dots[first], strict=True)
            columns = {"x": np.array(x, float), "y": np.array(y, float), "size": np.array(sizes)}
            marks.append(Mark("dots", columns, label, colour, marker="circle", words=words, beside=first))
    tops = {s: max(inputs, key=lambda n: by.get((s, n), 0.0)) for s in subjects}
    legend = "the area of a dot is the gain as a part of the greatest of its subject"
    quiet = len({r.subject for r in rows}) - len(every)
    if quiet:
        legend += f"; {quiet} subjects have nothing to explain"
    if len(every) > len(subjects):
        legend += f"; {len(subjects)} of {len(every)} are drawn, all are in results.csv"
    return Plots(
        "attribution-subjects",
        "attribution",
        "The same for each subject by itself",
        "For each subject the input that gains most: " + "; ".join(f"{s}: {n}" for s, n in tops.items()) + ".",
        {"": SubjectView(rows_axis(inputs, _LONGEST), (Part(rows_axis(subjects, _LONGEST), tuple(marks)),))},
        legend,
    )


def _effects(rows: Sequence[Result]) -> Plots:
    """Change of each number of the comparison per unit of each input, as a matrix of colours."""

    def label(r: Result) -> str:
        what = r.metric.removesuffix("_change").replace("roc_pd@", "P_D ").removesuffix("_ratio_windows")
        way = r.method.partition(" / ")[2].removesuffix("/pixel")
        return f"{r.subject}, {what}" + (f" {way}" if way else "")

    every = list(dict.fromkeys(label(r) for r in rows))
    gaps = {label(r): _gap(r) for r in rows}
    shown = sorted(every, key=lambda q: -gaps[q])[:_MOST_QUANTITIES]
    by = {(label(r), r.method.partition(" / ")[0]): r.value for r in rows}
    names = list(dict.fromkeys(r.method.partition(" / ")[0] for r in rows))
    names = sorted(names, key=lambda n: -max(abs(by.get((q, n), 0.0)) for q in shown))[:_MOST_INPUTS]
    y, x = (place.ravel().astype(float) for place in np.mgrid[: len(shown), : len(names)])
    values = np.array([by.get((q, n), math.nan) for q in shown for n in names])
    words = tuple(_change(value) for value in values)
    cells = Mark("cells", {"x": x, "y": y, "value": values}, words=words, beside=True)
    largest = max(((abs(v), q, n) for (q, n), v in by.items() if q in shown), default=(0.0, "", ""))
    alt = f"Change of {len(shown)} numbers of the comparison per unit of {len(names)} inputs; the largest, "
    alt += f"{largest[0]:.2g}, is that of {largest[1]} by {largest[2]}."
    legend = "one unit: the stated standard uncertainty of an input, or a usual step where none is stated; "
    legend += "gap: predicted less measured; spectra as a part of the collected mean, P_D as it stands; "
    legend += "the largest gaps are shown"
    quantities = [f"{q} (gap {gaps[q]:.2g})" for q in shown]
    return Plots(
        "attribution-effects",
        "sensitivity",
        "What one unit of each input moves",
        alt,
        {"": SubjectView(rows_axis(names, _LONGEST), (Part(rows_axis(quantities, 56), (cells,)),))},
        legend,
    )


def _what_ifs(rows: Sequence[Result]) -> Plots:
    before = np.array([_leading_number(r.reason) for r in rows])
    after, at = np.array([r.value for r in rows]), np.arange(float(len(rows)))
    marks = [Mark("dots", {"x": before, "y": at}, "as the campaign has it", marker="circle", hollow=True)]
    for own, label, colour, marker in (
        (after < before, "after, closer", _BETTER, "left"), (~(after < before), "after, farther", _WORSE, "right")
    ):  # fmt: skip
        if own.any():
            ends = {"low": np.minimum(before, after)[own], "high": np.maximum(before, after)[own]}
            words = tuple(f"{value:.3g}" for value in after[own])
            marks.append(Mark("dots", {"x": after[own], "y": at[own], **ends}, label, colour, marker=marker,
                              along="x", words=words, beside=True))  # fmt: skip
    both = [v for v in (*before, *after) if v > 0]
    scattered = bool(both) and max(both) > 20.0 * min(both)
    x = Axis(
        "reduced chi-square of all residuals [1]",
        "log" if scattered else "linear",
    )
    each = (f"{r.method} from {b:.3g} to {r.value:.3g}" for r, b in zip(rows, before, strict=True))
    return Plots(
        "what-ifs",
        "what-if",
        "What-ifs: the gap before and after",
        "Reduced chi-square of all residuals before and after each what-if: " + "; ".join(each) + ".",
        {"": SubjectView(x, (Part(rows_axis([r.method for r in rows]), tuple(marks), (("x", 1.0),)),))},
        "dotted: 1, which the uncertainties allow",
    )


def _change(value: float) -> str:
    if not abs(value) >= 0.0005:
        return ""
    return f"{value:+.2g}" if abs(value) >= 0.001 else f"{value:+.1g}"


def _short(gain: float) -> str:
    """Two digits, without a power of ten."""
    return f"{gain:.0f}" if gain >= 10.0 else f"{gain:.2g}"


def _numbered(names: Sequence[str]) -> bool:
    return any(name.endswith(")") and name.rpartition("(")[2][:-1].isdigit() for name in names)


def _stated(table: ResultTable) -> set[str]:
    rows = [r for r in table.where(product="attribution") if r.metric == "needed_uncertainty"]
    return {r.method for r in rows if "none is stated" not in r.reason}


def _leading_number(text: str) -> float:
    try:
        return float(text.split()[0].rstrip(",;"))
    except (IndexError, ValueError):
        return math.nan


def _gap(row: Result) -> float:
    """The gap that the row's reason tells, as a size."""
    return abs(_leading_number(row.reason.partition("gap ")[2]))


_MOST_OBJECTS = 40
_MOST_POINTS = 200


def object_score_plots(sides: Sides) -> list[Plots]:
    """Single objects: predicted 95 % interval of the score and what was measured, a row each."""
    pairs = [(key, p, float(m[0])) for key, p, m in _objects(sides) if m.size == 1]
    shown = pairs[:_MOST_OBJECTS]
    if not shown:
        return []
    names = [", ".join(key) for key, *_ in shown]
    at, measured = np.arange(float(len(shown))), np.array([m for *_, m in shown])
    low, middle, high = np.array([np.quantile(draws, [0.025, 0.5, 0.975]) for _, draws, _ in shown]).T
    inside = (low <= measured) & (measured <= high)
    words = [
        f"{name.replace(',', '')}: {m:.3g}, predicted {a:.3g} to {b:.3g}{'' if within else ', outside'}"
        for name, m, a, b, within in zip(names, measured, low, high, inside, strict=True)
    ]
    interval = {"left": low, "right": high, "bottom": at - 0.2, "top": at + 0.2, "y": at}
    marks = [
        Mark("bars", interval, "predicted 95 %", PREDICTED.colour, alpha=0.3, words=tuple(words)),
        Mark("dots", {"x": middle, "y": at}, "predicted median", PREDICTED.colour, marker="tick"),
    ]
    for own, label in ((inside, "measured"), (~inside, "measured, outside")):
        if own.any():
            own_words = tuple(text for text, one in zip(words, own, strict=True) if one)
            columns = {"x": measured[own], "y": at[own]}
            marks.append(
                measured_mark("dots", columns, label, marker="square", hollow=own is not inside, words=own_words)
            )
    view = SubjectView(Axis("greatest score of the object [1]"), (Part(rows_axis(names), tuple(marks), (("x", 0.0),)),))
    title = f"Score of each object: predicted interval and measured value{_part(len(shown), len(pairs))}"
    alt = f"Measured score of each object beside its predicted 95 % interval. {'; '.join(words)}."
    return [Plots("object-scores", "scores", title, alt, {"": view})]


def transform_plots(sides: Sides) -> list[Plots]:
    """Probability integral transforms of all objects: in order, with a band, and as a histogram, by detector."""
    by_detector: dict[str, list[Array]] = {}
    for (_, detector), draws, measured in _objects(sides):
        by_detector.setdefault(detector, []).append(_transform(measured, draws))
    views, words = {}, []
    for detector, parts in by_detector.items():
        u = np.sort(np.concatenate(parts))
        inside = float(np.mean((u >= 0.025) & (u <= 0.975)))
        words.append(f"{detector}: {u.size} objects, {inside:.0%} in the central 95 %")
        views[detector] = SubjectView(
            Axis("probability of a lower score [1]", ends=(0.0, 1.0)), (_ordered(u), _histogram(u))
        )
    if not views:
        return []
    return [Plots(
        "object-transforms", "scores",
        "Predicted probability of a lower score than measured, all objects: uniform where predictions are right",
        "Probability integral transforms of the objects' scores in order against the uniform distribution with its "
        "95 % band for independent objects, and their histogram with that of a uniform sample. Objects share "
        f"errors of the inputs, which the band leaves out. {'; '.join(words)}.", views,
    )]  # fmt: skip


def exceedance_plots(sides: Sides) -> list[Plots]:
    """Share of background pixels above a score, predicted and measured, on a logarithmic axis."""
    predicted, measured = (of_side(side, "exceedance") for side in sides)
    every = [key for key in both_first(predicted, measured) if key in predicted]
    views, words = {}, []
    for key in every[:MAX_PANELS]:
        views[", ".join(key)], text = _tail(predicted[key], measured.get(key), bool(measured))
        words.append(f"{' '.join(key)}: {text}")
    if not views:
        return []
    title = f"False-alarm probability against the threshold{_part(len(views), len(every))}"
    alt = f"Part of the background above each score, predicted (dashed) and measured. {' '.join(words)}"
    legend = "measured with its 95 % interval, by blocks of the image; predicted with that of its fitted law"
    return [Plots("exceedance", "scores", title, alt, views, legend if measured else "")]


def roc_difference_plots(sides: Sides, margin: float | None) -> list[Plots]:
    """Predicted minus measured P_D against P_FA with its 95 % interval, for the curves with the most targets."""
    predicted, measured = (of_side(side, "roc") for side in sides)
    every = [key for key in both_first(predicted, measured) if key in predicted and key in measured]
    # Objects are independent and pixels of one object are not: curves by object first, where there are several.
    every.sort(
        key=lambda key: (key[2] != "object" or (measured[key].n_target or 0) < 2, -(measured[key].n_target or 0))
    )
    views, words = {}, []
    for key in every[:MAX_PANELS]:
        name = f"{key[0]}, {key[1]}, by {key[2]}"
        views[name], text = _difference(predicted[key], measured[key], margin)
        words.append(f"{', '.join(key)}: {text}.")
    if not views:
        return []
    title = f"ROC: predicted minus measured P_D{left_out([list(views)], every)}"
    alt = f"Predicted minus measured probability of detection. {' '.join(words)}"
    legend = "" if margin is None else f"dotted: equivalence margin {margin:g}"
    return [Plots("roc-difference", "roc", title, alt, views, legend)]


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


def _part(shown: int, every: int) -> str:
    """What a caption adds when not all is drawn; the rows of all stand in the results table."""
    return "" if shown == every else f"; {shown} of {every} are drawn, all have rows in results.csv"


def _transform(measured: Array, draws: Array) -> Array:
    return np.asarray((np.searchsorted(np.sort(draws), measured) + 0.5) / (draws.size + 1.0))


def _ordered(u: Array) -> Part:
    n = u.size
    rank = np.arange(1, n + 1)
    at = (rank - 0.5) / n
    low, high = (betaincinv(rank, n + 1 - rank, q) for q in (0.025, 0.975))
    band = Mark("area", {"x": at, "low": low, "high": high}, "95 % of independent objects", PREDICTED.colour)
    uniform = Mark("line", {"x": np.array([0.0, 1.0]), "y": np.array([0.0, 1.0])}, "uniform", GREY, "dotted")
    objects = measured_mark("line", {"x": at, "y": u}, "objects, in order")
    return Part(Axis("transform value [1]", ends=(0.0, 1.0)), (band, uniform, objects))


def _histogram(u: Array) -> Part:
    bins = 10 if u.size >= 50 else 5
    counts, edges = np.histogram(u, bins, (0.0, 1.0))
    expected = u.size / bins
    half = COVERAGE * math.sqrt(expected * (1.0 - 1.0 / bins))
    ends = np.array([0.0, 1.0])
    band = {"x": ends, "low": np.full(2, max(expected - half, 0.0)), "high": np.full(2, expected + half)}
    bars = {
        "left": edges[:-1],
        "right": edges[1:],
        "bottom": np.zeros(bins),
        "top": counts.astype(float),
        "y": counts.astype(float),
    }
    marks = (
        Mark("bars", bars, colour=COLLECTED.colour, words=tuple(f"{n} objects" for n in counts)),
        Mark("area", band, colour=PREDICTED.colour),
        Mark("line", {"x": ends, "y": np.full(2, expected)}, colour=GREY, dash="dotted"),
    )
    return Part(Axis("objects [1]", ends=(0.0, max(float(counts.max()), expected + half) * 1.1)), marks)


def _tail(predicted: ExceedanceCurve, measured: ExceedanceCurve | None, paired: bool) -> tuple[SubjectView, str]:
    floor, words, span = 1e-6, "", None
    marks = []
    if paired:
        columns = dict.fromkeys(("x", "y", "low", "high"), np.empty(0))
        if measured is not None:
            keep = measured.probability > 0
            x, p = measured.threshold[keep], measured.probability[keep]
            low, high = np.nan_to_num(measured.lower[keep], nan=1e-9), np.nan_to_num(measured.upper[keep], nan=1.0)
            columns = {"x": x, "y": p, "low": np.maximum(low, 1e-9), "high": high}
            floor = 0.3 * float(p.min())
            span = x[0] - 0.05 * (x[-1] - x[0]), x[-1] + 0.35 * (x[-1] - x[0])
            at = int(np.argmin(np.abs(np.log(p) - math.log(1e-2))))
            model = float(np.exp(np.interp(x[at], predicted.threshold, np.log(predicted.probability))))
            words = f"at score {x[at]:.3g} measured {p[at]:.2g}, predicted {model:.2g}."
        marks.append(measured_mark("line", _thinned(columns)))
    law = {"x": predicted.threshold, "y": predicted.probability, "low": predicted.lower, "high": predicted.upper}
    marks.append(predicted_mark("line", _thinned(law)))
    y = Axis("part of the background above [1]", "log", ends=(floor, 1.0))
    return SubjectView(Axis("score [1]", ends=span), (Part(y, tuple(marks)),)), words


def _thinned(columns: dict[str, Any]) -> dict[str, Any]:
    """A curve of at most so many points, its ends among them."""
    size = columns["x"].size
    keep = np.unique(np.linspace(0, size - 1, _MOST_POINTS).round().astype(int)) if size > _MOST_POINTS else slice(None)
    return {name: values[keep] for name, values in columns.items()}


def _difference(predicted: RocCurve, measured: RocCurve, margin: float | None) -> tuple[SubjectView, str]:
    low = max(float(predicted.pfa[0]), float(measured.pfa[measured.pfa > 0].min()), 1e-9)
    if measured.n_background:
        low = max(low, 3.0 / measured.n_background)
    x = np.geomspace(low, min(float(predicted.pfa[-1]), float(measured.pfa[-1])), 120)
    p, p_low, p_high = _at(predicted, x)
    o, o_low, o_high = _at(measured, x)
    difference = p - o
    below = difference - np.hypot(p - p_low, o_high - o)
    above = difference + np.hypot(p_high - p, o - o_low)
    at = int(np.argmin(np.abs(np.log(x) - math.log(1e-2))))
    words = f"{difference[at]:+.2f} ({below[at]:+.2f} to {above[at]:+.2f}) at P_FA {x[at]:.1e}"
    columns = {"x": x, "y": difference, "low": below, "high": above}
    line = Mark("line", columns, "predicted minus measured, 95 % interval", DIFFERENCE_COLOUR)
    places = (0.0,) if margin is None else (0.0, -margin, margin)
    part = Part(Axis("difference of P_D [1]", ends=(-1.05, 1.05)), (line,), tuple(("y", place) for place in places))
    return SubjectView(Axis("P_FA per pixel [1]", "log", ends=(float(x[0]), float(x[-1]))), (part,)), words


def _at(curve: RocCurve, pfa: Array) -> tuple[Array, ...]:
    inside = np.clip(pfa, curve.pfa[0], curve.pfa[-1])
    return tuple(detection_at(curve, inside, y) for y in (curve.pd, curve.pd_lower, curve.pd_upper))


def every_plot(
    sides: Sides,
    table: ResultTable,
    eigenvalues: Mapping[tuple[str, str], EigenvalueSpectrum],
    tails: Mapping[str, TailCurve],
    margin: float | None,
) -> list[Plots]:
    """What the products, the rows and the spread of pixels of a run give, with its margin of P_D [1]."""
    return [
        *budget_plots(sides),
        *(sampled_eigenvalue_plots(eigenvalues) if eigenvalues else eigenvalue_plots(sides)),
        *tail_plots(tails),
        *class_error_plots(sides),
        *score_plots(sides),
        *object_score_plots(sides),
        *transform_plots(sides),
        *exceedance_plots(sides),
        *roc_difference_plots(sides, margin),
        *abundance_plots(sides),
        *unmixing_plots(sides, list(table.where(product="abundance"))),
        *reason_plots(table),
    ]


def equivalence_margin(provenance: Mapping[str, Any]) -> float | None:
    """The margin that the campaign of a run states, as its provenance records it."""
    campaign = (provenance.get("configuration") or {}).get("campaign") or {}
    margin = campaign.get("equivalence_margin")
    return float(margin) if isinstance(margin, int | float) else None
