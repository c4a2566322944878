"""Figures of the reasons: nothing cut, nothing told by colour alone."""

from __future__ import annotations

import re

import pytest

from hyperval.report.figures_attribution import attribution_figures
from hyperval.report.style import house_style
from hyperval.results import Result, ResultTable


@pytest.fixture(scope="module")
def drawings():
    long = "field spectrum of a target with a long name"
    rows = [
        Result(
            "c", "attribution", "all", name, "likelihood_gain", gain, reason=f"{name}: -3 times its step of 1 %; x"
        )
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
    with house_style():
        return {d.name: d for d in attribution_figures(ResultTable(rows), simulated=False)}


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
