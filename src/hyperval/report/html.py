"""``report.html``: one page that a reader understands in half a minute, with nothing loaded from elsewhere.

Its first screen is the matrix of product by subject, or product by campaign, each cell with its outcome.
"""

from __future__ import annotations

import functools
import gzip
import hashlib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jinja2

import hyperval
from hyperval.errors import WARNING, refuse
from hyperval.figures.catalogue import SPECTRA, first_figures, further_figures, many_objects_figure
from hyperval.figures.rows import campaigns_figure, criteria_figure, outcome_words
from hyperval.figures.spec import Drawing, Figure, Kind, figure_json, to_base64
from hyperval.metrics import Evidence, explained, plain_words, product_words
from hyperval.products import background_of
from hyperval.report import verdict as v
from hyperval.results import WORST_FIRST, Outcome, Result, ResultTable, grouped, row_name
from hyperval.run import Run, is_run, provenance_of, read_products
from hyperval.storage import installed_file, stated_time, whole_folder

# Packages and files: the library, what unpacks it and draws the figures, and the script of every page, which sorts and
# filters tables and links to evidence.
LIBRARY = tuple(("bokeh", "server", "static", "js", name) for name in ("bokeh.min.js", "bokeh-api.min.js"))
CHARTS = ("hyperval.figures", "charts.js")
_EVERY_PAGE = ("hyperval.report", "templates", "page.js")


def script(place: tuple[str, ...]) -> bytes:
    """A script of an installed package."""
    return installed_file(*place).read_bytes()


@functools.cache
def library_scripts() -> tuple[str, ...]:
    """The library's scripts as base64 of gzip: 0.6 MB in place of 1.4 leave the figures room."""
    return tuple(to_base64(gzip.compress(script(place), mtime=0)) for place in LIBRARY)


@functools.cache
def page_hashes(figures: bool = True) -> str:
    """The scripts of a page, with figures or without, as sources of its policy: these texts, and no other, may run."""
    places = (*LIBRARY, CHARTS, _EVERY_PAGE) if figures else (_EVERY_PAGE,)
    return " ".join(f"'sha256-{to_base64(hashlib.sha256(script(place)).digest())}'" for place in places)


def anchor(row: Result) -> str:
    """Where the evidence of a row stands on its page.

    >>> [anchor(Result("", "radiance", subject, "6S", "bias_ratio")) for subject in ("dry lawn, cut", "草", "木")]
    ['e-radiance-dry-lawn-cut', 'e-radiance-草', 'e-radiance-木']
    """
    return re.sub(r"\W+", "-", f"e-{row.product}-{row.subject}").strip("-")


def build_matrix(
    planned: Sequence[Result], line_of: Callable[[Result], str], link_of: Callable[[str, Sequence[Result]], str]
) -> dict[str, Sequence[Any]]:
    """Planned rows in lines by ``line_of`` and columns by product.

    Lines with criteria come first, the worst of them first, then informational ones; each has its name, its link, and
    a cell for each column.

    Parameters
    ----------
    link_of : (line, rows of the cell) -> where the cell links to; of a whole line (line, [])
    """
    products = dict.fromkeys(row.product for row in planned)
    columns = [product for product in dict.fromkeys([*_COMPARED, *products]) if product in products]

    def rank(item: tuple[str, list[Result]]) -> tuple[bool, int]:
        gates = [row for row in item[1] if row.gates]
        return not gates, WORST_FIRST.index(v.worst_outcome(gates or item[1]))

    lines = []
    for name, line in sorted(grouped(planned, line_of).items(), key=rank):
        by_product = ([row for row in line if row.product == product] for product in columns)
        lines.append((name, link_of(name, []), [_cell(rows, link_of(name, rows)) for rows in by_product]))
    return {"columns": [_COMPARED.get(p, p) for p in columns], "lines": lines}


def _matrices(run: Run, rows: Sequence[Result], *options: Callable[..., str]) -> list[tuple[str, Mapping[str, Any]]]:
    """The matrices of rows by what moves them, each with its heading, as a page of ``run`` parts them."""
    parts = _NUMBERS if run.sentence else _MATRICES
    compared = [row for row in rows if row.planned and row.product not in _REASONS]
    planned = ((title, [r for r in compared if r.evidence in kinds]) for title, kinds in parts)
    return [(title, build_matrix(some, *options)) for title, some in planned if some]


def _cell(rows: Sequence[Result], link: str) -> dict[str, str]:
    """The worst outcome of criteria, or of what is informational where there is none; how many rows have each.

    The letter is a capital of criteria, small of what is informational, "M n" where the criteria are met and something
    informational is not; empty where nothing was planned.
    """
    gates = [row for row in rows if row.gates or row.outcome is Outcome.ERROR]
    outcome = v.worst_outcome(gates or rows)
    letter = outcome.letter if gates else outcome.letter.lower()
    parts = [f"criteria: {outcome_words(gates)}"] if gates else []
    informing = [row for row in rows if not row.gates and row.outcome is not Outcome.ERROR]
    if gates and outcome is not Outcome.DISAGREES and v.worst_outcome(informing) is Outcome.DISAGREES:
        letter += f" {Outcome.DISAGREES.letter.lower()}"  # what decides does not, something else does
    parts += [f"informational: {outcome_words(informing)}"] if informing else []
    words = "; ".join(parts) or "not planned"
    return {"outcome": outcome, "letter": letter, "words": words, "link": link if rows else ""}


def merge_backgrounds(rows: Sequence[Result]) -> list[Result]:
    """Rows about the background seen by one filter, which every size of a target has, as one row for all of them.

    They are equal but for the subject; the first stands for all, with their number.
    """

    groups = grouped(rows, lambda r: repr(replace(r, subject="")) if r.subject.endswith(background_of("")) else id(r))
    return [
        first if not more else replace(first, subject=f"{first.subject} and {len(more)} alike")
        for first, *more in groups.values()
    ]


_FIGURE_BYTES = 2_350_000  # of a page, for figures and the script that draws these; pictures beyond it are linked
# Of a run, beside each other, before everything else, embedded whatever happens.
PICTURES = ("scene", "score-map-1", "score-map-1-expected")
_BUDGET = "radiance-budget"
_MAX_OPEN_FIGURES = 2  # of spectra, curves and scores of objects; the others are folded in their sections

# Products in the order of a page.
_PRODUCTS = (*SPECTRA, "covariance", "classification", "scores", "roc", "abundance")
_COMPARED = {name: product_words(name).capitalize() for name in _PRODUCTS}
_REASONS = {"attribution": "Why they differ", "what-if": "What-ifs", "sensitivity": "Sensitivity to the inputs"}
SECTIONS = _COMPARED | _REASONS
# Gates that the model moves stand apart from checks that it does not.
_MATRICES = (("Model and collection", (Evidence.MODEL,)), ("Checks of the pipeline", (Evidence.PIPELINE,)))
_NUMBERS = (("Numbers", tuple(Evidence)),)  # beside the accepted ones


def report_page(run: Run, drawings: Sequence[Drawing]) -> str:
    """The page of one campaign, scenario or collection."""
    rows, sides = list(run.table), run.pair

    def rank(chart: Figure) -> tuple[int, ...]:
        """Products whose gates say worse come before the others; of one rank, by informational comparisons."""
        planned = _made_rows(rows, chart.section)
        return tuple(WORST_FIRST.index(v.worst_outcome(some)) for some in ([r for r in planned if r.gates], planned))

    spectra = sorted(first_figures(sides, run.table), key=rank)
    many = many_objects_figure(run.score_maps, sides)
    first = [*spectra, *filter(None, [many])]
    charts, further = first[:_MAX_OPEN_FIGURES], first[_MAX_OPEN_FIGURES:]
    plots = further_figures(sides, run.table, equivalence_margin(run.provenance))
    # Of many objects that figure is a map and a histogram in place of a list.
    folded = [*further, *(one for one in plots if many is None or one.name != "object-scores")]
    compares = any(row.planned for row in rows)
    screen = v.first_screen(rows, run.power[0].sentence.partition(". ")[0] + "." if run.power else "")
    forest = criteria_figure(rows) if compares and not run.sentence else None
    worst = _worst_figure(screen.worst, [*spectra, *plots]) if forest and screen.worst else None
    statements = {one.name: figure_json(one) for one in (forest, worst, *charts, *folded) if one is not None}
    shown = merge_backgrounds(rows)
    unmade = (row for row in rows if row.outcome in (Outcome.SKIPPED, Outcome.ERROR))
    undone = grouped(unmade, lambda row: (row.outcome, row.product, row.reason or str(row.cause)))
    # What shows the most comes first: the scene and the first score map.
    images = ((d.name, d.content, d.kind) for d in sorted(drawings, key=lambda d: d.name not in PICTURES))
    return page(
        "report.html.j2", statements,
        run=run,
        screen=screen,
        forest=forest,
        worst=worst,
        compares=compares,
        warned=[f"Warning: {note.removeprefix(WARNING)}" for note in run.warnings],
        matrices=_matrices(run, shown, lambda r: r.subject, _link),
        charts=charts,
        pictures=[d for d in drawings if d.name in PICTURES],
        embedded=embed_images(images, _FIGURE_BYTES - sum(map(len, (*statements.values(), *library_scripts())))),
        budget=[chart for chart in folded if chart.name == _BUDGET],
        parts=_sections(drawings, folded, shown),
        of_reasons=_REASONS,
        undone={key: list(map(row_name, some)) for key, some in undone.items()},
        facts=flatten({k: v for k, v in run.provenance.items() if k != "inputs"}),
        metrics=explained(row.metric for row in rows if row.planned),
    )  # fmt: skip


def _worst_figure(row: Result, figures: Sequence[Figure]) -> Figure | None:
    """What shows the worst criterion, small: the difference of its spectrum, its curve, the scores of its objects.

    >>> from hyperval.figures.spec import Axis, Panels, Part
    >>> views = tuple(Panels(Axis("nm"), (Part(Axis("y"), ()),), name) for name in ("grass 2", "grass (n = 9)"))
    >>> row = Result("", "roc", "grass", "cem", "pd_difference", 0.1, "1")
    >>> _worst_figure(row, [Figure("roc", "roc", "", views)]).views[0].subject
    'grass (n = 9)'
    """
    for figure in figures:
        if figure.section != row.product or any(part.y.names for view in figure.views for part in view.parts):
            continue
        of_subject = [view for view in figure.views if re.match(rf"{re.escape(row.subject)}($|[,:]| \()", view.subject)]
        of_subject = of_subject or (list(figure.views) if row.subject in ("all", "all objects", "*") else [])
        if of_subject:
            parts = of_subject[0].parts[-1:] if figure.section in SPECTRA else of_subject[0].parts[:1]
            title = f"{SECTIONS.get(row.product, row.product)}: {of_subject[0].subject or row.subject}"
            return replace(figure, name="worst", title=title, views=(replace(of_subject[0], parts=parts),), legend="")
    return None


def _link(subject: str, rows: Sequence[Result]) -> str:
    return next((f"#{anchor(row)}" for row in rows if row.outcome is not Outcome.SKIPPED), "#undone" if rows else "")


def index_page(runs: Sequence[Run], folders: Mapping[str, str], title: str = "Validation") -> str:
    """The page of several campaigns; ``folders`` maps a campaign to its folder beside the page.

    Collected imagery, references that were computed and simulated collections stand apart, each in its group:
    agreement with the second compares two programs, with the last it tests the software.  Runs with a ``sentence`` of
    their own are set beside accepted numbers.
    """
    pages = {name: f"{folder}/report.html" for name, folder in folders.items()}

    def link(campaign: str, rows: Sequence[Result]) -> str:
        return pages[campaign] + _link("", rows)

    def heading(run: Run) -> str:
        return run.group or ("Simulated collections" if run.simulated else "Collected imagery")

    groups = []
    for kind, of_kind in sorted(grouped((run for run in runs if not run.remedy), heading).items()):
        together = [row for run in of_kind for row in run.table]
        matrices = _matrices(of_kind[0], merge_backgrounds(together), lambda r: r.campaign, link)
        entries = [(run, v.first_screen(list(run.table)), pages[run.campaign]) for run in of_kind]
        sentence = f"{v.accepted_text(together)} Whether model and collection agree is not asked here."
        groups.append((kind, v.first_screen(together), sentence if of_kind[0].sentence else "", matrices, entries))
    absent = list(grouped(((r, pages[r.campaign]) for r in runs if r.remedy), lambda one: one[0].remedy).items())
    forest = campaigns_figure({run.campaign: list(run.table) for run in runs if not run.sentence})
    return page("index.html.j2", [forest], forest=forest, title=title, groups=groups, absent=absent, count=len(runs))


def strict_templates(package: str) -> jinja2.Environment:
    """The templates of a package, strict and escaped."""
    return jinja2.Environment(
        loader=jinja2.PackageLoader(package, "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


@functools.cache
def environment() -> jinja2.Environment:
    """The templates of reports, with the filters of rows."""
    environment = strict_templates("hyperval.report")
    environment.filters.update(
        value=v.value_text,
        interval=v.interval_text,
        limits=v.limits_text,
        detectable=lambda row: v.number_text(row.detectable) if row.detectable == row.detectable else "",
        about=lambda row: plain_words(row.metric, row.product),
        outcome=lambda word: Outcome(word).word,
        subject=functools.partial(re.sub, r"(?<=\d) (?=(m|nm|km|%)\b)", "\u00a0"),  # a number beside its unit: "3 m"
        anchor=anchor,
    )
    return environment


def equivalence_margin(provenance: Mapping[str, Any]) -> Any:
    """The margin that the campaign of a run states, as its provenance records it; None without any."""
    return provenance.get("configuration", {}).get("campaign", {}).get("equivalence_margin")


def page(template: str, drawn: Iterable[Figure | None] | Mapping[str, str] = (), /, **words: Any) -> str:
    """One page: its template with what every page says, and the figures that it holds with the scripts that draw them.

    ``drawn`` : the figures, or their statements by name, where these are known already
    """
    statements = drawn if isinstance(drawn, Mapping) else {one.name: figure_json(one) for one in drawn if one}
    written = f"{when:%Y-%m-%d %H:%M UTC}" if (when := stated_time()) else None
    return environment().get_template(template).render(
        **words, statements=statements, library=library_scripts() if statements else (),
        starter=script(CHARTS).decode() if statements else "", script_hashes=page_hashes(bool(statements)),
        version=hyperval.__version__, generated=written, page_script=script(_EVERY_PAGE).decode(),
    )  # fmt: skip


def _made_rows(rows: Sequence[Result], product: str) -> list[Result]:
    """Planned rows of a product that were made."""
    return [row for row in rows if row.product == product and row.planned and row.outcome is not Outcome.SKIPPED]


def _sections(drawings: Sequence[Drawing], charts: Sequence[Figure], rows: Sequence[Result]) -> list[dict[str, Any]]:
    """Each product's part of the page: figures, what decides, what does not, what nothing was planned for."""
    sections = []
    for name in dict.fromkeys([*SECTIONS, *(row.product for row in rows)]):
        own_drawings = [d for d in drawings if d.section == name and d.name not in PICTURES]
        planned = sorted(_made_rows(rows, name), key=lambda row: (WORST_FIRST.index(row.outcome), row.subject))
        own_charts = [chart for chart in charts if chart.section == name and chart.name != _BUDGET]
        others = [row for row in rows if row.product == name and not row.planned and not row.per_band]
        if own_drawings or own_charts or planned or others:
            named = {"name": name, "title": SECTIONS.get(name, name), "figures": own_drawings, "charts": own_charts}
            sections.append(named | {"planned": planned, "others": others})
    return sections


def embed_images(images: Iterable[tuple[Any, bytes, str]], room: int) -> dict[Any, str]:
    """Names of images, their bytes and kinds -> data URI of each, for as many as there is room for."""
    sources: dict[Any, str] = {}
    for name, content, kind in images:
        source = f"data:image/{'svg+xml' if kind == 'svg' else kind};base64,{to_base64(content)}"
        if len(source) <= room:
            room -= len(source)
            sources[name] = source
    return sources


def flatten(value: Any, prefix: str = "") -> dict[str, str]:
    """A record as text by key, nested keys joined by dots; lists of records by their references."""
    if isinstance(value, list | tuple) and any(isinstance(item, Mapping) for item in value):
        names = (item.get("reference", n) if isinstance(item, Mapping) else n for n, item in enumerate(value))
        value = dict(zip(map(str, names), value, strict=True))
    if isinstance(value, Mapping):
        return {k: t for key, item in value.items() for k, t in flatten(item, f"{prefix}.{key}".strip(".")).items()}
    return {prefix: ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)}


def run_drawings(run: Path, kind: Kind, journal: bool = False) -> list[Drawing]:
    """The figures that the products and the table of a run allow.

    Raises
    ------
    InputError : no products.nc, or a damaged one.
    UsageError : the folder of a study or a sensor check, or products of which nothing can be drawn.
    """
    from hyperval.figures.print import drawings_of

    kinds = [name for name in ("study", "sensor") if name in provenance_of(run).get("configuration", {})]
    refuse(kinds, "results.drawn", run, kinds=kinds, folder=run / "figures")
    stored, opened = read_products(run), Run.open(run) if is_run(run) else Run(ResultTable())
    figures = [criteria_figure(list(opened.table)), *first_figures(stored.pair)]
    figures += further_figures(stored.pair, opened.table, equivalence_margin(opened.provenance))
    drawn = [one for one in figures if one]
    refuse(not drawn, "results.figures", run)
    return drawings_of(drawn, simulated=stored.simulated, kind=kind, journal=journal)


def figures_to_folder(run: Path, output: Path, kind: Kind, journal: bool) -> int:
    """Write the drawings of a run into a new folder; errors as of :func:`run_drawings`."""
    with whole_folder(output, beside=[run]) as folder:
        for drawing in run_drawings(run, kind, journal):
            (folder / drawing.file_name).write_bytes(drawing.content)
    return 0
