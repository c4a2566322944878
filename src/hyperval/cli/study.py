"""Trade-off studies."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hyperval.cli.shared import Output, Scheduler, app, finished, settings


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
