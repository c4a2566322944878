"""The command line: each command calls one function of the package and passes on its exit code.

Results go to files, data to standard output, messages to standard error.  Exit codes: 0 all passed,
1 a comparison failed, 2 usage or an invalid file, 3 input missing or corrupt, 4 internal error, 5 nothing
was checked, 130 interrupted, 143 terminated.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.table import Table
from typer.exceptions import Abort, TyperException

from hyperval import __version__
from hyperval.errors import HypervalError, UsageError

INTERNAL_ERROR = 4
INTERRUPTED = 130
TERMINATED = 143
OUTPUT_CLOSED = 141

app = typer.Typer(
    help="Does the model of a hyperspectral imager agree with what it collected?",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
sensor_app = typer.Typer(help="The sensors that come with the package.", no_args_is_help=True)
data_app = typer.Typer(help="Public data sets: list, fetch, verify.", no_args_is_help=True)
app.add_typer(sensor_app, name="sensor")
app.add_typer(data_app, name="data")


@dataclass
class Settings:
    """What the options before the command say."""

    quiet: bool = False
    debug: bool = False

    @property
    def show_progress(self) -> bool:
        """Bars only where somebody watches."""
        return not self.quiet and sys.stderr.isatty()


_settings = Settings()

Output = Annotated[Path, typer.Option("--output", "-o", help="Folder for the results; replaced as a whole.")]


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
    _settings.quiet, _settings.debug = quiet, debug
    if data_dir is not None:
        from hyperval.datasets import set_data_dir

        set_data_dir(data_dir)


@app.command()
def predict(
    scenario: Annotated[str, typer.Argument(help="A scenario file, or the name of a built-in scenario.")],
    output: Output,
) -> int:
    """Run the forward model alone."""
    from hyperval.campaign.run import predict_to_folder

    return _finished(predict_to_folder(scenario, output, show_progress=_settings.show_progress), output)


@app.command()
def observe(campaign: Annotated[Path, typer.Argument(help="A campaign file.")], output: Output) -> int:
    """Run the empirical pipeline alone: what the collected imagery says."""
    from hyperval.campaign.run import observe as run

    return _finished(run(campaign, output, show_progress=_settings.show_progress), output)


@app.command()
def validate(
    campaigns: Annotated[list[Path], typer.Argument(help="Campaign files.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder for the results; replaced as a whole.")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Run nothing: list files, values to fill in, comparisons.")
    ] = False,
) -> int:
    """Predict, observe, compare: the main job."""
    if dry_run:
        return _dry_run(campaigns)
    if output is None:
        raise UsageError("no folder for the results", mend="name one with --output (-o)")
    from hyperval.campaign.run import validate as run

    return _finished(run(campaigns, output, show_progress=_settings.show_progress), output)


@app.command()
def simulate(scene: Annotated[Path, typer.Argument(help="A scene file.")], output: Output) -> int:
    """Write a simulated collection with its truth."""
    from hyperval.simulate import simulate_to_folder

    return _finished(simulate_to_folder(scene, output, show_progress=_settings.show_progress), output)


@sensor_app.command("list")
def sensor_list() -> int:
    """List the sensors that come with the package."""
    from hyperval.sensor.specification import library_names, load_sensor

    rows = []
    for sensor in map(load_sensor, library_names()):
        centre = sensor.axis.centre_nm
        span = f"{centre.min():.0f}-{centre.max():.0f} nm"
        rows.append((sensor.name, str(centre.size), span, sensor.specification.title))
    _print_table(("name", "bands", "range", "title"), rows)
    return 0


@sensor_app.command("show")
def sensor_show(name: Annotated[str, typer.Argument(help="A sensor of the list, or a sensor file.")]) -> int:
    """Print a sensor's specification as YAML: every number with its source."""
    import yaml

    from hyperval.sensor.specification import load_sensor

    entries = load_sensor(name).specification.model_dump(mode="json", by_alias=True, exclude_none=True)
    print(yaml.safe_dump(entries, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100), end="")
    return 0


@data_app.command("list")
def data_list() -> int:
    """List the registered data sets and whether they are on this machine."""
    from hyperval.datasets import files_at_hand, missing, registry

    rows = []
    for name, entry in registry().items():
        if not entry.public:
            count = files_at_hand(name)
            held = f"{count} files here" if count else f"held by {entry.held_by}; ask them"
            rows.append((name, "-", entry.licence, held, entry.title))
            continue
        lacking = len(missing(name))
        here = "here" if not lacking else f"{lacking} of {len(entry.files)} files missing"
        size = sum(file.size for file in entry.files) / 1e6
        rows.append((name, f"{size:.1f} MB", entry.licence, here, entry.title))
    _print_table(("name", "size", "licence", "state", "title"), rows)
    return 0


@data_app.command("fetch")
def data_fetch(names: Annotated[list[str], typer.Argument(help="Names of data sets.")]) -> int:
    """Bring data sets into the user's cache; every file is checked against its SHA-256."""
    from hyperval.datasets import cache_dir, dataset, fetch

    for entry in [dataset(name) for name in names]:
        new = fetch(entry.name, show_progress=_settings.show_progress)
        _note(f"{entry.name}: {len(new)} files fetched into {cache_dir()}" if new else f"{entry.name}: complete")
        _note(f"  licence {entry.licence}; please cite: {entry.citation}")
    return 0


@data_app.command("verify")
def data_verify(
    names: Annotated[list[str] | None, typer.Argument(help="Names of data sets; all when none is named.")] = None,
) -> int:
    """Compare the files at hand with their SHA-256; exit code 3 when one is missing or differs."""
    from hyperval.datasets import dataset, registry, verify
    from hyperval.errors import InputError

    for name in names or []:
        if not dataset(name).public:
            _note(f"{name}: not public, so no checksums are registered")
    checks = [(name, check) for name in names or registry() for check in verify(name)]
    _print_table(("set", "file", "state"), [(name, check.path, check.state) for name, check in checks])
    return 0 if all(check.state == "ok" for _, check in checks) else InputError.exit_code


def _dry_run(campaigns: list[Path]) -> int:
    from hyperval.campaign.dry_run import dry_run, summary
    from hyperval.errors import InputError

    items = dry_run(campaigns)
    header = ("campaign", "kind", "state", "what", "detail")
    _print_table(header, [(i.campaign, i.kind, i.state, i.what, i.detail) for i in items])
    for line in summary(items):
        _note(line)
    return InputError.exit_code if any(i.lacking for i in items) else 0


def _finished(code: int, output: Path) -> int:
    _note(f"results in {output}")
    return code


def _note(text: str) -> None:
    """A message that --quiet leaves out."""
    if not _settings.quiet:
        print(text, file=sys.stderr)


def _print_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table for people on a terminal, tab-separated values for programs."""
    if not sys.stdout.isatty():
        for row in (header, *rows):
            print("\t".join(row))
        return
    table = Table(*header, box=None, pad_edge=False)
    for row in rows:
        table.add_row(*row)
    Console().print(table)


class _Terminated(BaseException):
    """SIGTERM came: unwinds like an interrupt, so that half-written files are removed."""


def _terminate(signum: int, frame: FrameType | None) -> NoReturn:
    raise _Terminated


def run(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; every error becomes one message on standard error."""
    _settings.quiet = _settings.debug = False
    try:
        code: Any = app(args=arguments, prog_name="hyperval", standalone_mode=False)
        sys.stdout.flush()
    except (KeyboardInterrupt, Abort):
        code = INTERRUPTED
    except _Terminated:
        code = TERMINATED
    except SystemExit:
        # typer stops with 1 when the reader of our output went away (`hyperval ... | head`), but 1 would
        # mean that a comparison failed.
        return OUTPUT_CLOSED
    except BrokenPipeError:
        # The same, met at the last flush: nothing more can be written.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OUTPUT_CLOSED
    except TyperException as error:
        return _usage(error)
    except HypervalError as error:
        if _settings.debug:
            traceback.print_exc()
        _error(str(error))
        return error.exit_code
    except Exception as error:
        return _internal(error)
    if code in (INTERRUPTED, TERMINATED):
        _error("interrupted" if code == INTERRUPTED else "terminated")
    return code if isinstance(code, int) else 0


def _usage(error: TyperException) -> int:
    context = getattr(error, "ctx", None)
    text = error.format_message().strip()
    if not text:  # no command given: typer raises with the help already printed
        return 2
    command = context.command_path if context is not None else "hyperval"
    _error(f"{text}\n  to mend it: see {command} --help")
    return 2


def _internal(error: Exception) -> int:
    what = f"internal error: {type(error).__name__}: {error}"
    if _settings.debug:
        traceback.print_exc()
        _error(what)
        return INTERNAL_ERROR
    try:
        handle, name = tempfile.mkstemp(prefix="hyperval-", suffix=".log")
        with open(handle, "w", encoding="utf-8") as log:
            log.write(f"hyperval {__version__}, Python {sys.version}\n{' '.join(sys.argv)}\n")
            traceback.print_exception(error, file=log)
        _error(f"{what} (traceback in {name}, or repeat with: hyperval --debug ...)")
    except OSError:
        _error(f"{what} (repeat with: hyperval --debug ...)")
    return INTERNAL_ERROR


def _error(text: str) -> None:
    print(f"hyperval: {text}", file=sys.stderr)


def main() -> None:
    """Entry point of the command `hyperval`."""
    # One thread for each matrix product, set before the libraries load: the last digits of a solve depend on the
    # number of threads, and our own workers would fight for the processors with those of the library.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    signal.signal(signal.SIGTERM, _terminate)
    sys.exit(run())
