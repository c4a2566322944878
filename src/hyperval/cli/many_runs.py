"""Commands that run the model or the pipeline many times: studies, benchmarks, planted errors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hyperval.cli.shared import Output, Scheduler, app, finished, note, print_table, settings


@app.command()
def study(
    study_file: Annotated[Path, typer.Argument(metavar="STUDY", help="A study file.")],
    output: Output,
    scheduler: Scheduler = None,
) -> int:
    """Evaluate a trade-off study; an interrupted run goes on where it stopped."""
    from hyperval.study.run import study_to_folder

    code = study_to_folder(study_file, output, scheduler=scheduler, show_progress=settings.show_progress)
    return finished(code, output)


@app.command()
def benchmark(
    campaigns: Annotated[list[Path], typer.Argument(metavar="CAMPAIGN.yaml...", help="Campaign files.")],
    output: Output,
    extend: Annotated[
        list[Path] | None,
        typer.Option("--extend", help="A Python file that registers detectors or engines; it is run."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the resampling.")] = 0,
    scheduler: Scheduler = None,
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
