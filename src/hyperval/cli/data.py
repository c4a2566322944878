"""Commands about public data sets."""

from __future__ import annotations

from typing import Annotated

import typer

from hyperval.cli.shared import app, note, print_table, settings

data_app = typer.Typer(help="Public data sets: list, fetch, verify.", no_args_is_help=True)
app.add_typer(data_app, name="data")


@data_app.command("list")
def data_list() -> int:
    """List the registered data sets and whether they are on this machine."""
    from hyperval.datasets import files_at_hand, missing, registry

    rows = []
    for name, entry in registry().items():
        if not entry.public:
            count = files_at_hand(name)
            where = f"{count} files here" if count else f"held by {entry.holder}: {entry.obtain}"
            rows.append((name, "-", entry.licence, where, entry.title))
            continue
        lacking = len(missing(name))
        here = "here" if not lacking else f"{lacking} of {len(entry.files)} files missing"
        size = sum(file.size for file in entry.files) / 1e6
        rows.append((name, f"{size:.1f} MB", entry.licence, here, entry.title))
    print_table(("name", "size", "licence", "state", "title"), rows)
    return 0


@data_app.command("fetch")
def data_fetch(names: Annotated[list[str], typer.Argument(help="Names of data sets.")]) -> int:
    """Bring data sets into the user's cache; every file is checked against its digest."""
    from hyperval.datasets import cache_dir, dataset, fetch

    for entry in [dataset(name) for name in names]:
        new = fetch(entry.name, show_progress=settings.show_progress)
        note(f"{entry.name}: {len(new)} files fetched into {cache_dir()}" if new else f"{entry.name}: complete")
        note(f"  licence {entry.licence}; please cite: {entry.citation}")
    return 0


@data_app.command("verify")
def data_verify(
    names: Annotated[list[str] | None, typer.Argument(help="Names of data sets; all when none is named.")] = None,
) -> int:
    """Compare the files at hand with their digests; exit code 3 when one is missing or differs."""
    from hyperval.datasets import dataset, registry, verify
    from hyperval.errors import InputError

    for name in names or []:
        if not dataset(name).public:
            note(f"{name}: not public, so no checksums are registered")
    checks = [(name, check) for name in names or registry() for check in verify(name)]
    print_table(("set", "file", "state"), [(name, check.path, check.state) for name, check in checks])
    return 0 if all(check.state == "ok" for _, check in checks) else InputError.exit_code
