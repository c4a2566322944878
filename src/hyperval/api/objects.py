"""What the verbs give: the products, rows and tables of the package with a short ``repr`` and the usual views.

Quick looks of what the verbs give; the figures of the reports are drawn by :mod:`hyperval.report`.

Every method takes ``ax``, axes to draw into, and gives them back.  matplotlib is loaded when something is drawn.
"""

from __future__ import annotations

import html
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import xarray as xr

from hyperval import products
from hyperval.compare.products import product_rows
from hyperval.errors import UsageError
from hyperval.figures.spec import SOURCES, WAVELENGTH, Axis, Dash, Mark, Panels, Part, row_names, single
from hyperval.imagery.cube import open_cube
from hyperval.imagery.interchange import cube_to_xarray
from hyperval.metrics import Metric
from hyperval.model.intervals import Z95
from hyperval.results import ResultTable
from hyperval.run import to_xarray
from hyperval.simulate.collection import SimulatedCollection
from hyperval.units import RADIANCE_UNIT

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_DASHES: tuple[Dash, ...] = ("solid", "dashed", "dotted")
_RGB_NM = (660.0, 550.0, 470.0)
_MOST = 40  # rows that a page can hold


def _axes(ax: Axes | None, height_in: float = 4.8) -> Axes:
    from matplotlib import pyplot

    return ax or pyplot.subplots(figsize=(8.0, height_in))[1]


def _drawn(view: Panels, ax: Axes | None, height_in: float = 4.8) -> Axes:
    """A stated view in axes, new ones where none are given."""
    from hyperval.figures.print import draw_part, legend_of

    ax = _axes(ax, height_in)
    draw_part(ax, view, view.parts[0])
    ax.set(xlabel=view.x.label, ylabel=view.parts[0].y.label)
    if any(mark.label for mark in view.parts[0].marks):
        ax.legend(*legend_of(view), fontsize="small")
    return ax


@dataclass(frozen=True)
class SidesPlot:
    """Spectra and curves of one side or of both, which differ by the style of their lines."""

    sides: Mapping[str, xr.Dataset]

    def __call__(self, ax: Axes | None = None) -> Axes:
        """Radiance, else reflectance, else ROC curves."""
        for product in ("radiance", "reflectance"):
            if any(product in data for data in self.sides.values()):
                return self.spectra(product, ax=ax)
        return self.roc(ax=ax)

    def spectra(self, product: str = "radiance", ax: Axes | None = None) -> Axes:
        """Mean spectra of ``radiance``, ``reflectance`` or ``snr`` with their 95 % intervals.

        Raises
        ------
        UsageError : no side has the product.
        """
        sides = self._with(product)
        subjects = list(dict.fromkeys(str(s) for d in sides.values() for s in d[f"{product}_subject"].to_numpy()))
        marks = []
        for dash, (side, data) in zip(_DASHES, sides.items(), strict=False):
            for i, subject in enumerate(map(str, data[f"{product}_subject"].to_numpy())):
                half = Z95 * data[f"{product}_standard_uncertainty"].to_numpy()[i]
                columns = {"x": data["wavelength"].to_numpy(), "y": data[product].to_numpy()[i], "half": half}
                colour = SOURCES[subjects.index(subject) % len(SOURCES)]
                marks.append(Mark("line", columns, f"{subject}, {side}", colour, dash))
        return _drawn(single(Axis(WAVELENGTH), _label(next(iter(sides.values()))[product]), marks), ax)

    def roc(self, ax: Axes | None = None) -> Axes:
        """Every ROC curve, false alarms on a logarithmic scale.

        Raises
        ------
        UsageError : no side has a curve.
        """
        marks = []
        for dash, (side, data) in zip(_DASHES, self._with("roc_pd").items(), strict=False):
            for i in range(data.sizes["roc_curve"]):
                words = [str(data[f"roc_{part}"].to_numpy()[i]) for part in ("subject", "detector", "unit")]
                columns = {"x": data["roc_pfa"].to_numpy()[i], "y": data["roc_pd"].to_numpy()[i]}
                label = f"{'/'.join(words)}, {side}"
                marks.append(Mark("line", columns, label, SOURCES[i % len(SOURCES)], dash))
        axis = Axis("probability of false alarm", "log")
        return _drawn(single(axis, "probability of detection", marks, ends=(0.0, 1.0)), ax)

    def _with(self, variable: str) -> dict[str, xr.Dataset]:
        sides = {side: data for side, data in self.sides.items() if variable in data}
        if not sides:
            names = sorted({str(n) for data in self.sides.values() for n in data.data_vars})
            raise UsageError(f"nothing to draw: no {variable}", expected="one of " + ", ".join(names[:8]))
        return sides


def _label(column: xr.DataArray) -> str:
    words, unit = column.attrs.get("long_name", column.name), column.attrs.get("units", "")
    return f"{words} [{unit}]" if unit and unit != "1" else str(words)


_WIDTH = 100
_LINES = 9
_ROWS = 10  # in a notebook


class _Shown:
    """What a notebook shows: the object in words, and its first rows without the columns that are empty there."""

    def _repr_html_(self: Any) -> str:
        rows = self._first_rows().head(_ROWS)
        rows = rows.loc[:, ~(rows.isna() | (rows == "")).all()]
        return f"<pre>{html.escape(repr(self))}</pre>{rows.to_html(border=0, notebook=True)}"

    def _first_rows(self: Any) -> pd.DataFrame:
        frame: pd.DataFrame = self.to_dataframe()
        return frame


def _card(head: str, facts: Mapping[str, Iterable[object]]) -> str:
    """A head and a line for each fact that there is, ten lines at most."""
    lines = [f"<{head}>"]
    for name, values in facts.items():
        words = ", ".join(map(str, values))
        if words:
            lines.append(textwrap.shorten(f"  {name}: {words}", _WIDTH, placeholder=" ..."))
            lines[-1] = "  " + lines[-1].lstrip()
    if len(lines) > _LINES + 1:
        lines = [*lines[:_LINES], "  ..."]
    return "\n".join(lines)


class _Side(_Shown):
    """Views of one side of a comparison."""

    def __repr__(self: Any) -> str:
        """Bands, and what there is of each product."""
        nm = self.axis.centre_nm
        facts: dict[str, Iterable[object]] = {
            name: sorted({key if isinstance(key, str) else "/".join(key) for key in getattr(self, name)})
            for name in (*products.SPECTRA, "scores", "roc", "abundance", "classification")
        }
        return _card(f"{type(self).__name__} of {nm.size} bands, {nm[0]:.0f}-{nm[-1]:.0f} nm", facts)

    def to_xarray(self: Any) -> xr.Dataset:
        """Spectra, covariances, noise and curves as the group of ``products.nc`` has them."""
        data: xr.Dataset = to_xarray(self)
        return data

    def to_dataframe(self: Any) -> pd.DataFrame:
        """Spectra by band, score moments, P_D at decades of P_FA and areas: a row each, as in ``results.csv``."""
        return ResultTable(product_rows(self, type(self).__name__.lower())).frame()

    @property
    def plot(self: Any) -> SidesPlot:
        """``plot.spectra()``, ``plot.roc()``; ``plot()`` draws what there is."""
        return SidesPlot({type(self).__name__.lower(): self.to_xarray()})


class Prediction(_Side, products.PredictedProducts):
    """The products as the model gives them."""


class Observation(_Side, products.ObservedProducts):
    """The products as the collection gives them."""


class Results(_Shown, ResultTable):
    """Rows of results."""

    def __repr__(self) -> str:
        """Number of rows by product and by outcome."""
        frame = self.frame()
        counts = {
            name: [f"{n} {value}" for value, n in frame[name].value_counts(sort=False).items()]
            for name in ("product", "outcome", "cause")
        }
        return _card(f"Results of {len(frame)} rows", {"campaigns": frame["campaign"].unique(), **counts})

    def to_dataframe(self) -> pd.DataFrame:
        """The rows in the columns of ``results.csv``."""
        return self.frame()

    def to_xarray(self) -> xr.Dataset:
        """The columns as variables over the rows."""
        return xr.Dataset.from_dataframe(self.frame().rename_axis("row"))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Value, interval and limits of each row that has limits, forty at most, one above the other."""
        frame = self.frame()
        limits = frame[["limit_low", "limit_high"]].notna().any(axis=1)
        rows = frame[limits & frame["value"].notna()].head(_MOST)
        y = np.arange(float(len(rows)))
        values = {"x": rows["value"].to_numpy(), "low": rows["lower"].to_numpy(), "high": rows["upper"].to_numpy()}
        marks = [Mark("dots", {"y": y, **values}, "value", SOURCES[0], marker="circle", along="x")]
        marks += [
            Mark("dots", {"x": rows[side].to_numpy(), "y": y}, "limit", SOURCES[5], marker="tick", along="x")
            for side in ("limit_low", "limit_high")
        ]
        labels = rows[["subject", "method", "metric"]].astype(str).agg(" ".join, axis=1)
        part = Part(row_names(labels.to_list(), 80), tuple(marks))
        return _drawn(Panels(Axis("value, 95 % interval, limits"), (part,)), ax, 1.0 + 0.25 * max(len(rows), 4))


@dataclass(frozen=True, repr=False)
class Validation(_Shown):
    """A campaign that was run, now or earlier.

    Attributes
    ----------
    name : of the campaign
    results : every planned comparison, a row each
    sides : "predicted" and "observed" as datasets
    provenance : inputs, versions, command
    notes : assumptions, what was left out
    prediction, observation : the sides as objects; None for one that was not made
    """

    name: str
    results: Results
    sides: Mapping[str, xr.Dataset]
    provenance: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    prediction: Prediction | None = None
    observation: Observation | None = None

    def __repr__(self) -> str:
        """The campaign, and its rows by outcome."""
        counts = self.results.frame()["outcome"].value_counts(sort=False)
        facts: dict[str, Iterable[object]] = {
            "rows": [f"{n} {value}" for value, n in counts.items()],
            "sides": list(self.sides),
        }
        for name, data in self.sides.items():
            subjects = data.get("radiance_subject", data.get("reflectance_subject"))
            facts[name] = [] if subjects is None else subjects.to_numpy().tolist()
        return _card(f"Run of {self.name}", facts)

    def to_dataframe(self) -> pd.DataFrame:
        """The rows in the columns of ``results.csv``."""
        return self.results.to_dataframe()

    def _first_rows(self) -> pd.DataFrame:
        """What was judged."""
        return self.summary

    @property
    def summary(self) -> pd.DataFrame:
        """The planned comparisons alone, as ``summary.csv`` has them: the outcome of each, and by how much."""
        frame = self.results.to_dataframe()
        return frame[frame["outcome"] != "none"].reset_index(drop=True)

    @property
    def spectra(self) -> pd.DataFrame:
        """Means with their standard uncertainties: a row for each side, product, subject and band."""
        parts = []
        for side, data in self.sides.items():
            for product in (name for name in products.SPECTRA if name in data):
                names = [product, f"{product}_standard_uncertainty"]
                part = data[names].rename({names[0]: "value", names[1]: "standard_uncertainty"})
                frame = part.rename({f"{product}_subject": "subject"}).to_dataframe().reset_index()
                parts.append(frame.assign(side=side, product=product).rename(columns={"wavelength": "band_nm"}))
        columns = ["side", "product", "subject", "band_nm", "value", "standard_uncertainty"]
        return pd.concat(parts, ignore_index=True)[columns] if parts else pd.DataFrame(columns=columns)

    def measurand(self, side: str, product: str, subject: str) -> xr.Dataset:
        """One spectrum with its standard uncertainty and the correlation of errors, named as CoMet's obsarray does.

        Returns
        -------
        Variables (B,) ``PRODUCT`` and ``u_PRODUCT`` in its unit, (B, B) ``err_corr_PRODUCT`` [1]: with obsarray
        imported, ``.unc`` finds them; punpy propagates them.

        Raises
        ------
        UsageError : no such side, product or subject, or a product whose covariance is not kept.
        """
        whole, names = self.sides.get(side), f"{product}_subject"
        if whole is None or f"{product}_error_covariance" not in whole or subject not in whole[names]:
            have = [f"{k} {n} {s}" for k, d in self.sides.items() for n in products.SPECTRA
                    if f"{n}_error_covariance" in d for s in d[f"{n}_subject"].to_numpy()]  # fmt: skip
            raise UsageError(f"no {side} {product} of {subject!r} with a covariance", expected=", ".join(have))
        one = whole.sel({names: subject}, drop=True)
        u = one[f"{product}_standard_uncertainty"].to_numpy()
        scale = np.where(u > 0, u, 1.0)
        correlation = one[f"{product}_error_covariance"].to_numpy() / np.outer(scale, scale)
        np.fill_diagonal(correlation, 1.0)
        unit, matrix = one[product].attrs["units"], f"err_corr_{product}"
        of_u = {
            "units": unit, "pdf_shape": "gaussian", "err_corr_1_dim": "band", "err_corr_1_form": "err_corr_matrix",
            "err_corr_1_units": [], "err_corr_1_params": [matrix],
        }  # fmt: skip
        return xr.Dataset(
            {
                product: ("band", one[product].to_numpy(), {**one[product].attrs, "unc_comps": [f"u_{product}"]}),
                f"u_{product}": ("band", u, of_u),
                matrix: (("band", "band_2"), correlation, {"units": "1"}),
            },
            {"wavelength": one["wavelength"]},
            {"subject": subject, "side": side},
        )

    @property
    def roc(self) -> pd.DataFrame:
        """ROC curves with their 95 % limits: a row for each point."""
        return self._entries("roc", ["pfa", "pd", "pd_lower", "pd_upper", "threshold"], ["subject", "detector", "unit"])

    @property
    def scores(self) -> pd.DataFrame:
        """Mean and standard deviation of each population's detector score."""
        return self._entries("score", ["mean", "sd", "n"], ["subject", "detector"])

    def _entries(self, name: str, values: list[str], names: list[str]) -> pd.DataFrame:
        parts = []
        for side, data in self.sides.items():
            if f"{name}_{values[0]}" in data:
                frame = data[[f"{name}_{v}" for v in values]].to_dataframe().reset_index()
                frame.columns = frame.columns.str.removeprefix(f"{name}_")
                parts.append(frame.dropna(subset=values[:1]).assign(side=side)[["side", *names, *values]])
        return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=["side", *names, *values])

    def to_xarray(self) -> xr.DataTree:
        """Both sides as the groups of ``products.nc``."""
        return xr.DataTree.from_dict(dict(self.sides), name=self.name)

    @property
    def plot(self) -> SidesPlot:
        """``plot.spectra()``, ``plot.roc()`` of both sides; ``results.plot()`` draws what was judged."""
        return SidesPlot(self.sides)


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
                unit = column.attrs.get("units", "")
                facts[str(name)] = [f"{np.nanmin(column):.4g} to {np.nanmax(column):.4g} {unit}"]
            else:
                facts[str(name)] = sorted(set(map(str, column.to_numpy())))
        return _card(f"Study of {self.table.sizes['point']} points", facts)

    def to_dataframe(self) -> pd.DataFrame:
        """A row for each point."""
        return self.table.to_dataframe()

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
        values, across = self.table[x].to_numpy(), Axis(_label(self.table[x]))
        if values.dtype.kind not in "fiu":
            kinds = list(dict.fromkeys(values.tolist()))
            values = np.array([kinds.index(v) for v in values.tolist()])
            across = Axis(across.label, "names", tuple(map(str, kinds)))
        columns = {"x": values, "y": self.table[y].to_numpy()}
        return _drawn(
            single(across, _label(self.table[y]), [Mark("dots", columns, "", SOURCES[0], marker="circle")]), ax
        )


class Collection(SimulatedCollection):
    """A simulated collection on disk."""

    def __repr__(self) -> str:
        """Where it is, and its files."""
        cube = open_cube(self.cube, quantity="radiance", unit=RADIANCE_UNIT)
        paths = [getattr(self, f.name) for f in fields(self)]
        files = [path.name for path in paths if isinstance(path, Path) and path != self.folder]
        size = f"{cube.lines} lines, {cube.samples} samples, {cube.bands} bands"
        return _card(f"Collection of {size}", {"folder": [self.folder], "files": files})

    def to_xarray(self) -> xr.Dataset:
        """The cube, read where it is asked for: radiance over lines, samples and bands."""
        return xr.Dataset({"radiance": cube_to_xarray(open_cube(self.cube, quantity="radiance", unit=RADIANCE_UNIT))})

    def to_dataframe(self) -> pd.DataFrame:
        """The list of targets."""
        return pd.read_csv(self.targets)

    def plot(self, ax: Axes | None = None) -> Axes:
        """The bands nearest to 660, 550 and 470 nm, each stretched from its 2nd to its 98th percentile."""
        data = self.to_xarray()
        nm = data["wavelength"].to_numpy()
        bands = [int(np.abs(nm - w).argmin()) for w in _RGB_NM]
        values = data["radiance"].to_numpy()[:, :, bands]
        low, high = np.nanpercentile(values, (2.0, 98.0), axis=(0, 1))
        ax = _axes(ax)
        ax.imshow(np.clip((values - low) / np.maximum(high - low, 1e-12), 0.0, 1.0))
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
        kinds = self.to_dataframe()["kind"].value_counts(sort=False)
        return _card(f"Metrics: {len(self.rows)}", {"kinds": [f"{n} {kind}" for kind, n in kinds.items()]})

    def to_dataframe(self) -> pd.DataFrame:
        """A row for each metric, by name."""
        names = [f.name for f in fields(Metric) if f.name not in ("tolerance", "usual")]
        return pd.DataFrame([{n: getattr(m, n) for n in names} for m in self.rows.values()]).set_index("name")

    def to_xarray(self) -> xr.Dataset:
        """The columns as variables over the names."""
        return xr.Dataset.from_dataframe(self.to_dataframe())
