"""``report.html``: one page that a reviewer reads in five minutes, with nothing loaded from elsewhere."""

from __future__ import annotations

import base64
import datetime
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jinja2
from markupsafe import Markup

import hyperval
from hyperval.report import verdict as v
from hyperval.report.glossary import explained
from hyperval.report.run import RunReport
from hyperval.report.style import Drawing
from hyperval.report.tables import row_name, status_counts
from hyperval.results import Result, Status

MAX_BYTES = 5_000_000  # of a page; figures beyond it are linked, not embedded
_FIGURE_BYTES = 4_200_000  # of that, for figures
_MOST_INFORMING = 40  # rows in the first table; more are moved to their sections
_MOST_OPEN = 12  # of those, before the rest is folded
_MOST_PASSES = 20  # in the first table; the others are folded below it
_MOST_SKIPPED = 10
_MOST_LISTED = 400  # per-band failures spelled out; results.csv has all
_MOST_ROWS = 60  # informing rows of one section
_INPUTS_UNDER_FIGURE = 3

_SECTIONS = {
    "attribution": "Why they differ",
    "what-if": "What-ifs",
    "sensitivity": "What moves what",
    "scene": "Scene",
    "radiance": "Radiance",
    "snr": "Signal-to-noise ratio",
    "reflectance": "Reflectance",
    "covariance": "Covariance",
    "classification": "Classification",
    "scores": "Detector scores",
    "roc": "Detection and false alarms",
    "abundance": "Abundance and target area",
}
_MEDIA = {"svg": "image/svg+xml", "png": "image/png"}


@dataclass(frozen=True)
class Section:
    """One product's part of the page."""

    title: str
    figures: list[dict[str, Any]]
    rows: list[Result]


def report_page(run: RunReport, drawings: Sequence[Drawing]) -> str:
    """The page of one campaign."""
    rows = list(run.table)
    tone, words = v.verdict(rows)
    gates = sorted((r for r in rows if r.status is not Status.INFO), key=_severity)
    whole = [r for r in gates if not v.is_per_band(r)]
    folded = {
        id(row)
        for status, most in ((Status.PASS, _MOST_PASSES), (Status.SKIPPED, _MOST_SKIPPED))
        for row in [r for r in whole if r.status is status][most:]
    }
    bands = [r for r in gates if v.is_per_band(r)]
    failed_bands = [r for r in bands if r.status in (Status.FAIL, Status.ERROR)]
    informing = [r for r in rows if r.status is Status.INFO and not v.is_per_band(r)]
    first = informing if len(informing) <= _MOST_INFORMING else [r for r in informing if v.is_planned(r)]
    # What explains the whole comes first, then what disagrees.
    first = sorted(first, key=lambda r: (not _explains_all(r), not v.informs_of_disagreement(r)))
    first = first[: max(_MOST_INFORMING, sum(v.informs_of_disagreement(r) for r in first))]
    shown = {id(r) for r in first}
    return environment().get_template("report.html.j2").render(
        run=run,
        tone=tone,
        verdict=words,
        counts=v.status_words(rows),
        gates=[r for r in whole if id(r) not in folded],
        folded_passes=[r for r in whole if id(r) in folded and r.status is Status.PASS],
        folded_skips=sum(id(r) in folded and r.status is Status.SKIPPED for r in whole),
        failed_bands=failed_bands,
        failed_by_subject=_grouped(failed_bands),
        unlisted_bands=len(bands) - len(failed_bands),
        per_band=sum(v.is_per_band(r) for r in rows),
        informing=first[:_MOST_OPEN],
        folded_informing=first[_MOST_OPEN:],
        moved=len(informing) - len(first),
        sections=_sections(run, drawings, [r for r in informing if id(r) not in shown]),
        undone=_undone(gates),
        notes=_all_notes(run),
        inputs=[_input(item) for item in run.provenance.get("inputs", ())],
        facts=_facts(run),
        maps=len(run.score_maps),
        metrics=explained([*whole, *first]),
        **common_words(),
    )  # fmt: skip


def _explains_all(row: Result) -> bool:
    return row.product == "attribution" and row.subject == "all" and row.metric == "reduced_chi_square"


def index_page(runs: Sequence[RunReport], folders: Mapping[str, str]) -> str:
    """The page of several campaigns; ``folders`` maps a campaign to its folder beside the page.

    Collected imagery and simulated collections have a verdict each: agreement of the latter tests the software.
    """
    verdicts = []
    for kind, simulated in (("Collected imagery", False), ("Simulated collections", True)):
        own = [row for run in runs if run.simulated == simulated for row in run.table]
        if any(run.simulated == simulated for run in runs):
            verdicts.append((kind, *v.verdict(own), v.status_words(own)))
    entries = []
    for run in sorted(runs, key=lambda r: r.simulated):
        own_tone, own_words = v.verdict(run.table)
        link = f"{folders[run.campaign]}/report.html"
        entries.append({"run": run, "tone": own_tone, "verdict": own_words, "link": link,
                        "counts": status_counts(run.table)})  # fmt: skip
    rows = [row for run in runs for row in run.table]
    failed = [r for r in rows if r.status in (Status.FAIL, Status.ERROR)]
    others = []
    for run in sorted(runs, key=lambda r: r.simulated):
        skipped = [r for r in run.table if r.status is Status.SKIPPED and not v.is_per_band(r)]
        telling = [r for r in run.table if v.informs_of_disagreement(r) and not v.is_per_band(r)]
        if skipped or telling:
            shown = [*telling, *skipped[:_MOST_SKIPPED]]
            others.append((run, len(telling), len(skipped), shown, max(len(skipped) - _MOST_SKIPPED, 0)))
    single = [r for r in sorted(failed, key=_severity) if not v.is_per_band(r)]
    return environment().get_template("index.html.j2").render(
        verdicts=verdicts, entries=entries, failed=single, others=others,
        failed_by_subject=_grouped([r for r in failed if v.is_per_band(r)]),
        simulated=[r.campaign for r in runs if r.simulated], **common_words(),
    )  # fmt: skip


def environment() -> jinja2.Environment:
    """The templates, strict and escaped, with the filters of rows."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("hyperval.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters.update(
        metric=_metric_markup,
        value=v.value_text,
        interval=v.interval_text,
        threshold=v.threshold_text,
        row_name=row_name,
        nm=_band_text,
        breakable=_breakable,
        subject=_subject_text,
    )
    return environment


def common_words() -> dict[str, Any]:
    """What every page says: version, when it was made, how much is listed."""
    return {
        "version": hyperval.__version__,
        "generated": _generated(),
        "most_listed": _MOST_LISTED,
        "most_rows": _MOST_ROWS,
    }


def _generated() -> str | None:
    """When SOURCE_DATE_EPOCH says the page was made; None when it is not set."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    if not epoch.isdigit():
        return None
    return datetime.datetime.fromtimestamp(int(epoch), datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")


def _severity(row: Result) -> int:
    order = (Status.FAIL, Status.ERROR, Status.PASS, Status.SKIPPED, Status.INFO)
    return order.index(row.status)


def _band_text(row: Result) -> str:
    return f"{row.band_nm:.1f} nm" if v.is_per_band(row) else ""


def _undone(rows: Sequence[Result]) -> list[tuple[str, str, str, list[str]]]:
    """Rows that were planned and not made, those of one status, product and reason together with their names."""
    groups: dict[tuple[str, str, str], list[str]] = {}
    for row in rows:
        if row.status in (Status.SKIPPED, Status.ERROR):
            key = (str(row.status), row.product, row.reason or "no reason given")
            groups.setdefault(key, []).append(row_name(row))
    return [(*key, names) for key, names in groups.items()]


def _breakable(text: str) -> Markup:
    """A dotted name with places where it may break."""
    return Markup(".<wbr>").join(Markup("_<wbr>").join(part.split("_")) for part in text.split("."))


def _metric_markup(row: Result) -> Markup:
    """The metric's name with places where a long one may break; what follows "@" stays together."""
    base, at, where = row.metric.partition("@")
    name = Markup("_<wbr>").join(base.split("_"))  # join escapes the parts
    return name + (Markup('<wbr><span class="together">{}</span>').format(at + where) if at else "")


def _subject_text(row: Result) -> str:
    """The subject, a number kept beside its unit: "3 m"."""
    return re.sub(r"(?<=\d) (?=(m|nm|km|%)\b)", "\u00a0", row.subject)


def _grouped(rows: Sequence[Result]) -> list[tuple[str, list[Result]]]:
    """Rows about single bands by what they are about, each group in one table."""
    groups: dict[str, list[Result]] = {}
    for row in rows:
        what = " ".join(p for p in (row.campaign, row.product, row.subject, row.method, row.metric) if p)
        groups.setdefault(what, []).append(row)
    return list(groups.items())


def _sections(run: RunReport, drawings: Sequence[Drawing], rows: Sequence[Result]) -> list[Section]:
    names = [*_SECTIONS, *dict.fromkeys(row.product for row in rows if row.product not in _SECTIONS)]
    embedded, sections = _embedded(drawings), []
    for name in names:
        figures = [
            {"drawing": d, "source": embedded.get(d.name), "from": _under_figure(run, name)}
            for d in drawings
            if d.section == name
        ]
        own = [row for row in rows if row.product == name]
        if figures or own:
            sections.append(Section(_SECTIONS.get(name, name), figures, own))
    return sections


def _embedded(drawings: Sequence[Drawing]) -> dict[str, str]:
    """Name of a figure -> its data URI, for as many as the page has room for; score maps come last."""
    sources, room = {}, _FIGURE_BYTES
    for drawing in sorted(drawings, key=lambda d: d.name.startswith("score-map")):
        source = f"data:{_MEDIA[drawing.kind]};base64,{base64.b64encode(drawing.content).decode('ascii')}"
        if len(source) <= room:
            room -= len(source)
            sources[drawing.name] = source
    return sources


def _under_figure(run: RunReport, product: str) -> str:
    """Inputs, their licence, version and seed of a figure, in one line."""
    inputs = [
        _input(item)
        for item in run.provenance.get("inputs", ())
        if not item.get("products") or product in item["products"]
    ]
    told = [i["reference"] + (f" ({i['licence']})" if i["licence"] else "") for i in inputs[:_INPUTS_UNDER_FIGURE]]
    if len(inputs) > _INPUTS_UNDER_FIGURE:
        told.append(f"{len(inputs) - _INPUTS_UNDER_FIGURE} more in the provenance table")
    parts = [f"Inputs: {'; '.join(told)}" if told else "Inputs: none recorded"]
    cited = list(dict.fromkeys(i["citation"] for i in inputs if i["citation"]))
    if cited:
        parts.append("; ".join(cited[:2]) + ("; …" if len(cited) > 2 else ""))
    parts.append(f"hyperval {hyperval.__version__}")
    parts += [f"{k} {run.provenance[k]}" for k in ("formulation", "seed") if run.provenance.get(k) is not None]
    return ". ".join(part.rstrip(".") for part in parts) + "."


def _input(item: Mapping[str, Any]) -> dict[str, str]:
    return {key: str(item.get(key) or "") for key in ("reference", "sha256", "licence", "citation")}


def _facts(run: RunReport) -> list[tuple[str, str]]:
    """Everything in the provenance but the inputs, nested keys joined by dots."""
    facts: list[tuple[str, str]] = []

    def walk(prefix: str, value: Any) -> None:
        if isinstance(value, Mapping):
            for key, item in value.items():
                walk(f"{prefix}.{key}" if prefix else str(key), item)
        elif isinstance(value, list | tuple):
            facts.append((prefix, ", ".join(str(item) for item in value)))
        else:
            facts.append((prefix, str(value)))

    walk("", {key: value for key, value in run.provenance.items() if key != "inputs"})
    for name, side in (("predicted", run.prediction), ("observed", run.observation)):
        if side is not None:
            walk(name, side.provenance)
    return facts


def _all_notes(run: RunReport) -> list[str]:
    notes = list(run.notes)
    for name, side in (("Prediction", run.prediction), ("Observation", run.observation)):
        if side is not None:
            notes += [f"{name}: {note}" for note in side.notes if note not in run.notes]
    return list(dict.fromkeys(notes))
