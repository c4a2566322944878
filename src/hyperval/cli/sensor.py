"""Commands about sensors."""

from __future__ import annotations

from typing import Annotated

import typer

from hyperval.cli.shared import app, print_table

sensor_app = typer.Typer(help="The sensors that come with the package.", no_args_is_help=True)
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
