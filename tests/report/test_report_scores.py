"""Figures of objects, transforms, exceedance and differences of P_D."""

from __future__ import annotations

import io
import tracemalloc
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from PIL import Image
from scipy.stats import norm

from hyperval.figures import (
    Quicklook,
    ScoreMap,
    drawings_of,
    exceedance_figure,
    object_score_figure,
    quicklook_figure,
    roc_difference_figure,
    score_map_figures,
    statement,
    transform_figure,
)
from hyperval.products import ExceedanceCurve, ObjectScores, ObservedProducts, PredictedProducts, RocCurve
from hyperval.spectra import SpectralAxis

AXIS = SpectralAxis(np.linspace(400.0, 900.0, 5), np.full(5, 5.0))


def sides(objects=1):
    rng = np.random.default_rng(1)
    names = [f"target {i} & $x$" for i in range(6)]
    predicted = {(n, "cem"): ObjectScores(rng.normal(0.5, 0.1, (20, 50))) for n in names}
    measured = {(n, "cem"): ObjectScores(rng.normal(0.5, 0.1, objects), tuple(map(str, range(objects)))) for n in names}
    measured[names[0], "cem"] = ObjectScores(np.full(objects, 0.95), ("far",) * objects)
    x = np.linspace(0.0, 4.0, 50)
    p = norm.sf(x)
    pfa = np.geomspace(1e-4, 0.999, 40)
    pd = np.linspace(0.3, 1.0, 40)
    curves = [RocCurve(pfa, y, y - 0.1, np.minimum(y + 0.1, 1.0), norm.isf(pfa), "object", n, b) for y, n, b in (
        (pd, None, None), (np.clip(pd - 0.05, 0, 1), 40, 10_000))]  # fmt: skip
    key = (names[1], "cem", "object")
    return (
        PredictedProducts(AXIS, object_scores=predicted, exceedance={(names[1], "cem"): ExceedanceCurve(x, p, p, p)},
                   roc={key: curves[0]}),
        ObservedProducts(AXIS, object_scores=measured, roc={key: curves[1]},
                    exceedance={(names[1], "cem"): ExceedanceCurve(
                        x[:30], p[:30], p[:30] / 2, np.full(30, np.nan), 9999)}),
    )  # fmt: skip


def printed(function, *arguments):
    return drawings_of([function(*arguments)], simulated=True)


@pytest.mark.parametrize(
    ("function", "arguments", "name"),
    [
        (object_score_figure, (), "object-scores"),
        (transform_figure, (), "object-transforms"),
        (exceedance_figure, (), "exceedance"),
        (roc_difference_figure, (0.1,), "roc-difference"),
    ],
)
def test_each_figure_is_drawn_the_same_twice(function, arguments, name):
    first, again = (printed(function, sides(), *arguments) for _ in range(2))
    assert [d.name for d in first] == [name]
    assert first[0].content == again[0].content
    ElementTree.fromstring(first[0].content)  # noqa: S314 - our own
    assert len(first[0].alt) > 60
    assert statement(function(sides(), *arguments)) == statement(function(sides(), *arguments))


def test_texts_say_what_is_drawn():
    figure = object_score_figure(sides())
    assert "target 0 & $x$ cem: 0.95, predicted 0." in figure.alt
    assert ", outside" in figure.alt
    figure = transform_figure(sides())
    assert "6 objects" in figure.alt
    figure = roc_difference_figure(sides(), None)
    assert "+0.05" in figure.alt


def test_groups_are_judged_together_alone():
    assert object_score_figure(sides(objects=12)) is None
    figure = transform_figure(sides(objects=12))
    assert "72 objects" in figure.alt


def test_pictures_are_drawn_in_little_memory():
    # 0.4 and 14 MB, besides a byte for each point
    shape = (600, 900)
    scene = Quicklook(np.full((*shape, 3), 100, np.uint8))
    scores = {"a": ScoreMap(np.linspace(0.0, 1.0, 600 * 900).reshape(shape))}
    score_map_figures({"a": ScoreMap(np.eye(3))}, simulated=True)  # what is loaded with the first
    tracemalloc.start()
    quicklook_figure(scene, simulated=True)
    scene_peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.reset_peak()
    score_map_figures(scores, simulated=True)
    map_peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert scene_peak < 5e6
    assert map_peak < 20e6


def test_a_map_has_the_colours_of_its_scores_and_says_where_it_is():
    """Pixels of the picture, each so many points wide: white for none, then from dark to bright."""
    values = np.linspace(0.0, 1.0, 200).reshape(10, 20)
    values[0, 0] = np.nan
    outline = np.zeros((10, 20), bool)
    outline[4:6, 8:12] = True
    plain, outlined = (
        score_map_figures({"a": ScoreMap(values, outlines=own, pixel_size_m=size)}, simulated=False)[0]
        for own, size in (({}, None), ({"panel": outline}, 2.0))
    )
    picture, marked = (
        np.asarray(Image.open(io.BytesIO(d.content)).convert("RGB")).astype(int) for d in (plain, outlined)
    )
    assert picture.shape == marked.shape
    top, left = 80, 96
    wide = (picture.shape[1] - left - 190) // 20
    corners = picture[top + wide // 2, left + wide // 2], picture[top + 10 * wide - 4, left + 20 * wide - 4]
    assert corners[0].tolist() == [255, 255, 255], "no score"
    np.testing.assert_allclose(corners[1], [253, 231, 37], atol=2)  # the highest
    np.testing.assert_allclose(picture[top + wide // 2, left + 3 * wide // 2], [68, 1, 84], atol=6)
    edge = marked[top + 4 * wide : top + 6 * wide, left + 8 * wide]
    assert [255, 215, 0] in edge.tolist()
    assert not np.array_equal(picture[-200:, :300], marked[-200:, :300]), "a scale"
    assert outlined.legend == "1 panel"
