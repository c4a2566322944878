"""Commands about accepted numbers."""

from __future__ import annotations

from typing import Annotated

import typer

from hyperval.cli.check import Baselines, Campaigns, Finished, Sensors
from hyperval.cli.shared import app, note, print_table, settings

baseline_app = typer.Typer(help="Accepted numbers of campaigns and sensors.", no_args_is_help=True)
app.add_typer(baseline_app, name="baseline")


@baseline_app.callback()
def baseline() -> None:
    """Accepted numbers of campaigns and sensors."""


@baseline_app.command("accept")
def baseline_accept(
    reason: Annotated[str, typer.Option(help="Why the new numbers are right.")],
    campaigns: Campaigns = None,
    sensors: Sensors = None,
    baselines: Baselines = None,
    source: Finished = None,
) -> int:
    """Take the numbers of a run as those that later runs must give; prints what changes."""
    from hyperval.baseline import accept
    from hyperval.baseline.store import DEFAULT_FOLDER

    done = accept(
        campaigns or [],
        sensors or [],
        reason=reason,
        baselines=baselines or DEFAULT_FOLDER,
        source=source,
        show_progress=settings.show_progress,
    )
    header = ("where", "metric", "accepted before", "accepted now")
    print_table(header, [(c.owner, c.key, _in_words(c.old), _in_words(c.new)) for c in done.changes])
    for name in done.unchanged:
        note(f"{name}: nothing changed")
    for name, why in done.skipped.items():
        note(f"{name}: skipped: {why}")
    for name, path in done.written.items():
        note(f"{name}: written to {path}")
    if done.written:
        note('add to the changelog, under "Science changes":')
        note(f"- {done.date}: {' '.join(reason.split())} (baselines: {', '.join(done.written)})")
    return done.exit_code


def _in_words(item: object) -> str:
    from hyperval.baseline.schema import Accepted

    if not isinstance(item, Accepted):
        return "-"
    value = "no value" if item.accepted is None else f"{item.accepted:.6g}"
    loose = f", loosened: {item.why}" if item.why else ""
    return f"{value} ({item.outcome}, tolerance {item.tolerance:g} of {item.of}{loose})"
