"""Interactive charts of a page: spectra by subject with their difference, and ROC curves.

Bokeh writes each as data in JSON; the page holds its script once, from the installed package, and needs no network.
Figures for print are drawn by ``figures_*``.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from bokeh.core.types import ID
from bokeh.embed import json_item
from bokeh.layouts import column
from bokeh.models import (
    BoxSelectTool,
    BoxZoomTool,
    ColumnDataSource,
    HoverTool,
    LayoutDOM,
    PanTool,
    Range1d,
    ResetTool,
    SaveTool,
    TabPanel,
    Tabs,
    WheelZoomTool,
)  # fmt: skip
from bokeh.models.annotations import Span
from bokeh.plotting import figure

from hyperval.products import Products, RocCurve, SpectralEstimate
from hyperval.report import style
from hyperval.report.figures_detection import best_counted
from hyperval.report.figures_spectra import Sides, both_first, difference_ratio
from hyperval.report.style import COLLECTED, PREDICTED
from hyperval.results import Outcome, Result
from hyperval.spectra.windows import ABSORPTION_BANDS_NM, in_window

Array = npt.NDArray[np.float64]
Column = npt.NDArray[np.float32]

_COVERAGE = 1.96  # normal quantile of a two-sided 95 % interval
SPECTRA = ("radiance", "toa_reflectance", "snr", "reflectance")
MOST_SUBJECTS = 24
MOST_CURVES = 24
FIRST = "the first few"  # of the subjects of curves
FIRST_CURVES = 3  # that are seen before a name in the legend is clicked
_MOST_POINTS = 200
_GREY = "#7a7f87"  # legible on white and on dark paper
_ABSORPTION = "#9aa0a8"
Labels = tuple[str, str]
LABELS: Labels = ("predicted", "collected")
_SPECTRUM_LOOKS = {
    "predicted": (PREDICTED.colour, "dashed"),
    "collected": (COLLECTED.colour, "solid"),
    "difference": (style.DIFFERENCE_COLOUR, "solid"),
}
_CURVE_COLOURS = ("#0072B2", "#C2410C", "#009E73", "#B4548F", "#5B3A8C", "#B58900")


@dataclass(frozen=True)
class Chart:
    """An interactive chart as the page holds it.

    Attributes
    ----------
    name, section, title, alt : as of a :class:`Drawing`
    content : JSON that the script draws
    subjects : those that a reader may choose among, the one that is shown at first before the others; maybe none
    """

    name: str
    section: str
    title: str
    alt: str
    content: str
    subjects: tuple[str, ...] = ()


@dataclass(frozen=True)
class Spectra:
    """What the chart of spectra shows of one subject.

    Attributes
    ----------
    nm : band centres
    bands : "predicted", "collected", "difference" -> value, and half-width of its 95 % interval
    ranges : limits of the plots
    """

    nm: Column
    bands: dict[str, tuple[Column, Column]]
    ranges: dict[str, tuple[float, float]]

    def packed(self, before: npt.NDArray[Any] | None = None) -> dict[str, Any]:
        """As the script reads it; wavelengths that are those of ``before`` are not repeated."""
        same = before is not None and np.array_equal(self.nm, before)
        bands = {name: [_text(value), _text(half)] for name, (value, half) in self.bands.items()}
        return {"columns": {} if same else {"nm": _text(self.nm)}, "bands": bands, "ranges": self.ranges}


def _text(values: Column) -> str:
    """Little-endian float32 as base64."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")


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
    predicted, collected = (_of_side(side, product) for side in sides)
    every = both_first(predicted, collected)
    pairs = [subject for subject in every if subject in predicted and subject in collected]
    if not pairs and None not in sides:
        return None
    shown = _worst_first(pairs or every, product, rows)[:MOST_SUBJECTS]
    if not shown:
        return None
    spectra = [subject_spectra(sides, predicted.get(name), collected.get(name), ratio=ratio) for name in shown]
    words = " and ".join(labels) if pairs else labels[0] if sides[0] is not None else labels[1]
    name = f"chart-{product}"
    return Chart(
        name,
        product,
        f"{title}: {words} (grey: absorption){style.left_out([shown], pairs or every)}",
        f"{title} against wavelength, a subject at a time: {labels[0]} (dashed) and {labels[1]} (solid) with 95 % "
        f"intervals{', the difference below' if pairs else ''}. Subjects: {', '.join(shown)}.",
        _content(
            _spectra_plots(spectra[0], label, ratio, labels),
            name,
            [one.packed(spectra[0].nm if i else None) for i, one in enumerate(spectra)],
        ),
        tuple(shown),
    )


def roc_chart(sides: Sides, labels: Labels = LABELS) -> Chart | None:
    """P_D against P_FA, a tab for each detector and unit, a name in the legend for each subject."""
    predicted, measured = (_of_side(side, "roc") for side in sides)
    every = both_first(predicted, measured)
    pairs = [key for key in every if key in predicted and key in measured]
    kinds = list(dict.fromkeys(key[1:] for key in pairs or every))
    if not kinds:
        return None
    tabs, shown = [], []
    for detector, unit in kinds:
        keys = [key for key in pairs or every if key[1:] == (detector, unit)]
        keys = best_counted(keys, measured, MOST_CURVES // len(kinds) or 1)
        shown.append(keys)
        tabs.append(TabPanel(title=f"{detector}, by {unit}", child=_curves(keys, predicted, measured, labels)))
    names = tuple(dict.fromkeys(key[0] for keys in shown for key in keys))
    second = "measured" if labels == LABELS else labels[1]
    return Chart(
        "chart-roc",
        "roc",
        f"ROC: {labels[0]} (dashed) and {second}; a click on a name shows or hides it"
        f"{style.left_out(shown, pairs or every)}",
        f"Probability of detection against probability of false alarm (logarithmic), {labels[0]} dashed and "
        f"{second}{' in steps' if second == 'measured' else ''}, with 95 % intervals, a tab for each detector. "
        f"Subjects: {', '.join(names)}.",
        _content(Tabs(tabs=tabs, sizing_mode="stretch_width"), "chart-roc"),
        (FIRST, *names) if len(names) > 1 else (),
    )


def _of_side(side: Products | None, product: str) -> Mapping[Any, Any]:
    return {} if side is None else getattr(side, product)


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
        if ratio:
            value, u = difference_ratio(predicted, collected)
        else:
            value = predicted.mean - collected.mean
            u = np.hypot(predicted.standard_uncertainty, collected.standard_uncertainty)
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
    return Spectra(_column(w), columns, ranges)


def _edges(band: tuple[Array, Array], keep: npt.NDArray[np.bool_]) -> list[Array]:
    value, half = band
    return [(value - half)[keep], (value + half)[keep]]


def _spectra_plots(spectra: Spectra, label: str, ratio: bool, labels: Labels = LABELS) -> Any:
    """The plot of both sides, with that of their difference where there is one."""
    # The script fills the columns of the first subject in: the page has them once.
    names = [f"{name}{end}" for name in spectra.bands for end in ("", "_low", "_high")]
    empty: dict[str, Any] = dict.fromkeys(("nm", *names), np.empty(0, np.float32))
    source = ColumnDataSource(empty, name="spectra")
    starts, ends, _ = zip(*ABSORPTION_BANDS_NM, strict=True)
    absorption = ColumnDataSource({"start": _column(np.array(starts)), "end": _column(np.array(ends))})
    w = spectra.nm
    span = Range1d(start=float(w[0]), end=float(max(w[-1], w[0] + 1.0)))
    plots = []
    shown = {**dict(zip(LABELS, labels, strict=True)), "difference": "difference"}
    sides = [name for name in spectra.bands if name != "difference"]
    for height, range_name, axis_label, names in (
        (300, "level", label, sides),
        (190, "gap", "difference ratio [1]" if ratio else "difference [1]", ["difference"]),
    ):
        if names[0] not in spectra.bands:
            continue
        plot = _plot(height, span, axis_label, absorption)
        start, end = spectra.ranges.get(range_name, (0.0, 1.0))
        plot.y_range = Range1d(start=start, end=end, name=range_name)
        lines = []
        for name in names:
            colour, dash = _SPECTRUM_LOOKS[name]
            plot.varea("nm", f"{name}_low", f"{name}_high", source=source, fill_color=colour, fill_alpha=0.2)
            named = {} if name == "difference" else {"legend_label": shown[name]}
            lines.append(
                plot.line("nm", name, source=source, color=colour, line_dash=dash, line_width=1.6, **named)
            )
            # Bands that are chosen in one plot stand out in both: their source is one.
            plot.scatter(
                "nm",
                name,
                source=source,
                size=5,
                color=colour,
                alpha=0.0,
                selection_alpha=1.0,
                nonselection_alpha=0.0,
            )
        tips = [
            (shown[name], f"@{name}{{0.0000}} (@{name}_low{{0.0000}} to @{name}_high{{0.0000}})") for name in names
        ]
        plot.add_tools(HoverTool(tooltips=[("nm", "@nm{0.0}"), *tips], mode="vline", renderers=lines[:1]))
        if range_name == "level":
            _legend(plot)
        else:
            plot.add_layout(Span(location=0.0, dimension="width", line_color=_GREY))
        plots.append(plot)
    plots[-1].xaxis.axis_label = style.WAVELENGTH_LABEL
    return column(*plots, sizing_mode="stretch_width")


def _curves(
    keys: Sequence[tuple[str, str, str]],
    predicted: Mapping[Any, RocCurve],
    measured: Mapping[Any, RocCurve],
    labels: Labels = LABELS,
) -> Any:
    """The ROC curves of one detector and unit; the first few are seen, the others when their name is clicked."""
    curves = [c[key] for c in (predicted, measured) for key in keys if key in c]
    lowest = min((float(c.pfa[c.pfa > 0].min()) for c in curves if (c.pfa > 0).any()), default=1e-3)
    counted = [1.0 / c.n_background for c in measured.values() if c.n_background]
    low = max(lowest, min(counted) / 100.0 if counted else lowest)
    plot = _plot(420, Range1d(start=low, end=1.0), "P_D [1]", x_axis_type="log")
    plot.y_range = Range1d(start=-0.02, end=1.04)
    lines = []
    plot.xaxis.axis_label = "P_FA per pixel [1]"
    for number, key in enumerate(keys):
        colour, seen = _CURVE_COLOURS[number % len(_CURVE_COLOURS)], number < FIRST_CURVES
        name = style.shortened(key[0], 30)
        second = "measured" if labels == LABELS else labels[1]
        for side, own, dash in ((labels[0], predicted, "dashed"), (second, measured, "solid")):
            if key not in own:
                continue
            source = ColumnDataSource(_curve_data(own[key], low))
            common: dict[str, Any] = {"source": source, "legend_label": name, "visible": seen}
            plot.varea("pfa", "low", "high", fill_color=colour, fill_alpha=0.12, **common)
            drawn = plot.line if side != "measured" else plot.step
            more = {} if side != "measured" else {"mode": "after"}
            look = {"color": colour, "line_dash": dash, "line_width": 1.6, "name": f"{name}, {side}"}
            lines.append(drawn("pfa", "pd", **look, **more, **common))
            for curve in plot.renderers[-2:]:
                curve.tags = [key[0], seen]
    tips = [("", "$name"), ("P_FA", "@pfa"), ("P_D", "@pd{0.000} (@low{0.000} to @high{0.000})")]
    plot.add_tools(HoverTool(tooltips=tips, renderers=lines, mode="mouse"))
    if counted:
        plot.add_layout(Span(location=min(counted), dimension="height", line_color=_GREY, line_dash="dotted"))
    _legend(plot)
    plot.add_layout(plot.legend[0], "right")
    return plot


def _curve_data(curve: RocCurve, low: float) -> dict[str, Column]:
    """At most a few hundred points of a curve, evenly spread over the logarithm of P_FA."""
    keep = np.flatnonzero(curve.pfa >= low)
    if keep.size > _MOST_POINTS:
        wanted = np.geomspace(curve.pfa[keep[0]], curve.pfa[keep[-1]], _MOST_POINTS)
        keep = np.unique(np.clip(np.searchsorted(curve.pfa, wanted), keep[0], keep[-1]))
    columns = {"pfa": curve.pfa, "pd": curve.pd, "low": curve.pd_lower, "high": curve.pd_upper}
    return {name: _column(values[keep]) for name, values in columns.items()}


def _plot(height: int, span: Range1d, label: str, absorption: ColumnDataSource | None = None, **more: Any) -> Any:
    """An empty plot in the house's look, legible on white and on dark paper."""
    plot = figure(
        height=height,
        sizing_mode="stretch_width",
        x_range=span,
        y_axis_label=label,
        tools=[PanTool(), BoxZoomTool(), WheelZoomTool(), ResetTool(), SaveTool()],
        toolbar_location="above",
        background_fill_alpha=0.0,
        border_fill_alpha=0.0,
        outline_line_color=None,
        min_border_left=72,  # so that plots above each other have one wavelength axis
        **more,
    )
    plot.toolbar.logo = None
    if absorption is not None:
        plot.add_tools(BoxSelectTool(dimensions="width"))
        plot.vstrip("start", "end", source=absorption, fill_color=_ABSORPTION, fill_alpha=0.22, line_alpha=0.0)
    for axis in (*plot.xaxis, *plot.yaxis):
        axis.axis_label_text_color = axis.major_label_text_color = axis.axis_line_color = _GREY
        axis.major_tick_line_color = axis.minor_tick_line_color = _GREY
        axis.axis_label_text_font_style = "normal"
    plot.grid.grid_line_color = _GREY
    plot.grid.grid_line_alpha = 0.25
    return plot


def _legend(plot: Any) -> None:
    plot.legend.click_policy = "hide"
    plot.legend.background_fill_alpha = 0.0
    plot.legend.border_line_alpha = 0.0
    plot.legend.label_text_color = _GREY


def _column(values: Array) -> Column:
    return np.asarray(values, dtype=np.float32)


def _content(model: LayoutDOM, target: str, subjects: Sequence[Mapping[str, Any]] = ()) -> str:
    """The JSON of a chart, its models numbered as they stand in it: the same run gives the same bytes."""
    item: Any = json_item(model, ID(target))
    numbers: dict[str, str] = {}

    def named(value: Any) -> None:
        if isinstance(value, dict):
            if isinstance(value.get("id"), str):
                numbers.setdefault(value["id"], f"c{len(numbers)}")
            for part in value.values():
                named(part)
        elif isinstance(value, list):
            for part in value:
                named(part)

    def renamed(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: renamed(part) for key, part in value.items()}
        if isinstance(value, list):
            return [renamed(part) for part in value]
        return numbers.get(value, value) if isinstance(value, str) else value

    named(item["doc"])
    content = {"item": renamed(item), "subjects": subjects}
    # "<" cannot end the script that holds it.
    return json.dumps(content, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")
