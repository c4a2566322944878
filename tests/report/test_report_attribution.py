"""Plots of the reasons, as charts and for print: nothing cut, nothing told by colour alone."""

from __future__ import annotations

import re

import pytest
from test_report_charts import stated

from hyperval.figures import drawings_of, reason_figures
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
    return {figure.name: figure for figure in reason_figures(ResultTable(rows))}


@pytest.fixture(scope="module")
def drawings(plots):
    return {drawing.name: drawing for drawing in drawings_of(list(plots.values()), simulated=False)}


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


def test_statements_hold_the_numbers_of_the_rows(plots):
    (part,) = stated(plots["attribution-inputs"])["views"][0]["parts"]
    bars = part["marks"][0]
    assert bars["columns"]["right"].tolist() == pytest.approx([130.0, 5.0, 0.2])
    assert bars["words"][0] == "−3 times its step of 1 %"
    (part,) = stated(plots["attribution-effects"])["views"][0]["parts"]
    assert part["marks"][0]["columns"]["value"].tolist() == pytest.approx([0.01, 0.02, 0.03, 0.04])
    assert part["y"]["names"][3] == "all of the materials 4 m, P_D 1e-2 cem (gap 0.2)"
    assert len(part["x"]["names"]) == 1


def test_closer_and_farther_differ_in_shape_where_a_page_draws_them(plots):
    (part,) = stated(plots["what-ifs"])["views"][0]["parts"]
    assert [mark["marker"] for mark in part["marks"]] == ["circle", "left", "right"]
    (part,) = stated(plots["attribution-subjects"])["views"][0]["parts"]
    assert part["marks"][0]["words"] == ["104"]
    assert all(re.search("[a-z]{3}", figure.alt) for figure in plots.values())
