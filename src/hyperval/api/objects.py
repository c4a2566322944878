"""The verbs and what they give: each takes paths or objects, and gives an object with a short ``repr`` and quick looks.

The figures of the reports are drawn by :mod:`hyperval.report`.  Every method takes ``ax``, axes to draw into, and gives
them back.  matplotlib is loaded when something is drawn.
"""

from __future__ import annotations

import html
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import lazy_loader
import numpy as np

import hyperval
from hyperval import baseline, imagery, model, spectra
from hyperval import campaign as campaigns
from hyperval.envi_header import header_beside
from hyperval.errors import UsageError, refuse
from hyperval.figures.catalogue import spectra_labels, wavelength_axis
from hyperval.figures.spec import SOURCES, Axis, Dash, Mark, Panels, Part, single_panel
from hyperval.hdf5 import check_hdf5
from hyperval.metrics import Metric, table
from hyperval.model import Z95, detection_at
from hyperval.products import SPECTRA, ObservedProducts, PredictedProducts, Products
from hyperval.progress import bars
from hyperval.results import ResultTable, of_campaign
from hyperval.run import Run, to_xarray
from hyperval.scenario import Scenario
from hyperval.scenario import load_scenario as load_scenario
from hyperval.storage import whole_folder
from hyperval.units import RADIANCE_UNIT

if TYPE_CHECKING:
    import pandas
    import xarray as xr
    from matplotlib.axes import Axes
else:  # which take a second, when they are used
    pandas, xr = lazy_loader.load("pandas"), lazy_loader.load("xarray")

_DASHES: tuple[Dash, ...] = ("solid", "dashed", "dotted")
_RGB_NM = (660.0, 550.0, 470.0)
_MOST = 40  # rows that a page can hold


def _axes(ax: Axes | None, height_in: float = 4.8) -> Axes:
    from matplotlib import pyplot

    return ax or pyplot.subplots(figsize=(8.0, height_in))[1]


def _draw(view: Panels, ax: Axes | None, height_in: float = 4.8) -> Axes:
    """A stated view in axes, new ones where none are given."""
    from hyperval.figures.print import draw_part, legend_entries

    ax = _axes(ax, height_in)
    draw_part(ax, view, view.parts[0])
    ax.set(xlabel=view.x.label, ylabel=view.parts[0].y.label)
    if any(mark.label for mark in view.parts[0].marks):
        ax.legend(*legend_entries(view), fontsize="small")
    return ax


@dataclass(frozen=True)
class SidesPlot:
    """Spectra and curves of one side or of both, which differ by the style of their lines."""

    tables: _Tables

    def __call__(self, ax: Axes | None = None) -> Axes:
        """Radiance, else reflectance, else ROC curves."""
        products = set(self.tables.spectra["product"])
        product = next((name for name in ("radiance", "reflectance") if name in products), None)
        return self.roc(ax=ax) if product is None else self.spectra(product, ax=ax)

    def spectra(self, product: str = "radiance", ax: Axes | None = None) -> Axes:
        """Mean spectra of ``radiance``, ``reflectance`` or ``snr`` with their 95 % intervals.

        Raises
        ------
        UsageError : no side has the product.

        Examples
        --------
        >>> from hyperval.products import SpectralEstimate
        >>> counts = {"grass": SpectralEstimate(np.ones(2), np.eye(2))}
        >>> axis, origin = spectra.SpectralAxis([1, 2], 1), {"quantity": "counts"}
        >>> side = ObservedProducts(axis, reflectance=counts, provenance=origin)
        >>> axes = Observation(side).plot.spectra("reflectance")
        >>> axes.get_xlabel(), axes.get_ylabel()
        ('number of the band', 'counts')
        """
        every = self.tables.spectra
        use = every.assign(half=Z95 * every["standard_uncertainty"])[every["product"] == product]
        if use.empty:
            names = ", ".join(every["product"].unique())
            raise UsageError(f"nothing to draw: no {product}", expected=f"one of {names}" if names else None)
        columns = {"x": "band_nm", "y": "value", "half": "half"}
        sides = list(self.tables.both.values())
        x, y = wavelength_axis(sides[0].axis), Axis(spectra_labels(sides, product)[0])
        return _draw(single_panel(x, y, _lines(use, ["subject"], columns)), ax)

    def roc(self, ax: Axes | None = None) -> Axes:
        """Every ROC curve, false alarms on a logarithmic scale.

        Raises
        ------
        UsageError : no side has a curve.
        """
        refuse(self.tables.roc.empty, "api.no_curve")
        marks = _lines(self.tables.roc, ["subject", "detector", "unit"], {"x": "pfa", "y": "pd"})
        x, y = Axis("probability of false alarm", "log"), Axis("probability of detection", ends=(0.0, 1.0))
        return _draw(single_panel(x, y, marks), ax)


def _lines(frame: pandas.DataFrame, names: list[str], columns: Mapping[str, str]) -> list[Mark]:
    """A line for each side and entry: a colour an entry, a dash a side."""
    colours, dashes = dict[tuple[str, ...], str](), dict(zip(frame["side"].unique(), _DASHES, strict=False))
    marks = []
    for (side, *key), part in frame.groupby(["side", *names], sort=False):
        colour = colours.setdefault(tuple(key), SOURCES[len(colours) % len(SOURCES)])
        values = {name: part[column].to_numpy() for name, column in columns.items()}
        marks.append(Mark("line", values, f"{'/'.join(key)}, {side}", colour, dashes[side]))
    return marks


def labelled(side: Products) -> xr.Dataset:
    """A side over one ``subject`` and one ``wavelength``; a product is NaN for a subject that has none."""
    whole = to_xarray(side)
    by_dim = {str(dim): [str(v) for v in whole.data_vars if dim in whole[v].dims]
           for dim in whole.dims if str(dim).endswith("_subject") and not str(dim).startswith("roc")}  # fmt: skip
    subjects = list(dict.fromkeys(s for dim in by_dim for s in whole[dim].to_numpy().tolist()))
    parts = [whole[names].rename({dim: "subject"}).reindex(subject=subjects) for dim, names in by_dim.items()]
    merged: xr.Dataset = xr.merge(
        [whole.drop_dims(list(by_dim)), *parts], combine_attrs="override", join="exact", compat="override"
    )
    return merged.swap_dims({d: w for d, w in (("band", "wavelength"), ("band_2", "wavelength_2")) if d in merged.dims})


def _label(column: xr.DataArray) -> str:
    words, unit = column.attrs.get("long_name", column.name), column.attrs.get("units", "")
    return f"{words} [{unit}]" if unit and unit != "1" else str(words)


_WIDTH = 100
_LINES = 9
_ROWS = 10  # in a notebook


class _Shown:
    """What a notebook shows: the object in words, and its first rows without the columns that are empty there."""

    def _repr_html_(self: Any) -> str:
        rows = getattr(self, "summary", None)  # what was judged, where that is told apart
        rows = (self.to_dataframe() if rows is None else rows).head(_ROWS)
        rows = rows.loc[:, ~(rows.isna() | (rows == "")).all()]
        return f"<pre>{html.escape(repr(self))}</pre>{rows.to_html(border=0, notebook=True)}"

    def to_xarray(self: Any) -> Any:
        """The columns as variables over the rows."""
        return xr.Dataset.from_dataframe(self.to_dataframe())


def _summary_card(head: str, facts: Mapping[str, Iterable[object]]) -> str:
    """A head and a line for each fact that there is, ten lines at most."""
    lines = [f"<{head}>"]
    for name, values in facts.items():
        words = ", ".join(map(str, values))
        if words:
            lines.append("  " + textwrap.shorten(f"{name}: {words}", _WIDTH, placeholder=" ..."))
    if len(lines) > _LINES + 1:
        lines = [*lines[:_LINES], "  ..."]
    return "\n".join(lines)


def _count_text(column: pandas.Series[Any]) -> list[str]:
    """How often each value of a column stands in it, in words."""
    return [f"{n} {value}" for value, n in column.value_counts(sort=False).items()]


class _Tables(_Shown):
    """Tables of the sides of a run, or of one side.

    Attributes
    ----------
    both : "predicted", "observed" -> the products of each side there is
    """

    both: Mapping[str, Products]

    @cached_property
    def sides(self) -> Mapping[str, xr.Dataset]:
        """The sides there are, "predicted" and "observed", as datasets."""
        return {name: labelled(side) for name, side in self.both.items()}

    @property
    def plot(self) -> SidesPlot:
        """``plot.spectra()``, ``plot.roc()``; ``plot()`` draws what there is."""
        return SidesPlot(self)

    @property
    def spectra(self) -> pandas.DataFrame:
        """Means with their standard uncertainties: a row for each side, product, subject and band."""
        return self._table(
            ["product", "subject", "band_nm", "value", "standard_uncertainty"],
            lambda side: (
                (product, subject, side.axis.centre_nm, e.mean, e.standard_uncertainty)
                for product in SPECTRA for subject, e in getattr(side, product).items()
            ),
        )  # fmt: skip

    @property
    def roc(self) -> pandas.DataFrame:
        """ROC curves with their 95 % limits: a row for each point."""
        values = ["pfa", "pd", "pd_lower", "pd_upper", "threshold"]
        return self._table(
            ["subject", "detector", "unit", *values],
            lambda side: ((*key, *(getattr(curve, v) for v in values)) for key, curve in side.roc.items()),
        )

    @property
    def scores(self) -> pandas.DataFrame:
        """Mean and standard deviation of each population's detector score."""
        return self._table(
            ["subject", "detector", "mean", "sd", "n"],
            lambda side: ((*key, *np.array([[s.mean], [s.sd], [s.n]], float)) for key, s in side.scores.items()),
        )

    def _table(
        self, columns: Sequence[str], entries: Callable[[Products], Iterable[Sequence[Any]]]
    ) -> pandas.DataFrame:
        """A row for each value of each entry of a side, which gives words and arrays in the order of the columns."""
        names = ["side", *columns]
        every = [(name, *entry) for name, side in self.both.items() for entry in entries(side)]
        parts = [pandas.DataFrame(dict(zip(names, entry, strict=True))) for entry in every]
        return pandas.concat(parts, ignore_index=True) if parts else pandas.DataFrame(columns=names)


class Probability(NamedTuple):
    """A probability of detection with its 95 % limits; these are NaN where no uncertainty is stated."""

    value: float
    lower: float
    upper: float


class _Side(_Tables):
    """One side of a comparison: ``products`` has all of it, and what is no table here goes by the same names.

    >>> from hyperval.api import predict
    >>> predict("panels").snr["grass"].mean.size
    360
    """

    def __init__(self, side: Products):
        self.products = side

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "products":  # of an object that is being made
            raise AttributeError(name)
        return getattr(self.products, name)

    def __repr__(self) -> str:
        """Bands, and what there is of each product.

        >>> repr(Observation(ObservedProducts(spectra.SpectralAxis([1, 2], 1)))).splitlines()[0]
        '<Observation of 2 bands by number>'
        """
        facts: dict[str, Iterable[object]] = {
            name: sorted({key if isinstance(key, str) else "/".join(key) for key in getattr(self.products, name)})
            for name in (*SPECTRA, "scores", "roc", "abundance", "classification")
        }
        return _summary_card(f"{type(self).__name__} of {self.products.axis.words}", facts)

    def pd(
        self, subject: str, *, pfa: float = 1e-3, detector: str | None = None, unit: str | None = None
    ) -> Probability:
        """P_D of a subject at a probability of false alarm, with its 95 % limits.

        Parameters
        ----------
        detector, unit : of the curve; else the first that the subject has. ``unit`` is pixel or object

        >>> from hyperval.api import predict
        >>> predict("scenario.yaml").pd("large-planks", pfa=1e-2).value > 0.9
        True
        >>> predict("scenario.yaml").pd("large-planks", pfa=2)
        Traceback (most recent call last):
        hyperval.errors.UsageError: no P_D at a P_FA of 2
          expected: a number above 0 and below 1 that the curve reaches, which runs from 1e-09 to 0.999

        Raises
        ------
        UsageError : no such curve, or a probability that it does not reach.
        """
        refuse(np.ndim(pfa) > 0, "api.pfa_list", subject=subject)
        asked = (subject, detector, unit)
        keys = [key for key in self.products.roc if all(a in (None, k) for a, k in zip(asked, key, strict=True))]
        if not keys:
            have = ", ".join("/".join(key) for key in self.products.roc)
            words = ", ".join(repr(one) for one in asked if one is not None)
            raise UsageError(f"no ROC curve of {words}", expected=f"one of {have}" if have else None)
        curve = self.products.roc[keys[0]]
        reached, ends = detection_at(curve, pfa, curve.pfa), (curve.pfa.min(initial=1.0), curve.pfa.max(initial=0.0))
        refuse(not 0.0 < pfa < 1.0 or np.isnan(reached), "api.pfa", pfa=pfa, ends=ends)
        limits = (curve.pd_lower, curve.pd_upper) if curve.has_limits else 2 * (np.full_like(curve.pd, np.nan),)
        return Probability(*(float(detection_at(curve, pfa, values)) for values in (curve.pd, *limits)))

    @property
    def both(self) -> Mapping[str, Products]:  # type: ignore[override]
        """This one, by its name."""
        return {"predicted" if isinstance(self, Prediction) else "observed": self.products}

    def to_xarray(self) -> xr.Dataset:
        """Spectra, covariances and noise over one ``subject`` and one ``wavelength``, and curves."""
        return labelled(self.products)

    def to_dataframe(self) -> pandas.DataFrame:
        """Spectra by band, score moments, P_D at decades of P_FA and areas: a row each, as in ``results.csv``."""
        return ResultTable(hyperval.compare.product_rows(self.products, type(self).__name__.lower())).frame()


class Prediction(_Side):
    """The products as the model gives them."""

    products: PredictedProducts


class Observation(_Side):
    """The products as the collection gives them."""

    products: ObservedProducts


class Results(_Shown, ResultTable):
    """Rows of results."""

    def __repr__(self) -> str:
        """Number of rows by product and by outcome."""
        frame = self.frame()
        counts = {name: _count_text(frame[name]) for name in ("product", "outcome", "cause")}
        return _summary_card(f"Results of {len(frame)} rows", {"campaigns": frame["campaign"].unique(), **counts})

    def to_dataframe(self) -> pandas.DataFrame:
        """The rows in the columns of ``results.csv``."""
        return self.frame().rename_axis("row")

    def plot(self, ax: Axes | None = None) -> Axes:
        """Value, interval and limits of each row that has limits, forty at most, one above the other.

        >>> Results([]).plot()
        Traceback (most recent call last):
        hyperval.errors.UsageError: nothing to draw: no row has a value and limits

        Raises
        ------
        UsageError : no row has limits.
        """
        frame = self.frame()
        limits = frame[["limit_low", "limit_high"]].notna().any(axis=1)
        rows = frame[limits & frame["value"].notna()].head(_MOST)
        refuse(rows.empty, "api.no_limits")
        y = np.arange(float(len(rows)))
        values = {"x": rows["value"].to_numpy(), "low": rows["lower"].to_numpy(), "high": rows["upper"].to_numpy()}
        marks = [Mark("dots", {"y": y, **values}, "value", SOURCES[0], marker="circle", along="x")]
        ends = rows[["limit_low", "limit_high"]].to_numpy().T.ravel()
        marks.append(Mark("dots", {"x": ends, "y": np.tile(y, 2)}, "limit", SOURCES[5], marker="tick", along="x"))
        labels = rows[["subject", "method", "metric"]].astype(str).agg(" ".join, axis=1)
        part = Part(Axis.named(labels.to_list(), 80), tuple(marks))
        return _draw(Panels(Axis("value, 95 % interval, limits"), (part,)), ax, 1.0 + 0.25 * max(len(rows), 4))


@dataclass(frozen=True, repr=False)
class Validation(_Tables):
    """A campaign that was run, now or earlier.

    Attributes
    ----------
    name : of the campaign
    run : its results, as a finished run's folder has them
    notes : assumptions, what was left out
    """

    name: str
    run: Run
    notes: tuple[str, ...] = ()

    @cached_property
    def results(self) -> Results:
        """Every planned comparison, a row each."""
        return Results(self.run.table)

    @property
    def provenance(self) -> Mapping[str, Any]:
        """Inputs, versions, command."""
        return self.run.provenance

    @cached_property
    def prediction(self) -> Prediction | None:
        """What the model gave; None where it was not asked."""
        return None if self.run.pair[0] is None else Prediction(self.run.pair[0])

    @cached_property
    def observation(self) -> Observation | None:
        """What the collection gave; None where it was not observed."""
        return None if self.run.pair[1] is None else Observation(self.run.pair[1])

    @property
    def both(self) -> Mapping[str, Products]:  # type: ignore[override]
        """The sides there are."""
        return self.run.sides

    def __repr__(self) -> str:
        """The campaign, and its rows by outcome."""
        rows = _count_text(self.results.frame()["outcome"])
        subjects = {name: side.radiance or side.reflectance for name, side in self.both.items()}
        return _summary_card(f"Run of {self.name}", {"rows": rows, "sides": self.both, **subjects})

    def to_dataframe(self) -> pandas.DataFrame:
        """The rows in the columns of ``results.csv``."""
        return self.results.to_dataframe()

    @property
    def summary(self) -> pandas.DataFrame:
        """The planned comparisons alone, as ``summary.csv`` has them: the outcome of each, and by how much."""
        frame = self.results.to_dataframe()
        return frame[frame["outcome"] != "none"].reset_index(drop=True)

    def to_xarray(self) -> xr.DataTree:
        """Both sides as the groups of ``products.nc``."""
        return xr.DataTree.from_dict(dict(self.sides), name=self.name)


@dataclass(frozen=True, repr=False)
class Study(_Shown):
    """A study that was evaluated, now or earlier.

    Attributes
    ----------
    table : inputs and outputs over the points
    results : sensitivities, knees and answers, a row each
    provenance : inputs, versions, command
    """

    table: xr.Dataset
    results: Results
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Number of points and the range of each column."""
        facts = {}
        for name, column in self.table.items():
            if column.dtype.kind == "f":
                unit = "" if column.attrs.get("units", "1") == "1" else f" {column.attrs['units']}"
                facts[str(name)] = [f"{np.nanmin(column):.4g} to {np.nanmax(column):.4g}{unit}"]
            else:
                facts[str(name)] = sorted(set(map(str, column.to_numpy())))
        return _summary_card(f"Study of {self.table.sizes['point']} points", facts)

    def to_dataframe(self) -> pandas.DataFrame:
        """A row for each point."""
        return self.table.drop_vars("reason", errors="ignore").to_dataframe()

    def to_xarray(self) -> xr.Dataset:
        """The columns as variables over the points."""
        return self.table

    def plot(self, x: str | None = None, y: str | None = None, ax: Axes | None = None) -> Axes:
        """One column against another; by default the last against the first.

        Raises
        ------
        UsageError : no such column.
        """
        names = [str(n) for n in self.table.data_vars]
        x, y = x or names[0], y or names[-1]
        if x not in names or y not in names:
            raise UsageError(f"no column {x if x not in names else y!r}", expected="one of " + ", ".join(names))
        ax = _axes(ax)
        ax.plot(self.table[x].to_numpy(), self.table[y].to_numpy(), "o", color=SOURCES[0])
        ax.set(xlabel=_label(self.table[x]), ylabel=_label(self.table[y]))
        return ax


class Collection(_Shown):
    """A simulated collection on disk: ``folder``, ``cube``, ``targets``, and its other files by their names."""

    folder: Path
    cube: Path
    targets: Path

    def __init__(self, **files: Any):
        vars(self).update(files)

    def __repr__(self) -> str:
        """Where it is, and its files."""
        sizes = self.to_xarray()["radiance"].shape
        files = [path.name for path in vars(self).values() if isinstance(path, Path) and path != self.folder]
        size = "Collection of {} lines, {} samples, {} bands".format(*sizes)
        return _summary_card(size, {"folder": [self.folder], "files": files})

    def to_xarray(self) -> xr.Dataset:
        """The cube, read where it is asked for: radiance over lines, samples and bands."""
        cube = imagery.open_cube(self.cube, quantity="radiance", unit=RADIANCE_UNIT)
        return xr.Dataset({"radiance": cube.to_xarray()})

    def to_dataframe(self) -> pandas.DataFrame:
        """The list of targets."""
        return pandas.read_csv(self.targets)

    def plot(self, ax: Axes | None = None) -> Axes:
        """The bands nearest to 660, 550 and 470 nm, each stretched from its 2nd to its 98th percentile."""
        rgb = self.to_xarray()["radiance"].sel(wavelength=list(_RGB_NM), method="nearest")
        low, high = rgb.quantile([0.02, 0.98], ("line", "sample"))
        ax = _axes(ax)
        ax.imshow(((rgb - low) / np.maximum(high - low, 1e-12)).clip(0.0, 1.0))
        ax.set(xlabel="sample", ylabel="line")
        return ax


@dataclass(frozen=True, repr=False)
class Metrics(_Shown):
    """The table of metrics.

    Attributes
    ----------
    rows : name -> metric
    """

    rows: Mapping[str, Metric]

    def __repr__(self) -> str:
        """Number of metrics by kind."""
        return _summary_card(f"Metrics: {len(self.rows)}", {"kinds": _count_text(self.to_dataframe()["kind"])})

    def to_dataframe(self) -> pandas.DataFrame:
        """A row for each metric, by name."""
        names = [f.name for f in fields(Metric) if f.name not in ("tolerance", "usual")]
        return pandas.DataFrame([{n: getattr(m, n) for n in names} for m in self.rows.values()]).set_index("name")


def load_campaign(path: Path | str) -> campaigns.Job:
    """Read and check a campaign file of one run; its parts are below ``campaign``.

    >>> load_campaign("campaign.yaml").campaign.name
    'small'

    Raises
    ------
    InputError, UsageError : of the file.
    """

    return campaigns.load_job(Path(path))


def explain(
    file: Path | str, *, header: Path | str | None = None, key: str | None = None
) -> list[tuple[str, str, str]]:
    """What a file is as its reader sees it: thing, value, and where the value comes from or what mends its lack.

    Parameters
    ----------
    file : an image, or a file of spectra
    header : ENVI header that does not lie beside the image
    key : which array of the file is the image, where it holds several

    >>> [value for what, value, origin in explain("collection/small_rad.img") if what == "wavelengths"]
    ['16, 450 to 2200 nm']

    Raises
    ------
    InputError, UsageError : neither, or damaged; in the words of the reader.
    """
    path = Path(file)
    is_image = header is not None or path.is_dir() or path.suffix.lower() == ".hdr" or header_beside(path) is not None
    if is_image or not imagery.needs_header(path):
        raster = imagery.open_raster(path, header=header, variable=key)
        if not (isinstance(raster, imagery.EnviRaster) and "library" in raster.header.file_type.lower()):
            return imagery.image_record(raster)
        path = raster.path
    rows = []
    for spectrum in spectra.read_records(path, quantity="other"):
        nm = spectrum.wavelength_nm
        rows.append(("spectrum", f"{spectrum.name}: {nm.size} values, {nm[0]:g} to {nm[-1]:g} nm", spectrum.source))
        rows += [("assumed", note, "reader") for note in spectrum.notes]
    return rows


def predict(
    scenario: Scenario | Path | str, *, objects: bool | int = False, object_curves: bool = True, **origins: Any
) -> Prediction:
    """What the model says of a scenario, a scenario file or a built-in name.

    >>> predict("scenario.yaml").radiance["grey-panel-35"].mean.shape
    (16,)

    Parameters
    ----------
    objects, object_curves : of :func:`hyperval.model.predict`
    origins : entries of :class:`hyperval.model.Origins`, such as ``axis``

    Raises
    ------
    InputError, UsageError, EngineError : of the scenario.
    """

    loaded = scenario if isinstance(scenario, Scenario) else load_scenario(str(scenario))
    return Prediction(model.predict(loaded, model.Origins(**origins), objects=objects, object_curves=object_curves))


def observe(campaign: campaigns.Job | Path | str, *, show_progress: bool | None = None) -> Observation:
    """What the collection of a campaign says.

    >>> sorted(observe("campaign.yaml").reflectance)[:3]
    ['black-panel', 'court', 'field']

    Raises
    ------
    InputError, UsageError : of the campaign; MissingDataError where its data are not at hand.
    """

    with bars(show_progress), campaigns.observe_campaign(_job(campaign, compares=False)) as collection:
        return Observation(collection.observed.observation)


def compare(
    prediction: Prediction | Scenario | Path | str,
    observation: Observation | campaigns.Job | Path | str,
    *,
    name: str = "comparison",
    method: str = "model",
) -> Results:
    """Compare two sides on the same bands: a row for each metric of each product, none of which gates.

    A scenario is predicted on the bands of the observation, a campaign is observed.

    >>> rows = compare("scenario.yaml", "campaign.yaml")
    >>> rows.to_dataframe()["product"].unique().tolist()[:2]
    ['radiance', 'snr']

    Raises
    ------
    UsageError : the two sides are not on the same bands.
    """
    measured = (observation if isinstance(observation, Observation) else observe(observation)).products
    predicted = prediction if isinstance(prediction, Prediction) else predict(prediction, axis=measured.axis)
    return Results(of_campaign(hyperval.compare.compare_products(predicted.products, measured, method=method), name))


def validate(
    campaign: campaigns.Job | Path | str, *, output: Path | str | None = None, show_progress: bool | None = None
) -> Validation:
    """Predict, observe and compare a campaign of one run; with ``output`` the folder of results is written, too.

    >>> run = validate("campaign.yaml")
    >>> run.results.exit_code()
    0
    >>> run.prediction.axis.centre_nm.size
    16

    Raises
    ------
    InputError, UsageError, EngineError : of the campaign.  Data that are not at hand make its rows SKIPPED.
    """
    with bars(show_progress):
        report = campaigns.run_campaign(job := _job(campaign))
    if output is not None:
        with whole_folder(Path(output), beside=(one.path for one in job.files)) as folder:
            hyperval.report.write_outputs(report, folder)
    return Validation(report.campaign, report, tuple(report.notes))


def study(path: Path | str, *, output: Path | str | None = None, show_progress: bool | None = None) -> Study:
    """Evaluate a study file; without ``output`` nothing is kept on disk.

    >>> table = study("study.yaml").to_dataframe()
    >>> table.columns.tolist()
    ['fill', 'pd']

    Raises
    ------
    UsageError, InputError, EngineError : of the study or its scenario.
    """
    with TemporaryDirectory(prefix="hyperval-study-") as scratch, bars(show_progress):
        folder = Path(scratch) / "study" if output is None else Path(output)
        hyperval.study.study_to_folder(Path(path), folder)
        return _study(folder)


def check(
    campaigns: Path | str | Iterable[Path | str] = (),
    sensors: str | Iterable[str] = (),
    *,
    baselines: Path | str | None = None,
    show_progress: bool | None = None,
) -> Results:
    """Compare campaigns and sensors with the accepted numbers; ``exit_code()`` of the rows is that of the command.

    >>> check(sensors="prospectir-vs", baselines="nothing-accepted").exit_code()
    1

    Raises
    ------
    UsageError, InputError : of the campaigns, sensors or baselines.
    """

    files = [campaigns] if isinstance(campaigns, Path | str) else list(campaigns)
    names = [sensors] if isinstance(sensors, str) else list(sensors)
    with bars(show_progress):
        runs = baseline.check([Path(f) for f in files], names, baselines=Path(baselines or baseline.DEFAULT_FOLDER))
    return Results(baseline.joined_rows(runs))


def simulate(
    scene: hyperval.simulate.SceneFile | Path | str, output: Path | str, *, show_progress: bool | None = None
) -> Collection:
    """Write a simulated collection with its truth into a folder.

    >>> simulate("scene.yaml", "simulated").cube.name
    'small_rad.img'

    Raises
    ------
    UsageError, InputError, EngineError : of the scene.
    """
    with bars(show_progress):
        return Collection(**hyperval.simulate.simulate(scene, Path(output)))


def open(folder: Path | str) -> Validation | Study:
    """A folder of results of an earlier run, or of a study.

    >>> run = validate("campaign.yaml", output="results")
    >>> open("results").results.to_dataframe().shape == run.results.to_dataframe().shape
    True

    Raises
    ------
    InputError : no folder of results.
    """
    folder = Path(folder)
    if (folder / "table.nc").is_file():
        return _study(folder)
    run = Run.open(folder)
    return Validation(next((row.campaign for row in run.table), folder.name), run)


def metrics() -> Metrics:
    """Every metric of the results: unit, range, direction, formula.

    >>> metrics().to_dataframe().loc["bias_ratio", "unit"]
    '1'
    """
    return Metrics(table())


def _job(campaign: campaigns.Job | Path | str, *, compares: bool = True) -> Any:
    """The campaign as it is, or that of a file of one run; ``compares`` as for :func:`load_jobs`."""

    if isinstance(campaign, campaigns.Job):
        return campaign
    jobs = campaigns.load_jobs(Path(campaign), compares=compares)
    return jobs[0] if len(jobs) == 1 else load_campaign(campaign)  # which says what is wrong with several


def _study(folder: Path) -> Study:
    check_hdf5(folder / "table.nc")
    table = xr.load_dataset(folder / "table.nc", engine="h5netcdf")
    run = Run.open(folder)
    return Study(table=table, results=Results(run.table), provenance=run.provenance)
