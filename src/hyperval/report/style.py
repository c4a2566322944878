"""One look for every figure, and bytes that depend on nothing but what is drawn.

Predicted and collected differ in colour (Okabe and Ito's palette, distinct under the common colour
deficiencies), in line style and in marker, so that a grey print still tells them apart.

Places of the axes of a figure, measured once.

matplotlib's own layout engine measures every label of every panel four times, which was half of the time that a
figure takes; panels of one grid need their widest labels alone.
"""

from __future__ import annotations

import base64
import io
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hyperval.spectra.axis import ABSORPTION_BANDS_NM, SpectralAxis
from hyperval.units import PLAUSIBLE_NM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_EDGE = 0.08  # [in] around everything
_GAP = 0.16  # [in] between a panel and the labels of the next
_TITLE_LINE = 0.19  # [in]
_TICK_LABELS, _AXIS_LABEL = 0.24, 0.2  # [in] height below a panel
_FEW = 4  # panels of which each label below is measured: one may be turned
_COLOUR_BAR, _COLOUR_LABEL = 0.16, 0.75  # [in] width of a colour bar, and of its labels


def lay_out(figure: Figure) -> None:
    """Place all panels of the figure's one grid between its title and its legends.

    Panels that share no grid, and those of a figure with a layout engine of its own, stay where they are.
    """
    panels = [axes for axes in figure.axes if axes.get_label() != "<colorbar>" and axes.get_subplotspec() is not None]
    if not panels or figure.get_layout_engine() is not None:
        return
    bars = [axes for axes in figure.axes if axes.get_label() == "<colorbar>"]
    cells = [_cell(axes) for axes in panels]
    rows, columns, heights = _grid(panels[0])
    width, height = (float(size) for size in figure.get_size_inches())
    renderer: Any = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    left_of, right_of, below, above = [0.0] * columns, [0.0] * columns, [0.0] * rows, [0.0] * rows
    few = len(panels) <= _FEW
    for axes, (row, column) in zip(panels, cells, strict=True):
        left_of[column] = max(left_of[column], _overhang(axes, "y", renderer, figure.dpi))
        right_of[column] = max(right_of[column], _words_beside(axes, renderer, figure.dpi))
        measured = _overhang(axes, "x", renderer, figure.dpi) if few else _usual_below(axes)
        below[row] = max(below[row], measured)
        lines = max(
            (axes.get_title(loc).count("\n") + 1 for loc in ("left", "center") if axes.get_title(loc)), default=0
        )
        above[row] = max(above[row], lines * _TITLE_LINE)
    legend_below, legend_right = 0.0, 0.0
    for legend in figure.legends:
        box = legend.get_window_extent(renderer)
        if box.height > 0.5 * figure.bbox.height or box.x0 > 0.5 * figure.bbox.width:  # beside the panels
            legend_right = max(legend_right, box.width / figure.dpi)
        else:
            legend_below = max(legend_below, box.height / figure.dpi)
    head = 0.32 if figure.get_suptitle() else 0.0
    right = _EDGE + _GAP + legend_right
    free_width = width - right - _EDGE - sum(left_of) - sum(right_of) - _GAP * (columns - 1)
    free_height = height - head - legend_below - 2 * _EDGE - sum(below) - sum(above) - _GAP * (rows - 1)
    each = max(free_width, 0.3 * width) / columns
    unit = max(free_height, 0.3 * height) / sum(heights)
    starts = [_EDGE + sum(left_of[: c + 1]) + sum(right_of[:c]) + c * (each + _GAP) for c in range(columns)]
    tops = list(accumulate(
        (above[r] + (below[r - 1] + _GAP + heights[r - 1] * unit if r else 0.0) for r in range(rows)),
        initial=_EDGE + head,
    ))[1:]  # fmt: skip
    for axes, (row, column) in zip(panels, cells, strict=True):
        size = each - (_COLOUR_BAR + _COLOUR_LABEL + _GAP if bars else 0.0), heights[row] * unit
        bottom = height - tops[row] - size[1]
        axes.set_position((starts[column] / width, bottom / height, size[0] / width, size[1] / height))
    for axes in bars:  # beside the last panel
        box = panels[-1].get_position()
        axes.set_aspect("auto")
        axes.set_position((box.x1 + _GAP / width, box.y0 + 0.1 * box.height, _COLOUR_BAR / width, 0.8 * box.height))


def _grid(axes: Axes) -> tuple[int, int, list[float]]:
    spec = axes.get_subplotspec()
    assert spec is not None  # noqa: S101 - panels were chosen so
    grid: Any = spec.get_topmost_subplotspec().get_gridspec()
    return grid.nrows, grid.ncols, [float(ratio) for ratio in grid.get_height_ratios() or [1.0] * grid.nrows]


def _cell(axes: Axes) -> tuple[int, int]:
    spec = axes.get_subplotspec()
    assert spec is not None  # noqa: S101 - panels were chosen so
    top = spec.get_topmost_subplotspec()
    return top.rowspan.start, top.colspan.start


def _usual_below(axes: Axes) -> float:
    labelled = axes.xaxis.get_tick_params().get("labelbottom", True)
    lines = axes.get_xlabel().count("\n") + 1 if axes.get_xlabel() else 0
    return (_TICK_LABELS if labelled else 0.05) + lines * _AXIS_LABEL


def _words_beside(axes: Axes, renderer: Any, dpi: float) -> float:
    """Space [in] that annotations at the right edge of the panel take beside it."""
    from matplotlib.text import Annotation

    ends = [
        text.get_window_extent(renderer).x1
        for text in axes.texts
        if isinstance(text, Annotation) and text.xy[0] == 1.0 and text.xycoords == ("axes fraction", "data")
    ]
    return float(max([end - axes.bbox.x1 for end in ends], default=0.0)) / dpi


def _overhang(axes: Axes, which: str, renderer: Any, dpi: float) -> float:
    """Space [in] that the labels of an axis take left of or below the panel."""
    box = (axes.yaxis if which == "y" else axes.xaxis).get_tightbbox(renderer)
    if box is None:
        return 0.0
    inside = axes.bbox
    return float(max(inside.x0 - box.x0 if which == "y" else inside.y0 - box.y0, 0.0)) / dpi


DIFFERENCE_COLOUR = "#5B3A8C"
ABSORPTION_COLOUR = "#e9e9e9"
WAVELENGTH_LABEL = "wavelength [nm]"
SOURCE_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#777777")
MAX_PANELS = 12

_RC: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titley": 1.0,  # where it goes by itself, without measuring all tick labels for each title
    "axes.labelsize": 9.0,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "lines.linewidth": 1.4,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "text.hinting": "none",  # hinted letters are measured narrower than they are drawn, which cuts long labels
    "svg.hashsalt": "hyperval",
    "svg.fonttype": "path",
    "path.simplify": True,
}


_JOURNAL_RC: dict[str, Any] = {
    "font.family": "DejaVu Serif",
    "font.size": 7.0,
    "axes.titlesize": 7.0,
    "axes.labelsize": 7.0,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "legend.fontsize": 7.0,
    "lines.linewidth": 1.0,
    "axes.grid": False,
    "pdf.fonttype": 42,
}
_JOURNAL_SCALE = 0.72  # of 10 in: 183 mm, two columns
_PRINT_DPI = 300.0


@dataclass(frozen=True)
class Look:
    """How one side is drawn."""

    colour: str
    line: Literal["-", "--"]
    marker: str
    face: str  # of the marker


PREDICTED = Look("#0072B2", "--", "o", "white")
COLLECTED = Look("#C2410C", "-", "s", "#C2410C")


@dataclass(frozen=True)
class Drawing:
    """A finished figure.

    Attributes
    ----------
    name : file name without its ending
    section : the product it belongs to
    title, alt : caption, and the text for those who cannot see it
    content, kind : the bytes of the file and their format
    width_px : width at which the text of a PNG has the size of the page's [CSS pixels]; None for SVG
    legend : what the numbers in a picture stand for, for the caption
    """

    name: str
    section: str
    title: str
    alt: str
    content: bytes
    kind: Literal["svg", "png", "pdf"]
    width_px: int | None = None
    legend: str = ""

    @property
    def file_name(self) -> str:
        """Name of the file in ``figures/``."""
        return f"{self.name}.{self.kind}"

    @property
    def source(self) -> str:
        """The figure as a data URI, for a page that holds it."""
        kind = "svg+xml" if self.kind == "svg" else self.kind
        return f"data:image/{kind};base64,{base64.b64encode(self.content).decode('ascii')}"


@dataclass(frozen=True)
class Print:
    """How figures are drawn for print.

    Attributes
    ----------
    format : of the files
    journal : as wide as two columns of a journal, in its letters, without a title: the caption has it
    """

    format: Literal["svg", "pdf", "png"] = "svg"
    journal: bool = False


_SCREEN = Print()
_PRINT: ContextVar[Print] = ContextVar("_PRINT", default=_SCREEN)


@contextmanager
def house_style(print_as: Print | None = None) -> Iterator[None]:
    """The settings of this module, whatever the user's own matplotlib settings are."""
    import matplotlib.style

    print_as = print_as or _SCREEN
    sheets: list[str | dict[str, Any]] = ["default", _RC, *([_JOURNAL_RC] if print_as.journal else [])]
    token = _PRINT.set(print_as)
    with matplotlib.style.context(sheets), warnings.catch_warnings():
        # A subject may be named in a script that the font lacks; the figure is still of use.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        try:
            yield
        finally:
            _PRINT.reset(token)


def new_figure(width_in: float, height_in: float, title: str, simulated: bool) -> Figure:
    """An empty figure with its title, which says so when the collection is simulated."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    journal = _PRINT.get().journal
    scale = _JOURNAL_SCALE if journal else 1.0
    figure = Figure(figsize=(scale * width_in, scale * height_in))
    FigureCanvasAgg(figure)
    if journal:
        return figure
    words = plain(title) + (" (simulated collection)" if simulated else "")
    figure.suptitle(words, fontsize=10.5, y=1.0 - 0.08 / height_in, va="top")
    return figure


def svg_bytes(figure: Figure) -> bytes:
    """The figure as SVG, coordinates rounded to 0.1 of a point (a seventh of a pixel), not indented."""
    _lay_out(figure)
    out = io.BytesIO()
    figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    text = out.getvalue().decode("utf-8")
    text = re.sub(r'(?<= d=")[^"]+(?=")', lambda m: compact_path(m[0]), text)
    text = re.sub(r'(?<= [xy]=")[^"]+(?=")', _rounded, text)
    return re.sub(r"\n\s+", "\n", text).encode("utf-8")


def vector_bytes(figure: Figure) -> bytes:
    """The figure as SVG, or in the format that figures are printed in."""
    kind = _PRINT.get().format
    if kind == "svg":
        return svg_bytes(figure)
    if kind == "png":
        return png_bytes(figure, dpi=_PRINT_DPI)
    _lay_out(figure)
    out = io.BytesIO()
    figure.savefig(out, format="pdf", metadata={"CreationDate": None, "Creator": None, "Producer": None})
    return out.getvalue()


def vector_drawing(figure: Figure, name: str, section: str, title: str, alt: str, legend: str = "") -> Drawing:
    """A finished figure of lines and words."""
    return Drawing(name, section, title, alt, vector_bytes(figure), "svg", legend=legend)


def png_bytes(figure: Figure, dpi: float = 120.0) -> bytes:
    """The figure as PNG of 256 colours, without the writer's version in it."""
    from PIL import Image

    _lay_out(figure)
    drawn, out = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png", dpi=dpi)
    with Image.open(drawn) as image:
        colours = image.convert("RGB").quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        colours.save(out, format="png")
    return out.getvalue()


def _lay_out(figure: Figure) -> None:

    lay_out(figure)


def compact_path(path: str) -> str:
    """SVG path data rounded to 0.1, its straight runs as relative steps; others rounded as they stand.

    The steps join rounded points, so rounding does not add up along a line.
    """
    tokens = path.split()
    if set("".join(tokens)) & set("CQHVASTclqhvast"):
        return re.sub(r"-?\d+\.\d+", _rounded, path)
    out: list[str] = []
    at, last, i = (0, 0), "", 0
    while i < len(tokens):
        command = tokens[i]
        if command in "zZ":
            out.append(command)
            last, i = command, i + 1
            continue
        point = round(float(tokens[i + 1]) * 10), round(float(tokens[i + 2]) * 10)
        if command == "M":
            out.append(f"M{_tenths(point[0])} {_tenths(point[1])}")
        else:
            step = f"{_tenths(point[0] - at[0])} {_tenths(point[1] - at[1])}"
            out.append(step if last == "L" else f"l{step}")
        at, last, i = point, command, i + 3
    return " ".join(out)


def _tenths(number: int) -> str:
    """A number of tenths as the shortest decimal."""
    whole, part = divmod(abs(number), 10)
    digits = f"{whole or ''}.{part}" if part else str(whole)
    return f"-{digits}" if number < 0 else digits


def _rounded(match: re.Match[str]) -> str:
    return re.sub(r"-?\d+\.\d+", lambda m: f"{float(m[0]):.1f}".removesuffix(".0"), match[0])


def plain(text: str) -> str:
    """Text that matplotlib takes as it stands: no mathematics between dollar signs, no hidden label."""
    text = " ".join(text.split()).replace("$", r"\$")
    return f" {text}" if text.startswith("_") else text


def shortened(text: str, length: int = 34) -> str:
    """Text for a narrow place, its middle left out when it is too long."""
    if len(text) <= length:
        return text
    head = (length - 1) * 2 // 3
    return f"{text[:head]}…{text[len(text) - (length - 1 - head) :]}"


def column_count(panels: int) -> int:
    """Columns of a grid of small multiples."""
    return 1 if panels == 1 else 2 if panels <= 4 else 3


def pages(keys: Sequence[Any], page_limit: int = 2) -> list[list[Any]]:
    """``keys`` in figures of at most MAX_PANELS panels, at most ``page_limit`` figures."""
    kept = list(keys[: MAX_PANELS * page_limit])
    return [kept[i : i + MAX_PANELS] for i in range(0, len(kept), MAX_PANELS)]


def left_out(shown: Sequence[Sequence[Any]], every: Sequence[Any]) -> str:
    """What a caption adds when a figure does not show everything; empty when it does."""
    count = sum(len(page) for page in shown)
    return "" if count == len(every) else f"; {count} of {len(every)} are drawn, all are in products.nc"


def add_legend(figure: Figure, entries: Sequence[tuple[Any, str]], columns: int = 6) -> None:
    """A legend below all panels."""
    figure.legend(
        [handle for handle, _ in entries],
        [plain(label) for _, label in entries],
        loc="outside lower center",
        ncols=columns,
    )


def band_label(axis: SpectralAxis) -> str:
    """What the axis of a figure over bands is called."""
    return "number of the band" if axis.numbered else WAVELENGTH_LABEL


def shade_absorption(axes: Axes, low_nm: float, high_nm: float) -> None:
    """Grey where a gas absorbs; nothing where the axis is of numbers of bands."""
    if low_nm < PLAUSIBLE_NM[0]:
        return
    for start, end, _ in ABSORPTION_BANDS_NM:
        if end > low_nm and start < high_nm:
            axes.axvspan(max(start, low_nm), min(end, high_nm), color=ABSORPTION_COLOUR, linewidth=0, zorder=0)


def log_ticks(axis: Any) -> None:
    """Decade ticks with labels that do not crowd."""
    from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullLocator

    axis.set_major_locator(LogLocator(base=10, numticks=7))
    axis.set_major_formatter(LogFormatterSciNotation(base=10))
    axis.set_minor_locator(NullLocator())


def robust_limits(values: Sequence[Any], *, zero: bool, trim: float = 0.5) -> tuple[float, float] | None:
    """Limits that hold all but ``trim`` per cent of the values at either end, and 0 if asked; None without any."""
    stack = np.concatenate([np.asarray(v, dtype=float).ravel() for v in values]) if values else np.empty(0)
    stack = stack[np.isfinite(stack)]
    if stack.size == 0:
        return None
    low, high = (float(x) for x in np.percentile(stack, [trim, 100.0 - trim]))
    if zero:
        low, high = min(low, 0.0), max(high, 0.0)
    margin = 0.08 * (high - low) or 0.05 * abs(high) or 1.0
    return low - (margin if low < 0 or not zero else 0.0), high + margin
