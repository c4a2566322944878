"""Commands about accepted numbers."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hyperval.cli.shared import AnyOutput, app, note, print_table, settings
from hyperval.errors import UsageError

if TYPE_CHECKING:
    from hyperval.baseline.check import Checked
    from hyperval.baseline.differences import Difference

Campaigns = Annotated[list[Path] | None, typer.Argument(metavar="[CAMPAIGN.yaml...]", help="Campaign files.")]
Sensors = Annotated[
    list[str] | None,
    typer.Option(
        "--sensors", metavar="NAME", help="A sensor of the library or a sensor file; several with commas; all."
    ),
]
Baselines = Annotated[Path | None, typer.Option(help="Folder of accepted numbers [validation/baselines].")]
Finished = Annotated[
    Path | None,
    typer.Option("--from", help="Folder of a finished validate of these campaigns, read instead of run."),
]


@app.command()
def check(
    campaigns: Campaigns = None,
    sensors: Sensors = None,
    junit: Annotated[Path | None, typer.Option(help="File for the verdicts as JUnit XML.")] = None,
    output: AnyOutput = None,
    baselines: Baselines = None,
    source: Finished = None,
    everything: Annotated[bool, typer.Option("--all", help="Print the numbers that are as accepted, too.")] = False,
) -> int:
    """Run campaigns and sensors, and compare with what was accepted."""
    from hyperval.baseline import check as run
    from hyperval.baseline.store import DEFAULT_FOLDER

    if baselines is not None and not baselines.is_dir():
        raise UsageError("no such folder", where=str(baselines), mend="name the folder of accepted numbers")
    outcome = run(
        campaigns or [],
        sensors or [],
        baselines=baselines or DEFAULT_FOLDER,
        source=source,
        output=output,
        junit=junit,
        show_progress=settings.show_progress,
    )
    header = ("where", "metric", "accepted", "now", "difference", "tolerance", "outcome")
    shown = [d for item in outcome.checked for d in item.differences if everything or d.words]
    lonely = [
        (r.campaign, r.metric, "", "", "", "", str(r.outcome))
        for c in outcome.checked
        if not c.differences
        for r in c.rows
    ]
    print_table(header, [*map(_cells, shown), *lonely])
    skipped: dict[str, list[str]] = {}
    for item in outcome.checked:
        _tell(item, baselines or DEFAULT_FOLDER)
        if item.run.skipped is not None:
            skipped.setdefault(item.run.skipped, []).append(item.run.owner)
    for reason, owners in skipped.items():
        note(f"{', '.join(owners)}: skipped: {reason}")
    if output is not None:
        note(f"results in {output}")
    return outcome.exit_code


def _cells(d: Difference) -> tuple[str, ...]:
    known = d.accepted is not None and d.accepted.accepted is not None
    return (
        d.owner,
        d.key,
        f"{d.accepted.accepted:.6g}" if d.accepted and d.accepted.accepted is not None else "-",
        f"{d.now.value:.6g}" if d.now and d.now.value == d.now.value else "-",
        f"{d.change:+.3g}" if d.change == d.change else "-",
        f"{d.accepted.width:.3g}" if d.accepted and known else "-",
        str(d.outcome),
    )


def _tell(item: Checked, baselines: Path) -> None:
    """One line of summary, and each number that is not as accepted in words."""
    from hyperval.results import Outcome

    wrong = [row for row in item.rows if row.outcome is Outcome.DISAGREES]
    for row in wrong:
        print(f"{row.campaign}: {row.product} {row.subject} {row.method}: {row.reason}", file=sys.stderr)
    if item.differences and not wrong:
        note(f"{item.run.owner}: {len(item.differences)} numbers as accepted")
    elif item.differences:
        note(f"{item.run.owner}: {len(wrong)} of {len(item.differences)} numbers are not as accepted")
        causes = _likely_causes(item)
        note(f"  likely cause: {causes}")
        note(f"  if the change is meant: {item.run.acceptance(baselines)}")


def _likely_causes(item: Checked) -> str:
    """What differs between the run and the one that was accepted, as far as both say."""
    from hyperval.baseline.schema import load_baseline

    then = load_baseline(item.baseline).versions
    changed = [f"{k} {then[k]} is now {v}" for k, v in item.run.versions.items() if k in then and then[k] != v]
    return (
        "; ".join(changed)
        or "the code, the campaign's files or its data: the versions of all packages are as accepted"
    )


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
