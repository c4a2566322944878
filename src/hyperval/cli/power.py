"""Command that plants errors in the model, and says which campaigns see them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hyperval.cli.shared import app, note, print_table, settings


@app.command()
def power(
    campaigns: Annotated[list[Path], typer.Argument(metavar="CAMPAIGN.yaml...", help="Campaign files.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder for the tables; replaced as a whole.")
    ] = None,
    accept: Annotated[bool, typer.Option("--accept", help="Take the tables as those that reports show.")] = False,
) -> int:
    """Plant standard errors in the model, one at a time: which gates turn?"""
    from hyperval.campaign.power import power as run

    tables = run(campaigns, output=output, accept=accept, show_progress=settings.show_progress)
    done = [item.table for item in tables if item.table is not None]
    names = list(dict.fromkeys(name for table in done for name in table.errors))
    print_table(
        ("planted error", *(table.campaign for table in done)),
        [(name, *(table.errors[name].words for table in done)) for name in names],
    )
    for item in tables:
        if item.skipped:
            note(f"{item.campaign}: skipped: {item.skipped}")
        elif item.table is not None:
            note(f"{item.campaign}: {item.table.sentence}")
        for change in item.changes:
            note(f"{item.campaign}: {change}")
    if output is not None:
        note(f"results in {output}")
    if not done:
        return 5
    return 1 if not accept and any(item.changes for item in tables) else 0
