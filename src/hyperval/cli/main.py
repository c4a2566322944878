"""The commands: each calls one function of the package, prints its result and returns its exit code."""

from __future__ import annotations

import errno
import os
import re
import signal
import socket
import sys
import tempfile
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Literal, TypeVar

import typer
from typer import Argument, Option
from typer.exceptions import TyperException

import hyperval
from hyperval import __version__, baseline, campaign, scoreboard
from hyperval.errors import HypervalError, InputError, UsageError, as_typed, needed, refuse, words_and_code
from hyperval.progress import set_listener

app = typer.Typer(
    help="Does the model of a hyperspectral imager agree with what it measured?",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # rich takes as long to load as all else that help needs
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
)
F = TypeVar("F", bound=Callable[..., Any])


def command(*examples: str, group: typer.Typer = app, name: str | None = None) -> Callable[[F], F]:
    """A command whose help ends with examples."""
    return group.command(name, epilog="\n".join(("\b", "Examples:", *(f"  hyperval {line}" for line in examples))))


settings = SimpleNamespace(quiet=False, debug=False)  # what the options before the command say

Output = Annotated[Path, Option("--output", "-o", help="Folder for the results; replaced as a whole.")]
AnyOutput = Annotated[Path | None, Option("--output", "-o", help="Folder for the results; replaced as a whole.")]

Scheduler = Annotated[
    str | None, Option(help="Address of a Dask scheduler that shares the work out, such as tcp://node:8786.")
]


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"hyperval {__version__}")
        raise typer.Exit


@app.callback()
def options(
    data_dir: Annotated[
        Path | None, Option(help="Folder with local copies of data sets, before the cache (HYPERVAL_DATA).")
    ] = None,
    quiet: Annotated[bool, Option("--quiet", "-q", help="No progress, no notes; errors only.")] = False,
    debug: Annotated[bool, Option("--debug", help="Show the traceback of any error.")] = False,
    version: Annotated[
        bool, Option("--version", help="Show the version and stop.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    """Options that stand before the command."""
    settings.quiet, settings.debug = quiet, debug
    set_listener((lambda *_: None) if quiet else None)  # who is quiet is told nothing
    if data_dir is not None:
        hyperval.datasets.set_data_dir(data_dir)


def report_results(code: int, output: Path | None) -> int:
    """Say where the results are, if there are any, and their warnings, each with its run; pass on the exit code."""
    if output is not None:
        print_note(f"results in {output}")
        for folder in (output, *sorted(output.glob("*/"))):
            record = hyperval.run.provenance_of(folder)
            name = record.get("configuration", {}).get("campaign", {}).get("name", folder.name)
            for line in record.get("warnings", ()):
                print_note(f"{name}: {line}")
    return code


def print_verdicts(output: Path) -> None:
    """A line for each campaign of a finished run, then its reasons, then how many criteria were met."""
    rows = list(hyperval.run.read_rows(output, every=False)) if hyperval.run.is_run(output) else []
    for name, some in hyperval.results.grouped(rows, lambda row: row.campaign).items():
        if any(row.outcome is not hyperval.results.Outcome.SKIPPED for row in some):  # else the reason, below, says all
            print_note(f"{name}: {hyperval.report.first_screen(some).words}")
    print_reasons(rows)
    if rows:
        print_note(hyperval.report.last_line(rows))


def print_reasons(rows: Sequence[hyperval.results.Result]) -> None:
    """A line for each reason of an error, under --quiet too, or of what was skipped."""
    outcomes = hyperval.results.Outcome
    for outcome in (outcomes.ERROR, outcomes.SKIPPED):
        listed = (row for row in rows if row.outcome is outcome and row.reason)
        # Reasons that differ only in measured numbers are printed once.
        for similar in hyperval.results.grouped(listed, lambda row: re.sub(r"(?<= )[\d.]+\b", "", row.reason)).values():
            more = len({row.reason for row in similar}) - 1
            names = ", ".join(dict.fromkeys(row.campaign for row in similar))
            line = f"{names}: {outcome}: {similar[0].reason}" + (f" (and {more} more like it)" if more else "")
            print(line, file=sys.stderr) if outcome is outcomes.ERROR else print_note(line)


def print_note(text: str) -> None:
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


Campaigns = Annotated[list[Path] | None, Argument(metavar="[CAMPAIGN.yaml...]", help="Campaign files.")]
Sensors = Annotated[
    list[str] | None, Option(metavar="NAME", help="A sensor of the library or a sensor file; several with commas; all.")
]
Baselines = Annotated[Path | None, Option(help="Folder of accepted numbers [validation/baselines].")]
Header = Annotated[Path | None, Option(help="ENVI header that does not lie beside the image.")]
Key = Annotated[str | None, Option(help="Which array of the file is the image, if there are several.")]
Draft = Annotated[Path | None, Option("--output", "-o", help="The file to write.")]
Finished = Annotated[
    Path | None, Option("--from", help="Folder of a finished validate of these campaigns, read instead of run.")
]


@command("check campaigns/*/campaign.yaml --sensors all", "check campaign.yaml --from results --junit check.xml")
def check(
    campaigns: Campaigns = None,
    sensors: Sensors = None,
    junit: Annotated[Path | None, Option(help="File for the verdicts as JUnit XML.")] = None,
    output: AnyOutput = None,
    baselines: Baselines = None,
    source: Finished = None,
    everything: Annotated[bool, Option("--all", help="Print the numbers that are as accepted, too.")] = False,
) -> int:
    """Run campaigns and sensors, and compare with what was accepted."""
    refuse(baselines is not None and not baselines.is_dir(), "folder.missing", str(baselines))
    folder = baselines or baseline.DEFAULT_FOLDER
    runs = baseline.check(campaigns or [], sensors or [], baselines=folder, source=source, output=output, junit=junit)
    header = ("where", "metric", "accepted", "now", "difference", "tolerance", "outcome")
    compared = [row for run in runs if run.before for row in run.rows if everything or row.reason]
    print_table(header, list(map(_cells, compared)))
    for run in runs:
        _print_summary(run, folder)
    for reason, skipped in hyperval.results.grouped(runs, lambda run: run.skipped).items():
        if reason is not None:
            print_note(f"{', '.join(run.owner for run in skipped)}: skipped: {reason}")
    return report_results(baseline.joined_rows(runs).exit_code(), output)


def _cells(row: hyperval.results.Result) -> tuple[str, ...]:
    accepted, width = (row.limit_high + row.limit_low) / 2.0, (row.limit_high - row.limit_low) / 2.0
    numbers = (f"{accepted:.6g}", f"{row.value:.6g}", f"{row.value - accepted:+.3g}", f"{width:.3g}")
    outcome = row.reason or str(row.outcome)
    return (row.campaign, row.key, *("-" if "nan" in text else text for text in numbers), outcome)


def _print_summary(run: baseline.RunNumbers, baselines: Path) -> None:
    """A line of summary; with the reason where nothing was compared."""
    wrong = [row for row in run.rows if row.outcome is hyperval.results.Outcome.DISAGREES]
    if run.before is None:
        for row in wrong:
            print(f"{row.campaign}: {row.reason}", file=sys.stderr)
    elif not wrong:
        print_note(f"{run.owner}: {len(run.rows)} numbers as accepted")
    else:
        before = run.before.versions
        changed = [f"{k} {before[k]} is now {v}" for k, v in run.versions.items() if k in before and before[k] != v]
        causes = "the code or the sensor file" if run.kind == "sensor" else "the code, the campaign's files or its data"
        unchanged = f"{causes}: the versions of all packages are as accepted"
        print_note(f"{run.owner}: {len(wrong)} of {len(run.rows)} numbers are not as accepted")
        print_note(f"  likely cause: {'; '.join(changed) or unchanged}")
        print_note(f"  if the change is meant: {run.accept_command(baselines)}")


baseline_app = typer.Typer(help="Accepted numbers of campaigns and sensors.", no_args_is_help=True)
app.add_typer(baseline_app, name="baseline")


@command(
    "baseline accept campaign.yaml --reason 'another atmosphere engine'",
    "baseline accept --sensors mine.yaml --reason 'first numbers'",
    group=baseline_app,
    name="accept",
)
def baseline_accept(
    reason: Annotated[str, Option(help="Why the new numbers are right.")],
    campaigns: Campaigns = None,
    sensors: Sensors = None,
    baselines: Baselines = None,
    source: Finished = None,
) -> int:
    """Take the numbers of a run as those that later runs must give; prints what changes."""
    folder = baselines or baseline.DEFAULT_FOLDER
    runs = baseline.accept(campaigns or [], sensors or [], reason=reason, baselines=folder, source=source)
    header = ("where", "metric", "accepted before", "accepted now")
    print_table(header, [(r.owner, key, _describe(old), _describe(new)) for r in runs for key, old, new in r.changes])
    for run in runs:
        done = f"written to {run.path(folder)}" if run.changes else "nothing changed"
        print_note(f"{run.owner}: {done if run.skipped is None else f'skipped: {run.skipped}'}")
    if written := [run.owner for run in runs if run.changes]:
        print_note('add to the changelog, under "Science changes", with what moved in place of the dots:')
        print_note(f"| {baseline.today()} | {' '.join(reason.split())} | ... | {', '.join(written)} |")
    return 0 if any(run.after for run in runs) else 5


def _describe(item: object) -> str:
    if not isinstance(item, baseline.Accepted):
        return "-"
    value = "no value" if item.accepted is None else f"{item.accepted:.6g}"
    loose = f", loosened: {item.why}" if item.why else ""
    return f"{value} ({item.outcome}, tolerance {item.tolerance:g} of {item.of}{loose})"


data_app = typer.Typer(help="Public data sets: list, fetch, verify.", no_args_is_help=True)
app.add_typer(data_app, name="data")


@command("data list", group=data_app, name="list")
def data_list() -> int:
    """List the registered data sets and whether they are on this machine."""
    rows = []
    for name, entry in hyperval.datasets.registry().items():
        if entry.public:
            lacking = len(hyperval.datasets.missing(name))
            size = f"{sum(file.size for file in entry.files) / 1e6:.1f} MB"
            state = f"{lacking} of {len(entry.files)} files missing" if lacking else "here"
        else:
            count, size = hyperval.datasets.files_at_hand(name), "-"
            state = f"{count} files here" if count else f"held by {entry.holder}: {entry.obtain}"
        rows.append((name, size, entry.licence, state, entry.title))
    print_table(("name", "size", "licence", "state", "title"), rows)
    return 0


@command("data fetch hysu", group=data_app, name="fetch")
def data_fetch(names: Annotated[list[str], Argument(help="Names of data sets.")]) -> int:
    """Bring data sets into the user's cache; every file is checked against its digest."""
    for entry in [hyperval.datasets.dataset(name) for name in names]:
        new, cache = hyperval.datasets.fetch(entry.name), hyperval.datasets.cache_dir()
        print_note(f"{entry.name}: {len(new)} files fetched into {cache}" if new else f"{entry.name}: complete")
        print_note(f"  licence {entry.licence}; please cite: {entry.citation}")
    return 0


@command("data verify hysu", group=data_app, name="verify")
def data_verify(
    names: Annotated[list[str] | None, Argument(help="Names of data sets; all when none is named.")] = None,
) -> int:
    """Compare the files at hand with their digests; exit code 3 when one is missing or differs."""
    for name in names or []:
        if not hyperval.datasets.dataset(name).public:
            print_note(f"{name}: not public, so no checksums are registered")
    every = names or hyperval.datasets.registry()
    checks = [(name, path, state) for name in every for path, state in hyperval.datasets.verify(name).items()]
    print_table(("set", "file", "state"), checks)
    return 0 if all(state == "ok" for *_, state in checks) else InputError.exit_code


@command("compare before after -o moved")
def compare(
    one: Annotated[Path, Argument(metavar="A", help="A folder of results.")],
    other: Annotated[Path, Argument(metavar="B", help="Another, of the same campaign.")],
    output: Output,
) -> int:
    """Set two runs side by side: verdicts that changed, what moved, both runs' curves and pictures."""
    print_note(hyperval.report.compare_runs(one, other, output))
    return report_results(0, output)


@command("drift day-1 day-2 day-3 --metric bias_ratio --within -0.01 0.01")
def drift(
    folders: Annotated[list[Path], Argument(metavar="DIR...", help="Folders that validate wrote.")],
    metric: Annotated[str, Option(help="Metric to follow.")] = "bias_ratio",
    product: Annotated[str, Option(help="Product of its row.")] = "radiance",
    subject: Annotated[str, Option(help="Subject of its row.")] = "site",
    method: Annotated[str, Option(help="Method of its row, where there are several.")] = "",
    within: Annotated[tuple[float, float] | None, Option(help="Accepted change in a year, lowest and highest.")] = None,
) -> int:
    """Print a row for each day of finished runs, and the change in a year with its interval."""
    refuse(within is not None and not within[0] < within[1], "drift.within", within=within)
    named = {"product": product, "subject": subject, "metric": metric, "method": method}
    days = hyperval.run.days_of(folders, **{key: name for key, name in named.items() if name})
    rows = [
        (f"{when:%Y-%m-%dT%H:%M:%SZ}", row.campaign, *(f"{x:.6g}" for x in (row.value, row.lower, row.upper)))
        for when, row in days
    ]
    print_table(("time", "campaign", metric, "lower", "upper"), rows)
    years = [when.timestamp() / hyperval.run.SECONDS_PER_YEAR for when, _ in days]
    trend = hyperval.compare.drift(years, [row.value for _, row in days])
    interval = f"95 % interval {trend.lower:+.3g} to {trend.upper:+.3g} ({len(days)} days)"
    outcome = within and hyperval.compare.compare_with_range(trend.lower, trend.upper, *within)
    judged = f": {outcome} with {within[0]:g} to {within[1]:g}" if within else ""
    print_note(f"{metric} changes by {trend.value:+.3g} in a year, {interval}{judged}")
    return {None: 0, "agrees": 0, "disagrees": 1}.get(outcome, 5)


@command("figures results -o figures --format svg --style journal")
def figures(
    folder: Annotated[Path, Argument(metavar="DIR", help="The folder of one campaign, scenario or collection.")],
    output: Output,
    kind: Annotated[Literal["pdf", "svg", "png"], Option("--format", help="Format of the files.")] = "pdf",
    style: Annotated[
        Literal["house", "journal"], Option(help="journal: two columns wide, in its letters, untitled.")
    ] = "house",
) -> int:
    """Draw the figures of a finished run for print, from its folder."""
    return report_results(hyperval.report.figures_to_folder(folder, output, kind, style == "journal"), output)


@command("metrics", "metrics bias_ratio")
def metrics(
    name: Annotated[str | None, Argument(help="One metric, with everything the table says of it.")] = None,
) -> int:
    """List the metrics: range, interval, how each is judged and what moves it."""
    if name is None:
        print_table(hyperval.metrics.HEADER, [tuple(str(x) for x in row) for row in hyperval.metrics.listed()])
    else:
        print("\n".join(hyperval.metrics.entry(hyperval.metrics.metric_of(name))).strip())
    return 0


@command("explain line1_rad.img", "explain scene.mat --key data")
def explain(
    file: Annotated[Path, Argument(help="An image, or a file of spectra.")], header: Header = None, key: Key = None
) -> int:
    """Say what a file is as the reader sees it: every number's origin, what is not known, and what mends it."""
    for row in hyperval.api.explain(file, header=header, key=key):
        typer.echo("\t".join(" ".join(cell.split()) for cell in row))
    return 0


@command("init --cube line1_rad.img --regions rois.xml --targets planks.csv --spectra spectra -o mine")
def init(
    cube: Annotated[list[Path], Option(help="The image: ENVI, GeoTIFF, NetCDF or HDF5 product, MATLAB or NumPy file.")],
    output: Annotated[Path, Option("--output", "-o", help="Folder for campaign.yaml, or a .yaml file.")],
    regions: Annotated[list[Path] | None, Option(help="Files of regions of interest.")] = None,
    targets: Annotated[Path | None, Option(help="Regions, mask or list (CSV) of the targets.")] = None,
    spectra: Annotated[
        list[Path] | None, Option(help="Files or folders of field spectra, named as regions and targets.")
    ] = None,
    header: Header = None,
    quantity: Annotated[
        Literal["radiance", "reflectance", "counts"] | None, Option(help="What the image holds, where it does not say.")
    ] = None,
    unit: Annotated[str | None, Option(help="Unit of the radiance, where the image does not say.")] = None,
    sensor: Annotated[str | None, Option(help="Sensor of the library, or a sensor file.")] = None,
    time: Annotated[str | None, Option(help="Acquisition time, UTC: 2012-09-20T16:31:00Z.")] = None,
    altitude_km: Annotated[float | None, Option(min=0.0, help="Sensor altitude above sea level [km].")] = None,
    pixel_size_m: Annotated[float | None, Option(help="Ground size of a pixel, without a map position.")] = None,
    key: Key = None,
    scale: Annotated[float | None, Option(help="What multiplies the stored values, if none is stated.")] = None,
    name: Annotated[str | None, Option(help="Name of the campaign; default: that of the folder.")] = None,
) -> int:
    """Write the first draft of a campaign from an image and what lies beside it; guesses are marked."""
    refuse(len(cube) > 1, "starter.cubes", ", ".join(map(str, cube)))
    path = output if output.suffix.lower() in (".yaml", ".yml") else output / "campaign.yaml"
    refuse(path.exists(), "file.exists", path)  # before what lies beside it is written anew
    called = path.stem if path == output else output.resolve().name
    title = re.sub(r"[^a-z0-9]+", "-", (name or called).lower()).strip("-") or "campaign"
    files = cube[0], regions or (), targets, spectra or (), header, quantity, unit
    sources = campaign.StarterSources(*files, sensor, time, altitude_km, pixel_size_m, key, scale)
    text, guesses = campaign.starter_campaign(sources, path.parent, title)
    hyperval.config.write_draft(path, "campaign", text)
    for guess in guesses:
        print_note(f"guess: {guess}")
    data, lines = hyperval.config.parse_yaml(text)
    asked = hyperval.config.placeholders(data, lines, str(path))
    for one in asked:
        print_note(f"to fill in: {one.key}: {one.what}")
    drafted = ("validate", "--dry-run", path) if asked or "comparisons" in data else ("observe", path, "-o", "seen")
    is_draft = bool(asked) and "scenarios" not in data
    proposal = "hyperval init again, with these options, into another folder" if is_draft else as_typed(*drafted)
    count = f"{len(asked)} value{'s' if len(asked) > 1 else ''} to fill in, then"
    print_note(f"{path}: {count if asked else 'now'}: {proposal}")
    return 0


@command("schema campaign -o campaign.schema.json")
def schema(
    kind: Annotated[Literal["campaign", "scenario", "scene", "study", "sensor"], Argument(help="Kind of file.")],
    output: Draft = None,
) -> int:
    """Print the JSON Schema of a kind of file, by which editors complete, explain and mark errors."""
    text = hyperval.config.schema_text(kind)
    if output is None:
        print(text, end="")
    else:
        hyperval.storage.write_text(output, text)
        print_note(f"{output}: the first line '# yaml-language-server: $schema={output}' of a file names it")
    return 0


@command("study study.yaml -o traded")
def study(
    study_file: Annotated[Path, Argument(metavar="STUDY", help="A study file.")],
    output: Output,
    scheduler: Scheduler = None,
) -> int:
    """Evaluate a trade study; an interrupted run goes on where it stopped."""
    return report_results(hyperval.study.study_to_folder(study_file, output, scheduler=scheduler), output)


@command("benchmark campaigns/*/campaign.yaml -o ranks", "benchmark campaign.yaml --scores net=net.npy -o ranks")
def benchmark(
    campaigns: Annotated[list[Path], Argument(metavar="CAMPAIGN.yaml...", help="Campaign files.")],
    output: Output,
    extend: Annotated[list[Path] | None, Option(help="A Python file that registers detectors; it is run.")] = None,
    scores: Annotated[
        list[str] | None,
        Option(metavar="NAME=FILE", help="A score map made elsewhere (GeoTIFF, ENVI, .npy, .mat); {campaign}."),
    ] = None,
    seed: Annotated[int, Option(min=0, help="Seed of the resampling.")] = 0,
    scheduler: Scheduler = None,
) -> int:
    """Rank all detectors on every campaign."""
    refuse(wrong := [one for one in scores or () if not all(one.partition("="))], "scores.form", value=wrong)
    maps, files = dict(one.split("=", 1) for one in scores or ()), extend or []
    code = scoreboard.benchmark(campaigns, output, extensions=files, scores=maps, seed=seed, scheduler=scheduler)
    print_reasons(list(hyperval.run.read_rows(output)))
    return report_results(code, output)


@command("power campaign.yaml -o detected")
def power(
    campaigns: Annotated[list[Path], Argument(metavar="CAMPAIGN.yaml...", help="Campaign files.")],
    output: AnyOutput = None,
    accept: Annotated[bool, Option("--accept", help="Keep the tables as those that reports show.")] = False,
    errors: Annotated[Path | None, Option(help="Errors of your own: NAME: {path: value}.")] = None,
) -> int:
    """Inject standard errors into the model, one at a time: which criteria detect them?"""
    tables = campaign.campaign_power(campaigns, output=output, accept=accept, errors_file=errors)
    done = [item.table for item in tables if item.table is not None]
    sights = {name: [table.errors[name] for table in done] for table in done[:1] for name in table.errors}
    rows = [(n, *(": ".join(filter(None, (e.words, e.not_applicable))) for e in each)) for n, each in sights.items()]
    print_table(("injected error", *(table.campaign for table in done)), rows)
    for item in tables:
        if item.skipped:
            print_note(f"{item.campaign}: skipped: {item.skipped}")
        elif item.table is not None:
            print_note(f"{item.campaign}: {item.table.sentence}")
        for change in item.changes:
            print_note(f"{item.campaign}: {change}")
    has_changed = not accept and any(item.changes for item in tables)
    return report_results(int(has_changed) if done else 5, output)


@command("predict yellow-planks-asphalt -o out", "predict scenario.yaml -o out")
def predict(
    scenario: Annotated[str, Argument(help="A scenario file, or the name of a built-in scenario.")], output: Output
) -> int:
    """Run the forward model alone."""
    return report_results(campaign.predict_to_folder(scenario, output), output)


@command("observe campaign.yaml -o out --write-reflectance envi")
def observe(
    file: Annotated[Path, Argument(metavar="CAMPAIGN", help="A campaign file.")],
    output: Output,
    write_reflectance: Annotated[
        Literal["envi", "cog"] | None,
        Option(help="Write the cube after the empirical line too: ENVI, or a cloud-optimised GeoTIFF."),
    ] = None,
) -> int:
    """Run the empirical pipeline alone: what the collected imagery says."""
    return report_results(campaign.observe(file, output, write_reflectance=write_reflectance), output)


@command("validate --dry-run campaign.yaml", "validate campaign.yaml -o results")
def validate(
    campaigns: Annotated[list[Path], Argument(help="Campaign files.")],
    output: AnyOutput = None,
    dry_run: Annotated[
        bool, Option("--dry-run", help="List files, values to fill in, comparisons, inconclusive criteria.")
    ] = False,
    junit: Annotated[Path | None, Option(help="Copy of junit.xml, where a test server looks for it.")] = None,
    scheduler: Scheduler = None,
    strict: Annotated[
        bool, Option("--strict", help="Exit with 1 where a criterion is inconclusive or skipped, too.")
    ] = False,
    again: Annotated[bool, Option("--again", help="Run unchanged campaigns of the output again, too.")] = False,
) -> int:
    """Predict, observe, compare: the main job."""
    if dry_run:
        items = campaign.dry_run(campaigns, output)
        header = ("campaign", "kind", "state", "what", "detail")
        print_table(header, [(i.campaign, i.kind, i.state, i.what, i.detail) for i in campaign.overview(items)])
        for line in campaign.summary(items):
            print_note(line)
        if any(i.state == campaign.WRONG for i in items):
            return UsageError.exit_code
        return InputError.exit_code if any(i.is_blocking for i in items) else 0
    output = needed(output, "validate.output")
    code = campaign.validate(campaigns, output, scheduler=scheduler, strict=strict, again=again, tell=print_note)
    if junit is not None:
        hyperval.storage.write_text(junit, (output / hyperval.run.JUNIT).read_text("utf-8"))
    report_results(code, output)
    print_verdicts(output)
    return code


@command("simulate scene.yaml -o collection")
def simulate(scene: Annotated[Path, Argument(help="A scene file.")], output: Output) -> int:
    """Write a simulated collection with its truth."""
    return report_results(hyperval.simulate.simulate_to_folder(scene, output), output)


sensor_app = typer.Typer(help="Sensors: those of the package, and new ones.", no_args_is_help=True)
app.add_typer(sensor_app, name="sensor")


@command("sensor list", group=sensor_app, name="list")
def sensor_list() -> int:
    """List the sensors that come with the package."""
    rows = []
    for sensor in map(hyperval.sensor.load_sensor, hyperval.sensor.library_names()):
        nm = sensor.axis.centre_nm
        rows.append((sensor.name, str(nm.size), f"{nm.min():.0f}-{nm.max():.0f} nm", sensor.specification.title))
    print_table(("name", "bands", "range", "title"), rows)
    return 0


@command("sensor show prospectir-vs", group=sensor_app, name="show")
def sensor_show(name: Annotated[str, Argument(help="A sensor of the list, or a sensor file.")]) -> int:
    """Print a sensor's specification as YAML: every number with its source."""
    import yaml

    entries = hyperval.sensor.load_sensor(name).specification.model_dump(mode="json", by_alias=True, exclude_none=True)
    print(yaml.safe_dump(entries, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100), end="")
    return 0


@command("sensor check mine.yaml -o mine-check", group=sensor_app, name="check")
def sensor_check(
    name: Annotated[str, Argument(help="A sensor of the list, or a sensor file.")],
    output: AnyOutput = None,
    vary: Annotated[float, Option(min=1.0, max=90.0, help="By how much each assumed number is varied [%].")] = 20.0,
) -> int:
    """Run the acceptance suite on a sensor; with --output, write its datasheet."""
    check = hyperval.sensor_check.check_to_folder(name, output, vary=vary / 100.0)
    decided = [r for r in check.table if r.planned]
    rows = [
        (str(r.outcome), r.product, r.subject, r.metric, f"{r.value:.4g}", hyperval.report.limits_text(r), r.reason)
        for r in decided
    ]
    print_table(("outcome", "part", "subject", "check", "value", "limit", "remark"), rows)
    failed = sum(map(hyperval.report.is_failed_gate, decided))
    print_note(f"{check.sensor.name}: {len(decided) - failed} of {len(decided)} checks passed" if failed
         else f"{check.sensor.name}: accepted, {len(decided)} checks")  # fmt: skip
    return report_results(check.table.exit_code(), output)


@command("sensor new mine --arms VNIR,SWIR", group=sensor_app, name="new")
def sensor_new(
    name: Annotated[str, Argument(help="Short name of the sensor.")],
    output: Draft = None,
    arms: Annotated[str, Option(help="Its spectrometers, with commas between.")] = "VNIR",
) -> int:
    """Write a sensor file, NAME.yaml by default, to be filled in from a data sheet."""
    path = output or Path(f"{name}.yaml")
    then = as_typed("sensor", "check", path, "-o", f"{name}-check")
    text = hyperval.sensor.new_sensor_file(name, [arm.strip() for arm in arms.split(",")], then)
    hyperval.config.write_draft(path, "sensor", text)
    print_note(f"{path}: replace every FILL_IN, then: {then}")
    return 0


@command("serve", "serve --campaigns campaigns --data data --port 8080")
def serve(
    port: Annotated[int, Option(min=1, max=65535, help="Port.")] = 8000,
    host: Annotated[str, Option(help="Address to listen on; this machine alone by default.")] = "127.0.0.1",
    name: Annotated[
        list[str] | None, Option(help="Name under which browsers reach it, besides localhost; may be repeated.")
    ] = None,
    folder: Annotated[Path | None, Option(help="Runs and uploads; by default in the user's data folder.")] = None,
    campaigns: Annotated[Path | None, Option(help="Folder of campaigns that may be run from the pages.")] = None,
    data: Annotated[Path | None, Option(help="Folder whose cubes, regions and spectra pages may name.")] = None,
    workers: Annotated[int, Option(min=1, max=64, help="Processes for predictions.")] = 2,
    long_workers: Annotated[int, Option(min=1, max=64, help="Processes for studies and campaigns.")] = 1,
    scheduler: Scheduler = None,
    memory_mb: Annotated[int, Option(min=500, help="Memory of one process.")] = 3000,
    seconds: Annotated[float, Option(min=1, help="Time limit of a study or campaign.")] = 3600.0,
    queue: Annotated[int, Option(min=1, max=10_000, help="Runs that may wait.")] = 64,
    connections: Annotated[
        int, Option(min=4, max=100_000, help="Connections from one address; behind a proxy, all of them.")
    ] = 256,
    upload_mb: Annotated[int, Option(min=1, max=2000, help="Largest upload.")] = 64,
    kept_mb: Annotated[int, Option(min=1, help="Finished runs that are kept; the oldest go first.")] = 5000,
    kept_days: Annotated[float, Option(min=0.01, help="How long finished runs are kept.")] = 30.0,
    https: Annotated[bool, Option("--https", help="Behind an HTTPS proxy: cookies are sent over HTTPS only.")] = False,
) -> int:
    """Serve the web application, to browsers of this machine by default."""
    import platformdirs

    place = folder or Path(platformdirs.user_data_dir("hyperval")) / "web"
    keep_caches(place)

    try:
        import uvicorn

        from hyperval.web import LOOPBACK, MEGABYTE, ServerSettings, connection_class, make_app
    except ModuleNotFoundError as error:
        raise UsageError(f"the web application needs {error.name}", mend="pip install 'hyperval[web]'") from error
    refuse(wrong := [str(p) for p in (campaigns, data) if p and not p.is_dir()], "serve.folder", ", ".join(wrong))
    try:
        listening = socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        raise UsageError(str(error.strerror).partition(" (")[0], mend="choose others with --host and --port") from error
    application = make_app(ServerSettings(
        place, campaigns, data, (*LOOPBACK, *(n.lower() for n in name or ())), https, scheduler,
        upload_bytes=upload_mb * MEGABYTE, long_seconds=seconds, memory_bytes=memory_mb * MEGABYTE, queue=queue,
        quick_workers=workers, long_workers=long_workers, kept_bytes=kept_mb * MEGABYTE, kept_days=kept_days,
    ))  # fmt: skip
    for words in application.state.runs.notices:
        print_note(words)
    print_note(f"hyperval serves at http://{host}:{port} (runs in {place}); Ctrl+C stops it")
    config = uvicorn.Config(
        application, log_level="warning", access_log=False, server_header=False, proxy_headers=False,
        timeout_keep_alive=30, ws="none", http=connection_class(connections), backlog=64,
    )  # fmt: skip
    with suppress(KeyboardInterrupt):
        uvicorn.Server(config).run([listening])
    return 0


def keep_caches(place: Path) -> None:
    """Keep what is computed once in the server's folder, where its user has no home, as that of a service."""
    caches = hyperval.datasets.cache_root()
    with suppress(OSError):
        caches.mkdir(parents=True, exist_ok=True)
    if not os.access(caches, os.W_OK):
        os.environ["HYPERVAL_CACHE"] = str(place / "cache")
        os.environ.setdefault("MPLCONFIGDIR", str(place / "cache" / "matplotlib"))


INTERRUPTED, OUTPUT_CLOSED, TERMINATED = 130, 141, 143
_SIGNALS = {INTERRUPTED: "interrupted", TERMINATED: "terminated"}
_FULL = (errno.ENOSPC, errno.EDQUOT)
# Files and folders that a command was told to use and that cannot be.
_PLACES = (errno.ENAMETOOLONG, errno.EACCES, errno.EROFS, errno.ENOTDIR, errno.EISDIR, errno.EEXIST)


def run(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; every error becomes one message on standard error."""
    settings.quiet = settings.debug = False
    try:
        hyperval.storage.stated_time()  # a wrong one is refused now, not when a page is written
        code: int = app(args=arguments, prog_name="hyperval", standalone_mode=False)
        sys.stdout.flush()
    except KeyboardInterrupt:
        code = INTERRUPTED
    except SystemExit as ended:
        # typer stops with 1 when the reader of our output went away (`hyperval ... | head`), but 1 would
        # mean that a comparison failed; with 0 once it has completed a word for a shell.
        code = TERMINATED if ended.code == TERMINATED else OUTPUT_CLOSED if ended.code else 0
    except BrokenPipeError:
        # The same, met at the last flush: nothing more can be written.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OUTPUT_CLOSED
    except TyperException as error:
        return _usage(error)
    except Exception as error:
        return _describe_interrupt(error)
    return _error(_SIGNALS[code], code) if code in _SIGNALS else code


def _usage(error: TyperException) -> int:
    context = getattr(error, "ctx", None)
    text = error.format_message().strip()
    if text.startswith("Usage: "):  # no command given: the help
        print(text)
        return 2
    command = context.command_path if context is not None else "hyperval"
    if context is not None and hasattr(error, "param_type"):  # one is missing: the first of perhaps several
        missing = [p for p in context.command.params if p.required and p.name not in context.params]
        text = "missing: " + ", ".join(p.get_error_hint() for p in missing)
    return _error(f"{text}\n  to fix it: see {command} --help", 2)


def _describe_interrupt(error: Exception) -> int:
    what, code = words_and_code(error)
    if settings.debug:
        traceback.print_exc()
    elif isinstance(error, OSError) and error.errno in _PLACES and error.filename:
        place = os.fsdecode(error.filename2 or error.filename)[:300]
        what = f"{place}: {error.strerror}\n  to fix it: name another file or folder"
        code = UsageError.exit_code
    elif isinstance(error, OSError) and error.errno in _FULL:
        what = f"{error}\n  to fix it: free space there, or name another folder with --output; "
        what += f"temporary files are in {tempfile.gettempdir()} (TMPDIR)"
    elif not isinstance(error, HypervalError):
        try:
            handle, name = tempfile.mkstemp(prefix="hyperval-", suffix=".log")
            with open(handle, "w", encoding="utf-8") as log:
                log.write(f"hyperval {__version__}, Python {sys.version}\n{' '.join(sys.argv)}\n")
                traceback.print_exception(error, file=log)
            what += f" (traceback in {name}, or repeat with: hyperval --debug ...)"
        except OSError:
            what += " (repeat with: hyperval --debug ...)"
    return _error(what, code)


def _error(text: str, code: int) -> int:
    """Say what went wrong, and pass on the exit code."""
    print(f"hyperval: {text}", file=sys.stderr)
    return code


def main() -> None:
    """Entry point of the command `hyperval`."""
    # One thread for each matrix product, set before the libraries load: the last digits of a solve depend on the
    # number of threads, and our own workers would fight for the processors with those of the library.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # It unwinds like an interrupt, so that half-written files are removed.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))
    sys.exit(run())
