"""Spectra of both sides with their difference, their uncertainty budget, and how pixels spread about the mean.

How often classes are taken for each other is what the spread does to a user.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hyperval.figures.sides import (
    Array,
    EigenvalueSpectrum,
    Sides,
    TailCurve,
    both_first,
    difference,
    drawn_of,
    in_windows,
    of_side,
)
from hyperval.figures.spec import (
    COVERAGE,
    DIFFERENCE,
    GREY,
    MAX_PANELS,
    SIDES,
    SOURCES,
    WAVELENGTH,
    Axis,
    Figure,
    Mark,
    Panels,
    Part,
    count_text,
    in_words,
    left_out,
    measured_mark,
    predicted_mark,
    robust_limits,
    row_marks,
    row_names,
    single,
)
from hyperval.products import ClassificationError, Products, SpectralEstimate
from hyperval.results import Outcome, Result
from hyperval.spectra.axis import SpectralAxis

# Of a product: its axis, its title, and whether its difference is a ratio.
SPECTRA = {
    "radiance": ("radiance [µW cm⁻² sr⁻¹ nm⁻¹]", "Radiance at the sensor", True),
    "toa_reflectance": ("reflectance", "Reflectance at the top of the atmosphere", True),
    "snr": ("signal-to-noise ratio", "Signal-to-noise ratio", True),
    "reflectance": ("reflectance", "Reflectance", False),
}
MOST_SUBJECTS = 24
_MOST_SOURCES = 7
_REST = "other sources"
_WEIGHT = {Outcome.DISAGREES: 3, Outcome.ERROR: 3, Outcome.UNDECIDED: 2, Outcome.AGREES: 1}


def wavelengths(axis: SpectralAxis) -> Axis:
    """The axis of a figure over bands, which may go by their number; of a single band with room beside it."""
    w = axis.centre_nm
    ends = float(w[0]), float(max(w[-1], w[0] + 1.0))
    return Axis("number of the band" if axis.numbered else WAVELENGTH, ends=ends)


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
    label, title, ratio = SPECTRA[product]
    predicted, measured, drawn, paired = drawn_of(sides, product)
    if not drawn or (not paired and None not in sides):
        return None  # a comparison that has none of this product
    worst: dict[str, int] = {}
    for row in rows:
        if row.planned and row.product == product:
            worst[row.subject] = max(worst.get(row.subject, 0), _WEIGHT.get(row.outcome, 0))
    shown = sorted(drawn, key=lambda subject: -worst.get(subject, 0))[:MOST_SUBJECTS]
    axis = next(side.axis for side, own in zip(sides, (predicted, measured), strict=True) if side and shown[0] in own)
    gaps: dict[str, tuple[Array, Array]] = {}
    if paired and sides[0] and sides[1] and sides[0].axis.matches(sides[1].axis):
        gaps = {subject: difference(predicted[subject], measured[subject], ratio) for subject in shown}
    identical = bool(gaps) and not any(np.nan_to_num(gap).any() for gap, _ in gaps.values())
    if identical:  # nothing to draw
        gaps = {}
    below = f"difference{' ratio' if ratio else ''}"
    aligned = [
        own if side and side.axis.matches(axis) else {} for side, own in zip(sides, (predicted, measured), strict=True)
    ]
    views = tuple(
        _view(axis, subject, [own.get(subject) for own in aligned], gaps.get(subject), label, below, names)
        for subject in shown
    )
    keep = in_windows(axis)
    medians = [
        f"{subject} {np.nanmedian(np.abs(gap[keep])):{'.2%' if ratio else '.4f'}}"
        for subject, (gap, _) in gaps.items()
        if np.isfinite(gap[keep]).any()
    ]
    alt = f"{title} against {wavelengths(axis).label.partition(' [')[0]}, a subject at a time: {names[0]} (dashed) and "
    alt += f"{names[1]} (solid) with 95 % intervals{', the difference below' if gaps else ''}."
    alt += f" Subjects: {', '.join(shown)}."
    if medians:
        alt += f" Median absolute {below} in the windows: {'; '.join(medians)}."
    words = " and ".join(names) if paired else names[0] if sides[0] is not None else names[1]
    words += ", which are identical" if identical else ""
    words += "" if axis.numbered else " (grey: absorption)"
    caption = f"{title}: {words}{left_out(len(shown), len({*predicted, *measured}))}"
    return Figure(product, product, caption, alt, views, head=f"{title}: {words}", together="offered")


def _view(
    axis: SpectralAxis, subject: str, both: Sequence[SpectralEstimate | None], gap: tuple[Array, Array] | None,
    label: str, below: str, names: tuple[str, str],
) -> Panels:  # fmt: skip
    w, keep = axis.centre_nm, in_windows(axis)
    marks, edges = [], []
    # Dashes on top, so that neither hides the other.
    for estimate, make, name in ((both[1], measured_mark, names[1]), (both[0], predicted_mark, names[0])):
        if estimate is not None:
            half = COVERAGE * estimate.standard_uncertainty
            marks.append(make("line", {"x": w, "y": estimate.mean, "half": half}, name, linked=True))
            edges += [(estimate.mean - half)[keep], (estimate.mean + half)[keep]]
    parts = [Part(Axis(label, ends=robust_limits(edges, zero=True)), tuple(marks))]
    if gap is not None:
        value, half = gap[0], COVERAGE * gap[1]
        ends = robust_limits([(value - half)[keep], (value + half)[keep]], zero=True, trim=3.0)
        mark = Mark("line", {"x": w, "y": value, "half": half}, "", DIFFERENCE, linked=True)
        parts.append(Part(Axis(below, ends=ends), (mark,), (("y", 0.0),)))
    return Panels(wavelengths(axis), tuple(parts), subject)


def budget_figure(sides: Sides) -> Figure | None:
    """Relative uncertainty of the radiance by source, stacked to the total; a view for each subject and side."""
    estimates = [of_side(side, "radiance") for side in sides]
    every = both_first(*estimates)
    panels: dict[str, tuple[Products, SpectralEstimate]] = {}
    for subject in [s for s in every if all(s in side for side in estimates)] or every:
        for name, side in zip(SIDES, sides, strict=True):
            if side is not None and subject in side.radiance and side.radiance[subject].budget:
                panels[f"{subject} ({name})"] = side, side.radiance[subject]
    if not panels:
        return None
    shown = dict(list(panels.items())[:MAX_PANELS])
    sources = _ranked_sources([estimate for _, estimate in shown.values()])
    head = "Uncertainty budget of the radiance (height: total; colour: share of the variance)"
    return Figure(
        "radiance-budget", "radiance", head + left_out(len(shown), len(panels)),
        "Relative standard uncertainty of the radiance against wavelength, stacked by source in proportion to its "
        f"share of the variance. Sources, largest first: {', '.join(sources)}. Panels: {', '.join(shown)}.",
        tuple(_stack(side.axis, estimate, sources, name) for name, (side, estimate) in shown.items()), head=head,
    )  # fmt: skip


def _stack(axis: SpectralAxis, estimate: SpectralEstimate, sources: Sequence[str], subject: str) -> Panels:
    w, parts = axis.centre_nm, _variances(estimate.budget, sources, estimate.mean.size)
    with np.errstate(invalid="ignore", divide="ignore"):
        total = np.sqrt(parts.sum(axis=0))
        # Variances add, uncertainties do not: each source takes its share of the variance in the height.
        heights = np.nan_to_num(100.0 * total / np.abs(estimate.mean) * parts / parts.sum(axis=0))
    edges = np.concatenate([np.zeros((1, w.size)), np.cumsum(heights, axis=0)])
    marks = [
        Mark("area", {"x": w, "low": low, "high": high}, source, colour, alpha=1.0)
        for low, high, source, colour in zip(edges[:-1], edges[1:], sources, SOURCES, strict=False)
    ]
    ends = robust_limits([edges[-1][in_windows(axis)]], zero=True)
    return single(wavelengths(axis), "standard uncertainty [% of radiance]", marks, subject=subject, ends=ends)


def _variances(budget: Mapping[str, Array], sources: Sequence[str], bands: int) -> Array:
    """(S, B) variance by source; the last may be everything that has no place of its own."""
    parts = np.zeros((len(sources), bands))
    for source, u in budget.items():
        if source in sources or sources[-1] == _REST:
            parts[sources.index(source) if source in sources else -1] += np.square(np.asarray(u, float))
    return parts


def _ranked_sources(estimates: Sequence[SpectralEstimate]) -> list[str]:
    """Sources by their largest median share of the variance, the small ones taken together."""
    weight: dict[str, float] = {}
    for estimate in estimates:
        squares = {s: float(np.nanmedian(np.square(u) / np.square(estimate.mean))) for s, u in estimate.budget.items()}
        total = sum(squares.values()) or 1.0
        for source, square in squares.items():
            weight[source] = max(weight.get(source, 0.0), square / total)
    ranked = sorted(weight, key=lambda s: (-weight[s], s))
    return ranked if len(ranked) <= _MOST_SOURCES else [*ranked[: _MOST_SOURCES - 1], _REST]


MOST_EIGENVALUES = 30
_MOST_ROWS = 40
_UNITS = {"radiance": "(µW cm⁻² sr⁻¹ nm⁻¹)²", "reflectance": "1"}


def eigenvalues(estimate: SpectralEstimate) -> Array:
    """(K,) leading eigenvalues of the pixel covariance over its finite bands, largest first."""
    covariance = np.asarray(estimate.pixel_covariance, dtype=float)
    finite = np.isfinite(np.diag(covariance))
    block = covariance[np.ix_(finite, finite)]
    if block.size == 0 or not np.isfinite(block).all():
        return np.empty(0)
    values = np.linalg.eigvalsh(block)[::-1]
    rank = block.shape[0] if estimate.n is None else min(block.shape[0], max(estimate.n - 1, 0))
    values = values[: min(rank, MOST_EIGENVALUES)]
    return values[values > 1e-13 * max(values[0], 0.0)] if values.size else values


def sampled_eigenvalue_figures(spectra: Mapping[tuple[str, str], EigenvalueSpectrum]) -> list[Figure]:
    """Eigenvalues of both sides; below each, predicted over measured with the band that chance alone gives."""
    made = []
    for quantity, unit in _UNITS.items():
        own = {subject: s for (subject, q), s in spectra.items() if q == quantity}
        words = []
        for subject, s in own.items():
            inside = int(np.sum((s.measured >= s.lower) & (s.measured <= s.upper)))
            words.append(
                f"{subject}: first eigenvalue predicted {s.expected[0]:.3g}, measured {s.measured[0]:.3g}; "
                f"{inside} of {s.measured.size} inside"
            )
        if own:
            made.append(Figure(
                f"{quantity}-eigenvalues", "covariance",
                f"Eigenvalues of the {quantity} covariance (band: 95 % of samples of as many independent "
                "pixels drawn from the prediction)",
                f"Leading eigenvalues of the pixel-to-pixel covariance of the {quantity}, logarithmic, predicted "
                "(hollow circles, with the 95 % band of samples of as many pixels) and measured (squares); below, "
                f"predicted over measured with that band. {'. '.join(words)}.",
                tuple(_sampled(subject, s, unit) for subject, s in own.items()),
            ))  # fmt: skip
    return made


def _sampled(subject: str, s: EigenvalueSpectrum, unit: str) -> Panels:
    number = np.arange(1.0, s.measured.size + 1)
    expected = {"y": s.expected, "low": s.lower, "high": s.upper}
    above = (
        predicted_mark("line", {"x": number, **expected}, "predicted, mean and 95 % of samples", marker="circle"),
        measured_mark("line", {"x": number, "y": s.measured}, marker="square"),
    )
    ratio = {"x": number, **{name: values / s.measured for name, values in expected.items()}}
    x = Axis("number of the eigenvalue", ends=(0.0, number[-1] + 1.0))
    below = Part(Axis("predicted / measured"), (Mark("line", ratio, colour=DIFFERENCE),), (("y", 1.0),))
    label = "eigenvalue" if unit == "1" else f"eigenvalue [{unit}]"
    return Panels(x, (Part(Axis(label, "log"), above), below), f"{subject} (n = {count_text(s.n)})")


def eigenvalue_figures(sides: Sides) -> list[Figure]:
    """Eigenvalues of the pixel covariance of the radiance of both sides, where no band of chance is known."""
    spectra = [{k: e for k, e in of_side(side, "radiance").items() if e.pixel_covariance is not None} for side in sides]
    every = both_first(*spectra)
    pairs = [subject for subject in every if all(subject in own for own in spectra)]
    views, words = [], []
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
        x = Axis("number of the eigenvalue", ends=(0.0, MOST_EIGENVALUES + 1.0))
        views.append(Panels(x, (Part(Axis(f"eigenvalue [{_UNITS['radiance']}]", "log"), tuple(marks)),), subject))
        words.append(f"{subject} {' and '.join(firsts)}")
    if not views:
        return []
    return [Figure(
        "radiance-eigenvalues", "covariance",
        "Eigenvalues of the pixel covariance (band: 95 % sampling interval, pixels taken as independent)"
        + left_out(len(views), len(pairs or every)),
        f"The largest {MOST_EIGENVALUES} eigenvalues of the pixel-to-pixel covariance of the radiance, on a "
        f"logarithmic scale. Largest: {'; '.join(words)}.", tuple(views),
    )]  # fmt: skip


def tail_figure(tails: Mapping[str, TailCurve]) -> Figure | None:
    """Share of pixels beyond a Mahalanobis distance: measured, as predicted, normal, and the t that fits best."""
    views, words = [], []
    for subject, t in list(tails.items())[:MAX_PANELS]:
        views.append(_tails(f"{subject}: {t.dimension} components, n = {count_text(t.n)}", t))
        predicted = "" if t.predicted_dof is None else f", {_dof(t.predicted_dof)} predicted"
        words.append(f"{subject}: {_dof(t.fitted_dof)} measured{predicted}")
    if not views:
        return None
    return Figure(
        "pixel-tails", "covariance",
        "Tails of the pixels in the leading components (interval: binomial, pixels taken as independent)",
        "Share of a class's pixels beyond a Mahalanobis distance in the leading components, logarithmic: measured "
        f"with its 95 % interval, under the predicted law, the normal law, and the fitted t. {'; '.join(words)}.",
        tuple(views),
    )  # fmt: skip


def _tails(name: str, t: TailCurve) -> Panels:
    marks = [measured_mark("line", {"x": t.distance, "y": t.measured, "low": t.lower, "high": t.upper},
                           "measured, with its 95 % interval")]  # fmt: skip
    if t.predicted is not None:
        marks.append(predicted_mark("line", {"x": t.distance, "y": t.predicted}, "predicted law"))
    marks.append(Mark("line", {"x": t.distance, "y": t.normal}, "normal law", GREY, "dotted"))
    marks.append(Mark("line", {"x": t.distance, "y": t.fitted}, "fitted t", DIFFERENCE, "dashdot"))
    x = Axis("Mahalanobis distance", ends=(0.0, float(t.distance[-1]) * 1.03))
    return Panels(x, (Part(Axis("share of pixels farther out", "log", ends=(0.3 / t.n, 1.5)), tuple(marks)),), name)


def _dof(dof: float) -> str:
    return "normal" if math.isinf(dof) else f"{dof:.3g} degrees of freedom"


def class_error_figure(sides: Sides) -> Figure | None:
    """Classification error of every set of classes and features, both sides, with the bounds from distances."""
    both = [of_side(side, "classification") for side in sides]
    predicted, measured = both
    every = list(dict.fromkeys([*measured, *predicted]))
    keys = every[:_MOST_ROWS]
    if not keys:
        return None
    errors = [e for own in both for e in own.values()]
    # Left end of the axis: below every error that was measured or predicted, and not below a millionth.
    floor = max(min([1e-2, *(x for e in errors for x in (e.error, e.lower) if x > 0)]) / 2.0, 1e-6)
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
        columns = {"left": low, "right": high, "bottom": at - 0.31, "top": at + 0.31}
        marks = [
            Mark("bars", columns, "bounds from the predicted distance"),
            Mark("dots", {"x": middle, "y": at}, "estimate from it", marker="tick", along="x"),
        ]

    def columns_of(own: Mapping[Any, ClassificationError]) -> dict[str, Any]:
        some = [own[key] for key in keys if key in own]
        return {name: np.maximum([getattr(e, error) for e in some], floor)
                for name, error in (("x", "error"), ("low", "lower"), ("high", "upper"))}  # fmt: skip

    title = f"Error of a Gaussian maximum-likelihood classifier{left_out(len(keys), len(every))}"
    rows = row_names([", ".join(key) for key in keys])
    x = Axis("probability of error", "log", ends=(floor / 1.4, 1.0))
    view = Panels(x, (Part(rows, (*marks, *row_marks(keys, both, columns_of, _error_words))),))
    legend = f"bar: 95 % interval; an error below {floor:.0e} is drawn there"
    return Figure(
        "class-error", "classification", title, f"{title}: {in_words(keys, both, _error_words)}.", (view,), legend
    )


def _error_words(e: ClassificationError) -> str:
    return f"{e.error:.2g} ({e.lower:.1g} to {e.upper:.1g})"
