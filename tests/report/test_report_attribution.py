"""Plots of the reasons, as charts and for print: nothing cut, nothing told by colour alone."""

from __future__ import annotations

import json
import re

import pytest
from test_report_charts import models, numbers

from hyperval.report.charts import chart_of
from hyperval.report.figures import drawing_of
from hyperval.report.plots_run import reason_plots
from hyperval.report.style import house_style
from hyperval.results import Result, ResultTable


@pytest.fixture(scope="module")
def plots():
    long = "field spectrum of a target with a long name"
    rows = [
        Result("c", "attribution", "all", name, "likelihood_gain", gain, reason=f"{name}: -3 times its step of 1 %; x")
        for name, gain in ((long, 130.0), ("sensor gain", 5.0), ("blur (2)", 0.2))
    ]
    rows += [Result("c", "attribution", "lawn", long, "likelihood_gain", 104.0)]
    for i in range(1, 5):
        subject, method = f"all of the materials {i} m", f"{long} / cem/pixel"
        rows.append(Result("c", "sensitivity", subject, method, "roc_pd@1e-2_change", 0.01 * i, reason="gap 0.2"))
    rows += [
        Result("c", "what-if", "all", "closer", "reduced_chi_square", 1.2, reason="1.5 before"),
        Result("c", "what-if", "all", "farther", "reduced_chi_square", 2.2, reason="1.5 before"),
    ]
    return {p.name: p for p in reason_plots(ResultTable(rows))}


@pytest.fixture(scope="module")
def drawings(plots):
    with house_style():
        return {name: drawing_of(p, simulated=False) for name, p in plots.items()}


@pytest.fixture(scope="module")
def charts(plots):
    return {name: chart_of(p) for name, p in plots.items()}


def _words(drawing):
    return re.findall(r"<!-- (.*?) -->", drawing.content.decode())


def test_numbers_of_subjects_have_no_power_of_ten(drawings):
    assert "104" in _words(drawings["attribution-subjects"])
    assert not any("e+" in text for text in _words(drawings["attribution-subjects"]))


def test_labels_of_effects_stay_inside(drawings):
    text = drawings["attribution-effects"].content.decode()
    assert "all of the materials 4 m, P_D 1e-2 cem (gap 0.2)" in _words(drawings["attribution-effects"])
    # A label is a group that is moved to where its first letter stands.
    starts = [float(x) for x in re.findall(r'<g transform="translate\((-?[\d.]+) ', text)]
    assert starts
    assert min(starts) >= 0.0


def test_closer_and_farther_differ_in_shape(drawings):
    assert {"after, closer", "after, farther"} <= set(_words(drawings["what-ifs"]))
    assert "from 1.5 to 1.2" in drawings["what-ifs"].alt


def test_captions_say_what_a_unit_and_a_number_in_brackets_are(drawings):
    assert "standard uncertainty" in drawings["attribution-effects"].legend
    assert "one of several" in drawings["attribution-inputs"].legend
    assert "one chance in a thousand" in drawings["attribution-inputs"].legend


def test_charts_hold_the_numbers_of_the_rows(charts):
    fill = json.loads(charts["attribution-inputs"].content)["fill"]
    bars = {name: numbers(fill["arrays"][i]) for name, i in fill["sources"]["m-0-0"].items()}
    assert bars["right"].tolist() == pytest.approx([130.0, 5.0, 0.2])
    assert fill["ranges"]["y-0"] == [2.6, -0.6], "the greatest gain stands above the others"
    assert fill["texts"]["m-0-0"]["words"][0] == "−3 times its step of 1 %"
    fill = json.loads(charts["attribution-effects"].content)["fill"]
    assert numbers(fill["arrays"][fill["sources"]["m-0-0"]["value"]]).tolist() == pytest.approx(
        [0.01, 0.02, 0.03, 0.04]
    )
    assert fill["names"]["names-y-0"][3] == "all of the materials 4 m, P_D 1e-2 cem (gap 0.2)"
    assert len(fill["names"]["names-x-0"]) == 1


def test_charts_tell_closer_from_farther_by_shape_and_hold_no_numbers_in_their_models(charts):
    shapes = [glyph["angle"]["value"] for glyph in models(charts["what-ifs"].content, "Scatter") if "angle" in glyph]
    assert len(set(shapes)) == 2, "triangles that point either way"
    content = json.loads(charts["attribution-subjects"].content)
    assert "104" not in json.dumps(content["item"])
    assert content["fill"]["texts"]["m-0-0"]["words"] == ["104"]
    assert all(re.search("[a-z]{3}", chart.alt) for chart in charts.values())
