"""The broken twin: mixtures, heavy tails, texture and shade open a gap, and the comparison shows it.

Agreement is not expected here.  A harness that still agreed would not be looking.
"""

from __future__ import annotations

import pytest
from twin_run import FIELDS, PANELS, TWIN, difference, levels, run_twin

from hyperval.campaign import job_of
from hyperval.compare import judged
from hyperval.results import Outcome, ResultTable

MEDIAN = "median_abs_difference_ratio_windows"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> ResultTable:
    return run_twin("campaign-broken.yaml", 2012, tmp_path_factory.mktemp("broken"))


@pytest.mark.parametrize("pfa", ["1e-2", "1e-3"])
def test_predicted_detection_leaves_the_measured_interval(run, pfa):
    found = levels(run, pfa)
    outside = [level for level in found if not level.inside]
    assert len(found) == 10
    # Seeds 2012 to 2015 put 8 to 10 cases outside at 1e-2 and 9 at 1e-3; under closure it is 0 or 1.
    assert len(outside) >= 6, outside
    # The model knows neither mixtures nor tails: it is too hopeful, not merely different.
    assert all(level.predicted > level.measured for level in outside)


def test_radiance_of_a_mixed_class_departs_and_pure_panels_stay(run):
    # Grass holds 8 % soil and texture moves both fields; the panels are unmixed and hold to 1 %.
    assert difference(run, "grass-field", MEDIAN) > 0.01
    assert all(difference(run, panel, MEDIAN) <= 0.01 for panel in PANELS)
    assert all(difference(run, field, MEDIAN) > 0.001 for field in FIELDS)


@pytest.mark.parametrize("subject", ["yellow-fill-0.060", "green-fill-0.200"])
def test_scores_of_planks_that_lie_as_they_fall_are_lower_than_predicted(run, subject):
    # The model puts every plank in the middle of a pixel.
    (target,) = run.where(product="scores", subject=subject, metric="score_mean_difference")
    assert target.lower > 0.0
    # Against soil, texture and shade the filter is another one; the spread of its background is off by 1 to 8 %,
    # far beyond its interval of 0.4 %.
    (spread,) = run.where(product="scores", subject=f"{subject} background", metric="score_sd_ratio")
    assert spread.lower > 1.0


def test_the_gates_of_closure_would_fail(run):
    gates = job_of(TWIN / "campaign.yaml").campaign.comparisons
    table = ResultTable(judged(list(run), gates))
    assert {row.product for row in table.gates().where(outcome=Outcome.DISAGREES)} == {
        "radiance",
        "reflectance",  # of mixed fields, by the full test
        "roc",
        "scores",  # of planks
        "covariance",  # of mixed fields
    }
    assert table.exit_code() == 1
