"""The verdict says "met" only where criteria of the model are met and none is not; numbers as a reader wants them."""

import csv
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from hyperval import cli
from hyperval.compare import mark_fitted
from hyperval.errors import UsageError
from hyperval.figures import campaigns_figure, criteria_figure
from hyperval.metrics import Evidence, plain_words
from hyperval.report import first_screen, interval_text, last_line, limits_text, number_text, value_text
from hyperval.results import Outcome, Result, Role

A, D, U, S, E, N = map(Outcome, ("agrees", "disagrees", "undecided", "skipped", "error", "none"))
WHAT = "mean level of the radiance"


def row(outcome, subject="grass", role=Role.GATE, **more):
    return Result("c", "radiance", subject, "6S", "bias_ratio", 0.01, outcome=outcome, role=role, **more)


def informing(subject="grass"):
    return row(D, subject, Role.INFORM)


def words(rows):
    return first_screen(rows).words


@pytest.mark.parametrize(
    ("outcomes", "tone", "head"),
    [
        ([A, A], A, "Met"), ([A, S], U, "Met in part"), ([A, U], U, "Met in part"), ([A, D], D, "Not met"),
        ([D], D, "Not met"), ([A, E], E, "Error"), ([S], S, "Not run"), ([U], U, "Inconclusive"),
        ([], N, "No acceptance criteria"),
    ],
)  # fmt: skip
def test_status_and_words_follow_the_outcomes(outcomes, tone, head):
    told = "disagrees; would not pass at most 1; inconsistent; outside"  # no reason turns a verdict
    screen = first_screen([*(row(o, reason=told) for o in outcomes), informing()])
    assert (screen.outcome, screen.head) == (tone, head)
    begin = {"Not run": "Not run:", "No acceptance criteria": "This campaign has no", "Error": "Ended in an error."}
    assert screen.words.startswith(begin.get(head, f"{head}."))
    assert screen.steps
    assert f"1 informational comparison is not met ({WHAT}: grass)" in screen.words


def test_checks_of_the_pipeline_are_counted_apart_and_are_no_agreement_of_the_model():
    checks = [row(A, evidence=Evidence.PIPELINE) for _ in range(18)]
    screen, counted = first_screen(checks), f"18 checks of the pipeline are met ({WHAT}: grass)."
    assert screen.outcome is U
    assert screen.words.startswith("Inconclusive: no criterion of the model was decided.")
    assert counted in screen.words
    assert words([row(A)] * 12 + checks) == f"Met. 12 acceptance criteria are met ({WHAT}: grass). {counted}"


def test_subjects_that_nothing_was_fitted_on_stand_apart():
    rows = [row(A), row(D, "lawn"), row(U, "all subjects")]
    for names, told in {
        "*": "grass, lawn; unseen: none yet",
        "gr*": f"grass; unseen: 1 not met ({WHAT}: lawn)",
    }.items():
        assert f"Budget and settings were fitted on {told}." in first_screen(mark_fitted(rows, [names])).asides
    with pytest.raises(UsageError, match="no comparison has the subject 'lot'"):
        mark_fitted(rows, ["lawn", "lot"])


def test_what_disagrees_fails_and_was_skipped_is_named_and_many_are_counted():
    assert words([row(D, "lawn"), row(E, "turf"), row(U, "lot"), row(A)]) == (
        f"Not met. 1 acceptance criterion ended in an error ({WHAT}: turf), 1 is not met ({WHAT}: lawn), "
        f"1 is inconclusive ({WHAT}: lot), 1 is met ({WHAT}: grass)."
    )
    many = [replace(row(S), campaign=f"line-{i}") for i in range(10)]
    assert "10 acceptance criteria were not run (10 campaigns)" in words(many)
    assert "line-8" in words(many[:9])
    others = [informing(f"field {i}") for i in range(10)]
    told = plain_words(others[0].metric, "radiance")
    assert f"10 informational comparisons are not met ({told}: 10)" in words([row(A), *others])
    parts = ("windows", "vnir", "swir1", "swir2", "absorption")
    metrics = ("p_value_full", *(f"median_difference_ratio_{part}" for part in parts))
    every = [replace(other, metric=metric) for metric in metrics for other in others]
    assert "60 informational comparisons are not met (60 of radiance)" in words([row(A), *every])
    assert last_line([row(A), row(U), row(U), informing()]) == "acceptance criteria: 2 inconclusive, 1 met"
    assert last_line([informing()]) == "acceptance criteria: none"


def test_numbers_values_intervals_and_limits_in_words():
    nan, told = math.nan, "at most a sixth more planks"
    for value, spread, text in (
        (0.123456, nan, "0.1235"), (12345.678, nan, "12346"), (3.0, nan, "3"), (0.123456, 0.01, "0.123"),
        (0.0, nan, "0"), (-0.5, 0.2, "−0.50"), (1.2e-7, nan, "1.2e−07"), (nan, nan, "–"), (math.inf, nan, "∞"),
    ):  # fmt: skip
        assert number_text(value, spread) == text
    area = Result("c", "abundance", "t", "CEM", "area", 8.21234, "m2", lower=7.1, upper=9.4)
    assert (value_text(area), interval_text(area)) == ("8.2 m2", "7.1 to 9.4")
    for value, text in ((0.0, "< 1e−300"), (0.18472, "0.18"), (3.219e-7, "3.2e−07"), (0.99979, "> 0.999")):
        assert value_text(Result("c", "radiance", "panel", "6S", "p_value_full", value)) == text
    for low, high, text in ((nan, 0.06, "≤ 0.06"), (0.01, nan, "≥ 0.01"), (-0.1, 0.1, "−0.1 to 0.1"), (nan, nan, "")):
        assert limits_text(row(A, limit_low=low, limit_high=high, reason=told)) == text


def test_the_sentence_of_a_page_says_what_the_table_says(small, tmp_path):
    """Half a minute with the page: what is met, what is not, what is inconclusive, counted anew."""
    small.gate("radiance")["at_most"] = 0.002  # some of it does not hold, some cannot be told
    cli.run(["-q", "validate", str(small.write()), "-o", str(tmp_path / "out")])
    page = (tmp_path / "out" / "report.html").read_text()
    (sentence,) = re.findall(r"<summary>In full</summary><p>(.*?)</p>", page, re.DOTALL)
    with (tmp_path / "out" / "results.csv").open(newline="") as stream:
        model = [r for r in csv.DictReader(stream) if r["role"] == "gate" and r["evidence"] == "model"]
    said = re.search(r"\d+ acceptance criteri.*?\)\.", sentence)[0]
    verbs = {"agrees": "(?:is|are) met", "disagrees": "(?:is|are) not met", "undecided": "(?:is|are) inconclusive"}
    for outcome, verb in verbs.items():
        own = [r["product"] for r in model if r["outcome"] == outcome]
        told = re.search(rf"(\d+)(?: acceptance criteri\w+)? {verb} \((.*?)\)", said)
        assert (int(told[1]) if told else 0) == len(own), outcome
        assert all(product.replace("roc", "probability of detection") in told[2] for product in own), outcome
    failed = sum(r["outcome"] == "disagrees" for r in model)
    assert failed > 0
    assert sentence.startswith("Not met.")
    assert '<p class="status">Not met</p>' in page
    assert f'<p class="lead">{failed} acceptance criteri' in page


def criterion(outcome, value, subject="grass", half=0.02, **more):
    told = {"effect": 100.0 * value, "effect_unit": "% of radiance", "ideal": 0.0}
    told |= {"effect_lower": 100.0 * (value - half), "effect_upper": 100.0 * (value + half)}
    told |= {"accepted_low": -5.0, "accepted_high": 5.0}
    names = "c", "radiance", subject, "m", "median_difference_ratio_windows"
    return Result(*names, value, role=Role.GATE, outcome=outcome, **told, **more)


def test_criteria_are_drawn_in_units_of_the_field_with_what_is_accepted():
    rows = [criterion(A, 0.01), criterion(D, 0.12, "lawn", detectable_low=-8.0, detectable_high=8.0)]
    (part,) = criteria_figure(rows).views[0].parts
    assert part.y.names == ("lawn", "grass"), "the worst first"
    assert part.y.notes == ("+12 % (10 to 14)", "+1 % (−1 to 3)")
    assert part.x.label == "Radiance: level [% of radiance]"
    (size,) = criteria_figure([replace(rows[0], metric="median_abs_difference_ratio_windows")]).views[0].parts
    assert size.x.label == "Radiance [% of radiance]", "not twice"
    marks = [mark for mark in part.marks if not np.isnan(next(iter(mark.columns.values()))).all()]
    accepted, failed, met, found = marks
    np.testing.assert_allclose([accepted.columns["left"][0], accepted.columns["right"][0]], [-5.0, 5.0])
    np.testing.assert_allclose([failed.columns["x"][0], met.columns["x"][0]], [12.0, 1.0])
    np.testing.assert_allclose(sorted(found.columns["x"]), [-8.0, 8.0])
    assert {mark.label for mark in part.marks} == {"", "accepted range", "not met", "met", "smallest detectable error"}


def test_a_forest_says_no_more_than_is_known_and_folds_what_is_met():
    (part,) = criteria_figure([criterion(A, 0.01, half=0.0)]).views[0].parts
    assert part.y.notes == ("+1 %",), "without stated uncertainty no interval"
    rows = [criterion(A, 0.001 * i, f"subject {i}") for i in range(30)] + [criterion(D, 0.2, "lawn")]
    figure = criteria_figure([*rows, replace(criterion(A, 0.0), product="snr")])
    assert figure.title.endswith("; 31 of 32 shown, all in summary.csv"), "a product of which all are met has no plot"
    (part,) = figure.views[0].parts
    assert part.y.names[-1].startswith("more: 2")
    assert len(part.y.names) < 12
    assert criteria_figure([row(S)]) is None


def test_campaigns_are_one_figure_the_worst_first():
    figure = campaigns_figure({"good": [row(A)] * 4, "bad": [row(A), row(D)], "absent": [row(S)]})
    (part,) = figure.views[0].parts
    assert (part.y.names, part.y.notes) == (("bad", "good"), ("1 not met, 1 met", "4 met"))
    failed, met = part.marks
    np.testing.assert_allclose([failed.columns["right"][0], met.columns["left"][0]], 50.0)
    assert campaigns_figure({"absent": [row(S)]}) is None
