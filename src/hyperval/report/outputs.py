"""Writing a run's folder, and the page that joins several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hyperval.run import Run, file_stems, write_joined


def write_outputs(run: Run, folder: Path) -> None:
    """Write everything of ``run`` into the existing ``folder``, its page and pictures besides."""
    from hyperval.report.html import report_page  # not before the imagery is done with

    drawings = []
    if run.quicklook is not None or run.score_maps:
        from hyperval.figures.pictures import draw_pictures

        drawings = draw_pictures(run.quicklook, run.score_maps, simulated=run.simulated)
    # Its products.nc has a title, if nothing else.
    products, provenance = run.products or {"observed": None}, {**run.provenance, "warnings": run.warnings}
    replace(run, provenance=provenance, products=products).write(folder, report_page(run, drawings), drawings)


def write_index(runs: Sequence[Run], folder: Path, title: str = "Validation", parts: Path | None = None) -> None:
    """Write the page and the tables of several campaigns, whose folders come into ``folder`` from ``parts``."""
    from hyperval.report.html import index_page

    folders = file_stems(run.campaign for run in runs)
    rows = [row for run in runs for row in run.table]
    write_joined(Path(folder), list(folders.values()), rows, index_page(runs, folders, title), parts)
