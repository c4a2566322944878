"""Gates on covariances, tails and classification turn when what they judge is falsified."""

from __future__ import annotations

import pytest

from hyperval.campaign import job_of, run_campaign
from hyperval.results import Outcome, ResultTable
from small_campaign import SmallCampaign

CLASSES = ["field", "court"]


def gated(small: SmallCampaign) -> None:
    """Ask for a classifier, and gate spread, tails and its error."""
    small.data["classification"] = {
        "classes": CLASSES, "features": [{"name": "1 band", "bands_nm": [560]}], "block_lines": 4,
    }  # fmt: skip
    small.data["comparisons"] += [
        {"product": "covariance", "subjects": CLASSES, "metric": "total_variance_ratio", "within": [0.85, 1.15],
         "method": "radiance", "reason": "closure"},
        {"product": "covariance", "subjects": CLASSES, "metric": "tail_inverse_dof_difference",
         "within": [-0.05, 0.05], "reason": "closure"},
        {"product": "classification", "subjects": ["field / court"], "metric": "error_difference",
         "within": [-0.06, 0.06], "reason": "closure"},
    ]  # fmt: skip


def table_of(small: SmallCampaign) -> ResultTable:
    path = small.write()
    return run_campaign(job_of(path), show_progress=False).table


def outcome(table: ResultTable, product: str) -> set[Outcome]:
    return {row.outcome for row in table.where(product=product).gates()}


def test_a_true_campaign_passes(small):
    gated(small)
    table = table_of(small)
    for product in ("covariance", "classification"):
        assert outcome(table, product) == {Outcome.AGREES}


def more_spread(small):
    """The model takes the grass for more varied than it is."""
    small.scenario["scene"]["classes"][0]["covariance"] = {"relative_sd": 0.5, "band_sd": 0.001}


def heavy_tails(small):
    small.scenario["scene"]["classes"][0]["tail_dof"] = 5.0


def other_class(small):
    """The model takes the court for a second field."""
    small.scenario["scene"]["classes"][1]["spectrum"] = {"builtin": "grass"}


@pytest.mark.parametrize(
    ("change", "product", "metric"),
    [
        (more_spread, "covariance", "total_variance_ratio"),
        (heavy_tails, "covariance", "tail_inverse_dof_difference"),
        (other_class, "classification", "error_difference"),
    ],
)
def test_each_falsified_input_turns_its_gate(small, change, product, metric):
    gated(small)
    change(small)
    table = table_of(small)
    assert Outcome.DISAGREES in {row.outcome for row in table.where(product=product, metric=metric)}
    assert table.exit_code() == 1


def test_statistics_of_the_collection_itself_are_not_compared_with_themselves(small):
    gated(small)
    small.scenario["scene"]["classes"][0].update(spectrum={"measured": "field"}, tail_dof="measured")
    table = table_of(small)
    told = {(r.product, r.metric) for r in table.where(subject="field") if r.outcome is not Outcome.ERROR}
    assert ("covariance", "total_variance_ratio") not in told
    assert ("covariance", "tail_inverse_dof_difference") not in told
    assert ("covariance", "background_tail_dof") in told  # measured, and said to have nothing to compare with
    absent = {r.metric for r in table.where(product="covariance", subject="field", outcome=Outcome.ERROR)}
    assert absent == {"total_variance_ratio", "tail_inverse_dof_difference"}
