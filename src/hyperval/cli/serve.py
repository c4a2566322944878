"""The web application."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from hyperval.cli.shared import Scheduler, app, note
from hyperval.errors import UsageError

_MB = 1_000_000


@app.command()
def serve(
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port.")] = 8000,
    host: Annotated[
        str, typer.Option(help="Address that it listens at; this machine alone by default.")
    ] = "127.0.0.1",
    name: Annotated[
        list[str] | None,
        typer.Option(help="Name under which browsers reach it, besides localhost; may be repeated."),
    ] = None,
    folder: Annotated[
        Path | None, typer.Option(help="Runs, uploads and their index; by default in the user's data folder.")
    ] = None,
    campaigns: Annotated[
        Path | None, typer.Option(help="Folder of campaigns that may be run from the pages.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="Folder whose cubes, regions and spectra may be named in the pages.")
    ] = None,
    workers: Annotated[int, typer.Option(min=1, max=64, help="Processes for predictions.")] = 2,
    long_workers: Annotated[int, typer.Option(min=1, max=64, help="Processes for studies and campaigns.")] = 1,
    scheduler: Scheduler = None,
    memory_mb: Annotated[int, typer.Option(min=500, help="Memory of one process.")] = 3000,
    seconds: Annotated[float, typer.Option(min=1, help="Longest study or campaign.")] = 3600.0,
    queue: Annotated[int, typer.Option(min=1, max=10_000, help="Runs that may wait.")] = 64,
    upload_mb: Annotated[int, typer.Option(min=1, max=2000, help="Largest upload.")] = 64,
    kept_mb: Annotated[int, typer.Option(min=1, help="Finished runs that are kept; the oldest go first.")] = 5000,
    kept_days: Annotated[float, typer.Option(min=0.01, help="How long finished runs are kept.")] = 30.0,
    https: Annotated[
        bool, typer.Option("--https", help="A proxy before it speaks HTTPS: cookies go no other way.")
    ] = False,
) -> int:
    """Serve the web application, to browsers of this machine by default."""
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # the workers share the processors
    import platformdirs

    place = folder or Path(platformdirs.user_data_dir("hyperval")) / "web"
    keep_caches(place)

    try:
        import uvicorn

        from hyperval.web.app import make_app
    except ModuleNotFoundError as error:
        raise UsageError(f"the web application needs {error.name}", mend="pip install 'hyperval[web]'") from error
    from hyperval.web.limits import LOOPBACK, Limits, Settings

    limits = Limits(
        upload_bytes=upload_mb * _MB, long_seconds=seconds, memory_bytes=memory_mb * _MB, quick_workers=workers,
        long_workers=long_workers, queue=queue, kept_bytes=kept_mb * _MB, kept_days=kept_days,
    )  # fmt: skip
    for given, words in ((campaigns, "a folder of campaigns"), (data, "a folder of collections")):
        if given is not None and not given.is_dir():
            raise UsageError("is no folder", where=str(given), expected=words)
    names = tuple(n.lower() for n in name or ())
    settings = Settings(place, campaigns, (*LOOPBACK, *names), https, limits, data)
    if scheduler is not None:
        from hyperval.web.cluster import Cluster

        crews = (Cluster(scheduler, queue, limits.quick_seconds), Cluster(scheduler, queue, limits.long_seconds))
    else:
        crews = None
    application = make_app(settings, crews)
    for words in application.state.store.notices:
        note(words)
    note(f"hyperval serves at http://{host}:{port} (runs in {place}); Ctrl+C ends it")
    uvicorn.run(
        application, host=host, port=port, log_level="warning", access_log=False, server_header=False,
        proxy_headers=False, timeout_keep_alive=30,
    )  # fmt: skip
    return 0


def keep_caches(place: Path) -> None:
    """Keep what is computed once in the server's folder, where its user has no home, as that of a service."""
    from hyperval.datasets import cache_dir

    try:
        cache_dir().parent.mkdir(parents=True, exist_ok=True)
        writable = os.access(cache_dir().parent, os.W_OK)
    except OSError:
        writable = False
    if not writable:
        os.environ["HYPERVAL_CACHE"] = str(place / "cache")
        os.environ.setdefault("MPLCONFIGDIR", str(place / "cache" / "matplotlib"))
