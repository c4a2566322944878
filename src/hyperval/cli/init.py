"""The command that writes the first draft of a campaign."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from hyperval.cli.shared import app, note
from hyperval.errors import UsageError


@app.command()
def init(
    cube: Annotated[Path, typer.Option(help="The image: data file, ENVI header, GeoTIFF, NetCDF or HDF5 product.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for campaign.yaml; made where it is not.")],
    regions: Annotated[list[Path] | None, typer.Option(help="Files of regions of interest.")] = None,
    targets: Annotated[Path | None, typer.Option(help="Regions, mask or list (CSV) of the targets.")] = None,
    spectra: Annotated[
        list[Path] | None, typer.Option(help="Files or folders of field spectra, named as regions and targets.")
    ] = None,
    header: Annotated[Path | None, typer.Option(help="ENVI header that does not lie beside the image.")] = None,
    quantity: Annotated[
        Literal["radiance", "reflectance"] | None, typer.Option(help="What the image holds, where it does not say.")
    ] = None,
    unit: Annotated[str | None, typer.Option(help="Unit of the radiance, where the image does not say.")] = None,
    sensor: Annotated[str | None, typer.Option(help="Sensor of the library, or a sensor file.")] = None,
    time: Annotated[str | None, typer.Option(help="Time of the line, UTC: 2012-09-20T16:31:00Z.")] = None,
    altitude_km: Annotated[float | None, typer.Option(help="Sensor above sea level [km].")] = None,
    pixel_size_m: Annotated[
        float | None, typer.Option(help="Ground size of a pixel, without a map position.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the campaign; default: that of the folder.")] = None,
) -> int:
    """Write the first draft of a campaign from an image and what lies beside it; guesses are marked."""
    import re

    from hyperval.campaign.starter import starter_campaign
    from hyperval.campaign.starter_draft import Sources
    from hyperval.files import write_text

    path = output / "campaign.yaml"
    if path.exists():
        raise UsageError("is there already", where=str(path), mend="name another folder with --output (-o)")
    own = name or re.sub(r"[^a-z0-9]+", "-", output.resolve().name.lower()).strip("-") or "campaign"
    sources = Sources(
        cube, regions or (), targets, spectra or (), header, quantity, unit, sensor, time, altitude_km, pixel_size_m
    )
    text, guesses = starter_campaign(sources, output, own)
    output.mkdir(parents=True, exist_ok=True)
    write_text(path, text)
    for guess in guesses:
        note(f"guess: {guess}")
    to_fill = text.count("FILL_IN:")
    note(
        f"{path}: {f'{to_fill} values to fill in, then' if to_fill else 'now'}: hyperval validate --dry-run {path}"
    )
    return 0
