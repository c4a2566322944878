"""Charts hold the numbers of the products, and the same run gives the same bytes."""

from __future__ import annotations

import base64
import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from synthetic_run import make_run

from hyperval.products import ObjectScores, ObservedProducts, PredictedProducts, RocCurve
from hyperval.report.charts import (
    MANY_OBJECTS,
    MOST_SUBJECTS,
    chart_models,
    draw_charts,
    map_objects,
    objects_chart,
    roc_chart,
    spectra_chart,
)
from hyperval.report.charts_base import FIRST_CURVES
from hyperval.report.figures import spectra_plots
from hyperval.report.plots_run import eigenvalue_plots
from hyperval.report.run import ScoreMap, difference, eigenvalues
from hyperval.results import Outcome, Result, Role
from hyperval.run import to_arrays
from hyperval.spectra.axis import SpectralAxis


def models(content: str, kind: str) -> list[dict[str, Any]]:
    """Attributes of every model of a kind, in the order of the chart."""
    found: list[dict[str, Any]] = []

    def walk(value: Any) -> None:
        if isinstance(value, dict):
            if value.get("name") == kind and "attributes" in value:
                found.append(value["attributes"])
            for part in value.values():
                walk(part)
        elif isinstance(value, list):
            for part in value:
                walk(part)

    walk(json.loads(content))
    return found


def numbers(text: str) -> np.ndarray:
    """A column as the page's script reads it."""
    return np.frombuffer(base64.b64decode(text), "<f4")


def curve_columns(content: str) -> dict[str, np.ndarray]:
    """The columns of the first curve."""
    fill = json.loads(content)["fill"]
    return {name: numbers(fill["arrays"][i]) for name, i in fill["sources"]["curve-0-0-0"].items()}


@pytest.fixture(scope="module")
def run():
    return make_run(subjects=("grass", "lawn"), curves=5, bands=24)


def test_spectra_hold_both_sides_and_their_difference(run):
    chart = spectra_chart((run.prediction, run.observation), "radiance")
    assert chart.subjects == ("grass", "lawn")
    subjects = json.loads(chart.content)["subjects"]
    assert [list(one["ranges"]) for one in subjects] == [["level", "gap"]] * 2
    assert [list(one["columns"]) for one in subjects] == [["nm"], []], "one axis, once"
    bands = {name: [numbers(text) for text in pair] for name, pair in subjects[0]["bands"].items()}
    predicted, collected = run.prediction.radiance["grass"], run.observation.radiance["grass"]
    ratio, u = difference(predicted, collected, True)
    np.testing.assert_allclose(numbers(subjects[0]["columns"]["nm"]), run.prediction.axis.centre_nm, rtol=1e-6)
    for name, value, own_u in (
        ("predicted", predicted.mean, predicted.standard_uncertainty),
        ("collected", collected.mean, collected.standard_uncertainty),
        ("difference", ratio, u),
    ):
        np.testing.assert_allclose(bands[name][0], value, rtol=1e-5, atol=1e-7)
        np.testing.assert_allclose(bands[name][1], 1.96 * own_u, rtol=1e-5)
    other = numbers(subjects[1]["bands"]["collected"][0])
    np.testing.assert_allclose(other, run.observation.radiance["lawn"].mean, rtol=1e-6)


def test_identical_sides_have_no_empty_difference(run):
    chart = spectra_chart((run.prediction, run.prediction), "radiance")
    assert "which are identical" in chart.title
    for one in json.loads(chart.content)["subjects"]:
        assert (list(one["bands"]), list(one["ranges"])) == (["predicted", "collected"], ["level"])
    assert "identical" not in spectra_chart((run.prediction, run.observation), "radiance").title


def test_subjects_have_their_columns_once(run):
    """Value and half-width alone: limits follow, and a page of many subjects keeps room for its pictures."""
    (content,) = (c.content for c in draw_charts((run.prediction, None), []) if c.section == "radiance")
    sources = (dict(source["data"]["entries"]) for source in models(content, "ColumnDataSource"))
    entries = next(entries for entries in sources if "predicted" in entries)
    assert [values["shape"] for values in entries.values()] == [[0]] * 4
    assert [len(one["bands"]["predicted"]) for one in json.loads(content)["subjects"]] == [2, 2]


def test_the_same_run_gives_the_same_bytes_whatever_was_drawn_before(run):
    sides = (run.prediction, run.observation)
    first = [chart.content for chart in draw_charts(sides, [])]
    assert [chart.content for chart in draw_charts(sides, [])] == first
    assert all(len(content) > 1000 for content in first)


def test_charts_built_alike_share_their_models_and_not_their_numbers(run):
    """Models take a hundred times as long as numbers: another run of the same scenario waits for its own alone."""
    first = draw_charts((run.prediction, run.observation), [])
    twice = {name: dataclasses.replace(e, mean=2 * e.mean) for name, e in run.prediction.radiance.items()}
    built = chart_models.cache_info().misses
    second = draw_charts((dataclasses.replace(run.prediction, radiance=twice), run.observation), [])
    assert chart_models.cache_info().misses == built
    before, after = (
        json.loads(next(c for c in charts if c.section == "radiance").content) for charts in (first, second)
    )
    assert before["item"] == after["item"]
    values = [numbers(one["subjects"][0]["bands"]["predicted"][0]) for one in (before, after)]
    np.testing.assert_allclose(values[1], 2 * values[0], rtol=1e-6)


def test_the_subject_that_disagrees_stands_first_and_their_number_is_bounded(run):
    row = Result("r", "radiance", "lawn", "m", "p_value_full", 0.0, role=Role.GATE, outcome=Outcome.DISAGREES)
    chart = spectra_chart((run.prediction, run.observation), "radiance", [row])
    assert chart.subjects == ("lawn", "grass")
    many = make_run(bands=6, subjects=[f"s{i}" for i in range(30)], curves=0, shape=(4, 4))
    chart = spectra_chart((many.prediction, many.observation), "snr")
    assert len(chart.subjects) == len(json.loads(chart.content)["subjects"]) == MOST_SUBJECTS
    assert chart.title.endswith("; 24 of 30 are drawn, all are in products.nc")


def test_one_side_alone_has_its_spectra_and_no_difference(run):
    chart = spectra_chart((run.prediction, None), "reflectance")
    assert [list(one["bands"]) for one in json.loads(chart.content)["subjects"]] == [["predicted"]] * 2
    assert spectra_chart((run.prediction, dataclasses.replace(run.observation, snr={})), "snr") is None


def test_curves_beyond_the_first_wait_for_a_click_and_keep_their_points(run):
    predicted, measured = (
        dataclasses.replace(
            side, roc={(f"target {i}", "cem", "pixel"): next(iter(side.roc.values())) for i in range(5)}
        )
        for side in (run.prediction, run.observation)
    )
    chart = roc_chart((predicted, measured))
    seen = [line.get("visible", True) for line in models(chart.content, "GlyphRenderer")]
    per_curve = 4  # the interval and the line of each side
    assert sum(seen) == FIRST_CURVES * per_curve < len(seen)
    assert all(plot["click_policy"] == "hide" for plot in models(chart.content, "Legend"))


def test_long_curves_are_thinned_from_end_to_end(run):
    pfa = np.geomspace(1e-6, 1.0, 50_000)
    curve = RocCurve(pfa, *(np.sqrt(pfa),) * 3, pfa)
    one = dataclasses.replace(run.prediction, roc={("grass", "cem", "pixel"): curve})
    held = curve_columns(roc_chart((one, None)).content)
    assert held["pfa"].size <= 200
    np.testing.assert_allclose(held["pfa"][[0, -1]], [1e-6, 1.0], rtol=1e-3)
    np.testing.assert_allclose(held["pd"], np.sqrt(held["pfa"]), rtol=1e-5)


def test_bands_that_go_by_number_are_called_so(run):
    bands = len(run.observation.axis)
    observed = dataclasses.replace(
        run.observation, axis=SpectralAxis(np.arange(1.0, bands + 1.0), np.ones(bands)), roc={}
    )
    chart = spectra_chart((None, observed), "reflectance")
    assert "number of the band" in [axis["axis_label"] for axis in models(chart.content, "LinearAxis")]
    assert models(chart.content, "HoverTool")[0]["tooltips"][0] == ["band", "@nm{0}"]
    assert "absorption" not in chart.title
    assert not models(chart.content, "VStrip")
    assert "wavelength" not in chart.alt
    (plots, *_) = spectra_plots((None, observed), "reflectance")
    assert "against number of the band" in plots.alt
    assert to_arrays(observed)["wavelength"][2] == {"units": "1", "long_name": "number of the band"}
    known = spectra_chart((None, run.observation), "reflectance")
    assert models(known.content, "VStrip")
    assert "against wavelength" in known.alt


def test_eigenvalues_of_one_side_have_their_sampling_interval(run):
    """Large-sample standard deviation of the logarithm of an eigenvalue: the root of 2 / (n - 1)."""
    (plots,) = eigenvalue_plots((run.prediction, None))
    view = plots.views["grass"]
    ((mark,),) = (part.marks for part in view.parts)
    estimate = run.prediction.radiance["grass"]
    np.testing.assert_array_equal(mark.columns["y"], eigenvalues(estimate))
    np.testing.assert_array_equal(mark.columns["x"], np.arange(1, mark.columns["y"].size + 1))
    low, high = view.ends(view.parts[0])
    assert low < mark.columns["y"].min() <= mark.columns["y"].max() < high
    one = dataclasses.replace(run.prediction, radiance={"grass": dataclasses.replace(estimate, n=51)})
    ((mark,),) = (part.marks for part in eigenvalue_plots((None, one))[0].views["grass"].parts)
    np.testing.assert_allclose(np.log(mark.columns["high"] / mark.columns["y"]), 1.96 * 0.2, rtol=1e-12)
    assert eigenvalue_plots((dataclasses.replace(run.prediction, radiance={}), None)) == []


@pytest.fixture(scope="module")
def planks():
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
    axis_of = SpectralAxis(np.array([500.0, 600.0]), 10.0)
    sides = (PredictedProducts(axis_of, object_scores=predicted), ObservedProducts(axis_of, object_scores=measured))
    return {"planks-cem": ScoreMap(np.zeros((9, 120)), outlines=outlines)}, sides


def test_many_objects_are_a_map_and_a_histogram(planks):
    maps, sides = planks
    own = map_objects("planks-cem", maps["planks-cem"], sides)
    np.testing.assert_allclose(own.measured - own.predicted, 0.1, atol=1e-12)
    assert (own.line[0], own.sample[0]) == (2.5, 1.0), "the middle of its two pixels"
    _, measured, expected = own.histogram()
    assert measured.sum() == len(own.names) == 50
    assert expected.sum() == pytest.approx(50.0)
    content = json.loads(objects_chart(maps, sides).content)
    fill = content["fill"]
    columns = {name: numbers(fill["arrays"][i]) for name, i in fill["sources"]["objects-0"].items()}
    np.testing.assert_allclose(columns["difference"], 0.1, atol=1e-6)
    assert fill["texts"]["objects-0"]["name"] == list(own.names)
    assert fill["colours"]["difference-0"] == pytest.approx([-0.1, 0.1])
    sources = [m["name"] for m in models(json.dumps(content["item"]), "ColumnDataSource")]
    assert sorted(sources) == ["bins-0", "objects-0"], "map and histogram share what is chosen"


def test_few_objects_stay_a_list(planks):
    maps, sides = planks
    some = dict(list(maps["planks-cem"].outlines.items())[:MANY_OBJECTS])
    assert objects_chart({"planks-cem": dataclasses.replace(maps["planks-cem"], outlines=some)}, sides) is None
    assert objects_chart({"planks-ace": maps["planks-cem"]}, sides) is None, "another detector's map"
    assert objects_chart(maps, (sides[0], None)) is None
