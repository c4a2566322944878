"""Spectra of both sides with their difference, their uncertainty budget, and how pixels spread about the mean.

How often classes are taken for each other is what the spread does to a user.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hyperval.figures.spec import (
    DIFFERENCE,
    GREY,
    MAX_PANELS,
    MOST_ROWS,
    SIDES,
    SOURCES,
    WAVELENGTH,
    Array,
    Axis,
    EigenvalueSpectrum,
    Figure,
    Mark,
    Panels,
    Part,
    Sides,
    a_row_each,
    a_view_each,
    count_text,
    difference,
    drawn_of,
    in_windows,
    left_out,
    measured_mark,
    of_side,
    predicted_mark,
    robust_limits,
    single,
)
from hyperval.model.intervals import Z95, clopper_pearson
from hyperval.pixels import exceedance_of_distance
from hyperval.products import ClassificationError, SpectralEstimate
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
    both, drawn, paired = drawn_of(sides, product)
    if not drawn or (not paired and None not in sides):
        return None  # a comparison that has none of this product
    worst: dict[str, int] = {}
    for row in rows:
        if row.planned and row.product == product:
            worst[row.subject] = max(worst.get(row.subject, 0), _WEIGHT.get(row.outcome, 0))
    shown = sorted(drawn, key=lambda subject: -worst.get(subject, 0))[:MOST_SUBJECTS]
    axis = next(side.axis for side, own in zip(sides, both, strict=True) if side and shown[0] in own)
    # Sides on other bands are not drawn over each other.
    aligned = [own if side and side.axis.matches(axis) else {} for side, own in zip(sides, both, strict=True)]
    gaps = {s: difference(aligned[0][s], aligned[1][s], ratio) for s in shown if all(s in own for own in aligned)}
    identical = bool(gaps) and not any(np.nan_to_num(gap).any() for gap, _ in gaps.values())
    gaps = {} if identical else gaps  # nothing to draw
    below = f"difference{' ratio' if ratio else ''}"
    views = tuple(_view(axis, s, [own.get(s) for own in aligned], gaps.get(s), label, below, names) for s in shown)
    keep = in_windows(axis)
    medians = [
        f"{subject} {np.nanmedian(np.abs(gap[keep])):{'.2%' if ratio else '.4f'}}"
        for subject, (gap, _) in gaps.items() if np.isfinite(gap[keep]).any()
    ]  # fmt: skip
    alt = f"{title} against {wavelengths(axis).label.partition(' [')[0]}, a subject at a time: {names[0]} (dashed) and "
    alt += f"{names[1]} (solid) with 95 % intervals{', the difference below' if gaps else ''}."
    alt += f" Subjects: {', '.join(shown)}."
    alt += f" Median absolute {below} in the windows: {'; '.join(medians)}." if medians else ""
    words = " and ".join(names) if paired else names[0] if sides[0] is not None else names[1]
    head = f"{title}: {words}{', which are identical' * identical}{'' if axis.numbered else ' (grey: absorption)'}"
    every = {*both[0], *both[1]}
    return Figure(product, product, head + left_out(len(shown), len(every)), alt, views, head=head, together="offered")


def _view(
    axis: SpectralAxis, subject: str, both: Sequence[SpectralEstimate | None], gap: tuple[Array, Array] | None,
    label: str, below: str, names: tuple[str, str],
) -> Panels:  # fmt: skip
    w, keep = axis.centre_nm, in_windows(axis)
    marks, edges = [], []
    # Dashes on top, so that neither hides the other.
    for estimate, make, name in ((both[1], measured_mark, names[1]), (both[0], predicted_mark, names[0])):
        if estimate is not None:
            half = Z95 * estimate.standard_uncertainty
            marks.append(make("line", {"x": w, "y": estimate.mean, "half": half}, name, linked=True))
            edges += [(estimate.mean - half)[keep], (estimate.mean + half)[keep]]
    parts = [Part(Axis(label, ends=robust_limits(edges)), tuple(marks))]
    if gap is not None:
        value, half = gap[0], Z95 * gap[1]
        ends = robust_limits([(value - half)[keep], (value + half)[keep]], trim=3.0)
        mark = Mark("line", {"x": w, "y": value, "half": half}, "", DIFFERENCE, linked=True)
        parts.append(Part(Axis(below, ends=ends), (mark,), (("y", 0.0),)))
    return Panels(wavelengths(axis), tuple(parts), subject)


def budget_figure(sides: Sides) -> Figure | None:
    """Relative uncertainty of the radiance by source, stacked to the total; a view for each subject and side."""
    estimates, drawn, _ = drawn_of(sides, "radiance")
    panels: dict[str, tuple[SpectralAxis, SpectralEstimate]] = {
        f"{subject} ({name})": (side.axis, own[subject])
        for subject in drawn
        for name, side, own in zip(SIDES, sides, estimates, strict=True)
        if side is not None and subject in own and own[subject].budget
    }
    sources = _ranked_sources([estimate for _, estimate in list(panels.values())[:MAX_PANELS]])
    head = "Uncertainty budget of the radiance (height: total; colour: share of the variance)"
    return a_view_each(
        "radiance-budget", "radiance", head,
        "Relative standard uncertainty of the radiance against wavelength, stacked by source in proportion to its "
        f"share of the variance. Sources, largest first: {', '.join(sources)}. Panels:",
        list(panels), lambda name: (_stack(*panels[name], sources, name), name), head=head,
    )  # fmt: skip


def _stack(axis: SpectralAxis, estimate: SpectralEstimate, sources: Sequence[str], subject: str) -> Panels:
    w = axis.centre_nm
    parts = np.zeros((len(sources), w.size))  # variance by source; the last may be everything without its own place
    for source, u in estimate.budget.items():
        if source in sources or sources[-1] == _REST:
            parts[sources.index(source) if source in sources else -1] += np.square(np.asarray(u, float))
    with np.errstate(invalid="ignore", divide="ignore"):
        total = np.sqrt(parts.sum(axis=0))
        # Variances add, uncertainties do not: each source takes its share of the variance in the height.
        heights = np.nan_to_num(100.0 * total / np.abs(estimate.mean) * parts / parts.sum(axis=0))
    edges = np.concatenate([np.zeros((1, w.size)), np.cumsum(heights, axis=0)])
    marks = [
        Mark("area", {"x": w, "low": low, "high": high}, source, colour, alpha=1.0)
        for low, high, source, colour in zip(edges[:-1], edges[1:], sources, SOURCES, strict=False)
    ]
    ends = robust_limits([edges[-1][in_windows(axis)]])
    return single(wavelengths(axis), "standard uncertainty [% of radiance]", marks, subject=subject, ends=ends)


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
_UNITS = {"radiance": "(µW cm⁻² sr⁻¹ nm⁻¹)²", "reflectance": "1"}


def _eigenvalues(estimate: SpectralEstimate) -> Array:
    """(K,) leading eigenvalues of the pixel covariance over its finite bands, largest first."""
    covariance = np.asarray(estimate.pixel_covariance, dtype=float)
    finite = np.isfinite(np.diag(covariance))
    block = covariance[np.ix_(finite, finite)]
    if block.size == 0 or not np.isfinite(block).all():
        return np.empty(0)
    rank = block.shape[0] if estimate.n is None else min(block.shape[0], max(estimate.n - 1, 0))
    values = np.linalg.eigvalsh(block)[::-1][: min(rank, MOST_EIGENVALUES)]
    return values[values > 1e-13 * max(values[0], 0.0)] if values.size else values


def sampled_eigenvalue_figures(spectra: Mapping[tuple[str, str], EigenvalueSpectrum]) -> list[Figure]:
    """Eigenvalues of both sides; below each, predicted over measured with the band that chance alone gives."""

    def view(key: tuple[str, str]) -> tuple[Panels, str]:
        s, (subject, quantity) = spectra[key], key
        number = np.arange(1.0, s.measured.size + 1)
        expected = {"y": s.expected, "low": s.lower, "high": s.upper}
        above = (
            predicted_mark("line", {"x": number, **expected}, "predicted, mean and 95 % of samples", marker="circle"),
            measured_mark("line", {"x": number, "y": s.measured}, marker="square"),
        )
        ratio = {"x": number, **{name: values / s.measured for name, values in expected.items()}}
        below = Part(Axis("predicted / measured"), (Mark("line", ratio, colour=DIFFERENCE),), (("y", 1.0),))
        label = "eigenvalue" + (f" [{_UNITS[quantity]}]" if _UNITS[quantity] != "1" else "")
        inside = int(np.sum((s.measured >= s.lower) & (s.measured <= s.upper)))
        words = f"{subject}: first eigenvalue predicted {s.expected[0]:.3g}, measured {s.measured[0]:.3g}; "
        words += f"{inside} of {s.measured.size} inside"
        x = Axis("number of the eigenvalue", ends=(0.0, number[-1] + 1.0))
        return Panels(x, (Part(Axis(label, "log"), above), below), f"{subject} (n = {count_text(s.n)})"), words

    made = (
        a_view_each(
            f"{quantity}-eigenvalues", "covariance",
            f"Eigenvalues of the {quantity} covariance (band: 95 % of samples of as many independent pixels drawn "
            "from the prediction)",
            f"Leading eigenvalues of the pixel-to-pixel covariance of the {quantity}, logarithmic, predicted (hollow "
            "circles, with the 95 % band of samples of as many pixels) and measured (squares); below, predicted over "
            "measured with that band.", [key for key in spectra if key[1] == quantity], view,
        )
        for quantity in _UNITS
    )  # fmt: skip
    return [figure for figure in made if figure is not None]


def eigenvalue_figure(sides: Sides) -> Figure | None:
    """Eigenvalues of the pixel covariance of the radiance of a side alone, for which no band of chance is known."""
    if (sides[0] is None) == (sides[1] is None):
        return None
    side, make = (sides[1], measured_mark) if sides[0] is None else (sides[0], predicted_mark)
    known = {k: e for k, e in of_side(side, "radiance").items() if e.pixel_covariance is not None}

    def view(subject: str) -> tuple[Panels, str]:
        n, values = known[subject].n, _eigenvalues(known[subject])
        # Large-sample variance of an eigenvalue of a normal sample covariance: 2 lambda^2 / (n - 1).
        factor = math.exp(Z95 * math.sqrt(2.0 / (n - 1))) if n is not None and n > 1 else 1.0
        columns = {"y": values, "low": values / factor, "high": values * factor}
        mark = make("line", {"x": np.arange(1.0, values.size + 1), **columns}, marker="circle")
        x = Axis("number of the eigenvalue", ends=(0.0, MOST_EIGENVALUES + 1.0))
        part = Part(Axis(f"eigenvalue [{_UNITS['radiance']}]", "log"), (mark,))
        return Panels(x, (part,), subject), f"{subject} {values[0]:.3g}" if values.size else f"{subject} none"

    return a_view_each(
        "radiance-eigenvalues", "covariance",
        "Eigenvalues of the pixel covariance (band: 95 % sampling interval, pixels taken as independent)",
        f"The largest {MOST_EIGENVALUES} eigenvalues of the pixel-to-pixel covariance of the radiance, on a "
        "logarithmic scale. Largest:", list(known), view,
    )  # fmt: skip


def tail_figure(sides: Sides) -> Figure | None:
    """Share of pixels beyond a Mahalanobis distance: measured, as predicted, normal, and the t that fits best."""
    predicted, measured = (of_side(side, "distribution") for side in sides)

    def view(subject: str) -> tuple[Panels, str]:
        law, stated = measured[subject], predicted.get(subject)
        n, dimension, distance = law.n or 1, law.leading_dimension, np.sqrt(law.distance)
        low, high = clopper_pearson(law.exceedance * n, np.full(distance.size, n))
        columns = {"x": distance, "y": law.exceedance, "low": low, "high": high}

        def curve(dof: float) -> dict[str, Array]:
            return {"x": distance, "y": exceedance_of_distance(law.distance, dimension, dof)}

        marks = [measured_mark("line", columns, "measured, with its 95 % interval")]
        marks += [] if stated is None else [predicted_mark("line", curve(stated.tail_dof), "predicted law")]
        marks.append(Mark("line", curve(math.inf), "normal law", GREY, "dotted"))
        marks.append(Mark("line", curve(law.leading_tail_dof), "fitted t", DIFFERENCE, "dashdot"))
        told = "" if stated is None else f", {_dof(stated.tail_dof)} predicted"
        part = Part(Axis("share of pixels farther out", "log", ends=(0.3 / n, 1.5)), tuple(marks))
        x = Axis("Mahalanobis distance", ends=(0.0, float(distance[-1]) * 1.03))
        name = f"{subject}: {dimension} components, n = {count_text(n)}"
        return Panels(x, (part,), name), f"{subject}: {_dof(law.leading_tail_dof)} measured{told}"

    known = [s for s, law in measured.items() if law.distance is not None and law.leading_dimension is not None]
    return a_view_each(
        "pixel-tails", "covariance",
        "Tails of the pixels in the leading components (interval: binomial, pixels taken as independent)",
        "Share of a class's pixels beyond a Mahalanobis distance in the leading components, logarithmic: measured "
        "with its 95 % interval, under the predicted law, the normal law, and the fitted t.", known, view,
    )  # fmt: skip


def _dof(dof: float) -> str:
    return "normal" if math.isinf(dof) else f"{dof:.3g} degrees of freedom"


def class_error_figure(sides: Sides) -> Figure | None:
    """Classification error of every set of classes and features, both sides, with the bounds from distances."""
    both = [of_side(side, "classification") for side in sides]
    keys = list(dict.fromkeys([*both[1], *both[0]]))
    # Left end of the axis: below every error that was measured or predicted, and not below a millionth.
    least = min([1e-2, *(x for own in both for e in own.values() for x in (e.error, e.lower) if x > 0)])
    floor = max(least / 2.0, 1e-6)

    def columns(own: Sequence[ClassificationError], **names: str) -> dict[str, Any]:
        names = names or {"x": "error", "low": "lower", "high": "upper"}
        return {name: np.maximum([getattr(e, of) for e in own], floor) for name, of in names.items()}

    bounded = {i: both[0][k] for i, k in enumerate(keys[:MOST_ROWS]) if k in both[0] and both[0][k].bound_upper > 0}
    at, own = np.array(list(bounded), float), list(bounded.values())
    bars = columns(own, left="bound_lower", right="bound_upper") | {"bottom": at - 0.31, "top": at + 0.31}
    ticks = columns(own, x="approximation") | {"y": at}
    under = [
        Mark("bars", bars, "bounds from the predicted distance"),
        Mark("dots", ticks, "estimate from it", marker="tick", along="x"),
    ] if bounded else []  # fmt: skip
    return a_row_each(
        "class-error", "classification", "Error of a Gaussian maximum-likelihood classifier", keys, both,
        Axis("probability of error", "log", ends=(floor / 1.4, 1.0)), columns,
        lambda e: f"{e.error:.2g} ({e.lower:.1g} to {e.upper:.1g})", under=under,
        legend=f"bar: 95 % interval; an error below {floor:.0e} is drawn there",
    )  # fmt: skip
