"""Command that prints the table of metrics."""

from __future__ import annotations

from typing import Annotated

import typer

from hyperval.cli.shared import app, print_table


@app.command()
def metrics(
    name: Annotated[str | None, typer.Argument(help="One metric, with everything the table says of it.")] = None,
) -> int:
    """List the metrics: range, interval, how each is judged and what moves it."""
    from hyperval.metrics import metric_of
    from hyperval.metrics.table import HEADER, entry, listed

    if name is None:
        print_table(HEADER, [tuple(str(x) for x in row) for row in listed()])
    else:
        print("\n".join(entry(metric_of(name))).strip())
    return 0
