"""The verdict says "agrees" only where model gates agree and nothing else disagrees."""

import csv
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from hyperval import cli
from hyperval.figures import campaigns_figure, criteria_figure
from hyperval.metrics import Evidence, explained, metric_of, plain_words
from hyperval.report.html import same_background_once
from hyperval.report.verdict import (
    disagrees_without_gating,
    first_screen,
    gate_fails,
    interval_text,
    last_line,
    limits_text,
    number_text,
    value_text,
    verdict,
    worst,
)
from hyperval.results import Outcome, Result, Role

A, D, U, S, E, N = (
    Outcome.AGREES, Outcome.DISAGREES, Outcome.UNDECIDED, Outcome.SKIPPED, Outcome.ERROR, Outcome.NONE,
)  # fmt: skip


def row(outcome, subject="grass", role=Role.GATE, evidence=Evidence.MODEL, **more):
    return Result(
        "c", "radiance", subject, "6S", "bias_ratio", 0.01, outcome=outcome, role=role, evidence=evidence, **more
    )


def informing(outcome, subject="grass"):
    return row(outcome, subject, Role.INFORM)


@pytest.mark.parametrize(
    ("outcomes", "tone"),
    [
        ([A, A], A), ([A, S], U), ([A, U], U), ([A, D], D), ([D], D), ([A, E], E), ([S], S), ([U], U), ([], N),
    ],
)  # fmt: skip
def test_tone_follows_the_outcomes(outcomes, tone):
    tone_now, words = verdict([row(o) for o in outcomes])
    assert tone_now is tone
    assert words.startswith("Met.") == (tone is A)
    assert words.startswith(("Inconclusive.", "Not run:")) == bool(outcomes and not {A, D, E} & set(outcomes))
    assert ("has no acceptance criteria" in words) == (not outcomes)


def test_checks_of_the_pipeline_are_counted_apart_and_are_no_agreement_of_the_model():
    checks = [row(A, evidence=Evidence.PIPELINE) for _ in range(18)]
    assert "18 checks of the pipeline are met (mean level of the radiance: grass)." in verdict(checks)[1]
    assert verdict(checks)[1].startswith("Inconclusive: no criterion of the model was decided.")
    assert verdict(checks)[0] is U
    both = verdict([row(A) for _ in range(12)] + checks)
    assert both == (
        A,
        "Met. 12 acceptance criteria are met (mean level of the radiance: grass). "
        "18 checks of the pipeline are met (mean level of the radiance: grass).",
    )


def test_what_disagrees_fails_and_was_skipped_is_named():
    _, words = verdict([row(D, "lawn"), row(E, "turf"), row(U, "lot"), row(A)])
    assert words == (
        "Not met. 1 acceptance criterion is not met (mean level of the radiance: lawn), 1 ended in an error "
        "(mean level of the radiance: turf), 1 is inconclusive (mean level of the radiance: lot), "
        "1 is met (mean level of the radiance: grass)."
    )


def test_many_campaigns_are_counted_and_not_named():
    many = [replace(row(S), campaign=f"line-{i}") for i in range(10)]
    assert "10 acceptance criteria were not run (10 campaigns)" in verdict(many)[1]
    assert "line-8" in verdict(many[:9])[1]


def test_one_falsified_gate_turns_the_verdict():
    rows = [row(A) for _ in range(20)]
    assert verdict(rows)[0] is A
    rows[7] = row(D)
    assert verdict(rows)[0] is D


def test_a_disagreement_that_does_not_decide_is_told_and_turns_nothing():
    tone, words = verdict([row(A), informing(D, "green planks")])
    assert tone is A
    assert words.startswith("Met. 1 acceptance criterion is met")
    assert "1 informational comparison is not met (mean level of the radiance: green planks)" in words


def test_the_reason_decides_nothing():
    told = "disagrees; would not pass at most 1; inconsistent; outside"
    assert verdict([row(A, reason=told), row(N, role=Role.INFORM, reason=told)])[0] is A
    assert not disagrees_without_gating(row(N, role=Role.INFORM, reason=told))


def test_many_disagreements_are_counted_by_what_they_are_about_or_by_product():
    others = [informing(D, f"field {i}") for i in range(10)]
    told = plain_words(others[0].metric, "radiance")
    assert f"10 informational comparisons are not met ({told}: 10)" in verdict([row(A), *others])[1]
    parts = ("windows", "vnir", "swir1", "swir2", "absorption")
    metrics = ("p_value_full", *(f"median_difference_ratio_{part}" for part in parts))
    many = [replace(other, metric=metric) for metric in metrics for other in others]
    assert "60 informational comparisons are not met (60 of radiance)" in verdict([row(A), *many])[1]


def test_undecided_gates_are_counted_in_the_last_line():
    assert last_line([row(A), row(U), row(U), informing(D)]) == "acceptance criteria: 1 met, 2 inconclusive"
    assert last_line([informing(D)]) == "acceptance criteria: none"


def test_the_worst_outcome_counts_for_several_rows():
    assert worst([row(A), row(U), row(S)]) is U
    assert worst([row(A), row(D), row(U)]) is D
    assert worst([]) is N
    assert gate_fails(row(D))
    assert not gate_fails(informing(D))
    assert gate_fails(informing(E))


@pytest.mark.parametrize(
    ("value", "spread", "text"),
    [
        (0.123456, math.nan, "0.1235"),
        (12345.678, math.nan, "12346"),
        (3.0, math.nan, "3"),
        (0.123456, 0.01, "0.123"),
        (-0.5, 0.2, "−0.50"),
        (1.2e-7, math.nan, "1.2e−07"),
        (math.nan, math.nan, "–"),
        (math.inf, math.nan, "∞"),
        (0.0, math.nan, "0"),
    ],
)
def test_numbers_have_sensible_digits(value, spread, text):
    assert number_text(value, spread) == text


def test_value_and_interval_share_their_digits():
    r = Result("c", "abundance", "t", "CEM", "area", 8.21234, "m2", lower=7.1, upper=9.4)
    assert value_text(r) == "8.2 m2"
    assert interval_text(r) == "7.1 to 9.4"


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "< 1e−300"), (0.18472, "0.18"), (3.219e-7, "3.2e−07"), (0.99979, "> 0.999")]
)
def test_p_values_have_two_digits_and_are_never_nothing(value, text):
    assert value_text(Result("c", "radiance", "panel", "6S", "p_value_full", value)) == text


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [(math.nan, 0.06, "≤ 0.06"), (0.01, math.nan, "≥ 0.01"), (-0.015, 0.015, "−0.015 to 0.015"),
     (math.nan, math.nan, "")],
)  # fmt: skip
def test_a_range_is_printed_from_its_limits_whatever_the_reason_says(low, high, text):
    assert limits_text(row(A, limit_low=low, limit_high=high, reason="at most a sixth more planks")) == text


def test_metrics_are_explained_in_words():
    words = metric_of("p_value_full").words
    assert explained(["p_value_full", "p_value_full"]) == [("p_value_full", words)]
    assert "predicted over measured variance" in metric_of("eigenvalue_ratio@3").words


def test_the_sentence_of_a_page_says_what_the_table_says(small, tmp_path):
    """Half a minute with the page: what agrees, what does not, what could not be told, counted anew."""
    small.gate("radiance")["at_most"] = 0.002  # some of it does not hold, some cannot be told
    cli.run(["-q", "validate", str(small.write()), "-o", str(tmp_path / "out")])
    page = (tmp_path / "out" / "report.html").read_text()
    (sentence,) = re.findall(r"<summary>All of it in words</summary><p>(.*?)</p>", page, re.DOTALL)
    with (tmp_path / "out" / "results.csv").open(newline="") as stream:
        gates = [r for r in csv.DictReader(stream) if r["role"] == "gate"]
    model = [r for r in gates if r["evidence"] == "model"]
    words = {
        "agrees": r"(?:is|are) met",
        "disagrees": r"(?:is|are) not met",
        "undecided": r"(?:is|are) inconclusive",
    }
    seen = {r["outcome"] for r in model}
    assert len(seen & set(words)) >= 2
    said = re.search(r"\d+ acceptance criteri.*?\)\.", sentence)[0]
    for outcome, verb in words.items():
        own = [r for r in model if r["outcome"] == outcome]
        told = re.search(rf"(\d+)(?: acceptance criteri\w+)? {verb} \((.*?)\)", said)
        assert (int(told[1]) if told else 0) == len(own), outcome
        for product in {r["product"] for r in own}:
            in_words = {"roc": "probability of detection"}.get(product, product)
            assert in_words in told[2] or product in told[2], (outcome, product)
    assert sentence.startswith("Not met.") == ("disagrees" in seen)
    assert ('<p class="status">Not met</p>' in page) == ("disagrees" in seen)
    failed = sum(r["outcome"] == "disagrees" for r in model)
    assert f'<p class="lead">{failed} of {len(model)} acceptance criteria' in page


def test_the_same_background_of_several_sizes_is_one_row():
    def row(subject, value=1.0, metric="score_sd_ratio"):
        return Result("c", "scores", subject, "cem", metric, value, outcome=Outcome.AGREES)

    rows = [row(f"felt {side} m background") for side in (3, 2, 1)]
    rows += [row("felt 3 m"), row("felt 2 m"), row("other background", 1.1), row("felt 1 m background", math.nan)]
    rows += [row("felt 2 m background", math.nan)]
    names = [(r.subject, r.value) for r in same_background_once(rows)]
    assert names[:4] == [
        ("felt 3 m background and 2 alike", 1.0), ("felt 3 m", 1.0), ("felt 2 m", 1.0), ("other background", 1.1),
    ]  # fmt: skip
    assert [name for name, _ in names[4:]] == ["felt 1 m background and 1 alike"]


@pytest.mark.parametrize(
    ("rows", "head"),
    [
        ([row(A), row(A)], "Met"),
        ([row(A), informing(D)], "Met"),
        ([row(A), row(U)], "Met in part"),
        ([row(U)], "Inconclusive"),
        ([row(D), row(A)], "Not met"),
        ([row(S)], "Not run"),
        ([informing(D)], "No acceptance criteria"),
    ],
)
def test_the_status_is_one_word(rows, head):
    screen = first_screen(rows)
    assert screen.head == head
    assert screen.steps
    assert (screen.outcome is N) == (head == "No acceptance criteria"), "which is no warning"


def criterion(outcome, value, subject="grass", half=0.02, **more):
    told = {"effect": 100.0 * value, "effect_unit": "% of radiance", "ideal": 0.0}
    told |= {"effect_lower": 100.0 * (value - half), "effect_upper": 100.0 * (value + half)}
    told |= {"accepted_low": -5.0, "accepted_high": 5.0}
    names = "c", "radiance", subject, "m", "median_difference_ratio_windows"
    return Result(*names, value, role=Role.GATE, outcome=outcome, **told, **more)


def test_criteria_are_drawn_in_units_of_the_field_with_what_is_accepted():
    rows = [criterion(A, 0.01), criterion(D, 0.12, "lawn", detectable_low=-8.0, detectable_high=8.0)]
    (view,) = criteria_figure(rows).views
    (part,) = view.parts
    assert part.y.names == ("lawn", "grass"), "the worst first"
    assert part.y.notes == ("+12 % (10 to 14)", "+1 % (−1 to 3)")
    assert part.x.label == "Radiance: level [% of radiance]"
    marks = [mark for mark in part.marks if not np.isnan(next(iter(mark.columns.values()))).all()]
    accepted, failed, met, found = marks
    np.testing.assert_allclose([accepted.columns["left"][0], accepted.columns["right"][0]], [-5.0, 5.0])
    np.testing.assert_allclose([failed.columns["x"][0], met.columns["x"][0]], [12.0, 1.0])
    np.testing.assert_allclose(sorted(found.columns["x"]), [-8.0, 8.0])
    assert {mark.label for mark in part.marks} == {"", "accepted range", "not met", "met", "smallest detectable error"}


def test_an_effect_without_stated_uncertainty_shows_no_interval():
    (view,) = criteria_figure([criterion(A, 0.01, half=0.0)]).views
    assert view.parts[0].y.notes == ("+1 %",)


def test_many_criteria_that_are_met_share_a_row():
    rows = [criterion(A, 0.001 * i, f"subject {i}") for i in range(30)] + [criterion(D, 0.2, "lawn")]
    (part,) = criteria_figure(rows).views[0].parts
    assert part.y.names[-1].endswith("more, met")
    assert len(part.y.names) < 12
    assert criteria_figure([row(S)]) is None


def test_campaigns_are_one_figure_the_worst_first():
    figure = campaigns_figure({"good": [row(A)] * 4, "bad": [row(A), row(D)], "absent": [row(S)]})
    (part,) = figure.views[0].parts
    assert (part.y.names, part.y.notes) == (("bad", "good"), ("1 not met, 1 met", "4 met"))
    failed, met = part.marks
    np.testing.assert_allclose([failed.columns["right"][0], met.columns["left"][0]], 50.0)
    assert campaigns_figure({"absent": [row(S)]}) is None
