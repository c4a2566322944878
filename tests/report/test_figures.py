"""Figures hold the numbers of the products; statement and print of a figure are the same bytes each time."""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import re
import tracemalloc
import xml.etree.ElementTree as ElementTree
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.stats import norm
from synthetic_run import axis, make_run

from hyperval.figures import (
    MOST_SUBJECTS,
    Axis,
    ColourScale,
    EigenvalueSpectrum,
    Figure,
    Mark,
    Panels,
    Part,
    Quicklook,
    ScoreMap,
    TailCurve,
    canvas_of,
    densities_figure,
    draw_pictures,
    drawings_of,
    first_figures,
    further_figures,
    house_style,
    many_objects_figure,
    spectra_figure,
    statement,
)
from hyperval.products import Abundance, ClassificationError, ExceedanceCurve, ObjectScores, RocCurve
from hyperval.results import Outcome, Result, ResultTable, Role
from hyperval.run import to_arrays

LONG = "field spectrum of a target with a long name"


def stated(figure: Figure) -> dict[str, Any]:
    """A figure as the page's script reads it: each mark with its columns as arrays."""
    whole: dict[str, Any] = json.loads(statement(figure))
    arrays = [np.frombuffer(base64.b64decode(text), "<f4") for text in whole["columns"]]
    for view in whole["views"]:
        for mark in (mark for part in view["parts"] for mark in part["marks"]):
            mark["columns"] = {name: arrays[i] for name, i in mark["columns"].items()}
    return whole


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
    law = ExceedanceCurve(x, p, p, p)
    found = ExceedanceCurve(x[:30], p[:30], p[:30] / 2, np.full(30, np.nan), 9999)
    areas = {(f"t{i}", "fcls"): Abundance(a, 0.1 * a, 4, a) for i, a in enumerate((1.0, 1.0, 4.0, 4.0))}
    some = ClassificationError(0.1, 0.08, 0.13, 400, 300.0, 1.0, 0.09, 0.03, 0.2)
    none = ClassificationError(0.0, 0.0, 0.01, 400, 400.0, 9.0, 1e-9, 1e-14, 1e-7)
    errors = {("a / b", "2 bands"): some, ("a / c", "2 bands"): none}
    return tuple(
        dataclasses.replace(
            side, object_scores=objects, exceedance={(names[1], "cem"): tail}, classification=errors,
            abundance={**side.abundance, **areas},
        )
        for side, objects, tail in ((run.prediction, predicted, law), (run.observation, measured, found))
    )  # fmt: skip


def reasons() -> list[Result]:
    rows = [
        Result("c", "attribution", "all", name, "likelihood_gain", gain, reason=f"{name}: -3 times its step of 1 %; x")
        for name, gain in ((LONG, 130.0), ("sensor gain", 5.0), ("blur (2)", 0.2))
    ]
    rows += [Result("c", "attribution", "lawn", LONG, "likelihood_gain", 104.0)]
    for i in range(1, 5):
        subject, method = f"all of the materials {i} m", f"{LONG} / cem/pixel"
        rows.append(Result("c", "sensitivity", subject, method, "roc_pd@1e-2_change", 0.01 * i, reason="gap 0.2"))
    for name, after in (("closer", 1.2), ("farther", 2.2)):
        rows.append(Result("c", "what-if", "all", name, "reduced_chi_square", after, reason="1.5 before"))
    return rows + [
        Result("c", "abundance", f"all targets of {a} m2", "fcls", f"area_rmse_{side}", 0.2, "m2", lower=0.1, upper=0.5)
        for a in (1, 4) for side in ("predicted", "observed")
    ]  # fmt: skip


def every_figure(sides) -> dict[str, Figure]:
    e, d = np.geomspace(10.0, 1e-4, 20), np.linspace(0.5, 9.0, 30)
    spread = {("grass $x$", "radiance"): EigenvalueSpectrum(1.02 * e, e, 0.95 * e, 1.05 * e, 5000)}
    share = np.exp(-d)
    tails = {"grass": TailCurve(d, share, 0.8 * share, 1.2 * share, None, share**2, share, None, 6.0, 4, 900)}
    made = [*first_figures(sides), *further_figures(sides, ResultTable(reasons()), spread, tails, 0.1)]
    made.append(densities_figure([("one", sides[0]), ("other", sides[1])]))
    return {figure.name: figure for figure in made}


@pytest.fixture(scope="module")
def figures(sides):
    return every_figure(sides)


@pytest.fixture(scope="module")
def drawings(figures):
    return {drawing.name: drawing for drawing in drawings_of(list(figures.values()), simulated=True)}


def words_of(drawing) -> list[str]:
    """Labels, which matplotlib keeps as comments."""
    return re.findall(r"<!-- (.*?) -->", drawing.content.decode())


def test_each_figure_is_the_same_again_and_told_in_words(sides, figures, drawings):
    """Whatever was drawn before, in a page and on paper; nothing is left to those who see alone."""
    again = every_figure(sides)
    assert {name: statement(figure) for name, figure in figures.items()} == {n: statement(f) for n, f in again.items()}
    reprinted = {drawing.name: drawing.content for drawing in drawings_of(list(again.values()), simulated=True)}
    assert {name: drawing.content for name, drawing in drawings.items()} == reprinted
    assert set(figures) == set(drawings) == {
        "radiance", "snr", "reflectance", "roc", "radiance-budget", "radiance-eigenvalues", "pixel-tails",
        "class-error", "scores", "object-scores", "object-transforms", "exceedance", "roc-difference", "abundance",
        "unmixing-areas", "attribution-inputs", "attribution-subjects", "attribution-effects", "what-ifs", "densities",
    }  # fmt: skip
    for drawing in drawings.values():
        ElementTree.fromstring(drawing.content)  # noqa: S314 - our own
        assert len(drawing.alt) > 60
        assert any("(simulated collection)" in word for word in words_of(drawing)), drawing.name


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("radiance-eigenvalues", "20 of 20 inside"),
        ("pixel-tails", "6 degrees of freedom measured"),
        ("class-error", "a / b, 2 bands: predicted 0.1 (0.08 to 0.1)"),
        ("unmixing-areas", "predicted: 0.2 m² at 1 m², 0.2 m² at 4 m²"),
        ("object-scores", "target 0 & $x$ cem: 0.95, predicted 0."),
        ("object-scores", ", outside"),
        ("object-transforms", "6 objects"),
        ("roc-difference", "at P_FA"),
        ("what-ifs", "from 1.5 to 1.2"),
        ("attribution-subjects", f"lawn: {LONG}"),
    ],
)
def test_the_words_of_a_figure_have_its_numbers(figures, name, words):
    assert words in figures[name].alt


def test_nothing_to_draw(run):
    nothing = tuple(type(side)(side.axis) for side in (run.prediction, run.observation))
    assert first_figures(nothing) == further_figures(nothing, ResultTable(), {}, {}, None) == []
    assert densities_figure([("one", nothing[0])]) is None


def test_spectra_hold_both_sides_and_their_difference(run):
    whole = stated(spectra_figure((run.prediction, run.observation), "radiance"))
    assert [view["subject"] for view in whole["views"]] == ["grass", "lawn"]
    above, below = whole["views"][0]["parts"]
    predicted, measured = run.prediction.radiance["grass"], run.observation.radiance["grass"]
    p, m, u = predicted.mean, measured.mean, predicted.standard_uncertainty
    ratio_u = np.hypot(u / m, p * measured.standard_uncertainty / m**2)
    for mark, value, own_u in (
        (above["marks"][0], m, measured.standard_uncertainty),
        (above["marks"][1], p, u),
        (below["marks"][0], p / m - 1.0, ratio_u),
    ):
        np.testing.assert_allclose(mark["columns"]["x"], run.prediction.axis.centre_nm, rtol=1e-6)
        np.testing.assert_allclose(mark["columns"]["y"], value, rtol=1e-5, atol=1e-7)
        np.testing.assert_allclose(mark["columns"]["half"], norm.isf(0.025) * own_u, rtol=1e-5)
    assert [mark["dash"] for mark in above["marks"]] == ["solid", "dashed"]
    # Wavelengths of all subjects stand once, and a half-width in place of two limits: room for pictures.
    assert len(whole["columns"]) == 1 + 2 * 3 * 2


def test_sides_without_a_difference_have_none_drawn(run):
    same = spectra_figure((run.prediction, run.prediction), "radiance")
    assert "which are identical" in same.title
    assert [len(view.parts) for view in same.views] == [1, 1]
    axis_of = run.observation.axis
    moved = dataclasses.replace(run.observation, axis=dataclasses.replace(axis_of, centre_nm=axis_of.centre_nm + 40.0))
    view = spectra_figure((run.prediction, moved), "radiance").views[0]
    assert [mark.label for part in view.parts for mark in part.marks] == ["predicted"]
    alone = spectra_figure((run.prediction, None), "reflectance")
    assert [mark.label for mark in alone.marks()] == ["predicted"] * 2
    assert spectra_figure((run.prediction, dataclasses.replace(run.observation, snr={})), "snr") is None
    one = dataclasses.replace(run.prediction, snr={"grass": run.prediction.snr["grass"]})
    compared = spectra_figure((one, run.observation), "snr")
    assert compared.title.endswith("; 1 of 2 are drawn, all are in products.nc")
    assert ("grass" in compared.alt, "lawn" in compared.alt) == (True, False)


def test_the_subject_that_disagrees_stands_first_and_their_number_is_bounded(run):
    row = Result("r", "radiance", "lawn", "m", "p_value_full", 0.0, role=Role.GATE, outcome=Outcome.DISAGREES)
    figure = spectra_figure((run.prediction, run.observation), "radiance", [row])
    assert [view.subject for view in figure.views] == ["lawn", "grass"]
    many = make_run(bands=6, subjects=[f"s{i}" for i in range(30)], curves=0, shape=(4, 4))
    figure = spectra_figure((many.prediction, many.observation), "snr")
    assert len(figure.views) == MOST_SUBJECTS
    assert figure.title.endswith("; 24 of 30 are drawn, all are in products.nc")


def test_bands_that_go_by_number_are_called_so(run):
    bands = len(run.observation.axis)
    numbered = dataclasses.replace(run.observation.axis, centre_nm=np.arange(1.0, bands + 1.0), fwhm_nm=np.ones(bands))
    observed = dataclasses.replace(run.observation, axis=numbered, roc={})
    figure = spectra_figure((None, observed), "reflectance")
    assert figure.views[0].x.label == "number of the band"
    assert "absorption" not in figure.title + statement(figure)
    assert to_arrays(observed)["wavelength"][2] == {"units": "1", "long_name": "number of the band"}
    known = spectra_figure((None, run.observation), "reflectance")
    assert [685.0, 693.0] in json.loads(statement(known))["absorption"]
    assert "against wavelength" in known.alt


def test_curves_have_a_tab_a_detector_and_may_stand_over_each_other(run, figures):
    figure = figures["roc"]
    assert list(dict.fromkeys(view.tab for view in figure.views)) == ["CEM, by pixel", "CEM, by object"]
    assert figure.together == "first"
    marks = figure.views[0].parts[0].marks
    assert [(mark.kind, mark.dash) for mark in marks] == [("line", "dashed"), ("steps", "solid")]
    assert figure.views[0].parts[0].rules == (("x", 1.0 / 12203),)
    assert "12\u202f203 background px" in figure.views[0].note


def test_of_long_or_many_curves_what_matters_is_drawn(run):
    """Curves are thinned from end to end; pools of targets have the first place among too many."""
    pfa = np.geomspace(1e-6, 1.0, 50_000)
    curve = RocCurve(pfa, *(np.sqrt(pfa),) * 3, pfa)
    held = {(f"t{i}", "cem", "pixel"): dataclasses.replace(curve, n_target=i) for i in range(30)}
    (figure,) = (
        one for one in first_figures((None, dataclasses.replace(run.observation, roc=held))) if one.name == "roc"
    )
    assert [view.subject for view in figure.views] == [f"t{i}" for i in range(6, 30)]
    columns = stated(figure)["views"][0]["parts"][0]["marks"][0]["columns"]
    assert columns["x"].size <= 200
    np.testing.assert_allclose(columns["x"][[0, -1]], [1e-6, 1.0], rtol=1e-3)
    np.testing.assert_allclose(columns["y"], np.sqrt(columns["x"]), rtol=1e-5)


def test_eigenvalues_of_one_side_have_their_sampling_interval(run):
    """Large-sample standard deviation of the logarithm of an eigenvalue: the root of 2 / (n - 1)."""
    estimate = dataclasses.replace(run.prediction.radiance["grass"], n=51)
    one = dataclasses.replace(run.prediction, radiance={"grass": estimate})
    (figure,) = (f for f in further_figures((None, one), ResultTable(), {}, {}, None) if f.section == "covariance")
    ((mark,),) = (part.marks for part in figure.views[0].parts)
    known = np.linalg.eigvalsh(estimate.pixel_covariance)[::-1][: mark.columns["y"].size]
    np.testing.assert_allclose(mark.columns["y"], known, rtol=1e-9)
    np.testing.assert_allclose(np.log(mark.columns["high"] / mark.columns["y"]), norm.isf(0.025) * 0.2, rtol=1e-12)
    low, high = figure.views[0].ends("y", figure.views[0].parts[0])
    assert low < known.min() <= known.max() < high


def test_statements_hold_the_numbers_and_a_view_each(figures):
    """The ratio below eigenvalues is that of the columns above; of classes without error the axis has an end."""
    above, below = stated(figures["radiance-eigenvalues"])["views"][0]["parts"]
    predicted, measured = (mark["columns"] for mark in above["marks"])
    ratio = below["marks"][0]["columns"]
    np.testing.assert_allclose(predicted["y"] / measured["y"], ratio["y"], rtol=1e-6)
    np.testing.assert_allclose(ratio["high"], 1.05 / 1.02, rtol=1e-6)
    (view,) = figures["class-error"].views
    assert view.ends("x")[0] > 0.0
    assert all((mark.columns["low"] > 0.0).all() for mark in view.parts[0].marks if "low" in mark.columns)
    difference = stated(figures["roc-difference"])["views"][0]["parts"][0]
    assert [rule[1] for rule in difference["rules"]] == [0.0, -0.1, 0.1]
    many = dataclasses.replace(figures["unmixing-areas"], views=figures["unmixing-areas"].views * 30)
    assert len(stated(many)["columns"]) == len(stated(figures["unmixing-areas"])["columns"])
    sheets = drawings_of([many], simulated=False)
    assert [sheet.name for sheet in sheets] == ["unmixing-areas-1", "unmixing-areas-2"]
    assert all(sheet.title.endswith("; 24 of 30 are drawn, all are in products.nc") for sheet in sheets)


def test_reasons_are_told_by_shape_and_number_not_by_colour_alone(figures, drawings):
    (part,) = stated(figures["attribution-inputs"])["views"][0]["parts"]
    assert part["marks"][0]["columns"]["right"].tolist() == pytest.approx([130.0, 5.0, 0.2])
    assert part["marks"][0]["words"][0] == "−3 times its step of 1 %"
    assert "one of several" in figures["attribution-inputs"].legend
    assert "one chance in a thousand" in figures["attribution-inputs"].legend
    (part,) = stated(figures["attribution-effects"])["views"][0]["parts"]
    assert part["marks"][0]["columns"]["value"].tolist() == pytest.approx([0.01, 0.02, 0.03, 0.04])
    assert len(part["x"]["names"]) == 1
    assert "standard uncertainty" in figures["attribution-effects"].legend
    (part,) = stated(figures["what-ifs"])["views"][0]["parts"]
    assert [mark["marker"] for mark in part["marks"]] == ["circle", "left", "right"]
    assert {"after, closer", "after, farther"} <= set(words_of(drawings["what-ifs"]))
    assert "104" in words_of(drawings["attribution-subjects"])
    assert not any("e+" in text for text in words_of(drawings["attribution-subjects"]))
    # Labels stay inside: each is a group that is moved to where its first letter stands.
    assert "all of the materials 4 m, P_D 1e-2 cem (gap 0.2)" in words_of(drawings["attribution-effects"])
    text = drawings["attribution-effects"].content.decode()
    assert min(float(x) for x in re.findall(r'<g transform="translate\((-?[\d.]+) ', text)) >= 0.0


@pytest.fixture(scope="module")
def planks(run):
    """A map of 50 objects of two subjects in a row, the measured scores 0.1 above the predicted median."""
    rng = np.random.default_rng(5)
    outlines, predicted, measured = {}, {}, {}
    for number, subject in enumerate(("large", "small")):
        names = tuple(f"{subject}-{i:02d}" for i in range(25))
        for i, name in enumerate(names):
            mask = np.zeros((9, 120), bool)
            mask[2 + 4 * number, 4 * i : 4 * i + 2] = True
            outlines[name] = mask
        draws = rng.normal(0.5 + number, 0.05, (400, 5))
        predicted[subject, "cem"] = ObjectScores(draws)
        measured[subject, "cem"] = ObjectScores(np.full(25, np.median(draws) + 0.1), names)
    sides = (
        type(run.prediction)(axis(2), object_scores=predicted),
        type(run.observation)(axis(2), object_scores=measured),
    )
    return {"planks-cem": ScoreMap(np.zeros((9, 120)), outlines=outlines)}, sides


def test_many_objects_are_a_map_and_a_histogram(planks):
    place, scores = stated(many_objects_figure(*planks))["views"][0]["parts"]
    (dots,) = place["marks"]
    np.testing.assert_allclose(dots["columns"]["value"], 0.1, atol=1e-6)
    assert (dots["columns"]["y"][0], dots["columns"]["x"][0]) == (2.5, 1.0), "the middle of its two pixels"
    assert dots["words"][0].startswith("large-00: measured ")
    assert (dots["scale"]["low"], dots["scale"]["high"]) == pytest.approx((-0.1, 0.1))
    measured, expected, below = scores["marks"]
    assert measured["columns"]["top"].sum() == len(dots["words"]) == 50
    assert expected["columns"]["y"][:-1].sum() == pytest.approx(50.0)
    assert dots["linked"], "what is chosen in the map stands out in the histogram"
    assert below["linked"]


def test_few_objects_are_a_list_and_groups_are_judged_together_alone(planks):
    maps, sides = planks
    some = dict(list(maps["planks-cem"].outlines.items())[:40])
    few = {"planks-cem": dataclasses.replace(maps["planks-cem"], outlines=some)}
    assert many_objects_figure(few, sides) is None
    assert many_objects_figure({"planks-ace": maps["planks-cem"]}, sides) is None, "another detector's map"
    assert many_objects_figure(maps, (sides[0], None)) is None
    groups = {figure.name: figure for figure in further_figures(sides, ResultTable(), {}, {}, None)}
    assert "object-scores" not in groups
    assert "50 objects" in groups["object-transforms"].alt


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
    one = dataclasses.replace(view, parts=(Part(Axis("y"), (Mark("line", {"x": [1.0], "y": [5.0]}),)),))
    assert np.all(np.isfinite([*one.ends("x"), *one.ends("y", one.parts[0])]))
    assert one.ends("y", one.parts[0])[0] < 5.0 < one.ends("y", one.parts[0])[1]


def test_pictures_are_drawn_in_little_memory():
    # 0.4 and 14 MB, besides a byte for each point
    shape = (600, 900)
    scores = ScoreMap(np.linspace(0.0, 1.0, 600 * 900).reshape(shape))
    draw_pictures(None, {"a": ScoreMap(np.eye(3))}, simulated=True)  # what is loaded with the first
    peaks = []
    for scene, maps in ((Quicklook(np.full((*shape, 3), 100, np.uint8)), {}), (None, {"a": scores})):
        tracemalloc.start()
        draw_pictures(scene, maps, simulated=True)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[0] < 5e6
    assert peaks[1] < 20e6


def pixels(drawing) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(drawing.content)).convert("RGB")).astype(int)


def test_a_map_has_the_colours_of_its_scores_and_says_where_it_is():
    """Pixels of the picture, each so many points wide: white for none, then from dark to bright."""
    values = np.linspace(0.0, 1.0, 200).reshape(10, 20)
    values[0, 0] = np.nan
    outline = np.zeros((10, 20), bool)
    outline[4:6, 8:12] = True
    plain, outlined = (
        draw_pictures(None, {"a": ScoreMap(values, outlines=own, pixel_size_m=size)}, simulated=False)[0]
        for own, size in (({}, None), ({"panel": outline}, 2.0))
    )
    picture, marked = pixels(plain), pixels(outlined)
    assert picture.shape == marked.shape
    top, left = 80, 96
    wide = (picture.shape[1] - left - 190) // 20
    corners = picture[top + wide // 2, left + wide // 2], picture[top + 10 * wide - 4, left + 20 * wide - 4]
    assert corners[0].tolist() == [255, 255, 255], "no score"
    np.testing.assert_allclose(corners[1], [253, 231, 37], atol=2)  # the highest
    np.testing.assert_allclose(picture[top + wide // 2, left + 3 * wide // 2], [68, 1, 84], atol=6)
    edges = [marked[top + 5 * wide - 3 : top + 5 * wide + 3, left + at * wide].tolist() for at in (8, 12, 9, 10)]
    assert [[255, 215, 0] in edge for edge in edges] == [True, True, False, False], "around the region, not through it"
    assert not np.array_equal(picture[-200:, :300], marked[-200:, :300]), "a scale"
    assert outlined.legend == "1 panel"


def test_a_target_of_one_pixel_is_seen_in_a_large_map():
    values = np.zeros((1700, 1700))
    values[5:900, 0:40] = np.nan
    values[1203, 704] = 9.0
    (drawing,) = draw_pictures(None, {"a": ScoreMap(values)}, simulated=False)
    assert "each point is the largest score of 3 by 3 pixels" in drawing.title
    bright = np.abs(pixels(drawing) - [253, 231, 37]).max(axis=-1)[:, :-190] <= 2
    assert [place.tolist() for place in np.nonzero(bright)] == [[80 + 1203 // 3], [96 + 704 // 3]]


@pytest.mark.parametrize("turned", [False, True])
def test_a_long_strip_is_cut_to_its_regions(turned):
    mask = np.zeros((1000, 100), bool)
    mask[500:520, 40:50] = True
    whole = np.zeros((300, 200), bool)
    titles = []
    for own in (mask, mask & False, whole):
        own = own.T if turned else own
        (drawing,) = draw_pictures(Quicklook(np.full((*own.shape, 3), 9, np.uint8), {"a": own}), {}, simulated=False)
        titles.append(drawing.title.partition("; ")[2])
    shown = "lines 0 to 99, samples 490 to 529" if turned else "lines 490 to 529, samples 0 to 99"
    assert titles == [shown, "", ""]
