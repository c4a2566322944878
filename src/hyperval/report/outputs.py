"""Writing a run's folder, and the page that joins several.

Score maps as float32 GeoTIFF.
"""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine

from hyperval.report.run import RunReport, ScoreMap
from hyperval.report.style import Drawing
from hyperval.report.tables import json_value, junit_xml, results_csv, results_json
from hyperval.results import ResultTable
from hyperval.storage import write_text


def write_score_map(path: Path, name: str, score_map: ScoreMap) -> None:
    """Write one map; NaN is nodata; georeferenced where the map knows its transform."""
    import rasterio  # 20 MB, which runs without score maps do not need
    from rasterio.errors import NotGeoreferencedWarning

    values = np.asarray(score_map.values, dtype=np.float32)
    profile = {
        "driver": "GTiff", "height": values.shape[0], "width": values.shape[1], "count": 1, "dtype": "float32",
        "nodata": float("nan"), "compress": "deflate", "predictor": 3,
    }  # fmt: skip
    if score_map.transform is not None:
        profile["transform"] = Affine(*[float(number) for number in list(score_map.transform)[:6]])
    if score_map.crs:
        profile["crs"] = score_map.crs
    with warnings.catch_warnings():
        # A map in image geometry is a legitimate product.
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", **profile) as out:
            out.write(values, 1)
            out.set_band_description(1, f"{name} score [1]")


def file_stems(names: Iterable[str]) -> dict[str, str]:
    """A distinct, harmless file name for each name: letters, digits, dot, minus and underscore."""
    stems: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        stem = re.sub(r"[^A-Za-z0-9._-]+", "_", name).lstrip(".")[:100] or "_"
        candidate, number = stem, 2
        while candidate.lower() in taken:
            candidate, number = f"{stem}_{number}", number + 1
        taken.add(candidate.lower())
        stems[name] = candidate
    return stems


def write_outputs(run: RunReport, folder: Path) -> None:
    """Write everything of ``run`` into the existing ``folder``.

    results.csv, summary.csv, results.json, junit.xml, provenance.json, products.nc, figures/, scores/ (where there
    are score maps) and report.html.  The same run gives the same bytes.
    """
    from hyperval.report.html import report_page  # not before the imagery is done with
    from hyperval.report.netcdf import write_products

    folder = Path(folder)
    write_tables(run.table, folder)
    sides = {"predicted": run.prediction, "observed": run.observation}
    write_products(folder / "products.nc", sides, title=run.title, simulated=run.simulated)
    stems = file_stems(run.score_maps)
    for name, score_map in run.score_maps.items():
        (folder / "scores").mkdir(exist_ok=True)
        write_score_map(folder / "scores" / f"{stems[name]}.tif", name, score_map)
    drawings = _drawings(run)
    write_page(folder, {**run.provenance, "warnings": run.warnings}, drawings, report_page(run, drawings))


def write_page(folder: Path, record: Mapping[str, Any], drawings: Sequence[Drawing], page: str) -> None:
    """Write provenance.json, figures/ and report.html."""
    text = json.dumps(json_value(dict(record)), indent=1, ensure_ascii=False)
    write_text(folder / "provenance.json", text + "\n")
    (folder / "figures").mkdir(exist_ok=True)
    for drawing in drawings:
        (folder / "figures" / drawing.file_name).write_bytes(drawing.content)
    write_text(folder / "report.html", page)


def _drawings(run: RunReport) -> list[Drawing]:
    """The pictures of a run: its scene, and its score maps."""
    if run.quicklook is None and not run.score_maps:
        return []
    from hyperval.report.pictures import draw_pictures

    return draw_pictures(run)


def write_index(runs: Sequence[RunReport], folder: Path, title: str = "Validation") -> None:
    """Write the page and the tables of several campaigns; each campaign's folder stands in ``folder``.

    The folder of a campaign bears its name (``campaign_folders`` tells how a name is made harmless).
    """
    from hyperval.report.html import index_page

    folder = Path(folder)
    write_tables(ResultTable(row for run in runs for row in run.table), folder)
    write_text(folder / "report.html", index_page(runs, campaign_folders(runs), title))


def write_tables(table: ResultTable, folder: Path) -> None:
    """Write results.csv, summary.csv (the planned comparisons alone), results.json and junit.xml."""
    write_text(folder / "results.csv", results_csv(table))
    write_text(folder / "summary.csv", results_csv(row for row in table if row.planned))
    write_text(folder / "results.json", results_json(table))
    write_text(folder / "junit.xml", junit_xml(table))


def campaign_folders(runs: Sequence[RunReport]) -> dict[str, str]:
    """Campaign name -> name of its folder."""
    return file_stems(run.campaign for run in runs)
