"""Interactive charts of a page: spectra by subject with their difference, and ROC curves.

Bokeh writes each as data in JSON; the page holds its script once, from the installed package, and needs no network.
Figures for print are drawn by ``figures_*``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.products import RocCurve, SpectralEstimate
from hyperval.report import style
from hyperval.report.charts_base import (
    LABELS,
    Chart,
    Curves,
    Fill,
    Labels,
    chart_content,
    column_text,
)
from hyperval.report.sides import (
    Sides,
    best_counted,
    both_first,
    difference,
    of_side,
)
from hyperval.report.text_cache import chart_models
from hyperval.results import Outcome, Result
from hyperval.spectra.windows import in_window

Array = npt.NDArray[np.float64]
Column = npt.NDArray[np.float32]

_COVERAGE = 1.96  # normal quantile of a two-sided 95 % interval
SPECTRA = ("radiance", "toa_reflectance", "snr", "reflectance")
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
    label, title, ratio = {
        "radiance": ("radiance [µW cm⁻² sr⁻¹ nm⁻¹]", "Radiance at the sensor", True),
        "reflectance": ("reflectance [1]", "Reflectance", False),
        "toa_reflectance": ("reflectance [1]", "Reflectance at the top of the atmosphere", True),
        "snr": ("signal-to-noise ratio [1]", "Signal-to-noise ratio", True),
    }[product]
    predicted, collected = (of_side(side, product) for side in sides)
    every = both_first(predicted, collected)
    pairs = [subject for subject in every if subject in predicted and subject in collected]
    if not pairs and None not in sides:
        return None
    shown = _worst_first(pairs or every, product, rows)[:MOST_SUBJECTS]
    if not shown:
        return None
    spectra = [subject_spectra(sides, predicted.get(name), collected.get(name), ratio=ratio) for name in shown]
    words = " and ".join(labels) if pairs else labels[0] if sides[0] is not None else labels[1]
    identical = bool(pairs) and not any(np.nan_to_num(own.bands["difference"][0]).any() for own in spectra)
    if identical:  # nothing to draw
        words += ", which are identical"
        spectra = [own.without_difference() for own in spectra]
    name, first = f"chart-{product}", spectra[0]
    over, grey = ("number of the band", "") if first.numbered else ("wavelength", " (grey: absorption)")
    below = ", the difference below" if "difference" in first.bands else ""
    nm = float(first.nm[0]), float(max(first.nm[-1], first.nm[0] + 1.0))
    return Chart(
        name,
        product,
        f"{title}: {words} {grey}{style.left_out([shown], pairs or every)}",
        f"{title} against {over}, a subject at a time: {labels[0]} (dashed) and {labels[1]} (solid) with 95 % "
        f"intervals{below}. Subjects: {', '.join(shown)}.",
        chart_content(
            chart_models("spectra", name, tuple(first.bands), first.numbered, label, ratio, labels),
            Fill(ranges={"nm": nm}),
            [one.packed(first.nm if i else None) for i, one in enumerate(spectra)],
        ),
        tuple(shown),
    )


def roc_chart(sides: Sides, labels: Labels = LABELS) -> Chart | None:
    """P_D against P_FA, a tab for each detector and unit, a name in the legend for each subject."""
    predicted, measured = (of_side(side, "roc") for side in sides)
    every = both_first(predicted, measured)
    pairs = [key for key in every if key in predicted and key in measured]
    kinds = list(dict.fromkeys(key[1:] for key in pairs or every))
    if not kinds:
        return None
    tabs, shown, fill = [], [], Fill()
    for number, (detector, unit) in enumerate(kinds):
        keys = [key for key in pairs or every if key[1:] == (detector, unit)]
        keys = best_counted(keys, measured, MOST_CURVES // len(kinds) or 1)
        shown.append(keys)
        tabs.append((f"{detector}, by {unit}", _fill_curves(fill, number, keys, predicted, measured)))
    names = tuple(dict.fromkeys(key[0] for keys in shown for key in keys))
    second = "measured" if labels == LABELS else labels[1]
    words = f"{labels[0]} (dashed) and {second}" if measured or labels == LABELS else labels[0]
    return Chart(
        "chart-roc",
        "roc",
        f"ROC: {words}; a click on a name shows or hides it{style.left_out(shown, pairs or every)}",
        f"Probability of detection against probability of false alarm (logarithmic), {labels[0]} dashed and "
        f"{second}{' in steps' if second == 'measured' else ''}, with 95 % intervals, a tab for each detector. "
        f"Subjects: {', '.join(names)}.",
        chart_content(chart_models("curves", "chart-roc", tuple(tabs), labels), fill),
        (FIRST, *names) if len(names) > 1 else (),
    )


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
    keep = in_window(w) if in_window(w).any() else np.ones(w.shape, bool)
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


def _edges(band: tuple[Array, Array], keep: npt.NDArray[np.bool_]) -> list[Array]:
    value, half = band
    return [(value - half)[keep], (value + half)[keep]]


def _fill_curves(
    fill: Fill,
    tab: int,
    keys: Sequence[tuple[str, str, str]],
    predicted: Mapping[Any, RocCurve],
    measured: Mapping[Any, RocCurve],
) -> Curves:
    """Note the numbers of the curves of one detector and unit."""
    curves = [c[key] for c in (predicted, measured) for key in keys if key in c]
    lowest = min((float(c.pfa[c.pfa > 0].min()) for c in curves if (c.pfa > 0).any()), default=1e-3)
    counted = [1.0 / c.n_background for c in measured.values() if c.n_background]
    low = max(lowest, min(counted) / 100.0 if counted else lowest)
    fill.ranges[f"pfa-{tab}"] = low, 1.0
    if counted:
        fill.spans[f"counted-{tab}"] = min(counted)
    subjects = []
    for number, key in enumerate(keys):
        sides = tuple(side for side, own in enumerate((predicted, measured)) if key in own)
        for side in sides:
            fill.add(f"curve-{tab}-{number}-{side}", _curve_data((predicted, measured)[side][key], low))
        subjects.append((key[0], sides))
    return Curves(tuple(subjects), bool(counted))


def _curve_data(curve: RocCurve, low: float) -> dict[str, Column]:
    """At most a few hundred points of a curve, evenly spread over the logarithm of P_FA."""
    keep = np.flatnonzero(curve.pfa >= low)
    if keep.size > _MOST_POINTS:
        wanted = np.geomspace(curve.pfa[keep[0]], curve.pfa[keep[-1]], _MOST_POINTS)
        keep = np.unique(np.clip(np.searchsorted(curve.pfa, wanted), keep[0], keep[-1]))
    columns = {"pfa": curve.pfa, "pd": curve.pd, "low": curve.pd_lower, "high": curve.pd_upper}
    return {name: _column(values[keep]) for name, values in columns.items()}


def _column(values: Array) -> Column:
    return np.asarray(values, dtype=np.float32)
