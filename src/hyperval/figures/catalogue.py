"""Every figure of a run, in the order of its page; those of the reasons: which input explains the residuals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hyperval.figures import detection, spectra
from hyperval.figures.spec import (
    DIFFERENCE,
    GREY,
    MET,
    NOT_MET,
    SIDES,
    WAVELENGTH,
    Axis,
    ColourScale,
    EigenvalueSpectrum,
    Figure,
    Mark,
    Panels,
    Part,
    Sides,
    left_out,
    of_rows,
    row_names,
)
from hyperval.results import Result, ResultTable
from hyperval.storage import number_of


def first_figures(sides: Sides, table: ResultTable | None = None, names: tuple[str, str] = SIDES) -> list[Figure]:
    """Spectra and ROC curves; subjects about which more is amiss in ``table`` come first.

    ``names`` : what the two sides are, where they are no prediction and collection
    """
    rows = list(table) if table is not None else []
    made = [
        *(spectra.spectra_figure(sides, product, rows, names) for product in spectra.SPECTRA),
        detection.roc_figure(sides, names),
    ]
    return [figure for figure in made if figure is not None]


def further_figures(
    sides: Sides,
    table: ResultTable,
    eigenvalues: Mapping[tuple[str, str], EigenvalueSpectrum],
    margin: float | None,
) -> list[Figure]:
    """What else the products, the rows and the eigenvalues of a run give, with its margin of P_D."""
    made = [
        spectra.budget_figure(sides),
        *(spectra.sampled_eigenvalue_figures(eigenvalues) if eigenvalues else [spectra.eigenvalue_figure(sides)]),
        spectra.tail_figure(sides),
        spectra.class_error_figure(sides),
        detection.score_figure(sides),
        detection.object_score_figure(sides),
        detection.transform_figure(sides),
        detection.exceedance_figure(sides),
        detection.roc_difference_figure(sides, margin),
        detection.abundance_figure(sides),
        detection.unmixing_figure(sides, list(table.where(product="abundance"))),
        *reason_figures(table),
    ]
    return [figure for figure in made if figure is not None]


_MOST_INPUTS = 14
_MOST_GROUPS = 26
_MOST_QUANTITIES = 26
_STATED, _UNSTATED = "#0072B2", "#E69F00"
_BEST, _OTHER = "#C2410C", "#8aa4b8"
_ALL = "all"
_LONGEST = 34  # characters of an input's name
# Twice a log-likelihood of 10.8 has one chance in a thousand by luck, for one direction.
_TELLING = 10.8


def reason_figures(table: ResultTable) -> list[Figure]:
    """Bars of all residuals together, a matrix of single subjects, effects of inputs, what-ifs."""
    gains = [r for r in table.where(product="attribution") if r.metric == "likelihood_gain"]
    whole = sorted((r for r in gains if r.subject == _ALL), key=lambda r: -r.value)
    others = [r for r in gains if r.subject != _ALL]
    moves = [r for r in table.where(product="sensitivity") if r.metric.endswith("_change")]
    outcomes = [r for r in table.where(product="what-if") if r.metric == "reduced_chi_square"]
    left = [
        r for r in table.where(product="attribution") if r.metric == "reduced_chi_square" and r.method != "every input"
    ]
    left = sorted(left, key=lambda r: -_leading_number(r.reason))[:_MOST_QUANTITIES]
    first = next((f"Residuals before and after: {r.method}" for r in left), "")
    made = (
        _before_and_after("residuals", "attribution", left, [r.subject for r in left], first),
        _inputs(whole[:_MOST_INPUTS], table) if whole else None,
        _gain(table),
        _by_subject(others) if others else None,
        _effects(moves) if moves else None,
        _before_and_after("what-ifs", "what-if", outcomes, [r.method for r in outcomes], "What-ifs: before and after"),
    )
    return [figure for figure in made if figure is not None]


def _inputs(rows: Sequence[Result], table: ResultTable) -> Figure:
    stated, names = _stated(table), [r.method for r in rows]
    marks = []
    for colour, label, own in (
        (_STATED, "uncertainty stated", [i for i, name in enumerate(names) if name in stated]),
        (_UNSTATED, "none stated: standard step", [i for i, name in enumerate(names) if name not in stated]),
    ):
        if own:
            at, ends = np.array(own, float), np.array([max(rows[i].value, 0.1) for i in own])
            columns = {"left": np.full(at.size, 0.1), "right": ends, "bottom": at - 0.35, "top": at + 0.35}
            # An input that explains nothing has nothing to say, however far it moves.
            words = [rows[i].reason.partition("; ")[0].partition(": ")[2] if rows[i].value >= 1.0 else "" for i in own]
            words = [text.replace("-", "−") for text in words]
            marks.append(Mark("bars", columns, label, colour, words=tuple(words), beside="right", alpha=0.85))
    best = rows[0]
    alt = f"Bars of the likelihood gained by freeing each input, all residuals together: {best.method} gains most"
    alt += f" ({best.value:.3g}); then " + ", ".join(f"{r.method} ({r.value:.3g})" for r in rows[1:4]) + "."
    numbered = any(name.endswith(")") and name.rpartition("(")[2][:-1].isdigit() for name in names)
    legend = "twice the gain in log-likelihood (2 Δ ln L) with that input free; dotted: by chance once in 1000"
    legend += "; a number in brackets: one of several independent shapes of an error" if numbered else ""
    x = Axis("improvement of the fit to the differences", "log", ends=(0.1, max(best.value * 100.0, 30.0)))
    title = "Inputs that would explain the differences if they were less certain"
    y = row_names(names, _LONGEST)
    return of_rows("attribution-inputs", "attribution", title, alt, x, y, marks, legend, (_TELLING,))


def _gain(table: ResultTable) -> Figure | None:
    """The gain of the sensor that would explain the radiance of all subjects, over wavelength."""
    marks: dict[str, Mark] = {}
    labels = {
        "": "gain without an offset",
        "_beside_offset": "gain beside the offset below",
        "o": "offset beside that gain",
    }
    for kind, label in labels.items():
        name = "sensor_offset@" if kind == "o" else f"sensor_gain{kind}@"
        every = [r for r in table.where(product="radiance") if r.metric.startswith(name)]
        if every:
            numbers = np.array([(float(r.metric.partition("@")[2]), r.value, r.lower, r.upper) for r in every])
            columns = dict(zip(("x", "y", "low", "high"), numbers.T, strict=True))
            colour, hollow = (GREY, True) if kind else (DIFFERENCE, False)
            marks[kind] = Mark("dots", columns, f"{label}, 95 % interval", colour, marker="circle", hollow=hollow)
    if not marks:
        return None
    nm, gain, low, high = (marks[""].columns[name] for name in ("x", "y", "low", "high"))
    far = int(np.argmax(np.abs(gain - 1.0)))
    title = "Gain and offset [uW cm-2 sr-1 nm-1] of the sensor that would explain the radiance of all subjects"
    alt = f"{title}; gain farthest from 1: {gain[far]:.2f} ({low[far]:.2f} to {high[far]:.2f}) at "
    alt += f"{nm[far]:.0f} nm."
    offset = [marks.pop("o")] if "o" in marks else []
    parts = [Part(Axis("measured / predicted radiance"), tuple(marks.values()), (("y", 1.0),))]
    parts += [Part(Axis("offset"), (mark,), (("y", 0.0),)) for mark in offset]
    return Figure("sensor-gain", "attribution", title, alt, (Panels(Axis(WAVELENGTH), tuple(parts)),))


def _by_subject(rows: Sequence[Result]) -> Figure | None:
    """A matrix of subjects by inputs: the area of a dot is the part of the greatest gain of its row."""
    by = {(r.subject, r.method): r.value for r in rows}
    # A gain below 1 explains nothing; subjects without any greater one have nothing to explain.
    telling, asked = {r.subject for r in rows if r.value >= 1.0}, list(dict.fromkeys(r.subject for r in rows))
    every = [s for s in asked if s in telling]
    if not every:
        return None
    subjects = every[:_MOST_GROUPS]
    best = {n: max(r.value for r in rows if r.method == n) for n in dict.fromkeys(r.method for r in rows)}
    inputs = sorted((n for n in best if best[n] > 0.0), key=lambda n: -best[n])[:_MOST_INPUTS]
    gains = np.array([[by.get((s, n), 0.0) for n in inputs] for s in subjects])
    part = gains / np.maximum(gains.max(axis=1, keepdims=True), 1e-300)
    marks = []
    for first, label, colour in ((False, "part of it", _OTHER), (True, "greatest gain of a subject", _BEST)):
        own = (gains > 0.0) & ((part >= 0.999) == first)
        if own.any():
            y, x = np.nonzero(own)
            columns = {"x": x.astype(float), "y": y.astype(float), "size": 14.0 * np.sqrt(part[own])}
            words = tuple(f"{gain:.0f}" if gain >= 10.0 else f"{gain:.2g}" for gain in gains[own])
            beside: Any = "right" if first else ""
            marks.append(Mark("dots", columns, label, colour, marker="circle", words=words, beside=beside))
    legend = "the area of a dot is the gain (2 Δ ln L) as a part of the greatest of its subject"
    quiet = len(asked) - len(every)
    legend += f"; {quiet} subjects have nothing to explain" if quiet else ""
    legend += left_out(len(subjects), len(every), "results.csv")
    tops = "; ".join(f"{s}: {inputs[at]}" for s, at in zip(subjects, gains.argmax(axis=1), strict=True))
    title, alt = "The same for each subject", f"For each subject the input that gains most: {tops}."
    names = row_names(inputs, _LONGEST), row_names(subjects, _LONGEST)
    return of_rows("attribution-subjects", "attribution", title, alt, *names, marks, legend)


def _effects(rows: Sequence[Result]) -> Figure:
    """Change of each number of the comparison per unit of each input, as a matrix of colours."""

    def label(r: Result) -> str:
        what = r.metric.removesuffix("_change").replace("roc_pd@", "P_D ").removesuffix("_ratio_windows")
        way = r.method.partition(" / ")[2].removesuffix("/pixel")
        return f"{r.subject}, {what}" + (f" {way}" if way else "")

    every = list(dict.fromkeys(label(r) for r in rows))
    gaps = {label(r): abs(_leading_number(r.reason.partition("gap ")[2])) for r in rows}
    shown = sorted(every, key=lambda q: -gaps[q])[:_MOST_QUANTITIES]
    by = {(label(r), r.method.partition(" / ")[0]): r.value for r in rows}
    names = list(dict.fromkeys(r.method.partition(" / ")[0] for r in rows))
    names = sorted(names, key=lambda n: -max(abs(by.get((q, n), 0.0)) for q in shown))[:_MOST_INPUTS]
    y, x = (place.ravel().astype(float) for place in np.mgrid[: len(shown), : len(names)])
    values = np.array([by.get((q, n), math.nan) for q in shown for n in names])
    words = tuple(f"{v:+.{1 + (abs(v) >= 0.001)}g}" if abs(v) >= 0.0005 else "" for v in values)
    # Colours end where nearly all values lie: one that is far out takes them from all others.
    finite = np.abs(values[np.isfinite(values)])
    reach = max(float(np.percentile(finite, 97)) if finite.size else 0.0, 1e-6)
    columns = {"left": x - 0.5, "right": x + 0.5, "bottom": y - 0.5, "top": y + 0.5, "value": values}
    scale = ColourScale("signed", -reach, reach, "change per unit")
    cells = Mark("cells", columns, words=words, beside="centre", scale=scale)
    largest = max(((abs(v), q, n) for (q, n), v in by.items() if q in shown), default=(0.0, "", ""))
    alt = f"Change of {len(shown)} numbers of the comparison per unit of {len(names)} inputs; the largest, "
    alt += f"{largest[0]:.2g}, is that of {largest[1]} by {largest[2]}."
    legend = "one unit: the stated standard uncertainty of an input, or a standard step where none is stated; "
    legend += "gap: predicted minus measured; spectra relative to the measured mean, P_D as a difference; "
    legend += "the largest gaps are shown"
    quantities = [f"{q} (gap {gaps[q]:.2g})" for q in shown]
    ways = row_names(names, _LONGEST), row_names(quantities, 56)
    title = "Change by one unit of each input"
    return of_rows("attribution-effects", "sensitivity", title, alt, *ways, [cells], legend)


def _before_and_after(name: str, product: str, rows: Sequence[Result], names: list[str], title: str) -> Figure | None:
    """Reduced chi-square of each row, and that which its reason tells."""
    if not rows:
        return None
    before = np.array([_leading_number(r.reason) for r in rows])
    after, at = np.array([r.value for r in rows]), np.arange(float(len(rows)))
    marks = [Mark("dots", {"x": before, "y": at}, "as in the campaign", marker="circle", hollow=True)]
    for own, label, colour, marker in (
        (after < before, "after, closer", MET, "left"), (~(after < before), "after, farther", NOT_MET, "right")
    ):  # fmt: skip
        if own.any():
            ends = {"low": np.minimum(before, after)[own], "high": np.maximum(before, after)[own]}
            words = tuple(f"{value:.3g}" for value in after[own])
            marks.append(Mark("dots", {"x": after[own], "y": at[own], **ends}, label, colour, marker=marker,
                              along="x", words=words, beside="right"))  # fmt: skip
    both = [v for v in (*before, *after) if v > 0]
    scattered = bool(both) and max(both) > 20.0 * min(both)
    x = Axis("reduced chi-square", "log" if scattered else "linear")
    each = (f"{one} from {b:.3g} to {r.value:.3g}" for one, r, b in zip(names, rows, before, strict=True))
    alt, legend = f"{title}. Reduced chi-square: {'; '.join(each)}.", "dotted: 1, as expected from the uncertainties"
    return of_rows(name, product, title, alt, x, row_names(names, _LONGEST), marks, legend, (1.0,))


def _stated(table: ResultTable) -> set[str]:
    rows = [r for r in table.where(product="attribution") if r.metric == "needed_uncertainty"]
    return {r.method for r in rows if "none is stated" not in r.reason}


def _leading_number(text: str) -> float:
    return number_of((text.split() or [""])[0].rstrip(",;"))
