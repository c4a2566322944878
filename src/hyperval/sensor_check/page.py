"""The datasheet: one page on a sensor, with nothing loaded from elsewhere; and its folder."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from hyperval.campaign.provenance import command_without_output, provenance
from hyperval.files import sha256_of
from hyperval.folders import whole_folder
from hyperval.report import verdict as v
from hyperval.report.html import common_words, environment
from hyperval.report.netcdf import write_products
from hyperval.report.outputs import write_page, write_tables
from hyperval.report.style import Drawing
from hyperval.results import Outcome, Result
from hyperval.sensor.specification import Sensor, library_names, load_sensor
from hyperval.sensor_check.figures import draw_datasheet
from hyperval.sensor_check.numbers import numbers
from hyperval.sensor_check.suite import SensorCheck, check_sensor

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
