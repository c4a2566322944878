"""Writing a datasheet's folder."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path
from typing import Any

from hyperval.campaign.provenance import command_without_output, provenance
from hyperval.files import sha256_of, write_text
from hyperval.folders import whole_folder
from hyperval.report.netcdf import write_products
from hyperval.report.outputs import write_tables
from hyperval.report.tables import json_value
from hyperval.sensor.specification import library_names
from hyperval.sensor_check.figures import draw_datasheet
from hyperval.sensor_check.page import datasheet_page
from hyperval.sensor_check.reference import Engine
from hyperval.sensor_check.suite import SensorCheck, check_sensor


def check_to_folder(
    name_or_file: str,
    output: Path | None,
    *,
    vary: float = 0.2,
    engine: Engine | None = None,
    show_progress: bool | None = None,
) -> SensorCheck:
    """Run the acceptance suite and, where ``output`` is given, write its datasheet into that folder."""
    if output is None:
        return check_sensor(name_or_file, vary=vary, engine=engine, show_progress=show_progress)
    with whole_folder(output) as folder:
        check = check_sensor(name_or_file, vary=vary, engine=engine, show_progress=show_progress)
        write_check(check, folder, name_or_file)
    return check


def write_check(check: SensorCheck, folder: Path, name_or_file: str) -> None:
    """Write results, figures, products, provenance and report.html; the same file gives the same bytes."""
    folder = Path(folder)
    record = _provenance(check, name_or_file)
    write_tables(check.table, folder)
    write_text(folder / "provenance.json", json.dumps(json_value(record), indent=1, ensure_ascii=False) + "\n")
    title = f"sensor {check.sensor.name}"
    write_products(folder / "products.nc", dict(check.predictions), title=title, simulated=False)
    drawings = draw_datasheet(check)
    (folder / "figures").mkdir(exist_ok=True)
    for drawing in drawings:
        (folder / "figures" / drawing.file_name).write_bytes(drawing.content)
    write_text(folder / "report.html", datasheet_page(check, drawings, record))


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
