"""Command that draws the figures of a finished run for print."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from hyperval.cli.shared import Output, app, finished


class Format(StrEnum):
    """Formats of a figure."""

    PDF = "pdf"
    SVG = "svg"
    PNG = "png"


class Style(StrEnum):
    """Looks of a figure."""

    HOUSE = "house"
    JOURNAL = "journal"


@app.command()
def figures(
    run: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of one campaign, scenario or collection.")],
    output: Output,
    kind: Annotated[Format, typer.Option("--format", help="Format of the files.")] = Format.PDF,
    style: Annotated[
        Style, typer.Option("--style", help="journal: two columns wide, in its letters, untitled.")
    ] = Style.HOUSE,
) -> int:
    """Draw the figures of a finished run for print, from its products.nc."""
    from hyperval.report.printed import figures_to_folder
    from hyperval.report.style import Print

    return finished(figures_to_folder(run, output, Print(kind.value, style is Style.JOURNAL)), output)
