"""The datasheet of a sensor: response, SNR, noise, saturation, detection and sensitivity, in a folder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hyperval.campaign.provenance import record_of
from hyperval.config import shipped
from hyperval.data import Array
from hyperval.datasets import InputLog
from hyperval.errors import UsageError
from hyperval.figures import drawings_of, outcome_words
from hyperval.figures.catalogue import budget_figure, roc_figure, wavelength_axis
from hyperval.figures.spec import SOURCES, Axis, Figure, Mark, Panels, Part, robust_limits, row_figure, single_panel
from hyperval.products import PredictedProducts, SpectralEstimate
from hyperval.report import verdict as v
from hyperval.report.html import page
from hyperval.results import Outcome
from hyperval.run import Run
from hyperval.scenario import load_scenario
from hyperval.sensor_check.suite import LEVELS, MIDDLE, TOLERANCE, SensorCheck, check_sensor, neighbour_ratio, numbers
from hyperval.spectra.axis import SpectralAxis
from hyperval.storage import whole_folder

_FEW = 30  # bands that are marked one by one
# Of the terms of a breakdown of the noise, in their order.
_SOURCES = ("photons", "fixed", "quantisation", "bit errors", "C_R (calibration error)", "rest of the fit")


def datasheet_figures(check: SensorCheck) -> list[Figure]:
    """Every figure that the checks allow, in the order of the page."""
    drawings = (_responses, _snr, _published, _noise, _saturation, _detection, _sensitivity)
    return [figure for draw in drawings for figure in draw(check)] if check.usable else []


def _responses(check: SensorCheck) -> Iterator[Figure]:
    """Widths against spacing."""
    axis, (wide, narrow) = check.axis, (SOURCES[0], SOURCES[5])
    columns = {"x": axis.centre_nm, "y": axis.fwhm_nm}
    marks, ratio = [Mark("line", columns, "full width at half maximum", wide, marker=_marker(axis))], ""
    if len(axis) > 1:
        spacing = np.diff(axis.centre_nm)
        if check.sensor.specification.bands.spacing == "contiguous":  # what is left out between spectrometers is none
            spacing = np.where(spacing > 3.0 * np.median(spacing), np.nan, spacing)
        columns = {"x": 0.5 * (axis.centre_nm[:-1] + axis.centre_nm[1:]), "y": spacing}
        marks.append(Mark("line", columns, "spacing", narrow, "dashed"))
        ratio = f"; the median width is {np.median(neighbour_ratio(axis)):.2f} spacings"
    view = single_panel(wavelength_axis(axis), Axis("width, spacing [nm]"), marks, words=f"{len(axis)} bands{ratio}")
    yield Figure("response", "response", "Width and spacing of the bands", (view,))


def _snr(check: SensorCheck) -> Iterator[Figure]:
    """SNR against wavelength at the reference radiances, with and without C_R."""
    axis, noise = check.axis, check.noise
    marks, highest = [], []
    for level, colour in zip(LEVELS, SOURCES, strict=False):
        radiance = check.sunlit(level)
        free = noise.snr(radiance, calibration=False)
        marks.append(_curve(axis, free, f"reflectance {level:g}", colour))
        marks.append(_curve(axis, noise.snr(radiance), "", colour, dash="dashed"))
        highest.append(free[check.good if len(axis) >= _FEW else axis.good])
    middle = noise.snr(check.sunlit(MIDDLE), calibration=False)[check.good]
    title = "Signal-to-noise ratio, sun at 45° and no atmosphere (dashed: with the calibration error C_R)"
    words = f"at 0.25 without it: median {np.median(middle):.0f}, {middle.min():.0f} to {middle.max():.0f}"
    y = Axis("signal-to-noise ratio", ends=robust_limits(highest))
    yield Figure("snr", "snr", title, (single_panel(wavelength_axis(axis), y, marks, words=words),))


def _noise(check: SensorCheck) -> Iterator[Figure]:
    """Noise of dark and bright ground by source, drawn as the budget of any radiance is."""
    spectra = {}
    for level in (LEVELS[0], LEVELS[-1]):
        radiance = check.sunlit(level)
        parts = check.noise.breakdown(radiance)
        named = zip(_SOURCES, map(np.abs, vars(parts).values()), strict=True)
        budget = {words: np.sqrt(part) for words, part in named if np.any(part > 1e-4 * parts.total)}
        spectra[f"reflectance {level:g}"] = SpectralEstimate(radiance, np.diag(parts.total), budget=budget)
    if (figure := budget_figure((PredictedProducts(check.axis, radiance=spectra), None))) is not None:
        title = "Sources of noise, dark and bright ground (height: noise; colour: share of the variance)"
        yield replace(figure, name="noise", section="noise", title=title, head=title)


def _saturation(check: SensorCheck) -> Iterator[Figure]:
    """Signal as a part of full scale, where the file says where that is."""
    if check.noise.full_scale is None:
        return
    levels = (*LEVELS[1:], 1.0)
    parts = [check.noise.full_scale_fraction(check.sunlit(level)) for level in levels]
    named = zip(levels, parts, SOURCES, strict=False)
    marks = [_curve(check.axis, part, f"reflectance {level:g}", colour) for level, part, colour in named]
    highest = max(1.0, float(np.max(parts)))
    title = "Signal as a part of full scale, sun at 45° and no atmosphere (dotted: full scale)"
    y, words = Axis("part of full scale", ends=(0.0, 1.08 * highest)), f"the highest is {np.max(parts):.2f}"
    view = single_panel(wavelength_axis(check.axis), y, marks, words=words, rules=(("y", 1.0),))
    yield Figure("saturation", "saturation", title, (view,))


def _curve(axis: SpectralAxis, values: Array, label: str, colour: str, **look: Any) -> Mark:
    """A line over the good bands, with a gap where bands are bad or left out."""
    w, y = axis.centre_nm, np.where(axis.good, values, np.nan)
    if len(axis) >= _FEW:
        wide = np.flatnonzero(np.diff(w) > 40.0) + 1
        w, y = np.insert(w, wide, w[wide] - 1.0), np.insert(y, wide, np.nan)
    return Mark("line", {"x": w, "y": y}, label, colour, marker=_marker(axis), **look)


def _marker(axis: SpectralAxis) -> str:
    """Each band is marked where they are few."""
    return "circle" if len(axis) < _FEW else ""


_MAX_SWINGS = 20


def _published(check: SensorCheck) -> Iterator[Figure]:
    """Computed over published ratio by wavelength."""
    points = check.points
    if not points:
        return
    styles = {
        "value": {"marker": "circle", "colour": SOURCES[0], "label": "published value"},
        "at least": {"marker": "square", "colour": SOURCES[2], "label": "published lower bound"},
        "unstated": {"marker": "tick", "colour": SOURCES[7], "label": "no radiance stated: not judged"},
    }
    kinds = [point.item.says if point.judged else "unstated" for point in points]
    columns = {"x": np.array([p.computed / p.published for p in points]), "y": np.arange(len(points), dtype=float)}
    words = tuple(f"{p.computed:.0f} / {p.published:g}" for p in points)
    marks = Mark("dots", columns, words=words, beside="right").split(kinds, styles)
    names = [f"{p.wavelength_nm:g} nm" for p in points]
    rules, finite = (1.0 - TOLERANCE, 1.0, 1.0 + TOLERANCE), columns["x"][np.isfinite(columns["x"])]
    x = Axis("computed / published", ends=(0.9 * min(*rules, *finite), 1.15 * max(*rules, *finite)))
    listed = "; ".join(f"{name} {p.computed:.0f} to {p.published:g}" for name, p in zip(names, points, strict=True))
    yield row_figure("published-snr", x, Axis.named(names), marks, listed, rules=rules, percent=100 * TOLERANCE)


def _detection(check: SensorCheck) -> Iterator[Figure]:
    """Receiver operating characteristic of every target of the standard scenes, as any prediction's is drawn."""
    for name, prediction in check.predictions.items():
        if (figure := roc_figure((prediction, None))) is not None:
            title = f"Detection with this sensor: {name}"
            yield replace(figure, name=f"detection-{name}", section="scenario", title=title, head=title)


def _sensitivity(check: SensorCheck) -> Iterator[Figure]:
    """Tornado: what each assumed number does to the SNR and to P_D."""
    swings, probe, vary = check.swings, check.probe, check.vary
    if not swings:
        return
    kept, views = swings[:_MAX_SWINGS], list[Panels]()
    rows, names = np.arange(len(kept), dtype=float), Axis.named([s.name for s in kept])
    for name, changes in (
        ("change of the SNR at reflectance 0.25 [%]", np.array([s.snr for s in kept]) * 100.0),
        ("change of P_D", np.array([s.detection for s in kept])),
    ):
        marks = []
        for change, label, colour in zip(changes.T, ("lower", "higher"), SOURCES[4:6], strict=True):
            columns = {"left": np.minimum(change, 0.0), "right": np.maximum(change, 0.0)}
            columns |= {"bottom": rows - 0.31, "top": rows + 0.31}
            marks.append(Mark("bars", columns, label, colour, alpha=1.0))
        views.append(Panels(Axis("change"), (Part(names, tuple(marks), (("x", 0.0),)),), name))
    most, what = kept[0], f" of {probe.key[0]} by {probe.key[1]}" if probe else ""
    more = f"; {len(kept)} of {len(swings)} are drawn" if len(kept) < len(swings) else ""
    title = f"Assumed numbers {100 * vary:g} % lower and higher: SNR of the band that moves most, P_D{what}{more}"
    views[0] = replace(views[0], words=f"most {most.name}, {100 * most.snr[0]:+.1f} % and {100 * most.snr[1]:+.1f} %")
    yield Figure("sensitivity", "sensitivity", title, tuple(views))


_FOLDED = 12  # rows of a section that are not folded


def datasheet_page(check: SensorCheck, figures: Sequence[Figure], provenance: dict[str, Any]) -> str:
    """The page of one sensor."""
    rows, axis = list(check.table), None
    failed, expected = ([r for r in rows if fails(r)] for fails in (v.is_failed_gate, v.informs_of_disagreement))
    with suppress(UsageError):  # the checks say what is wrong with it
        axis = check.axis
    return page(
        "datasheet.html.j2", figures,
        sensor=check.sensor.specification, axis=axis, counts=outcome_words(rows), failed=failed, known=expected,
        decided=len(failed) + sum(r.gates and r.outcome is Outcome.AGREES for r in rows), rows=rows, figures=figures,
        numbers=numbers(check.sensor.specification), provenance=provenance,
        folded=_FOLDED,
    )  # fmt: skip


def check_to_folder(name_or_file: str, output: Path | None, *, vary: float = 0.2) -> SensorCheck:
    """Run the acceptance suite and, where ``output`` is given, write its datasheet into that folder."""
    with nullcontext() if output is None else whole_folder(output) as folder:  # which may not be writable
        check = check_sensor(name_or_file, vary=vary)
        if folder is not None:
            write_check(check, folder, name_or_file)
    return check


def write_check(check: SensorCheck, folder: Path, name_or_file: str) -> None:
    """Write results, figures, products, provenance and report.html; the same file gives the same bytes."""
    log, path = InputLog(), shipped("hyperval.sensor", "library").get(name_or_file)
    log.add(path or Path(name_or_file), f"library: {name_or_file}" if path else Path(name_or_file).name)
    asked = {"sensor": check.sensor.specification, "vary": check.vary}
    record = record_of(log, [*map(load_scenario, check.predictions)], None, asked, check.predictions)
    figures = datasheet_figures(check)
    run = Run(check.table, record, dict(check.predictions), title=f"sensor {check.sensor.name}")
    run.write(folder, datasheet_page(check, figures, record), drawings_of(figures, simulated=False))
