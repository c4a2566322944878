"""Figures hold the numbers of the products; statement and print of a figure are the same bytes each time."""

import base64
import dataclasses
import io
import json
import math
import re
import xml.etree.ElementTree as ElementTree
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.stats import norm
from synthetic_run import axis, make_run

from hyperval import figures
from hyperval.products import Abundance, ClassificationError, ExceedanceCurve, ObjectScores, PixelDistribution, RocCurve
from hyperval.results import Outcome, Result, ResultTable, Role
from hyperval.run import Quicklook, ScoreMap

LONG = "field spectrum of a target with a long name"


def stated(figure: figures.Figure) -> list[dict[str, Any]]:
    """The views of a figure as the page's script reads them: each mark with its columns as arrays."""
    whole = json.loads(figures.figure_json(figure))
    arrays = [np.frombuffer(base64.b64decode(text), "<f4") for text in whole["columns"]]
    for view in whole["views"]:
        for mark in (mark for part in view["parts"] for mark in part["marks"]):
            mark["columns"] = {name: arrays[i] for name, i in mark["columns"].items()}
    return whole["views"]


def further(*sides) -> dict[str, figures.Figure]:
    return {figure.name: figure for figure in figures.further_figures(sides, ResultTable(), None)}


@pytest.fixture(scope="module")
def run():
    return make_run(subjects=("grass", "lawn"), curves=5, bands=24)


@pytest.fixture(scope="module")
def sides(run):
    """Both sides with everything that can be drawn, six objects of which one lies far out."""
    rng, names = np.random.default_rng(1), [f"target {i} & $x$" for i in range(6)]
    predicted = {(n, "cem"): ObjectScores(rng.normal(0.5, 0.1, (20, 50))) for n in names}
    measured = {(n, "cem"): ObjectScores(rng.normal(0.5, 0.1, 1), ("0",)) for n in names}
    measured[names[0], "cem"] = ObjectScores(np.array([0.95]), ("far",))
    x = np.linspace(0.0, 4.0, 50)
    p = norm.sf(x)
    tails = ExceedanceCurve(x, p, p, p), ExceedanceCurve(x[:30], p[:30], p[:30] / 2, np.full(30, np.nan), 9999)
    areas = {(f"t{i}", "fcls"): Abundance(a, 0.1 * a, 4, a) for i, a in enumerate((1.0, 1.0, 4.0, 4.0))}
    some = ClassificationError(0.1, 0.08, 0.13, 400, 300.0, 1.0, 0.09, 0.03, 0.2)
    none = ClassificationError(0.0, 0.0, 0.01, 400, 400.0, 9.0, 1e-9, 1e-14, 1e-7)
    errors = {("a / b", "2 bands"): some, ("a / c", "2 bands"): none}
    return tuple(
        dataclasses.replace(
            side, object_scores=objects, exceedance={(names[1], "cem"): tail}, classification=errors,
            abundance={**side.abundance, **areas},
        )
        for side, objects, tail in zip(run.pair, (predicted, measured), tails, strict=True)
    )  # fmt: skip


def reasons() -> list[Result]:
    words = "{}: -3 times its step of 1 %; x".format
    rows = [
        Result("c", "attribution", "all", name, "likelihood_gain", gain, reason=words(name))
        for name, gain in ((LONG, 130.0), ("sensor gain", 5.0), ("blur (2)", 0.2))
    ]
    told = [("attribution", "lawn", LONG, "likelihood_gain", 104.0, math.nan)]
    gains = [*(("lawn", f"input {i}", 9.0 + i) for i in range(14)), ("grass", "one of its own", 2.5)]
    told += [("attribution", *names, "likelihood_gain", gain, math.nan) for *names, gain in gains]
    told += [("attribution", "radiance of lawn", "sensor gain", "reduced_chi_square", 1.1, 9.3)]
    told += [
        ("sensitivity", f"all of the materials {i} m", f"{LONG} / cem/pixel", "roc_pd@1e-2_change", 0.01 * i, -0.2)
        for i in range(1, 5)
    ]
    told += [("what-if", "all", name, "reduced_chi_square", x, 1.5) for name, x in (("near", 1.2), ("far", 2.2))]
    rows += [Result("c", *names, value, before=before) for *names, value, before in told]
    return rows + [
        Result("c", "abundance", f"all targets of {a} m2", "fcls", f"area_rmse_{side}", 0.2, "m2", lower=0.1, upper=0.5)
        for a in (1, 4) for side in ("predicted", "observed")
    ]  # fmt: skip


def every_figure(sides) -> dict[str, figures.Figure]:
    d = np.linspace(0.5, 9.0, 30)
    law = PixelDistribution(leading_tail_dof=6.0, leading_dimension=4, n=900, distance=d**2, exceedance=np.exp(-d))
    spread = {"grass": sides[0].radiance["grass"].pixel_covariance, "lawn": None}
    radiance = {n: dataclasses.replace(sides[1].radiance[n], pixel_covariance=c) for n, c in spread.items()}
    sides = sides[0], dataclasses.replace(sides[1], radiance=radiance, distribution={"grass": law})
    made = [*figures.first_figures(sides), *figures.further_figures(sides, ResultTable(reasons()), 0.1)]
    made += [
        figures.densities_figure([("one", sides[0]), ("other", sides[1])]),
        figures.criteria_figure(list(make_run().table)),
    ]
    return {figure.name: figure for figure in made}


@pytest.fixture(scope="module")
def charts(sides):
    return every_figure(sides)


@pytest.fixture(scope="module")
def drawings(charts):
    return {drawing.name: drawing for drawing in figures.drawings_of(list(charts.values()), simulated=True)}


def words_of(drawing) -> list[str]:
    """Labels, which matplotlib keeps as comments."""
    return re.findall(r"<!-- (.*?) -->", drawing.content.decode())


def test_each_figure_is_the_same_again_and_told_in_words(sides, charts, drawings):
    """Whatever was drawn before, in a page and on paper; nothing is left to those who see alone."""
    again = every_figure(sides)
    assert {name: figures.figure_json(figure) for name, figure in charts.items()} == {
        n: figures.figure_json(f) for n, f in again.items()
    }
    (drawn,) = figures.drawings_of([again["attribution-effects"]], simulated=True)
    assert drawings[drawn.name].content == drawn.content
    assert set(charts) == set(drawings) == {
        "radiance", "snr", "reflectance", "roc", "radiance-budget", "radiance-eigenvalues", "pixel-tails",
        "class-error", "scores", "object-scores", "object-transforms", "exceedance", "roc-difference", "abundance",
        "unmixing-areas", "attribution-inputs", "attribution-subjects", "attribution-effects", "what-ifs", "densities",
        "criteria", "residuals",
    }  # fmt: skip
    for drawing in drawings.values():
        ElementTree.fromstring(drawing.content)  # noqa: S314 - our own
        assert len(drawing.alt) > 60
        assert any("(simulated collection)" in word for word in words_of(drawing)), drawing.name


def test_the_words_of_a_figure_have_its_numbers(charts):
    for name, words in {
        "radiance-eigenvalues": ("grass (n = 150): predicted, ", "13 of 13 measured inside"),
        "pixel-tails": ("6 degrees of freedom measured",),
        "class-error": ("predicted: a / b, 2 bands: 0.1 (0.08 to 0.13)",),
        "unmixing-areas": ("predicted: 0.2 m² at 1 m², 0.2 m² at 4 m²",),
        "object-scores": ("predicted: target 0 & $x$, cem: 0.", "cem: 0.95;", "1 of 6 outside"),
        "object-transforms": ("6 objects", "probability integral transform over uniform quantile"),
        "roc-difference": (") at 0.00996",),
        "what-ifs": ("from 1.5 to 1.2",),
        "attribution-subjects": (f"lawn: {LONG}",),
    }.items():
        assert all(word in charts[name].alt for word in words), name


def test_nothing_to_draw(run):
    nothing = tuple(type(side)(side.axis) for side in run.pair)
    assert [*figures.first_figures(nothing), *further(*nothing)] == []
    assert figures.densities_figure([("one", nothing[0])]) is None


def test_spectra_hold_both_sides_and_their_difference(run):
    figure = figures.spectra_figure(run.pair, "radiance")
    assert [view.subject for view in figure.views] == ["grass", "lawn"]
    above, below = stated(figure)[0]["parts"]
    assert (below["y"]["label"], "95 %" in figure.caption) == ("predicted / measured − 1", True)
    predicted, measured = run.pair[0].radiance["grass"], run.pair[1].radiance["grass"]
    p, m, u = predicted.mean, measured.mean, predicted.standard_uncertainty
    ratio_u = np.hypot(u / m, p * measured.standard_uncertainty / m**2)
    for mark, value, own_u in (
        (above["marks"][0], m, measured.standard_uncertainty),
        (above["marks"][1], p, u),
        (below["marks"][0], p / m - 1.0, ratio_u),
    ):
        np.testing.assert_allclose(mark["columns"]["x"], run.pair[0].axis.centre_nm, rtol=1e-6)
        np.testing.assert_allclose(mark["columns"]["y"], value, rtol=1e-5, atol=1e-7)
        np.testing.assert_allclose(mark["columns"]["half"], norm.isf(0.025) * own_u, rtol=1e-5)
    assert [mark["dash"] for mark in above["marks"]] == ["solid", "dashed"]
    # Wavelengths of all subjects stand once, and a half-width in place of two limits: room for pictures.
    assert len(json.loads(figures.figure_json(figure))["columns"]) == 1 + 2 * 3 * 2


def test_sides_without_a_difference_have_none_drawn(run):
    same = figures.spectra_figure((run.pair[0], run.pair[0]), "radiance")
    assert ("which are identical" in same.title, same.caption.count("grey: absorption bands")) == (True, 1)
    assert [len(view.parts) for view in same.views] == [1, 1]
    axis_of = run.pair[1].axis
    moved = dataclasses.replace(run.pair[1], axis=dataclasses.replace(axis_of, centre_nm=axis_of.centre_nm + 40.0))
    for other in (moved, None):
        alone = figures.spectra_figure((run.pair[0], other), "radiance")
        assert [mark.label for view in alone.views for mark in view.parts[0].marks] == ["predicted"] * 2
    assert figures.spectra_figure((run.pair[0], dataclasses.replace(run.pair[1], snr={})), "snr") is None
    one = dataclasses.replace(run.pair[0], snr={"grass": run.pair[0].snr["grass"]})
    compared = figures.spectra_figure((one, run.pair[1]), "snr")
    assert compared.title.endswith("; 1 of 2 shown, all in products.nc")
    assert ("grass" in compared.alt, "lawn" in compared.alt, stated(compared)[0]["note"]) == (True, False, "grass")


def test_the_subject_that_disagrees_stands_first_and_their_number_is_bounded(run):
    row = Result("r", "radiance", "lawn", "m", "p_value_full", 0.0, role=Role.GATE, outcome=Outcome.DISAGREES)
    figure = figures.spectra_figure(run.pair, "radiance", [row])
    assert [view.subject for view in figure.views] == ["lawn", "grass"]
    many = make_run(bands=6, subjects=[f"s{i}" for i in range(30)], curves=0, shape=(4, 4))
    figure = figures.spectra_figure(many.pair, "snr")
    assert len(figure.views) == figures.MAX_SUBJECTS
    assert figure.title.endswith("; 24 of 30 shown, all in products.nc")


def test_a_side_alone(run):
    """Bands may go by number; ends of axes take in a single value, and rules that lie near."""
    numbered = dataclasses.replace(run.pair[1].axis, centre_nm=np.arange(1.0, 25.0), fwhm_nm=np.ones(24))
    told, side = (dataclasses.replace(one, axis=numbered, provenance={"quantity": "counts"}) for one in run.pair)
    assert figures.spectra_figure((told, side), "reflectance").views[0].words.startswith("median absolute difference 0")
    figure = figures.spectra_figure((None, side), "reflectance")
    assert [figure.views[0].x.label, figure.views[0].parts[0].y.label] == ["number of the band", "counts"]
    assert "absorption" not in figure.caption + figures.figure_json(figure)
    known = figures.spectra_figure((None, run.pair[1]), "reflectance")
    assert [685.0, 693.0] in json.loads(figures.figure_json(known))["absorption"]
    part = figures.Part(figures.Axis("y"), (figures.Mark("line", {"x": [1.0], "y": [5.0]}),))
    low, high = figures.Panels(figures.Axis("x"), (part,)).limits("y", part)
    assert low < 5.0 < high, "a single value has an axis"
    line = figures.Mark("line", {"x": [1, 2], "y": [2.0, 3.0]})
    part = figures.Part(figures.Axis("y"), (line,), (("y", 1.5), ("y", 0.1)))
    assert 1.3 < figures.Panels(figures.Axis("x"), (part,)).limits("y", part)[0] < 1.5, "of rules that which lies near"


def test_curves_have_a_tab_a_detector_and_of_long_or_many_what_matters_is_drawn(run, charts):
    """Curves are thinned from end to end; pools of targets have the first place among too many."""
    figure = charts["roc"]
    assert list(dict.fromkeys(view.tab for view in figure.views)) == ["CEM, by pixel", "CEM, by object"]
    (part,) = figure.views[0].parts
    assert [(mark.kind, mark.dash) for mark in part.marks] == [("line", "dashed"), ("steps", "solid")]
    assert (figure.together, part.rules) == ("first", (("x", 1.0 / 12203),))
    assert ("12\u202f203 background samples" in figure.views[0].note, figure.caption[-13:]) == (True, "95 % interval")
    pfa = np.geomspace(1e-6, 1.0, 50_000)
    curve = RocCurve(pfa, *(np.sqrt(pfa),) * 3, pfa)
    held = {(f"t{i}", "cem", "pixel"): dataclasses.replace(curve, n_target=i) for i in range(30)}
    made = figures.first_figures((None, dataclasses.replace(run.pair[1], roc=held)))
    figure = next(f for f in made if f.name == "roc")
    assert [view.subject for view in figure.views] == [f"t{i}" for i in range(6, 30)]
    columns = stated(figure)[0]["parts"][0]["marks"][0]["columns"]
    assert columns["x"].size <= 200
    np.testing.assert_allclose(columns["x"][[0, -1]], [1e-6, 1.0], rtol=1e-3)
    np.testing.assert_allclose(columns["y"], np.sqrt(columns["x"]), rtol=1e-5)


def test_statements_hold_the_numbers_and_a_view_each(charts):
    """The ratio below eigenvalues is that of the columns above; of classes without error the axis has an end."""
    predicted, measured, ratio = (m.columns for p in charts["radiance-eigenvalues"].views[0].parts for m in p.marks)
    np.testing.assert_allclose(predicted["y"] / measured["y"], ratio["y"], rtol=1e-6)
    assert np.all((ratio["low"] < 1.0) & (ratio["high"] > 1.0))
    (view,) = charts["class-error"].views
    assert view.limits("x", view.parts[0])[0] > 0.0
    assert [place for _, place in charts["roc-difference"].views[0].parts[0].rules] == [0.0, -0.1, 0.1]
    many = dataclasses.replace(charts["unmixing-areas"], views=charts["unmixing-areas"].views * 24)
    sheets = figures.drawings_of([many], simulated=False)
    assert [sheet.name for sheet in sheets] == ["unmixing-areas-1", "unmixing-areas-2"]


def test_reasons_are_told_by_shape_and_number_not_by_colour_alone(charts, drawings):
    inputs, effects, what_ifs = (charts[n] for n in ("attribution-inputs", "attribution-effects", "what-ifs"))
    (bars,) = stated(inputs)[0]["parts"]
    assert bars["marks"][0]["columns"]["right"].tolist() == pytest.approx([130.0, 5.0, 0.2])
    assert bars["marks"][0]["words"][0] == "−3 times its step of 1 %"
    assert "one of several" in inputs.legend
    (cells,) = stated(effects)[0]["parts"]
    assert list(cells["marks"][0]["words"]) == ["+1", "+2", "+3", "+4"], "percent: a cell is no wider"
    looks = {(m.marker, m.beside) for m in what_ifs.views[0].parts[0].marks}
    assert looks == {("circle", ""), ("left", "left"), ("right", "right")}, "no number on a line"
    assert {"after, closer", "after, farther"} <= set(words_of(drawings["what-ifs"]))
    assert {"104", "2.5"} <= set(words_of(drawings["attribution-subjects"])), "the greatest of each, among many"
    quiet = ResultTable([dataclasses.replace(row, value=0.1) for row in reasons()])
    assert "attribution-inputs" not in {f.name for f in figures.further_figures((None, None), quiet, None)}
    # Labels stay inside: each is a group that is moved to where its first letter stands.
    assert "all of the materials 4 m, P_D at P_FA 1e-2, cem (gap −20 %)" in words_of(drawings["attribution-effects"])
    text = drawings["attribution-effects"].content.decode()
    assert min(float(x) for x in re.findall(r'<g transform="translate\((-?[\d.]+) ', text)) >= 0.0


def test_many_objects_are_a_map_and_a_histogram_and_groups_are_judged_together_alone(run):
    """A map of 50 objects of two subjects in a row, the measured scores 0.1 above the predicted median."""
    rng = np.random.default_rng(5)
    outlines, predicted, measured = {}, {}, {}
    for number, subject in enumerate(("large", "small")):
        names = tuple(f"{subject}-{i:02d}" for i in range(25))
        for i, name in enumerate(names):
            outlines[name] = np.zeros((9, 120), bool)
            outlines[name][2 + 4 * number, 4 * i : 4 * i + 2] = True
        draws = rng.normal(0.5 + number, 0.05, (400, 5))
        predicted[subject, "cem"] = ObjectScores(draws)
        measured[subject, "cem"] = ObjectScores(np.full(25, np.median(draws) + 0.1), names)
    sides = [type(s)(axis(2), object_scores=x) for s, x in ((run.pair[0], predicted), (run.pair[1], measured))]
    score_map = ScoreMap(np.zeros((9, 120)), outlines=outlines)
    place, scores = stated(figures.many_objects_figure({"planks-cem": score_map}, sides))[0]["parts"]
    (dots,) = place["marks"]
    np.testing.assert_allclose(dots["columns"]["value"], 0.1, atol=1e-6)
    assert (dots["columns"]["y"][0], dots["columns"]["x"][0]) == (2.5, 1.0), "the middle of its two pixels"
    assert dots["words"][0].startswith("large-00: measured ")
    assert (dots["scale"]["low"], dots["scale"]["high"]) == pytest.approx((-0.1, 0.1))
    counted, expected, below = scores["marks"]
    assert counted["columns"]["top"].sum() == len(dots["words"]) == 50
    assert expected["columns"]["y"][:-1].sum() == pytest.approx(50.0)
    assert (dots["linked"], below["linked"]) == (True, True), "a selection in one is highlighted in the other"
    few = dataclasses.replace(score_map, outlines=dict(list(outlines.items())[:40]))
    for name, maps in (("planks-cem", few), ("planks-ace", score_map)):  # a list has room; another detector's map
        assert figures.many_objects_figure({name: maps}, sides) is None
    assert figures.many_objects_figure({"planks-cem": score_map}, (sides[0], None)) is None
    groups = further(*sides)
    assert "object-scores" not in groups
    assert "50 objects" in groups["object-transforms"].alt


@pytest.mark.parametrize("name", ["radiance", "roc", "object-scores", "attribution-effects", "densities", "criteria"])
def test_panels_and_their_labels_do_not_overlap(charts, name):
    with figures.house_style():
        if name == "densities":  # one panel, with a label as long as a study may have
            object.__setattr__(charts[name].views[0].parts[0].y, "label", f"{LONG}, {LONG}")
        canvas = figures.draw_views(charts[name], charts[name].views, simulated=True)
        canvas.canvas.draw()
        renderer = canvas.canvas.get_renderer()
        boxes = [axes.get_tightbbox(renderer) for axes in canvas.axes]
    boxes += [words.get_window_extent(renderer) for words in (canvas._suptitle, *canvas.legends)]
    for i, one in enumerate(boxes):
        assert min(one.x0, one.y0, canvas.bbox.x1 - one.x1, canvas.bbox.y1 - one.y1) > -1
        for other in boxes[i + 1 :]:
            shared = min(one.x1, other.x1) - max(one.x0, other.x0), min(one.y1, other.y1) - max(one.y0, other.y0)
            assert min(shared) < 1, (one, other)


def pixels(drawing) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(drawing.content)).convert("RGB")).astype(int)


def test_a_map_has_the_colours_of_its_scores_and_says_where_it_is():
    """Pixels of the picture, each so many points wide: white for none, then from dark to bright."""
    values, outline = np.linspace(0.0, 1.0, 200).reshape(10, 20), np.zeros((10, 20), bool)
    values[0, 0], outline[4:6, 8:12] = np.nan, True
    maps = (ScoreMap(values), ScoreMap(values, outlines={"panel": outline}, pixel_size_m=2.0))
    plain, outlined = (figures.draw_pictures(None, {"a": one}, simulated=False)[0] for one in maps)
    picture, marked = pixels(plain), pixels(outlined)
    top, left = 80, 96
    wide = (picture.shape[1] - left - 190) // 20
    none, lowest, highest = (picture[top + y * wide // 2, left + x * wide // 2] for y, x in ((1, 1), (1, 3), (19, 39)))
    assert none.tolist() == [255, 255, 255]
    np.testing.assert_allclose(lowest, [68, 1, 84], atol=6)
    np.testing.assert_allclose(highest, [253, 231, 37], atol=2)
    edges = [marked[top + 5 * wide - 3 : top + 5 * wide + 3, left + at * wide].tolist() for at in (8, 12, 9, 10)]
    assert [[255, 215, 0] in edge for edge in edges] == [True, True, False, False], "around the region, not through it"
    assert not np.array_equal(picture[-200:, :300], marked[-200:, :300]), "a scale"
    assert outlined.legend == "1: panel"


def test_a_target_of_one_pixel_is_seen_in_a_large_map():
    values = np.zeros((1700, 1700))
    values[5:900, 0:40] = np.nan
    values[1203, 704] = 9.0
    (drawing,) = figures.draw_pictures(None, {"a": ScoreMap(values)}, simulated=False)
    assert "each point is the largest score of 3 by 3 pixels" in drawing.title
    bright = np.abs(pixels(drawing) - [253, 231, 37]).max(axis=-1)[:, :-190] <= 2
    assert [place.tolist() for place in np.nonzero(bright)] == [[80 + 1203 // 3], [96 + 704 // 3]]


@pytest.mark.parametrize(
    ("turned", "shown"),
    [(False, "lines 490 to 529 of 1000, samples 0 to 99 of 100"),
     (True, "lines 0 to 99 of 100, samples 490 to 529 of 1000")],
)  # fmt: skip
def test_a_long_strip_is_cut_to_its_regions(turned, shown):
    mask = np.zeros((1000, 100), bool)
    mask[500:520, 40:50] = True
    for own, cut in ((mask, shown), (mask & False, ""), (np.zeros((300, 200), bool), "")):
        own = own.T if turned else own
        look = Quicklook(np.full((*own.shape, 3), 9, np.uint8), {"a": own})
        (drawing,) = figures.draw_pictures(look, {}, simulated=False)
        assert drawing.title.partition("; ")[2] == cut
