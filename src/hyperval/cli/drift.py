"""Command that follows a number over the days of finished runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hyperval.cli.shared import app, note, print_table


@app.command()
def drift(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Folders that validate wrote.")],
    metric: Annotated[str, typer.Option(help="Which number is followed.")] = "bias_ratio",
    product: Annotated[str, typer.Option(help="Product of its row.")] = "radiance",
    subject: Annotated[str, typer.Option(help="Subject of its row.")] = "site",
    within: Annotated[
        tuple[float, float] | None, typer.Option(help="Accepted change in a year, lowest and highest.")
    ] = None,
) -> int:
    """Print a row for each day of finished runs, and the change in a year with its interval."""
    from hyperval.compare.drift import drift as drift_of
    from hyperval.errors import UsageError
    from hyperval.report.days import days_of
    from hyperval.results import Outcome

    if within is not None and not within[0] < within[1]:
        raise UsageError(f"--within {within[0]:g} {within[1]:g} holds no range", expected="lowest, highest")
    days = days_of(folders, product, subject, metric)
    print_table(
        ("time", "campaign", metric, "lower", "upper"),
        [
            (
                f"{d.when:%Y-%m-%dT%H:%M:%SZ}",
                d.row.campaign,
                *(f"{x:.6g}" for x in (d.row.value, d.row.lower, d.row.upper)),
            )
            for d in days
        ],
    )
    trend = drift_of([d.year for d in days], [d.row.value for d in days])
    words = f"{metric} changes by {trend.per_year:+.3g} in a year, 95 % interval "
    words += f"{trend.lower:+.3g} to {trend.upper:+.3g}"
    if within is None:
        note(f"{words} ({trend.n} days)")
        return 0
    outcome = trend.outcome(*within)
    note(f"{words} ({trend.n} days): {outcome} with {within[0]:g} to {within[1]:g}")
    return {Outcome.AGREES: 0, Outcome.DISAGREES: 1}.get(outcome, 5)
