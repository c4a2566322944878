"""The datasheet: one page on a sensor, with nothing loaded from elsewhere; and its folder.

Figures of a datasheet: response, SNR, noise, saturation, detection, sensitivity.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hyperval.campaign.provenance import record_of
from hyperval.data import Array
from hyperval.datasets import InputLog
from hyperval.figures import drawings_of, outcome_words
from hyperval.figures.catalogue import roc_figure
from hyperval.figures.spec import (
    SOURCES,
    WAVELENGTH,
    Axis,
    Dash,
    Figure,
    Mark,
    Panels,
    Part,
    by_kind,
    robust_limits,
    row_names,
    single,
)
from hyperval.report import verdict as v
from hyperval.report.html import page
from hyperval.results import Outcome, Result
from hyperval.run import Run
from hyperval.sensor.specification import Sensor, library_names, load_sensor
from hyperval.sensor_check.suite import (
    LEVELS,
    MIDDLE,
    TOLERANCE,
    SensorCheck,
    check_sensor,
    neighbour_ratio,
    numbers,
    standard_scenario,
    sunlit_radiance,
)
from hyperval.spectra.axis import SIGMA_PER_FWHM, SpectralAxis
from hyperval.storage import installed_file, whole_folder

_MOST_RESPONSES = 12
_SOURCES = {
    "shot": "photons",
    "fixed": "fixed",
    "quantisation": "quantisation",
    "bit_errors": "bit errors",
    "calibration": "C_R (calibration error)",
    "fit": "rest of the fit",
}


def datasheet_figures(check: SensorCheck) -> list[Figure]:
    """Every figure that the checks allow, in the order of the page."""
    drawings = (_responses, _snr, _published, _noise, _saturation, _detection, _sensitivity)
    return [figure for draw in drawings for figure in draw(check)] if check.usable else []


def _responses(check: SensorCheck) -> Iterator[Figure]:
    """Widths against spacing, and the responses of a few bands."""
    axis, (wide, narrow) = check.axis, (SOURCES[0], SOURCES[5])
    columns, marker = {"x": axis.centre_nm, "y": axis.fwhm_nm}, "" if len(axis) >= 30 else "circle"
    marks, ratio = [Mark("line", columns, "full width at half maximum", wide, marker=marker)], ""
    if len(axis) > 1:
        spacing = np.diff(axis.centre_nm)
        if check.sensor.specification.bands.spacing == "contiguous":  # what is left out between spectrometers is none
            spacing = np.where(spacing > 3.0 * np.median(spacing), np.nan, spacing)
        columns = {"x": 0.5 * (axis.centre_nm[:-1] + axis.centre_nm[1:]), "y": spacing}
        marks.append(Mark("line", columns, "spacing", narrow, "dashed"))
        ratio = f"; the median width is {np.median(neighbour_ratio(axis)):.2f} spacings"
    yield Figure(
        "response", "response", "Width and spacing of the bands",
        f"Width and spacing of the {len(axis)} bands against wavelength{ratio}.",
        (single(_wavelengths(axis), Axis("width, spacing [nm]"), marks),),
    )  # fmt: skip
    sigmas, responses = np.linspace(-3.0, 3.0, 61), []
    most = max(len(axis) - _MOST_RESPONSES, 0)
    first = int(np.clip(np.argmin(np.abs(axis.centre_nm - 550.0)) - 5, 0, most))
    for k in range(first, min(first + _MOST_RESPONSES, len(axis))):
        w = axis.centre_nm[k] + sigmas * axis.fwhm_nm[k] * SIGMA_PER_FWHM
        responses.append(Mark("line", {"x": w, "y": np.exp(-0.5 * sigmas**2)}, "", (wide, narrow)[k % 2]))
    ends = responses[0].columns["x"][0], responses[-1].columns["x"][-1]
    yield Figure(
        "responses", "response", f"Responses of {len(responses)} bands",
        f"Relative response of {len(responses)} bands against wavelength.",
        (single(Axis(WAVELENGTH, ends=ends), Axis("relative response"), responses),),
    )  # fmt: skip


def _snr(check: SensorCheck) -> Iterator[Figure]:
    """SNR against wavelength at the reference radiances, with and without C_R."""
    axis, noise = check.axis, check.noise
    marks, highest = [], []
    for level, colour in zip(LEVELS, SOURCES, strict=False):
        radiance = sunlit_radiance(axis, level)
        free = noise.snr(radiance, calibration=False)
        marks.append(_curve(axis, free, f"reflectance {level:g}", colour))
        marks.append(_curve(axis, noise.snr(radiance), "", colour, "dashed"))
        highest.append(free[check.good if len(axis) >= 30 else axis.good])
    middle = noise.snr(sunlit_radiance(axis, MIDDLE), calibration=False)[check.good]
    yield Figure(
        "snr", "snr", "Signal-to-noise ratio, sun at 45° and no atmosphere (dashed: with the calibration error C_R)",
        "Signal-to-noise ratio against wavelength for ground of 0.05, 0.25 and 0.6, with and without the "
        f"calibration error. At 0.25 without it: median {np.median(middle):.0f}, {middle.min():.0f} to "
        f"{middle.max():.0f}.",
        (single(_wavelengths(axis), Axis("signal-to-noise ratio", ends=robust_limits(highest)), marks),),
    )  # fmt: skip


def _noise(check: SensorCheck) -> Iterator[Figure]:
    """Share of each source in the noise variance."""
    axis, few = check.axis, len(check.axis) < 30
    left, right = axis.centre_nm - axis.fwhm_nm / 2, axis.centre_nm + axis.fwhm_nm / 2
    views: list[Panels] = []
    shown: dict[str, str] = {}
    for level in (LEVELS[0], LEVELS[-1]):
        parts, base, marks = check.noise.breakdown(sunlit_radiance(axis, level)), np.zeros(len(axis)), []
        shares = np.abs([getattr(parts, name) for name in _SOURCES])
        for words, share, colour in zip(_SOURCES.values(), 100.0 * shares / shares.sum(axis=0), SOURCES, strict=False):
            if np.max(share) > 0.01:
                bars = {"left": left, "right": right, "bottom": base, "top": base + share}
                columns = bars if few else {"x": axis.centre_nm, "low": base, "high": base + share}
                marks.append(Mark("bars" if few else "area", columns, words, colour, alpha=1.0))
                base = base + share
                shown.setdefault(words, colour)
        y = Axis("share of the variance [%]", ends=(0.0, 100.0))
        views.append(single(_wavelengths(axis), y, marks, f"reflectance {level:g}"))
    alt = f"Share of each source in the variance of the noise, dark and bright ground: {', '.join(shown)}."
    yield Figure("noise", "noise", "Sources of noise, dark and bright ground", alt, tuple(views))


def _saturation(check: SensorCheck) -> Iterator[Figure]:
    """Signal as a part of full scale, where the file says where that is."""
    if check.noise.full_scale is None:
        return
    levels = (*LEVELS[1:], 1.0)
    parts = [check.noise.full_scale_fraction(sunlit_radiance(check.axis, level)) for level in levels]
    named = zip(levels, parts, SOURCES, strict=False)
    marks = [_curve(check.axis, part, f"reflectance {level:g}", colour) for level, part, colour in named]
    highest = max(1.0, float(np.max(parts)))
    y = Axis("part of full scale", ends=(0.0, 1.08 * highest))
    yield Figure(
        "saturation", "saturation", "Signal as a part of full scale, sun at 45° and no atmosphere (dotted: full scale)",
        f"Signal as a part of full scale against wavelength; the highest, at reflectance 1, is {highest:.2f}.",
        (single(_wavelengths(check.axis), y, marks, rules=(("y", 1.0),)),),
    )  # fmt: skip


def _curve(axis: SpectralAxis, values: Array, label: str, colour: str, dash: Dash = "solid") -> Mark:
    """A line over the good bands; gaps where bands are bad or left out."""
    y = np.where(axis.good, values, np.nan)
    w = axis.centre_nm
    if len(axis) >= 30:
        wide = np.flatnonzero(np.diff(w) > 40.0) + 1
        w, y = np.insert(w, wide, w[wide] - 1.0), np.insert(y, wide, np.nan)
    return Mark("line", {"x": w, "y": y}, label, colour, dash, "circle" if len(axis) < 30 else "")


def _wavelengths(axis: SpectralAxis) -> Axis:
    low, high = axis.centre_nm[0] - axis.fwhm_nm[0], axis.centre_nm[-1] + axis.fwhm_nm[-1]
    return Axis(WAVELENGTH, ends=(float(low), float(high)))


_MOST_SWINGS = 20


def _published(check: SensorCheck) -> Iterator[Figure]:
    """Computed over published ratio by wavelength."""
    points = check.points
    if not points:
        return
    looks = {
        "value": {"marker": "circle", "colour": SOURCES[0], "label": "published value"},
        "at least": {"marker": "square", "colour": SOURCES[2], "label": "published lower bound"},
        "unstated": {"marker": "tick", "colour": SOURCES[7], "label": "no radiance stated: not judged"},
    }
    kinds = [point.item.says if point.judged else "unstated" for point in points]
    w, ratios = np.array([p.wavelength_nm for p in points]), np.array([p.computed / p.published for p in points])
    margin = max(0.12 * float(np.ptp(w)), 60.0)
    x = float(w.min()) - margin, float(w.max()) + 1.3 * margin
    marks = []
    if "value" in kinds:
        columns = {"x": np.array(x), "low": np.full(2, 1 - TOLERANCE), "high": np.full(2, 1 + TOLERANCE)}
        marks.append(Mark("area", columns, f"within {100 * TOLERANCE:g} %", SOURCES[0], alpha=0.15))
    words = tuple(f"{p.computed:.0f} / {p.published:g}" for p in points)
    marks += by_kind(Mark("dots", {"x": w, "y": ratios}, words=words, beside="right"), kinds, looks)
    listed = "; ".join(f"{p.wavelength_nm:g} nm {p.computed:.0f} to {p.published:g}" for p in points)
    ends = min(0.6, 0.9 * float(ratios.min())), max(1.4, 1.15 * float(ratios.max()))
    yield Figure(
        "published-snr", "published_snr", "Computed over published signal-to-noise ratio",
        f"Computed against published ratios: {listed}.",
        (single(Axis(WAVELENGTH, ends=x), Axis("computed / published", ends=ends), marks, rules=(("y", 1.0),)),),
    )  # fmt: skip


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
    kept = list(swings[:_MOST_SWINGS])
    views: list[Panels] = []
    rows, names = np.arange(len(kept), dtype=float), row_names([s.name for s in kept])
    for name, changes in (
        ("change of the SNR at reflectance 0.25 [%]", np.array([s.snr for s in kept]) * 100.0),
        ("change of P_D", np.array([s.detection for s in kept])),
    ):
        marks = tuple(
            Mark("bars", {"left": np.minimum(change, 0.0), "right": np.maximum(change, 0.0), "bottom": rows - 0.31,
                          "top": rows + 0.31}, label, SOURCES[colour], alpha=1.0)
            for change, label, colour in zip(changes.T, ("lower", "higher"), (4, 5), strict=True)
        )  # fmt: skip
        views.append(Panels(Axis("change"), (Part(names, marks, (("x", 0.0),)),), name))
    most, what = kept[0], f" of {probe.key[0]} by {probe.key[1]}" if probe else ""
    more = f"; {len(kept)} of {len(swings)} are drawn" if len(kept) < len(swings) else ""
    yield Figure(
        "sensitivity", "sensitivity",
        f"Assumed numbers {100 * vary:g} % lower and higher: SNR of the band that moves most, P_D{what}{more}",
        f"Bars of what each of {len(swings)} assumed numbers does when it is {100 * vary:g} % lower or higher. "
        f"Most for the SNR: {most.name}, {100 * most.snr[0]:+.1f} % and {100 * most.snr[1]:+.1f} %.",
        tuple(views),
    )  # fmt: skip


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


def datasheet_page(check: SensorCheck, figures: Sequence[Figure], provenance: dict[str, Any]) -> str:
    """The page of one sensor."""
    rows, listed = list(check.table), numbers(check.sensor.specification)
    assumed = sum(n.assumed for n in listed)
    failed, known = ([r for r in rows if fails(r)] for fails in (v.gate_fails, v.disagrees_without_gating))
    decided = len(failed) + sum(r.gates and r.outcome is Outcome.AGREES for r in rows)
    if failed:
        tone, words = "disagrees", f"Not accepted: {len(failed)} of {decided} checks failed."
    else:
        tone, words = "undecided" if known else "agrees", f"Accepted: all {decided} checks passed."
        if known:
            words += f" {len(known)} more do not, for reasons that the file states."
        if assumed:
            words += f" {assumed} of {len(listed)} numbers are assumed: the file holds together, which says"
            words += " nothing of the instrument itself."
    return page(
        "datasheet.html.j2", figures,
        sensor=check.sensor.specification, tone=tone, verdict=words, counts=outcome_words(rows), failed=failed,
        known=known, facts=_facts(check.sensor), numbers=listed, assumed=assumed, sections=_sections(rows, figures),
        beside=bands_beside(check.sensor), provenance=provenance, folded=_FOLDED,
    )  # fmt: skip


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


def _sections(rows: Sequence[Result], drawn: Sequence[Figure]) -> list[dict[str, Any]]:
    return [
        {"title": title, "rows": own, "figures": figures}
        for name, title in SECTIONS.items()
        if (own := [r for r in rows if r.product == name]) + (figures := [f for f in drawn if f.section == name])
    ]


def check_to_folder(name_or_file: str, output: Path | None, *, vary: float = 0.2) -> SensorCheck:
    """Run the acceptance suite and, where ``output`` is given, write its datasheet into that folder."""
    if output is None:
        return check_sensor(name_or_file, vary=vary)
    with whole_folder(output) as folder:
        check = check_sensor(name_or_file, vary=vary)
        write_check(check, folder, name_or_file)
    return check


def write_check(check: SensorCheck, folder: Path, name_or_file: str) -> None:
    """Write results, figures, products, provenance and report.html; the same file gives the same bytes."""
    record = _provenance(check, name_or_file)
    figures = datasheet_figures(check)
    run = Run(check.table, record, dict(check.predictions), title=f"sensor {check.sensor.name}")
    run.write(folder, datasheet_page(check, figures, record), drawings_of(figures, simulated=False))


def _provenance(check: SensorCheck, name_or_file: str) -> dict[str, Any]:
    log, is_known = InputLog(), name_or_file in library_names()
    path = installed_file("hyperval.sensor", "library", f"{name_or_file}.yaml") if is_known else Path(name_or_file)
    log.add(path, f"library: {name_or_file}" if is_known else path.name)
    told = {"sensor": check.sensor.specification, "vary": check.vary}
    return record_of(log, [*map(standard_scenario, check.predictions)], None, told, check.predictions)
