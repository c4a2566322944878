"""The datasheet: one page on a sensor, with nothing loaded from elsewhere; and its folder.

Figures of a datasheet: response, SNR, noise, saturation, detection, sensitivity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from hyperval.campaign.provenance import command_without_output, provenance
from hyperval.products import PredictedProducts
from hyperval.report import style
from hyperval.report import verdict as v
from hyperval.report.html import common_words, environment
from hyperval.report.netcdf import write_products
from hyperval.report.outputs import write_page, write_tables
from hyperval.report.style import Drawing
from hyperval.results import Outcome, Result
from hyperval.sensor.specification import Sensor, library_names, load_sensor
from hyperval.sensor_check.suite import (
    LEVELS,
    MIDDLE,
    TOLERANCE,
    Probe,
    SensorCheck,
    SnrPoint,
    Swing,
    check_sensor,
    neighbour_ratio,
    numbers,
    sunlit_radiance,
)
from hyperval.spectra.axis import SIGMA_PER_FWHM, SpectralAxis, in_window
from hyperval.storage import sha256_of, whole_folder

Array = npt.NDArray[np.float64]

_MOST_RESPONSES = 12
_SOURCES = {
    "shot": "photons",
    "fixed": "fixed",
    "quantisation": "quantisation",
    "bit_errors": "bit errors",
    "calibration": "C_R (calibration error)",
    "fit": "rest of the fit",
}


def draw_datasheet(check: SensorCheck) -> list[Drawing]:
    """Every figure that the checks allow, in the order of the page."""
    if not check.usable:
        return []
    with style.house_style():
        figures = [
            response_figure(check),
            snr_figure(check),
            published_figure(check.points) if check.points else None,
            noise_figure(check),
            saturation_figure(check),
            detection_figure(check.predictions),
            sensitivity_figure(check.swings, check.probe, check.vary),
        ]
    return [drawing for drawing in figures if drawing is not None]


def response_figure(check: SensorCheck) -> Drawing:
    """Widths against spacing, and the responses of a few bands."""
    axis = check.sensor.axis
    figure = style.new_figure(10.0, 3.2, "Bands", False)
    left, right = figure.subplots(1, 2)
    left.plot(axis.centre_nm, axis.fwhm_nm, color=style.SOURCE_COLOURS[0], marker=".", markersize=3, linewidth=0.8)
    if len(axis) > 1:
        middle = 0.5 * (axis.centre_nm[:-1] + axis.centre_nm[1:])
        spacing = np.diff(axis.centre_nm)
        together = check.sensor.specification.bands.spacing == "contiguous"
        if together:  # what is left out between spectrometers is no spacing
            spacing = np.where(spacing > 3.0 * np.median(spacing), np.nan, spacing)
        left.plot(middle, spacing, color=style.SOURCE_COLOURS[5], linewidth=0.9, linestyle="--")
    left.set_xlabel(style.WAVELENGTH_LABEL)
    left.set_ylabel("width, spacing [nm]")
    left.set_title("Full width at half maximum, and spacing", loc="left")
    shown = _few_bands(axis)
    for k in shown:
        sigma = axis.fwhm_nm[k] * SIGMA_PER_FWHM
        w = axis.centre_nm[k] + np.linspace(-3 * sigma, 3 * sigma, 61)
        colour = style.SOURCE_COLOURS[int(k) % 2 * 5]
        right.plot(w, np.exp(-0.5 * ((w - axis.centre_nm[k]) / sigma) ** 2), color=colour, linewidth=1.0)
    right.set_xlabel(style.WAVELENGTH_LABEL)
    right.set_ylabel("relative response [1]")
    right.set_title(f"Responses of {shown.size} bands", loc="left")
    style.add_legend(
        figure,
        [
            (Line2D([], [], color=style.SOURCE_COLOURS[0], marker=".", markersize=4), "FWHM"),
            (Line2D([], [], color=style.SOURCE_COLOURS[5], linestyle="--"), "spacing"),
        ],
    )
    ratio = f"; the median width is {np.median(neighbour_ratio(axis)):.2f} spacings" if len(axis) > 1 else ""
    alt = f"Width and spacing of the {len(axis)} bands against wavelength, and the responses of a few{ratio}."
    return style.vector_drawing(figure, "response", "response", "Bands: width, spacing and response", alt)


def snr_figure(check: SensorCheck) -> Drawing:
    """SNR against wavelength at the reference radiances, with and without C_R."""
    axis, noise = check.sensor.axis, check.sensor.noise()
    figure = style.new_figure(10.0, 3.6, "Signal-to-noise ratio, sun at 45° and no atmosphere", False)
    axes = figure.subplots()
    entries: list[tuple[Any, str]] = []
    highest = []
    for level, colour in zip(LEVELS, style.SOURCE_COLOURS, strict=False):
        radiance = sunlit_radiance(axis, level)
        free, calibrated = noise.snr(radiance, calibration=False), noise.snr(radiance)
        _curve(axes, axis, free, colour, "-")
        _curve(axes, axis, calibrated, colour, "--")
        highest.append(free[_shown(axis) if len(axis) >= 30 else axis.good])
        entries.append((Line2D([], [], color=colour, marker=_marker(axis)), f"reflectance {level:g}"))
    entries.append((Line2D([], [], color="#444444"), "without calibration error C_R"))
    entries.append((Line2D([], [], color="#444444", linestyle="--"), "with C_R"))
    _wavelength_axis(axes, axis, style.robust_limits(highest, zero=True))
    axes.set_ylabel("signal-to-noise ratio [1]")
    style.add_legend(figure, entries)
    middle = noise.snr(sunlit_radiance(axis, MIDDLE), calibration=False)[_shown(axis)]
    alt = (
        "Signal-to-noise ratio against wavelength for ground of 0.05, 0.25 and 0.6, with and without the "
        f"calibration error. At 0.25 without it: median {np.median(middle):.0f}, {middle.min():.0f} to "
        f"{middle.max():.0f}."
    )
    title = "Signal-to-noise ratio at the reference radiances (solid: without C_R; dashed: with it)"
    return style.vector_drawing(figure, "snr", "snr", title, alt)


def noise_figure(check: SensorCheck) -> Drawing:
    """Share of each source in the noise variance."""
    axis = check.sensor.axis
    figure = style.new_figure(10.0, 3.4, "Sources of noise", False)
    panels = figure.subplots(1, 2, sharey=True)
    shown: dict[str, str] = {}
    for axes, level in zip(panels, (LEVELS[0], LEVELS[-1]), strict=True):
        parts = check.sensor.noise().breakdown(sunlit_radiance(axis, level))
        rows = {words: getattr(parts, name) for name, words in _SOURCES.items()}
        total = sum(np.abs(v) for v in rows.values())
        kept = {words: 100.0 * np.abs(v) / total for words, v in rows.items() if np.max(np.abs(v) / total) > 1e-4}
        for words in kept:
            shown.setdefault(words, style.SOURCE_COLOURS[list(_SOURCES.values()).index(words)])
        if len(axis) < 30:
            base = np.zeros(len(axis))
            for words, share in kept.items():
                axes.bar(axis.centre_nm, share, axis.fwhm_nm, bottom=base, color=shown[words], linewidth=0)
                base = base + share
        else:
            axes.stackplot(axis.centre_nm, list(kept.values()), colors=[shown[w] for w in kept], linewidth=0)
        _wavelength_axis(axes, axis, (0.0, 100.0))
        axes.set_title(f"reflectance {level:g}", loc="left")
    panels[0].set_ylabel("share of the variance [%]")
    style.add_legend(figure, [(Patch(color=colour), words) for words, colour in shown.items()])
    alt = f"Share of each source in the variance of the noise, dark and bright ground: {', '.join(shown)}."
    return style.vector_drawing(figure, "noise", "noise", "Sources of noise, dark and bright ground", alt)


def saturation_figure(check: SensorCheck) -> Drawing | None:
    """Signal as a part of full scale; None where the file does not say where that is."""
    axis, noise = check.sensor.axis, check.sensor.noise()
    if noise.full_scale is None:
        return None
    figure = style.new_figure(10.0, 3.0, "Signal as a part of full scale, sun at 45° and no atmosphere", False)
    axes = figure.subplots()
    entries: list[tuple[Any, str]] = []
    highest = 1.0
    for level, colour in zip((*LEVELS[1:], 1.0), style.SOURCE_COLOURS, strict=False):
        part = noise.full_scale_fraction(sunlit_radiance(axis, level))
        _curve(axes, axis, part, colour, "-")
        highest = max(highest, float(np.max(part)))
        entries.append((Line2D([], [], color=colour, marker=_marker(axis)), f"reflectance {level:g}"))
    axes.axhline(1.0, color="#9b1c1c", linewidth=1.0, linestyle=":")
    entries.append((Line2D([], [], color="#9b1c1c", linestyle=":"), "full scale"))
    _wavelength_axis(axes, axis, (0.0, 1.08 * highest))
    axes.set_ylabel("part of full scale [1]")
    style.add_legend(figure, entries)
    alt = f"Signal as a part of full scale against wavelength; the highest, at reflectance 1, is {highest:.2f}."
    return style.vector_drawing(figure, "saturation", "saturation", "Signal as a part of full scale", alt)


def _few_bands(axis: SpectralAxis) -> npt.NDArray[np.intp]:
    if len(axis) <= _MOST_RESPONSES:
        return np.arange(len(axis))
    first = int(np.clip(np.argmin(np.abs(axis.centre_nm - 550.0)) - 5, 0, len(axis) - _MOST_RESPONSES))
    return np.arange(first, first + _MOST_RESPONSES)


def _shown(axis: SpectralAxis) -> npt.NDArray[np.bool_]:
    keep = axis.good & in_window(axis.centre_nm)
    return keep if keep.any() else np.ones(len(axis), bool)


def _marker(axis: SpectralAxis) -> str:
    return "o" if len(axis) < 30 else ""


def _curve(axes: Axes, axis: SpectralAxis, values: Array, colour: str, line: str) -> None:
    """A line over the good bands; gaps where bands are bad or left out."""
    y = np.where(axis.good, values, np.nan)
    w = axis.centre_nm
    if len(axis) >= 30:
        wide = np.flatnonzero(np.diff(w) > 40.0) + 1
        w, y = np.insert(w, wide, w[wide] - 1.0), np.insert(y, wide, np.nan)
    axes.plot(w, y, color=colour, linestyle=line, linewidth=1.1, marker=_marker(axis), markersize=3)


def _wavelength_axis(axes: Axes, axis: SpectralAxis, limits: tuple[float, float] | None) -> None:
    low = float(axis.centre_nm[0] - axis.fwhm_nm[0])
    high = float(axis.centre_nm[-1] + axis.fwhm_nm[-1])
    style.shade_absorption(axes, low, high)
    axes.set_xlim(low, high)
    axes.set_xlabel(style.WAVELENGTH_LABEL)
    if limits is not None:
        axes.set_ylim(*limits)


_MOST_SWINGS = 20
_LOWEST_PFA = 1e-6


def published_figure(points: Sequence[SnrPoint]) -> Drawing:
    """Computed over published ratio by wavelength."""
    figure = style.new_figure(10.0, 3.0, "Computed over published signal-to-noise ratio", False)
    axes = figure.subplots()
    looks = {
        "value": ("o", style.SOURCE_COLOURS[0], "published value"),
        "at least": ("^", style.SOURCE_COLOURS[2], "published lower bound"),
        "unstated": ("x", style.SOURCE_COLOURS[7], "no radiance stated: not judged"),
    }
    used = []
    for point in points:
        kind = point.item.says if point.judged else "unstated"
        used.append(kind)
        marker, colour, _ = looks[kind]
        ratio = point.computed / point.published
        axes.plot(point.wavelength_nm, ratio, marker=marker, color=colour, markersize=6, linestyle="")
        axes.annotate(
            f"{point.computed:.0f} / {point.published:g}", (point.wavelength_nm, ratio), fontsize=8,
            xytext=(6, 4), textcoords="offset points",
        )  # fmt: skip
    axes.axhline(1.0, color="#444444", linewidth=0.9)
    entries: list[tuple[Any, str]] = [
        (Line2D([], [], marker=m, color=c, linestyle=""), text) for k, (m, c, text) in looks.items() if k in used
    ]
    if "value" in used:
        axes.axhspan(1 - TOLERANCE, 1 + TOLERANCE, color=style.ABSORPTION_COLOUR, linewidth=0, zorder=0)
        entries.append((Patch(color=style.ABSORPTION_COLOUR), f"within {100 * TOLERANCE:g} %"))
    ratios = [p.computed / p.published for p in points]
    axes.set_ylim(min(0.6, 0.9 * min(ratios)), max(1.4, 1.15 * max(ratios)))
    span = max(p.wavelength_nm for p in points) - min(p.wavelength_nm for p in points)
    margin = max(0.12 * span, 60.0)
    axes.set_xlim(min(p.wavelength_nm for p in points) - margin, max(p.wavelength_nm for p in points) + 1.3 * margin)
    axes.set_xlabel(style.WAVELENGTH_LABEL)
    axes.set_ylabel("computed / published [1]")
    style.add_legend(figure, entries)
    listed = "; ".join(f"{p.wavelength_nm:g} nm {p.computed:.0f} to {p.published:g}" for p in points)
    title = "Computed over published signal-to-noise ratio (numbers: computed / published)"
    alt = f"Computed against published ratios: {listed}."
    return style.vector_drawing(figure, "published-snr", "published_snr", title, alt)


def detection_figure(predictions: Mapping[str, PredictedProducts]) -> Drawing | None:
    """Receiver operating characteristic of every target of the standard scenes."""
    scenes = {name: prediction for name, prediction in predictions.items() if prediction.roc}
    if not scenes:
        return None
    figure = style.new_figure(10.0, 3.6, "Detection in the standard scenes", False)
    panels = np.atleast_1d(figure.subplots(1, len(scenes), sharey=True))
    detectors = sorted({key[1] for prediction in scenes.values() for key in prediction.roc})
    lines: dict[str, Any] = dict(zip(detectors, ("-", "--", ":", "-."), strict=False))
    for axes, (name, prediction) in zip(panels, scenes.items(), strict=True):
        subjects = list(dict.fromkeys(key[0] for key in prediction.roc))
        for (subject, detector, unit), curve in prediction.roc.items():
            if unit != "pixel" or detector not in lines:
                continue
            colour = style.SOURCE_COLOURS[subjects.index(subject) % len(style.SOURCE_COLOURS)]
            keep = curve.pfa >= _LOWEST_PFA
            axes.plot(curve.pfa[keep], curve.pd[keep], color=colour, linestyle=lines[detector], linewidth=1.2)
        _detection_axes(axes, name)
        axes.legend(
            [Line2D([], [], color=style.SOURCE_COLOURS[i % 8]) for i in range(len(subjects))],
            [style.plain(style.shortened(s, 24)) for s in subjects], loc="upper left", fontsize=8,
            ncols=2,
        )  # fmt: skip
    panels[0].set_ylabel("P_D [1]")
    style.add_legend(figure, [(Line2D([], [], color="#444444", linestyle=lines[d]), d) for d in lines])
    alt = f"Probability of detection against that of false alarm in {', '.join(scenes)}, by target and detector."
    title = "Detection in the standard scenes with this sensor"
    return style.vector_drawing(figure, "detection", "scenario", title, alt)


def sensitivity_figure(swings: Sequence[Swing], probe: Probe | None, vary: float) -> Drawing | None:
    """Tornado: what each assumed number does to the SNR and to P_D."""
    if not swings:
        return None
    kept = list(swings[:_MOST_SWINGS])
    figure = style.new_figure(
        10.0, 1.3 + 0.24 * len(kept), f"Assumed numbers, {100 * vary:g} % lower and higher", False
    )
    left, right = figure.subplots(1, 2, sharey=True)
    rows = np.arange(len(kept))[::-1]
    for axes, pick, factor in ((left, "snr", 100.0), (right, "detection", 1.0)):
        for k, colour in ((0, style.SOURCE_COLOURS[4]), (1, style.SOURCE_COLOURS[5])):
            axes.barh(rows, [factor * getattr(s, pick)[k] for s in kept], color=colour, height=0.62)
        axes.axvline(0.0, color="#444444", linewidth=0.8)
        axes.grid(axis="y", visible=False)
    left.set_yticks(rows, [style.plain(s.number.name) for s in kept])
    left.tick_params(axis="y", labelsize=8)
    left.set_xlabel("change of the SNR at reflectance 0.25 [%]")
    right.xaxis.set_major_locator(MaxNLocator(5))
    what = f"change of P_D: {probe.key[0]}, {probe.key[1]}" if probe else "change of P_D [1]"
    right.set_xlabel(style.plain(f"{what} [1]" if probe else what))
    shades = ((style.SOURCE_COLOURS[4], "lower"), (style.SOURCE_COLOURS[5], "higher"))
    style.add_legend(figure, [(Patch(color=colour), words) for colour, words in shades])
    most = kept[0]
    alt = (
        f"Bars of what each of {len(swings)} assumed numbers does when it is {100 * vary:g} % lower or higher. "
        f"Most for the SNR: {most.number.name}, {100 * most.snr[0]:+.1f} % and {100 * most.snr[1]:+.1f} %."
    )
    more = f"; {len(kept)} of {len(swings)} are drawn" if len(kept) < len(swings) else ""
    title = f"What each assumed number does to the SNR (of the band it moves most) and to P_D{more}"
    return style.vector_drawing(figure, "sensitivity", "sensitivity", title, alt)


def _detection_axes(axes: Axes, name: str) -> None:
    axes.set_xscale("log")
    axes.set_xlim(_LOWEST_PFA, 1.0)
    style.log_ticks(axes.xaxis)
    axes.set_ylim(0.0, 1.32)  # room for the legend above the curves
    axes.set_yticks(np.linspace(0.0, 1.0, 6))
    axes.set_xlabel("P_FA [1]")
    axes.set_title(style.plain(name), loc="left")


SECTIONS = {
    "file": "The file",
    "response": "Bands and response",
    "throughput": "Throughput and gain",
    "snr": "Signal-to-noise ratio",
    "published_snr": "Against published ratios",
    "noise": "Noise",
    "saturation": "Saturation",
    "monotone": "Behaviour",
    "scenario": "Standard scenarios",
    "sensitivity": "Sensitivity to what is assumed",
}
_FOLDED = 12  # rows of a section that are not folded


def datasheet_page(check: SensorCheck, drawings: Sequence[Drawing], provenance: dict[str, Any]) -> str:
    """The page of one sensor."""
    rows = list(check.table)
    listed = numbers(check.sensor.specification)
    failed = [r for r in rows if v.gate_fails(r)]
    return (
        environment()
        .get_template("datasheet.html.j2")
        .render(
            sensor=check.sensor.specification,
            tone=_tone(rows),
            verdict=_verdict(rows, sum(n.assumed for n in listed), len(listed)),
            counts=v.outcome_words(rows),
            failed=failed,
            known=[r for r in rows if v.disagrees_without_gating(r)],
            facts=_facts(check.sensor),
            numbers=listed,
            assumed=sum(n.assumed for n in listed),
            sections=_sections(rows, drawings),
            beside=bands_beside(check.sensor),
            provenance=provenance,
            folded=_FOLDED,
            **common_words(),
        )
    )


def _tone(rows: Sequence[Result]) -> str:
    if any(v.gate_fails(r) for r in rows):
        return "disagrees"
    return "undecided" if any(v.disagrees_without_gating(r) for r in rows) else "agrees"


def _verdict(rows: Sequence[Result], assumed: int, numbers_in_all: int) -> str:
    failed = sum(v.gate_fails(r) for r in rows)
    decided = failed + sum(r.gates and r.outcome is Outcome.AGREES for r in rows)
    if failed:
        return f"Not accepted: {failed} of {decided} checks failed."
    known = sum(v.disagrees_without_gating(r) for r in rows)
    words = f"Accepted: all {decided} checks passed."
    if known:
        words += f" {known} more do not, for reasons that the file states."
    if assumed:
        words += f" {assumed} of {numbers_in_all} numbers are assumed: the file holds together, which says"
        words += " nothing of the instrument itself."
    return words


def _facts(sensor: Sensor) -> list[tuple[str, str]]:
    spec = sensor.specification
    facts = [("file", f"{spec.name}, schema {spec.schema_version}"), ("source", spec.source)]
    try:
        axis = sensor.axis
    except Exception:  # the checks say what is wrong with it
        return facts
    facts.append(("bands", f"{len(axis)}, {int(axis.good.sum())} of them good"))
    facts.append(("range", f"{axis.centre_nm[0]:.1f} to {axis.centre_nm[-1]:.1f} nm"))
    facts.append(("width", f"{axis.fwhm_nm.min():.2f} to {axis.fwhm_nm.max():.2f} nm (full width at half maximum)"))
    facts += [(f"arm {a.name}", f"{a.range_nm[0]:g} to {a.range_nm[1]:g} nm, {a.bits} bit") for a in spec.arms]
    if spec.measured_noise is not None:
        facts.append(("noise", "as measured: |a √(b + L) + c|"))
    return facts


def bands_beside(sensor: Sensor) -> dict[str, Any] | None:
    """Every band with the nearest one of the set that the file names as ``bands.beside``, None where it names none.

    The rows hold number, centre and width [nm] of both, and how much further on the other one lies [nm].
    """
    name = sensor.specification.bands.beside
    if name is None:
        return None
    own, other = sensor.axis, load_sensor(name).axis
    nearest = np.abs(own.centre_nm[:, None] - other.centre_nm[None, :]).argmin(axis=1)
    rows = [
        (i + 1, own.centre_nm[i], own.fwhm_nm[i], k + 1, other.centre_nm[k], other.fwhm_nm[k],
         other.centre_nm[k] - own.centre_nm[i])
        for i, k in enumerate(nearest.tolist())
    ]  # fmt: skip
    numbers = min(len(own), len(other))
    apart = np.abs(own.centre_nm[:numbers] - other.centre_nm[:numbers])
    wider = int(np.count_nonzero(other.fwhm_nm[nearest] > 1.5 * own.fwhm_nm))
    words = f"bands of one number lie up to {apart.max():.1f} nm apart"
    if wider:
        words += f"; of {wider} bands the nearest one there is more than 1.5 times as wide: another detector's"
    return {"name": name, "rows": rows, "words": words}


def _sections(rows: Sequence[Result], drawings: Sequence[Drawing]) -> list[dict[str, Any]]:
    sections = []
    for name, title in SECTIONS.items():
        own = [r for r in rows if r.product == name]
        figures = [{"drawing": d, "source": d.source} for d in drawings if d.section == name]
        if own or figures:
            sections.append({"title": title, "rows": own, "figures": figures})
    return sections


def check_to_folder(
    name_or_file: str, output: Path | None, *, vary: float = 0.2, show_progress: bool | None = None
) -> SensorCheck:
    """Run the acceptance suite and, where ``output`` is given, write its datasheet into that folder."""
    if output is None:
        return check_sensor(name_or_file, vary=vary, show_progress=show_progress)
    with whole_folder(output) as folder:
        check = check_sensor(name_or_file, vary=vary, show_progress=show_progress)
        write_check(check, folder, name_or_file)
    return check


def write_check(check: SensorCheck, folder: Path, name_or_file: str) -> None:
    """Write results, figures, products, provenance and report.html; the same file gives the same bytes."""
    folder = Path(folder)
    record = _provenance(check, name_or_file)
    write_tables(check.table, folder)
    title = f"sensor {check.sensor.name}"
    write_products(folder / "products.nc", dict(check.predictions), title=title, simulated=False)
    drawings = draw_datasheet(check)
    write_page(folder, record, drawings, datasheet_page(check, drawings, record))


def _provenance(check: SensorCheck, name_or_file: str) -> dict[str, Any]:
    if name_or_file in library_names():
        place = resources.files("hyperval.sensor") / "library" / f"{name_or_file}.yaml"
        with resources.as_file(place) as path:
            entry = {"reference": f"library: {name_or_file}", "sha256": sha256_of(path)}
    else:
        entry = {"reference": Path(name_or_file).name, "sha256": sha256_of(Path(name_or_file))}
    return provenance(
        command=command_without_output(),
        inputs=[entry],
        seed=None,
        formulation="corrected",
        configuration={
            "sensor": check.sensor.specification.model_dump(mode="json", by_alias=True),
            "vary": check.vary,
        },
        engines={name: dict(prediction.provenance) for name, prediction in check.predictions.items()},
    )
