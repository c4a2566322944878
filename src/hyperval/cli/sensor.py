"""Commands about sensors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hyperval.cli.shared import app, finished, note, print_table, settings
from hyperval.errors import UsageError

sensor_app = typer.Typer(help="Sensors: those of the package, and new ones.", no_args_is_help=True)
app.add_typer(sensor_app, name="sensor")


@sensor_app.command("list")
def sensor_list() -> int:
    """List the sensors that come with the package."""
    from hyperval.sensor.specification import library_names, load_sensor

    rows = []
    for sensor in map(load_sensor, library_names()):
        centre = sensor.axis.centre_nm
        span = f"{centre.min():.0f}-{centre.max():.0f} nm"
        rows.append((sensor.name, str(centre.size), span, sensor.specification.title))
    print_table(("name", "bands", "range", "title"), rows)
    return 0


@sensor_app.command("show")
def sensor_show(name: Annotated[str, typer.Argument(help="A sensor of the list, or a sensor file.")]) -> int:
    """Print a sensor's specification as YAML: every number with its source."""
    import yaml

    from hyperval.sensor.specification import load_sensor

    entries = load_sensor(name).specification.model_dump(mode="json", by_alias=True, exclude_none=True)
    print(yaml.safe_dump(entries, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100), end="")
    return 0


@sensor_app.command("check")
def sensor_check(
    name: Annotated[str, typer.Argument(help="A sensor of the list, or a sensor file.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder for the datasheet; replaced as a whole.")
    ] = None,
    vary: Annotated[
        float, typer.Option(min=1.0, max=90.0, help="By how much each assumed number is varied [%].")
    ] = 20.0,
) -> int:
    """Run the acceptance suite on a sensor; with --output, write its datasheet."""
    from hyperval.report.verdict import gate_fails, limits_text
    from hyperval.sensor_check.page import check_to_folder

    check = check_to_folder(name, output, vary=vary / 100.0, show_progress=settings.show_progress)
    decided = [r for r in check.table if r.planned]
    rows = [
        (str(r.outcome), r.product, r.subject, r.metric, f"{r.value:.4g}", limits_text(r), r.reason)
        for r in decided
    ]
    print_table(("outcome", "part", "subject", "check", "value", "limit", "remark"), rows)
    failed = sum(gate_fails(r) for r in decided)
    note(f"{check.sensor.name}: {len(decided) - failed} of {len(decided)} checks passed" if failed
         else f"{check.sensor.name}: accepted, {len(decided)} checks")  # fmt: skip
    return finished(check.exit_code, output) if output is not None else check.exit_code


@sensor_app.command("new")
def sensor_new(
    name: Annotated[str, typer.Argument(help="Short name of the sensor.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The file to write; default: NAME.yaml here.")
    ] = None,
    arms: Annotated[str, typer.Option(help="Its spectrometers, with commas between.")] = "VNIR",
) -> int:
    """Write a sensor file to be filled in from a data sheet."""
    from hyperval.files import write_text
    from hyperval.sensor_check.skeleton import skeleton

    path = output if output is not None else Path(f"{name}.yaml")
    text = skeleton(name, [arm.strip() for arm in arms.split(",")])
    if path.exists():
        raise UsageError("is there already", where=str(path), mend="name another file with --output (-o)")
    write_text(path, text)
    note(f"{path}: replace every FILL_IN, then: hyperval sensor check {path}")
    return 0
