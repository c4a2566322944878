"""Command that sets two runs side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hyperval.cli.shared import Output, app, finished


@app.command()
def compare(
    one: Annotated[Path, typer.Argument(metavar="A", help="A folder of results.")],
    other: Annotated[Path, typer.Argument(metavar="B", help="Another, of the same campaign.")],
    output: Output,
) -> int:
    """Set two runs side by side: verdicts that changed, what moved, both runs' figures."""
    from hyperval.report.side_by_side import compare_runs

    return finished(compare_runs(one, other, output), output)
