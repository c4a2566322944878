"""Panels stand beside each other: no labels over panels, nothing beyond the paper."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hyperval.figures import Axis, ColourScale, Figure, Mark, Panels, Part
from hyperval.figures.print import canvas_of, house_style


def sheet(panels: int, *, scaled: bool = False, notes: bool = False) -> Figure:
    line = Mark("line", {"x": [0.0, 1.0], "y": [0.0, 123456.789], "half": [1.0, 1.0]}, "interval")
    edges = {"left": [0.0, 1.0], "right": [1.0, 2.0], "bottom": [0.0, 0.0], "top": [1.0, 1.0], "value": [0.0, 1.0]}
    marks = (Mark("cells", edges, scale=ColourScale("rising", 0.0, 1.0, "score")),) if scaled else (line,)
    y = Axis("radiance [unit]")
    if notes:
        y = Axis("", "names", ("a name", "another"), notes=("3 [1-6]", "12 [1-99]"))
        marks = (Mark("dots", {"x": [1.0, 2.0], "y": [0.0, 1.0]}, "may be first", marker="circle"),)
    views = tuple(Panels(Axis("wavelength [nm]"), (Part(y, marks),), f"panel {i}") for i in range(panels))
    return Figure("sheet", "roc", "A title", "", views)


@pytest.mark.parametrize(
    ("panels", "options"),
    [(1, {}), (1, {"scaled": True}), (2, {}), (12, {}), (3, {"notes": True})],
)
def test_panels_and_their_labels_do_not_overlap(panels, options):
    figure = sheet(panels, **options)
    with house_style():
        canvas = canvas_of(figure, figure.views, simulated=True)
        canvas.canvas.draw()
        renderer = canvas.canvas.get_renderer()
        boxes = [axes.get_tightbbox(renderer) for axes in canvas.axes]
    everything = [*boxes, canvas._suptitle.get_window_extent(renderer)]
    everything += [legend.get_window_extent(renderer) for legend in canvas.legends]
    for i, one in enumerate(everything):
        assert min(one.x0, one.y0) > -1
        assert one.x1 < canvas.bbox.x1 + 1
        assert one.y1 < canvas.bbox.y1 + 1
        for other in everything[i + 1 :]:
            assert min(one.x1, other.x1) - max(one.x0, other.x0) < 1 or (
                min(one.y1, other.y1) - max(one.y0, other.y0) < 1
            ), (one, other)


def test_a_single_value_has_an_axis():
    (view,) = sheet(1).views
    flat = Mark("line", {"x": [1.0], "y": [5.0]})
    one = dataclasses.replace(view, parts=(Part(Axis("y"), (flat,)),))
    assert np.all(np.isfinite([*one.ends("x"), *one.ends("y", one.parts[0])]))
    assert one.ends("y", one.parts[0])[0] < 5.0 < one.ends("y", one.parts[0])[1]
