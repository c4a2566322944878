"""Figures of a finished run, drawn again for print from ``products.nc``."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import xarray as xr

from hyperval.errors import UsageError
from hyperval.folders import whole_folder
from hyperval.products import Observation, Prediction
from hyperval.report.figures import print_figures
from hyperval.report.netcdf_read import read_products
from hyperval.report.plots_run import equivalence_margin, every_plot
from hyperval.report.run import EigenvalueSpectrum, TailCurve
from hyperval.report.stored import read_results
from hyperval.report.style import Drawing, Print
from hyperval.results import ResultTable

Spread = tuple[Mapping[tuple[str, str], EigenvalueSpectrum], Mapping[str, TailCurve]]
Curves = Callable[[Prediction, Observation], Spread]


def figures_to_folder(run: Path, output: Path, print_as: Print, curves: Curves | None = None) -> int:
    """Draw what the products of ``run`` allow into a new folder, with the spread of its pixels by ``curves``.

    Raises
    ------
    InputError : no products.nc, or a damaged one.
    UsageError : products of which nothing can be drawn.
    """
    drawings = drawings_of(run, print_as, curves)
    if not drawings:
        raise UsageError(
            "there is nothing to draw", where=str(run), expected="spectra or ROC curves in products.nc"
        )
    with whole_folder(output) as folder:
        for drawing in drawings:
            (folder / drawing.file_name).write_bytes(drawing.content)
    return 0


def drawings_of(run: Path, print_as: Print, curves: Curves | None = None) -> list[Drawing]:
    """The figures of the products of a folder, and of the reasons that its table holds."""
    path, rows, record = (Path(run) / name for name in ("products.nc", "results.json", "provenance.json"))
    sides = read_products(path)
    with xr.open_dataset(path, engine="h5netcdf") as head:
        simulated = head.attrs.get("simulated") == "yes"
    table = read_results(rows) if rows.is_file() else ResultTable()
    margin = equivalence_margin(json.loads(record.read_bytes())) if record.is_file() else None
    predicted, observed = sides
    spread = curves(predicted, observed) if curves and predicted and observed else ({}, {})
    plots = every_plot(sides, table, *spread, margin)
    return print_figures(sides, plots, simulated=simulated, print_as=print_as)
