"""The datasheet: one page on a sensor, with nothing loaded from elsewhere."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

from hyperval.report import verdict as v
from hyperval.report.html import common_words, environment
from hyperval.report.style import Drawing
from hyperval.results import Outcome, Result
from hyperval.sensor.specification import Sensor
from hyperval.sensor_check.numbers import numbers
from hyperval.sensor_check.suite import SensorCheck

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


def _sections(rows: Sequence[Result], drawings: Sequence[Drawing]) -> list[dict[str, Any]]:
    sections = []
    for name, title in SECTIONS.items():
        own = [r for r in rows if r.product == name]
        figures = [
            {"drawing": d, "source": f"data:image/svg+xml;base64,{base64.b64encode(d.content).decode('ascii')}"}
            for d in drawings
            if d.section == name
        ]
        if own or figures:
            sections.append({"title": title, "rows": own, "figures": figures})
    return sections
