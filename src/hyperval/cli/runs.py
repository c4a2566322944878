"""Commands that run the model, the pipeline, or both."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from hyperval.cli.shared import (
    AnyOutput,
    Output,
    Scheduler,
    app,
    finished,
    note,
    print_table,
    say_verdicts,
    say_warnings,
    settings,
)
from hyperval.errors import UsageError


@app.command()
def predict(
    scenario: Annotated[str, typer.Argument(help="A scenario file, or the name of a built-in scenario.")],
    output: Output,
) -> int:
    """Run the forward model alone."""
    from hyperval.campaign.forward import predict_to_folder

    return finished(predict_to_folder(scenario, output, show_progress=settings.show_progress), output)


@app.command()
def observe(
    campaign: Annotated[Path, typer.Argument(help="A campaign file.")],
    output: Output,
    write_reflectance: Annotated[
        Literal["envi", "cog"] | None,
        typer.Option(help="Write the cube after the empirical line too: ENVI, or a cloud-optimised GeoTIFF."),
    ] = None,
) -> int:
    """Run the empirical pipeline alone: what the collected imagery says."""
    from hyperval.campaign.observing import observe as run

    code = run(campaign, output, write_reflectance=write_reflectance, show_progress=settings.show_progress)
    say_warnings(output)
    return finished(code, output)


@app.command()
def validate(
    campaigns: Annotated[list[Path], typer.Argument(help="Campaign files.")],
    output: AnyOutput = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Run nothing: list files, values to fill in, comparisons.")
    ] = False,
    junit: Annotated[Path | None, typer.Option(help="Copy of junit.xml, where a test server looks for it.")] = None,
    scheduler: Scheduler = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit with 1 where a gate is undecided or skipped, too.")
    ] = False,
    again: Annotated[
        bool, typer.Option("--again", help="Run also what stands in the output and would come out the same.")
    ] = False,
) -> int:
    """Predict, observe, compare: the main job."""
    if dry_run:
        return _dry_run(campaigns)
    if output is None:
        raise UsageError("no folder for the results", mend="name one with --output (-o)")
    from hyperval.campaign.run import validate as run
    from hyperval.files import write_text

    code = run(
        campaigns, output, scheduler=scheduler, strict=strict, again=again, tell=note,
        show_progress=settings.show_progress,
    )  # fmt: skip
    if junit is not None:
        write_text(junit, (output / "junit.xml").read_text("utf-8"))
    note(f"results in {output}")
    say_warnings(output)
    say_verdicts(output)
    return code


@app.command()
def simulate(scene: Annotated[Path, typer.Argument(help="A scene file.")], output: Output) -> int:
    """Write a simulated collection with its truth."""
    from hyperval.simulate import simulate_to_folder

    return finished(simulate_to_folder(scene, output, show_progress=settings.show_progress), output)


def _dry_run(campaigns: list[Path]) -> int:
    from hyperval.campaign.dry_run import WRONG, dry_run, overview, summary
    from hyperval.errors import InputError

    items = dry_run(campaigns)
    header = ("campaign", "kind", "state", "what", "detail")
    print_table(header, [(i.campaign, i.kind, i.state, i.what, i.detail) for i in overview(items)])
    for line in summary(items):
        note(line)
    if any(i.state == WRONG for i in items):
        return UsageError.exit_code
    return InputError.exit_code if any(i.lacking for i in items) else 0
