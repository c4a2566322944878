"""A folder of results, written and read: the only code that knows the names of its files.

============================  =====================================================================================
``results.csv, .json``        the table: a row for each comparison; ``summary.csv`` has the planned ones alone
``junit.xml``                 a test case for each acceptance criterion and each error
``products.nc``               what both sides hold, by one codec over the fields of their dataclasses
``provenance.json``           inputs with SHA-256, versions, command, seed
``figures/``, ``scores/``     pictures; score maps as GeoTIFF
``report.html``               the page
============================  =====================================================================================

The folder of several campaigns has a folder for each.  Its tables are joined from theirs, text by text, and its
``results.json`` names them, so that neither writing nor opening it needs more memory than its largest campaign and
the text of ``MAX_JOINED`` rows.

Numbers are written as their shortest exact representation, and the same run gives the same bytes.

``products.nc`` has a group for each side (``predicted``, ``observed``) and in its root the spectra of all of them, by
side and subject.  Every entry of a product is named by coordinates (``roc_subject``, ``roc_detector``, ...); arrays of
unequal length are filled up with NaN.  Numbers are float64; covariances are float32 (24 bits of mantissa) and
compressed, since they are most of the file, and their diagonals come back from the standard uncertainties.  The
covariance between bands of an SNR is left out.  A predicted score of objects is a law: the file has its quantiles,
and read back it is a thousand values evenly spread between the outermost of these.
"""

from __future__ import annotations

import csv
import fnmatch
import io
import json
import math
import re
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from functools import cache, cached_property
from itertools import chain, count
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple
from xml.etree import ElementTree

import h5netcdf
import h5py
import numpy as np
import numpy.typing as npt

import hyperval
import hyperval.products as product_types
from hyperval.data import Mask
from hyperval.errors import WARNING, UsageError, package_table, reader, refusal, refuse
from hyperval.hdf5 import check_hdf5
from hyperval.metrics import Evidence
from hyperval.products import SPECTRA, ObjectScores, ObservedProducts, PredictedProducts, Products
from hyperval.results import COLUMNS, Cause, Outcome, Result, ResultTable, Role, grouped, row_name
from hyperval.spectra.axis import SpectralAxis
from hyperval.storage import content_of, write_text

SIDES = {"predicted": PredictedProducts, "observed": ObservedProducts}
SCHEMA_VERSION = 4
SECONDS_PER_YEAR = 365.2425 * 86400.0
MAX_BYTES = 500_000_000  # of a table that is read
MAX_JOINED = 200_000  # rows that the results.json of several campaigns repeats
TABLE, PRODUCTS, PROVENANCE, PAGE, JUNIT, CSV = (
    "results.json", "products.nc", "provenance.json", "report.html", "junit.xml", "results.csv",
)  # fmt: skip


@dataclass(frozen=True)
class ExpectedScores:
    """The score that the model expects of each pixel of which the collection says what lies there.

    Attributes
    ----------
    content : (lines, samples) number of what lies there, -1 where that is not known; maps of one scene share it
    scores : (K + 1,) of each number [1]; the last, which -1 finds, is NaN
    """

    content: npt.NDArray[np.int16]
    scores: npt.NDArray[np.float32]

    def of(self, part: tuple[slice, slice]) -> npt.NDArray[np.float32]:
        """Some lines and samples as a map [1]; NaN where nothing is expected."""
        return self.scores[self.content[part]]


@dataclass(frozen=True)
class ScoreMap:
    """A detector's score for every pixel.

    Attributes
    ----------
    values : (lines, samples) score [1]; NaN where there is none
    transform : affine pixel-to-map transform (six numbers a, b, c, d, e, f, or an object that yields them
        first), None for an image without georeference
    crs : coordinate reference system as text (EPSG:32618 or WKT), None when unknown
    outlines : name of a target -> (lines, samples) mask of its pixels
    pixel_size_m : ground sampling distance for the scale [m], None when unknown
    expected : what the model expects in its place, None where it says nothing
    influence : predicted over measured P_FA without the part of the image that each pixel lies in (lines, samples),
        above which score a pixel is an alarm, and this in words; None without a law of these pixels
    """

    values: npt.NDArray[Any]
    transform: Sequence[float] | None = None
    crs: str | None = None
    outlines: Mapping[str, Mask] = field(default_factory=dict)
    pixel_size_m: float | None = None
    expected: ExpectedScores | None = None
    influence: tuple[npt.NDArray[Any], float, str] | None = None

    def to_xarray(self) -> Any:
        """As an array of xarray (line, sample) with its position."""
        from hyperval.imagery import map_to_xarray

        return map_to_xarray(self.values, self.transform, self.crs, "score")

    def to_spy(self) -> Any:
        """As an image of SPy with one band."""
        from hyperval.imagery import map_to_spy

        return map_to_spy(self.values, "score")


@dataclass(frozen=True)
class Quicklook:
    """A picture of the scene with its regions of interest.

    Attributes
    ----------
    rgb : (lines, samples, 3) uint8
    regions : name -> (lines, samples) mask
    bands : which ones are red, green and blue, in words
    pixel_size_m : ground sampling distance for the scale [m], None when unknown
    """

    rgb: npt.NDArray[np.uint8]
    regions: Mapping[str, Mask] = field(default_factory=dict)
    bands: str = ""
    pixel_size_m: float | None = None


@dataclass(frozen=True)
class Run:
    """The contents of a folder of results, and of its page.

    Attributes
    ----------
    table : every row
    provenance : ``inputs`` is a list of mappings with the keys reference, sha256, licence, citation; the other keys
        (versions, command, seed, formulation, ...) are shown as they are; empty for what joins several runs
    products : name of a side -> its products, of a run that is to be written
    campaign, title, description : name (also of the output folder), heading, a sentence or two
    simulated : True when the collection is simulated; every page, figure and file then says so
    group : its heading on an index page; empty: that of collected or of simulated imagery
    score_maps : "TARGET-DETECTOR" -> map
    quicklook : picture of the scene
    notes : assumptions made, what was left out
    references : literature
    chosen_after : (what, as it was before) of each range that was set after its data were seen
    deciding : inconclusive criteria, and what would decide each
    power : which injected errors the criteria detect (:class:`hyperval.campaign.PowerTable`), and why that is not of
        the present run (empty where it is); None where that was not worked out
    remedy : how to get the collection of a run that was skipped for lack of it
    kind : what the page is: "Campaign" for both sides compared, else what it shows
    sentence : first on a page that compares something else than a model with a collection
    folder : where it was read, None for one that is to be written
    """

    table: ResultTable
    provenance: Mapping[str, Any] = field(default_factory=dict)
    products: Mapping[str, Products | None] = field(default_factory=dict)
    title: str = ""
    simulated: bool = False
    campaign: str = ""
    description: str = ""
    group: str = ""
    score_maps: Mapping[str, ScoreMap] = field(default_factory=dict)
    quicklook: Quicklook | None = None
    notes: Sequence[str] = ()
    references: Sequence[str] = ()
    chosen_after: Sequence[tuple[str, str]] = ()
    deciding: Sequence[tuple[Result, str]] = ()
    power: tuple[Any, str] | None = None
    remedy: str = ""
    kind: str = "Campaign"
    sentence: str = ""
    folder: Path | None = None

    @classmethod
    def open(cls, folder: Path) -> Run:
        """The run that a command wrote into a folder; products are read on access.

        Raises
        ------
        InputError : no results.json, or one that is not of this kind.
        """
        return cls(ResultTable(read_rows(Path(folder))), provenance_of(folder), folder=Path(folder))

    @cached_property
    def sides(self) -> Mapping[str, Products]:
        """Name of a side -> its products; InputError for a damaged file, empty where there is none."""
        stored = self.folder is not None and (self.folder / PRODUCTS).is_file() and read_products(self.folder)
        products = stored.products if stored else self.products
        return {name: side for name, side in products.items() if side is not None}

    @property
    def pair(self) -> tuple[PredictedProducts | None, ObservedProducts | None]:
        """The prediction and the observation; None for one that was not made."""
        return self.sides.get("predicted"), self.sides.get("observed")  # type: ignore[return-value]

    @property
    def warnings(self) -> list[str]:
        """The notes that are warnings."""
        return [note for note in self.notes if note.startswith(WARNING)]

    @property
    def figures(self) -> dict[str, Path]:
        """Name of a file in ``figures/`` -> its path."""
        found = sorted((self.folder / "figures").glob("*.*")) if self.folder else []
        return {path.name: path for path in found if path.suffix in (".svg", ".png")}

    @property
    def times(self) -> set[datetime]:
        """Times of its scenarios, in UTC."""
        records = [r for r in dict(self.provenance.get("engines") or {}).values() if isinstance(r, dict)]
        texts = {str(record["time_utc"]) for record in records if record.get("time_utc")}
        parsed = (datetime.fromisoformat(text) for text in texts)
        return {t.replace(tzinfo=UTC) if t.tzinfo is None else t.astimezone(UTC) for t in parsed}

    def write(self, folder: Path, page: str, drawings: Iterable[Any] = ()) -> None:
        """Write the run into an existing folder.

        Parameters
        ----------
        page : HTML
        drawings : figures as files (:class:`hyperval.figures.Drawing`)
        """
        folder = Path(folder)
        write_table(self.table, folder)
        if self.products:
            write_products(folder, self.sides, title=self.title, simulated=self.simulated)
        stems = file_stems(self.score_maps)
        for name, score_map in self.score_maps.items():
            (folder / "scores").mkdir(exist_ok=True)
            _write_score_map(folder / "scores" / f"{stems[name]}.tif", name, score_map)
        if self.provenance:
            record = json.dumps(json_value(dict(self.provenance)), indent=1, ensure_ascii=False)
            write_text(folder / PROVENANCE, record + "\n")
            (folder / "figures").mkdir(exist_ok=True)
        for one in drawings:
            (folder / "figures" / one.file_name).write_bytes(one.content)
        write_text(folder / PAGE, page)


def is_run(folder: Path) -> bool:
    """Whether a folder holds results."""
    return (Path(folder) / TABLE).is_file()


def provenance_of(folder: Path) -> dict[str, Any]:
    """Where the results of a folder came from; empty where they join several runs."""
    path = Path(folder) / PROVENANCE
    return _json(path) if path.is_file() else {}


def runs_in(folders: Iterable[Path]) -> list[Path]:
    """The folders of single runs: those named, or where one joins several campaigns those inside it.

    Raises
    ------
    InputError : a folder without results.

    Examples
    --------
    What a run that was killed has left in a folder is none.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     for name in (TABLE, f".hyperval-new-1/{PROVENANCE}"):
    ...         (Path(folder) / name).parent.mkdir(exist_ok=True)
    ...         _ = (Path(folder) / name).write_text("{}")
    ...     runs_in([Path(folder)]) == [Path(folder)]
    True
    """
    out: list[Path] = []
    for folder in map(Path, folders):
        inside = sorted(path.parent for path in folder.glob(f"[!.]*/{PROVENANCE}"))
        refuse(not inside and not is_run(folder), "results.none", folder)
        out += inside or [folder]
    return out


def days_of(folders: Sequence[Path], **asked: str) -> list[tuple[datetime, Result]]:
    """A row of every run in the folders, by the time of its scenario; skipped ones are left out.

    ``asked`` : what names the row: its product, subject and metric, and its method where there are several

    Raises
    ------
    InputError : a folder without results.
    UsageError : a run with several times, or no such row, or several, such as of single bands.
    """
    days = []
    for run in map(Run.open, runs_in(folders)):
        rows = [row for row in run.table.where(**asked) if not math.isnan(row.value)]
        refuse(rows and len(run.times) != 1, "results.times", run.folder, count=len(run.times))
        days += [(when, row) for when in run.times for row in rows]
    refuse(not days, "results.row", row=", ".join(asked.values()))
    several = sorted({row.key for _, row in days})
    refuse(len(several) > 1, "results.several", count=len(several), rows="; ".join(several[:3]))
    return sorted(days, key=lambda day: day[0])


def file_stems(names: Iterable[str]) -> dict[str, str]:
    """A distinct, harmless file name for each name: letters, digits, dot, minus and underscore."""
    stems: dict[str, str] = {}
    for name in names:
        stem = re.sub(r"[^A-Za-z0-9._-]+", "_", name).lstrip(".")[:100] or "_"
        candidates = chain([stem], (f"{stem}_{number}" for number in count(2)))
        taken = {other.lower() for other in stems.values()}
        stems[name] = next(one for one in candidates if one.lower() not in taken)
    return stems


def _write_score_map(path: Path, name: str, score_map: ScoreMap) -> None:
    """Write one map as float32 GeoTIFF; NaN is nodata; georeferenced where the map knows its transform."""
    import rasterio  # 20 MB, which runs without score maps do not need
    from affine import Affine
    from rasterio.errors import NotGeoreferencedWarning

    values = np.asarray(score_map.values, dtype=np.float32)
    transform = None if score_map.transform is None else Affine(*map(float, list(score_map.transform)[:6]))
    # A map in image geometry is a legitimate product.
    quiet = warnings.catch_warnings(action="ignore", category=NotGeoreferencedWarning)
    with quiet, rasterio.open(
        path, "w", driver="GTiff", height=values.shape[0], width=values.shape[1], count=1, dtype="float32",
        nodata=math.nan, compress="deflate", predictor=3, transform=transform, crs=score_map.crs or None,
    ) as out:  # fmt: skip
        out.write(values, 1)
        out.set_band_description(1, f"{name} score [1]")


# The table ------------------------------------------------------------------------------------------------------------

_values = attrgetter(*COLUMNS)
# What XML 1.0 cannot hold at all, not even escaped.
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_READABLE = (2, 3, SCHEMA_VERSION)  # the second version repeated the names of the columns in each row
_ROWS = ' "rows": [\n'  # the last line before the rows of a table
_COLUMN_NAMES = set(COLUMNS)
_OLD = set(COLUMNS[: COLUMNS.index("effect")])  # in every version
# What the values of a column are read by, by the type of the field; rows repeat their words, which are kept once.
_READ: dict[str, Callable[[Any], Any]] = {
    "str": sys.intern, "float": lambda value: math.nan if value is None else float(value), "Role": Role,
    "Evidence | None": Evidence, "Outcome": Outcome, "Cause": Cause,
}  # fmt: skip
_READ_COLUMN = {f.name: _READ.get(str(f.type), lambda value: value) for f in fields(Result)}


def write_table(table: Iterable[Result], folder: Path) -> None:
    """Write results.csv, summary.csv (the planned comparisons alone), results.json and junit.xml."""
    rows = list(table)
    write_text(folder / CSV, results_csv(rows))
    write_text(folder / "summary.csv", results_csv(row for row in rows if row.planned))
    write_text(folder / TABLE, results_json(rows))
    write_text(folder / JUNIT, junit_xml(rows))


def write_joined(
    folder: Path, names: Sequence[str], planned: Sequence[Result], page: str, parts: Path | None = None
) -> None:
    """Write the page and the tables of several runs, whose folders come into ``folder`` under these names.

    Parameters
    ----------
    planned : at least their planned rows
    parts : where they stand until then; default: there
    """
    parts = parts or folder
    for name in (CSV, "summary.csv"):
        with open(folder / name, "wb") as out:
            out.write(results_csv([]).encode())
            out.writelines((parts / part / name).read_bytes().partition(b"\n")[2] for part in names)
    counts, lines = Counter[str](), list[str]()
    for name in names:
        head, _, listed = (parts / name / TABLE).read_text("utf-8").partition(_ROWS)
        counts.update(json.loads(head.removesuffix(",\n") + "}" if listed else head)["counts"])
        lines += [listed.removesuffix("\n ]\n}\n")] if listed and counts.total() <= MAX_JOINED else []
    write_text(folder / TABLE, _document(lines if counts.total() <= MAX_JOINED else [], counts, {"runs": list(names)}))
    write_text(folder / JUNIT, junit_xml(planned))
    write_text(folder / PAGE, page)


def results_csv(rows: Iterable[Result]) -> str:
    """The table as CSV: the columns ``results.COLUMNS``, an empty cell for NaN and None."""
    cells = ([harmless(x) if isinstance(x, str) else json_value(x) for x in _values(row)] for row in rows)
    return csv_text(chain([COLUMNS], cells))


def csv_text(rows: Iterable[Iterable[Any]]) -> str:
    """Rows as CSV."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()


def results_json(rows: Iterable[Result]) -> str:
    """The table as JSON: a header, and a list of values a row in the order of ``columns``.

    A line a row; null for NaN, "inf" and "-inf" for infinities.
    """
    rows = list(rows)
    encode = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode  # fast only without indentation
    lines = (f"  {encode([json_value(value) for value in _values(row)])}" for row in rows)
    return _document(lines, Counter(str(row.outcome) for row in rows))


def _document(lines: Iterable[str], counts: Counter[str], more: Mapping[str, Any] = MappingProxyType({})) -> str:
    document = {
        "schema_version": SCHEMA_VERSION, "hyperval_version": hyperval.__version__,
        "counts": {str(outcome): counts[outcome] for outcome in Outcome}, **more, "columns": list(COLUMNS), "rows": [],
    }  # fmt: skip
    head = json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False)
    listed = ",\n".join(lines)
    return head.removesuffix("[]\n}") + f"[\n{listed}\n ]\n}}\n" if listed else head + "\n"


def junit_xml(rows: Sequence[Result]) -> str:
    """One test case for each gate and each error; what disagrees fails, what is undecided counts as skipped.

    >>> gate = Result("b", "roc", "lawn", "cem", "auc", 0.9, role=Role.GATE, outcome=Outcome.DISAGREES)
    >>> text = junit_xml([Result("a", "roc", "lawn", "cem", "auc", 0.9), gate])
    >>> re.findall('testsuite name="(.)" tests="(.)" failures="(.)"', text)  # a campaign without a gate is there too
    [('a', '0', '0'), ('b', '1', '1')]
    """
    cases = [row for row in rows if row.gates or row.outcome is Outcome.ERROR]
    root = ElementTree.Element("testsuites", {"name": "hyperval", **_tally(cases)})
    for campaign, results in grouped(rows, lambda row: row.campaign).items():
        of_campaign = [row for row in results if row.gates or row.outcome is Outcome.ERROR]
        suite = ElementTree.SubElement(root, "testsuite", {"name": campaign, **_tally(of_campaign)})
        for row in of_campaign:
            case = ElementTree.SubElement(suite, "testcase", classname=f"{campaign}.{row.product}", name=row_name(row))
            if element := row.outcome.element:
                undecided = f"inconclusive: {row.cause}; " if row.outcome is Outcome.UNDECIDED else ""
                ElementTree.SubElement(case, element, message=undecided + _reason_of(row))
    ElementTree.indent(root, " ")
    text = _NOT_XML.sub("\ufffd", ElementTree.tostring(root, "unicode"))
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _tally(rows: Iterable[Result]) -> dict[str, str]:
    count = Counter(row.outcome.element for row in rows)
    names = {"failures": "failure", "errors": "error", "skipped": "skipped"}
    return {"tests": str(count.total())} | {name: str(count[element]) for name, element in names.items()}


def _reason_of(row: Result) -> str:
    """The reason of a row, or its numbers where it states none."""
    ends = (("at least", row.limit_low), ("at most", row.limit_high))
    limits = " and ".join(f"{words} {end:.6g}" for words, end in ends if not math.isnan(end))
    numbers = f"{row.metric} = {row.value:.6g} {row.unit}" + (f", accepted {limits}" if limits else "")
    return f"{row.reason} ({numbers})" if row.reason and math.isfinite(row.value) else row.reason or numbers


def json_value(value: Any) -> Any:
    """A value that JSON can hold: NaN becomes null, an infinity its name, anything unknown its text."""
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None if math.isnan(value) else str(value)
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, list | tuple):
        return [json_value(item) for item in value]
    if hasattr(value, "tolist"):  # NumPy scalars and arrays
        return json_value(value.tolist())
    if hasattr(value, "items"):
        return {str(key): json_value(item) for key, item in value.items()}
    return str(value)


def harmless(text: str) -> str:
    """The text of a CSV cell, with an apostrophe before what a spreadsheet would take for a formula.

    A carriage return becomes a line feed: readers of CSV take a bare one for the end of the row.
    """
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    return f"'{text}" if text[:1] in ("=", "+", "-", "@", "\t", "\n") else text


def read_rows(folder: Path, *, every: bool = True) -> Iterator[Result]:
    """The rows of a folder's results.json; of one that joins several campaigns those of each, one after the other.

    ``every``: also the numbers of single bands that nothing was asked of, which are most of a table.

    Raises
    ------
    InputError : no such file, not JSON, or not a results table of this version.
    """
    parts, rows = _table(Path(folder) / TABLE, every)
    for name in parts:
        yield from read_rows(folder / name, every=every)
    yield from rows


@reader
def _table(path: Path, every: bool) -> tuple[list[str], list[Result]]:
    """The folders that hold the rows of a table of several campaigns, and the rows of any other."""
    document = _json(path)
    parts, columns, rows = (document.get(name, []) for name in ("runs", "columns", "rows"))
    lists = all(isinstance(one, list) for one in (parts, columns, rows))
    is_known = document.get("schema_version") in _READABLE and lists and {"columns", "rows"} <= document.keys()
    refuse(not is_known, "results.table", path, version=SCHEMA_VERSION)
    for name in parts:
        refuse(not isinstance(name, str) or Path(name).name != name or name[:1] == ".", "results.part", path, name=name)
    out = []
    for i, item in enumerate([] if "runs" in document else rows, start=1):
        if isinstance(item, list) and len(item) == len(columns):
            item = dict(zip(map(str, columns), item, strict=True))
        if not isinstance(item, dict) or not _OLD <= item.keys() <= _COLUMN_NAMES:
            raise refusal("results.columns", f"{path}, row {i}", columns=", ".join(sorted(_COLUMN_NAMES)))
        if every or item["band_nm"] is None or item["outcome"] != Outcome.NONE:
            try:
                out.append(Result(**{name: _READ_COLUMN[name](value) for name, value in item.items()}))
            except (TypeError, ValueError, UsageError) as error:
                raise refusal("results.values", f"{path}, row {i}", why=error) from error
    return parts, out


def _json(path: Path) -> dict[str, Any]:
    raw = content_of(path, ("results.file", "results.large"), most=MAX_BYTES)
    head, rows, _ = raw.partition(b"\n" + _ROWS.encode())
    try:  # the rows of a table that names its runs are read from the folders of these
        content: dict[str, Any] = json.loads(head + b'"rows": []}' if rows and b'\n "runs": [' in head else raw)
    except (ValueError, RecursionError) as error:
        raise refusal("results.json", path, why=error) from error
    refuse(not isinstance(content, dict), "results.object", path)
    return content


# Products -------------------------------------------------------------------------------------------------------------

Entry = tuple[tuple[str, ...], Any, Mapping[str, Any]]  # axes, values, attributes
Arrays = dict[str, Entry]
_PROBABILITY = "object_score_probability"
_SCALES = ("wavelength", "wavelength_2", _PROBABILITY)


class Column(NamedTuple):
    """A variable of the file, which holds a field of each entry of a product: see ``products.yaml``."""

    name: str
    field: str
    long_name: str
    units: str = "1"
    axes: str = ""


class Layout(NamedTuple):
    """How a product lies in the file: see ``products.yaml``."""

    prefix: str
    kind: type | None
    axis: str
    key: tuple[str, ...]
    columns: tuple[Column, ...]
    inner: Mapping[str, Layout]


@cache
def _layouts() -> dict[str, Layout]:
    return {name: _layout(name, about) for name, about in package_table("products.yaml")["products"].items()}


def _layout(name: str, about: Mapping[str, Any]) -> Layout:
    columns = tuple(Column(variable, **entry) for variable, entry in about["variables"].items())
    inner = {field: _layout(field, entry) for field, entry in about.get("inner", {}).items()}
    kind = getattr(product_types, about["kind"]) if "kind" in about else None
    return Layout(about.get("prefix", name), kind, about["axis"], tuple(about["key"]), columns, inner)


# A predicted object score is a law; its quantiles say what its draws do.
OBJECT_QUANTILES = (0.001, 0.005, 0.01, 0.025, 0.05, *np.round(np.arange(0.1, 0.95, 0.1), 1).tolist(),
                    0.95, 0.975, 0.99, 0.995, 0.999)  # fmt: skip
_LAW_VALUES = 1000


def _is_label(name: str, entry: Entry) -> bool:
    """Whether an array only names the places along an axis."""
    return name in _SCALES or np.asarray(entry[1]).dtype.kind == "O"


def to_xarray(products: Products) -> Any:
    """One side as a dataset of xarray, which takes 80 MB with pandas and is loaded where it is asked for."""
    import xarray as xr

    arrays = to_arrays(products)
    return xr.Dataset(arrays).set_coords([name for name, entry in arrays.items() if _is_label(name, entry)])


def to_arrays(products: Products) -> Arrays:
    """One side as arrays along ``band``, ``band_2``, ``PRODUCT_subject``, ``roc_curve``, ``roc_point``, ..."""
    axis, data = products.axis, _bands(products.axis)
    words = {"units": data["wavelength"][2]["units"], "long_name": "wavelength, second index"}
    data["wavelength_2"] = (("band_2",), axis.centre_nm, words)
    flags = {"flag_values": np.array([0, 1], dtype=np.int8), "flag_meanings": "not_used used"}
    good = {"units": "1", "long_name": "whether the band is used", **flags}
    data["good_band"] = (("band",), axis.good.astype(np.int8), good)
    held = {name: [(_key(key), item) for key, item in getattr(products, name, {}).items()] for name in _layouts()}
    for key, law in products.object_scores.items():
        if np.ndim(law.values) == 2:  # a law
            held["object_score_law"].append((key, np.quantile(law.values, OBJECT_QUANTILES)))
        else:
            held["object_score"] += [((*key, name), value) for name, value in zip(law.names, law.values, strict=True)]
    for name, layout in _layouts().items():
        _add(data, layout, held[name])
    if held["object_score_law"]:
        words = {"units": "1", "long_name": "probability of a lower score"}
        data[_PROBABILITY] = ((_PROBABILITY,), np.array(OBJECT_QUANTILES), words)
    return data


def _bands(axis: SpectralAxis) -> Arrays:
    words = {"units": "nm", "standard_name": "radiation_wavelength"}
    words = {"units": "1", "long_name": "number of the band"} if axis.numbered else words
    data: Arrays = {"wavelength": (("band",), axis.centre_nm, words)}
    data["fwhm"] = (("band",), axis.fwhm_nm, {"units": "nm", "long_name": "full width at half maximum"})
    return data


def _key(key: Any) -> tuple[str, ...]:
    return (key,) if isinstance(key, str) else tuple(key)


def _add(data: Arrays, layout: Layout, entries: Sequence[tuple[tuple[str, ...], Any]]) -> None:
    if not entries:
        return
    for part, names in zip(layout.key, zip(*(key for key, _ in entries), strict=True), strict=True):
        words = {"long_name": package_table("products.yaml")["parts"][part]}
        data[f"{layout.prefix}_{part}"] = ((layout.axis,), np.array(names, dtype=object), words)
    each: list[tuple[Column, list[Any], dict[str, str]]] = []
    for column in layout.columns:
        values = [item if column.field == "self" else getattr(item, column.field) for _, item in entries]
        if "{}" not in column.name:
            each.append((column, values, {}))
            continue
        for source in sorted(set(chain(*values))):
            name, words = column.name.format(re.sub(r"[^A-Za-z0-9]", "_", source)), source.replace("_", " ")
            named_column = column._replace(name=name, long_name=column.long_name.format(words))
            each.append((named_column, [value.get(source) for value in values], {"source": source}))
    longest = Counter[str]()  # length of each axis
    for column, values, _ in each:
        for value in values:
            longest |= Counter(dict(zip(column.axes.split(), np.shape(value), strict=False)))
    for column, values, more in each:
        _add_column(data, layout.axis, column, values, longest, more)
    for name, inner in layout.inner.items():
        found = []
        for key, item in entries:
            held = getattr(item, name)
            named = held.items() if isinstance(held, Mapping) else (((), one) for one in held)
            found += [((*key, *_key(named_column)), one) for named_column, one in named]
        _add(data, inner, found)


def _add_column(
    data: Arrays, axis: str, column: Column, values: list[Any], longest: Mapping[str, int], more: dict[str, str]
) -> None:
    """Numbers or arrays below each other, NaN where one is None or has ended; nothing where all arrays are None."""
    axes, words = column.axes.split(), {"long_name": column.long_name, **more}
    if not column.units:
        data[column.name] = ((axis,), np.array(values, dtype=object), words)
    elif not axes or any(value is not None for value in values):
        kind, shape = np.float32 if column.name.endswith("_covariance") else float, [longest[one] for one in axes]
        out = np.full((len(values), *shape), np.nan, dtype=kind)
        for row, value in zip(out[..., None], values, strict=True):
            if value is not None:
                row[tuple(slice(n) for n in np.shape(value))] = np.asarray(value)[..., None]
        data[column.name] = ((axis, *axes), out, {"units": column.units, **words})


def write_products(folder: Path, sides: Mapping[str, Products], *, title: str, simulated: bool) -> None:
    """Write ``products.nc`` of the sides that there are into a folder; two writes give the same bytes.

    Of their provenance it has what was measured, such as counts, by which figures name their axes.
    """
    with h5netcdf.File(Path(folder) / PRODUCTS, "w") as file:
        file.attrs.update({
            "Conventions": "CF-1.11", "title": title, "source": f"hyperval {hyperval.__version__}",
            "simulated": "yes" if simulated else "no",
        })  # fmt: skip
        for name, products in sides.items():
            group = file.create_group(name)
            group.attrs.update({key: what for key, what in products.provenance.items() if key == "quantity"})
            _write_group(group, to_arrays(products))
        _write_group(file, _all_spectra(sides))  # last: its axes are not those of the groups


def _all_spectra(sides: Mapping[str, Products]) -> Arrays:
    """The spectra of all sides with their standard uncertainties, NaN where a side has no such subject."""
    each = list(sides.values())
    products = [name for name in SPECTRA if any(getattr(side, name) for side in each)]
    if not products or not all(side.axis.matches(each[0].axis) for side in each):
        return {}
    data = _bands(each[0].axis)
    subjects = list(dict.fromkeys(s for side in each for name in products for s in getattr(side, name)))
    data["side"] = (("side",), np.array(list(sides), dtype=object), {"long_name": "predicted or observed"})
    words = {"long_name": package_table("products.yaml")["parts"]["subject"]}
    data["subject"] = (("subject",), np.array(subjects, dtype=object), words)
    none = np.full(len(each[0].axis), np.nan)
    for name in products:
        for column in (c for c in _layouts()[name].columns if c.field in ("mean", "standard_uncertainty")):
            held = [[getattr(getattr(side, name).get(s), column.field, none) for s in subjects] for side in each]
            words = {"units": column.units, "long_name": column.long_name}
            data[column.name] = (("side", "subject", "band"), np.array(held), words)
    return data


def _write_group(group: Any, data: Arrays) -> None:
    labels = sorted(name for name, entry in data.items() if _is_label(name, entry))
    for name, (axes, values, attributes) in data.items():
        array = np.asarray(values)
        new = {axis: size for axis, size in zip(axes, array.shape, strict=True) if axis not in group.dimensions}
        group.dimensions.update(new)
        options: dict[str, Any] = {"dtype": h5py.string_dtype() if array.dtype.kind == "O" else array.dtype}
        if array.dtype.kind == "f" and name not in labels:
            packed = {"compression": "gzip", "compression_opts": 4, "shuffle": True}
            options |= {"fillvalue": array.dtype.type(np.nan), **(packed if array.dtype == np.float32 else {})}
        variable = group.create_variable(name, axes, data=array, **options)
        variable.attrs.update(attributes)
        labels_along = [label for label in labels if label not in axes and {*data[label][0]} <= {*axes}]
        if name not in labels and labels_along:
            variable.attrs["coordinates"] = " ".join(labels_along)


@reader
def read_products(folder: Path) -> Run:
    """The sides of a run as they were written, and whether its collection is simulated; without its table.

    Raises
    ------
    InputError : no products.nc, or one that is damaged or not of this kind.
    """
    path = Path(folder) / PRODUCTS
    refuse(not path.is_file(), "products.file", path)
    check_hdf5(path)
    try:
        with h5netcdf.File(path, "r", decode_vlen_strings=True) as file:
            sides = {name: _products(group, SIDES.get(name, PredictedProducts)) for name, group in file.groups.items()}
            return Run(ResultTable(), products=sides, simulated=bool(file.attrs.get("simulated") == "yes"))
    except KeyError as error:
        raise refusal("products.version", path, version=hyperval.__version__) from error
    except (OSError, ValueError, RuntimeError) as error:
        raise refusal("products.damaged", path, why=error) from error


def _products(group: Any, kind: type[Products]) -> Products:
    centre, fwhm, good = (group[name][...] for name in ("wavelength", "fwhm", "good_band"))
    axis = SpectralAxis(centre, fwhm, good.astype(bool))
    held = {name: entries for name, layout in _layouts().items() if (entries := _entries(group, layout))}
    scores: dict[Any, ObjectScores] = {}
    for key, quantiles in held.pop("object_score_law", []):
        probability = (np.arange(_LAW_VALUES) + 0.5) / _LAW_VALUES
        scores[key] = ObjectScores(np.interp(probability, group[_PROBABILITY][...], quantiles)[None])
    for (*target, name), value in held.pop("object_score", []):
        one = scores.get(tuple(target), ObjectScores(np.empty(0)))
        scores[tuple(target)] = ObjectScores(np.append(one.values, value), (*one.names, name))
    content: dict[str, Any] = {
        name: {key[0] if len(key) == 1 else key: item for key, item in entries} for name, entries in held.items()
    }
    return kind(axis=axis, **content, object_scores=scores, provenance=dict(group.attrs))


def _entries(group: Any, layout: Layout) -> list[tuple[tuple[str, ...], Any]]:
    """Key and entry of each that a group holds of a product."""
    if f"{layout.prefix}_{layout.key[0]}" not in group:
        return []
    keys = list(zip(*(group[f"{layout.prefix}_{part}"][...] for part in layout.key), strict=True))
    items: list[dict[str, Any]] = [{} for _ in keys]
    for column in layout.columns:
        for name in fnmatch.filter(group.variables, column.name.format("*")):
            variable = group[name]
            for item, value in zip(items, variable[...], strict=True):
                if "{}" not in column.name:
                    item[column.field] = value
                elif not np.isnan(value).all():
                    item.setdefault(column.field, {})[str(variable.attrs["source"])] = value
    # Cut off what fills arrays of one length up to the longest of their kind.
    for axes in {column.axes for column in layout.columns if column.axes and "band" not in column.axes}:
        names = [column.field for column in layout.columns if column.axes == axes]
        for item in items:
            arrays = {name: item[name] for name in names if name in item}
            filled = np.flatnonzero(np.any(~np.isnan(list(arrays.values())), axis=0))
            item.update({name: values[: filled.max(initial=-1) + 1] for name, values in arrays.items()})
    by_key = dict(zip(keys, items, strict=True))
    for name, inner in layout.inner.items():
        for key, entry in _entries(group, inner):
            item, inner_key = by_key[key[: len(layout.key)]], key[len(layout.key) :]
            item[name] = {**item.get(name, {}), inner_key[0]: entry} if inner_key else (*item.get(name, ()), entry)
    return [(key, _made(layout.kind, key, item)) for key, item in zip(keys, items, strict=True)]


_TYPES = {"int": int, "bool": bool, "Counts": np.int64}  # of the values of a field, where they are not float


def _made(kind: type | None, key: tuple[str, ...], item: dict[str, Any]) -> Any:
    """The entry of these fields; NaN is None where a field may be None, and a whole number where it is one."""
    if kind is None:
        return item["self"]
    if kind is product_types.SpectralEstimate:
        variance = item.pop("standard_uncertainty") ** 2
        covariance = np.array(item.get("error_covariance", np.diag(variance)), dtype=float)
        np.fill_diagonal(covariance, variance)
        item["error_covariance"] = covariance
        if (errors := item.get("spread_errors")) is not None:
            item["spread_errors"] = errors[:, ~np.isnan(errors).all(axis=(0, 2))]
    if kind is product_types.RocCurve:
        item["unit"] = "pixel" if key[2] == "pixel" else "object"
    for name, hint in ((f.name, str(f.type)) for f in fields(kind) if f.name in item):
        value, number = item[name], _TYPES.get(hint.partition(" ")[0], float)
        if isinstance(value, np.ndarray | np.floating):
            is_none = "None" in hint and np.isnan(value).all()
            item[name] = None if is_none else np.array(value, dtype=number) if value.ndim else number(value)
    return kind(**item)
