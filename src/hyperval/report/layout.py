"""Places of the axes of a figure, measured once.

matplotlib's own layout engine measures every label of every panel four times, which was half of the time that a
figure takes; panels of one grid need their widest labels alone.
"""

from __future__ import annotations

from itertools import accumulate
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Annotation

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
    panels = [
        axes for axes in figure.axes if axes.get_label() != "<colorbar>" and axes.get_subplotspec() is not None
    ]
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
