"""Commands on finished runs, and on the numbers in them."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from hyperval.cli.shared import Output, app, finished, note, print_table


@app.command()
def compare(
    one: Annotated[Path, typer.Argument(metavar="A", help="A folder of results.")],
    other: Annotated[Path, typer.Argument(metavar="B", help="Another, of the same campaign.")],
    output: Output,
) -> int:
    """Set two runs side by side: verdicts that changed, what moved, both runs' curves and pictures."""
    from hyperval.report.side_by_side import compare_runs

    return finished(compare_runs(one, other, output), output)


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
    """Draw the figures of a finished run for print, from its folder."""
    from hyperval.campaign.curves import spread_curves
    from hyperval.report.printed import figures_to_folder
    from hyperval.report.style import Print

    print_as = Print(kind.value, style is Style.JOURNAL)
    return finished(figures_to_folder(run, output, print_as, spread_curves), output)


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
