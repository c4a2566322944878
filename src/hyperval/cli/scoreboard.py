"""Command that sets detectors, engines and formulations against each other."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hyperval.cli.shared import Output, app, finished, settings


@app.command()
def benchmark(
    campaigns: Annotated[list[Path], typer.Argument(metavar="CAMPAIGN.yaml...", help="Campaign files.")],
    output: Output,
    extend: Annotated[
        list[Path] | None,
        typer.Option("--extend", help="A Python file that registers detectors or engines; it is run."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the resampling.")] = 0,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler, such as tcp://node:8786.")
    ] = None,
) -> int:
    """Rank all detectors, and score all engines and formulations, on every campaign."""
    from hyperval.scoreboard.one import benchmark as run

    code = run(
        campaigns,
        output,
        extensions=extend or [],
        seed=seed,
        scheduler=scheduler,
        show_progress=settings.show_progress,
    )
    return finished(code, output)
