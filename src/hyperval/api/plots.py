"""Quick looks of what the verbs give; the figures of the reports are drawn by :mod:`hyperval.report`.

Every method takes ``ax``, axes to draw into, and gives them back.  matplotlib is loaded when something is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import xarray as xr

from hyperval.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_STYLES = ("-", "--", ":")
_RGB_NM = (660.0, 550.0, 470.0)
_MOST = 40  # rows that a page can hold


def _axes(ax: Axes | None, **size: Any) -> Axes:
    if ax is not None:
        return ax
    from matplotlib import pyplot

    made: Axes = pyplot.subplots(**size)[1]
    return made


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
        """Mean spectra of ``radiance``, ``reflectance`` or ``snr`` with two standard uncertainties.

        Raises
        ------
        UsageError : no side has the product.
        """
        sides = self._with(product)
        ax = _axes(ax)
        subjects = list(dict.fromkeys(str(s) for d in sides.values() for s in d[f"{product}_subject"].to_numpy()))
        for style, (side, data) in zip(_STYLES, sides.items(), strict=False):
            for i, subject in enumerate(map(str, data[f"{product}_subject"].to_numpy())):
                nm, mean = data["wavelength"].to_numpy(), data[product].to_numpy()[i]
                u = 2.0 * data[f"{product}_standard_uncertainty"].to_numpy()[i]
                colour = f"C{subjects.index(subject) % 10}"
                ax.plot(nm, mean, style, color=colour, label=f"{subject}, {side}")
                ax.fill_between(nm, mean - u, mean + u, color=colour, alpha=0.15, linewidth=0.0)
        ax.set(xlabel="wavelength [nm]", ylabel=f"{product} [{next(iter(sides.values()))[product].attrs['units']}]")
        ax.legend(fontsize="small")
        return ax

    def roc(self, ax: Axes | None = None) -> Axes:
        """Every ROC curve, false alarms on a logarithmic scale.

        Raises
        ------
        UsageError : no side has a curve.
        """
        sides = self._with("roc_pd")
        ax = _axes(ax)
        for style, (side, data) in zip(_STYLES, sides.items(), strict=False):
            for i in range(data.sizes["roc_curve"]):
                words = [str(data[f"roc_{part}"].to_numpy()[i]) for part in ("subject", "detector", "unit")]
                pfa, pd_ = data["roc_pfa"].to_numpy()[i], data["roc_pd"].to_numpy()[i]
                ax.semilogx(pfa, pd_, style, color=f"C{i % 10}", label=f"{'/'.join(words)}, {side}")
        ax.set(xlabel="probability of false alarm", ylabel="probability of detection", ylim=(0.0, 1.0))
        ax.legend(fontsize="small")
        return ax

    def _with(self, variable: str) -> dict[str, xr.Dataset]:
        sides = {side: data for side, data in self.sides.items() if variable in data}
        if not sides:
            names = sorted({str(n) for data in self.sides.values() for n in data.data_vars})
            raise UsageError(f"nothing to draw: no {variable}", expected="one of " + ", ".join(names[:8]))
        return sides


@dataclass(frozen=True)
class ResultsPlot:
    """Rows of results."""

    frame: pd.DataFrame

    def __call__(self, ax: Axes | None = None) -> Axes:
        """Value, interval and limits of each row that has limits, forty at most, one above the other."""
        limits = self.frame[["limit_low", "limit_high"]].notna().any(axis=1)
        rows = self.frame[limits & self.frame["value"].notna()].head(_MOST)
        ax = _axes(ax, figsize=(8.0, 1.0 + 0.25 * max(len(rows), 4)))
        y = np.arange(len(rows))[::-1]
        ax.plot(rows["value"], y, "o", color="C0", label="value")
        ax.hlines(y, rows["lower"], rows["upper"], color="C0")
        for side in ("limit_low", "limit_high"):
            ax.plot(rows[side], y, "|", color="C3", markersize=12.0)
        labels = rows[["subject", "method", "metric"]].astype(str).agg(" ".join, axis=1)
        ax.set_yticks(y, labels.to_list(), fontsize="small")
        ax.set_xlabel("value, 95 % interval, limits")
        return ax


@dataclass(frozen=True)
class TablePlot:
    """Columns over the points of a study."""

    table: xr.Dataset

    def __call__(self, x: str | None = None, y: str | None = None, ax: Axes | None = None) -> Axes:
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
        ax.plot(self.table[x].to_numpy(), self.table[y].to_numpy(), ".")
        ax.set(xlabel=_label(self.table[x]), ylabel=_label(self.table[y]))
        return ax


@dataclass(frozen=True)
class ImagePlot:
    """A cube as a picture."""

    data: xr.Dataset

    def __call__(self, ax: Axes | None = None) -> Axes:
        """The bands nearest to 660, 550 and 470 nm, each stretched from its 2nd to its 98th percentile."""
        nm = self.data["wavelength"].to_numpy()
        bands = [int(np.abs(nm - w).argmin()) for w in _RGB_NM]
        values = self.data["radiance"].to_numpy()[:, :, bands]
        low, high = np.nanpercentile(values, (2.0, 98.0), axis=(0, 1))
        ax = _axes(ax)
        ax.imshow(np.clip((values - low) / np.maximum(high - low, 1e-12), 0.0, 1.0))
        ax.set(xlabel="sample", ylabel="line")
        return ax


def _label(column: xr.DataArray) -> str:
    words, unit = column.attrs.get("long_name", column.name), column.attrs.get("units", "")
    return f"{words} [{unit}]" if unit and unit != "1" else str(words)
