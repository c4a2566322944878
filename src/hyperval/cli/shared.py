"""What all commands share: the application, options before the command, how they speak to people."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from hyperval import __version__

app = typer.Typer(
    help="Does the model of a hyperspectral imager agree with what it measured?",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # rich takes as long to load as all else that help needs
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
)
F = TypeVar("F", bound=Callable[..., Any])


def command(*examples: str, of: typer.Typer = app, name: str | None = None) -> Callable[[F], F]:
    """A command whose help ends with examples."""
    return of.command(name, epilog="\n".join(("\b", "Examples:", *(f"  hyperval {example}" for example in examples))))


@dataclass
class CommandSettings:
    """What the options before the command say."""

    quiet: bool = False
    debug: bool = False

    @property
    def show_progress(self) -> bool:
        """Bars only where somebody watches."""
        return not self.quiet and sys.stderr.isatty()


settings = CommandSettings()

Output = Annotated[Path, typer.Option("--output", "-o", help="Folder for the results; replaced as a whole.")]
AnyOutput = Annotated[Path | None, typer.Option("--output", "-o", help="Folder for the results; replaced as a whole.")]

Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", help="Address of a Dask scheduler that shares the work out, such as tcp://node:8786."),
]


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"hyperval {__version__}")
        raise typer.Exit


@app.callback()
def options(
    data_dir: Annotated[
        Path | None, typer.Option(help="Folder with local copies of data sets, before the cache (HYPERVAL_DATA).")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no notes; errors only.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of any error.")] = False,
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and stop.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    """Options that stand before the command."""
    settings.quiet, settings.debug = quiet, debug
    if data_dir is not None:
        from hyperval.datasets import set_data_dir

        set_data_dir(data_dir)


def finished(code: int, output: Path | None) -> int:
    """Say where the results are, if there are any, and pass on the exit code."""
    if output is not None:
        note(f"results in {output}")
    return code


def say_verdicts(output: Path) -> None:
    """A line for each campaign of a finished run, then one for each reason of an error or a skipped comparison.

    Errors are said under --quiet too.
    """
    from hyperval.report import first_screen, last_line
    from hyperval.results import Outcome
    from hyperval.run import is_run, read_rows

    rows = list(read_rows(output, every=False)) if is_run(output) else []
    for name, own in groupby(rows, lambda row: row.campaign):
        note(f"{name}: {first_screen(list(own)).words}")
    for outcome in (Outcome.ERROR, Outcome.SKIPPED):
        concerned: dict[str, dict[str, None]] = {}
        for row in rows:
            if row.outcome is outcome and row.reason:
                concerned.setdefault(row.reason, {})[row.campaign] = None
        for reason, campaigns in concerned.items():
            line = f"{', '.join(campaigns)}: {outcome}: {reason}"
            print(line, file=sys.stderr) if outcome is Outcome.ERROR else note(line)
    if rows:
        note(last_line(rows))


def say_warnings(output: Path) -> None:
    """The warnings of a finished run, each with its campaign."""
    from hyperval.run import provenance_of, runs_in

    for folder in runs_in([output]) if output.is_dir() else ():
        record = provenance_of(folder)
        name = record.get("configuration", {}).get("campaign", {}).get("name", folder.name)
        for line in record.get("warnings", ()):
            note(f"{name}: {line}")


def note(text: str) -> None:
    """A message that --quiet leaves out."""
    if not settings.quiet:
        print(text, file=sys.stderr)


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table for people on a terminal, tab-separated values for programs."""
    if not sys.stdout.isatty():
        for row in (header, *rows):
            print("\t".join(row))
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(*header, box=None, pad_edge=False)
    for row in rows:
        table.add_row(*row)
    Console().print(table)
