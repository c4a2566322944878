"""Figures hold the numbers of the products, and their statement holds those of the figure: the same bytes each time."""

from __future__ import annotations

import base64
import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from synthetic_run import make_run

from hyperval.figures import (
    MOST_SUBJECTS,
    Figure,
    ScoreMap,
    difference,
    eigenvalue_figures,
    eigenvalues,
    first_figures,
    many_objects_figure,
    roc_figure,
    spectra_figure,
    statement,
)
from hyperval.products import ObjectScores, ObservedProducts, PredictedProducts, RocCurve
from hyperval.results import Outcome, Result, Role
from hyperval.run import to_arrays
from hyperval.spectra import SpectralAxis


def stated(figure: Figure) -> dict[str, Any]:
    """A figure as the page's script reads it: each mark with its columns as arrays."""
    whole: dict[str, Any] = json.loads(statement(figure))
    arrays = [np.frombuffer(base64.b64decode(text), "<f4") for text in whole["columns"]]
    for view in whole["views"]:
        for part in view["parts"]:
            for mark in part["marks"]:
                mark["columns"] = {name: arrays[i] for name, i in mark["columns"].items()}
    return whole


@pytest.fixture(scope="module")
def run():
    return make_run(subjects=("grass", "lawn"), curves=5, bands=24)


def test_spectra_hold_both_sides_and_their_difference(run):
    figure = spectra_figure((run.prediction, run.observation), "radiance")
    whole = stated(figure)
    assert [view["subject"] for view in whole["views"]] == ["grass", "lawn"]
    above, below = whole["views"][0]["parts"]
    predicted, measured = run.prediction.radiance["grass"], run.observation.radiance["grass"]
    ratio, u = difference(predicted, measured, True)
    for mark, value, own_u in (
        (above["marks"][0], measured.mean, measured.standard_uncertainty),
        (above["marks"][1], predicted.mean, predicted.standard_uncertainty),
        (below["marks"][0], ratio, u),
    ):
        np.testing.assert_allclose(mark["columns"]["x"], run.prediction.axis.centre_nm, rtol=1e-6)
        np.testing.assert_allclose(mark["columns"]["y"], value, rtol=1e-5, atol=1e-7)
        np.testing.assert_allclose(mark["columns"]["half"], 1.96 * own_u, rtol=1e-5)
    assert [mark["dash"] for mark in above["marks"]] == ["solid", "dashed"]
    other = whole["views"][1]["parts"][0]["marks"][0]["columns"]["y"]
    np.testing.assert_allclose(other, run.observation.radiance["lawn"].mean, rtol=1e-6)


def test_columns_stand_once(run):
    """Wavelengths of all subjects, and a half-width in place of two limits: a page keeps room for its pictures."""
    whole = json.loads(statement(spectra_figure((run.prediction, run.observation), "radiance")))
    assert len(whole["columns"]) == 1 + 2 * 3 * 2


def test_identical_sides_have_no_empty_difference(run):
    figure = spectra_figure((run.prediction, run.prediction), "radiance")
    assert "which are identical" in figure.title
    assert [len(view.parts) for view in figure.views] == [1, 1]
    assert "identical" not in spectra_figure((run.prediction, run.observation), "radiance").title


def test_sides_on_other_bands_are_not_drawn_over_each_other(run):
    axis = run.observation.axis
    moved = dataclasses.replace(run.observation, axis=SpectralAxis(axis.centre_nm + 40.0, axis.fwhm_nm))
    view = spectra_figure((run.prediction, moved), "radiance").views[0]
    assert [mark.label for part in view.parts for mark in part.marks] == ["predicted"]


def test_the_same_run_gives_the_same_bytes_whatever_was_drawn_before(run):
    sides = (run.prediction, run.observation)
    first = [statement(figure) for figure in first_figures(sides)]
    assert [statement(figure) for figure in first_figures(sides)] == first
    assert all(len(text) > 1000 for text in first)


def test_the_subject_that_disagrees_stands_first_and_their_number_is_bounded(run):
    row = Result("r", "radiance", "lawn", "m", "p_value_full", 0.0, role=Role.GATE, outcome=Outcome.DISAGREES)
    figure = spectra_figure((run.prediction, run.observation), "radiance", [row])
    assert [view.subject for view in figure.views] == ["lawn", "grass"]
    many = make_run(bands=6, subjects=[f"s{i}" for i in range(30)], curves=0, shape=(4, 4))
    figure = spectra_figure((many.prediction, many.observation), "snr")
    assert len(figure.views) == MOST_SUBJECTS
    assert figure.title.endswith("; 24 of 30 are drawn, all are in products.nc")


def test_one_side_alone_has_its_spectra_and_no_difference(run):
    figure = spectra_figure((run.prediction, None), "reflectance")
    assert [[mark.label for mark in figure.marks()]] == [["predicted"] * 2]
    assert spectra_figure((run.prediction, dataclasses.replace(run.observation, snr={})), "snr") is None


def test_curves_have_a_tab_a_detector_and_may_stand_over_each_other(run):
    figure = roc_figure((run.prediction, run.observation))
    assert list(dict.fromkeys(view.tab for view in figure.views)) == ["CEM, by pixel", "CEM, by object"]
    assert figure.together == "first"
    marks = figure.views[0].parts[0].marks
    assert [(mark.kind, mark.dash) for mark in marks] == [("line", "dashed"), ("steps", "solid")]
    assert figure.views[0].parts[0].rules == (("x", 1.0 / 12203),)
    assert "12\u202f203 background px" in figure.views[0].note


def test_long_curves_are_thinned_from_end_to_end(run):
    pfa = np.geomspace(1e-6, 1.0, 50_000)
    curve = RocCurve(pfa, *(np.sqrt(pfa),) * 3, pfa)
    one = dataclasses.replace(run.prediction, roc={("grass", "cem", "pixel"): curve})
    held = stated(roc_figure((one, None)))["views"][0]["parts"][0]["marks"][0]["columns"]
    assert held["x"].size <= 200
    np.testing.assert_allclose(held["x"][[0, -1]], [1e-6, 1.0], rtol=1e-3)
    np.testing.assert_allclose(held["y"], np.sqrt(held["x"]), rtol=1e-5)


def test_bands_that_go_by_number_are_called_so(run):
    bands = len(run.observation.axis)
    observed = dataclasses.replace(
        run.observation, axis=SpectralAxis(np.arange(1.0, bands + 1.0), np.ones(bands)), roc={}
    )
    figure = spectra_figure((None, observed), "reflectance")
    assert figure.views[0].x.label == "number of the band"
    assert "absorption" not in figure.title
    assert "absorption" not in json.loads(statement(figure))
    assert "against number of the band" in figure.alt
    assert to_arrays(observed)["wavelength"][2] == {"units": "1", "long_name": "number of the band"}
    known = spectra_figure((None, run.observation), "reflectance")
    assert [685.0, 693.0] in json.loads(statement(known))["absorption"]
    assert "against wavelength" in known.alt


def test_eigenvalues_of_one_side_have_their_sampling_interval(run):
    """Large-sample standard deviation of the logarithm of an eigenvalue: the root of 2 / (n - 1)."""
    (figure,) = eigenvalue_figures((run.prediction, None))
    (view,) = (view for view in figure.views if view.subject == "grass")
    ((mark,),) = (part.marks for part in view.parts)
    estimate = run.prediction.radiance["grass"]
    np.testing.assert_array_equal(mark.columns["y"], eigenvalues(estimate))
    np.testing.assert_array_equal(mark.columns["x"], np.arange(1, mark.columns["y"].size + 1))
    low, high = view.ends("y", view.parts[0])
    assert low < mark.columns["y"].min() <= mark.columns["y"].max() < high
    one = dataclasses.replace(run.prediction, radiance={"grass": dataclasses.replace(estimate, n=51)})
    ((mark,),) = (part.marks for part in eigenvalue_figures((None, one))[0].views[0].parts)
    np.testing.assert_allclose(np.log(mark.columns["high"] / mark.columns["y"]), 1.96 * 0.2, rtol=1e-12)
    assert eigenvalue_figures((dataclasses.replace(run.prediction, radiance={}), None)) == []


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


def test_few_objects_stay_a_list(planks):
    maps, sides = planks
    some = dict(list(maps["planks-cem"].outlines.items())[:40])
    few = {"planks-cem": dataclasses.replace(maps["planks-cem"], outlines=some)}
    assert many_objects_figure(few, sides) is None
    assert many_objects_figure({"planks-ace": maps["planks-cem"]}, sides) is None, "another detector's map"
    assert many_objects_figure(maps, (sides[0], None)) is None
