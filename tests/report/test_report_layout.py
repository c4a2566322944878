"""Panels stand beside each other: no labels over panels, nothing beyond the paper."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.patches import Patch

from hyperval.report import style
from hyperval.report.style import lay_out


@pytest.mark.parametrize(("rows", "columns", "bar"), [(1, 1, False), (1, 1, True), (2, 1, False), (4, 3, False)])
def test_panels_and_their_labels_do_not_overlap(rows, columns, bar):
    with style.house_style():
        figure = style.new_figure(10.0, 1.0 + 2.6 * rows, "A title", simulated=True)
        for at in range(rows * columns):
            axes = figure.add_subplot(rows, columns, at + 1)
            image = axes.imshow(np.eye(3), aspect="auto") if bar else axes.plot([0, 1], [0.0, 123456.789 * at])
            axes.set_title(f"panel {at}", loc="left")
            axes.set_ylabel("radiance\n[unit]")
            axes.set_xlabel("wavelength [nm]")
        if bar:
            figure.colorbar(image, ax=axes, label="score [1]")
        style.add_legend(figure, [(Patch(color="red"), "interval")])
        lay_out(figure)
        renderer = figure.canvas.get_renderer()
        boxes = [axes.get_tightbbox(renderer) for axes in figure.axes]
    title, legend = figure._suptitle.get_window_extent(renderer), figure.legends[0].get_window_extent(renderer)
    everything = [*boxes, title, legend]
    for i, one in enumerate(everything):
        assert one.x0 > -1
        assert one.y0 > -1
        assert one.x1 < figure.bbox.x1 + 1
        assert one.y1 < figure.bbox.y1 + 1
        for other in everything[i + 1 :]:
            assert min(one.x1, other.x1) - max(one.x0, other.x0) < 1 or (
                min(one.y1, other.y1) - max(one.y0, other.y0) < 1
            ), (one, other)


def test_words_beside_a_panel_keep_clear_of_the_next_one():
    figure = style.new_figure(8.0, 2.0, "A title", simulated=False)
    panels = figure.subplots(1, 3)
    for axes in panels:
        axes.annotate(
            "3 [1-6]", (1.0, 0.5), xycoords=("axes fraction", "data"), xytext=(3, 0), textcoords="offset points"
        )
    lay_out(figure)
    renderer = figure.canvas.get_renderer()
    ends = [axes.texts[0].get_window_extent(renderer).x1 for axes in panels]
    starts = [axes.yaxis.get_tightbbox(renderer).x0 for axes in panels]
    assert all(end < start for end, start in zip(ends, [*starts[1:], figure.bbox.x1], strict=True))
