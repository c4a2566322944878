"""The truth beside a simulated cube: regions, targets, maps, panel spectra, and what was drawn."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rasterio import features

from hyperval.files import write_text
from hyperval.scene.builtin import builtin_mean
from hyperval.simulate import streams
from hyperval.simulate.layout import Ground, Mask, touched
from hyperval.simulate.schema import SceneFile
from hyperval.spectra.axis import SpectralAxis

TARGET_COLUMNS = (
    "name", "group", "material", "host", "nominal_fill", "side_m", "area_m2", "line", "sample",
    "phase", "heading_deg", "best_line", "best_sample", "best_fill", "pixels",
)  # fmt: skip

FIELD_AXIS_NM = (350.0, 2500.0, 1.0)  # what a field spectrometer delivers: first, last, step
FIELD_FWHM_NM = 3.0


def write_regions(path: Path, scene: SceneFile, masks: Mapping[str, Mask]) -> None:
    """Regions of interest as GeoJSON polygons along pixel edges, x = sample, y = line.

    (0, 0) is the upper left corner of the first pixel.  GeoJSON proper is in degrees;
    ``coordinates: pixel`` among the members says that this file is not.
    """
    records = []
    for name, mask in masks.items():
        shapes = [shape for shape, value in features.shapes(mask.astype(np.uint8), mask=mask) if value == 1]
        polygons = [shape["coordinates"] for shape in shapes]
        geometry = (
            {"type": "Polygon", "coordinates": polygons[0]}
            if len(polygons) == 1
            else {"type": "MultiPolygon", "coordinates": polygons}
        )
        surface = next((p.surface for p in scene.panels if p.name == name), None)
        surface = surface or next(r.surface for r in scene.regions if r.name == name)
        properties = {"name": name, "surface": surface, "pixels": int(mask.sum())}
        records.append({"type": "Feature", "properties": properties, "geometry": geometry})
    content = {"type": "FeatureCollection", "name": scene.name, "coordinates": "pixel", "features": records}
    write_text(path, json.dumps(content) + "\n")


def target_rows(scene: SceneFile, ground: Ground) -> list[dict[str, Any]]:
    """One row per plank, with the fills as rendered and not as asked for.

    ``line``, ``sample``: its centre, continuous; ``best_line``, ``best_sample``: the pixel it fills most, whole
    numbers; ``pixels``: how many hold at least 1e-4 of it.
    """
    rows = []
    for plank in ground.planks:
        group = plank.group
        lines, samples, fill = touched(plank)
        best = int(np.argmax(fill))
        side = plank.side_pixels * scene.gsd_m
        rows.append(
            {
                "name": plank.name,
                "group": group.name,
                "material": group.material,
                "host": group.host,
                "nominal_fill": "" if group.fill is None else group.fill,
                "side_m": round(side, 6),
                "area_m2": round(side**2, 6),
                "line": round(plank.centre_line, 4),
                "sample": round(plank.centre_sample, 4),
                "phase": group.phase,
                "heading_deg": round(plank.heading_deg, 3),
                "best_line": int(lines[best]),
                "best_sample": int(samples[best]),
                "best_fill": round(float(fill[best]), 6),
                "pixels": int(fill.size),
            }
        )
    return rows


def write_table(path: Path, columns: tuple[str, ...], rows: list[dict[str, Any]]) -> None:
    """A CSV file with Unix line ends."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


def field_axis() -> SpectralAxis:
    """The 1 nm grid of the simulated field spectrometer."""
    first, last, step = FIELD_AXIS_NM
    centre = np.arange(first, last + 0.5 * step, step)
    return SpectralAxis(centre, np.full(centre.size, FIELD_FWHM_NM))


def write_panel_spectra(path: Path, scene: SceneFile) -> None:
    """CSV: wavelength_nm, then mean NAME and standard deviation NAME_sd of every panel, reflectance as a fraction.

    A reading is the panel's mean reflectance with ``relative_noise`` of the instrument, independent between
    wavelengths; the panels' own spread from pixel to pixel is averaged by the sweep of the spectrometer.  A comment
    says how many readings are behind the means, where there is more than one.
    """
    axis = field_axis()
    noise, count = scene.field_spectra.relative_noise, scene.field_spectra.readings
    columns, values = ["wavelength_nm"], [axis.centre_nm]
    for number, panel in enumerate(scene.panels):
        mean = builtin_mean(panel.surface, axis)
        rng = streams.generator(scene.seed, streams.FIELD_SPECTRA, number)
        readings = mean * (1.0 + noise * rng.standard_normal((count, mean.size)))
        columns += [panel.name, f"{panel.name}_sd"]
        values += [readings.mean(axis=0), readings.std(axis=0, ddof=1) if count > 1 else np.zeros(mean.size)]
    lines = [f"# means of N = {count} readings and their standard deviations"] if count > 1 else []
    lines += [",".join(columns)]
    lines += [f"{row[0]:.1f}," + ",".join(f"{v:.6f}" for v in row[1:]) for row in np.stack(values, axis=1)]
    write_text(path, "\n".join(lines) + "\n")
